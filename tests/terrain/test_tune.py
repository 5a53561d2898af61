"""The search of ``terraphi tune`` against engines whose answer is known, and the real ones."""

from __future__ import annotations

import json
import math
import re
import runpy
import sys
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from terraphi import invert
from terraphi.cli.main import cli
from terraphi.cli.options import TUNED
from terraphi.experiment.errors import InputError
from terraphi.inference.stored import StoredAnswer
from terraphi.laws.foot import LAWS, Foot
from terraphi.terrain import tune as tuning
from terraphi.terrain.export import export, text, write
from terraphi.terrain.simulators import simulator
from terraphi.terrain.tune import ENGINES, Fit, Press, Sole, fit, tune

SOIL = {"density": 1600.0, "surface_friction": 0.5}
TARGET = np.array([100.0, 160.0, 210.0])
GIVEN: dict[str, Any] = {"tolerance": 0.2, "start": 0.545, "limits": (0.05, 2.0)}
OWN = math.sin(math.radians(33.0))


def search(
    answer: float, *, power: float = 3.0, noise: float = 0.0, spread: float = 0.3, seed: int = 0
) -> Fit:
    """Fit to an engine that has the soil's force at a known q, with noise in each press."""
    rng = np.random.default_rng(seed)

    def press(ratio: float, _place: int) -> np.ndarray:
        return (
            TARGET
            * (ratio / answer) ** power
            * np.exp(noise * rng.standard_normal(3) - 0.5 * noise**2)
        )

    targets = TARGET * np.exp(np.random.default_rng(9).normal(0.0, spread, 2000))[:, None]
    return fit(press, TARGET, targets, **GIVEN)


@pytest.mark.parametrize("answer", [0.21, OWN, 1.3])
def test_a_known_friction_is_found_with_its_interval(answer: float) -> None:
    result = search(answer)
    assert result.fits
    assert result.ratio == pytest.approx(answer, rel=0.01)
    # Errors of log force divided by the exponent.
    assert np.std(np.log(result.draws)) == pytest.approx(0.1, rel=0.15)
    assert np.median(result.factor) == pytest.approx((answer / OWN) ** 3, rel=0.02)
    assert result.presses <= 18


def test_intervals_cover_noise_as_often_as_they_say() -> None:
    """Of the friction, and of what the soil carries with its own, whose draws add nothing."""
    hits = []
    for seed in range(40):
        result = search(0.8, noise=0.4, spread=0.0, seed=seed)
        ends = np.quantile([result.draws, result.factor], [0.025, 0.975], axis=1)
        truth = np.array([0.8, (0.8 / OWN) ** 3])
        hits.append((ends[0] <= truth) & (truth <= ends[1]))
    covered = np.mean(hits, axis=0)
    assert np.all((covered >= 0.88) & (covered <= 1.0))
    assert np.all(ends[1] / ends[0] > 1.1)


def test_an_engine_that_cannot_bear_the_load_has_no_value() -> None:
    def press(ratio: float, _place: int) -> np.ndarray:
        return 0.3 * TARGET * ratio / (0.5 + ratio)

    fitted = fit(press, TARGET, TARGET[None] * np.ones((500, 1)), **GIVEN)
    assert not fitted.fits
    assert fitted.at_limit == "high"
    assert fitted.lost == 1.0
    weak = fit(lambda q, _: 50 * TARGET * (1 + q), TARGET, TARGET[None], **GIVEN)
    assert weak.at_limit == "low"
    assert np.median(weak.factor) == pytest.approx(1 / (50 * (1 + OWN)), rel=0.01)


def test_another_curve_of_force_over_sinkage_has_no_value() -> None:
    def press(ratio: float, _place: int) -> np.ndarray:
        return TARGET * [0.2, 1.0, 5.0] * (ratio / 0.6) ** 3

    fitted = fit(press, TARGET, TARGET[None] * np.ones((500, 1)), **GIVEN)
    assert fitted.ratio == pytest.approx(0.6, rel=0.02)
    assert not fitted.fits
    assert fitted.residual == pytest.approx(math.log(5) * math.sqrt(2 / 3), rel=0.02)


def test_a_force_that_depends_on_the_place_in_the_voxel_has_no_value() -> None:
    def press(ratio: float, place: int) -> np.ndarray:
        return TARGET * (0.4, 1.0, 1.6)[place] * (ratio / 0.6) ** 3

    fitted = fit(press, TARGET, TARGET[None] * np.ones((500, 1)), **GIVEN)
    assert fitted.ratio == pytest.approx(0.6, rel=0.01)
    assert fitted.residual < 0.01
    assert fitted.scatter == pytest.approx(0.6)
    assert not fitted.fits


