"""Every number of the paper next to ours: by the model of its text, and by the contact of its code.

Library ``paper`` is simulated as the paper's text has it, ``paper-code`` with the contact of its
public prototype, which the text does not describe. Forces are means over 1° of leg angle within
|θ| < 85°, φ is that of the paper's yield criterion. Arrays of two are (F_z, F_x), as in the paper.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib.resources import files
from typing import Any, NamedTuple

import h5netcdf
import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.history import WINDOW_DEG, ForceHistory
from terraphi.experiment.measurements import measurement
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.soil import Soil
from terraphi.forward import simulate
from terraphi.laws.store import Library
from terraphi.paper import figures as draw
from terraphi.paper import likelihood as paper
from terraphi.paper.gaussian_process import Surrogate
from terraphi.paper.likelihood import BURN_IN, Posterior

TEXT, CODE = "paper", "paper-code"
"""Libraries: the model of the paper's text, and of its public code."""
FORCES = ("Fz", "Fx")
PHI_DEG = 35.0
"""Friction angle of the benchmark [deg]."""

# What Xu & Wang print.
PEAKS_N = {25.0: (8.6, 10.2), 45.0: (14.0, 15.5)}
NRMSD_MPM = {"straight": (24.8, 14.9), "c": (17.6, 15.0), "reversed_c": (18.7, 14.9)}
NRMSD_RFT = {"straight": (11.5, 3.5), "c": (23.7, 16.5), "reversed_c": (188.7, 75.9)}
PRINTED = {"mpm": NRMSD_MPM, "paper_code": NRMSD_MPM, "rft2d": NRMSD_RFT}
WALKERS_DEG = 33.97
"""The truth whose walkers the paper shows [deg]."""
RECOVERED = (
    ("median error", "{abs_error_deg[median]:.2f}°", "0.09°"),
    ("largest error", "{abs_error_deg[max]:.2f}°", "0.73°"),
    ("median 68 % half-width", "{ci68_half_width_deg[median]:.2f}°", "1.34°"),
    ("largest 68 % half-width", "{ci68_half_width_deg[max]:.2f}°", "1.93°"),
    ("truths inside their 68 % interval", "{inside68} of 14", "14 of 14"),
)

# Limits of ours.
EDGE_MASS = 0.05
"""Largest mass of a posterior within half a step of the library from one of its ends [-]."""
NRMSD_LIMIT = 0.10
"""Largest deviation from the curve at the median, of peak-to-peak [-]."""
ENGAGED = 0.02
"""|F| over the peak of F_z above which the leg counts as engaged [-]."""
LEAST_TOLERANCE, SCATTERS = 2.0, 2.0
"""Changes below 2 %, or below twice the scatter between seeds, count as none."""

Json = dict[str, Any]
Progress = Callable[[float], None]
"""Called with the share of the work that is done, 0 to 1."""


@dataclass(frozen=True)
class Result:
    """One of the paper's results, ours.

    Attributes
    ----------
    data
        JSON-able, of fixed keys; :func:`run` adds all else but the figures.
    table
        Records, and which of their keys have a column, dotted where they are nested.
    notes
        Sentences.
    compared
        Quantity, ours, and that of Xu & Wang.
    figures
        Name to a function that draws it.
    """

    data: Json
    table: tuple[Sequence[Json], str]
    notes: Sequence[str] = ()
    compared: Sequence[tuple[str, str, str]] = ()
    figures: Mapping[str, Callable[[], Any]] = field(default_factory=dict)


def as_table(title: str, records: Iterable[Json], columns: str) -> Json:
    """Title, header, and a row for each record."""

    def cell(record: Json, path: str) -> str:
        value: Any = functools.reduce(operator.getitem, path.split("."), record)
        numbers = [value] if isinstance(value, float) else value
        return " to ".join(f"{x:.4g}" for x in numbers) if isinstance(numbers, list) else str(value)

    header = columns.split()
    rows = [[cell(record, path) for path in header] for record in records]
    return {"title": title, "header": header, "rows": rows}


