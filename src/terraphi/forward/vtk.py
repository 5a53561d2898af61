"""Particles and leg as two series of VTK files, which ParaView and PyVista open.

Binary files of the legacy kind, and for each series a table in JSON that gives its frames their
times (https://docs.vtk.org, "VTK file formats"; ParaView's ``.vtk.series``).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.files import atomic_write, made_folder
from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import Snapshot, block_length
from terraphi.forward.forecast import step_count

Array = NDArray[Any]

VERTEX, POLYGON = 1, 7
"""Kinds of cells."""


class FieldSeries:
    """Observer that writes ``particles.vtk.series`` and ``leg.vtk.series`` with their frames.

    Coordinates are those of the physics: x forward, z up, in two dimensions y = 0. SI units; times,
    velocities and speeds are those of the simulation, in which the leg is sped up. A simulation
    that goes on from a checkpoint goes on with its frames.

    Parameters
    ----------
    folder
        Where to; made if it is not there. Files of these names are overwritten.
    scenario
        What is simulated.
    frames
        Number of frames, fewer if there are fewer blocks of steps.
    """

    def __init__(self, folder: Path, scenario: Scenario, *, frames: int) -> None:
        self._folder = made_folder(folder)
        steps = step_count(scenario)
        ends = [*range(0, steps, block_length(scenario)), steps]
        chosen = np.linspace(0, len(ends) - 1, min(frames, len(ends))).round().astype(int)
        self._steps = [ends[i] for i in chosen]

    def __call__(self, snapshot: Snapshot) -> None:
        """Write a frame if it is time for one; raises InputError if the disk is full."""
        if snapshot.step not in self._steps:
            return
        number, pose = self._steps.index(snapshot.step), snapshot.pose
        points, data = snapshot.solver.fields(snapshot.soil)
        outline = np.insert(pose.placed(snapshot.scenario.leg.outline())[0], 1, 0.0, axis=1)
        time_step = snapshot.scenario.numerics.time_step
        for name, *grid in (("particles", points, data), ("leg", outline, {})):
            title = f"terraphi: {name}, leg angle {np.degrees(pose.theta[0]):.6g} deg"
            write_grid(self._folder / _frame(name, number), title, *grid, cell=name == "leg")
            frames = [
                {"name": _frame(name, k), "time": step * time_step}
                for k, step in enumerate(self._steps[: number + 1])
                if (self._folder / _frame(name, k)).exists()
            ]
            with atomic_write(self._folder / f"{name}.vtk.series") as temporary:
                series = {"file-series-version": "1.0", "files": frames}
                temporary.write_text(json.dumps(series, indent=1))


def _frame(name: str, number: int) -> str:
    return f"{name}_{number:04d}.vtk"


def write_grid(
    path: Path, title: str, points: Array, data: Mapping[str, Array], *, cell: bool = False
) -> None:
    """Write points, each by itself or all as the corners of one ``cell``, in single precision.

    Parameters
    ----------
    path
        The file, ``.vtk``.
    title
        Its second line.
    points
        (x, y, z) [m], shape [point, 3].
    data
        Scalars of shape [point] and vectors of shape [point, 3], by name.
    cell
        True if the points are corners of a polygon.
    """
    count = len(points)
    # A row for each cell: how many points it has, and which.
    rows = np.arange(count)[None] if cell else np.arange(count)[:, None]
    cells = np.insert(rows, 0, rows.shape[1], axis=1)
    with atomic_write(path) as temporary, temporary.open("wb") as stream:

        def write(head: str, values: Array, kind: str = ">f4") -> None:
            stream.write(f"{head}\n".encode() + values.astype(kind).tobytes() + b"\n")

        stream.write(
            f"# vtk DataFile Version 3.0\n{title}\nBINARY\nDATASET UNSTRUCTURED_GRID\n".encode()
        )
        write(f"POINTS {count} float", points)
        write(f"CELLS {len(cells)} {cells.size}", cells, ">i4")
        write(f"CELL_TYPES {len(cells)}", np.full(len(cells), POLYGON if cell else VERTEX), ">i4")
        stream.write(f"POINT_DATA {count}\nFIELD fields {len(data)}\n".encode())
        for name, values in data.items():
            write(f"{name} {values.size // count} {count} float", values)
