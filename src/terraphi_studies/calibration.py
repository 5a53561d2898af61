"""Calibration: whether intervals hold the truth as often as they say, and how narrow they are.

Simulation-based calibration in thousands of simulated worlds, each with a truth and a library of
its own, and in worlds unlike the prior; coverage through the one shipped library; its truths, as
they are and made worse; histories that the model must not explain.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, names
from terraphi.inference.answer import Inversion
from terraphi.inference.calibrated import CalibratedLikelihood, Problem
from terraphi.inference.coverage import (
    WORLDS,
    Coverage,
    calibrate,
    expected_of,
    learnt_anew,
    of_observations,
    one_world,
    through_one_library,
)
from terraphi.inference.fit import fit_without_discrepancy
from terraphi.inference.friction_angle import NODES
from terraphi.inference.inversion import invert
from terraphi.inference.posterior import quadrature
from terraphi.inference.prepared_leg import PreparedLeg, prepare
from terraphi.library.store import Library
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, panels_of
from terraphi.view.table import Table
from terraphi_studies import Progress, Study, steps
from terraphi_studies.measures import Truth, recovered, straight_truths

if TYPE_CHECKING:
    from matplotlib.figure import Figure


REPLICATES = 5000
BESIDE = 2000
"""Worlds at most of each kind that is not the prior's."""
ONE_LIBRARY = (40, 50)
"""Worlds that the one library may be of, and truths in each."""
EXPECTED = 200
"""Worlds that the one library may be of, from which the counts of truths are expected."""
MATCHED = (10, 20)
"""Worlds that the one library may be of, and truths in each, for all of the inference."""
MATCHED_NOISE = {"clean": 0.0, "white noise 2%": 0.02}
"""Noise of a window mean in them, of the peak force [-]."""
ANEW = (10, 60)
"""Worlds in which scatter and hyperparameters are learnt anew, and truths in each."""
HEADER = ("what", "discrepancy", "cases", "median error", "largest", "68 % half-width", "in 68 %",
          "in 95 %", "not believed")  # fmt: skip
PICTURE = (
    "Ranks of the truths, coverage over the mass of the interval, half-widths over the friction "
    "angle, and the particle scatter"
)
DEFAULT = "quick-plane-strain"
ORIGIN = (
    "Written by `terraphi study calibration{option} --out DIR`; what the rows mean stands in "
    "[inference.md](inference.md). How many are inside an interval is told in percent of worlds "
    "and of matched histories, and counted of truths."
)
COVERAGES = (("in 68 %", "{coverage68:.1%}"), ("in 95 %", "{coverage95:.1%}"))
CERTIFICATE = (
    ("library, leg", "`{name}`, {leg}"),
    ("replicates", "{replicates}"),
    *COVERAGES,
    ("p", "{rank_chi2_p:.2g}"),
    ("p of other seeds", lambda row: ", ".join(f"{p:.2g}" for p in row["others"])),
    ("68 % half-width", "{ci68_half_width_deg:.3f}°"),
)
"""Columns of the certificates."""
WORLD_CELLS = (
    ("cases", "{replicates}"),
    ("median error", "{abs_error_deg:.3f}°"),
    ("68 % half-width", "{ci68_half_width_deg:.3f}°"),
    *COVERAGES,
)
MATCHED_CELLS = (("cases", "{cases}"), *COVERAGES, ("not believed", "{misfit}"))
TRUTH_CELLS = (
    ("cases", "{cases}"),
    ("median error", "{abs_error_deg[median]:.3f}°"),
    ("largest", "{abs_error_deg[max]:.2f}°"),
    ("68 % half-width", "{ci68_half_width_deg[median]:.3f}°"),
    ("in 68 %", "{inside68}"),
    ("in 95 %", "{inside95}"),
    ("not believed", "{misfit}"),
)
"""Which cells of :data:`HEADER` each kind of row has; the others are empty."""


