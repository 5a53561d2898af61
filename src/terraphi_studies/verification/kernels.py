"""Agreement of the two kernels: step by step, and over whole sweeps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.history import WINDOW_DEG
from terraphi.experiment.leg import LEG_SHAPES
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.soil import YIELD_CRITERIA
from terraphi.forward.driver import Kernel, simulate
from terraphi.forward.plane.bed import Particles, geostatic_bed
from terraphi.library.workers import heartbeat
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, panels_of
from terraphi_studies.verification.check import Check, Family, Outcome, Task
from terraphi_studies.verification.conservation import BOOKS, ROUND_OFF, coarse_sweep
from terraphi_studies.verification.driver import follow, in_words, rig_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

LOOKS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)
"""Steps after which the two are compared."""
SAME = 1e-9
"""Difference allowed after all of these steps, of the largest entry of a field [-]."""
SOURCE = "Kernel `scalar`, the reference, written plainly; `packets` is the same but for rounding"
SCATTER = (
    "Standard deviation over beds that differ in the seed of their particles alone, root mean "
    "square over the angles |θ| ≤ 85°; both on means over 1°"
)


def growth(leg: str, criterion: str, looks: Sequence[int] = LOOKS) -> Outcome:
    """How the two kernels part from each other, step by step.

    Parameters
    ----------
    leg
        Shape of the leg, which turns from -10° through the vertical.
    criterion
        Yield criterion.
    looks
        Steps after which they are compared.
    """
    scenario = coarse_sweep(
        **{
            "leg.shape": leg,
            "soil.yield_criterion": criterion,
            "motion.start_deg": -10.0,
            "motion.stop_deg": 40.0,
            # Early and fast, so that much of the soil fades within these steps.
            "relief.distance": 1e-3,
            "relief.rate": 9.0,
        }
    )
    soils = {kernel: geostatic_bed(scenario) for kernel in _PAIR}
    rigs = {kernel: rig_of(scenario) for kernel in _PAIR}
    before, apart = 0, []
    for look in looks:
        for kernel in _PAIR:
            follow(scenario, soils[kernel], rigs[kernel], before, look - before, kernel=kernel)
        before = look
        apart.append(_apart(*(soils[kernel] for kernel in _PAIR)))
    faded = float((soils["packets"].weight < 0.5).mean())
    check = Check(
        problem="Two kernels, step by step",
        case=f"`{leg}`, `{criterion}`",
        quantity=f"largest difference after {looks[-1]} steps, of the field's largest entry",
        expected=0.0,
        obtained=apart[-1],
        tolerance=SAME,
        relative=False,
        sense="at_most",
        resolution=f"{in_words(scenario)}; {100.0 * faded:.0f} % of the soil faded to half or less",
        source=SOURCE,
    )
    return Outcome([check], {"leg": leg, "criterion": criterion, "steps": list(looks),
                             "apart": apart})  # fmt: skip


_PAIR: tuple[Kernel, Kernel] = ("packets", "scalar")


def _apart(ours: Particles, theirs: Particles) -> float:
    """Largest difference of any field, over that field's largest entry [-]."""
    return max(
        float(np.abs(one - other).max() / max(np.abs(other).max(), 1e-300))
        for one, other in zip(ours, theirs, strict=True)
    )


def whole_sweep(criterion: str, seeds: int, preset: str = "quick") -> Outcome:
    """Forces of a whole sweep by both kernels, beside those of beds with other seeds.

    Parameters
    ----------
    criterion
        Yield criterion.
    seeds
        Number of beds.
    preset
        Shipped scenario; ``coarse`` for a smaller one still.
    """
    base = coarse_sweep() if preset == "coarse" else Scenario.load(preset)
    scenario = base.replace(**{"soil.yield_criterion": criterion})
    runs = {
        seed: _means(scenario.replace(**{"numerics.seed": seed}), "packets")
        for seed in range(seeds)
    }
    reference, mismatch = _means(scenario.replace(**{"numerics.seed": 0}), "scalar")
    beds = np.array([run[0] for run in runs.values()])
    apart = _rms(beds[0] - reference)
    scatter = _rms(beds.std(axis=0, ddof=1))
    check = partial(
        Check,
        problem="Two kernels over a whole sweep",
        case=f"preset `{preset}`, `{criterion}`, {seeds} seeds",
        resolution=in_words(scenario),
        sense="at_most",
        relative=False,
        expected=0.0,
    )
    checks = [
        check(
            quantity=f"difference in {axis} over scatter from seed to seed ({scatter[i]:.2g} N)",
            obtained=float(apart[i] / scatter[i]),
            tolerance=0.1,
            source=SCATTER,
        )
        for i, axis in enumerate(("F_x", "F_z"))
    ]
    worst = {"packets": max(run[1] for run in runs.values()), "scalar": mismatch}
    checks += [
        check(
            quantity=f"momentum, largest mismatch of a step, kernel `{kernel}`",
            obtained=closed,
            tolerance=ROUND_OFF,
            source=BOOKS,
        )
        for kernel, closed in worst.items()
    ]
    curves = {
        "criterion": criterion,
        "preset": preset,
        "theta_deg": _ANGLES.tolist(),
        "scatter": beds.std(axis=0, ddof=1).tolist(),
        "apart": np.abs(beds[0] - reference).tolist(),
        "force": beds[0].tolist(),
    }
    return Outcome(checks, curves)


