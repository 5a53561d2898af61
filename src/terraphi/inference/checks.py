"""What an inversion refuses, before it computes anything."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from terraphi.errors import InputError
from terraphi.history import ForceHistory, Observation
from terraphi.scenario import Scenario

DENSITIES = (100.0, 10000.0)
"""Bulk densities that are accepted [kg/m³]; 1.6 is one in g/cm³."""
FORCES = (1e-4, 1e5)
"""Peak forces that are accepted [N]."""
FREE = {"name", "soil.friction_angle_deg", "soil.density", "numerics.seed"}
"""Keys in which a simulated history may differ from the library."""
IDLE = {"mpm": ("rft.",), "rft": ("numerics.", "relief.", "bed.", "soil.")}
"""Sections that a forward model does not read."""
TOLD = 4
"""Differences that are named."""


def check_magnitudes(density: float | None, observation: Observation, scenario: Scenario) -> None:
    """Refuse numbers that can only be in another unit, and scaling where it does not hold."""
    low, high = DENSITIES
    if density is not None and not low <= density <= high:
        raise InputError(
            f"density = {density:g} kg/m³ is not that of a soil; {low:g} to {high:g} kg/m³ is "
            "accepted"
        )
    if density not in (None, scenario.soil.density) and scenario.soil.cohesion > 0.0:
        raise InputError(
            f"density = {density:g} kg/m³: the library's soil has cohesion and a density of "
            f"{scenario.soil.density:g} kg/m³, and its forces are not proportional to the density"
        )
    for name, force in (("Fx", observation.Fx), ("Fz", observation.Fz)):
        # Exact equality would be lost to the rounding of the window means.
        if np.ptp(force) <= 1e-9 * np.abs(force).max():
            raise InputError(f"{name} is {force[0]:g} N at every angle; is the sensor connected?")
    low, high = FORCES
    peak = float(np.abs(observation.vector).max())
    if not low <= peak <= high:
        raise InputError(
            f"the largest mean force is {peak:g} N; {low:g} to {high:g} N is accepted: are the "
            "forces in newtons?"
        )


def unlike(history: ForceHistory, scenario: Scenario, leg: str) -> str:
    """A sentence on how a simulated history differs from the library; empty if it does not.

    The friction angle is what is asked for, forces are scaled by the density, and seeds are to
    differ; all else makes the library another model than the one that the history is of.

    Parameters
    ----------
    history
        Forces; it carries its scenario if we simulated it.
    scenario
        Any of the library's for this leg.
    leg
        Shape of the leg that the history is inverted as.
    """
    if "scenario" not in history.provenance:
        return ""
    made_by = Scenario.model_validate(history.provenance["scenario"])
    expected = scenario.replace(**{"leg.shape": leg})
    if made_by.model != expected.model:
        differences = [f"model = {made_by.model} ({expected.model})"]
    else:
        own, other = (dict(_flat(s.model_dump(mode="json"))) for s in (made_by, expected))
        idle = IDLE[made_by.model]
        differences = [
            f"{key} = {_word(own.get(key))} ({_word(other.get(key))})"
            for key in {**other, **own}
            if key not in FREE and not key.startswith(idle) and own.get(key) != other.get(key)
        ]
    if not differences:
        return ""
    told, rest = differences[:TOLD], len(differences) - TOLD
    if rest > 0:
        told.append(f"{rest} more")
    listed = told[0] if len(told) == 1 else f"{', '.join(told[:-1])} and {told[-1]}"
    return (
        "The history was not simulated as the library was (the library's in brackets): "
        f"{listed}; so the angle found is not the one that it was simulated with."
    )


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and their values."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _word(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def check_same_setup(history: ForceHistory, scenario: Scenario) -> None:
    """Refuse a simulated history of a leg or hip unlike the library's."""
    if "scenario" not in history.provenance:
        return
    made_by = Scenario.model_validate(history.provenance["scenario"])
    for name, found, expected in (
        ("leg.chord", made_by.leg.chord, scenario.leg.chord),
        ("leg.width", made_by.leg.width, scenario.leg.width),
        ("leg.half_thickness", made_by.leg.half_thickness, scenario.leg.half_thickness),
        ("hip above the surface", made_by.hip_height, scenario.hip_height),
    ):
        if abs(found - expected) > 1e-6:
            raise InputError(
                f"the history was simulated with {name} = {found:g} m, the library with "
                f"{expected:g} m; build a library for this setup"
            )