def run(
    *,
    library: str = DEFAULT,
    replicates: int = REPLICATES,
    seed: int = 0,
    progress: Progress | None = None,
) -> Study:
    """Check the intervals of the straight leg of a library.

    Parameters
    ----------
    library
        Name of a shipped library; its truths, ``NAME-fourteen`` or ``NAME-truths``, and
        ``NAME-hip`` are used if there are any.
    replicates, seed
        Number of worlds and seed of all draws.
    progress
        Called with steps done and all steps.

    Returns
    -------
    Study
        ``data``: ``library``, ``yield``, ``replicates``, ``coverage68``, ``coverage95``,
        ``rank_chi2_p``, ``ci68_half_width_deg``, ``fitted_surface``, ``heavy_tails`` and
        ``learnt_anew`` (the same in other worlds), ``one_library`` (the same coverages, mean and 5
        to 95 % over worlds), ``matched`` (by noise, ``cases`` that the model explains, their
        coverages and how many are a ``misfit``), ``truths`` (by what was done to them and the
        discrepancy: ``cases``, ``abs_error_deg``, ``ci68_half_width_deg``, ``inside68``,
        ``inside95``, ``misfit``, and ``by_seed`` the same for the truths of each particle seed),
        ``clean_known`` (how many clean truths are inside if it is known that there is no noise, and
        between which counts, 5 and 95 % over worlds, that should be), ``strangers``.

    Raises
    ------
    InputError
        If there is no such library.
    """
    trained = Library.load(library)
    todo = ways(library, np.random.default_rng(seed + 2))
    done_with = steps(7 + len(todo), progress)
    # Worlds are of forces as simulated.
    leg = prepare(trained.as_simulated, "straight")
    counts = {kind: min(replicates, BESIDE) for kind in WORLDS} | {"prior": replicates}
    worlds = {
        kind: done_with(calibrate(leg, replicates=count, seed=seed, worlds=kind))
        for kind, count in counts.items()
    }
    anew = done_with(learnt_anew(leg, worlds=ANEW[0], truths=ANEW[1], seed=seed + 3))
    count, truths = ONE_LIBRARY
    one = done_with(through_one_library(leg, worlds=count, truths=truths, seed=seed + 1))
    right = done_with(
        {
            name: matched(leg, noise=noise, worlds=MATCHED[0], truths=MATCHED[1], seed=seed + 4)
            for name, noise in MATCHED_NOISE.items()
        }
    )
    data = {
        "library": library,
        "yield": leg.curves.scenario.convention,
        **worlds["prior"].as_dict(),
        "seed": seed,
        "fitted_surface": worlds["fitted"].as_dict(),
        "heavy_tails": worlds["tails"].as_dict(),
        "learnt_anew": {"worlds": ANEW[0], **anew.as_dict()},
        "one_library": {
            name: {"mean": float(part.mean()), "p05_p95": np.quantile(part, [0.05, 0.95]).tolist()}
            for name, part in zip(("coverage68", "coverage95"), one, strict=True)
        },
        "matched": right,
        "truths": {way.name: done_with(inverted(trained, way)) for way in todo},
        "clean_known": _known(leg, library, seed=seed + 5),
        "strangers": done_with(strangers(trained)),
    }
    title = f"Calibration of the intervals of library '{library}', leg straight"
    table, notes = Table(title, HEADER, _rows(data)), _notes(data)
    name = "calibration" if library == DEFAULT else f"calibration-{Path(library).stem}"
    return Study(
        table=table,
        data=data,
        figures={name: calibration_figure(worlds["prior"], leg, one[0])},
        documents={f"{name}.md": _page(library, name, table, notes)},
        notes=notes,
    )


def _known(leg: PreparedLeg, library: str, *, seed: int) -> dict[str, Any]:
    """How many clean truths are inside, without any noise inferred, and how many should be."""
    truths = truths_of(library)
    if not truths:
        return {}
    angles = np.array([truth.phi_deg for truth in truths])
    data = np.stack([truth.history.observation().vector for truth in truths])
    found = of_observations(leg, angles, data)
    worlds = expected_of(leg, angles, worlds=EXPECTED, seed=seed)
    return {
        f"inside{p}": {
            "found": found.count(0.01 * p),
            "p05_p95": np.quantile([w.count(0.01 * p) for w in worlds], [0.05, 0.95]).tolist(),
        }
        for p in (68, 95)
    }