# -- simulations and measures ----------------------------------------------------------------------


class Case(NamedTuple):
    """A simulation: its settings, and its forces."""

    about: Json
    history: ForceHistory
    applied: ForceHistory | None = None
    """Forces that the code's contact applied to the soil; ``history`` has those that it counted."""

    @property
    def phi_deg(self) -> float:
        """Friction angle [deg]."""
        return float(self.about["phi_deg"])


@cache
def library_cases(name: str) -> tuple[Case, ...]:
    """Cases of the straight leg in library ``paper`` or ``paper-code``."""
    cases = []
    for case in Library.load(name).cases:
        soil, history = case.scenario.soil, case.history
        assert history is not None
        about = {"phi_deg": soil.friction_angle_deg, "leg": case.scenario.leg.shape}
        about |= {"speed_up": case.scenario.numerics.speed_up}
        cases.append(Case(about, history, history.applied()))
    return tuple(cases)


@cache
def read(name: str) -> tuple[tuple[Case, ...], list[Json]]:
    """Cases of ``data/paper/NAME.nc``, and how they are grouped."""
    with h5netcdf.File(str(files("terraphi") / "data" / "paper" / f"{name}.nc"), "r") as file:
        values = {key: np.asarray(v[...], dtype=np.float64) for key, v in file.variables.items()}
        cases, groups = (json.loads(file.attrs.get(key, "[]")) for key in ("cases", "groups"))
    parsed = []
    for about, force, applied in zip(cases, values["force"], values["applied"], strict=True):
        missing = bool(np.isnan(applied).any())
        applied_history = None if missing else ForceHistory(values["theta_applied"], applied)
        parsed.append(Case(about, ForceHistory(values["theta"], force), applied_history))
    return tuple(parsed), groups


def means(history: ForceHistory) -> FloatArray:
    """Means over 1° [N] at whole degrees within |θ| < 85°, shape [theta, 2]."""
    degrees = np.arange(-WINDOW_DEG + 1.0, WINDOW_DEG)
    return history.means(np.radians(degrees), math.radians(0.5))[:, ::-1]


def nrmsd_percent(reference: ForceHistory, other: ForceHistory) -> FloatArray:
    """The paper's NRMSD: root mean square deviation over the reference's peak-to-peak [%]."""
    data = means(reference)
    return 100.0 * rms(means(other) - data, 0) / np.ptp(data, axis=0)


def peaks_N(history: ForceHistory) -> FloatArray:
    """Largest forces [N]."""
    top = history.peaks()
    return np.array([top.Fz, top.Fx])


def peaks_and_angles(history: ForceHistory) -> dict[str, float]:
    """Largest forces [N] and their leg angles [deg]."""
    top = history.peaks()
    angles = {"theta_Fz_deg": top.theta_Fz_deg, "theta_Fx_deg": top.theta_Fx_deg}
    return {"Fz_N": top.Fz, "Fx_N": top.Fx, **angles}


PEAKS = "peaks.Fz_N peaks.theta_Fz_deg peaks.Fx_N peaks.theta_Fx_deg"
"""Columns of peaks in a table."""


def engagement_deg(history: ForceHistory) -> float:
    """Leg angle from which on |F| stays above 2 % of the peak of F_z for 5° [deg]."""
    theta, size = history.theta_deg, np.hypot(history.Fx, history.Fz)
    span = max(1, round(5.0 / float(np.median(np.diff(theta)))))
    engaged = size > ENGAGED * history.peaks().Fz
    stays = np.lib.stride_tricks.sliding_window_view(engaged, span).all(axis=1)
    return float(theta[stays.argmax()]) if stays.any() else math.nan


