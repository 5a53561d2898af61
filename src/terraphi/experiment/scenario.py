"""Scenario: everything a forward model needs to know, strict, frozen and hashed.

The defaults are those of the paper's benchmark (Xu & Wang): a straight leg, Yuma sand, 128² cells,
2.9 million steps. The shipped presets write them all out (``terraphi simulate paper-1``).

An option that is added later says in :data:`ADDED_LATER` which value means what was there before.
A scenario that leaves it there keeps its hash, and what was simulated is not simulated again.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from terraphi.experiment.documents import WRITTEN, Strict, parse_toml, shipped_file, strictly
from terraphi.experiment.files import is_there
from terraphi.experiment.leg import LEG_SHAPES, SOLID_SHAPES, Leg
from terraphi.experiment.motion import Motion, Rotation, bin_count
from terraphi.experiment.soil import Soil

GRAVITY = 9.81
"""Acceleration of gravity g [m/s²]."""
ADDED_LATER: dict[str, Any] = {
    "bed.soil_left": None,
    "bed.soil_width": None,
    "bed.surcharge": 0.0,
    "bed.gravity": GRAVITY,
    "bed.breadth": None,
    "soil.critical_friction_angle_deg": None,
    "soil.softening_strain": 0.2,
    "soil.yield_surface": "mohr_coulomb",
    "numerics.symmetry": "half",
    "numerics.transfer": "apic",
    "numerics.damping_order": "after_contact",
    "numerics.contact": "nodes",
    "numerics.remap_interval": 0.0,
    "numerics.dilatation": "particle",
    "numerics.distortion": "particle",
    "numerics.cell_damping": 0.0,
    "numerics.stiffness_damping": 0.0,
    "numerics.stress_rate": "jaumann",
    "numerics.tip_inset_cells": 0.0,
}
"""Dotted key to the value that leaves a scenario as it was before the option existed."""
DROPPED: dict[str, Any] = {"gradient": "mls"}
"""Key of an option of ``numerics`` that is gone to the value that asks for what is done now.

