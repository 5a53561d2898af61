"""Errors about what a person wrote, in one sentence each."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, get_args

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError


LONGEST = 400
"""Letters of a message."""
GUESSED = "Guessed "
"""Beginning of the sentence that names what was guessed of a table; it is no warning."""
NO_UNIT = "have no unit, and are taken as"
"""What a sentence on readings without a unit has, for it goes before other warnings."""


HIDDEN = re.compile(
    "[\x00-\x1f\x7f-\x9f\xad\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]"
)
"""Characters that are not seen: controls, line breaks, what turns the direction of writing, halves
of surrogate pairs."""


def visible(text: str) -> str:
    """A text whose hidden characters are escaped as ``ascii`` escapes them."""
    return HIDDEN.sub(lambda match: ascii(match[0])[1:-1], text)


def printable(text: str) -> str:
    """A text on one line, hidden characters escaped, its middle left out where it is too long."""
    shown = visible(" ".join(text.split()))
    return shown if len(shown) <= LONGEST else f"{shown[:180]} … {shown[183 - LONGEST :]}"


class InputError(ValueError):
    """An input is unusable; the message is one sentence that names the place and the remedy.

    The command line prints the message as it stands and exits with status 2.

    Examples
    --------
    >>> terraphi.convert(0.68, from_="newtn")
    Traceback (most recent call last):
    terraphi.experiment.errors.InputError: unknown simulator 'newtn'; did you mean 'newton'?
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(printable(sentence))


class SimulationError(RuntimeError):
    """A simulation broke down: a particle left the grid or a force is not a number."""


@contextmanager
def needing(what: str, packages: str, *, extra: str) -> Iterator[None]:
    """Raise InputError that names the extra to install if an import in the block fails.

    Such as ``"walk.mcap: reading MCAP needs mcap: pip install 'terraphi[robot]'"``.
    """
    try:
        yield
    except ImportError as error:
        raise InputError(f"{what} needs {packages}: pip install 'terraphi[{extra}]'") from error


def nearest(word: object, choices: Iterable[str]) -> str:
    """Hint at the choice closest to a misspelt word, or at all of them.

    Such as ``"did you mean 'yuma'?"`` or ``"known: a, b, c"``.
    """
    by_case = {choice.lower(): choice for choice in sorted(choices)}
    match = difflib.get_close_matches(str(word).lower(), by_case, n=1)
    if match:
        return f"did you mean '{by_case[match[0]]}'?"
    return "known: " + (", ".join(by_case.values()) or "none")


def sentence_from_validation(error: ValidationError, source: str, model: type[Any]) -> str:
    """Describe the first thing wrong in a document: file, dotted key, value and what is expected.

    Parameters
    ----------
    error
        What pydantic raised.
    source
        Name of the file.
    model
        The model that refused it, searched for the name nearest to an unknown key.
    """
    # A misspelt key comes first: it explains why the right one is missing.
    errors = error.errors()
    first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
    kind, loc, context = first["type"], first["loc"], first.get("ctx", {})
    # The branch of a union is part of the location, and not of what people write.
    unknown = loc[-1:] if kind == "extra_forbidden" else ()
    parts = [p for p in loc[: len(loc) - len(unknown)] if p not in ("rotation", "translation")]
    key = ".".join(map(str, [*parts, *unknown]))
    if kind == "extra_forbidden":
        return f"{source}: unknown key '{key}'; {nearest(str(loc[-1]), _keys_at(model, loc[:-1]))}"
    if kind == "missing":
        return f"{source}: key '{key}' is missing"
    message = first["msg"].removeprefix("Value error, ").removeprefix("Input ").rstrip(".")
    message = message.replace("an object", "a table").replace("a valid boolean", "true or false")
    if kind == "value_error":
        return f"{source}: {key and key + ': '}{message}"
    if kind == "list_type" and isinstance(first["input"], dict):
        return f"{source}: [{key}] is one table and there may be several: write [[{key}]]"
    value, expected = first["input"], context.get("expected", "")
    if kind == "union_tag_invalid":
        key, value, expected = f"{key}.kind", context["tag"], context["expected_tags"]
        message = f"should be {expected}"
    hint = nearest(str(value), expected.strip("'").replace("' or '", "', '").split("', '"))
    hint = f"; {hint}" if hint.startswith("did") else ""
    return f"{source}: {key} = {value!r:.60}: {message}{hint}"


def _keys_at(model: type[Any], path: tuple[Any, ...]) -> list[str]:
    """Keys that may stand at a place of a document, given the keys that lead there."""
    models = [model]
    for part in path:
        inside = [m.model_fields[part].annotation for m in models if part in m.model_fields]
        branch = [m for m in models if m.__name__.lower() == part]
        models = models_in(inside) or branch or models
    return [name for branch_model in models for name in branch_model.model_fields]


def models_in(types: Iterable[Any]) -> list[type[BaseModel]]:
    """Pydantic models that some type annotations mention."""
    from pydantic import BaseModel

    models: list[type[BaseModel]] = []
    for item in types:
        if isinstance(item, type) and issubclass(item, BaseModel):
            models.append(item)
        else:
            models += models_in(get_args(item))
    return models
