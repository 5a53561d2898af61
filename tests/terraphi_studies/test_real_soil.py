"""Study real_soil: what it learns from, inverts and counts, on a few records."""

from __future__ import annotations

import json
from collections import Counter

import numpy as np
import pytest

import terraphi_studies as studies
from terraphi.experiment.measurements import measurement
from terraphi.inference.discrepancy import learn
from terraphi.inference.inversion import invert
from terraphi.inference.trials import Trial
from terraphi.library.store import Library
from terraphi_studies import real_soil

STRAIGHT = tuple(
    f"li2013:{medium}/straight"
    for medium in ("glass03_close", "glass03_loose", "poppy_loose", "yuma")
)


def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """The straight leg alone, and two false records of one medium."""
    wrong = [
        one
        for one in real_soil._spoilt(measurement("li2013:glass03_close/straight"))
        if one.kind in ("columns exchanged", "gravity: Moon")
    ]
    monkeypatch.setattr(real_soil, "names", lambda: STRAIGHT)
    monkeypatch.setattr(real_soil, "false_records", lambda _sands: iter(wrong))


def test_a_medium_is_inverted_with_what_the_others_taught(monkeypatch: pytest.MonkeyPatch) -> None:
    few(monkeypatch)
    told: list[tuple[float, float]] = []
    found = studies.run("real_soil", progress=lambda done, total: told.append((done, total)))
    json.dumps(found.data, allow_nan=False)
    assert told == [(i, 10) for i in range(1, 11)]
    assert found.data["passed"] == {
        "columns exchanged": {"consistent": 0, "of": 1},
        "gravity: Moon": {"consistent": 0, "of": 1},
    }
    # By hand: the others teach, and the medium itself does not.
    library = Library.load("resolved")
    seen = [real_soil.seen_through(library, measurement(name)) for name in STRAIGHT]
    others = learn(library, [one for one in seen if one.medium != "poppy_loose"])
    alone = invert(
        Trial.of(measurement("li2013:poppy_loose/straight")), library=library, discrepancy=others
    )
    (own,) = (a for a in found.data["answers"] if a["medium"] == "poppy_loose")
    assert own["phi_median_deg"] == pytest.approx(alone.phi.median)
    assert own["ci95_deg"] == pytest.approx(alone.phi.ci95)
    assert others.media == ("glass03_close", "glass03_loose", "yuma")
    # The file for the package is of all media.
    assert json.loads(found.documents["resolved.json"])["media"] == [
        "glass03_close", "glass03_loose", "poppy_loose", "yuma",
    ]  # fmt: skip


def test_false_records_are_of_every_kind_and_say_no_simulation() -> None:
    sands = [measurement(name) for name in STRAIGHT[:1]]
    false = list(real_soil.false_records(sands))
    assert Counter(one.kind for one in false) == {
        "RFT 3-D": 18, "RFT 2-D": 21, "wrong leg": 2, "density halved": 1, "density doubled": 1,
        "columns exchanged": 1, "gravity: Moon": 1, "gravity: Mars": 1, "gravity: 2.5 g": 1,
    }  # fmt: skip
    assert not any(one.trial.simulation for one in false)
    right = sands[0].history.force
    (exchanged,) = (one for one in false if one.kind == "columns exchanged")
    assert np.array_equal(exchanged.trial.history.Fx, right[:, 1])


def test_errors_and_intervals_are_counted_against_the_angles_of_repose() -> None:
    def answer(leg: str, repose: float | None, phi: float, half: float) -> dict[str, object]:
        return {
            "leg": leg, "angle_of_repose_deg": repose, "phi_median_deg": phi, "verdict": "misfit",
            "ci68_deg": [phi - half, phi + half], "ci95_deg": [phi - 2 * half, phi + 2 * half],
        }  # fmt: skip

    told = real_soil.summary(
        [
            answer("c", 30.0, 33.0, 2.0),
            answer("c", 35.0, 36.0, 2.0),
            answer("straight", 30.0, 28.0, 4.0),
            answer("straight", 35.0, 27.0, 3.0),
            answer("c", None, 90.0, 1.0),
        ]
    )
    assert told["rms_deg"] == pytest.approx(np.sqrt((9 + 1 + 4 + 64) / 4))
    assert told["mean_deg"] == pytest.approx((3 + 1 - 2 - 8) / 4)
    assert (told["held68"], told["held95"], told["with_repose"]) == (2, 3, 4)
    assert (told["legs_in_order"], told["legs"], told["consistent"]) == (1, 2, 0)
