"""The report of an inversion: what ``terraphi invert --out`` left in its folder."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import damage_told
from terraphi.inference.answer import PHI, decimals
from terraphi.inference.budget import (
    MOST_WITHOUT_FORCE,
    ZERO_FORCE,
    share_without_force,
    without_force,
)
from terraphi.inference.findings import Measure
from terraphi.inference.paper_likelihood import peak_to_peak
from terraphi.inference.words import rows_of
from terraphi.library.store import Library
from terraphi.view import answers
from terraphi.view.report import parts as fig
from terraphi.view.report.certificate import certificate_parts
from terraphi.view.report.parts import (
    Part,
    Plot,
    Section,
    Status,
    Text,
    number,
    smooth_density,
)
from terraphi.view.report.study import pictures
from terraphi.view.table import Table

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
OF_SIMULATED = (
    "That of the library is of simulated forces. How often the intervals of measured ones hold the "
    "angle of repose is what 'terraphi study real_soil' says."
)
OWN_PRIOR = "consistent; its interval rests on the prior that was given, and was not checked"
UNCHECKED_TOGETHER = (
    "consistent; nobody has checked how often intervals of several histories or parameters hold "
    "the truth"
)
PICTURES = "Fits, and the corner plot of the posterior"
UNKNOWN = "consistent, but whether its library's intervals were checked is not known here"
NO_BAND = "No band of the 95 % interval: the file is of an earlier version and does not hold it."
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

    Raises
    ------
    InputError
        If the result is not whole, or the library named is not the one that was used.
    """
    saved = load(path)
    answer = saved.answer
    if is_several(answer):
        return _of_several(path, answer)
    used = library_of(answer, library)
    parts: list[Part] = []
    if saved.draws_deg.size:
        parts += [_density(saved, used), *_forces(saved), _residuals(saved)]
    if saved.share is not None:
        parts.append(_information(saved, saved.share))
    parts += [_numbers(answer), *measures(answer)]
    if used is not None:
        parts += _certificate(answer, used)
    parts += [*_budget(answer), _convergence(answer)]
    status, badge = _belief(answer, used)
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


def is_several(answer: Mapping[str, Any]) -> bool:
    """Whether an answer is one of several histories or parameters."""
    return isinstance(answer.get("expected_sd"), Mapping)


def _of_several(path: Path, answer: Mapping[str, Any]) -> Section:
    """Report of several histories or parameters."""
    status = STATUS.get(str(answer["verdict"]), "none")
    sound = status == "good"
    about = {key: answer[key] for key in ("library", "likelihood", "sampler", "seed", "fixed")}
    table = replace(answers.parameters(answer, "Parameters"), wide=True)
    if not answer["converged"]:
        table = replace(table, note="The draws have not converged: do not use them.")
    found = [f"{name} = {median} (68 %: {ci68})" for name, median, ci68, *_ in table.rows]
    by_leg = replace(answers.expected(answer), title="What each leg alone would leave", wide=True)
    fixed = tuple(map(str, answer["identifiability"]["sentences"]))
    return Section(
        kind="inversion",
        title=", ".join(str(history["source"]) for history in answer["histories"]) or path.name,
        headline=f"{'; '.join(found)}. Verdict: {str(answer['verdict']).replace('_', ' ')}.",
        reason=str(answer["reason"]),
        status="doubtful" if sound else status,
        badge=UNCHECKED_TOGETHER if sound else "",
        parts=[
            table,
            *measures(answer),
            Text("What the forces tell of each parameter", fixed),
            *([by_leg] if len(by_leg.rows) > 2 else []),
            _histories(answer),
            *pictures(path if path.is_dir() else path.parent, PICTURES),
        ],
        provenance={"result": path.name, **about, **answer.get("provenance", {})},
    )