def rms(values: ArrayLike, axis: int | tuple[int, ...] | None = None) -> FloatArray:
    """Root mean square."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=axis)))


def by_force(values: Iterable[Any]) -> Json:
    """(F_z, F_x) as JSON has them."""
    return dict(zip(FORCES, (None if v is None else float(v) for v in values), strict=True))


def force_pair(values: Iterable[float], unit: str, digits: str = ".1f") -> str:
    """(F_z, F_x) as text, such as ``8.6 / 10.2 N``."""
    return " / ".join(f"{value:{digits}}" for value in values) + unit


def compared_forces(
    tops_N: Mapping[float, Iterable[float]], engages_deg: Sequence[float]
) -> list[tuple[str, str, str]]:
    """Peaks by φ [deg] and the angle of first resistance [deg] next to the paper's."""
    peaks = [
        (f"peaks Fz / Fx at {phi:g}°", force_pair(tops_N[phi], " N"), force_pair(printed, " N"))
        for phi, printed in PEAKS_N.items()
    ]
    first = "leg angle of first resistance (ours: median)"
    return [*peaks, (first, f"{np.median(engages_deg):.0f}°", "about -85°")]


# -- inversion -------------------------------------------------------------------------------------


@cache
def surrogate_of(library: str) -> Surrogate:
    """The two Gaussian processes, fitted to a library."""
    cases = library_cases(library)
    observations = [paper.observe(case.history) for case in cases]
    vectors = np.stack([observation.vector for observation in observations])
    return Surrogate.fit([case.phi_deg for case in cases], observations[0].theta_deg, vectors)


class HeldOut(NamedTuple):
    """The fourteen truths: off the library's grid, and with other particle seeds."""

    phi_deg: FloatArray
    data: FloatArray
    """d [N], shape [truth, 2 theta]."""
    mean: FloatArray
    """Mean of the surrogate [N], same shape."""
    residuals: FloatArray
    """Residuals of F_x, then F_z, over each curve's peak-to-peak [-], shape [2, truth, theta]."""


@cache
def held_out(library: str) -> HeldOut:
    """The truths of a library, and its surrogate there."""
    truths, _ = read(f"{library}-truths")
    phi = np.array([truth.phi_deg for truth in truths])
    data = np.stack([paper.observe(truth.history).vector for truth in truths])
    mean = surrogate_of(library).mean(phi)
    span = np.ptp(np.stack(np.hsplit(data, 2)), axis=2, keepdims=True)
    return HeldOut(phi, data, mean, np.stack(np.hsplit(data - mean, 2)) / span)


@cache
def posteriors(library: str) -> list[Posterior]:
    """Posteriors of the truths of a library, by quadrature."""
    fitted = surrogate_of(library)
    phi = np.linspace(*fitted.phi_bounds_deg, paper.NODES)
    curves, theta = fitted.mean(phi), fitted.Fx.theta_deg
    likelihoods = (paper.Likelihood(data, theta)(curves) for data in held_out(library).data)
    return [Posterior.by_quadrature(phi, log_p) for log_p in likelihoods]


def verdict(exact: Posterior, data: FloatArray, fitted: Surrogate) -> str:
    """Verdict on an answer: ``consistent``, ``misfit`` or ``out_of_range``."""
    low, high = fitted.phi_bounds_deg
    margin = 0.5 * float(np.diff(fitted.Fx.phi_deg).max())
    if max(exact.mass(low, low + margin), exact.mass(high - margin, high)) > EDGE_MASS:
        return "out_of_range"
    residual = (fitted.mean(exact.median) - data).reshape(2, -1)
    nrmsd = rms(residual, 1) / np.ptp(data.reshape(2, -1), axis=1)
    return "misfit" if nrmsd.max() > NRMSD_LIMIT else "consistent"


