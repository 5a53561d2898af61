"""A library: simulations over the friction angle, in one NetCDF."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import BaseModel, Json

from terraphi.experiment.documents import located, shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import NetcdfFile
from terraphi.experiment.history import COORDINATES, ForceHistory, force_variables, positions
from terraphi.experiment.results import Result, Variable, read
from terraphi.experiment.scenario import Scenario
from terraphi.laws.law import PHI, AnyLaw

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

IGNORED = {PHI, "soil.density", "leg.shape", "numerics.seed", "name"}
"""Scenario keys in which a simulation may differ from a library's: φ, density, leg, seed, name."""


class LibraryAttributes(BaseModel):
    """Attributes of a library's file."""

    name: str
    description: str = ""
    caveat: str = ""
    coordinate: Literal["theta", "displacement", "time"]
    provenance: Json[dict[str, Any]] = {}


class Case(NamedTuple):
    """One simulation of a library."""

    scenario: Scenario
    """What was simulated."""
    history: ForceHistory | None
    """Its forces; ``None`` if the simulation failed."""
    failure: str = ""
    """Why it failed; empty if it did not."""


@dataclass(frozen=True, eq=False, repr=False)
class Library(AnyLaw, Result):
    """Simulations of a plan.

    Attributes
    ----------
    name, description, caveat
        As in the plan.
    cases
        The simulations.
    provenance
        Plan and versions; JSON-able.
    """

    KIND = "library"
    SCHEMA = 1
    ATTRIBUTES = LibraryAttributes
    VARIABLES = (
        *COORDINATES,
        *force_variables("case position", holes=True, packed=True),
        *(
            Variable(name, "case", words=True, coordinate=True)
            for name in ("scenario", "failure", "provenance")
        ),
    )

    name: str
    cases: tuple[Case, ...]
    description: str = ""
    caveat: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def scenario(self) -> Scenario:
        """Scenario of the first case: density, yield criterion and all that is not varied."""
        return self.cases[0].scenario

    @property
    def _first_history(self) -> ForceHistory:
        return next(case.history for case in self.cases if case.history)

    @property
    def coordinate(self) -> str:
        """Kind of the positions of its forces: ``theta``, ``displacement`` or ``time``."""
        return self._first_history.coordinate

    @property
    def convention(self) -> str:
        """Meaning of its friction angle: a yield criterion, or ``rft3d``."""
        return self.scenario.convention

    @property
    def legs(self) -> list[str]:
        """Shapes of its legs, sorted."""
        return sorted({case.scenario.leg.shape for case in self.cases if case.history})

    @property
    def phi_deg_by_leg(self) -> dict[str, tuple[float, float]]:
        """Smallest and largest friction angle of each leg [deg]."""
        angles = {
            leg: [case.scenario.soil.friction_angle_deg for case in self._of(leg)]
            for leg in self.legs
        }
        return {leg: (min(values), max(values)) for leg, values in angles.items()}

    @property
    def phi_deg(self) -> tuple[float, float]:
        """Smallest and largest friction angle of all legs [deg]."""
        low, high = zip(*self.phi_deg_by_leg.values(), strict=True)
        return min(low), max(high)

    def summary(self) -> dict[str, Any]:
        """Contents and origin, JSON-able."""
        first = self.scenario
        numerics = first.numerics if first.model == "mpm" else None
        return super().summary() | {
            "description": self.description,
            "caveat": self.caveat,
            "phi_deg_by_leg": {leg: list(ends) for leg, ends in self.phi_deg_by_leg.items()},
            "cases": len(self.cases),
            "failures": {c.scenario.hash: c.failure for c in self.cases if c.failure},
            "cell_mm": None if numerics is None else 1e3 * numerics.cell_size,
            "speed_up": None if numerics is None else numerics.speed_up,
        }

    def _lines(self) -> list[str]:
        first = self.scenario
        legs = [f"{leg} {low:g} to {high:g}°" for leg, (low, high) in self.phi_deg_by_leg.items()]
        model = f"{first.model}, {first.dimensions}-D, {first.soil.density:g} kg/m³"
        lines = [
            f"{self.name}: {len(self.cases)} simulations ({model})",
            f"φ ({first.convention}): {', '.join(legs)}",
        ]
        return [*lines, *filter(None, [self.description, self.caveat])]

    def plot(self) -> Figure:
        """Force curves of each leg, coloured by φ, as a Matplotlib figure."""
        from terraphi.experiment.figure import Figure as NewFigure

        figure = NewFigure(figsize=(9.0, 3.0 * len(self.legs)), layout="constrained")
        from matplotlib import cm, colormaps, colors

        rows = figure.subfigures(len(self.legs), squeeze=False)[:, 0]
        ends = np.array([*self.phi_deg_by_leg.values()])
        scale = colors.Normalize(ends.min(), ends.max())
        for row, leg in zip(rows, self.legs, strict=True):
            panels = row.subplots(1, 2)
            for scenario, history, _ in self._of(leg):
                assert history is not None
                history.plot(row)
                color = colormaps["viridis"](scale(scenario.soil.friction_angle_deg))
                for axes in panels:
                    axes.lines[-1].set(color=color, lw=0.8)
            row.suptitle(f"leg {leg}", fontsize=10)
            row.colorbar(cm.ScalarMappable(scale, "viridis"), ax=panels, label="φ [deg]")
        return figure

    def _of(self, leg: str) -> list[Case]:
        """Simulations of a leg that succeeded."""
        return [case for case in self.cases if case.history and case.scenario.leg.shape == leg]

    # -- files -----------------------------------------------------------------------------------

    @staticmethod
    def names() -> tuple[str, ...]:
        """Names of the shipped libraries.

        Examples
        --------
        >>> terraphi.Library.names()
        ('paper', 'paper-code')
        """
        return tuple(shipped_names("libraries", ".nc"))

    def _variables(self) -> dict[str, Any]:
        histories = [case.history for case in self.cases]
        places = [history.position for history in histories if history]
        if any(
            place.shape != places[0].shape or not np.allclose(place, places[0], rtol=0.0, atol=1e-9)
            for place in places
        ):
            why = (
                "forces at different positions; sweep neither the span of the motion nor dimensions"
            )
            raise InputError(f"library '{self.name}': {why}")
        rows = [history._variables() if history else {} for history in histories]
        lost = np.full(len(places[0]), np.nan)
        forces = {
            name: [lost if row.get(name) is None else row[name] for row in rows]
            for name in ("Fx", "Fy", "Fz", "M")
            if any(row.get(name) is not None for row in rows)
        }
        at = "theta_deg" if self.coordinate == "theta" else self.coordinate
        origins = [dict(history.provenance) if history else {} for history in histories]
        return forces | {
            at: self._first_history._variables()[at],
            "scenario": [case.scenario.model_dump_json() for case in self.cases],
            "failure": [case.failure for case in self.cases],
            "provenance": [json.dumps(origin) for origin in origins],
        }

    def to_xarray(self) -> xr.Dataset:
        """Forces of all cases, as in the NetCDF; raises InputError if positions differ."""
        dim = "theta_deg" if self.coordinate == "theta" else self.coordinate
        return super().to_xarray().swap_dims(position=dim)

    save = Result.to_netcdf

    @classmethod
    def load(cls, source: Path | str) -> Self:
        """Read a library file, or a shipped library by its name.

        Raises
        ------
        InputError
            If there is no such library, or the file is not a whole one of this schema.

        Examples
        --------
        >>> terraphi.Library.load("paper").legs
        ['straight']
        """
        if not isinstance(source, str | Path):
            raise InputError(f"library of type {type(source).__name__}; give a name or a file")
        return super().load(located(source, "libraries", ".nc"))

    @classmethod
    def _of_file(cls, file: NetcdfFile[LibraryAttributes]) -> Self:
        """A library; raises ValueError if no simulation in it succeeded."""
        attrs, values = file.attrs, read(file, cls.VARIABLES)
        axes = ("x", "y", "z") if values["Fy"] is not None else ("x", "z")
        position, moments = positions(values, attrs.coordinate), values["M"]
        force = np.stack([values[f"F{axis}"] for axis in axes], axis=2)
        cases: list[Case] = []
        texts = zip(values["scenario"], values["failure"], values["provenance"], strict=True)
        for i, (scenario, failure, origin) in enumerate(texts):
            moment = None if moments is None or np.isnan(moments[i]).any() else moments[i]
            numbers = position, force[i], attrs.coordinate, axes, {**json.loads(origin)}, moment
            history = None if failure else ForceHistory(*numbers)
            cases.append(Case(Scenario.model_validate_json(scenario), history, failure))
        if not any(case.history for case in cases):
            raise ValueError("no simulation in it succeeded")
        return cls(attrs.name, tuple(cases), attrs.description, attrs.caveat, attrs.provenance)


def _flat(value: Any, name: str = "") -> dict[str, Any]:
    """Leaves of nested dictionaries and lists, by dotted key."""
    if isinstance(value, list):
        value = dict(enumerate(value))
    if not isinstance(value, dict):
        return {name[1:]: value}
    parts = (_flat(item, f"{name}.{key}") for key, item in value.items())
    return {key: leaf for part in parts for key, leaf in part.items()}


def differences(scenario: Scenario, other: Scenario) -> list[str]:
    """Dotted keys in which two scenarios differ, apart from :data:`IGNORED`."""
    ours, theirs = (_flat(item.model_dump(mode="json")) for item in (scenario, other))
    return [
        k
        for k in {**ours, **theirs}
        if ours.get(k) != theirs.get(k)
        and k not in IGNORED
        and not (scenario.model == "rft" and k.startswith("relief."))
    ]