def test_a_friction_without_force_does_not_hide_the_scatter() -> None:
    def press(ratio: float, place: int) -> np.ndarray:
        return TARGET * (0.2, 1.0, 1.8)[place] * (ratio / 0.4) ** 3 * (ratio > 0.35)

    fitted = fit(press, TARGET, TARGET[None] * np.ones((500, 1)), **GIVEN)
    assert fitted.scatter > fitted.tolerance
    assert not fitted.fits


def test_a_foot_that_feels_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="finer voxels"):
        search(1.0, power=math.nan)


def synthetic(strength: float, coarse: float = 1.0):
    """An engine with the law's force at a known value; another curve on voxels above ``coarse``."""

    def engine(press: Press, value: float) -> tuple[np.ndarray, np.ndarray]:
        depth = np.linspace(1e-4, press.depth, 60)
        force = press.sole.force(depth, np.array([33.0]), **SOIL)[0]
        if press.voxel > coarse:
            force = force * (depth / press.depth) ** 4
        return depth, force * (value / strength) ** 2

    return engine


MATERIAL = {
    "dilatancy", "elasticDamping", "hardening", "hardeningRate", "initialPlasticVolumeStrain",
    "internalFriction", "poissonsRatio", "softeningRate", "tensileYieldRatio", "viscosity",
    "yieldPressure", "yieldStress", "youngsModulus",
}  # fmt: skip
"""Attributes of NewtonMPMMaterialAPI as newton-usd-schemas has them (2026)."""


def check_bed(file: Path, content: dict[str, Any]) -> None:
    """The stage has the scene, the material with all attributes, and a bed of whole voxels."""
    text = file.read_text(encoding="utf-8")
    values = dict(re.findall(r"float (?:newton:mpm|physics):(\w+) = (\S+)", text))
    assert {*values} == MATERIAL | {"voxelSize", "gravityMagnitude", "density"}
    assert float(values["internalFriction"]) == pytest.approx(content["value"], abs=1e-6)
    assert (float(values["yieldStress"]), float(values["voxelSize"])) == (0.0, 0.03)
    assert float(values["density"]) == 1600.0
    triples = re.findall(r"\(([-.\de]+), ([-.\de]+), ([-.\de]+)\)", text.split("points = ")[1])
    points = np.array(triples, dtype=float)
    masses = [float(mass) for mass in text.split("masses = [")[1].split("]")[0].split(",")]
    half, deep = content["bed_m"]
    assert np.abs(points[:, :2]).max() <= half
    assert -deep <= points[:, 2].min() < points[:, 2].max() <= 0.0
    assert sum(masses) == pytest.approx(1600.0 * 4.0 * half**2 * deep, rel=1e-4)
    if find_spec("pxr") is None:  # a skip would leave out what the caller checks after this
        return
    stages = import_module("pxr.Usd")
    bed = stages.Stage.Open(str(file)).GetPrimAtPath("/World/Bed")
    assert len(bed.GetAttribute("points").Get()) == len(points)
    assert str(bed.GetRelationship("physics:simulationOwner").GetTargets()[0]) == "/World/Scene"


def test_newton_loads_the_bed_itself(tmp_path: Path) -> None:
    """Newton's own loader makes the particles, with the friction and mass of the stage."""
    newton = pytest.importorskip("newton")
    pytest.importorskip("newton_usd_schemas")
    bed = {**export("33±2", density="1600±40", to="newton"), "voxel_m": 0.05, "bed_m": (0.1, 0.1)}
    write(bed, tmp_path / "bed.usda")
    builder = newton.ModelBuilder()
    newton.solvers.SolverImplicitMPM.register_custom_attributes(builder)
    builder.add_usd(str(tmp_path / "bed.usda"))
    model = builder.finalize(device="cpu")
    assert model.particle_count == 12 * 12 * 6
    assert model.mpm.friction.numpy() == pytest.approx(bed["value"], rel=1e-6)
    assert model.particle_mass.numpy().sum() == pytest.approx(1600.0 * 0.004, rel=1e-5)


