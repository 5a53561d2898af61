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

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray, IntArray
from terraphi.experiment.priors import (
    DENSITY,
    DROP_SD_PART,
    FOOT_FRICTION,
    FOOT_RADIUS_SD_M,
    ODOMETRY_DRIFT_SD,
    TOUCHDOWN_DEPTH_SD_M,
)
from terraphi.inference.estimator import Best, least_squares, weights
from terraphi.laws.foot import LAWS, Foot, FootLaw, inertial_force

PHI_RANGE = (15.0, 50.0)
"""Friction angles in plane strain for which laws are evaluated [deg]: law ``foot`` has a table from
17 to 52° and is continued by 3°."""
NOISE_N, NOISE_PART = 1.5, 0.04
"""Standard deviation of a force: constant [N], and as a part of it [-]; odometry is in it.
Residuals scale the result, so that the ratio of both counts (chosen)."""
SET_M = 0.002
"""Way over which a sole finds its hold [m]: by the laws soil bears a flat body at once, and it
gives way a little before; chosen."""
INERTIA_PART = 0.3
"""Standard deviation of the inertia's force, as a part of it [-]: half of what balls in grains
differ by (``docs/landing.md``; from 0.1 to 0.8 their angles differ by 0.2° root mean square)."""
LEVEL_M = 1e-4
"""Least height of the end of a sole over its middle [m], below which it counts as that; chosen."""
ONSET_M = 0.001
"""Range of depths about the surface over which the soil's inertia sets in [m]. A foot meets the
highest grains first, over a range in proportion to their size: balls that hit grains of 6 mm at 1
and 1.5 m/s have 0.4 of the force in the last two millimetres above the surface, 0.6 in the first
below it, 0.9 in the second: some 4 mm, 0.7 of a grain. Here it is that of grains of 1.5 mm, coarse
sand. From 0.5 to 4 mm two simulated trots change by 0.06° at most on average, single footfalls by
0.16° root mean square. A jump would make χ² one over z₀, at which fits end anywhere."""
CORRELATION_S = 0.008
"""Correlation time of the noise [s]: a few samples of a log of 500 Hz (chosen)."""
EXPONENTS = (-0.7, 0.4)
"""Range of what is added to a law's power of depth [-]; the upper end makes law ``foot`` grow like
resistive force theory, whose stress is proportional to the depth."""
LEARNED_SD = 0.03
"""Least standard deviation of an exponent learned from touch-downs [-]; on walks made from the law
it errs by 0.01 (``tests/robot/test_footfall_truth.py``), on simulated ones by 0.05."""
GROWTH, EACH_SD = {"foot": (-0.05, 0.1)}, 0.3
"""Mean and standard deviation of the exponent in soils, by law, and that of one touch-down [-]: in
grains 22 discs of 60 mm that are pressed slowly have −0.04 ± 0.06 by law ``foot``, 22 balls of
seven grains −0.1 ± 0.3. For other laws it is that of :class:`Prior`."""
MOST_INERTIA = 0.3
"""Part of the force that is the soil's inertia above which a touch-down does not show how the
static force grows with depth [-]: errors of the mass that moves, 30 %, look like another growth."""
EXPONENT_STEP = 0.05
"""Step of differences over the exponent [-]."""
MOST_FITTED = 120
"""Most footfalls from which shared quantities are learned, evenly chosen: model errors would
otherwise be taken for certainty in a long log (chosen)."""
MOST_GROWN = 40
"""Most touch-downs from which an exponent is learned, evenly chosen (time): with 120 its standard
deviation falls from 0.04 to 0.03."""
LEVEL_ROUNDS, LEVEL_STEPS = 3, 60
"""Linearizations, and steps of expectation and maximization in each, after which the scatter of
levels of a walk changes by less than a tenth (chosen)."""
FEWEST = 10
"""Fewest touch-downs from which a law's growth with depth is learned."""
FEWEST_SAMPLES, ENOUGH_S = (6, 10), 0.02
"""Fewest samples of a touch-down while the foot goes down, for a fit of three quantities: the
second number, or so many as take the time [s], but not fewer than the first. A simulated walk of
250 Hz thinned to 125 Hz has φ within 0.6° of its own (``tests/robot/test_footfalls.py``)."""
GAINED = 1e-5
"""Part of χ² by which the last step of a fit lowers it at most [-]: it is shorter than 0.01
standard deviations of φ. Where a table of forces has a bend, steps go to and fro about it."""
BLOCK = 512
"""Touch-downs that are fitted together; bounds the memory."""

