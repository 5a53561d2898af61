"""Quadrupeds of other names and orders: the Go2 under another name has the Go2's forces."""

from __future__ import annotations

import re
import runpy
import xml.etree.ElementTree as ET
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from go2.logs import write_csv, write_mcap

from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import JOINT_NAMES
from terraphi.robot.legs import Legs
from terraphi.robot.logs import read_log
from terraphi.robot.logs.bags import JOINT_STATE
from terraphi.robot.model import Robot
from terraphi.robot.results import RobotForces, foot_forces

HERE = Path(__file__)
Walk = runpy.run_path(str(HERE.with_name("walker.py")))["Walk"]
LOGS = runpy.run_path(str(HERE.with_name("test_logs.py")))
small_urdf = runpy.run_path(str(HERE.with_name("test_model.py")))["small_urdf"]
GO2 = Robot.load("go2")

SIDES = {
    "anymal": {"FR": "RF", "FL": "LF", "RR": "RH", "RL": "LH"},
    "spot": {"FR": "fr", "FL": "fl", "RR": "hr", "RL": "hl"},
    "words": {"FR": "front_right", "FL": "front_left", "RR": "back_right", "RL": "back_left"},
}
KINDS = {
    "anymal": {"hip": "HAA", "thigh": "HFE", "calf": "KFE"},
    "spot": {"hip": "hx", "thigh": "hy", "calf": "kn"},
    "words": {"hip": "hip", "thigh": "upper_leg", "calf": "lower_leg"},
}
SHUFFLED = np.random.default_rng(3).permutation(12).tolist()


def names_like(style: str) -> list[str]:
    """Names of the twelve joints in the order of a JointLog."""
    if style == "nameless":
        return [f"j{number}" for number in SHUFFLED]
    link = "." if style == "spot" else "_"
    words = [name.split("_") for name in JOINT_NAMES]
    return [f"{SIDES[style][foot]}{link}{KINDS[style][joint]}" for foot, joint in words]


def go2_like(folder: Path, style: str) -> Path:
    """The Go2's MJCF with other names of joints, bodies that say nothing, and legs shuffled."""
    root = ET.fromstring(shipped_file("robots", "go2", ".xml").read_text())
    names = dict(zip((f"{name}_joint" for name in JOINT_NAMES), names_like(style), strict=True))
    for number, element in enumerate(root.iter()):
        if element.tag in {"body", "geom"}:
            element.set("name", f"part{number}")
        elif element.tag == "joint":
            element.set("name", names[element.attrib["name"]])
    trunk = root.find("worldbody/body")
    assert trunk is not None
    legs = trunk.findall("body")
    for leg in legs:
        trunk.remove(leg)
    trunk.extend([legs[i] for i in (2, 1, 3, 0)])
    path = folder / f"{style}.xml"
    ET.ElementTree(root).write(path)
    if style != "nameless":
        return path
    return named_by_table(path)


def named_by_table(model: Path, more: str = "") -> Path:
    """A robot's TOML that names the joints of a nameless model."""
    names = zip(JOINT_NAMES, names_like("nameless"), strict=True)
    table = "\n".join(f"{ours} = '{name}'" for ours, name in names)
    path = model.with_suffix(".toml")
    path.write_text(f"model = '{model.name}'\n{more}\n[joints]\n{table}")
    return path


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RobotForces]:
    """A table of a walk, and the Go2's forces by it."""
    path = tmp_path_factory.mktemp("walk") / "go2.csv"
    log, _ = Walk(duration=2.0).log()
    write_csv(path, log)
    return path, foot_forces(path, robot=GO2)


def renamed_table(source: Path, folder: Path, style: str) -> Path:
    """The same table with a robot's own names of joints, its columns shuffled."""
    header, *rows = [line.split(",") for line in source.read_text().splitlines()]
    names = dict(zip(JOINT_NAMES, names_like(style), strict=True))
    header = [re.sub("^[FR][RL]_(hip|thigh|calf)", lambda m: names[m[0]], name) for name in header]
    order = np.random.default_rng(0).permutation(len(header)).tolist()
    path = folder / f"{style}.csv"
    lines = [",".join(row[i] for i in order) for row in [header, *rows]]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("style", ["spot", "nameless"])
