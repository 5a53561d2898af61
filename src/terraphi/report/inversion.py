"""The report of an inversion: what ``terraphi invert --out`` left in its folder."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from terraphi.inference.information import (
    MOST_WITHOUT_FORCE,
    ZERO_FORCE,
    share_without_force,
    without_force,
)
from terraphi.inference.residual import peak_to_peak
from terraphi.report import figures as fig
from terraphi.report.certificate import certificate_of, certificate_parts
from terraphi.report.density import smooth_density
from terraphi.report.inversion_data import Again, Saved, load, recomputed
from terraphi.report.parts import Part, Plot, Section, Status, Table, Text, decimals, number

FloatArray = NDArray[np.float64]

CONVENTION = {
    "paper": "the paper's yield criterion",
    "plane_strain": "plane strain",
    "triaxial": "triaxial compression",
    "rft3d": "three-dimensional resistive force theory",
}
INFORMATION = "Which angles told the friction angle"
STATUS: dict[str, Status] = {"consistent": "good", "misfit": "bad", "out_of_range": "doubtful"}
UNCHECKED = "consistent, with a library whose intervals nobody has checked"
OTHER_LIKELIHOOD = (
    "consistent; its intervals were not checked, only those of the calibrated likelihood"
)
UNKNOWN = "consistent, but whether its library's intervals were checked is not known here"
WORDS = {
    "nodes": "nodes of the quadrature",
    "relative_change_on_halving": "change on halving the nodes / 68 % half-width",
    "split_rhat": "split R-hat (near 1)",
    "effective_sample_size": "effective draws",
    "steps_per_autocorrelation_time": "steps in autocorrelation times",
    "autocorrelation_time_steps": "autocorrelation time [steps]",
    "median_standard_error": "Monte-Carlo error of the median [deg]",
    "acceptance_fraction": "accepted proposals [-]",
}


def section(path: Path, *, library: str | None = None) -> Section:
    """Report of an inversion.

    Parameters
    ----------
    path
        Folder, ``answer.json`` or ``posterior.nc``.
    library
        Name or file of the library that was used, if it is not a shipped one.

    Returns
    -------
    Section

    Raises
    ------
    InputError
        If the result is not whole, or the library named is not the one that was used.
    """
    saved = load(path)
    again, why_not = recomputed(saved, library)
    answer = saved.answer
    parts: list[Part] = []
    if saved.draws_deg.size:
        parts += [_density(saved, again), *_forces(saved, again, why_not), _residuals(saved)]
    share = saved.share if again is None else again.share
    if share is not None:
        parts.append(_information(saved, share))
    parts.append(_numbers(answer))
    if again is not None:
        parts += _certificate(answer, again)
    parts += [*_budget(answer), _convergence(answer)]
    status, badge = _belief(answer, again)
    about = {key: answer[key] for key in ("source", "leg", "library", "likelihood", "sampler")}
    return Section(
        kind="inversion",
        title=str(answer["source"]) or path.name,
        headline=headline(answer),
        reason=_plain_verdict(answer),
        status=status,
        badge=badge,
        parts=parts,
        provenance={"result": path.name, **about, **answer.get("provenance", {})},
        overview=_overview(answer),
        apart=_apart(answer),
    )


def _belief(answer: Mapping[str, Any], again: Again | None) -> tuple[Status, str]:
    """Whether to believe an answer, and words for it where the usual ones would say too much."""
    status = STATUS.get(str(answer["verdict"]), "none")
    if status != "good":
        return status, ""
    if again is None:
        return "doubtful", UNKNOWN
    if str(answer["leg"]) not in certificate_of(again.library):
        return "doubtful", UNCHECKED
    if answer["likelihood"] != "calibrated":
        return "doubtful", OTHER_LIKELIHOOD
    return status, ""


def _certificate(answer: Mapping[str, Any], again: Again) -> list[Part]:
    """The library's certificate, but for forces of which it says nothing."""
    leg, library = str(answer["leg"]), again.library
    if answer["verdict"] != "misfit" or leg not in certificate_of(library):
        return certificate_parts(library, leg=leg)
    why = (
        f"That of library {library.name} does not apply: it was earned with forces that the "
        "library's own model made, and no friction angle of that model explains these."
    )
    return [Text("No certificate", (why,), wide=False)]


