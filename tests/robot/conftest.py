"""Pinocchio, and the URDF of the Go2 that comes with it."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="session")
def pinocchio() -> Any:
    return pytest.importorskip("pinocchio")


@pytest.fixture(scope="session")
def go2_urdf() -> Path:
    """The URDF that example-robot-data brings."""
    files = metadata.files("example-robot-data") or []
    return Path(str(next(f for f in files if f.name == "go2.urdf").locate()))
