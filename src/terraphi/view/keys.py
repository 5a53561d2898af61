"""The keys of the documents that people write: unit, default, what is allowed, and meaning.

All of it is read off the models that check the documents, and off their docstrings, so that what
is said here is what is accepted.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import Plan
from terraphi.robot.model import Quadruped
from terraphi.view import table as view

DOCUMENTS: dict[str, tuple[type[BaseModel], str]] = {
    "scenario": (Scenario, "terraphi simulate SCENARIO.toml"),
    "plan": (Plan, "terraphi library build PLAN.toml --out FILE.nc"),
    "robot": (Quadruped, "terraphi forces LOG --robot ROBOT.toml"),
}
"""Kind of document to its model, and to the command that reads it."""
REQUIRED = "required"
_WORDS: dict[type, str] = {
    bool: "true or false",
    int: "whole number",
    float: "number",
    str: "text",
}
_BOUNDS = (
    (annotated_types.Ge, "ge", "≥ {}"),
    (annotated_types.Gt, "gt", "> {}"),
    (annotated_types.Le, "le", "≤ {}"),
    (annotated_types.Lt, "lt", "< {}"),
)


@dataclass(frozen=True)
class Key:
    """A key that may stand in a document.

    Attributes
    ----------
    name
        Within its table.
    unit
        ``-`` if it has none; empty if it is no number, or counts something.
    default
        As TOML has it; ``required``, or ``not given``.
    allowed
        Choices, or the kind of value and its limits.
    meaning
        What it is.
    """

    name: str
    unit: str
    default: str
    allowed: str
    meaning: str


@dataclass(frozen=True)
class Table:
    """A table of a document.

    Attributes
    ----------
    names
        Dotted names of the tables that these keys may stand in; ``""`` for the top.
    about
        What the table describes.
    keys
        Its keys, without those that are tables themselves.
    kind
        Which of several such tables this is, as in ``kind = "rotation"``; empty if there is but
        one.
    """

    names: tuple[str, ...]
    about: str
    keys: tuple[Key, ...]
    kind: str = ""

    @property
    def title(self) -> str:
        """Names as they stand in a document."""
        return " with ".join(filter(None, [", ".join(map(_heading, self.names)), self.kind]))


def tables(document: str) -> list[Table]:
    """Tables of a kind of document, from the top down.

    Parameters
    ----------
    document
        One of :data:`DOCUMENTS`.

    Returns
    -------
    list of Table

    Raises
    ------
    InputError
        If there is no such kind.
    """
    if document not in DOCUMENTS:
        raise InputError(f"unknown document '{document}'; {nearest(document, DOCUMENTS)}")
    places: dict[type[BaseModel], list[str]] = {}
    for model, name in _walk(DOCUMENTS[document][0], ""):
        places.setdefault(model, []).append(name)
    if document != "scenario":  # a plan's scenario has a page of its own
        places = {
            model: names
            for model, names in places.items()
            if not any(re.match(r"scenario\b", name) for name in names)
        }
    found = [_table(model, names) for model, names in places.items()]
    return [table for table in found if table.keys]


def as_dict(document: str) -> dict[str, Any]:
    """Tables of a kind of document, JSON-able."""
    return {
        "document": document,
        "tables": [
            {
                "names": list(table.names),
                "kind": table.kind or None,
                "about": table.about,
                "keys": [asdict(key) for key in table.keys],
            }
            for table in tables(document)
        ],
    }


def markdown(document: str) -> str:
    """Tables of a kind of document as a page.

    Parameters
    ----------
    document
        One of :data:`DOCUMENTS`.

    Returns
    -------
    str
        Markdown, from the second level of headings down.
    """
    parts = []
    for table in tables(document):
        parts += [f"## {_cell(table.title)}", table.about]
        rows = [
            (
                f"`{key.name}`",
                key.unit,
                _code(key.default),
                _cell(key.allowed),
                _cell(key.meaning),
            )
            for key in table.keys
        ]
        header = ("key", "unit", "default", "allowed", "meaning")
        parts.append(view.Table("", header, rows).markdown())
    return "\n\n".join(parts) + "\n"


# -- reading models ------------------------------------------------------------------------------


def _walk(model: type[BaseModel], prefix: str) -> Iterator[tuple[type[BaseModel], str]]:
    """Every model that a document may hold, with the dotted name of its place."""
    yield model, prefix
    for name, field in model.model_fields.items():
        many = _is_list(field.annotation)
        for inner in _models(field.annotation):
            place = f"{prefix}.{name}" if prefix else name
            yield from _walk(inner, f"{place}[]" if many else place)


def _table(model: type[BaseModel], names: list[str]) -> Table:
    meanings = attributes(model)
    about, _, _ = (inspect.getdoc(model) or "").partition("\n\n")
    found = tuple(
        _key(name, field, meanings.get(name, ""))
        for name, field in model.model_fields.items()
        if not _models(field.annotation)
    )
    kind = model.model_fields.get("kind")
    return Table(tuple(names), about, found, f'kind = "{kind.default}"' if kind else "")


def _key(name: str, field: FieldInfo, meaning: str) -> Key:
    units = dict.fromkeys(re.findall(r"\[([^\]]+)\]", meaning))
    limits = [
        form.format(f"{getattr(bound, sign):g}")
        for kind, sign, form in _BOUNDS
        for bound in field.metadata
        if isinstance(bound, kind)
    ]
    allowed = " ".join([_kind(field.annotation), *limits[:1]])
    return Key(
        name=name,
        unit=", ".join(units),
        default=REQUIRED if field.is_required() else _toml(_default(field)),
        allowed=", ".join([allowed, *limits[1:]]),
        meaning=_without_units(meaning),
    )


def _default(field: FieldInfo) -> Any:
    return field.get_default(call_default_factory=True)


def _without_units(meaning: str) -> str:
    text = re.sub(r"\s*\[[^\]]+\]", "", meaning).replace("``None``", "not given")
    return text.replace("``", "`")


def _heading(name: str) -> str:
    """A table's name as TOML has it; an array of tables has two brackets."""
    if not name:
        return "Top of the file"
    return f"[[{name[:-2]}]]" if name.endswith("[]") else f"[{name.replace('[]', '')}]"


