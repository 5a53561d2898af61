"""Stir simulated grains with legs, press feet in, and write their forces.

    python studies/grains/run.py B-loose --work FOLDER --out studies/data/grains

A bed is poured once for each seed and rig, periodic across; that of the legs of Li et al. (2013)
has 220 x 84 x 105 mm. The hip stands above the mass-equivalent surface and the leg turns at
1 rad/s. Feet are pressed into another bed, which is as new for each. What is in FOLDER already is
not simulated again. A record has the forces [N] of soil on the leg or the foot, x forward and z up,
and of a leg the moment about the hip [N m]; its first lines say of what.
"""

from __future__ import annotations

import argparse
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path

import engine
import numpy as np

from terraphi.experiment.files import atomic_write
from terraphi.experiment.leg import Leg
from terraphi.laws.foot import Foot

HERE = Path(__file__).parent
ENDS, SIDES, FLOOR = 0.65, 0.522, 1.868
"""From where the leg enters the soil to the end of the bed, from its edge to the bed's side, and
thickness of the bed, over the depth of the leg [-]: of Li's leg 220 x 84 x 105 mm."""
SWING_DEG, CLEAR_DEG, EVERY_DEG = (-85.0, 80.0), (10.0, 5.0), 1.0
"""Angles, least distance of the first and the last from the soil, width of the means [deg]."""
SPEED, DEEPEST, EVERY = 0.03, 1.5, 5e-4
"""Speed of a foot at a rate of 1 [m/s], its last depth over its radius, and the depth of the means
[m]."""
LANDED = 0.025
"""Last depth of a foot that lands [m]: what a Go2 of 15 kg sinks in loose sand."""
TRAVEL, SUNK, PATH = 0.1, (0.17, 0.3), (0.6, 1.5, 0.4, 1.7)
"""Speed of a wheel's axle [m/s], its two depths over its radius, and the ways over which it is let
down, rolls, is let down again and rolls over its radius [-]."""
WHEEL_BED, WHEEL_EVERY = (7.4, 0.25, 1.0), 2e-3
"""Length of a wheel's bed, soil on either side of the wheel, and thickness, over its radius [-];
way of the means [m]."""


@dataclass(frozen=True)
class Rig:
    """A leg and its height above the soil; of Li et al. unless it says otherwise."""

    leg: str
    """``straight``, ``c`` or ``reversed_c``."""
    name: str = ""
    """Of a rig of ``soils.toml``."""
    length_mm: float = 76.2
    """From the hip to the outermost point."""
    width_mm: float = 25.4
    thickness_mm: float = 6.4
    hip_height_mm: float = 20.0
    soils: tuple[str, ...] = ()
    """Names of the soils that it stirs."""
    bed_mm: tuple[float, ...] = ()
    """Length, breadth and thickness of its bed, if they are given."""

    @property
    def half_angle(self) -> float:
        """Angle from the vertical at which the tip touches the soil [rad]."""
        return math.acos(self.hip_height_mm / self.length_mm)

    @property
    def bed(self) -> tuple[float, float, float]:
        """Length, breadth and thickness of its bed [m], in whole millimeters."""
        if self.bed_mm:
            return tuple(1e-3 * size for size in self.bed_mm)
        depth = self.length_mm - self.hip_height_mm
        half_length = self.length_mm * math.sin(self.half_angle) + ENDS * depth
        sizes = 2.0 * half_length, self.width_mm + 2.0 * SIDES * depth, FLOOR * depth
        return tuple(1e-3 * round(size) for size in sizes)

    @property
    def swing_deg(self) -> tuple[float, float]:
        """First and last angle [deg]."""
        entry = self.half_angle
        if self.leg == "c":
            # Its arc, of radius R about the middle of the chord, is lowest R (1 + cos θ) under the
            # hip, and enters before the tip.
            height = self.hip_height_mm - 0.5 * self.thickness_mm
            entry = math.acos(2.0 * height / (self.length_mm - 0.5 * self.thickness_mm) - 1.0)
        before, behind = (
            math.ceil(math.degrees(angle) + clear)
            for angle, clear in zip((entry, self.half_angle), CLEAR_DEG, strict=True)
        )
        return min(SWING_DEG[0], -before), max(SWING_DEG[1], behind)


