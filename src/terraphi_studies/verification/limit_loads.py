"""Limit loads: a passive wall and a strip footing, both the plate that the leg may be.

The wall pushes a bed that lies on one side of it only. Of the footing one half is computed: its
middle stands at the left wall, which is smooth. N_q is that of a weightless soil, by Caquot's
correspondence: a cohesion c = p tan φ in place of a pressure p all around, so that
N_q = 1 + load / p; and, to check that, of a dead weight on a bed of little weight of its own, whose
N_γ is taken off. Soil under the footing carries the dead weight from the start, so that there too
N_q = 1 + load / p.

All is solved with the settings of preset ``resolved-2``, and with contact at the nodes. Soil lies
beneath the toe of a rough wall, as beneath the leg: the slip lines of the exact solution may leave
the toe downward. A smooth wall stands on a smooth floor.

Loads are read in the first geometry, for which the exact ones hold. Some smooth walls go on to
where a force history of a leg has its plateau; there the soil taken in by the toe counts.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.experiment.scenario import GRAVITY, Scenario
from terraphi.forward.driver import simulate
from terraphi.library.workers import heartbeat
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, one_legend, panels_of
from terraphi_studies.verification.check import Check, Family, Outcome, Task
from terraphi_studies.verification.driver import push
from terraphi_studies.verification.limit_scenarios import (
    CONFINEMENT,
    DENSITY,
    FOOTING_WIDTH,
    HEAVY,
    MOVED,
    N_GAMMA,
    NODES,
    PLATEAU,
    PRESET,
    WALL_HEIGHT,
    davis,
    footing_scenario,
    moved_pressure,
    n_gamma_per_degree,
    passive_pressure,
    passive_source,
    per_degree,
    surcharge_factor,
    wall_scenario,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


LOOKS = {
    PRESET: ("black", "-", "o"),
    NODES: (BLUE, "--", "s"),
}
"""Colour, line and marker of the settings; the preset's first."""
_ANGLE = re.compile(r"φ = ([0-9.]+)°, ")


def figures(outcomes: Mapping[str, Outcome]) -> dict[str, Figure]:
    """Loads over the exact ones against φ, a panel a problem; and the preset's along its path."""
    checks = [check for outcome in outcomes.values() for check in outcome.checks]
    drawn = {"verification-limit-loads": _against_angle(checks)} if checks else {}
    runs = [
        o.curves
        for o in outcomes.values()
        if o.curves.get("settings") == PRESET
        and o.curves["kind"] != "moved"
        and "ψ = 0" not in o.curves["case"]
    ]
    if runs:
        drawn["verification-limit-paths"] = _along_path(runs)
    return drawn


def _against_angle(checks: Sequence[Check]) -> Figure:
    """A panel for each problem that the preset's settings solve: the finest grid of each."""
    from matplotlib.ticker import MultipleLocator

    of_preset = {_problem(check) for check in checks if check.settings == PRESET}
    names = list(dict.fromkeys(_problem(c) for c in checks if _problem(c) in of_preset))
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    size = (4.2 * columns, 3.4 * rows + 0.6)
    figure, panels = panels_of(rows, columns, size=size, sharex=True)
    for axes, name in zip(panels.flat, names, strict=False):
        for settings, (colour, line, marker) in LOOKS.items():
            points = _finest([c for c in checks if c.settings == settings and _problem(c) == name])
            if points:
                look: dict[str, Any] = {"color": colour, "marker": marker, "ms": 4, "lw": 1.2}
                axes.plot(*zip(*points, strict=True), line, label=settings, **look)
        within = next(check.tolerance for check in checks if _problem(check) == name)
        axes.axhspan(1.0 - within, 1.0 + within, color=GREY, alpha=0.25, lw=0)
        _dress(axes, name, "φ [deg]")
        axes.tick_params(labelbottom=True)
        axes.xaxis.set_major_locator(MultipleLocator(5.0))
    for axes in panels.flat[len(names) :]:
        axes.remove()
    for axes in panels[:, 0]:
        axes.set_ylabel("limit load / exact")
    columns = len({check.settings for check in checks if _problem(check) in of_preset})
    one_legend(figure, "outside upper center", fontsize=8, ncols=columns)
    return figure


