r"""The friction angle under one touch-down, by a force law and least squares; many at a time.

For the upward force F of a touch-down, its ball's descent d since the first force and time t,

.. math::
    F_k = F_{law}\bigl(z_k,\ \gamma_k;\ \varphi, \rho, \mu_s, R\bigr)
          + \frac{d}{dt} m(z_k)\,\dot z_k + e_k,\qquad z_k = d_k + z_0 + w\,t_k,

with the mass m of soil that moves with the foot (:func:`~terraphi.laws.foot.moved_mass`), the
friction angle φ, the depth z₀ at which the foot's lowest point lies at touch-down (the surface is
not known), a vertical drift w of the odometry, and noise e that is correlated over
:data:`CORRELATION_S`. The likelihood of φ, with z₀ and w under their priors, is taken as normal
about its mode (Laplace): φ's own prior is the pooling's, and counts once. What all
footfalls share, θ, is held at its prior's mean θ₀ here; how far that puts the mode off
follows from the same linearisation, φ̂ = φ + S (θ − θ₀) + e, and is left to the pooling.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray, IntArray
from terraphi.inference.estimator import least_squares, weights
from terraphi.laws.foot import (
    LAWS,
    SURFACE_FRICTION,
    SURFACE_FRICTION_SD,
    Foot,
    FootLaw,
    inertial_force,
)

PHI_RANGE = (15.0, 50.0)
"""Friction angles in plane strain for which laws are evaluated [deg]: law ``foot`` has a table from
17 to 52° and is continued by 3°."""
NOISE_N, NOISE_PART = 1.5, 0.04
"""Standard deviation of a force: constant [N], and as a part of it [-]; odometry is in it.
Residuals scale the result, so that the ratio of both counts (chosen)."""
INERTIA_PART = 0.3
"""Standard deviation of the inertia's force, as a part of it [-]: half of what balls in grains
differ by (``docs/landing.md``; from 0.1 to 0.8 their angles differ by 0.2° root mean square)."""
CORRELATION_S = 0.008
"""Correlation time of the noise [s]: a few samples of a log of 500 Hz (chosen)."""
EXPONENTS = (-0.7, 0.4)
"""Range of what is added to a law's power of depth [-]; the upper end makes law ``foot`` grow like
resistive force theory, whose stress is proportional to the depth."""
TAUGHT_SD = 0.03
"""Standard deviation of an exponent that touch-downs have taught [-]; on walks made from the law it
errs by 0.01 (``tests/robot/test_footfall_truth.py``), on simulated ones by 0.05."""
EXPONENT_SD = 0.1
"""Of the exponent that the right law would be given [-] (worlds of ``examples/sand_check.py``)."""
MOST_FITTED = 120
"""Footfalls from which what they share is learned at most, evenly chosen, so that what no model has
right does not grow into certainty with the length of a log (chosen)."""
FEWEST = 10
"""Samples that a touch-down needs while the foot goes down, to fit three quantities; touch-downs
that teach how a law grows with depth."""
BLOCK = 512
"""Touch-downs that are fitted together; bounds the memory."""

Rows = TypeVar("Rows", bound=NamedTuple)


class Touchdowns(NamedTuple):
    """Touch-downs of a log, feet that load soil; arrays of shape [touchdown, sample] or as noted.

    Attributes
    ----------
    foot
        Number of the foot, fore feet first, shape [touchdown].
    begin
        Touch-down of the stance on the log's clock [s], shape [touchdown].
    place
        Of the foot in the world when its loading ends [m], shape [touchdown, 3].
    time
        Since touch-down [s].
    drop
        How far the ball has gone down since touch-down [m].
    descent
        Angle of its velocity below the horizontal [rad].
    speed
        [m/s].
    acceleration
        Of the ball, downward [m/s²].
    force
        Upward force on the foot [N].
    per_error
        What errors of the leg's torques add to it [N]: of the gains of its three joints, and
        friction of 1 N m in them; shape [touchdown, sample, 6].
    used
        Whether the sample is there, and the foot is going down in it.
    torn
        Samples are missing, or come too slowly for a touch-down; shape [touchdown].
    saturated
        A motor of the leg is at its limit in it; shape [touchdown].
    faulty
        The log contradicts its robot then; shape [touchdown].
    returned
        Work that the ground gives back at the end of the stance, over what the loading put in [-],
        shape [touchdown].
    peak, deepest
        Of the whole stance: largest force [N] and largest drop [m], shape [touchdown].
    broken
        Largest part of the force that is lost while the foot goes deeper [-], shape [touchdown];
        what the soil's inertia adds to a landing does not count.
    """

    foot: IntArray
    begin: FloatArray
    place: FloatArray
    time: FloatArray
    drop: FloatArray
    descent: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    force: FloatArray
    per_error: FloatArray
    used: BoolArray
    torn: BoolArray
    saturated: BoolArray
    faulty: BoolArray
    returned: FloatArray
    peak: FloatArray
    deepest: FloatArray
    broken: FloatArray


@dataclass(frozen=True)
class Prior:
    """What is known before the forces are seen: means and standard deviations.

    Attributes
    ----------
    phi_deg, phi_sd_deg
        Of the friction angle in plane strain [deg].
    level_sd, drift_sd
        Of the depth at touch-down [m] and of the odometry's drift [m/s], about zero.
    density, density_sd
        Bulk density [kg/m³].
    surface_friction, surface_friction_sd
        Between foot and soil [-]. A foot that touches down moves steeply: its drag over lift
        differs by at most 0.02 between 0.3 and 0.5, less than by gains of the torques.
    radius, radius_sd
        Of the foot [m].
    shape
        Of the foot.
    drop_sd
        Of the way that feet go down, as the odometry has it, relative [-]: standing feet give
        way a little while the load moves over, and the attitude errs.
    law_sd_deg
        Of the law's offset [deg]; not given: the law's own.
    exponent, exponent_sd
        Of an exponent by which the law's growth with depth is wrong [-]: of the depth over the
        foot's radius, a factor on the law.
    slope_sd
        Of a relative error of differences of φ between places [-], for the law grows with φ
        otherwise than the soil. Between loose grains of six soils law ``foot`` reads 1.03 ± 0.08
        of what a shear cell does (line through the last table but two of ``docs/plates.md``).
    other_law_sd
        Of the part [-] of what another law reads otherwise between places (:func:`likeness`).
    """

    phi_deg: float = 32.0
    phi_sd_deg: float = 8.0
    level_sd: float = 0.01
    drift_sd: float = 0.01
    density: float = 1550.0
    density_sd: float = 80.0
    surface_friction: float = SURFACE_FRICTION
    surface_friction_sd: float = SURFACE_FRICTION_SD
    radius: float = 0.022
    radius_sd: float = 0.0005
    shape: str = "ball"
    drop_sd: float = 0.02
    law_sd_deg: float | None = None
    exponent: float = 0.0
    exponent_sd: float = 0.2
    slope_sd: float = 0.1
    other_law_sd: float = 0.0

    @property
    def foot(self) -> Foot:
        """The foot of that radius and shape."""
        return Foot(self.radius, self.shape)  # type: ignore[arg-type]

    def shared(self) -> dict[str, tuple[float, float]]:
        """Mean and standard deviation of what all footfalls share, but errors of torques."""
        law_sd = LAWS["foot"].sd_deg if self.law_sd_deg is None else self.law_sd_deg
        return {
            "odometry_drop": (0.0, self.drop_sd),
            "density_kg_m3": (self.density, self.density_sd),
            "surface_friction": (self.surface_friction, self.surface_friction_sd),
            "foot_radius_mm": (1e3 * self.radius, 1e3 * self.radius_sd),
            "law_offset_deg": (0.0, law_sd),
            "law_exponent": (self.exponent, self.exponent_sd),
            "law_slope": (0.0, self.slope_sd),
            "other_law": (0.0, self.other_law_sd),
        }


TORQUES = 24
"""Errors of the torques of twelve joints: gains [-], then Coulomb friction [N m]."""
STEPS = np.array([[0, 0, 0], [0.1, 0, 0], [-0.1, 0, 0], [0, 1e-4, 0], [0, -1e-4, 0]])
"""Of φ [deg], z₀ [m] and w [m/s], for forces and their differences."""
CHANGES = {
    "surface_friction": ("surface_friction", 0.05, 1.0),
    "foot_radius_mm": ("radius", 2e-4, 1e3),
}
"""Of quantities that footfalls share: field of the prior, step of its differences, and unit."""


class Fit(NamedTuple):
    """Likelihood of φ of each touch-down; arrays of shape [touchdown] unless noted.

    Attributes
    ----------
    phi
        Mode of φ [deg].
    sd
        Its standard deviation with what is shared known, scaled to the residuals by Birge's ratio
        √(χ² over the degrees of freedom), which the Particle Data Group uses (S. Navas et al.,
        Phys. Rev. D 110 (2024) 030001, sect. 5.2) where it is above 1 [deg].
    sinkage
        Depth of the lowest point at the end of the loading [m].
    gained
        How far the foot went down while the force rose from a sixth to five sixths of its end,
        by the odometry alone [m].
    misfit
        χ² over the degrees of freedom [-].
    cost
        χ² and what z₀ and w are off their prior, over the number of samples [-].
    borne
        Largest force of the stance over what the law gives at its deepest point [-].
    shared
        S: how far φ̂ is off per unit of θ − θ₀, shape [touchdown, shared], by :data:`TORQUES` and
        :meth:`Prior.shared`; zero for ``law_slope`` and ``other_law``, which compare
        touch-downs.
    """

    phi: FloatArray
    sd: FloatArray
    sinkage: FloatArray
    gained: FloatArray
    misfit: FloatArray
    cost: FloatArray
    borne: FloatArray
    shared: FloatArray


def predicted(law: FootLaw, prior: Prior, seen: Touchdowns, state: FloatArray) -> FloatArray:
    """Upward force of the law [N], shape [..., touchdown, sample].

    Parameters
    ----------
    law, prior
        Which law, for which soil and foot.
    seen
        The touch-downs.
    state
        φ [deg], z₀ [m] and w [m/s], shape [..., touchdown, 3].
    """
    depth = seen.drop + state[..., 1:2] + state[..., 2:3] * seen.time
    lift = law.force(
        prior.foot,
        depth,
        seen.descent,
        friction_angle_deg=state[..., :1],
        density=prior.density,
        surface_friction=prior.surface_friction,
    )[..., 1]
    if prior.exponent:
        lift = lift * (np.maximum(depth, 1e-4) / prior.radius) ** prior.exponent
    return np.asarray(lift + inertia(prior, seen, depth), dtype=np.float64)


def inertia(prior: Prior, seen: Touchdowns, depth: FloatArray) -> FloatArray:
    """Upward force of the soil's inertia, d(m v)/dt [N], shape [touchdown, sample]."""
    down = seen.speed * np.sin(seen.descent)
    return inertial_force(prior.foot, depth, down, seen.acceleration, prior.density)


