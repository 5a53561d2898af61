"""Parts of a stroke: information adds up, and intervals still hold the angle of the whole."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, names
from terraphi.inference.answer import Answer
from terraphi.inference.inversion import invert
from terraphi.inference.likelihood import PART_DEG, Likelihood
from terraphi.inference.records import open_record
from terraphi.laws.legs import shipped_legs

GRAINS = Path(__file__).parents[2] / "studies" / "data" / "grains"


def cut(name: str, low: float, high: float) -> ForceHistory:
    history = measurement(name).history
    return replace(history.between(*np.radians([low, high])), provenance={})


def test_information_of_the_parts_adds_up_to_that_of_the_whole() -> None:
    shares = []
    # Cut between windows, whose width is 170/39°.
    for low, high in ((-90.0, -170.0 / 78.0 * 20), (-170.0 / 78.0 * 20, 0.0), (0.0, 90.0)):
        record = open_record(
            cut("li2013:yuma/straight", low, high), rig="li2013", leg="straight", density=1650
        )
        likelihood = Likelihood([record], shipped_legs())
        share = likelihood.coverage[0].share
        missing = likelihood.budget()["missing angles"]
        assert missing == pytest.approx(PART_DEG * np.sqrt(1.0 / share - 1.0), rel=0.05)
        shares.append(share)
    # Each is taken at the best angle of its part.
    assert sum(shares) == pytest.approx(1.0, abs=0.1)
    full = open_record("li2013:yuma/straight")
    assert Likelihood([full], shipped_legs()).coverage[0].share == 1.0


@cache
def whole(name: str) -> Answer:
    return invert(measurement(name))


@pytest.mark.parametrize("window", [
    (-85, 20), (-60, 60), (-60, 0), (-20, 40), (0, 85),
    pytest.param((-80, 80), marks=pytest.mark.slow),
    pytest.param((-40, 0), marks=pytest.mark.slow),
])  # fmt: skip
def test_a_part_gives_the_angle_of_the_whole_within_its_own_share(window: tuple[int, int]) -> None:
    difference = []
    for name in names():
        record = measurement(name)
        answer = whole(name)
        part = invert(cut(name, *window), rig=record.rig, density=record.density_kg_m3)
        missing = part.budget_deg.get("missing angles", 0.0)
        assert part.phi.sd > 0.8 * answer.phi.sd  # other terms change too
        if part.verdict == "consistent":
            difference.append(abs(part.phi.median - answer.phi.median) / max(missing, 0.3))
    # All twelve are consistent as a whole.
    assert len(difference) >= (12 if window[1] - window[0] > 90 else 11)
    # Of twelve normal deviates the root mean square is below 1.55 with 99.5 % probability.
    assert np.sqrt(np.mean(np.square(difference))) < 1.55


def test_a_part_of_one_wrong_force_is_a_misfit() -> None:
    """Whose residual is twice that of a right part."""
    for name in ("li2013:yuma/straight", "li2013:glass03_loose/straight"):
        stroke, part = measurement(name), cut(name, -85.0, 20.0)
        for gain, verdict in ((1.0, "consistent"), (0.5, "misfit"), (2.0, "misfit")):
            forces = replace(part, force=part.force * [gain, 1.0])
            answer = invert(forces, rig=stroke.rig, density=stroke.density_kg_m3)
            assert answer.verdict == verdict


@pytest.mark.parametrize("leg", ["straight", "c", "reversed_c"])
def test_intervals_of_parts_and_of_a_torque_hold_the_angle_of_grains(leg: str) -> None:
    """The angles are those of shear cells."""
    difference, errors = [], []
    for soil, true in (("A", 20.0), ("B", 26.4), ("C", 31.9), ("E", 29.7)):
        table = np.loadtxt(GRAINS / f"{soil}-loose_{leg}_1.csv", delimiter=",", skiprows=3)
        theta, force, moment = np.radians(table[:, 0]), table[:, 1:3], table[:, 3]
        full_history = ForceHistory(theta, force)
        torque = ForceHistory(theta, force[:, :0], axes=(), moment=moment)
        for history in (
            torque,
            *(full_history.between(*np.radians(w)) for w in ((-60, 20), (-20, 60))),
        ):
            answer = invert(history, rig="li2013", leg=leg, density="1415±20", grain_size_mm=6.0)
            errors.append(answer.phi.median - true)
            difference.append(errors[-1] / answer.phi.sd)
    assert np.mean(np.abs(difference) < 1.96) >= 11 / 12
    assert abs(np.mean(errors)) < 2.0  # as of dry soil + 3 to + 11°
