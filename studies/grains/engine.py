"""Decks for LIGGGHTS, and what it writes.

LIGGGHTS (GPL) is run as a separate program; Debian's package ``liggghts`` has it. Contacts are
those of Hertz and Mindlin with tangential history, and rolling friction ``epsd2``. Grains are
spheres, or clumps: rigid spheres that overlap, whose mass and inertia LIGGGHTS takes of the union.
"""

from __future__ import annotations

import functools
import itertools
import math
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.leg import Leg, frame_axes

DENSITY, YOUNGS, POISSON, RESTITUTION = 2500.0, 2.5e6, 0.3, 0.5
"""Of a grain [kg/m³], [Pa], [-], [-]. Soft, for long steps: overlaps are 1 % of a radius."""
SPREAD = 0.15
"""Diameters are uniform within this share of the mean, either side, if a soil has no other [-]."""
RAYLEIGH = 0.25
"""Time step over Rayleigh's time of the smallest grain [-]. With 0.4 a poured bed trembles, and is
as dense as one without friction."""
GRAVITY = 9.81
LIQUID, VISCOSITY, REACH = 1.0, 1e-3, 1.1
"""Liquid on damp grains [% of their volume], its viscosity [Pa s], and distance of centers over the
sum of radii up to which bridges are sought [-]; they break at a gap of a sixth of a radius."""
ROOM = 0.2
"""Height above grains that are let fall [m], in which a wheel of 0.2 m has room."""
SIZES = 5
"""Sizes of clumps, evenly spread: LIGGGHTS has one of each template."""
SPARSE = 0.2
"""Volume fraction of clumps as they are let fall [-]."""
EDGE = 0.75
"""Half the distance of a clump's neighbouring spheres, over their radius [-]."""
CLUMPS = {
    "dimer of aspect 1.5": [(-0.5, 0.0, 0.0), (0.5, 0.0, 0.0)],
    "dimer of aspect 1.25": [(-0.25, 0.0, 0.0), (0.25, 0.0, 0.0)],
    "tetrahedron of four": [
        (EDGE * x / math.sqrt(2.0), EDGE * y / math.sqrt(2.0), EDGE * x * y / math.sqrt(2.0))
        for x in (-1, 1) for y in (-1, 1)
    ],
    "flat square of four": [(EDGE * x, EDGE * y, 0.0) for x in (-1, 1) for y in (-1, 1)],
    "cube of eight": [
        (EDGE * x, EDGE * y, EDGE * z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)
    ],
}  # fmt: skip
"""Centers of the spheres of a clump over their radius."""
POINTS, RIM, DISC, PANELS = 500, 32, 0.006, 96
"""Corners of a ball's mesh and of a disc's rim, a disc's thickness [m], panels of a wheel's rim."""


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
    feet: tuple[str, ...]
    seeds: tuple[int, ...]
    rate: float
    bed: tuple[float, float, float]
    attraction: float = 0.0
    poured_attraction: float = 0.0
    youngs: float = YOUNGS
    spread: float = SPREAD
    clump: str = ""
    """A name of CLUMPS; spheres have none."""
    learn: bool = True
    """Whether the error of law `foot` is learned from its feet."""

    @property
    def diameter(self) -> float:
        """Mean diameter [m], of a sphere as large as a clump."""
        return 1e-3 * self.diameter_mm

    @property
    def median_mm(self) -> float:
        """Diameter d50 below which grains have half of the mass, as a sieve has it [mm].

        Of diameters d that are uniform between a and b by number, mass grows as d⁴ − a⁴.
        """
        ends = self.diameter_mm * (1.0 + self.spread * np.array([-1.0, 1.0]))
        return float(np.mean(ends**4) ** 0.25)

    @property
    def time_step(self) -> float:
        """[s]."""
        radius = self.diameter * (1.0 - self.spread) * spheres(self.clump)[0, 3]
        shear = self.youngs / (2.0 * (1.0 + POISSON))
        rayleigh = math.pi * radius * math.sqrt(DENSITY / shear) / (0.1631 * POISSON + 0.8766)
        return RAYLEIGH * rayleigh

    @property
    def words(self) -> str:
        """Size, and what is not as usual."""
        words = f"{self.diameter_mm} mm"
        words += f", {self.clump}" if self.clump else ""
        words += f", graded ± {self.spread:.0%}" if self.spread != SPREAD else ""
        return words + (f", E {self.youngs:.3g} Pa" if self.youngs != YOUNGS else "")