def noise_covariance(seen: Touchdowns, prior: Prior) -> FloatArray:
    """Covariance of forces [N²], shape [touchdown, sample, sample]; alone where not used.

    A part grows with the force, and one with the soil's inertia.
    """
    hit = INERTIA_PART * inertia(prior, seen, np.maximum(seen.drop, 0.0))
    sd = np.sqrt(NOISE_N**2 + (NOISE_PART * seen.force) ** 2 + hit**2)
    apart = np.abs(seen.time[:, :, None] - seen.time[:, None, :])
    covariance = sd[:, :, None] * sd[:, None, :] * np.exp(-apart / CORRELATION_S)
    both = seen.used[:, :, None] & seen.used[:, None, :]
    covariance = np.where(both, covariance, 0.0)
    rows = np.arange(sd.shape[1])
    covariance[:, rows, rows] = np.where(seen.used, sd**2 * (1.0 + 1e-6), 1.0)
    return covariance


def fit(seen: Touchdowns, law: str | FootLaw, prior: Prior) -> Fit:
    """Fit touch-downs, each for itself.

    Parameters
    ----------
    seen
        The touch-downs, one or more; those without used samples come out at the prior.
    law
        One of :data:`~terraphi.laws.foot.LAWS`, by its name, or another.
    prior
        What is known before.

    Returns
    -------
    Fit
    """
    known = LAWS[law] if isinstance(law, str) else law
    parts = [
        _fit(picked(seen, slice(i, i + BLOCK)), known, prior)
        for i in range(0, len(seen.foot), BLOCK)
    ]
    return Fit(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def picked(rows: Rows, which: Any) -> Rows:
    """Rows of a tuple of arrays, by a mask, numbers or a slice."""
    return rows._make(column[which] for column in rows)


def evenly(rows: Rows, most: int) -> Rows:
    """Rows of a tuple of arrays, at most so many, evenly chosen."""
    count = len(rows[0])
    return picked(rows, np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)))