def _rows(data: Mapping[str, Any]) -> list[tuple[str, ...]]:
    kinds = {
        "simulated worlds": data,
        "worlds about the fitted surface": data["fitted_surface"],
        "worlds of heavy-tailed libraries": data["heavy_tails"],
        "worlds learnt anew": data["learnt_anew"],
    }
    one = {name: part["mean"] for name, part in data["one_library"].items()}
    one["cases"] = ONE_LIBRARY[0] * ONE_LIBRARY[1]
    return [
        *(_row(name, "none", WORLD_CELLS, part) for name, part in kinds.items()),
        _row("through the one library", "none", MATCHED_CELLS[:-1], one),
        *(
            _row(f"matched histories, {name}", "none", MATCHED_CELLS, part)
            for name, part in data["matched"].items()
        ),
        *(
            _row(f"truths, {name}", discrepancy, TRUTH_CELLS, part)
            for name, by_discrepancy in data["truths"].items()
            for discrepancy, part in by_discrepancy.items()
        ),
    ]


def _row(
    what: str, discrepancy: str, cells: Sequence[tuple[str, str]], part: Mapping[str, Any]
) -> tuple[str, ...]:
    filled = {name: cell.format_map(part) for name, cell in cells}
    return (what, discrepancy, *(filled.get(name, "") for name in HEADER[2:]))


def _notes(data: Mapping[str, Any]) -> list[str]:
    spread, fitted = data["one_library"]["coverage68"]["p05_p95"], data["fitted_surface"]
    believed = ", ".join(
        f"{n['believed']} of {n['cases']} ({kind})"
        for kind, n in data["strangers"].items()
        if n["cases"]
    )
    ranks, fitted_ranks = (
        f"have mean {part['mean_rank']:.3f}, and are uniform with p = {part['rank_chi2_p']:.2g}"
        for part in (data, fitted)
    )
    clean = data["truths"].get("clean", {}).get("none")
    held = f"{spread[0]:.0%} to {spread[1]:.0%} (5 to 95 % of the worlds that it may be of)"
    return [
        f"Ranks of the true angles in simulated worlds {ranks} (chi-square).",
        f"In worlds about the fitted surface they {fitted_ranks}.",
        f"Through one library 68 % intervals cover {held}.",
        f"Histories that must not be believed, but were: {believed}.",
        *(_expected(data["clean_known"]) if clean else ()),
        *(_by_seed(clean["by_seed"]) if clean else ()),
    ]


def _expected(known: Mapping[str, Any]) -> list[str]:
    """Clean truths inside their intervals, beside how many should be."""
    counts = " and ".join(
        f"{part['found']} in {name.removeprefix('inside')} % "
        f"({part['p05_p95'][0]:.0f} to {part['p05_p95'][1]:.0f} expected)"
        for name, part in known.items()
    )
    worlds = "5 to 95 % of the worlds that the library may be of"
    return [f"Clean truths inside, where no noise is inferred: {counts}; expected: {worlds}."]


def _by_seed(seeds: Sequence[Mapping[str, Any]]) -> list[str]:
    """Clean truths, apart by particle seed."""
    if len(seeds) < 2:
        return []
    lists = "; ".join(
        f"{name} {', '.join(cell.format_map(part) for part in seeds)}" for name, cell in OF_SEEDS
    )
    return [f"Clean truths, {seeds[0]['cases']} of each of {len(seeds)} particle seeds: {lists}."]


OF_SEEDS = (
    ("median errors", "{abs_error_deg[median]:.3f}°"),
    ("largest", "{abs_error_deg[max]:.2f}°"),
    ("median 68 % half-widths", "{ci68_half_width_deg[median]:.3f}°"),
    ("in 68 %", "{inside68}"),
    ("in 95 %", "{inside95}"),
)


