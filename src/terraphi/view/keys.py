"""The keys of the documents that people write: unit, default, what is allowed, and meaning.

All of it comes from the JSON schema that pydantic makes of the models that check the documents, so
that what is said here is what is accepted. A key's meaning is the docstring of its field.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import asdict, astuple, dataclass, replace
from typing import Any

from pydantic import BaseModel

from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import Plan
from terraphi.robot.logs.columns import Columns
from terraphi.robot.model import RobotFile
from terraphi.view import table as view

DOCUMENTS: dict[str, tuple[type[BaseModel], str]] = {
    "scenario": (Scenario, "terraphi simulate SCENARIO.toml"),
    "plan": (Plan, "terraphi library build PLAN.toml --out FILE.nc"),
    "robot": (RobotFile, "terraphi forces LOG --robot ROBOT.toml"),
    "columns": (Columns, "terraphi forces LOG.csv --columns COLUMNS.toml"),
}
"""Kind of document to its model, and to the command that reads it."""
REQUIRED = "required"
NOT_GIVEN = "not given"
_WORDS = {
    "boolean": "true or false",
    "integer": "whole number",
    "number": "number",
    "string": "text",
}
_LIMITS = {
    "minimum": "≥ {:g}",
    "exclusiveMinimum": "> {:g}",
    "maximum": "≤ {:g}",
    "exclusiveMaximum": "< {:g}",
}


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

    def shown(self) -> view.Table:
        """Its keys, a row each."""
        header = ("key", "unit", "default", "allowed", "meaning")
        rows = [astuple(key) for key in self.keys]
        return view.Table(f"{self.title}: {self.about}", header, rows)


def tables(document: str) -> list[Table]:
    """Tables of a kind of document, from the top down.

    Parameters
    ----------
    document
        One of :data:`DOCUMENTS`.

    Raises
    ------
    InputError
        If there is no such kind.
    """
    if document not in DOCUMENTS:
        raise InputError(f"unknown document '{document}'; {nearest(document, DOCUMENTS)}")
    schema = DOCUMENTS[document][0].model_json_schema()
    places: dict[str, list[str]] = {}
    for model, name in _walk(schema, "", "", schema.get("$defs", {})):
        places.setdefault(model, []).append(name)
    if document != "scenario":  # a plan's scenario has a page of its own
        places = {
            model: names
            for model, names in places.items()
            if not any(re.match(r"scenario\b", name) for name in names)
        }
    found = [
        _table(schema.get("$defs", {}).get(model, schema), names) for model, names in places.items()
    ]
    return [table for table in found if table.keys]


def as_dict(document: str) -> dict[str, Any]:
    """Tables of a kind of document, JSON-able."""
    return {
        "document": document,
        "tables": [asdict(table) | {"kind": table.kind or None} for table in tables(document)],
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
            (f"`{name}`", unit, _code(default), _cell(allowed), _cell(meaning))
            for name, unit, default, allowed, meaning in table.shown().rows
        ]
        parts.append(replace(table.shown(), rows=rows).markdown())
    return "\n\n".join(parts) + "\n"


# -- reading the schema --------------------------------------------------------------------------

Schema = dict[str, Any]
"""A JSON schema, or a part of one."""


def _walk(
    schema: Schema, model: str, place: str, models: dict[str, Schema]
) -> Iterator[tuple[str, str]]:
    """Every model that a document may hold, by its name in the schema, with its dotted place."""
    yield model, place
    for name, value in schema["properties"].items():
        inside = f"{place}.{name}" if place else name
        for inner, many in _models(value):
            yield from _walk(models[inner], inner, f"{inside}[]" if many else inside, models)


def _models(value: Schema) -> list[tuple[str, bool]]:
    """Models that a value is one of, and whether it is a list of them."""
    found = []
    for part in _parts(value):
        inner = part.get("items", part)
        name = inner.get("$ref", "").rpartition("/")[2]
        if name and name != "JsonValue":
            found.append((name, inner is not part))
    return found


def _parts(value: Schema) -> list[Schema]:
    """What a value may be, without null."""
    either = value.get("anyOf") or value.get("oneOf") or [value]
    return [part for part in either if part.get("type") != "null"]


def _table(schema: Schema, names: list[str]) -> Table:
    properties = schema["properties"]
    found = tuple(
        _key(name, value, required=name in schema.get("required", ()))
        for name, value in properties.items()
        if not _models(value)
    )
    about = " ".join(schema["description"].partition("\n\n")[0].split())
    kind = properties.get("kind")
    return Table(tuple(names), about, found, f'kind = "{kind["default"]}"' if kind else "")


def _key(name: str, value: Schema, *, required: bool) -> Key:
    meaning = " ".join(value.get("description", "").split())
    units = dict.fromkeys(re.findall(r"\[([^\]]+)\]", meaning))
    return Key(
        name=name,
        unit=", ".join(units),
        default=REQUIRED if required else _toml(value.get("default")),
        allowed=_allowed(_parts(value)[0]),
        meaning=_without_units(meaning),
    )


def _allowed(value: Schema) -> str:
    """The values that a schema allows, in words."""
    choices = value.get("enum", [value["const"]] if "const" in value else [])
    if choices:
        return ", ".join(_toml(choice) for choice in choices)
    if "additionalProperties" in value:
        return f"table of key to {_allowed(value['additionalProperties'])}"
    if "prefixItems" in value:
        inner = [_allowed(item) for item in value["prefixItems"]]
        same = len(set(inner)) == 1
        return f"list of {len(inner)}: {inner[0]}" if same else f"[{', '.join(inner)}]"
    if "items" in value:
        return f"list of {_allowed(value['items'])}"
    limits = [form.format(value[limit]) for limit, form in _LIMITS.items() if limit in value]
    return f"{_WORDS.get(value.get('type', ''), 'value')} {', '.join(limits)}".strip()


def _without_units(meaning: str) -> str:
    text = re.sub(r"\s*\[[^\]]+\]", "", meaning).replace("``None``", NOT_GIVEN)
    return text.replace("``", "`")


def _heading(name: str) -> str:
    """A table's name as TOML has it; an array of tables has two brackets."""
    if not name:
        return "Top of the file"
    return f"[[{name[:-2]}]]" if name.endswith("[]") else f"[{name.replace('[]', '')}]"


def _toml(value: Any) -> str:
    """A default as TOML has it."""
    if value is None:
        return NOT_GIVEN
    if isinstance(value, float):
        return re.sub(r"e([+-])0*", lambda found: "e" + found[1].strip("+"), f"{value:g}")
    return json.dumps(value, ensure_ascii=False)


def _code(default: str) -> str:
    return default if default in (REQUIRED, NOT_GIVEN) else f"`{default}`"


def _cell(text: str) -> str:
    quoted = re.sub(r'("[^"]*"|\[\[?[a-z][^\]]*\]\]?)', r"`\1`", text)
    return quoted.replace("|", "\\|").replace("<", "&lt;")
