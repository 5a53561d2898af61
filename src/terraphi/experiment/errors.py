"""What is raised when something a person wrote cannot be used."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, get_args

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

TYPO = 0.9
"""How alike a word and a choice are, at least, of which one is the other mistyped [-]."""


class InputError(ValueError):
    """An input is unusable; the message is one sentence that names the place and the remedy.

    The command line prints the message as it stands and exits with status 2.
    """


class SimulationError(RuntimeError):
    """A simulation broke down: a particle left the grid or a force is not a number."""


@contextmanager
def needing(what: str, packages: str, *, extra: str) -> Iterator[None]:
    """Say, where an import in the block fails, which extra installs the packages of what is done.

    Raises
    ------
    InputError
        Such as ``"walk.mcap: reading MCAP needs mcap: pip install 'terraphi[robot]'"``.
    """
    try:
        yield
    except ImportError as error:
        raise InputError(f"{what} needs {packages}: pip install 'terraphi[{extra}]'") from error


def nearest(word: str, choices: Iterable[str]) -> str:
    """Hint that names the choice closest to a misspelt word, or lists them all.

    Parameters
    ----------
    word
        What was written.
    choices
        What could have been written.

    Returns
    -------
    str
        ``"did you mean 'yuma'?"`` or ``"known: a, b, c"``.
    """
    known = sorted(choices)
    folded = {choice.lower(): choice for choice in known}
    written = word.lower()
    # NAME-ROLE that is no slip of the pen is nearer to NAME than to what has another role.
    stems = [choice for choice in folded if choice and written.startswith(f"{choice}-")]
    match = (
        difflib.get_close_matches(written, folded, n=1, cutoff=TYPO)
        or sorted(stems, key=len)[-1:]
        or difflib.get_close_matches(written, folded, n=1)
    )
    if match:
        return f"did you mean '{folded[match[0]]}'?"
    return "known: " + (", ".join(known) or "none")


def sentence_from_validation(error: ValidationError, source: str, model: type[BaseModel]) -> str:
    """One sentence for the first thing wrong in a document that a person wrote.

    Parameters
    ----------
    error
        What pydantic raised.
    source
        Name of the file.
    model
        The model that refused it, searched for the name nearest to an unknown key.

    Returns
    -------
    str
        File, dotted key, what was found and what is expected.
    """
    # A misspelt key explains whatever else is wrong, such as the right one's absence.
    errors = error.errors()
    first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
    path = [str(part) for part in first["loc"]]
    if first["type"] == "extra_forbidden":
        names = _field_names(model, path[:-1])
        key = ".".join([*_as_written(path[:-1]), path[-1]])
        return f"{source}: unknown key '{key}'; {nearest(path[-1], names)}"
    key = ".".join(_as_written(path))
    if first["type"] == "list_type" and isinstance(first["input"], dict):
        return f"{source}: [{key}] is one table and there may be several: write [[{key}]]"
    message = first["msg"].removeprefix("Value error, ").removeprefix("Input ").rstrip(".")
    message = message.replace("an object", "a table")  # TOML has tables
    if first["type"] == "missing":
        return f"{source}: key '{key}' is missing"
    if first["type"] == "value_error":
        return f"{source}: {key + ': ' if key else ''}{message}"
    if first["type"] == "union_tag_invalid":
        tag, expected = first["ctx"]["tag"], first["ctx"]["expected_tags"]
        return f"{source}: {key}.kind = '{tag}': should be {expected}{_hint(tag, expected)}"
    hint = ""
    if first["type"] == "literal_error":
        hint = _hint(str(first["input"]), first["ctx"]["expected"])
    return f"{source}: {key} = {first['input']!r}: {message}{hint}"


def _as_written(path: list[str]) -> list[str]:
    """Parts of a key without the branch of a union, which people do not write."""
    return [part for part in path if part not in {"rotation", "translation"}]


def _hint(word: str, allowed: str) -> str:
    """Mention of the closest of the allowed words, which the message lists already."""
    hint = nearest(word, [choice.strip(" '") for choice in re.split(r",| or ", allowed)])
    return "" if hint.startswith("known") else f"; {hint}"


def _field_names(model: type[BaseModel], path: list[str]) -> list[str]:
    """Names that may stand at a place of a document, given the keys that lead there."""
    types: list[object] = [model]
    for part in path:
        found: list[object] = []
        for candidate in _models(types):
            fields = candidate.model_fields
            if part in fields:
                found.append(fields[part].annotation)
            elif "kind" in fields and fields["kind"].default == part:
                found.append(candidate)  # the branch of a union
        types = found or types
    return sorted({name for candidate in _models(types) for name in candidate.model_fields})


def _models(types: list[object]) -> list[type[BaseModel]]:
    """Pydantic models mentioned anywhere in some type annotations."""
    from pydantic import BaseModel

    found: list[type[BaseModel]] = []
    for item in types:
        if isinstance(item, type) and issubclass(item, BaseModel):
            found.append(item)
        else:
            found.extend(_models(list(get_args(item))))
    return found
