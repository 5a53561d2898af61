"""Laws of legs by their names and files, and the one that is nearest to a simulation."""

from __future__ import annotations

from pathlib import Path

from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import netcdf_kind
from terraphi.experiment.rig import Rig
from terraphi.experiment.scenario import Scenario
from terraphi.laws.fitted import KIND
from terraphi.laws.law import PHI
from terraphi.laws.legs import FORMER_NAME, NAME, VARIED, LawOfLegs, Legs, reach, shipped_legs
from terraphi.laws.store import Library, differences, nearest_library, shipped_library
from terraphi.laws.theory import Theory


def shipped_laws() -> list[LawOfLegs]:
    """All shipped laws of legs."""
    return [shipped_legs(), Theory(), *map(shipped_library, Library.names())]


def nearest_law(scenario: Scenario) -> LawOfLegs:
    """Law ``legs`` of legs that turn in three dimensions, or the most similar shipped law."""
    if scenario.model == "rft":
        return Theory()
    turns = (scenario.model, scenario.dimensions, scenario.motion.kind) == ("mpm", 3, "rotation")
    return shipped_legs() if turns else nearest_library(scenario)


def stored(name: Path | str) -> LawOfLegs:
    """A shipped law of legs by its name, or a law or library from a file; raises InputError."""
    if str(name) in (NAME, FORMER_NAME):
        return shipped_legs()
    if str(name) == Theory.name:
        return Theory()
    if str(name) in Library.names():
        return shipped_library(str(name))
    path = Path(name)
    if not path.suffix and not path.exists():
        hint = nearest(str(name), (NAME, Theory.name, *Library.names()))
        raise InputError(f"'{name}' is neither a file nor a law of legs; {hint}")
    of_law = path.is_file() and netcdf_kind(path) == KIND
    return Legs.load(path) if of_law else Library.load(name)


def law_named(name: Path | str) -> LawOfLegs:
    """A law of legs or a library, by its name or file.

    Its method ``forces(rig, phi_deg)`` has the forces on a leg (:func:`forces`). A library over φ
    alone of legs that turn through the soil of law ``legs`` is joined to it.

    Raises
    ------
    InputError
        If there is none.

    Examples
    --------
    >>> terraphi.law("legs").legs
    ['c', 'reversed_c', 'straight']
    """
    stored_law = stored(name)
    law = nearest_law(stored_law.scenario)
    if not (isinstance(stored_law, Library) and isinstance(law, Legs)):
        return stored_law
    is_same_soil = set(differences(stored_law.scenario, law.scenario)) <= VARIED
    varies_phi_alone = all(stored_law.keys(leg) == (PHI,) for leg in stored_law.legs)
    return (
        law.joined(stored_law)
        if is_same_soil and varies_phi_alone and _begins_and_ends_in_air(stored_law)
        else stored_law
    )


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
