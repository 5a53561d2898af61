"""Decks for LIGGGHTS, and what it writes.

LIGGGHTS (GPL) is run as a separate program; Debian's package ``liggghts`` has it. Contacts are
those of Hertz and Mindlin with tangential history, and rolling friction ``epsd2``.
"""

from __future__ import annotations

import itertools
import math
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.leg import Leg, frame_axes

DENSITY, YOUNGS, POISSON, RESTITUTION = 2500.0, 2.5e6, 0.3, 0.5
"""Of a grain [kg/m³], [Pa], [-], [-]. Soft, for long steps: overlaps are 1 % of a radius."""
SIZES = np.array([0.85, 0.925, 1.0, 1.075, 1.15])
"""Diameters over the mean, equal shares of the mass [-]."""
RAYLEIGH = 0.25
"""Time step over Rayleigh's time of the smallest grain [-]."""
GRAVITY = 9.81
POUR = 0.35
"""Volume fraction at which grains are let fall [-]."""


@dataclass(frozen=True)
class Soil:
    """Grains and how they are packed."""

    name: str
    sliding: float
    rolling: float
    settled: float
    diameter_mm: float
    leg_friction: float
    legs: tuple[str, ...]
    seeds: tuple[int, ...]

    @property
    def diameter(self) -> float:
        """Mean diameter [m]."""
        return 1e-3 * self.diameter_mm

    @property
    def time_step(self) -> float:
        """[s]."""
        radius = 0.5 * self.diameter * SIZES.min()
        shear = YOUNGS / (2.0 * (1.0 + POISSON))
        rayleigh = math.pi * radius * math.sqrt(DENSITY / shear) / (0.1631 * POISSON + 0.8766)
        return RAYLEIGH * rayleigh


def contacts(soil: Soil, sliding: float) -> str:
    """Material and integrator; type 1 are grains and walls alike, type 2 is the leg."""
    wall = soil.leg_friction
    return f"""
fix m1 all property/global youngsModulus peratomtype {YOUNGS} {YOUNGS}
fix m2 all property/global poissonsRatio peratomtype {POISSON} {POISSON}
fix m3 all property/global coefficientRestitution peratomtypepair 2 &
  {RESTITUTION} {RESTITUTION} {RESTITUTION} {RESTITUTION}
fix m4 all property/global coefficientFriction peratomtypepair 2 {sliding} {wall} {wall} {wall}
fix m5 all property/global coefficientRollingFriction peratomtypepair 2 &
  {soil.rolling} {soil.rolling} {soil.rolling} {soil.rolling}
pair_style gran model hertz tangential history rolling_friction epsd2
pair_coeff * *
timestep {soil.time_step:.4g}
"""


WALL = "wall/gran model hertz tangential history rolling_friction epsd2"


def next_prime(number: int) -> int:
    """The smallest prime not below a number."""
    while any(number % divisor == 0 for divisor in range(2, math.isqrt(number) + 1)):
        number += 1
    return number


def header(soil: Soil) -> str:
    """First lines of a deck."""
    return f"""units si
atom_style granular
atom_modify map array
boundary f p f
newton off
soft_particles yes
communicate single vel yes
processors 1 1 1
neighbor {0.2 * soil.diameter:.4g} bin
neigh_modify delay 0
"""


def ground(box: tuple[float, ...]) -> str:
    """Weight, floor and end walls of a box [m]; across, it is periodic."""
    x0, x1, *_ = box
    return f"""fix integrate all nve/sphere
fix gravity all gravity {GRAVITY} vector 0 0 -1
fix floor all {WALL} primitive type 1 zplane 0
fix west all {WALL} primitive type 1 xplane {x0}
fix east all {WALL} primitive type 1 xplane {x1}
"""


def pour(soil: Soil, seed: int, box: tuple[float, ...], thickness: float) -> str:
    """Grains that fall into a box [m] and settle to a bed about so thick [m]."""
    x0, x1, y0, y1, top = box
    # The engine takes primes above 10,000 for seeds.
    sizing, placing = (next_prime(20_011 + 1_000 * seed + 500 * i) for i in range(2))
    tall = thickness * 0.58 / POUR
    templates, shares = [], []
    primes = (15485863, 32452843, 49979687, 67867967, 86028121)
    for i, (size, prime) in enumerate(zip(SIZES, primes, strict=True)):
        radius = 0.5 * soil.diameter * size
        templates.append(
            f"fix p{i} all particletemplate/sphere {prime} atom_type 1 density constant {DENSITY} "
            f"radius constant {radius:.6g}"
        )
        shares.append(f"p{i} {1.0 / len(SIZES)}")
    fall = math.sqrt(2.0 * tall / GRAVITY)
    steps = round((fall + 0.35 + 8.0 * math.sqrt(thickness / GRAVITY)) / soil.time_step)
    return (
        header(soil)
        + f"""region box block {x0} {x1} {y0} {y1} -0.001 {top} units box
create_box 2 box
"""
        + contacts(soil, soil.settled)
        + "\n".join(templates)
        + f"""
fix pdd all particledistribution/discrete {sizing} {len(SIZES)} {" ".join(shares)}
region column block {x0} {x1} {y0} {y1} 0 {tall:.5g} units box
fix ins all insert/pack seed {placing} distributiontemplate pdd maxattempt 200 &
  insert_every once overlapcheck yes all_in yes vel uniform -0.1 0.1 -0.1 0.1 -0.3 0.0 &
  region column volumefraction_region {POUR}
{ground(box)}thermo 5000
thermo_style custom step atoms ke cpu
run {steps}
unfix ins
write_restart bed.restart
dump last all custom 1 bed.dump id x y z radius
run 0
"""
    )