@functools.cache
def spheres(clump: str) -> FloatArray:
    """Centers and radius of the spheres of a grain as large as a ball of unit diameter.

    The volume of their union is counted on a grid, to 1e-3. Shape [sphere, 4].
    """
    if not clump:
        return np.array([[0.0, 0.0, 0.0, 0.5]])
    centers = np.array(CLUMPS[clump])
    ends = np.abs(centers).max(axis=0) + 1.0
    axes = [np.linspace(-end, end, 100, endpoint=False) + end / 100 for end in ends]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = np.any([np.square(points - at).sum(axis=-1) < 1.0 for at in centers], axis=0)
    diameter = float(6.0 / math.pi * inside.mean() * np.prod(2.0 * ends)) ** (1.0 / 3.0)
    return np.column_stack([centers, np.ones(len(centers))]) / diameter


def contacts(soil: Soil, *, poured: bool = False) -> str:
    """Material and integrator; type 1 are grains and walls alike, type 2 is the leg.

    Bridges of liquid (Soulié et al. 2006, as LIGGGHTS has them) attract grains, not the leg.
    """
    wall = soil.leg_friction
    rolling, sliding, attraction = soil.rolling, soil.sliding, soil.attraction
    if poured:
        sliding, attraction = soil.settled, soil.poured_attraction
    damp = f"""fix l1 all property/global surfaceLiquidContentInitial scalar {LIQUID}
fix l2 all property/global surfaceTension scalar {attraction * soil.diameter}
fix l3 all property/global fluidViscosity scalar {VISCOSITY}
fix l4 all property/global contactAngle peratomtype 0 0
fix l5 all property/global minSeparationDistanceRatio scalar 0.01
fix l6 all property/global maxSeparationDistanceRatio scalar {REACH}
"""
    bridges = soil.attraction or soil.poured_attraction  # a restart keeps the model
    model = f"hertz tangential history {'cohesion easo/capillary/viscous ' if bridges else ''}"
    return f"""
fix m1 all property/global youngsModulus peratomtype {soil.youngs} {soil.youngs}
fix m2 all property/global poissonsRatio peratomtype {POISSON} {POISSON}
fix m3 all property/global coefficientRestitution peratomtypepair 2 &
  {RESTITUTION} {RESTITUTION} {RESTITUTION} {RESTITUTION}
fix m4 all property/global coefficientFriction peratomtypepair 2 {sliding} {wall} {wall} {wall}
fix m5 all property/global coefficientRollingFriction peratomtypepair 2 &
  {rolling} {rolling} {rolling} {rolling}
{damp if bridges else ""}pair_style gran model {model}rolling_friction epsd2
pair_coeff * *
timestep {soil.time_step:.4g}
"""


FINISHED = "deck finished"
WALL = "wall/gran model hertz tangential history rolling_friction epsd2"


def header(soil: Soil, *, walls: bool = True) -> str:
    """First lines of a deck, periodic along as well if it has no walls."""
    return f"""units si
atom_style granular
atom_modify map array
boundary {"f" if walls else "p"} p f
newton off
soft_particles yes
communicate single vel yes
processors 1 1 1
neighbor {0.2 * soil.diameter:.4g} bin
neigh_modify delay 0
"""


def integrator(soil: Soil) -> str:
    """What moves grains."""
    return "multisphere allow_group_and_set yes" if soil.clump else "nve/sphere"


def ground(soil: Soil, box: tuple[float, ...], *, walls: bool = True) -> str:
    """Weight, floor and end walls of a box [m]; across, it is periodic."""
    x0, x1, *_ = box
    lines = f"""fix integrate all {integrator(soil)}
fix gravity all gravity {GRAVITY} vector 0 0 -1
fix floor all {WALL} primitive type 1 zplane 0
"""
    for name, x in (("west", x0), ("east", x1)) if walls else ():
        lines += f"fix {name} all {WALL} primitive type 1 xplane {x}\n"
    return lines


def number(soil: Soil, volume: float) -> float:
    """Grains in so much of a bed [m³]."""
    return 0.58 * volume / (math.pi / 6.0 * soil.diameter**3 * (1.0 + soil.spread**2))


def prime(count: int) -> int:
    """Prime number that follows so many others above 1e4: LIGGGHTS seeds with such."""
    numbers = (n for n in itertools.count(10_001, 2) if all(n % k for k in range(3, 400, 2)))
    return next(itertools.islice(numbers, count, None))


