"""The apparatus: a rigid leg that rotates about a hip above level soil, or a body pressed into it.

Slow, dry soil under gravity has no length of its own, so that

    F = ρ g L³ f(θ; φ, μ, w/L, h/L, t/L, curvature)

with L from the hip to the outermost tip, the width w, the thickness t and the height of the hip h.
Legs of one shape and one set of ratios are therefore simulated once, at one length.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Self, cast

import numpy as np
from pydantic import Field, model_validator

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.bodies import OUTLINES, TOOLS, ToolShape
from terraphi.experiment.documents import Strict, parse_toml, refuse
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import number_with_sd, plain_number
from terraphi.experiment.leg import Leg, RotatingShape, one_of
from terraphi.experiment.motion import placed
from terraphi.experiment.priors import FRICTION, HIP_HEIGHT_SD_MM
from terraphi.experiment.units import GRAVITY

if TYPE_CHECKING:
    from terraphi.experiment.scenario import Scenario

SIMULATED_LENGTH = 0.0762
"""Length of the leg in simulations [m]: that of Li et al. (2013)."""
SLENDER = 5.0
"""Longest side of a rectangular plate over the other [-]: shape factors were compared up to it."""
CELLS_ACROSS, CELLS_DEEP = 5.08, 11.24
"""Cells in the width and in the depth of the leg [-]: those of ``sand3d`` with Li's leg."""
COARSEST, FINEST = 1.0 / 12.0, 1.0 / 20.0
"""Bounds of the cell over the length [-]; finer ones take hours."""
BESIDE, BELOW, ASIDE = 1.2, 1.15, 1.6
"""Soil before and behind, below, and to each side of what the leg reaches, in depths [-]: that of
``sand3d``, whose bed is the smallest that leaves the forces alone."""
THETA_DEG = np.arange(-175.0, 91.0)
"""Angles at which a leg may be near the soil [deg]."""
AIR_MARGIN_DEG = 5.0
"""Angle beyond the last touch of level soil from which on a leg is taken to be in air [deg]."""
BEFORE_DEG, AFTER_DEG, STOP_DEG = 20.0, 10.0, 90.0
"""Angles simulated before the first contact and after the last, and the last of all [deg]."""


class Ratios(NamedTuple):
    """What the forces on a leg depend on besides the soil and its friction."""

    width: float
    """w / L [-]."""
    hip_height: float
    """h / L [-]."""
    thickness: float
    """t / L [-]."""


def with_sds(**pairs: tuple[str, str]) -> Any:
    """Validator that reads numbers as ``35±1``, by the key of the SD and an example of each."""

    def parse(_cls: Any, content: Any) -> Any:
        for key, (sd_key, example) in pairs.items() if isinstance(content, dict) else ():
            text = content.get(key)
            if isinstance(text, str):
                try:
                    mean, sd = number_with_sd(text)
                except ValueError:
                    raise ValueError(f"{key} = '{text}'; give it as {example}") from None
                content = {**content, key: mean, **({} if sd is None else {sd_key: sd})}
        return content

    return model_validator(mode="before")(cast("Any", classmethod(parse)))


