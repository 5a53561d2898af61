r"""Where to simulate next: the design points that would cut the expected posterior variance most.

At a truth x the posterior covariance of the parameters is, to first order,

    C(x) = (sum_t g_t g_t^T / (v_t + s^2 + t^2) + P^-1)^-1,

g_t the slopes of a force along direction t of the basis in which its errors are independent, v_t
the surrogate's variance there, s the noise of a window mean, t^2 the scatter of the simulations, P
the prior covariance; the error common to all t counts as in `likelihood`. A simulation at c lowers
the variance to v_t - k_t(x, c)^2 / (v_t(c) + t^2), whatever its outcome, k_t the surrogate's
posterior covariance. The next point is the candidate after which the variance of the parameters, in
units of the prior's, is least on average over truths (an average-risk design, A-optimal; Chaloner &
Verdinelli, *Stat. Sci.* 10:273, 1995). Further ones follow one by one, each given those before it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.inference.identifiability import axis_label, fisher, label
from terraphi.library.store import Library
from terraphi.surrogate.design import DesignKernel, DesignSurrogate, from_unit
from terraphi.surrogate.kronecker import Kronecker, single_threaded
from terraphi.surrogate.process import Process
from terraphi.surrogate.training import training

TRUTHS = 64
"""Truths over which the variance is averaged; a power of two."""
CANDIDATES = 256
"""Points that are considered; a power of two."""
NOISE = 0.01
"""Noise of a window mean unless it is given, of the forces' peak-to-peak [-]: the paper's."""
SLOPE_STEP = 1e-3
"""Step of differences over a parameter, of its span [-]."""


@dataclass(frozen=True)
class Suggestion:
    """Points to simulate, in this order.

    Attributes
    ----------
    library
        Name of the library.
    legs
        Legs of it that each point is simulated with.
    points
        Dotted key to value.
    expected_sd
        Root of the expected posterior variance of each parameter, as it is and after each point.
    floor_sd
        The same of a library without errors: what noise and scatter alone leave.
    noise_N
        Noise of a window mean that was assumed, by leg [N].
    """

    library: str
    legs: tuple[str, ...]
    points: tuple[Mapping[str, float], ...]
    expected_sd: tuple[Mapping[str, float], ...]
    floor_sd: Mapping[str, float]
    noise_N: Mapping[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return asdict(self)

    def title(self) -> str:
        """One line for people."""
        noise = ", ".join(f"{leg} {sigma:.3g} N" for leg, sigma in self.noise_N.items())
        return f"Next points for library {self.library}; noise of a window mean: {noise}"

    def table(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Header and rows: each point, and the expected standard deviations after it."""
        keys = list(self.floor_sd)
        names = [label(key)[0] for key in keys]
        header = ("", *map(axis_label, keys), *(f"expected sd of {name}" for name in names))
        nowhere = dict.fromkeys(keys, "")
        points = [{k: f"{v:g}" for k, v in point.items()} for point in self.points]
        names_of = ["as it is", *map(str, range(1, len(points) + 1)), "noise alone"]
        rows = [
            (name, *point.values(), *(f"{value:.3g}" for value in sd.values()))
            for name, point, sd in zip(
                names_of,
                [nowhere, *points, nowhere],
                [*self.expected_sd, self.floor_sd],
                strict=True,
            )
        ]
        return header, rows

    def advice(self) -> str:
        """How the points go into a plan, in a sentence."""
        rows = [f"[{', '.join(f'{v:g}' for v in point.values())}]" for point in self.points]
        keys = ", ".join(self.floor_sd)
        if len(self.floor_sd) == 1:
            values = ", ".join(row[1:-1] for row in rows)
            return f"Add {values} to {keys} in [sweep] of the plan (or to 'also' in [sample])."
        return f"Add to [sample] of the plan: also = [{', '.join(rows)}], in the order {keys}."


