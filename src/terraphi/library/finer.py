"""Finer simulations of some of a library's cases, which say what its cells and its speed-up do.

A fine case is one of the library's with smaller cells (and what goes with them: time step, phase
length and particle seed), or with a smaller speed-up, and nothing else. They are made like any
library: take the plan, leave three to five friction angles in its sweep, evenly over the range and
both ends among them, and set in ``[scenario.numerics]`` for half the cell size

    cells = 2 x, time_step = 0.5 x, remap_interval = 0.5 x what it was

or ``speed_up`` to half of what it was. A third size, such as two thirds of the cell size, makes the
limit somewhat surer. ``terraphi library refine`` puts them into the library's file.

A fine case may lack the library's ``stiffness_damping`` where its soil hardly shakes without it:
what it lacks in force there, 5 % at most, is then counted as an effect of what is finer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.plausibility import soil_shakes
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import value_of
from terraphi.library.store import Case, Library

CAUSES = {"grid": "cells", "speed_up": "speed-up"}
"""What may be finer, and what it is called."""
SCALED = ("time_step", "remap_interval")
"""Keys of ``numerics`` that go with the cell size, in proportion."""
FREE = ("cells", "speed_up", "seed", *SCALED)
"""Keys of ``numerics`` in which a fine case may differ: what is finer and what goes with it."""
DAMPING = "stiffness_damping"
"""The one that it may lack where its soil does not shake."""
ALIKE = 0.02
"""How far from that proportion they may be [-]."""


class FineCurves(NamedTuple):
    """Fine curves of one leg and one cause."""

    phi_deg: FloatArray
    """Friction angles [deg], shape [row]."""
    ratio: FloatArray
    """Size over the library's [-], shape [row]: cell size over the library's; k - 1 over the
    library's."""
    repeats: FloatArray
    """Simulations that each is the mean of [-], shape [row]."""
    forces: FloatArray
    """Observation vectors [N], shape [row, 2 theta]."""


def finer(coarse: Scenario, fine: Scenario) -> tuple[str, float]:
    """Cause, one of :data:`CAUSES`, and ratio of a fine case, as :class:`FineCurves` has it.

    Raises
    ------
    InputError
        If it differs in anything else, in both, in neither, or is not finer.
    """
    told, own = (s.model_dump(mode="json") | {"name": ""} for s in (fine, coarse))
    undamped = fine.numerics.stiffness_damping == 0.0 and not soil_shakes(fine)
    for key in (*FREE, DAMPING) if undamped else FREE:
        told["numerics"][key] = own["numerics"][key]
    other = next((name for name in own if told[name] != own[name]), None)
    if other is not None:
        key = other
        if isinstance(own[other], dict):
            inner = next(k for k in own[other] if told[other].get(k) != own[other][k])
            key = f"{other}.{inner}"
        raise InputError(
            f"{key} is {value_of(fine, key)}, in the library {value_of(coarse, key)}; a finer case "
            "differs in its cells or its speed-up alone"
        )
    cells = fine.numerics.cell_size / coarse.numerics.cell_size
    k, k_fine = coarse.numerics.speed_up, fine.numerics.speed_up
    alike = abs(cells - 1.0) < 1e-9
    if not alike and k != k_fine:
        raise InputError(
            f"both its cells ({1e3 * fine.numerics.cell_size:.3g} mm, in the library "
            f"{1e3 * coarse.numerics.cell_size:.3g} mm) and its speed-up ({k_fine:g}, {k:g}) "
            "differ, so that nobody can tell what each does; change one of them"
        )
    if alike and k == k_fine:
        raise InputError("its cells and its speed-up are those of the library; make one smaller")
    if not alike and cells > 1.0:
        raise InputError(
            f"its cells of {1e3 * fine.numerics.cell_size:.3g} mm are coarser than the library's "
            f"of {1e3 * coarse.numerics.cell_size:.3g} mm; make them smaller"
        )
    if alike and not 1.0 <= k_fine < k:
        raise InputError(
            f"its speed-up is {k_fine:g}; between 1 and the library's, {k:g}, it tells of the error"
        )
    for key in SCALED if fine.model == "mpm" else ():
        value, own_value = (getattr(s.numerics, key) for s in (fine, coarse))
        if abs(value - cells * own_value) > ALIKE * cells * own_value:
            raise InputError(
                f"numerics.{key} is {value:g} s; it goes with the cells, and should be "
                f"{cells * own_value:g} s"
            )
    return ("speed_up", (k_fine - 1.0) / (k - 1.0)) if alike else ("grid", cells)