def templates(soil: Soil, seed: int) -> str:
    """Clumps of all sizes, as the distribution `sizes`."""
    lines, parts = "", ""
    for k in range(SIZES):
        scale = soil.diameter * (1.0 + soil.spread * (2 * k + 1 - SIZES) / SIZES)
        balls = scale * spheres(soil.clump)
        lines += f"""fix t{k} all particletemplate/multisphere {prime(10 * seed + k)} atom_type 1 &
  density constant {DENSITY} nspheres {len(balls)} ntry 1000000 &
  spheres {" ".join(f"{value:.9g}" for value in balls.ravel())} type {k + 1}
"""
        parts += f" t{k} {1.0 / SIZES}"
    return f"""{lines}fix sizes all particledistribution/discrete/numberbased &
  {prime(10 * seed + SIZES)} {SIZES}{parts}
"""


def clumps(
    soil: Soil, seed: int, box: tuple[float, ...], thickness: float, *, walls: bool
) -> tuple[str, str]:
    """An empty box, and clumps that fall into it and settle as the grains of :func:`lattice`."""
    x0, x1, y0, y1, _ = box
    count = round(number(soil, (x1 - x0) * (y1 - y0) * thickness))
    low = soil.diameter * (1.0 + soil.spread)
    high = low + thickness * 0.58 / SPARSE
    end = low if walls else 0.0
    empty = f"region box block {x0} {x1} {y0} {y1} -0.001 {high + ROOM:.6g} units box"
    fill = f"region fill block {x0 + end} {x1 - end} {y0} {y1} {low} {high} units box"
    pour = f"""{templates(soil, seed)}{fill}
fix pour all insert/pack seed {prime(10 * seed + SIZES + 1)} distributiontemplate sizes &
  maxattempt 200 insert_every once overlapcheck yes all_in no vel uniform 0 0 0 0.1 0.1 0.1 &
  orientation random region fill particles_in_region {count}
"""
    return f"{empty}\ncreate_box 2 box", pour


def lattice(soil: Soil, seed: int, box: tuple[float, ...], thickness: float, path: Path) -> None:
    """Write grains that will settle to a level bed about so thick [m], above the floor of a box.

    They stand on a lattice that grains of any size fit, with sizes and velocities drawn at random.
    """
    rng = np.random.default_rng(seed)
    x0, x1, y0, y1, _ = box
    largest = soil.diameter * (1.0 + soil.spread)
    counts = [int((x1 - x0) / largest), int((y1 - y0) / largest)]
    pitch_x, pitch_y = (x1 - x0) / counts[0], (y1 - y0) / counts[1]
    layers = round(number(soil, pitch_x * pitch_y * thickness))
    ix, iy, iz = np.indices((*counts, layers)).reshape(3, -1)
    x, y, z = x0 + pitch_x * (ix + 0.5), y0 + pitch_y * (iy + 0.5), largest * (iz + 0.5)
    diameter = soil.diameter * rng.uniform(1.0 - soil.spread, 1.0 + soil.spread, x.size)
    velocity = rng.uniform(-0.1, 0.1, (x.size, 3))
    lines = [
        "grains\n",
        f"{x.size} atoms\n2 atom types",
        f"{x0} {x1} xlo xhi\n{y0} {y1} ylo yhi\n-0.001 {largest * layers + ROOM:.6g} zlo zhi",
        "\nAtoms\n",
    ]
    grains = enumerate(zip(diameter, x, y, z, strict=True), 1)
    lines += [f"{i} 1 {d:.9g} {DENSITY} {a:.9g} {b:.9g} {c:.9g}" for i, (d, a, b, c) in grains]
    lines.append("\nVelocities\n")
    lines += [f"{i} {u:.6g} {v:.6g} {w:.6g} 0 0 0" for i, (u, v, w) in enumerate(velocity, 1)]
    path.write_text("\n".join([*lines, ""]))


