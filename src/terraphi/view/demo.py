"""The demonstration: an angle that is known is recovered, then those of measured sands inferred."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement

if TYPE_CHECKING:
    from terraphi.inference.answer import Inversion

TRUTHS, TRUTH_DEG = "quick-plane-strain-truths", 33.97
"""Fresh simulations, off the grid of their library and of other seeds, and the one that is used."""
NOISE_N = 0.1
"""Standard deviation of the noise that is added to each of its readings [N]."""


def answers(sources: Sequence[str]) -> list[Inversion]:
    """Inversions of the known record and of shipped measurements, in that order."""
    from terraphi.inference.inversion import invert
    from terraphi.inference.trials import Trial

    trials = [Trial(known_record(), "straight", f"simulated, φ = {TRUTH_DEG:g}°")]
    trials += [Trial.of(measurement(source)) for source in sources]
    return [invert(trial) for trial in trials]


def known_record() -> ForceHistory:
    """A simulation of known friction angle, with noise."""
    from terraphi.library.store import Library

    cases = Library.load(TRUTHS).cases
    truth = next(
        case.history
        for case in cases
        if case.history and abs(case.scenario.soil.friction_angle_deg - TRUTH_DEG) < 1e-6
    )
    noise = NOISE_N * np.random.default_rng(0).standard_normal(truth.force.shape)
    return replace(truth, force=truth.force + noise)


def told(found: Sequence[Inversion]) -> list[str]:
    """A sentence for each, of at most 25 words."""
    known, *measured = found
    low, high = known.phi.ci95
    inside = "inside" if low <= TRUTH_DEG <= high else "outside"
    sentences = [
        f"Simulated with {TRUTH_DEG:g}° and noise: {_angle(known)}, the truth {inside} 95 %."
    ]
    for one in measured:
        words = {
            "consistent": "The model fits it as well as it fits other sands.",
            "misfit": "The model fits it worse than other sands: check the record.",
        }
        said = words.get(one.verdict.verdict, "It lies at the library's edge.")
        sentences.append(f"{one.source}: {_angle(one)}. {said}")
    return sentences


def _angle(one: Inversion) -> str:
    """φ with half of its 68 % interval, in the digits that it has."""
    form = one.digits("soil.friction_angle_deg")
    half = 0.5 * (one.phi.ci68[1] - one.phi.ci68[0])
    return f"φ = {one.phi.median:{form}} ± {half:{form}}°"