Solved = tuple[FloatArray, Best, FloatArray, FloatArray, FloatArray]
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
        Change of the force per error of the leg's torques [N]: of the gains of its joints, then
        friction of 1 N m in them; shape [touchdown, sample, 2 joint].
    rise
        Heights of the front and the left end of a flat sole above its middle [m], shape
        [touchdown, sample, 2]; zero of a ball.
    used
        True where the sample exists and the foot is going down.
    moved
        Level distance from where the foot bore load last [m], shape [touchdown]; infinite if it had
        borne none.
    heading
        Direction of the sole's length from x [rad], shape [touchdown]; zero of a ball.
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
        Of the whole stance: largest force less the soil's inertia [N] and largest drop [m], shape
        [touchdown].
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
    rise: FloatArray
    used: BoolArray
    moved: FloatArray
    heading: FloatArray
    torn: BoolArray
    saturated: BoolArray
    faulty: BoolArray
    returned: FloatArray
    peak: FloatArray
    deepest: FloatArray
    broken: FloatArray


def sampled(touchdowns: Touchdowns) -> tuple[FloatArray, BoolArray]:
    """Step of the samples [s], and True where those of a foot that goes down are too few."""
    steps = (np.diff(touchdowns.time, axis=1) > 0.0).sum(axis=1)
    step = np.maximum(np.ptp(touchdowns.time, axis=1), 1e-9) / np.maximum(steps, 1)
    return step, touchdowns.used.sum(axis=1) < np.clip(ENOUGH_S / step, *FEWEST_SAMPLES)


@dataclass(frozen=True)
class Prior:
    """Means and standard deviations assumed before any force is used.

    Attributes
    ----------
    phi_deg, phi_sd_deg
        Of the friction angle in plane strain [deg].
    level, level_sd
        Of the depth at touch-down [m].
    drift_sd
        Of the odometry's drift [m/s], about zero.
    density, density_sd
        Bulk density [kg/m³].
    surface_friction, surface_friction_sd
        Between foot and soil [-]. A foot that touches down moves steeply: its drag over lift
        differs by at most 0.02 between 0.3 and 0.5, less than by gains of the torques.
    radius, radius_sd
        Of the foot [m].
    shape
        Of the foot.
    sole
        Length and width of a flat sole [m], whose disc of equal area has the radius; ``None`` of a
        ball.
    legs
        Number of the robot's legs.
    drop_sd
        Of the odometry's drop of the feet, relative [-]: standing feet give way a little while the
        load moves over, and the attitude errs.
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
        Of the part [-] of what another law reads otherwise between places.
    incline, incline_sd
        Logarithm of the force on inclined ground over that on level ground [-].
    highest_deg
        Largest φ of a fit [deg].
    """

    phi_deg: float = 32.0
    phi_sd_deg: float = 8.0
    level: float = 0.0
    level_sd: float = TOUCHDOWN_DEPTH_SD_M
    drift_sd: float = ODOMETRY_DRIFT_SD
    density: float = DENSITY.mean
    density_sd: float = DENSITY.sd
    surface_friction: float = FOOT_FRICTION.mean
    surface_friction_sd: float = FOOT_FRICTION.sd
    radius: float = 0.022
    radius_sd: float = FOOT_RADIUS_SD_M
    shape: str = "ball"
    sole: tuple[float, float] | None = None
    legs: int = 4
    drop_sd: float = DROP_SD_PART
    law_sd_deg: float | None = None
    exponent: float = 0.0
    exponent_sd: float = 0.2
    slope_sd: float = 0.1
    other_law_sd: float = 0.0
    incline: float = 0.0
    incline_sd: float = 0.0
    highest_deg: float = PHI_RANGE[1]

    @property
    def state(self) -> FloatArray:
        """Means of φ [deg], of the depth at touch-down [m] and of the drift [m/s]."""
        return np.array([self.phi_deg, self.level, 0.0])

    @cached_property
    def foot(self) -> Foot:
        """The foot of that radius and shape."""
        return Foot(self.radius, self.shape)  # type: ignore[arg-type]

    def shared(self) -> dict[str, tuple[float, float]]:
        """Mean and standard deviation of each shared quantity, errors of the torques excluded."""
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
            "ground_slope": (0.0, self.incline_sd),
        }


