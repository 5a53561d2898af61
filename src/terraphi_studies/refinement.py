"""Refinement: what cells without size and no speed-up would do to a library's forces.

Finer simulations of some of a library's cases are shipped beside it. They are put into it as
`terraphi library refine` does, and the correction is told in percent and newtons of the force and
in degrees of friction angle, each with its standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.experiment.errors import InputError, nearest
from terraphi.inference.prepared_leg import prepare
from terraphi.inference.refining import corrections, left_out, refined
from terraphi.library.finer import CAUSES, untold
from terraphi.library.store import Library
from terraphi.view.plots import BLUE, ORANGE, panels_of
from terraphi.view.table import Table
from terraphi_studies import Progress, Study, page, steps
from terraphi_studies.measures import FORCES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


NAME = "refinement"
FINER = {
    "resolved-2": (
        "cells-384",
        "cells-288",
        "bent-cells-384",
        "speed-up",
        "bent-speed-up",
    ),
    "sand3d": ("cells-150", "cells-120", "cells-86", "speed-up"),
}
"""By library, what the names of those end with that have finer cases of it."""
PHI_DEG = 35.0
"""Friction angle whose curves are kept and drawn, or the nearest there is [deg]."""
TITLE = "Cells and speed-up taken out of libraries"
COLUMNS = (
    ("library", "`{library}`"),
    ("leg", "{leg}"),
    ("φ [deg]", "{phi_deg:g}"),
    ("Fz [%]", lambda row: _said(row["Fz"], "percent")),
    ("Fz [N]", lambda row: _said(row["Fz"], "newton")),
    ("Fx [%]", lambda row: _said(row["Fx"], "percent")),
    ("Fx [N]", lambda row: _said(row["Fx"], "newton")),
    ("φ as read [deg]", lambda row: _said(row["phi"], "deg")),
)
METHOD = (
    "Written by `terraphi study refinement --out DIR`. Simulations with smaller cells or a smaller "
    "speed-up, of a few friction angles, are put into the library that they are cases of "
    "(`terraphi library refine`), whose forces are led to cells without size and to no speed-up "
    "([how](inference.md#cells-and-speed-up)). Each row says by how much this changes the forces, "
    "as one factor for all leg angles and as that share of the mean force, and how many degrees "
    "more friction a record then reads as, with one standard deviation; at the least, the middle "
    "and the largest friction angle of the library. This is the error of the numbers alone: a "
    "strip may still differ from a leg of 25 mm."
)
PICTURE = "Forces over the leg angle, as simulated and led to cells without size and no speed-up"


def run(*, library: str | None = None, progress: Progress | None = None) -> Study:
    """Refine libraries by the shipped simulations that are finer.

    Parameters
    ----------
    library
        One of :data:`FINER`; all if not given.
    progress
        Called with the number of libraries done and of all.

    Returns
    -------
    Study
        ``data``: ``rows``, those of :func:`~terraphi.inference.refining.corrections` with
        ``library`` before them; ``finer``, by library and leg the finer cases in words;
        ``borrowed``, by library and cause the legs that have none of their own; ``left_out``, as
        :func:`~terraphi.inference.refining.left_out`, with ``library``; and ``curves``, one for
        each leg of a library: ``library``, ``leg``, ``phi_deg``, ``theta_deg``, and by force
        ``simulated_N``, ``limit_N`` and ``sd_N``.

    Raises
    ------
    InputError
        If no finer simulations of that library are shipped.
    """
    if library is not None and library not in FINER:
        raise InputError(
            f"library '{library}': no finer simulations of it are shipped; "
            f"{nearest(library, FINER)}"
        )
    names = [library] if library else list(FINER)
    step = steps(len(names), progress)
    rows: list[dict[str, Any]] = []
    curves: list[dict[str, Any]] = []
    tried: list[dict[str, Any]] = []
    finer, borrowed = {}, {}
    for name in names:
        made = refined(
            Library.load(name).as_simulated,
            [Library.load(f"{name}-{ending}") for ending in FINER[name]],
        )
        rows += [{"library": name, **row} for row in corrections(made)]
        curves += [{"library": name, **curves_of(made, leg)} for leg in made.legs]
        tried += [{"library": name, **row} for row in left_out(made)]
        borrowed[name] = untold(made)
        finer[name] = step(made.summary()["finer_cases"])
    table, notes = Table.of(TITLE, COLUMNS, rows), _notes(rows, finer, borrowed, tried)
    return Study(
        table=table,
        data={
            "rows": rows,
            "finer": finer,
            "borrowed": borrowed,
            "left_out": tried,
            "curves": curves,
        },
        figures={NAME: _figure(curves)},
        documents=page(NAME, table, METHOD, notes, PICTURE),
        notes=notes,
    )


def curves_of(library: Library, leg: str) -> dict[str, Any]:
    """A leg's forces at one angle, as simulated and at the limit; keys as in :func:`run`."""
    surrogate = prepare(library, leg).surrogate
    simulated = surrogate.as_simulated
    phi = float(surrogate.phi_deg[np.abs(surrogate.phi_deg - PHI_DEG).argmin()])
    error = surrogate.covariance(phi) - simulated.covariance(phi)
    told = {
        "simulated_N": simulated.predict(phi)[0],
        "limit_N": surrogate.predict(phi)[0],
        "sd_N": np.sqrt(np.diag(error)),
    }
    found: dict[str, Any] = {"leg": leg, "phi_deg": phi}
    found["theta_deg"] = surrogate.theta_deg.tolist()
    for i, force in enumerate(("Fx", "Fz")):
        found[force] = {key: np.split(values, 2)[i].tolist() for key, values in told.items()}
    return found


