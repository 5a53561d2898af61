"""What a library is to carry in its file: particle scatter, hyperparameters, and a certificate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.errors import InputError
from terraphi.inference.coverage import calibrate
from terraphi.inference.library import PreparedLeg, learn
from terraphi.library import Library, hash_of, unseeded

FloatArray = NDArray[np.float64]

WORLD_COUNT = 5000
OTHER_SEEDS = 4
"""Seeds after the certificate's own with which the ranks are looked at again."""


def certified(
    library: Library,
    replicates: Library | None = None,
    *,
    worlds: int = WORLD_COUNT,
    seed: int = 0,
    progress: Callable[[float, float], None] | None = None,
) -> Library:
    """Learn the scatter of a library, check the coverage of its intervals, and note both in it.

    Parameters
    ----------
    library
        Simulations over the friction angle.
    replicates
        Some of them again, under other particle seeds, in addition to those that the library
        carries; without any the scatter is learnt from the curves alone.
    worlds, seed
        Number of replicates of the check, and their seed.
    progress
        Called with the legs done and the number of legs.

    Returns
    -------
    Library
        The same with its calibration. Its certificate is that of the seed; beside it stands how
        uniform the ranks are with other seeds.

    Raises
    ------
    InputError
        If the replicates are not of this library, or it has no leg to infer with.
    """
    legs: dict[str, Any] = {}
    certificates: dict[str, Any] = {}
    again: dict[str, list[float]] = {}
    known = library.calibration if library.replicates else {}
    origin = {key: known.get(key) for key in ("replicates", "replicates_hash")}
    if replicates is not None:
        library = with_replicates(library, replicates)
        given = {case.scenario.hash for case in replicates.cases}
        kept = any(case.scenario.hash not in given for case in library.replicates)
        named = (origin["replicates"] or "").split(", ") if kept else []
        origin = {
            "replicates": ", ".join(dict.fromkeys([*filter(None, named), replicates.name])),
            "replicates_hash": hash_of(library.replicates),
        }
    for leg in library.legs:
        curves = library.curves(leg)
        surrogate = learn(curves, library.repeated(leg))
        legs[leg] = {"scatter": surrogate.scatter.as_dict(), "kernel": surrogate.kernel.as_dict()}
        prepared = PreparedLeg.of(surrogate, curves)
        certificates[leg] = calibrate(prepared, replicates=worlds, seed=seed).as_dict()
        again[leg] = [
            calibrate(prepared, replicates=worlds, seed=seed + i).chi2_probability
            for i in range(1, 1 + OTHER_SEEDS)
        ]
        if progress is not None:
            progress(len(legs), len(library.legs))
    calibration = {
        "library_hash": library.hash,
        **origin,
        "legs": legs,
        "certificate": {
            "seed": seed,
            "legs": certificates,
            "rank_chi2_p_of_other_seeds": again,
        },
    }
    return replace(library, calibration=calibration)


def with_replicates(library: Library, replicates: Library) -> Library:
    """The library with more of its cases again, under other particle seeds.

    Parameters
    ----------
    library, replicates
        As in :func:`certified`.

    Raises
    ------
    InputError
        If a replicate is not a case of the library but for its seed, or has its very seed.
    """
    known = {c.scenario.hash for c in library.cases}
    own = {unseeded(c.scenario) for c in library.cases if c.history}
    for case in replicates.cases:
        if case.scenario.hash in known:
            raise InputError(
                f"'{replicates.name}' repeats a simulation, with the seed "
                f"{case.scenario.numerics.seed} at "
                f"{case.scenario.soil.friction_angle_deg:g} deg: that tells nothing of the scatter"
            )
        known.add(case.scenario.hash)
        if unseeded(case.scenario) not in own:
            raise InputError(
                f"'{replicates.name}' is not of replicates of library '{library.name}': its case "
                f"at {case.scenario.soil.friction_angle_deg:g} deg, leg "
                f"{case.scenario.leg.shape}, is no case of the library under another seed"
            )
    added = {c.scenario.hash: c for c in (*library.replicates, *replicates.cases) if c.history}
    return replace(library, replicates=tuple(added.values()))
