"""Strip footings that others computed and published, beside ours on as many cells.

The first is a regression test of another material point code, MarbleRun.jl by K. Nakamura
(quadratic B-splines with corrected gradients, 2×2 particles a cell, contact of particles with the
surface): ``test/GroundPenetration/StripFooting/DruckerPrager.toml`` of
github.com/KeitaNakamura/MarbleRun.jl, commit 338f422, and the forces that it keeps to compare
itself with, ``output/DruckerPrager_1.csv``, commit 02f9598. B = 1 m on cells of 0.05 m, c = 10 kPa,
φ = ψ = 30°, ρ = 1000 kg/m³, E = 200 MPa, ν = 0.3, friction 0.6, which is rough, 0.1 m/s for 10 mm,
in a bed that is 5 m wide, beside half of the footing, and 5 m deep. At this speed ρ c v is 12 % of
the limit pressure, so that the forces are no limit loads: they are compared with ours at that
speed, and ours at less with the exact load.

The second is by finite elements, Code_Aster (quadratic, small strains): a smooth strip,
c = 4.21 MPa, φ = ψ = 32.07°, B = 2 m, in ``code-aster/bc-strip-foundation`` of
github.com/SRaude/formation-mfront-2022, commit 90bd04b, where the weight of the soil is 0.1 % of
the load. The script that makes a mesh puts 20 elements beneath the footing, with cells as fine as
it has them, which fits the finest.

Both have the Drucker-Prager cone that is Mohr-Coulomb in plane strain with associated flow, as
ours, so that the limit load is the same and exact: that of the first by slip lines, of the second
by Prandtl, but that the tip of its cone is rounded, by a tenth of c cot φ.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from terraphi.experiment.scenario import GRAVITY, Scenario
from terraphi.forward.driver import simulate
from terraphi.library.workers import heartbeat
from terraphi_studies.verification.check import Check, Family, Outcome, Task, numbered
from terraphi_studies.verification.limit_loads import footing_cause, unrest
from terraphi_studies.verification.limit_scenarios import (
    BOTH,
    COHESION,
    CONFINEMENT,
    DENSITY,
    FOOTING_WIDTH,
    NODES,
    PRESET,
    RESOLVED,
    Drive,
    footing_scenario,
    surcharge_factor,
)

MARBLERUN = {1: 60.68, 2: 103.66, 3: 146.75, 4: 174.90, 5: 205.43, 6: 229.94, 7: 248.03, 8: 260.03,
             9: 271.66, 10: 259.82}  # fmt: skip
"""Settlement [mm] and force on half the footing [kN/m] that MarbleRun.jl keeps."""
CODE_ASTER = {437: 164.94, 816: 161.60, 1069: 159.57, 2792: 155.23}
"""Corners of the elements, and force on half the footing [MN/m], of Code_Aster."""
AS_RUN = Drive(
    stiffness=200e6 * (DENSITY / 1000.0) * FOOTING_WIDTH,
    speed=0.1 * math.sqrt(FOOTING_WIDTH),
    path=0.0101 * FOOTING_WIDTH,
    courant=0.6,
    jitter=0.0,
)
"""MarbleRun.jl's test in small: the same E/(γ B), v/√(g B) and settlement over B."""
FIRST = "E = 10⁵ q_u, ρ c v = 0.05 q_u"
"""What :func:`~terraphi_studies.verification.limit_scenarios.drive_at_first` chooses, in words."""
MOVED_NODES = (
    "contact with the nodes depends on where in a cell the footing stands, which has moved by 0.2 "
    "cells"
)
PHI_DEG, PHI_OF_ELEMENTS_DEG = 30.0, 32.07
ELEMENT_COHESION, ELEMENT_WIDTH = 4.21, 2.0
"""c [MPa] and B [m] of Code_Aster."""