def recovery(
    library: str = TEXT, *, draws: bool = True, progress: Progress = lambda _: None
) -> Result:
    """Fourteen friction angles of fresh simulations, inferred by quadrature and by emcee."""
    fitted, truths = surrogate_of(library), held_out(library)
    cases: list[Json] = []
    figures = {"recovery": partial(draw.recovery, cases)}
    truth_cases = zip(truths.phi_deg.tolist(), truths.data, posteriors(library), strict=True)
    for phi, data, exact in truth_cases:
        case = {"phi_true_deg": phi, "phi_median_deg": exact.median}
        case |= {"ci68": exact.interval(0.68), "ci95": exact.interval(0.95)}
        case["verdict"] = verdict(exact, data, fitted)
        if draws:
            chains = paper.sample(exact)
            case |= by_emcee(chains[:, :, BURN_IN:], exact.median)
            if phi == WALKERS_DEG:
                figures["walkers"] = partial(draw.walkers, chains[0], phi, exact, BURN_IN)
        cases.append(case)
        progress(len(cases) / len(truths.data))
    low, high = np.transpose([[case["ci68"], case["ci95"]] for case in cases])
    inside = ((low <= truths.phi_deg) & (truths.phi_deg <= high)).sum(axis=1).tolist()
    summary: Json = dict(zip(("inside68", "inside95"), inside, strict=True))
    off = np.abs([case["phi_median_deg"] - case["phi_true_deg"] for case in cases])
    for name, values in (("abs_error", off), ("ci68_half_width", 0.5 * (high - low)[0])):
        summary[f"{name}_deg"] = {"median": float(np.median(values)), "max": float(values.max())}
    notes = []
    if draws:
        rhat, errors = (max(c[k] for c in cases) for k in ("emcee_rhat", "medians_apart_in_errors"))
        notes = [
            f"emcee: split-R̂ <= {rhat:.4f}, medians {errors:.1f} Monte Carlo errors off or less."
        ]
    return Result(
        {"library": library, "yield": "paper", **summary, "cases": cases},
        (cases, "phi_true_deg phi_median_deg ci68 ci95 verdict"),
        notes,
        [(what, ours.format_map(summary), printed) for what, ours, printed in RECOVERED],
        figures,
    )


def by_emcee(draws: FloatArray, exact_deg: float) -> Json:
    """Median, interval and convergence by emcee, next to the exact median."""
    median, error = float(np.median(draws)), paper.median_standard_error(draws)
    return {
        "emcee_median_deg": median,
        "emcee_median_error_deg": error,
        "emcee_ci68": np.quantile(draws, [0.16, 0.84]).tolist(),
        "emcee_rhat": paper.split_rhat(draws),
        "emcee_autocorrelation_steps": float(paper.autocorrelation_time(draws).max()),
        "medians_apart_in_errors": abs(median - exact_deg) / error,
    }


def surrogate(library: str = TEXT) -> Result:
    """The surrogate on cases held out: its errors, and their correlation length."""
    fitted, truths = surrogate_of(library), held_out(library)
    theta, processes = fitted.Fx.theta_deg, fitted._asdict()
    residuals = truths.residuals.reshape(-1, theta.size)
    length = paper.residual_correlation_length_deg(theta, residuals)
    places = [int(np.abs(theta - angle).argmin()) for angle in (-50.0, -25.0, 0.0)]
    errors: list[Json] = []
    for (force, shift), i in itertools.product((("Fx", 0), ("Fz", theta.size)), places):
        at = (slice(None), i + shift)
        off = 100.0 * np.abs(truths.mean[at] / truths.data[at] - 1.0)
        spread = {"median": float(np.median(off)), "max": float(off.max())}
        where = {"force": force, "theta_deg": float(theta[i])}
        errors.append({**where, "relative_error_percent": spread})
    parameters = {}
    for force, process in processes.items():
        _, phi_length, theta_length, _ = process.hyperparameters
        lengths = {"phi_length_deg": phi_length, "theta_length_deg": theta_length}
        parameters[force] = {**lengths, "noise_N": math.sqrt(process.noise_variance)}
    fx, fz = (100.0 * rms(truths.residuals, (1, 2))).tolist()
    vectors = np.stack([paper.observe(case.history).vector for case in library_cases(library)])
    points = {"library": (fitted.Fx.phi_deg, vectors), "held out": (truths.phi_deg, truths.data)}
    lags, rho = paper.residual_autocorrelation(theta, residuals)
    return Result(
        {
            "library": library,
            "yield": "paper",
            "parameters": parameters,
            "held_out": {"phi_deg": truths.phi_deg.tolist(), "angles": errors},
            "nrmsd_percent": {"Fx": fx, "Fz": fz},
            "correlation_length_deg": length,
        },
        (errors, "force theta_deg relative_error_percent.median relative_error_percent.max"),
        [
            f"Held-out forces deviate by {fx:.2f} % (Fx) and {fz:.2f} % (Fz) of peak-to-peak.",
            f"Leg angles {lags[1]:.1f}° apart can show no length below {lags[1] / 3.0:.1f}°.",
        ],
        [("correlation length of the residuals", f"{length:.1f}°", "about 6°")],
        {
            "surrogate-surfaces": partial(draw.surfaces, fitted, truths.phi_deg),
            "surrogate-slices": partial(draw.slices, fitted, points, places),
            "residuals": partial(draw.residuals, lags, rho, length),
        },
    )