def headline(answer: Mapping[str, Any]) -> str:
    """The answer in one sentence, with convention and verdict."""
    phi = answer["phi_deg"]
    convention = CONVENTION.get(str(phi.get("yield")), str(phi.get("yield")))
    equal = answer["phi_plane_strain_deg"]
    also = ""
    if equal and phi.get("yield") != "plane_strain":
        also = f", which acts as {_median(equal)}° in plane strain"
    return (
        f"φ = {_median(phi)}° ({convention}; 68 %: {_range(phi, 'ci68')}, 95 %: "
        f"{_range(phi, 'ci95')}){also}. Verdict: {answer['verdict'].replace('_', ' ')}."
    )


def _overview(answer: Mapping[str, Any]) -> dict[str, str]:
    phi, equal = answer["phi_deg"], answer["phi_plane_strain_deg"]
    return {
        "verdict": str(answer["verdict"]).replace("_", " "),
        "leg": str(answer["leg"]),
        "library": str(answer["library"]),
        "φ means": CONVENTION.get(str(phi.get("yield")), str(phi.get("yield"))),
        "φ": f"{_median(phi)}°",
        "68 %": _range(phi, "ci68"),
        "95 %": _range(phi, "ci95"),
        "in plane strain": f"{_median(equal)}°" if equal else "–",
    }


def _apart(answer: Mapping[str, Any]) -> dict[str, str]:
    """What tells two answers from the same forces, leg and library apart."""
    assumed = ", assumed" if answer.get("density_assumed") else ""
    budget = answer.get("error_budget")
    known = budget if isinstance(budget, Mapping) else {}
    told, size = known.get("noise"), known.get("noise_N")
    words = [str(told)] if told is not None else []
    if _is_number(size):
        words.append(f"{number(size, 3)} N")
    return {
        "likelihood": str(answer["likelihood"]),
        "density": f"{answer['density_kg_m3']:g} kg/m³{assumed}",
        "noise": ", ".join(words) or "–",
        "discrepancy": str(known.get("discrepancy") or "–"),
    }


def _origin(answer: Mapping[str, Any]) -> str:
    """What its forces are, in a word."""
    return "simulated" if "simulation" in answer.get("provenance", {}) else "measured"


def _median(angle: Mapping[str, Any], fewest: int = 1) -> str:
    return f"{angle['median']:.{decimals(angle['ci68'], fewest)}f}"


def _range(angle: Mapping[str, Any], level: str, fewest: int = 1, unit: str = "°") -> str:
    """An interval, both levels with the digits that the narrower one needs."""
    low, high = (f"{end:.{decimals(angle['ci68'], fewest)}f}" for end in angle[level])
    return f"{low} to {high}{unit}"


def _plain_verdict(answer: Mapping[str, Any]) -> str:
    without = answer.get("phi_plane_strain_reason")
    note = f" No equivalent in plane strain: {without}." if without else ""
    return f"{answer['reason']}{note}"


def _numbers(answer: Mapping[str, Any]) -> Table:
    angles = [(f"φ, {answer['phi_deg'].get('yield')} [deg]", answer["phi_deg"])]
    if answer["phi_plane_strain_deg"] and answer["phi_deg"].get("yield") != "plane_strain":
        angles.append(("φ, equivalent in plane strain [deg]", answer["phi_plane_strain_deg"]))
    rows = [
        (
            name,
            _median(angle, 2),
            _range(angle, "ci68", 2, ""),
            _range(angle, "ci95", 2, ""),
        )
        for name, angle in angles
    ]
    misfit = " and ".join(f"{100.0 * answer['nrmsd'][f]:.1f} % ({f})" for f in ("Fx", "Fz"))
    assumed = ", assumed" if answer.get("density_assumed") else ""
    return Table(
        title="In numbers",
        header=("", "median", "68 %", "95 %"),
        rows=rows,
        note=(
            f"Leg {answer['leg']}, library {answer['library']}, density "
            f"{answer['density_kg_m3']:g} kg/m³{assumed}. The curve at the median deviates from "
            f"the {_origin(answer)} forces by {misfit} of their peak-to-peak."
        ),
    )