def test_a_go2_of_other_names_has_the_forces_of_a_go2(
    tmp_path: Path, walked: tuple[Path, RobotForces], style: str
) -> None:
    source, truth = walked
    robot = Robot.load(go2_like(tmp_path, style))
    assert robot.own_names == tuple(names_like(style))
    robot_forces = foot_forces(renamed_table(source, tmp_path, style), robot=robot)
    # Forces are single; the order of legs in the tree changes the order of MuJoCo's sums.
    np.testing.assert_allclose(robot_forces.forces.force, truth.forces.force, rtol=1e-5, atol=1e-4)
    assert [s.foot for s in robot_forces.stances] == [s.foot for s in truth.stances]


@pytest.mark.parametrize("order_given", [True, False])
def test_an_assumed_order_of_motors_is_noted(
    tmp_path: Path, walked: tuple[Path, RobotForces], order_given: bool
) -> None:
    """A LowState numbers its motors: by the TOML, in the model's names, or as the Go2 does."""
    log, names = Walk(duration=2.0).log()[0], names_like("nameless")
    order = np.random.default_rng(1).permutation(12) if order_given else np.arange(12)
    joints = {
        name: getattr(log, name).reshape(-1, 12)[:, order].reshape(-1, 4, 3)
        for name in ("angle", "velocity", "torque")
    }
    write_mcap(
        tmp_path / "walk.mcap", replace(log, **joints, foot_counts=np.zeros_like(log.quaternion))
    )
    listed = f"joint_order = {[names[i] for i in order]}" if order_given else ""
    robot = named_by_table(go2_like(tmp_path, "nameless").with_suffix(".xml"), listed)
    robot_forces = foot_forces(tmp_path / "walk.mcap", robot=robot)
    # Messages are single.
    np.testing.assert_allclose(
        robot_forces.forces.force, walked[1].forces.force, rtol=1e-3, atol=0.02
    )
    assert any("numbered FR_hip, FR_thigh" in note for note in robot_forces.warnings) != order_given


def test_joint_states_by_the_names_of_the_model(tmp_path: Path) -> None:
    order = np.random.default_rng(2).permutation(12)
    names = names_like("nameless")
    rows = LOGS["joint_states"]([names[i] for i in order], np.append(order, 12)[:12])
    path = LOGS["bag"](tmp_path / "bag", {"/joint_states": (JOINT_STATE, rows)})
    joint_log = read_log(path, robot=go2_like(tmp_path, "nameless"))
    np.testing.assert_array_equal(joint_log.torque, LOGS["log"].torque)
    with pytest.raises(InputError, match="'j"):
        read_log(path)


def published(name: str) -> Path:
    """The URDF of a robot that example-robot-data brings."""
    try:
        files = metadata.files("example-robot-data") or []
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    return Path(str(next(f for f in files if f.name == f"{name}.urdf").locate()))


def test_two_joints_a_leg(tmp_path: Path) -> None:
    root = ET.fromstring(small_urdf())
    for joint in root.iter("joint"):
        if (axis := joint.find("axis")) is not None and axis.get("xyz") == "1 0 0":
            joint.set("type", "fixed")
    (tmp_path / "own.urdf").write_text(ET.tostring(root, encoding="unicode"))
    robot = Robot.load(tmp_path / "own.urdf")
    assert robot.there.tolist() == [[False, True, True]] * 4
    place = Legs(robot, np.zeros((1, 4, 3))).place[0]
    assert np.sign(place[:, :2]).tolist() == [[1, -1], [1, 1], [-1, -1], [-1, 1]]


def test_exchanged_axes_of_hip_and_thigh_are_noted(tmp_path: Path) -> None:
    text = small_urdf().replace('xyz="1 0 0"', 'xyz="A"').replace('xyz="0 -1 0"', 'xyz="0 1 0"')
    text = text.replace('xyz="0 1 0"', 'xyz="1 0 0"', 1).replace('xyz="A"', 'xyz="0 1 0"', 1)
    (tmp_path / "own.urdf").write_text(text.replace('xyz="A"', 'xyz="1 0 0"'))
    (note,) = (note for note in Robot.load(tmp_path / "own.urdf").notes if "disagree" in note)
    assert "the hip and thigh of FR have each other's axes" in note


