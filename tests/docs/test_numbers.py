"""Numbers in the pages are those of the code that they come from."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import legs
from terraphi.experiment import baseline, budget, reading
from terraphi.experiment.priors import FOOT_FRICTION, FRICTION
from terraphi.inference import checks, footfalls, inversion, likelihood, pressed, records
from terraphi.inference.manifest import LEAST_ROWS
from terraphi.inference.touchdowns import PHI_RANGE, Prior
from terraphi.laws import foot
from terraphi.laws.legs import MODES, PHI_DEG
from terraphi.laws.plan import RIG_ANGLES_DEG
from terraphi.robot.checks import CHECK_S, PART_S
from terraphi.robot.friction import MOST_LAG_S
from terraphi.robot.touchdowns import WINDOW_S
from terraphi.terrain.inputs import HEIGHTS
from terraphi.terrain.slopes import SAMPLES
from terraphi.view.app import MOST_MEMORY, Limits

ROOT = Path(__file__).parents[2]
EXPLANATION, HOW_TO = "docs/explanation/", "docs/how-to/"
LIMITS = Limits()
FRICTIONS = sorted({float(mu) for mu in foot.simulated_cases().x[:, 0]})

NUMBERS = [
    ("CONTRIBUTING.md", r"missing of (\d+) cases", [len(list(legs.cases()))]),
    ("SECURITY.md", r"more than (\S+) GB of variables", [budget.BYTES >> 30]),
    ("SECURITY.md", r"limited to (0\.\d) GB and (\d+) times its size",
     [round(budget.LEAST_UNPACKED / 1e9, 1), budget.UNPACKED]),
    ("SECURITY.md", r"file has at most (\d+) MB", [LIMITS.bytes / 1e6]),
    ("SECURITY.md", r"for at most (\d+) s, within (\d+) GiB", [LIMITS.seconds, MOST_MEMORY >> 30]),
    (EXPLANATION + "interval.md", r"up to ± (\d+)°, that is fitted", [likelihood.SHIFT_DEG]),
    (EXPLANATION + "interval.md", r"(\d+) degrees of freedom and a scale of (\d+) Pa",
     [likelihood.COHESION_DEGREES, likelihood.COHESION_PA]),
    (EXPLANATION + "interval.md", r"cohesion above (\d+) Pa better \(and (\d+\.\d+) ρ g d",
     [checks.MOIST_PA, checks.LIKE_GRAINS]),
    (EXPLANATION + "interval.md", r"a density outside (\d+) to (\d+)", [*records.USUAL_DENSITY]),
    (EXPLANATION + "interval.md", r"angle outside (\d+) to (\d+)°", [*checks.USUAL_DEG]),
    (EXPLANATION + "interval.md", r"more than (\d+(?:\.\d+)?)° later", [checks.LARGE_SHIFT_DEG]),
    (EXPLANATION + "model.md", r"friction \((\d+(?:\.\d+)?) and (\d+(?:\.\d+)?)\)", FRICTIONS),
    (HOW_TO + "own-library.md", r"`legs` \|.*\| (\d+) to (\d+)° \|", [*PHI_DEG]),
    (HOW_TO + "own-leg.md", r"taken as (\d+(?:\.\d+)?) ± (\d+(?:\.\d+)?)",
     [FRICTION.mean, round(FRICTION.sd, 2)]),
    (HOW_TO + "own-forces.md", r"averaged in bins of (\d+(?:\.\d+)?)°", [reading.BIN_DEG]),
    (HOW_TO + "own-forces.md", r"exceeds (\d+) % of the force's range", [100 * baseline.OFFSET]),
    (HOW_TO + "own-forces.md", r"at most (\d+)° above the critical", [inversion.DENSEST_DEG]),
    (HOW_TO + "own-forces.md", r"turned by (\d+) to (\d+)°",
     [abs(checks.TURNS_DEG).min(), checks.TURNS_DEG.max()]),
    (HOW_TO + "own-forces.md", r"Angles above (\d+)° are out of range",
     [round(pressed.LOOSE_DEG)]),
    (HOW_TO + "map.md", r"metres \(−(\d+) to (\d),000\)", [-HEIGHTS[0], HEIGHTS[1] / 1e3]),
    (HOW_TO + "map.md", r"mean over (\d+) points of a Sobol", [SAMPLES]),
    (HOW_TO + "go2-log.md", r"(\d+) ms at most", [1e3 * MOST_LAG_S]),
    (HOW_TO + "go2-log.md", r"first (\d+) s are checked, then each (\d+) s", [CHECK_S, PART_S]),
    (HOW_TO + "footfalls.md", r"at most (\d+(?:\.\d+)?) s, while the foot goes down", [WINDOW_S]),
    (HOW_TO + "footfalls.md", r"(\d\.\d)° for `foot`, (\d+)° for `rft`, (\d+)° for the others",
     [foot.LAWS[name].sd_deg for name in ("foot", "rft", "hansen")]),
    (HOW_TO + "footfalls.md", r"less than (\d+) mm while the force rose",
     [1e3 * footfalls.LEAST_GAINED]),
    (HOW_TO + "footfalls.md", r"closer than (\d+(?:\.\d+)?) radii", [footfalls.NEAR_RADII]),
    (HOW_TO + "footfalls.md", r"φ is (\d+) or (\d+)°", [*PHI_RANGE]),
    (HOW_TO + "footfalls.md", r"prior of (\d+) ± (\d+)°", [Prior().phi_deg, Prior().phi_sd_deg]),
    (HOW_TO + "footfalls.md", r"taken as (\d+(?:\.\d+)?) ± (\d+(?:\.\d+)?)",
     [FOOT_FRICTION.mean, round(FOOT_FRICTION.sd, 2)]),
]  # fmt: skip
"""Page, an expression that finds numbers in it, and what they are in the code."""


def test_numbers_of_pages_are_those_of_the_code() -> None:
    wrong = []
    for page, shown, expected in NUMBERS:
        match = re.search(shown, (ROOT / page).read_text(encoding="utf-8"))
        numbers = [float(number) for number in match.groups()] if match else []
        if numbers != pytest.approx(list(expected)):
            wrong.append((page, shown, numbers, expected))
    assert not wrong


def test_numbers_in_words_are_those_of_the_code() -> None:
    words = {3: "three", 5: "five", 8: "eight"}
    readme = (ROOT / "README.md").read_text(encoding="utf-8").lower()
    examples = len(list((ROOT / "docs" / "notebooks").glob("*.py")))
    assert f"[{words[examples]} examples]" in readme
    assert f"{words[len(RIG_ANGLES_DEG)]} simulations" in readme
    many = (ROOT / "docs" / "how-to" / "many.md").read_text(encoding="utf-8").lower()
    assert f"{words[LEAST_ROWS]} or more records run on all cores" in many
    interval = (ROOT / "docs" / "explanation" / "interval.md").read_text(encoding="utf-8")
    assert f"{words[MODES]} components" in interval
