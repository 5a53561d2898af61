"""Design: a library built in the order that is suggested, against an even one of the same size.

Three-dimensional resistive force theory stands in for longer simulations. Over the friction angle
the even library is a grid, built anew for each size; over three parameters it is a Sobol sequence.
The other begins with the same few points and takes what `suggest` names, given what it has. Both
are asked for truths that neither has seen, without noise: what they get wrong is their own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.stats import qmc

from terraphi.design_surrogate import DesignSurrogate, training
from terraphi.forward import simulate
from terraphi.history import ForceHistory
from terraphi.inference.joint.identifiability import axis_label, label
from terraphi.inference.joint.suggestion import suggest
from terraphi.library import Case, Library
from terraphi.plan import Plan, Sample
from terraphi.plots import BLUE, ORANGE
from terraphi.scenario import Scenario
from terraphi.studies import Study

FloatArray = NDArray[np.float64]
Key = str

BASE: dict[str, Any] = {
    "model": "rft",
    "dimensions": 3,
    "leg": {"friction": 0.4},
    "motion": {"start_deg": -90.0, "stop_deg": 90.0},
    "rft": {"panels": 60},
}
"""Setting of the simulations: the leg's path in the soil alone, and coarse."""
LEG = "straight"
PHI = "soil.friction_angle_deg"
NOISES = (0.01, 0.003, 0.001)
"""Noise of a window mean, of the forces' peak-to-peak [-]."""
SLOPE_STEP = 1e-3
"""Step of differences over a parameter, of its span [-]."""


@dataclass(frozen=True)
class Box:
    """Parameters, and the sizes of the libraries over them.

    Attributes
    ----------
    bounds
        Dotted key to its bounds.
    sizes
        Numbers of cases, of which the first is where both begin.
    truths
        Number of truths.
    """

    bounds: Mapping[Key, tuple[float, float]]
    sizes: Sequence[int]
    truths: int
    _made: dict[tuple[float, ...], ForceHistory] = field(default_factory=dict, repr=False)

    def simulated(self, point: Sequence[float]) -> ForceHistory:
        """Forces at a point, computed once."""
        at = tuple(float(value) for value in point)
        if at not in self._made:
            scenario = Scenario.model_validate(BASE)
            self._made[at] = simulate(scenario.replace(**dict(zip(self.bounds, at, strict=True))))
        return self._made[at]

    def library(self, points: FloatArray) -> Library:
        """Library of some points, shape [case, key]."""
        sample = Sample(keys=dict(self.bounds), count=0, also=points.tolist())
        plan = Plan(name="design", scenario=Scenario.model_validate(BASE), sample=sample)
        cases = zip(plan.cases(), points, strict=True)
        return Library(plan, tuple(Case(s, self.simulated(at), "") for s, at in cases))

    def even(self, count: int) -> FloatArray:
        """Evenly spread points, shape [case, key]: a grid over one parameter, else Sobol's."""
        if len(self.bounds) == 1:
            return np.linspace(*next(iter(self.bounds.values())), count)[:, None]
        points = Sample(keys=dict(self.bounds), count=count).points()
        return np.array([list(point.values()) for point in points])

    def unseen(self) -> FloatArray:
        """Truths in between, shape [truth, key]."""
        low, high = np.array(list(self.bounds.values())).T
        unit = qmc.Sobol(len(low), rng=np.random.default_rng(1)).random(self.truths)
        return np.asarray(qmc.scale(unit, low, high))

    def following(self, points: FloatArray, level: float) -> FloatArray:
        """The points and the one that is suggested next, at a level of noise [-]."""
        library = self.library(points)
        spans = np.ptp(training(library, LEG).forces.reshape(2 * len(points), -1), axis=1)
        found = suggest(library, leg=LEG, noise=level * float(spans.mean()))
        return np.vstack([points, list(found.points[0].values())])

    def wrong(self, points: FloatArray, level: float) -> FloatArray:
        """Root mean square error of each parameter, inferred with a library of some points.

        To first order: the surrogate's error at a truth, weighted as the likelihood weights it.
        Shape [key].
        """
        surrogate = DesignSurrogate.fit(training(self.library(points), LEG))
        truths = self.unseen()
        keys = list(self.bounds)
        named = dict(zip(keys, truths.T, strict=True))
        data = np.stack([self.simulated(at).observation().vector for at in truths])
        spans = np.array([high - low for low, high in self.bounds.values()])
        noise = level * np.ptp(data.reshape(len(data), 2, -1), axis=2).mean(axis=1)
        precision = np.tile(np.diag(12.0 / np.square(spans)), (len(truths), 1, 1))
        scale = surrogate.scale(named)[:, None]
        forces, slopes, whole = [], [], []
        for process, slope in zip(
            surrogate.processes,
            surrogate.slopes(named, keys, (SLOPE_STEP * spans).tolist()),
            strict=True,
        ):
            mean, variance = process.rotated(surrogate.points(named))
            forces.append(scale * mean)
            slopes.append(slope)
            own = np.square(scale) * (variance + process.noise_variance)
            whole.append(own + np.square(noise)[:, None])
        curve, slope, variance = np.hstack(forces), np.dstack(slopes), np.hstack(whole)
        bases = block_diag(*(process.basis for process in surrogate.processes))
        covariance = variance[:, :, None] * np.eye(variance.shape[1]) + surrogate.factor_variance(
            named
        )[:, None, None] * np.einsum("xt,xu->xtu", curve, curve)
        weighted = np.linalg.solve(covariance, slope.swapaxes(1, 2))
        precision += slope @ weighted
        score = np.einsum("xtk,xt->xk", weighted, data @ bases - curve)
        errors = np.linalg.solve(precision, score[:, :, None])[:, :, 0]
        return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))


