"""Calibration on soils of known angle, and the comparison of forces without a library."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.measurements import measurement
from terraphi.inference.discrepancy import learnt_for
from terraphi.inference.inversion import invert
from terraphi.inference.known_soils import Calibration, KnownSoil, angle_with_sd, known_soil
from terraphi.inference.trials import Trial
from terraphi.library.store import Library

REPOSE = {"poppy_loose": 36.0, "glass03_close": 35.0, "glass03_loose": 25.0}


def soil(found_deg: float, phi_deg: float) -> KnownSoil:
    return KnownSoil(
        phi_deg=phi_deg,
        sd_deg=2.0,
        found_deg=found_deg,
        found_sd_deg=1.0,
        legs=("straight",),
        forces=(),
    )


def test_one_soil_moves_an_unknown_library_and_hardly_one_that_is_known() -> None:
    unknown, known = Library.load("rft3d"), Library.load("resolved")
    soils = [soil(24.0, 36.0)]
    # N(0, 10²) with a record of variance 3² + 2² + 1²: shrunk to 100/114 of 12°.
    level = Calibration.of(unknown, soils).level(24.0, None)
    assert level.offset_deg == pytest.approx(12.0 * 100.0 / 114.0, rel=1e-3)
    assert level.scale_deg == pytest.approx(
        np.sqrt(9.0 + 1.0 / (1.0 / 100.0 + 1.0 / 14.0)), rel=1e-3
    )
    learnt = learnt_for(known)
    assert learnt is not None
    level = Calibration.of(known, soils).level(24.0, learnt)
    assert 0.0 < level.offset_deg < 3.0
    # From two on, the slope between them is followed in part.
    two = Calibration.of(unknown, [soil(20.0, 25.0), soil(30.0, 40.0)])
    low, high = (two.level(at, None).offset_deg for at in (20.0, 30.0))
    assert low < high < low + 10.0


@pytest.mark.parametrize(
    ("name", "media"),
    # Loose glass lies at the lower end of the one.
    [("quick-plane-strain", ("poppy_loose", "glass03_close")), ("rft3d", tuple(REPOSE))],
)
def test_calibrated_on_one_medium_the_others_come_out_closer_and_are_held(
    name: str, media: tuple[str, ...]
) -> None:
    library = Library.load(name)
    found = {
        medium: invert(Trial.of(measurement(f"li2013:{medium}/straight")), library=library)
        for medium in REPOSE
    }
    before, after, held = [], [], []
    for medium in media:
        calibration = Calibration.of(library, [known_soil(found[medium], REPOSE[medium], 2.0)])
        for other in REPOSE.keys() - {medium}:
            trial = Trial.of(measurement(f"li2013:{other}/straight"))
            answer = invert(trial, library=library, calibration=calibration)
            before.append(found[other].phi.median - REPOSE[other])
            after.append(answer.phi.median - REPOSE[other])
            held.append(answer.phi.ci95[0] < REPOSE[other] < answer.phi.ci95[1])
    rms = [float(np.sqrt(np.mean(np.square(errors)))) for errors in (before, after)]
    assert rms[1] < 0.75 * rms[0]
    assert sum(held) >= len(held) - 1


def test_a_file_is_strict_and_of_one_library(tmp_path: Path) -> None:
    library = Library.load("rft3d")
    path = tmp_path / "soil.json"
    Calibration.of(library, [soil(24.0, 36.0)]).save(path)
    assert Calibration.load(path).soils == (soil(24.0, 36.0),)
    record = measurement("li2013:yuma/straight").history
    with pytest.raises(InputError, match="made with library 'rft3d'"):
        invert(record, library=Library.load("quick-plane-strain"), calibration=path)
    path.write_text(path.read_text(encoding="utf-8").replace('"sd_deg"', '"sd"'), encoding="utf-8")
    with pytest.raises(InputError, match="sd"):
        Calibration.load(path)
    path.write_text("theta_deg,Fx_N,Fz_N\n" * 99, encoding="utf-8")
    with pytest.raises(
        InputError, match=r"soil\.json: not a file that 'terraphi calibrate' wrote$"
    ):
        Calibration.load(path)
    for text in ("35±2", "35+-2", " 35 +/- 2"):
        assert angle_with_sd(text) == (35.0, 2.0)
    for text in ("35", "35±0", "95±2", "a±b"):
        with pytest.raises(InputError, match="as 35±2"):
            angle_with_sd(text)
    with pytest.raises(InputError, match=r"80 degrees says nothing of the angle; .* at most 15"):
        angle_with_sd("36±80")


def test_forces_are_compared_with_known_soils_in_the_same_apparatus() -> None:
    library = Library.load("resolved")
    loose = invert(Trial.of(measurement("li2013:glass03_loose/c")), library=library)
    seeds = invert(Trial.of(measurement("li2013:poppy_loose/c")), library=library)
    assert loose.compared is not None
    assert seeds.compared is not None
    # The medium itself is not among those that it is compared with.
    assert loose.compared.media == ("glass03_close", "poppy_loose")
    assert loose.compared.low_deg < 25.0 < loose.compared.high_deg < seeds.compared.high_deg
    case = library.cases[0]
    assert case.history is not None
    simulated = invert(case.history, library=library, leg=case.scenario.leg.shape)
    assert simulated.compared is None
    assert simulated.as_dict()["compared_with_known_soils"] is None


def test_a_calibrated_angle_is_of_plane_strain_and_its_curve_still_fits() -> None:
    library = Library.load("quick-paper")
    record = Trial.of(measurement("li2013:poppy_loose/straight"))
    plain = invert(record, library=library)
    # A library that is off by some 10°: its best curve is still the one at its own angle.
    calibration = Calibration.of(library, [soil(45.0, 33.0)])
    found = invert(record, library=library, calibration=calibration)
    assert found.convention == "plane_strain"
    plane, own = found.phi_plane_strain, found.phi
    assert (plane.median, plane.ci68, plane.ci95) == (own.median, own.ci68, own.ci95)
    assert found.phi.median < plain.phi.median - 8.0
    assert found.record.nrmsd == pytest.approx(plain.record.nrmsd, abs=0.01)
    assert found.budget is not None
    degrees = found.budget.degrees
    assert degrees["soils"] == 3.0
    level = calibration.level(plain.phi.median, None)
    assert degrees["calibration"] == pytest.approx(np.sqrt(level.scale_deg**2 - 9.0), rel=0.05)
    assert sum(found.budget.shares.values()) == pytest.approx(1.0)


def test_what_a_calibration_is_not_for_is_refused() -> None:
    library = Library.load("rft3d")
    record = Trial.of(measurement("li2013:poppy_loose/straight"))
    found = invert(record, library=library)
    calibration = Calibration.of(library, [known_soil(found, 36.0, 2.0)])
    for wrong, options in (
        ("drop --likelihood and --discrepancy", {"discrepancy": "none"}),
        ("no soil on leg 'c'", {"leg": "c"}),
    ):
        with pytest.raises(InputError, match=wrong):
            invert(replace(record, leg=options.pop("leg", "straight")), library=library,
                   calibration=calibration, **options)  # fmt: skip
    case = library.cases[0]
    assert case.history is not None
    simulated = Trial(case.history, case.scenario.leg.shape)
    with pytest.raises(InputError, match="for measured forces"):
        invert(simulated, library=library, calibration=calibration)
    with pytest.raises(InputError, match="is simulated"):
        known_soil(
            replace(found, records=(replace(found.record, simulation={"seed": 0}),)), 36.0, 2.0
        )
    with pytest.raises(InputError, match="in the calibration already"):
        calibration.with_soil(calibration.soils[0])


def test_a_soil_counts_by_the_error_of_the_librarys_angle_and_not_if_that_is_none() -> None:
    library = Library.load("resolved")
    record = Trial.of(measurement("li2013:poppy_loose/straight"))
    one = known_soil(invert(record, library=library), 36.0, 2.0)
    legs = [Trial.of(measurement(f"li2013:poppy_loose/{leg}")) for leg in ("straight", "c")]
    two = known_soil(invert(legs, library=library), 36.0, 2.0)
    # Legs err independently, and the spread between soils is in the level already.
    assert two.found_sd_deg == pytest.approx(one.found_sd_deg / np.sqrt(2.0), rel=0.1)
    assumed = known_soil(invert(replace(record, density_assumed=True), library=library), 36.0, 2.0)
    assert assumed.found_sd_deg > one.found_sd_deg
    for density in (100.0, 1650.0):  # at the library's end, and a misfit
        with pytest.raises(InputError, match="nothing to calibrate with"):
            known_soil(invert(replace(record, density=density), library=library), 36.0, 2.0)


def test_an_answer_of_several_parameters_calibrates_nothing() -> None:
    found = invert(
        measurement("li2013:poppy_loose/straight"),
        library=Library.load("rft3d"),
        prior=["density=600:680"],
        steps=30,  # that it infers several is all that counts
    )
    with pytest.raises(InputError, match="infers several parameters"):
        known_soil(found, 36.0, 2.0)