STEPS = np.array([[0, 0, 0], [0.1, 0, 0], [-0.1, 0, 0], [0, 1e-4, 0], [0, -1e-4, 0]])
"""Of φ [deg], z₀ [m] and w [m/s], for forces and their differences."""
FREE_PHI = np.array([1e-6, 1.0, 1.0])
"""Parts of the precisions of φ, z₀, w in a fit: a trace of φ's for touch-downs without samples."""
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
        S: how far φ̂ is off per unit of θ − θ₀, shape [touchdown, shared]: of gains [-] and Coulomb
        frictions [N m] of all joints, leg by leg, then of :meth:`Prior.shared`; zero for
        ``law_slope`` and ``other_law``, which compare touch-downs.
    """

    phi: FloatArray
    sd: FloatArray
    sinkage: FloatArray
    gained: FloatArray
    misfit: FloatArray
    cost: FloatArray
    borne: FloatArray
    shared: FloatArray


def predicted(law: FootLaw, prior: Prior, touchdowns: Touchdowns, state: FloatArray) -> FloatArray:
    """Upward force of the law [N], shape [..., touchdown, sample].

    Parameters
    ----------
    law, prior
        Force law, and the soil and foot it is evaluated for.
    touchdowns
        Depth, direction and speed of the feet.
    state
        φ [deg], z₀ [m] and w [m/s], shape [..., touchdown, 3].
    """
    depth = middle = _depth(touchdowns, state)
    size: FloatArray = np.ones(1)
    if prior.sole:
        # Forces of soil without cohesion are ρ g R³ times a function of z/R: what is in soil of a
        # sole, a share s of it, bears s^(3/2) times as much as all of it at its mean depth over √s.
        share, mean = submerged_part(middle, touchdowns.rise)
        size, depth = share**1.5, mean / np.sqrt(np.maximum(share, 1e-6))
    lift = size * law.lift(
        prior.foot,
        depth,
        touchdowns.descent,
        friction_angle_deg=state[..., :1],
        density=prior.density,
        surface_friction=prior.surface_friction,
    )
    if prior.exponent:
        lift = lift * (np.maximum(depth, 1e-4) / prior.radius) ** prior.exponent
    return np.asarray(lift + inertia(prior, touchdowns, middle), dtype=np.float64)


def submerged_part(depth: FloatArray, rise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Share of a rectangle that is below the surface [-], and the mean depth of this part [m].

    Of its middle's depth [m] and the heights of its ends above its middle [m], shape [..., 2].
    """
    # Over u and v from −1 to 1 the depth is z − a u − b v. The integral of its positive part is a
    # difference of its third antiderivative x³/6 at the corners, z ± a ± b, over a b; the share has
    # the second one, x²/2.
    a, b = np.moveaxis(np.maximum(np.abs(rise), LEVEL_M), -1, 0)
    corners = np.maximum([depth + a + b, depth + a - b, depth - a + b, depth - a - b], 0.0)
    signs = np.array([1.0, -1.0, -1.0, 1.0])
    share = np.tensordot(signs, corners**2, axes=1) / (8.0 * a * b)
    total = np.tensordot(signs, corners**3, axes=1) / (24.0 * a * b)
    return share, total / np.maximum(share, 1e-9)


