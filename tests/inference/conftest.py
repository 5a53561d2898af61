"""Libraries and curves that the tests of inference share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from terraphi.experiment.history import ForceHistory
from terraphi.inference.emulator import Emulator
from terraphi.library.store import Library


@pytest.fixture(scope="session")
def sand3d() -> Library:
    return Library.load("sand3d")


@pytest.fixture(scope="session")
def rft3d() -> Library:
    return Library.load("rft3d")


@pytest.fixture(scope="session")
def history_at(rft3d: Library) -> Callable[..., ForceHistory]:
    """A record as resistive force theory has it, read every so many degrees, with noise."""

    def make(
        phi_deg: float, leg: str = "straight", *, every: float = 0.5, noise: float = 0.0,
        seed: int = 0, span: tuple[float, float] = (-90.0, 90.0), density: float = 1650.0,
    ) -> ForceHistory:  # fmt: skip
        emulator = Emulator(rft3d.curves(leg))
        theta = np.arange(span[0], span[1] + 1e-9, every)
        curve = emulator(np.array([[phi_deg]]))[0] * density / 1650.0
        force = np.stack([np.interp(theta, emulator.curves.theta_deg, row) for row in curve], 1)
        force += noise * np.random.default_rng(seed).standard_normal(force.shape)
        return ForceHistory(np.radians(theta), force)

    return make