def _page(library: str, picture: str, table: Table, notes: Sequence[str]) -> str:
    """The study as a page in Markdown, with the certificates of all shipped libraries."""
    usual = library == DEFAULT
    parts = [
        f"# Are the intervals {'' if usual else f'of {library} '}calibrated?",
        ORIGIN.format(option="" if usual else f" --library {library}"),
        "## Certificates",
        certificates().markdown(),
        f"## {table.title}",
        table.markdown(),
        "\n".join(f"- {note}" for note in notes),
        f"![{PICTURE}]({picture}.png)",
    ]
    return "\n\n".join(parts) + "\n"


def certificates() -> Table:
    """The certificates that shipped libraries carry."""
    found = []
    for name in shipped_names("libraries", ".nc"):
        certificate = Library.load(name).calibration.get("certificate", {})
        for leg, numbers in certificate.get("legs", {}).items():
            others = certificate["rank_chi2_p_of_other_seeds"][leg]
            found.append({"name": name, "leg": leg, "others": others, **numbers})
    return Table.of("", CERTIFICATE, found)


NOISES = (0.02, 0.05, 0.10)
"""White noise of a reading, of the peak force [-]."""
CORRELATED = 0.02
"""Noise correlated over 6°, of the peak force [-]."""
CORRELATION_DEG = 6.0
OFFSET = 0.02
"""Offset of both forces, of the peak force [-]."""
THETA_DEG = 1.0
"""Error of the leg angle [deg]."""
DENSITY = 1.2
"""Error of the density, a factor [-]."""
OTHER_MODEL = "rft3d"
"""Library of another forward model, whose histories the model must not explain."""


class Way(NamedTuple):
    """Something that is done to truths before they are inverted."""

    name: str
    truths: Sequence[Truth]
    spoil: Callable[[ForceHistory], ForceHistory]
    density: float = 1.0
    """Factor on the density that is told [-]."""
    discrepancies: tuple[str, ...] = ("none", "gp")
    """Those that it is inverted with."""


def truths_of(library: str) -> list[Truth]:
    """Straight truths of a library: the paper's fourteen, thrice, else any; empty if none."""
    return _straight(f"{library}-fourteen") or _straight(f"{library}-truths")


def _straight(name: str) -> list[Truth]:
    """Straight truths of a shipped library; none if there is none of that name."""
    try:
        return straight_truths(Library.load(name))
    except InputError:
        return []


def ways(library: str, rng: np.random.Generator) -> list[Way]:
    """All that is done, in the order of the table; empty if the library has no truths."""
    truths, hips = truths_of(library), _straight(f"{library}-hip")
    if not truths:
        return []

    def noisy(fraction: float) -> Callable[[ForceHistory], ForceHistory]:
        return lambda h: _spoilt(h, fraction * rng.standard_normal(h.force.shape))

    def turned(history: ForceHistory) -> ForceHistory:
        shifted = history.position + math.radians(THETA_DEG)
        return replace(history, position=shifted, provenance={})

    def nameless(history: ForceHistory) -> ForceHistory:
        return replace(history, provenance={})

    found = [
        Way("clean", truths, lambda h: h),
        *(Way(f"white noise {f:.0%}", truths, noisy(f)) for f in NOISES),
        Way(
            f"noise over {CORRELATION_DEG:g}°, {CORRELATED:.0%}",
            truths,
            lambda h: _spoilt(h, CORRELATED * _correlated(h, rng)),
        ),
        Way(f"offset {OFFSET:.0%}", truths, lambda h: _spoilt(h, OFFSET * np.ones_like(h.force))),
        Way(f"θ off by {THETA_DEG:g}°", truths, turned),
    ]
    if hips:
        found.append(Way("hip off by 2 mm", hips, nameless))
    wrong = f"density off by {DENSITY - 1.0:.0%}"
    found.append(Way(wrong, truths, nameless, DENSITY, ("gp",)))
    for fraction in NOISES:
        name = f"{wrong}, white noise {fraction:.0%}"
        found.append(Way(name, truths, noisy(fraction), DENSITY, ("gp",)))
    return found


