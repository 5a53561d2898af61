"""Particles and leg as two series of VTK files, which ParaView opens."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.files import made_folder
from terraphi.experiment.leg import frame_axes
from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import block_length, step_count
from terraphi.forward.plane.bed import Particles
from terraphi.forward.vtk import Data, write_points, write_polygon, write_series
from terraphi.forward.watch import Snapshot

FloatArray = NDArray[np.float64]

PARTICLES, LEG = "particles", "leg"
"""Names of the two series: ``particles.pvd``, ``leg.pvd`` and their frames."""


class FieldSeries:
    """Observer that writes ``particles.pvd`` and ``leg.pvd`` with their frames into a folder.

    Coordinates are those of the physics: x forward, z up, y = 0 (look along +y). SI units; times
    and velocities are those of the simulation, in which the leg is sped up. Frames are taken at
    the ends of blocks of steps, evenly spread, the first and the last step among them. A simulation
    that goes on from a checkpoint goes on with its frames; files of these names are overwritten.

    Parameters
    ----------
    folder
        Made if it is not there.
    scenario
        What is simulated.
    frames
        Number of frames, fewer if there are fewer blocks of steps.

    Raises
    ------
    InputError
        If the folder cannot be made; when called, if a file cannot be written.
    """

    def __init__(self, folder: Path, scenario: Scenario, *, frames: int) -> None:
        self._folder = made_folder(folder)
        steps = step_count(scenario)
        ends = [*range(0, steps, block_length(scenario)), steps]
        chosen = np.linspace(0, len(ends) - 1, min(frames, len(ends))).round().astype(int)
        self._times = {ends[i]: ends[i] * scenario.numerics.time_step for i in chosen}

    def __call__(self, seen: Snapshot) -> None:
        """Write a frame if it is time for one; ``seen`` is the state after a block of steps."""
        if seen.step not in self._times:
            return
        series: dict[str, list[tuple[float, str]]] = {PARTICLES: [], LEG: []}
        for number, (step, time) in enumerate(self._times.items()):
            for name, frames in series.items():
                file = f"{name}_{number:04d}.vtu"
                if step == seen.step:
                    self._write(name, file, seen)
                # Frames of before a checkpoint are there, unless it was made without them.
                if step <= seen.step and (self._folder / file).exists():
                    frames.append((time, file))
        for name, frames in series.items():
            write_series(self._folder / f"{name}.pvd", frames)

    def _write(self, name: str, file: str, seen: Snapshot) -> None:
        about = {"TimeValue": np.array([seen.time]), "theta_deg": np.degrees(seen.pose.theta)}
        if name == LEG:
            write_polygon(self._folder / file, leg_outline(seen), field_data=about)
            return
        soil: Any = seen.soil
        if seen.scenario.dimensions == 2:
            points, data = particle_fields(soil)
        else:
            from terraphi.forward.mpm import fields

            points, data = fields.particle_fields(seen.scenario, soil)
        write_points(self._folder / file, points, point_data=data, field_data=about)


def particle_fields(soil: Particles) -> tuple[NDArray[np.float32], Data]:
    """Positions (x, 0, z) [m], shape [particle, 3], and fields of the particles.

    Fields are ``velocity``, ``speed`` [m/s], ``displacement`` [m], ``stress_xx`` and so on,
    ``pressure`` -(σ_xx + σ_zz)/2 and ``mohr_radius`` √((σ_xx - σ_zz)²/4 + σ_xz²) [Pa], ``weight`` q
    [-], and ``particle``, its index.
    """
    sxx, szz, sxz, syy = soil.stress.T
    fields = {
        "velocity": _with_y(soil.velocity),
        "speed": np.hypot(*soil.velocity.T),
        "displacement": _with_y(soil.position - soil.start),
        "pressure": -0.5 * (sxx + szz),
        "mohr_radius": np.hypot(0.5 * (sxx - szz), sxz),
        "stress_xx": sxx,
        "stress_zz": szz,
        "stress_xz": sxz,
        "stress_yy": syy,
        "weight": soil.weight,
    }
    data: dict[str, Any] = {name: values.astype(np.float32) for name, values in fields.items()}
    data["particle"] = np.arange(len(soil.mass))
    return _with_y(soil.position).astype(np.float32), data


def leg_outline(seen: Snapshot) -> FloatArray:
    """Corners of the leg's outline where it is now, (x, 0, z) [m], shape [corner, 3]."""
    along, motion = frame_axes(seen.pose.theta[0])
    s, m = seen.scenario.leg.outline().T
    return _with_y(seen.pose.hip[0] + s[:, None] * along + m[:, None] * motion)


def _with_y(flat: FloatArray) -> FloatArray:
    """(x, z) as (x, 0, z)."""
    return np.insert(flat, 1, 0.0, axis=1)
