"""Checks, tasks that resume, and the document, on families made up for the purpose."""

from __future__ import annotations

import json
import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from click.testing import CliRunner

from terraphi.cli.main import cli
from terraphi.experiment.errors import InputError
from terraphi_studies import verification
from terraphi_studies.verification import running
from terraphi_studies.verification.check import Check, Family, Outcome, Task
from terraphi_studies.verification.document import data_of, markdown, number, short_table
from terraphi_studies.verification.running import forget, run_tasks


def check_of(expected: float = 2.0, obtained: float = 2.1, **changes) -> Check:
    fields = {
        "problem": "Column",
        "case": "smooth",
        "quantity": "K",
        "expected": expected,
        "obtained": obtained,
        "tolerance": 0.06,
    }
    return Check(**{**fields, **changes})


@pytest.mark.parametrize(
    ("obtained", "sense", "passed"),
    [
        (2.1, "equal", True),
        (1.9, "equal", True),
        (2.2, "equal", False),
        (1.8, "equal", False),
        (1.0, "at_most", True),
        (2.2, "at_most", False),
        (9.0, "at_least", True),
        (1.8, "at_least", False),
        (math.nan, "equal", False),
        (math.nan, "at_most", False),
        (math.inf, "at_least", False),
    ],
)
def test_verdict(obtained: float, sense, passed: bool) -> None:
    assert check_of(obtained=obtained, sense=sense).passed is passed


def test_deviation_is_relative_to_the_magnitude_or_absolute() -> None:
    assert check_of(-2.0, -2.1).deviation == pytest.approx(-0.05)
    assert check_of(-2.0, -2.1, relative=False).deviation == pytest.approx(-0.1)
    assert check_of(0.0, 0.01, relative=False).passed


@pytest.mark.parametrize("obtained", [2.1, math.nan])
def test_check_survives_json(obtained: float) -> None:
    check = check_of(obtained=obtained, source="a formula", note="n", cause="c", sense="at_most")
    again = Check.from_dict(json.loads(json.dumps(check.as_dict(), allow_nan=False)))
    assert again.as_dict() == check.as_dict()
    assert again.passed == check.passed


# -- tasks ---------------------------------------------------------------------------------------

done: list[int] = []


def task_of(number: int) -> Outcome:
    """A task that tells that it was done."""
    done.append(number)
    if number < 0:
        raise ValueError("no such column")
    return Outcome([check_of(obtained=float(number))], {"number": number})


def tasks_of(*numbers: int) -> dict[tuple[str, str], Task]:
    return {("made_up", f"task-{n}"): Task(f"task-{n}", task_of, {"number": n}) for n in numbers}


@pytest.fixture(autouse=True)
def _nothing_done() -> None:
    done.clear()


def test_outcomes_come_in_the_order_of_the_tasks() -> None:
    with ThreadPoolExecutor(3) as pool:
        found = run_tasks(tasks_of(3, 1, 2), executor=pool)
    assert [outcome.curves["number"] for outcome in found.values()] == [3, 1, 2]


@pytest.mark.parametrize("pooled", [False, True])
def test_interrupted_run_goes_on_where_it_stopped(tmp_path: Path, pooled: bool) -> None:
    with ThreadPoolExecutor(1) as pool:
        executor = pool if pooled else None
        with pytest.raises(ValueError, match="no such column"):
            run_tasks(tasks_of(1, 2, -1), keep=tmp_path, executor=executor)
        assert sorted(done) == [-1, 1, 2]
        done.clear()
        told: list[tuple[float, float]] = []
        found = run_tasks(
            tasks_of(1, 2, 3),
            keep=tmp_path,
            executor=executor,
            progress=lambda ready, total: told.append((ready, total)),
        )
    assert done == [3]
    assert found[("made_up", "task-1")] == task_of(1)
    assert told[0] == (2.0, 3.0)
    assert told[-1] == (3.0, 3.0)


def test_other_arguments_or_other_code_are_another_task(tmp_path: Path, monkeypatch) -> None:
    run_tasks(tasks_of(1), keep=tmp_path)
    same_name = {("made_up", "task-1"): Task("task-1", task_of, {"number": 5})}
    assert run_tasks(same_name, keep=tmp_path)[("made_up", "task-1")].curves == {"number": 5}
    monkeypatch.setattr(running, "_code_digest", lambda: "another")
    run_tasks(tasks_of(1), keep=tmp_path)
    assert done == [1, 5, 1]


