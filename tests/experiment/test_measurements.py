"""The shipped measurements against the published figures, and people's own files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import (
    is_of_their_apparatus,
    measurement,
    names,
    open_forces,
    reference_rft,
)
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.library.store import Library

# Peaks [N] and angles [deg] read off Figs. S5 and S12 of Li et al. (2013): Fz, Fx.
PEAKS = {
    "li2013:yuma/straight": (7.2, -36, 9.0, -12),
    "li2013:poppy_loose/straight": (4.20, -49, 3.98, -23),
    "li2013:glass03_close/straight": (6.58, -39, 6.11, -16),
    "li2013:yuma/c": (16.4, -41, 10.3, -10),
    "li2013:yuma/reversed_c": (1.43, -43, 4.35, -3),
}
READING_ERROR = 0.05
"""Width of the lines in the figures [N]."""


def test_names() -> None:
    legs = ("c", "reversed_c", "straight")
    media = ("glass03_close", "glass03_loose", "poppy_loose", "yuma")
    assert names() == tuple(f"li2013:{medium}/{leg}" for medium in media for leg in legs)


@pytest.mark.parametrize("name", PEAKS)
def test_peaks_are_those_of_the_figures(name: str) -> None:
    fz, theta_fz, fx, theta_fx = PEAKS[name]
    history = measurement(name).history
    assert history.Fz.max() == pytest.approx(fz, abs=READING_ERROR)
    assert history.Fx.max() == pytest.approx(fx, abs=READING_ERROR)
    assert history.theta_deg[[history.Fz.argmax(), history.Fx.argmax()]] == pytest.approx(
        [theta_fz, theta_fx]
    )


@pytest.mark.parametrize("name", names())
def test_every_measurement_is_whole(name: str) -> None:
    found = measurement(name)
    assert found.name == name
    assert name.endswith(f"/{found.leg}")
    assert "10.1126/science.1229163" in found.source
    assert found.history.provenance["measurement"] == name
    assert found.medium
    for history in (found.history, reference_rft(name)):
        assert history.theta_deg == pytest.approx(np.arange(-132.0, 133.0))
        assert np.isfinite(history.observation().vector).all()
    assert not np.array_equal(found.history.force, reference_rft(name).force)


@pytest.mark.parametrize("medium", ["yuma", "poppy_loose", "glass03_close", "glass03_loose"])
def test_no_force_where_the_straight_leg_is_out(medium: str) -> None:
    # The tip meets the surface at cos θ = 20 / 76.2; grains pile up around it, and the curves stray
    # from zero by up to 0.2 N even in the air.
    history = measurement(f"li2013:{medium}/straight").history
    out = np.abs(history.theta_deg) > math.degrees(math.acos(20.0 / 76.2)) + 5.0
    assert np.abs(history.force[out]).max() < 0.25


def test_what_is_known_of_the_media() -> None:
    yuma = measurement("li2013:yuma/c")
    assert (yuma.density_kg_m3, yuma.density_assumed, yuma.angle_of_repose_deg) == (
        1650,
        True,
        None,
    )
    poppy = measurement("li2013:poppy_loose/c")
    assert (poppy.density_kg_m3, poppy.density_assumed, poppy.angle_of_repose_deg) == (
        638,
        False,
        36,
    )
    glass = measurement("li2013:glass03_close/c")
    assert (glass.density_kg_m3, glass.density_assumed, glass.angle_of_repose_deg) == (
        1550,
        False,
        35,
    )


def test_unknown_names_are_answered_by_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'li2013:yuma/straight'"):
        measurement("li2013:yuma/strait")
    with pytest.raises(InputError, match="did you mean 'li2013:poppy_loose/c'"):
        reference_rft("li2013:poppy/c")
    with pytest.raises(InputError, match="did you mean 'li2013:yuma/c'"):
        open_forces("li2013:juma/c")
    with pytest.raises(InputError, match="did you mean 'li2013:yuma/straight'"):
        open_forces("yuma/straight")


def test_peoples_own_csv(tmp_path: Path) -> None:
    path = tmp_path / "forces.csv"
    path.write_text("theta_deg,Fx_N,Fz_N\n-90,0,0\n0,1,2\n90,0,0\n")
    found = open_forces(path)
    assert found.history.Fz.tolist() == [0.0, 2.0, 0.0]
    assert (found.leg, found.density_kg_m3, found.source) == ("straight", None, "")


def test_shipped_name_opens_like_a_file() -> None:
    opened = open_forces("li2013:yuma/c")
    assert opened.history.Fz.max() == measurement("li2013:yuma/c").history.Fz.max()
    assert opened.leg == "c"


def test_simulated_history_knows_its_leg_and_density(tmp_path: Path) -> None:
    scenario = Scenario.model_validate(
        {"model": "rft", "dimensions": 3, "leg": {"shape": "c"}, "soil": {"density": 1400.0}}
    )
    simulate(scenario).to_netcdf(tmp_path / "c.nc")
    found = open_forces(str(tmp_path / "c.nc"))
    assert (found.leg, found.density_kg_m3, found.density_assumed) == ("c", 1400.0, False)


def test_netcdf_of_unknown_origin(tmp_path: Path) -> None:
    theta = np.radians(np.arange(-90.0, 91.0))
    ForceHistory(theta, np.ones((181, 2))).to_netcdf(tmp_path / "a.nc")
    assert open_forces(tmp_path / "a.nc").density_kg_m3 is None


def test_netcdf_over_something_else_is_refused(tmp_path: Path) -> None:
    history = ForceHistory(np.array([0.0, 0.1]), np.ones((2, 2)), coordinate="displacement")
    history.to_netcdf(tmp_path / "plate.nc")
    with pytest.raises(InputError, match="expected forces over the leg angle"):
        open_forces(tmp_path / "plate.nc")


def test_missing_file_is_said_to_be_missing() -> None:
    with pytest.raises(InputError, match="no such file"):
        open_forces("nowhere.csv")


def test_data_say_whom_to_cite() -> None:
    text = shipped_file("li2013", "PROVENANCE", ".md").read_text(encoding="utf-8")
    assert "The numbers are measurements of those authors: cite them." in text


@pytest.mark.parametrize("name", ["resolved", "resolved-2", "sand3d", "rft3d"])
def test_shipped_libraries_are_of_the_apparatus_of_the_measurements(name: str) -> None:
    scenario = Library.load(name).cases[0].scenario
    assert is_of_their_apparatus(scenario)
    for changes in ({"leg.chord": 0.07}, {"leg.width": 0.03}, {"leg.half_thickness": 0.004}):
        assert not is_of_their_apparatus(scenario.replace(**changes))
    x, z = scenario.motion.hip
    assert not is_of_their_apparatus(scenario.replace(**{"motion.hip": (x, z + 0.001)}))
