"""Law ``legs`` against a law that is known exactly, simulations, and similarity."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import qmc

import terraphi
from restricted import hyperparameters, left_out
from terraphi import Rig, invert
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.rig import Ratios, similar_scenario
from terraphi.experiment.scenario import GRAVITY, Scenario
from terraphi.forward.rft import from_plane_strain, leg_force
from terraphi.inference.likelihood import Likelihood
from terraphi.inference.records import open_record
from terraphi.laws.law import LegLaw
from terraphi.laws.legs import (
    PLACES,
    Legs,
    cases_of,
    cells_in,
    reach,
    shipped_legs,
)
from terraphi.laws.named import law_named, stored
from terraphi.laws.store import Case, Library
from terraphi.laws.theory import Theory

STUDY = Path(__file__).parents[2] / "studies" / "data" / "legs"
THETA = np.arange(-130.0, 131.0)
SIZES = {"leg": "straight", "thickness_mm": 8.0}


def theory(rig: Rig, phi_deg: float, mu: float = 0.3) -> np.ndarray:
    """Forces by resistive force theory over ρ g L³ [-], at THETA, shape [2, theta]."""
    base = Scenario.load("quick")
    scenario = base.replace(**{
        "soil.friction_angle_deg": float(from_plane_strain(phi_deg)),
        "soil.density": 1000.0, "leg.friction": mu, "leg.chord": rig.length,
        "leg.width": 1e-3 * rig.width_mm, "leg.half_thickness": 5e-4 * rig.thickness_mm,
        "motion.hip.1": base.bed.surface + 1e-3 * rig.hip_height_mm,
    })  # fmt: skip
    force, _ = leg_force(scenario, scenario.motion.poses_at(np.radians(THETA)))
    return force.T / (1000.0 * GRAVITY * rig.length**3)


def rig_of(x: np.ndarray, length_mm: float = 80.0) -> Rig:
    """Rig of a width, height of the hip and thickness over the length."""
    width, height, thickness = (float(length_mm * item) for item in x)
    return Rig(leg="straight", length_mm=length_mm, width_mm=width, thickness_mm=thickness,
               hip_height_mm=height, hip_height_sd_mm=0.0)  # fmt: skip


@pytest.fixture(scope="module")
def exact() -> Legs:
    """A law fitted to resistive force theory at 64 points of the box."""
    unit = qmc.Sobol(5, rng=2).random_base2(6)
    points = qmc.scale(unit, [12.0, 0.1, np.log(0.15), 0.0, 0.03], [44.0, 0.6, 0.0, 0.6, 0.15])
    x, depth, force = [], [], []
    for phi, mu, width, height, thickness in points:
        rig = rig_of(np.array([np.exp(width), height, thickness]))
        first, last, deep = reach("straight", rig.ratios)
        at = 0.5 * (first + last + (last - first) * PLACES)
        curves = theory(rig, phi, mu) / (rig.ratios.width * deep**2)
        x.append([phi, mu, *rig.ratios, 0.0, 1.0, 0.0])
        depth.append(deep)
        force.append([np.interp(at, THETA, row) for row in curves])
    law = Legs(np.array(x), np.array(depth), np.array(force))
    return replace(law, hyper=hyperparameters(*law.training))


def test_a_known_law_is_met_between_its_cases(exact: Legs) -> None:
    """Size and shape of the forces on rigs and frictions that it has not seen."""
    rng = np.random.default_rng(5)
    difference, stated = [], []
    for _ in range(25):
        rig = rig_of(rng.uniform([0.2, 0.05, 0.04], [0.9, 0.55, 0.13]), float(rng.uniform(40, 200)))
        phi, mu = rng.uniform(16.0, 40.0), rng.uniform(0.15, 0.55)
        law = exact.law(rig.model_copy(update={"leg_friction": mu}))
        result = law(np.array([[phi]]))[0] / (law.density * GRAVITY * rig.length**3)
        truth = np.array([np.interp(law.theta_deg, THETA, row) for row in theory(rig, phi, mu)])
        size = np.sqrt(np.square(truth).mean())
        difference.append(np.sqrt(np.square(result - truth).mean()) / size)
        factor = law.errors(np.array([phi]), 0.0, is_measured=True)["emulator"]
        reference = np.sqrt(np.square(factor).sum(axis=1).mean())
        stated.append(reference / (law.density * GRAVITY * rig.length**3 * size))
    assert np.median(difference) < 0.04
    assert np.max(difference) < 0.15
    # The stated error is that of the smooth part; jumps of this law where a face turns are not.
    assert 0.2 < np.median(stated) / np.median(difference) < 2.0


def test_forces_grow_with_the_cube_of_the_length() -> None:
    """The same record on a leg and grains of twice the size, forces eight times as large."""
    small = {"length_mm": 90.0, "width_mm": 40.0, "hip_height_mm": "30±1", **SIZES}
    large = {**{k: 2.0 * v for k, v in small.items() if isinstance(v, float)},
             "leg": "straight", "hip_height_mm": "60±2"}  # fmt: skip
    law = shipped_legs().law(Rig(**small))
    theta = np.radians(law.theta_deg)
    force = law(np.array([[31.0]]))[0].T
    answer, other = (
        invert(ForceHistory(theta, size**3 * force), rig=rig, density="1650±0",
               noise=0.02 * size**3, grain_size_mm=float(size))
        for size, rig in ((1, small), (2, large))
    )  # fmt: skip
    assert answer.law == other.law == "legs"
    assert other.phi.median == pytest.approx(answer.phi.median, abs=1e-3)
    assert other.phi.sd == pytest.approx(answer.phi.sd, rel=1e-3)


def test_resistive_force_theory_is_of_the_record_s_own_rig() -> None:
    """Whether its model is taken as exact or not."""
    rig = Rig(hip_height_mm="35±1", **{**SIZES, "length_mm": 110, "width_mm": 40})
    law = Theory().law(rig)
    history = ForceHistory(np.radians(law.theta_deg), law(np.array([[30.0]]))[0].T)
    for simulated in (True, False):
        options = {"rig": rig, "density": "1650±1", "law": "rft3d", "simulated": simulated}
        assert invert(history, **options).phi.median == pytest.approx(30.0, abs=1e-3)


def test_uncertain_sizes_are_what_a_change_of_them_does() -> None:
    """One standard deviation of the hip's height and of the leg's friction, either way."""
    sizes = {"length_mm": 110, "width_mm": 45, **SIZES}
    rig = Rig(hip_height_mm="35±1.5", leg_friction="0.35±0.04", **sizes)
    x, law = np.array([[28.0]]), shipped_legs().law(rig)
    for cause, ends in {
        "hip height": [{"hip_height_mm": 33.5}, {"hip_height_mm": 36.5}],
        "leg friction": [{"leg_friction": 0.31}, {"leg_friction": 0.39}],
    }.items():
        below, above = (shipped_legs().law(rig.model_copy(update=end))(x)[0] for end in ends)
        expected = 0.5 * (above - below)
        mode = law.errors(x[0], 0.0, is_measured=True)[cause].reshape(expected.shape)
        np.testing.assert_allclose(mode, expected, atol=0.15 * np.abs(expected).max())


@pytest.mark.parametrize("length", [76.2, 200.0])
def test_the_moment_alone_is_read_in_any_size(length: float) -> None:
    """Of resistive force theory, whose lever arms it has: as both of its forces are read."""
    ratio = length / 76.2
    rig = Rig(leg="straight", length_mm=length, width_mm=25.4 * ratio, thickness_mm=6.4 * ratio,
              hip_height_mm=20.0 * ratio, hip_height_sd_mm=0.5 * ratio)  # fmt: skip
    rig_law = Theory().law(rig)
    force = rig_law(np.array([[25.0]]))[0]
    theta, arm = np.radians(rig_law.theta_deg), rig_law.arm
    options = {"rig": rig, "density": "1650±1", "law": "legs"}
    answer = invert(ForceHistory(theta, force.T), **options)
    moment = ForceHistory(theta, np.zeros((theta.size, 0)), axes=(), moment=(arm * force).sum(0))
    alone = invert(moment, **options)
    assert alone.phi.median == pytest.approx(answer.phi.median, abs=2.5)


@pytest.mark.parametrize(("length", "density"), [(80.0, 1500.0), (160.0, 1700.0)])
def test_a_cohesion_is_found_in_pascals(length: float, density: float) -> None:
    """Of the law's own forces; its prior takes a part of it, and the interval includes that."""
    rig = Rig(leg="straight", length_mm=length, width_mm=0.5 * length, thickness_mm=0.08 * length,
              hip_height_mm=0.3 * length, hip_height_sd_mm=0.5)  # fmt: skip
    law, number = shipped_legs().law(rig), 0.08
    force = density / law.density * law(np.array([[29.0]]), number)[0].T
    answer = invert(ForceHistory(np.radians(law.theta_deg), force), rig=rig,
                    density=f"{density}±1", cohesion="unknown")  # fmt: skip
    pascals = number * density * GRAVITY * rig.length
    assert answer.cohesion_pa == pytest.approx(pascals, rel=0.35)
    assert answer.cohesion_pa < pascals
    median = answer.phi.median
    read = median + float(shipped_legs().error.offset(rig, 0.0, np.array(median)))
    assert 0.0 < read - 29.0 < 2.0 * answer.budget_deg["cohesion"]