def test_the_command_writes_what_the_simulators_read(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(ENGINES, "newton", synthetic(0.7))
    args = ["tune", "newton", "--voxel", "0.03", "--foot", "disc:0.05", "--phi", "33±2",
            "--density", "1600"]  # fmt: skip
    files = [tmp_path / f"soil.{end}" for end in ("usda", "py", "json")]
    for file in files:
        ran = CliRunner().invoke(cli, [*args, "--out", str(file), "--json"], catch_exceptions=False)
        assert ran.exit_code == 0, ran.output
    content = json.loads(files[2].read_text())
    assert content["value"] == pytest.approx(0.7, rel=0.01)
    assert content["carried"] == pytest.approx((OWN / 0.7) ** 2, rel=0.03)
    assert content["verdict"] == "carries"
    check_bed(files[0], content)
    module = runpy.run_path(str(files[1]))
    assert (module["FRICTION"], module["DRAWS"]) == (content["value"], content["draws"])


def test_draws_beyond_the_law_do_not_move_the_others(monkeypatch) -> None:
    """Law foot ends near 55°: dropped draws took the median of the load down."""

    def engine(press: Press, value: float) -> tuple[np.ndarray, np.ndarray]:
        depth = np.linspace(1e-4, press.depth, 60)
        force = press.sole.force(depth, np.array([54.0]), **SOIL)[0]
        return depth, force * (value / math.sin(math.radians(54.0))) ** 2

    monkeypatch.setitem(ENGINES, "newton", engine)
    parameters = tune("newton", voxel=0.03, foot="disc:0.05", phi="54±6", density=1600.0)
    assert parameters["carried"] == pytest.approx(1.0, abs=0.1)


def test_an_answer_that_is_a_misfit_is_tuned_if_wanted(monkeypatch) -> None:
    monkeypatch.setitem(ENGINES, "newton", synthetic(0.7))
    answer = invert("li2013:poppy_loose/straight", density="1600±10")
    misfit = replace(answer, verdict="misfit", reason="Misfit: of a test.")
    options: dict[str, Any] = {"voxel": 0.03, "foot": "disc:0.05", "phi": misfit}
    with pytest.raises(InputError, match="--anyway"):
        tune("newton", **options)
    assert "Misfit: of a test." in tune("newton", **options, anyway=True)["caution"]
    assert tune("newton", voxel=0.03, foot="disc:0.05", phi="33±2")["density_assumed"]


def test_genesis_gets_its_angle(monkeypatch) -> None:
    monkeypatch.setitem(ENGINES, "genesis", synthetic(30.0))
    parameters = tune(
        "genesis", voxel=0.03, foot="ball:0.022", phi=33.0, density=1600.0, surface_friction=0.5
    )
    assert parameters["density_factor"] is None
    assert parameters["value"] == pytest.approx(30.0, rel=0.01)
    assert parameters["own_value"] == pytest.approx(simulator("genesis").from_angle(33.0), abs=1e-6)


def test_a_grid_that_is_too_coarse_is_said_to_be(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(ENGINES, "newton", synthetic(0.7, coarse=0.021))
    options: dict[str, Any] = {"voxel": 0.03, "foot": "disc:0.05", "phi": "33±2"}
    parameters = tune("newton", **options)
    assert parameters["verdict"] == "no value"
    assert "Take finer voxels" in parameters["reason"]
    out = tmp_path / "soil.py"
    with pytest.raises(InputError, match="--anyway"):
        tune("newton", **options, out=out)
    assert not out.exists()
    tune("newton", **options, out=out, anyway=True)
    assert "CAUTION: No friction does" in runpy.run_path(str(out))["__doc__"]


def test_an_interval_is_as_wide_as_that_of_the_soil(monkeypatch) -> None:
    monkeypatch.setitem(ENGINES, "newton", synthetic(0.7))
    options: dict[str, Any] = {"voxel": 0.03, "foot": "disc:0.05"}
    logs = [np.log(tune("newton", **options, phi=phi)["ci68"]) for phi in (33.0, "33±5")]
    narrow, wide = (half[1] - half[0] for half in logs)
    # Half of the change of log force by the law's own error, the engine's exponent being 2.
    ends = (33.0 - 2.6, 33.0 + 2.6)
    law = [LAWS["foot"].force(Foot(0.05, "disc"), 0.0125, np.pi / 2,
                              friction_angle_deg=phi, **SOIL)[1] for phi in ends]  # fmt: skip
    assert narrow == pytest.approx(math.log(law[1] / law[0]) / 2, rel=0.15)
    assert wide / narrow == pytest.approx(math.hypot(2.6, 5.0) / 2.6, rel=0.2)


def test_the_density_s_error_widens_genesis_and_goes_with_newton_s_draws(monkeypatch) -> None:
    """A rigid soil is as much too heavy as the simulated one; an elastic one is not."""
    options: dict[str, Any] = {"voxel": 0.03, "foot": "disc:0.05", "phi": 33.0, "draws": 400}
    widths, result = {}, {}
    for name, strength in (("newton", 0.7), ("genesis", 30.0)):
        monkeypatch.setitem(ENGINES, name, synthetic(strength))
        for sd in (0, 480):
            result[name, sd] = tune(name, **options, density=f"1600±{sd}")
            low, high = (math.log(end) for end in result[name, sd]["ci68"])
            widths[name, sd] = high - low
    assert widths["newton", 480] == widths["newton", 0]
    drawn = np.array(result["newton", 480]["density_draws_kg_m3"])
    assert (drawn.mean(), drawn.std()) == pytest.approx((1600.0, 480.0), rel=0.1)
    assert set(result["genesis", 480]["density_draws_kg_m3"]) == {1600.0}
    law = result["genesis", 0]["tolerance"]
    ratio = math.hypot(law, 0.3) / law
    assert widths["genesis", 480] / widths["genesis", 0] == pytest.approx(ratio, rel=0.1)


@pytest.mark.parametrize("shape", ["disc", "ball"])
def test_a_mesh_of_a_disc_or_ball_has_its_force(shape: Any, tmp_path: Path) -> None:
    exact = Sole.of(f"{shape}:0.04")
    file = write_obj(
        tmp_path / "sole.obj", exact.vertices + np.array([0.3, -0.2, 0.7]), exact.faces
    )
    mesh = Sole.of(file)
    assert mesh.radius == pytest.approx(0.04, rel=0.005)
    depth, phi = 0.04 * np.array([0.25, 0.5, 1.0]), np.array([25.0, 33.0, 42.0])
    np.testing.assert_allclose(
        mesh.force(depth, phi, **SOIL), exact.force(depth, phi, **SOIL), rtol=0.06
    )


def test_a_mesh_between_ball_and_disc_widens_the_interval(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(ENGINES, "newton", synthetic(0.7))
    monkeypatch.setattr(tuning, "FINE", 8)  # a mesh takes its time at each depth
    ball, widths, flatness = Sole.of("ball:0.04"), [], []
    for height in (1.0, 0.35):
        file = write_obj(tmp_path / "sole.obj", ball.vertices * [1, 1, height], ball.faces)
        flatness.append(1.0 - Sole.of(file).foot.footprint(np.array([0.02]))[1][0])
        low, high = tune("newton", voxel=0.03, foot=file, phi=33.0, draws=200)["ci68"]
        widths.append(math.log(high / low))
    assert flatness[0] < 0.05
    assert 0.2 < flatness[1] < 0.8
    assert widths[1] > 1.1 * widths[0]


def write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    lines = ["v {} {} {}".format(*point) for point in vertices]
    lines += ["f {}//1 {}//1 {}//1".format(*face) for face in faces + 1]
    path.write_text("\n".join(lines))
    return path


def test_a_box_of_quadrilaterals_is_read_and_turned_outward(tmp_path: Path) -> None:
    corners = [(x, y, z) for z in (0, 0.02) for y in (0, 0.1) for x in (0, 0.2)]
    quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = ["v {} {} {}".format(*corner) for corner in corners]
    lines += ["f " + " ".join(map(str, quad)) for quad in quads]
    file = tmp_path / "box.obj"
    file.write_text("\n".join(lines))
    box = Sole.of(file)
    faces = box.foot
    volume = np.einsum("fi,fi,f->", faces.points, faces.normals, faces.areas) / 3
    assert volume == pytest.approx(0.2 * 0.1 * 0.02)
    assert box.radius == pytest.approx(math.sqrt(0.02 / math.pi))
    assert box.vertices[:, 2].min() == 0.0


def test_unusable_input_is_one_sentence(tmp_path: Path) -> None:
    ball = Sole.of("ball:0.04")
    open_ = write_obj(tmp_path / "open.obj", ball.vertices, ball.faces[1:])
    large = write_obj(tmp_path / "mm.obj", 1e3 * ball.vertices, ball.faces)
    words = tmp_path / "words.obj"
    words.write_text("v 0 0 zero\n")
    bare = tmp_path / "bare.obj"
    bare.write_text("v 0 0 0\nf 1 2 3\n")
    options: dict[str, Any] = {"voxel": 0.03, "foot": "disc:0.05", "phi": 33.0}
    for changed, match in [
        ({"foot": open_}, "not closed"),
        ({"foot": large}, "meter"),
        ({"foot": words}, "line 1"),
        ({"foot": bare}, "vertices that it lacks"),
        ({"foot": "disc:5cm"}, "disc:0.05"),
        ({"foot": "box:1"}, "disc:RADIUS"),
        ({"phi": "33±x"}, "33±x"),
        ({"phi": 3.0}, "5 to 60"),
        ({"phi": 58.0}, "is for 14 to 55 deg"),
        ({"voxel": 30.0}, "voxel = 30"),
        ({"depth": 1.0}, "depth = 1"),
        ({"time_step": 0.1}, "time_step = 0.1"),
        ({"surface_friction": 3.0}, "surface_friction"),
        ({"out": tmp_path / "soil.txt"}, ".usda"),
    ]:
        with pytest.raises(InputError, match=match):
            tune("newton", **{**options, **changed})
    with pytest.raises(InputError, match="USD"):
        tune("genesis", **options, out=tmp_path / "soil.usda")
    with pytest.raises(InputError, match="did you mean 'newton'"):
        tune("newtom", **options)
    assert set(TUNED) == set(ENGINES)


@pytest.mark.parametrize(("name", "module"), [("newton", "newton"), ("genesis", "genesis")])
def test_a_missing_package_is_named_with_the_line_to_type(name, module, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"pip install 'terraphi\[tune-{name}\]'"):
        tune(name, voxel=0.03, foot="disc:0.05", phi=33.0)


def test_the_event_of_isaac_lab_draws_for_the_environments_that_are_reset(monkeypatch) -> None:
    torch = pytest.importorskip("torch")
    phi = {"median": 30.0, "ci68": [29.0, 31.0], "ci95": [28.0, 32.0]}
    answer = {
        "phi_deg": {**phi, "yield": "plane_strain"}, "phi_plane_strain_deg": phi,
        "verdict": "consistent", "density_kg_m3": 1600.0, "law": "foot",
    }  # fmt: skip
    stored = StoredAnswer("answer", answer, np.linspace(28.0, 32.0, 51))
    parameters = export(stored, to="isaaclab", draws=8)
    module: dict[str, Any] = {}
    exec(text(parameters, "python"), module)
    world = torch.tensor([-1, 0, 0, 1, 1, 2, 2], dtype=torch.int32)
    friction = torch.zeros(7)
    model = SimpleNamespace(particle_world=world, mpm=SimpleNamespace(friction=friction))
    fakes = {
        "warp": SimpleNamespace(to_torch=lambda array: array),
        "isaaclab_newton": ModuleType("isaaclab_newton"),
        "isaaclab_newton.physics": SimpleNamespace(
            NewtonManager=SimpleNamespace(get_model=lambda: model)
        ),
    }
    for name, fake in fakes.items():
        monkeypatch.setitem(sys.modules, name, fake)
    environment = SimpleNamespace(num_envs=3)
    module["draw_friction"](environment, torch.tensor([0, 2], dtype=torch.int32))
    assert friction[[0, 3, 4]].tolist() == [0.0, 0.0, 0.0]
    assert friction[1] == friction[2]
    assert friction[5] == friction[6]
    given = torch.tensor(module["DRAWS"])
    assert all((given - value).abs().min() < 1e-6 for value in friction[[1, 5]])
    for values in (None, slice(None)):
        friction.zero_()
        module["draw_friction"](environment, values)
        assert (friction[1:] > 0).all()
        assert friction[0] == 0.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # theirs
@pytest.mark.parametrize("name", ["newton", "genesis"])
def test_the_simulator_itself_carries_more_with_more_friction(name: str) -> None:
    """Presses of the package, where it is installed: a tiny bed, forces by two ways."""
    pytest.importorskip(name)
    sole = Sole.of("disc:0.05")
    press = Press(sole, 0.03, 0.02, 1600.0, 0.5, 0.01)
    law = simulator(name).law
    weak, strong = (ENGINES[name](press, law.value(q)) for q in (0.3, 0.9))
    assert strong[0][-1] == pytest.approx(0.02, rel=0.1)
    means = [force[sinkage > 0].mean() for sinkage, force in (weak, strong)]
    assert 1.0 < means[0] < means[1] < 2000.0
    if name == "newton":  # its soil is rigid: the factor of density rests on this
        heavy = ENGINES[name](tuning.replace(press, density=3200.0), law.value(0.9))
        assert heavy[1][heavy[0] > 0].mean() == pytest.approx(2 * means[1], rel=0.02)
