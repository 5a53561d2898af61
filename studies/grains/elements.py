"""Measure the friction angle of simulated grains: shear cell and tilting bed.

    python studies/grains/elements.py B-loose --work FOLDER --out studies/data/grains

Both tests are periodic across and along, and their grains settle as those of a leg's bed do.

**Shear cell.** The lowest and the highest layer are glued to plates. Without weight, under 1.5 kPa,
the upper one moves along at an inertial number of 2e-3, so slowly that its size does not matter,
and is free to rise. Rows: shear strain, rise over the height, τ and σ on the lower plate and τ on
the upper one [Pa]. In the steady state both τ agree and σ is the load.

**Tilting bed.** Gravity is turned by 2.5° a second until the bed flows, and back until it rests;
beds of clumps are small, and are not turned back.
Rows: angle [deg] and the mean speed along of the grains above the middle [m/s].

Damp soil, and soil that contracts, is sheared in smaller cells under two loads (`firm`, `light`),
which give φ and the cohesion.

Angles of a shear cell are those of Mohr-Coulomb soil in plane strain: with the stress ratio τ/σ and
the rise tan ψ = dh/dx, τ/σ = sin φ cos ψ / (1 − sin φ sin ψ) (Davis 1968), and sin φ = τ/σ in the
critical state, where nothing rises.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import engine
import numpy as np
import run

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.files import atomic_write

DIAMETER_MM = 6.0
"""Of all grains: a test without a length does not see it."""
CELL, LAYER = (20.0, 12.0, 26.0), 2.0
"""Length, breadth and height of a cell, and height of a glued layer, in diameters.

Through a layer of 1.3 grains slip out of loose soils.
"""
SMALL = 12.0, 8.0, 18.0
"""The same of a cell under two loads, and of a tilting bed of clumps."""
LOADS = {"shear": (1500.0, 2e-3, 1.2), "firm": (1500.0, 5e-3, 1.0), "light": (500.0, 5e-3, 1.0)}
"""Load [Pa], inertial number and shear strain of a shear cell; damp soil is under two loads."""
ROW = 0.005
"""Shear strain of a row."""
TILT_DEG, CLUMPS_TILT_DEG, LEAN = 14.0, 24.0, 10
"""Angle at which rows begin [deg], of clumps too, and the steps in which it is reached: beds of
clumps that are turned at once slide."""
RATE_DEG, STEP_DEG = 2.5, 0.25
"""Speed of the tilt [deg/s], and width of a row [deg]."""
FLOWS, RUNS, RESTS = 0.01, 0.1, 0.002
"""Mean speed of the upper half that is flow, that ends the tilt, and that ends the return [m/s]."""
SMOOTH, EARLY, BLOCKS = 0.04, 0.5, 4
"""Shear strain of running means, that by which they peak, and blocks of a steady state."""
SEEDS = (1, 2, 3, 4)
CRITICAL_STRAIN, EARLY_STRAIN = 0.25, 0.05
"""Shear strain from which a cell is steady, and one at which it is not [-]. τ/σ still falls slowly
there. These cells have 20.0, 26.4, 31.9, 30.1 and 33.8° in soils A, B, C, I and K, cells of a
program of ours 20.1, 26.8, 32.4, 29.6 and 33.1°."""


def box_of(soil: engine.Soil, cell: tuple[float, ...] = CELL) -> tuple[float, ...]:
    """West, east, south, north and top of a cell [m]."""
    length, breadth, height = (soil.diameter * each for each in cell)
    return -length / 2, length / 2, -breadth / 2, breadth / 2, 3.0 * height


def glued(soil: engine.Soil, folder: Path, top: float = math.inf) -> str:
    """Groups: `low`, the lowest layer, `high`, all above a height [m], and `inner`, which moves.

    Clumps are glued as spheres of their own, without a body.
    """
    bottom = LAYER * soil.diameter
    move = f"fix integrate {{}} {engine.integrator(soil)}\n"
    if not soil.clump:
        return f"""region low block INF INF INF INF INF {bottom:.5g} units box
