"""Calibration: whether intervals hold the truth as often as they say, and how narrow they are.

Simulation-based calibration in thousands of simulated worlds, each with a truth and a library of
its own, and in worlds unlike the prior; coverage through the one shipped library; its truths, as
they are and made worse; histories that the model must not explain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.documents import shipped_names
from terraphi.inference.coverage import (
    WORLDS,
    calibrate,
    expected_of,
    learnt_anew,
    of_observations,
    through_one_library,
)
from terraphi.inference.library import PreparedLeg, prepare
from terraphi.library import Library
from terraphi.studies import Study
from terraphi.studies.calibration_cases import inverted, matched, strangers, truths_of, ways
from terraphi.studies.calibration_figures import calibration_figure

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
CERTIFICATE = ("library, leg", "replicates", "in 68 %", "in 95 %", "p", "p of other seeds",
               "68 % half-width")  # fmt: skip


def run(
    *,
    library: str = DEFAULT,
    replicates: int = REPLICATES,
    seed: int = 0,
    progress: Callable[[float, float], None] | None = None,
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
    done = iter(range(1, 8 + len(todo)))

    def report() -> None:
        if progress is not None:
            progress(next(done), 7 + len(todo))

    leg = prepare(trained, "straight")
    found = {}
    for worlds in WORLDS:
        count = replicates if worlds == "prior" else min(replicates, BESIDE)
        found[worlds] = calibrate(leg, replicates=count, seed=seed, worlds=worlds)
        report()
    anew = learnt_anew(leg, worlds=ANEW[0], truths=ANEW[1], seed=seed + 3)
    report()
    one = through_one_library(leg, worlds=ONE_LIBRARY[0], truths=ONE_LIBRARY[1], seed=seed + 1)
    report()
    right = {
        name: matched(leg, noise=noise, worlds=MATCHED[0], truths=MATCHED[1], seed=seed + 4)
        for name, noise in MATCHED_NOISE.items()
    }
    report()
    tables = {}
    for way in todo:
        tables[way.name] = inverted(trained, way)
        report()
    data = {
        "library": library,
        "yield": leg.curves.scenario.convention,
        **found["prior"].as_dict(),
        "seed": seed,
        "fitted_surface": found["fitted"].as_dict(),
        "heavy_tails": found["tails"].as_dict(),
        "learnt_anew": {"worlds": ANEW[0], **anew.as_dict()},
        "one_library": {
            name: {"mean": float(part.mean()), "p05_p95": np.quantile(part, [0.05, 0.95]).tolist()}
            for name, part in zip(("coverage68", "coverage95"), one, strict=True)
        },
        "matched": right,
        "truths": tables,
        "clean_known": _known(leg, library, seed=seed + 5),
        "strangers": strangers(trained),
    }
    report()
    return _study(data, calibration_figure(found["prior"], leg, one[0]))


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


def _study(data: Mapping[str, Any], figure: Figure) -> Study:
    """Table, sentences, page and picture."""
    rows, notes = _rows(data), _notes(data)
    library = str(data["library"])
    name = "calibration" if library == DEFAULT else f"calibration-{Path(library).stem}"
    return Study(
        title=_title(library),
        header=HEADER,
        rows=rows,
        data=data,
        figures={name: figure},
        documents={f"{name}.md": _page(library, name, rows, notes)},
        notes=notes,
    )


def _rows(data: Mapping[str, Any]) -> list[tuple[str, ...]]:
    kinds = {
        "simulated worlds": data,
        "worlds about the fitted surface": data["fitted_surface"],
        "worlds of heavy-tailed libraries": data["heavy_tails"],
        "worlds learnt anew": data["learnt_anew"],
    }
    rows: list[tuple[str, ...]] = [
        (
            name,
            "none",
            str(part["replicates"]),
            f"{part['abs_error_deg']:.3f}°",
            "",
            f"{part['ci68_half_width_deg']:.3f}°",
            f"{part['coverage68']:.1%}",
            f"{part['coverage95']:.1%}",
            "",
        )
        for name, part in kinds.items()
    ]
    one = (f"{data['one_library'][name]['mean']:.1%}" for name in ("coverage68", "coverage95"))
    cases = str(ONE_LIBRARY[0] * ONE_LIBRARY[1])
    rows.append(("through the one library", "none", cases, "", "", "", *one, ""))
    for name, part in data["matched"].items():
        covers = (f"{part[key]:.1%}" for key in ("coverage68", "coverage95"))
        what, count = f"matched histories, {name}", str(part["cases"])
        rows.append((what, "none", count, "", "", "", *covers, str(part["misfit"])))
    for name, by_discrepancy in data["truths"].items():
        for discrepancy, part in by_discrepancy.items():
            error, cases = part["abs_error_deg"], str(part["cases"])
            rows.append(
                (
                    f"truths, {name}",
                    discrepancy,
                    cases,
                    f"{error['median']:.3f}°",
                    f"{error['max']:.2f}°",
                    f"{part['ci68_half_width_deg']['median']:.3f}°",
                    f"{part['inside68']}",
                    f"{part['inside95']}",
                    f"{part['misfit']}",
                )
            )
    return rows


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
    numbers = {
        "median errors": [f"{part['abs_error_deg']['median']:.3f}°" for part in seeds],
        "largest": [f"{part['abs_error_deg']['max']:.2f}°" for part in seeds],
        "median 68 % half-widths": [
            f"{part['ci68_half_width_deg']['median']:.3f}°" for part in seeds
        ],
        "in 68 %": [str(part["inside68"]) for part in seeds],
        "in 95 %": [str(part["inside95"]) for part in seeds],
    }
    lists = "; ".join(f"{name} {', '.join(values)}" for name, values in numbers.items())
    return [f"Clean truths, {seeds[0]['cases']} of each of {len(seeds)} particle seeds: {lists}."]


def _title(library: str) -> str:
    return f"Calibration of the intervals of library '{library}', leg straight"


def _page(library: str, picture: str, rows: Sequence[Sequence[str]], notes: Sequence[str]) -> str:
    """The study as a page in Markdown, with the certificates of all shipped libraries."""
    usual = library == DEFAULT
    parts = [
        f"# Are the intervals {'' if usual else f'of {library} '}calibrated?",
        ORIGIN.format(option="" if usual else f" --library {library}"),
        "## Certificates",
        _table(CERTIFICATE, certificates()),
        f"## {_title(library)}",
        _table(HEADER, rows),
        "\n".join(f"- {note}" for note in notes),
        f"![{PICTURE}]({picture}.png)",
    ]
    return "\n\n".join(parts) + "\n"


def certificates() -> list[tuple[str, ...]]:
    """Rows of the certificates that shipped libraries carry."""
    rows: list[tuple[str, ...]] = []
    for name in shipped_names("libraries", ".nc"):
        certificate = Library.load(name).calibration.get("certificate", {})
        for leg, found in certificate.get("legs", {}).items():
            again = certificate["rank_chi2_p_of_other_seeds"][leg]
            rows.append(
                (
                    f"`{name}`, {leg}",
                    str(found["replicates"]),
                    *(f"{found[key]:.1%}" for key in ("coverage68", "coverage95")),
                    f"{found['rank_chi2_p']:.2g}",
                    ", ".join(f"{p:.2g}" for p in again),
                    f"{found['ci68_half_width_deg']:.3f}°",
                )
            )
    return rows


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in [header, ["---"] * len(header), *rows])