BOXES = (
    Box({PHI: (15.0, 50.0)}, tuple(range(3, 11)), 32),
    Box(
        {PHI: (20.0, 45.0), "leg.friction": (0.2, 0.6), "motion.hip.1": (0.18, 0.20)},
        (16, 20, 24, 28, 32),
        32,
    ),
)


def run(*, progress: Callable[[float, float], None] | None = None) -> Study:
    """Build libraries in both orders, and compare what they get wrong.

    Parameters
    ----------
    progress
        Called with the number of libraries that are done, and of all.

    Returns
    -------
    Study
        ``data``: ``comparisons``, each with ``keys``, ``noise_of_peak_to_peak``, ``cases``,
        ``even`` and ``suggested`` (root mean square error of each parameter, by size) and ``order``
        (the suggested points, after those at the beginning).
    """
    tasks = [(box, level) for box in BOXES for level in NOISES]
    comparisons = []
    for box, level in tasks:
        comparisons.append(_compared(box, level))
        if progress is not None:
            progress(len(comparisons), len(tasks))
    return Study(
        title="Errors of a library's own, built evenly and in the order that is suggested",
        header=("parameters", "noise", "cases", "even", "suggested", "even / suggested"),
        rows=[row for comparison in comparisons for row in _rows(comparison)],
        data={"comparisons": comparisons},
        figures={"design": _figure(comparisons)},
        notes=[
            _note([c for c in comparisons if c["keys"] == list(box.bounds)], i)
            for box in BOXES
            for i in range(len(box.bounds))
        ],
    )


def _compared(box: Box, level: float) -> dict[str, Any]:
    """Libraries of all sizes in both orders."""
    points = box.even(box.sizes[0])
    found: dict[str, list[list[float]]] = {"even": [], "suggested": []}
    for size in box.sizes:
        while len(points) < size:
            points = box.following(points, level)
        found["even"].append(box.wrong(box.even(size), level).tolist())
        found["suggested"].append(box.wrong(points, level).tolist())
    return {
        "keys": list(box.bounds),
        "noise_of_peak_to_peak": level,
        "cases": list(box.sizes),
        **found,
        "order": points[box.sizes[0] :].tolist(),
    }


def _rows(comparison: Mapping[str, Any]) -> list[tuple[str, ...]]:
    names = ", ".join(axis_label(key) for key in comparison["keys"])
    rows = []
    for size, *both in zip(*(comparison[k] for k in ("cases", "even", "suggested")), strict=True):
        even, other = both
        columns = (
            ", ".join(form(value) for value in values)
            for form, values in (
                ("{:.2g}".format, even),
                ("{:.2g}".format, other),
                ("{:.2f}".format, np.divide(even, other)),
            )
        )
        rows.append((names, f"{comparison['noise_of_peak_to_peak']:.1%}", f"{size}", *columns))
    return rows


def _note(comparisons: Sequence[Mapping[str, Any]], i: int) -> str:
    """Mean ratio of the errors of a parameter over sizes and noises, in words."""
    ratios = np.array([[e[i] for e in c["even"][1:]] for c in comparisons]) / np.array(
        [[e[i] for e in c["suggested"][1:]] for c in comparisons]
    )
    first, keys = comparisons[0], comparisons[0]["keys"]
    alone = "alone" if len(keys) == 1 else f"of {len(keys)}"
    return (
        f"{label(keys[i])[0]} {alone}, {first['cases'][1]} to {first['cases'][-1]} cases: the "
        f"even library errs {np.exp(np.log(ratios).mean()):.2f} times as much as the suggested one "
        f"(geometric mean; {ratios.min():.2f} to {ratios.max():.2f}), and more than it in "
        f"{np.count_nonzero(ratios > 1.0)} of {ratios.size}."
    )


def _figure(comparisons: Sequence[Mapping[str, Any]]) -> Any:
    """Error of the first parameter over the number of cases, a panel each comparison."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.0 * len(NOISES) + 0.4, 5.6), layout="constrained")
    panels = figure.subplots(len(BOXES), len(NOISES), sharey="row", squeeze=False)
    for axes, comparison in zip(panels.ravel(), comparisons, strict=True):
        for order, colour, style in (("even", BLUE, "o-"), ("suggested", ORANGE, "s--")):
            errors = [found[0] for found in comparison[order]]
            axes.plot(comparison["cases"], errors, style, color=colour, ms=4, label=order)
        count, level = len(comparison["keys"]), comparison["noise_of_peak_to_peak"]
        axes.set_yscale("log")
        axes.set_title(f"{count} varied, noise {level:.1%} of peak-to-peak", fontsize=9)
        axes.set_xlabel("cases")
    for axes in panels[:, 0]:
        axes.set_ylabel("RMS error of φ, 3-D RFT [deg]")
    panels[0, 0].legend(frameon=False)
    return figure
