"""Shipped cases come out again to the last bit, or it is said what is different here."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from terraphi.experiment.errors import InputError
from terraphi.forward import rests_on, simulate
from terraphi.library.plan import Plan
from terraphi.library.reproduction import account, differences, rebuild
from terraphi.library.store import Case, Library


def small() -> Library:
    scenario = {"model": "rft", "dimensions": 3, "rft": {"panels": 10}}
    sweep = {"soil.friction_angle_deg": [20.0, 30.0]}
    plan = Plan.model_validate({"name": "small", "scenario": scenario, "sweep": sweep})
    return Library(plan, tuple(Case(s, simulate(s), "") for s in plan.cases()))


def changed(library: Library, **provenance: Any) -> Library:
    """With other words in the provenance of the first case; ``None`` drops one."""
    case = library.cases[0]
    assert case.history is not None
    known = {**case.history.provenance, **provenance}
    known = {name: value for name, value in known.items() if value is not None}
    first = case._replace(history=replace(case.history, provenance=known))
    return replace(library, cases=(first, *library.cases[1:]))


@pytest.mark.parametrize(
    "name", ["rft3d", pytest.param("quick-k0-half", marks=pytest.mark.slow)], ids=str
)
def test_a_shipped_case_comes_out_again(name: str) -> None:
    """To rounding anywhere, and to the last bit of another run on this machine."""
    shipped = Library.load(name)
    again = rebuild(shipped, 1)
    assert again.largest_change < 1e-9, again.sentence
    case = shipped.cases[0]
    here = replace(shipped, cases=(case._replace(history=simulate(case.scenario)),))
    once_more = rebuild(here, 1)
    assert once_more.same_bits, once_more.sentence
    assert once_more.sentence.endswith("the same to the last bit.")


@pytest.mark.parametrize("name", ["rft3d", "quick-k0-half", "quick-k0-jaky"])
def test_shipped_libraries_record_what_their_bits_rest_on(name: str) -> None:
    library = Library.load(name)
    found = account(library)
    json.dumps(found, allow_nan=False)
    assert len(found["cases"]) == len(library.cases)
    assert all(len(digest) == 64 for digest in found["cases"].values())
    for case in library.cases:
        assert case.history is not None
        # What was made before NumPy's instructions were recorded lacks them.
        assert (
            case.history.provenance["rests_on"].keys() | {"numpy_instructions"}
            >= rests_on(case.scenario).keys()
        )
    assert [s.hash for s in Plan.load(name).cases()] == [c.scenario.hash for c in library.cases]
    if found["expected"]:
        assert (
            f"'terraphi library build {name} --out FILE.nc' gives the same forces"
            in (found["sentence"])
        )


def test_a_long_case_says_so_before_it_is_checked() -> None:
    quick = small()
    assert "simulates a case again and compares" in account(quick)["sentence"]
    long = []
    for number, case in enumerate(quick.cases, start=1):
        assert case.history is not None
        lasted = {"all": 1800.0 * number}
        seconds = {"provenance": {**case.history.provenance, "seconds": lasted}}
        long.append(case._replace(history=replace(case.history, **seconds)))
    found = account(replace(quick, cases=tuple(long)))
    assert (
        f"again (they took 30 to {30 * len(long)} minutes there) and compares" in found["sentence"]
    )


def test_what_is_the_same_here_is_expected_again() -> None:
    library = small()
    found = account(library)
    assert found["expected"]
    assert found["sentence"].startswith("its plan gives the same forces to the last bit here")
    again = rebuild(library, 2)
    assert (again.same_bits, again.largest_change, again.differences) == (True, 0.0, ())
    assert again.case == "case 2 (soil.friction_angle_deg = 30.0)"


def test_what_is_different_here_is_named() -> None:
    library = small()
    assert library.cases[0].history is not None
    before = dict(library.cases[0].history.provenance["rests_on"])
    old = changed(library, rests_on={**before, "numpy": "1.0"}, model_version="rft-0")
    assert differences(old.cases[0])[0] == "model: rft-0 there, rft-1 here"
    assert differences(old.cases[0])[1].startswith("numpy: 1.0 there, ")
    found = account(old)
    assert not found["expected"]
    assert (
        "forces may come out otherwise in their last digits here (model: rft-0 there"
        in found["sentence"]
    )


def test_a_library_without_a_record_says_so() -> None:
    found = account(changed(small(), rests_on=None))
    assert not found["expected"]
    assert "before libraries recorded" in found["sentence"]


def test_other_forces_are_seen() -> None:
    library = small()
    case = library.cases[0]
    assert case.history is not None
    force = case.history.force.copy()
    force[1000, 0] += 1e-3 * abs(force).max()
    first = case._replace(history=replace(case.history, force=force))
    again = rebuild(replace(library, cases=(first, *library.cases[1:])), 1)
    assert not again.same_bits
    assert again.largest_change == pytest.approx(1e-3, rel=1e-3)
    assert "forces differ by up to 1.0e-03 of the largest (and nothing that" in again.sentence


@pytest.mark.parametrize("number", [0, 3])
def test_no_such_case(number: int) -> None:
    with pytest.raises(InputError, match=rf"has the cases 1 to 2, not {number}"):
        rebuild(small(), number)


def test_a_case_that_failed_is_not_made_again() -> None:
    library = small()
    failed = Case(library.cases[0].scenario, None, "blew up")
    assert failed.digest == ""
    broken = replace(library, cases=(failed, library.cases[1]))
    with pytest.raises(InputError, match="failed: blew up"):
        rebuild(broken, 1)
    assert account(broken)["expected"]


def test_forces_that_were_damaged_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "x.nc"
    with monkeypatch.context() as patch:
        patch.setattr(Case, "digest", "0" * 64)
        small().save(file)
    with pytest.raises(InputError, match="the forces of case 1 are not those that were written"):
        Library.load(file)


def test_show_says_it(tmp_path: Path, terraphi: Callable[..., Any]) -> None:
    file = tmp_path / "small.nc"
    small().save(file)

    def show(*options: str) -> str:
        status, out, _ = terraphi("library", "show", str(file), *options)
        assert status == 0
        return str(out)

    printed = show("--check", "--case", "2")
    assert "computed with" in printed
    assert "Simulated again: its plan gives the same forces to the last bit here; 'ter" in printed
    assert printed.endswith("30.0): simulated again, the same to the last bit.\n")
    told = json.loads(show("--check", "--json"))["bits"]
    assert told["checked"]["same_bits"] is True
    assert len(told["cases"]) == 2
    assert "checked" not in json.loads(show("--json"))["bits"]


def test_the_command_that_checks_names_what_was_shown(tmp_path: Path, terraphi: Any) -> None:
    """Not the plan's name, which another file may have as well."""
    for name in ("own.nc", "my own.nc"):
        small().save(tmp_path / name)
        _, out, _ = terraphi("library", "show", name)
        quoted = f"'{name}'" if " " in name else name
        assert f"'terraphi library show {quoted} --check' simulates" in out
    assert "'terraphi library show rft3d --check'" in terraphi("library", "show", "rft3d").out


def test_a_case_is_named_only_to_be_checked(tmp_path: Path, terraphi: Any) -> None:
    small().save(tmp_path / "own.nc")
    status, out, err = terraphi("library", "show", "own.nc", "--case", "2")
    assert (status, out) == (2, "")
    assert err == "terraphi: --case 2 says which case to simulate again; give --check as well\n"