def attributes(model: type[BaseModel]) -> dict[str, str]:
    """What the docstring of a model says of each of its attributes.

    Parameters
    ----------
    model
        Documented as numpydoc has it.

    Returns
    -------
    dict
        Attribute to its description in one line, units included.
    """
    _, _, section = (inspect.getdoc(model) or "").partition("Attributes\n----------\n")
    found: dict[str, str] = {}
    names: list[str] = []
    for line in section.splitlines():
        if not line.strip():
            continue
        if not line.startswith(" "):
            names = [name.strip() for name in line.split(",")]
            continue
        for name in names:
            found[name] = f"{found.get(name, '')} {line.strip()}".strip()
    return found


def _parts(annotation: Any) -> list[Any]:
    """Members of a union, without ``None`` and without annotations."""
    if get_origin(annotation) is Annotated:
        return _parts(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [p for a in get_args(annotation) if a is not NoneType for p in _parts(a)]
    return [annotation]


def _is_list(annotation: Any) -> bool:
    return any(get_origin(part) in (list, tuple) for part in _parts(annotation))


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Models that a value of this type is, or is a list of."""
    found: list[type[BaseModel]] = []
    for part in _parts(annotation):
        if isinstance(part, type) and issubclass(part, BaseModel):
            found.append(part)
        elif get_origin(part) in (list, tuple):
            found += [m for inner in get_args(part) if inner is not ... for m in _models(inner)]
    return found


def _kind(annotation: Any) -> str:
    """The values that a type allows, in words."""
    (part, *more) = _parts(annotation)
    if get_origin(part) is Literal:
        return ", ".join(_toml(choice) for choice in get_args(part))
    inner = get_args(part)
    if get_origin(part) is dict:
        return f"table of key to {_kind(inner[1])}"
    if get_origin(part) in (list, tuple):
        if get_origin(part) is list or inner[-1] is ...:
            return f"list of {_kind(inner[0])}"
        if len({_kind(one) for one in inner}) == 1 and len(inner) > 1:
            return f"list of {len(inner)}: {_kind(inner[0])}"
        return f"[{', '.join(_kind(one) for one in inner)}]"
    if more:  # JSON's values, whatever their order
        return "value"
    return _WORDS.get(part, "value")


def _toml(value: Any) -> str:
    """A default as TOML has it."""
    if value is None:
        return "not given"
    if isinstance(value, float):
        return re.sub(r"e([+-])0*", lambda found: "e" + found[1].strip("+"), f"{value:g}")
    return json.dumps(value, ensure_ascii=False)


def _code(default: str) -> str:
    return default if default in (REQUIRED, "not given") else f"`{default}`"


def _cell(text: str) -> str:
    quoted = re.sub(r'("[^"]*"|\[\[?[a-z][^\]]*\]\]?)', r"`\1`", text)
    return quoted.replace("|", "\\|").replace("<", "&lt;")