def twin(library: Library, fine: Scenario) -> Scenario:
    """The library's case of the same leg and friction angle.

    Raises
    ------
    InputError
        If it has none.
    """
    leg, phi = fine.leg.shape, fine.soil.friction_angle_deg
    found = {
        case.scenario.soil.friction_angle_deg: case.scenario
        for case in library.cases
        if case.history and case.scenario.leg.shape == leg
    }
    if phi not in found:
        has = f"has {', '.join(f'{p:g}' for p in sorted(found))}" if found else "lacks the leg"
        raise InputError(f"library '{library.name}' {has}; take an angle and a leg that it has")
    return found[phi]


def with_fine(library: Library, others: Sequence[Library]) -> Library:
    """The library with finer simulations of some of its cases beside those that it has.

    Parameters
    ----------
    library
        To be refined.
    others
        Whose cases, and replicates, all are finer ones.

    Raises
    ------
    InputError
        If one is no finer case of the library.
    """
    added: dict[str, Case] = {case.scenario.hash: case for case in library.fine}
    for other in others:
        for case in (*other.cases, *other.replicates):
            leg, phi = case.scenario.leg.shape, case.scenario.soil.friction_angle_deg
            try:
                finer(twin(library, case.scenario), case.scenario)
            except InputError as error:
                raise InputError(
                    f"'{other.name}', case of leg {leg} at {phi:g} deg: {error}"
                ) from error
            if case.history:
                added[case.scenario.hash] = case
    if not added:
        raise InputError("no finer case is finished; build them first")
    return replace(library, fine=tuple(added.values()), refinement={})


def fine_curves(
    library: Library, leg: str, *, readings: FloatArray | None = None
) -> dict[str, FineCurves]:
    """Fine curves of one leg by cause, over friction angle and size.

    Parameters
    ----------
    library
        Refined.
    leg, readings
        As in :meth:`Library.curves`.
    """
    groups: dict[tuple[str, float, float], list[FloatArray]] = {}
    for case in library.fine:
        if case.history and case.scenario.leg.shape == leg:
            cause, ratio = finer(twin(library, case.scenario), case.scenario)
            key = cause, case.scenario.soil.friction_angle_deg, round(ratio, 12)
            seen = case.history.as_read_at(readings).observation().vector
            groups.setdefault(key, []).append(seen)
    found = {}
    for cause in CAUSES:
        own = ((key[1:], v) for key, v in sorted(groups.items()) if key[0] == cause)
        rows = [(*key, len(vectors), np.mean(vectors, axis=0)) for key, vectors in own]
        if rows:
            found[cause] = FineCurves(*(np.array(column) for column in zip(*rows, strict=True)))
    return found


def untold(library: Library) -> dict[str, list[str]]:
    """Legs of a refined library without finer cases of their own, by cause, one of `CAUSES`.

    All legs, if none has any: then that cause is not taken out of the forces. Otherwise another
    leg's finer cases stand for those of a leg that has none. Of a library that is not sped up
    there is nothing to take out.
    """
    told = {
        (case.scenario.leg.shape, finer(twin(library, case.scenario), case.scenario)[0])
        for case in library.fine
    }
    fast = any(case.scenario.numerics.speed_up > 1.0 for case in library.cases)
    causes = [cause for cause in CAUSES if fast or cause != "speed_up"]
    legs = {cause: [leg for leg in library.legs if (leg, cause) not in told] for cause in causes}
    return {cause: without for cause, without in legs.items() if without}
