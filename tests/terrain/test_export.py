"""``terraphi export`` and ``terraphi convert``: exported modules work, unusable answers do not."""

from __future__ import annotations

import ast
import dataclasses
import json
import math
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import h5py
import mujoco
import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.forward.rft import stress_scale
from terraphi.inference.inversion import invert
from terraphi.inference.stored import StoredAnswer as Told
from terraphi.laws.foot import LAWS, Foot
from terraphi.laws.wrench import force
from terraphi.terrain.export import bekker, export, headline, text
from terraphi.terrain.simulators import NAMES, simulator
from terraphi.terrain.soils import in_plane_strain, soil

SUMMARY = {"median": 30.0, "ci68": [28.0, 32.0], "ci95": [26.0, 34.0]}


def answer(**changes: Any) -> dict[str, Any]:
    return {
        "phi_deg": {**SUMMARY, "yield": "plane_strain"},
        "phi_plane_strain_deg": SUMMARY,
        "verdict": "consistent",
        "reason": "It fits.",
        "density_kg_m3": 1600.0,
        "source": "sand.csv",
        "law": "of-another-machine",
        **changes,
    }


def read(draws: Any = (), source: str = "answer", **changes: Any) -> Told:
    return Told(source, answer(**changes), np.asarray(draws, dtype=float))


@pytest.mark.parametrize("name", NAMES)
def test_the_module_sets_the_parameter_in_the_simulator(name, tmp_path, monkeypatch) -> None:
    to = simulator(name)
    parameters = export(read([25.0, 30.0, 35.0]), to=name, draws=3)
    path = tmp_path / "soil.py"
    path.write_text(text(parameters, "python"), encoding="utf-8")
    made = runpy.run_path(str(path))
    value = to.from_angle(30.0)
    assert made[to.parameter.upper()] == pytest.approx(value, abs=1e-6)
    assert sorted(made["DRAWS"]) == pytest.approx([to.from_angle(p) for p in (25.0, 30.0, 35.0)])
    assert parameters["density_assumed"]
    assert set_by(name, made, monkeypatch) == pytest.approx(value, abs=1e-6)


