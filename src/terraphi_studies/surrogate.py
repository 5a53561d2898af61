"""The surrogate between a library's angles: mean surfaces, held-out cases, residuals.

The surrogate is fitted to the library and asked for the forces of the truths, simulated off its
grid with other particle seeds. What is left over is correlated over the leg angle; its correlation
length is the one that the paper's residual covariance needs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.inference.paper_likelihood import (
    residual_autocorrelation,
    residual_correlation_length_deg,
)
from terraphi.library.shipped import companion
from terraphi.library.store import Curves, Library
from terraphi.surrogate.paper import LegSurrogate
from terraphi.view.table import Table
from terraphi_studies import PAPER_LIBRARY, Study
from terraphi_studies.degrees import LEG
from terraphi_studies.measures import straight_truths
from terraphi_studies.pictures import autocorrelation_figure, slices_figure, surfaces_figure

ANGLES_DEG = (-50.0, -25.0, 0.0)
"""Leg angles at which held-out errors are told [deg]: from the peak of F_z to that of F_x."""
PAPER_LENGTH_DEG = 6.0
FORCES = ("Fx", "Fz")
COLUMNS = (
    ("force", "{force}"),
    ("leg angle", "{theta_deg:.0f}°"),
    ("median relative error", "{relative_error_percent[median]:.2f} %"),
    ("largest", "{relative_error_percent[max]:.2f} %"),
)


class HeldOut(NamedTuple):
    """A surrogate and the cases that it has not seen."""

    curves: Curves
    """What it was fitted to."""
    surrogate: LegSurrogate
    phi_deg: FloatArray
    """Their friction angles [deg], shape [case]."""
    truth: FloatArray
    """Their observation vectors [N], shape [case, 2 theta]."""
    predicted: FloatArray
    """Those of the surrogate [N], same shape."""

    def residuals(self) -> FloatArray:
        """Truth minus prediction over each force's peak-to-peak [-], shape [2 case, theta]."""
        parts = zip(
            np.hsplit(self.truth - self.predicted, 2), np.hsplit(self.truth, 2), strict=True
        )
        return np.vstack([left / np.ptp(force, axis=1, keepdims=True) for left, force in parts])


def run(*, library: str = PAPER_LIBRARY) -> Study:
    """Fit the surrogate and ask it for cases that it has not seen.

    Parameters
    ----------
    library
        Name of a shipped library that has truths, ``NAME-truths``.

    Returns
    -------
    Study
        ``data``: ``library``, ``yield``; ``parameters`` by force (correlation lengths [deg], noise
        [N]); ``held_out`` (``phi_deg``; ``angles``: list of ``theta_deg``, ``force``,
        ``relative_error_percent`` (``median``, ``max``)); ``nrmsd_percent`` by force, over all
        leg angles; ``correlation_length_deg``. Three figures.

    Raises
    ------
    InputError
        If there is no such library, or none of its truths.
    """
    found = held_out(library)
    convention = found.curves.scenario.convention
    theta, residuals = found.curves.theta_deg, found.residuals()
    length = residual_correlation_length_deg(theta, residuals)
    errors = [_error(found, force, at) for force in FORCES for at in ANGLES_DEG]
    rms = np.sqrt(np.mean(residuals.reshape(2, -1) ** 2, axis=1))
    nrmsd = {force: 100.0 * float(value) for force, value in zip(FORCES, rms, strict=True)}
    seen = np.hstack([found.curves.Fx, found.curves.Fz])
    points = {"library": (found.curves.phi_deg, seen), "held out": (found.phi_deg, found.truth)}
    indices = [_index(theta, at) for at in ANGLES_DEG]
    rho = residual_autocorrelation(theta, residuals)
    whole = (
        f"Over all {theta.size} leg angles the held-out forces deviate by {nrmsd['Fx']:.2f} % (Fx) "
        f"and {nrmsd['Fz']:.2f} % (Fz) of their peak-to-peak, root mean square."
    )
    return Study(
        table=Table.of(
            f"Surrogate of library '{library}' ({convention}), leg {LEG}, on cases held out",
            COLUMNS,
            errors,
        ),
        data={
            "library": library,
            "yield": convention,
            "parameters": {force: _parameters(found.surrogate, force) for force in FORCES},
            "held_out": {"phi_deg": found.phi_deg.tolist(), "angles": errors},
            "nrmsd_percent": nrmsd,
            "correlation_length_deg": length,
        },
        figures={
            "surfaces": surfaces_figure(found.surrogate, found.phi_deg, convention),
            "slices": slices_figure(found.surrogate, points, indices, convention),
            "residuals": autocorrelation_figure(*rho, length, PAPER_LENGTH_DEG),
        },
        notes=[whole, _about_the_spread(found), *_about_the_length(theta, residuals, length)],
        beside_paper=[
            (
                "correlation length of the residuals",
                f"{length:.1f}°",
                f"about {PAPER_LENGTH_DEG:.0f}°",
            )
        ],
    )


