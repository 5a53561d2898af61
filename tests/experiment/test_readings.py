"""Where a record was read."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory, is_dense, shares


def test_a_share_ends_at_the_nearer_neighbour_and_at_one_degree() -> None:
    readings = np.radians([-10.0, -7.0, -6.6, -6.4, -5.0, 0.0])
    assert np.degrees(shares(readings)) == pytest.approx([1.0, 0.4, 0.2, 0.2, 1.0, 1.0])


def test_records_of_half_a_degree_are_dense_whatever_their_rounding() -> None:
    for start in np.linspace(-90.0, -85.0, 23):
        assert is_dense(np.radians(start + 0.5 * np.arange(300)))
    assert not is_dense(np.radians(np.r_[-90.0:0.0:0.1, 0.7:90.0:0.1]))


def test_a_record_needs_a_reading_for_each_window() -> None:
    def record(count: int) -> ForceHistory:
        known = {"file": "a.csv"}
        return ForceHistory(
            np.radians(np.linspace(-85.0, 85.0, count)), np.ones((count, 2)), provenance=known
        )

    assert len(record(40).observation().theta_deg) == 40
    with pytest.raises(InputError, match=r"^a\.csv: only 39 angles .* at least 40 are needed, one"):
        record(39).observation()
