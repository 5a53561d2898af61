"""Calibration: how often intervals hold the truth, with truths that were simulated.

Truths are simulations off the grid of library `sand3d`, with particle seeds of their own. Each is
inverted as it is, and with white noise on its forces. Records that the model must not explain are
inverted too: legs passed off as others, and forces by another model.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import pages
import terraphi
from terraphi.laws.store import Case

LIBRARY = "sand3d"
TRUTHS = ("sand3d-truths.nc",)
NOISES = (0.0, 0.02, 0.05)
"""White noise of a reading, as a part of the peak force."""
DRAWS = 4
"""Draws of the noise for each truth."""


def simulated(library: Path | str) -> list[Case]:
    """Cases of a library that were simulated."""
    return [case for case in terraphi.Library.load(library).cases if case.history is not None]


def inverted(paths: Iterable[Path]) -> pd.DataFrame:
    """Answers to each truth of some libraries, with noise to several; angles in degrees."""
    rng, rows = np.random.default_rng(0), []
    truths = [case for path in paths for case in simulated(path)]
    for noise in NOISES:
        for case in truths:
            for _ in range(DRAWS if noise else 1):
                force, phi = case.history.force, case.scenario.soil.friction_angle_deg
                errors = noise * np.abs(force).max(axis=0) * rng.standard_normal(force.shape)
                answer = terraphi.invert(replace(case.history, force=force + errors), law=LIBRARY)
                found = answer.phi
                rows.append({
                    "leg": case.scenario.leg.shape,
                    "noise": noise,
                    "phi": phi,
                    "error": found.median - phi,
                    "half": 0.5 * (found.ci68[1] - found.ci68[0]),
                    "ci68": found.ci68,
                    "ci95": found.ci95,
                    "in68": found.ci68[0] <= phi <= found.ci68[1],
                    "in95": found.ci95[0] <= phi <= found.ci95[1],
                    "consistent": answer.verdict == "consistent",
                })  # fmt: skip
    return pd.DataFrame(rows)


def row_of(leg: str, noise: float, found: pd.DataFrame) -> tuple[object, ...]:
    """A row of the table."""
    error, count = found["error"].abs(), len(found)
    return (
        leg,
        f"{noise:.0%}",
        count,
        *(f"{angle:.2f}°" for angle in (error.median(), error.max(), found["half"].median())),
        *(f"{held.sum()} ({held.mean():.0%})" for held in (found["in68"], found["in95"])),
        (~found["consistent"]).sum(),
    )


def strangers() -> Iterator[tuple[str, Case, str]]:
    """Records that the model must not explain: their kind, and the leg they are passed off as."""
    legs = tuple(pages.LEGS)
    for case in simulated(LIBRARY)[::2]:
        own = case.scenario.leg.shape
        other = legs[(legs.index(own) + 1) % 3]
        yield f"{own} leg passed off as {other}", case, other
    for case in terraphi.Library.load("rft3d").cases[::3]:
        leg = case.scenario.leg.shape
        if case.history is not None and leg in legs:
            yield f"resistive force theory, {leg}", case, leg


def believed() -> list[tuple[str, str]]:
    """How many of these were called consistent, by kind."""
    verdicts: dict[str, list[str]] = {}
    for kind, case, leg in strangers():
        history, density = replace(case.history, provenance={}), case.scenario.soil.density
        answer = terraphi.invert(history, law=LIBRARY, rig="li2013", leg=leg, density=density)
        verdicts.setdefault(kind, []).append(answer.verdict)
    return [(kind, f"{v.count('consistent')} of {len(v)}") for kind, v in verdicts.items()]


def draw(found: pd.DataFrame) -> Figure:
    """Errors over φ with their intervals, and coverage over what it should be."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    errors, coverage = figure.subplots(1, 2)
    for one in found[found["noise"] == 0.0].itertuples():
        look = {"color": "#0072b2" if one.in95 else "#d55e00"}
        for interval, width in ((one.ci68, 3.0), (one.ci95, 1.0)):
            errors.plot([one.phi] * 2, [end - one.phi for end in interval], lw=width, **look)
        errors.plot(one.phi, one.error, "o", ms=4, **look)
    errors.axhline(0.0, color="grey", lw=0.8)
    errors.set(xlabel="true friction angle [deg]", ylabel="inferred less true [deg]")
    # A normal distribution through the 68 % interval: the score of each truth.
    for noise, own in found.groupby("noise"):
        scores = np.sort(own["error"].abs() / own["half"])
        share = np.arange(1, len(scores) + 1) / len(scores)
        coverage.step(scores, share, where="post", label=f"noise {noise:.0%}")
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
    found = inverted(arguments.truths or [pages.LIBRARIES / name for name in TRUTHS])
    rows = [row_of(leg, noise, own) for (leg, noise), own in found.groupby(["leg", "noise"])]
    header = ("leg", "noise", "records", "median error", "largest", "68 % half-width", "in 68 %",
              "in 95 %", "not consistent")  # fmt: skip
    parts = [
        (
            f"Simulations off the grid of library `{LIBRARY}`, inverted with it: how far medians "
            "are from the truth, and how many intervals hold it. Noise is white, as a part of the "
            "peak force."
        ),
        pages.table(header, rows),
        "Records that the model must not explain, and how many were called consistent:",
        pages.table(("record", "consistent"), believed()),
    ]
    alt = "errors of inferred angles with their intervals, and how often intervals hold the truth"
    pages.write(arguments.out, "calibration", "Are the intervals right?", parts, draw(found), alt)


if __name__ == "__main__":
    main()