def test_sources_of_numbers_and_no_others_are_watched() -> None:
    watched = {
        file.relative_to(running._PACKAGE).as_posix()
        for pattern in running._SOURCES
        for file in running._PACKAGE.glob(pattern)
    }
    room = "terraphi_studies/verification"
    forward = {"terraphi/forward/plane/contact.py", "terraphi/forward/mpm/lanes.py"}
    plan = {"terraphi/library/plan.py", "terraphi/data/plans/sand3d.toml"}
    known = {"terraphi/experiment/soil.py", *forward, *plan, f"{room}/waves.py"}
    assert known <= watched
    assert all((running._PACKAGE / name).is_file() for name in watched)
    assert "terraphi/cli/main.py" not in watched


def test_broken_file_is_computed_again(tmp_path: Path) -> None:
    run_tasks(tasks_of(1), keep=tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_text('{"checks": [')
    run_tasks(tasks_of(1), keep=tmp_path)
    run_tasks(tasks_of(1), keep=tmp_path)
    assert done == [1, 1]


def test_what_is_forgotten_is_gone_and_what_is_not_stays(tmp_path: Path) -> None:
    keep = tmp_path / "kept"
    run_tasks(tasks_of(1, 2), keep=keep)
    forget(tasks_of(1), keep)
    assert len(list(keep.iterdir())) == 1
    forget(tasks_of(2), keep)
    assert not keep.exists()


# -- the document --------------------------------------------------------------------------------


def made_up(*checks: Check) -> Family:
    return Family("Columns", "What they mean.", [Task("all", lambda: checks)], [])


def written(*checks: Check) -> str:
    families = {"columns": made_up(*checks)}
    data = data_of({"columns": {"all": Outcome(checks)}}, quick=False)
    return markdown(families, data, {"columns": ["columns-1"]})


def test_document_has_verdict_cause_and_source() -> None:
    text = written(
        check_of(source="Rankine", note="loose"),
        check_of(case="rough", obtained=3.0, source="Rankine", cause="too coarse a grid"),
        check_of(case="rough|er", obtained=math.nan, source="Rankine"),
    )
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert "| **Column** [1]<br>smooth [2] | K | 2 | 2.1 | +5 % | ±6 % |  | pass |" in rows
    assert "| rough | K | 2 | 3 | +50 % | ±6 % |  | **MISS** [3] |" in rows
    assert "| rough\\|er | K | 2 | none | none | ±6 % |  | **MISS** |" in rows
    assert "1. Rankine.\n2. loose.\n3. too coarse a grid." in text
    assert "**1 checks pass, 2 miss.**" in text
    assert "| `columns` | Columns | 1 | 2 |" in rows
    assert "What they mean." in text
    assert "![columns-1](columns-1.png)" in text
    assert "terraphi study verification --only columns --out DIR" in text


def test_misses_are_listed_by_cause() -> None:
    text = written(
        check_of(obtained=3.0, cause="too coarse a grid"),
        check_of(case="rough", obtained=4.0, cause="too coarse a grid"),
        check_of(case="third", obtained=5.0),
    )
    _, listed = text.split("## What misses, and why")
    assert listed.split("##")[0].split("\n\n")[1] == (
        "- Cause: too coarse a grid.\n"
        "  - Column, smooth: K (3, not 2)\n"
        "  - Column, rough: K (4, not 2)\n"
        "- Cause: not known.\n"
        "  - Column, third: K (5, not 2)"
    )
    assert "What misses" not in written(check_of())


def test_cause_is_silent_while_a_check_passes() -> None:
    assert "too coarse" not in written(check_of(cause="too coarse a grid"))


def test_quantities_with_sources_of_their_own_name_them() -> None:
    text = written(
        check_of(source="Jaky"), check_of(quantity="N_q", source="Prandtl"), check_of(problem="B")
    )
    assert "| **Column**<br>smooth | K [1] |" in text
    assert "| smooth | N_q [2] |" in text
    assert "| **B**<br>smooth | K |" in text


def test_checks_of_a_problem_stand_together() -> None:
    text = written(check_of(), check_of(problem="Wall"), check_of(case="third"))
    assert text.index("third") < text.index("**Wall**")


def test_settings_stand_side_by_side_and_the_presets_first() -> None:
    text = written(
        check_of(settings="nodes", source="Rankine", resolution="20 cells"),
        check_of(obtained=3.0, settings="preset", cause="stiff", resolution="20 cells"),
        check_of(case="rough", settings="nodes", note="loose", resolution="20 cells"),
        check_of(case="rough", settings="preset", resolution="40 cells", per_degree=0.05),
    )
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert "| problem | quantity | resolution | expected | allowed | preset | nodes |" in rows
    first = "| **Column**<br>smooth | K [1] | 20 cells | 2 | ±6 % | **MISS** +50 % [2] | +5 % |"
    assert first in rows
    assert "| rough | K | 20 cells | 2 | ±6 % |  | +5 % [3] |" in rows
    assert "| rough | K | 40 cells | 2 | ±6 % | +5 %, +1.0° |  |" in rows
    assert "1. Rankine.\n2. stiff.\n3. loose." in text
    assert "  - Column, smooth, settings: preset, 20 cells: K (3, not 2)" in text


@pytest.mark.parametrize(("obtained", "text"), [(4.06, "+103 %"), (3.98, "+99 %"), (2.0, "0 ")])
def test_deviations_beyond_all_are_no_powers_of_ten(obtained: float, text: str) -> None:
    assert f"| {text}" in written(check_of(obtained=obtained))


def test_rows_for_machines_are_those_of_all_families() -> None:
    checks = [check_of(settings="preset"), check_of(obtained=1.0, relative=False)]
    data = data_of({"columns": {"all": Outcome(checks)}}, quick=True)
    first, second = data["rows"]
    assert first["family"] == "columns"
    assert first["problem"] == "Column"
    assert first["settings"] == "preset"
    assert first["deviation_percent"] == pytest.approx(5.0)
    assert first["passed"] is True
    assert second["deviation_percent"] is None
    assert second["deviation"] == pytest.approx(-1.0)


def test_table_for_a_terminal() -> None:
    checks = [check_of(), check_of(obtained=1e-9, relative=False)]
    data = data_of({"columns": {"all": Outcome(checks)}}, quick=True)
    assert data["tier"] == "quick"
    assert short_table(data).rows == [
        ("Column: smooth", "K", "2", "2.1", "+5 %", "pass"),
        ("Column: smooth", "K", "2", "1.000e-09", "-2", "MISS"),
    ]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (0.57358, "0.5736"),
        (2305.7, "2306"),
        (1.25e-13, "1.250e-13"),
        (3e5, "3.000e+05"),
    ],
)
def test_numbers_for_people(value: float, text: str) -> None:
    assert number(value) == text


