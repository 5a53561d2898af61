"""The report of an inversion: what ``terraphi invert --out`` left in its folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.errors import InputError
from terraphi.inference.information import information_share
from terraphi.inference.residual import PaperLikelihood, peak_to_peak
from terraphi.library import Library
from terraphi.report import figures as fig
from terraphi.report.certificate import certificate_parts
from terraphi.report.density import smooth_density
from terraphi.report.parts import Part, Plot, Section, Status, Table, number
from terraphi.surrogate import LegSurrogate

FloatArray = NDArray[np.float64]

CONVENTION = {
    "paper": "the paper's yield criterion",
    "plane_strain": "plane strain",
    "triaxial": "triaxial compression",
    "rft3d": "three-dimensional resistive force theory",
}
STATUS: dict[str, Status] = {"consistent": "good", "misfit": "bad", "out_of_range": "doubtful"}
STEP_DEG = 0.25
"""Half the step of the derivative of the forces with respect to φ [deg]."""
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


@dataclass(frozen=True)
class Saved:
    """What a folder of an inversion holds.

    Attributes
    ----------
    answer
        ``answer.json``.
    draws_deg
        Of φ [deg], shape [draw]; empty if only the answer is there.
    theta_deg
        Leg angles [deg], shape [theta].
    data, best
        Observation vector and the curve at the median [N], shape [2 theta].
    """

    answer: Mapping[str, Any]
    draws_deg: FloatArray
    theta_deg: FloatArray
    data: FloatArray
    best: FloatArray


@dataclass(frozen=True)
class Again:
    """What follows from the library that was used.

    Attributes
    ----------
    band
        Smallest and largest force over the 95 % interval [N], shape [2, 2 theta].
    share
        What each angle adds to the information on φ [-], shape [2, theta]; ``None`` where the
        likelihood is not the paper's.
    bounds_deg
        Friction angles that the library covers [deg].
    library
        The library.
    """

    band: FloatArray
    share: FloatArray | None
    bounds_deg: tuple[float, float]
    library: Library


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
    if again is not None and again.share is not None:
        parts.append(_information(saved, again.share))
    parts.append(_numbers(answer))
    if again is not None:
        parts += certificate_parts(again.library, leg=str(answer["leg"]))
    parts.append(_convergence(answer))
    about = {key: answer[key] for key in ("source", "leg", "library", "likelihood", "sampler")}
    return Section(
        kind="inversion",
        title=str(answer["source"]) or path.name,
        headline=headline(answer),
        reason=_plain_verdict(answer),
        status=STATUS.get(str(answer["verdict"]), "none"),
        parts=parts,
        provenance={"result": path.name, **about, **answer.get("provenance", {})},
        overview=_overview(answer),
    )


def load(path: Path) -> Saved:
    """Read an inversion's folder, answer or posterior; raises InputError if it is not whole."""
    folder = path if path.is_dir() else path.parent
    answer_file = path if path.suffix == ".json" else folder / "answer.json"
    posterior = path if path.suffix == ".nc" else folder / "posterior.nc"
    if not posterior.is_file():
        return _checked(Saved(_answer(answer_file), *(np.empty(0),) * 4), answer_file)
    import xarray as xr

    try:
        with xr.open_datatree(posterior, engine="h5netcdf") as opened:
            tree = opened.load()
        vectors = [
            np.concatenate([tree[group][name].values.astype(np.float64) for name in ("Fx", "Fz")])
            for group in ("observed_data", "posterior_predictive_mean")
        ]
        theta = tree["observed_data"]["theta_deg"].values.astype(np.float64)
        draws = tree["posterior"]["phi_deg"].values.astype(np.float64).ravel()
        answer = json.loads(tree.attrs["answer"])
    except Exception as error:  # the HDF5 stack raises OSError, KeyError, ValueError and more
        raise InputError(
            f"{posterior}: not a whole posterior as 'terraphi invert --out' writes it; make it "
            "again"
        ) from error
    sound = len(vectors[0]) == len(vectors[1]) == 2 * len(theta) and len(draws) >= 10
    if not sound or not all(np.isfinite(v).all() for v in (*vectors, theta, draws)):
        raise InputError(f"{posterior}: its arrays do not fit each other; make it again")
    return _checked(Saved(answer, draws, theta, *vectors), posterior)


