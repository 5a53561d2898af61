"""Repeats of a soil of known angle: properties that no calibration may lack."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terraphi.inference.calibration import Calibration, CalibrationSoil
from terraphi.laws.model_error import ModelError

ERROR = ModelError(
    effects=("offset c", "breadth"), mean_deg=(0.0, 0.0), covariance_deg2=((2.9, 0.1), (0.1, 0.5)),
    soil_sd_deg=0.7, leg_sd_deg=0.8, rig_sd_deg=0.5, bed_sd_deg=0.6,
)  # fmt: skip
ROW = (1.0, 0.3)
BED_SD_DEG = 0.6
READ = st.floats(22.0, 34.0)
SD = st.floats(0.0, 3.0)


def in_one_soil(reads: Sequence[float], sds: Sequence[float], rig_sds: Sequence[float],
                phi_sd: float = 1.0) -> Calibration:  # fmt: skip
    """Repeats in a soil of 28°."""
    soils = [
        CalibrationSoil(
            source="x", soil="sand", leg="c", rig="mine", phi_deg=28.0, phi_sd_deg=phi_sd,
            read_deg=read, read_sd_deg=sd, rig_sd_deg=rig_sd, row=ROW, bed_sd_deg=BED_SD_DEG,
        )
        for read, sd, rig_sd in zip(reads, sds, rig_sds, strict=True)
    ]  # fmt: skip
    return Calibration(library="x", library_hash="", soils=soils)


def correction(known: Calibration) -> tuple[float, float]:
    """Mean and standard deviation of what the calibration takes off [deg]."""
    mean, causes = known.offset(ERROR, "mine", np.array(ROW))
    return mean, float(np.hypot.reduce(causes))


@given(read=st.floats(25.0, 31.0), sd=SD, rig_sd=SD, data=st.data())
def test_copies_of_a_record_calibrate_as_it_does(
    read: float, sd: float, rig_sd: float, data: st.DataObject
) -> None:
    """Their standard deviations are within 1 %, their readings within 0.05°."""
    n = data.draw(st.integers(2, 10))
    like = st.lists(st.floats(-1.0, 1.0), min_size=n, max_size=n)
    off, factor, other = (np.array(data.draw(like)) for _ in range(3))
    once, sd_once = correction(in_one_soil([read], [sd], [rig_sd]))
    copies = in_one_soil(read + 0.05 * off, sd * (1 + 0.01 * factor), rig_sd * (1 + 0.01 * other))
    mean, sd_of_all = correction(copies)
    assert abs(mean - once) < 0.1 + 0.05
    # Rig's errors that differ by 1 % are the prior's, too.
    assert sd_of_all < 1.01 * sd_once + 1e-9


@given(data=st.data(), more=st.floats(0.0, 3.0))
def test_a_repeat_that_reads_more_takes_off_more(data: st.DataObject, more: float) -> None:
    n = data.draw(st.integers(1, 5))
    reads, sds, rig_sds = (
        data.draw(st.lists(kind, min_size=n, max_size=n)) for kind in (READ, SD, SD)
    )
    raised = [*reads[:-1], reads[-1] + more]
    lower, higher = (correction(in_one_soil(item, sds, rig_sds))[0] for item in (reads, raised))
    assert higher >= lower - 1e-6


@given(data=st.data(), phi_sd=SD)
def test_repeats_are_worth_no_more_than_a_soil_without_error(
    data: st.DataObject, phi_sd: float
) -> None:
    """Its angle is exact, and its bed is not: what is left is the soil's and the leg's own."""
    n = data.draw(st.integers(1, 50))
    reads, sds, rig_sds = (
        data.draw(st.lists(kind, min_size=n, max_size=n)) for kind in (READ, SD, SD)
    )
    _, sd = correction(in_one_soil(reads, sds, rig_sds, phi_sd))
    shared = ROW @ np.array(ERROR.covariance_deg2) @ ROW
    shared += ERROR.rig_sd_deg**2 + np.mean(np.square(rig_sds))
    reference = ERROR.soil_sd_deg**2 + ERROR.leg_sd_deg**2
    least = shared - shared**2 / (shared + reference)
    assert least - 1e-4 <= sd**2 <= shared + 1e-9


def test_soils_are_told_apart_by_name_and_repeats_that_disagree_are_named() -> None:
    """Two soils of equal angles count twice; beds that differ by 5° are no repeats."""
    first = in_one_soil([30.0, 30.0], [1.0, 1.0], [0.0, 0.0])
    named = [
        soil.model_copy(update={"soil": name}) for soil, name in zip(first.soils, "ab", strict=True)
    ]
    two = Calibration(library="x", library_hash="", soils=named)
    assert correction(two)[1] < correction(first)[1] - 0.05
    assert not [*first.warnings(), *two.warnings()]
    assert [*in_one_soil([30.0, 25.0, 30.0], [1.0] * 3, [0.0] * 3).warnings()]
    with pytest.raises(ValueError, match="one angle"):
        Calibration(library="x", library_hash="", soils=[
            first.soils[0], first.soils[1].model_copy(update={"phi_deg": 30.0})])  # fmt: skip
