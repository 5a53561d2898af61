"""A result of each kind, made once."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi import Answer, Scenario, invert, simulate
from terraphi.inference.footfalls import FootfallMap
from terraphi.robot.joint_log import FEET


@pytest.fixture(scope="session")
def answer() -> Answer:
    return invert(["li2013:poppy_loose/straight", "li2013:poppy_loose/c"])


@pytest.fixture(scope="session")
def footfalls() -> FootfallMap:
    count = 8
    s = np.linspace(0.0, 1.4, 15)
    verdict = ("usable",) * 6 + ("saturated",) * 2
    reference = np.where(np.arange(count) < 6, 1.0, np.nan)
    return FootfallMap(
        time=np.arange(count) * 0.3,
        foot=tuple(FEET) * 2,
        place=np.column_stack([0.2 * np.arange(count), 0.1 * (-1.0) ** np.arange(count), s[:8]]),
        sinkage=np.full(count, 0.03),
        phi=reference * (30.0 + np.arange(count)),
        sd=reference * 0.5,
        shared_sd=reference * 3.0,
        misfit=reference,
        verdict=verdict,
        path=np.column_stack([s, s, 0.0 * s]),
        path_phi=30.0 + s,
        path_relative_sd=np.full(15, 0.4),
        path_absolute_sd=np.full(15, 3.0),
        shared={},
        by_law={"rft": 31.0},
        warnings=("density is assumed",),
    )


@pytest.fixture(scope="session")
def foot_forces_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of ``terraphi forces --out``, as far as a report reads it."""
    import json

    import xarray as xr

    time = np.arange(0.0, 3.0, 0.01)
    force = np.zeros((len(time), 4, 3))
    force[:, :, 2] = 40.0 * (1.0 + np.sin(2.0 * np.pi * time)[:, None])
    part = np.linspace(0.0, 1.0, 21)
    mean = np.stack([0.0 * part, 0.0 * part, 80.0 * np.sin(np.pi * part)], axis=1)
    figures = {
        "stances": 3, "mean_duration_s": 0.5, "mean_peak_Fz_N": 80.0, "mean_peak_Fx_N": None,
    }  # fmt: skip
    summary = {
        "feet": dict.fromkeys(FEET, figures), "pooled": figures, "duration_s": 3.0,
        "estimator": "quasi_static", "frame": "world", "warnings": ["no attitude"],
    }  # fmt: skip
    data = {
        "force": (("time", "foot", "axis"), force),
        "stance_foot": ("stance", list(FEET)),
        "stance_begin": ("stance", [0.5] * 4),
        "stance_end": ("stance", [1.0] * 4),
        "stance_mean": (("foot", "part", "axis"), np.stack([mean] * 4)),
        "pooled_mean": (("part", "axis"), mean),
        "pooled_spread": (("part", "axis"), 0.1 * mean),
    }
    coordinates = {"time": time, "foot": list(FEET), "part": part}
    attributes = {
        "terraphi_file": "foot forces", "terraphi_schema": 1, "summary": json.dumps(summary),
        "provenance": json.dumps({"log": {"source": "walk.csv"}}),
    }  # fmt: skip
    path = tmp_path_factory.mktemp("robot") / "forces.nc"
    xr.Dataset(data, coordinates, attributes).to_netcdf(path, engine="h5netcdf")
    return path


@pytest.fixture(scope="session")
def results(
    answer: Answer,
    footfalls: FootfallMap,
    foot_forces_file: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, str]:
    """A source of each kind that a report shows."""

    place = tmp_path_factory.mktemp("results")
    answer.save(place / "answer")
    simulate(Scenario.load("quick")).to_netcdf(place / "simulation.nc")
    footfalls.to_netcdf(place / "footfalls.nc")
    return {
        "answer": str(place / "answer"),
        "library": "paper",
        "simulation": str(place / "simulation.nc"),
        "foot forces": str(foot_forces_file),
        "footfalls": str(place / "footfalls.nc"),
    }


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
    program = next((path for name in names if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"needs a browser: none of {', '.join(names)} is on the PATH")
    root = ["--no-sandbox"] if os.geteuid() == 0 else []
    with api.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=program, args=root)
        yield opened
        opened.close()
