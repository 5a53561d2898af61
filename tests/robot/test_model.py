"""The shipped Go2 against its URDF, robots of one's own, and unusable files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from terraphi.experiment.documents import DATA, shipped_file
from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import FEET, JOINT_NAMES
from terraphi.robot.legs import Legs
from terraphi.robot.model import Robot


def written(tmp_path: Path, text: str, name: str) -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_shipped_go2_is_what_its_urdf_says(go2_urdf: Path) -> None:
    shipped, read = Robot.load("go2"), Robot.load(go2_urdf)
    assert shipped.torque_limit == read.torque_limit == (23.7, 23.7, 45.43)
    assert shipped.imu == read.imu == (-0.02557, 0.0, 0.04232)
    assert shipped.mass == pytest.approx(read.mass, abs=1e-9)
    assert (shipped.joint_order, shipped.foot_radius) == (JOINT_NAMES, 0.022)
    np.testing.assert_allclose(shipped.leg_length, 0.426, rtol=1e-12)


def small_urdf() -> str:
    """A robot of bare links, whose right thighs turn about −y."""
    parts = [
        '<robot name="small"><link name="trunk"><inertial><mass value="5"/>',
        '<inertia ixx="1" iyy="1" izz="1"/></inertial></link>',
    ]
    for foot in FEET:
        x, y = (0.2 if foot[0] == "F" else -0.2), (0.1 if foot[1] == "L" else -0.1)
        before = "trunk"
        for joint, axis, place in (
            ("hip", "1 0 0", f"{x} {y} 0"),
            ("thigh", "0 1 0" if y > 0 else "0 -1 0", f"0 {y} 0"),
            ("calf", "0 1 0", "0 0 -0.25"),
        ):
            name = f"{foot}_{joint}"
            parts.append(
                f'<link name="{name}"><visual><geometry><mesh filename="absent.dae"/></geometry>'
                '</visual><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>'
                '<inertia ixx="0.002" iyy="0.001" izz="0.0015"/></inertial></link>'
                f'<joint name="{name}_joint" type="revolute"><parent link="{before}"/>'
                f'<child link="{name}"/><origin xyz="{place}"/><axis xyz="{axis}"/></joint>'
            )
            before = name
        parts.append(
            f'<link name="{foot}_foot"><inertial><origin rpy="0 0 1.5707963267948966"/>'
            '<mass value="0.1"/><inertia ixx="0.001" iyy="0.002" izz="0.002"/></inertial>'
            '<collision><geometry><sphere radius="0.02"/></geometry></collision></link>'
            f'<joint name="{foot}_foot_joint" type="fixed"><parent link="{foot}_calf"/>'
            f'<child link="{foot}_foot"/><origin xyz="0 0 -0.25"/></joint>'
        )
    return "".join(parts) + "</robot>"


def test_urdf_of_another_robot(tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, small_urdf(), "small.urdf"))
    assert (robot.name, robot.foot_radius, robot.torque_limit) == ("small", 0.02, None)
    assert robot.mass == pytest.approx(5.0 + 4 * 1.6)
    # Thighs turn about ± y: the same angle swings the feet of both sides apart.
    place = Legs(robot, np.tile([0.0, 0.3, 0.0], (1, 4, 1))).place[0]
    swing = 0.5 * np.sin(0.3)
    np.testing.assert_allclose(place[:2, 0], [0.2 + swing, 0.2 - swing], atol=1e-12)
    np.testing.assert_allclose(place[:, 1], [-0.2, 0.2, -0.2, 0.2], atol=1e-12)


def test_a_toml_adds_what_the_model_lacks(tmp_path: Path) -> None:
    written(tmp_path, small_urdf(), "small.urdf")
    order = ", ".join(f"'{name}'" for name in reversed(JOINT_NAMES))
    text = f"model = 'small.urdf'\nmass = 20\ntorque_limit = [1, 2, 3]\njoint_order = [{order}]"
    robot = Robot.load(written(tmp_path, text, "robot.toml"))
    assert (robot.mass, robot.torque_limit) == (20.0, (1.0, 2.0, 3.0))
    assert robot.joint_order == JOINT_NAMES[::-1]


def test_mjcf_with_meshes_and_feet_that_are_spheres(tmp_path: Path) -> None:
    text = shipped_file("robots", "go2", ".xml").read_text()
    for foot in FEET:
        text = re.sub(
            rf'<body name="{foot}_foot".*?</body>',
            f'<geom name="{foot}" type="sphere" size="0.022" pos="0 0 -0.213"/>'
            '<geom type="mesh" mesh="calf"/>',
            text,
            flags=re.DOTALL,
        )
    text = text.replace("<worldbody>", '<asset><mesh name="calf" file="calf.stl"/></asset>'
                        "<worldbody>").replace("<freejoint/>", "")  # fmt: skip
    robot, shipped = Robot.load(written(tmp_path, text, "own.xml")), Robot.load("go2")
    angle = np.random.default_rng(0).normal(size=(5, 4, 3))
    np.testing.assert_allclose(Legs(robot, angle).place, Legs(shipped, angle).place, atol=1e-12)
    assert robot.foot_radius == 0.022
    np.testing.assert_allclose(robot.leg_length, shipped.leg_length)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("model = 'small.urdf'\njoint_order = ['FR_hip']", "are expected, each once"),
        ("model = 'small.urdf'\njoints = {FR_hip = 'FR_hop'}", "no revolute joint 'FR_hop' in the"),
        ("model = 'small.urdf'\njoints = {FR_hip = 'FR_hip_joint'}", "FR_thigh, FR_calf, FL_hip"),
        ("model = 'absent.urdf'", "absent.urdf: no such file"),
        ("model = 'small.urdf'\nfoot_radius = 0.02\nsole = [0.2, 0.1]", "foot_radius and sole"),
        (
            "model = 'small.urdf'\n[joints]\nFR_hip = 'FR_hip_joint'\n[legs]\nR = ['FR_hop']",
            "joints and legs exclude each other; keep one",
        ),
        ("model = 'small.urdf'\nlegs = {left = []}", "robot.toml: legs.left"),
    ],
)
def test_wrong_toml_is_refused_in_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    written(tmp_path, small_urdf(), "small.urdf")
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        Robot.load(written(tmp_path, text, "robot.toml"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("pattern", "new", "words"),
    [
        ('<link name="FL_foot">', '<link name="other">', "MuJoCo cannot read it"),
        (
            '"FR_calf_joint" type="revolute"',
            '"FR_calf_joint" type="fixed"',
            "no joints FR_calf by the names of the model's 11",
        ),
        ("</robot>", "", "not valid XML"),
        ('<robot name="small">', "<sdf>", "outermost element is <sdf>"),
        (
            '<parent link="FR_hip"/>',
            '<parent link="FL_hip"/>',
            "'FR_thigh_joint' does not hang on the joint above it; list all joints",
        ),
        ('<parent link="RL_calf"/>', '<parent link="trunk"/>', "nothing is fixed to body"),
    ],
)
def test_wrong_urdf_is_refused_in_one_sentence(
    tmp_path: Path, pattern: str, new: str, words: str
) -> None:
    text = small_urdf()
    assert pattern in text
    text = text.replace(pattern, new)
    text = text.replace("</robot>", "</sdf>") if "<sdf>" in new else text
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        Robot.load(written(tmp_path, text, "small.urdf"))
    assert "small.urdf" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_feet_that_are_capsules_are_refused_with_the_remedy(tmp_path: Path) -> None:
    """Their caps are not at the body's origin, where a foot without a sphere is taken to be."""
    text = DATA.joinpath("robots", "go2.xml").read_text(encoding="utf-8")
    capsules = text.replace('type="sphere" size="0.022"', 'type="capsule" size="0.022 0.03"')
    assert capsules != text
    with pytest.raises(InputError, match="'FR_foot' is a capsule; put a sphere"):
        Robot.load(written(tmp_path, capsules, "robot.xml"))
    given = written(tmp_path, 'model = "robot.xml"\nfoot_radius = 0.022\n', "robot.toml")
    assert Robot.load(given).foot_radius == 0.022
    drawn = capsules.replace("0.022 0.03", '0.022 0.03" contype="0" conaffinity="0')
    assert Robot.load(written(tmp_path, drawn, "robot.xml")).foot_radius == 0.0
    given = written(tmp_path, 'model = "robot.xml"\nfoot_radius = 0.022\n', "robot.toml")
    assert Robot.load(given).foot_radius == 0.022
    drawn = capsules.replace("0.022 0.03", '0.022 0.03" contype="0" conaffinity="0')
    assert Robot.load(written(tmp_path, drawn, "robot.xml")).foot_radius == 0.0


def test_unknown_robot_and_missing_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean 'go2'"):
        Robot.load("go3")
    with pytest.raises(InputError, match="no such file"):
        Robot.load(tmp_path / "absent.urdf")


@pytest.mark.parametrize(
    "parts",
    [
        '<replicate count="300"><replicate count="300"><body/></replicate></replicate>',
        '<replicate count="nan"><body/></replicate>',
    ],
)
def test_a_model_that_copies_its_parts_without_end_is_refused(tmp_path: Path, parts: str) -> None:
    text = f'<mujoco><worldbody><body name="trunk"><freejoint/>{parts}</body></worldbody></mujoco>'
    with pytest.raises(InputError, match="copies counted"):
        Robot.load(written(tmp_path, text, "robot.xml"))