def _said(told: Mapping[str, float], key: str) -> str:
    return f"{told[key]:+.1f} ± {told[f'sd_{key}']:.1f}"


def _notes(
    rows: Sequence[Mapping[str, Any]],
    finer: Mapping[str, Mapping[str, Sequence[str]]],
    borrowed: Mapping[str, Mapping[str, Sequence[str]]],
    tried: Sequence[Mapping[str, Any]],
) -> list[str]:
    """Of each library what it was refined by, and where that is least and best known."""
    notes = []
    for name, legs in finer.items():
        told = "; ".join(f"{leg} {', '.join(cases)}" for leg, cases in legs.items())
        notes.append(f"Finer cases of `{name}`: {told}.")
        mine = [row for row in rows if row["library"] == name]
        for cause, without in borrowed[name].items():
            what = CAUSES[cause]
            if set(without) == {row["leg"] for row in mine}:
                notes.append(f"Of `{name}`, {what} is not taken out: no finer case tells of it.")
            else:
                notes.append(
                    f"Of `{name}`, what {what} does to {' and '.join(without)} is taken over from "
                    "another leg, with more uncertainty."
                )
        best = min(mine, key=lambda row: row["phi"]["sd_deg"])
        worst = max(mine, key=lambda row: row["phi"]["sd_deg"])
        notes.append(
            f"Change of angles read through `{name}`: best known {_place(best)}, least known "
            f"{_place(worst)}."
        )
    if tried:
        apart = [abs(one["deg"] - one["foretold_deg"]) / one["sd_deg"] for one in tried]
        notes.append(
            f"Each angle left out in turn: of {len(tried)} changes of φ as read by the finest "
            f"simulations {sum(z < 1.0 for z in apart)} are foretold by the other angles within "
            f"one standard deviation, {sum(z < 1.96 for z in apart)} within two; root mean square "
            f"{np.sqrt(np.mean(np.square(apart))):.1f}."
        )
    return notes


def _place(row: Mapping[str, Any]) -> str:
    return f"{_said(row['phi'], 'deg')}° ({row['leg']}, {row['phi_deg']:g}°)"


def _figure(curves: Sequence[Mapping[str, Any]]) -> Figure:
    """Two rows of panels, the forces, for each library, a column for each of its legs."""
    libraries: dict[str, list[Mapping[str, Any]]] = {}
    for curve in curves:
        libraries.setdefault(curve["library"], []).append(curve)
    columns = max(map(len, libraries.values()))
    rows = 2 * len(libraries)
    figure, panels = panels_of(rows, columns, size=(2.9 * columns, 2.5 * rows), sharex=True)
    for first, legs in zip(range(0, rows, 2), libraries.values(), strict=True):
        for column, curve in enumerate(legs):
            _draw(panels[first : first + 2, column], curve)
        for force, axes in zip(FORCES, panels[first : first + 2, 0], strict=True):
            axes.set_ylabel(f"{force} [N]")
    for axes in panels[-1]:
        axes.set_xlabel("leg angle [deg]")
    panels[0, 0].legend(frameon=False, fontsize=7)
    return figure


def _draw(panels: Sequence[Axes], curve: Mapping[str, Any]) -> None:
    """Both forces on a leg, as simulated and at the limit."""
    theta = np.array(curve["theta_deg"])
    for force, axes in zip(FORCES, panels, strict=True):
        simulated, limit, sd = map(np.array, curve[force].values())
        axes.plot(theta, simulated, color=ORANGE, lw=1.2, label="as simulated")
        axes.plot(theta, limit, color=BLUE, lw=1.2, label="at the limit, ± 1 sd")
        axes.fill_between(theta, limit - sd, limit + sd, color=BLUE, alpha=0.25, lw=0)
        axes.axhline(0.0, color="k", lw=0.5)
    panels[0].set_title(
        f"{curve['library']}, {curve['leg']}, φ = {curve['phi_deg']:g}°", fontsize=9
    )