def test_a_table_of_names_fixes_what_is_wrong(tmp_path: Path) -> None:
    """Left and right are exchanged in a model's names: noted, and mended by the table."""
    text = small_urdf()
    swapped = re.sub("([FR])([RL])(?=_)", lambda m: m[1] + "RL"[m[2] == "R"], text)
    (tmp_path / "own.urdf").write_text(swapped)
    assert any("disagree" in note for note in Robot.load(tmp_path / "own.urdf").notes)
    table = "\n".join(f"{n} = '{n[0]}{'RL'[n[1] == 'R']}{n[2:]}_joint'" for n in JOINT_NAMES)
    (tmp_path / "own.toml").write_text(f"model = 'own.urdf'\n[joints]\n{table}")
    robot = Robot.load(tmp_path / "own.toml")
    assert not any("disagree" in note for note in robot.notes)
    place = Legs(robot, np.zeros((1, 4, 3))).place[0]
    assert np.sign(place[:, :2]).tolist() == [[1, -1], [1, 1], [-1, -1], [-1, 1]]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("centauro", r"nothing is fixed to body 'wheel_\d'"),
        ("iris", "stands on 0 limbs"),
        (
            "borinot_flying_arm_2",
            r"stands on 1 limb \(.* list all joints of each leg, .* in the table",
        ),
    ],
)
def test_published_robots_of_other_kinds_are_refused(name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Robot.load(published(name))


@pytest.mark.parametrize(
    ("name", "joints", "note"),
    [
        ("bolt", 3, "R from FR_HAA"),
        ("talos_reduced", 6, "20 joints that are no leg's"),
        ("g1_29dof_rev_1_0", 6, "170 × 60 mm"),
        ("icub_reduced", 6, "names and places of the legs disagree"),
    ],
)
def test_published_bipeds_are_read(name: str, joints: int, note: str) -> None:
    """iCub's x points backward."""
    robot = Robot.load(published(name))
    assert (robot.feet, robot.joint.shape) == (("R", "L"), (2, joints))
    assert any(note in line for line in robot.notes)


def test_an_ankle_below_named_legs_is_a_fourth_joint(tmp_path: Path) -> None:
    """Even where the calf itself has a ball, such as at its knee."""
    root = ET.fromstring(small_urdf())
    ball = "<collision><geometry><sphere radius='0.02'/></geometry></collision>"
    for link in root.iter("link"):
        if link.attrib["name"].endswith("calf"):
            link.append(ET.fromstring(ball))
    for joint in root.iter("joint"):
        if joint.attrib["name"].endswith("foot_joint"):
            joint.set("type", "revolute")
            joint.append(ET.fromstring("<axis xyz='0 1 0'/>"))
    (tmp_path / "own.urdf").write_text(ET.tostring(root, encoding="unicode"))
    robot = Robot.load(tmp_path / "own.urdf")
    assert robot.joint.shape == (4, 4)
    assert robot.legs[0][-1] == "FR_foot_joint"
    for table in ("joints", "legs"):
        lines = [f"{name} = '{name}_joint'" for name in JOINT_NAMES]
        if table == "legs":
            names = np.array(JOINT_NAMES).reshape(4, 3).tolist()
            lines = [f"{leg[0][:2]} = {[f'{name}_joint' for name in leg]}" for leg in names]
        (tmp_path / "own.toml").write_text("\n".join(["model = 'own.urdf'", f"[{table}]", *lines]))
        with pytest.raises(InputError, match=r"FR_foot_joint' is below .* in the table 'legs'"):
            Robot.load(tmp_path / "own.toml")


@pytest.mark.parametrize("name", ["anymal", "hyq_no_sensors", "solo"])
def test_names_and_places_of_published_quadrupeds_agree(name: str) -> None:
    assert not any("disagree" in note for note in Robot.load(published(name)).notes)


def test_knees_as_high_as_the_trunk_at_the_reference_angles(tmp_path: Path) -> None:
    """Coxa and femur straight out, as hexapods are drawn: the balls alone are low."""
    limb = """
<body pos="{x} {y} 0"><joint name="{name}_coxa" axis="0 0 1"/><geom size="0.01" mass="0.1"/>
<body pos="0 {y} 0"><joint name="{name}_femur" axis="1 0 0"/><geom size="0.01" mass="0.1"/>
<body pos="0 {y} 0"><joint name="{name}_tibia" axis="1 0 0"/><geom size="0.01" mass="0.1"/>
<geom size="0.02" pos="0 0 -0.16" mass="0.01"/></body></body></body>"""
    limbs = [
        limb.format(name=f"{side}{i}", x=0.2 * (2 - i), y=0.1 * sign)
        for i in (1, 2, 3)
        for side, sign in (("right", -1), ("left", 1))
    ]
    (tmp_path / "six.xml").write_text(
        '<mujoco><worldbody><body><freejoint/><geom type="box" size="0.25 0.1 0.03" mass="5"/>'
        f"{''.join(limbs)}</body></worldbody></mujoco>"
    )
    robot = Robot.load(tmp_path / "six.xml")
    assert robot.there.shape == (6, 3)
    assert robot.foot_radius == pytest.approx(0.02)