def _density(saved: Saved, again: Again | None) -> Plot:
    phi = saved.answer["phi_deg"]
    x, density = smooth_density(saved.draws_deg, bounds=again.bounds_deg if again else None)
    hover = f"φ = %{{x:.{decimals(phi['ci68'], 2)}f}}°<extra></extra>"
    traces = [fig.line(x, density, "posterior density", "@blue", hovertemplate=hover)]
    for level, colour in (("ci95", "@blue/0.18"), ("ci68", "@blue/0.40")):
        low, high = phi[level]
        inside = np.linspace(low, high, 121)
        height = np.interp(inside, x, density)
        name = f"{level[2:]} %: {_range(phi, level)}"
        traces.append(fig.band(inside, np.zeros_like(inside), height, name, colour))
    margin = 0.5 * (phi["ci95"][1] - phi["ci95"][0])
    reach = [phi["ci95"][0] - margin, phi["ci95"][1] + margin]
    ends = [end for end in (again.bounds_deg if again else ()) if reach[0] <= end <= reach[1]]
    return Plot(
        title="Posterior of the friction angle",
        traces=traces,
        layout=fig.layout(
            fig.phi_label(phi.get("yield")),
            "density [1/deg]",
            xaxis={"range": fig.numbers(reach)},
            yaxis={"rangemode": "tozero"},
            shapes=[
                fig.vertical(phi["median"], "@ink", dash="solid"),
                *(fig.vertical(end, "@orange", dash="dash") for end in ends),
            ],
        ),
        note="Line: median."
        + (f" Dashed: the library ends at {' and '.join(f'{e:g}°' for e in ends)}." if ends else "")
        + f" Smoothed from {saved.draws_deg.size} draws.",
    )


def _forces(saved: Saved, again: Again | None, why_not: str) -> list[Part]:
    half = len(saved.theta_deg)
    plots: list[Part] = []
    for name, part in (("Fx", slice(0, half)), ("Fz", slice(half, None))):
        traces = []
        if again is not None and again.band is not None:
            low, high = again.band[:, part]
            within = "curves within the 95 % interval"
            traces.append(fig.band(saved.theta_deg, low, high, within, "@blue/0.3"))
        traces += [
            fig.line(saved.theta_deg, saved.best[part], "curve at the median", "@blue"),
            fig.points(saved.theta_deg, saved.data[part], _origin(saved.answer), "@orange"),
        ]
        deviation = 100.0 * saved.answer["nrmsd"][name]
        plots.append(
            Plot(
                title=f"{name}: deviation {deviation:.1f} % of peak-to-peak",
                traces=traces,
                layout=fig.layout(fig.THETA, fig.AXIS_LABEL[name], xaxis=fig.DEGREES),
                note=f"No band of the 95 % interval: {why_not}." if why_not else "",
            )
        )
    return plots


def _residuals(saved: Saved) -> Plot:
    rest = (saved.data - saved.best).reshape(2, -1)
    spans = peak_to_peak(saved.data)
    looks = {"Fx": ("@orange", "square", "dash"), "Fz": ("@blue", "circle", "solid")}
    traces = []
    for (name, (colour, symbol, dash)), residual in zip(looks.items(), rest, strict=True):
        trace = fig.line(
            saved.theta_deg, 100.0 * residual / spans[name], fig.FORCE[name], colour, dash=dash,
            customdata=fig.numbers(residual),
            hovertemplate="θ = %{x:.0f}°: %{y:.1f} %, %{customdata:.3g} N",
        )  # fmt: skip
        trace["name"] = fig.FORCE[name]
        traces.append(
            {
                **trace,
                "mode": "lines+markers",
                "marker": {"symbol": symbol, "size": 5, "color": colour},
            }
        )
    return Plot(
        title=f"Residuals: {_origin(saved.answer)} minus curve at the median",
        traces=traces,
        layout=fig.layout(fig.THETA, "residual [% of peak-to-peak]", xaxis=fig.DEGREES),
    )


