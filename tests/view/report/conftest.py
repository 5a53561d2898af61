"""A result of each kind, made once, as people make them."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import pytest
from go2.logs import write_csv

from terraphi.cli.invert import save_inversion
from terraphi.experiment.measurements import measurement
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.forward.plane.fields import FieldSeries
from terraphi.inference.answer import Inversion
from terraphi.inference.inversion import invert
from terraphi.library.store import Library
from terraphi.robot.results import analyse, write_forces


@pytest.fixture(scope="session")
def inversion() -> Inversion:
    measured = measurement("li2013:poppy_loose/straight")
    return invert(
        measured.history,
        library=Library.load("rft3d"),
        leg="straight",
        density=measured.density_kg_m3,
        source="li2013:poppy_loose/straight",
    )


@pytest.fixture(scope="session")
def inversion_folder(inversion: Inversion, tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("inversion")
    save_inversion(inversion, place)
    return place


@pytest.fixture(scope="session")
def recovery_data() -> dict:
    case = {
        "phi_true_deg": 21.6, "phi_median_deg": 21.73, "ci68": [21.1, 22.3], "ci95": [20.5, 22.8],
        "verdict": "consistent",
    }  # fmt: skip
    return {
        "study": "recovery",
        "about": "friction angles of fresh simulations",
        "notes": ["All by `quadrature`."],
        "table": {
            "title": "Recovery of 2 friction angles",
            "header": ["true φ", "median"],
            "rows": [["21.60°", "21.73°"], ["40.00°", "39.50°"]],
        },
        "library": "quick-plane-strain",
        "yield": "plane_strain",
        "cases": [case, {**case, "phi_true_deg": 40.0, "phi_median_deg": 39.5}],
        "abs_error_deg": {"median": 0.315, "max": 0.5},
        "ci68_half_width_deg": {"median": 0.6, "max": 0.6},
        "inside68": 1,
        "inside95": 2,
        "beside_paper": [{"what": "median error", "ours": "0.32°", "paper": "0.09°"}],
    }


@pytest.fixture
def study_folder(recovery_data: dict, tmp_path: Path) -> Path:
    from PIL import Image

    place = tmp_path / "recovery"
    place.mkdir()
    (place / "data.json").write_text(json.dumps(recovery_data))
    (place / "recovery.md").write_text("# Recovery\n\n- a note\n\n![errors](recovery.png)\n")
    Image.new("RGB", (2000, 400), "white").save(place / "recovery.png")
    return place


@pytest.fixture(scope="session")
def log_file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("log") / "walk.csv"
    samples = runpy.run_path(str(Path(__file__).parents[2] / "robot" / "log_samples.py"))
    write_csv(path, samples["trotting"]())
    return path


@pytest.fixture(scope="session")
def forces_file(log_file: Path, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("forces") / "walk.nc"
    write_forces(analyse(log_file), path)
    return path


@pytest.fixture(scope="session")
def simulation(tmp_path_factory) -> tuple[Path, Path]:
    """A coarse simulation's history and fields."""
    place = tmp_path_factory.mktemp("simulation")
    (place / "s.toml").write_text(
        """
[numerics]
cells = 32
speed_up = 20.0
time_step = 5e-5
contact_band_cells = 0.5
[bed]
left = 0.010
floor = 0.010
width = 0.280
height = 0.160
[motion]
start_deg = -80.0
stop_deg = 10.0
"""
    )
    scenario = Scenario.load(str(place / "s.toml"))
    fields = place / "fields"
    history = simulate(scenario, observe=FieldSeries(fields, scenario, frames=5))
    history.to_netcdf(place / "h.nc")
    return place / "h.nc", fields