def inverted(trained: Library, way: Way) -> dict[str, dict[str, Any]]:
    """Errors and coverage over the truths, by the discrepancy they were inverted with.

    Parameters
    ----------
    trained
        The library.
    way
        What is inverted.

    Returns
    -------
    dict
        Of each discrepancy the summary of all, with those of each particle seed in ``by_seed``.
    """
    density = way.density * trained.cases[0].scenario.soil.density
    spoilt = [(truth.phi_deg, way.spoil(truth.history)) for truth in way.truths]
    seeds = max(Counter(phi for phi, _ in spoilt).values())
    tables = {}
    for discrepancy in way.discrepancies:
        found = [
            (phi, invert(history, library=trained, density=density, discrepancy=discrepancy))
            for phi, history in spoilt
        ]
        size = len(found) // seeds
        groups = [_summary(found[i * size : (i + 1) * size]) for i in range(seeds)]
        tables[discrepancy] = {**_summary(found), "by_seed": groups}
    return tables


def matched(
    leg: PreparedLeg, *, noise: float, worlds: int, truths: int, seed: int
) -> dict[str, float]:
    """Histories that the model does explain, through all of the inference.

    Parameters
    ----------
    leg
        Of the library, whose model is true in worlds that the library may be of.
    noise
        White noise of a window mean, of the peak force [-]; its size is inferred.
    worlds, truths
        Number of worlds, and of histories in each.
    seed
        Of all draws.

    Returns
    -------
    dict
        Number of ``cases``, fractions of 68 and 95 % intervals that hold the truth, ``coverage68``
        and ``coverage95`` [-], and how many cases are a ``misfit``.
    """
    rng, surrogate = np.random.default_rng(seed), leg.surrogate
    shape = np.eye(2 * len(surrogate.theta_deg))
    ranks, misfits = [], 0
    for _ in range(worlds):
        truth = np.sort(rng.uniform(*surrogate.phi_bounds_deg, size=truths))
        forces = one_world(surrogate, truth, rng) + surrogate.scatter.draw(truth, rng)
        white = rng.standard_normal(forces.shape)
        forces += noise * np.abs(forces).max(axis=1, keepdims=True) * white
        for phi, data in zip(truth.tolist(), forces, strict=True):
            likelihood = CalibratedLikelihood(Problem(leg, data, shape, None, discrepancy=False))
            posterior = quadrature(likelihood, surrogate.phi_bounds_deg, nodes=NODES["calibrated"])
            ranks.append(posterior.mass(surrogate.phi_bounds_deg[0], phi))
            fit = fit_without_discrepancy(likelihood.problem, likelihood.without, scale=1.0)
            misfits += fit.misfit
    off = np.abs(np.array(ranks) - 0.5)
    inside = {f"coverage{p}": float(np.mean(off <= 0.005 * p)) for p in (68, 95)}
    return {"cases": len(ranks), **inside, "misfit": misfits}


def strangers(trained: Library) -> dict[str, dict[str, int]]:
    """Histories that the straight leg of the model must not explain, and how many were believed.

    Of other legs passed off as the straight one, of resistive force theory if the model is another,
    and of measured sand.
    """
    legs = [c.history for c in trained.cases if c.scenario.leg.shape in {"c", "reversed_c"}][::3]
    law = [c for c in Library.load(OTHER_MODEL).cases if c.scenario.leg.shape == "straight"]
    if trained.cases[0].scenario.model == "rft":
        law = []
    sand = [m for m in map(measurement, names()) if m.leg == "straight"]
    kinds: dict[str, list[tuple[ForceHistory | None, float | None]]] = {
        "other legs": [(history, None) for history in legs],
        OTHER_MODEL: [
            (replace(c.history, provenance={}), c.scenario.soil.density) for c in law if c.history
        ],
        "measured sand": [(m.history, m.density_kg_m3) for m in sand],
    }
    found = {}
    for kind, histories in kinds.items():
        verdicts = [
            invert(history, library=trained, leg="straight", density=density).verdict.verdict
            for history, density in histories
            if history
        ]
        found[kind] = {"cases": len(verdicts), "believed": verdicts.count("consistent")}
    return found


