"""Laws of legs by their names and files, and the one that a simulation is read with."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import netcdf_kind
from terraphi.experiment.scenario import Scenario
from terraphi.laws.fitted import KIND
from terraphi.laws.law import AnyLaw
from terraphi.laws.legs import FORMER_NAME, NAME, VARIED, LawOfLegs, Legs, shipped_legs
from terraphi.laws.store import Library, differences
from terraphi.laws.theory import Theory


def shipped() -> list[LawOfLegs | Library]:
    """All shipped laws of legs, and libraries."""
    return [stored(name) for name in (NAME, Theory.name, *Library.names())]


def law_of_simulation(scenario: Scenario) -> LawOfLegs:
    """Law ``legs`` of legs that turn in three dimensions, ``rft3d`` of resistive force theory.

    Raises InputError for any other simulation.
    """
    if scenario.model == "rft":
        return Theory()
    if (scenario.dimensions, scenario.motion.kind) != (3, "rotation"):
        kind = f"({scenario.dimensions}-D, {scenario.motion.kind})"
        why = "of legs that turn in three dimensions; 'terraphi paper' infers angles in two"
        raise InputError(f"no law has the forces of this simulation {kind}; laws are {why}")
    return shipped_legs()


def stored(name: Path | str) -> LawOfLegs | Library:
    """A law of legs or a library, by its name or from a file; raises InputError."""
    if str(name) in (NAME, FORMER_NAME):
        return shipped_legs()
    if str(name) == Theory.name:
        return Theory()
    path = Path(name)
    if not path.suffix and not path.exists() and str(name) not in Library.names():
        hint = nearest(str(name), (NAME, Theory.name, *Library.names()))
        raise InputError(f"'{name}' is neither a file nor a law of legs; {hint}")
    of_law = path.is_file() and netcdf_kind(path) == KIND
    return Legs.load(path) if of_law else Library.load(name)


def law_named(name: Path | str | AnyLaw) -> LawOfLegs:
    """A law of legs by its name or file; a library is joined to law ``legs``.

    Its method ``forces(rig, phi_deg)`` has the forces on a leg.

    Raises
    ------
    InputError
        If there is none, or a library is not of legs that turn through the soil of law ``legs``
        from air to air.

    Examples
    --------
    >>> terraphi.law("legs").legs
    ['c', 'reversed_c', 'straight']
    """
    law: Any = name if isinstance(name, AnyLaw) else stored(name)
    if not isinstance(law, Library):
        return cast("LawOfLegs", law)
    legs = shipped_legs()
    keys = (key for case in law.cases for key in differences(case.scenario, legs.scenario))
    if differing := [key for key in dict.fromkeys(keys) if key not in VARIED]:
        why = f"differs from law {NAME} in {', '.join(differing[:3])}, and cannot join it"
        raise InputError(f"library {law.name} {why}; 'terraphi library build --rig' makes one")
    return legs.joined(law)