def test_the_hash_changes_with_all_that_changes_an_answer() -> None:
    law = shipped_legs()
    changes = [
        {"model_error": {"legs": {"soil_sd_deg": 1.0}}}, {"force": 1.1 * law.force},
        {"hyper": 0.5 * law.hyper}, {"error_scale": 2.0 * law.error_scale},
    ]  # fmt: skip
    remaining = [replace(law, **change) for change in changes]
    assert len({law.hash, *(other.hash for other in remaining)}) == 1 + len(remaining)


@pytest.mark.parametrize("leg", ["straight", "c", "reversed_c"])
def test_it_is_the_law_of_li_s_leg_there(leg: str) -> None:
    """As large as the simulations of that leg in the same cells."""
    rig, data = Rig.of("li2013", leg), STUDY.parent / "libraries"
    for scenario, history, _ in Library.load(data / "sand3d-simulated.nc").cases:
        if scenario.leg.shape == leg:
            law = shipped_legs().law(rig, cells_in(scenario, rig))
            theta = np.radians(law.theta_deg[16:-16])
            result = law(np.array([[scenario.soil.friction_angle_deg]]))[0, :, 16:-16]
            expected = history.means(theta, np.radians(0.5)).T
            error = np.sqrt(np.square(result - expected).mean())
            assert error < 0.08 * np.ptp(expected, axis=1).max()  # one seed


