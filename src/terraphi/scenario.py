"""Scenario: everything a forward model needs to know, strict, frozen and hashed.

The defaults are those of the paper's benchmark (Xu & Wang): a straight leg, Yuma sand, 128² cells,
2.9 million steps. The shipped presets write them all out (``terraphi simulate paper-1``).
"""

from __future__ import annotations

import functools
import hashlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from terraphi.documents import parse_toml, shipped_file, strictly
from terraphi.files import is_there
from terraphi.leg import Leg, frame_axes
from terraphi.motion import Motion, Rotation, bin_count
from terraphi.setting import (
    ADDED_LATER,
    Bed,
    Numerics,
    Relief,
    Resistive,
    Section,
)
from terraphi.soil import Soil

COURANT_LIMIT = 0.9
"""Largest stable (c_p + v) Δt / Δx of the explicit step.

Measured: elastic beds stay quiet up to 1.00 in the worst arrangement of particles tried and 1.10 in
most, soil up to 1.15; see tests/forward/mpm."""

LONGEST_TRAVEL = 0.1
"""Cells that the leg may travel while the grid keeps its velocities [-]: the particles' places on
the grid are held meanwhile."""


LEAST, LARGEST = 1e-15, 1e15
"""Sizes of numbers, in SI or degrees, that can be computed with."""


class Scenario(Section):
    """A soil, a leg, a motion and the numerics that bring them together.

    Attributes
    ----------
    name
        For people; not part of the hash.
    model
        ``mpm``: material point method; ``rft``: resistive force theory.
    dimensions
        2: plane strain; 3: ``rft`` only, so far.
    """

    name: str = ""
    model: Literal["mpm", "rft"] = "mpm"
    dimensions: Literal[2, 3] = 2
    soil: Soil = Field(default_factory=Soil)
    leg: Leg = Field(default_factory=Leg)
    motion: Motion = Field(default_factory=Rotation)
    bed: Bed = Field(default_factory=Bed)
    relief: Relief = Field(default_factory=Relief)
    numerics: Numerics = Field(default_factory=Numerics)
    rft: Resistive = Field(default_factory=Resistive)

    @model_validator(mode="after")
    def _can_be_simulated(self) -> Self:
        try:
            self._check()
        except (ArithmeticError, MemoryError) as error:
            raise ValueError(
                f"some number is too large or too small to compute with ({error}); "
                "'terraphi keys' lists what is usual"
            ) from error
        return self

    def _check(self) -> None:
        for key, value in _numbers(self.model_dump()):
            if value and not LEAST <= abs(value) <= LARGEST:
                raise ValueError(
                    f"{key} = {value:g} is out of all proportion; sizes from {LEAST:g} to "
                    f"{LARGEST:g} can be computed with"
                )
        if self.model == "mpm":
            if self.dimensions == 3:
                raise ValueError(
                    "dimensions = 3: the material point method knows plane strain only; "
                    "set dimensions = 2, or model = 'rft'"
                )
            self._check_domain()
            self._check_time_step()
            self._check_phases()
            self._check_every_bin_is_visited()
            self._check_leg_stays_inside()
        else:
            self._check_resistive_bed()

    def _check_resistive_bed(self) -> None:
        if self.bed.surcharge > 0.0:
            raise ValueError(
                f"bed.surcharge = {self.bed.surcharge:g} Pa: resistive force theory knows the "
                "soil's own weight only; set it to 0, or model = 'mpm'"
            )
        for name in ("soil_left", "soil_width"):
            if getattr(self.bed, name) is not None:
                raise ValueError(
                    f"bed.{name} = {getattr(self.bed, name):g} m: resistive force theory knows "
                    "soil without an edge only; leave it out, or set model = 'mpm'"
                )

    def _check_domain(self) -> None:
        # Two rows of nodes outside the soil hold it: with one, particles creep through the wall.
        margin = self.numerics.cell_size * (1.0 - 1e-9)
        low, high = self.bed.soil_span
        if min(high - low, self.bed.height) < margin:
            raise ValueError(
                f"bed.width = {high - low:g} m of soil and bed.height = {self.bed.height:g} m must "
                f"be at least a cell, {margin:g} m"
            )
        for name, top in (
            ("bed.left + bed.width", self.bed.left + self.bed.width),
            ("bed.floor + bed.height", self.bed.surface),
        ):
            if top > self.numerics.domain - margin:
                raise ValueError(
                    f"{name} = {top:g} m must stay a cell below the grid's end, "
                    f"numerics.domain = {self.numerics.domain:g} m; refine the grid or move the bed"
                )
        if min(self.bed.left, self.bed.floor) < margin:
            raise ValueError(
                f"bed.left = {self.bed.left:g} m and bed.floor = {self.bed.floor:g} m must be at "
                f"least a cell, {margin:g} m; refine the grid or move the bed"
            )

    def _check_time_step(self) -> None:
        limit = self.time_step_limit
        if self.numerics.time_step > limit:
            raise ValueError(
                f"numerics.time_step = {self.numerics.time_step:g} s is above the CFL limit of "
                f"{limit:.3g} s for this grid, stiffness and density"
            )

    def _check_phases(self) -> None:
        numerics = self.numerics
        speed = numerics.speed_up * self.motion.top_speed(self.leg.reach())
        interval = numerics.steps_per_phase * numerics.time_step
        longest = LONGEST_TRAVEL * numerics.cell_size / speed
        if interval > longest:
            raise ValueError(
                f"numerics.remap_interval = {numerics.remap_interval:g} s lets the leg travel more "
                f"than {LONGEST_TRAVEL:g} cells while the grid keeps its velocities; at most "
                f"{longest:.3g} s fits"
            )

    def _check_every_bin_is_visited(self) -> None:
        rate = self.motion.top_coordinate_rate * self.numerics.speed_up
        low, high = self.motion.span
        longest = (high - low) / bin_count(self.motion) / rate
        if self.numerics.time_step > longest:
            raise ValueError(
                f"numerics.time_step = {self.numerics.time_step:g} s passes over whole bins of the "
                f"history at numerics.speed_up = {self.numerics.speed_up:g}; at most {longest:.3g} "
                "s fits"
            )

    def _check_leg_stays_inside(self) -> None:
        low, high = _extent_of_path(self.motion, self.leg)
        room_low = [self.bed.left, self.bed.floor]
        room_high = [self.bed.left + self.bed.width, self.numerics.domain]
        if self.motion.kind == "translation":
            # What slides along a wall may reach into it: a wall's foot, a half of what is
            # symmetric. Otherwise the grid would see its end face in the corner.
            for axis in range(2):
                if self.motion.velocity[axis] == 0.0:
                    room_low[axis], room_high[axis] = 0.0, self.numerics.domain
        for axis, name in enumerate("xz"):
            if low[axis] < room_low[axis] or high[axis] > room_high[axis]:
                raise ValueError(
                    f"the leg leaves the domain: its path covers {name} = {low[axis]:.4f} to "
                    f"{high[axis]:.4f} m, the room is {room_low[axis]:.4f} to "
                    f"{room_high[axis]:.4f} m; move motion.hip or shorten leg.chord"
                )

    @property
    def time_step_limit(self) -> float:
        """Largest stable time step of the material point method [s]."""
        speed = self.soil.p_wave_speed + self.numerics.speed_up * self.motion.top_speed(
            self.leg.reach()
        )
        return COURANT_LIMIT * self.numerics.cell_size / speed

    @property
    def hip_height(self) -> float:
        """Height of the leg's frame above the free surface at the start [m]."""
        start = self.motion.poses(np.zeros(1)).hip[0, 1]
        return float(start) - self.bed.surface

    @property
    def convention(self) -> str:
        """What the friction angle means here: the yield criterion, ``rft3d`` or ``none``.

        Two-dimensional resistive force theory has no friction angle. That of the
        three-dimensional theory enters an empirical law as
        μ = tan φ (Agarwal et al., 2023); no yield criterion stands behind it.
        """
        if self.model == "mpm":
            return self.soil.yield_criterion
        return "rft3d" if self.dimensions == 3 else "none"

    @property
    def hash(self) -> str:
        """SHA-256 of everything that bears on the result (not the name), hexadecimal.

        Options of :data:`~terraphi.setting.ADDED_LATER` count only where they change something.
        """
        content = self.model_dump(mode="json", exclude={"name"})
        for key, before in ADDED_LATER.items():
            section, option = key.split(".")
            if content[section][option] == before:
                del content[section][option]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def replace(self, **changes: Any) -> Scenario:
        """Copy with some dotted keys replaced, checked anew.

        Parameters
        ----------
        **changes
            Dotted key to value, as in ``replace(**{"soil.friction_angle_deg": 30.0})``; a number
            picks an entry of a list, as in ``motion.hip.1``, the height of the hip.

        Returns
        -------
        Scenario

        Raises
        ------
        pydantic.ValidationError
            If a key does not exist or a value cannot be.
        """
        content = self.model_dump(mode="json")
        for key, value in changes.items():
            *sections, last = key.split(".")
            place = content
            for section in sections[:-1]:
                place = _section(place, section)
            if sections and _is_entry(place.get(sections[-1]), last):
                place[sections[-1]][int(last)] = value
            else:
                place = _section(place, sections[-1]) if sections else place
                place[last] = value
        return strictly(content, Scenario)

    @classmethod
    def load(cls, source: Path | str) -> Scenario:
        """Read a scenario from a TOML file, or a shipped preset by its name.

        Parameters
        ----------
        source
            A path ending in ``.toml``, or the name of a preset.

        Returns
        -------
        Scenario

        Raises
        ------
        InputError
            If the file is missing, not TOML, has an unknown key or a value that cannot be.
        """
        if Path(source).suffix != ".toml" and not is_there(Path(source)):
            source = shipped_file("scenarios", str(source), ".toml")
        return parse_toml(Path(source), cls)


