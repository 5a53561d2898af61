"""Names of joints as people write them, in descriptions of robots and in logs."""

from __future__ import annotations

import pytest

from terraphi.robot.joint_log import FEET, JOINTS, joint_place


@pytest.mark.parametrize(
    ("name", "meaning"),
    [
        ("LF_HAA", "FL hip"),
        ("LR_upper_leg", "RL thigh"),
        ("front_left_hip_x", "FL hip"),
        ("fr.hx", "FR hip"),
        ("FL_2", "FL calf"),
        ("LFHAA", "FL hip"),
        ("FR_FL_hip", None),
        ("FR_foot", None),
        ("FL_hip_rotor_joint", None),
    ],
)
def test_names_of_joints(name: str, meaning: str | None) -> None:
    place = joint_place(name)
    assert (place and f"{FEET[place[0]]} {JOINTS[place[1]]}") == meaning
