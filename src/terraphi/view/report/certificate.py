"""The certificate of a library: how often its intervals held the truth when that was tried."""

from __future__ import annotations

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
WITHOUT_REPLICATES = (
    " No replicates of {legs}: what particle seeds do to a force is guessed from the curves, in "
    "these worlds too, and intervals of other simulations may be too narrow."
)


def certificate_parts(library: Library, *, leg: str | None = None) -> list[Part]:
    """What a page says of a library's certificate.

    Parameters
    ----------
    library
        The library.
    leg
        Only this one; all if not given.
    """
    known = library.certificate
    chosen = {name: found for name, found in known.items() if leg in (None, name)}
    title = f"Certificate of library {library.name}"
    if not chosen:
        none = (
            "None in its file: nobody has tried yet how often the intervals from this library "
            "hold the truth."
        )
        return [Text(title, (none,), wide=False)]
    guessed = [leg for leg in chosen if library.guesses_scatter(leg)]
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
                + (WITHOUT_REPLICATES.format(legs=", ".join(guessed)) if guessed else "")
            ),
        )
    ]
