"""The keys of the TOML files that people write: unit, default, choices, meaning.

All of it comes from the JSON schema of the pydantic models that check these files; the meaning of a
key is the docstring of its field.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from importlib import import_module
from typing import Any, get_origin

from pydantic import BaseModel

from terraphi.experiment.errors import models_in
from terraphi.view.console import Table

DOCUMENTS = {
    "scenario": ("terraphi.experiment.scenario", "Scenario"),
    "plan": ("terraphi.laws.plan", "Plan"),
    "robot": ("terraphi.robot.model", "RobotFile"),
    "forces": ("terraphi.experiment.reading", "ForceColumns"),
    "tool": ("terraphi.experiment.pressed_reading", "PressColumns"),
    "wheel": ("terraphi.experiment.wheel_reading", "WheelColumns"),
    "columns": ("terraphi.robot.logs.columns", "Columns"),
}
"""Kind of document to the module and the name of its model."""
HEADER = ("key", "unit", "default", "allowed", "meaning")
_WORDS = {
    "boolean": "true or false", "integer": "whole number", "number": "number", "string": "text",
}  # fmt: skip
_LIMITS = {
    "minimum": "≥ {:g}", "exclusiveMinimum": "> {:g}", "maximum": "≤ {:g}",
    "exclusiveMaximum": "< {:g}",
}  # fmt: skip
Schema = dict[str, Any]


def tables(document: str) -> list[Table]:
    """A table of keys for each table of a document; KeyError if there is no such document.

    The scenario within a plan is left out: it has tables of its own.
    """
    module, name = DOCUMENTS[document]
    places: dict[type[BaseModel], list[str]] = {}
    for model, place in _walk(getattr(import_module(module), name), ""):
        if document == "scenario" or not re.match(r"scenario\b", place):
            places.setdefault(model, []).append(place)
    key_tables = []
    for model, names in places.items():
        schema = model.model_json_schema()
        keys = [
            _row(key, value, required=key in schema.get("required", ()))
            for key, value in schema["properties"].items()
            if not models_in([model.model_fields[key].annotation])
        ]
        kind = schema["properties"].get("kind")
        title = ", ".join(map(_heading, names))
        title += f' with kind = "{kind["default"]}"' if kind else ""
        about = " ".join(schema["description"].partition("\n\n")[0].split())
        if keys:
            key_tables.append(Table(f"{title}: {about}", HEADER, keys))
    return key_tables


def as_dict(document: str) -> dict[str, Any]:
    """Tables of a document, JSON-able."""
    listed = [
        {"table": table.title, "keys": [dict(zip(HEADER, row, strict=True)) for row in table.rows]}
        for table in tables(document)
    ]
    return {"document": document, "tables": listed}


def _walk(model: type[BaseModel], place: str) -> Iterator[tuple[type[BaseModel], str]]:
    """Every model that a document may hold, with its dotted place."""
    yield model, place
    for name, field in model.model_fields.items():
        many = "[]" * (get_origin(field.annotation) in (list, tuple))
        for inner in models_in([field.annotation]):
            yield from _walk(inner, f"{place}.{name}{many}".lstrip("."))


def _row(name: str, value: Schema, *, required: bool) -> tuple[str, ...]:
    meaning = " ".join(value.get("description", "").split())
    units = dict.fromkeys(re.findall(r"\[([^\]]+)\]", meaning))
    plain = re.sub(r"\s*\[[^\]]+\]", "", meaning).replace("``None``", "not given")
    default = "required" if required else _toml(value.get("default"))
    either = value.get("anyOf") or [value]
    kind = next(part for part in either if part.get("type") != "null")
    return name, ", ".join(units), default, _allowed(kind), plain.replace("``", "`")


def _allowed(value: Schema) -> str:
    """The values that a schema allows, in words."""
    choices = value.get("enum", [value["const"]] if "const" in value else [])
    if choices:
        return ", ".join(map(_toml, choices))
    if "additionalProperties" in value:
        return f"table of key to {_allowed(value['additionalProperties'])}"
    if "prefixItems" in value:
        inner = list(dict.fromkeys(map(_allowed, value["prefixItems"])))
        return f"list of {len(value['prefixItems'])}: {', '.join(inner)}"
    if "items" in value:
        return f"list of {_allowed(value['items'])}"
    limits = [form.format(value[limit]) for limit, form in _LIMITS.items() if limit in value]
    return f"{_WORDS.get(value.get('type', ''), 'value')} {', '.join(limits)}".strip()


def _heading(name: str) -> str:
    """A table's name as TOML has it; an array of tables has two brackets."""
    if not name:
        return "top of the file"
    return f"[[{name[:-2]}]]" if name.endswith("[]") else f"[{name.replace('[]', '')}]"


def _toml(value: Any) -> str:
    """A default as TOML has it."""
    if value is None:
        return "not given"
    if isinstance(value, float):
        return re.sub(r"e([+-])0*", lambda match: "e" + match[1].strip("+"), f"{value:g}")
    return json.dumps(value, ensure_ascii=False)