def _numbers(content: dict[str, Any], above: str = "") -> Iterator[tuple[str, float]]:
    """Dotted keys and values of all numbers that are not whole, those in lists too."""
    for key, value in content.items():
        if isinstance(value, dict):
            yield from _numbers(value, f"{above}{key}.")
        for number in value if isinstance(value, list | tuple) else (value,):
            if isinstance(number, float):
                yield above + key, number


@functools.lru_cache(maxsize=64)
def _extent_of_path(motion: Motion, leg: Leg) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Least and largest x and z [m] that a leg covers; the cases of a library mostly share it."""
    times = np.linspace(0.0, min(motion.duration, sys.float_info.max), 541)
    poses = motion.poses(times)
    along, ahead = frame_axes(poses.theta)
    line, margin = leg.extremities()
    points = (
        poses.hip[:, None, :]
        + line[None, :, :1] * along[:, None, :]
        + line[None, :, 1:] * ahead[:, None, :]
    )
    low, high = points.min(axis=(0, 1)) - margin, points.max(axis=(0, 1)) + margin
    return tuple(low.tolist()), tuple(high.tolist())


def _section(place: dict[str, Any], name: str) -> dict[str, Any]:
    """Section of a document; made, for the check to refuse, where there is none."""
    if not isinstance(place.get(name), dict):
        place[name] = {}
    section: dict[str, Any] = place[name]
    return section


def _is_entry(value: object, index: str) -> bool:
    """Whether an index in a dotted key names an entry of a list."""
    return isinstance(value, list) and index.isdecimal() and int(index) < len(value)
