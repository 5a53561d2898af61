"""Where to simulate next, against designs that are tried one by one."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.forward import simulate
from terraphi.inference.suggestion import _Search, suggest
from terraphi.library.plan import Plan
from terraphi.library.store import Case, Library
from terraphi.surrogate.design import DesignSurrogate
from terraphi.surrogate.process import Process
from terraphi.surrogate.training import training

PHI = "soil.friction_angle_deg"
RFT = {"model": "rft", "dimensions": 3, "rft": {"panels": 20}}


@pytest.fixture(scope="module")
def few() -> Library:
    plan = Plan.model_validate({"name": "few", "scenario": RFT, "sweep": {PHI: [15, 28, 39, 50]}})
    return Library(plan, tuple(Case(s, simulate(s), "") for s in plan.cases()))


def search(library: Library) -> _Search:
    data = training(library, "straight")
    return _Search({"straight": DesignSurrogate.fit(data)}, {"straight": 0.05}, data.bounds, 0)


def test_risk_is_that_of_a_process_with_the_point_added(few) -> None:
    found = search(few)
    candidate = 60
    at = found.candidates[candidate]
    leg = found.legs[0]
    variances = []
    for known in leg.known:
        process = known.process
        # Forces there play no part in a variance: any will do, in the units of the process.
        more = Process.condition(
            np.vstack([process.points, at]),
            process.theta_deg,
            np.vstack([process.predict(process.points)[0], process.predict(at)[0]]),
            process.kernel,
        )
        variances.append(process.std**2 * more.rotated(found.truths)[1] / more.std**2)
    # One parameter, one leg: the information at each truth, from dense matrices.
    inverse = []
    for t in range(len(found.truths)):
        whole = np.concatenate(
            [
                v[t] + leg.noise[t] ** 2 + known.process.noise_variance
                for v, known in zip(variances[:2], leg.known[:2], strict=True)
            ]
        )
        slope = np.concatenate([part[t] for part in leg.slopes], axis=1)
        curve = np.concatenate([part[t] for part in leg.curves])
        covariance = np.diag(whole) + variances[2][t, 0] * np.outer(curve, curve)
        inverse.append(1.0 / (12.0 + float(slope[0] @ np.linalg.solve(covariance, slope[0]))))
    assert found.risk(candidate, [0]) == pytest.approx(12.0 * np.mean(inverse), rel=1e-6)
    # And the state after it, from which the next of a greedy design is sought.
    found.add(candidate)
    for known, variance in zip(found.legs[0].known, variances, strict=True):
        np.testing.assert_allclose(known.truth, variance, rtol=1e-6, atol=1e-12)


def test_the_best_candidate_is_best_and_none_is_named_twice(few) -> None:
    found = search(few)
    best = found.best([0])
    risks = [found.risk(c, [0]) for c in range(0, len(found.candidates), 7)]
    assert found.risk(best, [0]) <= min(risks)
    points = [point[PHI] for point in suggest(few, noise=0.05, count=3).points]
    assert len(set(points)) == 3
    assert all(15.0 <= phi <= 50.0 and min(abs(phi - k) for k in (15, 28, 39, 50)) > 0.5
               for phi in points)  # fmt: skip


def test_expected_variance_falls_with_every_point(few) -> None:
    found = suggest(few, noise=0.05, count=4)
    sd = [one[PHI] for one in found.expected_sd]
    assert all(later < earlier for earlier, later in itertools.pairwise(sd))
    assert sd[-1] > found.floor_sd[PHI] > 0.0
    header, rows = found.table()
    assert all(len(row) == len(header) for row in rows)
    assert found.as_dict()["expected_sd"][0] == {PHI: sd[0]}


def test_the_parameter_that_counts_may_be_chosen(two_parameters) -> None:
    by = {
        name: suggest(two_parameters, leg="straight", parameter=name, noise=0.02)
        for name in ("friction_angle_deg", "leg.friction")
    }
    for name, key in (("friction_angle_deg", PHI), ("leg.friction", "leg.friction")):
        other = "leg.friction" if name == "friction_angle_deg" else "friction_angle_deg"
        assert by[name].expected_sd[1][key] <= by[other].expected_sd[1][key] + 1e-12
    assert by["leg.friction"].legs == ("straight",)
    assert "also = [[" in by["leg.friction"].advice()


def test_what_cannot_be_is_refused(few) -> None:
    with pytest.raises(InputError, match="no parameter 'mu'"):
        suggest(few, parameter="mu")
    with pytest.raises(InputError, match="no leg 'c'"):
        suggest(few, leg="c")
    with pytest.raises(InputError, match="must be positive"):
        suggest(few, noise=0.0)
    with pytest.raises(InputError, match="must be positive"):
        suggest(few, count=0)