def suggest(
    library: Library,
    *,
    leg: str | None = None,
    parameter: str | None = None,
    noise: float | None = None,
    count: int = 1,
    seed: int = 0,
) -> Suggestion:
    """Name the design points that would cut the expected posterior variance most.

    Parameters
    ----------
    library
        Simulations over one parameter or several.
    leg
        Leg that will be inverted; all of the library together if not given.
    parameter
        The one whose variance counts, by its key or the key's last part; all if not given.
    noise
        Standard deviation of a window mean that is expected [N]; 1 % of each leg's mean
        peak-to-peak if not given.
    count
        Number of points.
    seed
        Of the scrambled Sobol sequences of truths and candidates.

    Raises
    ------
    InputError
        If the library lacks the leg or the parameter, or has too few cases; if noise or count are
        not positive.
    """
    if count < 1 or (noise is not None and not 0.0 < noise < np.inf):
        raise InputError(f"count = {count} and noise = {noise} N must be positive")
    legs = tuple(library.legs if leg is None else [leg])
    with single_threaded():
        data = {name: training(library, name) for name in legs}
        bounds = data[legs[0]].bounds
        counted = _counted(parameter, list(bounds))
        levels = {
            name: noise
            or NOISE * float(np.ptp(d.forces.reshape(-1, d.theta_deg.size), axis=1).mean())
            for name, d in data.items()
        }
        surrogates = {name: DesignSurrogate.fit(d) for name, d in data.items()}
        search = _Search(surrogates, levels, bounds, seed)
        sd = [search.expected_sd()]
        chosen = []
        for _ in range(count):
            chosen.append(search.best(counted))
            search.add(chosen[-1])
            sd.append(search.expected_sd())
    keys = list(bounds)
    values = from_unit(search.candidates[chosen], bounds)
    return Suggestion(
        library.name,
        legs,
        tuple({k: float(f"{v:.4g}") for k, v in zip(keys, row, strict=True)} for row in values),
        tuple(dict(zip(keys, row.tolist(), strict=True)) for row in sd),
        dict(zip(keys, search.floor_sd().tolist(), strict=True)),
        levels,
    )


def _counted(parameter: str | None, keys: Sequence[str]) -> list[int]:
    if parameter is None:
        return list(range(len(keys)))
    matches = [i for i, k in enumerate(keys) if k == parameter or k.endswith(f".{parameter}")]
    if len(matches) != 1:
        names = ", ".join(f"{k} ({label(k)[0]})" for k in keys)
        raise InputError(
            f"the library varies no parameter '{parameter}'; it has {names}; "
            f"{nearest(parameter, list(keys))}"
        )
    return matches


@dataclass(frozen=True, eq=False)
class _Known:
    """What a process knows at truths and candidates, whatever the forces at its points are.

    ``truth`` [truth, theta] and ``candidate`` [candidate, theta] are variances, ``across`` [truth,
    candidate, theta] covariances.
    """

    process: Process[DesignKernel]
    points: FloatArray
    truths: FloatArray
    candidates: FloatArray
    truth: FloatArray
    candidate: FloatArray
    across: FloatArray

    @classmethod
    def of(
        cls,
        process: Process[DesignKernel],
        points: FloatArray,
        truths: FloatArray,
        candidates: FloatArray,
    ) -> _Known:
        """With simulations at some points, shape [case, d]."""
        kernel, theta_deg = process.kernel, process.theta_deg
        known = Kronecker(
            kernel.over_points(points, points),
            kernel.over_angles(theta_deg),
            np.zeros((len(points), theta_deg.size)),
            signal=kernel.signal_variance,
            noise=kernel.noise_variance,
        ).posterior(process.std)
        one, other = (kernel.over_points(x, points) for x in (truths, candidates))
        return cls(
            process, points, truths, candidates,
            known.variance(one, kernel.variance(truths)),
            known.variance(other, kernel.variance(candidates)),
            known.covariance(one, other, kernel.over_points(truths, candidates)),
        )  # fmt: skip

    def after(self, candidate: int) -> FloatArray:
        """Variance at the truths after a simulation at a candidate, shape [truth, theta]."""
        # A candidate that is known already has next to no variance, and no covariance either.
        floor = np.finfo(float).eps * self.process.roots.max() * self.process.std**2
        whole = self.candidate[candidate] + self.process.noise_variance + floor
        return (self.truth - np.square(self.across[:, candidate]) / whole).clip(min=0.0)

    def added(self, candidate: int) -> _Known:
        """The same after a simulation at a candidate."""
        points = np.vstack([self.points, self.candidates[candidate]])
        return _Known.of(self.process, points, self.truths, self.candidates)


