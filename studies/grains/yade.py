"""Shear cells and legs by YADE, by the protocol of `elements.py` and `run.py`.

    python studies/grains/yade.py B-loose_firm_1 --work FOLDER --out FOLDER

YADE (GPL) is run as a separate program; Debian's package ``yade`` has it. The same spheres are let
fall as by LIGGGHTS, with the same contacts of Hertz and Mindlin, friction, restitution, time step
and load. A moment that resists rolling is elastic and at most μ_r R* F_n, as that of ``epsd2``; its
stiffness is that of a contact under 1 kPa. Floor and end walls are fixed spheres. What is
interrupted goes on from the last 20 rows.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import elements
import engine
import numpy as np
import run

from terraphi.experiment.leg import Leg

PRESSURE = 1000.0
"""Stress at which the moment of a contact has the stiffness of LIGGGHTS' [Pa]."""
DECK = '''
import json, os
import numpy as np

task = json.load(open("task.json"))
x, y, z = Vector3.UnitX, Vector3.UnitY, Vector3.UnitZ


def engines(gravity, sliding):
    """Engines of a step; grains are material 0, a leg is material 1."""
    friction = MatchMaker(matches=[(0, 0, np.arctan(sliding)),
                                   (0, 1, np.arctan(task["leg_friction"]))])
    half = MatchMaker(algo="val", val=task["restitution"])
    O.engines = [
        ForceResetter(),
        InsertionSortCollider([Bo1_Sphere_Aabb(), Bo1_Facet_Aabb()]),
        InteractionLoop(
            [Ig2_Sphere_Sphere_ScGeom(), Ig2_Facet_Sphere_ScGeom()],
            [Ip2_FrictMat_FrictMat_MindlinPhys(en=half, es=half, frictAngle=friction,
                                               eta=0.5 * task["rolling"], krot=task["stiffness"])],
            [Law2_ScGeom_MindlinPhys_Mindlin(includeMoment=task["rolling"] > 0.0)]),
        NewtonIntegrator(gravity=(0, 0, -gravity), damping=0.0),
    ]
    for each in O.interactions:
        if each.isReal:
            each.phys.tangensOfFrictionAngle = sliding


def bed():
    """Grains fall with the friction of their packing, and rest with their own."""
    O.periodic = True
    O.cell.setBox(*task["size"])
    O.materials.append([FrictMat(young=task["youngs"], poisson=task["poisson"],
                                 density=task["density"], label=name) for name in ("grain", "leg")])
    for place in ("fixed", "grains"):
        for diameter, *rest in np.load(f"{place}.npy").tolist():
            O.bodies.append(utils.sphere(rest[:3], 0.5 * diameter, material="grain",
                                         fixed=place == "fixed"))
            O.bodies[-1].state.vel = rest[3:]
    O.dt = task["time_step"]
    for gravity, sliding, time in ((9.81, task["settled"], task["fall"]),
                                   (9.81, task["sliding"], 0.3)):
        engines(gravity, sliding)
        O.run(round(time / O.dt), True)
    save("bed")


def save(name):
    """Keep the state, and where all grains are."""
    O.save("new.yade.gz")
    os.rename("new.yade.gz", f"{name}.yade.gz")
    rows = [(b.id, *b.state.pos, b.shape.radius) for b in O.bodies
            if isinstance(b.shape, Sphere) and b.id >= task["fixed"]]
    np.save(f"{name}.npy", rows)


def glued():
    """Bodies of the lowest and the highest layer, and the plate of the latter."""
    low, high = ([b.id for b in O.bodies if isinstance(b.shape, Sphere) and inside(b.state.pos[2])]
                 for inside in (lambda h: h < task["low"], lambda h: h > task["high"]))
    for body in O.bodies:
        body.state.vel = body.state.angVel = Vector3.Zero
        if body.id in set(low):
            body.state.blockedDOFs = "xyzXYZ"
    for body in range(task["fixed"]):  # the floor
        O.bodies.erase(body)
    plate = O.bodies.clump(high)
    O.bodies[plate].state.blockedDOFs = "xyXYZ"
    O.bodies[plate].state.vel = (task["speed"], 0, 0)
    engines(0.0, task["sliding"])
    O.engines = O.engines[:3] + [
        ForceEngine(ids=[plate], force=(0, 0, -task["load"]))] + O.engines[3:]
    return {"low": low, "high": high, "plate": plate}


def legs():
    """Bodies of a leg that turns about its hip."""
    from yade import ymport

    leg = O.bodies.append(ymport.stl("body.stl", material="leg", shift=Vector3(task["origin"])))
    engines(9.81, task["sliding"])
    O.engines = O.engines[:3] + [
        RotationEngine(ids=leg, angularVelocity=task["rate"], rotationAxis=y,
                       rotateAroundZero=True, zeroPoint=task["hip"])] + O.engines[3:]
    return {"leg": leg}


def sample():
    """Force on what is moved [N], and its moment [N m] or its height [m]."""
    if "leg" in parts:
        leg = parts["leg"]
        sums.append((utils.sumForces(leg, x), utils.sumForces(leg, z),
                     utils.sumTorques(leg, y, task["hip"])))
    else:
        sums.append((*(utils.sumForces(parts["low"], axis) for axis in (x, z)),
                     utils.sumForces(parts["high"], x), O.bodies[parts["plate"]].state.pos[2]))


if not os.path.exists("bed.yade.gz"):
    bed()
if task["rows"]:
    done = f"{task['name']}.json"
    if os.path.exists(done):
        kept = json.load(open(done))
        parts, table = kept["parts"], kept["table"]
        O.load(f"{task['name']}.yade.gz")
    else:
        O.load("bed.yade.gz")
        parts, table = (legs if "hip" in task else glued)(), []
        O.engines = O.engines + [PyRunner(iterPeriod=5, command="sample()")]
    while len(table) < task["rows"]:
        sums = []
        O.run(task["every"], True)
        table.append(np.mean(sums, axis=0).tolist())
        if len(table) % 20 == 0 or len(table) == task["rows"]:
            save(task["name"])
            json.dump({"parts": parts, "table": table}, open("new.json", "w"))
            os.rename("new.json", done)
'''