def bed(
    soil: Soil, seed: int, box: tuple[float, ...], thickness: float, folder: Path,
    *, walls: bool = True,
) -> None:  # fmt: skip
    """Make a bed in a folder unless it is there: bed.restart, bed.dump.

    Grains settle with the friction of their packing; then it is switched to their own, and they
    rest again.
    """
    if (folder / "bed.dump").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    if soil.clump:
        start, pour = clumps(soil, seed, box, thickness, walls=walls)
    else:
        lattice(soil, seed, box, thickness, folder / "grains.data")
        start, pour = "read_data grains.data", ""
    fall = 0.25 + 5.0 * math.sqrt(thickness / GRAVITY)
    columns = "id x y z radius" + (" id_multisphere" if soil.clump else "")
    for name, source, poured, time in (
        ("fallen", start, pour, fall), ("bed", "read_restart fallen.restart", "", 0.3)
    ):  # fmt: skip
        deck = f"""{header(soil, walls=walls)}{source}
{contacts(soil, poured=name == "fallen")}
{ground(soil, box, walls=walls)}{poured}thermo 5000
thermo_style custom step atoms ke cpu
thermo_modify flush yes
run {round(time / soil.time_step)}
write_restart {name}.restart
dump last all custom 1 {name}.dump {columns}
run 0
"""
        run(deck, folder, name)


def run(deck: str, folder: Path, name: str) -> None:
    """Run a deck in a folder; raises RuntimeError with the log's end if the engine fails.

    An engine that is ended from outside returns 0 as well: a deck's last line says that it is done.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.in").write_text(f'{deck}\nprint "{FINISHED}"\n')
    with (folder / f"{name}.out").open("w") as out:
        code = subprocess.run(
            ["liggghts", "-in", f"{name}.in", "-log", f"{name}.log"],
            cwd=folder, stdout=out, stderr=subprocess.STDOUT, check=False,
        ).returncode  # fmt: skip
    tail = (folder / f"{name}.out").read_text(errors="replace")[-600:]
    if code or FINISHED not in tail.splitlines():
        raise RuntimeError(f"{folder / name}.in: LIGGGHTS failed: {tail}")


def dump(path: Path) -> FloatArray:
    """Spheres of a dump's last frame: id, x, y, z, radius and that of the clump, if any."""
    lines = path.read_text().splitlines()
    start = max(i for i, line in enumerate(lines) if line.startswith("ITEM: ATOMS"))
    return np.array([line.split() for line in lines[start + 1 :]], dtype=float)


def layering(soil: Soil, grains: FloatArray, area: float) -> tuple[float, float]:
    """Height of the mass-equivalent surface [m] and volume fraction of the middle [-].

    Each sphere of a clump has an equal share of its volume.
    """
    z, radius = grains[:, 3], grains[:, 4]
    top = np.quantile(z, 0.98)
    low, high = 0.25 * top, 0.8 * top
    overlap = float(8.0 * (spheres(soil.clump)[:, 3] ** 3).sum())

    def above(level: float) -> float:
        """Volume of grains above a level [m³]."""
        h = np.clip(z + radius - level, 0.0, 2.0 * radius)
        return float((math.pi * h**2 * (radius - h / 3.0)).sum()) / overlap

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
    write_mesh(triangles, path)


def foot_mesh(shape: str, radius: float, low: tuple[float, float], path: Path) -> None:
    """Write a ball, or a disc DISC thick, whose lowest point is at (x, z) [m], as STL."""
    if shape == "ball":  # points spread evenly by the golden angle
        up = 1.0 - (2.0 * np.arange(POINTS) + 1.0) / POINTS
        turn = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(POINTS)
        level, height = radius * np.sqrt(1.0 - up**2), radius * (1.0 + up)
    else:
        turn = np.tile(np.linspace(0.0, 2.0 * math.pi, RIM, endpoint=False), 2)
        level, height = np.full(2 * RIM, radius), np.repeat([0.0, DISC], RIM)
    points = np.stack([low[0] + level * np.cos(turn), level * np.sin(turn), low[1] + height], -1)
    write_mesh(points[ConvexHull(points).simplices], path)