def _histories(answer: Mapping[str, Any]) -> Table:
    rows = [
        (str(h["source"]), str(h["leg"]), f"{h['nrmsd']['Fx']:.1%}", f"{h['nrmsd']['Fz']:.1%}")
        for h in answer["histories"]
    ]
    return Table("Histories, and deviation of the best curve", ("", "leg", "Fx", "Fz"), rows)


def _belief(answer: Mapping[str, Any], used: Library | None) -> tuple[Status, str]:
    """Status of an answer, and words for its badge where the usual ones would promise too much."""
    status = STATUS.get(str(answer["verdict"]), "none")
    if status != "good":
        return status, ""
    if _as_soils(answer):
        return status, ""
    if used is None:
        return "doubtful", UNKNOWN
    if str(answer["leg"]) not in used.certificate:
        return "doubtful", UNCHECKED
    if answer["likelihood"] != "calibrated":
        return "doubtful", OTHER_LIKELIHOOD
    if _has_own_prior(answer, used):
        return "doubtful", OWN_PRIOR
    return status, ""


def _as_soils(answer: Mapping[str, Any]) -> bool:
    """Whether measured forces were compared with how real soils deviate from the model."""
    return any(one.get("code") == "soil_deviation" for one in answer.get("measures", ()))


def _has_own_prior(answer: Mapping[str, Any], used: Library) -> bool:
    """Whether φ had another prior than the uniform one over the library."""
    prior = answer.get("parameters", {}).get(PHI, {}).get("prior")
    if prior is None:
        return False
    return prior["kind"] != "uniform" or (prior["low"], prior["high"]) != _bounds_deg(answer, used)


def _bounds_deg(answer: Mapping[str, Any], used: Library) -> tuple[float, float]:
    """Friction angles that a library covers with the leg of an answer [deg]."""
    low, *_, high = used.curves(str(answer["leg"])).phi_deg.tolist()
    return low, high


def _certificate(answer: Mapping[str, Any], library: Library) -> list[Part]:
    """The library's certificate, but for forces of which it says nothing."""
    leg = str(answer["leg"])
    if _as_soils(answer):
        return [Text("No certificate", (OF_SIMULATED,), wide=False)]
    if leg in library.certificate and _has_own_prior(answer, library):
        why = f"That of library {library.name} is of a uniform prior; this answer had another."
        return [Text("No certificate", (why,), wide=False)]
    if answer["verdict"] != "misfit" or leg not in library.certificate:
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
    """Whether the forces were ``measured`` or ``simulated``."""
    return "simulated" if "simulation" in answer.get("provenance", {}) else "measured"


def _median(angle: Mapping[str, Any]) -> str:
    return f"{angle['median']:.{decimals(angle['ci68'])}f}"


def _range(angle: Mapping[str, Any], level: str) -> str:
    """An interval, both levels with the digits that the narrower one deserves."""
    return f"{answers.between(angle[level], decimals(angle['ci68']))}°"


def _plain_verdict(answer: Mapping[str, Any]) -> str:
    without = answer.get("phi_plane_strain_reason")
    note = f" No equivalent in plane strain: {without}." if without else ""
    return f"{answer['reason']}{note}"


def _numbers(answer: Mapping[str, Any]) -> Table:
    misfit = " and ".join(f"{100.0 * answer['nrmsd'][f]:.1f} % ({f})" for f in ("Fx", "Fz"))
    density, leg = (
        ", assumed" if answer.get(f"{what}_assumed") else "" for what in ("density", "leg")
    )
    return replace(
        answers.parameters(answer, "In numbers"),
        note=(
            f"Leg {answer['leg']}{leg}, library {answer['library']}, density "
            f"{answer['density_kg_m3']:g} kg/m³{density}. The curve at the median deviates from "
            f"the {_origin(answer)} forces by {misfit} of their peak-to-peak."
        ),
    )


def measures(answer: Mapping[str, Any]) -> list[Part]:
    """The numbers that the verdict rests on."""
    told = [Measure(**one) for one in answer.get("measures", ())]
    title = "What the verdict rests on"
    return [Table(title, ("", "found", "limit"), rows_of(told), wide=True)] if told else []


