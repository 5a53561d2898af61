"""Study spacing: what it thins, counts and expects, on a few records."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import terraphi_studies as studies
from terraphi.experiment.errors import InputError
from terraphi.inference.inversion import invert
from terraphi.library.store import Library
from terraphi_studies import spacing

PAGE = Path(__file__).parents[2] / "docs" / "spacing.md"


def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two truths of one library, dense and at two phases of one reading every 2°."""
    whole = spacing.sets_of

    def cut(library: str) -> list:
        every = whole(library)
        return [(trained, name, found[1:8:6]) for trained, name, found in every if "truths" in name]

    monkeypatch.setattr(spacing, "sets_of", cut)
    monkeypatch.setattr(spacing, "EVERY", (1, 20))
    monkeypatch.setattr(spacing, "PHASES", 2)


def test_rows_count_what_single_inversions_give(monkeypatch: pytest.MonkeyPatch) -> None:
    few(monkeypatch)
    told: list[tuple[float, float]] = []
    found = studies.run(
        "spacing", library="quick-paper", progress=lambda done, total: told.append((done, total))
    )
    json.dumps(found.data, allow_nan=False)
    dense, sparse, every = found.data["rows"]
    assert [row["spacing_deg"] for row in (dense, sparse, every)] == [0.1, 2.0, None]
    assert [row["records"] for row in (dense, sparse, every)] == [2, 4, 6]
    assert told == [(i, 6) for i in range(1, 7)]
    library, truths = Library.load("quick-paper"), Library.load("quick-paper-truths").cases[1:8:6]
    errors, inside, half = [], [], []
    for phase in (0, 10):
        for case in truths:
            assert case.history is not None
            near = np.abs(case.history.theta_deg) <= 95.0
            record = type(case.history)(
                case.history.position[near][phase::20],
                case.history.force[near][phase::20],
                provenance=case.history.provenance,
            )
            answer, phi = invert(record, library=library), case.scenario.soil.friction_angle_deg
            errors.append(answer.phi.median - phi)
            inside.append(answer.phi.ci68[0] <= phi <= answer.phi.ci68[1])
            half.append(0.5 * np.ptp(answer.phi.ci68))
    assert sparse["coverage68"] == pytest.approx(np.mean(inside))
    assert sparse["rms_error_deg"] == pytest.approx(np.sqrt(np.mean(np.square(errors))))
    assert sparse["ci68_half_width_deg"] == pytest.approx(np.median(half))
    assert set(found.documents) == {"spacing.md"}
    assert len(found.table.rows) == 3


@pytest.mark.parametrize(
    ("narrow", "told"), [(1.0, "as many as"), (0.4, "too few"), (3.0, "too many")]
)
def test_intervals_of_another_width_are_found_out(narrow: float, told: str) -> None:
    from scipy.special import ndtr

    rng = np.random.default_rng(6)
    error = 0.6 * rng.standard_normal((20, 1)) + 0.8 * rng.standard_normal((20, 10))
    answers = [
        spacing.Answer(20.0 + i, 20.0 + i - 0.1 * z, 0.1 * narrow, float(ndtr(z / narrow)), True)
        for i, row in enumerate(error)
        for z in row.tolist()
    ]
    row = spacing.row_of("library", "truths", 1.0, answers)
    assert row["likeness"] == pytest.approx(0.36, abs=0.15)
    assert row["rms_error_deg"] == pytest.approx(0.1, rel=0.15)
    assert row["consistent_outside95"] == pytest.approx(1.0 - row["coverage95"])
    for note, level in zip(spacing._notes([row]), (68, 95), strict=False):
        assert note.startswith(f"In {level} % intervals: {told}")


def test_shares_expected_of_records_that_are_alike_or_not() -> None:
    from scipy.stats import binom

    rng = np.random.default_rng(1)
    truth = np.tile(np.arange(8.0), 10)
    own = rng.uniform(size=80)
    likeness, expected = spacing.expected_of(truth, own)
    assert likeness < 0.3
    alone, bands = spacing.expected_of(truth, np.tile(own[:8], 10))
    assert alone == pytest.approx(1.0)
    assert bands[68] == pytest.approx(binom.ppf([0.05, 0.95], 8, 0.68) / 8)
    assert expected[68][0] > bands[68][0]
    assert expected[68][1] < bands[68][1]
    # Eighty of a chance each: 68 ± 1.64 · 5.2 %.
    _, independent = spacing.expected_of(np.arange(80.0), own)
    assert independent[68] == pytest.approx((0.59, 0.77), abs=0.03)


def test_phases_are_spread_over_the_spacing() -> None:
    assert spacing.phases(1) == [0]
    assert spacing.phases(2) == [0, 1]
    assert spacing.phases(40) == [0, 8, 16, 24, 32]


def test_a_library_without_truths_is_refused() -> None:
    with pytest.raises(InputError, match=r"'rft3d': no truths of it are shipped.*quick-paper"):
        spacing.run(library="rft3d")


def test_numbers_that_another_page_quotes_are_those_of_the_page() -> None:
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if "|" in line]
    both = {row[0]: (row[3][:-1], row[5][:-1]) for row in rows if row[1] == "all"}
    fourteen, eight, random, paper, ten = both.values()
    text = PAGE.with_name("inference.md").read_text(encoding="utf-8")
    for sentence in (
        f"over all spacings {fourteen[0]} % of the records of fourteen truths",
        f"are inside 68 % and {fourteen[1]} % inside 95 % intervals",
        f"{eight[0]} and {eight[1]} % of those of eight truths",
        f"{random[0]} and {random[1]} % of those of twenty",
        f"{paper[0]} and {paper[1]} % of those of eight and",
        f"and {ten[0]} and {ten[1]} % of those of ten at random",
    ):
        assert sentence in text


@pytest.mark.slow
def test_the_page_is_what_the_study_writes() -> None:
    page, written = PAGE.read_text(encoding="utf-8"), spacing.run().documents["spacing.md"]
    rows, again = (
        [line for line in text.splitlines() if line.startswith("| quick")]
        for text in (page, written)
    )
    number = r"\d+\.?\d*"
    for one, other in zip(rows, again, strict=True):
        for a, b in zip(re.findall(number, one), re.findall(number, other), strict=True):
            # Another machine rounds otherwise, and a case at an interval's end may change sides.
            assert float(a) == pytest.approx(float(b), rel=0.05, abs=3.0 if "." not in a else 0.02)
