"""The stress at rest: what K0 = 0.5 in place of 1 - sin φ changes in a history.

Two libraries of the same cases, particles included, that differ in K0 alone. Changes are taken on
1° means within the engaged window, relative to the largest force of that component.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.soil import Soil
from terraphi.library.shipped import companion
from terraphi.library.store import Case
from terraphi.view.plots import BLUE, ORANGE, Curve, comparison_figure
from terraphi.view.table import Table
from terraphi_studies import Study
from terraphi_studies.measures import means_of

LIBRARIES = "k0"
"""Common beginning of the names of the two shipped libraries."""
PAPER_LIMIT_PERCENT = 0.5
COLUMNS = (
    ("φ", "{phi_deg:g}°"),
    ("1 - sin φ", "{k0_jaky:.3f}"),
    ("change of Fz", lambda case: f"{100.0 * case['relative_change']['Fz']:.2f} %"),
    ("change of Fx", lambda case: f"{100.0 * case['relative_change']['Fx']:.2f} %"),
)


def run(*, library: str = LIBRARIES) -> Study:
    """Largest change of a history between the two stresses at rest.

    Parameters
    ----------
    library
        Common beginning of the names of two libraries, ``-jaky`` with K0 = 1 - sin φ
        and ``-half`` with K0 = 0.5.

    Returns
    -------
    Study
        ``data``: ``library``, ``yield``, ``max_relative_change`` [-], the largest of all cases and
        both forces; ``cases`` (``phi_deg``, ``k0_jaky``, ``relative_change`` by force). A figure
        of the case that changes most.

    Raises
    ------
    InputError
        If a library is missing, or they differ in more than K0.
    """
    jaky, half = (companion(library, name) for name in ("jaky", "half"))
    if len(jaky.cases) != len(half.cases):
        raise InputError(
            f"'{jaky.name}' has {len(jaky.cases)} cases and '{half.name}' {len(half.cases)}; build "
            "both libraries from one scenario"
        )
    pairs = [_pair(one, other) for one, other in zip(jaky.cases, half.cases, strict=True)]
    angles = [case.scenario.soil.friction_angle_deg for case in jaky.cases]
    cases: list[dict[str, Any]] = [
        {
            "phi_deg": phi,
            "k0_jaky": 1.0 - math.sin(math.radians(phi)),
            "relative_change": relative_change(*pair),
        }
        for phi, pair in zip(angles, pairs, strict=True)
    ]
    changes = [max(case["relative_change"].values()) for case in cases]
    worst = int(np.argmax(changes))
    convention = jaky.cases[0].scenario.convention
    soils = [[case.scenario.soil for case in library.cases] for library in (jaky, half)]
    beyond = [
        soil.friction_angle_deg
        for soil, other in zip(*soils, strict=True)
        if yields_at_rest(soil) and yields_at_rest(other)
    ]
    notes = []
    if beyond:
        ends = " to ".join(f"{phi:g}" for phi in sorted({min(beyond), max(beyond)}))
        notes.append(
            f"At {len(beyond)} of {len(cases)} angles, {ends}°, both stresses at rest lie "
            "beyond the yield surface, to which the first step takes them back."
        )
    title = f"The case that changes most, φ = {angles[worst]:g}° ({convention})"
    before, after = pairs[worst]
    curves = [Curve("K0 = 1 − sin φ", before, BLUE), Curve("K0 = 0.5", after, ORANGE, "--")]
    return Study(
        table=Table.of(
            f"Largest change of a history from K0 = 1 - sin φ to 0.5, libraries '{library}-jaky' "
            f"and '{library}-half' (φ: {convention})",
            COLUMNS,
            cases,
        ),
        data={
            "library": library,
            "yield": convention,
            "max_relative_change": max(changes),
            "cases": cases,
        },
        notes=notes,
        figures={"k0": comparison_figure(title, curves)},
        beside_paper=[
            (
                "largest change of a history",
                f"{100.0 * max(changes):.2f} %",
                f"below {PAPER_LIMIT_PERCENT:g} %",
            )
        ],
    )


def yields_at_rest(soil: Soil) -> bool:
    """Whether the stress at rest lies beyond the yield surface, in the plane and without cohesion.

    Its principal stresses are σ and K0 σ, so that it does if |1 - K0| / (1 + K0) exceeds the sine
    of the friction angle that acts there.
    """
    sine = math.sin(math.radians(soil.plane_strain_friction_angle_deg))
    return abs(1.0 - soil.k0_at_rest) / (1.0 + soil.k0_at_rest) > sine


def relative_change(before: ForceHistory, after: ForceHistory) -> dict[str, float]:
    """Largest change of each force on 1° means over its largest value [-], by force."""
    old, new = (means_of(history) for history in (before, after))
    fx, fz = (np.abs(new - old).max(axis=0) / np.abs(old).max(axis=0)).tolist()
    return {"Fz": fz, "Fx": fx}


def _pair(one: Case, other: Case) -> tuple[ForceHistory, ForceHistory]:
    """Two histories, of scenarios that differ in K0 alone."""
    if one.scenario.replace(**{"soil.k0": 0.5}).hash != other.scenario.hash:
        raise InputError(
            f"the cases at {one.scenario.soil.friction_angle_deg:g} and "
            f"{other.scenario.soil.friction_angle_deg:g} deg differ in more than K0 = 1 - sin φ "
            "and 0.5; build both libraries from one scenario"
        )
    if one.history is None or other.history is None:
        raise InputError(f"a case failed: {one.failure or other.failure}")
    return one.history, other.history