def packed(soil: engine.Soil, seed: int, box: Sequence[float], thickness: float, folder: Path,
           *, walls: bool) -> dict[str, Any]:  # fmt: skip
    """Write grains as `engine.lattice` does, and the spheres that bound them; task of their bed."""
    folder.mkdir(parents=True, exist_ok=True)
    engine.lattice(soil, seed, (*box[:4], 0.0), thickness, folder / "lattice.data")
    text = (folder / "lattice.data").read_text().partition("Atoms\n")[2]
    atoms, speeds = (np.loadtxt(part.splitlines()) for part in text.split("Velocities\n"))
    d, (x0, x1, y0, y1) = soil.diameter, box[:4]
    # The cell of YADE begins at 0 and is periodic in all directions; walls and room are in between.
    gap = 2.0 * d if walls else 0.0
    origin = np.array([gap - x0, -y0, 2.0 * d])
    top = atoms[:, 6].max() + engine.ROOM
    size = np.array([x1 - x0 + 2.0 * gap, y1 - y0, top + 4.0 * d])
    counts = [max(int(each / d), 1) for each in size]
    at = [(np.arange(n) + 0.5) * each / n for n, each in zip(counts, size, strict=True)]
    fixed = [(px, py, 1.5 * d) for px in at[0] for py in at[1]]
    if walls:
        fixed += [(px, py, pz) for px in (1.5 * d, size[0] - 1.5 * d)
                  for py in at[1] for pz in at[2] if pz > 2.5 * d]  # fmt: skip
    rows = np.column_stack([atoms[:, 2], atoms[:, 4:7] + origin, speeds[:, 1:4]])
    np.save(folder / "grains.npy", rows)
    np.save(folder / "fixed.npy", [(d, *each, 0.0, 0.0, 0.0) for each in fixed])
    # Of two equal spheres under PRESSURE, by Hertz and Mindlin.
    shear, reduced = soil.youngs / (2.0 * (1.0 + engine.POISSON)), 0.25 * d
    normal = PRESSURE * d**2 / (4.0 / 3.0 * soil.youngs / (2.0 * (1.0 - engine.POISSON**2)))
    overlap = (normal / math.sqrt(reduced)) ** (2.0 / 3.0)
    tangent = 4.0 * shear / (2.0 - engine.POISSON) * math.sqrt(reduced * overlap)
    return {
        "size": size.tolist(), "origin": origin.tolist(), "fixed": len(fixed),
        "youngs": soil.youngs, "poisson": engine.POISSON, "density": engine.DENSITY,
        "restitution": engine.RESTITUTION, "sliding": soil.sliding, "rolling": soil.rolling,
        "settled": soil.settled, "leg_friction": soil.leg_friction,
        "stiffness": tangent * reduced**2, "time_step": soil.time_step,
        "fall": 0.25 + 5.0 * math.sqrt(thickness / engine.GRAVITY), "rows": 0,
    }  # fmt: skip


def simulate(task: dict[str, Any], folder: Path) -> np.ndarray:
    """Run YADE on a task: its rows; none makes the bed alone."""
    (folder / "task.json").write_text(json.dumps(task))
    (folder / "deck.py").write_text(DECK)
    command = ["yade", "-n", "-x", "-j1", "deck.py"]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    kept = folder / f"{task['name']}.json" if task["rows"] else None
    return np.array(json.loads(kept.read_text())["table"] if kept else [])


