"""Design: a library built in the order that is suggested, against even ones of the same size.

Three-dimensional resistive force theory stands in for longer simulations. The even libraries are
grids, built anew for each size, and Sobol sequences. The other begins with the coarsest grid and
takes what `suggest` names, given what it has. All are asked for truths that none has seen, without
noise: what they get wrong is their own.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import qmc

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.inference.identifiability import axis_label, label
from terraphi.inference.suggestion import NOISE, suggest
from terraphi.library.plan import Plan, Sample
from terraphi.library.store import Case, Library
from terraphi.surrogate.design import DesignSurrogate
from terraphi.surrogate.training import training
from terraphi.view.plots import BLUE, GREY, ORANGE, panels_of
from terraphi.view.table import Table
from terraphi_studies import Progress, Study, steps
from terraphi_studies.measures import PHI

BASE: dict[str, Any] = {
    "model": "rft",
    "dimensions": 3,
    "leg": {"friction": 0.4},
    "motion": {"start_deg": -90.0, "stop_deg": 90.0},
    "rft": {"panels": 60},
}
"""Setting of the simulations: the leg's path in the soil alone, and coarse."""
LEG = "straight"
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

    bounds: Mapping[str, tuple[float, float]]
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

    def grid(self, count: int) -> FloatArray:
        """All combinations of evenly spaced values, as many of each, shape [case, key]."""
        each = round(count ** (1.0 / len(self.bounds)))
        axes = (np.linspace(low, high, each) for low, high in self.bounds.values())
        return np.array(list(itertools.product(*axes)))

    def sobol(self, count: int) -> FloatArray:
        """Points that fill the box evenly, shape [case, key]."""
        points = Sample(keys=dict(self.bounds), count=count).points()
        return np.array([list(point.values()) for point in points])

    def unseen(self) -> FloatArray:
        """Truths in between, shape [truth, key]."""
        low, high = np.array(list(self.bounds.values())).T
        unit = qmc.Sobol(len(low), rng=np.random.default_rng(1)).random(self.truths)
        return np.asarray(qmc.scale(unit, low, high))

    def wrong(self, points: FloatArray) -> FloatArray:
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
        noise = NOISE * np.ptp(data.reshape(len(data), 2, -1), axis=2).mean(axis=1)
        precision = np.tile(np.diag(12.0 / np.square(spans)), (len(truths), 1, 1))
        scale = surrogate.scale(named)[:, None]
        forces, slopes, whole = [], [], []
        steps = (SLOPE_STEP * spans).tolist()
        by_force = zip(surrogate.processes, surrogate.slopes(named, keys, steps), strict=True)
        for process, slope in by_force:
            mean, variance = process.rotated(surrogate.points(named))
            forces.append(scale * mean)
            slopes.append(slope)
            own = np.square(scale) * (variance + process.noise_variance)
            whole.append(own + np.square(noise)[:, None])
        curve, slope, variance = np.hstack(forces), np.dstack(slopes), np.hstack(whole)
        bases = block_diag(*(process.basis for process in surrogate.processes))
        together = surrogate.located(named)[2][:, None, None]
        covariance = variance[:, :, None] * np.eye(variance.shape[1])
        covariance = covariance + together * np.einsum("xt,xu->xtu", curve, curve)
        weighted = np.linalg.solve(covariance, slope.swapaxes(1, 2))
        precision += slope @ weighted
        score = np.einsum("xtk,xt->xk", weighted, data @ bases - curve)
        errors = np.linalg.solve(precision, score[:, :, None])[:, :, 0]
        return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))


PHI_BOUNDS = (20.0, 45.0)
BOXES = (
    Box({PHI: (15.0, 50.0)}, (3, 4, 5, 6, 7, 8, 9, 10), 32),
    Box({PHI: PHI_BOUNDS, "leg.friction": (0.2, 0.6)}, (4, 9, 16, 25), 32),
    Box({PHI: PHI_BOUNDS, "leg.friction": (0.2, 0.6), "motion.hip.1": (0.18, 0.20)}, (8, 27), 32),
)
ORDERS = ("grid", "sobol", "suggested")


