"""A certificate as another version of a library's file holds it, and everything that is none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from terraphi.library.store import Library
from terraphi.view.report.certificate import certificate_parts
from terraphi.view.report.parts import Text
from terraphi.view.table import Table

LEGS = {"straight": {"coverage68": 0.683, "coverage95": 0.951, "replicates": 5000}, "c": {}}


def library(calibration: Any) -> Library:
    return replace(Library.load("rft3d"), calibration=calibration)


def test_coverage_is_shown_by_leg() -> None:
    (table,) = certificate_parts(library({"certificate": {"seed": 0, "legs": LEGS}}))
    assert isinstance(table, Table)
    assert table.header == ("", "straight", "c")
    assert ("truths inside the 68 % interval [-]", "0.683", "–") in table.rows


def test_only_the_leg_that_was_asked_for() -> None:
    (table,) = certificate_parts(library({"certificate": {"legs": LEGS}}), leg="straight")
    assert isinstance(table, Table)
    assert table.header == ("", "straight")


@pytest.mark.parametrize(
    "calibration",
    [
        {},
        {"certificate": None},
        {"certificate": {"legs": [1]}},
        {"certificate": {"legs": {"c": 3}}},
    ],
)
def test_what_is_no_certificate_is_none(calibration: Any) -> None:
    assert library(calibration).certificate == {}
    (text,) = certificate_parts(library(calibration))
    assert isinstance(text, Text)


def test_intervals_that_did_not_hold_are_named() -> None:
    legs = {"straight": {"coverage95": 0.95}, "c": {"coverage95": 0.1}, "reversed_c": {}}
    assert library({"certificate": {"legs": legs}}).unheld == {"c": 0.1}
