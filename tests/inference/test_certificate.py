"""Replicates: which are accepted, that a file keeps them, and that they are data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.inference.coverage import certified, with_replicates
from terraphi.inference.prepared_leg import prepare
from terraphi.library.shipped import legs_of
from terraphi.library.store import Case, Library

NAME = "k4-plane-strain"


@pytest.fixture(scope="module")
def alone() -> Library:
    """The library as it was built."""
    return replace(Library.load(NAME), calibration={}, replicates=())


@pytest.fixture(scope="module")
def seeds() -> Library:
    """Its replicates, as the library that they came from."""
    whole = Library.load(NAME)
    return replace(whole, cases=whole.replicates, calibration={}, replicates=())


def test_replicates_are_kept_with_the_cases_that_they_repeat(
    alone: Library, seeds: Library, tmp_path: Path
) -> None:
    both = with_replicates(alone, seeds)
    assert both.hash == alone.hash
    assert both.curves("straight").Fx == pytest.approx(alone.curves("straight").Fx)
    both.save(tmp_path / "both.nc")
    found = Library.load(tmp_path / "both.nc")
    assert [c.digest for c in found.cases] == [c.digest for c in alone.cases]
    assert [c.digest for c in found.replicates] == [c.digest for c in seeds.cases]
    assert legs_of(tmp_path / "both.nc") == {"straight"}
    groups = found.repeated("straight", readings=np.arange(-1.5, 1.5001, 0.005))
    assert [(phi, len(vectors)) for phi, vectors in groups] == [(17.5, 4), (32.5, 4), (47.5, 4)]
    own = next(c for c in alone.cases if c.scenario.soil.friction_angle_deg == 32.5)
    assert own.history is not None
    first = own.history.between(-1.5, 1.5).observation().vector
    assert groups[1][1][0] == pytest.approx(first, rel=1e-12)
    assert found.repeated("c") == []


def test_what_is_no_replicate_is_refused(alone: Library, seeds: Library) -> None:
    again = replace(seeds, cases=(*seeds.cases, alone.cases[3]))
    with pytest.raises(InputError, match=r"repeats a simulation, with the seed 3 at 22\.5 deg"):
        with_replicates(alone, again)
    with pytest.raises(
        InputError, match="its case at 15 deg, leg straight, is no case of the library"
    ):
        with_replicates(alone, Library.load("quick-plane-strain"))


def test_failed_replicates_count_for_nothing(alone: Library, seeds: Library) -> None:
    failed = Case(seeds.cases[0].scenario, None, "too wet")
    both = with_replicates(alone, replace(seeds, cases=(failed, *seeds.cases[1:])))
    assert [len(vectors) for _, vectors in both.repeated("straight")] == [3, 4, 4]


def test_replicates_are_data(alone: Library, seeds: Library) -> None:
    both = with_replicates(alone, seeds)
    few, many = (prepare(library, "straight").surrogate for library in (alone, both))
    for phi, vectors in both.repeated("straight"):
        mean = vectors.mean(axis=0)
        assert np.trace(many.covariance(phi)) < 0.6 * np.trace(few.covariance(phi))
        off = [np.linalg.norm(one.predict([phi])[0] - mean) for one in (few, many)]
        assert off[1] < off[0]


def test_a_calibration_is_used_with_the_replicates_that_it_was_learnt_from(
    alone: Library, seeds: Library, tmp_path: Path
) -> None:
    made = certified(alone, seeds, worlds=200)
    made.save(tmp_path / "made.nc")
    found = Library.load(tmp_path / "made.nc")
    assert found.calibration["replicates"] == seeds.name
    learnt, read = (
        prepare(library, "straight").surrogate for library in (with_replicates(alone, seeds), found)
    )
    # Files keep five digits of the logarithms.
    assert read.predict([29.0, 41.0]) == pytest.approx(
        learnt.predict([29.0, 41.0]), rel=1e-4, abs=1e-4
    )
    assert sorted(np.square(read.root_repeats).round().tolist())[-3:] == [4.0, 4.0, 4.0]


def test_more_replicates_come_in_addition(alone: Library, seeds: Library) -> None:
    few, rest = replace(seeds, cases=seeds.cases[:4]), replace(seeds, cases=seeds.cases[4:])
    both = with_replicates(with_replicates(alone, few), rest)
    assert {c.digest for c in both.replicates} == {c.digest for c in seeds.cases}
    # Given twice, they are still there once.
    assert len(with_replicates(both, seeds).replicates) == len(seeds.cases)


def assert_alike(one: Any, other: Any) -> None:
    """Nested numbers agree to a thousandth, and all else exactly."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_alike(one[key], other[key])
    elif isinstance(one, list):
        for a, b in zip(one, other, strict=True):
            assert_alike(a, b)
    else:
        assert one == (pytest.approx(other, rel=1e-3) if isinstance(one, float) else other)


def test_calibrated_again_a_library_keeps_its_replicates_and_says_whose_they_are() -> None:
    shipped = Library.load(NAME)
    again = certified(shipped, worlds=200)
    # Optima of another processor: the same as far as they are determined.
    assert_alike(again.calibration["legs"], shipped.calibration["legs"])
    for key in ("replicates", "replicates_hash"):
        assert again.calibration[key] == shipped.calibration[key] is not None
