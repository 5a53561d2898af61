"""The inversion from end to end, on forces whose friction angle is known."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import arviz
import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.soil import plane_strain_friction_angle_deg
from terraphi.forward import simulate
from terraphi.inference import friction_angle
from terraphi.inference.answer import PHI, AngleSummary, Inversion, plane_strain_summary
from terraphi.inference.inversion import invert
from terraphi.inference.trials import Trial
from terraphi.inference.words import of_doubt
from terraphi.library.store import Library

PHI_DEG = 31.3


@pytest.fixture(scope="module")
def library() -> Library:
    return Library.load("rft3d")


def rft_history(phi_deg: float, leg: str = "straight") -> ForceHistory:
    scenario = {
        "model": "rft",
        "dimensions": 3,
        "leg": {"shape": leg, "friction": 0.40},
        "soil": {"friction_angle_deg": phi_deg},
    }
    return simulate(Scenario.model_validate(scenario))


@pytest.fixture(scope="module")
def history() -> ForceHistory:
    return rft_history(PHI_DEG)


@pytest.fixture(scope="module")
def found(history: ForceHistory, library: Library) -> Inversion:
    return invert(history, library=library)


def test_known_angle_is_found(found: Inversion) -> None:
    assert found.phi.median == pytest.approx(PHI_DEG, abs=0.1)
    # No word on the interval: the paper's likelihood knows nothing of the surrogate's own error,
    # all there is here where the forces are without noise.
    assert found.verdict.verdict == "consistent"
    assert max(found.record.nrmsd.values()) < 0.01


def test_what_a_history_says_of_its_leg_and_its_density_is_taken() -> None:
    library, poppy = Library.load("resolved"), measurement("li2013:poppy_loose/c")
    for given in (poppy, poppy.history):
        answer = invert(given, library=library)
        assert (answer.record.leg, answer.record.leg_assumed) == ("c", False)
        assert (answer.density, answer.density_assumed) == (638.0, False)
    nameless = replace(poppy.history, provenance={})
    answer = invert(nameless, library=library)
    assert (answer.record.leg, answer.record.leg_assumed) == ("straight", True)
    assert invert(nameless, library=library, leg="c").record.leg_assumed is False


def test_a_library_may_be_named() -> None:
    record = measurement("li2013:yuma/straight")
    named, loaded = (
        invert(record, library=library) for library in ("rft3d", Library.load("rft3d"))
    )
    assert (named.library, named.phi) == (loaded.library, loaded.phi)
    with pytest.raises(InputError, match="sand3e"):
        invert(record, library="sand3e")


def test_nameless_histories_are_judged_as_named_ones() -> None:
    trials = [Trial.of(measurement(f"li2013:yuma/{leg}")) for leg in ("straight", "c")]
    louder = [replace(t, history=t.history.scaled(1.1)) for t in trials]
    nameless = [replace(t, source="") for t in louder]
    library = Library.load("resolved")
    named, other = (invert(each, library=library) for each in (louder, nameless))
    assert [m.most for m in other.verdict.measures] == [m.most for m in named.verdict.measures]
    assert [record.source for record in other.records] == ["history 1", "history 2"]


def test_what_is_no_leg_angle_or_no_leg_of_the_library_is_refused(library: Library) -> None:
    simulated = rft_history(PHI_DEG)
    with pytest.raises(InputError, match="has no leg 'strait'"):
        invert(simulated, library=library, leg="strait")
    pressed = ForceHistory(np.linspace(0.0, 0.1, 50), np.ones((50, 2)), coordinate="displacement")
    with pytest.raises(InputError, match="expected forces over the leg angle"):
        invert(pressed, library=library)
    with pytest.raises(InputError, match="seed = -1"):
        invert(simulated, library=library, seed=-1)


def test_intervals_nest_and_the_band_holds_the_best_curve(found: Inversion) -> None:
    (low95, high95), (low68, high68) = found.phi.ci95, found.phi.ci68
    assert low95 < low68 < found.phi.median < high68 < high95
    assert np.all(found.record.band[0] <= found.record.best + 1e-9)
    assert np.all(found.record.best <= found.record.band[1] + 1e-9)


def test_density_scales_the_curves(
    history: ForceHistory, library: Library, found: Inversion
) -> None:
    # Half the forces from soil of half the density is the same soil.
    light = invert(history.scaled(0.5), library=library, density=0.5 * 1650.0)
    assert light.phi.median == pytest.approx(found.phi.median, abs=1e-6)
    assert not light.density_assumed
    # What was simulated says its density; of what says none the library's is assumed.
    assert not found.density_assumed
    assert invert(replace(history, provenance={}), library=library).density_assumed
    assert found.density == 1650.0


def test_wrong_density_moves_the_angle(history: ForceHistory, library: Library) -> None:
    assert invert(history, library=library, density=1300.0).phi.median > PHI_DEG + 1.0


def test_emcee_agrees_with_quadrature(
    history: ForceHistory, library: Library, found: Inversion
) -> None:
    sampled = invert(history, library=library, sampler="emcee", seed=3)
    error = sampled.convergence_of(PHI)["median_standard_error"]
    assert abs(sampled.phi.median - found.phi.median) < 3.0 * error
    assert (sampled.sampler, sampled.seed) == ("emcee", 3)
    assert "not_converged" not in {doubt.code for doubt in sampled.warnings}


def test_draws_of_the_angle_that_have_not_converged_are_doubted(
    history: ForceHistory, library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    hasty = partial(friction_angle.sample, steps=20, doublings=0)
    monkeypatch.setattr(friction_angle, "sample", hasty)
    found = invert(history, library=library, sampler="emcee")
    assert "not_converged" in {doubt.code for doubt in found.warnings}


def test_another_leg_is_not_believed(library: Library) -> None:
    passed_off = invert(rft_history(PHI_DEG, "reversed_c"), library=library, leg="straight")
    assert passed_off.verdict.verdict in {"misfit", "out_of_range"}


@pytest.mark.parametrize(("phi_deg", "edge"), [(12.0, "low"), (55.0, "high")])
def test_soil_beyond_the_library_is_out_of_range(
    phi_deg: float, edge: str, library: Library
) -> None:
    beyond = invert(rft_history(phi_deg), library=library)
    assert beyond.verdict.verdict == "out_of_range"
    assert beyond.verdict.edge == edge


def test_an_answer_at_a_prompt_fits_in_ten_lines(found: Inversion) -> None:
    lines = repr(found).splitlines()
    assert len(lines) <= 10
    assert max(map(len, lines)) <= 100
    told = repr(found)
    for word in (found.record.leg, found.library, found.verdict.verdict, f"{found.phi.median:.2f}"):
        assert word in told


def test_answer_has_the_keys_that_programs_rely_on(found: Inversion) -> None:
    answer = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert set(answer["phi_deg"]) == {"median", "sd", "ci68", "ci95", "yield"}
    assert answer["phi_deg"]["yield"] == "rft3d"
    assert answer["phi_plane_strain_deg"] is None
    assert "empirical law" in answer["phi_plane_strain_reason"]
    assert set(answer["nrmsd"]) == {"Fx", "Fz"}
    assert answer["n_angles"] == 40
    relied_on = {"phi_deg", "phi_plane_strain_deg", "verdict", "reason", "edge", "nrmsd"}
    relied_on |= {"density_kg_m3", "n_angles", "library", "sampler", "convergence"}
    besides = {"phi_plane_strain_reason", "density_assumed", "source", "leg", "likelihood", "seed"}
    besides |= {"provenance", "error_budget", "warnings", "data", "measures", "leg_assumed"}
    besides |= {"library_reason", "compared_with_known_soils"}
    assert set(answer) == relied_on | besides | {"histories", "parameters", "fixed"}
    assert answer["warnings"] == []
    assert answer["provenance"]["library_hash"]


@pytest.mark.parametrize("sampler", ["quadrature", "emcee"])
def test_posterior_file_opens_in_arviz(
    sampler: str, history: ForceHistory, library: Library, tmp_path
) -> None:
    made = invert(history, library=library, sampler=sampler)
    made.to_netcdf(tmp_path / "posterior.nc")
    opened = arviz.from_netcdf(str(tmp_path / "posterior.nc"))
    draws = np.asarray(opened["posterior"]["phi_deg"])
    assert draws.ndim == 2
    width = made.phi.ci68[1] - made.phi.ci68[0]
    assert np.median(draws) == pytest.approx(made.phi.median, abs=0.05 * width)
    low, high = np.quantile(draws, [0.16, 0.84])
    assert high - low == pytest.approx(width, rel=0.1)
    assert np.asarray(opened["observed_data"]["Fx"])[0] == pytest.approx(made.record.observation.Fx)
    assert "prior" in opened


def test_plane_strain_equivalent_maps_the_quantiles() -> None:
    phi = AngleSummary(30.0, (28.0, 32.0), (26.0, 34.0))
    found, reason = plane_strain_summary(phi, Scenario())
    assert found is not None
    assert reason == ""
    assert found.median == pytest.approx(13.35, abs=0.01)
    assert found.ci95[1] == pytest.approx(plane_strain_friction_angle_deg(34.0, "paper"))


def test_equivalent_of_associated_flow_takes_the_angle_as_its_dilation() -> None:
    scenario = Scenario.model_validate(
        {"soil": {"yield_criterion": "triaxial", "flow": "associated"}}
    )
    phi = AngleSummary(25.0, (24.0, 26.0), (23.0, 27.0))
    found, _ = plane_strain_summary(phi, scenario)
    assert found is not None
    assert found.median == pytest.approx(37.0, abs=0.05)


def test_no_equivalent_is_said_with_the_reason() -> None:
    scenario = Scenario.model_validate({"soil": {"yield_criterion": "triaxial"}})
    found, reason = plane_strain_summary(AngleSummary(41.0, (40.0, 42.0), (39.0, 43.0)), scenario)
    assert found is None
    assert "43" in reason


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"likelihood": "papr"}, "did you mean 'paper'"),
        ({"sampler": "emce"}, "did you mean 'emcee'"),
        ({"density": -1.0}, "not that of a soil"),
        ({"density": float("nan")}, "not that of a soil"),
        ({"density": 1.65}, "not that of a soil"),
        ({"leg": "plate"}, "it has c, reversed_c, straight"),
    ],
)
def test_unusable_options(
    options: dict, words: str, history: ForceHistory, library: Library
) -> None:
    with pytest.raises(InputError, match=words):
        invert(history, library=library, **options)


def test_forces_in_another_unit_are_refused(history: ForceHistory, library: Library) -> None:
    with pytest.raises(InputError, match="in newtons"):
        invert(history.scaled(1e9), library=library)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"leg.width": 0.0127}, "leg.width"),
        ({"leg.chord": 0.08}, "leg.chord"),
        ({"motion.hip": [0.15, 0.2]}, "hip above the surface"),
    ],
)
def test_a_leg_of_another_size_is_refused(change: dict, name: str, library: Library) -> None:
    scenario = Scenario.model_validate({"model": "rft", "dimensions": 3}).replace(**change)
    with pytest.raises(InputError, match=name):
        invert(simulate(scenario), library=library)


def test_a_history_of_another_model_is_told_apart(library: Library) -> None:
    # A newcomer simulated with the paper's yield, inverted with plane strain, and was believed.
    case = Library.load("quick-paper-truths").cases[2]
    assert case.history is not None
    answer = invert(case.history, library=Library.load("quick-plane-strain"))
    (warning,) = answer.warnings
    assert warning.code == "unlike"
    assert ("soil.yield_criterion", "paper", "plane_strain") in warning.numbers["differences"]
    (said,) = answer.as_dict()["warnings"]
    assert said == of_doubt(warning)
    assert said in answer.reason
    by_law = invert(case.history, library=library)
    assert by_law.warnings[0].numbers["differences"] == [("model", "mpm", "rft")]


def test_forces_that_leave_phi_as_unknown_as_it_was_are_remarked_on(library: Library) -> None:
    found = invert(measurement("li2013:yuma/straight").history, library=Library.load("paper"))
    (remark,) = (doubt for doubt in found.warnings if doubt.code == "uninformed")
    assert np.ptp(found.phi.ci68) == pytest.approx(0.68 * 20.0, rel=0.05)
    assert of_doubt(remark) in found.reason


def test_another_gravity_is_another_model(library: Library) -> None:
    scenario = library.cases[0].scenario.replace(**{"bed.gravity": 1.62})
    found = invert(simulate(scenario), library=library)
    (unlike,) = (said for said in found.warnings if said.code == "unlike")
    assert unlike.numbers["differences"] == [("bed.gravity", 1.62, 9.81)]


def test_what_an_inversion_allows_for_is_no_other_model(library: Library) -> None:
    own = Library.load("quick-plane-strain")
    truth = Library.load("quick-plane-strain-truths").cases[4]  # another angle, another seed
    assert truth.history is not None
    assert invert(truth.history, library=own).warnings == ()
    rough = simulate(
        Scenario.model_validate(
            {"model": "rft", "dimensions": 3, "leg": {"friction": 0.6}, "soil": {"density": 1500.0}}
        )
    )
    (warning,) = invert(rough, library=library, density=1500.0).warnings
    assert warning.numbers["differences"] == [("leg.friction", 0.6, 0.4)]


def test_a_record_that_ends_with_the_window_loses_nothing(
    history: ForceHistory, library: Library, found: Inversion
) -> None:
    # Its end windows are half as wide; the library's must be, too.
    cut = invert(history.engaged(), library=library)
    assert cut.phi.median == pytest.approx(found.phi.median, abs=0.02)
    assert max(cut.record.nrmsd.values()) < 1.2 * max(found.record.nrmsd.values())


def test_a_sensor_stuck_at_an_offset_is_refused(history: ForceHistory, library: Library) -> None:
    stuck = history.force.copy()
    stuck[:, 0] = 1.0
    with pytest.raises(InputError, match="Fx is 1 N at every angle"):
        invert(ForceHistory(history.position, stuck), library=library)


def codes(answer: Inversion) -> list[str]:
    return [doubt.code for doubt in answer.warnings]


def bare(history: ForceHistory, *, Fx: float = 1.0, Fz: float = 1.0) -> ForceHistory:
    """Forces as a sensor gives them, each multiplied by a number: nothing tells of their soil."""
    return ForceHistory(history.position, history.force * [Fx, Fz])


def test_a_slip_of_the_unit_is_asked_about(history: ForceHistory, library: Library) -> None:
    large, blind = codes(invert(bare(history, Fx=1e3, Fz=1e3), library=library))
    assert (large, blind) == ("millinewtons", "uninformed")
    # No slip explains forces of two units; that they are large is told all the same.
    odd = codes(invert(bare(history, Fx=20.0, Fz=1000.0), library=library))
    assert odd[0] == "too_large"
    answer = invert(bare(history, Fx=1e-3, Fz=1e-3), library=library)
    assert codes(answer) == ["kilonewtons"]
    assert answer.reason.count("?") == 1
    assert invert(bare(history), library=library).warnings == ()


@pytest.mark.parametrize("name", ["Fx", "Fz"])
def test_a_turned_sign_is_asked_about(name: str, history: ForceHistory, library: Library) -> None:
    answer = invert(bare(history, **{name: -1.0}), library=library)
    assert codes(answer) == [f"turned_{name}"]
    # With another slip beside it neither explains the record, and the sign is still asked about.
    (_, sign, *_) = invert(bare(history, **{name: -100.0}), library=library).warnings
    assert (sign.code, sign.numbers["force"]) == ("runs_against", name)
    assert sign.numbers["correlation"] == pytest.approx(-1.0, abs=0.005)


def test_an_offset_in_air_is_told_and_not_asked_about(
    history: ForceHistory, library: Library
) -> None:
    size = 0.1 * float(np.ptp(history.Fz))
    answer = invert(
        ForceHistory(history.position, history.force + np.array([0.0, size])), library=library
    )
    assert set(codes(answer)) == {"offset"}


def test_a_density_unlike_the_measured_one_is_told(library: Library) -> None:
    poppy, yuma = (measurement(f"li2013:{sand}/straight") for sand in ("poppy_loose", "yuma"))
    (said,) = invert(poppy.history, library=library, density=1650.0).warnings
    assert said.code == "other_density"
    assert said.numbers == {"made": "measured at", "own": 638.0, "used": 1650.0}
    assert invert(poppy.history, library=library, density=638.0).warnings == ()
    # That of Yuma sand is not reported: nothing is known to differ from.
    assert invert(yuma.history, library=library, density=1500.0).warnings == ()


def test_a_density_unlike_the_simulated_one_is_told(
    history: ForceHistory, library: Library
) -> None:
    (warning,) = invert(history, library=library, density=2000.0).warnings
    assert warning.numbers == {"made": "simulated with", "own": 1650.0, "used": 2000.0}


def test_a_scenario_of_another_version_is_refused(history: ForceHistory, library: Library) -> None:
    odd = ForceHistory(history.position, history.force, provenance={"scenario": {"sand": "wet"}})
    with pytest.raises(InputError, match=r"unknown key 'sand'.*; give its forces alone"):
        invert(odd, library=library)


def test_noise_beyond_any_force_is_refused(history: ForceHistory, library: Library) -> None:
    with pytest.raises(InputError, match="0 to 100000 N is accepted"):
        invert(history, library=library, noise=1e200)


def test_a_calibration_of_another_version_is_told(history: ForceHistory) -> None:
    own = Library.load("quick-plane-strain")
    legs = {leg: {**kept, "kernel": {}} for leg, kept in own.calibration["legs"].items()}
    old = replace(own, calibration={**own.calibration, "legs": legs})
    with pytest.raises(InputError, match="calibrate it again"):
        invert(bare(history), library=old)


@pytest.mark.parametrize(
    "theta_deg",
    [
        pytest.param(np.arange(-88.0, 88.1, 2.0), id="every 2 deg"),
        pytest.param(np.arange(-88.0, 88.1, 4.0), id="every 4 deg"),
        pytest.param(np.r_[-88.0:-49.0, -35.0:89.0], id="a gap of 15 deg"),
    ],
)
def test_a_coarse_record_is_compared_with_curves_read_as_coarsely(theta_deg) -> None:
    library, truths = (Library.load(f"quick-plane-strain{end}") for end in ("", "-fourteen"))
    readings = np.radians(theta_deg)
    scores, verdicts = [], []
    for case in truths.cases[1::5]:
        record = ForceHistory(readings, case.history.means(readings, np.radians(0.5)))
        answer = invert(record, library=library)
        low, high = answer.phi.ci95
        off = answer.phi.median - case.scenario.soil.friction_angle_deg
        scores.append(off / (0.25 * (high - low)))
        verdicts.append(answer.verdict.verdict)
    # Against whole curves nearly all of them are a misfit.
    assert verdicts.count("consistent") >= 7
    assert np.abs(scores).max() < 4.0
    assert np.sqrt(np.mean(np.square(scores))) < 1.7


def test_a_library_s_own_caveat_is_told_with_every_answer(library: Library) -> None:
    case = library.cases[3]
    plan = library.plan.model_copy(update={"caveat": "it reads low."})
    for used, codes in ((library, []), (replace(library, plan=plan), ["caveat"])):
        found = invert(case.history, library=used)
        assert [doubt.code for doubt in found.warnings if doubt.code == "caveat"] == codes
    assert f"Library {library.name}: it reads low." in found.reason


def test_real_soils_beside_other_parameters_are_pointed_to_what_knows_them() -> None:
    """Beside a density that is inferred nothing is known of how real soils deviate."""
    record = measurement("li2013:poppy_loose/straight")
    alone = invert(record.history, leg=record.leg, density=638.0)
    both = invert(record.history, leg=record.leg, prior=["density=638"])
    several = invert(record.history, leg=record.leg, prior=["density=637:639"], steps=100)
    for found, asked in ((alone, False), (both, False), (several, True)):
        assert ("with_others" in [doubt.code for doubt in found.warnings]) is asked
        assert bool(found.library_reason) is not asked
