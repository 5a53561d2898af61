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
    measurement,
    names,
    open_forces,
)
from terraphi.experiment.reading import read_forces
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate

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


@pytest.mark.parametrize("name", PEAKS)
def test_peaks_are_those_of_the_figures(name: str) -> None:
    fz, theta_fz, fx, theta_fx = PEAKS[name]
    history = measurement(name).history
    assert history.Fz.max() == pytest.approx(fz, abs=READING_ERROR)
    assert history.Fx.max() == pytest.approx(fx, abs=READING_ERROR)
    assert history.theta_deg[[history.Fz.argmax(), history.Fx.argmax()]] == pytest.approx(
        [theta_fz, theta_fx]
    )


def test_every_measurement_is_whole() -> None:
    assert len(names()) == 12
    for name in names():
        record = measurement(name)
        assert (record.name, record.history.provenance["measurement"]) == (name, name)
        assert name.endswith(f"/{record.rig.leg}")
        assert record.medium
        assert "10.1126/science.1229163" in record.source
        theory = read_forces(shipped_file("li2013", f"{name[7:].replace('/', '-')}-rft", ".csv"))
        for history in (record.history, theory):
            assert history.theta_deg == pytest.approx(np.arange(-132.0, 133.0))
        assert not np.array_equal(record.history.force, theory.force)


@pytest.mark.parametrize("medium", ["yuma", "poppy_loose", "glass03_close", "glass03_loose"])
def test_no_force_where_the_straight_leg_is_out(medium: str) -> None:
    # The tip meets the surface at cos θ = 20 / 76.2; grains pile up around it, and the curves stray
    # from zero by up to 0.2 N even in the air.
    history = measurement(f"li2013:{medium}/straight").history
    out = np.abs(history.theta_deg) > math.degrees(math.acos(20.0 / 76.2)) + 5.0
    assert np.abs(history.force[out]).max() < 0.25


def test_what_is_known_of_the_media() -> None:
    reference = {"yuma": (1650, True, None), "poppy_loose": (638, False, 36)}
    reference |= {"glass03_loose": (1450, False, 25), "glass03_close": (1550, False, 35)}
    for medium, facts in reference.items():
        record = measurement(f"li2013:{medium}/c")
        assert (record.density_kg_m3, record.density_assumed, record.angle_of_repose_deg) == facts


def test_names_that_are_wrong_are_answered_by_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'li2013:poppy_loose/c'"):
        measurement("li2013:poppy/c")
    with pytest.raises(InputError, match="did you mean 'li2013:yuma/c'"):
        open_forces("li2013:juma/c")
    with pytest.raises(InputError, match="did you mean 'li2013:yuma/straight'"):
        open_forces("yuma/straight")
    with pytest.raises(InputError, match="no such file"):
        open_forces("nowhere.csv")


def test_forces_open_with_what_is_known_of_them(tmp_path: Path) -> None:
    [shipped] = open_forces("li2013:yuma/c")
    assert (shipped.rig.leg, shipped.density_assumed) == ("c", True)
    (tmp_path / "own.csv").write_text("theta_deg,Fx_N,Fz_N\n-90,0,0\n0,1,2\n90,0,0\n")
    [reference] = open_forces(tmp_path / "own.csv")
    assert reference.history.Fz.tolist() == [0.0, 2.0, 0.0]
    assert (reference.rig, reference.density_kg_m3) == (None, None)
    scenario = {"model": "rft", "dimensions": 3, "leg": {"shape": "c"}, "soil": {"density": 1400.0}}
    simulate(Scenario.model_validate(scenario)).to_netcdf(tmp_path / "c.nc")
    [made] = open_forces(tmp_path / "c.nc")
    assert (made.rig.leg, made.rig.length_mm, made.density_kg_m3) == ("c", 76.2, 1400.0)
    ForceHistory(np.array([0.0, 0.1]), np.ones((2, 2)), "displacement").to_netcdf(tmp_path / "p.nc")
    with pytest.raises(InputError, match="forces over displacement, expected over theta"):
        open_forces(tmp_path / "p.nc")