def _pressed(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Settlement over B, and mean pressure [Pa]."""
    history = simulate(scenario, progress=lambda _: heartbeat(0.0))
    return history.position / FOOTING_WIDTH, history.force[:, 1] / (FOOTING_WIDTH / 2)


def _cause(settings: str) -> str:
    if settings == RESOLVED:
        return (
            "a mean dilatation with distortions of each particle is more conditions of flow than "
            "the nodes can fulfil, and soil flows as if contact ended a cell beyond the edge"
        )
    return footing_cause("cohesion", settings)


def press_as_run(settings: str, across: int = 20, slower: float = 1.0) -> Outcome:
    """MarbleRun.jl's footing at its stiffness, beside the forces that it keeps.

    Parameters
    ----------
    settings
        As in :func:`~terraphi_studies.verification.limit_scenarios.footing_scenario`.
    across
        B/Δx.
    slower
        Its speed over ours. Of a slow footing the last forces are held against the exact load.
    """
    scenario = footing_scenario(
        PHI_DEG, "rough", across, load="weight and cohesion", settings=settings, room=(5.0, 5.0),
        drive=replace(AS_RUN, speed=AS_RUN.speed / slower),
    )  # fmt: skip
    place, pressure = _pressed(scenario.replace(**{"leg.friction": 0.6}))
    # Single bins are noisy; theirs are single steps.
    ours = np.array([pressure[abs(1e3 * place - mm) < 0.25].mean() for mm in MARBLERUN])
    ours /= scenario.soil.cohesion
    theirs = np.array(list(MARBLERUN.values())) / (10.0 * 0.5)
    found = [
        ("mean of 1, 2 … 10 mm", theirs.mean(), ours.mean()),
        ("largest of these", theirs.max(), ours.max()),
    ]
    source = (
        "the forces that MarbleRun.jl keeps of its own run at B/Δx = 20; no limit load: at 9 and "
        f"10 mm they are {100 * (theirs[-2] / BOTH - 1):.0f} and "
        f"{100 * (theirs[-1] / BOTH - 1):.0f} % above the exact one"
    )
    if slower != 1.0:
        found, source = [("mean of 8, 9 and 10 mm", BOTH, ours[-3:].mean())], "slip lines"
    return Outcome(
        [
            Check(
                problem="Footing of MarbleRun.jl",
                case=f"rough, E = 470 q_u, ρ c v = {0.122 / slower:.2g} q_u",
                settings=settings,
                quantity=f"pressure/c, {what}",
                expected=float(expected),
                obtained=float(obtained),
                tolerance=0.10 if slower == 1.0 else 0.05,
                resolution=f"B/Δx = {across}",
                source=source,
                cause=MOVED_NODES if settings == NODES else _cause(settings),
            )
            for what, expected, obtained in found
        ]
    )


def press_slowly(settings: str, across: int, weight: bool) -> Outcome:
    """Either footing in the first geometry, beside its exact limit load.

    Parameters
    ----------
    settings, across
        As in :func:`press_as_run`.
    weight
        Whether it is MarbleRun.jl's, whose soil has weight; else that of Code_Aster.
    """
    if weight:
        problem, case, exact = "Footing of MarbleRun.jl", f"rough, {FIRST}", BOTH
        source = "slip lines"
        scenario = footing_scenario(
            PHI_DEG, "rough", across, load="weight and cohesion", settings=settings
        )
        cohesion = COHESION * DENSITY * GRAVITY * FOOTING_WIDTH
    else:
        problem, case = "Footing of Code_Aster", f"smooth, {FIRST}"
        tangent = math.tan(math.radians(PHI_OF_ELEMENTS_DEG))
        exact = (surcharge_factor(PHI_OF_ELEMENTS_DEG) - 1.0) / tangent
        over = 1.0 / (ELEMENT_COHESION * 0.5 * ELEMENT_WIDTH * exact)
        theirs = ", ".join(f"{100 * (force * over - 1):+.1f}" for force in CODE_ASTER.values())
        source = (
            f"Prandtl; Code_Aster has {theirs} % with {', '.join(map(str, CODE_ASTER))} corners of "
            "quadratic elements, of which 20 lie beneath the footing in the finest mesh"
        )
        scenario = footing_scenario(
            PHI_OF_ELEMENTS_DEG, "smooth", across, load="cohesion", settings=settings
        )
        cohesion = CONFINEMENT * tangent
    _, pressure = _pressed(scenario)
    factor = pressure / cohesion
    check = Check(
        problem=problem,
        case=case,
        settings=settings,
        quantity="q_u/c, first geometry",
        expected=exact,
        obtained=float(factor[-len(factor) // 4 :].mean()),
        tolerance=0.05,
        resolution=f"B/Δx = {across}",
        source=source,
        note=unrest(factor),
        cause=_cause(settings),
    )
    return Outcome([check])


SETTINGS = (PRESET, NODES, RESOLVED)
FAMILY = Family(
    title="Footings that others computed",
    meaning="Strip footings whose forces others have published, here on as many cells: a rough one "
    "on soil with weight and cohesion, φ = ψ = 30°, by another material point code, [MarbleRun.jl]"
    "(https://github.com/KeitaNakamura/MarbleRun.jl), whose regression test keeps them and is no "
    "validation; and a smooth one, of weightless soil, φ = ψ = 32.07°, by finite elements, "
    "[Code_Aster]"
    "(https://github.com/SRaude/formation-mfront-2022/tree/main/code-aster/bc-strip-foundation), "
    "from a course. MarbleRun.jl presses so fast that its forces are no limit loads: ours stand "
    "beside them at the same speed, and beside the exact load where the footing is slow. The ±10 % "
    "beside their forces was chosen when the deviations were known. Column "
    "`resolved` has the settings of that preset, the others those of the limit loads above.",
    full=[
        *numbered(
            "as-run",
            press_as_run,
            [
                {"settings": settings, "slower": slower}
                for slower, settings in itertools.product((1.0, 5.0), SETTINGS)
            ],
            10.0,
        ),
        *numbered(
            "slowly",
            press_slowly,
            [
                {"settings": settings, "across": n, "weight": weight}
                for (weight, n), settings in itertools.product(
                    ((True, 20), (False, 10), (False, 20)), SETTINGS
                )
            ],
            20.0,
        ),
    ],
    quick=[Task("as-run", press_as_run, {"settings": NODES})],
)
