"""Several histories and parameters inverted together, from end to end."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import arviz
import numpy as np
import pytest
from scipy.stats import norm

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.soil import plane_strain_friction_angle_deg
from terraphi.forward import simulate
from terraphi.inference.answer import Inversion, Summary
from terraphi.inference.defects import Inspection
from terraphi.inference.explanation import Explanation
from terraphi.inference.findings import Doubt, Measure
from terraphi.inference.inversion import invert
from terraphi.inference.noise import Noise
from terraphi.inference.prior import Marginal
from terraphi.inference.several_parameters import (
    DILATION,
    LegLikelihood,
    Target,
    _edge,
    _judge,
    _plane_strain,
    _window_noise,
)
from terraphi.inference.trials import Looked, Matched, Repeats, Through, Trial, grouped
from terraphi.inference.verdict import EDGE_DENSITY, NRMSD_LIMIT, deviations
from terraphi.surrogate.design import DesignSurrogate
from terraphi.surrogate.training import Training, training
from terraphi.view.plots import corner_figure, fits_figure

PHI, DENSITY, FRICTION = "soil.friction_angle_deg", "soil.density", "leg.friction"
TRUTH = {PHI: 32.7, FRICTION: 0.37, DENSITY: 1650.0}
NOISE_N = 0.5
FEW = 150
"""Steps to begin with, where a verdict is asked for and no quantile."""


@pytest.fixture(scope="module")
def straight(two_parameters, trial) -> Inversion:
    return invert([trial("straight")], library=two_parameters, noise=NOISE_N)


@pytest.fixture(scope="module")
def both(two_parameters, trial) -> Inversion:
    trials = [trial("straight"), trial("c", 1)]
    return invert(trials, library=two_parameters, noise=NOISE_N)


@pytest.fixture(scope="module")
def loose(two_parameters, trial) -> Inversion:
    return invert(
        [trial("straight")], library=two_parameters, noise=NOISE_N, prior=["density=1500:1800"]
    )


def test_an_answer_at_a_prompt_fits_in_ten_lines(both) -> None:
    lines = repr(both).splitlines()
    assert len(lines) <= 10
    assert max(map(len, lines)) <= 100
    for key in both.keys:
        assert sum(both.axis_name(key) in line for line in lines) == 1
    many = {f"soil.{i}": next(iter(both.marginal.values())) for i in range(20)}
    more = replace(both, marginal=many, together=replace(both.together, conditional=many))
    assert len(repr(more).splitlines()) <= 10
    assert "16 more" in repr(more)


def test_truths_are_within_three_standard_deviations(straight, both, loose) -> None:
    for found in (straight, both, loose):
        assert found.draws.converged
        for key in found.keys:
            one = found.marginal[key]
            assert abs(one.median - TRUTH[key]) < 3.0 * one.sd, key
            assert one.ci95[0] < one.ci68[0] < one.median < one.ci68[1] < one.ci95[1]


def test_draws_are_those_of_the_posterior_on_a_grid(straight, two_parameters, trial) -> None:
    # Two parameters and known noise: the posterior can be tabulated.
    given = trial("straight")
    surrogate = DesignSurrogate.fit(
        training(two_parameters, "straight", readings=grouped([given])[0].readings)
    )
    likelihood = LegLikelihood(surrogate, given.history.observation().vector[None])
    sd = [straight.marginal[k].sd for k in (PHI, FRICTION)]
    axes = [
        np.linspace(straight.marginal[k].median - 6 * s, straight.marginal[k].median + 6 * s, 161)
        for k, s in zip((PHI, FRICTION), sd, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    noise = straight.together.noise_N[0]
    log_p = likelihood(
        {PHI: grid[:, 0], FRICTION: grid[:, 1]}, np.full(len(grid), noise), np.zeros(len(grid))
    )
    p = np.exp(log_p - log_p.max()).reshape(161, 161)
    for i, key in enumerate((PHI, FRICTION)):
        marginal = p.sum(axis=1 - i)
        cdf = np.cumsum(marginal) / marginal.sum()
        for quantile, value in zip(
            (0.5, 0.16, 0.84),
            (straight.marginal[key].median, *straight.marginal[key].ci68),
            strict=True,
        ):
            expected = np.interp(quantile, cdf, axes[i])
            assert value == pytest.approx(expected, abs=0.08 * sd[i])


def test_friction_angle_and_density_trade_places(loose, straight) -> None:
    # The forces of this theory are a function of the angle times the density, and of no more.
    assert (PHI, DENSITY) in loose.together.identifiability.confounded
    assert loose.together.identifiability.kinds[DENSITY] == "open"
    flat = loose.draws.flat
    assert np.corrcoef(flat[:, 0], flat[:, loose.keys.index(DENSITY)])[0, 1] < -0.97
    assert loose.marginal[PHI].sd > 3.0 * straight.marginal[PHI].sd
    # With the density known, what is left is the one-parameter interval.
    known = loose.together.conditional[PHI].ci68
    assert known[1] - known[0] < 0.4 * np.ptp(loose.marginal[PHI].ci68)


def test_a_second_leg_adds_what_was_expected(straight, both) -> None:
    for i, key in enumerate((PHI, FRICTION)):
        assert both.marginal[key].sd < straight.marginal[key].sd
        # By linearisation: all legs, and each alone.
        assert both.together.expected_sd["all"][i] < min(
            both.together.expected_sd["straight"][i], both.together.expected_sd["c"][i]
        )
        assert both.marginal[key].sd == pytest.approx(both.together.expected_sd["all"][i], rel=0.15)
    assert both.together.identifiability.bits > straight.together.identifiability.bits


def test_repeated_trials_narrow_the_interval_by_their_root(two_parameters, trial) -> None:
    four = [trial("straight", seed, noise=2.0) for seed in range(4)]
    one, found = (
        invert(trials, library=two_parameters, noise=2.0, prior=["leg.friction=0.37"], steps=FEW)
        for trials in (four[:1], four)
    )
    ratio = one.marginal[PHI].sd / found.marginal[PHI].sd
    # The surrogate's own error is shared by all: not quite two.
    assert 1.6 < ratio < 2.05
    assert found.keys == (PHI,)
    assert [len(records) for records in found.by_leg.values()] == [4]


def test_noise_is_inferred_if_it_is_not_given(two_parameters, trial) -> None:
    found = invert(
        [trial("straight"), trial("straight", 1)],
        library=two_parameters,
        prior=["leg.friction=0.37"],
        steps=FEW,
    )
    # Some 44 readings 0.1° apart make a window mean.
    assert np.median(found.together.noise_N) == pytest.approx(NOISE_N / np.sqrt(44.0), rel=0.25)


def test_forces_that_no_parameters_explain_are_a_misfit(two_parameters, trial) -> None:
    c = trial("c")
    wrong = Trial(c.history, "straight", "passed off")
    found = invert([wrong], library=two_parameters, steps=FEW)
    assert found.verdict.verdict in ("misfit", "out_of_range")


@pytest.mark.parametrize(
    ("mean", "off", "verdict"),
    [
        (18.0, 0.45, "misfit"),  # loose poppy seeds: 65 % of the density at the edge
        (18.0, 0.02, "out_of_range"),
        (15.0, 0.45, "misfit"),
        (30.0, 0.45, "misfit"),
        (30.0, 0.02, "consistent"),
    ],
)
def test_an_edge_that_a_misfit_only_reaches_is_a_misfit(
    mean: float, off: float, verdict: str
) -> None:
    draws = norm(mean, 3.2).ppf(np.linspace(0.0001, 0.9999, 40001))
    draws = draws[draws > 15.0][:, None]
    priors = {PHI: Marginal(15.0, 50.0)}
    target = SimpleNamespace(keys=(PHI,), priors=priors)
    record = SimpleNamespace(source="sand.csv", nrmsd={"Fx": off, "Fz": 0.0})
    measures = deviations(record.nrmsd, most=NRMSD_LIMIT)
    seen = [Matched(None, None, record, measures, Explanation())]
    found = _judge(target, draws, SimpleNamespace(kinds={PHI: "fixed"}), seen)
    assert found.verdict == verdict
    assert found.numbers["worst"] == "sand.csv"
    (edge,) = (m for m in found.measures if m.code == "edge_density")
    assert (edge.value > EDGE_DENSITY) is (mean < 20.0)
    assert ("at_edge" in found.code) is (mean < 20.0 and verdict == "misfit")
    # Ends of the normal density, halfway into the edge's bin of 0.7°.
    density = min(norm.pdf(15.35, mean, 3.2) / norm.pdf(mean, mean, 3.2), 1.0)
    if mean < 20.0:
        assert edge.value == pytest.approx(density, abs=0.03)


def looked_at(group: Repeats) -> Looked:
    nothing = tuple(Inspection(trial.history, 0) for trial in group.trials)
    return Looked(group.trials, nothing, (group,))


def warnings_on(group: Repeats, data: Training, density: float | None) -> list[Doubt]:
    curves = data.forces * (1.0 if density is None else (density / data.density)[:, None])
    looked, through = looked_at(group), Through(data.scenario, curves, density, data.bounds)
    return looked.doubts(looked.beside(group, through, data.forces[0], None), misfit=False)


def test_a_slip_that_explains_a_history_is_asked_about_once(two_parameters, trial) -> None:
    right, data = trial("straight").history, training(two_parameters, "straight")
    turned = Trial(ForceHistory(right.position, right.force * [1.0, -1.0]), "straight")
    (group,) = grouped([turned])
    asked = Explanation(question=Doubt("turned_Fz"))
    looked = looked_at(group)
    through = Through(data.scenario, data.forces, 1650.0)
    (bare,) = looked.beside(group, through, data.forces[0], None)
    for fits, misfit, said in (
        (False, True, ["turned_Fz"]),
        (True, True, ["runs_against"]),
        (False, False, ["runs_against"]),
    ):
        measures = [Measure("nrmsd", 0.0 if fits else 1.0, most=0.1)]
        seen = [bare._replace(measures=measures, why=asked)]
        found = looked.doubts(seen, misfit=misfit)
        assert [doubt.code for doubt in found] == said


def test_a_history_of_another_model_is_named_and_not_believed_blindly(
    two_parameters, trial
) -> None:
    given = trial("straight")
    data = training(two_parameters, "straight")
    assert given.made_as(data.scenario, data.bounds)
    bare = ForceHistory(given.history.position, given.history.force)
    assert not replace(given, history=bare).made_as(data.scenario, data.bounds)
    coarser = two_parameters.cases[0].scenario.replace(**TRUTH, **{"rft.panels": 20})
    other = Trial(simulate(coarser), "straight", "other")
    assert not other.made_as(data.scenario, data.bounds)
    (group,) = grouped([other])
    (said,) = warnings_on(group, data, None)
    assert said.code == "unlike"
    assert said.numbers["differences"] == [("rft.panels", 20, 40)]
    known = warnings_on(group, data, 1500.0)
    assert (known[1].code, known[1].numbers["used"]) == ("other_density", 1500.0)
    found = invert([other], library=two_parameters, noise=NOISE_N, steps=FEW)
    assert found.together.discrepancy == "gp"
    assert said in found.warnings


def test_records_read_at_other_angles_are_told(two_parameters, trial) -> None:
    whole = trial("straight", noise=0.0).history
    every, later = (np.radians(np.arange(start, 88.0, 2.0)) for start in (-87.9, -86.9))
    rough = np.radians(np.r_[-87.0:60.0:0.25, 66.0:87.0:0.25])
    one, other, gap, dense = (
        Trial(whole.as_read_at(at), "straight", name)
        for name, at in (
            ("one", every),
            ("other", later),
            ("gap", rough),
            ("dense", whole.position),
        )
    )
    data = training(two_parameters, "straight")
    (pair,) = grouped([one, other, dense])
    assert pair.readings.size < 90
    (said,) = [w for w in warnings_on(pair, data, 1650.0) if w.code == "read_twice"]
    assert said.source in ("one", "other")
    # The record with the fewest readings decides, not the one with the widest gap.
    (mixed,) = grouped([gap, one])
    assert np.diff(np.degrees(mixed.readings)) == pytest.approx(2.0)
    (same,) = grouped([one, replace(one, history=one.history.scaled(1.01)), dense])
    assert same.read_twice == []
    assert not any(w.code == "read_twice" for w in warnings_on(same, data, 1650.0))


def test_a_density_that_is_assumed_is_compared_with_the_simulated_one(two_parameters) -> None:
    data = training(two_parameters, "straight")
    light = two_parameters.cases[0].scenario.replace(**{**TRUTH, DENSITY: 1500.0})
    (group,) = grouped([Trial(simulate(light), "straight", "light")])
    (said,) = warnings_on(group, data, data.scenario.soil.density)
    assert said.numbers == {"made": "simulated with", "own": 1500.0, "used": 1650.0}
    assert warnings_on(group, data, None) == []


def test_noise_that_is_told_is_of_each_force(trial) -> None:
    groups = grouped([trial("straight"), trial("c", 1)])
    size, ratio = _window_noise(Noise((0.01, 1.0)), groups)
    assert ratio == pytest.approx((0.01, 1.0))
    # The window mean of a smooth part of the noise: by drawing records of white readings.
    position = groups[0].trials[0].history.position
    rng = np.random.default_rng(3)
    drawn = [
        ForceHistory(position, rng.standard_normal((position.size, 2))).observation().vector
        for _ in range(400)
    ]
    smooth = np.mean(np.array(drawn)[:, 5:35], axis=1) * np.sqrt(30.0)
    assert size == pytest.approx(smooth.std(), rel=0.12)
    assert _window_noise(Noise(), groups) == (None, (1.0, 1.0))
    assert _window_noise(Noise((0.0, 0.0)), groups) == (0.0, (1.0, 1.0))


def test_an_edge_of_the_library_cuts_a_normal_prior_too() -> None:
    draws = norm(47.5, 3.0).ppf(np.linspace(0.0001, 0.9999, 40001))
    edge = _edge(PHI, Marginal(20.0, 45.0, (38.0, 10.0)), draws[draws < 45.0])
    assert (edge.side, edge.numbers["at"]) == ("high", 45.0)
    assert edge.size > edge.limit
    # A prior of six standard deviations ends by itself, before the library does.
    assert _edge(PHI, Marginal(20.0, 44.0, (32.0, 2.0)), draws[draws < 44.0]).size == 0.0


def test_the_equivalent_in_plane_strain_knows_the_dilation(two_parameters) -> None:
    soil = {"yield_criterion": "triaxial", "dilation_angle_deg": 0.0}
    scenario = Scenario.model_validate({"soil": soil})
    marginal = {PHI: Summary.of(np.full(10, 30.0))}
    for psi in (0.0, 15.0):
        priors = {PHI: Marginal(20.0, 40.0), DILATION: Marginal(psi, psi)}
        target = Target((), priors, (PHI,), 0.1, False)
        found, _ = _plane_strain(marginal, target, scenario)
        exact = plane_strain_friction_angle_deg(30.0, "triaxial", dilation_angle_deg=psi)
        assert found.median == pytest.approx(exact)


def test_the_answer_is_plain_json(loose) -> None:
    answer = json.loads(json.dumps(loose.as_dict(), allow_nan=False))
    assert set(answer["parameters"]) == set(loose.keys)
    assert answer["density_kg_m3"] is None
    assert answer["parameters"][PHI]["convergence"]["split_rhat"] < 1.01
    assert answer["phi_plane_strain_deg"] is None
    assert "empirical law" in answer["phi_plane_strain_reason"]
    assert answer["histories"][0]["source"] == "straight 0"


def test_arviz_opens_the_file_and_agrees(loose, tmp_path) -> None:
    loose.to_netcdf(tmp_path / "posterior.nc")
    opened = arviz.from_netcdf(tmp_path / "posterior.nc")
    draws = opened["posterior"]
    assert draws["phi_deg"].dims == ("chain", "draw")
    assert draws.sizes["chain"] == 4
    assert draws["density"].attrs["units"] == "kg/m³"
    summary = arviz.summary(opened, var_names=["phi_deg", "density", "friction"])
    for key, name in ((PHI, "phi_deg"), (DENSITY, "density"), (FRICTION, "friction")):
        # What is kept is nearly independent, and says the same as all draws.
        assert float(summary["r_hat"][name]) < 1.02
        assert float(summary["ess_bulk"][name]) > 0.3 * draws[name].size
        assert float(draws[name].std()) == pytest.approx(loose.marginal[key].sd, rel=0.1)
    assert "prior" in opened
    assert opened["observed_data"]["Fx"].shape == (1, 40)
    assert (tmp_path / "posterior.nc").stat().st_size < 2e6


def test_figures_show_every_parameter_and_leg(loose, both) -> None:
    corner = corner_figure(loose)
    assert len(corner.axes) == 6
    assert corner.axes[0].get_title().startswith("φ = $")
    assert "ρ" in corner.axes[-1].get_xlabel()
    corner.draw_without_rendering()
    fits = fits_figure(both)
    assert [axes.get_title() for axes in fits.axes] == ["leg straight"] * 2 + ["leg c"] * 2
    fits.draw_without_rendering()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"discrepancy": "some"}, "unknown discrepancy"),
        ({"prior": ["density=1500:1800"], "density": 1600.0}, "given twice"),
        ({"prior": ["friction_angle_deg=30", "leg.friction=0.4"]}, "nothing to infer"),
        ({"density": 1.6}, "between 100 and 10000"),
        ({"noise": "loud"}, "give newtons"),
    ],
)
def test_unusable_options_are_refused(options, words, two_parameters, trial) -> None:
    with pytest.raises(InputError, match=words):
        invert([trial("straight")], library=two_parameters, **options)


def test_unusable_histories_are_refused(two_parameters, trial) -> None:
    one = trial("straight")
    with pytest.raises(InputError, match="there is no force history"):
        invert([], library=two_parameters)
    with pytest.raises(InputError, match="the same forces as straight 0"):
        invert([one, Trial(one.history, "straight", "copy")], library=two_parameters)
    with pytest.raises(InputError, match="no leg 'reversed_c'"):
        invert([Trial(one.history, "reversed_c", "x")], library=two_parameters)
    soils = [
        Trial(one.history, "straight", "a", 1600.0),
        Trial(trial("straight", 1).history, "straight", "b", 1500.0),
    ]
    with pytest.raises(InputError, match="a is of soil of 1600"):
        invert(soils, library=two_parameters)