def test_cases_are_predicted_by_the_others_as_well_as_it_says() -> None:
    difference, sd = left_out(shipped_legs())
    assert np.median(np.abs(difference[:, 0])) < 0.03
    assert 0.6 < np.mean(np.abs(difference) < sd) < 0.76
    assert 0.9 < np.mean(np.abs(difference) < 1.96 * sd) < 0.99


def damp_cases() -> list[list[float]]:
    """φ [deg], width and height [m], cohesion [Pa] and forces [N] of simulations."""
    with (STUDY / "coarse.csv").open() as file:
        rows = list(csv.reader(line for line in file if line[0] not in "#p"))
    table = np.array([[float(v) for v in row] for row in rows])
    return table[(table[:, 3] > 30.0) & (table[:, 0] < 40.0)].tolist()


def test_soil_with_cohesion_is_not_soil_of_a_larger_angle() -> None:
    """Simulations with a cohesion, read as dry and as of an unknown one."""
    errors: list[float] = []
    dry: list[float] = []
    for phi, width, height, _, *values in damp_cases():
        rig = Rig(leg="straight", length_mm=76.2, width_mm=1e3 * width, thickness_mm=6.4,
                  hip_height_mm=1e3 * height, hip_height_sd_mm=0.0)  # fmt: skip
        force = np.reshape(values, (2, -1)).T
        history = ForceHistory(np.radians(np.arange(-84.0, 81.0, 4.0)), force)
        for angles, cohesion in ((errors, "unknown"), (dry, "0")):
            record = open_record(history, rig=rig, density="1650±0", cohesion=cohesion)
            angles.append(Likelihood([record], shipped_legs()).least_squares - phi)
    assert len(errors) > 5
    assert np.sqrt(np.mean(np.square(errors))) < 0.45 * np.sqrt(np.mean(np.square(dry)))


