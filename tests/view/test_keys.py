"""The tables of keys, against the models that they are read off."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator

import pytest
from pydantic import ValidationError

from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import Scenario
from terraphi.view.keys import DOCUMENTS, Key, Table, markdown, tables

LIMITED = re.compile("[≥>≤<]")


def all_keys(document: str) -> Iterator[tuple[Table, Key]]:
    for table in tables(document):
        for key in table.keys:
            yield table, key


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_key_has_a_meaning(document: str) -> None:
    found = list(all_keys(document))
    assert found
    for table, key in found:
        assert len(key.meaning) > 2, f"{table.title} {key.name}: say what it is in the docstring"
        assert "None" not in key.meaning
        assert "``" not in key.meaning


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_number_has_a_unit_or_says_that_it_has_none(document: str) -> None:
    for table, key in all_keys(document):
        if re.match(r"number|list of \d: number", key.allowed):
            assert key.unit, f"{table.title} {key.name}: put its unit in brackets, or [-]"


def test_every_key_of_a_scenario_is_there() -> None:
    content = Scenario().model_dump()
    wanted = {name for name, value in content.items() if not isinstance(value, dict)}
    for section, value in content.items():
        if isinstance(value, dict):
            wanted |= {f"{section}.{name}" for name in value}
    found = {
        f"{name}.{key.name}" if name else key.name
        for table, key in all_keys("scenario")
        for name in table.names
        if "translation" not in table.kind
    }
    assert found == wanted
    assert {"start", "velocity", "distance"} <= {key.name for _, key in all_keys("scenario")}


def test_defaults_written_out_are_the_defaults() -> None:
    lines = []
    for table in tables("scenario"):
        if "translation" in table.kind:
            continue
        lines += [f"[{name}]" for name in table.names if name]
        lines += [f"{k.name} = {k.default}" for k in table.keys if k.default != "not given"]
    written = Scenario.model_validate(tomllib.loads("\n".join(lines)))
    rate = written.numerics.damping_rate
    assert rate == pytest.approx(Scenario().numerics.damping_rate, rel=1e-5)
    assert written.replace(**{"numerics.damping_rate": Scenario().numerics.damping_rate}).hash == (
        Scenario().hash
    )


@pytest.mark.parametrize(
    ("table", "name"),
    [
        (t, k)
        for t, k in all_keys("scenario")
        if re.search("[≥>≤<]", k.allowed) and t.names != ("",)
    ],
    ids=lambda value: value.name if isinstance(value, Key) else value.title,
)
def test_limits_are_those_that_are_checked(table: Table, name: Key) -> None:
    section = type(getattr(Scenario(), table.names[0]))
    for sign, limit in re.findall(r"([≥>≤<]) ([\d.e-]+)", name.allowed):
        step = 1 if name.allowed.startswith("whole") else 1e-6
        beyond = {"≥": -step, "≤": step, ">": 0, "<": 0}[sign]
        value = float(limit) + beyond
        with pytest.raises(ValidationError) as refused:
            section.model_validate({name.name: int(value) if step == 1 else value})
        assert refused.value.errors()[0]["loc"] == (name.name,)


def test_choices_are_those_that_are_accepted() -> None:
    (transfer,) = [k for _, k in all_keys("scenario") if k.name == "transfer"]
    for word in re.findall('"([a-z]+)"', transfer.allowed):
        Scenario().replace(**{"numerics.transfer": word})
    with pytest.raises(ValidationError):
        Scenario().replace(**{"numerics.transfer": "flip"})


def test_page_has_a_row_for_each_key() -> None:
    page = markdown("scenario")
    for _, key in all_keys("scenario"):
        assert f"| `{key.name}` |" in page
    assert '## `[motion]` with kind = `"translation"`' in page
    cells = {len(re.findall(r"(?<!\\)\|", line)) for line in page.splitlines() if line[:1] == "|"}
    assert cells == {6}


def test_plan_names_its_steps_as_toml_does() -> None:
    assert "## `[[steps]]`" in markdown("plan")


def test_unknown_document_names_the_nearest() -> None:
    with pytest.raises(InputError, match="scenario"):
        tables("scenery")


def test_command_prints_the_tables(terraphi) -> None:
    status, out, _ = terraphi("keys", "plan")
    assert status == 0
    assert "vary_seed" in out
    assert "[[steps]]" in out
