"""Plots of the studies that infer friction angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from terraphi.view.report import parts as fig
from terraphi.view.report.certificate import WORDS
from terraphi.view.report.parts import Part, Plot, Table, label, number


def recovery(data: Mapping[str, Any]) -> list[Part]:
    """Inferred over true angles, errors with their intervals, and all cases."""
    cases = data["cases"]
    truth = np.array([case["phi_true_deg"] for case in cases], dtype=np.float64)
    median = np.array([case["phi_median_deg"] for case in cases], dtype=np.float64)
    ends = [float(truth.min()) - 1.0, float(truth.max()) + 1.0]
    of = fig.phi_label(data.get("yield"))
    over = Plot(
        title="Inferred over true friction angle",
        traces=[
            fig.line(ends, ends, "equal", "@grey", dash="dot"),
            fig.points(truth, median, "median", "@blue"),
        ],
        layout=fig.layout(f"true {of}", f"inferred {of}"),
    )
    traces = []
    for level, width in (("ci95", 1.5), ("ci68", 5)):
        low, high = np.array([case[level] for case in cases], dtype=np.float64).T
        bar = fig.points(truth, 0.5 * (low + high) - truth, f"{level[2:]} % interval", "@blue")
        bar["marker"]["size"] = 1
        bar["error_y"] = {
            "array": fig.numbers(0.5 * (high - low)), "color": "@blue/0.6", "thickness": width,
            "width": 0,
        }  # fmt: skip
        traces.append(bar)
    verdicts = [label(str(case.get("verdict", "")).replace("_", " ")) for case in cases]
    traces.append(
        fig.points(
            truth, median - truth, "median", "@orange", symbol="diamond", customdata=verdicts,
            hovertemplate="true %{x:.2f}°: %{y:+.2f}°, %{customdata}<extra></extra>",
        )
    )  # fmt: skip
    errors = Plot(
        title="Errors with their intervals",
        traces=traces,
        layout=fig.layout(f"true {of}", "inferred − true [deg]"),
    )
    rows = [
        (
            f"{case['phi_true_deg']:.2f}°",
            f"{case['phi_median_deg']:.2f}°",
            f"{case['phi_median_deg'] - case['phi_true_deg']:+.2f}°",
            "{:.2f} to {:.2f}°".format(*case["ci68"]),
            "{:.2f} to {:.2f}°".format(*case["ci95"]),
            str(case.get("verdict", "")).replace("_", " "),
        )
        for case in cases
    ]
    header = ("true φ", "median", "error", "68 %", "95 %", "verdict")
    return [over, errors, Table("Case by case", header, rows, wide=True)]


def calibration(data: Mapping[str, Any]) -> list[Part]:
    """Coverage in simulated worlds, and of truths."""
    keys = ("coverage68", "coverage95", "rank_chi2_p", "ci68_half_width_deg")
    rows = [(WORDS.get(key, key), number(data[key], 3)) for key in keys]
    truths = [
        (
            str(what),
            str(found["cases"]),
            f"{found['abs_error_deg']['median']:.2f}",
            f"{found['ci68_half_width_deg']['median']:.2f}",
            str(found["inside68"]),
            str(found["inside95"]),
        )
        for what, found in data["truths"].items()
    ]
    header = ("truths", "cases", "median error [deg]", "half-width of 68 % [deg]", "in 68 %",
              "in 95 %")  # fmt: skip
    note = f"In {data['replicates']} simulated worlds."
    return [Table("Coverage", ("", ""), rows, note=note), Table("Truths", header, truths)]


LEGS = {"straight": "straight", "c": "C", "reversed_c": "reversed C"}


def measured(data: Mapping[str, Any]) -> list[Part]:
    """Friction angles by medium and leg, a plot a library, and all answers."""
    answers = data["answers"]
    libraries = list(dict.fromkeys(answer["library"] for answer in answers))
    plots: list[Part] = []
    for library in libraries:
        of_library = [answer for answer in answers if answer["library"] == library]
        looks = zip(LEGS.items(), fig.COLOURS, fig.SYMBOLS, strict=False)
        traces = [
            _answers([a for a in of_library if a["leg"] == leg], name, colour, symbol)
            for (leg, name), colour, symbol in looks
        ]
        words = fig.phi_label(of_library[0]["yield"])
        media = {"type": "category"}
        plots.append(
            Plot(
                title=f"By library {library}",
                traces=traces,
                layout=fig.layout("", words, scattermode="group", scattergap=0.6, xaxis=media),
                note="Bars: 95 % intervals. Hollow: misfit or out of range.",
            )
        )
    rows = [
        (
            f"{a['library']}, {a['medium']}, {LEGS.get(a['leg'], a['leg'])}",
            f"{a['phi_median_deg']:.1f}°",
            "{:.1f} to {:.1f}°".format(*a["ci95_deg"]),
            *(f"{a['nrmsd_percent'][force]:.0f} %" for force in ("Fz", "Fx")),
            str(a["verdict"]).replace("_", " "),
        )
        for a in answers
    ]
    header = ("", "φ", "95 %", "NRMSD Fz", "NRMSD Fx", "verdict")
    return [*plots, Table("Answer by answer", header, rows, wide=True, folded=True)]


def design(data: Mapping[str, Any]) -> list[Part]:
    """Error of the friction angle over the size of the library, in each order."""
    looks = (("grid", "@blue"), ("sobol", "@grey"), ("suggested", "@orange"))
    return [
        Plot(
            title=f"Error of the friction angle, {len(found['keys'])} varied",
            traces=[
                fig.line(found["cases"], [e[0] for e in found[order]], order, colour)
                for order, colour in looks
            ],
            layout=fig.layout("cases", "root mean square error of φ [deg]", yaxis={"type": "log"}),
        )
        for found in data["comparisons"]
    ]


def _answers(
    answers: Sequence[Mapping[str, Any]], name: str, colour: str, symbol: str
) -> dict[str, Any]:
    """Medians with their 95 % intervals over the media."""
    median = np.array([a["phi_median_deg"] for a in answers], dtype=np.float64)
    low, high = np.array([a["ci95_deg"] for a in answers], dtype=np.float64).reshape(-1, 2).T
    hollow = [a["verdict"] != "consistent" for a in answers]
    return {
        "type": "scatter",
        "mode": "markers",
        "x": [label(a["medium"]) for a in answers],
        "y": fig.numbers(median),
        "name": label(name),
        "marker": {
            "color": colour, "size": 8, "symbol": [symbol + "-open" * h for h in hollow],
        },
        "error_y": {
            "array": fig.numbers(high - median), "arrayminus": fig.numbers(median - low),
            "color": colour, "thickness": 1.5,
        },
        "customdata": [label(str(a["verdict"]).replace("_", " ")) for a in answers],
        "hovertemplate": "%{x}: %{y:.1f}°, %{customdata}",
    }  # fmt: skip
