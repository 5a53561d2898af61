"""The figures of the paper, drawn from our own simulations. Forces over θ are means over 1°."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import WINDOW_DEG, ForceHistory
from terraphi.experiment.motion import placed
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.paper.likelihood import observe
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from terraphi.forward.driver import Snapshot
    from terraphi.paper.gaussian_process import Surrogate
    from terraphi.paper.likelihood import Posterior

COLORMAP = "viridis"
PHI, THETA = "friction angle φ of the paper [deg]", "leg angle θ [deg]"
FORCE = {"Fx": "$F_x$ [N], forward", "Fz": "$F_z$ [N], up"}
IN_YUMA = {
    "measured": ("measured, Li et al. 2013", ORANGE, "none"),
    "mpm": ("MPM, its text", BLUE, "-"),
    "rft2d": ("RFT 2-D, generic, ζ = 0.597", GREEN, "--"),
    "paper_code": ("counted by its code", PURPLE, "-."),
    "paper_code_applied": ("applied by its code", PURPLE, ":"),
}
"""Label, color and line; RFT 3-D is five times the measured force, and left out."""
Points = Mapping[str, tuple[FloatArray, FloatArray]]
SNAPSHOTS_DEG = (-60.0, -30.0, 0.0, 40.0)
SPEED_UP = 10.0
"""Speed-up for the snapshots: forces differ by 3 to 4 % from those at the true speed."""


def panels(
    rows: int, columns: int, size: tuple[float, float], **options: Any
) -> tuple[Figure, Any]:
    """A figure of a size [in], and its panels, shape [row, column]."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def legend(axes: Axes, ncols: int) -> None:
    """A legend below all panels, of one of them."""
    figure = cast("Figure", axes.figure)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=ncols, frameon=False)


def curve(axes: Axes, history: ForceHistory, force: str, **look: Any) -> None:
    """One force of a history, ``Fx`` or ``Fz``, over the leg angle."""
    observation = observe(history, 171)
    axes.plot(observation.theta_deg, getattr(observation, force), **look)
    axes.axhline(0.0, color=GREY, lw=0.6)
    axes.set(xlim=(-88.0, 88.0), xticks=range(-80, 81, 40), xlabel=THETA, ylabel=FORCE[force])


def histories(by_phi: Mapping[float, ForceHistory]) -> Figure:
    """Both forces over the leg angle, a curve for each friction angle [deg]."""
    figure, (row,) = panels(1, 2, (8.4, 3.6))
    scale = Normalize(min(by_phi), max(by_phi))
    for axes, force in zip(row, FORCE, strict=True):
        for phi, history in by_phi.items():
            curve(axes, history, force, color=colormaps[COLORMAP](scale(phi)), lw=1.1)
    figure.colorbar(ScalarMappable(scale, COLORMAP), ax=row, pad=0.02).set_label(PHI)
    return figure


def peaks(data: Mapping[str, Any], printed: Mapping[float, tuple[float, float]]) -> Figure:
    """Peak forces and their leg angles over φ, next to the peaks that the paper prints."""
    figure, ((forces, angles),) = panels(1, 2, (8.4, 3.4))
    tops = np.array(list(printed.values())).T
    for force, style, ends in zip(("Fz", "Fx"), ("bo-", "rs-"), tops, strict=True):
        forces.plot(data["phi_deg"], data[f"peak_{force}_N"], style, ms=4, label=force)
        angles.plot(data["phi_deg"], data[f"theta_peak_{force}_deg"], style, ms=4)
        forces.plot(list(printed), ends, style[:2], mfc="none", ms=7, label=f"{force}, Xu & Wang")
    forces.set(xlabel=PHI, ylabel="peak force [N]", ylim=(0.0, None))
    angles.set(xlabel=PHI, ylabel="leg angle of the peak [deg]")
    legend(forces, 4)
    return figure


def legs(by_leg: Mapping[str, Mapping[str, ForceHistory]]) -> Figure:
    """Forces on several legs: a column a leg, a row a force."""
    figure, grid = panels(2, len(by_leg), (9.6, 5.4), sharex=True)
    for column, (leg, models) in zip(grid.T, by_leg.items(), strict=True):
        for axes, force in zip(column, FORCE, strict=True):
            for model, (label, color, style) in IN_YUMA.items():
                marker = {"marker": ".", "ms": 3} if style == "none" else {}
                curve(axes, models[model], force, color=color, ls=style, label=label, **marker)
        column[0].set_title(leg.replace("_", " "), fontsize=10)
    for axes in grid[:, 1:].flat:
        axes.set_ylabel("")
    legend(grid[0, 0], 3)
    return figure


