"""Documents that people write, and files that the package ships."""

from __future__ import annotations

import json
import tomllib
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from terraphi.experiment.errors import InputError, nearest, sentence_from_validation
from terraphi.experiment.files import read_bytes

Model = TypeVar("Model", bound=BaseModel)

STUDIES = "terraphi.studies"
"""Group of the entry points by which packages of studies are found."""


@cache
def data_folders() -> tuple[Path, ...]:
    """Folders of data: this package's, then those of the packages of studies that are installed."""
    packages = ["terraphi", *(found.module for found in entry_points(group=STUDIES))]
    specs = [spec for spec in map(find_spec, packages) if spec is not None]
    places = [place for spec in specs for place in spec.submodule_search_locations or ()]
    return tuple(Path(place) / "data" for place in places)


WRITTEN = "written by people"
"""Context in which pydantic checks a document that people write, in contrast to a stored one."""


class Strict(BaseModel):
    """A table of a document: frozen, without unknown keys, of finite numbers."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )


def shipped_names(folder: str, suffix: str) -> list[str]:
    """Names of the shipped files of a kind, without their suffix, sorted."""
    found = {
        file.name.removesuffix(suffix)
        for place in data_folders()
        for file in place.joinpath(folder).glob(f"*{suffix}")
    }
    return sorted(found)


def shipped_file(folder: str, name: str, suffix: str) -> Path:
    """Path of a shipped file.

    Parameters
    ----------
    folder
        Folder within the data.
    name
        Name without suffix.
    suffix
        With its dot.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If there is none of that name; the nearest is named.
    """
    names = shipped_names(folder, suffix)
    if name not in names:
        raise InputError(f"'{name}' is neither a file nor a shipped name; {nearest(name, names)}")
    return shipped_folder(folder, name + suffix)


def shipped_folder(*parts: str) -> Path:
    """Path of a file or folder within the data; if it is nowhere, where this package would have it.

    Where two packages have it, it is that of the first of :func:`data_folders`.
    """
    places = [place.joinpath(*parts) for place in data_folders()]
    return next((place for place in places if place.exists()), places[0])


def strictly(content: dict[str, Any], model: type[Model]) -> Model:
    """Check a document by its types as written: ``true`` and ``"1650"`` are no numbers.

    Parameters
    ----------
    content
        Tables, arrays, words and numbers.
    model
        The pydantic model that it must fill.

    Returns
    -------
    Model

    Raises
    ------
    pydantic.ValidationError
        If it does not.
    """
    # In strict mode only JSON lets an array become a tuple.
    return model.model_validate_json(json.dumps(content, default=str), strict=True, context=WRITTEN)


def parse_toml(path: Path, model: type[Model]) -> Model:
    """Read a strict document from a TOML file.

    Parameters
    ----------
    path
        The file, a pipe, or ``-`` for standard input.
    model
        The pydantic model that it must fill.

    Returns
    -------
    Model

    Raises
    ------
    InputError
        One sentence with file, key, what was found and what is expected.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file; TOML in UTF-8 is expected") from error
    content = toml_content(text, path)
    try:
        return strictly(content, model)
    except ValidationError as error:
        if error.errors()[0]["type"] == "json_invalid":  # what TOML has, JSON has but for its depth
            raise _too_deep(path) from error
        raise InputError(sentence_from_validation(error, str(path), model)) from error
    except RecursionError as error:
        raise _too_deep(path) from error


def toml_content(text: str, path: Path) -> dict[str, Any]:
    """Content of a TOML document; raises InputError, with the name of its file, if it has none."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    except RecursionError as error:
        raise _too_deep(path) from error
    except ValueError as error:  # of an integer with thousands of digits
        reason = str(error).partition(";")[0]
        raise InputError(f"{path}: not valid TOML: {reason}") from error


def _too_deep(path: Path) -> InputError:
    return InputError(
        f"{path}: tables or arrays are nested hundreds deep; a few levels are expected"
    )