def _answer(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not an answer of 'terraphi invert --out'") from error
    if not isinstance(found, dict):
        raise InputError(f"{path}: not an answer of 'terraphi invert --out'")
    return found


def _checked(saved: Saved, path: Path) -> Saved:
    """Refuse an answer without what every answer has."""
    answer = saved.answer
    try:
        for name in ("phi_deg", "phi_plane_strain_deg"):
            if name == "phi_deg" or answer[name] is not None:
                float(answer[name]["median"])
                for level in ("ci68", "ci95"):
                    low, high = map(float, answer[name][level])
                    assert low <= high
        assert all(isinstance(answer["nrmsd"][name], float) for name in ("Fx", "Fz"))
        float(answer["density_kg_m3"])
        for name in ("source", "leg", "library", "likelihood", "sampler", "verdict", "reason"):
            assert isinstance(answer[name], str)
        assert isinstance(answer["convergence"], dict)
        assert isinstance(answer.get("provenance", {}), dict)
    except (KeyError, TypeError, ValueError, AssertionError) as error:
        raise InputError(f"{path}: not an answer of 'terraphi invert --out'; make it again") from (
            error
        )
    return saved


def recomputed(saved: Saved, name: str | None) -> tuple[Again | None, str]:
    """What follows from the library, or why it cannot be had.

    Parameters
    ----------
    saved
        The inversion.
    name
        Name or file of the library; by default the shipped one of the name in the answer.

    Raises
    ------
    InputError
        If a library was named and is not the one that was used.
    """
    answer = saved.answer
    if not saved.draws_deg.size:
        return None, "posterior.nc does not lie beside the answer"
    wanted = answer.get("provenance", {}).get("library_hash")
    used = str(answer["library"])
    try:
        # Never a path out of somebody's file.
        found = Library.load(name or Path(used).name.removesuffix(".nc"))
    except InputError as error:
        if name is not None:
            raise
        return None, f"the library '{used}' is not at hand ({error}); name it with --library"
    if wanted != found.hash:
        why = f"library '{name or used}' is not the one that was used, or of another version"
        if name is not None:
            raise InputError(why)
        return None, why
    return _again(saved, found), ""


def _again(saved: Saved, library: Library) -> Again:
    answer = saved.answer
    curves = library.curves(str(answer["leg"]))
    scale = float(answer["density_kg_m3"]) / curves.scenario.soil.density
    surrogate = LegSurrogate.fit(curves.phi_deg, curves.theta_deg, curves.Fx, curves.Fz)
    phi = answer["phi_deg"]
    inside = surrogate.predict(np.linspace(*phi["ci95"], 101), scale=scale)
    share = None
    if answer["likelihood"] == "paper":
        low, high = surrogate.phi_bounds_deg
        at = np.clip(phi["median"] + np.array([-STEP_DEG, STEP_DEG]), low, high)
        before, after = surrogate.predict(at, scale=scale)
        slope = (after - before) / (at[1] - at[0])
        share = information_share(PaperLikelihood(saved.data, saved.theta_deg), slope)
    band = np.stack([inside.min(axis=0), inside.max(axis=0)])
    return Again(band, share, surrogate.phi_bounds_deg, library)


def headline(answer: Mapping[str, Any]) -> str:
    """The answer in one sentence, with convention and verdict."""
    phi = answer["phi_deg"]
    convention = CONVENTION.get(str(phi.get("yield")), str(phi.get("yield")))
    equal = answer["phi_plane_strain_deg"]
    also = ""
    if equal and phi.get("yield") != "plane_strain":
        also = f", which acts as {equal['median']:.1f}° in plane strain"
    return (
        f"φ = {phi['median']:.1f}° ({convention}; 68 %: {_range(phi['ci68'])}, 95 %: "
        f"{_range(phi['ci95'])}){also}. Verdict: {answer['verdict'].replace('_', ' ')}."
    )


def _overview(answer: Mapping[str, Any]) -> dict[str, str]:
    phi, equal = answer["phi_deg"], answer["phi_plane_strain_deg"]
    return {
        "leg": str(answer["leg"]),
        "library": str(answer["library"]),
        "φ means": CONVENTION.get(str(phi.get("yield")), str(phi.get("yield"))),
        "φ": f"{phi['median']:.1f}°",
        "68 %": _range(phi["ci68"]),
        "95 %": _range(phi["ci95"]),
        "in plane strain": f"{equal['median']:.1f}°" if equal else "–",
        "verdict": str(answer["verdict"]).replace("_", " "),
    }


def _range(ends: Any) -> str:
    return f"{ends[0]:.1f} to {ends[1]:.1f}°"


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
            f"{angle['median']:.2f}",
            "{:.2f} to {:.2f}".format(*angle["ci68"]),
            "{:.2f} to {:.2f}".format(*angle["ci95"]),
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
            f"the measured forces by {misfit} of their peak-to-peak."
        ),
    )


