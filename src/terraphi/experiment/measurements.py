"""Measured force histories: those shipped with the package, and people's own files.

Shipped are the rotating-leg experiments of Li, Zhang & Goldman, *Science* 339:1408 (2013), named
``li2013:MEDIUM/LEG``; ``data/li2013/PROVENANCE.md`` says how they were read from the paper.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from terraphi.experiment.documents import shipped_file, shipped_names, strictly
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import is_there
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.reading import read_forces, read_trials
from terraphi.experiment.rig import Rig

if TYPE_CHECKING:
    from terraphi.experiment.scenario import Scenario

COLLECTION = "li2013"
"""Folder of the shipped measurements, and the first part of their names."""


@dataclass(frozen=True)
class Measurement:
    """A force history and what is known of the rig and the soil that made it.

    Attributes
    ----------
    name
        Shipped name, or the file that it was read from.
    history
        Fx, Fz [N] over θ.
    rig
        The apparatus; ``None`` if it is unknown.
    medium
        Description of the soil; empty if unknown.
    density_kg_m3
        Bulk density [kg/m³]; ``None`` if unknown.
    density_assumed
        Whether the density is a guess.
    angle_of_repose_deg
        [deg]; ``None`` if it is not reported. A guide to the friction angle, not its truth.
    source
        What to cite; empty if unknown.
    scenario
        Of a simulation, if its history carries one.
    """

    name: str
    history: ForceHistory
    rig: Rig | None = None
    medium: str = ""
    density_kg_m3: float | None = None
    density_assumed: bool = False
    angle_of_repose_deg: float | None = None
    source: str = ""
    scenario: Scenario | None = field(default=None, repr=False)


def names() -> tuple[str, ...]:
    """Names of the shipped measurements, such as ``"li2013:yuma/straight"``, sorted."""
    stems = shipped_names(COLLECTION, ".csv")
    return tuple(f"{COLLECTION}:{s.replace('-', '/')}" for s in stems if not s.endswith("-rft"))


def measurement(name: str) -> Measurement:
    """One of the shipped measurements.

    Parameters
    ----------
    name
        ``li2013:MEDIUM/LEG``.

    Raises
    ------
    InputError
        With the nearest name, if there is none of that name.

    Examples
    --------
    >>> terraphi.measurement("li2013:poppy_loose/c").angle_of_repose_deg
    36.0
    """
    if name not in names():
        raise InputError(f"no shipped measurement '{name}'; {nearest(name, names())}")
    file = name.partition(":")[2].replace("/", "-")
    history = read_forces(shipped_file(COLLECTION, file, ".csv"))
    table = tomllib.loads(shipped_file(COLLECTION, "media", ".toml").read_text(encoding="utf-8"))
    medium, _, leg = name.partition(":")[2].partition("/")
    facts, source = table["media"][medium], table["citation"]
    provenance = {**history.provenance, "measurement": name, "source": source}
    if "density" in facts:
        provenance["density_kg_m3"] = facts["density"]
    return Measurement(
        name=name,
        history=replace(history, provenance=provenance),
        rig=Rig.of(COLLECTION, leg),
        medium=facts["label"],
        density_kg_m3=facts.get("density", facts.get("assumed_density")),
        density_assumed="density" not in facts,
        angle_of_repose_deg=facts.get("angle_of_repose_deg"),
        source=source,
    )


def open_forces(source: str | Path, columns: Any = None) -> list[Measurement]:
    """A measurement by its shipped name, or the histories of a file.

    Parameters
    ----------
    source
        ``li2013:MEDIUM/LEG``; a NetCDF (``.nc``) that this package wrote; or a table of text: a
        file, a pipe, or ``-`` for standard input.
    columns
        Which columns of a table are what (:class:`~terraphi.experiment.reading.ForceColumns`).

    Returns
    -------
    list of Measurement
        One for each stroke in the file.
        With the rig and the density of the scenario, of a simulation; those of the measurement, of
        a shipped one in a CSV. Of any other file nothing is known.

    Raises
    ------
    InputError
        If there is no such name, or the file cannot be used or is not a function of θ.
    """
    text, path = str(source), Path(source)
    if not is_there(path) and not path.is_dir():
        if text.startswith(f"{COLLECTION}:"):
            return [measurement(text)]
        if not path.suffix and (hint := nearest(text, names())).startswith("did"):
            raise InputError(f"'{text}' is neither a file nor a shipped measurement; {hint}")
    if path.suffix.lower() == ".nc":
        histories = [ForceHistory.load(path)]
    else:
        histories = read_trials(path, columns)
    name = "standard input" if text == "-" else text
    return [
        measurement_of(history, name if len(histories) == 1 else f"{name}, stroke {i}")
        for i, history in enumerate(histories, start=1)
    ]


def measurement_of(history: ForceHistory, name: str = "") -> Measurement:
    """A history with what its provenance says of its rig and its soil.

    Parameters
    ----------
    history
        Forces over the leg angle.
    name
        By default the file that it comes from.

    Raises
    ------
    InputError
        If it is not a function of θ, or has a scenario that cannot be read.
    """
    name = name or str(history.provenance.get("file", "forces"))
    if history.coordinate != "theta":
        raise InputError(f"{name}: forces over {history.coordinate}, expected over theta")
    shipped = history.provenance.get("measurement")
    if shipped in names():
        return replace(measurement(str(shipped)), name=name, history=history)
    scenario = scenario_of(history, name)
    if scenario is None:
        return Measurement(name=name, history=history)
    return Measurement(
        name=name,
        history=history,
        rig=Rig.of_scenario(scenario),
        medium=f"simulated ({scenario.model})",
        density_kg_m3=scenario.soil.density,
        scenario=scenario,
    )


def scenario_of(history: ForceHistory, name: str) -> Scenario | None:
    """The scenario of a simulation; ``None`` of a measurement.

    Raises InputError if it cannot be read.
    """
    content = history.provenance.get("scenario")
    if content is None:
        return None
    from terraphi.experiment.scenario import Scenario

    try:
        return strictly(content, Scenario, f"{name}, scenario")
    except InputError as error:
        raise InputError(f"{error}; simulate it again, or give its forces alone") from error
