"""Plots of the studies whose data are known, drawn from the data and not from their pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from terraphi.report import figures as fig
from terraphi.report.certificate import WORDS
from terraphi.report.parts import Part, Plot, Table, Text, label, number

Data = Mapping[str, Any]


def known_plots(name: str, data: Data) -> list[Part]:
    """Plots of a study; none if there is no such study or its data are not as expected.

    Parameters
    ----------
    name
        Of the study.
    data
        ``data.json``.
    """
    if name not in _PLOTS:
        return []
    try:
        return _PLOTS[name](data)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        return [Text("Not drawn", (f"The data are not those of a {name} study ({error}).",))]


def _grouped(x: str, y: str) -> dict[str, Any]:
    """Bars beside each other over words, which may look like numbers."""
    return fig.layout(x, y, barmode="group", xaxis={"type": "category"})


def _recovery(data: Data) -> list[Part]:
    cases = data["cases"]
    truth = np.array([case["phi_true_deg"] for case in cases], dtype=np.float64)
    median = np.array([case["phi_median_deg"] for case in cases], dtype=np.float64)
    ends = [float(truth.min()) - 1.0, float(truth.max()) + 1.0]
    over = Plot(
        title="Inferred over true friction angle",
        traces=[
            fig.line(ends, ends, "equal", "@grey", dash="dot"),
            fig.points(truth, median, "median", "@blue"),
        ],
        layout=fig.layout("true φ [deg]", "inferred φ [deg]"),
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
        layout=fig.layout("true φ [deg]", "inferred − true φ [deg]"),
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


MODELS = {"mpm": "material point method", "rft2d": "2-D RFT", "rft3d": "3-D RFT"}


def _benchmark(data: Data) -> list[Part]:
    plots: list[Part] = []
    for name in ("Fz", "Fx"):
        deviations = data["nrmsd_percent"]
        legs = list(deviations)
        models = list(dict.fromkeys(model for leg in legs for model in deviations[leg]))
        plots.append(
            Plot(
                title=f"Deviation from the measured {name}",
                traces=[
                    fig.bars(
                        [leg.replace("_", " ") for leg in legs],
                        [deviations[leg].get(model, {}).get(name, np.nan) for leg in legs],
                        MODELS.get(model, model),
                        colour,
                        hovertemplate="%{x}: %{y:.1f} %",
                    )
                    for model, colour in zip(models, fig.COLOURS, strict=False)
                ],
                layout=_grouped("leg", "NRMSD [% of peak-to-peak]"),
            )
        )
    rows = [
        (f"{leg}, {MODELS.get(model, model)}", *(f"{found[key]:.1f}" for key in keys))
        for keys in (("Fz_N", "theta_Fz_deg", "Fx_N", "theta_Fx_deg"),)
        for leg, models_ in data["peaks"].items()
        for model, found in models_.items()
    ]
    header = ("", "peak Fz [N]", "at θ [deg]", "peak Fx [N]", "at θ [deg]")
    return [*plots, Table("Peaks", header, rows, wide=True)]


def _sensitivity(data: Data) -> list[Part]:
    plots: list[Part] = []
    sentences = []
    for group in data["groups"].values():
        sentences.append((str(group["setting"]), str(group["conclusion"]["sentence"])))
    for key, group in data["groups"].items():
        found = _changes(group)
        if found is not None:
            plots.append(
                Plot(
                    title=f"{group['setting']} ({key}), from {group['reference']}",
                    traces=found,
                    layout=_grouped(label(group["setting"]), "change [%]"),
                    height=260,
                )
            )
    follows = Table("What follows", ("setting", "conclusion"), sentences, wide=True, prose=True)
    return [follows, *plots]


def _changes(group: Data) -> list[dict[str, Any]] | None:
    """Change of the peaks with each value of a setting, if the data have it."""
    cases = [case for case in group["cases"] if isinstance(case, dict)]
    values = [str(case.get("value", case.get("label", ""))) for case in cases]
    changes = [case.get("peak_change_percent") for case in cases]
    if not cases or not all(isinstance(change, dict) for change in changes):
        return None
    return [
        fig.bars(values, [c[name] for c in changes if c], name, colour, hovertemplate="%{y:+.1f} %")
        for name, colour in (("Fz", "@blue"), ("Fx", "@orange"))
    ]


def _resolution(data: Data) -> list[Part]:
    steps = data["waterfall"]
    looks = (("Fz", "@blue"), ("Fx", "@orange"))
    way = Plot(
        title="Peak forces, one remedy after another",
        traces=[
            fig.bars(
                [str(step["step"]) for step in steps],
                [step["peaks_N"][name] for step in steps],
                name,
                colour,
                customdata=fig.numbers([step["change_N"][name] for step in steps]),
                hovertemplate="%{x}: %{y:.2f} N (%{customdata:+.2f} N)",
            )
            for name, colour in looks
        ],
        layout=_grouped("", "peak [N]"),
        wide=True,
        height=420,
    )
    halved = data["halved"]
    end = Plot(
        title="Preset resolved, changed by itself",
        traces=[
            fig.bars(
                list(halved),
                [change["change_percent"][name] for change in halved.values()],
                name,
                colour,
                hovertemplate="%{x}: %{y:+.1f} %",
            )
            for name, colour in looks
        ],
        layout=_grouped("", "change of the peak [%]"),
        wide=True,
        height=380,
    )
    return [way, end]


def _verification(data: Data) -> list[Part]:
    tables: list[Part] = []
    counts = []
    for family, found in data["families"].items():
        checks: Sequence[Data] = found["checks"]
        passed = sum(bool(check["passed"]) for check in checks)
        counts.append((family, passed, len(checks) - passed))
    tables.append(
        Plot(
            title="Checks by family",
            traces=[
                fig.bars([c[0] for c in counts], [c[1] for c in counts], "passed", "@blue"),
                fig.bars(
                    [c[0] for c in counts], [c[2] for c in counts], "missed", "@orange",
                    marker={"color": "@orange", "pattern": {"shape": "/"}},
                ),
            ],
            layout=fig.layout("", "checks", barmode="stack"),
            wide=True,
        )
    )  # fmt: skip
    missed = [
        (
            str(check["problem"]),
            *(str(check.get(key, "")) for key in ("case", "quantity")),
            *(number(check.get(key)) for key in ("expected", "obtained")),
            str(check.get("cause", "")),
        )
        for found in data["families"].values()
        for check in found["checks"]
        if not check["passed"]
    ]
    header = ("problem", "case", "quantity", "expected", "obtained", "cause")
    if missed:
        tables.append(Table("Checks that missed", header, missed, wide=True, prose=True))
    return tables


def _calibration(data: Data) -> list[Part]:
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


def _phi_sensitivity(data: Data) -> list[Part]:
    traces = [
        {
            **fig.line(data["phi_deg"], data[f"peak_{name}_N"], name, colour, dash=dash),
            "mode": "lines+markers",
            "hovertemplate": "φ = %{x:g}°: %{y:.2f} N",
        }
        for name, colour, dash in (("Fz", "@blue", "solid"), ("Fx", "@orange", "dash"))
    ]
    words = f"friction angle, {label(data['yield'])} [deg]"
    return [
        Plot(
            "Peak forces over the friction angle", traces, fig.layout(words, "peak [N]"), wide=True
        )
    ]


_PLOTS: dict[str, Callable[[Data], list[Part]]] = {
    "recovery": _recovery,
    "benchmark": _benchmark,
    "sensitivity": _sensitivity,
    "resolution": _resolution,
    "verification": _verification,
    "calibration": _calibration,
    "phi_sensitivity": _phi_sensitivity,
}
