"""The figures of the paper's simulations and inversions from our own, in one command.

Each comes from the study that measures what it shows. The paper's two pictures of foot forces are
those of ``terraphi forces``; its photograph is left out.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from terraphi.experiment.scenario import Scenario
from terraphi.view.table import Table
from terraphi_studies import PAPER_LIBRARY, Study, benchmark, phi_sensitivity, recovery, surrogate
from terraphi_studies.pictures import Moment, legs_figure, moments, snapshots_figure

LEGS = ("straight", "c", "reversed_c")
SNAPSHOTS_DEG = (-60.0, -30.0, 0.0, 40.0)
"""Leg angles of the snapshots [deg]: going in, at the peaks, coming out."""
SNAPSHOT_SPEED_UP = 10.0
"""Least speed-up of the simulations that are run for the snapshots alone; at the true speed the
three would take over an hour, for forces that differ by 3 to 4 % (docs/sensitivity.md)."""
SNAPSHOTS_SHARE = 0.95
"""Share of the time that those three simulations take, roughly."""
DOTS_PER_INCH = 300
WHAT = {
    "forces-phi": "forces against the leg angle at every friction angle",
    "peaks-phi": "peak forces against the friction angle",
    "legs": "three legs at 35° beside the measured forces and resistive force theory",
    "surrogate-surfaces": "mean forces of the surrogate, with what it has and has not seen",
    "surrogate-slices": "surrogate and simulations at three leg angles",
    "residuals": "correlation of the residuals",
    "walkers": "walkers and posterior at 33.97°",
    "recovery": "inferred against true friction angles",
    "snapshots": f"the soil around the three legs, sped up {SNAPSHOT_SPEED_UP:g} times or more",
}


def run(
    *,
    library: str = PAPER_LIBRARY,
    build: Path | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Study:
    """Draw all figures.

    Parameters
    ----------
    library
        Name of a shipped library that has truths, ``NAME-truths``. Legs at 35° that it lacks are
        taken from ``NAME-legs``.
    build
        Folder that keeps the particles of the three simulations that the snapshots are taken from,
        sped up at least :data:`SNAPSHOT_SPEED_UP` times; without, they are simulated anew each
        time.
    progress
        Called with the share of the work that is done, and 1.

    Returns
    -------
    Study
        ``data``: ``library`` and the data of each study by its name. Nine figures at 300 dots an
        inch.

    Raises
    ------
    InputError
        As the studies; and if the folder cannot be written.
    """

    def tell(done: float, total: float, *, first: float, last: float) -> None:
        if progress is not None:
            progress(first + (last - first) * done / total, 1.0)

    begun = partial(tell, first=0.0, last=1.0 - SNAPSHOTS_SHARE)
    parts = {
        module.__name__.rpartition(".")[2]: module.run(library=library)
        for module in (phi_sensitivity, benchmark, surrogate)
    }
    parts["recovery"] = recovery.run(library=library, progress=begun)
    legs = {leg: benchmark.curves_of(library, leg) for leg in LEGS}
    figures = {
        "forces-phi": parts["phi_sensitivity"].figures["forces"],
        "peaks-phi": parts["phi_sensitivity"].figures["peaks"],
        "legs": legs_figure(legs),
        "surrogate-surfaces": parts["surrogate"].figures["surfaces"],
        "surrogate-slices": parts["surrogate"].figures["slices"],
        "residuals": parts["surrogate"].figures["residuals"],
        "walkers": parts["recovery"].figures["walkers"],
        "recovery": parts["recovery"].figures["recovery"],
        "snapshots": snapshots_figure(
            _particles(library, build, partial(tell, first=1.0 - SNAPSHOTS_SHARE, last=1.0))
        ),
    }
    return Study(
        table=Table(
            f"Figures from library '{library}'",
            ("figure", "what it shows"),
            [(f"{name}.png", what) for name, what in WHAT.items()],
        ),
        data={"library": library, **{name: part.everything() for name, part in parts.items()}},
        figures=figures,
        notes=[note for part in parts.values() for note in part.notes],
        beside_paper=[line for part in parts.values() for line in part.beside_paper],
        dpi=DOTS_PER_INCH,
    )


def _particles(
    library: str,
    place: Path | None,
    progress: Callable[[float, float], None],
) -> dict[str, tuple[Scenario, list[Moment]]]:
    """Scenario and moments of each leg at 35°."""
    cases = {leg: sped_up(benchmark.case_at(library, leg).scenario) for leg in LEGS}
    found = {}
    with tempfile.TemporaryDirectory() as passing:
        for number, (leg, scenario) in enumerate(cases.items()):

            def tell(fraction: float, number: int = number) -> None:
                progress(number + fraction, len(LEGS))

            kept = place or Path(passing)
            found[leg] = scenario, moments(scenario, SNAPSHOTS_DEG, kept, progress=tell)
    return found


def sped_up(scenario: Scenario) -> Scenario:
    """A scenario as it is simulated for the snapshots: not slower than sped up ten times."""
    factor = max(scenario.numerics.speed_up, SNAPSHOT_SPEED_UP)
    return scenario.replace(**{"numerics.speed_up": factor})