# -- forces ----------------------------------------------------------------------------------------


def phi_sensitivity(library: str = TEXT) -> Result:
    """Forces on the straight leg and their peaks over the friction angle."""
    by_phi = {case.phi_deg: case.history for case in library_cases(library)}
    records: list[Json] = [{"phi_deg": p, "peaks": peaks_and_angles(h)} for p, h in by_phi.items()]
    observations = [paper.observe(history) for history in by_phi.values()]
    data: Json = {"library": library, "yield": "paper", "phi_deg": list(by_phi)}
    data |= {"peaks_increase": {}, "share_of_angles_monotone": {}}
    for force in FORCES:
        data[f"peak_{force}_N"] = tops = [row["peaks"][f"{force}_N"] for row in records]
        data[f"theta_peak_{force}_deg"] = [row["peaks"][f"theta_{force}_deg"] for row in records]
        data["peaks_increase"][force] = bool(np.all(np.diff(tops) > 0.0))
        signs = np.sign(np.diff([getattr(row, force) for row in observations], axis=0))
        monotone = np.abs(signs.sum(axis=0)) == len(signs)
        data["share_of_angles_monotone"][force] = float(np.mean(monotone))
    data["theta_engages_deg"] = [engagement_deg(history) for history in by_phi.values()]
    angles = [float(np.median(data[f"theta_peak_{force}_deg"])) for force in FORCES]
    compared = compared_forces({p: peaks_N(by_phi[p]) for p in PEAKS_N}, data["theta_engages_deg"])
    shares = data["share_of_angles_monotone"].values()
    what = "leg angle of the peaks Fz / Fx (ours: median)"
    compared.insert(2, (what, force_pair(angles, "°", ".0f"), "about -50 / 0°"))
    return Result(
        data,
        (records, f"phi_deg {PEAKS}"),
        [f"Fz / Fx are monotone in φ at {force_pair(shares, '', '.0%')} of the leg angles."],
        compared,
        {
            "forces-phi": partial(draw.histories, by_phi),
            "peaks-phi": partial(draw.peaks, data, PEAKS_N),
        },
    )


def forces_in_yuma(leg: str) -> dict[str, ForceHistory]:
    """Forces on a leg at 35° and 1650 kg/m³: measured in Yuma sand, and of each model.

    RFT 2-D is Li et al. (2013), generic coefficients times ζ = 0.597, which reproduces their curves
    for Yuma sand; RFT 3-D is Agarwal et al. (2023).
    """
    models = {"measured": measurement(f"li2013:yuma/{leg}").history}
    soil = {"friction_angle_deg": PHI_DEG, "density": 1650.0}
    law = {"model": "rft", "soil": soil, "rft": {"medium": "generic", "scale": 0.597}}
    for dimensions in (2, 3):
        rft = {**law, "leg": {"shape": leg}, "dimensions": dimensions}
        models[f"rft{dimensions}d"] = simulate(Scenario.model_validate(rft))
    for library, model in ((TEXT, "mpm"), (CODE, "paper_code")):
        cases = (*library_cases(library), *read(f"{library}-legs")[0])
        case = next(c for c in cases if (c.about["leg"], c.phi_deg) == (leg, PHI_DEG))
        models[model] = case.history
        if case.applied is not None:
            # They are kept by the degree; lines between them give windows at every degree.
            theta, by_degree = case.history.position, case.applied
            lines = [np.interp(theta, by_degree.position, force) for force in by_degree.force.T]
            models[f"{model}_applied"] = replace(case.history, force=np.stack(lines, axis=1))
    return models