def test_the_cohesion_does_not_depend_on_how_often_a_leg_is_read() -> None:
    """A reading each degree, or each four degrees."""
    rig = Rig(leg="straight", length_mm=80, width_mm=40, thickness_mm=6.4, hip_height_mm="24±0.5")
    law = shipped_legs().law(rig)
    force = law(np.array([[29.0]]), 0.08)[0].T
    fine, rough = (
        invert(
            ForceHistory(np.radians(law.theta_deg[::n]), force[::n]),
            rig=rig,
            density="1650±1",
            cohesion="unknown",
        )
        for n in (1, 4)
    )
    assert rough.phi.median == pytest.approx(fine.phi.median, abs=0.3)
    assert rough.cohesion_pa == pytest.approx(fine.cohesion_pa, rel=0.15)


@pytest.mark.parametrize(
    ("rig", "why"),
    [
        ({**SIZES, "leg": "c", "length_mm": 90, "width_mm": 5, "hip_height_mm": 30}, "width over"),
        ({**SIZES, "length_mm": 90, "width_mm": 150, "hip_height_mm": 30}, "width over length"),
        ({**SIZES, "length_mm": 90, "width_mm": 40, "hip_height_mm": 80}, "hip height over"),
    ],
)
def test_other_rigs_are_refused_with_the_line_to_type(rig: dict, why: str) -> None:
    with pytest.raises(InputError, match=f"{why}.*terraphi library build --leg"):
        shipped_legs().law(Rig(**rig))


def test_a_written_law_is_the_same(tmp_path: Path) -> None:
    law = shipped_legs()
    law.save(tmp_path / "law.nc")
    again = Legs.load(tmp_path / "law.nc")
    assert again.hash == law.hash
    rig = Rig(leg="straight", length_mm=90, width_mm=40, thickness_mm=8, hip_height_mm=30)
    x = np.array([[20.0], [40.0]])
    laws: list[LegLaw] = [law.law(rig), again.law(rig)]
    np.testing.assert_allclose(laws[1](x, 0.1), laws[0](x, 0.1), rtol=1e-6)


def own_library(width: float, larger: float) -> Library:
    """Of a leg wider than any of the law: forces as it continues them, all larger by a factor."""
    law, cases = shipped_legs(), []
    ratios = Ratios(width, 0.3, 0.09)
    first, last, depth = reach("straight", ratios)
    for phi in (15.0, 25.0, 35.0, 45.0):
        scenario = similar_scenario("straight", ratios, friction_angle_deg=phi, leg_friction=0.3)
        rig = Rig.of_scenario(scenario)
        x = np.array([[phi, 0.3, *rig.ratios, 0.0, cells_in(scenario, rig), 0.0]])
        size = scenario.soil.density * GRAVITY * rig.length**3 * width * depth**2
        theta = np.radians(0.5 * (first + last + (last - first) * PLACES))
        force = larger * size * law(x, np.array([depth]))[0].T
        cases.append(Case(scenario, ForceHistory(theta, force)))
    return Library("wide", tuple(cases))