def with_exponent(seen: Touchdowns, law: str, prior: Prior) -> Prior:
    """The prior with the growth with depth that the touch-downs' courses of force have.

    The exponent within :data:`EXPONENTS` with the least mean logarithm of the cost: touch-downs
    have noise of their own, and an unlikely level or drift counts against a course. Footfalls do
    not teach the level or the slope in φ of a law: there, another law and another field of φ are
    the same. But the further the law's growth with depth is off, the less sure is its growth with
    φ.

    Parameters
    ----------
    seen
        Touch-downs that go deep enough for a fit, one or more.
    law, prior
        As in :func:`fit`.
    """
    from scipy.optimize import minimize_scalar

    def cost(exponent: float) -> float:
        found = fit(seen, law, replace(prior, exponent=exponent))
        return float(np.log(np.maximum(found.cost, 1e-6)).mean())

    best = minimize_scalar(cost, bounds=EXPONENTS, method="bounded", options={"xatol": 0.02}).x
    return replace(prior, exponent=float(best), exponent_sd=TAUGHT_SD)


def likeness(prior: Prior, other: Prior) -> float:
    """Weight of another law against the walk's, by the exponents that both have been given [-].

    How forces on soil grow with φ is unknown, but growth with depth goes with it: of two laws the
    one whose growth with depth needs less correction is the likelier one for the other, too.
    """
    variance = EXPONENT_SD**2 + prior.exponent_sd**2
    return float(1.0 / (1.0 + np.exp((other.exponent**2 - prior.exponent**2) / (2.0 * variance))))