def rest_on_soil(made: dict[str, Any]) -> None:
    """A sphere of 2 kg comes to rest between where the soil bears it and twice as deep."""
    model = mujoco.MjModel.from_xml_string("""<mujoco><option timestep="0.002"/><worldbody><body
        name="ball"><freejoint/><geom name="foot" type="sphere" size="0.03" mass="2"/></body>
        </worldbody></mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[2] = 0.035
    sand = made["Soil"](model, ["foot"])
    for _ in range(1500):
        sand.push(model, data)
        mujoco.mj_step(model, data)
    depth = 0.03 - data.qpos[2]
    load = [LAWS["foot"].force(Foot(0.03), z, np.pi / 2, friction_angle_deg=30.0, density=1600.0,
                               surface_friction=0.4)[1] for z in (depth, 0.5 * depth)]  # fmt: skip
    assert np.abs(data.qvel).max() < 0.02
    assert load[1] < 2.0 * 9.81 < 1.05 * load[0]
    assert sand.held[0][0, 2] == pytest.approx(2.0 * 9.81, rel=0.02)


def set_by(name: str, made: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> float:
    """What the module passes to the simulator's own interface."""
    if name == "genesis":
        sand = SimpleNamespace(Sand=lambda **given: given)
        genesis = SimpleNamespace(materials=SimpleNamespace(MPM=sand))
        monkeypatch.setitem(sys.modules, "genesis", genesis)
        return made["sand"](E=1e6)["friction_angle"]
    if name in ("newton", "isaaclab"):
        kept = np.zeros(3)
        field = SimpleNamespace(numpy=lambda: kept, assign=lambda new: np.copyto(kept, new))
        made["set_friction"](SimpleNamespace(mpm=SimpleNamespace(friction=field)), particles=[0, 2])
        assert kept[1] == 0.0
        return kept[2]
    if name == "chrono-crm":
        properties = made["fill"](SimpleNamespace())
        assert properties.mu_fric_2 == properties.mu_fric_s
        return properties.mu_fric_s
    if name == "chrono-scm":
        given: list[float] = []
        terrain = SimpleNamespace(SetSoilParameters=lambda *all_: given.extend(all_))
        made["set_soil"](terrain, elastic_k=1e8, damping_r=3e4)
        assert given[:4] == [made["BEKKER_KPHI"], 0.0, made["BEKKER_N"], 0.0]
        assert given[5:] == [made["JANOSI_SHEAR"], 1e8, 3e4]
        return given[4]
    if name == "mujoco":
        rest_on_soil(made)
        return made["Soil"].__init__.__defaults__[1]
    if name == "rft3d":
        # The module's φ is the law's; its ξ is that of resistive force theory.
        disc, moving = Foot(0.018, "disc"), ([0.0, 0.0, -0.02], [0.0, 0.0, -1.0])
        soil = made["soil"](surface_friction=0.4)
        result, _ = force(disc, *moving, inertia=False, **soil)
        plane = {"friction_angle_deg": 30.0, "density": 1600.0, "surface_friction": 0.4}
        pressed = LAWS["foot"].force(disc, 0.02, np.pi / 2, **plane)
        assert result[2] == pytest.approx(pressed[1], rel=1e-6)
        assert made["XI_N"] == pytest.approx(stress_scale(made["FRICTION_ANGLE_DEG"], 1600.0))
        return made["FRICTION_ANGLE_DEG"]
    assert made["material"](1e7, 0.3)["dpType"] == "MiddleCircumscribed"
    return made["material"](1e7, 0.3)["Friction"]


def test_files_of_mujoco_and_chrono_let_a_ball_rest_on_the_soil(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    sand = soil(33.0, density=1600.0)
    sand.mujoco(out=tmp_path / "soil.py")
    runpy.run_path(str(tmp_path / "soil.py"), run_name="__main__")
    assert 0.01 < float(capsys.readouterr().out) < 0.03
    # Of Chrono, which pip does not install, there are the names of its source alone.
    chrono = MagicMock(spec_set=[
        "ChSystemSMC", "ChCollisionSystem", "ChVector3d", "ChBodyEasySphere",
        "ChContactMaterialSMC", "vehicle",
    ])  # fmt: skip
    chrono.vehicle = MagicMock(spec_set=["SCMTerrain"])
    system, ball = chrono.ChSystemSMC(), chrono.ChBodyEasySphere()
    system.GetChTime.side_effect, ball.GetPos.return_value = (0.0, 2.0), SimpleNamespace(z=0.03)
    monkeypatch.setitem(sys.modules, "pychrono", chrono)
    monkeypatch.setitem(sys.modules, "pychrono.vehicle", chrono.vehicle)
    sand.chrono("scm", out=tmp_path / "scm.py")
    runpy.run_path(str(tmp_path / "scm.py"), run_name="__main__")
    assert float(capsys.readouterr().out) == pytest.approx(0.02)
    given = chrono.vehicle.SCMTerrain().SetSoilParameters.call_args.args
    law = sand.bekker_wong(200.0, 80.0)
    assert given[5] == law["shear_m"]
    # Kφ, Kc, n, cohesion, φ [deg] as docs of SCMTerrain::SetSoilParameters have them.
    assert (given[1], given[3], len(given)) == (0.0, 0.0, 8)
    assert 0.5 < given[2] < 2.0
    assert 28.0 < given[4] < 34.0


@pytest.mark.parametrize(("name", "module"), [("genesis", "genesis"), ("chrono-scm", "pychrono")])
def test_a_script_without_its_simulator_ends_in_a_sentence(tmp_path, monkeypatch, name, module):
    monkeypatch.setitem(sys.modules, module, None)
    export(soil(33.0, density=1600.0), to=name, out=tmp_path / "soil.py")
    with pytest.raises(SystemExit, match=module):
        runpy.run_path(str(tmp_path / "soil.py"), run_name="__main__")


def test_bekker_is_near_bearing_capacity_and_published_sand() -> None:
    draws = np.random.default_rng(0).normal(30.0, 2.0, 500)
    result = bekker(SUMMARY, draws, 1650.0)
    pressure = result["BEKKER_KPHI"]["median"] * 0.02 ** result["BEKKER_N"]["median"]
    # Rough strip of 10 cm, 2 cm deep: N_γ 14.75 by characteristics (Martin, 2004), N_q 18.4.
    capacity = 1650.0 * 9.81 * (0.5 * 0.1 * 14.75 + 0.02 * 18.4)
    assert pressure == pytest.approx(capacity, rel=0.3)
    # Dry sand of 28 deg (Wong, 2008): K_c 990 N/m^2.1, K_φ 1528 kN/m^3.1, n 1.1; 10 cm wide.
    wong = (990.0 / 0.1 + 1.52843e6) * 0.02**1.1
    sand = bekker({"median": 28.0, "ci68": [], "ci95": []}, np.empty(0), 1550.0)
    assert sand["BEKKER_KPHI"]["median"] * 0.02 == pytest.approx(wong, rel=0.4)
    twice = bekker(SUMMARY, draws, 3300.0)["BEKKER_KPHI"]
    assert np.array(twice["draws"]) == pytest.approx(2.0 * np.array(result["BEKKER_KPHI"]["draws"]))
    assert result["BEKKER_KPHI"]["ci95"][0] < result["BEKKER_KPHI"]["ci68"][0]
    assert "NOT inferred" in result["JANOSI_SHEAR"]["about"]


@pytest.mark.parametrize(
    "name",
    ['x"""\nimport sys\nsys.stolen = True\n"""', "C:\\new\\u00\\N{x}\\", "nul\0 \ud800 '\u2028\""],
)
def test_foreign_text_stays_text_in_the_module(name) -> None:
    changes = {"source": name, "law": name, "verdict": "misfit", "reason": name}
    item = Told(name, answer(**changes), np.empty(0))
    tree = ast.parse(text(export(item, to="newton", anyway=True), "python"))
    clean = ast.parse(text(export(read(), to="newton"), "python"))
    kinds = [[type(node) for node in item.body] for item in (tree, clean)]
    assert kinds[0] == kinds[1]
    assert f"From {name}: {name}, law {name}." in (ast.get_docstring(tree, clean=False) or "")


def test_draws_are_converted_to_plane_strain() -> None:
    phi = np.radians([30.0, 35.0, 44.0, 46.0])
    sine = np.sin(phi)
    for criterion, wanted in {
        "plane_strain": sine,
        "paper": 2 * sine / (math.sqrt(3) * (3 - sine)),  # docs/explanation/friction-angle.md
        "rft": np.tan(phi),  # √J2 = p tan φ without dilation
    }.items():
        with np.errstate(invalid="ignore"):
            turned = np.degrees(np.arcsin(wanted))
        ends = turned[[0, 2]].tolist()
        plane = {"median": turned[1], "ci68": ends, "ci95": ends}
        angle = {"median": 35.0, "ci68": [30.0, 44.0], "ci95": [30.0, 44.0], "yield": criterion}
        item = read(np.degrees(phi), phi_deg=angle, phi_plane_strain_deg=plane)
        assert in_plane_strain(item) == pytest.approx(turned, nan_ok=True)
        parameters = export(item, to="newton", draws=9)
        assert parameters["draws_without_equivalent"] == (0.25 if criterion == "rft" else 0.0)
        plane["median"] = 20.0
        with pytest.raises(InputError, match="leave out --draws"):
            in_plane_strain(item)


def test_export_of_a_folder(terraphi, tmp_path) -> None:
    result = dataclasses.replace(invert("li2013:yuma/straight"), **MISFIT)
    result.save(tmp_path / "answer")
    phi = result.phi_draws()
    base = ("export", "answer", "--to", "newton", "--draws", "5")
    assert "--anyway" in terraphi(*base).err
    assert terraphi(*base, "--anyway", "--out", "soil.py").status == 0
    printed = json.loads(terraphi(*base, "--anyway", "--json").out)
    module = runpy.run_path(str(tmp_path / "soil.py"))
    assert module["DRAWS"] == printed["draws"]
    assert module["__doc__"].splitlines()[2] == f"CAUTION: {printed['caution']}"
    assert printed["caution"] == "the verdict is misfit: No angle fits."
    (tmp_path / "answer" / "answer.json").write_text("edited")
    caution = json.loads(terraphi(*base, "--anyway", "--json").out)["caution"]
    assert caution.startswith("answer.json was changed after terraphi wrote it. the verdict")
    assert np.isin(printed["draws"], np.round(np.sin(np.radians(phi)), 6)).all()
    assert terraphi(*base, "--anyway", "--out", "soil.usda").status == 0
    assert "newton:mpm:internalFriction = 0." in (tmp_path / "soil.usda").read_text()


def test_export_reads_what_invert_writes(terraphi) -> None:
    ran = terraphi("invert", "li2013:yuma/straight", "--law", "rft3d", "--out", "answer")
    assert ran.status == 0, ran.err
    ran = terraphi("export", "answer", "--to", "newton", "--anyway")
    assert ran.status == 0 or "no friction angle in plane strain" in ran.err


def test_a_table_of_forces_is_no_answer(tmp_path) -> None:
    path = tmp_path / "forces.csv"
    path.write_text("theta_deg,Fx_N,Fz_N\n-110.0,-0.15,-0.1\n")
    with pytest.raises(InputError, match=r"forces\.csv: no answer; give the folder"):
        export(path, to="newton")


def test_an_answer_whose_groups_are_a_cycle_is_refused(terraphi, tmp_path) -> None:
    with h5py.File(tmp_path / "cycle.nc", "w") as file:
        file.create_group("g")["loop"] = file["/"]
    ran = terraphi("export", "cycle.nc", "--to", "newton")
    assert (ran.status, ran.err.count("\n")) == (2, 1)
    assert "'/g/loop' is a link" in ran.err


MISFIT = {"verdict": "misfit", "reason": "No angle fits."}


def edited(**changes: Any) -> dict[str, Any]:
    return {"phi_plane_strain_deg": {**SUMMARY, **changes}}


STRONG = {"phi_plane_strain_deg": None, "phi_plane_strain_reason": "too strong"}


@pytest.mark.parametrize(
    ("changes", "args", "words"),
    [
        (MISFIT, "--to newton", "misfit: No angle fits."),
        (STRONG, "--to newton", "too strong"),
        ({"phi_plane_strain_deg": {}}, "--to newton", "phi_plane_strain_deg.median' is missing"),
        (edited(median=12.0), "--to newton", "do not lie within each other"),
        (edited(ci95=[26.0, 34.0, 35.0]), "--to newton", "phi_plane_strain_deg.ci95"),
        (edited(median=31.0), "--to newton", "phi_deg 30.0 is 30.0 in plane strain, found 31.0"),
        ({"questions": 5}, "--to newton", "questions = 5: should be a valid array"),
        ({"density_kg_m3": -5.0}, "--to newton", "density_kg_m3 = -5.0: should be greater than 0"),
        ({}, "--to newton --draws 3", "has no draws of the posterior"),
        ({}, "--to newton --out soil.txt", "name a .py, .json or .usda"),
        ({}, "--to genesis --out soil.usda", "reads no materials in USD"),
        ({}, "--to newton --out mine.py", "not a file written by"),
    ],
)
def test_refusals_write_nothing(terraphi, tmp_path, changes, args, words) -> None:
    (tmp_path / "answer.json").write_text(json.dumps(answer(**changes)))
    (tmp_path / "mine.py").write_text("[1]")
    ran = terraphi("export", "answer.json", *args.split())
    assert (ran.status, ran.out, ran.err.count("\n")) == (2, "", 1)
    assert words in ran.err
    assert {file.name for file in tmp_path.iterdir()} == {"answer.json", "mine.py"}
    assert (tmp_path / "mine.py").read_text() == "[1]"


def test_convert(terraphi) -> None:
    ran = terraphi("convert", "0.68", "--from", "newton", "--to", "genesis")
    assert "42.8 deg" in ran.out
    assert "29.5 deg" in ran.out
    content = json.loads(terraphi("convert", "0.68", "--from", "newton", "--json").out)
    assert content["phi_plane_strain_deg"] == pytest.approx(42.8, abs=0.05)


@pytest.mark.parametrize("density", [None, "1600±40"])
def test_an_assumed_density_is_marked_wherever_it_is_written(density: str | None) -> None:
    parameters = export("33±2", to="newton", density=density)
    texts = [text(parameters, "python"), headline(parameters), repr(soil("33±2", density=density))]
    assert all(("assumed" in words) == (density is None) for words in texts)
    constant = next(line for line in texts[0].splitlines() if line.startswith("DENSITY = "))
    assert ("# assumed" in constant) == (density is None)