def _density(saved: Saved, used: Library | None) -> Plot:
    phi = saved.answer["phi_deg"]
    bounds = None if used is None else _bounds_deg(saved.answer, used)
    x, density = smooth_density(saved.draws_deg, bounds=bounds)
    hover = f"φ = %{{x:.{decimals(phi['ci68'])}f}}°<extra></extra>"
    traces = [fig.line(x, density, "posterior density", "@blue", hovertemplate=hover)]
    for level, colour in (("ci95", "@blue/0.18"), ("ci68", "@blue/0.40")):
        low, high = phi[level]
        inside = np.linspace(low, high, 121)
        height = np.interp(inside, x, density)
        name = f"{level[2:]} %: {_range(phi, level)}"
        traces.append(fig.band(inside, np.zeros_like(inside), height, name, colour))
    margin = 0.5 * (phi["ci95"][1] - phi["ci95"][0])
    reach = [phi["ci95"][0] - margin, phi["ci95"][1] + margin]
    ends = [end for end in bounds or () if reach[0] <= end <= reach[1]]
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


def _forces(saved: Saved) -> list[Part]:
    half = len(saved.theta_deg)
    plots: list[Part] = []
    for name, part in (("Fx", slice(0, half)), ("Fz", slice(half, None))):
        traces = []
        if saved.band is not None:
            low, high = saved.band[:, part]
            within = "curves within the 95 % interval"
            traces.append(fig.band(saved.theta_deg, low, high, within, "@blue/0.3"))
        traces += [
            fig.line(saved.theta_deg, saved.best[part], "curve at the median", "@blue"),
            *_expected(saved, part),
            fig.points(saved.theta_deg, saved.data[part], _origin(saved.answer), "@orange"),
        ]
        deviation = 100.0 * saved.answer["nrmsd"][name]
        plots.append(
            Plot(
                title=f"{name}: deviation {deviation:.1f} % of peak-to-peak",
                traces=traces,
                layout=fig.layout(fig.THETA, fig.AXIS_LABEL[name], xaxis=fig.DEGREES),
                note="" if saved.band is not None else NO_BAND,
            )
        )
    return plots


def _expected(saved: Saved, part: slice) -> list[dict[str, Any]]:
    if saved.expected is None:
        return []
    name = "with the mean deviation of real soils"
    return [fig.line(saved.theta_deg, saved.expected[part], name, "@purple", dash="dash")]


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
    """Parts of the uncertainty of φ, where the likelihood tells them apart."""
    budget = answer.get("error_budget") or {}
    degrees, shares = budget.get("degrees"), budget.get("shares")
    if not degrees or not shares:
        return []
    rows = [
        (name.replace("_", " "), number(sd, 2), f"{shares[name]:.0%}")
        for name, sd in sorted(degrees.items(), key=lambda one: -one[1])
    ]
    size, told = budget.get("noise_N"), budget.get("noise")
    note = f"Noise of a window mean: {number(size, 2)} N, {told}." if _is_number(size) else ""
    title = "What the width of the interval comes from"
    header = ("", "standard deviation of φ [deg]", "share of the variance")
    return [Table(title, header, rows, note=note, wide=True)]


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and math.isfinite(value)


