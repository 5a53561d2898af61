"""Is an interval right as often as it says? Simulation-based calibration of one leg of a library.

A replicate is a world: a true angle, true forces f(phi), a library simulated anew, its own particle
scatter included, and an observed simulation, all drawn from the very prior that the inference
holds. The surrogate is conditioned on that library and the angle inferred. If the posterior is
right, its mass below the true angle is uniform (Talts et al., arXiv:1804.06788). Hyperparameters
are those of the shipped library.

Other worlds ask what the prior's part in that is: those that keep the cubic which was fitted to the
library, and those whose libraries scatter with the tail that observed simulations have.

In the joint surrogate's basis all directions are independent, so worlds are drawn by the thousand.
Worlds that the one library may be of are draws of the process given its curves, by Matheron's rule
(Wilson et al., ICML 2020): f = u + K (K + 1)^-1 (y - u - e), u and e draws of prior and scatter.

All forces are as simulated, true ones too: the correction of a refined library and its error
(`fidelity`) are left out of both worlds and inference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.inference.calibrated import log_sum
from terraphi.inference.prepared_leg import PreparedLeg, learn
from terraphi.inference.refining import refined
from terraphi.library.plan import unseeded
from terraphi.library.store import Library, hash_of
from terraphi.surrogate.joint import JointSurrogate
from terraphi.surrogate.kronecker import single_threaded

CHUNK = 200
"""Replicates at once."""
STRIDE = 2
"""Of the leg's nodes; over thousands of worlds the rest makes no difference."""
COARSE_NODES = 201
FINE_NODES = 401
"""Nodes over phi at which posteriors are looked for, and then integrated."""
NOTHING = 1e-9
"""Density over the largest that is not looked at more closely [-]."""
BINS = 20
"""Bins of the rank histogram."""
REPLICATES = 3
"""Replicates of three cases from which a scatter is learnt anew."""
WORLDS = {
    "prior": "drawn from the prior of the inference",
    "fitted": "that keep the cubic fitted to the library",
    "tails": "whose libraries scatter with the tail of observed simulations",
}
"""Kinds of worlds."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """Ranks of true angles in their posteriors.

    Attributes
    ----------
    truth_deg
        True angles [deg], shape [replicate].
    rank
        Mass of the posterior below the true angle [-], same shape.
    median_deg, half_width_deg
        Median, and half the width of the 68 % interval [deg], same shape.
    """

    truth_deg: FloatArray
    rank: FloatArray
    median_deg: FloatArray
    half_width_deg: FloatArray

    def count(self, probability: float) -> int:
        """How many equal-tailed intervals of that mass hold the truth."""
        return int(np.count_nonzero(np.abs(self.rank - 0.5) <= 0.5 * probability))

    def within(self, probability: float) -> float:
        """Fraction of equal-tailed intervals of that mass that hold the truth [-]."""
        return self.count(probability) / self.rank.size

    @property
    def histogram(self) -> NDArray[np.int64]:
        """Number of ranks in each of :data:`BINS` bins."""
        return np.histogram(self.rank, bins=BINS, range=(0.0, 1.0))[0].astype(np.int64)

    @property
    def chi2_probability(self) -> float:
        """Probability of a histogram as uneven, if ranks are uniform [-]."""
        from scipy.special import chdtrc

        expected = self.rank.size / BINS
        chi2 = float(np.sum(np.square(self.histogram - expected)) / expected)
        return float(chdtrc(BINS - 1, chi2))

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "replicates": int(self.rank.size),
            "mean_rank": float(self.rank.mean()),
            "coverage68": self.within(0.68),
            "coverage95": self.within(0.95),
            "rank_chi2_p": self.chi2_probability,
            "ci68_half_width_deg": float(np.median(self.half_width_deg)),
            "abs_error_deg": float(np.median(np.abs(self.median_deg - self.truth_deg))),
        }


def calibrate(leg: PreparedLeg, *, replicates: int, seed: int, worlds: str = "prior") -> Coverage:
    """Coverage over worlds that each have a truth, a library and an observation of their own.

    Parameters
    ----------
    leg
        Whose surrogate and scatter make the worlds.
    replicates
        Number of worlds.
    seed
        Of all draws.
    worlds
        Their kind, one of :data:`WORLDS`.
    """
    if worlds not in WORLDS:
        raise ValueError(f"worlds is '{worlds}'; expected one of {', '.join(WORLDS)}")
    rng = np.random.default_rng(seed)
    surrogate, found = leg.surrogate, []
    with single_threaded():
        for start in range(0, replicates, CHUNK):
            truth = rng.uniform(*surrogate.phi_bounds_deg, size=min(CHUNK, replicates - start))
            forces, library = _worlds(surrogate, truth, rng, worlds)
            data = forces + surrogate.scatter.draw(truth, rng)
            means = surrogate.standard_mean(leg.phi_deg[::STRIDE], library)
            found.append(_posteriors(leg, truth, data, means))
    return _joined(found)


def through_one_library(
    leg: PreparedLeg, *, worlds: int, truths: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Coverage of the 68 and 95 % intervals through the one library, in worlds that it may be of.

    The library's scatter errs the same way in all inversions of a world, so that coverage differs
    between worlds.

    Parameters
    ----------
    leg
        The library's leg.
    worlds, truths
        Number of worlds, and of true angles in each.
    seed
        Of all draws.

    Returns
    -------
    tuple
        Fractions of intervals that hold the truth [-], shapes [world].
    """
    rng = np.random.default_rng(seed)
    within = []
    for _ in range(worlds):
        truth = np.sort(rng.uniform(*leg.surrogate.phi_bounds_deg, size=truths))
        found = _in_one_world(leg, truth, rng)
        within.append((found.within(0.68), found.within(0.95)))
    one, two = np.array(within).T
    return one, two


