"""The posterior of the friction angle by quadrature, or of another single parameter.

A single unknown needs no sampler: quadrature is exact. emcee, as in the paper (Xu & Wang), stays
for comparison (`friction_angle.drawn`). It takes a log-likelihood, known up to a constant, and a
uniform prior on bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray

LogLikelihood = Callable[[FloatArray], FloatArray]
"""Log-likelihood [-] of friction angles [deg], shape [k] -> [k]."""

# Refinement of the quadrature: a cell is split into four while it holds more than this much of the
# mass, may be wrong by more than that much of it, or while log p drops by more than this from a
# local maximum to the other end of the cell, for then the maximum itself may lie inside.
CELL_MASS = 2e-3
CELL_ERROR = 1e-9
PEAK_DROP = 0.05
SPLIT = np.array([0.25, 0.5, 0.75])
MAX_ROUNDS = 60


@dataclass(frozen=True, eq=False, kw_only=True)
class Posterior:
    """The posterior distribution of the friction angle; its density is linear between nodes.

    Attributes
    ----------
    bounds_deg
        Ends of the uniform prior [deg].
    phi_deg
        Nodes [deg], shape [node].
    cdf
        Cumulative distribution at the nodes [-], shape [node].
    density
        Normalised density at the nodes [1/deg], shape [node].
    convergence
        Diagnostics by name, plain numbers.
    """

    bounds_deg: tuple[float, float]
    phi_deg: FloatArray = field(repr=False)
    cdf: FloatArray = field(repr=False)
    density: FloatArray = field(repr=False)
    convergence: dict[str, float]

    @property
    def median(self) -> float:
        """Median [deg]."""
        return self.quantile(0.5)

    @property
    def sd(self) -> float:
        """Standard deviation [deg]."""
        mean = float(np.trapezoid(self.density * self.phi_deg, self.phi_deg))
        apart = np.square(self.phi_deg - mean)
        return float(np.sqrt(np.trapezoid(self.density * apart, self.phi_deg)))

    def interval(self, probability: float) -> tuple[float, float]:
        """Equal-tailed credible interval [deg].

        Parameters
        ----------
        probability
            Mass of the interval [-], in (0, 1).

        Raises
        ------
        ValueError
            If the probability is outside (0, 1).
        """
        if not 0.0 < probability < 1.0:
            raise ValueError(f"probability is {probability}; it must lie between 0 and 1")
        tail = (1.0 - probability) / 2.0
        return self.quantile(tail), self.quantile(1.0 - tail)

    def quantile(self, probability: float) -> float:
        """Friction angle [deg] below which a mass of ``probability`` lies.

        Parameters
        ----------
        probability
            Mass [-], in [0, 1].

        Raises
        ------
        ValueError
            If the probability is outside [0, 1].
        """
        if not 0.0 <= probability <= 1.0:
            raise ValueError(f"probability is {probability}; it must lie in [0, 1]")
        # The cell whose two ends enclose the probability, and the root of a quadratic within it,
        # in the form that does not cancel.
        i = int(np.searchsorted(self.cdf, probability, side="right")) - 1
        i = min(max(i, 0), self.cdf.size - 2)
        width, start, slope = self._cell(i)
        rest = max(probability - float(self.cdf[i]), 0.0)
        root = np.sqrt(max(start**2 + 2.0 * slope * rest, 0.0))
        offset = 2.0 * rest / (start + root) if start + root > 0.0 else 0.0
        return float(self.phi_deg[i] + min(offset, width))

    def mass(self, low: float, high: float) -> float:
        """Posterior probability [-] of friction angles between ``low`` and ``high`` [deg].

        Raises
        ------
        ValueError
            If ``low`` exceeds ``high`` or either is not a number.
        """
        if not low <= high:
            raise ValueError(f"low = {low} deg exceeds high = {high} deg")
        return self._mass_below(high) - self._mass_below(low)

    def _cell(self, i: int) -> tuple[float, float, float]:
        """Width [deg], density at the left end [1/deg] and its slope [1/deg^2] in cell i."""
        width = float(self.phi_deg[i + 1] - self.phi_deg[i])
        start = float(self.density[i])
        return width, start, (float(self.density[i + 1]) - start) / width

    def _mass_below(self, phi_deg: float) -> float:
        phi = min(max(phi_deg, float(self.phi_deg[0])), float(self.phi_deg[-1]))
        i = min(int(np.searchsorted(self.phi_deg, phi, side="right")) - 1, self.phi_deg.size - 2)
        _, start, slope = self._cell(i)
        offset = phi - float(self.phi_deg[i])
        return float(self.cdf[i]) + offset * (start + 0.5 * slope * offset)


def quadrature(
    log_likelihood: LogLikelihood, bounds_deg: tuple[float, float], *, nodes: int = 4001
) -> Posterior:
    """Posterior by the trapezoidal rule on nodes that gather where the mass is.

    Evenly spaced nodes come first. Cells are then split around every local maximum until it is
    resolved, and wherever they hold much mass or may be in error, so that a posterior much
    narrower than the first spacing, at an edge, or with several modes is integrated too: its
    cumulative distribution is right to about 1e-6. A mode that leaves no trace on the first nodes
    is not found.

    Parameters
    ----------
    log_likelihood
        Log-likelihood [-] up to a constant of friction angles [deg], shape [k] -> [k]. It may be
        minus infinity in places.
    bounds_deg
        Ends of the uniform prior [deg].
    nodes
        Number of evenly spaced nodes to begin with.

    Returns
    -------
    Posterior
        Its ``convergence`` has ``nodes``, the number used in the end, and
        ``relative_change_on_halving``: the most that the median or an end of the 68 % or 95 %
        interval moves if every second node is left out, over the half-width of the 68 % interval.

    Raises
    ------
    ValueError
        If the log-likelihood is NaN or plus infinity anywhere, minus infinity everywhere, or does
        not settle.
    """
    phi, log_p = _resolved(log_likelihood, bounds_deg, nodes)
    low, high = float(phi[0]), float(phi[-1])
    posterior = _from_nodes(phi, log_p, (low, high))
    every_second = np.r_[0 : phi.size - 1 : 2, phi.size - 1]
    coarse = _from_nodes(phi[every_second], log_p[every_second], (low, high))
    probabilities = (0.5, 0.16, 0.84, 0.025, 0.975)
    change = max(abs(posterior.quantile(p) - coarse.quantile(p)) for p in probabilities)
    half_width = 0.5 * (posterior.quantile(0.84) - posterior.quantile(0.16))
    convergence = {"nodes": phi.size, "relative_change_on_halving": change / half_width}
    return replace(posterior, convergence=convergence)


def _resolved(
    log_likelihood: LogLikelihood, bounds_deg: tuple[float, float], nodes: int
) -> tuple[FloatArray, FloatArray]:
    """Nodes that gather where the mass is [deg], and the log-likelihood there."""
    low, high = bounds_deg
    phi = np.linspace(low, high, nodes)
    log_p = _checked(log_likelihood, phi)
    if not np.isfinite(log_p).any():
        raise ValueError(f"the log-likelihood is minus infinity at all {nodes} nodes")
    # No cell may shrink to where its ends are the same floating-point number.
    narrowest = max(1e-12 * (high - low), 64.0 * float(np.spacing(np.abs([low, high]).max())))
    for _ in range(MAX_ROUNDS):
        split = np.flatnonzero(_unresolved(phi, log_p) & (np.diff(phi) > narrowest))
        if split.size == 0:
            break
        inner = (phi[split, None] + np.diff(phi)[split, None] * SPLIT).ravel()
        where = np.repeat(split + 1, SPLIT.size)
        log_p = np.insert(log_p, where, _checked(log_likelihood, inner))
        phi = np.insert(phi, where, inner)
    else:
        raise ValueError(
            f"the log-likelihood is not resolved by {phi.size} nodes after {MAX_ROUNDS} rounds of "
            "refinement; it does not look like a smooth function of phi"
        )
    return phi, log_p


def _unresolved(phi: FloatArray, log_p: FloatArray) -> NDArray[np.bool_]:
    """Cells that refinement must split, shape [node] -> [node - 1]."""
    p = np.exp(log_p - log_p.max())
    width, left, right = np.diff(phi), p[:-1], p[1:]
    trapezoid = 0.5 * width * (left + right)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Minus infinity at both ends gives NaN: no drop there.
        rise = np.nan_to_num(np.diff(log_p), nan=0.0, posinf=np.inf, neginf=-np.inf)
        # Exact where log p is linear in a cell; its distance from the trapezoid tells the error.
        exponential = np.where(np.abs(rise) > 1e-4, width * (right - left) / rise, trapezoid)
    total = trapezoid.sum()
    peak = np.isfinite(log_p)
    peak[1:] &= rise >= 0.0
    peak[:-1] &= rise <= 0.0
    beside_peak = peak[:-1] | peak[1:]
    return (
        (trapezoid > CELL_MASS * total)
        | (np.abs(trapezoid - exponential) > CELL_ERROR * total)
        | (beside_peak & (np.abs(rise) > PEAK_DROP))
    )


def _from_nodes(phi: FloatArray, log_p: FloatArray, bounds_deg: tuple[float, float]) -> Posterior:
    p = np.exp(log_p - log_p.max())
    mass = np.r_[0.0, np.cumsum(0.5 * np.diff(phi) * (p[:-1] + p[1:]))]
    return Posterior(
        bounds_deg=bounds_deg,
        phi_deg=phi,
        cdf=mass / mass[-1],
        density=p / mass[-1],
        convergence={},
    )


def _checked(log_likelihood: LogLikelihood, phi: FloatArray) -> FloatArray:
    log_p = np.asarray(log_likelihood(phi), dtype=np.float64)
    if log_p.shape != phi.shape:
        raise ValueError(f"the log-likelihood has shape {log_p.shape}; expected {phi.shape}")
    if not (log_p < np.inf).all():
        i = int(np.argmin(log_p < np.inf))
        raise ValueError(f"the log-likelihood is {log_p[i]} at phi = {float(phi[i])!r} deg")
    return log_p
