"""Forces against the friction angle: the histories of a library and their peaks.

An inversion needs forces that tell one friction angle from the next: peaks that rise with it, and
at every leg angle a force that moves one way.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from terraphi.experiment.history import ForceHistory
from terraphi.library.store import Library
from terraphi.view.table import Table
from terraphi_studies import PAPER_LIBRARY, Beside, Study, capitalised
from terraphi_studies.degrees import LEG, histories_of
from terraphi_studies.measures import (
    FORCES,
    PAPER_ANGLES_DEG,
    PAPER_PEAKS_N,
    engagement_beside_paper,
    engagement_deg,
    peaks_beside_paper,
)
from terraphi_studies.pictures import histories_figure, peaks_figure

ANOTHER_ANGLE = "Not beside the paper's forces, whose friction angles mean something else."
COLUMNS = (
    ("φ", "{phi:g}°"),
    ("peak Fz", "{peak.Fz:.2f} N at {peak.theta_Fz_deg:.0f}°"),
    ("peak Fx", "{peak.Fx:.2f} N at {peak.theta_Fx_deg:.0f}°"),
)


def run(*, library: str = PAPER_LIBRARY) -> Study:
    """Peaks of the straight leg's histories over the friction angle.

    Parameters
    ----------
    library
        Name or file of a library with the straight leg.

    Returns
    -------
    Study
        ``data``: ``library``, ``yield``, ``phi_deg``; ``peak_Fz_N``, ``peak_Fx_N``,
        ``theta_peak_Fz_deg``, ``theta_peak_Fx_deg``, ``theta_engages_deg``, a value for each;
        ``peaks_increase`` by force; ``share_of_angles_monotone`` by force: of the 40 leg angles,
        how many have a force that moves one way as the friction angle grows. Two figures.

    Raises
    ------
    InputError
        If the library has no straight leg.
    """
    found = Library.load(library)
    histories = histories_of(found)
    peaks = [history.peaks() for history in histories.values()]
    convention = found.cases[0].scenario.convention
    data: dict[str, Any] = {"library": library, "yield": convention, "phi_deg": list(histories)}
    for force in FORCES:
        data[f"peak_{force}_N"] = [getattr(peak, force) for peak in peaks]
        data[f"theta_peak_{force}_deg"] = [getattr(peak, f"theta_{force}_deg") for peak in peaks]
    data["theta_engages_deg"] = [engagement_deg(history) for history in histories.values()]
    data["peaks_increase"] = {
        force: bool(np.all(np.diff(data[f"peak_{force}_N"]) > 0.0)) for force in FORCES
    }
    data["share_of_angles_monotone"] = {
        force: _share_monotone(list(histories.values()), force) for force in FORCES
    }
    comparable = convention == "paper"
    return Study(
        table=Table.of(
            f"Peak forces against φ ({convention}), leg {LEG}, library '{library}'",
            COLUMNS,
            [{"phi": phi, "peak": peak} for phi, peak in zip(histories, peaks, strict=True)],
        ),
        data=data,
        figures={
            "forces": histories_figure(histories, convention),
            "peaks": peaks_figure(
                data, *((PAPER_PEAKS_N, PAPER_ANGLES_DEG) if comparable else ({}, {}))
            ),
        },
        notes=[_monotone(data), *([] if comparable else [ANOTHER_ANGLE])],
        beside_paper=_beside_paper(data) if comparable else (),
    )


def _share_monotone(histories: list[ForceHistory], force: str) -> float:
    """Share of the 40 leg angles at which a force moves one way with the friction angle [-]."""
    seen = [history.observation() for history in histories]
    steps = np.diff(np.stack([o.Fx if force == "Fx" else o.Fz for o in seen]), axis=0)
    return float(np.mean(np.all(steps > 0.0, axis=0) | np.all(steps < 0.0, axis=0)))


def _monotone(data: dict[str, Any]) -> str:
    words = [
        f"the peak of {force} {'rises' if data['peaks_increase'][force] else 'does not rise'} with "
        f"φ throughout, and {force} itself moves one way at "
        f"{data['share_of_angles_monotone'][force]:.0%} of the leg angles"
        for force in FORCES
    ]
    return f"{capitalised('; '.join(words))}."


def _beside_paper(data: dict[str, Any]) -> list[Beside]:
    lines = [
        peaks_beside_paper(phi, {force: data[f"peak_{force}_N"][i] for force in FORCES})
        for i, phi in enumerate(data["phi_deg"])
        if phi in PAPER_PEAKS_N
    ]
    ours = [f"{np.median(data[f'theta_peak_{force}_deg']):.0f}" for force in FORCES]
    paper = [f"{PAPER_ANGLES_DEG[force]:.0f}" for force in FORCES]
    what = "leg angle of the peaks Fz / Fx (ours: median)"
    return [
        *lines,
        (what, f"{' / '.join(ours)}°", f"about {' / '.join(paper)}°"),
        engagement_beside_paper(data["theta_engages_deg"]),
    ]