def benchmark() -> Result:
    """Three legs at 35°: our models, and two resistive force theories, against Yuma sand."""
    by_leg = {leg: forces_in_yuma(leg) for leg in NRMSD_MPM}
    data: Json = {"library": TEXT, "phi_deg": PHI_DEG, "yield": "paper"}
    data |= {"nrmsd_percent": {leg: {} for leg in by_leg}, "peaks": {leg: {} for leg in by_leg}}
    records = []
    for leg, models in by_leg.items():
        for model, history in models.items():
            data["peaks"][leg][model] = peaks = peaks_and_angles(history)
            nrmsd = by_force(nrmsd_percent(models["measured"], history))
            if model != "measured":
                data["nrmsd_percent"][leg][model] = nrmsd
            records.append({"leg": leg, "model": model, "nrmsd_percent": nrmsd, "peaks": peaks})
    compared = []
    for leg, (model, printed) in itertools.product(by_leg, PRINTED.items()):
        ours = force_pair(data["nrmsd_percent"][leg][model].values(), " %")
        what = f"leg {leg}, {model}: NRMSD Fz / Fx"
        compared.append((what, ours, force_pair(printed[leg], " %")))
    return Result(
        data,
        (records, f"leg model nrmsd_percent.Fz nrmsd_percent.Fx {PEAKS}"),
        ["The φ of rft3d is the parameter of an empirical law; library 'rft3d' fits it."],
        compared,
        {"legs": partial(draw.legs, by_leg)},
    )


def k0(library: str = TEXT) -> Result:
    """What K0 = 0.5 in place of 1 - sin φ changes in a history."""
    name = "k0" if library == TEXT else f"{library}-k0"
    pairs, _ = read(name)
    half = len(pairs) // 2
    cases: list[Json] = []
    for jaky, other in zip(pairs[:half], pairs[half:], strict=True):
        old, new = means(jaky.history), means(other.history)
        change = by_force(np.abs(new - old).max(axis=0) / np.abs(old).max(axis=0))
        at_rest = 1.0 - math.sin(math.radians(jaky.phi_deg))
        cases.append({"phi_deg": jaky.phi_deg, "k0_jaky": at_rest, "relative_change": change})
    largest = max(max(case["relative_change"].values()) for case in cases)
    beyond = sum(yields(c["phi_deg"], c["k0_jaky"]) and yields(c["phi_deg"], 0.5) for c in cases)
    note = "angles both stresses at rest lie beyond the yield surface, to which the first step"
    return Result(
        {"library": name, "yield": "paper", "max_relative_change": largest, "cases": cases},
        (cases, "phi_deg k0_jaky relative_change.Fz relative_change.Fx"),
        [f"At {beyond} of {len(cases)} {note} returns them."],
        [("largest change of a history", f"{100.0 * largest:.2f} %", "below 0.5 %")],
    )


def yields(phi_deg: float, k0_at_rest: float) -> bool:
    """True if σ and K0 σ lie beyond the paper's yield surface: |1 - K0| / (1 + K0) > sin φ_eff."""
    soil = Soil(friction_angle_deg=phi_deg, yield_criterion="paper")
    sine = math.sin(math.radians(soil.plane_strain_friction_angle_deg))
    return abs(1.0 - k0_at_rest) / (1.0 + k0_at_rest) > sine


# -- numerics --------------------------------------------------------------------------------------


def scatter_percent(runs: Sequence[ForceHistory], base_N: FloatArray) -> dict[str, FloatArray]:
    """Root mean square over pairs of runs: of their NRMSD, and of peaks over the base's [%]."""
    pairs = list(itertools.combinations(runs, 2))
    tops = [100.0 * (peaks_N(b) - peaks_N(a)) / base_N for a, b in pairs]
    return {"nrmsd": rms([nrmsd_percent(*pair) for pair in pairs], 0), "peak": rms(tops, 0)}