region high block INF INF INF INF {min(top, 1e3):.5g} INF units box
group low region low
group high region high
group inner subtract all low high
neigh_modify exclude group low low
neigh_modify exclude group high high
{move.format("inner")}"""
    grains = engine.dump(folder / "bed.dump")
    _, clump = np.unique(grains[:, 5], return_inverse=True)
    height = (np.bincount(clump, grains[:, 3]) / np.bincount(clump))[clump]
    low, high = grains[height < bottom], grains[height > top]
    first = int(grains[:, 0].max()) + 1
    middle, last = first + len(low), first + len(low) + len(high)
    plates = np.vstack([low, high])
    lines = ["plates\n", f"{len(plates)} atoms\n2 atom types", "\nAtoms\n"]
    lines += [f"{i} 1 {2.0 * r:.9g} {engine.DENSITY} {x:.9g} {y:.9g} {z:.9g}"
              for i, (_, x, y, z, r, _) in enumerate(plates, first)]  # fmt: skip
    (folder / "plates.data").write_text("\n".join([*lines, ""]))
    parts = np.array_split(plates[:, 0].astype(int), 1 + len(plates) // 50)
    gone = "\n".join(f"group gone id {' '.join(map(str, part))}" for part in parts)
    return f"""{move.format("all")}{gone}
run 0
delete_atoms group gone compress no
run 0
read_data plates.data add
group low id <> {first} {middle - 1}
group high id <> {middle} {last}
group inner subtract all low high
neigh_modify exclude group low low
neigh_modify exclude group high high
"""


def sheared(soil: engine.Soil, folder: Path, top: float, area: float, kind: str) -> str:
    """Deck of a shear cell whose surface is at a height [m], under a load of LOADS."""
    pressure, inertial, strain = LOADS[kind]
    height = top - 2.0 * LAYER * soil.diameter
    speed = inertial * height / (soil.diameter * math.sqrt(engine.DENSITY / pressure))
    every = round(ROW * height / speed / soil.time_step)
    return f"""{engine.header(soil, walls=False)}read_restart bed.restart
{engine.contacts(soil)}
{glued(soil, folder, top - LAYER * soil.diameter)}velocity all set 0 0 0
velocity high set {speed:.6g} 0 0
variable many equal count(high)
variable each equal -{pressure * area:.6g}/v_many
fix load high addforce 0 0 ${{each}}
fix plate high rigid single force 1 off off on torque 1 off off off
fix ground low freeze
variable above equal f_plate[1][7]
variable rise equal xcm(high,z)
fix mean all ave/time 1 {every} {every} f_ground[1] f_ground[3] v_above v_rise file {kind}.txt
dump last all custom {round(strain / ROW) * every} {kind}.dump id x y z radius
run {round(strain / ROW) * every}
"""


def tilted(soil: engine.Soil, folder: Path, top: float) -> str:
    """Deck of a bed that is tilted until it flows, and, of spheres, back until it rests."""
    steps = round(STEP_DEG / RATE_DEG / soil.time_step)
    start = CLUMPS_TILT_DEG if soil.clump else TILT_DEG
    degree = math.pi / 180.0

    def turn(name: str, angle: str, stop: str, most: int = 400) -> str:
        """Loop over angles, one run at each, until the speed passes a limit."""
        return f"""variable {name} loop {most}