def surfaces(surrogate: Surrogate, held_out_deg: FloatArray) -> Figure:
    """Mean forces of the surrogate over both angles, with the φ [deg] of both sets of cases."""
    figure, (row,) = panels(1, 2, (8.8, 3.9))
    phi = np.linspace(*surrogate.phi_bounds_deg, 201)
    for axes, force in zip(row, FORCE, strict=True):
        process = getattr(surrogate, force)
        grid = process.theta_deg, phi, process.predict(phi)
        shown = axes.contourf(*grid, 24, cmap=COLORMAP)
        axes.contour(*grid, [0.0], colors="white", linewidths=1.2)
        axes.hlines(held_out_deg, -WINDOW_DEG, WINDOW_DEG, color=ORANGE, lw=1, label="held out")
        edge = np.full(process.phi_deg.size, -WINDOW_DEG)
        axes.plot(edge, process.phi_deg, "k>", ms=4, clip_on=False, label="library")
        axes.set(xlabel=f"{THETA} (white: no force)", ylabel=PHI, xticks=range(-80, 81, 40))
        ticks = MaxNLocator(8, steps=[1, 2, 5, 10])
        figure.colorbar(shown, ax=axes, format="%g", ticks=ticks).set_label(FORCE[force])
    legend(row[0], 2)
    return figure


def slices(surrogate: Surrogate, points: Points, places: Sequence[int]) -> Figure:
    """Forces at some leg angles over φ: the surrogate's mean ± 2 standard deviations, simulations.

    Parameters
    ----------
    surrogate
        The surrogate.
    points
        ``library`` and ``held out`` to friction angles [deg] and d [N], [case, 2 theta].
    places
        Indices of the leg angles.
    """
    figure, grid = panels(2, len(places), (9.6, 5.2), sharex=True)
    phi = np.linspace(*surrogate.phi_bounds_deg, 201)
    theta = surrogate.Fx.theta_deg
    for row, force, shift in zip(grid, FORCE, (0, theta.size), strict=True):
        process = getattr(surrogate, force)
        mean, spread = process.predict(phi), 2.0 * np.sqrt(process.variance(phi))
        for axes, i in zip(row, places, strict=True):
            axes.fill_between(phi, (mean - spread)[:, i], (mean + spread)[:, i], alpha=0.3)
            axes.plot(phi, mean[:, i], color="black", lw=1.0, label="surrogate")
            for (name, (angles, vectors)), style in zip(points.items(), ("bo", "rD"), strict=True):
                axes.plot(angles, vectors[:, i + shift], style, ms=4, label=name)
            axes.set_title(f"θ = {theta[i]:.0f}°", fontsize=10)
        row[0].set_ylabel(FORCE[force])
    grid[-1, 1].set_xlabel(PHI)
    legend(grid[0, 0], 3)
    return figure


def residuals(lags_deg: FloatArray, rho: FloatArray, length_deg: float) -> Figure:
    """Autocorrelation of the residuals over the lag, with kernels of our length and the paper's."""
    figure, ((axes,),) = panels(1, 1, (5.0, 3.4))
    fine = np.linspace(0.0, lags_deg[-1], 400)
    for length, style, name in ((length_deg, "b-", "fitted"), (6.0, "r--", "Xu & Wang, about")):
        axes.plot(
            fine, np.exp(-0.5 * (fine / length) ** 2), style, label=f"{name} ℓ = {length:.1f}°"
        )
    axes.plot(lags_deg, rho, "ko:", ms=4, lw=0.8, label="held-out residuals")
    axes.set(xlabel="lag in leg angle [deg]", ylabel="autocorrelation of the residuals")
    axes.legend(frameon=False, fontsize="small")
    return figure


def walkers(steps_deg: FloatArray, truth_deg: float, exact: Posterior, burn_in: int) -> Figure:
    """Traces of an ensemble's walkers [deg], shape [walker, step], and both posteriors."""
    figure, ((traces, density),) = panels(1, 2, (9.6, 3.6), width_ratios=(1.6, 1.0))
    traces.plot(steps_deg.T, color=BLUE, lw=0.3, alpha=0.35)
    traces.axvspan(0, burn_in, color=GREY, alpha=0.25, lw=0)
    traces.axhline(truth_deg, color=ORANGE, lw=1.2, ls="--")
    traces.set(xlim=(0, steps_deg.shape[1]), xlabel="step (grey: burn-in)", ylabel=PHI)
    drawn = steps_deg[:, burn_in:].ravel()
    density.hist(drawn, 80, density=True, color=BLUE, alpha=0.4, label="emcee")
    density.plot(exact.phi_deg, exact.density, color="black", lw=1.2, label="quadrature")
    density.axvline(truth_deg, color=ORANGE, lw=1.2, ls="--", label="truth")
    density.axvspan(*exact.interval(0.68), color=GREY, alpha=0.25, lw=0, label="68 % interval")
    density.set(xlim=exact.interval(0.998), yticks=[], xlabel=PHI, ylabel="posterior density")
    legend(density, 4)
    return figure