def _fit(seen: Touchdowns, law: FootLaw, prior: Prior) -> Fit:
    weight = np.asarray(np.linalg.inv(noise_covariance(seen, prior)))
    mean = np.array([prior.phi_deg, 0.0, 0.0])
    sd = np.array([prior.phi_sd_deg, prior.level_sd, prior.drift_sd])
    precision = sd**-2 * [1e-6, 1.0, 1.0]  # a trace for touch-downs without samples

    # The last states that were tried with the slopes there, and the slopes of those that are best.
    tried = np.full((len(seen.foot), 3), np.nan)
    slopes, best_slopes = np.zeros((2, *seen.drop.shape, 3))

    def residual(state: FloatArray, rows: IntArray) -> FloatArray:
        part = picked(seen, rows)
        tried[rows] = state
        # All in one call, whose price for one touch-down is mostly that of the call.
        here, *moved = predicted(law, prior, part, state + STEPS[:, None])
        by_phi, by_level = (moved[0] - moved[1]) / 0.2, (moved[2] - moved[3]) / 2e-4
        slope = np.stack([by_phi, by_level, by_level * part.time], axis=-1)
        slopes[rows] = np.where(part.used[..., None], slope, 0.0)
        return np.where(part.used, part.force - here, 0.0)

    def slope_at(state: FloatArray, rows: IntArray) -> FloatArray:
        new = rows[(state == tried[rows]).all(axis=1)]
        best_slopes[new] = slopes[new]
        return np.asarray(best_slopes[rows])

    free = np.full(2, np.inf)
    state, left, slope = least_squares(
        residual,
        slope_at,
        weight,
        np.tile(mean, (len(seen.foot), 1)),
        bounds=(np.append(PHI_RANGE[0], -free), np.append(PHI_RANGE[1], free)),
        scale=sd,
        mean=mean,
        precision=precision,
    )
    # A prediction that rises by D lets the mode move by −c D.
    gain = weights(slope, weight, precision)[0][:, 0]
    torques = np.zeros((len(state), TORQUES))
    own = 3 * seen.foot[:, None] + np.array([0, 1, 2, 12, 13, 14])
    np.put_along_axis(torques, own, np.einsum("nl,nlk->nk", gain, seen.per_error), axis=1)
    # How far φ̂ is off where the truth is above what is assumed: forces are higher than expected
    # by so much, and a drop that reads too large makes the expected ones too high.
    depth = seen.drop + state[:, 1:2] + state[:, 2:3] * seen.time
    force = seen.force - left
    steady = force - inertia(prior, seen, depth)
    rises = {
        "odometry_drop": -slope[..., 1] * seen.drop,
        "density_kg_m3": force / prior.density,
        "law_exponent": steady * np.log(np.maximum(depth, 1e-4) / prior.radius),
    }
    for name, (key, step, unit) in CHANGES.items():
        after, before = (
            predicted(law, replace(prior, **{key: getattr(prior, key) + s}), seen, state)
            for s in (step, -step)
        )
        rises[name] = (after - before) / (2.0 * step * unit)
    off = {name: np.einsum("nl,nl->n", gain, rise) for name, rise in rises.items()}
    off["law_offset_deg"] = np.ones(len(state))
    none = np.zeros(len(state))
    shared = np.column_stack([torques, *(off.get(name, none) for name in prior.shared())])
    chi = np.einsum("nk,nkl,nl->n", left, weight, left)
    count = seen.used.sum(axis=1)
    misfit = chi / np.maximum(count - 2.0, 1.0)
    cost_each = (chi + np.square(state[:, 1:] / sd[1:]).sum(axis=1)) / np.maximum(count, 1)
    sinkage = np.where(seen.used, depth, -np.inf).max(axis=1, initial=-np.inf)
    force = np.where(seen.used, seen.force, 0.0)
    end = force.max(axis=1, keepdims=True, initial=0.0)
    rising = seen.used & (force > end / 6.0)
    rising &= np.minimum.accumulate(force < 5.0 / 6.0 * end, axis=1)
    bottom = np.where(rising, seen.drop, -np.inf).max(axis=1, initial=-np.inf)
    top = np.where(rising, seen.drop, np.inf).min(axis=1, initial=np.inf)
    # Birge's ratio is of the noise: what is known of the drop and its drift beforehand stays.
    scaled = weight / np.maximum(misfit, 1e-6)[:, None, None]
    sd = np.sqrt(weights(slope, scaled, precision)[1][:, 0, 0])
    sinkage = np.where(np.isfinite(sinkage), sinkage, 0.0)
    gained = np.where(rising.any(axis=1), bottom - top, 0.0)
    rest = np.zeros((len(state), 1))
    end = seen._replace(
        drop=seen.deepest[:, None], descent=rest + 0.5 * np.pi, time=rest, speed=rest,
        acceleration=rest,
    )  # fmt: skip
    borne = seen.peak / np.maximum(predicted(law, prior, end, state)[:, 0], NOISE_N)
    return Fit(state[:, 0], sd, sinkage, gained, misfit, cost_each, borne, shared)