def _information(saved: Saved, share: FloatArray) -> Plot:
    total = np.cumsum(share.sum(axis=0))
    middle = float(saved.theta_deg[int(np.searchsorted(total, 0.5))])
    traces = [
        fig.bars(fig.numbers(saved.theta_deg), 100.0 * part, name, colour,
                 hovertemplate="θ = %{x:.0f}°: %{y:.1f} %")
        for part, name, colour in zip(share, ("Fx", "Fz"), ("@orange", "@blue"), strict=True)
    ]  # fmt: skip
    for trace, name in zip(traces, ("Fx", "Fz"), strict=True):
        trace["name"] = fig.FORCE[name]
    traces.append(
        fig.line(saved.theta_deg, 100.0 * total, "sum so far (right)", "@ink", dash="dot",
                 yaxis="y2", hovertemplate="θ = %{x:.0f}°: %{y:.0f} % so far")
    )  # fmt: skip
    parts = 100.0 * share.sum(axis=1)
    nothing = share_without_force(share, saved.data)
    doubt = (
        f" Beware: {nothing:.0%} comes from the shaded angles, where the measured force is zero "
        f"(below {ZERO_FORCE:.0%} of its largest): the model has a force there, and what these "
        "angles tell is where the soil begins, not how strong it is."
        if nothing > MOST_WITHOUT_FORCE
        else ""
    )
    return Plot(
        title=INFORMATION,
        traces=traces,
        layout=fig.layout(
            fig.THETA,
            "information added [%]",
            xaxis=fig.DEGREES,
            barmode="stack",
            shapes=_shaded(saved) if doubt else [],
            yaxis2={
                "overlaying": "y", "side": "right", "range": [0, 105], "showgrid": False,
                "tickvals": [0, 25, 50, 75, 100],
                "title": {"text": "sum so far [%]"},
            },
        ),
        wide=True,
        note=(
            f"Fx gave {parts[0]:.0f} %, Fz {parts[1]:.0f} %; half of all was in by θ = "
            f"{middle:.0f}°. What each angle adds to the Fisher information of those before it, "
            f"by the model's slope and the likelihood's covariance.{doubt}"
        ),
    )  # fmt: skip


def _shaded(saved: Saved) -> list[dict[str, Any]]:
    """A shade behind each angle at which no force was measured."""
    half = 0.5 * float(np.diff(saved.theta_deg).mean())
    return [
        fig.shade(theta - half, theta + half)
        for theta in saved.theta_deg[without_force(saved.data)].tolist()
    ]


def _budget(answer: Mapping[str, Any]) -> list[Part]:
    """Shares in the variance of φ, where the likelihood tells its parts apart."""
    budget = answer.get("error_budget")
    if not isinstance(budget, Mapping) or not isinstance(budget.get("shares"), Mapping):
        return []
    rows = [
        (str(name).replace("_", " "), f"{100.0 * share:.0f} %" if _is_number(share) else "–")
        for name, share in budget["shares"].items()
    ]
    size, told = budget.get("noise_N"), budget.get("noise")
    note = f"Noise of a window mean: {number(size, 2)} N, {told}." if _is_number(size) else ""
    title = "What the width of the interval comes from"
    return [Table(title, ("", "share"), rows, note=note, wide=True)]


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and math.isfinite(value)


def _convergence(answer: Mapping[str, Any]) -> Table:
    rows = [(WORDS.get(key, key), number(value)) for key, value in answer["convergence"].items()]
    title = f"Convergence ({answer['sampler']})"
    return Table(title=title, header=("", ""), rows=rows, wide=True)
