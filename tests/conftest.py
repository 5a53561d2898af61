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
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.laws.emulator import Emulator
from terraphi.laws.store import PHI, Case, Library

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
def sand3d() -> Library:
    """Simulations of the legs of Li et al. (2013), which no law is made of alone."""
    data = Path(__file__).parents[1] / "studies" / "data" / "libraries"
    return Library.load(data / "sand3d-simulated.nc")


@pytest.fixture(scope="session")
def rft3d() -> Library:
    """Simulations of an exact model, for what is made of simulations."""
    few = {"rft.panels": 50, "motion.start_deg": -100.0, "motion.stop_deg": 100.0}
    base = Scenario.load("quick").replace(**few)
    legs, angles = ("straight", "c", "reversed_c"), np.linspace(15.0, 50.0, 15).tolist()
    cases = [base.replace(**{PHI: phi, "leg.shape": leg}) for leg in legs for phi in angles]
    return Library("simulated", tuple(Case(case, simulate(case)) for case in cases))


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
