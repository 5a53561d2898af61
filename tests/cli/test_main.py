"""The command line as people use it, above all where they go wrong."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from terraphi_studies import STUDIES

from terraphi.cli.main import main
from terraphi.experiment.documents import shipped_file
from terraphi.experiment.measurements import measurement

Terraphi = Callable[..., Any]


def assert_refused(ran: tuple[int, str, str], *words: str) -> None:
    """One sentence on standard error that says what is wrong and where."""
    status, out, err = ran
    assert (status, out) == (2, "")
    assert "Traceback" not in err
    for word in words:
        assert word in err


@pytest.fixture
def forces(tmp_path) -> Path:
    path = tmp_path / "forces.csv"
    measurement("li2013:poppy_loose/straight").history.to_csv(path)
    return path


# -- what works ----------------------------------------------------------------------------------


def test_help_names_every_command(terraphi: Terraphi) -> None:
    ran = terraphi("--help")
    assert ran.status == 0
    for command in ("demo", "invert", "simulate", "library", "study", "report", "app"):
        assert command in ran.out


@pytest.mark.parametrize(
    "command", ["demo", "invert", "simulate", "study", "library build", "report"]
)
def test_help_of_every_command_has_an_example(command: str, terraphi: Terraphi) -> None:
    assert "Example: terraphi " + command in terraphi(*command.split(), "--help").out


def test_studies_are_listed_with_and_without_the_word(terraphi: Terraphi) -> None:
    ran = terraphi("study", "list")
    assert ran.status == 0
    assert ran == terraphi("study")
    assert terraphi("study", "list", "--json") == terraphi("study", "--json")
    listed = json.loads(terraphi("study", "--json").out)["studies"]
    assert listed.keys() == STUDIES.keys()
    for name, entry in listed.items():
        (line,) = [line for line in ran.out.splitlines() if line.split()[:1] == [name]]
        assert entry["what"] in line
        assert line.rstrip().endswith(entry["takes"])
        assert re.fullmatch(
            r"seconds|(half )?a minute|half an hour|\d+ (to \d+ )?minutes", entry["takes"]
        )
        assert name in terraphi("study", "--help").out


@pytest.mark.parametrize("option", [("--out", "x"), ("--only", "elements"), ("--quick",)])
def test_an_option_of_no_study_is_refused(option: tuple[str, ...], terraphi: Terraphi) -> None:
    ran = terraphi("study", *option)
    assert (ran.status, ran.out) == (2, "")
    assert f"{option[0]}: of which study?" in ran.err


def test_study_says_what_it_wrote(terraphi: Terraphi, tmp_path: Path) -> None:
    ran = terraphi("study", "k0", "--library", "quick-k0", "--out", str(tmp_path / "k0"))
    assert ran.out.splitlines()[-1] == f"Written: {tmp_path}/k0/data.json, k0.png"
    assert {path.name for path in (tmp_path / "k0").iterdir()} == {
        "data.json",
        "k0.png",
        "manifest.json",
    }


def test_invert_prints_the_answer_as_json(terraphi: Terraphi) -> None:
    ran = terraphi("invert", "li2013:poppy_loose/straight", "--library", "rft3d", "--json")
    answer = json.loads(ran.out)
    assert ran.status == 0
    assert answer["density_kg_m3"] == 638.0
    assert answer["density_assumed"] is False
    assert answer["library"] == "rft3d"
    assert answer["leg"] == "straight"


def test_invert_prints_convention_and_assumed_density(terraphi: Terraphi) -> None:
    ran = terraphi("invert", "li2013:yuma/c", "--library", "rft3d")
    assert "φ, rft3d [deg]" in ran.out
    assert "1650 kg/m³, assumed" in ran.out
    assert "leg c" in ran.out
    assert "Verdict: " in ran.out


def test_invert_writes_answer_posterior_and_figure(
    terraphi: Terraphi, forces: Path, tmp_path
) -> None:
    ran = terraphi("invert", str(forces), "--library", "rft3d", "--density", "638", "--out", "o")
    assert ran.status == 0
    assert {p.name for p in (tmp_path / "o").iterdir()} == {
        "answer.json",
        "posterior.nc",
        "figure.png",
        "manifest.json",
    }
    answer = json.loads((tmp_path / "o" / "answer.json").read_text())
    shipped = terraphi("invert", "li2013:poppy_loose/straight", "--library", "rft3d", "--json")
    same = json.loads(shipped.out)
    assert answer["phi_deg"]["median"] == pytest.approx(same["phi_deg"]["median"], abs=1e-3)


def test_simulate_then_invert(terraphi: Terraphi, tmp_path) -> None:
    scenario = '[soil]\nfriction_angle_deg = 33.0\n[leg]\nshape = "c"\nfriction = 0.4\n'
    (tmp_path / "s.toml").write_text('model = "rft"\ndimensions = 3\n' + scenario)
    ran = terraphi("simulate", "s.toml", "--out", "h.nc", "--json")
    assert json.loads(ran.out)["peak_Fz_N"] > 0
    answer = json.loads(terraphi("invert", "h.nc", "--library", "rft3d", "--json").out)
    assert answer["leg"] == "c"
    assert answer["phi_deg"]["median"] == pytest.approx(33.0, abs=0.2)
    assert answer["verdict"] == "consistent"


def test_library_list_and_show(terraphi: Terraphi) -> None:
    listed = json.loads(terraphi("library", "list", "--json").out)["libraries"]
    assert "rft3d" in [entry["name"] for entry in listed]
    usable, others = terraphi("library", "list").out.split("To test those with")
    row = r"^rft3d +3 +rft3d +15 to 50 +c, reversed_c, straight +45 "
    assert re.search(row, usable, re.MULTILINE)
    assert "quick-plane-strain-hip" in others
    assert "quick-plane-strain-hip" not in usable
    shown = json.loads(terraphi("library", "show", "rft3d", "--json").out)
    assert shown["cases"] == 45
    assert shown["provenance"]["model_version"] == "rft-1"


PLAN = """
name = "small"
[sweep]
"soil.friction_angle_deg" = [20.0, 30.0, 40.0]
[scenario]
model = "rft"
dimensions = 3
"""


def test_library_build_and_use(terraphi: Terraphi, tmp_path) -> None:
    (tmp_path / "p.toml").write_text(PLAN)
    ran = terraphi("library", "build", "p.toml", "--out", "l.nc", "--workers", "1", "--json")
    assert ran.status == 0, ran.err
    assert json.loads(ran.out)["cases"] == 3
    assert sorted(p.name for p in tmp_path.iterdir()) == ["l.nc", "p.toml"]
    ran = terraphi("invert", "li2013:poppy_loose/straight", "--library", "l.nc", "--json")
    assert json.loads(ran.out)["library"] == "small"


# -- what people get wrong -----------------------------------------------------------------------

HEADER = "theta_deg,Fx_N,Fz_N\n"


def rows(theta: np.ndarray, force: float = 1.0) -> str:
    return HEADER + "".join(f"{t:.3f},{force},{force * t}\n" for t in theta)


WHOLE = np.arange(-90.0, 91.0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", ("empty",)),
        (HEADER, ("no numbers",)),
        ("theta_deg,Fx_N\n1,2\n", ("line 1", "'Fz_N' is missing")),
        ("theta_deg,Fx_N,Fz\n1,2,3\n", ("line 1", "'Fz'", "did you mean 'Fz_N'")),
        ("theta_deg,Fx_N,Fz_N,time\n1,2,3,4\n", ("line 1", "unexpected column 'time'")),
        (HEADER + "1,2,three\n", ("line 2", "Fz_N = 'three'", "not a number")),
        (HEADER + "1,nan,3\n", ("line 2", "Fx_N", "not finite")),
        (HEADER + "1,inf,3\n", ("line 2", "Fx_N", "not finite")),
        (HEADER + "8,2,3\n7,2,3\n9,2,3\n", ("line 3", "increase")),
        (HEADER + "8,2,3\n8,2,3\n", ("line 3", "repeats")),
        (rows(WHOLE[::-1]), ("decreases",)),
        (rows(np.radians(WHOLE)), ("radians",)),
        (rows(np.linspace(-90, 90, 9)), ("at least 40",)),
        (rows(WHOLE, 0.0), ("zero at every angle",)),
        (rows(np.arange(-90.0, 1.0)), ("whole window",)),
        ("\x00\x01\x02", ()),
    ],
)
def test_unusable_forces(
    content: str, words: tuple[str, ...], terraphi: Terraphi, tmp_path
) -> None:
    (tmp_path / "bad.csv").write_text(content)
    ran = terraphi("invert", "bad.csv", "--library", "rft3d", "--out", "o")
    assert_refused(ran, "bad.csv", *words)
    assert [p.name for p in tmp_path.iterdir()] == ["bad.csv"]


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("invert", "no.csv"), ("no.csv", "no such file")),
        (("invert", "."), (".: is a folder; expected a CSV or NetCDF file of forces", "li2013:")),
        (("invert", "li2013:yma/straight"), ("did you mean 'li2013:yuma/straight'",)),
        (("invert", "li2013:yuma/c", "--library", "rft"), ("did you mean 'rft3d'",)),
        (("invert", "li2013:yuma/c", "--leg", "strait"), ("did you mean 'straight'",)),
        (
            ("invert", "li2013:yuma/c", "--library", "rft3d", "--leg", "plate"),
            ("measured on leg 'c'",),
        ),
        (("invert", "li2013:yuma/c", "--density", "-5"), ("not that of a soil",)),
        (("invert", "li2013:yuma/c", "--density", "heavy"), ("--density",)),
        (("invert", "li2013:yuma/c", "--sampler", "emce"), ("did you mean 'emcee'",)),
        (("invert", "li2013:yuma/c", "--librar", "x"), ("--library",)),
        (("simulate", "quik"), ("did you mean 'quick'",)),
        (("simulate", "no.toml"), ("no such file",)),
        (("library", "show", "rft3"), ("did you mean 'rft3d'",)),
        (("library", "show", "no.nc"), ("no such file",)),
        (("library", "build", "rft3", "--out", "x.nc"), ("did you mean 'rft3d'",)),
        (("study", "recovry"), ("did you mean 'recovery'",)),
    ],
)
def test_unusable_words(args: tuple[str, ...], words: tuple[str, ...], terraphi, tmp_path) -> None:
    assert_refused(terraphi(*args), *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        ("sol = 3", ("unknown key 'sol'", "did you mean 'soil'")),
        ("[soil]\npoison_ratio = 0.3", ("unknown key 'soil.poison_ratio'", "'poisson_ratio'")),
        ("[soil]\ndensity = -1650.0", ("soil.density = -1650", "greater than 0")),
        ("[soil]\nfriction_angle_deg = 0", ("soil.friction_angle_deg = 0",)),
        ("[soil]\nfriction_angle_deg = 90", ("soil.friction_angle_deg = 90", "less than 90")),
        ("[soil]\npoisson_ratio = 0.5", ("less than 0.5",)),
        ('[soil]\nyield_criterion = "planestrain"', ("did you mean 'plane_strain'",)),
        ('[leg]\nshape = "strait"', ("did you mean 'straight'",)),
        ("[numerics]\ntime_step = 1e-3", ("time_step = 0.001", "CFL limit of 1.65e-05 s")),
        ("[motion]\nhip = [0.05, 0.19]", ("leaves the domain",)),
        ("soil = = 1", ("not valid TOML", "line 1")),
        ("a = " + "[" * 5000 + "]" * 5000, ("nested hundreds deep",)),
        (".".join(["a"] * 3000) + " = 1", ("nested hundreds deep",)),
        (".".join(["a"] * 300) + " = 1", ("nested hundreds deep",)),
        ("a = 1" + "0" * 5000, ("not valid TOML", "4300 digits")),
        ("[motion]\nstop_deg = 1e308", ("motion.stop_deg = 1e+308 is out of all proportion",)),
        ("[motion]\nstop_deg = 1e13", ("motion.stop_deg = 1e+13", "of memory")),
        ("[motion]\nrate = 1e-300", ("motion.rate = 1e-300 is out of all proportion",)),
        ("[numerics]\ntime_step = 1e-14", ("numerics.time_step = 1e-14", "years")),
        ("[numerics]\nremap_interval = 1e308", ("numerics.remap_interval = 1e+308",)),
        ('model = "rft"\n[rft]\npanels = 10000000000000', ("rft.panels", "100000")),
    ],
)
def test_unusable_scenarios(toml: str, words: tuple[str, ...], terraphi, tmp_path) -> None:
    (tmp_path / "s.toml").write_text(toml)
    assert_refused(terraphi("simulate", "s.toml", "--out", "h.nc"), "s.toml", *words)
    assert [p.name for p in tmp_path.iterdir()] == ["s.toml"]


class OurMistakeError(Exception):
    """Nobody expects it."""


def test_an_error_of_ours_is_one_sentence_and_its_traceback_is_in_the_log(
    terraphi: Terraphi, monkeypatch: pytest.MonkeyPatch
) -> None:
    def mistaken(*_: object, **__: object) -> None:
        raise OurMistakeError("two\nlines")

    monkeypatch.setattr("terraphi.experiment.scenario.Scenario.load", mistaken)
    ran = terraphi("simulate", "quick")
    assert (ran.status, ran.out) == (1, "")
    assert ran.err == (
        "terraphi: an error of terraphi itself (OurMistakeError: two lines); please report it with "
        "the command that you ran and what it prints as 'terraphi -v ...'\n"
    )
    assert "in mistaken" in terraphi("simulate", "quick", "-v").err


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (MemoryError("Unable to allocate 9 TiB"), 2, "more memory than there is (Unable to alloc"),
        (ModuleNotFoundError("No module named 'h5netcdf'"), 1, "'h5netcdf'; install terraphi"),
    ],
)
def test_what_a_machine_lacks_is_one_sentence(
    error: Exception, status: int, words: str, terraphi: Terraphi, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lacking(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("terraphi.experiment.scenario.Scenario.load", lacking)
    ran = terraphi("simulate", "quick")
    assert (ran.status, ran.out) == (status, "")
    assert words in ran.err
    assert ran.err.count("\n") == 1


def test_documents_from_pipes_and_what_cannot_come_from_one(
    terraphi: Terraphi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = io.BytesIO(b'model = "rft"\ndimensions = 3\n')
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(scenario))
    assert json.loads(terraphi("simulate", "-", "--json").out)["samples"] == 2700
    os.mkfifo(tmp_path / "pipe")
    for words in (
        ("invert", "li2013:yuma/c", "--library", "pipe"),
        ("forces", "pipe"),
        ("report", "pipe", "--out", "r.html"),
    ):
        assert_refused(terraphi(*words), "pipe: a pipe", "save it to a file")


def test_library_files_that_are_not_whole(terraphi: Terraphi, tmp_path) -> None:
    whole = shipped_file("libraries", "rft3d", ".nc").read_bytes()
    (tmp_path / "half.nc").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.nc").write_text("not a NetCDF")
    for name in ("half.nc", "text.nc"):
        assert_refused(
            terraphi("invert", "li2013:yuma/straight", "--library", name), name, "not a whole"
        )


def test_nowhere_to_write(terraphi: Terraphi, tmp_path) -> None:
    (tmp_path / "taken").write_text("a file")
    ran = terraphi("invert", "li2013:yuma/c", "--library", "rft3d", "--out", "taken")
    assert_refused(ran, "taken", "folder")
    ran = terraphi("simulate", "quick", "--out", "taken/h.nc")
    assert_refused(ran, "taken")
    assert (tmp_path / "taken").read_text() == "a file"


SLOW_PLAN = """
name = "slow"
[sweep]
"soil.friction_angle_deg" = [20.0, 30.0, 40.0]
[scenario.numerics]
cells = 64
time_step = 16e-6
speed_up = 10.0
"""


@pytest.mark.parametrize("pauses", [(0.4,), (1.0,), (1.0, 0.1)], ids=["early", "once", "twice"])
def test_interrupted_build_leaves_one_sentence_and_no_process(
    pauses: tuple[float, ...], tmp_path
) -> None:
    (tmp_path / "p.toml").write_text(SLOW_PLAN)
    command = [sys.executable, "-m", "terraphi.cli", "library", "build", "p.toml", "--out", "l.nc"]
    started = subprocess.Popen(
        [*command, "--workers", "1", "--quiet"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    early = pauses[0] < 1.0  # Python itself is still starting, and says so in its own words
    for _ in range(0 if early else 1200):
        if (tmp_path / "l.nc.cases").is_dir():
            break
        time.sleep(0.05)
    for pause in pauses:
        time.sleep(pause)
        os.killpg(started.pid, signal.SIGINT)
    # Ends only when every process that holds the pipes has ended.
    out, err = started.communicate(timeout=120)
    if not early:
        assert_refused((started.returncode, out, err), "interrupted")
        assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / "l.nc").exists()
    kept = tmp_path / "l.nc.cases"
    assert not kept.exists() or any(kept.iterdir())


def test_workers_end_with_a_parent_that_is_killed(tmp_path) -> None:
    (tmp_path / "p.toml").write_text(SLOW_PLAN)
    command = [sys.executable, "-m", "terraphi.cli", "library", "build", "p.toml", "--out", "l.nc"]
    started = subprocess.Popen(
        [*command, "--workers", "1", "--checkpoint-every", "0"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    kept = tmp_path / "l.nc.cases"
    for _ in range(1200):  # until a worker is at work on a case
        if list(kept.glob("[0-9a-f]*.checkpoint")):
            break
        time.sleep(0.05)
    else:
        pytest.fail("no worker came to a checkpoint")
    started.kill()
    # The workers hold the pipe as long as they live: here, for a part of what a case takes.
    started.communicate(timeout=120)
    assert not list(kept.glob("*.nc"))


@pytest.mark.parametrize("words", [[], ["library"]])
def test_no_words_show_the_help(words: list[str], monkeypatch, capsys) -> None:
    monkeypatch.setattr(sys, "argv", ["terraphi", *words])
    main()
    out, err = capsys.readouterr()
    assert out.startswith("Usage: terraphi")
    assert "Example:" in out
    assert not err


WAITING_BUILD = """
import importlib, pathlib, time
from terraphi.library.plan import Plan
building = importlib.import_module("terraphi.library.build")
simulate = building.simulate
def waiting(*args, **options):
    while not pathlib.Path("go").exists():
        time.sleep(0.02)
    return simulate(*args, **options)
building.simulate = waiting
building.build(Plan.load("p.toml"), "l.nc")
"""


def test_a_second_build_is_refused_and_the_first_one_ends_well(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text(PLAN)
    started = {"cwd": tmp_path, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    first = subprocess.Popen([sys.executable, "-c", WAITING_BUILD], **started)
    kept = tmp_path / "l.nc.cases"
    try:
        while not kept.is_dir() and first.poll() is None:
            time.sleep(0.02)
        build = ("library", "build", "p.toml", "--out", "l.nc", "--workers", "1", "-q")
        second = subprocess.Popen([sys.executable, "-m", "terraphi.cli", *build], **started)
        said = second.communicate(timeout=120)
        assert_refused((second.returncode, *said), "another build is at work here; wait for it")
        assert list(kept.iterdir()) == []  # there, although nothing is in it yet
        (tmp_path / "go").touch()
        said = first.communicate(timeout=120)
    finally:
        first.kill()
    assert (first.returncode, said[0]) == (0, "")
    assert "refused" not in said[1]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["go", "l.nc", "p.toml"]
