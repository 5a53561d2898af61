"""Stir simulated grains with the leg of Li et al. (2013), and write its forces.

    python studies/grains/run.py B-loose --work FOLDER --out studies/data/grains

A bed is poured once for each seed and size, 220 x 84 x 105 mm, periodic across. The hip stands
20 mm above the mass-equivalent surface and the leg turns at 1 rad/s. What is in FOLDER already is
not simulated again. A record has the forces [N] of soil on the leg, x forward and z up, and the
moment about the hip [N m]; its first lines say of what.
"""

from __future__ import annotations

import argparse
import math
import tomllib
from pathlib import Path

import engine
import numpy as np

from terraphi.experiment.files import replacing
from terraphi.experiment.leg import Leg

HERE = Path(__file__).parent
BOX, THICKNESS = (-0.110, 0.110, -0.042, 0.042, 0.26), 0.105
"""West, east, south, north and top of the box, and about how thick the bed is [m]."""
HIP = 0.020
"""Height of the hip above the surface [m]."""
SWING_DEG, EVERY_DEG = (-85.0, 80.0), 1.0
"""Angles, and the width of the means [deg]."""


def soils() -> dict[str, engine.Soil]:
    """All soils of ``soils.toml`` by name."""
    table = tomllib.loads((HERE / "soils.toml").read_text())
    return {
        name: engine.Soil(name=name, **{**table["defaults"], **own})
        for name, own in table["soils"].items()
    }


def record(soil: engine.Soil, shape: str, seed: int, work: Path, out: Path) -> Path:
    """Pour the bed unless it is there, stir it, and write the forces; the file."""
    path = out / f"{soil.name}_{shape}_{seed}.csv"
    if path.exists():
        return path
    folder = work / f"{soil.name}_{seed}"
    engine.bed(soil, seed, BOX, THICKNESS, folder)
    west, east, south, north, _ = BOX
    surface, fraction = engine.layering(
        engine.dump(folder / "bed.dump"), (east - west) * (north - south)
    )
    hip = (0.0, surface + HIP)
    # Centre line and half thickness end 76.2 mm from the hip.
    leg = Leg(shape=shape, chord=0.0730, friction=soil.leg_friction)
    engine.leg_mesh(leg, math.radians(SWING_DEG[0]), hip, folder / "leg.stl")
    deck = engine.stirring(
        soil, BOX, hip, start_deg=SWING_DEG[0], stop_deg=SWING_DEG[1], rate=soil.rate,
        every_deg=EVERY_DEG,
    )  # fmt: skip
    engine.run(deck, folder, shape)
    step, fx, _, fz, moment = np.loadtxt(folder / "leg.txt").T
    # Steps go on from the bed's; the first mean begins where its length next divides the step.
    first = int((folder / "bed.dump").read_text().split(maxsplit=3)[2])
    middle = step - first - 0.5 * (step[1] - step[0])
    theta = SWING_DEG[0] + np.degrees(soil.rate * soil.time_step * middle)
    lines = [
        (
            f"# grains {soil.name}, seed {seed}: sliding friction {soil.sliding}, rolling "
            f"{soil.rolling}, settled with {soil.settled}, {soil.diameter_mm} mm"
        ),
        (
            f"# density {engine.DENSITY * fraction:.0f} kg/m3, volume fraction {fraction:.4f}, "
            f"{shape} leg, friction {soil.leg_friction}"
        ),
        "theta_deg,Fx_N,Fz_N,M_Nm",
    ]
    rows = zip(theta, fx, fz, moment, strict=True)
    lines += [f"{t:.2f},{x:.4f},{z:.4f},{m:.6f}" for t, x, z, m in rows]
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n")
    return path


def load(path: Path) -> tuple[np.ndarray, np.ndarray, float]:
    """Leg angles [deg], forces (Fx, Fz) [N], shape [2, angle], and density [kg/m³] of a record."""
    with path.open() as file:
        density = next(float(line.split()[2]) for line in file if line.startswith("# density"))
    theta, *forces = np.loadtxt(path, delimiter=",", skiprows=3, unpack=True)
    return theta, np.array(forces[:2]), density


def main() -> None:
    """Stir one soil with every leg that it lists."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("soil", choices=sorted(soils()), metavar="SOIL")
    parser.add_argument("--work", type=Path, required=True, help="folder for the engine's files")
    parser.add_argument("--out", type=Path, required=True, help="folder for the records")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    soil = soils()[options.soil]
    for seed in soil.seeds:
        for shape in soil.legs:
            print(record(soil, shape, seed, options.work, options.out))


if __name__ == "__main__":
    main()