def sensitivity() -> Result:
    """What moves the simulated forces: preset paper-1 at k = 4, one setting changed at a time.

    A group is compared with its finest value where there is one, else with the base.
    """
    cases, groups = read("sensitivity")
    seeds = next(group for group in groups if group["key"] == "numerics.seed")
    base = cases[seeds["cases"][seeds["base"]]]
    base_N, runs = peaks_N(base.history), [cases[i].history for i in seeds["cases"]]
    scatter = scatter_percent(runs, base_N)
    tolerance = {
        k: np.maximum(LEAST_TOLERANCE, SCATTERS * percent) for k, percent in scatter.items()
    }
    data: Json = {
        "plan": "sensitivity",
        "base": {**base.about, "peaks": peaks_and_angles(base.history)},
        "scatter_percent": {"seeds": len(runs), **{k: by_force(v) for k, v in scatter.items()}},
        "tolerance_percent": {k: by_force(v) for k, v in tolerance.items()},
        "groups": {},
    }
    rows, moved = [], []
    for group in groups:
        reference = cases[group["cases"][group["reference"]]]
        tops = np.stack([peaks_N(cases[i].history) for i in group["cases"]])
        lines: list[Json] = []
        for value, i, top in zip(group["values"], group["cases"], tops, strict=True):
            nrmsd = nrmsd_percent(reference.history, cases[i].history)
            change = 100.0 * (top / peaks_N(reference.history) - 1.0)
            moves = np.any([nrmsd > tolerance["nrmsd"], np.abs(change) > tolerance["peak"]])
            line = {"value": value, **cases[i].about, "moves": bool(moves)}
            line["peaks"] = peaks_and_angles(cases[i].history)
            line["peak_change_percent"] = by_force(100.0 * (top / base_N - 1.0))
            line["change_from_reference_percent"] = by_force(change)
            line["nrmsd_percent"] = None if cases[i] is reference else by_force(nrmsd)
            lines.append(line)
            moved += [f"{group['setting']} {value}"] if moves else []
            rows.append({**line, "setting": group["setting"], "nrmsd": by_force(nrmsd)})
        about = {"setting": group["setting"], "reference": group["values"][group["reference"]]}
        data["groups"][group["key"]] = {**about, "cases": lines}
    least = [force_pair(tolerance[key], " %") for key in ("nrmsd", "peak")]
    limits = f"{least[0]} (NRMSD) or {least[1]} (peaks)"
    return Result(
        data,
        (rows, f"setting value nrmsd.Fz nrmsd.Fx {PEAKS} moves"),
        [
            f"A case moves the forces if it is more than {limits} away.",
            f"The forces are moved by: {', '.join(moved)}.",
        ],
    )


def prototype() -> Result:
    """What the contact of the paper's code counts, and what it applies to the soil.

    It counts momentum that it gives back along the tangent: the counted force is not the applied
    one, and grows with the speed k.
    """
    order = ["its text", "its code", ""]
    text = {case.phi_deg: case for case in library_cases(TEXT)}
    cases = [counted_and_applied(case) for case in read("prototype")[0]]
    for phi in PEAKS_N:
        about = {**text[phi].about, "name": f"{phi:g}°, its text", "model": "its text"}
        cases.append(counted_and_applied(text[phi]._replace(about=about)))
    cases.sort(key=lambda c: (c["phi_deg"], order.index(c["model"]), c["speed_up"]))
    code = [case for case in cases if (case["model"], case["speed_up"]) == ("its code", 1.0)]
    tops = {case["phi_deg"]: case["counted_peaks_N"].values() for case in code}
    return Result(
        {"cases": cases},
        (cases, "name counted_peaks_N.Fz counted_peaks_N.Fx share_of_peaks.Fz share_of_peaks.Fx"),
        compared=compared_forces(tops, [case["engagement_deg"] for case in code]),
    )