def _problem(check: Check) -> str:
    """A problem without its angle: what a panel is about."""
    return f"{check.problem}: {_ANGLE.sub('', check.case)}".replace(", associated", "")


def _finest(checks: Sequence[Check]) -> list[tuple[float, float]]:
    """φ [deg] and load over the exact one, on the grid with most cells at each φ."""
    found: dict[float, tuple[int, float]] = {}
    for check in checks:
        angle = _ANGLE.search(check.case)
        cells = int(check.resolution.rpartition("=")[2])
        if angle and cells > found.get(float(angle[1]), (0, 0.0))[0]:
            found[float(angle[1])] = (cells, check.obtained / check.expected)
    return sorted((phi, ratio) for phi, (_, ratio) in found.items())


def _along_path(runs: Sequence[Mapping[str, Any]]) -> Figure:
    """Force over the exact one along the path, with the preset's settings, on the finest grid."""
    kinds = dict.fromkeys(run["kind"] for run in runs)
    most = {kind: max(r["across"] for r in runs if r["kind"] == kind) for kind in kinds}
    size = (0.6 + 4.6 * len(most), 6.4)
    figure, (panels,) = panels_of(1, len(most), size=size, sharey=True)
    for axes, (kind, cells) in zip(panels, most.items(), strict=True):
        shown = [run for run in runs if run["kind"] == kind and run["across"] == cells]
        for n, run in enumerate(shown):
            colour = (BLUE, ORANGE, GREEN, PURPLE)[n % 4]
            # Means over 2.5 % of the path: contact is noisy.
            place, ratio = (
                np.array(run[key])[: len(run[key]) // 5 * 5].reshape(-1, 5).mean(axis=1)
                for key in ("x", "y")
            )
            line = ("-", "--", ":")[n // 4 % 3]
            label = run["case"].replace(", associated", "")
            axes.plot(place, ratio, line, color=colour, lw=1.2, label=label)
        title = "passive wall" if kind == "wall" else f"strip footing, {kind}"
        _dress(axes, f"{title}, {cells} cells", "displacement / (size q_u/E)")
        axes.legend(fontsize=6, frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.2))
    panels[0].set_ylabel("force / exact limit load")
    return figure


def _dress(axes: Axes, title: str, label: str) -> None:
    axes.axhline(1.0, color=GREY, lw=1.0)
    axes.set_title(title, fontsize=8)
    axes.set_xlabel(label)
    axes.grid(lw=0.4)


ANGLES = (25.0, 30.0, 35.0, 40.0)
UNREST = 0.05
"""Change of the load over the last quarter of the path above which it is not told from swings."""
FIRST_UNIT = 1e-5
"""q_u/E in the first geometry [-]."""


def _run(scenario: Scenario, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Displacement over a length, and force (x, z) [N]."""
    history = simulate(scenario, progress=lambda _: heartbeat(0.0))
    return history.position / length, history.force


def _curve(place: np.ndarray, ratio: np.ndarray) -> dict[str, list[float]]:
    """Every second point: four digits are more than a figure shows."""
    every = slice(None, None, 2)
    return {
        "x": [float(f"{v:.4g}") for v in place[every]],
        "y": [float(f"{v:.4g}") for v in ratio[every]],
    }


def at_end(values: np.ndarray) -> float:
    """Mean over the last quarter of the path."""
    return float(values[-len(values) // 4 :].mean())


def unrest(values: np.ndarray) -> str:
    """A note where the load still moves while it is read, between means of a 20th of the path."""
    last = np.array_split(values[-len(values) // 4 :], 5)
    means = np.array([piece.mean() for piece in last])
    moves = float(np.ptp(means) / abs(means.mean()))
    if moves <= UNREST:
        return ""
    return f"the load still moves by {moves:.0%} where it is read, so that this mean is no plateau"


def push_wall(
    phi_deg: float,
    friction: float,
    across: int,
    flow: str = "associated",
    settings: str = NODES,
    floor: str = "rough",
    beneath: bool = False,
) -> Outcome:
    """Passive force of a wall in the first geometry; arguments as in :func:`wall_scenario`."""
    scenario = wall_scenario(
        phi_deg, friction, across, flow=flow, settings=settings, floor=floor, beneath=beneath
    )
    if beneath:
        place, force = push(scenario)
        place = place / WALL_HEIGHT
    else:
        place, force = _run(scenario, WALL_HEIGHT)
    pressure = -force[:, 0] / (0.5 * DENSITY * GRAVITY * WALL_HEIGHT**2)
    exact = passive_pressure(phi_deg, friction)
    expected, slack, source = exact, 0.05, passive_source(friction)
    if flow == "dilation":
        lowest = passive_pressure(davis(phi_deg), friction)
        # Anywhere from 5 % below Davis's value to 5 % above the exact one.
        expected = 0.5 * (0.95 * lowest + 1.05 * exact)
        slack = 1.05 * exact / expected - 1.0
        source = "between that at Davis's reduced angle and the exact one of associated flow, ±5 %"
    flows = "associated" if flow == "associated" else "ψ = 0"
    under = "soil beneath the toe" if beneath else f"{floor} floor"
    check = Check(
        problem="Passive wall",
        case=f"φ = {phi_deg:g}°, μ = {friction:g}, {flows}, {under}",
        settings=settings,
        quantity="K_p, first geometry",
        expected=expected,
        obtained=at_end(pressure),
        tolerance=slack,
        resolution=f"h/Δx = {across}",
        source=source,
        note=unrest(pressure),
        cause=_wall_cause(settings, floor),
        per_degree=per_degree(lambda phi: passive_pressure(phi, friction), phi_deg)
        if flow == "associated"
        else 0.0,
    )
    return Outcome([check], _curves("wall", check, across, expected, place / FIRST_UNIT, pressure))


def _wall_cause(settings: str, floor: str) -> str:
    if settings == PRESET:
        return (
            "one length by which contact ends before the toe serves all soils and plates: it is "
            "right for soil that keeps its volume, and a cell too much for a plate that hardly "
            "moves"
        )
    if floor == "rough":
        return (
            "at the toe the plate drives nodes that the rough floor holds; the excess falls with "
            "the width of the cells, and on a smooth floor most of it is gone"
        )
    return "slip is spread over some cells; what remains falls with their width"


def move_wall(phi_deg: float, across: int, settings: str = NODES) -> Outcome:
    """Mean passive force of a smooth wall that moves far, beside :func:`moved_pressure`."""
    scenario = wall_scenario(phi_deg, 0.0, across, settings=settings, drive=MOVED)
    place, force = _run(scenario, WALL_HEIGHT)
    pressure = -force[:, 0] / (0.5 * DENSITY * GRAVITY * WALL_HEIGHT**2)
    over = (place >= PLATEAU[0]) & (place <= PLATEAU[1])
    check = Check(
        problem="Passive wall that moves",
        case=f"φ = {phi_deg:g}°, μ = 0, associated, rough floor",
        settings=settings,
        quantity="K_p, mean over 0.02 to 0.1 h, with the toe's intake",
        expected=moved_pressure(phi_deg, 0.5 * sum(PLATEAU)),
        obtained=float(pressure[over].mean()),
        tolerance=0.05,
        resolution=f"h/Δx = {across}",
        source="tan²(45° + φ/2) (1 + 2 d/(h tan(45° + φ/2))): with the soil that the toe takes in",
        note="E = 5 MPa as for the leg, particles within the middle half of their sub-cells",
        cause="at the toe, as in the first geometry",
        per_degree=per_degree(lambda phi: moved_pressure(phi, 0.5 * sum(PLATEAU)), phi_deg),
    )
    curve = np.array([moved_pressure(phi_deg, d) for d in place])
    return Outcome([check], _curves("moved", check, across, curve, place, pressure))


def press_footing(
    phi_deg: float, base: str, across: int, load: str, settings: str = NODES
) -> Outcome:
    """Bearing capacity in the first geometry; arguments as in :func:`footing_scenario`."""
    scenario = footing_scenario(phi_deg, base, across, load=load, settings=settings)
    place, force = _run(scenario, FOOTING_WIDTH)
    pressure, note = force[:, 1] / (FOOTING_WIDTH / 2), ""
    if load == "weight":
        exact, name = N_GAMMA[phi_deg, base], "N_γ"
        factor = pressure / (0.5 * DENSITY * GRAVITY * FOOTING_WIDTH)
        source = "method of characteristics"
    else:
        exact, name = surcharge_factor(phi_deg), "N_q"
        own = 0.0
        source = "N_q = e^(π tan φ) tan²(45° + φ/2), through N_c"
        if load == "dead weight":
            own = 0.5 * N_GAMMA[phi_deg, base] / HEAVY
            source = "N_q = e^(π tan φ) tan²(45° + φ/2)"
            note = (
                f"`bed.surcharge` = {HEAVY:g} γB; what γB N_γ/2 adds, {100 * own / exact:.1f} %, "
                "is taken off"
            )
        factor = pressure / CONFINEMENT + 1.0 - own
    check = Check(
        problem="Strip footing",
        case=f"{name}{'' if load == 'weight' else f' by {load}'}, φ = {phi_deg:g}°, {base}, "
        "associated",
        settings=settings,
        quantity=f"{name}, first geometry",
        expected=exact,
        obtained=at_end(factor),
        tolerance=0.05 if settings == PRESET else 0.10,
        resolution=f"B/Δx = {across}",
        source=source,
        note="; ".join(filter(None, (note, unrest(factor)))),
        cause=footing_cause(load, settings),
        per_degree=n_gamma_per_degree(phi_deg, base)
        if load == "weight"
        else per_degree(surcharge_factor, phi_deg),
    )
    return Outcome([check], _curves(name, check, across, exact, place / FIRST_UNIT, factor))


def footing_cause(load: str, settings: str) -> str:
    """Why the load of a footing misses the exact one."""
    if settings == PRESET:
        return (
            "the transfer smooths the velocities beside the footing's edge, against which contact "
            "that ends 1.7 cells before the edge takes off too much on few cells"
        )
    if load == "weight":
        return (
            "a transfer at every step smooths the velocities beside the footing's edge, and least "
            "squares their gradients"
        )
    return "beside the footing's edge all shear is in one or two cells; the error falls with them"


def _curves(
    kind: str, check: Check, across: int, expected: Any, place: np.ndarray, found: np.ndarray
) -> dict[str, Any]:
    """What the figure needs of a run: the force over that which is expected along its path."""
    last = check.obtained / check.expected
    about = {"kind": kind, "case": check.case, "settings": check.settings, "across": across}
    about["last"] = last
    return about | _curve(place, found / expected)


def _name(kind: str, run: Mapping[str, Any]) -> str:
    """Name of a task: what it is called with, in one word."""
    words = (
        key if value is True else f"{value:g}" if isinstance(value, float | int) else str(value)
        for key, value in run.items()
    )
    return "-".join((kind, *words)).replace(", ", "-").replace(" ", "-").replace(".", "_")


def _cost(run: Mapping[str, Any]) -> float:
    """Rough time on one core [s]."""
    often = 5.0 if run.get("load") == "dead weight" else 1.0
    wide = {25.0: 1.0, 30.0: 1.8, 35.0: 1.8, 40.0: 3.5}[run["phi_deg"]] if "load" in run else 1.2
    return float(often * wide * 12.0 * (run["across"] / 40) ** 3)


def _walls() -> list[dict[str, Any]]:
    """What to call :func:`push_wall` with: the preset's settings first, on each problem."""
    # What lies beneath the toe so that the exact force is that of this problem.
    grounds: dict[float, dict[str, Any]] = {
        0.0: {"floor": "smooth"},
        0.35: {"beneath": True},
        0.5: {"beneath": True},
    }
    runs: list[dict[str, Any]] = [
        {"phi_deg": phi, "friction": mu, "across": n, "settings": settings, **grounds[mu]}
        for settings, mu, phi, n in itertools.product((PRESET, NODES), grounds, ANGLES, (20, 30))
    ]
    runs += [
        {"phi_deg": phi, "friction": mu, "across": n}
        for phi, mu, n in itertools.product((25.0, 35.0), (0.0, 0.35), (10, 20, 40))
    ]
    runs += [
        {"phi_deg": phi, "friction": 0.0, "across": n, "flow": "dilation"}
        for phi, n in itertools.product((25.0, 35.0), (20, 40))
    ]
    runs += [
        {"phi_deg": phi, "friction": mu, "across": n, "flow": "dilation", "settings": PRESET,
         **grounds[mu]}
        for mu, phi, n in itertools.product(grounds, (25.0, 35.0), (20, 30))
    ]  # fmt: skip
    return runs


def _feet() -> list[dict[str, Any]]:
    """What to call :func:`press_footing` with: the preset's settings first, on each problem."""
    smooth = {"base": "smooth"}
    runs: list[dict[str, Any]] = [
        {"phi_deg": phi, "base": base, "across": n, "load": "weight", "settings": PRESET}
        for base, phi, n in itertools.product(("smooth", "rough"), ANGLES, (20, 30))
    ]
    runs += [
        {"phi_deg": phi, "across": n, "load": "cohesion", "settings": settings, **smooth}
        for settings, phi, n in itertools.product((PRESET, NODES), ANGLES, (20, 30))
    ]
    runs += [
        {"phi_deg": phi, "base": base, "across": 10, "load": "cohesion"}
        for phi, base in itertools.product((25.0, 35.0), ("smooth", "rough"))
    ]
    runs += [
        {"phi_deg": phi, "base": "rough", "across": n, "load": "cohesion"}
        for phi, n in itertools.product((25.0, 35.0), (20, 40))
    ]
    runs += [
        {"phi_deg": phi, "across": n, "load": "dead weight", **smooth}
        for phi, n in ((25.0, 10), (25.0, 20), (25.0, 40), (35.0, 20))
    ]
    return [*runs, {"phi_deg": 25.0, "across": 40, "load": "weight", **smooth}]


WALL = {"phi_deg": 35.0, "friction": 0.0, "across": 20}
FOOT = {"phi_deg": 25.0, "base": "smooth", "across": 10}
OF_PRESET = {"settings": PRESET}
MOVING = [
    {"phi_deg": phi, "across": 40, "settings": settings}
    for settings, phi in itertools.product((PRESET, NODES), (25.0, 35.0))
]
FAMILY = Family(
    title="Limit loads",
    meaning="A plate that moves the soil must meet the force that plasticity theory says, or φ "
    "inferred from forces means something else. Column `preset` has the settings of preset "
    "`resolved-2`: contact on the surface that ends 1.7 cells before the tip, phases of 20 steps, "
    "and strains of whole cells where the soil dilates. Column `nodes` has contact with the nodes "
    "within half a cell, a transfer at every step and the strains of each particle. Soil lies "
    "beneath the toe of a rough wall; the floor is 1/3 of its height down.",
    full=[
        *(Task(_name("wall", run), push_wall, run, _cost(run)) for run in _walls()),
        *(Task(_name("moved", run), move_wall, run, 3 * _cost(run)) for run in MOVING),
        *(Task(_name("footing", run), press_footing, run, _cost(run)) for run in _feet()),
    ],
    quick=[
        Task("wall-preset", push_wall, {**WALL, **OF_PRESET, "across": 10, "floor": "smooth"}),
        Task("wall-0", push_wall, WALL),
        Task("footing-0", press_footing, {**FOOT, "load": "cohesion"}),
        Task(
            "footing-preset", press_footing, {**FOOT, **OF_PRESET, "load": "weight", "across": 20}
        ),
    ],
    figures=figures,
)
