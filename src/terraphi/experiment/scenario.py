"""Scenario: everything a forward model needs to know, strict, frozen and hashed.

The defaults are those of the paper's benchmark (Xu & Wang): a straight leg, Yuma sand, 128² cells,
2.9 million steps. The shipped presets write them all out (``terraphi simulate paper-1``).
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.documents import Strict, located, parse_toml, refuse, strictly
from terraphi.experiment.leg import SOLID, Leg
from terraphi.experiment.motion import Motion, Rotation, bin_count
from terraphi.experiment.soil import Soil
from terraphi.experiment.units import GRAVITY

Medium = Literal[
    "generic", "poppy_loose", "poppy_close", "glass03_loose", "glass03_close", "glass3_close"
]
PAPER_DAMPING_RATE = -math.log(0.997) / 8e-6
"""The paper multiplies grid velocities by 0.997 every 8 µs: a decay rate of 375.6 1/s."""
COURANT_LIMIT = 0.9
"""Largest stable (c_p + v) Δt / Δx of the explicit step in plane strain.

Measured: elastic beds stay quiet up to 1.00 in the worst arrangement of particles tried and 1.10 in
most, soil up to 1.15; see tests/paper/plane."""
COURANT_LIMIT_3D = 0.75
"""The same in three dimensions."""
LONGEST_TRAVEL = 0.5
"""Cells that the leg may travel in three dimensions while the grid keeps its velocities [-]."""
ONLY_IN: dict[int, dict[str, Any]] = {
    2: {
        "relief.enabled": False,
        "numerics.damping_order": "after_contact",
        "numerics.transfer": "apic",
        "numerics.contact": "nodes",
        "numerics.stress_rate": "jaumann",
    },
    3: {
        "bed.breadth": None,
        "soil.yield_surface": "mohr_coulomb",
        "soil.critical_friction_angle_deg": None,
        "numerics.tip_inset_cells": 0.0,
        "numerics.remap_interval": 0.0,
        "numerics.stiffness_damping": 0.0,
    },
}
"""Dimensions of the material point method to the keys that no other has, with their value there."""
NOT_IN_RFT: dict[str, Any] = {
    "bed.breadth": None, "bed.soil_left": None, "bed.soil_width": None, "bed.surcharge": 0.0
}  # fmt: skip
"""Keys that resistive force theory does not have, with their value there."""
DROPPED: dict[str, tuple[Any, ...]] = {
    "gradient": ("mls",),
    "particle_volume": ("fixed",),
    "symmetry": ("half",),
    "contact": ("surface",),
    "dilatation": ("particle", "cell"),
    "distortion": ("particle",),
    "cell_damping": (0.0,),
}
"""Keys and choices of ``numerics`` that are gone, with the values that ask for what is done now.

Older files may still have them with these values."""

LIMITS = {
    "soil.friction_angle_deg": (5.0, 60.0, "deg"),
    "soil.density": (500.0, 5000.0, "kg/m³"),
    "soil.youngs_modulus": (1e5, 1e10, "Pa"),
    "leg.chord": (5e-3, 2.0, "m"),
    "leg.half_thickness": (1e-4, 0.1, "m"),
    "leg.width": (1e-3, 1.0, "m"),
    "leg.friction": (0.0, 2.0, "-"),
    "motion.duration": (1e-3, 1e4, "s"),
    "bed.height": (1e-3, 10.0, "m"),
    "numerics.time_step": (1e-8, 1e-2, "s"),
    "numerics.speed_up": (0.1, 1e3, "-"),
}
"""Smallest and largest plausible value of a key, and its unit; others are warned of."""
SHAKEN_DEG = {"mohr_coulomb": 31.0, "matsuoka_nakai": 36.0}
"""By yield surface, the φ [deg] above which soil in three dimensions shakes if nothing damps it.

