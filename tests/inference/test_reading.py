"""What readings leave open: against errors of records that were read at every phase."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from terraphi.experiment.history import ForceHistory
from terraphi.inference import prepared_leg
from terraphi.inference.inversion import invert
from terraphi.inference.prepared_leg import (
    WHITE,
    Reading,
    _beside_neighbours,
    _Errors,
    learn_reading,
    prepare,
    reading_errors,
    surrogate_of,
    white_of,
)
from terraphi.library.store import Library

RIPPLE = 1.25
"""Period of a made-up ripple [deg]."""


def rippled(phase: float = 0.0) -> ForceHistory:
    theta = np.arange(-100.0, 100.05, 0.1)
    smooth = np.cos(np.radians(theta))
    ripple = 0.05 * np.sin(2.0 * np.pi * (theta / RIPPLE + phase))
    force = np.stack([4.0 * smooth, 6.0 * (smooth + ripple)], axis=1)
    return ForceHistory(np.radians(theta), force)


def test_errors_are_those_of_the_ripple_at_all_phases() -> None:
    """Readings as far apart as the period of a ripple meet it at one phase."""
    readings = np.radians(np.arange(-95.0, 95.1, RIPPLE))
    about, around = reading_errors(rippled(), readings)
    lift = about[:, 40:]
    # Point readings show amplitude times sine of the phase; means over 1 of 1.25° keep a part.
    kept = np.sin(np.pi / RIPPLE) / (np.pi / RIPPLE)
    expected = (1.0 - kept) * 6.0 * 0.05 / np.sqrt(2.0)
    assert np.sqrt(np.mean(np.square(lift[:, 2:-2]))) == pytest.approx(expected, rel=0.15)
    assert np.ptp(lift.mean(axis=1)) > expected  # all windows together, up and down
    assert np.abs(about[:, :40]).max() < 0.01 * expected
    assert np.abs(around).max() < 6.0 * 0.05


def test_a_dense_record_leaves_nothing_open() -> None:
    library = Library.load("rft3d")
    own = library.cases[0].history
    assert own is not None
    prepared = prepare(library, "straight", readings=own.position)
    found = learn_reading(library, "straight", own.position, prepared.surrogate)
    assert found.errors is None
    assert not found.covariance(30.0, np.array([0.0, 1.0, 0.0, 1.0])).any()
    assert prepared.read_for(prepared.mean[3]) is prepared


def test_a_library_that_hardly_reaches_beyond_the_window_will_do() -> None:
    library = Library.load("rft3d")
    cut = [
        case._replace(history=case.history.between(*np.radians([-86.0, 86.0])))
        for case in library.cases
        if case.history is not None
    ]
    short = replace(library, cases=tuple(cut))
    readings = np.radians(np.arange(-88.0, 88.01, 4.0))
    surrogate = surrogate_of(short, "straight", short.curves("straight"))
    assert learn_reading(short, "straight", readings, surrogate).moment(30.0).any()


def drawn_errors(rng: np.random.Generator, phi: np.ndarray, patterns: np.ndarray) -> _Errors:
    """Errors of curves at three shifts that are mixtures of patterns, of 80 windows."""
    about = 0.05 * rng.standard_normal((phi.size, 3, len(patterns))) @ patterns
    return _Errors(phi, about, np.zeros_like(about), np.full((phi.size, 80), 8.0))


@pytest.mark.parametrize("count", [2, 300])
def test_errors_of_curves_that_were_not_learnt_from_are_as_large_as_said(count: int) -> None:
    """Two patterns are learnt from a few curves; of as many as there are windows most are not."""
    surrogate = prepare(Library.load("quick-plane-strain"), "straight").surrogate
    rng = np.random.default_rng(3)
    patterns = rng.standard_normal((count, 80)) / np.sqrt(count)
    phi = np.arange(17.5, 48.0, 2.5)
    errors, fresh = (drawn_errors(rng, phi.repeat(n), patterns) for n in (1, 40))
    white = white_of(errors, surrogate)
    assert white < 0.02 if count == 2 else white > 0.05
    ratios = {0.0: [], white: []}
    for each in phi[1:-1].tolist():
        moved = 8.0 * fresh.about[fresh.phi_deg == each].reshape(-1, 80)
        known = surrogate.covariance(each) + surrogate.scatter.covariance(each)
        rest = errors.of(errors.phi_deg != each)
        for added, found in ratios.items():
            opened = 64.0 * Reading(rest, added).moment(each)
            direction = np.linalg.solve(known + opened, surrogate.slope(each))
            said = direction @ opened @ direction
            found.append(np.square(moved @ direction).mean() / said)
    if count > 2:
        assert np.mean(ratios[white]) == pytest.approx(1.0, abs=0.35)
        assert np.mean(ratios[0.0]) > 1.5


def test_curves_without_errors_and_few_curves_have_the_usual_white_part() -> None:
    surrogate = prepare(Library.load("quick-plane-strain"), "straight").surrogate
    rng, phi = np.random.default_rng(1), np.arange(20.0, 33.0, 2.5)
    still = drawn_errors(rng, phi, np.zeros((2, 80)))
    few = drawn_errors(rng, phi[:5], rng.standard_normal((2, 80)))
    assert [white_of(errors, surrogate) for errors in (still, few)] == [WHITE, WHITE]


def test_replicates_are_learnt_from_too() -> None:
    library = Library.load("quick-paper")
    readings = np.radians(np.arange(-95.0, 95.0, 1.0))
    surrogate = prepare(library, "straight", readings=readings).surrogate
    louder = [
        case._replace(history=replace(case.history, force=case.history.force * ripple))
        for case in library.replicates
        if case.history is not None
        for ripple in [1.0 + 0.2 * np.sin(2.0 * np.pi * case.history.theta_deg)[:, None]]
    ]
    without, loud = (
        learn_reading(replace(library, replicates=some), "straight", readings, surrogate)
        for some in ((), tuple(louder))
    )
    force = surrogate.predict([32.5])[0]
    assert np.trace(loud.covariance(32.5, force)) > 2.0 * np.trace(without.covariance(32.5, force))


def test_what_a_curve_has_beside_its_neighbours_is_alike_throughout_and_at_the_ends() -> None:
    """One and a half times its own variance, and nothing of what is linear over phi."""
    rng = np.random.default_rng(4)
    own, line = rng.standard_normal((5, 40000)), 3.0 * np.arange(5.0)[:, None]
    for i in range(5):
        found = _beside_neighbours((own + line)[i], i, list(own + line))
        assert np.mean(np.square(found)) == pytest.approx(1.5, rel=0.05)


def test_the_covariance_is_that_of_the_curves_near_and_each_part_grows_by_itself() -> None:
    """Points lose and means gain with phi; patterns of far curves do not count."""
    phi = np.arange(15.0, 51.0, 2.5)
    one, other, third = np.eye(80)[:3]
    pattern = np.where(phi[:, None] < 30.0, one, other)
    shrinks, grows = (0.05 * np.exp(rate * (phi - 15.0)) for rate in (-0.02, 0.05))
    # Two shifts of opposite signs of one part, so that the parts are not alike.
    about = shrinks[:, None, None] * np.stack([pattern, -pattern], axis=1)
    beside = np.repeat(grows[:, None, None] * third, 2, axis=1)
    errors = _Errors(phi, about, beside, np.ones((phi.size, 80)))
    for i in (0, -1):
        low, high, means = np.diag(errors.moment(phi[i]))[:3]
        near, far = (low, high) if i == 0 else (high, low)
        assert far < 0.05 * near
        assert near == pytest.approx(shrinks[i] ** 2, rel=0.05)
        assert means == pytest.approx(grows[i] ** 2, rel=0.05)
    # As errors of one record they are added: what is in both counts four times.
    alike = errors._replace(beside=about)
    assert np.allclose(alike.moment(20.0), 4.0 * errors.of(phi > 0)._replace(
        beside=np.zeros_like(about)).moment(20.0))  # fmt: skip


@pytest.mark.parametrize("degrees", [0.1, 1.0, 4.0])
def test_scatter_is_the_calibrations_at_every_spacing(degrees: float) -> None:
    library = Library.load("quick-plane-strain")
    found = prepare(library, "straight", readings=np.radians(np.arange(-95.0, 95.0, degrees)))
    carried = library.calibration["legs"]["straight"]["scatter"]
    assert found.surrogate.scatter.as_dict() == carried
    assert (found.reading.errors is not None) == (degrees > 0.1)


def test_covariance_grows_with_the_spacing_and_with_the_force() -> None:
    library = Library.load("quick-plane-strain")
    sizes = []
    for degrees in (0.2, 1.0, 2.0):
        readings = np.radians(np.arange(-95.0, 95.0, degrees))
        prepared = prepare(library, "straight", readings=readings)
        weak, strong = (prepared.read_for(prepared.mean[i]).opened for i in (20, 250))
        assert np.linalg.eigvalsh(strong).min() > -1e-12 * np.trace(strong)
        assert np.trace(strong) > 4.0 * np.trace(weak)
        sizes.append(np.trace(weak))
    assert sizes[0] < 0.1 * sizes[1] < sizes[2]


def test_intervals_hold_the_truth_at_every_phase() -> None:
    """Without the covariance of the readings 95 % intervals held 30 to 40 % of these truths."""
    library, every = Library.load("quick-plane-strain"), 20
    inside, consistent = [], []
    for case in Library.load("quick-plane-strain-fourteen").cases[1:14:4]:
        truth = case.scenario.soil.friction_angle_deg
        assert case.history is not None
        for phase in range(0, every, every // 5):
            whole = case.history
            record = replace(
                whole, position=whole.position[phase::every], force=whole.force[phase::every]
            )
            answer = invert(record, library=library)
            inside.append(answer.phi.ci95[0] <= truth <= answer.phi.ci95[1])
            consistent.append(answer.verdict.verdict == "consistent")
            assert answer.budget is not None
            assert answer.budget.shares["readings"] > 0.1
    assert np.mean(inside) > 0.8
    assert np.mean(consistent) > 0.8


@pytest.mark.parametrize(
    ("name", "percent"),
    [("quick-plane-strain", (5, 9)), ("quick-paper", (1.5, 3)), ("k4-plane-strain", (2.5, 4.5)),
     ("resolved", (2.5, 5)), ("paper", (0.4, 0.8))],
)  # fmt: skip
def test_ripple_of_the_libraries(name: str, percent: tuple[float, float]) -> None:
    """As docs/inference.md has it."""
    found = []
    for case in Library.load(name).cases:
        if case.scenario.leg.shape == "straight" and case.history is not None:
            inside = np.radians(np.arange(-72.0, 72.0, 0.1))
            fine, wide = (case.history.means(inside, np.radians(h)) for h in (0.25, 1.5))
            found.append((fine - wide).std(axis=0) / np.ptp(wide, axis=0))
    low, high = percent
    assert (100.0 * np.median(found, axis=0) > low).all()
    assert (100.0 * np.median(found, axis=0) < high).all()


def test_a_coarse_library_gets_the_variance_that_its_errors_ask_for(monkeypatch) -> None:
    found = []

    def kept(errors, surrogate):
        found.append(white_of(errors, surrogate))
        return found[-1]

    monkeypatch.setattr(prepared_leg, "white_of", kept)
    prepare(Library.load("resolved"), "straight", readings=np.radians(np.arange(-94.0, 95.0, 4.0)))
    assert found
    assert prepared_leg.WHITES[0] < found[0] < prepared_leg.WHITES[-1]
    assert 0.1 < found[0] < 2.0  # five degrees between angles, but what grows is told from what not