def run(*, progress: Progress | None = None) -> Study:
    """Build libraries in three orders, and compare what they get wrong.

    Parameters
    ----------
    progress
        Called with the number of comparisons that are done, and of all.

    Returns
    -------
    Study
        ``data``: ``noise_of_peak_to_peak``, and ``comparisons``, each with ``keys``, ``cases``,
        ``grid``, ``sobol`` and ``suggested`` (root mean square error of each parameter, by size)
        and ``order`` (the suggested points, after those at the beginning).
    """
    step = steps(len(BOXES), progress)
    comparisons = [step(_compared(box)) for box in BOXES]
    return Study(
        table=Table.of(
            "Errors of a library's own: an even grid, a Sobol sequence, the suggested order",
            COLUMNS,
            [row for comparison in comparisons for row in _rows(comparison)],
        ),
        data={"noise_of_peak_to_peak": NOISE, "comparisons": comparisons},
        figures={"design": _figure(comparisons)},
        notes=[_note(comparison) for comparison in comparisons],
    )


def _compared(box: Box) -> dict[str, Any]:
    """Libraries of all sizes in all orders; the suggested one begins with the coarsest grid."""
    points = box.grid(box.sizes[0])
    found: dict[str, list[list[float]]] = {order: [] for order in ORDERS}
    for size in box.sizes:
        while len(points) < size:
            following = suggest(box.library(points), leg=LEG).points[0]
            points = np.vstack([points, list(following.values())])
        each = {"grid": box.grid(size), "sobol": box.sobol(size), "suggested": points}
        for order, chosen in each.items():
            found[order].append(box.wrong(chosen).tolist())
    order = points[box.sizes[0] :].tolist()
    return {"keys": list(box.bounds), "cases": list(box.sizes), **found, "order": order}


COLUMNS = (
    ("", "{parameter}"),
    ("cases", "{size}"),
    ("grid", "{grid:.2g}"),
    ("Sobol", "{sobol:.2g}"),
    ("suggested", "{suggested:.2g}"),
    ("grid / suggested", lambda row: f"{row['grid'] / row['suggested']:.2f}"),
)


def _rows(comparison: Mapping[str, Any]) -> list[dict[str, Any]]:
    rows = []
    names = [label(key)[0] for key in comparison["keys"]]
    for i, key in enumerate(comparison["keys"]):
        others = ", ".join(name for j, name in enumerate(names) if j != i)
        parameter = axis_label(key) + (f", beside {others}" if others else "")
        for j, size in enumerate(comparison["cases"]):
            errors = {order: comparison[order][j][i] for order in ORDERS}
            rows.append({"parameter": parameter, "size": size, **errors})
    return rows


def _note(comparison: Mapping[str, Any]) -> str:
    """Ratios of the errors, over parameters and sizes, in words."""
    grid, sobol, suggested = (np.array(comparison[order])[1:] for order in ORDERS)
    names, sizes = ", ".join(label(key)[0] for key in comparison["keys"]), comparison["cases"]
    span = f"{sizes[1]} to {sizes[-1]}" if len(sizes) > 2 else f"{sizes[-1]}"
    mean, least, most = _spread(grid / suggested)
    return (
        f"{names}, {span} cases: the even grid errs {mean:.2f} times as much as the suggested "
        f"order ({least:.2f} to {most:.2f}), Sobol points {_spread(sobol / suggested)[0]:.2f} "
        "times (geometric means)."
    )


def _spread(ratios: FloatArray) -> tuple[float, float, float]:
    """Geometric mean, least and largest."""
    return float(np.exp(np.log(ratios).mean())), float(ratios.min()), float(ratios.max())


def _figure(comparisons: Sequence[Mapping[str, Any]]) -> Any:
    """Error of the friction angle over the number of cases, a panel each number of parameters."""
    figure, (panels,) = panels_of(1, len(comparisons), size=(3.2 * len(comparisons), 3.2))
    looks = {"grid": (BLUE, "o-"), "sobol": (GREY, "^:"), "suggested": (ORANGE, "s--")}
    for axes, comparison in zip(panels, comparisons, strict=True):
        for order, (colour, style) in looks.items():
            errors = [found[0] for found in comparison[order]]
            axes.plot(comparison["cases"], errors, style, color=colour, ms=4, label=order)
        axes.set(xlabel="cases", yscale="log")
        axes.set_title(", ".join(label(key)[0] for key in comparison["keys"]), fontsize=10)
    panels[0].set_ylabel("RMS error of φ, 3-D RFT [deg]")
    panels[0].legend(frameon=False)
    return figure
