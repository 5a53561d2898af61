"""Laws of legs by their names and files, and the one that a simulation is read with."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import netcdf_kind
from terraphi.experiment.rig import Rig
from terraphi.experiment.scenario import Scenario
from terraphi.laws.fitted import KIND
from terraphi.laws.law import PHI, AnyLaw
from terraphi.laws.legs import FORMER_NAME, NAME, VARIED, LawOfLegs, Legs, reach, shipped_legs
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
        raise InputError(
            f"no law has the forces of this simulation ({scenario.dimensions}-D, "
            f"{scenario.motion.kind}); legs that turn in three dimensions have one, and "
            "'terraphi paper' infers angles in two"
        )
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
        If there is none, or a library is not over φ alone, of legs that turn through the soil of
        law ``legs`` from air to air.

    Examples
    --------
    >>> terraphi.law("legs").legs
    ['c', 'reversed_c', 'straight']
    """
    law: Any = name if isinstance(name, AnyLaw) else stored(name)
    if not isinstance(law, Library):
        return cast("LawOfLegs", law)
    legs = shipped_legs()
    differing = [key for key in differences(law.scenario, legs.scenario) if key not in VARIED]
    varies_phi_alone = all(law.keys(leg) == (PHI,) for leg in law.legs)
    if differing or not varies_phi_alone or not _begins_and_ends_in_air(law):
        differs = f" (another {', '.join(differing[:3])})" if differing else ""
        raise InputError(
            f"library {law.name}{differs} cannot join law {NAME}: it must be of legs that turn "
            "through the soil of that law in three dimensions, from air to air, and vary φ alone; "
            "'terraphi library build --rig' makes one"
        )
    return legs.joined(law)


def _begins_and_ends_in_air(library: Library) -> bool:
    """True if the paths of a library begin and end in the air."""
    for scenario, history, _ in library.cases:
        rig = Rig.of_scenario(scenario)
        if history is not None and rig is not None:
            first, last, _ = reach(rig.leg, rig.ratios)
            begins, ends = history.theta_deg[[0, -1]]
            if begins > first + 1.0 or ends < last - 1.0:
                return False
    return True
