"""A library of simulations: a plan in, one self-describing NetCDF out.

Finished cases are kept beside the file to be (``FILE.nc.cases``, one force history each, named by
its scenario's hash) until the library is whole, so an interrupted build goes on where it stopped
and computes nothing twice.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import shipped_file, shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import is_there, open_netcdf, positions, write_netcdf
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import Plan, describe, unseeded, value_of

SCHEMA = 1
"""Version of the layout of a library file."""
HELD_AT_LEAST = 0.85
"""Share of simulated truths in 95 % intervals below which these are not to be believed [-]."""
COUNTED = (
    "its contact counts another force than it applies to the soil, so that angles of measured "
    "forces mean nothing; see docs/explanation/prototype.md."
)
"""Caveat of libraries with the contact ``unbalanced``."""


class Case(NamedTuple):
    """One simulation of a library."""

    scenario: Scenario
    """What was simulated."""
    history: ForceHistory | None
    """Its forces; ``None`` if it failed."""
    failure: str
    """Why it failed; empty if it did not."""

    @property
    def digest(self) -> str:
        """SHA-256 of positions and forces, to the last bit, hexadecimal; empty if it failed."""
        if self.history is None:
            return ""
        parts = (
            np.ascontiguousarray(a, "<f8") for a in (self.history.position, self.history.force)
        )
        return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


class Curves(NamedTuple):
    """What an inversion takes from a library: observation vectors over the friction angle."""

    phi_deg: FloatArray
    """Friction angles [deg], increasing, shape [case]."""
    theta_deg: FloatArray
    """Leg angles [deg], shape [M]."""
    Fx: FloatArray
    """Forward force [N], shape [case, M]."""
    Fz: FloatArray
    """Vertical force [N], shape [case, M]."""
    scenario: Scenario
    """Scenario of the first case: density, convention and all that is not swept."""

    @property
    def vectors(self) -> FloatArray:
        """Observation vectors [Fx, Fz] [N], shape [case, 2 M]."""
        return np.hstack([self.Fx, self.Fz])


@dataclass(frozen=True, eq=False)
class Library:
    """The simulations of a plan.

    Attributes
    ----------
    plan
        What was to be simulated.
    cases
        What came of it, in the plan's order.
    provenance
        Versions; JSON-able.
    calibration
        What inversions have learnt of it: particle scatter and hyperparameters by leg, and the
        certificate of its coverage; JSON-able, empty if nobody looked.
    replicates
        Some of the cases again under other particle seeds: what the scatter was learnt from.
    fine
        Some of the cases again with smaller cells or speed-up (`finer`): what the library's forces
        are corrected by; empty if it is not refined.
    refinement
        Hyperparameters of that correction by leg and cause; JSON-able.
    """

    plan: Plan
    cases: tuple[Case, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    calibration: Mapping[str, Any] = field(default_factory=dict)
    replicates: tuple[Case, ...] = ()
    fine: tuple[Case, ...] = ()
    refinement: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the library."""
        return self.plan.name

    @property
    def failures(self) -> dict[str, str]:
        """Case to why it failed."""
        return {describe(self.plan, c.scenario): c.failure for c in self.cases if c.failure}

    @property
    def hash(self) -> str:
        """SHA-256 of the hashes of all cases, and of finer ones if there are, hexadecimal."""
        return hash_of((*self.cases, *self.fine))

    @cached_property
    def as_simulated(self) -> Library:
        """The same without finer cases."""
        return replace(self, fine=(), refinement={}) if self.fine else self

    @property
    def certificate(self) -> Mapping[str, Mapping[str, Any]]:
        """How often its intervals held simulated truths, by leg; empty if nobody tried."""
        told = self.calibration.get("certificate")
        legs = told.get("legs") if isinstance(told, Mapping) else None
        if not isinstance(legs, Mapping):
            return {}
        return {str(leg): found for leg, found in legs.items() if isinstance(found, Mapping)}

    @property
    def unheld(self) -> dict[str, float]:
        """Legs whose 95 % intervals held too few simulated truths, and the share of these [-]."""
        held = {leg: found.get("coverage95") for leg, found in self.certificate.items()}
        return {
            leg: float(share)
            for leg, share in held.items()
            if isinstance(share, int | float) and share < HELD_AT_LEAST
        }

    def guesses_scatter(self, leg: str) -> bool:
        """Whether it can but guess what particle seeds do to a leg's forces."""
        again = {case.scenario.leg.shape for case in self.replicates}
        return self.cases[0].scenario.model == "mpm" and leg not in again

    @property
    def caveat(self) -> str:
        """What everyone who inverts with it should know: of its contact, and its plan's."""
        own = self.plan.caveat
        contacts = {case.scenario.numerics.contact for case in self.cases}
        if "unbalanced" not in contacts or "contact" in own:
            return own
        return f"{COUNTED} {own}".rstrip()

    @property
    def legs(self) -> list[str]:
        """Shapes of the legs that it has, sorted."""
        return sorted({case.scenario.leg.shape for case in self.cases if case.history})

    @property
    def phi_deg_by_leg(self) -> dict[str, list[float]]:
        """Least and largest friction angle that it has of each leg [deg]."""
        found: dict[str, list[float]] = {leg: [] for leg in self.legs}
        for case in self.cases:
            if case.history:
                found[case.scenario.leg.shape].append(case.scenario.soil.friction_angle_deg)
        return {leg: [min(angles), max(angles)] for leg, angles in found.items()}

    def summary(self) -> dict[str, Any]:
        """What it holds and where it comes from, JSON-able."""
        first, ranges = self.cases[0].scenario, self.phi_deg_by_leg
        ends = [end for both in ranges.values() for end in both]
        return {
            "name": self.name,
            "description": self.plan.description,
            "caveat": self.caveat,
            "convention": first.convention,
            "phi_deg": [min(ends), max(ends)],
            "phi_deg_by_leg": ranges,
            "legs": self.legs,
            "cases": len(self.cases),
            "failures": self.failures,
            "density_kg_m3": first.soil.density,
            "settings": self.settings,
            "sweep": self.plan.sweep or self.plan.one_at_a_time,
            **({"steps": [s.model_dump() for s in self.plan.steps]} if self.plan.steps else {}),
            **({"presets": self.plan.presets} if self.plan.presets else {}),
            **({"more": [m.model_dump() for m in self.plan.more]} if self.plan.more else {}),
            **({"sample": self.plan.sample.model_dump()} if self.plan.sample else {}),
            "replicates": len(self.replicates),
            **({"finer_cases": self._fine_by_leg} if self.fine else {}),
            "certificate": self.calibration.get("certificate"),
            "provenance": dict(self.provenance),
        }

    @property
    def settings(self) -> dict[str, Any]:
        """What all cases were simulated with, by keys that name their unit, JSON-able.

        What differs between them is left out.
        """
        first, *others = (_settings_of(case.scenario) for case in self.cases)
        return {
            key: value
            for key, value in first.items()
            if all(other.get(key) == value for other in others)
        }

    @property
    def _fine_by_leg(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        # By size, then angle.
        order = sorted(
            (case.scenario for case in self.fine),
            key=lambda s: (s.numerics.cell_size, s.numerics.speed_up, s.soil.friction_angle_deg),
        )
        for scenario in order:
            size, k = 1e3 * scenario.numerics.cell_size, scenario.numerics.speed_up
            told = f"{scenario.soil.friction_angle_deg:g}° (cells {size:.3g} mm, k = {k:g})"
            found.setdefault(scenario.leg.shape, []).append(told)
        return found

    def rotations(self, leg: str, *, over_phi: bool = True) -> list[Case]:
        """Finished cases of one leg.

        Parameters
        ----------
        leg
            Its shape.
        over_phi
            Whether a friction angle is to be inferred from them.

        Raises
        ------
        InputError
            If there is none, the leg does not rotate, or its forces know no friction angle.
        """
        chosen = [c for c in self.cases if c.history and c.scenario.leg.shape == leg]
        if not chosen:
            raise InputError(
                f"library '{self.name}' has no leg '{leg}'; it has {', '.join(self.legs)}"
            )
        first = chosen[0].scenario
        if over_phi and (first.model, first.dimensions) == ("rft", 2):
            raise InputError(
                f"library '{self.name}': two-dimensional resistive force theory has no friction "
                "angle to infer; build it with dimensions = 3"
            )
        if first.motion.kind != "rotation":
            raise InputError(
                f"library '{self.name}' is one of translations; an inversion needs rotations"
            )
        return chosen

    def curves(self, leg: str, *, readings: FloatArray | None = None) -> Curves:
        """Observation vectors of one leg over the friction angle.

        Parameters
        ----------
        leg
            Shape of the leg.
        readings
            Leg angles at which the measured record was read [rad], so that windows at its ends
            are cut alike and gaps bridged alike (:meth:`ForceHistory.as_read_at`); ``None`` takes
            the whole curves.

        Returns
        -------
        Curves

        Raises
        ------
        InputError
            If the library lacks the leg, has fewer than three friction angles for it or several
            cases of one, or varies anything else.
        """
        chosen = self.rotations(leg)
        if self.plan.sample and len(self.plan.sample.keys) > 1:
            raise InputError(
                f"library '{self.name}' varies {', '.join(self.plan.sample.keys)} together, not "
                "the friction angle alone; this inversion knows one parameter"
            )
        chosen.sort(key=lambda case: case.scenario.soil.friction_angle_deg)
        phi = np.array([case.scenario.soil.friction_angle_deg for case in chosen])
        if len(phi) < 3 or np.any(np.diff(phi) <= 0):
            raise InputError(
                f"library '{self.name}' has the friction angles {phi.tolist()} for leg '{leg}'; "
                "an inversion needs at least three, each once"
            )
        if differ_beyond(chosen, ["soil.friction_angle_deg"]):
            raise InputError(
                f"library '{self.name}' varies more than the friction angle of leg '{leg}'; this "
                "inversion knows one parameter"
            )
        seen = [case.history.as_read_at(readings).observation() for case in chosen if case.history]
        return Curves(
            phi,
            seen[0].theta_deg,
            np.stack([o.Fx for o in seen]),
            np.stack([o.Fz for o in seen]),
            chosen[0].scenario,
        )

    def repeated(
        self, leg: str, *, readings: FloatArray | None = None
    ) -> list[tuple[float, FloatArray]]:
        """Observations of simulations that differ by their particle seed alone, of one leg.

        Parameters
        ----------
        leg, readings
            As in :meth:`curves`.

        Returns
        -------
        list
            Friction angle [deg] of each case that was repeated, and its observation vectors [N],
            the case's own first, shape [simulation, 2 theta].
        """
        again = [c for c in self.replicates if c.scenario.leg.shape == leg]
        found = []
        for phi in dict.fromkeys(c.scenario.soil.friction_angle_deg for c in again):
            vectors = [
                case.history.as_read_at(readings).observation().vector
                for case in (*self.cases, *again)
                if case.scenario.soil.friction_angle_deg == phi
                and case.scenario.leg.shape == leg
                and case.history
            ]
            found.append((phi, np.stack(vectors)))
        return found

    # -- files -----------------------------------------------------------------------------------

    def save(self, path: Path | str) -> None:
        """Write one NetCDF-4 file.

        Parameters
        ----------
        path
            The file.

        Raises
        ------
        InputError
            If the place cannot be written; a file that was there stays as it is.
        """
        import xarray as xr

        whole = next(case.history for case in self.cases if case.history)
        kinds = (self.cases, self.replicates, self.fine)
        everything = tuple(case for kind in kinds for case in kind)
        for case in everything:
            if case.history and not _alike(case.history, whole):
                raise InputError(
                    f"library '{self.name}': the forces at {describe(self.plan, case.scenario)} "
                    "are taken at other positions than those of the first case; sweep neither the "
                    "span of the motion nor the dimensions"
                )
        coordinate = "theta_deg" if whole.coordinate == "theta" else whole.coordinate
        position = whole.theta_deg if whole.coordinate == "theta" else whole.position
        nothing = np.full(whole.force.shape, np.nan)
        force = np.stack([c.history.force if c.history else nothing for c in everything])
        units = {"theta_deg": "degree", "displacement": "m"}[coordinate]

        def text(values: list[str]) -> tuple[str, NDArray[np.object_]]:
            return "case", np.array(values, dtype=object)

        dataset = xr.Dataset(
            {
                f"F{axis}": (("case", coordinate), force[:, :, i], {"units": "N"})
                for i, axis in enumerate(whole.axes)
            },
            coords={
                whole.coordinate: (coordinate, whole.position, {"units": "rad"}),
                coordinate: (coordinate, position, {"units": units}),
                "scenario": text([c.scenario.model_dump_json() for c in everything]),
                "scenario_hash": text([c.scenario.hash for c in everything]),
                "failure": text([c.failure for c in everything]),
                "digest": text([c.digest for c in everything]),
                # 0 of the plan, 1 a replicate, 2 a finer one.
                "replicate": ("case", [i for i, kind in enumerate(kinds) for _ in kind]),
                "provenance": text(
                    [
                        json.dumps(dict(c.history.provenance) if c.history else {})
                        for c in everything
                    ]
                ),
            },
            attrs={
                "terraphi_file": "library",
                "terraphi_schema": SCHEMA,
                "name": self.name,
                "description": self.plan.description,
                "plan": self.plan.model_dump_json(),
                "coordinate": whole.coordinate,
                "provenance": json.dumps(dict(self.provenance)),
                "calibration": json.dumps(dict(self.calibration)),
                **({"refinement": json.dumps(dict(self.refinement))} if self.fine else {}),
            },
        )
        packing = {f"F{axis}": {"zlib": True, "shuffle": True} for axis in whole.axes}
        write_netcdf(dataset, Path(path), encoding=packing)

    @classmethod
    def load(cls, source: Path | str) -> Library:
        """Read a library file, or a shipped library by its name.

        Parameters
        ----------
        source
            A path ending in ``.nc``, or the name of a shipped library.

        Returns
        -------
        Library

        Raises
        ------
        InputError
            If there is no such library, or the file is not a whole one of this schema.
        """
        path = Path(source)
        if path.suffix != ".nc" and not is_there(path):
            _refuse_if_only_planned(str(source))
            path = shipped_file("libraries", str(source), ".nc")
        data = open_netcdf(path, kind="library", schema=SCHEMA)
        try:
            return cls._from_dataset(data)
        except (KeyError, TypeError, ValueError) as error:
            # A scenario of another version fails in many lines; the first says what it is.
            reason = str(error).splitlines()[0]
            raise InputError(
                f"{path}: not as this version writes a library ({reason}); build it again under "
                "another name"
            ) from error

    @classmethod
    def _from_dataset(cls, data: Any) -> Library:
        coordinate, position = str(data.attrs["coordinate"]), positions(data)
        axes = tuple(str(name)[1:] for name in data.data_vars)
        force = np.stack([data[f"F{axis}"].values.astype(np.float64) for axis in axes], axis=2)
        cases = []
        for i, failure in enumerate(data["failure"].values.tolist()):
            scenario = Scenario.model_validate_json(str(data["scenario"].values[i]))
            provenance = json.loads(str(data["provenance"].values[i]))
            history = (
                None if failure else ForceHistory(position, force[i], coordinate, axes, provenance)
            )
            cases.append(Case(scenario, history, str(failure)))
            if "digest" in data and str(data["digest"].values[i]) != cases[-1].digest:
                raise ValueError(f"the forces of case {i + 1} are not those that were written")
        plan = Plan.model_validate_json(str(data.attrs["plan"]))
        provenance, calibration, refinement = (
            json.loads(data.attrs.get(name, "{}"))
            for name in ("provenance", "calibration", "refinement")
        )
        kinds = kinds_in(data)
        own, again, fine = (
            tuple(case for case, of in zip(cases, kinds, strict=True) if of == kind)
            for kind in range(3)
        )
        return cls(plan, own, provenance, calibration, again, fine, refinement)


def _refuse_if_only_planned(name: str) -> None:
    """Raise InputError if a plan of that name is shipped, and the library itself is not yet."""
    if name in shipped_names("libraries", ".nc") or name not in shipped_names("plans", ".toml"):
        return
    plan = Plan.load(name)
    if plan.combined_keys:  # others are those of studies
        raise InputError(
            f"library '{name}' is planned, and its {plan.count} simulations are not all finished "
            f"yet: 'terraphi library build {name} --out {name}.nc' computes what is missing"
        )


def hash_of(cases: Sequence[Case]) -> str:
    """SHA-256 of the hashes of some cases, hexadecimal."""
    return hashlib.sha256("".join(case.scenario.hash for case in cases).encode()).hexdigest()


def differ_beyond(cases: Sequence[Case], keys: Iterable[str]) -> bool:
    """Whether the scenarios of some cases differ in more than these keys and the particle seed."""
    same = {key: value_of(cases[0].scenario, key) for key in keys}
    return len({unseeded(case.scenario.replace(**same)) for case in cases}) > 1


def kinds_in(data: Any) -> list[int]:
    """Of each case in an open library file: 0 of its plan, 1 a replicate, 2 a finer one.

    Files that were written before libraries kept the others have none.
    """
    if "replicate" not in data:
        return [0] * len(data["failure"].values)
    return [int(kind) for kind in data["replicate"].values]


def _alike(one: ForceHistory, other: ForceHistory) -> bool:
    """Whether two histories have the same axes and positions."""
    return one.axes == other.axes and np.array_equal(one.position, other.position)


def _settings_of(scenario: Scenario) -> dict[str, Any]:
    """What a case was simulated with, by keys that name their unit, JSON-able."""
    leg, soil, numerics = scenario.leg, scenario.soil, scenario.numerics
    lengths = {
        "leg_chord_mm": leg.chord,
        "leg_width_mm": leg.width,
        "hip_above_surface_mm": scenario.hip_height,
    }
    found: dict[str, Any] = {
        "model": scenario.model,
        "dimensions": scenario.dimensions,
        # To the nanometre: 19.99999999999999 is the rounding of a difference.
        **{key: round(1e3 * length, 6) for key, length in lengths.items()},
    }
    if scenario.model == "mpm":
        found |= {
            "leg_friction": leg.friction,
            "youngs_modulus_mpa": round(1e-6 * soil.youngs_modulus, 9),
            "dilation_angle_deg": soil.potential_angle_deg,
            **({"yield_surface": soil.yield_surface} if scenario.dimensions == 3 else {}),
            "cell_mm": round(1e3 * numerics.cell_size, 6),
            "particles_per_cell_side": numerics.particles_per_cell_side,
            "speed_up": numerics.speed_up,
            "contact": numerics.contact,
        }
    return found
