"""The certificate of a library: how often its intervals held the truth when that was tried."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from terraphi.library.store import Library
from terraphi.view.report.parts import Part, Text, number
from terraphi.view.table import Table

WORDS = {
    "replicates": "worlds tried",
    "mean_rank": "mean rank of the truth (0.5: unbiased)",
    "coverage68": "truths inside the 68 % interval [-]",
    "coverage95": "truths inside the 95 % interval [-]",
    "rank_chi2_p": "p of uniform ranks (χ²)",
    "ci68_half_width_deg": "median half-width of the 68 % interval [deg]",
    "abs_error_deg": "median error [deg]",
}


def certificate_of(library: Library) -> Mapping[str, Mapping[str, Any]]:
    """Coverage by leg from a library's certificate; empty if the library has none."""
    calibration = getattr(library, "calibration", None)
    if not isinstance(calibration, Mapping):
        return {}
    certificate = calibration.get("certificate")
    legs = certificate.get("legs") if isinstance(certificate, Mapping) else None
    if not isinstance(legs, Mapping):
        return {}
    return {str(leg): found for leg, found in legs.items() if isinstance(found, Mapping)}


def certificate_parts(library: Library, *, leg: str | None = None) -> list[Part]:
    """What a page says of a library's certificate.

    Parameters
    ----------
    library
        The library.
    leg
        Only this one; all if not given.
    """
    known = certificate_of(library)
    chosen = {name: found for name, found in known.items() if leg in (None, name)}
    title = f"Certificate of library {library.name}"
    if not chosen:
        none = (
            "None in its file: nobody has tried yet how often the intervals from this library "
            "hold the truth."
        )
        return [Text(title, (none,), wide=False)]
    names = list(dict.fromkeys(key for found in chosen.values() for key in found))
    rows = [
        (WORDS.get(key, key), *(number(found.get(key), 3) for found in chosen.values()))
        for key in names
    ]
    return [
        Table(
            title,
            ("", *chosen),
            rows,
            note=(
                "Simulated worlds with a truth of their own, inverted with this library under the "
                "calibrated likelihood; a sound interval holds the truth as often as its name says."
            ),
        )
    ]
