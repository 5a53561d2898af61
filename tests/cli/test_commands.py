"""The commands: their help, their results, and what they refuse."""

from __future__ import annotations

import csv
import inspect
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd
import pytest

import terraphi as package
from terraphi.cli import options
from terraphi.cli.main import cli
from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError
from terraphi.experiment.measurements import names
from terraphi.inference import calibration
from terraphi.inference.calibration import Calibration, CalibrationSoil
from terraphi.inference.footfalls import FootfallMap
from terraphi.inference.manifest import read_manifest
from terraphi.laws.foot import LAWS

Terraphi = Callable[..., Any]
QUICK = ("--law", "rft3d")
MEASURED = "li2013:poppy_loose/straight"
PLAN = """
name = "small"
[sweep]
"soil.friction_angle_deg" = [20.0, 30.0, 40.0]
[scenario]
model = "rft"
dimensions = 3
"""


def commands(command: click.Command = cli, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    yield path
    if isinstance(command, click.Group):
        for name, inner in command.commands.items():
            yield from commands(inner, (*path, name))


# -- help ----------------------------------------------------------------------------------------


def test_every_help_has_an_example(terraphi: Terraphi) -> None:
    for path in commands():
        status, out, _ = terraphi(*path, "--help")
        assert status == 0
        assert " ".join(["Example: terraphi", *path]) in " ".join(out.split())


def test_help_loads_neither_numpy_nor_pydantic() -> None:
    code = (
        "import sys; from terraphi.cli.main import cli; "
        "cli.main(['invert', '--help'], standalone_mode=False); "
        "print([m for m in ('numpy', 'scipy', 'pydantic', 'numba') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_choices_are_those_of_the_modules() -> None:
    assert tuple(LAWS) == options.LAWS


def test_defaults_of_options_are_those_of_python() -> None:
    """Each option that a function has as well; those without a value leave it to the function."""
    compared = 0
    for name, command in cli.commands.items():
        function = getattr(package, {"forces": "foot_forces"}.get(name, name), None)
        if not callable(function):
            continue
        parameters = inspect.signature(function).parameters
        given = command.make_context(name, [], resilient_parsing=True).params
        for option in command.params:
            value, own = given.get(option.name or ""), parameters.get(option.name or "")
            if own is not None and value not in (None, False, ()):
                assert value == own.default, (name, option.name)
                compared += 1
    assert compared > 10


# -- ends -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [KeyError("a"), OSError(28, "no space"), TypeError("two\nlines")])
def test_any_error_is_one_sentence_and_its_stack_is_there_if_wanted(
    error: Exception, terraphi: Terraphi, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr(cli.commands["doctor"], "callback", fail)
    status, out, err = terraphi("doctor")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("terraphi: ")
    status, _, err = terraphi("-v", "doctor")
    assert status == 2
    assert "Traceback" in err


@pytest.mark.parametrize(
    "line", ["keys | head -c 1", "keys > /dev/full", "keys >&- 2>&- <&-", "invert - <&-"]
)
def test_closed_and_full_streams_end_without_a_stack(line: str) -> None:
    command = f"{sys.executable} -m terraphi {line}"
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert len(done.stderr.splitlines()) <= 1
    assert done.stderr[:10] in ("", "terraphi: ")


# -- answers -------------------------------------------------------------------------------------


def test_invert_prints_the_answer_of_python(terraphi: Terraphi) -> None:
    answer = json.loads(terraphi("invert", MEASURED, *QUICK, "--json").out)
    same = package.invert(MEASURED, law="rft3d")
    assert answer["phi_deg"]["median"] == pytest.approx(same.phi.median, abs=1e-9)
    assert (answer["density_kg_m3"], answer["density_assumed"]) == (638.0, False)
    assert (answer["law"], answer["rig"]["leg"]) == ("rft3d", "straight")


def test_invert_prints_angle_and_verdict_within_ten_lines(terraphi: Terraphi) -> None:
    ran = terraphi("invert", *names()[:4])
    first, phi, verdict, *rest = ran.out.splitlines()
    assert ran.status == 0
    assert first.startswith("4 records")
    assert first.endswith("law legs")
    assert phi.startswith("φ = ")
    assert "plane strain" in phi
    assert verdict.split(":")[0] in ("Consistent", "Misfit", "Out of range")
    assert len(rest) <= 7
    assert "model: soil" in terraphi("invert", "li2013:yuma/c", "-v").out


def test_invert_out_writes_what_python_reads(terraphi: Terraphi, tmp_path: Path) -> None:
    assert terraphi("invert", MEASURED, *QUICK, "--out", "o").status == 0
    result = {path.name for path in (tmp_path / "o").iterdir()}
    assert {"answer.json", "answer.nc", "answer.png"} <= result
    answer = json.loads((tmp_path / "o" / "answer.json").read_text())
    read = package.Answer.load(tmp_path / "o")
    assert read.phi.median == pytest.approx(answer["phi_deg"]["median"])


def test_table_has_a_row_for_each_record_and_the_reason_of_a_failure(
    terraphi: Terraphi, tmp_path: Path
) -> None:
    (tmp_path / "bad.csv").write_text("theta_deg,Fx_N,Fz_N\n1,2,three\n")
    arguments = ("invert", MEASURED, "bad.csv", *QUICK, "--table", "t.csv")
    ran = terraphi(*arguments, "--json")
    assert ran.status == 1, ran.err
    assert json.loads(ran.out)["verdicts"]["failed"] == 1
    with (tmp_path / "t.csv").open() as stream:
        good, bad = csv.DictReader(stream)
    alone = json.loads(terraphi("invert", MEASURED, *QUICK, "--json").out)
    assert float(good["phi_deg"]) == pytest.approx(alone["phi_deg"]["median"], rel=1e-4)
    assert float(good["ci95_high_deg"]) == pytest.approx(alone["phi_deg"]["ci95"][1], rel=1e-4)
    assert (bad["phi_deg"], bad["verdict"]) == ("", "failed")
    assert "line 2" in bad["reason"]
    assert terraphi(*arguments).status == 1  # over its own table
    assert "no table of answers" in terraphi(*arguments[:-1], "bad.csv").err


@pytest.mark.parametrize("copies", [1, 3])  # in this process, and in several
def test_a_table_of_records_is_inverted_as_each_alone(
    copies: int, terraphi: Terraphi, tmp_path: Path
) -> None:
    day = tmp_path / "day"
    day.mkdir()
    history = package.measurement("li2013:yuma/c").history
    plain = package.ForceHistory(history.position, history.force)
    plain.to_csv(day / "plain.csv")
    pd.DataFrame({"Winkel": plain.theta_deg, "a": plain.Fx / 1e3, "b": plain.Fz / 1e3}).to_csv(
        day / "other.csv", sep=";", decimal=",", index=False
    )
    (day / "c.toml").write_text('fx = "a"\nfz = "b"\nunit = "kN"\n')
    lines = [
        "plain.csv,c,li2013,1500±50,,dry",
        "other.csv,c,li2013,1500±50,c.toml,",
        f"{MEASURED},,,,,",
        "no.csv,,,,,",
    ]
    table = ["file,leg,rig,density,columns,remark", *lines * copies]
    (day / "day.csv").write_text("\n".join(table) + "\n", encoding="utf-8")
    ran = terraphi("invert", "--table", "day/day.csv", *QUICK, "--out", "answers.csv")
    assert ran.status == 1, ran.err
    assert "no.csv" in ran.err
    rows = pd.read_csv(tmp_path / "answers.csv")
    assert len(rows) == 4 * copies
    assert rows["verdict"].tolist()[3::4] == ["failed"] * copies
    phi = package.invert(plain, rig="li2013", leg="c", density="1500±50", law="rft3d").phi
    shipped = package.invert(MEASURED, law="rft3d").phi
    expected = [phi.median, phi.median, shipped.median] * copies
    assert rows["phi_deg"].dropna().tolist() == pytest.approx(expected, abs=2e-3)
    assert rows["remark"][0] == "dry"


def test_no_cell_of_answers_is_a_formula(terraphi: Terraphi, tmp_path: Path) -> None:
    shown = {"=1+1": "=cmd|'/C calc'!A0", "@b": "-3.5", "+c": "+1", "d": "-2+3", "e": "\u202e=x"}
    package.measurement("li2013:yuma/c").history.to_csv(tmp_path / "=f\u202e.csv")
    with (tmp_path / "day.csv").open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows(
            [["file", *shown], ["=f\u202e.csv", *shown.values()], ["no.csv", *["\t=y"] * 5]]
        )
    ran = terraphi("invert", "--table", "day.csv", *QUICK, "--out", "answers.csv")
    assert ran.status == 1, ran.err
    with (tmp_path / "answers.csv").open(newline="", encoding="utf-8") as stream:
        header, first, second = csv.reader(stream)
    for cell in (*header, *first, *second):
        assert "\u202e" not in cell
        assert cell.lstrip()[:1] not in {*"=+-@"} or float(cell) < 2.0
    assert first[0] == r"'=f\u202e.csv"
    kept = dict(zip(header, first, strict=True))
    assert (kept["'@b"], kept["'+c"], kept["d"]) == ("-3.5", "+1", "'-2+3")
    # Read back, the names and cells are those that were there.
    copied = [header.index(name) for name in ("'=1+1", "'@b", "'+c", "d")]
    with (tmp_path / "day.csv").open("w", newline="", encoding="utf-8") as stream:
        rows = [["file", *(row[i] for i in copied)] for row in (header, first)]
        csv.writer(stream).writerows([rows[0], [MEASURED, *rows[1][1:]]])
    (read,) = read_manifest(tmp_path / "day.csv")
    assert read["notes"] == {name: shown[name] for name in ("=1+1", "@b", "+c", "d")}


@pytest.mark.parametrize(
    ("content", "wrong"),
    [
        ("file;leg;density\nli2013:yuma/c\n\nli2013:yuma/straight;;1600\n", ""),
        ("fil,leg\na,c\n", "did you mean 'file'"),
        ("file,dens\nli2013:yuma/c,3\n,3\n", "row 2 names no file"),
        ("", "no rows"),
    ],
)
def test_a_table_of_records_is_read_or_refused(
    content: str, wrong: str, terraphi: Terraphi, tmp_path: Path
) -> None:
    (tmp_path / "day.csv").write_text(content)
    ran = terraphi("invert", "--table", "day.csv", *QUICK, "--json")
    if wrong:
        assert (ran.status, ran.out) == (2, "")
        assert wrong in ran.err
    else:
        assert {row["verdict"] for row in json.loads(ran.out)["rows"]} <= {"consistent", "misfit"}
        assert ran.status == 0


def test_columns_stand_in_a_file_or_on_the_command_line(terraphi: Terraphi, tmp_path: Path) -> None:
    history = package.measurement("li2013:yuma/c").history
    table = {"q": 132.0 - history.theta_deg, "a": history.Fx / 4.4482216152605, "b": -history.Fz}
    frame = pd.DataFrame(table).assign(b=-history.Fz / 4.4482216152605)
    frame.to_csv(tmp_path / "x.csv", sep="\t", encoding="utf-16")
    pairs = "theta=q,fx=a,fz=b,unit=lbf,theta_offset_deg=-132,theta_sign=-1,fz_sign=-1"
    (tmp_path / "c.toml").write_text(
        "".join(
            f"{key} = {json.dumps(value)}\n" if value.isalpha() else f"{key} = {value}\n"
            for key, value in (pair.split("=") for pair in pairs.split(","))
        )
    )
    density = ("--rig", "li2013", "--leg", "c", "--density", "1650", *QUICK, "--json")
    phi = package.invert("li2013:yuma/c", density=1650, law="rft3d").phi.median
    for columns in (pairs, "c.toml"):
        ran = terraphi("invert", "x.csv", "--columns", columns, *density)
        assert json.loads(ran.out)["phi_deg"]["median"] == pytest.approx(phi, abs=1e-3)


def test_the_raw_file_of_a_lab_is_one_command(terraphi: Terraphi, tmp_path: Path) -> None:
    """Semicolons, decimal commas, counts, kilograms, a turned load cell, forth, back and forth."""
    history = package.measurement("li2013:yuma/straight").history
    turn = np.radians(-30.0)
    angle, force = history.theta_deg, (history.Fx + 1j * history.Fz) * np.exp(1j * turn)
    pieces = [(angle, force), (angle[::-1], 0.02 * force[::-1]), (angle, 1.01 * force)]
    theta, read = (np.concatenate(column) for column in zip(*pieces, strict=True))
    read /= 9.80665
    lab = pd.DataFrame({
        "Zeit [s]": 0.05 * np.arange(len(theta)),
        "Encoder [Impulse]": np.round((theta + 200.0) * 4096 / 360),
        "Kraft X [kgf]": read.real,
        "Kraft Z [kgf]": read.imag,
    })  # fmt: skip
    lab.round(4).to_csv(tmp_path / "lab.csv", sep=";", decimal=",", index=False, encoding="cp1252")
    options = ("--rig", "li2013", "--leg", "straight", "--density", "1650", "--json")
    columns = "theta=Encoder,theta_scale=0.087890625,theta_offset_deg=-200,sensor_angle_deg=-30"
    ran = terraphi("invert", "lab.csv", "--columns", columns, *options)
    answer = json.loads(ran.out)
    clean = package.invert("li2013:yuma/straight", density=1650)
    assert answer["verdict"] == "consistent"
    assert answer["phi_deg"]["median"] == pytest.approx(clean.phi.median, abs=0.3)


def test_a_calibration_narrows_the_interval(terraphi: Terraphi) -> None:
    options = ("--phi", "36±1", "--soil", "seeds", "--out", "c.toml")
    _, _, line, *_ = terraphi("calibrate", MEASURED, *options).out.splitlines()
    assert line.split()[:2] == ["seeds", MEASURED]
    soil = Calibration.load("c.toml").soils[0]
    assert (soil.soil, soil.phi_deg, soil.phi_sd_deg) == ("seeds", 36.0, 1.0)
    before = json.loads(terraphi("invert", "li2013:yuma/c", "--json").out)["phi_deg"]
    calibrated = ("invert", "li2013:yuma/c", "--calibration", "c.toml", "--json")
    after = json.loads(terraphi(*calibrated).out)["phi_deg"]
    assert after["sd"] < before["sd"]


def test_ten_lines_state_half_and_twice_the_force(terraphi: Terraphi) -> None:
    """Of two rigs as well, between what each states."""
    legs = ("li2013:yuma/c", "li2013:yuma/straight")
    of_c, of_straight, of_both = (
        json.loads(terraphi("invert", *forces, "--json").out)["phi_of_force_deg"]
        for forces in (legs[:1], legs[1:], legs)
    )
    for key, angle in of_both.items():
        low, high = sorted((of_c[key], of_straight[key]))
        assert low <= angle <= high
    lines = terraphi("invert", *legs).out.splitlines()[:10]
    sentence = f"Half the force: {of_both['half']:.0f}°; twice: {of_both['twice']:.0f}°."
    assert any(sentence in line for line in lines)


def test_a_simulation_inverts_to_its_own_angle(terraphi: Terraphi) -> None:
    changes = ("--set", "soil.friction_angle_deg=33", "--set", "leg.shape=c")
    summary = json.loads(terraphi("simulate", "quick", *changes, "--out", "h.nc", "--json").out)
    assert summary["peak_Fz_N"] > 0.0
    answer = json.loads(terraphi("invert", "h.nc", "--json").out)
    assert (answer["rig"]["leg"], answer["law"]) == ("c", "rft3d")
    assert answer["phi_deg"]["median"] == pytest.approx(33.0, abs=0.1)


def test_a_library_is_built_listed_shown_and_used(terraphi: Terraphi, tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text(PLAN)
    ran = terraphi("library", "build", "p.toml", "--out", "l.nc", "--workers", "1", "--json")
    assert json.loads(ran.out)["cases"] == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["l.nc", "p.toml"]
    assert "small" in terraphi("library", "show", "l.nc").out
    ran = terraphi("invert", MEASURED, "--law", "l.nc")
    assert ran.status == 2
    assert "library small differs from law legs in model" in ran.err
    listed = json.loads(terraphi("library", "list", "--json").out)
    assert [entry["name"] for entry in listed["libraries"]][:2] == ["legs", "rft3d"]
    assert listed["soils"]["loose dry sand"]["phi_plane_strain_deg"] == [33.0, 2.0]


@pytest.mark.parametrize(
    "command",
    [
        ("library", "build", "--rig", "li2013", "--leg", "c", "--out", "l.nc"),
        ("simulate", "sand3d", "--out", "h.nc"),
    ],
)
def test_a_missing_compiler_is_named_before_a_simulation(
    command: tuple[str, ...], terraphi: Terraphi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, "terraphi.forward.compiled", raising=False)
    status, _, err = terraphi(*command)
    assert status == 2
    assert "pip install 'terraphi[simulate]'" in err
    assert list(tmp_path.iterdir()) == []


# -- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("theta_deg,Fx_N,lift\n1,2,x\n", "line 2"),
        ("\x00\x01\x02", ""),
    ],
)
def test_unusable_forces_are_one_sentence_and_write_nothing(
    content: str, word: str, terraphi: Terraphi, tmp_path: Path
) -> None:
    (tmp_path / "bad.csv").write_text(content)
    status, out, err = terraphi(
        "invert", "bad.csv", "--rig", "li2013", "--leg", "c", *QUICK, "--out", "o"
    )
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert "bad.csv" in err
    assert word in err
    assert [path.name for path in tmp_path.iterdir()] == ["bad.csv"]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ("invrt x.csv", "invert"),
        ("invert no.csv", "no such file"),
        ("invert li2013:yuma/c --law rtf3d", "rft3d"),
        ("invert li2013:yuma/c --densty 1600", "--density"),
        ("invert li2013:yuma/c --table t.csv --out o", "--table"),
        ("invert", "FORCES"),
        ("calibrate li2013:yuma/c --phi 35 --out c.toml", "36±2"),
        ("simulate quick --set soil.frction_angle_deg=30", "friction_angle_deg"),
        ("simulate quick --out h.csv", ".nc"),
        (f"invert {'no' * 400}.csv", " … "),
        ("invert no\x1b[31m\u202e.csv", "no\\x1b[31m\\u202e.csv"),
    ],
)
def test_a_mistake_is_one_sentence_that_names_the_remedy(
    arguments: str, word: str, terraphi: Terraphi, tmp_path: Path
) -> None:
    status, out, err = terraphi(*arguments.split())
    assert (status, out) == (2, "")
    assert word in err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "option", "word"),
    [
        ("# made with terraphi\nt", ("--out", "walk.nc"), "walk.csv: is the log"),
        ("# made with terraphi\nt", ("--mcap", "walk.csv"), "walk.csv: is the log"),
        ("t", ("--out", "other.nc"), "other.png: is there"),
        ("t", ("--out", "."), ".: is a folder; name a file"),
        ("t", ("--layers", "."), ".: holds 'other.png', not written by terraphi"),
        ("t", ("--layers", "walk.csv"), "walk.csv: is the log"),
    ],
)
def test_files_in_the_way_of_footfalls_are_named_before_anything_is_loaded(
    content: str, option: tuple[str, str], word: str, terraphi: Terraphi, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setitem(sys.modules, "terraphi.robot.footfalls", None)
    (tmp_path / "walk.csv").write_text(content)
    (tmp_path / "other.png").write_bytes(b"a picture")
    status, out, err = terraphi("footfalls", "walk.csv", *option)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert word in err
    assert {path.name for path in tmp_path.iterdir()} == {"walk.csv", "other.png"}
    assert (tmp_path / "walk.csv").read_text() == content


def test_codes_in_names_do_not_reach_the_terminal(terraphi: Terraphi, tmp_path: Path) -> None:
    name = "a\x1b]0;title\x07b.csv"
    assert terraphi("simulate", "quick", "--out", f"{name}.nc").status == 0
    out = terraphi("report", f"{name}.nc", "--out", "r.html").out
    assert out.startswith("a\\u001b]0;title\\u0007b.csv")
    assert terraphi("simulate", "quick", "--out", "a\x7f\x9bb.nc").status == 0
    out = terraphi("invert", "a\x7f\x9bb.nc", "--json").out
    assert json.loads(out)["source"] == "a\x7f\x9bb.nc"


def test_a_file_name_that_is_not_utf8_is_escaped_in_results(terraphi: Terraphi) -> None:
    name, escaped = "a\udcff.csv", "a\\udcff.csv"
    package.measurement(MEASURED).history.to_csv(name)
    forces = (name, "--rig", "li2013", "--leg", "straight", *QUICK)
    assert terraphi("invert", *forces, "--out", "o").status == 0
    assert package.Answer.load("o").source == escaped
    assert json.loads(Path("o/answer.json").read_text())["source"] == escaped
    assert terraphi("calibrate", *forces, "--phi", "36±2", "--out", "c.toml").status == 0
    assert terraphi("invert", *forces, "--calibration", "c.toml", "--table", "t.csv").status == 0
    depth = np.linspace(0.0, 60.0, 50)
    pd.DataFrame({"sinkage_mm": depth, "force_N": depth}).to_csv(name, index=False)
    assert terraphi("invert", name, "--tool", "plate:60", "--out", "p").status == 0
    assert package.Answer.load("p").source == escaped
    # The first 3.6 s of eight have footfalls.
    lines = shipped_file("robots", "walk", ".csv").read_text().splitlines(keepends=True)
    Path(name).write_text("".join(lines[:900]))
    assert terraphi("footfalls", name, "--out", "w.nc").status == 0
    assert FootfallMap.load("w.nc").provenance["log"] == escaped
    assert terraphi("forces", name, "--out", "f.nc").status == 0
    assert terraphi("report", "f.nc", "--out", "r.html").status == 0


@pytest.mark.parametrize("soil", ["a\udcff", "a\nb"])
def test_a_soil_of_hidden_letters_is_refused_before_the_work(
    soil: str, terraphi: Terraphi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ("calibrate", MEASURED, *QUICK, "--phi", "36±2", "--out", "c.toml", "--soil")
    assert terraphi(*arguments, "sand ü").status == 0
    text = (tmp_path / "c.toml").read_text()
    assert Calibration.load("c.toml").soils[0].soil == "sand ü"
    with monkeypatch.context() as patch:
        patch.setattr(calibration, "_calibration_soil", None)
        status, out, err = terraphi(*arguments, soil)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert f"soil = {soil!r};" in err
    assert (tmp_path / "c.toml").read_text() == text
    with pytest.raises(InputError, match="printable"):
        CalibrationSoil(
            source="x", soil=soil, leg="c", phi_deg=30.0, phi_sd_deg=1.0, read_deg=30.0,
            read_sd_deg=1.0,
        )  # fmt: skip


def test_a_calibration_with_a_file_of_hidden_letters_is_read_back(terraphi: Terraphi) -> None:
    package.measurement(MEASURED).history.to_csv("a\x7f.csv")
    forces = ("a\x7f.csv", "--rig", "li2013", "--leg", "straight", *QUICK)
    assert terraphi("calibrate", *forces, "--phi", "36±2", "--out", "c.toml").status == 0
    assert Calibration.load("c.toml").soils[0].source == "a\\x7f.csv"


def test_numbers_and_depth_without_bound_are_one_sentence(
    terraphi: Terraphi, tmp_path: Path
) -> None:
    terraphi("calibrate", MEASURED, *QUICK, "--phi", "36±2", "--out", "c.toml")
    text = (tmp_path / "c.toml").read_text().replace("phi_sd_deg = 2.0", "phi_sd_deg = 1e308")
    (tmp_path / "c.toml").write_text(text)
    (tmp_path / "deep.toml").write_text(f"model = {'[' * 5000}{']' * 5000}")
    for command in (
        ("invert", MEASURED, *QUICK, "--calibration", "c.toml"),
        ("forces", "c.toml", "--robot", "deep.toml"),
    ):
        status, out, err = terraphi(*command)
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert len(err) <= 312


def test_a_warning_of_numpy_stays_off_the_terminal() -> None:
    code = (
        "import warnings, sys, click; from terraphi.cli import main; "
        "main.cli.main = lambda **_: warnings.warn('divide by zero', RuntimeWarning); main.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""
