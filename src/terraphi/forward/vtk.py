"""Particles and leg as two series of VTK files, which ParaView opens.

XML files of the kind ``UnstructuredGrid``, with their numbers in base64, and ``Collection`` files
that give each frame its time (https://docs.vtk.org, "XML file formats").
"""

from __future__ import annotations

import base64
import sys
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
    """Observer that writes ``particles.pvd`` and ``leg.pvd`` with their frames into a folder.

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
        about = {"TimeValue": np.array([snapshot.time]), "theta_deg": np.degrees(pose.theta)}
        points, data = snapshot.solver.fields(snapshot.soil)
        outline = np.insert(pose.placed(snapshot.scenario.leg.outline())[0], 1, 0.0, axis=1)
        write_grid(self._folder / _frame("particles", number), points, VERTEX, data, about)
        write_grid(self._folder / _frame("leg", number), outline, POLYGON, {}, about)
        time_step = snapshot.scenario.numerics.time_step
        for name in ("particles", "leg"):
            sets = "".join(
                f'<DataSet timestep="{step * time_step!r}" part="0" file="{_frame(name, k)}"/>'
                for k, step in enumerate(self._steps[: number + 1])
                if (self._folder / _frame(name, k)).exists()
            )
            _write(self._folder / f"{name}.pvd", "Collection", sets)


def write_grid(
    path: Path, points: Array, kind: int, data: Mapping[str, Array], about: Mapping[str, Array]
) -> None:
    """Write points, each a cell of its own (``VERTEX``) or corners of one (``POLYGON``).

    Parameters
    ----------
    path
        The file, ``.vtu``.
    points
        (x, y, z) [m], shape [point, 3].
    kind
        Kind of the cells.
    data
        Scalars of shape [point] and vectors of shape [point, 3], by name.
    about
        Values for the whole file, shape [value], by name; ``TimeValue`` is its time [s].
    """
    count = len(points)
    ends = np.arange(1, count + 1) if kind == VERTEX else np.array([count])
    cells = {
        "connectivity": np.arange(count),
        "offsets": ends,
        "types": np.full(len(ends), kind, np.uint8),
    }
    fields = "".join(_array(k, v, f' NumberOfTuples="{len(v)}"') for k, v in about.items())
    _write(
        path,
        "UnstructuredGrid",
        f"<FieldData>{fields}</FieldData>"
        f'<Piece NumberOfPoints="{count}" NumberOfCells="{len(ends)}">'
        f"<Points>{_array('points', points)}</Points>"
        f"<Cells>{''.join(_array(k, v) for k, v in cells.items())}</Cells>"
        f"<PointData>{''.join(_array(k, v) for k, v in data.items())}</PointData></Piece>",
    )


def _frame(name: str, number: int) -> str:
    return f"{name}_{number:04d}.vtu"


def _array(name: str, values: Array, more: str = "") -> str:
    """An array: its number of bytes and its bytes, in one run of base64."""
    values = np.ascontiguousarray(values)
    kind = values.dtype.name.capitalize().replace("Ui", "UI")
    if values.ndim == 2:
        more += f' NumberOfComponents="{values.shape[1]}"'
    content = np.uint64(values.nbytes).tobytes() + values.tobytes()
    text = base64.b64encode(content).decode("ascii")
    return f'<DataArray type="{kind}" Name="{name}" format="binary"{more}>{text}</DataArray>'


def _write(path: Path, kind: str, content: str) -> None:
    order = f"{sys.byteorder.capitalize()}Endian"
    with atomic_write(path) as temporary:
        temporary.write_text(
            f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="1.0" byte_order="{order}" '
            f'header_type="UInt64"><{kind}>{content}</{kind}></VTKFile>\n'
        )