def rigs() -> list[Rig]:
    """All rigs of ``soils.toml``."""
    table = tomllib.loads((HERE / "soils.toml").read_text())
    return [Rig(name=name, **rig) for name, rig in table["rigs"].items()]


def soils() -> dict[str, engine.Soil]:
    """All soils of ``soils.toml`` by name."""
    table = tomllib.loads((HERE / "soils.toml").read_text())
    return {
        name: engine.Soil(name=name, **{**table["defaults"], **own})
        for name, own in table["soils"].items()
    }


def record(soil: engine.Soil, rig: Rig, seed: int, work: Path, out: Path) -> Path:
    """Pour the bed unless it is there, stir it, and write the forces; the file."""
    body = f"rig-{rig.name}" if rig.name else rig.leg
    path = out / f"{soil.name}_{body}_{seed}.csv"
    if path.exists():
        return path
    length, breadth, thickness = rig.bed
    sizes = "x".join(f"{1e3 * size:.0f}" for size in rig.bed)
    folder = work / f"{soil.name}_{sizes}_{seed}"  # legs of one size stir the same bed
    box = (-0.5 * length, 0.5 * length, -0.5 * breadth, 0.5 * breadth, 0.0)
    engine.bed(soil, seed, box, thickness, folder)
    surface, fraction = engine.layering(soil, engine.dump(folder / "bed.dump"), length * breadth)
    hip = (0.0, surface + 1e-3 * rig.hip_height_mm)
    # Center line and half thickness together have the leg's length.
    leg = Leg(
        shape=rig.leg, chord=1e-3 * (rig.length_mm - 0.5 * rig.thickness_mm),
        half_thickness=5e-4 * rig.thickness_mm, width=1e-3 * rig.width_mm,
        friction=soil.leg_friction,
    )  # fmt: skip
    first, last = rig.swing_deg
    engine.leg_mesh(leg, math.radians(first), hip, folder / "body.stl")
    turn = math.radians(last - first) / soil.rate
    deck = engine.moved(
        soil, box, hip,
        f"rotate origin {hip[0]} 0 {hip[1]} axis 0 1 0 period {2.0 * math.pi / soil.rate:.8g}",
        steps=round(turn / soil.time_step),
        every=round(math.radians(EVERY_DEG) / soil.rate / soil.time_step),
    )  # fmt: skip
    engine.run(deck, folder, body)
    time, (fx, _, fz, moment) = engine.means(soil, folder)
    theta = first + np.degrees(soil.rate * time)
    rows = zip(theta, fx, fz, moment, strict=True)
    lines = [f"{t:.2f},{x:.4f},{z:.4f},{m:.6f}" for t, x, z, m in rows]
    sizes = f"{rig.length_mm:g} x {rig.width_mm:g} x {rig.thickness_mm:g} mm"
    words = f"{rig.leg} leg of {sizes}, hip {rig.hip_height_mm:g} mm above the soil"
    write(path, soil, seed, fraction, words, ["theta_deg,Fx_N,Fz_N,M_Nm", *lines])
    return path


