"""What a known covariance says of its parameters."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi.inference.identifiability import Identifiability

PHI, DENSITY, FRICTION = "soil.friction_angle_deg", "soil.density", "leg.friction"


def confounded() -> Identifiability:
    # Phi and density along a ridge, leg friction by itself; priors of standard deviation 1.
    ridge = 0.25 * np.array([[1.0, -0.99], [-0.99, 1.0]])
    covariance = np.block([[ridge, np.zeros((2, 1))], [np.zeros((1, 2)), np.array([[0.01]])]])
    return Identifiability.of((PHI, DENSITY, FRICTION), covariance, [1.0, 1.0, 1.0])


def test_a_ridge_is_named_with_its_direction() -> None:
    found = confounded()
    assert found.kinds == {PHI: "narrowed", DENSITY: "narrowed", FRICTION: "fixed"}
    assert found.confounded == [(PHI, DENSITY)]
    sentence = found.sentences()[-1]
    assert sentence.startswith("φ and ρ cannot be told apart: φ +")
    assert "ρ -" in sentence


def test_conditional_and_gain_are_those_of_a_normal_distribution() -> None:
    found = confounded()
    assert found.conditional_sd[0] == pytest.approx(0.5 * np.sqrt(1.0 - 0.99**2))
    assert found.conditional_sd[2] == pytest.approx(0.1)
    determinant = 0.25**2 * (1.0 - 0.99**2) * 0.01
    assert found.bits == pytest.approx(-0.5 * np.log2(determinant))
    np.testing.assert_allclose(found.variance_left, [0.25 * 0.01, 0.01, 0.25 * 1.99])
    least_known = found.directions[:, -1]
    np.testing.assert_allclose(np.abs(least_known), [np.sqrt(0.5), np.sqrt(0.5), 0.0], atol=1e-12)


def test_independent_parameters_are_not_bound_up() -> None:
    found = Identifiability.of((PHI, DENSITY), np.diag([0.01, 0.9]), [1.0, 1.0])
    assert found.kinds == {PHI: "fixed", DENSITY: "open"}
    assert found.confounded == []
    assert "is not learnt" in found.sentences()[1]


def test_a_parameter_alone_has_no_others() -> None:
    found = Identifiability.of((PHI,), np.array([[0.04]]), [1.0])
    assert found.sentences() == [
        "φ is narrowed down: its standard deviation is 0.2 deg, 20% of the prior's."
    ]
