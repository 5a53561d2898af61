"""Shipped libraries: those that an inversion can use, with their legs, and what goes with them.

A library that is there for another is named after it, ``LIBRARY-ROLE``, by the roles of
:data:`COMPANIONS`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.documents import shipped_file, shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.leg import LEG_SHAPES
from terraphi.library.store import Library, kinds_in

FEWEST_ANGLES = 3
"""Friction angles that an inversion needs."""
COMPANIONS = {
    "truths": "fresh simulations of known friction angle",
    "random": "the same, of angles drawn at random",
    "seeds": "some of its cases under other particle seeds",
    "legs": "the legs that the library lacks, at the benchmark's friction angle",
    "jaky": "one of a pair: K0 = 1 - sin φ",
    "half": "the other: K0 = 0.5",
    "raised": "some of its cases with the hip higher above the soil",
    "friction": "some of its cases with a smoother and a rougher leg",
}
"""Roles of shipped libraries that are there for others, however many angles they have."""
TRY_OTHERS = re.compile(rf"-({'|'.join(COMPANIONS)}|cells-\d+|speed-up)$")
"""How the names of libraries end that are there for others: by such a role, or finer cases."""
WIDEST_STEP_DEG = 5.0
"""Step between friction angles above which a library is there to test others [deg]."""


@cache
def offered() -> Mapping[str, frozenset[str]]:
    """Shipped libraries that can be inverted with, and the legs that each can do so for."""
    found = {
        name: legs_of(shipped_file("libraries", name, ".nc"))
        for name in shipped_names("libraries", ".nc")
        if not TRY_OTHERS.search(name)
    }
    return {name: legs for name, legs in found.items() if legs}


def is_there_to_try_others(name: str) -> bool:
    """Whether a shipped library could be inverted with, but is there to try others."""
    return bool(TRY_OTHERS.search(name)) and name in shipped_names("libraries", ".nc")


def has_companion(library: str, role: str) -> bool:
    """Whether a library in some role for another is shipped, or planned: its plan is."""
    name = f"{library}-{role}"
    return name in shipped_names("libraries", ".nc") or name in shipped_names("plans", ".toml")


def companion(library: str, role: str) -> Library:
    """The shipped library in some role for another.

    Parameters
    ----------
    library
        Name of the other; of a pair, what their names begin with.
    role
        Of :data:`COMPANIONS`.

    Returns
    -------
    Library

    Raises
    ------
    InputError
        If there is none, or it is not simulated yet.
    """
    if not has_companion(library, role):
        ending = f"-{role}"
        shipped = shipped_names("libraries", ".nc")
        known = [name.removesuffix(ending) for name in shipped if name.endswith(ending)]
        raise InputError(
            f"library '{library}': no '{library}{ending}' is shipped, which this study needs; "
            f"those that have one: {', '.join(known)}"
        )
    return Library.load(f"{library}-{role}")


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
        own = kinds_in(data).count(0)
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
