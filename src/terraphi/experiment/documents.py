"""Documents that people write, and files that the package ships."""

from __future__ import annotations

import json
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from terraphi.experiment.errors import InputError, nearest, sentence_from_validation
from terraphi.experiment.files import read_bytes

Model = TypeVar("Model", bound=BaseModel)

WRITTEN = "written by people"
"""Context in which pydantic checks a document that people write, in contrast to a stored one."""


def shipped_names(folder: str, suffix: str) -> list[str]:
    """Names of the shipped files of a kind, without their suffix, sorted."""
    place = resources.files("terraphi").joinpath("data", folder)
    entries = [entry.name for entry in place.iterdir()] if place.is_dir() else []
    return sorted(name.removesuffix(suffix) for name in entries if name.endswith(suffix))


def shipped_file(folder: str, name: str, suffix: str) -> Path:
    """Path of a shipped file.

    Parameters
    ----------
    folder
        Folder within the package's data.
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
    return Path(str(resources.files("terraphi").joinpath("data", folder, name + suffix)))


def shipped_folder(*parts: str) -> Path:
    """Path of a folder within the package's data, whether it exists or not."""
    return Path(str(resources.files("terraphi").joinpath("data", *parts)))


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
