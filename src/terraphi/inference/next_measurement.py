"""What the next measurement buys: the standard deviation of φ with one thing known better.

A term whose cause is measured shrinks with the standard deviation of that cause. A soil of known
angle on the same rig is a further row of the mixed model (:mod:`~terraphi.inference.calibration`):
with P the variance that both records share and R what the known soil has besides, P falls by
P² / (P + R). A further record in the same soil is one by the law, joined to this one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.priors import DENSITY
from terraphi.experiment.rig import Rig
from terraphi.inference.answer import Answer
from terraphi.inference.combined import combined
from terraphi.inference.inversion import invert
from terraphi.inference.records import density_with_sd
from terraphi.inference.terms import TERMS
from terraphi.laws.legs import NAME as LEGS
from terraphi.laws.legs import shipped_legs

FRICTION_SD, HIP_SD_MM, DENSITY_SD_PART, GAIN_SD, KNOWN_SD_DEG = 0.03, 0.5, 0.01, 0.005, 1.0
"""Standard deviations that a careful measurement has: friction of the leg by a slide test [-],
height of the hip [mm], density of a weighed bed [-], gain by a known weight [-], and the critical
angle by shear tests [deg]; chosen."""


HIGHER = 0.15
"""Raise of the hip for a second record, over the length of the leg [-]; chosen."""


class Measurement(NamedTuple):
    """A measurement and what φ would be uncertain by after it."""

    words: str
    sd_deg: float


def next_measurements(answer: Answer, *, further_records: bool = True) -> list[Measurement]:
    """What measurements would make of the standard deviation of φ, best first.

    Parameters
    ----------
    answer
        Of one leg in measured soil, by :func:`terraphi.invert`; there is none for others.
    further_records
        Whether records of other legs in the same soil are among them, which takes a second.
    """
    rig, squares = answer.rigs[0], {name: sd**2 for name, sd in answer.budget_deg.items()}
    is_of_one_leg = len(answer.rigs) == 1 and isinstance(rig, Rig) and answer.offset_causes_deg
    if not is_of_one_leg or answer.verdict != "consistent":
        return []
    assert isinstance(rig, Rig)

    def without(names: Sequence[str], share: float = 0.0) -> float:
        """Standard deviation with a share of the standard deviation of some terms."""
        removed = (1.0 - share**2) * sum(squares.get(name, 0.0) for name in names)
        return math.sqrt(max(sum(squares.values()) - removed, 0.0))

    density_sd = (answer.density_sd_kg_m3 or 0.0) / answer.density_kg_m3
    # A gain scales the forces as a density does.
    scale = answer.budget_deg.get("density", 0.0)
    gain_sd = density_sd * answer.budget_deg.get("gain", 0.0) / scale if scale else 0.0
    removed = {
        "a record of the whole stroke": "missing angles", "both forces": "missing forces",
        "more readings": "noise", "a library of this rig with more cases": "emulator",
        "a known cohesion": "cohesion",
    }  # fmt: skip
    measured = [
        (f"the hip's height known to ± {HIP_SD_MM:g} mm", "hip height", HIP_SD_MM,
         rig.hip_height_sd_mm),
        (f"the leg's friction known to ± {FRICTION_SD:g} (slide test)", "leg friction", FRICTION_SD,
         rig.leg_friction_sd),
        (f"the density known to ± {100 * DENSITY_SD_PART:g} %", "density", DENSITY_SD_PART,
         density_sd),
        (f"the gain known to ± {100 * GAIN_SD:g} % (a known weight)", "gain", GAIN_SD, gain_sd),
    ]  # fmt: skip
    after = [
        Measurement(words, without([name], sd / usual))
        for words, name, sd, usual in measured
        if usual > sd
    ]
    after += [Measurement(words, without([name])) for words, name in removed.items()]
    # Both records of a rig share the fixed terms, the law's offset and the error of the rig.
    kept = [name for name in squares if TERMS[name].fixed]
    kept += ["model: offset", "model: rig"]
    shared = sum(squares.get(name, 0.0) for name in kept)
    besides = sum(squares.values()) - shared + KNOWN_SD_DEG**2
    calibrated = math.sqrt(sum(squares.values()) - shared**2 / (shared + besides))
    words = f"a soil of known angle ± {KNOWN_SD_DEG:g}° on this rig (terraphi calibrate)"
    after.append(Measurement(words, calibrated))
    if further_records and answer.law == LEGS:
        after += _further_records(answer, rig)
    now = math.sqrt(sum(squares.values()))
    better = [each for each in after if each.sd_deg < 0.99 * now]
    return sorted(better, key=lambda each: each.sd_deg)


def _further_records(answer: Answer, rig: Rig) -> Iterator[Measurement]:
    """The joint answer with another leg in the same soil, where the law has it."""
    soil = f"{answer.density_kg_m3}±{answer.density_sd_kg_m3 or 0.0}"
    high = rig.hip_height_mm + HIGHER * rig.length_mm
    other_shapes = [leg for leg in OUTLINES if leg != rig.leg]
    rigs = {f"a {OUTLINES[leg].label} in the same soil": rig.model_copy(update={"leg": leg})
            for leg in other_shapes}  # fmt: skip
    rigs[f"this leg with its hip at {high:.0f} mm in the same soil"] = rig.model_copy(
        update={"hip_height_mm": high}
    )
    for words, further in rigs.items():
        with suppress(InputError):
            second = plan(further, phi_deg=answer.phi.median, density=soil)
            yield Measurement(words, combined([answer, second]).phi.sd)


def plan(rig: Any, *, phi_deg: float = 30.0, leg: str | None = None, **soil: Any) -> Answer:
    """The answer that a rig is going to give in soil of some friction angle.

    Its forces are those of law ``legs``. What :func:`next_measurements` says of it is known before
    any soil is touched.

    Parameters
    ----------
    rig, leg
        As of :func:`terraphi.invert`.
    phi_deg
        Friction angle in plane strain [deg].
    soil
        ``density``, ``grain_size_mm``, ``cohesion`` and ``gain`` of :func:`terraphi.invert`.

    Raises
    ------
    InputError
        If the law does not have the rig, or the angle.

    Examples
    --------
    >>> answer = terraphi.plan("li2013", leg="c")
    >>> terraphi.next_measurements(answer)[0].sd_deg < answer.phi.sd
    True
    """
    law, apparatus, density = shipped_legs(), Rig.of(rig, leg), soil.get("density")
    mean = DENSITY.mean if density is None else density_with_sd(density, "plan")[0]
    grain_size_mm = float(soil.get("grain_size_mm") or 0.0)
    offset_deg = float(law.error.offset(apparatus, grain_size_mm, np.array(phi_deg)))
    curves = law.forces(apparatus, phi_deg + offset_deg, density=mean)
    theta = curves.theta_deg.values
    history = ForceHistory(np.radians(theta), curves.forces.values[0].T)
    return invert(history, rig=apparatus, simulated=False, **soil)
