"""Calibration: how often intervals hold the truth, with truths that were simulated.

Truths are simulations off the grid of library `sand3d`, with particle seeds of their own. Each is
inverted as it is, and with white noise on its forces. Records that the model must not explain are
inverted too: legs passed off as others, and forces by another model.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

import pages
import terraphi

LIBRARY = "sand3d"
TRUTHS = ("sand3d-truths.nc",)
NOISES = (0.0, 0.02, 0.05)
"""White noise of a reading, as a part of the peak force."""
DRAWS = 4
"""Draws of the noise for each truth."""


class Truth(NamedTuple):
    """A simulated record whose friction angle is known."""

    leg: str
    phi_deg: float
    history: terraphi.ForceHistory


class Outcome(NamedTuple):
    """What an inversion made of a truth."""

    truth: Truth
    noise: float
    phi: Any
    verdict: str

    @property
    def error(self) -> float:
        """Median less truth [deg]."""
        return float(self.phi.median - self.truth.phi_deg)

    def holds(self, interval: Sequence[float]) -> bool:
        """Whether an interval holds the truth."""
        return bool(interval[0] <= self.truth.phi_deg <= interval[1])


def truths_of(paths: Iterable[Path]) -> list[Truth]:
    """Simulations of libraries, by leg and friction angle."""
    return [
        Truth(case.scenario.leg.shape, case.scenario.soil.friction_angle_deg, case.history)
        for path in paths
        for case in terraphi.Library.load(path).cases
        if case.history is not None
    ]


def inverted(truths: Sequence[Truth], noise: float, rng: np.random.Generator) -> list[Outcome]:
    """Each truth, with noise several times."""
    found = []
    for truth in truths:
        for _ in range(DRAWS if noise else 1):
            peak = np.abs(truth.history.force).max(axis=0)
            errors = noise * peak * rng.standard_normal(truth.history.force.shape)
            history = replace(truth.history, force=truth.history.force + errors)
            answer = terraphi.invert(history, library=LIBRARY)
            found.append(Outcome(truth, noise, answer.phi, answer.verdict))
    return found


def row_of(leg: str, noise: float, found: Sequence[Outcome]) -> tuple[str, ...]:
    """A row of the table."""
    error = np.array([abs(one.error) for one in found])
    half = [0.5 * (one.phi.ci68[1] - one.phi.ci68[0]) for one in found]
    inside = [sum(one.holds(one.phi.ci68) for one in found),
              sum(one.holds(one.phi.ci95) for one in found)]  # fmt: skip
    return (
        leg,
        f"{noise:.0%}",
        str(len(found)),
        f"{np.median(error):.2f}°",
        f"{error.max():.2f}°",
        f"{np.median(half):.2f}°",
        *(f"{n} ({n / len(found):.0%})" for n in inside),
        str(sum(one.verdict != "consistent" for one in found)),
    )


def strangers() -> dict[str, list[str]]:
    """Verdicts on records that the model must not explain, by kind."""
    legs = ("straight", "c", "reversed_c")
    cases = [c for c in terraphi.Library.load(LIBRARY).cases if c.history is not None]
    found: dict[str, list[str]] = {}
    for case in cases[::2]:
        own = case.scenario.leg.shape
        other = legs[(legs.index(own) + 1) % 3]
        answer = terraphi.invert(
            replace(case.history, provenance={}), library=LIBRARY, leg=other,
            density=case.scenario.soil.density,
        )  # fmt: skip
        found.setdefault(f"{own} leg passed off as {other}", []).append(answer.verdict)
    for case in terraphi.Library.load("rft3d").cases[::3]:
        if case.history is not None and case.scenario.leg.shape in legs:
            answer = terraphi.invert(
                replace(case.history, provenance={}), library=LIBRARY,
                leg=case.scenario.leg.shape, density=case.scenario.soil.density,
            )  # fmt: skip
            kind = f"resistive force theory, {case.scenario.leg.shape}"
            found.setdefault(kind, []).append(answer.verdict)
    return found


def draw(found: Sequence[Outcome]) -> Figure:
    """Errors over φ with their intervals, and coverage over what it should be."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    errors, coverage = figure.subplots(1, 2)
    clean = [one for one in found if one.noise == 0.0]
    for one in clean:
        phi, held = one.truth.phi_deg, one.holds(one.phi.ci95)
        low, high = (end - phi for end in one.phi.ci68)
        colour = "#0072b2" if held else "#d55e00"
        errors.plot([phi, phi], [low, high], color=colour, lw=3.0)
        errors.plot([phi, phi], [end - phi for end in one.phi.ci95], color=colour, lw=1.0)
        errors.plot(phi, one.error, "o", color=colour, ms=4)
    errors.axhline(0.0, color="grey", lw=0.8)
    errors.set(xlabel="true friction angle [deg]", ylabel="inferred less true [deg]")
    # A normal distribution through the 68 % interval: the score of each truth.
    for noise in sorted({one.noise for one in found}):
        scores = np.array(
            [
                abs(one.error) / (0.5 * (one.phi.ci68[1] - one.phi.ci68[0]))
                for one in found
                if one.noise == noise
            ]
        )
        share = np.arange(1, len(scores) + 1) / len(scores)
        coverage.step(np.sort(scores), share, where="post", label=f"noise {noise:.0%}")
    coverage.plot([1.0, 2.0], [0.68, 0.95], "k+", ms=10, label="should be")
    coverage.set(xlabel="|error| over the 68 % half-width", ylabel="share of truths", xlim=(0, 4))
    coverage.legend(frameon=False, fontsize="small")
    return figure


def main() -> None:
    """Invert, and write the page."""
    parser = argparse.ArgumentParser(description=str(__doc__))
    parser.add_argument("truths", nargs="*", type=Path, help="libraries of truths")
    parser.add_argument("--out", type=Path, default=pages.DOCS)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    truths = truths_of(arguments.truths or [pages.LIBRARIES / name for name in TRUTHS])
    rng = np.random.default_rng(0)
    found = [one for noise in NOISES for one in inverted(truths, noise, rng)]
    legs = dict.fromkeys(truth.leg for truth in truths)
    rows = [
        row_of(leg, noise, [o for o in found if o.truth.leg == leg and o.noise == noise])
        for leg in legs
        for noise in NOISES
    ]
    header = ("leg", "noise", "records", "median error", "largest", "68 % half-width", "in 68 %",
              "in 95 %", "not consistent")  # fmt: skip
    believed = [
        (kind, f"{verdicts.count('consistent')} of {len(verdicts)}")
        for kind, verdicts in strangers().items()
    ]
    parts = [
        (
            f"Simulations off the grid of library `{LIBRARY}`, inverted with it: how far medians "
            "are from the truth, and how many intervals hold it. Noise is white, as a part of the "
            "peak force."
        ),
        pages.table(header, rows),
        "Records that the model must not explain, and how many were called consistent:",
        pages.table(("record", "consistent"), believed),
    ]
    alt = "errors of inferred angles with their intervals, and how often intervals hold the truth"
    pages.write(arguments.out, "calibration", "Are the intervals right?", parts, draw(found), alt)


if __name__ == "__main__":
    main()