def recovery(cases: Sequence[Mapping[str, Any]]) -> Figure:
    """Inferred over true friction angles, and their errors, with intervals."""
    truth, median = (np.array([c[f"phi_{key}_deg"] for c in cases]) for key in ("true", "median"))
    figure, (row,) = panels(1, 2, (10.0, 4.2))
    for axes, base, name in zip(row, (0.0 * truth, truth), ("φ", "φ less true"), strict=True):
        axes.plot(truth, truth - base, color=GREY, lw=0.8)
        for key, width in (("ci95", 1.2), ("ci68", 4.0)):
            low, high = np.array([case[key] for case in cases]).T - base
            label = f"{key[2:]} % interval"
            axes.vlines(truth, low, high, color=BLUE, lw=width, alpha=0.5, label=label)
        axes.plot(truth, median - base, "o", color=ORANGE, ms=4, label="median")
        axes.set(xlabel=f"true {PHI}", ylabel=f"inferred {name} [deg]")
    legend(row[0], 3)
    return figure


# -- the soil around the legs ----------------------------------------------------------------------


class Moment(NamedTuple):
    """The soil at one leg angle [rad]: hip [m], particles [m], their speed [m/s] and weight [-]."""

    theta: float
    hip: FloatArray
    points: FloatArray
    speed: FloatArray
    weight: FloatArray


def soil_around(
    scenario: Scenario, shapes: Iterable[str], progress: Callable[[float], None]
) -> dict[str, tuple[Scenario, list[Moment]]]:
    """Simulate legs of several shapes, and keep the soil when each first reaches some angles."""
    by_shape: dict[str, tuple[Scenario, list[Moment]]] = {}
    count = len(shapes := list(shapes))
    for number, shape in enumerate(shapes):
        sped_up = scenario.replace(**{"leg.shape": shape, "numerics.speed_up": SPEED_UP})
        kept: list[Moment] = []

        def observe(snapshot: Snapshot, kept: list[Moment] = kept) -> None:
            theta, soil = float(snapshot.pose.theta[0]), cast(Any, snapshot.soil)
            if len(kept) < len(SNAPSHOTS_DEG) and np.degrees(theta) >= SNAPSHOTS_DEG[len(kept)]:
                speed = np.linalg.norm(soil.velocity, axis=1) / SPEED_UP
                hip, points = snapshot.pose.hip[0].copy(), soil.position.copy()
                kept.append(Moment(theta, hip, points, speed, soil.weight.copy()))

        def along(done: float, number: int = number) -> None:
            progress((number + done) / count)

        simulate(sped_up, progress=along, observe=observe)
        by_shape[shape] = sped_up, kept
    return by_shape


def snapshots(by_leg: Mapping[str, tuple[Scenario, Sequence[Moment]]]) -> Figure:
    """Particles around several legs: a row a leg, a column an angle; pale: faded by the relief."""
    columns = max(len(kept) for _, kept in by_leg.values())
    size = (3.0 * columns + 1.0, 2.2 * len(by_leg) + 0.3)
    figure, grid = panels(len(by_leg), columns, size, sharex=True, sharey=True)
    shown: Any = None
    for row, (leg, (scenario, kept)) in zip(grid, by_leg.items(), strict=True):
        tip, bed = scenario.motion.top_speed(scenario.leg.reach()), scenario.bed
        for axes, moment in zip(row, kept, strict=True):
            look: dict[str, Any] = {"cmap": COLORMAP, "vmin": 0.0, "vmax": 1.0, "lw": 0, "s": 0.6}
            faded: Any = np.maximum(moment.weight, 0.25)
            place = 1e3 * moment.points.T
            shown = axes.scatter(*place, c=moment.speed / tip, alpha=faded, rasterized=True, **look)
            corners = placed(scenario.leg.outline(), moment.hip, np.array([moment.theta]))[0]
            axes.add_patch(Polygon(1e3 * corners, facecolor="white", edgecolor="black"))
            axes.plot(*(1e3 * moment.hip), "k+")
            axes.set_title(
                f"{leg.replace('_', ' ')}, θ = {np.degrees(moment.theta):+.0f}°", fontsize=9
            )
            axes.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal")
            axes.set(ylim=(60.0, 1e3 * bed.surface + 85.0))
            axes.label_outer()
    bar = figure.colorbar(shown, ax=grid, shrink=0.6, aspect=40, extend="max")
    bar.set_label("speed of the soil over that of the leg's tip")
    return figure
