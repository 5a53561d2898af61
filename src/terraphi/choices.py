"""Shipped libraries that an inversion can use, and their legs; others are there to try those."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.documents import shipped_file, shipped_names
from terraphi.leg import LEG_SHAPES
from terraphi.library import replicates_in

FEWEST_ANGLES = 3
"""Friction angles that an inversion needs."""
TRY_OTHERS = ("-truths", "-jaky", "-half")
"""Endings of the names of shipped libraries that are there to try others, however many angles."""
WIDEST_STEP_DEG = 5.0
"""Step between friction angles above which a library is there to test others [deg]."""


@cache
def offered() -> Mapping[str, frozenset[str]]:
    """Shipped libraries that can be inverted with, and the legs that each can do so for."""
    found = {
        name: legs_of(shipped_file("libraries", name, ".nc"))
        for name in shipped_names("libraries", ".nc")
        if not name.endswith(TRY_OTHERS)
    }
    return {name: legs for name, legs in found.items() if legs}


def there_to_try_others(name: str) -> list[str]:
    """A remark if a shipped library could be inverted with, and is there to try others."""
    if name.endswith(TRY_OTHERS) and name in shipped_names("libraries", ".nc"):
        return [f"Library '{name}' is shipped to try others, not to invert with."]
    return []


def offered_legs() -> list[str]:
    """Legs that some offered library has."""
    some = frozenset[str]().union(*offered().values())
    return [leg for leg in LEG_SHAPES if leg in some]


def legs_of(path: Path) -> frozenset[str]:
    """Legs for which a library has a grid of friction angles, each once and nothing else varied.

    Only the scenarios are read, which is quick. Replicates of a library and variants with a few
    angles far apart can be told by their angles: they are no grid.

    Parameters
    ----------
    path
        The library.
    """
    import xarray as xr

    with xr.open_dataset(path, engine="h5netcdf") as data:
        failures = data["failure"].values.tolist()
        own = len(failures) - replicates_in(data)
        scenarios = [json.loads(str(text)) for text in data["scenario"].values]
        sample = json.loads(str(data.attrs["plan"])).get("sample")
    if sample and len(sample.get("keys", ())) > 1:
        return frozenset()
    whole = [s for s, failure in list(zip(scenarios, failures, strict=True))[:own] if not failure]
    by_leg: dict[str, list[dict[str, Any]]] = {}
    for scenario in whole:
        by_leg.setdefault(str(scenario["leg"]["shape"]), []).append(scenario)
    return frozenset(leg for leg, cases in by_leg.items() if _is_grid(cases))


def _is_grid(cases: list[dict[str, Any]]) -> bool:
    """Whether simulations of one leg are rotations over friction angles, each once and close."""
    first = cases[0]
    has_angle = (first["model"], first["dimensions"]) != ("rft", 2)
    steps = np.diff(sorted(case["soil"]["friction_angle_deg"] for case in cases))
    rest = [
        case
        | {
            "name": "",
            "soil": case["soil"] | {"friction_angle_deg": 0.0},
            "numerics": case["numerics"] | {"seed": 0},
        }
        for case in cases
    ]
    return bool(
        has_angle
        and first["motion"]["kind"] == "rotation"
        and len(cases) >= FEWEST_ANGLES
        and all(case == rest[0] for case in rest)
        and steps.min() > 0.0
        and steps.max() <= WIDEST_STEP_DEG
    )
