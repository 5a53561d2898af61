"""Measured force histories: those shipped with the package, and people's own files.

Shipped are the rotating-leg experiments of Li, Zhang & Goldman, *Science* 339:1408 (2013), named
``li2013:MEDIUM/LEG``; how they were read from the paper stands in ``data/li2013/PROVENANCE.md``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import Field, ValidationError

from terraphi.experiment.documents import Strict, parse_toml, shipped_file, shipped_names
from terraphi.experiment.errors import InputError, nearest, sentence_from_validation
from terraphi.experiment.files import is_there
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.leg import LEG_SHAPES, LegShape
from terraphi.experiment.scenario import Scenario

COLLECTION = "li2013"
"""Folder of the shipped measurements, and the first part of their names."""
CHORDS = (0.072, 0.077)
"""Chords of scenarios of their legs, 76.2 mm or that less the round end [m]."""
HALF_THICKNESS, WIDTH, HIP_ABOVE = 0.0032, 0.0254, 0.020
"""Of their legs, and the height of their hip above the soil as it was meant to be [m]."""
SAME = 0.01
"""How nearly a scenario has these sizes [-]."""
_RFT = "-rft"


class _Medium(Strict):
    """A row of the table of media; what the source does not report is left out."""

    label: str
    density: float | None = Field(None, gt=0)
    assumed_density: float | None = Field(None, gt=0)
    angle_of_repose_deg: float | None = Field(None, gt=0, lt=90)


class _Media(Strict):
    citation: str
    media: Mapping[str, _Medium]


@dataclass(frozen=True)
class Measurement:
    """A force history and what is known of the leg and the soil that made it.

    Attributes
    ----------
    name
        Shipped name, or the file that it was read from.
    history
        Fx, Fz [N] over θ.
    leg
        Shape of the leg, as scenarios name it.
    leg_assumed
        Whether nobody said so.
    medium
        The soil, for people; empty if unknown.
    density_kg_m3
        Bulk density [kg/m³]; ``None`` if nothing is known.
    density_assumed
        Whether the density is a guess rather than a measured value.
    angle_of_repose_deg
        [deg]; ``None`` if it is not reported. A guide to the friction angle, not its truth.
    source
        What to cite; empty if unknown.
    """

    name: str
    history: ForceHistory
    leg: str
    medium: str = ""
    density_kg_m3: float | None = None
    density_assumed: bool = False
    angle_of_repose_deg: float | None = None
    source: str = ""
    leg_assumed: bool = False


def names() -> tuple[str, ...]:
    """Names of the shipped measurements, such as ``"li2013:yuma/straight"``, sorted."""
    stems = shipped_names(COLLECTION, ".csv")
    return tuple(f"{COLLECTION}:{s.replace('-', '/')}" for s in stems if not s.endswith(_RFT))


def measurement(name: str) -> Measurement:
    """One of the shipped measurements.

    Parameters
    ----------
    name
        ``li2013:MEDIUM/LEG``.

    Returns
    -------
    Measurement

    Raises
    ------
    InputError
        If there is none of that name; the nearest is named.

    Examples
    --------
    >>> measurement("li2013:poppy_loose/c").angle_of_repose_deg
    36.0
    """
    history, medium, leg, source = _shipped(name)
    density = medium.assumed_density if medium.density is None else medium.density
    return Measurement(
        name=name,
        history=history,
        leg=leg,
        medium=medium.label,
        density_kg_m3=density,
        density_assumed=medium.density is None and density is not None,
        angle_of_repose_deg=medium.angle_of_repose_deg,
        source=source,
    )


def reference_rft(name: str) -> ForceHistory:
    """The authors' own prediction for a shipped measurement, by resistive force theory.

    Parameters
    ----------
    name
        Name of the measurement, ``li2013:MEDIUM/LEG``.

    Returns
    -------
    ForceHistory
        The dashed curve of the source's figure.

    Raises
    ------
    InputError
        If there is no measurement of that name; the nearest is named.
    """
    return _shipped(name, _RFT)[0]


def open_forces(source: str | Path) -> Measurement:
    """A measurement by its shipped name, or a history from a file.

    Parameters
    ----------
    source
        ``li2013:MEDIUM/LEG``; a NetCDF (``.nc``) that this package wrote; or a CSV with exactly
        the columns ``theta_deg,Fx_N,Fz_N``: a file, a pipe, or ``-`` for standard input.

    Returns
    -------
    Measurement
        Of a simulated history leg and density are those of its scenario, of a shipped measurement
        in a CSV those of the measurement. Of any other CSV nothing is known, and the leg is taken
        to be straight.

    Raises
    ------
    InputError
        If there is no such name, or the file cannot be used or is not a function of θ.
    """
    text, path = str(source), Path(source)
    if path.is_dir():
        raise InputError(
            f"{path}: is a folder; expected a CSV or NetCDF file of forces, or a shipped "
            f"measurement such as {COLLECTION}:yuma/straight"
        )
    if not is_there(path):
        if text.startswith(f"{COLLECTION}:"):
            return measurement(text)
        if not path.suffix and nearest(text, names()).startswith("did"):
            raise InputError(
                f"'{text}' is neither a file nor a shipped measurement; {nearest(text, names())}"
            )
    named = "standard input" if text == "-" else text
    if path.suffix.lower() == ".nc":
        history, remedy = ForceHistory.from_netcdf(path), "simulate it again"
    else:
        history, remedy = ForceHistory.from_csv(path), "remove that comment for its forces alone"
    if history.coordinate != "theta":
        raise InputError(
            f"{path}: forces over {history.coordinate}, expected forces over the leg angle theta"
        )
    return told_by(history, named, remedy=remedy)


def told_by(
    history: ForceHistory, name: str = "", *, remedy: str = "give its forces alone"
) -> Measurement:
    """What a force history itself says of its leg and its soil.

    Parameters
    ----------
    history
        Forces over the leg angle.
    name
        What it is called; by default the file that it says it comes from.
    remedy
        What to do if it carries a scenario that cannot be read.

    Returns
    -------
    Measurement
        As of :func:`open_forces`.

    Raises
    ------
    InputError
        If it carries a scenario that cannot be read.
    """
    name = name or str(history.provenance.get("file", ""))
    shipped = history.provenance.get("measurement")
    if shipped in names():
        return replace(measurement(str(shipped)), name=name or str(shipped), history=history)
    scenario = scenario_of(history, name=name, remedy=remedy)
    if scenario is None:
        return Measurement(name=name, history=history, leg="straight", leg_assumed=True)
    return Measurement(
        name=name,
        history=history,
        leg=scenario.leg.shape,
        medium=f"simulated ({scenario.model})",
        density_kg_m3=scenario.soil.density,
    )


def scenario_of(
    history: ForceHistory, *, name: str = "", remedy: str = "give its forces alone"
) -> Scenario | None:
    """The scenario that a simulated history carries; ``None`` if it carries none.

    Parameters
    ----------
    history
        Any.
    name, remedy
        As of :func:`told_by`.

    Raises
    ------
    InputError
        If it is not one of this version.
    """
    made_by = history.provenance.get("scenario")
    try:
        return None if made_by is None else Scenario.model_validate(made_by)
    except ValidationError as error:
        what = f"{name or 'the history'}, scenario"
        raise InputError(f"{sentence_from_validation(error, what, Scenario)}; {remedy}") from error


def is_of_their_apparatus(scenario: Scenario) -> bool:
    """Whether a scenario's leg, and the height of its hip, are those of the shipped records."""
    leg, (shortest, longest) = scenario.leg, CHORDS
    sizes = {
        HALF_THICKNESS: leg.half_thickness,
        WIDTH: leg.width,
        HIP_ABOVE: scenario.hip_height,
    }
    same = all(math.isclose(size, own, rel_tol=SAME) for own, size in sizes.items())
    return same and shortest <= leg.chord <= longest


def medium_and_leg(name: str) -> tuple[str, str]:
    """The two parts of a shipped measurement's name: ``yuma`` and ``straight``.

    Parameters
    ----------
    name
        ``li2013:MEDIUM/LEG``.
    """
    medium, _, leg = name.partition(":")[2].partition("/")
    return medium, leg


def _shipped(name: str, kind: str = "") -> tuple[ForceHistory, _Medium, LegShape, str]:
    """History of a kind, medium, leg and citation of a shipped measurement."""
    if name not in names():
        raise InputError(f"no shipped measurement '{name}'; {nearest(name, names())}")
    medium, shape = medium_and_leg(name)
    table = parse_toml(shipped_file(COLLECTION, "media", ".toml"), _Media)
    history = ForceHistory.from_csv(shipped_file(COLLECTION, f"{medium}-{shape}{kind}", ".csv"))
    provenance = {**history.provenance, "measurement": name, "source": table.citation}
    if table.media[medium].density is not None:
        provenance["density_kg_m3"] = table.media[medium].density
    leg = next(known for known in LEG_SHAPES if known == shape)
    return replace(history, provenance=provenance), table.media[medium], leg, table.citation
