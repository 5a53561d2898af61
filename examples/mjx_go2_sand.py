"""Go2s on as many soils in MuJoCo MJX: the force of soil inside ``jax.jit``, for policies.

    pip install mujoco-mjx 'terraphi[plot]'
    python examples/mjx_go2_sand.py --worlds 256 --steps 500 --out sinkage.png

Each world draws φ and density from one soil. Its robot trots on the spot; the picture has the
deepest print of each world over its φ. Put your policy in the place of :func:`trot`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

import terraphi
from terraphi.experiment.documents import shipped_file
from terraphi.laws.foot import Foot
from terraphi.laws.wrench import force
from terraphi.robot.joint_log import FEET, JOINTS

STAND = jnp.tile(jnp.array([0.0, 0.9, -1.8]), 4)
"""Angles of hip, thigh and calf of each leg [rad]."""
LIFT, PERIOD_S = jnp.tile(jnp.array([0.0, 0.25, -0.5]), 4), 0.5
"""What a swing adds to them [rad], and its period [s]."""
PAIRS = jnp.repeat(jnp.array([0.0, jnp.pi, jnp.pi, 0.0]), 3)
"""Phase of each joint in a trot [rad]: FR and RL, FL and RR move together."""
P_GAIN, D_GAIN = 60.0, 2.0
"""Of the joints [N m/rad] and [N m s/rad]."""
STIFFNESS = 20e3
"""Of soil that holds a foot [N/m]: below 2 m / step², with 0.11 kg the least mass of a Go2's foot
55 kN/m at 2 ms."""


class World(NamedTuple):
    """A robot and its soil; with a leading axis, many."""

    robot: mjx.Data
    held: tuple[jax.Array, jax.Array]
    """Force and moment of the soil on the feet at the step before, shape [foot, 3] each."""
    phi_deg: jax.Array
    density: jax.Array


def build() -> mujoco.MjModel:
    """The Go2 that terraphi ships, without a floor."""
    spec = mujoco.MjSpec.from_file(str(shipped_file("robots", "go2", ".xml")))
    spec.option.timestep = 0.002
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    return spec.compile()


def worlds(model: mujoco.MjModel, soil: Any, n: int, seed: int = 0) -> World:
    """Robots that stand on the surface, at rest, on n draws of a soil."""
    data = mujoco.MjData(model)
    data.qpos[7:] = STAND
    mujoco.mj_kinematics(model, data)
    feet = [model.geom(foot).id for foot in FEET]
    data.qpos[2] -= (data.geom_xpos[feet, 2] - model.geom_size[feet, 0]).min()
    mujoco.mj_forward(model, data)
    robot, zero = mjx.put_data(model, data), jnp.zeros((len(FEET), 3))
    drawn = soil.draws(n, rng=seed)
    many = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf, (n, *jnp.shape(leaf))), (robot, (zero, zero))
    )
    world = World(*many, jnp.asarray(drawn.phi_deg), jnp.asarray(drawn.density))
    # On one device from the start; else a second step is compiled for what the first returns.
    return jax.device_put(world, jax.devices()[0])


def trot(robot: mjx.Data) -> jax.Array:
    """Angles that the joints are driven to [rad], shape [12]."""
    swing = jnp.maximum(jnp.sin(2.0 * jnp.pi * robot.time / PERIOD_S + PAIRS), 0.0)
    return STAND + swing * LIFT


def stepper(model: mujoco.MjModel, policy: Any = trot) -> Any:
    """A step of many worlds, compiled, World -> World."""
    on_device = mjx.put_model(model)
    feet = np.array([model.geom(foot).id for foot in FEET])
    bodies, ball = model.geom_bodyid[feet], Foot(float(model.geom_size[feet[0], 0]))
    names = [f"{foot}_{joint}_joint" for foot in FEET for joint in JOINTS]
    angles, dofs = (np.array([int(getattr(model.joint(name), key)[0]) for name in names])
                    for key in ("qposadr", "dofadr"))  # fmt: skip
    limit = model.jnt_actfrcrange[[model.joint(name).id for name in names], 1]

    def step(world: World) -> World:
        # A step leaves the places from before it.
        robot = mjx.com_pos(on_device, mjx.kinematics(on_device, world.robot))
        place = robot.geom_xpos[feet]
        # J of each foot's centre: its velocity is J'q̇, and the soil's force f is the generalized
        # force J f.
        jacobian = jnp.stack([
            mjx.jac(on_device, robot, point, body)[0]
            for point, body in zip(place, bodies, strict=True)
        ])  # fmt: skip
        velocity = jnp.einsum("fvi,v->fi", jacobian, robot.qvel)
        held = force(
            ball, place, velocity, phi_deg=world.phi_deg, density=world.density, held=world.held,
            step=model.opt.timestep, stiffness=STIFFNESS,
        )  # fmt: skip
        torque = P_GAIN * (policy(robot) - robot.qpos[angles]) - D_GAIN * robot.qvel[dofs]
        applied = jnp.einsum("fvi,fi->v", jacobian, held[0])
        applied = applied.at[dofs].add(jnp.clip(torque, -limit, limit))
        moved = mjx.step(on_device, robot.replace(qfrc_applied=applied))
        return World(moved, held, world.phi_deg, world.density)

    return jax.jit(jax.vmap(step))


def main() -> None:
    """Trot, print how deep the feet sink in, and draw it over φ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=256)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--soil", default="loose dry sand")
    parser.add_argument("--out", type=Path, default=Path("sinkage.png"))
    options = parser.parse_args()

    model = build()
    world, step = worlds(model, terraphi.soil(options.soil), options.worlds), stepper(model)
    feet = np.array([model.geom(foot).id for foot in FEET])
    radius, deepest = float(model.geom_size[feet[0], 0]), jnp.zeros(options.worlds)
    for _ in range(options.steps):
        world = step(world)
        below = radius - world.robot.geom_xpos[:, feet, 2].min(axis=1)
        deepest = jnp.maximum(deepest, below)
    low, middle, high = 1e3 * np.quantile(deepest, [0.05, 0.5, 0.95])
    print(f"deepest print {middle:.0f} mm, {low:.0f} to {high:.0f} mm in 9 of 10 worlds")  # noqa: T201

    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 3.4), layout="constrained")
    axes = figure.subplots()
    dots = axes.scatter(world.phi_deg, 1e3 * deepest, s=9.0, c=world.density)
    figure.colorbar(dots, label="bulk density [kg/m³]")
    axes.set(xlabel="φ in plane strain [deg]", ylabel="deepest print of a foot [mm]")
    figure.savefig(options.out, dpi=150)


if __name__ == "__main__":
    main()
