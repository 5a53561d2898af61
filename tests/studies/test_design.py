"""Libraries built evenly and in the order that is suggested, on a small scale."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi.studies import design


@pytest.fixture
def small(monkeypatch) -> None:
    box = design.Box({design.PHI: (15.0, 50.0)}, (3, 5, 7), 16)
    monkeypatch.setattr(design, "BOXES", (box,))
    monkeypatch.setattr(design, "NOISES", (0.003,))


def test_the_suggested_order_beats_the_even_grid(small) -> None:
    seen: list[tuple[float, float]] = []
    study = design.run(progress=lambda done, total: seen.append((done, total)))
    (found,) = study.data["comparisons"]
    even, suggested = np.array(found["even"])[1:, 0], np.array(found["suggested"])[1:, 0]
    assert found["even"][0] == found["suggested"][0]
    assert (suggested < even).all()
    assert len(found["order"]) == 4
    assert seen[-1] == (1, 1)
    assert len(study.rows) == 3
    assert "and more than it in 2 of 2" in study.notes[0]


def test_errors_are_those_of_the_most_probable_angle() -> None:
    # The first-order error against the angle that fits best, found by search.
    from scipy.optimize import minimize_scalar

    from terraphi.design_surrogate import DesignSurrogate, training

    box = design.Box({design.PHI: (15.0, 50.0)}, (4,), 4)
    points, level = box.even(4), 0.01
    surrogate = DesignSurrogate.fit(training(box.library(points), design.LEG))
    errors = []
    for (truth,) in box.unseen():
        data = np.hsplit(box.simulated((truth,)).observation().vector, 2)
        noise = level * np.mean([np.ptp(half) for half in data])
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
            factor = surrogate.factor_variance(at)[0] * np.outer(curve, curve)
            covariance = np.diag(np.concatenate(variances)) + factor
            return total + r @ np.linalg.solve(covariance, r)

        errors.append(minimize_scalar(misfit, bounds=(truth - 2, truth + 2)).x - truth)
    expected = np.sqrt(np.mean(np.square(errors)))
    assert box.wrong(points, level)[0] == pytest.approx(expected, rel=0.05)
