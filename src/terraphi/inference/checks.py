"""What an inversion refuses, before it computes anything."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory, Observation
from terraphi.experiment.scenario import Scenario
from terraphi.inference.findings import Doubt

DENSITIES = (100.0, 10000.0)
"""Bulk densities that are accepted [kg/m³]; 1.6 is one in g/cm³."""
FORCES = (1e-4, 1e5)
"""Peak forces that are accepted [N]."""
OUT_OF_SCALE = 5.0
"""Peak force over the largest of the library, or that of its smallest over it, above which its unit
is asked about [-]."""
TURNED = -0.5
"""Correlation of a force with the library's mean curve below which its sign is asked about [-]."""
FREE = {"name", "soil.friction_angle_deg", "soil.density", "numerics.seed"}
"""Keys in which a simulated history may differ from the library."""
IDLE = {"mpm": ("rft.",), "rft": ("numerics.", "relief.", "bed.", "soil.")}
"""Sections that a forward model does not read, but for what is in ``READ``."""
READ = {"mpm": (), "rft": ("bed.gravity",)}
"""Keys of such sections that it does read."""
HIP = "hip above the surface"


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


def unlike(
    history: ForceHistory, scenario: Scenario, leg: str, *, varied: Iterable[str] = ()
) -> Doubt | None:
    """How a simulated history differs from the library; ``None`` if it does not.

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
    varied
        Further keys in which it may differ: those that the library varies.
    """
    made_by = scenario_of(history)
    if made_by is None:
        return None
    expected = scenario.replace(**{"leg.shape": leg})
    if made_by.model != expected.model:
        differences: list[tuple[str, Any, Any]] = [("model", made_by.model, expected.model)]
    else:
        own, other = (dict(_flat(s.model_dump(mode="json"))) for s in (made_by, expected))
        idle, read = IDLE[made_by.model], READ[made_by.model]
        free = FREE.union(varied)
        differences = [
            (key, own.get(key), other.get(key))
            for key in {**other, **own}
            if key not in free
            and (key in read or not key.startswith(idle))
            and own.get(key) != other.get(key)
        ]
    return Doubt("unlike", {"differences": differences}) if differences else None


def doubts(
    history: ForceHistory,
    observation: Observation,
    curves: NDArray[np.float64],
    density: float | None,
    *,
    asked: bool = False,
) -> list[Doubt]:
    """What is likely to be a slip: of units, of signs, or of the density.

    Parameters
    ----------
    history
        Forces; it carries its scenario if we simulated it.
    observation
        Its window means.
    curves
        The library's, at that density [N], shape [case, 2 theta].
    density
        With which the history is inverted [kg/m³]; ``None`` if it is inferred.
    asked
        Whether a slip of units or signs that explains the history is asked about already.
    """
    found = [] if asked else _slips(observation, curves)
    made_by = scenario_of(history)
    how = "simulated with" if made_by else "measured at"
    own = made_by.soil.density if made_by else history.provenance.get("density_kg_m3")
    if density and own and abs(own - density) > 1e-6 * density:
        found.append(Doubt("other_density", {"made": how, "own": own, "used": density}))
    return found


def _slips(observation: Observation, curves: NDArray[np.float64]) -> list[Doubt]:
    """Questions on units and signs."""
    found = []
    names, measured = ("Fx", "Fz"), observation.vector.reshape(2, -1)
    library = curves.reshape(len(curves), 2, -1)
    peak, peaks = np.abs(measured).max(), np.abs(library).max(axis=(1, 2))
    for code, ratio in (("too_large", peak / peaks.max()), ("too_small", peaks.min() / peak)):
        if ratio > OUT_OF_SCALE:
            found.append(Doubt(code, {"peak_N": float(peak), "ratio": float(ratio)}))
    for name, force, own in zip(names, measured, library.mean(axis=0), strict=True):
        correlation = float(np.corrcoef(force, own)[0, 1])
        if correlation < TURNED:
            found.append(Doubt("runs_against", {"force": name, "correlation": correlation}))
    return found


def scenario_of(history: ForceHistory) -> Scenario | None:
    """Scenario that a simulated history carries; ``None`` if it carries none.

    Raises
    ------
    InputError
        If it is not one of this version.
    """
    if "scenario" not in history.provenance:
        return None
    try:
        return Scenario.model_validate(history.provenance["scenario"])
    except ValidationError as error:
        raise InputError(
            "the history carries a scenario that this version of terraphi cannot read; simulate it "
            "again, or give its forces alone (a CSV without its comment)"
        ) from error


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and their values."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def check_same_setup(
    history: ForceHistory, scenario: Scenario, *, source: str = "", varied: Iterable[str] = ()
) -> None:
    """Refuse a simulated history of a leg or hip unlike the library's.

    Parameters
    ----------
    history, scenario
        As in :func:`unlike`.
    source
        Name of the history, for people.
    varied
        Keys that the library varies, in which histories may differ.
    """
    made_by, free = scenario_of(history), set(varied)
    if made_by is None:
        return
    if any(key.startswith(("motion.hip", "bed.")) for key in free):
        free.add(HIP)
    for name, found, expected in (
        ("leg.chord", made_by.leg.chord, scenario.leg.chord),
        ("leg.width", made_by.leg.width, scenario.leg.width),
        ("leg.half_thickness", made_by.leg.half_thickness, scenario.leg.half_thickness),
        (HIP, made_by.hip_height, scenario.hip_height),
    ):
        if name not in free and abs(found - expected) > 1e-6:
            raise InputError(
                f"{source or 'the history'} was simulated with {name} = {found:g} m, the library "
                f"with {expected:g} m; build a library for this setup"
            )
