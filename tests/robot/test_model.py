"""The Go2's numbers against its URDF and pinocchio, and what is said of unusable files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import FEET, JOINT_NAMES
from terraphi.robot.model import Quadruped

SMALL = """
mass = 20.0
foot_radius = 0.03
[legs]
FR = { hip = [0.3, -0.05, 0], thigh = [0, -0.1, 0], calf = [0, 0, -0.3], foot = [0, 0, -0.32] }
FL = { hip = [0.3, 0.05, 0], thigh = [0, 0.1, 0], calf = [0, 0, -0.3], foot = [0, 0, -0.32] }
RR = { hip = [-0.3, -0.05, 0], thigh = [0, -0.1, 0], calf = [0, 0, -0.3], foot = [0, 0, -0.32] }
RL = { hip = [-0.3, 0.05, 0], thigh = [0, 0.1, 0], calf = [0, 0, -0.3], foot = [0, 0, -0.32] }
"""

NO_SUCH_BODY = "{ link = 'hip', mass = 1, centre = [0, 0, 0], inertia = [1, 1, 9, 0, 0, 0] }"


def written(tmp_path: Path, text: str, name: str = "robot.toml") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_shipped_go2_is_what_its_urdf_says(go2_urdf: Path) -> None:
    shipped, read = Quadruped.load("go2"), Quadruped.load(go2_urdf)
    assert shipped.legs == read.legs
    assert shipped.torque_limit == read.torque_limit == (23.7, 23.7, 45.43)
    assert shipped.imu == read.imu
    assert shipped.mass == pytest.approx(read.mass, abs=1e-9)
    assert shipped.joint_order == JOINT_NAMES
    assert shipped.has_masses


def test_links_weigh_what_pinocchio_says(pinocchio: Any, floating: Any) -> None:
    robot = Quadruped.load("go2")
    assert robot.mass == pytest.approx(pinocchio.computeTotalMass(floating), abs=1e-9)
    for i, name in enumerate(JOINT_NAMES):
        body = floating.inertias[floating.getJointId(f"{name}_joint")]
        at = divmod(i, 3)
        assert robot.chain.mass[at] == pytest.approx(body.mass, abs=1e-12)
        np.testing.assert_allclose(robot.chain.first[at], body.mass * body.lever, atol=1e-12)
        second = robot.chain.second[at]
        about_origin = body.inertia + body.mass * (
            body.lever @ body.lever * np.eye(3) - np.outer(body.lever, body.lever)
        )
        np.testing.assert_allclose(np.trace(second) * np.eye(3) - second, about_origin, atol=1e-12)


@pytest.mark.parametrize("mass", ["true", "'20.0'"])
def test_what_is_no_number_is_no_mass(tmp_path: Path, mass: str) -> None:
    path = written(tmp_path, SMALL.replace("mass = 20.0", f"mass = {mass}"))
    with pytest.raises(InputError, match=r"robot\.toml.*mass"):
        Quadruped.load(path)


def test_small_file_is_enough_for_geometry(tmp_path: Path) -> None:
    robot = Quadruped.load(written(tmp_path, SMALL))
    assert robot.legs.RL.foot == (0.0, 0.0, -0.32)
    assert not robot.has_masses
    assert robot.legs.RL.signs == (1, 1, 1)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mass = 20.0", "", "key 'mass' is missing"),
        ("mass = 20.0", "mass = -1", "mass = -1: should be greater than 0"),
        ("foot_radius", "foot_radios", "unknown key 'foot_radios'; did you mean 'foot_radius'"),
        ("RR = {", "rr = {", r"unknown key 'legs.rr'; did you mean 'RR'"),
        ("foot = [0, 0, -0.32] }\nFL", "foot = [0, 0, 0] }\nFL", "without length"),
        ("[legs]", "joint_order = ['FR_hip', 'FR_knee']\n[legs]", "joint_order has 'FR_knee'"),
        ("[legs]", "joint_order = ['FR_hip']\n[legs]", "each of the 12 joints is expected once"),
        ("[legs]", "[legs", "not valid TOML"),
        (
            "-0.32] }\nFL",
            "-0.32], bodies = [" + NO_SUCH_BODY + "] }\nFL",
            "no mass distribution has",
        ),
        ("-0.32] }\nFL", "-0.32], signs = [1, 0, 1] }\nFL", "signs"),
    ],
)
def test_wrong_file_is_refused_in_one_sentence(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    assert old in SMALL
    with pytest.raises(InputError, match=words) as caught:
        Quadruped.load(written(tmp_path, SMALL.replace(old, new, 1)))
    assert "robot.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_robot_and_missing_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean 'go2'"):
        Quadruped.load("go3")
    with pytest.raises(InputError, match="no such file"):
        Quadruped.load(tmp_path / "absent.urdf")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file"):
        Quadruped.load(tmp_path / "binary.toml")


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
                f'<link name="{name}"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>'
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
    robot = Quadruped.load(written(tmp_path, small_urdf(), "small.urdf"))
    assert robot.mass == pytest.approx(5.0 + 4 * 1.6)
    assert robot.foot_radius == 0.02
    assert robot.legs.FR.signs == (1, -1, 1)
    assert robot.legs.FL.signs == (1, 1, 1)
    assert robot.legs.RL.hip == (-0.2, 0.1, 0.0)
    assert robot.legs.RL.foot == (0.0, 0.0, -0.25)
    foot = robot.legs.RL.bodies[-1]
    # Turned by a quarter about z, the foot's own x is the calf's y.
    np.testing.assert_allclose(foot.inertia, [0.002, 0.001, 0.002, 0, 0, 0], atol=1e-12)
    assert robot.torque_limit is None


def mounted(rpy: str = "0 0 0") -> str:
    """The same robot, each leg on a mount that is fixed to the trunk 0.05 m above its middle."""
    text = small_urdf()
    for foot in FEET:
        text = text.replace(
            f'type="revolute"><parent link="trunk"/><child link="{foot}_hip"/>',
            f'type="revolute"><parent link="{foot}_mount"/><child link="{foot}_hip"/>',
        )
        mount = (
            f'<link name="{foot}_mount"/><joint name="{foot}_mount_joint" type="fixed">'
            f'<parent link="trunk"/><child link="{foot}_mount"/>'
            f'<origin xyz="0.01 0 0.05" rpy="{rpy}"/></joint>'
        )
        text = text.replace("</robot>", mount + "</robot>")
    imu = (
        '<link name="imu"/><joint name="imu_joint" type="fixed"><parent link="trunk"/>'
        '<child link="imu"/><origin xyz="0 0 0.1"/></joint>'
    )
    return text.replace("</robot>", imu + "</robot>")


def test_what_a_hip_hangs_on_counts_as_part_of_the_trunk(tmp_path: Path) -> None:
    robot = Quadruped.load(written(tmp_path, mounted(), "mounted.urdf"))
    assert robot.legs.RL.hip == pytest.approx((-0.19, 0.1, 0.05))
    assert robot.imu == pytest.approx((0.0, 0.0, 0.1))
    # What the trunk itself is fixed to does not matter, however it is turned.
    world = (
        '<link name="world"/><joint name="w" type="fixed"><parent link="world"/>'
        '<child link="trunk"/><origin xyz="1 2 3" rpy="0 0 1"/></joint></robot>'
    )
    fixed = Quadruped.load(written(tmp_path, mounted().replace("</robot>", world), "fixed.urdf"))
    assert fixed.legs == robot.legs
    loop = world.replace('"world"/><child link="trunk"', '"FR_mount"/><child link="trunk"')
    with pytest.raises(InputError, match="hangs on itself by way of"):
        Quadruped.load(written(tmp_path, mounted().replace("</robot>", loop), "loop.urdf"))
    turned = Quadruped.load(written(tmp_path, mounted("0 0 0.3"), "turned.urdf"))
    assert (robot.legs.FR.axes is None, turned.legs.FR.axes is None) == (True, False)
    apart = re.sub(
        r'"fixed"(><parent link="trunk"/><child link="FL_mount"/>)', r'"floating"\1', mounted()
    )
    with pytest.raises(InputError, match="the legs hang on several links"):
        Quadruped.load(written(tmp_path, apart, "apart.urdf"))


@pytest.mark.parametrize(
    ("pattern", "new", "words"),
    [
        ('<sphere radius="0.02"/>', '<sphere radius="${r}"/>', "a number cannot be read"),
        ('<sphere radius="0.02"/>', "<sphere/>", "lacks its radius"),
        ('<link name="FL_foot">', '<link name="other">', "names link 'FL_foot', which is not"),
        ('<parent link="FL_calf"/><child', '<parent link="FL_foot"/><child', "or on itself"),
        ("FR_calf_joint", "front_wheel", "no revolute joint is named like FR_calf"),
        ("</robot>", "", "not valid XML"),
        ('<robot name="small">', "<sdf>", "outermost element is <sdf>"),
        ('xyz="0 0 -0.25"/><axis', 'xyz="0 0 x"/><axis', "a number cannot be read"),
        ('<mass value="5"/>', "<mass/>", "lacks its value"),
        ('<parent link="FR_thigh"/>', '<parent link="trunk"/>', "hangs on link 'trunk'"),
        ('<parent link="RL_calf"/>', '<parent link="trunk"/>', "nothing is fixed to link"),
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
        Quadruped.load(written(tmp_path, text, "small.urdf"))
    assert "small.urdf" in str(caught.value)
    assert "\n" not in str(caught.value)