Undamped, the straight leg of `sand3d` has 2 % less lift at 35° and a fifth less at 40°; with
Mohr-Coulomb the same at 30° and an eighth less at 35°."""
ENOUGH = 0.1
"""Least `stiffness_damping` that was seen to stop it [-]."""


class Bed(Strict):
    """The box of soil; its walls do not move with the grid."""

    left: float = Field(0.005, ge=0)
    """Position of the left wall x [m]."""
    floor: float = Field(0.005, ge=0)
    """Position of the floor z [m]."""
    width: float = Field(0.290, gt=0)
    """Width of the box [m]; the right wall stands at left + width."""
    height: float = Field(0.165, gt=0)
    """Height of the soil above the floor [m]."""
    breadth: float | None = Field(None, gt=0)
    """In three dimensions, extent of the box across the plane of motion [m], with the leg in its
    middle; rounded up to whole cells. Its sides are smooth mirrors."""
    floor_friction: Literal["rough", "smooth"] = "rough"
    """``rough``: soil that presses on the floor sticks; ``smooth``: it slips freely. The side
    walls always let soil slip."""
    soil_left: float | None = Field(None, ge=0)
    """Where the soil begins, x [m]; ``None``: at the left wall."""
    soil_width: float | None = Field(None, gt=0)
    """How far the soil reaches to the right [m]; ``None``: to the right wall."""
    surcharge: float = Field(0.0, ge=0)
    """Pressure on the free surface [Pa]: dead weight that the uppermost particles carry."""
    gravity: float = Field(GRAVITY, ge=0)
    """Acceleration of gravity g [m/s²]."""

    @model_validator(mode="after")
    def _holds_its_soil(self) -> Self:
        (low, high), right = self.soil_span, self.left + self.width
        slack = 1e-9 * self.width
        inside = self.left - slack <= low < high <= right + slack
        weightless = self.surcharge > 0.0 and self.gravity == 0.0
        refuse(
            {
                f"soil from x = {low:g} to {high:g} m lies outside the walls, {self.left:g} "
                f"to {right:g} m; change soil_left or soil_width": not inside,
                f"surcharge = {self.surcharge:g} Pa has no weight; set gravity > 0": weightless,
            }
        )
        return self

    @property
    def soil_span(self) -> tuple[float, float]:
        """Where the soil begins and ends x [m]."""
        low = self.left if self.soil_left is None else self.soil_left
        room = self.left + self.width - low
        return low, low + (room if self.soil_width is None else self.soil_width)

    @property
    def surface(self) -> float:
        """Height of the free surface z [m]."""
        return self.floor + self.height


class Relief(Strict):
    """Fading of soil that the leg has carried away (the paper's tail-phase relief), in 2-D."""

    enabled: bool = True
    """True if particles fade at all; only in a rotation."""
    distance: float = Field(0.020, ge=0)
    """Displacement from its first place beyond which a particle fades once θ > 0 [m]."""
    rate: float = Field(2.0, ge=0)
    """Decay rate per turned angle [1/rad]."""
    least: float = Field(0.05, gt=0, le=1)
    """Smallest weight q of a particle [-]."""


class Numerics(Strict):
    """Discretization of the material point method."""

    domain: float = Field(0.300, gt=0)
    """Side of the square background grid [m]."""
    cells: int = Field(128, ge=8, le=4096)
    """Cells along a side."""
    particles_per_cell_side: int = Field(2, ge=1, le=8)
    """Particles along a side of a cell; 2 makes 4 a cell in 2-D, 8 in 3-D."""
    particle_jitter: float = Field(1.0, ge=0, le=1)
    """Share of its sub-cell over which a particle's place is drawn [-]: 0 a lattice, 1 anywhere."""
    seed: int = Field(0, ge=0)
    """Seed of the particle places."""
    time_step: float = Field(8e-6, gt=0)
    """Time step Δt [s], below the CFL limit."""
    speed_up: float = Field(1.0, gt=0)
    """Factor k [-]: the motion runs k times faster, and the damping rate is divided by k, so
    that its drag on the soil stays the same."""
    damping_rate: float = Field(PAPER_DAMPING_RATE, ge=0)
    """Decay rate of grid velocities [1/s], a drag on the soil; 0: none."""
    damping_order: Literal["after_contact", "before_contact"] = "after_contact"
    """In 2-D, whether grid velocities decay ``after_contact`` with leg and walls or
    ``before_contact``."""
    transfer: Literal["apic", "pic"] = "apic"
    """In 2-D, what particles keep of the grid's velocities: ``apic``, value and gradient; ``pic``,
    the value alone, whose smoothing at every step acts like a viscosity."""
    contact: Literal["nodes", "unbalanced"] = "nodes"
    """In 2-D, ``nodes``: the nodes of the grid near the leg take its velocity; ``unbalanced``: as
    in the public prototype of Xu & Wang, which counts more force than it applies
    (``paper/plane/contact.py``). In 3-D material points press on the leg's true surface."""
    contact_band_cells: float = Field(2.0, ge=0)
    """In 2-D, nodes closer to the leg than this many cells are in contact [-]."""
    tip_inset_cells: float = Field(0.0, ge=0, le=4)
    """In 3-D, by how many cells contact ends before the leg's tip, along its center line [-]: the
    soil below a tip follows the nodes that contact drives, as if the tip were that much farther
    out. The faces stay where they are."""
    remap_interval: float = Field(0.0, ge=0)
    """In 3-D, for how long the grid keeps its velocities before it takes them from the particles
    again [s], rounded to steps, at least one."""
    stiffness_damping: float = Field(0.0, ge=0, le=0.5)
    """In 3-D, damping in proportion to the tangent stiffness: forces of the stress lead it by this
    share of its change in a time step [-]. 0: none, and soil with a large φ shakes and carries less
    than its strength; 0.1 to 0.5 stops that."""
    stress_rate: Literal["jaumann", "none"] = "jaumann"
    """In 2-D, how stress turns with the soil: ``jaumann``, with its spin; ``none``, not at all, as
    in the public prototype of Xu & Wang."""

    @model_validator(mode="before")
    @classmethod
    def _without_dropped(cls, content: Any) -> Any:
        if not isinstance(content, dict):
            return content
        return {k: v for k, v in content.items() if k not in DROPPED or v not in DROPPED[k]}

    @property
    def steps_per_phase(self) -> int:
        """Steps for which the grid keeps its velocities, 0 if it does not."""
        if self.remap_interval == 0.0:
            return 0
        return max(1, round(self.remap_interval / self.time_step))

    @property
    def cell_size(self) -> float:
        """Δx [m]."""
        return self.domain / self.cells

    @property
    def damping_factor(self) -> float:
        """Factor on grid velocities each step, exp(-rate Δt / k) [-]."""
        return math.exp(-self.damping_rate * self.time_step / self.speed_up)


class Resistive(Strict):
    """Resistive force theory."""

    medium: Medium = "generic"
    """In 2-D, whose coefficients to take (Li et al., 2013); the friction angle plays no part. In
    3-D the coefficients follow from φ and ρ (Agarwal et al., 2023)."""
    scale: float = Field(1.0, gt=0)
    """Factor ζ on the 2-D coefficients [-]."""
    panels: int = Field(200, ge=10, le=100_000)
    """Elements along the leg."""


class Scenario(Strict):
    """A soil, a leg, a motion and the numerics that bring them together.

    Examples
    --------
    >>> scenario = terraphi.Scenario.load("quick").replace(**{"soil.friction_angle_deg": 31.0})
    >>> scenario.model, scenario.soil.friction_angle_deg
    ('rft', 31.0)
    """

    name: str = ""
    """Name of the scenario; not part of the hash."""
    model: Literal["mpm", "rft"] = "mpm"
    """``mpm``: material point method; ``rft``: resistive force theory."""
    dimensions: Literal[2, 3] = 2
    """2: plane strain; 3: three dimensions, with legs of their true width."""
    soil: Soil = Field(default_factory=Soil)
    leg: Leg = Field(default_factory=Leg)
    motion: Motion = Field(default_factory=Rotation)
    bed: Bed = Field(default_factory=Bed)
    relief: Relief = Field(default_factory=Relief)
    numerics: Numerics = Field(default_factory=Numerics)
    rft: Resistive = Field(default_factory=Resistive)

    @model_validator(mode="after")
    def _can_be_simulated(self) -> Self:
        if "relief" not in self.model_fields_set and (self.dimensions == 3 or self.model == "rft"):
            # The paper's, in 2-D; elsewhere off unless somebody asks for it.
            object.__setattr__(self, "relief", Relief(enabled=False))
        try:
            if self.model == "rft":
                self._refuse_keys(NOT_IN_RFT, "model = 'mpm'")
            else:
                other = 5 - self.dimensions
                self._refuse_keys(ONLY_IN[other], f"dimensions = {other}")
                self._check_grid()
                self._check_path()
            if self.model == "mpm" and self.dimensions == 3:
                self._check_3d()
            else:
                self._check_2d()
        except ArithmeticError as error:
            raise ValueError(f"a number is too large or too small ({error})") from error
        return self

    def _refuse_keys(self, keys: dict[str, Any], needs: str) -> None:
        """Refuse keys that the model does not have, but for the value that asks for nothing."""
        for key, nothing in keys.items():
            value = attrgetter(key)(self)
            if value != nothing:
                instead = "leave it out" if nothing is None else f"set it to {json.dumps(nothing)}"
                raise ValueError(f"{key} = {json.dumps(value)} is for {needs}; {instead}")

    def _check_2d(self) -> None:
        shape, psi = self.leg.shape, self.soil.potential_angle_deg
        refuse(
            {
                f"leg.shape = '{shape}' is for model = 'mpm' in dimensions = 3; take one of "
                f"{', '.join([*OUTLINES, 'plate'])}": shape in SOLID,
                f"soil.dilation_angle_deg = {psi:g} < 0 is for dimensions = 3": psi < 0.0,
            }
        )

    def _check_3d(self) -> None:
        leg, numerics = self.leg, self.numerics
        is_plane = self.soil.yield_criterion == "plane_strain"
        across = leg.chord if leg.shape == "sphere" else leg.width
        breadth = self.bed.breadth or 0.0
        travel = numerics.steps_per_phase * numerics.time_step * self.sped_up_leg_speed
        cells = travel / numerics.cell_size
        # Contact begins at the hip, so that the soil must not reach it.
        hip = self.motion.poses_at(np.array(self.motion.span)).hip[:, 1].min()
        inset = f"numerics.tip_inset_cells = {numerics.tip_inset_cells:g}"
        refuse(
            {
                "dimensions = 3 needs bed.breadth, such as 0.2 m": not breadth,
                "dimensions = 3 needs numerics.remap_interval": numerics.remap_interval == 0.0,
                "dimensions = 3 needs soil.yield_criterion = 'plane_strain'": not is_plane,
                f"the leg is {across:g} m wide, more than bed.breadth = {breadth:g} m": across
                > breadth * (1.0 + 1e-9),
                f"numerics.remap_interval = {numerics.remap_interval:g} s lets the leg travel "
                f"{cells:.2g} cells, more than {LONGEST_TRAVEL:g}": cells > LONGEST_TRAVEL,
            }
        )
        if self.tip_inset > 0.0:
            refuse(
                {
                    f"{inset}, but a {leg.shape} has no tip; set it to 0": leg.shape in SOLID,
                    f"{inset} is more than the leg's length": self.tip_inset >= leg.length,
                    f"{inset} needs the hip above the soil, not at z = {hip:g} m": hip
                    < self.bed.surface,
                }
            )

    def _check_grid(self) -> None:
        bed, numerics, motion = self.bed, self.numerics, self.motion
        step, domain = numerics.time_step, numerics.domain
        # Two rows of nodes outside the soil hold it: with one, particles creep through the wall.
        cell = numerics.cell_size * (1.0 - 1e-9)
        left, right = bed.soil_span
        low, wall = min(bed.left, bed.floor), max(bed.left + bed.width, bed.surface)
        limit = self.time_step_limit
        # No step may pass over a whole bin of the history.
        bin_width = (motion.span[1] - motion.span[0]) / bin_count(motion)
        visit = bin_width / (motion.top_coordinate_rate * numerics.speed_up)
        refuse(
            {
                f"bed.width = {right - left:g} m of soil and bed.height = {bed.height:g} m must "
                f"be at least a cell, {cell:g} m": min(right - left, bed.height) < cell,
                f"the bed reaches from {low:g} to {wall:g} m and must stay a cell, {cell:g} m, "
                f"inside numerics.domain = {domain:g} m": low < cell or wall > domain - cell,
                f"numerics.time_step = {step:g} s is above the CFL limit of {limit:.3g} s": step
                > limit,
                f"numerics.time_step = {step:g} s skips bins of angle; give {visit:.3g} s": step
                > visit,
            }
        )

    def _check_path(self) -> None:
        """Refuse a leg that leaves the box."""
        bed, grid = self.bed, (0.0, self.numerics.domain)
        room = [(bed.left, bed.left + bed.width), (bed.floor, grid[1])]
        moves = self.motion.velocity if self.motion.kind == "translation" else (1.0, 1.0)
        paths = _extent_of_path(self.motion, self.leg)
        for name, path, box, moving in zip("xz", paths, room, moves, strict=True):
            # What slides along a wall may reach into it, such as a half of a symmetric plate.
            low, high = box if moving else grid
            if path[0] < low or path[1] > high:
                raise ValueError(
                    f"the leg leaves the domain, {name} = {path[0]:.4f} to {path[1]:.4f} m, not in "
                    f"{low:.4f} to {high:.4f}; move motion.hip or shorten leg.chord"
                )

    @property
    def tip_inset(self) -> float:
        """How much of the leg's center line contact leaves out at the tip [m]."""
        return self.numerics.tip_inset_cells * self.numerics.cell_size

    @property
    def sped_up_leg_speed(self) -> float:
        """Largest speed of any point of the leg, sped up [m/s]."""
        return self.numerics.speed_up * self.motion.top_speed(self.leg.reach())

    @property
    def time_step_limit(self) -> float:
        """Largest stable time step of the material point method [s].

        In three dimensions the contact of more than three particles along a cell lowers it.
        """
        limit = COURANT_LIMIT
        if self.dimensions == 3:
            limit = COURANT_LIMIT_3D * min(1.0, 3.0 / self.numerics.particles_per_cell_side)
        speed = self.soil.p_wave_speed + self.sped_up_leg_speed
        return limit * self.numerics.cell_size / speed

    @property
    def cells_across(self) -> int:
        """Cells from the plane of motion, a plane of symmetry, to the side; 0 in plane strain."""
        if self.dimensions == 2 or self.bed.breadth is None:
            return 0
        return max(1, math.ceil(0.5 * self.bed.breadth / self.numerics.cell_size - 1e-6))

    @property
    def hip_height(self) -> float:
        """Height of the leg's frame above the free surface at the start [m]."""
        return float(self.motion.poses(np.zeros(1)).hip[0, 1]) - self.bed.surface

    @property
    def convention(self) -> str:
        """What the friction angle means here: the yield criterion, ``rft3d`` or ``none``.

        Two-dimensional resistive force theory has no friction angle. In the three-dimensional
        theory it enters an empirical law as μ = tan φ (Agarwal et al., 2023).
        """
        if self.model == "mpm":
            return self.soil.yield_criterion
        return "rft3d" if self.dimensions == 3 else "none"

    @property
    def hash(self) -> str:
        """SHA-256 of all that differs from the defaults, but for the name, hexadecimal.

        A new option leaves the hashes of what was simulated before as they are.
        """
        content = self.model_dump(mode="json", exclude={"name"}, exclude_defaults=True)
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def warnings(self) -> list[str]:
        """Values that can be simulated and are probably a mistake, a sentence each."""
        values = {key: attrgetter(key)(self) for key in LIMITS}
        sentences = [
            f"{key} = {values[key]:g} is unusual: in {unit}, mostly {least:g} to {most:g}"
            for key, (least, most, unit) in LIMITS.items() if not least <= values[key] <= most
        ]  # fmt: skip
        soil, damping = self.soil, self.numerics.stiffness_damping
        undamped = (self.model, self.dimensions) == ("mpm", 3) and damping < ENOUGH
        if undamped and soil.friction_angle_deg > SHAKEN_DEG[soil.yield_surface]:
            shakes = f"undamped soil of {soil.friction_angle_deg:g}° shakes and is too weak"
            sentences.append(f"{shakes}; set numerics.stiffness_damping = 0.25")
        poses = self.motion.poses(np.linspace(0.0, self.motion.duration, 361))
        height_mm = 1e3 * (poses.placed(self.leg.outline())[..., 1] - self.bed.surface)
        low, first = height_mm.min(), height_mm[0].min()
        if low > 0.0:
            sentences.append(f"the leg stays {low:.3g} mm above the soil; lower motion.hip")
        elif first < 0.0:
            why = f"the leg starts {-first:.3g} mm deep in the soil, so its first forces are off"
            sentences.append(why)
        return sentences

    def replace(self, source: str = "scenario", /, **changes: Any) -> Scenario:
        """Copy with some dotted keys replaced, checked anew.

        Parameters
        ----------
        source
            Where the changes come from, for messages.
        **changes
            Dotted key to value, as in ``replace(**{"soil.friction_angle_deg": 30.0})``; a number
            picks an entry of a list, as in ``motion.hip.1``, the height of the hip.

        Raises
        ------
        InputError
            If a key does not exist or a value cannot be.
        """
        content = self.model_dump(mode="json")
        for key, value in changes.items():
            *sections, last = key.split(".")
            place: Any = content
            for section in sections:
                place = place.get(section) if isinstance(place, dict) else None
            if isinstance(place, dict):
                place[last] = value
            elif isinstance(place, list) and last.isdecimal() and int(last) < len(place):
                place[int(last)] = value
            else:
                content[key] = value  # unknown, for the check to refuse
        return strictly(content, Scenario, source)

    @classmethod
    def load(cls, source: Path | str) -> Scenario:
        """Read a scenario from a TOML file, or a shipped preset by its name.

        Parameters
        ----------
        source
            A path ending in ``.toml``, or the name of a preset.

        Raises
        ------
        InputError
            If the file is missing, not TOML, has an unknown key or a value that cannot be.
        """
        return parse_toml(located(source, "scenarios", ".toml"), cls)


@functools.lru_cache(maxsize=64)
def _extent_of_path(motion: Motion, leg: Leg) -> tuple[tuple[float, float], ...]:
    """Least and largest x and z [m] that a leg covers; the cases of a library mostly share it."""
    points = motion.poses_at(np.linspace(*motion.span, 541)).placed(leg.outline())
    low, high = points.min(axis=(0, 1)).tolist(), points.max(axis=(0, 1)).tolist()
    return tuple(zip(low, high, strict=True))