def _depth(touchdowns: Touchdowns, state: FloatArray) -> FloatArray:
    """Depth z of the foot's lowest point [m], shape [..., touchdown, sample]."""
    return touchdowns.drop + state[..., 1:2] + state[..., 2:3] * touchdowns.time


def inertia(prior: Prior, touchdowns: Touchdowns, depth: FloatArray) -> FloatArray:
    """Upward force of the soil's inertia, d(m v)/dt [N], shape [touchdown, sample]."""
    down = touchdowns.speed * np.sin(touchdowns.descent)
    # A ramp that is even about the surface takes nothing off the momentum at larger depths.
    share = np.minimum(np.maximum(depth / ONSET_M + 0.5, 0.0), 1.0)
    deep = np.maximum(depth, 1e-9)
    return share * inertial_force(prior.foot, deep, down, touchdowns.acceleration, prior.density)


def noise_covariance(touchdowns: Touchdowns, prior: Prior) -> FloatArray:
    """Covariance of forces [N²], shape [touchdown, sample, sample]; unit where not used.

    Its standard deviation has a constant part, one that grows with the force, and one that grows
    with the soil's inertia.
    """
    # cov(t, t') = σ(t) σ(t') exp(−|t − t'| / τ); the nugget keeps the matrix invertible.
    hit = INERTIA_PART * inertia(prior, touchdowns, touchdowns.drop)
    part = NOISE_PART + np.exp(-np.maximum(touchdowns.drop, 0.0) / SET_M) * bool(prior.sole)
    sd = np.sqrt(NOISE_N**2 + (part * touchdowns.force) ** 2 + hit**2)
    lag = np.abs(touchdowns.time[:, :, None] - touchdowns.time[:, None, :])
    covariance = sd[:, :, None] * sd[:, None, :] * np.exp(-lag / CORRELATION_S)
    covariance *= touchdowns.used[:, :, None] & touchdowns.used[:, None, :]
    rows = np.arange(sd.shape[1])
    covariance[:, rows, rows] = np.where(touchdowns.used, sd**2 * (1.0 + 1e-6), 1.0)
    return covariance


def fit(touchdowns: Touchdowns, law: str | FootLaw, prior: Prior) -> Fit:
    """Fit φ, level and drift of each touch-down independently.

    Parameters
    ----------
    touchdowns
        One or more; those without used samples come out at the prior.
    law
        A law, or the name of one of :data:`~terraphi.laws.foot.LAWS`.
    prior
        Soil, foot and priors.

    Returns
    -------
    Fit
    """
    force_law = LAWS[law] if isinstance(law, str) else law
    starts = range(0, len(touchdowns.foot), BLOCK)
    parts = [picked(touchdowns, slice(i, i + BLOCK)) for i in starts]
    return stacked([
        _fit(dense(part), force_law, prior, _gained(part, is_sole=bool(prior.sole)))
        for part in parts
    ])  # fmt: skip


def picked(rows: Rows, which: Any) -> Rows:
    """Rows of a tuple of arrays, by a mask, numbers or a slice."""
    return rows._make(column[which] for column in rows)


def stacked(parts: Sequence[Rows]) -> Rows:
    """Tuples of arrays, one below the other."""
    return parts[0]._make(map(np.concatenate, zip(*parts, strict=True)))


def dense(touchdowns: Touchdowns) -> Touchdowns:
    """Touch-downs with their used samples first, and no more samples than the most that are used.

    Others have no effect on a fit, whose time grows with their number: of 64 samples 15 to 30 are
    used.
    """
    used = touchdowns.used
    order = np.argsort(~used, axis=1, kind="stable")[:, : max(int(used.sum(axis=1).max()), 1)]
    rows = np.arange(len(used))[:, None]
    return touchdowns._replace(**{
        name: getattr(touchdowns, name)[rows, order]
        for name in ("time", "drop", "descent", "speed", "acceleration", "force", "per_error",
                     "rise", "used")
    })  # fmt: skip


