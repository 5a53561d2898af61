"""Pinocchio, the URDF of the Go2 that comes with it, and a log of a Go2 on sand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from terraphi.robot.joint_log import JointLog


@pytest.fixture(scope="session")
def pinocchio() -> Any:
    return pytest.importorskip("pinocchio")


@pytest.fixture(scope="session")
def go2_urdf() -> Path:
    """The URDF that example-robot-data brings."""
    files = metadata.files("example-robot-data") or []
    return Path(str(next(f for f in files if f.name == "go2.urdf").locate()))


@pytest.fixture(scope="session")
def trot_on_sand(made_once: Callable[..., Any]) -> JointLog:
    """Four seconds on sand, where standing feet sink and slide; each torque is off by its gain."""
    pytest.importorskip("mujoco")
    from sand_walk import sand_log, sand_walk

    def make() -> JointLog:
        walk = sand_walk("trot", seed=3, law="rft", mean=40.5, duration=4.0)
        # Steps of 1 ms and a second to settle: half the time, and the same findings.
        walk = replace(walk, settle=1.0, physics=replace(walk.physics, step=1e-3))
        return sand_log(walk.run(), seed=3, gain_sd=0.1)

    return made_once("trot-on-sand", make)