def pressed(soil: engine.Soil, name: str, seed: int, work: Path, out: Path) -> Path:
    """Pour the bed of feet unless it is there, press one in, and write the forces; the file.

    A foot is named by its shape, its diameter [mm], how far from the vertical it moves [deg], and
    its speed [m/s] after a v, if that is another, or after an l if it lands: a quarter of a sine,
    which is at rest :data:`LANDED` deep. ``ball_44_45``, ``ball_44_v1.5``, ``ball_44_l1``.
    """
    path = out / f"{soil.name}_{name}_{seed}.csv"
    if path.exists():
        return path
    foot, descent, speed, lands = foot_of(name)
    folder = work / f"{soil.name}_{seed}_feet"
    length, breadth, thickness = (soil.diameter * each for each in soil.bed)
    box = (-0.5 * length, 0.5 * length, -0.5 * breadth, 0.5 * breadth)
    engine.bed(soil, seed, (*box, 0.0), thickness, folder)
    surface, fraction = engine.layering(soil, engine.dump(folder / "bed.dump"), length * breadth)
    start, stop = -soil.diameter, LANDED if lands else DEEPEST * foot.radius
    vx, vz = soil.rate * speed * math.cos(descent), soil.rate * speed * math.sin(descent)
    low = (-0.5 * (stop - start) * vx / vz, surface - start)
    engine.foot_mesh(foot.shape, foot.radius, low, folder / "body.stl")
    duration, way = (stop - start) / vz, stop - start
    motion, every = f"linear {vx:.8g} 0 {-vz:.8g}", EVERY / vz
    if lands:
        duration *= 0.5 * math.pi
        motion = f"wiggle amplitude 0. 0. {-way:.8g} period {4.0 * duration:.8g}"
        every = duration / 70.0
    deck = engine.moved(
        soil, (*box, 0.0), low, motion,
        steps=round(duration / soil.time_step), every=max(round(every / soil.time_step), 1),
    )  # fmt: skip
    engine.run(deck, folder, name)
    time, (fx, _, fz, _) = engine.means(soil, folder)
    depth, moved = start + vz * time, ""
    if lands:
        turn = 0.5 * math.pi * time / duration
        depth, moved = start + way * np.sin(turn), ",speed_m_s,acceleration_m_s2"
        more = np.array([vz * np.cos(turn), -(vz**2) / way * np.sin(turn)])
    rows = np.array([1e3 * depth, fx, fz]).T
    lines = [f"{z:.2f},{x:.4f},{f:.4f}" for z, x, f in rows]
    if lands:
        lines = [f"{line},{v:.4f},{a:.3f}" for line, v, a in zip(lines, *more, strict=True)]
    words = name.replace("_", " ")
    write(path, soil, seed, fraction, words, [f"depth_mm,Fx_N,Fz_N{moved}", *lines])
    return path


def rolled(soil: engine.Soil, name: str, seed: int, work: Path, out: Path) -> Path:
    """Pour the bed of a wheel unless it is there, roll it, and write the forces; the file.

    A wheel is named by its diameter and width [mm], after a + its lugs, number and height [mm], and
    its slip 1 - v / (w R), R to the lugs' tips: ``wheel_120x25_s0.2``, ``wheel_120x25+12x6_s0``.
    The axle moves level at two depths, one after the other.
    """
    path = out / f"{soil.name}_{name}_{seed}.csv"
    if path.exists():
        return path
    diameter, width, (count, height), slip = wheel_of(name)
    rim, reach = 0.5 * diameter, 0.5 * diameter + height
    length, thickness = WHEEL_BED[0] * rim, WHEEL_BED[2] * rim
    breadth = width + 2.0 * WHEEL_BED[1] * rim
    sizes = "x".join(f"{1e3 * value:.0f}" for value in (length, breadth, thickness))
    folder = work / f"{soil.name}_{sizes}_{seed}"
    box = (-0.5 * length, 0.5 * length, -0.5 * breadth, 0.5 * breadth, 0.0)
    engine.bed(soil, seed, box, thickness, folder)
    surface, fraction = engine.layering(soil, engine.dump(folder / "bed.dump"), length * breadth)
    clear = 0.5 * soil.diameter
    at = (-0.5 * length + 1.15 * rim, surface + clear + reach)
    engine.wheel_mesh(rim, width, (count, height), at, folder / "body.stl")
    ways = np.array(PATH) * rim
    falls = np.array([SUNK[0] * rim + clear, 0.0, (SUNK[1] - SUNK[0]) * rim, 0.0])
    deck = engine.rolling(
        soil, box, at, TRAVEL / (reach * (1.0 - slip)), TRAVEL, -falls / ways * TRAVEL,
        [round(way / TRAVEL / soil.time_step) for way in ways],
        round(WHEEL_EVERY / TRAVEL / soil.time_step),
    )  # fmt: skip
    engine.run(deck, folder, name)
    time, (fx, _, fz, moment) = engine.means(soil, folder)
    travel = TRAVEL * time
    depth = np.interp(travel, np.append(0.0, ways.cumsum()), np.append(0.0, falls.cumsum())) - clear
    rows = zip(1e3 * travel, 1e3 * depth, fx, fz, -moment, strict=True)
    lines = [f"{x:.1f},{z:.2f},{f:.4f},{w:.4f},{m:.6f}" for x, z, f, w, m in rows]
    words = f"wheel of {1e3 * diameter:g} x {1e3 * width:g} mm"
    words += f" with {count} lugs of {1e3 * height:g} mm" if count else ""
    head = "travel_mm,sinkage_mm,pull_N,load_N,torque_Nm"
    write(path, soil, seed, fraction, f"{words} at a slip of {slip:g}", [head, *lines])
    return path