def evenly(rows: Rows, most: int) -> Rows:
    """Rows of a tuple of arrays, ``most`` at most, evenly spaced."""
    count = len(rows[0])
    return picked(rows, np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)))


def learn_exponent(touchdowns: Touchdowns, law: str, prior: Prior) -> Prior:
    """Prior with the exponent of depth learned from the touch-downs.

    The exponent within :data:`EXPONENTS` with the least mean logarithm of the cost. The logarithm
    leaves each touch-down its own noise level; the cost includes the priors of level and drift.
    The law's level and its slope in φ cannot be learned: they cannot be separated from the field
    of φ. A large exponent makes the law's growth with φ less certain. Touch-downs that are not
    :func:`is_slow` show the added mass; without others the exponent is that of :data:`GROWTH`.

    Parameters
    ----------
    touchdowns
        One or more, each deep enough for a fit.
    law, prior
        As in :func:`fit`.
    """
    from scipy.optimize import minimize_scalar

    slow = dense(evenly(picked(touchdowns, is_slow(touchdowns, prior)), MOST_GROWN))
    usual, usual_sd = GROWTH.get(law, (Prior.exponent, Prior.exponent_sd))
    if not len(slow.foot):
        return replace(prior, exponent=usual, exponent_sd=usual_sd)

    state = np.tile(prior.state, (len(slow.foot), 1))

    def cost(exponent: float) -> FloatArray:
        solved = _solved(slow, LAWS[law], replace(prior, exponent=exponent), state)
        state[:] = solved[1].x  # the next exponent is near
        return np.log(np.maximum(_cost(slow, prior, solved), 1e-6))

    best = minimize_scalar(
        lambda exponent: float(cost(exponent).mean()), bounds=EXPONENTS, method="bounded",
        options={"xatol": 0.02},
    ).x  # fmt: skip
    # Its variance from how touch-downs differ, Σ c'² / (Σ c'')² of their costs c (an M-estimator's,
    # P. J. Huber, Robust Statistics, 1981, sect. 3.2), where EACH_SD counts as one of them.
    below, at, above = (cost(best + EXPONENT_STEP * k) for k in (-1, 0, 1))
    bend = max(float((below + above - 2.0 * at).sum()), 1e-9) / EXPONENT_STEP**2
    count, square = len(slow.foot), float(np.square((above - below) / (2.0 * EXPONENT_STEP)).sum())
    each = (count**2 * square / bend**2 + EACH_SD**2) / (count + 1)
    precision, before = 1.0 / (LEARNED_SD**2 + each / count), 1.0 / usual_sd**2
    mean = (precision * float(best) + before * usual) / (precision + before)
    return replace(prior, exponent=mean, exponent_sd=(precision + before) ** -0.5)


def is_slow(touchdowns: Touchdowns, prior: Prior) -> BoolArray:
    """Mask of touch-downs whose forces are hardly the soil's inertia, shape [touchdown]."""
    hit = np.abs(inertia(prior, touchdowns, touchdowns.drop))
    part, total = ((touchdowns.used * each).sum(axis=1) for each in (hit, touchdowns.force))
    return np.asarray(part <= MOST_INERTIA * total)


