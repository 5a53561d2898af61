"""Particles and leg as two series of VTK files, frame by frame while a simulation runs."""

from __future__ import annotations

import contextlib
import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import made_folder
from terraphi.experiment.leg import frame_axes
from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import BLOCK, block_length, step_count
from terraphi.forward.plane.bed import Particles
from terraphi.forward.vtk import Data, read_series, write_points, write_polygon, write_series
from terraphi.forward.watch import Snapshot

FloatArray = NDArray[np.float64]
log = logging.getLogger(__name__)

NOTE = "scenario "
"""How the note begins that marks a series as written here."""
FRAME = "_[0-9][0-9][0-9][0-9].vtu"
"""How the name of a frame ends."""
PARTICLES, LEG = "particles", "leg"
"""Names of the two series: ``particles.pvd``, ``leg.pvd`` and their frames."""


class FieldSeries:
    """Observer that writes ``particles.pvd`` and ``leg.pvd``, which ParaView opens, into a folder.

    Coordinates are those of the physics: x forward, z up, y = 0 (look along +y). SI units; times,
    velocities and speeds are those of the simulation, in which the leg is sped up. A simulation
    that goes on from a checkpoint goes on with its frames.

    Parameters
    ----------
    folder
        Where to; made if it is not there.
    scenario
        What is simulated.
    frames
        Number of frames, fewer if there are fewer blocks of steps.

    Raises
    ------
    InputError
        If the folder cannot be made, or files of these names are there and not ours.
    """

    def __init__(self, folder: Path, scenario: Scenario, *, frames: int) -> None:
        self._folder = made_folder(folder)
        self._steps = frame_steps(step_count(scenario), frames, block=block_length(scenario))
        self._note = f"{NOTE}{scenario.hash}, frame of each step {self._steps}"
        self._known: dict[int, float] | None = None
        self._check_what_is_there()

    def _check_what_is_there(self) -> None:
        """Raise InputError if the folder has files of these names that were not written here."""
        note = ""
        with contextlib.suppress(InputError):  # no series yet, or somebody else's
            note = read_series(self.particles)[1]
        if note.startswith(NOTE):
            return
        patterns = [f"{name}{end}" for name in (PARTICLES, LEG) for end in (FRAME, ".pvd")]
        for file in (file for pattern in patterns for file in self._folder.glob(pattern)):
            raise InputError(
                f"{file}: is there, and of no series that terraphi wrote; name another folder, or "
                "move it away"
            )

    @property
    def particles(self) -> Path:
        """File of the particles' series."""
        return self._folder / f"{PARTICLES}.pvd"

    def __call__(self, seen: Snapshot) -> None:
        """Write a frame if it is time for one.

        Parameters
        ----------
        seen
            The state after a block of steps.

        Raises
        ------
        InputError
            If the disk is full.
        """
        if self._known is None:
            self._known = self._frames_before(seen.step)
            self._list_frames()  # whenever we are killed, what lies here is known to be ours
        if seen.step not in self._steps:
            return
        number = self._steps.index(seen.step)
        pose = seen.pose
        about = {"TimeValue": np.array([seen.time]), "theta_deg": np.degrees(pose.theta)}
        points, data = _fields_of(seen)
        write_points(self._frame(PARTICLES, number), points, point_data=data, field_data=about)
        write_polygon(self._frame(LEG, number), leg_outline(seen), field_data=about)
        self._known[number] = seen.time
        self._list_frames()

    def _list_frames(self) -> None:
        """Write both .pvd files with the frames so far.

        That of the particles comes first: its note tells a later run that the files are ours.
        """
        known = sorted((self._known or {}).items())
        for name in (PARTICLES, LEG):
            frames = [(time, self._frame(name, k).name) for k, time in known]
            write_series(self._folder / f"{name}.pvd", frames, note=self._note)

    def _frame(self, name: str, number: int) -> Path:
        return self._folder / f"{name}_{number:04d}.vtu"

    def _frames_before(self, step: int) -> dict[int, float]:
        """Frames that this simulation wrote before it was stopped: from number to time [s]."""
        frames: list[tuple[float, str]] = []
        note = ""
        with contextlib.suppress(InputError):  # no series yet, or somebody else's
            frames, note = read_series(self.particles)
        for name in (PARTICLES, LEG):  # of a process that was killed
            for begin in (f".{name}{FRAME}.", f".{name}.pvd."):
                for file in self._folder.glob(f"{begin}*"):
                    file.unlink(missing_ok=True)
        wanted = {k: before for k, before in enumerate(self._steps) if before < step}
        there = {name: time for time, name in frames} if note == self._note else {}
        names = {k: self._frame(PARTICLES, k).name for k in wanted}
        known = {k: there[name] for k, name in names.items() if name in there}
        self._clear({self._frame(name, k).name for name in (PARTICLES, LEG) for k in known})
        if len(known) < len(wanted):
            log.warning(
                "%s: %d frames before step %d are missing, as the simulation goes on from a "
                "checkpoint that was made without them; remove the checkpoint to have them all",
                self._folder,
                len(wanted) - len(known),
                step,
            )
        return known

    def remove(self) -> None:
        """Remove the series, and the folder if nothing else is in it."""
        self._clear(set())
        for name in (LEG, PARTICLES):  # that which tells that all is ours goes last
            (self._folder / f"{name}.pvd").unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # somebody keeps something else there
            self._folder.rmdir()

    def _clear(self, kept: set[str]) -> None:
        """Remove all frames but those named, so that none of another run is left."""
        for name in (PARTICLES, LEG):
            for file in self._folder.glob(f"{name}{FRAME}"):
                if file.name not in kept:
                    file.unlink(missing_ok=True)


