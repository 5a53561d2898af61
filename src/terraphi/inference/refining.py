"""Libraries refined by finer simulations: what these change, and whether they are foretold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.inference.prepared_leg import prepare, surrogate_of
from terraphi.library.finer import FineCurves, fine_curves, with_fine
from terraphi.library.store import Library
from terraphi.surrogate.fidelity import Correction, priors_of


def refined(library: Library, others: Sequence[Library]) -> Library:
    """The library with finer simulations of some of its cases, and the correction that they give.

    Parameters
    ----------
    library, others
        As in :func:`~terraphi.library.finer.with_fine`.

    Raises
    ------
    InputError
        If one is no finer case of the library, or nothing can be inferred with that.
    """
    bare = with_fine(library, others)
    told: dict[str, dict[str, dict[str, float]]] = {}
    for leg in dict.fromkeys(case.scenario.leg.shape for case in bare.fine):
        surrogate = surrogate_of(bare, leg, bare.curves(leg))
        told[leg] = {
            cause: Correction.of(
                surrogate, fine, priors=priors_of(cause, library.plan.scenario)
            ).as_dict()
            for cause, fine in fine_curves(bare, leg).items()
        }
    return replace(bare, refinement=told)


def corrections(library: Library) -> list[dict[str, Any]]:
    """What the correction of a refined library does to each force, JSON-able.

    Returns
    -------
    list
        For each leg at its least, middle and largest friction angle ``leg``, ``phi_deg``; for
        ``Fx`` and ``Fz`` the factor that comes closest to the change over θ, with its standard
        deviation, ``percent`` and ``sd_percent``, and what that is of the mean force, ``newton``
        and ``sd_newton``; and for ``phi`` by how much the angle of least squares that is read off
        a record rises, ``deg`` and ``sd_deg``.
    """
    found = []
    for leg in library.legs:
        surrogate = prepare(library, leg).surrogate
        simulated = surrogate.as_simulated
        angles = surrogate.phi_deg
        for phi in angles[[0, len(angles) // 2, -1]].tolist():
            before, after = simulated.predict(phi)[0], surrogate.predict(phi)[0]
            error = surrogate.covariance(phi) - simulated.covariance(phi)
            slope = surrogate.slope(phi)
            shift = slope / (slope @ slope)
            read = {"deg": -float(shift @ (after - before)), "sd_deg": _sd(shift, error)}
            row: dict[str, Any] = {"leg": leg, "phi_deg": phi, "phi": read}
            for name, part in zip(("Fx", "Fz"), np.split(np.arange(before.size), 2), strict=True):
                along = before[part] / np.square(before[part]).sum()
                sd = _sd(along, error[np.ix_(part, part)])
                change = float(along @ (after - before)[part])
                mean = float(np.abs(before[part]).mean())
                row[name] = {
                    "percent": 100.0 * change,
                    "sd_percent": 100.0 * sd,
                    "newton": mean * change,
                    "sd_newton": mean * sd,
                }
            found.append(row)
    return found


def _sd(weights: FloatArray, covariance: FloatArray) -> float:
    """Standard deviation of a sum with weights."""
    return float(np.sqrt(weights @ covariance @ weights))


def left_out(library: Library) -> list[dict[str, Any]]:
    """Each friction angle's finest curve foretold by those of the other angles, JSON-able.

    Returns
    -------
    list
        For each leg, cause and angle, where there are two at least, ``leg``, ``cause``,
        ``phi_deg``, and by how much the finest simulations change the angle of least squares that
        is read off a record: ``deg``, ``foretold_deg``, and the standard deviation of the
        difference, ``sd_deg``, particle scatter included.
    """
    found = []
    for leg in library.legs:
        coarse = surrogate_of(library, leg, library.curves(leg))
        for cause, fine in fine_curves(library, leg).items():
            for phi in np.unique(fine.phi_deg).tolist() if np.ptp(fine.phi_deg) else []:
                there = fine.phi_deg == phi
                rest = FineCurves(*(part[~there] for part in fine))
                others = Correction.of(coarse, rest, priors=priors_of(cause, library.plan.scenario))
                row = int(np.flatnonzero(there)[fine.ratio[there].argmin()])
                at, ratio = np.array([phi]), float(fine.ratio[row])
                forces = coarse.predict(at)
                change = fine.forces[row] - forces[0]
                foretold = others.mean(at, forces, ratio=ratio)[0]
                error = others.covariance(at, forces, ratio=ratio)[0] + coarse.covariance(phi)
                own = others.kernel.scatter**2 / fine.repeats[row]
                error += own * coarse.scatter.covariance(phi)
                slope = coarse.slope(phi)
                shift = slope / (slope @ slope)
                told = {"leg": leg, "cause": cause, "phi_deg": phi, "deg": -float(shift @ change)}
                told |= {"foretold_deg": -float(shift @ foretold), "sd_deg": _sd(shift, error)}
                found.append(told)
    return found
