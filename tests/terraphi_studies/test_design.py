"""Libraries built evenly and in the order that is suggested, on a small scale."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi_studies import design


@pytest.mark.slow
def test_the_suggested_order_beats_the_even_grid_over_two_parameters(monkeypatch) -> None:
    box = design.Box({design.PHI: (20.0, 45.0), "leg.friction": (0.2, 0.6)}, (4, 9), 16)
    monkeypatch.setattr(design, "BOXES", (box,))
    seen: list[tuple[float, float]] = []
    study = design.run(progress=lambda done, total: seen.append((done, total)))
    (found,) = study.data["comparisons"]
    assert found["grid"][0] == found["suggested"][0]
    assert (2.0 * np.array(found["suggested"][1]) < np.array(found["grid"][1])).all()
    assert len(found["order"]) == 5
    assert seen == [(1, 1)]
    assert len(study.table.rows) == 4
    assert study.notes[0].startswith("φ, μ_leg, 9 cases: the even grid errs")


def test_one_parameter_in_three_orders(monkeypatch) -> None:
    box = design.Box({design.PHI: (15.0, 50.0)}, (3, 4), 8)
    monkeypatch.setattr(design, "BOXES", (box,))
    study = design.run()
    (found,) = study.data["comparisons"]
    assert found["grid"][0] == found["suggested"][0]
    assert found["suggested"][1] < found["suggested"][0]
    assert len(found["order"]) == 1
    assert study.notes[0].startswith("φ, 4 cases: the even grid errs")


def test_a_grid_has_its_corners_and_all_combinations() -> None:
    box = design.Box({"a": (0.0, 1.0), "b": (10.0, 20.0)}, (4, 9), 1)
    expected = [[a, b] for a in (0.0, 0.5, 1.0) for b in (10.0, 15.0, 20.0)]
    np.testing.assert_allclose(box.grid(9), expected)


def test_errors_are_those_of_the_most_probable_angle() -> None:
    # The first-order error against the angle that fits best, found by search.
    from scipy.optimize import minimize_scalar

    from terraphi.surrogate.design import DesignSurrogate
    from terraphi.surrogate.training import training

    box = design.Box({design.PHI: (15.0, 50.0)}, (4,), 4)
    points = box.grid(4)
    surrogate = DesignSurrogate.fit(training(box.library(points), design.LEG))
    errors = []
    for (truth,) in box.unseen():
        data = np.hsplit(box.simulated((truth,)).observation().vector, 2)
        noise = design.NOISE * np.mean([np.ptp(half) for half in data])
        at = {design.PHI: np.array([truth])}
        scale = surrogate.scale(at)[0]

        def misfit(phi, truth=truth, data=data, noise=noise, at=at, scale=scale):
            named, total = {design.PHI: np.array([phi])}, 12.0 * ((phi - truth) / 35.0) ** 2
            residual, variances, curves = [], [], []
            for process, half in zip(surrogate.processes, data, strict=True):
                variance = process.rotated(surrogate.points(at))[1][0] + process.noise_variance
                mean = surrogate.scale(named)[0] * process.rotated_mean(surrogate.points(named))[0]
                residual.append(half @ process.basis - mean)
                variances.append(scale**2 * variance + noise**2)
                curves.append(scale * process.rotated_mean(surrogate.points(at))[0])
            r, curve = np.concatenate(residual), np.concatenate(curves)
            factor = surrogate.located(at)[2][0] * np.outer(curve, curve)
            covariance = np.diag(np.concatenate(variances)) + factor
            return total + r @ np.linalg.solve(covariance, r)

        errors.append(minimize_scalar(misfit, bounds=(truth - 2, truth + 2)).x - truth)
    expected = np.sqrt(np.mean(np.square(errors)))
    assert box.wrong(points)[0] == pytest.approx(expected, rel=0.05)
