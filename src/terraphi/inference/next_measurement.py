"""The standard deviation of φ after a further measurement.

A term whose cause is measured shrinks with the standard deviation of that cause. A soil of known
angle on the same rig is a further row of the mixed model (:mod:`~terraphi.inference.calibration`):
with P the variance that both records share and R what the known soil has besides, P falls by
P² / (P + R). A further record in the same soil is one by the law, joined to this one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement_of
from terraphi.experiment.rig import Rig
from terraphi.inference.answer import Answer
from terraphi.inference.inversion import invert
from terraphi.inference.records import record_of
from terraphi.inference.terms import TERMS
from terraphi.laws.legs import NAME as LEGS
from terraphi.laws.legs import shipped_legs

SLIDE_TEST, HIP_MM, WEIGHED_BED, KNOWN_WEIGHT, SHEARED_DEG = 0.03, 0.5, 0.01, 0.005, 1.0
"""Standard deviations after a careful measurement: friction of the leg by a slide test [-], height
of the hip [mm], density of a weighed bed over it [-], gain by a known weight [-], and the critical
angle by shear tests [deg]; chosen."""


class Measurement(NamedTuple):
    """A measurement and what φ would be uncertain by after it."""

    words: str
    sd_deg: float


def next_measurements(answer: Answer, *, further_records: bool = True) -> list[Measurement]:
    """Predict the standard deviation of φ after each further measurement, best first.

    Parameters
    ----------
    answer
        A consistent one of one leg in measured soil, by :func:`terraphi.invert`, whose critical
        angle was not given. For others there are none.
    further_records
        Whether records of other legs in the same soil are among them, which takes a second.
    """
    rig, squares = answer.rigs[0], {name: sd**2 for name, sd in answer.budget_deg.items()}
    is_of_one_leg = len(answer.rigs) == 1 and isinstance(rig, Rig) and answer.offset_causes_deg
    if not is_of_one_leg or answer.verdict != "consistent" or "critical" in answer.provenance:
        return []
    assert isinstance(rig, Rig)

    variance = sum(squares.values())
    density_sd = (answer.density_sd_kg_m3 or 0.0) / answer.density_kg_m3
    # A gain scales the forces as a density does.
    scale = answer.budget_deg.get("density", 0.0)
    of_sensor = density_sd * answer.budget_deg.get("gain", 0.0) / scale if scale else 0.0
    measured = [
        (f"the hip's height known to ± {HIP_MM:g} mm", "hip height", HIP_MM,
         rig.hip_height_sd_mm),
        (f"the leg's friction known to ± {SLIDE_TEST:g} (slide test)", "leg friction", SLIDE_TEST,
         rig.leg_friction_sd),
        (f"the density known to ± {100 * WEIGHED_BED:g} %", "density", WEIGHED_BED,
         density_sd),
        (f"the gain known to ± {100 * KNOWN_WEIGHT:g} % (a known weight)", "gain", KNOWN_WEIGHT,
         of_sensor),
        ("a record of the whole stroke", "missing angles", 0.0, 1.0),
        ("both forces", "missing forces", 0.0, 1.0), ("more readings", "noise", 0.0, 1.0),
        ("a library of this rig with more cases", "emulator", 0.0, 1.0),
        ("a known cohesion", "cohesion", 0.0, 1.0),
    ]  # fmt: skip
    after = [
        Measurement(words, math.sqrt(variance - (1.0 - (sd / usual) ** 2) * squares.get(name, 0.0)))
        for words, name, sd, usual in measured
        if usual > sd
    ]
    # Both records of a rig share the fixed terms, the law's offset and the error of the rig.
    if "calibration" not in answer.provenance:
        kept = [name for name in squares if TERMS[name].fixed]
        kept += ["model: offset", "model: rig"]
        in_common = sum(squares.get(name, 0.0) for name in kept)
        calibrated = math.sqrt(variance - in_common**2 / (variance + SHEARED_DEG**2))
        words = f"a soil of known angle ± {SHEARED_DEG:g}° on this rig (terraphi calibrate)"
        after.append(Measurement(words, calibrated))
        if further_records and answer.law == LEGS:
            after += _further_records(answer, rig)
    # What makes no difference to the tenth of a degree that is printed is left out.
    low, high = answer.phi.ci68
    better = [each for each in after if round(each.sd_deg, 1) < round(0.5 * (high - low), 1)]
    return sorted(better, key=lambda each: each.sd_deg)


def _further_records(answer: Answer, rig: Rig) -> Iterator[Measurement]:
    """The joint answer with another leg in the same soil, where the law has it."""
    from terraphi.inference.combined import combined

    soil = answer.provenance["soil"] | {
        "density": f"{answer.density_kg_m3}±{answer.density_sd_kg_m3 or 0.0}"
    }
    for leg in [leg for leg in OUTLINES if leg != rig.leg]:
        with suppress(InputError):
            second = plan(rig.model_copy(update={"leg": leg}), phi_deg=answer.phi.median, **soil)
            words = f"a {OUTLINES[leg].label} in the same soil"
            yield Measurement(words, combined([answer, second]).phi.sd)


def plan(
    rig: Any,
    *,
    phi_deg: float = 30.0,
    leg: str | None = None,
    density: float | str | None = None,
    grain_size_mm: float | None = None,
    cohesion: float | str | None = None,
    gain: float | str | None = None,
) -> Answer:
    """Invert the forces that law ``legs`` predicts for a rig in soil of some friction angle.

    The answer shows how certain φ will be on the rig, and :func:`next_measurements` what would
    narrow it.

    Parameters
    ----------
    rig, leg
        As of :func:`terraphi.invert`.
    phi_deg
        Friction angle in plane strain [deg].
    density, grain_size_mm, cohesion, gain
        As of :func:`terraphi.invert`; the cohesion may not be unknown.

    Raises
    ------
    InputError
        If the law does not have the rig, or the angle, or if the cohesion is unknown.

    Examples
    --------
    >>> answer = terraphi.plan("li2013", leg="c")
    >>> terraphi.next_measurements(answer)[0].sd_deg < answer.phi.sd
    True
    """
    law = shipped_legs()
    theta = np.radians(np.arange(-132.0, 132.5))
    still = ForceHistory(theta, np.zeros((theta.size, 2)))
    soil: dict[str, Any] = {"density": density, "grain_size_mm": grain_size_mm,
                            "cohesion": cohesion, "gain": gain}  # fmt: skip
    # The soil as an inversion reads it: its record of no forces.
    record = record_of(measurement_of(still, "plan"), rig=rig, leg=leg, **soil)
    apparatus = record.rig
    if math.isinf(record.cohesion_sd_pa):
        raise InputError("a plan needs a cohesion; give PA±SD")
    angles = np.append(np.arange(90.0), phi_deg)
    angles_of_law = angles + law.error.offset(apparatus, record.grain_size_mm, angles)
    in_range = (law.phi_deg[0] <= angles_of_law) & (angles_of_law <= law.phi_deg[1])
    if not in_range[-1]:
        first, last = np.flatnonzero(in_range)[[0, -1]]
        meaning = f"phi = {phi_deg:g} is {angles_of_law[-1]:.1f}° as law legs reads it"
        ends = "{:g} to {:g}".format(*law.phi_deg)
        raise InputError(f"{meaning}, outside its {ends}°; give {first} to {last}°")
    curves = law.forces(
        apparatus, float(angles_of_law[-1]), density=record.density_kg_m3,
        cohesion_pa=record.cohesion_pa,
    )  # fmt: skip
    # Forces come as late as those of other records of this shape.
    theta = np.radians(curves.theta_deg.values + law.error.of_leg(apparatus.leg).shift_deg)
    history = ForceHistory(theta, record.gain * curves.forces.values[0].T)
    return invert(history, rig=apparatus, simulated=False, **soil)