_ANGLES = np.arange(-WINDOW_DEG, WINDOW_DEG + 0.5)


def _means(scenario: Scenario, kernel: Kernel) -> tuple[FloatArray, float]:
    """Means over 1° [N], shape [angle, 2], and the largest mismatch of momentum [-]."""
    history = simulate(scenario, kernel=kernel, progress=lambda _: heartbeat(0.0))
    means = history.means(np.radians(_ANGLES), math.radians(0.5))
    return means, float(history.provenance["momentum_mismatch"])


def _rms(values: FloatArray) -> FloatArray:
    """Root mean square over angles, shape [2]."""
    return np.asarray(np.sqrt((values**2).mean(axis=0)))


QUICK = [
    Task("growth", growth, {"leg": "c", "criterion": "triaxial", "looks": LOOKS[:-1]}),
    Task("sweep", whole_sweep, {"criterion": "plane_strain", "seeds": 2, "preset": "coarse"}, 8.0),
]
FULL = [
    *(
        Task(f"growth-{leg}-{criterion}", growth, {"leg": leg, "criterion": criterion})
        for leg in LEG_SHAPES
        for criterion in YIELD_CRITERIA
    ),
    *(
        Task(f"sweep-{criterion}", whole_sweep, {"criterion": criterion, "seeds": 4}, 160.0)
        for criterion in ("paper", "plane_strain")
    ),
]
"""All legs under all criteria; whole sweeps under two of them."""


OF_SWEEP = {
    "force": (GREY, "force"),
    "scatter": (ORANGE, "seed to seed"),
    "apart": (BLUE, "kernel to kernel"),
}


def figures(outcomes: Mapping[str, Outcome]) -> dict[str, Figure]:
    """Growth of the difference, and difference and scatter over the angle."""
    grown = [o.curves for o in outcomes.values() if "leg" in o.curves]
    swept = [o.curves for o in outcomes.values() if "theta_deg" in o.curves]
    figure, ((left, right),) = panels_of(1, 2, size=(11.0, 3.8))
    colours = dict(zip(LEG_SHAPES, (BLUE, ORANGE, GREEN, PURPLE), strict=True))
    styles = dict(zip(YIELD_CRITERIA, ("-", "--", ":"), strict=True))
    for curves in grown:
        style, colour = styles[curves["criterion"]], colours[curves["leg"]]
        label = f"{curves['leg']}, {curves['criterion']}".replace("_", " ")
        left.loglog(curves["steps"], curves["apart"], style, color=colour, label=label)
    left.axhline(SAME, color=GREY, lw=0.8)
    left.set_xlabel("steps")
    left.set_ylabel("largest difference, of the largest entry")
    left.legend(fontsize=6, frameon=False, ncols=2)
    for curves, style in zip(swept, ("-", "--"), strict=False):
        for name, (colour, said) in OF_SWEEP.items():
            values = np.abs(np.array(curves[name])[:, 1])
            values[values == 0.0] = np.nan
            look: dict[str, Any] = {"color": colour, "label": f"{said}, {curves['criterion']}"}
            right.semilogy(curves["theta_deg"], values, style, lw=1.0, **look)
    right.set_xlabel("leg angle θ [deg]")
    right.set_ylabel("$|F_z|$ [N], means over 1°")
    right.legend(fontsize=6, frameon=False)
    return {"verification-kernels": figure}


FAMILY = Family(
    title="Agreement of the kernels",
    meaning="The fast kernel beside the reference kernel, with all legs and yield criteria and "
    "with relief. If these pass, it does not matter which of them was used.",
    full=FULL,
    quick=QUICK,
    figures=figures,
)