def test_simulations_of_one_s_own_leg_join_the_law(tmp_path: Path) -> None:
    """It has their forces, and between their angles what lies there; others stay as they are."""
    library = own_library(1.4, 1.15)
    joined, rig = shipped_legs().joined(library), Rig.of_scenario(library.scenario)
    with pytest.raises(InputError, match="width over length"):
        shipped_legs().law(rig)
    rig_law = joined.law(rig)
    forces = {
        scenario.soil.friction_angle_deg: np.stack(
            [np.interp(rig_law.theta_deg, history.theta_deg, row, 0.0, 0.0)
             for row in history.force.T]
        )
        for scenario, history, _ in library.cases
    }  # fmt: skip
    # At the angles of the library and, by the geometric mean of its sizes, between two of them.
    forces[30.0] = np.sign(forces[25.0]) * np.sqrt(np.abs(forces[25.0] * forces[35.0]))
    for phi in (25.0, 30.0, 35.0):
        result = rig_law(np.array([[phi]]))[0]
        difference = np.sqrt(np.square(result - forces[phi]).mean())
        assert difference < 0.03 * np.ptp(forces[phi])
    with pytest.raises(InputError, match="width over length"):
        joined.law(rig.model_copy(update={"width_mm": 1.2 * rig.width_mm}))
    li = Rig.of("li2013", "straight")
    before, after = (law.law(li)(np.array([[30.0]])) for law in (shipped_legs(), joined))
    np.testing.assert_allclose(after, before, atol=0.01 * np.ptp(before))
    assert joined.error == shipped_legs().error
    for write in (joined.save, joined.to_netcdf):
        with pytest.raises(InputError, match="keep the library's own file"):
            write(tmp_path / "joined.nc")
    assert not [*tmp_path.iterdir()]


def test_a_library_of_one_rig_is_read_with_the_law(tmp_path: Path) -> None:
    own_library(1.4, 1.15).save(tmp_path / "wide.nc")
    law = law_named(tmp_path / "wide.nc")
    assert isinstance(law, Legs)
    assert law.name == "wide"
    assert isinstance(stored(tmp_path / "wide.nc"), Library)
    assert law_named("sand3d") is law_named("legs")
    with pytest.raises(InputError, match="keep the library's own file"):
        law.save(tmp_path / "again.nc")
    shipped_legs().save(tmp_path / "law.nc")
    assert law_named(tmp_path / "law.nc").hash == shipped_legs().hash


def test_a_library_of_other_soil_or_of_a_part_of_the_stroke_is_refused(tmp_path: Path) -> None:
    library = own_library(1.4, 1.15)
    other = [
        case._replace(scenario=case.scenario.replace(**{"soil.dilation_angle_deg": 10.0}))
        for case in library.cases
    ]
    front, end = (
        [case._replace(history=case.history.between(*np.radians(ends))) for case in library.cases]
        for ends in ([-44.0, 90.0], [-90.0, 44.0])
    )
    for cases, why in ((other, "from law legs in soil.dilation_angle_deg"),
                       (front, "do not turn from air to air"),
                       (end, "do not turn from air to air")):  # fmt: skip
        replace(library, cases=tuple(cases)).save(tmp_path / "other.nc")
        with pytest.raises(InputError, match=f"library wide.*{why}"):
            law_named(tmp_path / "other.nc")


@pytest.mark.parametrize("leg", ["c", "reversed_c"])
def test_simulations_of_a_leg_with_a_low_hip_join_the_law(leg: str) -> None:
    """It is in soil beyond the last angle that is simulated, or before level soil is reached."""
    scenario = similar_scenario(
        leg, Ratios(0.33, 0.1, 0.08), friction_angle_deg=30.0, leg_friction=0.3
    )
    motion = scenario.motion
    theta = np.linspace(*np.radians([motion.start_deg, motion.stop_deg]), 400)
    history = ForceHistory(theta, np.cos(theta)[:, None] * [1.0, 1.0])
    assert len(cases_of(Library("low", (Case(scenario, history),)))[0]) == 1


