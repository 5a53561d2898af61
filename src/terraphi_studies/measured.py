"""Measured: what each library makes of each measured history, and whether the verdict owns up.

Nothing is tuned to a medium: every history of the same sand should give the same φ, whatever the
leg, and media whose angles of repose differ should come out in that order. An angle of repose is a
guide to the friction angle, not its truth (dense sand dilates, seeds interlock), so that an offset
from it is reported and not judged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from terraphi.experiment.documents import shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.measurements import measurement, names
from terraphi.inference.inversion import invert
from terraphi.inference.verdict import uninformed
from terraphi.library.store import Library
from terraphi.view.table import Table
from terraphi_studies import Progress, Study, page, steps
from terraphi_studies.measures import answer_of
from terraphi_studies.pictures import measured_figure

NAME = "measured"
TITLE = "Friction angles of the measured sands, by library and leg"
LIBRARIES = (
    "resolved",
    "resolved-2",
    "k4-plane-strain",
    "quick-plane-strain",
    "paper",
    "quick-paper",
    "rft3d",
    "sand3d",
)
"""Libraries to invert with, as far as they are shipped."""
COLUMNS = (
    ("library", "{library}"),
    ("medium", "{medium}"),
    ("leg", "{leg}"),
    ("φ [deg]", "{phi_median_deg:.1f} ({yield})"),
    ("95 %", "{ci95_deg[0]:.1f} to {ci95_deg[1]:.1f}"),
    ("NRMSD Fz", "{nrmsd_percent[Fz]:.0f} %"),
    ("NRMSD Fx", "{nrmsd_percent[Fx]:.0f} %"),
    ("verdict", lambda a: a["verdict"] + ("" if a["told_by_forces"] else ", hardly tells φ")),
)
METHOD = (
    "`terraphi invert` on every shipped measurement of Li et al. (2013) with every library, each "
    "in its own convention of φ. `resolved`, `resolved-2` and `sand3d` have learnt from these very "
    "media how real soils deviate from them; `terraphi study real_soil` leaves out the one that is "
    "tried. NRMSD: of the fit at the median, in percent of the measured peak-to-peak. Run again: "
    "`terraphi study measured`."
)
PICTURE = "friction angles by medium, leg and library, with their 95 % intervals"

Answers = Sequence[Mapping[str, Any]]


def run(*, library: str | None = None, progress: Progress | None = None) -> Study:
    """Invert all shipped measurements.

    Parameters
    ----------
    library
        Name or file of the one library to use; all of :data:`LIBRARIES` if not given.
    progress
        Called with the number of inversions done and of all.

    Returns
    -------
    Study
        ``data``: ``answers`` (list of ``library``, ``yield``, ``medium``, ``leg``,
        ``phi_median_deg``, ``told_by_forces``, ``ci95_deg``, ``phi_plane_strain_deg``,
        ``nrmsd_percent``, ``verdict``, ``reason``, ``angle_of_repose_deg``), ``spread_deg``
        between legs by library and medium, where there are several, ``verdicts`` by library, and
        for the media with an angle of repose ``order`` and ``off_repose_deg``, the least and the
        largest offset of a median from it by library, of its equivalent in plane strain where
        there is one.

    Raises
    ------
    InputError
        If a library cannot be used.
    """
    shipped = shipped_names("libraries", ".nc")
    chosen = [library] if library else [name for name in LIBRARIES if name in shipped]
    loaded = {name: Library.load(name) for name in chosen}
    wanted = [(name, measurement(source)) for name in chosen for source in names()]
    answers: list[dict[str, Any]] = []
    step = steps(len(wanted), progress)
    for name, one in map(step, wanted):
        if any(case.scenario.leg.shape == one.leg for case in loaded[name].cases):
            found = invert(
                one.history,
                library=loaded[name],
                leg=one.leg,
                density=one.density_kg_m3,
                density_assumed=one.density_assumed,
                source=one.name,
            )
            answers.append(
                {
                    **answer_of(one, found),
                    "library": name,
                    "told_by_forces": not uninformed(found.posterior),
                    "nrmsd_percent": {f: 100.0 * v for f, v in found.record.nrmsd.items()},
                    "reason": found.reason,
                }
            )
    if not answers:
        raise InputError(f"library '{library}' has none of the measured legs")
    return _study(answers)


def _study(answers: Answers) -> Study:
    libraries = dict.fromkeys(answer["library"] for answer in answers)
    of = {name: [a for a in answers if a["library"] == name] for name in libraries}
    data = {
        "answers": list(answers),
        "spread_deg": {name: _spread(some) for name, some in of.items()},
        "verdicts": {name: Counter(sorted(a["verdict"] for a in s)) for name, s in of.items()},
        "order": {name: _order(some) for name, some in of.items()},
        "off_repose_deg": {name: _off_repose(some) for name, some in of.items()},
    }
    repose = {
        a["medium"]: f"{a['medium']} {a['angle_of_repose_deg']:g}°"
        for a in answers
        if a["angle_of_repose_deg"] is not None
    }
    notes = [f"Angle of repose: {', '.join(repose.values())}."] if repose else []
    notes += [f"{name}: {_note(name, some, data)}." for name, some in of.items()]
    table = Table.of(TITLE, COLUMNS, answers)
    return Study(
        table=table,
        data=data,
        figures={NAME: measured_figure(answers)},
        documents=page(NAME, table, METHOD, notes, PICTURE),
        notes=notes,
    )


def _spread(answers: Answers) -> dict[str, float]:
    """Largest less smallest median between the legs, by medium that has several [deg]."""
    media = dict.fromkeys(answer["medium"] for answer in answers)
    found = {m: [a["phi_median_deg"] for a in answers if a["medium"] == m] for m in media}
    return {medium: float(np.ptp(values)) for medium, values in found.items() if len(values) > 1}


def _of_known_repose(answers: Answers) -> list[Mapping[str, Any]]:
    return [a for a in answers if a["angle_of_repose_deg"] is not None]


def _order(answers: Answers) -> dict[str, int]:
    """Pairs of media on one leg whose φ come out in the order of their angles of repose, or not."""
    pairs = [
        (a["angle_of_repose_deg"] - b["angle_of_repose_deg"])
        * (a["phi_median_deg"] - b["phi_median_deg"])
        for a, b in combinations(_of_known_repose(answers), 2)
        if a["leg"] == b["leg"] and a["angle_of_repose_deg"] != b["angle_of_repose_deg"]
    ]
    return {"right": sum(p > 0.0 for p in pairs), "of": len(pairs)}


def _off_repose(answers: Answers) -> list[float]:
    """Least and largest offset of a median from the angle of repose [deg]; empty if none has one.

    Of the equivalents in plane strain, which are what soil mechanics means by φ, if there are any.
    """
    known = _of_known_repose(answers)
    acting = [a for a in known if a["phi_plane_strain_deg"] is not None]
    key = "phi_plane_strain_deg" if acting else "phi_median_deg"
    found = [a[key] - a["angle_of_repose_deg"] for a in acting or known]
    return [min(found), max(found)] if found else []


def _note(library: str, answers: Answers, data: Mapping[str, Any]) -> str:
    """What a library's answers come to."""
    verdicts, spread, order, off = (
        data[key][library] for key in ("verdicts", "spread_deg", "order", "off_repose_deg")
    )
    said = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
    if spread:
        apart = ", ".join(f"{medium} {value:.1f}" for medium, value in spread.items())
        said += f"; medians of the legs lie apart by [deg] {apart}"
    if order["of"]:
        said += (
            f"; {order['right']} of {order['of']} pairs of media on one leg come out in the order "
            "of their angles of repose"
        )
    blind = sum(not answer["told_by_forces"] for answer in answers)
    if blind:
        said += f"; in {blind} of {len(answers)}, counted all the same, the forces hardly tell φ"
    if off:
        converted = answers[0]["yield"] != "plane_strain" and any(
            a["phi_plane_strain_deg"] is not None for a in answers
        )
        acting = ", as they act in plane strain," if converted else ""
        said += (
            f"; the medians{acting} lie {off[0]:+z.0f} to {off[1]:+z.0f}° off the angle of repose"
        )
    return said
