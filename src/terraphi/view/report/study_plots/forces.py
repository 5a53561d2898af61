"""Plots of the studies that compare forces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from terraphi.view.report import parts as fig
from terraphi.view.report.parts import Part, Plot, Table

LOOKS = (("Fz", "@blue"), ("Fx", "@orange"))
MODELS = {"mpm": "material point method", "rft2d": "2-D RFT", "rft3d": "3-D RFT"}


def benchmark(data: Mapping[str, Any]) -> list[Part]:
    """Deviations from the measured forces by leg and model, and the peaks."""
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
                layout=fig.grouped("leg", "NRMSD [% of peak-to-peak]"),
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


def phi_sensitivity(data: Mapping[str, Any]) -> list[Part]:
    """Peak forces over the friction angle."""
    traces = [
        {
            **fig.line(data["phi_deg"], data[f"peak_{name}_N"], name, colour, dash=dash),
            "mode": "lines+markers",
            "hovertemplate": "φ = %{x:g}°: %{y:.2f} N",
        }
        for name, colour, dash in (("Fz", "@blue", "solid"), ("Fx", "@orange", "dash"))
    ]
    axes = fig.layout(fig.phi_label(data["yield"]), "peak [N]")
    return [Plot("Peak forces over the friction angle", traces, axes, wide=True)]


def k0(data: Mapping[str, Any]) -> list[Part]:
    """Change of a history with the stress at rest, by friction angle."""
    cases = data["cases"]
    traces = [
        fig.bars(
            [f"{case['phi_deg']:g}" for case in cases],
            [100.0 * case["relative_change"][force] for case in cases],
            force,
            colour,
            hovertemplate="φ = %{x}°: %{y:.2g} %",
        )
        for force, colour in LOOKS
    ]
    return [
        Plot(
            "Largest change of a history, of its peak",
            traces,
            fig.grouped(fig.phi_label(data["yield"]), "change [%]"),
            note="From a stress at rest of 1 − sin φ to 0.5 of the weight above.",
        )
    ]


def surrogate(data: Mapping[str, Any]) -> list[Part]:
    """Errors on cases that were held out, and the fitted parameters."""
    plots: list[Part] = []
    for force, colour in LOOKS:
        found = [angle for angle in data["held_out"]["angles"] if angle["force"] == force]
        traces = [
            fig.bars(
                [f"θ = {angle['theta_deg']:.0f}°" for angle in found],
                [angle["relative_error_percent"][which] for angle in found],
                name,
                fill,
                hovertemplate="%{x}: %{y:.2f} %",
            )
            for which, name, fill in (("median", "median", colour), ("max", "largest", "@grey"))
        ]
        title = f"{force} of {len(data['held_out']['phi_deg'])} held-out cases"
        plots.append(Plot(title, traces, fig.grouped("", "relative error [%]")))
    rows = [
        (
            force,
            f"{found['phi_length_deg']:.0f}°",
            f"{found['theta_length_deg']:.1f}°",
            f"{found['noise_N']:.2g} N",
            f"{data['nrmsd_percent'][force]:.2f} %",
        )
        for force, found in data["parameters"].items()
    ]
    header = ("", "length over φ", "length over θ", "noise", "NRMSD of held-out cases")
    return [*plots, Table("Fitted", header, rows, wide=True)]


def prediction(data: Mapping[str, Any]) -> list[Part]:
    """Deviations on each leg, a plot a medium and force, and what was calibrated."""
    rows = [
        (
            str(medium),
            f"{fit['phi_deg']:.1f}°",
            f"{fit['friction']:.2f}",
            "at an edge of what was simulated" if fit["at_edge"] else "inside",
        )
        for medium, fit in data["calibrated"].items()
    ]
    header = ("medium", "φ, plane strain", "friction of the leg", "the fit is")
    plots: list[Part] = []
    for medium, legs in data["nrmsd_percent"].items():
        models = list(dict.fromkeys(model for found in legs.values() for model in found))
        for force, _ in LOOKS:
            traces = [
                fig.bars(
                    [str(leg).replace("_", " ") for leg in legs],
                    [found.get(model, {}).get(force, np.nan) for found in legs.values()],
                    model,
                    colour,
                    hovertemplate="%{x}: %{y:.1f} %",
                )
                for model, colour in zip(models, fig.COLOURS, strict=False)
            ]
            title = f"{medium}: deviation from the measured {force}"
            plots.append(Plot(title, traces, fig.grouped("leg", "NRMSD [% of peak-to-peak]")))
    return [Table("Calibrated on the straight leg", header, rows, wide=True), *plots]