Stored scenarios may still name it with that value; people may not name it at all."""
PAPER_DAMPING_RATE = -math.log(0.997) / 8e-6
"""The paper multiplies grid velocities by 0.997 every 8 µs: a decay rate of 375.6 1/s."""


class Bed(Strict):
    """The box of soil; its walls are fixed in space whatever the grid."""

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
    middle; rounded up to whole cells. Its flanks are smooth and mirror what is between them."""
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
        low, high = self.soil_span
        slack = 1e-9 * self.width
        if low < self.left - slack or high > self.left + self.width + slack or low >= high:
            raise ValueError(
                f"soil from x = {low:g} to {high:g} m does not lie between the walls at "
                f"{self.left:g} and {self.left + self.width:g} m; change soil_left or soil_width"
            )
        if self.surcharge > 0.0 and self.gravity == 0.0:
            raise ValueError(
                f"surcharge = {self.surcharge:g} Pa is dead weight, and gravity = 0 gives it none; "
                "set gravity above 0"
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
    """Fading of soil that the leg has carried away (the paper's tail-phase relief)."""

    enabled: bool = True
    """Whether particles fade at all; only in a rotation."""
    distance: float = Field(0.020, ge=0)
    """Displacement from its first place beyond which a particle fades once θ > 0 [m]."""
    rate: float = Field(2.0, ge=0)
    """Decay rate per turned angle [1/rad]."""
    least: float = Field(0.05, gt=0, le=1)
    """Smallest weight q of a particle [-]."""


class Numerics(Strict):
    """Discretisation of the material point method."""

    domain: float = Field(0.300, gt=0)
    """Side of the square background grid [m]."""
    cells: int = Field(128, ge=8, le=4096)
    """Cells along a side."""
    particles_per_cell_side: int = Field(2, ge=1, le=8)
    """Particles along a side of a cell; 2 makes 4 a cell in the plane, 8 in space."""
    particle_jitter: float = Field(1.0, ge=0, le=1)
    """Share of its sub-cell over which a particle's place is drawn [-]: 0 a lattice, 1 anywhere."""
    symmetry: Literal["half", "whole"] = "half"
    """In three dimensions, what is computed: ``half`` of the soil, to one side of the leg's plane
    of motion, which mirrors it; or the ``whole``."""
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
    """Whether grid velocities decay ``after_contact`` with leg and walls or ``before_contact``."""
    transfer: Literal["apic", "pic"] = "apic"
    """What particles keep of the grid's velocities: ``apic``, value and gradient; ``pic``, the
    value alone, whose smoothing at every step acts like a viscosity."""
    contact: Literal["nodes", "surface", "unbalanced"] = "nodes"
    """``nodes``: the nodes of the grid near the leg take its velocity; ``surface``: the
    material points press on its true surface; ``unbalanced``: near nodes as in the public
    prototype of Xu & Wang, which counts more force than it applies
    (``forward/plane/contact.py``)."""
    contact_band_cells: float = Field(2.0, ge=0)
    """Nodes closer to the leg than this many cells are in contact [-]."""
    tip_inset_cells: float = Field(0.0, ge=0, le=4)
    """By how many cells ``surface`` contact ends before the leg's tip, along its centre line [-]:
    the soil beneath a tip follows the nodes that contact drives, as if the tip were that much
    farther out (``docs/convergence.md``). The faces stay where they are."""
    remap_interval: float = Field(0.0, ge=0)
    """For how long the grid keeps its velocities before it takes them from the particles anew
    [s], rounded to steps; 0: it does so at every step."""
    dilatation: Literal["particle", "cell"] = "particle"
    """Volumetric strain rate that the stress follows: ``particle``, that at each particle;
    ``cell``: their mean over a cell (B-bar; Hughes, 1980, doi 10.1002/nme.1620150914), without
    which plastic flow at constant volume locks. In three dimensions the particles of a cell then
    share their plastic changes of volume too. In two they do not, and soil that dilates gets
    stiffer, since what one particle gains its neighbours would have to give back, unless
    ``distortion`` is that of the cell too."""
    distortion: Literal["particle", "cell", "auto"] = "particle"
    """Distortion rate that the stress follows, as ``dilatation`` says it of the volumetric rate.
    With both ``cell`` all particles of a cell strain alike, and soil that dilates no longer meets
    more conditions than its nodes can fulfil (``docs/convergence.md``). Not without
    ``cell_damping``: what then shakes within a cell weakens the soil. ``auto``: ``cell``, with
    ``cell_damping``, for soil that dilates; ``particle``, without, for soil that keeps its volume,
    which ``dilatation`` alone keeps from locking, and which that damping would make stiffer the
    faster it shears. From one to the other a leg's force changes by 3 to 10 %: not for soils
    of both kinds in one library."""
    cell_damping: float = Field(0.0, ge=0, le=0.5)
    """Viscosity against what the particles of a cell strain apart from their mean, as a share of
    ρ c Δx [-], c that of compression waves; of those rates that are means over the cell. A mean
    knows nothing of such motion, so that nothing else resists it. 0: none; 0.05 to 0.2 stops
    it."""
    stiffness_damping: float = Field(0.0, ge=0, le=0.5)
    """In three dimensions, damping in proportion to the tangent stiffness: forces of the stress
    lead it by this share of what it changed by in a time step [-]. Without it soil with a large φ
    shakes, and bears less than its strength (``docs/explanation/three-dimensions-cells.md``).
    0: none; 0.1 to 0.5 stops it."""
    stress_rate: Literal["jaumann", "none"] = "jaumann"
    """How stress turns with the soil: ``jaumann``, with its spin; ``none``, not at all, as in
    the public prototype of Xu & Wang."""
    particle_volume: Literal["fixed", "updated"] = "fixed"
    """Volume of a particle: ``fixed``, that at the start, V₀; ``updated``, J V₀ by the
    deformation's determinant J."""

    @model_validator(mode="before")
    @classmethod
    def _without_dropped_options(cls, content: Any, info: ValidationInfo) -> Any:
        if info.context == WRITTEN or not isinstance(content, dict):
            return content
        return {k: v for k, v in content.items() if k not in DROPPED or v != DROPPED[k]}

    @model_validator(mode="after")
    def _phases_where_needed(self) -> Self:
        if self.contact == "unbalanced":
            self._check_unbalanced()
        for name, value, usual in (
            ("contact", self.contact, ("nodes", "unbalanced")),
            ("dilatation", self.dilatation, ("particle",)),
            ("distortion", self.distortion, ("particle",)),
            ("stiffness_damping", self.stiffness_damping, (0.0,)),
        ):
            if value not in usual and self.remap_interval == 0.0:
                raise ValueError(
                    f"{name} = {value!r} needs a grid that keeps its velocities for a while; "
                    "set remap_interval above 0, as to 20 time steps"
                )
        if self.cell_damping > 0.0 and {self.dilatation, self.distortion} == {"particle"}:
            raise ValueError(
                f"cell_damping = {self.cell_damping:g} acts against motion that means over a cell "
                "do not see; set dilatation or distortion = 'cell', or cell_damping = 0"
            )
        if self.tip_inset_cells > 0.0 and self.contact != "surface":
            raise ValueError(
                f"tip_inset_cells = {self.tip_inset_cells:g} says where contact = 'surface' ends, "
                f"and contact = '{self.contact}' does not know it; set tip_inset_cells = 0"
            )
        if self.contact == "surface" and self.particles_per_cell_side > 3:
            raise ValueError(
                f"particles_per_cell_side = {self.particles_per_cell_side} makes the penalty of "
                "contact = 'surface' too stiff for a particle's mass; at most 3 are stable"
            )
        if self.transfer == "pic" and self.remap_interval > 0.0:
            raise ValueError(
                "transfer = 'pic' is one of every step; set remap_interval = 0, or transfer = "
                "'apic'"
            )
        return self

    def _check_unbalanced(self) -> None:
        for name in ("dilatation", "distortion"):
            if (value := getattr(self, name)) != "particle":
                raise ValueError(
                    f"contact = 'unbalanced' goes with the strains of each particle: set {name} = "
                    f"'particle' instead of '{value}', or contact = 'nodes'"
                )
        if self.remap_interval > 0.0:
            raise ValueError(
                "contact = 'unbalanced' counts its force where the grid takes new velocities at "
                "every step; set remap_interval = 0, or contact = 'nodes'"
            )

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

    medium: Literal[
        "generic",
        "poppy_loose",
        "poppy_close",
        "glass03_loose",
        "glass03_close",
        "glass3_close",
    ] = "generic"
    """In two dimensions, whose coefficients to take (Li et al., 2013); the friction angle plays
    no part. In three dimensions the coefficients follow from φ and ρ (Agarwal et al., 2023)."""
    scale: float = Field(1.0, gt=0)
    """Factor ζ on the two-dimensional coefficients [-]."""
    panels: int = Field(200, ge=10, le=100_000)
    """Elements along the leg."""


COURANT_LIMIT = 0.9
"""Largest stable (c_p + v) Δt / Δx of the explicit step.

Measured: elastic beds stay quiet up to 1.00 in the worst arrangement of particles tried and 1.10 in
most, soil up to 1.15; see tests/forward/plane."""

LONGEST_TRAVEL = {2: 0.1, 3: 0.5}
"""Cells that the leg may travel while the grid keeps its velocities, by dimensions [-]: the
particles' places on the grid are held meanwhile."""
COURANT_LIMIT_IN_SPACE = 0.75
"""As :data:`COURANT_LIMIT`, in three dimensions."""
_ONLY_IN_SPACE = {
    "relief.enabled": False,
    "numerics.contact": "surface",
    "numerics.transfer": "apic",
    "numerics.damping_order": "after_contact",
    "numerics.distortion": "particle",
    "numerics.cell_damping": 0.0,
    "numerics.stress_rate": "jaumann",
    "numerics.particle_volume": "fixed",
}
"""What the material point method in three dimensions can do of what it can in the plane."""

LEAST, LARGEST = 1e-15, 1e15
"""Sizes of numbers, in SI or degrees, that can be computed with."""


class Scenario(Strict):
    """A soil, a leg, a motion and the numerics that bring them together."""

    name: str = ""
    """Name of the scenario, for people; not part of the hash."""
    model: Literal["mpm", "rft"] = "mpm"
    """``mpm``: material point method; ``rft``: resistive force theory."""
    dimensions: Literal[2, 3] = 2
    """2: plane strain; 3: in space, with legs of their true width."""
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
                self._check_space()
            else:
                self._check_plane()
            self._check_domain()
            self._check_time_step()
            self._check_phases()
            self._check_every_bin_is_visited()
            self._check_leg_stays_inside()
            self._check_tip()
        else:
            self._check_resistive_bed()

    def _check_plane(self) -> None:
        if self.leg.shape in SOLID_SHAPES:
            raise ValueError(
                f"leg.shape = '{self.leg.shape}' is a body in space; set dimensions = 3, or a "
                f"shape of {', '.join(LEG_SHAPES)}"
            )
        for key, value in (
            ("bed.breadth", self.bed.breadth),
            ("soil.critical_friction_angle_deg", self.soil.critical_friction_angle_deg),
        ):
            if value is not None:
                raise ValueError(
                    f"{key} = {value:g}: plane strain does not know it; leave it out, or set "
                    "dimensions = 3"
                )
        if self.soil.is_compacted:
            raise ValueError(
                f"soil.dilation_angle_deg = {self.soil.dilation_angle_deg:g}: soil is compacted in "
                "three dimensions only; set it to 0, or set dimensions = 3"
            )
        if self.soil.yield_surface == "matsuoka_nakai":
            raise ValueError(
                "soil.yield_surface = 'matsuoka_nakai' is for three dimensions: set dimensions = "
                "3, or leave it out (soil that does not dilate has the same strength in the plane)"
            )
        if self.numerics.stiffness_damping > 0.0:
            raise ValueError(
                f"numerics.stiffness_damping = {self.numerics.stiffness_damping:g} is for three "
                "dimensions: set it to 0, or set dimensions = 3"
            )

    def _check_space(self) -> None:
        for key, known in _ONLY_IN_SPACE.items():
            section, option = key.split(".")
            value = getattr(getattr(self, section), option)
            if value != known:
                raise ValueError(
                    f"{key} = {json.dumps(value)} is for two dimensions only; in three set it to "
                    f"{json.dumps(known)}"
                )
        criterion = self.soil.yield_criterion
        softens = self.soil.softens
        if criterion == "paper" or (softens and criterion != "plane_strain"):
            some = "'plane_strain'" + ("" if softens else " or 'triaxial'")
            what = "soil that softens or is compacted has" if softens else "there is"
            raise ValueError(
                f"soil.yield_criterion = '{criterion}': in three dimensions {what} {some}; set that"
                + (", or leave critical_friction_angle_deg and ψ < 0 out" if softens else "")
            )
        if self.bed.breadth is None:
            raise ValueError(
                "dimensions = 3 needs bed.breadth, the extent of the box across the plane of "
                "motion; 0.2 m leaves the forces on a leg of 25 mm alone"
            )
        # A sphere is as wide as its chord is long.
        key = "chord" if self.leg.shape == "sphere" else "width"
        across = getattr(self.leg, key)
        if across > self.bed.breadth * (1.0 + 1e-9):
            raise ValueError(
                f"leg.{key} = {across:g} m does not fit between the flanks of the box, "
                f"bed.breadth = {self.bed.breadth:g} m; widen the box, or take a smaller leg"
            )

    def _check_resistive_bed(self) -> None:
        if self.leg.shape in SOLID_SHAPES:
            raise ValueError(
                f"leg.shape = '{self.leg.shape}': resistive force theory knows outlines only; set "
                f"a shape of {', '.join(LEG_SHAPES)}, or model = 'mpm'"
            )
        if self.bed.surcharge > 0.0:
            raise ValueError(
                f"bed.surcharge = {self.bed.surcharge:g} Pa: resistive force theory knows the "
                "soil's own weight only; set it to 0, or model = 'mpm'"
            )
        for name in ("soil_left", "soil_width", "breadth"):
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
            top = self.sped_up_leg_speed
            leg = (
                f", and a leg that speed_up = {self.numerics.speed_up:g} moves at {top:.3g} m/s"
                if top > 0.1 * self.soil.p_wave_speed
                else ""
            )
            raise ValueError(
                f"numerics.time_step = {self.numerics.time_step:g} s is above the CFL limit of "
                f"{limit:.3g} s for this grid, stiffness and density{leg}"
            )

    def _check_phases(self) -> None:
        travel = LONGEST_TRAVEL[self.dimensions]
        if self.travel_per_phase_cells > travel:
            longest = travel * self.numerics.cell_size / self.sped_up_leg_speed
            raise ValueError(
                f"numerics.remap_interval = {self.numerics.remap_interval:g} s lets the leg travel "
                f"more than {travel:g} cells while the grid keeps its velocities; at most "
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

    def _check_tip(self) -> None:
        if self.tip_inset == 0.0:
            return
        key = f"numerics.tip_inset_cells = {self.numerics.tip_inset_cells:g}"
        if self.leg.shape in ("sphere", "cylinder"):
            raise ValueError(
                f"{key}, but leg.shape = '{self.leg.shape}' has no tip; set tip_inset_cells = 0"
            )
        if self.tip_inset >= self.leg.length:
            raise ValueError(
                f"{key} is {self.tip_inset:g} m, no less than the leg's length of "
                f"{self.leg.length:g} m; lower it or refine the grid"
            )
        times = np.linspace(0.0, min(self.motion.duration, sys.float_info.max), 541)
        x, z = self.motion.poses(times).hip.T
        low, high = self.bed.soil_span
        in_soil = (z < self.bed.surface) & (x > low) & (x < high)
        if in_soil.any():
            raise ValueError(
                f"{key} draws in the tip alone, but the leg's other end, at the hip, comes as low "
                f"as {z[in_soil].min():g} m, into soil that reaches up to {self.bed.surface:g} m; "
                "raise motion.hip, or set tip_inset_cells = 0"
            )

    @property
    def mean_dilatation(self) -> bool:
        """Whether the stress follows the mean volumetric strain rate of a cell."""
        return self.numerics.dilatation == "cell"

    @property
    def mean_distortion(self) -> bool:
        """Whether the stress follows the mean distortion rate of a cell."""
        chosen = self.numerics.distortion
        return chosen == "cell" or (chosen == "auto" and self.soil.dilates)

    @property
    def cell_damping(self) -> float:
        """The damping of motion within cells that acts, as a share of ρ c Δx [-]."""
        left_out = self.numerics.distortion == "auto" and not self.mean_distortion
        return 0.0 if left_out else self.numerics.cell_damping

    @property
    def tip_inset(self) -> float:
        """How much of the leg's centre line contact leaves out at the tip [m]."""
        return self.numerics.tip_inset_cells * self.numerics.cell_size

    @property
    def sped_up_leg_speed(self) -> float:
        """Largest speed of any point of the leg, sped up [m/s]."""
        return self.numerics.speed_up * self.motion.top_speed(self.leg.reach())

    @property
    def travel_per_phase_cells(self) -> float:
        """By how many cells that point moves while the grid keeps its velocities [-]."""
        interval = self.numerics.steps_per_phase * self.numerics.time_step
        return interval * self.sped_up_leg_speed / self.numerics.cell_size

    @property
    def time_step_limit(self) -> float:
        """Largest stable time step of the material point method [s]."""
        speed = self.soil.p_wave_speed + self.sped_up_leg_speed
        limit = COURANT_LIMIT if self.dimensions == 2 else COURANT_LIMIT_IN_SPACE
        return limit * self.numerics.cell_size / speed

    @property
    def cells_across(self) -> int:
        """Cells across the plane of motion that are computed; 0 in plane strain."""
        breadth = self.bed.breadth
        if self.dimensions == 2 or breadth is None:
            return 0
        half = 0.5 if self.numerics.symmetry == "half" else 1.0
        return max(1, math.ceil(half * breadth / self.numerics.cell_size - 1e-6))

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

        Options of :data:`ADDED_LATER` count only where they change something.
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


def _numbers(content: Any, key: str = "") -> Iterator[tuple[str, float]]:
    """Dotted keys and values of all numbers that are not whole, those in lists too."""
    if isinstance(content, dict):
        for name, value in content.items():
            yield from _numbers(value, f"{key}.{name}" if key else name)
    elif isinstance(content, list | tuple):
        for value in content:
            yield from _numbers(value, key)
    elif isinstance(content, float):
        yield key, content


@functools.lru_cache(maxsize=64)
def _extent_of_path(motion: Motion, leg: Leg) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Least and largest x and z [m] that a leg covers; the cases of a library mostly share it."""
    times = np.linspace(0.0, min(motion.duration, sys.float_info.max), 541)
    line, margin = leg.extremities()
    points = motion.poses(times).placed(line)
    low, high = points.min(axis=(0, 1)) - margin, points.max(axis=(0, 1)) + margin
    return tuple(low.tolist()), tuple(high.tolist())


def _section(place: dict[str, Any], name: str) -> dict[str, Any]:
    """Section of a document; made, for the check to refuse, where there is none."""
    if not isinstance(place.get(name), dict):
        place[name] = {}
    return place[name]


def _is_entry(value: object, index: str) -> bool:
    """Whether an index in a dotted key names an entry of a list."""
    return isinstance(value, list) and index.isdecimal() and int(index) < len(value)