def _convergence(answer: Mapping[str, Any]) -> Table:
    rows = [(WORDS.get(key, key), number(value)) for key, value in answer["convergence"].items()]
    title = f"Convergence ({answer['sampler']})"
    return Table(title=title, header=("", ""), rows=rows, wide=True)


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
    share
        What each angle adds to the information on φ [-], shape [2, theta], if the file says so.
    band
        Least and largest force of the curves within the 95 % interval [N], shape [2, 2 theta], if
        the file says so.
    expected
        The curve with the mean deviation of real soils [N], shape [2 theta], if the file says so.
    """

    answer: Mapping[str, Any]
    draws_deg: FloatArray = field(default_factory=lambda: np.empty(0))
    theta_deg: FloatArray = field(default_factory=lambda: np.empty(0))
    data: FloatArray = field(default_factory=lambda: np.empty(0))
    best: FloatArray = field(default_factory=lambda: np.empty(0))
    share: FloatArray | None = None
    band: FloatArray | None = None
    expected: FloatArray | None = None


def load(path: Path) -> Saved:
    """Read an inversion's folder, answer or posterior; raises InputError if it is not whole."""
    folder = path if path.is_dir() else path.parent
    answer_file = path if path.suffix == ".json" else folder / "answer.json"
    posterior = path if path.suffix == ".nc" else folder / "posterior.nc"
    several = path.suffix != ".nc" and answer_file.is_file() and is_several(_answer(answer_file))
    if several or not posterior.is_file():
        return Saved(_answer(answer_file))
    import xarray as xr

    why = f"{posterior}: not a whole posterior as 'terraphi invert --out' writes it; make it again"
    with damage_told(why, AttributeError, TypeError):
        with xr.open_datatree(posterior, engine="h5netcdf") as opened:
            tree = opened.load()
        answer = _parsed(tree.attrs["answer"])
        if is_several(answer):
            return Saved(answer)
        data, best = _both(tree, "observed_data"), _both(tree, "posterior_predictive_mean")
        theta = _array(tree, "observed_data/theta_deg")
        draws = _array(tree, "posterior/phi_deg")
        share = band = expected = None
        if "information_share" in tree:
            share = _both(tree, "information_share").reshape(2, -1)
        if "with_mean_deviation" in tree:
            expected = _both(tree, "with_mean_deviation")
        if "curves_within_ci95" in tree:
            ends = [_array(tree, f"curves_within_ci95/{name}") for name in ("Fx", "Fz")]
            band = np.hstack([part.reshape(2, -1) for part in ends])
    shapes = {(2, len(theta)): share, (2, 2 * len(theta)): band, data.shape: expected}
    sound = len(data) == len(best) == 2 * len(theta) and len(draws) >= 10
    sound = sound and all(part is None or part.shape == shape for shape, part in shapes.items())
    told = [part for part in (data, best, theta, draws, share, band, expected) if part is not None]
    if not sound or not all(np.isfinite(part).all() for part in told):
        raise InputError(f"{posterior}: its arrays do not fit each other; make it again")
    return Saved(answer, draws, theta, data, best, share, band, expected)


def _both(tree: Any, group: str) -> FloatArray:
    return np.concatenate([_array(tree, f"{group}/{name}") for name in ("Fx", "Fz")])


def _array(tree: Any, name: str) -> FloatArray:
    return np.asarray(tree[name].values, dtype=np.float64).ravel()


def _answer(path: Path) -> dict[str, Any]:
    why = f"{path}: not an answer of 'terraphi invert --out'; make it again"
    try:
        found = _parsed(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(why) from error
    if not isinstance(found, dict) or not {"phi_deg", "verdict", "reason"} <= found.keys():
        raise InputError(why)
    return found


def _parsed(text: str) -> Any:
    """JSON without NaN and infinities; raises ValueError if there are any."""

    def no_number(name: str) -> None:
        raise ValueError(f"{name} is no number")

    return json.loads(text, parse_constant=no_number)


def library_of(answer: Mapping[str, Any], name: str | None) -> Library | None:
    """The library that was used, or None if it is not at hand.

    Parameters
    ----------
    answer
        The inversion's.
    name
        Name or file of the library; by default the shipped one of the name in the answer.

    Raises
    ------
    InputError
        If a library was named and is not the one that was used.
    """
    used = str(answer["library"])
    try:
        # Never a path out of somebody's file.
        found = Library.load(name or Path(used).name.removesuffix(".nc"))
    except InputError:
        if name is not None:
            raise
        return None
    if answer.get("provenance", {}).get("library_hash") == found.hash:
        return found
    if name is not None:
        raise InputError(f"library '{name}' is not the one that was used, or of another version")
    return None
