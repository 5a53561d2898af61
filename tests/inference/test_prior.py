"""Priors as people write them."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.inference.prior import Marginal, priors

BOUNDS = {"soil.friction_angle_deg": (20.0, 45.0), "motion.hip.1": (0.18, 0.2)}


def test_what_is_not_said_is_uniform_over_the_library() -> None:
    found = priors(BOUNDS)
    assert found == {key: Marginal(*ends) for key, ends in BOUNDS.items()}
    assert found["motion.hip.1"].sd == pytest.approx(0.02 / np.sqrt(12.0))


def test_three_ways_to_say_it() -> None:
    found = priors(BOUNDS, ["friction_angle_deg=25:40", "hip.1=0.19+-0.002", "density=1600"])
    assert found["soil.friction_angle_deg"] == Marginal(25.0, 40.0)
    assert found["motion.hip.1"].normal == (0.19, 0.002)
    assert found["soil.density"].fixed
    assert found["soil.density"].as_dict() == {"kind": "fixed", "value": 1600.0}


def test_draws_follow_a_normal_prior_that_is_cut_off() -> None:
    from scipy.stats import truncnorm

    marginal = priors(BOUNDS, ["friction_angle_deg=22+-4"])["soil.friction_angle_deg"]
    assert (marginal.low, marginal.high) == (20.0, 45.0)
    drawn = marginal.draw(20_000, np.random.default_rng(0))
    exact = truncnorm((20 - 22) / 4, (45 - 22) / 4, 22, 4)
    assert drawn.min() >= 20.0
    assert drawn.mean() == pytest.approx(exact.mean(), abs=0.1)
    assert marginal.sd == pytest.approx(exact.std(), rel=1e-6)
    x = np.array([19.0, 24.0, 30.0])
    log_p = marginal.log_density(x)
    assert log_p[0] == -np.inf
    assert log_p[2] - log_p[1] == pytest.approx(exact.logpdf(30.0) - exact.logpdf(24.0))


def test_a_prior_is_cut_off_where_the_library_ends_and_not_where_it_runs_out() -> None:
    key = "soil.friction_angle_deg"
    said = {"22+-1": (True, False), "30+-1": (False, False), "40±2": (False, True)}
    for text, cut in said.items():
        assert priors(BOUNDS, [f"{key}={text}"])[key].cut_off == cut
    assert Marginal(1.0, 2.0).cut_off == (True, True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("frictio_angle_deg=25:40", "did you mean 'soil.friction_angle_deg'"),
        ("friction_angle_deg", "expected KEY=LOW:HIGH"),
        ("friction_angle_deg=", "expected KEY=LOW:HIGH"),
        ("friction_angle_deg=40:25", "LOW below HIGH"),
        ("friction_angle_deg=much", "LOW below HIGH"),
        ("friction_angle_deg=30+--2", "has to be above 0"),
        ("friction_angle_deg=15:30", "between 20 and 45"),
        ("friction_angle_deg=50", "between 20 and 45"),
        ("friction_angle_deg=200+-10", "lies more than 6 standard deviations outside 20 to 45"),
        ("friction_angle_deg=35+-0", "has to be above 0"),
        ("friction_angle_deg=30+-inf", "finite"),
        ("friction_angle_deg=nan", "finite"),
        ("density=1.6", "between 100 and 10000"),
    ],
)
def test_unusable_priors_are_refused(text, words) -> None:
    with pytest.raises(InputError, match=words):
        priors(BOUNDS, [text])


def test_two_priors_on_one_key_are_refused_whatever_their_order() -> None:
    both = ["friction_angle_deg=30+-1", "soil.friction_angle_deg=20:45"]
    for given in (both, both[::-1]):
        with pytest.raises(InputError, match="are both on soil"):
            priors(BOUNDS, given)


def test_a_density_is_a_number_of_any_kind_and_refused_as_one() -> None:
    given = priors(BOUNDS, ["friction_angle_deg=20:40"], density=np.float64(1450.0))
    assert given["soil.density"].as_dict() == {"kind": "fixed", "value": 1450.0}
    with pytest.raises(InputError, match=r"^density = -5 kg/m³: soil.density lies between 100"):
        priors(BOUNDS, [], density=-5.0)