def wheel_of(name: str) -> tuple[float, float, tuple[int, float], float]:
    """Diameter and width of a wheel, number and height of its lugs [m], and its slip [-]."""
    _, size, slip = name.split("_")
    body, _, lugs = size.partition("+")
    diameter, width = (1e-3 * float(value) for value in body.split("x"))
    count, height = lugs.split("x") if lugs else ("0", "0")
    return diameter, width, (int(count), 1e-3 * float(height)), float(slip.removeprefix("s"))


def foot_of(name: str) -> tuple[Foot, float, float, bool]:
    """A foot, angle of its velocity below the horizontal [rad], speed [m/s], whether it lands."""
    name, _, landing = name.partition("_l")
    name, _, speed = name.partition("_v")
    shape, diameter, *turned = name.split("_")
    descent = math.radians(90.0 - float((turned or [0])[0]))
    foot = Foot(5e-4 * float(diameter), shape)
    return foot, descent, float(landing or speed or SPEED), bool(landing)


def write(
    path: Path, soil: engine.Soil, seed: int, fraction: float, body: str, table: list[str]
) -> None:
    """Write a record: two lines that say of what, and a table."""
    lines = [
        (
            f"# grains {soil.name}, seed {seed}: sliding friction {soil.sliding}, rolling "
            f"{soil.rolling}, settled with {soil.settled}, {soil.words}"
        ),
        (
            f"# density {engine.DENSITY * fraction:.0f} kg/m3, volume fraction {fraction:.4f}, "
            f"{body}, friction {soil.leg_friction}"
        ),
    ]
    with atomic_write(path) as temporary:
        temporary.write_text("\n".join([*lines, *table]) + "\n")


def load(path: Path) -> tuple[np.ndarray, np.ndarray, float]:
    """Leg angles [deg] or depths [mm], forces (Fx, Fz) [N], shape [2, row], and density [kg/m³]."""
    with path.open() as file:
        density = next(float(line.split()[2]) for line in file if line.startswith("# density"))
    theta, *forces = np.loadtxt(path, delimiter=",", skiprows=3, unpack=True)
    return theta, np.array(forces[:2]), density


def main() -> None:
    """Stir one soil with every leg and rig that it has, and press in every foot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("soil", choices=sorted(soils()), metavar="SOIL")
    parser.add_argument("--work", type=Path, required=True, help="folder for the engine's files")
    parser.add_argument("--out", type=Path, required=True, help="folder for the records")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    soil = soils()[options.soil]
    for seed in soil.seeds:
        for shape in soil.legs:
            print(record(soil, Rig(shape), seed, options.work, options.out))
        for foot in soil.feet:
            print(pressed(soil, foot, seed, options.work, options.out))
    for rig in rigs():
        if soil.name in rig.soils:
            print(record(soil, rig, soil.seeds[0], options.work, options.out))


if __name__ == "__main__":
    main()
