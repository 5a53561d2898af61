"""Scenario: everything a forward model needs to know, strict, frozen and hashed.

The defaults are those of the paper's benchmark (Xu & Wang): a straight leg, Yuma sand, 128² cells,
2.9 million steps. The shipped presets write them all out (``terraphi simulate paper-0``).
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from terraphi.documents import parse_toml, shipped_file, strictly
from terraphi.leg import Leg, frame_axes
from terraphi.motion import Motion, Rotation, bin_centres
from terraphi.soil import Soil

GRAVITY = 9.81
"""Acceleration of gravity g [m/s²]."""
COURANT_LIMIT = 0.9
"""Largest stable (c_p + v) Δt / Δx of the explicit step.

Measured: elastic beds stay quiet up to 1.00 in the worst arrangement of particles tried and 1.10 in
most, soil up to 1.15; see tests/forward/mpm."""
PAPER_DAMPING_RATE = -math.log(0.997) / 8e-6
"""The paper multiplies grid velocities by 0.997 every 8 µs: a decay rate of 375.6 1/s."""


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Bed(_Section):
    """The box of soil; its walls are fixed in space whatever the grid.

    Attributes
    ----------
    left, floor
        Position of the left wall x and of the floor z [m].
    width, height
        Extent of the soil [m]; the right wall stands at left + width.
    floor_friction
        ``rough``: soil that presses on the floor sticks; ``smooth``: it slips freely. The side
        walls always let soil slip.
    """

    left: float = Field(0.005, ge=0)
    floor: float = Field(0.005, ge=0)
    width: float = Field(0.290, gt=0)
    height: float = Field(0.165, gt=0)
    floor_friction: Literal["rough", "smooth"] = "rough"

    @property
    def surface(self) -> float:
        """Height of the free surface z [m]."""
        return self.floor + self.height


class Relief(_Section):
    """Fading of soil that the leg has carried away (the paper's tail-phase relief).

    Attributes
    ----------
    enabled
        Whether particles fade at all; only in a rotation.
    distance
        Displacement from its first place beyond which a particle fades once θ > 0 [m].
    rate
        Decay rate per turned angle [1/rad].
    least
        Smallest weight q of a particle [-].
    """

    enabled: bool = True
    distance: float = Field(0.020, ge=0)
    rate: float = Field(2.0, ge=0)
    least: float = Field(0.05, gt=0, le=1)


class Numerics(_Section):
    """Discretisation of the material point method.

    Attributes
    ----------
    domain
        Side of the square background grid [m].
    cells
        Cells along a side.
    particles_per_cell_side
        Particles along a side of a cell; 2 makes 4 a cell in the plane.
    particle_jitter
        Share of its sub-cell over which a particle's place is drawn [-]: 0 a lattice, 1 anywhere.
    seed
        Seed of the particle places.
    time_step
        Δt [s].
    speed_up
        k: the motion runs k times faster, and the damping rate is divided by k, so that its
        drag on the soil stays the same.
    damping_rate
        Decay rate of grid velocities [1/s]; 0 for none.
    contact_band_cells
        Nodes closer to the leg than this many cells are in contact.
    particle_volume
        ``fixed``: V₀; ``updated``: J V₀.
    """

    domain: float = Field(0.300, gt=0)
    cells: int = Field(128, ge=8, le=4096)
    particles_per_cell_side: int = Field(2, ge=1, le=8)
    particle_jitter: float = Field(1.0, ge=0, le=1)
    seed: int = Field(0, ge=0)
    time_step: float = Field(8e-6, gt=0)
    speed_up: float = Field(1.0, gt=0)
    damping_rate: float = Field(PAPER_DAMPING_RATE, ge=0)
    contact_band_cells: float = Field(2.0, ge=0)
    particle_volume: Literal["fixed", "updated"] = "fixed"

    @property
    def cell_size(self) -> float:
        """Δx [m]."""
        return self.domain / self.cells

    @property
    def damping_factor(self) -> float:
        """Factor on grid velocities each step, exp(-rate Δt / k) [-]."""
        return math.exp(-self.damping_rate * self.time_step / self.speed_up)


class Resistive(_Section):
    """Resistive force theory.

    Attributes
    ----------
    medium
        In two dimensions, whose coefficients to take (Li et al., 2013); the friction angle plays
        no part. In three dimensions the coefficients follow from φ and ρ (Agarwal et al., 2023).
    scale
        Factor ζ on the two-dimensional coefficients [-].
    panels
        Elements along the leg.
    """

    medium: Literal[
        "generic",
        "poppy_loose",
        "poppy_close",
        "glass03_loose",
        "glass03_close",
        "glass3_close",
    ] = "generic"
    scale: float = Field(1.0, gt=0)
    panels: int = Field(200, ge=10)


class Scenario(_Section):
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
        if self.model == "mpm":
            if self.dimensions == 3:
                raise ValueError(
                    "dimensions = 3: the material point method knows plane strain only; "
                    "set dimensions = 2, or model = 'rft'"
                )
            self._check_domain()
            self._check_time_step()
            self._check_every_bin_is_visited()
            self._check_leg_stays_inside()
        return self

    def _check_domain(self) -> None:
        # Two rows of nodes outside the soil hold it: with one, particles creep through the wall.
        margin = self.numerics.cell_size * (1.0 - 1e-9)
        if min(self.bed.width, self.bed.height) < margin:
            raise ValueError(
                f"bed.width = {self.bed.width:g} m and bed.height = {self.bed.height:g} m must be "
                f"at least a cell, {margin:g} m"
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

    def _check_every_bin_is_visited(self) -> None:
        rate = self.motion.top_coordinate_rate * self.numerics.speed_up
        low, high = self.motion.span
        longest = (high - low) / len(bin_centres(self.motion)) / rate
        if self.numerics.time_step > longest:
            raise ValueError(
                f"numerics.time_step = {self.numerics.time_step:g} s passes over whole bins of the "
                f"history at numerics.speed_up = {self.numerics.speed_up:g}; at most {longest:.3g} "
                "s fits"
            )

    def _check_leg_stays_inside(self) -> None:
        times = np.linspace(0.0, self.motion.duration, 541)
        poses = self.motion.poses(times)
        along, motion = frame_axes(poses.theta)
        line = np.vstack([[0.0, 0.0], self.leg.centre_line(60).centre, [self.leg.chord, 0.0]])
        points = (
            poses.hip[:, None, :]
            + line[None, :, :1] * along[:, None, :]
            + line[None, :, 1:] * motion[:, None, :]
        )
        low = points.min(axis=(0, 1)) - self.leg.half_thickness
        high = points.max(axis=(0, 1)) + self.leg.half_thickness
        room_low = (self.bed.left, self.bed.floor)
        room_high = (self.bed.left + self.bed.width, self.numerics.domain)
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
        """SHA-256 of everything that bears on the result (not the name), hexadecimal."""
        content = self.model_dump(mode="json", exclude={"name"})
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def replace(self, **changes: Any) -> Scenario:
        """Copy with some dotted keys replaced, checked anew.

        Parameters
        ----------
        **changes
            Dotted key to value, as in ``replace(**{"soil.friction_angle_deg": 30.0})``.

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
            for section in sections:
                if not isinstance(place.get(section), dict):
                    place[section] = {}  # for the check below to refuse
                place = place[section]
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
        if Path(source).suffix != ".toml" and not Path(source).is_file():
            source = shipped_file("scenarios", str(source), ".toml")
        return parse_toml(Path(source), cls)
