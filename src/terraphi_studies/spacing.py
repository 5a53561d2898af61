"""Spacing: how often intervals hold the truth if a record has few readings.

The quick libraries' forces ripple over the leg angle with a period near a degree, at the same
angles in every simulation. A record of one reading a degree meets the ripple at one phase. So fresh
simulations of known friction angle are thinned, at evenly spread phases, and each is inverted.

The records of one truth share its particles and the library's error, so that they count for fewer
than they are. What share of them would be inside if the intervals were right is found from normal
errors that are as alike within a truth as those of the records (analysis of variance).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.inference.inversion import invert
from terraphi.library.store import Library
from terraphi.view.plots import BLUE, GREY, ORANGE, panels_of
from terraphi.view.table import Table
from terraphi_studies import Progress, Study, page, steps
from terraphi_studies.measures import Truth, rms, straight_truths

if TYPE_CHECKING:
    from matplotlib.figure import Figure


NAME = "spacing"
LIBRARIES = ("quick-plane-strain", "quick-paper")
ROLES = ("fourteen", "truths", "random")
"""Endings of the names of libraries that hold truths."""
EVERY = (1, 2, 5, 10, 20, 40)
"""Of the simulation's samples, a record has the first and each so many further on."""
PHASES = 5
"""Phases at most of the readings within their spacing."""
BEYOND_DEG = 95.0
"""Readings reach so far to both sides [deg]."""
LEVELS = (68, 95)
COLOURS = (BLUE, ORANGE)
"""Of libraries."""
MARKS = dict(zip(ROLES, "osD", strict=True))
"""Of sets of truths."""
DRAWS = 4000
"""Sets of errors from which shares are expected."""
DOUBTFUL = 0.05
"""Share of the consistent answers that may lie outside their 95 % interval [-]."""
TITLE = "Records of few readings: how often their intervals hold the truth"
COLUMNS = (
    ("truths", "{truths}"),
    (
        "spacing",
        lambda row: "all" if row["spacing_deg"] is None else f"{row['spacing_deg']:g}°",
    ),
    ("records", "{records}"),
    ("in 68 %", "{coverage68:.0%}"),
    ("expected", lambda row: _band(row["expected68"])),
    ("in 95 %", "{coverage95:.0%}"),
    ("expected", lambda row: _band(row["expected95"])),
    ("68 % half-width", "{ci68_half_width_deg:.3f}°"),
    ("RMS error", "{rms_error_deg:.3f}°"),
    ("consistent", "{consistent:.0%}"),
    ("of these outside 95 %", "{consistent_outside95:.0%}"),
)
METHOD = (
    "Written by `terraphi study spacing --out DIR`. Fresh simulations, off the library's grid, are "
    "thinned to one reading in so many degrees, beginning at evenly spread places, and inverted. "
    "`fourteen` are the paper's angles, three simulations each; `truths` are eight from end to "
    "end of the library; `random` are at random within even parts of it, two in three of which "
    "were not looked at while the covariance was worked on. Expected are 5 to 95 % of what comes "
    "out if intervals are right and records of one angle are as alike as these are; errors that "
    "angles share are not in it. "
    "What readings leave open is a term of the covariance, learnt from the library alone: see "
    "[inference.md](inference.md)."
)
PICTURE = "Share of truths inside, and errors beside half-widths, over the spacing of the readings"


class Answer(NamedTuple):
    """One record's answer."""

    truth_deg: float
    """True friction angle [deg]."""
    median_deg: float
    half_width_deg: float
    """Median and half-width of the 68 % interval [deg]."""
    rank: float
    """Mass of the posterior below the truth [-]."""
    consistent: bool