def run(deck: str, folder: Path, name: str) -> None:
    """Run a deck in a folder; raises RuntimeError with the log's end if the engine fails."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.in").write_text(deck)
    with (folder / f"{name}.out").open("w") as out:
        code = subprocess.run(
            ["liggghts", "-in", f"{name}.in", "-log", f"{name}.log"],
            cwd=folder, stdout=out, stderr=subprocess.STDOUT, check=False,
        ).returncode  # fmt: skip
    if code:
        tail = (folder / f"{name}.out").read_text()[-600:]
        raise RuntimeError(f"{folder / name}.in: LIGGGHTS failed: {tail}")


def dump(path: Path) -> FloatArray:
    """Grains of a dump's last frame: id, x, y, z, radius, shape [grain, 5]."""
    lines = path.read_text().splitlines()
    start = max(i for i, line in enumerate(lines) if line.startswith("ITEM: ATOMS"))
    return np.array([line.split() for line in lines[start + 1 :]], dtype=float)


def layering(grains: FloatArray, area: float) -> tuple[float, float]:
    """Height of the mass-equivalent surface [m] and volume fraction of the middle [-]."""
    z, radius = grains[:, 3], grains[:, 4]
    top = np.quantile(z, 0.98)
    low, high = 0.25 * top, 0.8 * top

    def above(level: float) -> float:
        """Volume of grains above a level [m³]."""
        h = np.clip(z + radius - level, 0.0, 2.0 * radius)
        return float((math.pi * h**2 * (radius - h / 3.0)).sum())

    fraction = (above(low) - above(high)) / (area * (high - low))
    return low + above(low) / (area * fraction), fraction


def leg_mesh(leg: Leg, theta: float, hip: tuple[float, float], path: Path) -> None:
    """Write a leg at an angle [rad] with its hip at (x, z) [m] as STL, triangles of 6 mm."""
    panels = 12 if leg.shape == "straight" else 16
    along, motion = frame_axes(theta)
    corners = leg.outline(panels)
    ring = corners[:, :1] * along + corners[:, 1:] * motion + np.array(hip)
    n, near = len(ring), panels + panels // 3 + 1
    sections = np.linspace(-0.5, 0.5, 5) * leg.width
    triangles = []
    for y0, y1 in itertools.pairwise(sections):
        for (ax, az), (bx, bz) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            a, b, c, d = (ax, y0, az), (bx, y0, bz), (bx, y1, bz), (ax, y1, az)
            triangles += [(a, b, c), (a, c, d)]
    # The outline runs along one long edge, round the tip, back along the other and round the hip.
    one, other = np.arange(panels), np.arange(near, near + panels)[::-1]
    faces = [[one[i], one[i + 1], other[i + 1], other[i]] for i in range(panels - 1)]
    faces.append([one[-1], *range(panels, near), other[-1]])
    faces.append([other[0], *range(near + panels, n), one[0]])
    for y in (sections[0], sections[-1]):
        for face in faces:
            at = [(ring[i, 0], y, ring[i, 1]) for i in face]
            triangles += [(at[0], b, c) for b, c in itertools.pairwise(at[1:])]
    lines = ["solid leg"]
    for a, b, c in triangles:
        normal = np.cross(np.subtract(b, a), np.subtract(c, a))
        normal = normal / np.linalg.norm(normal)
        lines.append("facet normal {:.9g} {:.9g} {:.9g}".format(*normal))
        lines.append("outer loop")
        lines += ["vertex {:.9g} {:.9g} {:.9g}".format(*point) for point in (a, b, c)]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid leg", ""]))


def stirring(
    soil: Soil, box: tuple[float, ...], hip: tuple[float, float], *, start_deg: float,
    stop_deg: float, rate: float, every_deg: float,
) -> str:  # fmt: skip
    """A leg that turns through the bed; means of its force and torque about the hip."""
    steps = round(math.radians(stop_deg - start_deg) / rate / soil.time_step)
    every = round(math.radians(every_deg) / rate / soil.time_step)
    return (
        header(soil)
        + "read_restart bed.restart\n"
        + contacts(soil, soil.sliding)
        + f"""
{ground(box)}fix leg all mesh/surface/stress file leg.stl type 2 reference_point {hip[0]} 0 {hip[1]}
fix touch all {WALL} mesh n_meshes 1 meshes leg
fix turn all move/mesh mesh leg rotate origin {hip[0]} 0 {hip[1]} axis 0 1 0 &
  period {2.0 * math.pi / rate:.8g}
fix mean all ave/time 1 {every} {every} f_leg[1] f_leg[2] f_leg[3] f_leg[5] file leg.txt
thermo 5000
thermo_style custom step atoms ke cpu
run {steps}
"""
    )