def test_a_leg_that_other_shapes_may_not_have_is_answered() -> None:
    """Each record is compared with the same leg in other shapes, which the law may not know."""
    law = shipped_legs()
    thickest = {leg: law.ranges(leg)["thickness"][1] for leg in law.legs}
    leg = max(thickest, key=lambda one: thickest[one])
    thickness = 50.0 * (thickest[leg] + min(thickest.values()))
    rig = Rig(leg=leg, length_mm=100, width_mm=40, thickness_mm=thickness, hip_height_mm=30)
    rig_law = law.law(rig)
    history = ForceHistory(np.radians(rig_law.theta_deg), rig_law(np.array([[30.0]]))[0].T)
    assert invert(history, rig=rig, density="1600±10").verdict == "consistent"


def test_forces_of_a_rig_and_their_slope_are_those_of_the_theory(exact: Legs) -> None:
    """As resistive force theory has them; its slope by differences over 4°."""
    rig, phi = rig_of(np.array([0.4, 0.2, 0.08]), 110.0), [24.0, 31.0]
    curves = exact.forces(rig, phi, density=1500.0)
    assert curves.forces.dims == curves.slope.dims == ("phi_deg", "force", "theta_deg")
    assert curves.force.values.tolist() == ["Fx", "Fz"]
    unit = 1500.0 * GRAVITY * 0.11**3
    for i, angle in enumerate(phi):
        below, at, above = (
            unit * np.array([np.interp(curves.theta_deg, THETA, row) for row in theory(rig, item)])
            for item in (angle - 2.0, angle, angle + 2.0)
        )
        slope = (above - below) / 4.0
        for result, expected in ((curves.forces[i], at), (curves.slope[i], slope)):
            rms = np.sqrt(np.square(expected).mean())
            assert float(np.sqrt(np.square(result - expected).mean())) < 0.08 * rms


def test_a_moment_is_no_larger_than_a_force_at_the_tip_and_cohesion_adds() -> None:
    dry, damp = (
        law_named("legs").forces("li2013", 30.0, leg="c", cohesion_pa=pascals)
        for pascals in (0.0, 100.0)
    )
    size = np.sqrt(np.square(dry.forces).sum("force"))
    assert (abs(dry.moment) <= 1.05 * 0.0762 * size + 1e-3).all()
    assert float(damp.forces.sel(force="Fz").max()) > float(dry.forces.sel(force="Fz").max())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"phi_deg": 5.0}, "10 to 55 deg by law legs"),
        ({"density": 1.0}, "density = 1: 100 to 10000 kg"),
        ({"cohesion_pa": 1e5}, "cohesion_pa = 100000"),
        ({"leg": None}, "lacks its leg"),
    ],
)
def test_forces_outside_a_law_are_refused(options: dict[str, Any], words: str) -> None:
    given = {"rig": "li2013", "phi_deg": 30.0, "leg": "c", **options}
    with pytest.raises(InputError, match=words):
        law_named("legs").forces(**given)


def test_angles_that_are_listed_are_those_that_are_accepted() -> None:
    summary = law_named("legs").summary()
    low, high = summary["phi_deg"]
    for leg, ranges in summary["ranges"].items():
        assert list(ranges["phi_deg"]) == [low, high]
        law_named("legs").forces(rig="li2013", leg=leg, phi_deg=[low, high])
        for outside in (low - 0.1, high + 0.1):
            with pytest.raises(InputError, match=f"{low:g} to {high:g}"):
                law_named("legs").forces(rig="li2013", leg=leg, phi_deg=outside)
    with pytest.raises(InputError, match=f"{low:g} to {high:g}"):
        terraphi.plan("li2013", leg="c", phi_deg=low)