def run(*, library: str | None = None, progress: Progress | None = None) -> Study:
    """Invert thinned truths of libraries.

    Parameters
    ----------
    library
        Name of a shipped library that has truths; both quick ones if not given.
    progress
        Called with the number of records inverted and of all.

    Returns
    -------
    Study
        ``data``: ``rows``, one for each set of truths and spacing and one for each set
        (``spacing_deg`` is null): ``library``, ``truths``, ``spacing_deg``, ``records``,
        ``coverage68``, ``expected68`` (5 and 95 %), ``coverage95``, ``expected95``,
        ``ci68_half_width_deg`` (median), ``rms_error_deg``, ``consistent`` (share),
        ``consistent_outside95`` (share of these) and ``likeness`` (correlation of the errors of
        one truth's records); all shares are fractions.

    Raises
    ------
    InputError
        If there is no such library, or none of its truths.
    """
    sets = [pair for name in ([library] if library else LIBRARIES) for pair in sets_of(name)]
    total = sum(len(truths) * len(phases(every)) for _, _, truths in sets for every in EVERY)
    step, rows = steps(total, progress), []
    for trained, name, truths in sets:
        spacing = float(np.median(np.diff(truths[0].history.theta_deg)))
        answers: list[Answer] = []
        for every in EVERY:
            before = len(answers)
            for phase, truth in itertools.product(phases(every), truths):
                record = thinned(truth.history, every, phase)
                answers.append(step(answer_of(trained, truth.phi_deg, record)))
            rows.append(row_of(trained.name, name, round(every * spacing, 6), answers[before:]))
        rows.append(row_of(trained.name, name, None, answers))
    table, notes = Table.of(TITLE, COLUMNS, rows), _notes(rows)
    return Study(
        table=table,
        data={"rows": rows},
        figures={NAME: _figure(rows)},
        documents=page(NAME, table, METHOD, notes, PICTURE),
        notes=notes,
    )


def sets_of(library: str) -> list[tuple[Library, str, list[Truth]]]:
    """A library and, of each set of its truths, the name, and as many histories of each angle.

    Raises InputError if there is no such library, or none of its truths.
    """
    trained, found = Library.load(library), []
    shipped = shipped_names("libraries", ".nc")
    for name in (f"{library}-{role}" for role in ROLES):
        if name in shipped:
            found.append((trained, name, straight_truths(Library.load(name))))
    if not found:
        endings = tuple(f"-{role}" for role in ROLES)
        known = {name.rpartition("-")[0] for name in shipped if name.endswith(endings)}
        raise InputError(
            f"library '{library}': no truths of it are shipped, which this study needs; those that "
            f"have some: {', '.join(sorted(known))}"
        )
    return found


