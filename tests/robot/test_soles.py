"""A robot on two flat soles: what is missing of its log, and φ under a sole in MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest
from scipy.spatial import ConvexHull

import terraphi
from terraphi.experiment.errors import InputError
from terraphi.laws.wrench import Mesh
from terraphi.robot.model import Quadruped

LENGTH, WIDTH, HEIGHT = 0.2, 0.09, 0.02
LINK = '<inertial pos="0 0 -0.1" mass="2" diaginertia="0.01 0.01 0.01"/>'
LEG = f"""<body name="{{0}}_hip" pos="0 {{1}} 0"><joint name="{{0}}_hip_roll" axis="1 0 0"/>{LINK}
<body><joint name="{{0}}_hip_pitch" axis="0 1 0"/>{LINK}
<body pos="0 0 -0.35"><joint name="{{0}}_knee" axis="0 1 0"/>{LINK}
<body pos="0 0 -0.35"><joint name="{{0}}_ankle" axis="0 1 0"/>
<geom type="box" size="{LENGTH / 2} {WIDTH / 2} {HEIGHT / 2}" mass="1"/></body></body></body>
</body>"""


def test_a_biped_is_told_what_is_missing(tmp_path: Path) -> None:
    arm = f'<body pos="0 0 0.3"><joint name="elbow"/>{LINK}</body>'
    legs = LEG.format("left", 0.1) + LEG.format("right", -0.1)
    (tmp_path / "biped.xml").write_text(
        f"<mujoco><worldbody><body>{LINK}{legs}{arm}</body></worldbody></mujoco>"
    )
    words = (
        r"2 limbs \(left_hip_roll to left_ankle \(4\), right_hip_roll .*flat sole, which is a plate"
    )
    with pytest.raises(InputError, match=words):
        Quadruped.load(tmp_path / "biped.xml")


def box() -> Mesh:
    """Faces of a sole about the middle of its lower side."""
    sides = (-0.5 * LENGTH, 0.5 * LENGTH), (-0.5 * WIDTH, 0.5 * WIDTH), (0.0, HEIGHT)
    corners = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    hull = ConvexHull(corners)
    a, b, c = corners[hull.simplices].swapaxes(0, 1)
    inward = np.vecdot(np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return Mesh.of(corners, faces, longest=0.03)


def test_phi_under_a_sole_that_takes_over_the_weight() -> None:
    """60 kg are lowered onto one sole at 20 mm/s; soil of 30° bears them at 45 mm."""
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
        <option timestep="0.002" integrator="implicitfast"/>
        <worldbody><body name="sole" pos="0 0 0.005"><joint name="down" type="slide" axis="0 0 1"/>
        <geom type="box" size="{LENGTH / 2} {WIDTH / 2} {HEIGHT / 2}" mass="60"/></body></worldbody>
        <actuator><velocity joint="down" kv="200000"/></actuator></mujoco>""")
    data, sole = mujoco.MjData(model), box()
    sand = terraphi.soil(phi="30±1", density=1550)
    data.ctrl[0] = -0.02
    rows: list[tuple[float, float]] = []
    while not rows or rows[-1][1] < 60.0 * 9.81:
        force, _ = sand.force(sole, data.xpos[1], [0.0, 0.0, data.qvel[0]], inertia=False)
        data.xfrc_applied[1, :3] = force
        mujoco.mj_step(model, data)
        rows.append((-1e3 * data.xpos[1, 2], force[2]))
    table = pd.DataFrame(rows[::10], columns=["sinkage_mm", "force_N"])
    answer = terraphi.invert(table, tool=f"plate:{1e3 * LENGTH:g}x{1e3 * WIDTH:g}", density=1550)
    low, high = answer.phi.ci95
    assert answer.verdict == "consistent"
    assert low < 30.0 < high