def of_observations(leg: PreparedLeg, truth_deg: FloatArray, data: FloatArray) -> Coverage:
    """Ranks of truths whose observations are at hand, through the one library.

    Noise and discrepancy are known to be absent, as in worlds.

    Parameters
    ----------
    leg
        The library's leg.
    truth_deg, data
        True angles [deg], shape [r], and forces [N], shape [r, 2 theta].
    """
    mean = leg.surrogate.standard_mean(leg.phi_deg[::STRIDE])[None]
    with single_threaded():
        return _posteriors(leg, truth_deg, data, mean)


def expected_of(
    leg: PreparedLeg, truth_deg: FloatArray, *, worlds: int, seed: int
) -> list[Coverage]:
    """The same for truths of each world that the library may be of: what should come out.

    Observations of one angle share the library's error, so that counts vary more than independent
    ones would.

    Parameters
    ----------
    leg, truth_deg
        As in :func:`of_observations`.
    worlds, seed
        Number of worlds, and seed of all draws.
    """
    rng = np.random.default_rng(seed)
    return [_in_one_world(leg, truth_deg, rng) for _ in range(worlds)]


def learnt_anew(leg: PreparedLeg, *, worlds: int, truths: int, seed: int) -> Coverage:
    """Coverage where scatter and hyperparameters are learnt from each world's own library.

    They are learnt as the shipped ones were: from the curves, and from a few replicates.

    Parameters
    ----------
    leg
        Whose surrogate and scatter make the worlds.
    worlds, truths
        Number of worlds, and of true angles in each.
    seed
        Of all draws.
    """
    rng = np.random.default_rng(seed)
    surrogate, found = leg.surrogate, []
    cases, m = len(surrogate.phi_deg), len(surrogate.theta_deg)
    with single_threaded():
        for _ in range(worlds):
            truth = np.sort(rng.uniform(*surrogate.phi_bounds_deg, size=truths))
            standard = surrogate.draw(np.concatenate([surrogate.phi_deg, truth]), rng)
            forces = standard @ surrogate.basis.T
            forces *= surrogate.scatter.sigma(np.concatenate([surrogate.phi_deg, truth]))
            data = forces[cases:] + surrogate.scatter.draw(truth, rng)
            library = forces[:cases] + surrogate.scatter.draw(surrogate.phi_deg, rng)
            groups = []
            for i in (1, cases // 2, cases - 2):
                phi = float(surrogate.phi_deg[i])
                again = forces[i] + surrogate.scatter.draw(np.full(REPLICATES, phi), rng)
                groups.append((phi, np.vstack([library[i : i + 1], again])))
            curves = leg.curves._replace(Fx=library[:, :m], Fz=library[:, m:])
            own = PreparedLeg.of(learn(curves, groups), curves)
            found.append(of_observations(own, truth, data))
    return _joined(found)


def _in_one_world(leg: PreparedLeg, truth: FloatArray, rng: np.random.Generator) -> Coverage:
    """Ranks of truths [deg], shape [r], observed in a world that the library may be of."""
    angles, place = np.unique(truth, return_inverse=True)
    with single_threaded():
        forces = one_world(leg.surrogate, angles, rng)[place]
        data = forces + leg.surrogate.scatter.draw(truth, rng)
        return of_observations(leg, truth, data)


def _worlds(
    surrogate: JointSurrogate, truth: FloatArray, rng: np.random.Generator, worlds: str
) -> tuple[FloatArray, FloatArray]:
    """True forces at the truths [N], [r, 2 theta], and a new library for each.

    The libraries are as :meth:`JointSurrogate.standard` gives them [-], [r, case, 2 theta].
    """
    angles = np.column_stack([np.tile(surrogate.phi_deg, (len(truth), 1)), truth])
    cubic = surrogate.standard_cubic(angles) if worlds == "fitted" else None
    standard = surrogate.draw(angles, rng, about=cubic)
    forces = surrogate.scatter.sigma(truth) * (standard[:, -1] @ surrogate.basis.T)
    scatter = rng.standard_normal(standard[:, :-1].shape)
    if worlds == "tails":
        scatter *= np.sqrt(surrogate.scatter.draw_sizes(scatter.shape[:2], rng))[..., None]
    return forces, surrogate.root_repeats[:, None] * standard[:, :-1] + scatter


def one_world(surrogate: JointSurrogate, truth: FloatArray, rng: np.random.Generator) -> FloatArray:
    """True forces in one world that a library may be of, given its curves.

    Parameters
    ----------
    surrogate
        Of the library.
    truth
        Friction angles [deg], shape [r].
    rng
        Of the draw.

    Returns
    -------
    FloatArray
        Without scatter of their own [N], shape [r, 2 theta].
    """
    cases = len(surrogate.phi_deg)
    prior = surrogate.draw(np.concatenate([surrogate.phi_deg, truth]), rng)
    scatter = rng.standard_normal(prior[:cases].shape)
    simulated = surrogate.root_repeats[:, None] * prior[:cases] + scatter
    missing = surrogate.standard_curves - simulated
    standard = prior[cases:] + surrogate.standard_mean(truth, missing)
    return surrogate.scatter.sigma(truth) * (standard @ surrogate.basis.T)


def _posteriors(
    leg: PreparedLeg, truth: FloatArray, data: FloatArray, means: FloatArray
) -> Coverage:
    """Ranks of the truths; noise and discrepancy are known to be absent.

    Parameters
    ----------
    leg
        The prepared leg, for nodes and covariance.
    truth, data
        True angles [deg], shape [r], and forces [N], shape [r, 2 theta].
    means
        Means of the surrogates over sigma in the basis [-], shape [r or 1, node, 2 theta].
    """
    from scipy.interpolate import CubicSpline

    surrogate, nodes_deg = leg.surrogate, leg.phi_deg[::STRIDE]
    variance = surrogate.standard_variance(nodes_deg)
    sigma = surrogate.scatter.sigma(nodes_deg)
    standard = (data[:, None, :] / sigma) @ surrogate.whitener.T
    squares, parts = np.square(standard - means), []
    for size, log_prior in zip(*surrogate.scatter.sizes, strict=True):
        total = variance + size
        volume = np.log(total).sum(axis=1) + 2.0 * np.log(sigma).sum(axis=1)
        parts.append(0.5 * (np.sum(squares / total, axis=2) + volume) - log_prior)
    splines = [CubicSpline(nodes_deg, exponent.T).c for exponent in parts]
    fine = density = np.empty(0)
    ends = np.tile(nodes_deg[[0, -1]], (len(truth), 1))
    for nodes in (COARSE_NODES, FINE_NODES):
        fine = np.linspace(ends[:, 0], ends[:, 1], nodes, axis=1)
        log_p = log_sum(np.array([-_evaluate(spline, nodes_deg, fine) for spline in splines]))
        density = np.exp(log_p - log_p.max(axis=1, keepdims=True))
        # The second round looks closely at where the first found anything.
        some = density > NOTHING
        first, last = some.argmax(axis=1), nodes - 1 - some[:, ::-1].argmax(axis=1)
        places = np.column_stack([np.maximum(first - 1, 0), np.minimum(last + 1, nodes - 1)])
        ends = np.take_along_axis(fine, places, axis=1)
    mass = np.zeros_like(density)
    np.cumsum(0.5 * (density[:, 1:] + density[:, :-1]), axis=1, out=mass[:, 1:])
    mass /= mass[:, -1:]
    rank = np.array([np.interp(t, x, m) for t, x, m in zip(truth, fine, mass, strict=True)])
    quantiles = np.array(
        [np.interp((0.16, 0.5, 0.84), m, x) for x, m in zip(fine, mass, strict=True)]
    )
    half_width = 0.5 * (quantiles[:, 2] - quantiles[:, 0])
    return Coverage(truth, rank, quantiles[:, 1], half_width)


def _evaluate(coefficients: FloatArray, nodes: FloatArray, at: FloatArray) -> FloatArray:
    """Splines, one a row, on even nodes, each at places of its own, shape [r, k]."""
    step = nodes[1] - nodes[0]
    cell = np.clip(((at - nodes[0]) / step).astype(int), 0, len(nodes) - 2)
    row = np.arange(len(at))[:, None]
    offset = at - nodes[cell]
    value = np.zeros_like(at)
    for power in coefficients:
        value = value * offset + power[cell, row]
    return value


def _joined(parts: list[Coverage]) -> Coverage:
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return Coverage(*(np.concatenate(column) for column in columns))


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
        "library_hash": library.as_simulated.hash,
        **origin,
        "legs": legs,
        "certificate": {
            "seed": seed,
            "legs": certificates,
            "rank_chi2_p_of_other_seeds": again,
        },
    }
    made = replace(library, calibration=calibration)
    # What finer cases say rests on the scatter.
    return refined(made, ()) if library.fine else made


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