def phases(every: int) -> list[int]:
    """Samples at which records begin, evenly spread over the spacing."""
    count = min(every, PHASES)
    return [i * every // count for i in range(count)]


def thinned(history: ForceHistory, every: int, phase: int) -> ForceHistory:
    """A record that has each so many samples of a history, from one on; no longer its whole."""
    near = history.engaged(window_deg=BEYOND_DEG)
    return replace(near, position=near.position[phase::every], force=near.force[phase::every])


def answer_of(library: Library, phi_deg: float, record: ForceHistory) -> Answer:
    """Invert a record of known friction angle [deg] with the straight leg of a library."""
    found = invert(record, library=library)
    return Answer(
        phi_deg,
        found.phi.median,
        0.5 * (found.phi.ci68[1] - found.phi.ci68[0]),
        found.posterior.mass(found.posterior.bounds_deg[0], phi_deg),
        found.verdict.verdict == "consistent",
    )


def row_of(
    library: str, truths: str, spacing_deg: float | None, found: Sequence[Answer]
) -> dict[str, Any]:
    """What came out of some records; keys as in :func:`run`."""
    truth, median, half, rank, consistent = (np.array(part) for part in zip(*found, strict=True))
    off = np.abs(rank - 0.5)
    inside = {level: off <= 0.005 * level for level in LEVELS}
    likeness, expected = expected_of(truth, rank)
    outside = (~inside[95])[consistent]
    return {
        "library": library,
        "truths": truths,
        "spacing_deg": spacing_deg,
        "records": len(found),
        **{f"coverage{level}": float(inside[level].mean()) for level in LEVELS},
        **{f"expected{level}": expected[level] for level in LEVELS},
        "ci68_half_width_deg": float(np.median(half)),
        "rms_error_deg": rms(median - truth),
        "consistent": float(consistent.mean()),
        "consistent_outside95": float(outside.mean()) if outside.size else 0.0,
        "likeness": likeness,
    }


def expected_of(
    truth_deg: FloatArray, rank: FloatArray
) -> tuple[float, dict[int, tuple[float, float]]]:
    """How alike the errors of one truth's records are, and shares inside right intervals.

    Parameters
    ----------
    truth_deg, rank
        True angle [deg] and mass of the posterior below it [-] of each record, shape [record]; as
        many of every angle.

    Returns
    -------
    tuple
        Correlation of the errors of two records of one truth [-], 0 to 1, and by percent of the
        interval 5 and 95 % of the share of records inside [-].
    """
    from scipy.special import ndtri

    _, place = np.unique(truth_deg, return_inverse=True)
    groups = int(place.max()) + 1
    error = ndtri(np.clip(rank, 1e-6, 1.0 - 1e-6))[np.argsort(place, kind="stable")]
    table = error.reshape(groups, -1)
    each = table.shape[1]
    likeness = 1.0
    if each > 1 and groups > 1:
        between = each * float(table.mean(axis=1).var(ddof=1))
        within = float(table.var(axis=1, ddof=1).mean())
        likeness = max(between - within, 0.0) / max(between + (each - 1) * within, 1e-12)
    elif each > 1:
        likeness = 0.0
    rng = np.random.default_rng(0)
    drawn = np.sqrt(likeness) * rng.standard_normal((DRAWS, groups, 1))
    drawn = drawn + np.sqrt(1.0 - likeness) * rng.standard_normal((DRAWS, groups, each))
    expected = {}
    for level in LEVELS:
        share = (np.abs(drawn) <= ndtri(0.5 + 0.005 * level)).mean(axis=(1, 2))
        low, high = np.quantile(share, [0.05, 0.95]).tolist()
        expected[level] = (low, high)
    return likeness, expected


def _band(ends: tuple[float, float]) -> str:
    return f"{100 * ends[0]:.0f} to {ends[1]:.0%}"


def _notes(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    notes = []
    single = {
        f"{row['spacing_deg']:g}° (`{row['truths']}`)": row
        for row in rows
        if row["spacing_deg"] is not None
    }
    for level in LEVELS:
        key, band = f"coverage{level}", f"expected{level}"
        low = ", ".join(name for name, row in single.items() if row[key] < row[band][0])
        high = ", ".join(name for name, row in single.items() if row[key] > row[band][1])
        told = [f"too few at {low}"] if low else []
        told += [f"too many at {high}"] if high else []
        all_right = "as many as expected, within chance, in every row"
        notes.append(f"In {level} % intervals: {'; '.join(told) or all_right}.")
    doubtful = [
        name
        for name, row in single.items()
        if row["consistent_outside95"] > max(DOUBTFUL, 1.0 - row["expected95"][0])
    ]
    notes.append(
        f"Of the consistent ones more than {DOUBTFUL:.0%}, and more than by chance, are outside "
        f"their 95 % interval at {', '.join(doubtful) or 'no spacing'}."
    )
    return notes


def _figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Shares inside, and errors beside half-widths, over the spacing."""
    figure, ((shares, errors),) = panels_of(1, 2, size=(10.0, 4.2))
    for level in LEVELS:
        shares.axhline(level, color=GREY, lw=0.8)
    sets = list(dict.fromkeys(row["truths"] for row in rows))
    colours = dict(zip(dict.fromkeys(row["library"] for row in rows), COLOURS, strict=False))
    for name in sets:
        mine = [row for row in rows if row["truths"] == name and row["spacing_deg"] is not None]
        x = [row["spacing_deg"] for row in mine]
        colour = colours[mine[0]["library"]]
        mark = MARKS[name.rpartition("-")[2]]
        look: dict[str, Any] = {"color": colour, "marker": mark, "ms": 5}
        for level, line in zip(LEVELS, ("-", "--"), strict=True):
            shares.plot(x, [100.0 * row[f"coverage{level}"] for row in mine], line, **look)
        errors.plot(
            x, [row["rms_error_deg"] for row in mine], "-", label=f"{name}, RMS error", **look
        )
        half = [row["ci68_half_width_deg"] for row in mine]
        errors.plot(x, half, "--", mfc="white", label="68 % half-width", **look)
    shares.set_ylabel("inside the interval [%]")
    errors.set(ylabel="[deg of φ]", yscale="log")
    for axes in (shares, errors):
        axes.set(xscale="log", xlabel="spacing of the readings [deg]")
        axes.set_xticks([row["spacing_deg"] for row in rows if row["truths"] == sets[0]][:-1])
        axes.set_xticks([], minor=True)
        axes.xaxis.set_major_formatter("{x:g}")
    shares.set_title("solid: 68 % intervals, dashed: 95 %", fontsize=10)
    errors.legend(frameon=False, fontsize=8)
    return figure
