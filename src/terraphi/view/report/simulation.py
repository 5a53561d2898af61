"""The report of a simulation: its particles in motion, and the forces beside them.

Of the particles that ``terraphi simulate --fields`` wrote, about a hundred thousand positions in
all are kept, with two bytes a coordinate and one byte a speed, which is as fine as a screen shows.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.forward.plane.fields import LEG, PARTICLES
from terraphi.forward.vtk import Grid, read_points, read_series
from terraphi.view.plots import scenario_name, shown_position
from terraphi.view.report import parts as fig
from terraphi.view.report.parts import Part, Player, Plot, Section, number
from terraphi.view.table import Table

MOST_PLACES = 220_000
"""Particles times frames in a page, five bytes each before they are written in base64."""
MOST_FRAMES = 60
ROOM_ABOVE = 0.02
"""Free room above leg and soil in the picture [m]."""
SEED = 0
"""Of the choice of particles."""
COORDINATES = {"theta": fig.THETA, "displacement": "displacement [mm]", "time": "time [ms]"}


class Frame(NamedTuple):
    """The particles and the leg at one time."""

    at: float
    """θ [deg], or displacement [mm]."""
    soil: Grid
    leg: FloatArray
    """Corners (x, z) [m], shape [corner, 2]."""


def section(history_file: Path, *, fields: Path | None, share: float = 1.0) -> Section:
    """Report of a simulation.

    Parameters
    ----------
    history_file
        NetCDF of ``terraphi simulate --out``.
    fields
        Folder of ``--fields``; ``None`` leaves out the animation.
    share
        Part of the places that this one may take, if there are several in a page [-].

    Raises
    ------
    InputError
        If a file is not whole, or history and fields are not of one scenario.
    """
    history = ForceHistory.from_netcdf(history_file)
    known = history.provenance
    scenario = Scenario.model_validate(known["scenario"]) if "scenario" in known else None
    curves = _curves(history)
    parts: list[Part] = list(curves)
    if fields is not None:
        if scenario is None:
            raise InputError(f"{history_file}: names no scenario; simulate it again with --out")
        parts = [_player(fields, scenario, curves, share)]
    parts.append(_peaks(history))
    about = {key: value for key, value in known.items() if key != "scenario"}
    return Section(
        kind="simulation",
        title=scenario_name(scenario) if scenario else str(known.get("file", history_file.name)),
        headline=_headline(history),
        parts=parts,
        provenance={
            "result": history_file.name, **about, "scenario": known.get("scenario", {}),
        },
    )  # fmt: skip


def _headline(history: ForceHistory) -> str:
    summary = history.summary()

    def peaks_of(key: str) -> str:
        return ", ".join(f"{summary[f'{key}_F{axis}_N']:.1f} N (F{axis})" for axis in history.axes)

    said = f"Peak forces: {peaks_of('peak')}."
    if "theta_peak_Fz_deg" in summary:
        said = (
            f"Peak lift {summary['peak_Fz_N']:.1f} N at θ = {summary['theta_peak_Fz_deg']:.0f}°, "
            f"peak thrust {summary['peak_Fx_N']:.1f} N at θ = {summary['theta_peak_Fx_deg']:.0f}°."
        )
    if history.applied() is not None:
        said += f" These are counted; applied to the soil were {peaks_of('applied_peak')} at most."
    return said


def _peaks(history: ForceHistory) -> Table:
    rows = [(name, number(value)) for name, value in history.summary().items()]
    return Table("In numbers", ("", ""), rows, folded=True, wide=True)


# -- forces --------------------------------------------------------------------------------------


def _curves(history: ForceHistory) -> list[Plot]:
    """Both forces, averaged over half a degree or the like, with a mark to be moved."""
    angular = history.coordinate == "theta"
    where = COORDINATES[history.coordinate]
    start, stop = float(history.position[0]), float(history.position[-1])
    place = np.linspace(start, stop, min(len(history.position), 500))
    half = (stop - start) / 360.0
    force = history.means(place, half)
    x = shown_position(place, history.coordinate)
    looks = {"Fx": "@orange", "Fz": "@blue"}
    return [
        Plot(
            title=f"{name} on the leg",
            traces=[
                {
                    **fig.line(x, force[:, history.axes.index(name[1])], name, colour),
                    "hovertemplate": "%{x:.0f}: %{y:.2f} N<extra></extra>",
                }
            ],
            layout=fig.layout(
                where,
                fig.AXIS_LABEL[name],
                showlegend=False,
                shapes=[fig.vertical(float(x[0]), "@ink", dash="solid")],
                xaxis={"range": fig.numbers(x[[0, -1]]), **({"dtick": 45} if angular else {})},
            ),
            height=235,
        )
        for name, colour in looks.items()
    ]


# -- particles -----------------------------------------------------------------------------------


def _player(fields: Path, scenario: Scenario, curves: list[Plot], share: float) -> Player:
    frames = _frames(fields, scenario)
    total = len(frames[0].soil.points)
    most = max(int(share * MOST_PLACES / len(frames)), 200)
    chosen = np.arange(total)
    if total > most:
        chosen = np.sort(np.random.default_rng(SEED).choice(total, most, replace=False))
    top = _ceiling(frames, scenario)
    size = np.array([scenario.numerics.domain, top])
    fastest = scenario.motion.top_speed(scenario.leg.reach())
    positions, speeds = [], []
    for frame in frames:
        places = frame.soil.points[chosen][:, [0, 2]] / size
        positions.append(np.round(65535.0 * np.clip(places, 0.0, 1.0)).astype("<u2"))
        speed = frame.soil.point_data["speed"][chosen] / scenario.numerics.speed_up / fastest
        speeds.append(np.round(255.0 * np.clip(speed, 0.0, 1.0)).astype(np.uint8))
    spacing = scenario.numerics.cell_size / scenario.numerics.particles_per_cell_side
    angular = scenario.motion.coordinate == "theta"
    tip = f"leg's tip: {1e3 * fastest:.3g} mm/s"
    return Player(
        title="The soil, coloured by its speed",
        data={
            "theta_deg": fig.numbers([frame.at for frame in frames]),
            "symbol": "θ" if angular else "x",
            "unit": "°" if angular else " mm",
            "first": _first(frames),
            "particles": len(chosen),
            "size_mm": fig.numbers(1e3 * size),
            "bed_mm": _bed(scenario),
            # Thinned particles are drawn larger, so that they still cover the bed.
            "marker_mm": fig.numbers([1.7e3 * spacing * math.sqrt(total / len(chosen))])[0],
            "fastest_mm_s": f"{1e3 * fastest:.3g}",
            "leg_mm": [[fig.numbers(corner) for corner in 1e3 * frame.leg] for frame in frames],
            "positions": _base64(np.stack(positions)),
            "speeds": _base64(np.stack(speeds)),
        },
        curves=curves,
        note=(
            f"{len(chosen)} of {total} particles, {len(frames)} frames; speeds as if the leg moved "
            f"as slowly as it is meant to ({tip})."
        ),
    )


def _first(frames: list[Frame]) -> int:
    """The frame shown first and in print: the one in which most soil moves."""
    return int(np.argmax([float(frame.soil.point_data["speed"].mean()) for frame in frames]))


def _frames(fields: Path, scenario: Scenario) -> list[Frame]:
    """Choose frames at even distances; raises InputError if the fields are of another scenario."""
    particles, _ = read_series(fields / f"{PARTICLES}.pvd")
    legs = {number_of(name): name for _, name in read_series(fields / f"{LEG}.pvd")[0]}
    if scenario.hash != scenario_of(fields):
        raise InputError(f"{fields}: the fields are of another simulation than the history")
    if not particles:
        raise InputError(f"{fields}: holds no frames; simulate it again with --fields")
    count = min(len(particles), MOST_FRAMES)
    picked = np.linspace(0, len(particles) - 1, count).round().astype(int)
    found = []
    for _, name in (particles[i] for i in picked):
        # A file names its neighbours, and nothing beyond its folder.
        soil = read_points(fields / Path(name).name)
        leg = read_points(fields / Path(legs.get(number_of(name), "missing")).name)
        try:
            place = float(soil.field_data["theta_deg"][0])
            time = np.array([float(soil.field_data["TimeValue"][0])])
        except (KeyError, IndexError) as error:
            raise InputError(f"{fields / name}: holds no angle; simulate it again") from error
        if scenario.motion.coordinate != "theta":
            slow = time * scenario.numerics.speed_up
            place = 1e3 * float(scenario.motion.coordinates(slow)[0])
        found.append(Frame(place, soil, leg.points[:, [0, 2]].astype(np.float64)))
    if len({len(frame.soil.points) for frame in found}) != 1:
        raise InputError(
            f"{fields}: its frames have different numbers of particles; simulate it again"
        )
    return found


def scenario_of(fields: Path) -> str:
    """Scenario hash stored in a folder of fields; empty if there is none."""
    _, note = read_series(fields / f"{PARTICLES}.pvd")
    words = note.replace(",", " ").split()
    return words[words.index("scenario") + 1] if "scenario" in words[:-1] else ""


def number_of(name: str) -> str:
    """Number of a frame in its file's name."""
    return Path(name).stem.rpartition("_")[2]


def _ceiling(frames: list[Frame], scenario: Scenario) -> float:
    highest = max(float(frame.leg[:, 1].max()) for frame in frames)
    return min(max(highest, scenario.bed.surface) + ROOM_ABOVE, scenario.numerics.domain)


def _bed(scenario: Scenario) -> Mapping[str, Any]:
    bed = scenario.bed
    ends = {
        "left": bed.left, "right": bed.left + bed.width, "floor": bed.floor, "surface": bed.surface,
    }  # fmt: skip
    return {name: fig.numbers([1e3 * value])[0] for name, value in ends.items()}


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