def _spoilt(history: ForceHistory, relative: FloatArray) -> ForceHistory:
    """A history with something added, relative to each force's peak; no longer one of ours."""
    peak = np.abs(history.force).max(axis=0)
    return replace(history, force=history.force + peak * relative, provenance={})


def _correlated(history: ForceHistory, rng: np.random.Generator) -> FloatArray:
    """Smooth noise of unit variance over the leg angle, as the paper's residual has it."""
    coarse = np.arange(-140.0, 140.1, 2.0)
    covariance = np.exp(-0.5 * np.square((coarse[:, None] - coarse) / CORRELATION_DEG))
    factor = np.linalg.cholesky(covariance + 1e-6 * np.eye(coarse.size))
    drawn = factor @ rng.standard_normal((coarse.size, history.force.shape[1]))
    return np.column_stack([np.interp(history.theta_deg, coarse, column) for column in drawn.T])


def _summary(found: list[tuple[float, Inversion]]) -> dict[str, Any]:
    misfit = sum(answer.verdict.verdict != "consistent" for _, answer in found)
    return {**recovered(found), "misfit": misfit}


def calibration_figure(coverage: Coverage, leg: PreparedLeg, one_library: FloatArray) -> Figure:
    """Rank histogram, coverage over its nominal value, half-widths, and the particle scatter.

    Parameters
    ----------
    coverage
        Of the simulated worlds.
    leg
        The leg of the library.
    one_library
        Coverage of 68 % intervals in each world that the one library may be of [-], shape [world].
    """
    figure, ((ranks, covers), (widths, scatter)) = panels_of(2, 2, size=(11.0, 7.2))
    counts = coverage.histogram
    expected = counts.sum() / counts.size
    ranks.bar((np.arange(counts.size) + 0.5) / counts.size, counts, 0.9 / counts.size, color=BLUE)
    slack = 2.0 * np.sqrt(expected)
    ranks.axhspan(expected - slack, expected + slack, color=GREY, alpha=0.3, lw=0)
    ranks.set(xlabel="rank of the truth in its posterior", ylabel="worlds")
    ranks.set_title(f"uniform with p = {coverage.chi2_probability:.2g}; grey: ± 2 σ", fontsize=10)

    nominal = np.linspace(0.02, 0.98, 49)
    covers.plot([0, 1], [0, 1], color=GREY, lw=0.8)
    within = [coverage.within(p) for p in nominal]
    covers.plot(nominal, within, color=BLUE, label="simulated worlds")
    at, label = np.full(one_library.size, 0.68), "one library, world by world"
    covers.plot(at, one_library, "_", color=ORANGE, ms=9, label=label)
    covers.set(xlabel="mass of the interval", ylabel="fraction that hold the truth")
    covers.legend(frameon=False, fontsize=9)

    widths.plot(coverage.truth_deg, coverage.half_width_deg, ".", ms=2, color=BLUE)
    widths.set(xlabel="true friction angle [deg]", yscale="log")
    widths.set_ylabel("half-width of the 68 % interval [deg]")

    model = leg.surrogate.scatter
    theta = model.theta_deg
    angles = np.quantile(leg.surrogate.phi_deg, [0.1, 0.5, 0.9]).tolist()
    looks = ((GREEN, "-"), (BLUE, "--"), (ORANGE, ":"))
    for phi, (colour, style) in zip(angles, looks, strict=True):
        fz = model.sigma([phi])[0, theta.size :]
        scatter.plot(theta, fz, style, color=colour, label=f"φ = {phi:.1f}°")
    name = "particle scatter of $F_z$ [N]"
    scatter.set(xlabel="leg angle θ [deg]", ylabel=name, yscale="log")
    scatter.legend(frameon=False, fontsize=9)
    return figure
