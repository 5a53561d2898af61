"""The report of a slope map: its sentences, what it rests on, and its picture."""

from __future__ import annotations

import json
from pathlib import Path

from terraphi.experiment.errors import InputError
from terraphi.terrain.map import KIND, SUMMARY, in_words
from terraphi.terrain.slopes import QUANTITIES
from terraphi.view.report.parts import Section, Text, pairs
from terraphi.view.report.study import pictures
from terraphi.view.table import Table

WORTH = (
    "A foot probes the uppermost centimetres, and slopes fail at metres: this map takes the "
    "friction angle of the surface for that of the layer. It shows which slopes come first, and is "
    "no forecast of slides."
)


def section(folder: Path) -> Section:
    """Report of the folder of ``terraphi map --out``; raises InputError if it is none."""
    try:
        told = json.loads(folder.joinpath(SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{folder / SUMMARY}: not the summary of a slope map") from error
    if told.get("terraphi_file") != KIND:
        raise InputError(f"{folder / SUMMARY}: not the summary of a slope map")
    points, area, *rest = in_words(told)
    priors = [
        (QUANTITIES[key].about, key, ", ".join(f"{k} {v}" for k, v in one.items()))
        for key, one in told["priors"].items()
    ]
    shown = ("crs", "cells", "cell_m", "field", "wetness", "covariate", "draws", "seed", "seconds")
    return Section(
        kind="slope map",
        title=folder.resolve().name,
        headline=area,
        reason=points,
        parts=[
            Text("What it is worth", (*rest, WORTH)),
            *pictures(folder, "Maps"),
            Table("What was not measured", ("", "key", "prior"), priors),
            Table("The map", ("", ""), pairs({key: told[key] for key in shown})),
        ],
        provenance={key: told[key] for key in ("points", "dem", "terraphi")},
    )