def counted_and_applied(case: Case) -> Json:
    """Peaks that a case counted and applied: the same, unless its contact kept what it applied."""
    history, counted = case.history, peaks_N(case.history)
    applied = counted if case.applied is None else case.applied.force.max(axis=0)[::-1]
    ends = history.position[[0, -1]]
    path = history.means(ends.mean(keepdims=True), float(np.ptp(ends)) / 2.0)[0]
    share = (case.applied or history).force.mean(axis=0) / path
    return {
        **{key: case.about[key] for key in ("name", "model", "phi_deg", "speed_up")},
        "counted_peaks_N": by_force(counted),
        "applied_peaks_N": by_force(applied),
        "share_of_peaks": by_force(applied / counted),
        "share_of_path": by_force(share[::-1]),
        "engagement_deg": engagement_deg(history),
    }


# -- all of them -----------------------------------------------------------------------------------


def figures(*, progress: Progress = lambda _: None) -> Result:
    """The figures of the paper's simulations and inversions; the snapshots take ten minutes."""
    parts = {name: run(name) for name in ("phi_sensitivity", "benchmark", "surrogate", "recovery")}
    described = ("study", "about")
    data = {n: {k: v for k, v in p.data.items() if k not in described} for n, p in parts.items()}
    drawn = {name: made for part in parts.values() for name, made in part.figures.items()}
    library = Library.load(TEXT).cases
    straight = next(c.scenario for c in library if c.scenario.soil.friction_angle_deg == PHI_DEG)
    drawn["snapshots"] = partial(draw.snapshots, draw.soil_around(straight, NRMSD_MPM, progress))
    return Result(
        {"library": TEXT, **data},
        ([{"figure": f"{name}.png"} for name in drawn], "figure"),
        [note for part in parts.values() for note in part.notes],
        [line for part in parts.values() for line in part.compared],
        drawn,
    )


_ALL = (recovery, benchmark, sensitivity, phi_sensitivity, k0, prototype, surrogate)
RESULTS: dict[str, Callable[..., Result]] = {made.__name__: made for made in (*_ALL, figures)}
BY_LIBRARY = ("recovery", "phi_sensitivity", "k0", "surrogate")
"""Results of either library."""


def run(name: str, *, library: str = TEXT, progress: Progress = lambda _: None) -> Result:
    """One of :data:`RESULTS`; those of :data:`BY_LIBRARY` by ``paper-code`` too.

    Raises
    ------
    InputError
        If there is no such result, or not by that library.
    """
    if name not in RESULTS:
        raise InputError(f"unknown result '{name}'; {nearest(name, list(RESULTS))}")
    libraries = (TEXT, CODE) if name in BY_LIBRARY else (TEXT,)
    if library not in libraries:
        raise InputError(f"library '{library}': {name} has {' and '.join(libraries)}")
    options: Json = {"library": library} if len(libraries) > 1 else {}
    options |= {"progress": progress} if name in ("recovery", "figures") else {}
    result = RESULTS[name](**options)
    about = (RESULTS[name].__doc__ or "").partition("\n")[0]
    compared = [
        {"what": what, "ours": ours, "paper": paper} for what, ours, paper in result.compared
    ]
    more = {
        "notes": result.notes,
        "beside_paper": compared,
        "table": as_table(about, *result.table),
    }
    result.data.update({"study": name, "about": about, **{k: v for k, v in more.items() if v}})
    return result


def number_by_number(progress: Progress = lambda _: None) -> tuple[dict[str, Result], Json]:
    """All results but the figures; and all that the paper prints, next to both models."""
    results = {name: run(name, progress=progress) for name in RESULTS if name != "figures"}
    code = [recovery(CODE, draws=False), *(RESULTS[name](CODE) for name in BY_LIBRARY[1:])]
    ours = {what: value for result in code for what, value, _ in result.compared}
    lines = [
        line for name, result in results.items() if name != "prototype" for line in result.compared
    ]
    rows = [
        {"quantity": what, "paper": printed, "text": text, "code": ours.get(what, "")}
        for what, text, printed in lines
    ]
    return results, as_table("The paper, number by number", rows, "quantity paper text code")