@dataclass(frozen=True, eq=False)
class _Leg:
    """A leg at the truths, all forces over their size.

    ``slopes`` [truth, key, theta] of each force are over the parameters' spans, ``curves`` [truth,
    theta]; ``noise`` [truth] is the standard deviation of a window mean; ``known`` are the two
    processes of the forces and that of their size.
    """

    slopes: tuple[FloatArray, ...]
    curves: tuple[FloatArray, ...]
    noise: FloatArray
    known: tuple[_Known, ...]

    def information(self, variances: Sequence[FloatArray]) -> FloatArray:
        """Of the parameters over their spans, shape [truth, key, key]."""
        *forces, size = variances
        whole = [
            variance + np.square(self.noise)[:, None] + known.process.noise_variance
            for variance, known in zip(forces, self.known[:-1], strict=True)
        ]
        return fisher(self.slopes, self.curves, whole, size[:, 0])


class _Search:
    """The state of a greedy design."""

    def __init__(
        self,
        surrogates: Mapping[str, DesignSurrogate],
        noise: Mapping[str, float],
        bounds: Mapping[str, tuple[float, float]],
        seed: int,
    ) -> None:
        keys = list(bounds)
        self.spans = np.array([high - low for low, high in bounds.values()])
        self.truths, self.candidates = _points(len(keys), seed)
        named = dict(zip(keys, from_unit(self.truths, bounds).T, strict=True))
        self.legs = []
        for leg, surrogate in surrogates.items():
            scale = surrogate.scale(named)
            both = surrogate.slopes(named, keys, (SLOPE_STEP * self.spans).tolist())
            per_span = self.spans[:, None] / scale[:, None, None]
            processes = (*surrogate.processes, surrogate.log_size)
            self.legs.append(
                _Leg(
                    tuple(slopes * per_span for slopes in both),
                    tuple(p.rotated_mean(self.truths) for p in surrogate.processes),
                    noise[leg] / scale,
                    tuple(_Known.of(p, p.points, self.truths, self.candidates) for p in processes),
                )
            )

    def _covariance(self, variances: Sequence[Sequence[FloatArray]]) -> FloatArray:
        """Of the parameters over their spans at each truth, shape [truth, key, key]."""
        information = [leg.information(v) for leg, v in zip(self.legs, variances, strict=True)]
        # A uniform prior on a unit span has a variance of 1/12.
        precision = np.sum(information, axis=0) + 12.0 * np.eye(len(self.spans))
        return np.linalg.inv(precision)

    def expected_sd(self) -> FloatArray:
        """Root of the expected variance of each parameter, in its unit, shape [key]."""
        return self._sd([[known.truth for known in leg.known] for leg in self.legs])

    def floor_sd(self) -> FloatArray:
        """The same if the surrogates knew the forces exactly."""
        return self._sd([[np.zeros_like(k.truth) for k in leg.known] for leg in self.legs])

    def _sd(self, variances: Sequence[Sequence[FloatArray]]) -> FloatArray:
        variance = np.diagonal(self._covariance(variances), axis1=1, axis2=2).mean(axis=0)
        return np.sqrt(variance) * self.spans

    def risk(self, candidate: int, counted: Sequence[int]) -> float:
        """Expected variance in units of the prior's after a simulation there, summed [-]."""
        after = [[known.after(candidate) for known in leg.known] for leg in self.legs]
        diagonal = np.diagonal(self._covariance(after), axis1=1, axis2=2)[:, list(counted)]
        return 12.0 * float(diagonal.mean(axis=0).sum())

    def best(self, counted: Sequence[int]) -> int:
        """The candidate of least risk."""
        return int(np.argmin([self.risk(c, counted) for c in range(len(self.candidates))]))

    def add(self, candidate: int) -> None:
        """Condition all processes on a simulation at a candidate."""
        self.legs = [
            replace(leg, known=tuple(known.added(candidate) for known in leg.known))
            for leg in self.legs
        ]


def _points(d: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Truths and candidates, scaled to [-1, 1]; a line is filled evenly, its ends included."""
    from scipy.stats import qmc

    if d == 1:
        step = 2.0 / TRUTHS
        truths = np.arange(-1.0 + 0.5 * step, 1.0, step)
        return truths[:, None], np.linspace(-1.0, 1.0, CANDIDATES)[:, None]
    first, second = np.random.SeedSequence(seed).spawn(2)
    truths, candidates = (
        2.0 * qmc.Sobol(d, rng=np.random.default_rng(stream)).random(count) - 1.0
        for stream, count in ((first, TRUTHS), (second, CANDIDATES))
    )
    # What lies at the rim of the box tells most about it, and a Sobol sequence hardly goes there.
    half = CANDIDATES // 2
    candidates[half:] = (1.25 * candidates[half:]).clip(-1.0, 1.0)
    return truths, candidates
