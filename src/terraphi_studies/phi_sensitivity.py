"""Forces against the friction angle: the histories of a library and their peaks.

An inversion needs forces that tell one friction angle from the next: peaks that rise with it, and
at every leg angle a force that moves one way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.history import ForceHistory
from terraphi.library.store import Library
from terraphi.view.table import Table
from terraphi_studies import PAPER_LIBRARY, Beside, Study, capitalised
from terraphi_studies.degrees import LEG, histories_of
from terraphi_studies.pictures import histories_figure, peaks_figure
from terraphi_studies.reading import (
    PAPER_ANGLES_DEG,
    PAPER_ENGAGEMENT_DEG,
    PAPER_PEAKS_N,
    engagement_deg,
)

FloatArray = NDArray[np.float64]

ANOTHER_ANGLE = "Not beside the paper's forces, whose friction angles mean something else."


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
    phi = np.array(list(histories))
    peaks = [history.peaks() for history in histories.values()]
    data = {
        "library": library,
        "yield": found.cases[0].scenario.convention,
        "phi_deg": phi.tolist(),
        "peak_Fz_N": [peak.Fz for peak in peaks],
        "peak_Fx_N": [peak.Fx for peak in peaks],
        "theta_peak_Fz_deg": [peak.theta_Fz_deg for peak in peaks],
        "theta_peak_Fx_deg": [peak.theta_Fx_deg for peak in peaks],
        "theta_engages_deg": [engagement_deg(history) for history in histories.values()],
    }
    data["peaks_increase"] = {
        force: bool(np.all(np.diff(data[f"peak_{force}_N"]) > 0.0)) for force in ("Fz", "Fx")
    }
    data["share_of_angles_monotone"] = {
        force: _share_monotone(list(histories.values()), force) for force in ("Fz", "Fx")
    }
    comparable = data["yield"] == "paper"
    return Study(
        table=Table(
            f"Peak forces against φ ({data['yield']}), leg {LEG}, library '{library}'",
            ("φ", "peak Fz", "peak Fx"),
            [
                (
                    f"{angle:g}°",
                    f"{peak.Fz:.2f} N at {peak.theta_Fz_deg:.0f}°",
                    f"{peak.Fx:.2f} N at {peak.theta_Fx_deg:.0f}°",
                )
                for angle, peak in zip(phi, peaks, strict=True)
            ],
        ),
        data=data,
        figures={
            "forces": histories_figure(histories, data["yield"]),
            "peaks": peaks_figure(
                data,
                PAPER_PEAKS_N if comparable else {},
                PAPER_ANGLES_DEG if comparable else {},
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


def _monotone(data: dict[str, object]) -> str:
    rises, shares = data["peaks_increase"], data["share_of_angles_monotone"]
    assert isinstance(rises, dict)
    assert isinstance(shares, dict)
    words = [
        f"the peak of {force} {'rises' if rises[force] else 'does not rise'} with φ throughout, "
        f"and {force} itself moves one way at {shares[force]:.0%} of the leg angles"
        for force in ("Fz", "Fx")
    ]
    return f"{capitalised('; '.join(words))}."


def _beside_paper(data: dict[str, list[float]]) -> list[Beside]:
    lines: list[Beside] = []
    for phi, printed in PAPER_PEAKS_N.items():
        if phi not in data["phi_deg"]:
            continue
        i = data["phi_deg"].index(phi)
        ours = f"{data['peak_Fz_N'][i]:.1f} / {data['peak_Fx_N'][i]:.1f} N"
        paper = f"{printed['Fz']:.1f} / {printed['Fx']:.1f} N"
        lines.append((f"peaks Fz / Fx at {phi:g}°", ours, paper))
    angles = [np.median(data[f"theta_peak_{force}_deg"]) for force in ("Fz", "Fx")]
    lines.append(
        (
            "leg angle of the peaks Fz / Fx (ours: median)",
            f"{angles[0]:.0f} / {angles[1]:.0f}°",
            f"about {PAPER_ANGLES_DEG['Fz']:.0f} / {PAPER_ANGLES_DEG['Fx']:.0f}°",
        )
    )
    engages = np.median(data["theta_engages_deg"])
    lines.append(
        (
            "leg angle of first resistance (ours: median)",
            f"{engages:.0f}°",
            f"about {PAPER_ENGAGEMENT_DEG:.0f}°",
        )
    )
    return lines
