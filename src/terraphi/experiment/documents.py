"""Documents that people write in TOML, and files that the package ships."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from terraphi.experiment.errors import InputError, nearest, sentence_from_validation
from terraphi.experiment.files import is_there, read_text

Model = TypeVar("Model")

DATA = Path(__file__).parents[1] / "data"
"""Folder of the shipped files."""


class Strict(BaseModel):
    """A table of a document: frozen, without unknown keys, of finite numbers."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )

    def __init__(self, /, **values: Any) -> None:
        """Check the values; raises InputError with the first thing wrong."""
        try:
            super().__init__(**values)
        except ValidationError as error:
            name = type(self).__name__
            raise InputError(sentence_from_validation(error, name, type(self))) from error

    # Without this mark pydantic would call it for tables within tables too, and lose their keys.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]


def refuse(sentences: Mapping[str, bool]) -> None:
    """Raise ValueError with the first sentence that is true."""
    for sentence, is_true in sentences.items():
        if is_true:
            raise ValueError(sentence)


def shipped_names(folder: str, suffix: str) -> list[str]:
    """Names of the shipped files of a kind, without their suffix, sorted."""
    return sorted(file.name.removesuffix(suffix) for file in DATA.glob(f"{folder}/*{suffix}"))


def shipped_file(folder: str, name: str, suffix: str) -> Path:
    """Path of a shipped file; raises InputError with the nearest name if there is none.

    Parameters
    ----------
    folder
        Folder within the data.
    name
        Name without suffix.
    suffix
        With its dot.
    """
    names = shipped_names(folder, suffix)
    if name not in names:
        raise InputError(f"'{name}' is neither a file nor a shipped name; {nearest(name, names)}")
    return DATA / folder / (name + suffix)


def located(source: Path | str, folder: str, suffix: str) -> Path:
    """Path of a file, or of a shipped one by its name; errors as of :func:`shipped_file`."""
    path = Path(source)
    if path.suffix == suffix or is_there(path):
        return path
    return shipped_file(folder, str(source), suffix)


def value_of(text: str) -> Any:
    """A value on a command line as TOML has it; a word may lack its quotation marks."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        pass
    try:
        return float(text)  # such as .5, which is no number of TOML
    except ValueError:
        return text.strip(" '\"")


def strictly(content: Any, model: type[Model], source: str) -> Model:
    """Check a document, also as JSON in bytes, by its types: ``"1650"`` is no number.

    Raises InputError, with the name of its source, if it does not fill the model.
    """
    # In strict mode only JSON lets an array become a tuple.
    text = content if isinstance(content, bytes) else json.dumps(content, default=str)
    try:
        return TypeAdapter(model).validate_json(text, strict=True)
    except ValidationError as error:
        raise InputError(sentence_from_validation(error, source, model)) from error


def parse_toml(path: Path, model: type[Model]) -> Model:
    """Read a strict document from a TOML file.

    Parameters
    ----------
    path
        The file, a pipe, or ``-`` for standard input.
    model
        The pydantic model that it must fill.

    Raises
    ------
    InputError
        With file, key, what was found and what is expected.
    """
    text = read_text(path)
    try:
        content = tomllib.loads(text)
    except (RecursionError, ValueError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    return strictly(content, model, str(path))