def learn_level(touchdowns: Touchdowns, law: str, prior: Prior) -> Prior:
    """Prior with the mean and the scatter of the depth at touch-down over a walk.

    Empirical Bayes: φ and z₀ of the touch-downs scatter normally about means of the walk, and the
    prior before counts as one more touch-down. The drift keeps its prior: within a short landing it
    looks like another growth of the force with depth.

    Parameters
    ----------
    touchdowns
        Those of one walk, one or more, each deep enough for a fit.
    law, prior
        As in :func:`fit`.
    """
    touchdowns, learned, state = dense(touchdowns), prior, None
    for _ in range(LEVEL_ROUNDS):
        sd, best, _, misfit, scaled = _solved(touchdowns, LAWS[law], learned, state)
        state, _, slope = best
        # The likelihood alone about its mode, ½ x'Λx − h'x: at the mode its slope is the prior's.
        information = np.einsum("nki,nkl,nlj->nij", slope, scaled, slope)
        off = (state - learned.state) * sd**-2 * FREE_PHI
        towards = np.einsum("nij,nj->ni", information, state) + off / misfit[:, None]
        # Expectation of each state given the walk's mean and variance, then both given the states.
        count = len(state) + 1.0
        mean, variance = learned.state, np.square(sd)
        first_mean, first_variance = prior.state, np.square([sd[0], prior.level_sd, sd[2]])
        for _ in range(LEVEL_STEPS):
            posterior = np.linalg.inv(information + np.diag(1.0 / variance))
            x = np.einsum("nij,nj->ni", posterior, towards + mean / variance)
            mean[:2] = (x.sum(axis=0) + first_mean)[:2] / count
            square = np.einsum("nii->ni", posterior) + np.square(x - mean)
            variance[:2] = (square.sum(axis=0) + first_variance)[:2] / count
        # The fit takes the noise as assumed: where the law's misfit is larger, by Birge's ratio of
        # the walk, levels get as much less freedom.
        level_sd = math.sqrt(variance[1] / max(float(np.median(misfit)), 1.0))
        learned = replace(prior, level=float(mean[1]), level_sd=level_sd)
    return learned


def _fit(touchdowns: Touchdowns, law: FootLaw, prior: Prior, gained: FloatArray) -> Fit:
    solved = sd, best, weight, misfit, scaled = _solved(touchdowns, law, prior)
    state, _, slope = best
    precision = sd**-2 * FREE_PHI
    # A prediction that rises by D lets the mode move by −c D.
    gain = weights(slope, weight, precision)[0][:, 0]
    depth = np.where(touchdowns.used, _depth(touchdowns, state), -np.inf)
    sinkage = depth.max(axis=1, initial=-np.inf)
    # The law at the deepest point of the whole stance, where the foot rests.
    still = np.zeros((len(state), 1))
    deepest = touchdowns._replace(
        drop=touchdowns.deepest[:, None], descent=still + 0.5 * np.pi, time=still, speed=still,
        acceleration=still, rise=np.zeros((len(state), 1, 2)),
    )  # fmt: skip
    bears = predicted(law, prior, deepest, state)[:, 0]
    return Fit(
        phi=state[:, 0],
        sd=np.sqrt(weights(slope, scaled, precision)[1][:, 0, 0]),
        sinkage=np.where(np.isfinite(sinkage), sinkage, 0.0),
        gained=gained,
        misfit=misfit,
        cost=_cost(touchdowns, prior, solved),
        borne=touchdowns.peak / np.maximum(bears, NOISE_N),
        shared=_sensitivity(touchdowns, law, prior, best, gain),
    )


def _cost(touchdowns: Touchdowns, prior: Prior, solved: Solved) -> FloatArray:
    """χ² and what z₀ and w are off their prior, over the number of samples [-]."""
    sd, best, _, misfit, _ = solved
    count = touchdowns.used.sum(axis=1)
    off = np.square((best.x - prior.state)[:, 1:] / sd[1:]).sum(axis=1)
    return np.asarray((misfit * np.maximum(count - 2.0, 1.0) + off) / np.maximum(count, 1))