def frame_steps(steps: int, frames: int, *, block: int = BLOCK) -> list[int]:
    """Steps at which frames are taken: the ends of blocks, evenly spread.

    Parameters
    ----------
    steps
        Number of steps in all.
    frames
        Number of frames wanted, the first and the last among them.
    block
        Steps between two blocks' ends.

    Returns
    -------
    list
        Increasing; fewer than wanted if there are fewer blocks.
    """
    ends = [*range(0, steps, block), steps]
    chosen = np.linspace(0, len(ends) - 1, min(frames, len(ends))).round().astype(int)
    return [ends[i] for i in chosen]


def _fields_of(seen: Snapshot) -> tuple[NDArray[np.float32], Data]:
    """Places and fields of the particles, in the plane or in space."""
    soil: Any = seen.soil
    if seen.scenario.dimensions == 2:
        return particle_fields(soil)
    from terraphi.forward.mpm import fields

    return fields.particle_fields(seen.scenario, soil)


def particle_fields(soil: Particles) -> tuple[NDArray[np.float32], Data]:
    """Places and fields of the particles as VTK takes them.

    Parameters
    ----------
    soil
        The particles.

    Returns
    -------
    points
        (x, 0, z) [m], shape [particle, 3].
    data
        ``velocity``, ``speed`` [m/s], ``displacement`` [m], ``stress_xx`` and so on, ``pressure``
        -(σ_xx + σ_zz)/2 and ``mohr_radius`` √((σ_xx - σ_zz)²/4 + σ_xz²), both in the plane [Pa],
        ``weight`` q, ``volume_ratio`` J [-], and ``particle``, its index.
    """
    sxx, szz, sxz, syy = soil.stress.T
    fields = {
        "velocity": _in_space(soil.velocity),
        "speed": np.hypot(*soil.velocity.T),
        "displacement": _in_space(soil.position - soil.start),
        "pressure": -0.5 * (sxx + szz),
        "mohr_radius": np.hypot(0.5 * (sxx - szz), sxz),
        "stress_xx": sxx,
        "stress_zz": szz,
        "stress_xz": sxz,
        "stress_yy": syy,
        "weight": soil.weight,
        "volume_ratio": soil.stretch,
    }
    data: dict[str, NDArray[np.float32] | NDArray[np.int64]] = {
        name: values.astype(np.float32) for name, values in fields.items()
    }
    data["particle"] = np.arange(len(soil.mass))
    return _in_space(soil.position).astype(np.float32), data


def leg_outline(seen: Snapshot) -> FloatArray:
    """Corners of the leg's outline where it is now, (x, 0, z) [m], shape [corner, 3]."""
    pose = seen.pose
    along, motion = frame_axes(pose.theta[0])
    s, m = seen.scenario.leg.outline().T
    return _in_space(pose.hip[0] + s[:, None] * along + m[:, None] * motion)


def _in_space(plane: FloatArray) -> FloatArray:
    """(x, z) as (x, 0, z)."""
    return np.insert(plane, 1, 0.0, axis=1)
