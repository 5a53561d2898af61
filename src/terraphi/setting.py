"""The parts of a scenario beside soil, leg and motion: bed, relief, discretisation, RFT.

An option that is added later says in :data:`ADDED_LATER` which value means what was there before.
A scenario that leaves it there keeps its hash, and what was simulated is not simulated again.
"""

from __future__ import annotations

import math
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

GRAVITY = 9.81
"""Acceleration of gravity g [m/s²]."""
ADDED_LATER: dict[str, Any] = {
    "bed.soil_left": None,
    "bed.soil_width": None,
    "bed.surcharge": 0.0,
    "bed.gravity": GRAVITY,
    "numerics.transfer": "apic",
    "numerics.damping_order": "after_contact",
    "numerics.contact": "nodes",
    "numerics.remap_interval": 0.0,
    "numerics.dilatation": "particle",
    "numerics.gradient": "mls",
    "numerics.stress_rate": "jaumann",
}
"""Dotted key to the value that leaves a scenario as it was before the option existed."""
PAPER_DAMPING_RATE = -math.log(0.997) / 8e-6
"""The paper multiplies grid velocities by 0.997 every 8 µs: a decay rate of 375.6 1/s."""


class Section(BaseModel):
    """Frozen, strict and finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Bed(Section):
    """The box of soil; its walls are fixed in space whatever the grid.

    Attributes
    ----------
    left, floor
        Position of the left wall x and of the floor z [m].
    width, height
        Extent of the box x and of the soil z [m]; the right wall stands at left + width.
    floor_friction
        ``rough``: soil that presses on the floor sticks; ``smooth``: it slips freely. The side
        walls always let soil slip.
    soil_left, soil_width
        Where the soil begins, x, and how far it reaches [m]; ``None``: from the left wall, and
        to the right one.
    surcharge
        Pressure on the free surface [Pa]: dead weight that the uppermost particles carry.
    gravity
        Acceleration of gravity g [m/s²].
    """

    left: float = Field(0.005, ge=0)
    floor: float = Field(0.005, ge=0)
    width: float = Field(0.290, gt=0)
    height: float = Field(0.165, gt=0)
    floor_friction: Literal["rough", "smooth"] = "rough"
    soil_left: float | None = Field(None, ge=0)
    soil_width: float | None = Field(None, gt=0)
    surcharge: float = Field(0.0, ge=0)
    gravity: float = Field(GRAVITY, ge=0)

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


class Relief(Section):
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


class Numerics(Section):
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
        Time step Δt [s], below the CFL limit.
    speed_up
        Factor k [-]: the motion runs k times faster, and the damping rate is divided by k, so
        that its drag on the soil stays the same.
    damping_rate
        Decay rate of grid velocities [1/s], a drag on the soil; 0: none.
    damping_order
        Whether grid velocities decay ``after_contact`` with leg and walls or ``before_contact``.
    transfer
        What particles keep of the grid's velocities: ``apic``, value and gradient; ``pic``, the
        value alone, whose smoothing at every step acts like a viscosity.
    contact
        ``nodes``: the nodes of the grid near the leg take its velocity; ``surface``: the material
        points press on its true surface; ``unbalanced``: near nodes as in the public prototype of
        Xu & Wang, which counts more force than it applies (``unbalanced_contact.py``).
    contact_band_cells
        Nodes closer to the leg than this many cells are in contact [-].
    remap_interval
        For how long the grid keeps its velocities before it takes them from the particles anew [s],
        rounded to steps; 0: it does so at every step.
    dilatation
        Volumetric strain rate that the stress follows: ``particle``, that at each particle;
        ``cell``: their mean over a cell (B-bar; Hughes, 1980, doi 10.1002/nme.1620150914), without
        which plastic flow at constant volume locks. Not for soil that dilates: what one particle of
        a cell dilates, its neighbours would have to give back, and the soil gets stiffer instead.
    gradient
        Velocity gradient that the stress follows: ``mls``, by moving least squares, as the transfer
        has it; ``spline``, that of the interpolated velocity itself. They differ where the velocity
        is curved: next to the edge of a plate ``mls`` is the stiffer.
    stress_rate
        How stress turns with the soil: ``jaumann``, with its spin; ``none``, not at all, as in the
        public prototype of Xu & Wang.
    particle_volume
        Volume of a particle: ``fixed``, that at the start, V₀; ``updated``, J V₀ by the
        deformation's determinant J.
    """

    domain: float = Field(0.300, gt=0)
    cells: int = Field(128, ge=8, le=4096)
    particles_per_cell_side: int = Field(2, ge=1, le=8)
    particle_jitter: float = Field(1.0, ge=0, le=1)
    seed: int = Field(0, ge=0)
    time_step: float = Field(8e-6, gt=0)
    speed_up: float = Field(1.0, gt=0)
    damping_rate: float = Field(PAPER_DAMPING_RATE, ge=0)
    damping_order: Literal["after_contact", "before_contact"] = "after_contact"
    transfer: Literal["apic", "pic"] = "apic"
    contact: Literal["nodes", "surface", "unbalanced"] = "nodes"
    contact_band_cells: float = Field(2.0, ge=0)
    remap_interval: float = Field(0.0, ge=0)
    dilatation: Literal["particle", "cell"] = "particle"
    gradient: Literal["mls", "spline"] = "mls"
    stress_rate: Literal["jaumann", "none"] = "jaumann"
    particle_volume: Literal["fixed", "updated"] = "fixed"

    @model_validator(mode="after")
    def _phases_where_needed(self) -> Self:
        for name, value, usual in (
            ("contact", self.contact, ("nodes", "unbalanced")),
            ("dilatation", self.dilatation, ("particle",)),
            ("gradient", self.gradient, ("mls",)),
        ):
            if value not in usual and self.remap_interval == 0.0:
                raise ValueError(
                    f"{name} = '{value}' needs a grid that keeps its velocities for a while; "
                    "set remap_interval above 0, as to 20 time steps"
                )
        if self.contact == "surface" and self.particles_per_cell_side > 3:
            raise ValueError(
                f"particles_per_cell_side = {self.particles_per_cell_side} makes the penalty of "
                "contact = 'surface' too stiff for a particle's mass; at most 3 are stable"
            )
        if self.contact == "unbalanced" and self.remap_interval > 0.0:
            raise ValueError(
                "contact = 'unbalanced' counts its force where the grid takes new velocities at "
                "every step; set remap_interval = 0, or contact = 'nodes'"
            )
        if self.transfer == "pic" and self.remap_interval > 0.0:
            raise ValueError(
                "transfer = 'pic' is one of every step; set remap_interval = 0, or transfer = "
                "'apic'"
            )
        return self

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


class Resistive(Section):
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
    panels: int = Field(200, ge=10, le=100_000)