def _solved(
    touchdowns: Touchdowns, law: FootLaw, prior: Prior, start: FloatArray | None = None
) -> Solved:
    """Standard deviations of the prior, mode, weights [N⁻²], misfit [-], and scaled weights.

    The mode has φ [deg], z₀ [m] and w [m/s], residuals [N] and slopes of the law.
    """
    weight = np.asarray(np.linalg.inv(noise_covariance(touchdowns, prior)))
    sd = np.array([prior.phi_sd_deg, prior.level_sd, prior.drift_sd])
    # The largest array is not needed, and would be copied each time that rows are chosen.
    moving = touchdowns._replace(per_error=touchdowns.begin)

    def residual(state: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        part = moving if len(rows) == len(weight) else picked(moving, rows)
        # All in one call, whose price for one touch-down is mostly that of the call.
        force, *moved = predicted(law, prior, part, state + STEPS[:, None])
        # Central differences of STEPS. The drift w acts as the level z₀ does, times the time.
        by_phi, by_level = (moved[0] - moved[1]) / 0.2, (moved[2] - moved[3]) / 2e-4
        slope = np.stack([by_phi, by_level, by_level * part.time], axis=-1)
        used = part.used
        return np.where(used, part.force - force, 0.0), np.where(used[..., None], slope, 0.0)

    free = np.full(2, np.inf)
    best = least_squares(
        residual, weight, np.tile(prior.state, (len(weight), 1)) if start is None else start,
        bounds=(np.append(PHI_RANGE[0], -free), np.append(prior.highest_deg, free)),
        scale=sd, mean=prior.state, precision=sd**-2 * FREE_PHI, gained=GAINED,
    )  # fmt: skip
    chi = np.einsum("nk,nkl,nl->n", best.residual, weight, best.residual)
    misfit = np.maximum(chi / np.maximum(touchdowns.used.sum(axis=1) - 2.0, 1.0), 1e-6)
    # Birge's ratio is of the noise: what is known of the drop and its drift beforehand stays.
    return sd, best, weight, misfit, weight / misfit[:, None, None]


def _sensitivity(
    touchdowns: Touchdowns, law: FootLaw, prior: Prior, best: Best, gain: FloatArray
) -> FloatArray:
    """S: how far φ̂ is off per unit of each shared error, shape [touchdown, shared].

    ``gain``, shape [touchdown, sample], turns a rise of the forces into one of φ̂ [deg/N].
    """
    state, residual, slope = best
    by_joint = np.einsum("nl,nlk->nk", gain, touchdowns.per_error).reshape(len(state), 2, -1)
    torques = np.zeros((len(state), 2, prior.legs, by_joint.shape[-1]))
    torques[np.arange(len(state)), :, touchdowns.foot] = by_joint
    torques = torques.reshape(len(state), -1)
    # How far φ̂ is off where the truth is above what is assumed: forces are higher than expected
    # by so much, and a drop that reads too large makes the expected ones too high.
    depth, force = _depth(touchdowns, state), touchdowns.force - residual
    steady = force - inertia(prior, touchdowns, depth)
    rises = {
        "odometry_drop": -slope[..., 1] * touchdowns.drop,
        "density_kg_m3": force / prior.density,
        "law_exponent": steady * np.log(np.maximum(depth, 1e-4) / prior.radius),
        "ground_slope": steady,
    }
    for name, (key, step, unit) in CHANGES.items():
        after, before = (
            predicted(law, replace(prior, **{key: getattr(prior, key) + s}), touchdowns, state)
            for s in (step, -step)
        )
        rises[name] = (after - before) / (2.0 * step * unit)
    off = {name: np.einsum("nl,nl->n", gain, rise) for name, rise in rises.items()}
    off["law_offset_deg"] = np.ones(len(state))
    zero = np.zeros(len(state))  # of law_slope and other_law, which compare touch-downs
    return np.column_stack([torques, *(off.get(name, zero) for name in prior.shared())])


def _gained(touchdowns: Touchdowns, *, is_sole: bool) -> FloatArray:
    """How far each foot goes down while its force rises from a sixth to five sixths of its end."""
    force = np.where(touchdowns.used, touchdowns.force, 0.0)
    # Samples from a sixth of the largest force until the first one above five sixths. A sole may
    # rest on the way.
    end = force.max(axis=1, keepdims=True, initial=0.0)
    force = touchdowns.force if is_sole else force
    rising = (touchdowns.used | is_sole) & (force > end / 6.0)
    rising &= np.minimum.accumulate(force < 5.0 / 6.0 * end, axis=1)
    bottom = np.where(rising, touchdowns.drop, -np.inf).max(axis=1, initial=-np.inf)
    top = np.where(rising, touchdowns.drop, np.inf).min(axis=1, initial=np.inf)
    return np.where(rising.any(axis=1), bottom - top, 0.0)