def wheel_mesh(
    rim: float, width: float, lugs: tuple[int, float], at: tuple[float, float], path: Path
) -> None:
    """Write a wheel about an axle at (x, z) [m] as STL; lugs by their number and height [m].

    A lug is as thick as a :data:`PANELS`-th part of the rim.
    """
    count, height = lugs
    panels = PANELS if not count else count * max(round(PANELS / count), 3)
    turn = 2.0 * math.pi / panels * np.arange(panels + 1)
    each = np.arange(panels)
    is_lug = (each % (panels // count) == 0) if count else each < 0
    triangles: list[Sequence[Sequence[float]]] = []

    def quad(a: float, b: float, inner: float, outer: float, y: Sequence[float]) -> None:
        """Two triangles of a patch between two angles, radii and widths."""
        p, q, r, s = ((at[0] + R * math.sin(t), w, at[1] - R * math.cos(t)) for t, R, w in (
            (a, inner, y[0]), (b, outer, y[1]), (b, outer, y[2]), (a, inner, y[3])))  # fmt: skip
        triangles.extend([(p, q, r), (p, r, s)])

    edges = np.linspace(-0.5, 0.5, 5) * width
    for k in range(panels):
        a, b, radius = turn[k], turn[k + 1], rim + height * is_lug[k]
        for left, right in itertools.pairwise(edges):
            quad(a, b, radius, radius, (left, left, right, right))
            if is_lug[k]:  # its two flanks
                quad(a, a, rim, radius, (left, left, right, right))
                quad(b, b, rim, radius, (left, left, right, right))
        for y in (edges[0], edges[-1]):  # the sides, from half the radius on
            p, q, r, s = (
                (at[0] + R * math.sin(t), y, at[1] - R * math.cos(t))
                for t, R in ((a, 0.5 * rim), (b, 0.5 * rim), (b, radius), (a, radius))
            )
            triangles += [(p, q, r), (p, r, s)]
    write_mesh(triangles, path)


def write_mesh(triangles: Iterable[Sequence[Sequence[float]]], path: Path) -> None:
    """Write triangles [m] as STL."""
    lines = ["solid body"]
    for a, b, c in triangles:
        normal = np.cross(np.subtract(b, a), np.subtract(c, a))
        normal = normal / np.linalg.norm(normal)
        lines.append("facet normal {:.9g} {:.9g} {:.9g}".format(*normal))
        lines.append("outer loop")
        lines += ["vertex {:.9g} {:.9g} {:.9g}".format(*point) for point in (a, b, c)]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid body", ""]))


def moved(
    soil: Soil, box: tuple[float, ...], at: tuple[float, float], motion: str, *, steps: int,
    every: int,
) -> str:  # fmt: skip
    """The body of body.stl moves through the bed; means of its force and torque about (x, z)."""
    return (
        header(soil)
        + "read_restart bed.restart\n"
        + contacts(soil)
        + f"""
{ground(soil, box)}fix body all mesh/surface/stress file body.stl type 2 &
  reference_point {at[0]} 0 {at[1]}
fix touch all {WALL} mesh n_meshes 1 meshes body
fix move all move/mesh mesh body {motion}
fix mean all ave/time 1 {every} {every} f_body[1] f_body[2] f_body[3] f_body[5] file body.txt
thermo 5000
thermo_style custom step atoms ke cpu
thermo_modify flush yes
run {steps}
"""
    )


def rolling(
    soil: Soil, box: tuple[float, ...], at: tuple[float, float], turn: float, speed: float,
    sinking: FloatArray, steps: Sequence[int], every: int,
) -> str:  # fmt: skip
    """The wheel of body.stl rolls along x, in stages of a vertical velocity each.

    It turns by ``turn`` [rad/s] about its axle at (x, z), which goes with it.
    """
    stages, (x, z) = "", at
    for down, count in zip(sinking.tolist(), steps, strict=True):
        stages += f"""fix travel all move/mesh mesh body linear {speed:.8g} 0 {down:.8g}
fix spin all move/mesh mesh body rotate origin {x:.8g} 0 {z:.8g} axis 0 1 0 &
  period {2.0 * math.pi / turn:.8g}
run {count}
unfix spin
unfix travel
"""
        x, z = x + speed * count * soil.time_step, z + down * count * soil.time_step
    begin, _, _ = moved(soil, box, at, "", steps=0, every=every).partition("fix move")
    return f"""{begin}fix mean all ave/time 1 {every} {every} f_body[1] f_body[2] f_body[3] &
  f_body[5] file body.txt
thermo 5000
thermo_style custom step atoms ke cpu
thermo_modify flush yes
{stages}"""


def means(soil: Soil, folder: Path) -> tuple[FloatArray, FloatArray]:
    """Times since the body began to move [s], and its force (x, y, z) and torque [4, time]."""
    step, *columns = np.loadtxt(folder / "body.txt").T
    # Steps go on from the bed's; the first mean begins where its length next divides the step.
    first = int((folder / "bed.dump").read_text().split(maxsplit=3)[2])
    middle = step - first - 0.5 * (step[1] - step[0])
    return soil.time_step * middle, np.array(columns)
