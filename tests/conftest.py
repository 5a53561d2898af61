"""What every test may count on."""

from __future__ import annotations

import fcntl
import importlib
import os
import pickle
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

from terraphi.experiment.history import ForceHistory
from terraphi.experiment.rig import Rig
from terraphi.laws.theory import Theory

# Tests run side by side, and their small matrices gain nothing from threads.
assert np.ones(1) @ np.ones(1) == 1.0  # loads the library that is limited
threadpool_limits(limits=1, user_api="blas")

# A busy machine is no error.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


class Ran(NamedTuple):
    """How a command ended, and what it printed."""

    status: int
    out: str
    err: str


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[], Any]], Any]:
    """Make by one process of this run what all of them read: an object that can be pickled."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # each worker has a folder below that of the run

    def load(name: str, make: Callable[[], Any]) -> Any:
        with (folder / f"{name}.pickle").open("a+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            file.seek(0)
            if content := file.read():
                return pickle.loads(content)
            result = make()
            file.write(pickle.dumps(result))
            return result

    return load


@pytest.fixture
def terraphi(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Callable[..., Ran]:
    """Run a command in an empty folder, in this process."""
    from terraphi.cli.main import main

    monkeypatch.chdir(tmp_path)

    def run(*args: str) -> Ran:
        monkeypatch.setattr(sys, "argv", ["terraphi", *args])
        status = 0
        try:
            main()
        except SystemExit as leaving:
            status = int(leaving.code or 0)
        return Ran(status, *capsys.readouterr())

    return run


@pytest.fixture(scope="session")
def arviz() -> Any:
    """ArviZ, whose import takes seconds: no worker without these tests pays for it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module("arviz")


@pytest.fixture(scope="session")
def history_at() -> Callable[..., ForceHistory]:
    """A record as resistive force theory has it, read every so many degrees, with noise."""

    def make(
        phi_deg: float, leg: str = "straight", *, every: float = 0.5, noise: float = 0.0,
        seed: int = 0, span: tuple[float, float] = (-90.0, 90.0), density: float = 1650.0,
    ) -> ForceHistory:  # fmt: skip
        law = Theory().law(Rig.of("li2013", leg))
        theta = np.arange(span[0], span[1] + 1e-9, every)
        curve = law(np.array([[phi_deg]]))[0] * density / law.density
        force = np.stack([np.interp(theta, law.theta_deg, row) for row in curve], 1)
        force += noise * np.random.default_rng(seed).standard_normal(force.shape)
        return ForceHistory(np.radians(theta), force)

    return make