# -- the study -----------------------------------------------------------------------------------


def test_unknown_family_names_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'elements'"):
        verification.run(only="element", quick=True)


@pytest.mark.parametrize("name", verification.FAMILIES)
@pytest.mark.parametrize("quick", [False, True])
def test_tasks_can_travel(name: str, quick: bool) -> None:
    """Unlike names, arguments that are JSON, functions that another process finds."""
    family = verification.family_of(name)
    tasks = family.quick if quick else family.full
    assert len({task.name for task in tasks}) == len(tasks)
    for task in tasks:
        json.dumps(dict(task.arguments), allow_nan=False)
        assert "<locals>" not in task.function.__qualname__


def test_interruption_says_what_is_kept(tmp_path: Path, monkeypatch) -> None:
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(verification, "run_tasks", interrupted)
    with pytest.raises(InputError, match="goes on from there"):
        verification.run(only="elements", quick=True, out=tmp_path)
    with pytest.raises(KeyboardInterrupt):
        verification.run(only="elements", quick=True)


# -- the command ---------------------------------------------------------------------------------


def command(*args: str):
    """What `terraphi study` does with some arguments."""
    return CliRunner().invoke(cli, ["study", *args])


def test_command_writes_page_and_data(tmp_path: Path, monkeypatch) -> None:
    family = Family("Columns", "", [], list(tasks_of(2, 5).values()))
    monkeypatch.setattr(verification, "family_of", lambda name: family)
    out = tmp_path / "found"
    ran = command("verification", "--only", "waves", "--quick", "--out", str(out))
    assert ran.exit_code == 0, ran.output
    assert "1 checks pass, 1 miss" in ran.output
    assert done == [2, 5]
    made = {file.name for file in out.iterdir()}
    assert made == {"data.json", "verification.md", "manifest.json"}
    printed = command("verification", "--only", "waves", "--quick", "--json")
    assert json.loads(printed.output) == json.loads((out / "data.json").read_text())


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("verification", "--only", "slidin"), "did you mean 'sliding'"),
        (("verification", "--library", "quick-paper"), "has no option 'library'"),
        (("recovery", "--only", "rest"), "study 'recovery' has no option 'only'"),
        (("benchmark", "--quick"), "study 'benchmark' has no option 'quick'"),
    ],
)
def test_options_that_a_study_does_not_have(args: tuple[str, ...], words: str) -> None:
    ran = command(*args)
    assert isinstance(ran.exception, InputError)
    assert words in str(ran.exception)