def _about_the_spread(found: HeldOut) -> str:
    """How many held-out forces the surrogate's own standard deviation covers."""
    curve = found.surrogate.predict_variance(found.phi_deg)
    angles = found.curves.theta_deg.size
    both = (found.surrogate.Fx, found.surrogate.Fz)
    noise = np.repeat([np.sqrt(process.noise_variance) for process in both], angles)
    off = np.abs(found.truth - found.predicted)
    inside = float(np.mean(off < 2.0 * np.sqrt(curve + noise**2)))
    return (
        f"{inside:.0%} of the held-out forces lie within two standard deviations, the surrogate's "
        "noise included, where 95 % should; of the curve alone, as drawn, "
        f"{float(np.mean(off < 2.0 * np.sqrt(curve))):.0%}."
    )


def _about_the_length(theta: FloatArray, residuals: FloatArray, length_deg: float) -> list[str]:
    """How well one correlation length describes the residuals; and if the angles cannot show it."""
    lags, rho = residual_autocorrelation(theta, residuals)
    kernel = np.exp(-0.5 * (lags / length_deg) ** 2)
    most = int(np.argmax(np.abs(rho - kernel)))
    fit = (
        "An autocorrelation of that length differs from the residuals' by up to "
        f"{abs(rho[most] - kernel[most]):.2f}: at {lags[most]:.1f}° theirs is {rho[most]:+.2f}."
    )
    if length_deg > 0.5 * lags[1]:
        return [fit]
    least = (
        f"{length_deg:.1f}° is the least that leg angles {lags[1]:.1f}° apart can give, and not a "
        "length that was measured."
    )
    return [least, fit]


def held_out(library: str) -> HeldOut:
    """Fit a surrogate to a shipped library and predict its truths.

    Raises InputError if there is no such library or it has no truths of the straight leg.
    """
    curves = Library.load(library).curves(LEG)
    truths = straight_truths(companion(library, "truths"))
    if not truths:
        raise InputError(f"library '{library}-truths' has no leg '{LEG}'")
    phi = np.array([truth.phi_deg for truth in truths])
    surrogate = LegSurrogate.fit(curves.phi_deg, curves.theta_deg, curves.Fx, curves.Fz)
    observed = np.stack([truth.history.observation().vector for truth in truths])
    return HeldOut(curves, surrogate, phi, observed, surrogate.predict(phi))


def _index(theta_deg: FloatArray, at_deg: float) -> int:
    return int(np.abs(theta_deg - at_deg).argmin())


def _error(found: HeldOut, force: str, at_deg: float) -> dict[str, Any]:
    """Error of one force at one leg angle over all held-out cases, relative to that force."""
    theta = found.curves.theta_deg
    i = _index(theta, at_deg) + FORCES.index(force) * theta.size
    relative = 100.0 * np.abs(found.predicted[:, i] / found.truth[:, i] - 1.0)
    return {
        "force": force,
        "theta_deg": float(theta[_index(theta, at_deg)]),
        "relative_error_percent": {
            "median": float(np.median(relative)),
            "max": float(relative.max()),
        },
    }


def _parameters(surrogate: LegSurrogate, force: str) -> dict[str, float]:
    process = surrogate.Fx if force == "Fx" else surrogate.Fz
    return {
        "phi_length_deg": process.kernel.phi_length_deg,
        "theta_length_deg": process.kernel.theta_length_deg,
        "noise_N": float(np.sqrt(process.noise_variance)),
    }