def layering(
    soil: engine.Soil, task: dict[str, Any], area: float, folder: Path
) -> tuple[float, float]:
    """Surface above the floor [m] and volume fraction, as `engine.layering` has them."""
    grains = np.load(folder / "bed.npy")
    grains[:, 3] -= task["origin"][2]
    return engine.layering(soil, grains, area)


def cell(soil: engine.Soil, kind: str, seed: int, work: Path, out: Path) -> None:
    """Shear a cell as `elements.test` does, and write its rows."""
    soil = replace(soil, diameter_mm=elements.DIAMETER_MM)
    sizes = elements.SMALL if kind in ("firm", "light") else elements.CELL
    folder, box = work / f"{soil.name}_{seed}_{sizes[2]:g}", elements.box_of(soil, sizes)
    area, layer = (box[1] - box[0]) * (box[3] - box[2]), elements.LAYER * soil.diameter
    task = packed(soil, seed, box, sizes[2] * soil.diameter, folder, walls=False)
    simulate(task, folder)
    top, fraction = layering(soil, task, area, folder)
    pressure, inertial, strain = elements.LOADS[kind]
    height = top - 2.0 * layer
    speed = inertial * height / (soil.diameter * math.sqrt(engine.DENSITY / pressure))
    floor = task["origin"][2]
    rows = simulate(task | {
        "name": kind, "rows": round(strain / elements.ROW), "speed": speed,
        "every": round(elements.ROW * height / speed / soil.time_step),
        "low": floor + layer, "high": floor + top - layer, "load": pressure * area,
    }, folder)  # fmt: skip
    x, z, above, rise = rows.T
    sheared = elements.ROW * (np.arange(x.size) + 0.5)
    stress = np.array([x, -z, -above]) / area
    _, columns, form = elements.SHEAR
    lines = [form % row for row in zip(sheared, (rise - rise[0]) / height, *stress, strict=True)]
    run.write(out / f"{soil.name}_{kind}_{seed}.csv", soil, seed, fraction,
              f"by YADE, cell under {pressure:g} Pa", [columns, *lines])  # fmt: skip


def stirred(soil: engine.Soil, shape: str, seed: int, work: Path, out: Path) -> None:
    """Stir a bed with a leg of Li's rig as `run.record` does, and write the forces."""
    rig = run.Rig(shape)
    length, breadth, thickness = rig.bed
    folder = work / f"{soil.name}_{seed}_leg"
    box = (-0.5 * length, 0.5 * length, -0.5 * breadth, 0.5 * breadth)
    task = packed(soil, seed, box, thickness, folder, walls=True)
    simulate(task, folder)
    surface, fraction = layering(soil, task, length * breadth, folder)
    hip = np.array([0.0, 0.0, surface + 1e-3 * rig.hip_height_mm])
    leg = Leg(shape=shape, chord=1e-3 * (rig.length_mm - 0.5 * rig.thickness_mm),
              half_thickness=5e-4 * rig.thickness_mm, width=1e-3 * rig.width_mm)  # fmt: skip
    first, last = rig.swing_deg
    engine.leg_mesh(leg, math.radians(first), (0.0, hip[2]), folder / "body.stl")
    rows = simulate(task | {
        "name": shape, "rows": round((last - first) / run.EVERY_DEG), "rate": soil.rate,
        "every": round(math.radians(run.EVERY_DEG) / soil.rate / soil.time_step),
        "hip": (hip + task["origin"]).tolist(),
    }, folder)  # fmt: skip
    theta = first + run.EVERY_DEG * (np.arange(len(rows)) + 0.5)
    lines = [f"{t:.2f},{x:.4f},{z:.4f},{m:.6f}" for t, (x, z, m) in zip(theta, rows, strict=True)]
    sizes = f"{rig.length_mm:g} x {rig.width_mm:g} x {rig.thickness_mm:g} mm"
    words = f"by YADE, {shape} leg of {sizes}, hip {rig.hip_height_mm:g} mm above the soil"
    run.write(out / f"{soil.name}_{shape}_{seed}.csv", soil, seed, fraction, words,
              ["theta_deg,Fx_N,Fz_N,M_Nm", *lines])  # fmt: skip


def main() -> None:
    """Make records that are missing, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("records", nargs="+", help="SOIL_TEST_SEED or SOIL_LEG_SEED")
    parser.add_argument("--work", type=Path, required=True, help="folder for the engine's files")
    parser.add_argument("--out", type=Path, required=True, help="folder for the records")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for stem in options.records:
        name, body, seed = stem.split("_")
        if not (options.out / f"{stem}.csv").exists():
            make = cell if body in elements.LOADS else stirred
            make(run.soils()[name], body, int(seed), options.work, options.out)


if __name__ == "__main__":
    main()
