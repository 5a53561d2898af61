"""Verdicts on legs and tools alike: whether φ is in the range of a law, and the residual usual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from terraphi.inference.answer import Edge, RecordFit, Verdict, worst_nrmsd

USUAL_DEG = (18.0, 50.0)
"""Friction angles of dry soils in plane strain [deg]: from glass beads, 21 to 24° (Jop, Forterre &
Pouliquen 2006, Nature 441:727), to dense quartz sand at its peak, 48° (Bolton 1986, Géotechnique
36:65, table 1, whose critical angles are about 30 to 37°)."""
LITTLE_KNOWN = "The forces carry almost no information on φ: the posterior equals the prior."
Judgment = tuple[Verdict, str, Edge | None]
"""Verdict, its reason in a sentence or more, and the end of the law beyond which φ lies."""


def out_of_range(
    law: str, edge: Edge, end_deg: float, advice: str = "", what: str = ""
) -> Judgment:
    """Verdict on φ beyond an end of a law [deg], or beyond what else limits the answer."""
    where, end = ("below", "lower") if edge == "low" else ("above", "upper")
    reason = f"Out of range: φ lies {where} {end_deg:.0f}°, {what or f'the {end} end of law {law}'}"
    return "out_of_range", f"{reason}{f'; {advice}' if advice else ''}.", edge


def misfit(why: str) -> Judgment:
    """Verdict on a record that no angle describes."""
    return "misfit", f"Misfit: {why} Do not use the angle.", None


def large_residual(fits: Sequence[RecordFit], origin: str) -> Judgment | None:
    """Verdict on the first record whose residual exceeds its limit; ``None`` if there is none.

    ``origin`` names what the limit was found by.
    """
    for fit in fits:
        sizes = np.array([*fit.nrmsd.values()])
        if fit.limit is None or sizes.max() <= fit.limit:
            continue
        residual = fit.data - fit.curve
        rms = np.sqrt(np.square(residual).mean(axis=1))
        residual *= (sizes / np.maximum(rms, 1e-300))[:, None]
        i, j = np.unravel_index(np.abs(residual).argmax(), residual.shape)
        largest = residual[i, j]
        shown = f"{100.0 * largest:+.0f} % of" if abs(largest) < 2.0 else f"{largest:+.1f} times"
        return misfit(
            f"{[*fit.nrmsd][i]} differs from the model by {shown} its range "
            f"{fit.place(int(j))}. The residual is {100.0 * sizes.max():.1f} %; the limit "
            f"is {100.0 * fit.limit:.1f} %, from {origin}."
        )
    return None


def consistent(fits: Sequence[RecordFit], usual: str) -> Judgment:
    """Verdict on records whose residuals are usual for some soils."""
    sizes = " and ".join(
        f"{n} within {100.0 * size:.0f} %" for n, size in worst_nrmsd(fits).items()
    )
    reason = f"Consistent: the model follows {sizes} of the range, usual for {usual}."
    return "consistent", reason, None


def unusual(phi_deg: float, body: str) -> list[str]:
    """Warn of an angle in plane strain that few dry soils have [deg], read by a leg or a tool."""
    low, high = USUAL_DEG
    if low <= phi_deg <= high:
        return []
    sentence = f"φ = {phi_deg:.0f}° is unusual for dry soil ({low:g} to {high:g}°)"
    return [f"{sentence}: check the density, the unit of force and the {body}."]