class Rig(Strict):
    """A leg and the height of its hip, in millimeters as people measure them.

    Examples
    --------
    >>> rig = terraphi.Rig(
    ...     leg="straight", length_mm=110, width_mm=40, thickness_mm=8, hip_height_mm="35±1"
    ... )
    >>> print(rig)
    straight leg 110 × 40 × 8 mm, hip 35 mm above the soil
    """

    leg: RotatingShape
    """``straight``; ``c``, a semicircle that bulges where it moves; ``reversed_c``, its mirror."""
    length_mm: float = Field(gt=0, le=10_000)
    """From the hip to the outermost tip [mm]; 10 and less are centimeters or meters."""
    width_mm: float = Field(gt=0, le=10_000)
    """Extent across the plane of motion [mm]."""
    thickness_mm: float = Field(gt=0, le=1000)
    """Thickness of the leg [mm]."""
    hip_height_mm: float = Field(ge=0, le=10_000)
    """Height of the hip above the level soil [mm]; with its standard deviation as ``"35±1"``."""
    hip_height_sd_mm: float = Field(HIP_HEIGHT_SD_MM, ge=0, le=1000)
    """Standard deviation of that height [mm]."""
    leg_friction: float = Field(FRICTION.mean, ge=0, le=2)
    """Coulomb friction between leg and soil [-]; with its standard deviation as ``"0.35±0.1"``."""
    leg_friction_sd: float = Field(FRICTION.sd, ge=0, le=1)
    """Standard deviation of that friction [-]."""

    _parse_sds = with_sds(hip_height_mm=("hip_height_sd_mm", "35±1"),
                          leg_friction=("leg_friction_sd", "0.35±0.05"))  # fmt: skip

    @model_validator(mode="after")
    def _reaches_soil(self) -> Self:
        length, thickness, height = self.length_mm, self.thickness_mm, self.hip_height_mm
        refuse(
            {
                f"length_mm = {length:g} looks like meters or centimeters; give mm": length <= 10.0,
                f"thickness_mm = {thickness:g} is not below half of length_mm = {length:g}; give "
                "all sizes in mm": 2.0 * thickness >= length,
                f"hip_height_mm = {height:g}: a leg of {length:g} mm does not reach the soil": (
                    height >= length
                ),
            }
        )
        return self

    @property
    def length(self) -> float:
        """From the hip to the outermost tip [m]."""
        return 1e-3 * self.length_mm

    @property
    def sizes_mm(self) -> dict[str, float]:
        """Length, width, thickness and height of the hip by their keys [mm]."""
        return {f"{name}_mm": getattr(self, f"{name}_mm") for name in SIZES}

    @property
    def ratios(self) -> Ratios:
        """Lengths over that of the leg [-]."""
        length = self.length_mm
        return Ratios(
            self.width_mm / length, self.hip_height_mm / length, self.thickness_mm / length
        )

    def air_deg(self) -> tuple[float, float]:
        """Angles below and above which the leg is clear of the soil [deg]."""
        leg = leg_of(self.leg, self.ratios, self.length)
        first, last = contact_deg(leg, 1e-3 * self.hip_height_mm)
        return first - AIR_MARGIN_DEG, last + AIR_MARGIN_DEG

    def __str__(self) -> str:
        """Sizes in one line, such as ``straight leg 110 × 40 × 8 mm, hip 35 mm above the soil``."""
        sizes = " × ".join(
            f"{round(v, 1):g}" for v in (self.length_mm, self.width_mm, self.thickness_mm)
        )
        height = f"hip {round(self.hip_height_mm, 1):g} mm above the soil"
        return f"{OUTLINES[self.leg].label} {sizes} mm, {height}"

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> Self | None:
        """The rig of a simulation; ``None`` if that has no leg that rotates.

        Legs of two dimensions and of resistive force theory end at their chord; in three dimensions
        the material point method adds their round end.
        """
        leg, motion = scenario.leg, scenario.motion
        if motion.kind != "rotation" or leg.shape not in OUTLINES:
            return None
        ends_round = scenario.model == "mpm" and scenario.dimensions == 3
        length = leg.reach() if ends_round else leg.chord
        return cls(
            leg=leg.shape,
            length_mm=1e3 * length,
            width_mm=1e3 * leg.width,
            thickness_mm=2e3 * leg.half_thickness,
            hip_height_mm=min(max(0.0, 1e3 * scenario.hip_height), 999.0 * length),
            hip_height_sd_mm=0.0,
            leg_friction=leg.friction,
            leg_friction_sd=0.0,
        )

    @classmethod
    def of(cls, rig: Any, leg: str | None = None) -> Self:
        """A rig from whatever people give: a rig, its keys, a TOML file, or ``li2013``.

        Parameters
        ----------
        rig
            ``li2013`` is that of Li et al. (2013).
        leg
            Shape of the leg, in place of that of the rig.

        Raises
        ------
        InputError
            If the file is missing, not TOML, or a value cannot be.
        """
        if not isinstance(rig, Rig | Mapping | str | Path):
            raise InputError(f"rig of type {type(rig).__name__}; give a Rig, its keys or a file")
        if isinstance(rig, str | Path) and str(rig) != "li2013":
            rig = parse_toml(Path(rig), cls)
        if isinstance(rig, Rig):
            rig = rig.model_dump()
        if isinstance(rig, Mapping):
            return cls(**{**rig, **({} if leg is None else {"leg": leg})})
        if leg is None:
            raise InputError(f"rig li2013 lacks its leg; give --leg {', '.join(OUTLINES)}")
        return cls(leg=leg, **LI2013)


LI2013: dict[str, Any] = {
    "length_mm": 76.2,
    "width_mm": 25.4,
    "thickness_mm": 6.4,
    "hip_height_mm": 20.0,
}
"""Sizes of the rig of Li et al. (2013), supplement [mm]."""
SIZES = ("length", "width", "thickness", "hip_height")
"""Options that together with the leg make a rig [mm]."""