label {name}
variable angle equal {angle}
variable along equal sin({degree:.9f}*v_angle)
variable down equal -cos({degree:.9f}*v_angle)
fix weight all gravity {engine.GRAVITY} vector ${{along}} 0 ${{down}}
run {steps}
if "${{speed}} {stop}" then "jump SELF {name}_end"
next {name}
jump SELF {name}
label {name}_end
"""

    return_way = turn("back", f"${{turned}}-{STEP_DEG}*v_back", f"< {RESTS}")
    back = "" if soil.clump else f"variable turned equal ${{angle}}\n{return_way}"
    return f"""{engine.header(soil, walls=False)}read_restart bed.restart
{engine.contacts(soil)}
{glued(soil, folder)}region upper block INF INF INF INF {0.5 * top:.5g} INF units box
group upper region upper
fix ground low freeze
variable speed equal vcm(upper,x)
{turn("lean", f"{start / LEAN}*v_lean", "> 1e9", LEAN)}\
fix mean all ave/time 1 {steps} {steps} v_angle v_speed file tilt.txt
{turn("up", f"{start}+{STEP_DEG}*v_up", f"> {RUNS}")}{back}"""


def shear(soil: engine.Soil, folder: Path, top: float, area: float, kind: str) -> FloatArray:
    """Shear a bed: strain, rise over height, τ, σ below and τ above [Pa], shape [row, 5]."""
    engine.run(sheared(soil, folder, top, area, kind), folder, kind)
    _, x, z, above, rise = np.loadtxt(folder / f"{kind}.txt").T
    strain = ROW * (np.arange(x.size) + 0.5)
    height = top - 2.0 * LAYER * soil.diameter
    return np.column_stack([strain, (rise - rise[0]) / height, x / area, -z / area, -above / area])


def tilt(soil: engine.Soil, folder: Path, top: float, _: float, kind: str) -> FloatArray:
    """Tilt a bed and turn it back: angle [deg], mean speed of its upper half [m/s]."""
    engine.run(tilted(soil, folder, top), folder, kind)
    return np.loadtxt(folder / f"{kind}.txt")[:, 1:]


SHEAR = (shear, "strain,rise,tau_Pa,sigma_Pa,tau_top_Pa", "%.4f,%.5f,%.2f,%.2f,%.2f")
TESTS = {
    **dict.fromkeys(LOADS, SHEAR),
    "tilt": (tilt, "angle_deg,speed_m_s", "%.3f,%.5f"),
}


def test(name: str, kind: str, seed: int, work: Path, out: Path) -> None:
    """Make one test of a bed and write its rows, unless the file is there."""
    path = out / f"{name}_{kind}_{seed}.csv"
    if path.exists():
        return
    soil = replace(run.soils()[name], diameter_mm=DIAMETER_MM)
    small = kind in ("firm", "light") or (kind == "tilt" and soil.clump)
    cell = SMALL if small else CELL
    folder = work / f"{name}_{seed}_{cell[2]:g}"
    x0, x1, y0, y1, _ = box = box_of(soil, cell)
    area = (x1 - x0) * (y1 - y0)
    engine.bed(soil, seed, box, cell[2] * soil.diameter, folder, walls=False)
    top, fraction = engine.layering(soil, engine.dump(folder / "bed.dump"), area)
    perform, columns, form = TESTS[kind]
    rows = perform(soil, folder, top, area, kind)
    with atomic_write(path) as temporary, temporary.open("w") as file:
        file.write(
            f"# grains {name}, seed {seed}: sliding friction {soil.sliding}, rolling "
            f"{soil.rolling}, settled with {soil.settled}, {soil.words}\n# density "
            f"{engine.DENSITY * fraction:.0f} kg/m3, volume fraction {fraction:.4f}\n{columns}\n"
        )
        np.savetxt(file, rows, fmt=form)


@dataclass(frozen=True)
class Measured:
    """Results of the element tests of one soil, means over beds."""

    phi_critical_deg: float
    """Friction angle in plane strain in the critical state [deg]."""
    phi_critical_sd_deg: float
    """Its standard error, from blocks or from beds, whichever is larger [deg]."""
    phi_peak_deg: float
    """The same at the peak, with the dilation there [deg]."""
    dilation_deg: float
    """Dilation angle at the peak [deg]."""
    softening_strain: float
    """Shear strain at which half of the softening is gone [-]; NaN without any."""
    volume_fraction: float
    """Of the settled bed [-]."""
    tilt_start_deg: float
    """Angle at which a tilting bed begins to flow [deg]."""
    tilt_stop_deg: float
    """Angle at which it comes to rest [deg]."""


def block_means(strain: FloatArray, values: FloatArray) -> FloatArray:
    """Means over blocks of the critical state, shape [..., strain] -> [..., block]."""
    if strain[-1] <= CRITICAL_STRAIN:
        raise ValueError(f"a test ends at a strain of {strain[-1]:g}; {CRITICAL_STRAIN:g} is early")
    blocks = np.array_split(values[..., strain > CRITICAL_STRAIN], BLOCKS, axis=-1)
    return np.stack([block.mean(axis=-1) for block in blocks], axis=-1)


def critical(strain: FloatArray, ratio: FloatArray) -> FloatArray:
    """Friction angle of each block of the critical state [deg], from τ/σ [-]."""
    return np.degrees(np.arcsin(block_means(strain, ratio)))


def peak(strain: FloatArray, rise: FloatArray, ratio: FloatArray) -> tuple[float, float, float]:
    """Friction and dilation angle at the peak [deg], and strain of half the softening [-].

    Parameters
    ----------
    strain, rise, ratio
        Evenly spaced shear strain, rise over height and τ/σ [-].
    """
    width = max(round(SMOOTH / (strain[1] - strain[0])), 1)
    smooth = np.convolve(ratio, np.ones(width) / width, "valid")
    middle = np.convolve(strain, np.ones(width) / width, "valid")
    top = int(smooth[middle < EARLY].argmax())
    near = np.abs(strain - middle[top]) < SMOOTH
    psi = math.atan(max(float(np.polyfit(strain[near], rise[near], 1)[0]), 0.0))
    # Davis, solved for sin φ.
    sine = smooth[top] / (math.cos(psi) + smooth[top] * math.sin(psi))
    steady = float(ratio[strain > CRITICAL_STRAIN].mean())
    gone = np.flatnonzero(smooth[top:] < 0.5 * (smooth[top] + steady))
    half = float(middle[top + gone[0]]) if gone.size else math.nan
    return math.degrees(math.asin(sine)), math.degrees(psi), half


def of_tilt(angle: FloatArray, speed: FloatArray) -> tuple[float, float]:
    """Angles at which a bed begins to flow for good and comes to rest [deg]; NaN if it does not."""
    top = int(angle.argmax())
    still = np.flatnonzero(speed[: top + 1] < FLOWS)
    flows = int(still[-1]) + 1 if still.size else 0
    rests = np.flatnonzero(speed[top:] < FLOWS)
    begin = float(angle[flows]) if flows <= top else math.nan
    return begin, float(angle[top + rests[0]]) if rests.size else math.nan


def measured(folder: Path, name: str) -> Measured:
    """Reduce the tests of a soil; raises FileNotFoundError if it has no shear cell.

    The peak is that of the mean curve of all beds: one bed's largest value is chance in part.
    Without a tilting bed its angles are NaN.
    """
    paths = sorted(folder.glob(f"{name}_shear_*.csv"))
    if not paths:
        raise FileNotFoundError(f"{folder}: no shear cell of {name}")
    curves = [np.loadtxt(path, delimiter=",", skiprows=3)[:, :4].T for path in paths]
    rows = min(curve.shape[1] for curve in curves)
    strain, rise, tau, sigma = np.mean([curve[:, :rows] for curve in curves], axis=0)
    blocks = np.array([critical(curve[0], curve[2] / curve[3]) for curve in curves])
    errors = [values.std(ddof=1) / math.sqrt(values.size)
              for values in (blocks.ravel(), blocks.mean(axis=1)) if values.size > 1]  # fmt: skip
    words = [path.read_text().split("volume fraction ")[1].split()[0] for path in paths]
    tilts = [
        of_tilt(*np.loadtxt(path, delimiter=",", skiprows=3, unpack=True))
        for path in sorted(folder.glob(f"{name}_tilt_*.csv"))
    ]
    begin, stop = np.mean(tilts or [(math.nan, math.nan)], axis=0).tolist()
    return Measured(
        float(blocks.mean()), float(max(errors)), *peak(strain, rise, tau / sigma),
        float(np.mean([float(word) for word in words])), begin, stop,
    )  # fmt: skip


class Cohesive(NamedTuple):
    """Results of a shear cell under two loads."""

    phi_deg: float
    """Friction angle in plane strain in the critical state [deg]."""
    phi_sd_deg: float
    cohesion_pa: float
    """Cohesion there [Pa]."""
    cohesion_sd_pa: float
    """Standard errors from blocks [deg], [Pa]."""
    shrinks: tuple[float, float]
    """Loss of height until it is least, under the firm and the light load [-]."""
    mobilized: tuple[float, float]
    """τ/σ at a shear strain of EARLY_STRAIN over that of the critical state, likewise [-]."""
    volume_fraction: float
    """Of the settled bed [-]."""


def cohesive(folder: Path, name: str) -> Cohesive:
    """Reduce the cells of a soil under two loads; raises FileNotFoundError if one is missing.

    In the critical state planes of shear are those of the largest shear stress, so that
    τ = σ sin φ + c cos φ.
    """
    steady, shrinks, mobilized = [], [], []
    for kind in ("firm", "light"):
        paths = sorted(folder.glob(f"{name}_{kind}_*.csv"))
        if not paths:
            raise FileNotFoundError(f"{folder}: no cell {kind} of {name}")
        cells = np.array([np.loadtxt(path, delimiter=",", skiprows=3)[:, :4].T for path in paths])
        strain, rise, tau, sigma = cells.mean(axis=0)
        near = np.abs(strain - EARLY_STRAIN) < 0.5 * SMOOTH
        blocks = np.hstack(block_means(strain, cells[:, 2:]).transpose(2, 1, 0))
        stress, load = blocks.mean(axis=1)
        sd = (blocks[0] / blocks[1]).std(ddof=1) * load / math.sqrt(blocks.shape[1])
        steady.append((load, stress, sd))
        width = round(SMOOTH / (strain[1] - strain[0]))
        least = np.convolve(rise, np.ones(width) / width, "valid").min()
        shrinks.append(max(-float(least), 0.0))
        mobilized.append(float(tau[near].mean() / sigma[near].mean() / (stress / load)))
    words = [path.read_text().split("volume fraction ")[1].split()[0] for path in paths]
    (high, firm, firm_sd), (low, light, light_sd) = steady
    slope = (firm - light) / (high - low)
    slope_sd = math.hypot(light_sd, firm_sd) / (high - low)
    phi = math.asin(slope)
    rest_sd = math.hypot(light_sd * high, firm_sd * low) / (high - low)
    return Cohesive(
        math.degrees(phi), math.degrees(slope_sd / math.cos(phi)),
        float(light - slope * low) / math.cos(phi), rest_sd / math.cos(phi),
        (shrinks[0], shrinks[1]), (mobilized[0], mobilized[1]),
        float(np.mean([float(word) for word in words])),
    )  # fmt: skip


def main() -> None:
    """Test one soil."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("soil", choices=sorted(run.soils()), metavar="SOIL")
    parser.add_argument("--work", type=Path, required=True, help="folder for the engine's files")
    parser.add_argument("--out", type=Path, required=True, help="folder for the results")
    parser.add_argument("--tests", nargs="+", choices=list(TESTS), default=["shear", "tilt"])
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for kind in options.tests:
        for seed in options.seeds:
            test(options.soil, kind, seed, options.work, options.out)
    print(options.soil, measured(options.out, options.soil))


if __name__ == "__main__":
    main()
