"""The example of MuJoCo MJX against plain MuJoCo and NumPy's forces."""

from __future__ import annotations

import numpy as np
import pytest

import terraphi
from terraphi.laws.foot import Foot
from terraphi.laws.wrench import force
from terraphi.robot.joint_log import FEET, JOINTS

jax = pytest.importorskip("jax")
pytest.importorskip("mujoco.mjx")

pytestmark = pytest.mark.slow


def test_twenty_steps_of_many_worlds_are_those_of_mujoco() -> None:
    import mjx_go2_sand as example
    import mujoco

    model = example.build()
    many = example.worlds(model, terraphi.soil("dense dry sand"), 4, seed=3)
    assert np.ptp(many.phi_deg) > 1.0
    phi, density = np.array(many.phi_deg), np.array(many.density)
    first, step = many, example.stepper(model)
    for _ in range(20):
        many = step(many)
    feet = [model.geom(foot).id for foot in FEET]
    joints = [model.joint(f"{foot}_{joint}_joint") for foot in FEET for joint in JOINTS]
    for world in range(4):
        data = mujoco.MjData(model)
        data.qpos[:] = first.robot.qpos[world]
        held = np.zeros((4, 3)), np.zeros((4, 3))
        for i in range(20):
            mujoco.mj_forward(model, data)
            place, velocity, jacobian = data.geom_xpos[feet], np.zeros((4, 3)), np.zeros((3, 18))
            applied = np.zeros(18)
            for k, geom in enumerate(feet):
                mujoco.mj_jacGeom(model, data, jacobian, None, geom)
                velocity[k] = jacobian @ data.qvel
            held = force(
                Foot(0.022), place, velocity, phi_deg=phi[world], density=density[world],
                held=held, step=0.002, stiffness=example.STIFFNESS,
            )  # fmt: skip
            for k, geom in enumerate(feet):
                mujoco.mj_jacGeom(model, data, jacobian, None, geom)
                applied += jacobian.T @ held[0][k]
            swing = np.sin(2.0 * np.pi * 0.002 * i / example.PERIOD_S + np.array(example.PAIRS))
            angle = np.array(example.STAND) + np.maximum(swing, 0.0) * np.array(example.LIFT)
            for target, joint in zip(angle, joints, strict=True):
                at, dof = int(joint.qposadr[0]), int(joint.dofadr[0])
                torque = example.P_GAIN * (target - data.qpos[at])
                torque -= example.D_GAIN * data.qvel[dof]
                applied[dof] += np.clip(torque, *model.jnt_actfrcrange[joint.id])
            data.qfrc_applied[:] = applied
            mujoco.mj_step(model, data)
        assert held[0][:, 2].max() > 5.0  # the robot stands on the soil
        np.testing.assert_allclose(many.robot.qpos[world], data.qpos, atol=2e-4)
        np.testing.assert_allclose(many.held[0][world], held[0], rtol=0.02, atol=0.2)