def _density(saved: Saved, again: Again | None) -> Plot:
    phi = saved.answer["phi_deg"]
    x, density = smooth_density(saved.draws_deg, bounds=again.bounds_deg if again else None)
    traces = [
        fig.line(
            x, density, "posterior density", "@blue", hovertemplate="φ = %{x:.2f}°<extra></extra>"
        ),
    ]
    for level, colour in (("ci95", "@blue/0.18"), ("ci68", "@blue/0.40")):
        inside = np.linspace(*phi[level], 121)
        height = np.interp(inside, x, density)
        name = f"{level[2:]} %: {_range(phi[level])}"
        traces.append(fig.band(inside, np.zeros_like(inside), height, name, colour))
    margin = 0.5 * (phi["ci95"][1] - phi["ci95"][0])
    reach = [phi["ci95"][0] - margin, phi["ci95"][1] + margin]
    ends = [end for end in (again.bounds_deg if again else ()) if reach[0] <= end <= reach[1]]
    return Plot(
        title="Posterior of the friction angle",
        traces=traces,
        layout=fig.layout(
            f"friction angle, {fig.label(phi.get('yield'))} [deg]",
            "density [1/deg]",
            xaxis={"range": fig.numbers(reach)},
            yaxis={"rangemode": "tozero"},
            shapes=[
                fig.vertical(phi["median"], "@ink", dash="solid"),
                *(fig.vertical(end, "@orange", dash="dash") for end in ends),
            ],
        ),
        note="Line: median."
        + (f" Dashed: the library ends at {ends[0]:g}°." if ends else "")
        + f" Smoothed from {saved.draws_deg.size} draws.",
    )


def _forces(saved: Saved, again: Again | None, why_not: str) -> list[Part]:
    half = len(saved.theta_deg)
    plots: list[Part] = []
    for name, part in (("Fx", slice(0, half)), ("Fz", slice(half, None))):
        traces = []
        if again is not None:
            traces.append(
                fig.band(
                    saved.theta_deg, *again.band[:, part], "curves within the 95 % interval",
                    "@blue/0.3",
                )
            )  # fmt: skip
        traces += [
            fig.line(saved.theta_deg, saved.best[part], "curve at the median", "@blue"),
            fig.points(saved.theta_deg, saved.data[part], "measured", "@orange"),
        ]
        plots.append(
            Plot(
                title=f"{name}: misfit {100.0 * saved.answer['nrmsd'][name]:.1f} % of peak-to-peak",
                traces=traces,
                layout=fig.layout(fig.THETA, fig.AXIS_LABEL[name], xaxis=fig.DEGREES),
                note="" if again else f"No band of the 95 % interval: {why_not}.",
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
        title="Residuals: measured minus curve at the median",
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
    return Plot(
        title="Which angles told the friction angle",
        traces=traces,
        layout=fig.layout(
            fig.THETA,
            "information added [%]",
            xaxis=fig.DEGREES,
            barmode="stack",
            yaxis2={
                "overlaying": "y", "side": "right", "range": [0, 105], "showgrid": False,
                "tickvals": [0, 25, 50, 75, 100],
                "title": {"text": "sum so far [%]"},
            },
        ),
        note=(
            f"Fx gave {parts[0]:.0f} %, Fz {parts[1]:.0f} %; half of all was in by θ = "
            f"{middle:.0f}°. What each angle adds to the Fisher information of those before it, "
            "by the model's slope and the likelihood's covariance."
        ),
    )  # fmt: skip


def _convergence(answer: Mapping[str, Any]) -> Table:
    rows = [(WORDS.get(key, key), number(value)) for key, value in answer["convergence"].items()]
    return Table(title=f"Convergence ({answer['sampler']})", header=("", ""), rows=rows)