def with_rig(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options with a rig in place of the sizes that are given one by one, if any are.

    A friction without a rig is that of tools, ``friction``.

    Parameters
    ----------
    options
        By name; those of :data:`SIZES` as text or numbers [mm], ``leg_friction`` as both.

    Raises
    ------
    InputError
        If some of the sizes or the leg are missing, or there is a rig as well.
    """
    remaining = {key: v for key, v in options.items() if key not in (*SIZES, "leg_friction")}
    friction = {"leg_friction": f} if (f := options.get("leg_friction")) is not None else {}
    sizes = {key: options[key] for key in SIZES if options.get(key) is not None}
    if not sizes:
        if not friction:
            return remaining
        if remaining.get("rig") is None:
            if {"tool", "forces"} & {*options}:
                return {**remaining, "friction": f}
            raise InputError("--friction goes with a rig; add its sizes, or --rig li2013")
        rig = Rig.of(remaining["rig"], remaining.get("leg")).model_dump(exclude={"leg_friction_sd"})
        return {**remaining, "rig": Rig(**{**rig, **friction})}
    flags = {key: f"--{key.replace('_', '-')}" for key in ("leg", *SIZES)}
    lacking = [flag for key, flag in flags.items() if options.get(key) is None]
    if remaining.get("rig") is not None:
        raise InputError(f"--rig has all sizes; leave out {flags[next(iter(sizes))]}")
    if lacking:
        raise InputError(f"the sizes of a rig go together; add {', '.join(lacking)}")
    try:
        numbers = {
            f"{key}_mm": value if key == "hip_height" else plain_number(str(value))
            for key, value in sizes.items()
        }
    except ValueError as error:
        raise InputError(f"sizes of the rig: {error}; give millimeters") from None
    return {**remaining, "rig": Rig(leg=options["leg"], **numbers, **friction)}


class Tool(Strict):
    """A body pressed in or a wheel, of a shape of :data:`~terraphi.experiment.bodies.TOOLS`."""

    leg: Annotated[str, *one_of(TOOLS)]
    """Its shape; named as that of a rig, so that answers treat both alike."""
    size_mm: tuple[float, ...] = Field(min_length=1)
    """Diameter, or both sides; of a wheel diameter and width, number and height of lugs [mm]."""
    friction: float = Field(FRICTION.mean, ge=0.05, le=0.65)
    """Coulomb friction between tool and soil [-]; with its standard deviation as ``"0.35±0.1"``."""
    friction_sd: float = Field(FRICTION.sd, ge=0, le=1)
    """Standard deviation of that friction [-]."""

    _parse_sds = with_sds(friction=("friction_sd", "0.35±0.05"))

    @classmethod
    def of(cls, text: str | Self) -> Self:
        """Parse ``plate:151``, ``ball:44``, ``wheel:314x165+lugs:30x10``; raises InputError."""
        if isinstance(text, cls):
            return text
        keyword, _, numbers = str(text).strip().lower().partition(":")
        try:
            numbers = re.sub(r"\+(lugs:)?", "x", numbers) if keyword == "wheel" else numbers
            sizes = tuple(plain_number(number) for number in re.split("[x×]", numbers))
        except ValueError:
            sizes = ()
        shapes = [name for name, shape in TOOLS.items()
                  if (shape.keyword, len(shape.sizes)) == (keyword, len(sizes))]  # fmt: skip
        if not shapes or not all(1.0 <= size <= 5000.0 for size in sizes):
            forms = " or ".join(shape.form for shape in TOOLS.values())
            raise InputError(f"tool '{text}'; give {forms}, such as plate:151, of 1 to 5000 mm")
        if keyword == "wheel":
            rim, _, *lugs = sizes
            if lugs and (lugs[0] % 1.0 or not 3 <= lugs[0] <= 200 or lugs[1] > 0.25 * rim):
                form = f"number, 3 to 200, and height, to {0.25 * rim:g} mm, of lugs"
                raise InputError(f"tool '{text}': give {form} after +lugs:")
        elif max(sizes) > SLENDER * min(sizes):
            raise InputError(f"tool '{text}': law foot is for sides up to {SLENDER:g} to 1")
        return cls(leg=shapes[0], size_mm=sizes)

    @property
    def shape(self) -> ToolShape:
        """What the force on it is computed by."""
        return TOOLS[self.leg]

    @property
    def radius(self) -> float:
        """Radius of the disc or ball that bears as it does, but for :attr:`factor` [m].

        Of a wheel that to the tips of its lugs.
        """
        return 1e-3 * self.shape.radius(*self.size_mm)

    @property
    def factor(self) -> float:
        """Force over that on the disc or ball of :attr:`radius` [-]."""
        return self.shape.factor(*self.size_mm)

    @property
    def sizes_mm(self) -> dict[str, float]:
        """Nothing of what a rig has."""
        return {}

    def on(self, friction: float | str | None) -> Self:
        """The tool with a friction, unless that is ``None``."""
        if friction is None:
            return self
        given = self.model_dump(exclude={"friction", "friction_sd"})
        return type(self)(**given, friction=friction)

    def __str__(self) -> str:
        """Shape and size, such as ``disc 151 mm``."""
        return f"{self.leg} {' × '.join(f'{size:g}' for size in self.size_mm)} mm"


def rounded(length: float) -> float:
    """A length to the micrometer [m], so that every processor makes the same scenario."""
    return round(float(length), 6)


def leg_of(shape: RotatingShape, ratios: Ratios, length: float) -> Leg:
    """A leg of some length from the hip to the outermost tip [m]."""
    thickness = ratios.thickness * length
    return Leg(
        shape=shape,
        chord=rounded(length - 0.5 * thickness),
        half_thickness=rounded(0.5 * thickness),
        width=rounded(ratios.width * length),
    )


def swept(leg: Leg, hip_height: float, theta_deg: FloatArray) -> FloatArray:
    """Outline (x, z) [m] of a leg at some angles, the soil's surface at z = 0 below the hip.

    Shape [theta, corner, 2].
    """
    return placed(leg.outline(), np.array([0.0, hip_height]), np.radians(theta_deg))


@functools.lru_cache(maxsize=32)
def contact_deg(leg: Leg, hip_height: float) -> tuple[float, float]:
    """First and last angle at which a leg reaches into level soil [deg], to a degree.

    Of a leg that never does, no angle: inf and -inf.
    """
    theta = np.arange(-180.0, 181.0)
    touching = theta[(swept(leg, hip_height, theta)[..., 1] < 0.0).any(axis=1)]
    return float(touching.min(initial=np.inf)), float(touching.max(initial=-np.inf))


def similar_scenario(
    leg: RotatingShape,
    ratios: Ratios,
    *,
    friction_angle_deg: float,
    leg_friction: float,
    cohesion: float = 0.0,
    cells: float = 1.0,
    bed: float = 1.0,
    seed: int = 0,
) -> Scenario:
    """A simulation of a rig with a leg of :data:`SIMULATED_LENGTH`.

    Numerics are those of ``sand3d`` in proportion to the cell, which is a fifth of the width or an
    eleventh of the depth, whichever is less. Only the angles at which the leg is near the soil are
    simulated.

    Parameters
    ----------
    leg, ratios
        The rig.
    friction_angle_deg
        φ in plane strain [deg].
    leg_friction
        μ between leg and soil [-].
    cohesion
        c / (ρ g L) [-].
    cells, bed
        Size of the cell, and soil around the leg, over those of the rule [-].
    seed
        Of the particles.

    Raises
    ------
    InputError
        If a number is outside what can be simulated.
    """
    from terraphi.experiment.scenario import Scenario

    base, length = Scenario.load("sand3d"), SIMULATED_LENGTH
    height = ratios.hip_height * length
    body = leg_of(leg, ratios, length).model_copy(update={"friction": leg_friction})
    corners = swept(body, height, THETA_DEG)
    inside = corners[..., 1] < 0.0
    depth, highest = -corners[..., 1].min(), corners[..., 1].max()
    reach = abs(corners[..., 0][inside]).max()
    first, last = contact_deg(body, height)
    start = max(-175.0, 5.0 * math.floor((first - BEFORE_DEG) / 5.0))
    stop = min(STOP_DEG, 5.0 * math.ceil((last + AFTER_DEG) / 5.0))

    rule = min(body.width / CELLS_ACROSS, depth / CELLS_DEEP)
    cell = rounded(cells * min(max(rule, FINEST * length), COARSEST * length))
    scale = cell / base.numerics.cell_size
    soil, below = 2.0 * (reach + bed * BESIDE * depth), (1.0 + bed * BELOW) * depth
    wall = 2.0 * cell
    # The box holds the bed, and the leg that stands up before it enters.
    top = below + height + highest + 2.0 * cell
    count = math.ceil((max(soil, top) + 2.0 * wall) / cell)
    return base.replace(
        f"leg {leg}",
        **{
            "name": f"{leg}-{friction_angle_deg:g}",
            "soil.friction_angle_deg": friction_angle_deg,
            "soil.cohesion": round(cohesion * base.soil.density * GRAVITY * length, 3),
            "leg": body.model_dump(),
            "motion.hip": [rounded(wall + 0.5 * soil), rounded(wall + below + height)],
            "motion.start_deg": start,
            "motion.stop_deg": stop,
            "bed.left": rounded(wall),
            "bed.floor": rounded(wall),
            "bed.width": rounded(soil),
            "bed.height": rounded(below),
            "bed.breadth": rounded(body.width + 2.0 * bed * ASIDE * depth),
            "numerics.domain": rounded(count * cell),
            "numerics.cells": count,
            "numerics.time_step": float(f"{base.numerics.time_step * scale:.4g}"),
            "numerics.remap_interval": float(f"{base.numerics.remap_interval * scale:.4g}"),
            "numerics.seed": seed,
        },
    )
