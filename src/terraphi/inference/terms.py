"""The table of what an answer is uncertain by: each term, its source, and who shares its error.

A term is one cause of error. It adds a covariance to the forces, and by that a standard deviation
to φ. Two records, or two answers, that share the cause are wrong by the same error, each times its
own size; otherwise their errors are independent. The likelihood, joint answers, tools and
calibration all read this table, so that a new term is one row here and its size where the forces
are known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

SMALLEST = 0.01
"""Share of the largest term below which a term is left out of the budget [-]."""


class Term(NamedTuple):
    """One cause of error."""

    source: Literal["learned", "given", "assumed"]
    """Origin of the size: training soils and simulations; the user's rig, record and options; or
    the authors' choice."""
    key: Literal["record", "rig", "leg", "law", "soil"]
    """What records and answers have in common if they share the error."""
    fixed: bool = False
    """It stays as it is in an apparatus, so that a calibration of that rig includes it."""
    residual: bool = False
    """It shows in the residual; the other terms move the whole curve and look like another φ."""
    weighs: bool = True
    """Answers that share it count it as shared when they are weighed against each other."""


TERMS: dict[str, Term] = {
    # Readings, and the law's curves between its simulations.
    "noise": Term("given", "record", residual=True),
    "emulator": Term("learned", "rig", residual=True),
    "particle scatter": Term("learned", "record", residual=True),
    # The apparatus. Legs of one laboratory have one surface, one sensor and one hip.
    "leg friction": Term("given", "law", fixed=True),
    "hip height": Term("given", "law", fixed=True),
    "gain": Term("given", "law", fixed=True),
    # The soil. All answers read too high in damp soil, but not by the same share.
    "density": Term("given", "soil"),
    "cohesion": Term("assumed", "soil", weighs=False),
    # How real soils differ from the law of legs: terraphi.laws.model_error.
    "model: offset": Term("learned", "law"),
    "model: soil": Term("learned", "soil"),
    "model: leg": Term("learned", "leg"),
    "model: rig": Term("learned", "rig"),
    "model: bed": Term("learned", "record"),
    "missing angles": Term("learned", "record"),
    "missing forces": Term("learned", "record"),
    "second opinion": Term("assumed", "rig"),
    # Bodies that are pressed in, by the law of a foot.
    "model: law": Term("learned", "law"),
    "model: compaction": Term("learned", "law"),
    "model: course": Term("assumed", "record", residual=True),
    "contraction": Term("learned", "record"),
    "surface friction": Term("assumed", "law"),
    "rectangle": Term("learned", "law"),
    "slip": Term("learned", "law"),
    "resistance": Term("learned", "law"),
    "contact": Term("assumed", "record"),
    "depth": Term("assumed", "record"),
    "grain size": Term("learned", "record"),
    # A walk, by the names of a map's errors that all its footfalls share.
    "torque_gain": Term("learned", "leg", fixed=True),
    "joint_friction_Nm": Term("learned", "leg", fixed=True),
    "odometry_drop": Term("assumed", "rig"),
    "foot_radius_mm": Term("given", "rig", fixed=True),
    "density_kg_m3": Term("given", "soil"),
    "surface_friction": Term("assumed", "law"),
    "law_offset_deg": Term("learned", "law"),
    "law_exponent": Term("learned", "law"),
    "law_slope": Term("learned", "law"),
    "other_law": Term("assumed", "law"),
    "ground_slope": Term("learned", "soil"),
    # Joint answers.
    "disagreement": Term("learned", "record"),
}
"""Every term of an interval by its name in the budget."""


def ordered_budget(sds: Mapping[str, float]) -> dict[str, float]:
    """Standard deviations of φ by term [deg], the largest first and the negligible left out."""
    least = SMALLEST * max(sds.values(), default=0.0)
    ordered = sorted(sds.items(), key=lambda item: -item[1])
    return {name: sd for name, sd in ordered if TERMS[name] and sd > least}


def root_sum_square(budget: Mapping[str, float], *excluded: str) -> float:
    """Standard deviation of φ by all terms of a budget but some [deg]."""
    return math.hypot(*(sd for name, sd in budget.items() if name not in excluded))
