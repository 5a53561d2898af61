"""Force histories that are inverted together: several legs, repeated trials."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import (
    DENSE_DEG,
    ForceHistory,
    Observation,
    is_dense,
    is_read_again,
)
from terraphi.experiment.measurements import Measurement, scenario_of
from terraphi.experiment.scenario import Scenario
from terraphi.inference.answer import Record
from terraphi.inference.defects import Inspection, inspect_record, touches_soil_deg
from terraphi.inference.explanation import OFFSETS, Explanation, explain
from terraphi.inference.findings import Doubt, Measure, Side
from terraphi.inference.first_contact import first_contact
from terraphi.inference.noise import Noise, window_covariance
from terraphi.inference.prior import DENSITIES, Marginal
from terraphi.inference.verdict import deviations, nrmsd
from terraphi.inference.words import of_doubt
from terraphi.library.store import Library

if TYPE_CHECKING:
    from terraphi.inference.discrepancy import Learnt
    from terraphi.inference.known_soils import Calibration

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
FIRST = ("soil.yield_criterion", "soil.yield_surface", "soil.flow", "numerics.contact")
"""Keys that are named before others in which a history differs: they change forces the most."""
HIP = "hip above the surface"


@dataclass(frozen=True, eq=False)
class Trial:
    """One history.

    Attributes
    ----------
    history
        Forces over the whole window of leg angles.
    leg
        Shape of the leg that was moved.
    source
        Where it comes from, for people.
    density
        Bulk density of the soil as the source has it [kg/m3]; ``None`` if it is not known.
    density_assumed, leg_assumed
        Whether that, or the leg, is a guess.
    """

    history: ForceHistory
    leg: str
    source: str = ""
    density: float | None = None
    density_assumed: bool = False
    leg_assumed: bool = False

    @classmethod
    def of(cls, one: Measurement, leg: str | None = None) -> Trial:
        """A measurement, on the leg that is named or else as measured."""
        return cls(
            history=one.history,
            leg=leg or one.leg,
            source=one.name,
            density=one.density_kg_m3,
            density_assumed=one.density_assumed,
            leg_assumed=one.leg_assumed and leg is None,
        )

    @property
    def simulation(self) -> dict[str, Any]:
        """What a history that was simulated says of its simulation; empty for any other."""
        if "scenario" not in self.history.provenance:
            return {}
        known = ("scenario_hash", "model_version", "seed")
        return {key: self.history.provenance.get(key) for key in known}

    def made_as(self, scenario: Scenario, varied: Iterable[str] = ()) -> bool:
        """Whether a library's own model made it, whatever the parameters that it varies."""
        known = "scenario" in self.history.provenance
        return known and not unlike(self.history, scenario, self.leg, varied=varied)


@dataclass(frozen=True, eq=False)
class Repeats:
    """All trials of one leg.

    Attributes
    ----------
    leg
        Shape of the leg.
    trials
        In the order given.
    observations
        Of each.
    """

    leg: str
    trials: tuple[Trial, ...]
    observations: tuple[Observation, ...]

    @cached_property
    def readings(self) -> FloatArray:
        """Leg angles of the record with the fewest readings in the window, shape [sample].

        Those where all have forces [rad].
        """
        low = max(float(t.history.position[0]) for t in self.trials)
        high = min(float(t.history.position[-1]) for t in self.trials)
        records = [t.history.between(low, high) for t in self.trials]
        return min(records, key=lambda record: len(record.engaged().position)).position

    @property
    def read_twice(self) -> list[Trial]:
        """Coarse records that are compared at other angles than their own."""
        common = self.readings
        return [
            trial
            for trial in self.trials
            if is_read_again(trial.history.position, common)
            and not is_dense(trial.history.between(common[0], common[-1]).position)
        ]

    @property
    def window_covariances(self) -> list[FloatArray]:
        """Noise covariance of each trial's window means, of readings of unit variance [-]."""
        return [
            window_covariance(t.history.position, o.theta_deg, read_at=self.readings)
            for t, o in zip(self.trials, self.observations, strict=True)
        ]

    @property
    def mean(self) -> FloatArray:
        """Mean of the observation vectors [N], shape [2 theta]."""
        return self.vectors[0] if len(self.trials) == 1 else self.vectors.mean(axis=0)

    @property
    def vectors(self) -> FloatArray:
        """Observation vectors [N], shape [trial, 2 theta]."""
        return np.stack([o.vector for o in self.observations])


class Through(NamedTuple):
    """The library's curves that the histories of a leg are compared with."""

    scenario: Scenario
    """Any of its scenarios for that leg."""
    curves: FloatArray
    """At the density of the soil [N], shape [case, 2 theta]."""
    density: float | None
    """That density [kg/m3]; ``None`` if it is inferred."""
    varied: Iterable[str] = ()
    """Keys in which histories may differ from the library."""


class Matched(NamedTuple):
    """A history matched with the curve that fits best."""

    trial: Trial
    through: Through
    record: Record
    measures: list[Measure]
    """How well that fits."""
    why: Explanation
    """What would explain a misfit."""

    @property
    def fits(self) -> bool:
        """Whether no measure is exceeded."""
        return not any(measure.exceeded for measure in self.measures)

    def question(self, *, misfit: bool) -> Doubt | None:
        """What is asked about it, if the verdict is a misfit or is none."""
        asked = self.why.question
        # Noise may hide a flat top, and a smaller angle fit what is left of it.
        if asked is None or asked.code == "saturated" or (misfit and not self.fits):
            return asked
        return None


def beyond(seen: Sequence[Matched]) -> Side | None:
    """End of the library beyond which an angle would explain all histories that do not fit."""
    ends = {one.why.beyond for one in seen if not one.fits}
    return ends.pop() if len(ends) == 1 else None


@dataclass(frozen=True, eq=False)
class Looked:
    """Histories without their damaged readings, and what was found to be damaged.

    Attributes
    ----------
    trials
        Each history without its damaged readings, in the order given.
    inspections
        The damage found in each.
    groups
        The trials by leg.
    """

    trials: tuple[Trial, ...]
    inspections: tuple[Inspection, ...]
    groups: tuple[Repeats, ...]

    @property
    def several(self) -> bool:
        """Whether there is more than one, so that what is said of one has to name it."""
        return len(self.trials) > 1

    @property
    def spoilt(self) -> bool:
        """Whether one is damaged so badly that no answer can be believed."""
        return any(inspection.spoilt for inspection in self.inspections)

    @property
    def damage(self) -> list[Doubt]:
        """What was left out of each."""
        return [
            defect.doubt(self.name_of(trial))
            for trial, inspection in zip(self.trials, self.inspections, strict=True)
            for defect in inspection.defects
        ]

    def name_of(self, trial: Trial) -> str:
        """Its source, where it has to be named."""
        return trial.source if self.several else ""

    def beside(
        self,
        repeats: Repeats,
        through: Through,
        best: FloatArray,
        nodes: tuple[FloatArray, FloatArray] | None,
        *,
        most: float | None = None,
    ) -> list[Matched]:
        """The trials of a leg beside the curve that fits best.

        Parameters
        ----------
        repeats, through
            Trials of one leg, and what they are compared with.
        best
            The curve [N], shape [2 theta].
        nodes
            Closely spaced friction angles, and curves there, as :func:`explain` has them; ``None``:
            misfits are not explained.
        most
            Largest deviation that is accepted, of peak-to-peak [-].
        """
        found = []
        for trial, observation in zip(repeats.trials, repeats.observations, strict=True):
            seen = self._inspected(trial)
            record = Record(
                source=trial.source,
                leg=trial.leg,
                observation=observation,
                readings=trial.history.position,
                best=best,
                nrmsd=nrmsd(observation.vector, best),
                data=seen.as_dict(),
                simulation=trial.simulation,
                left_out_deg=seen.left_out_deg,
                leg_assumed=trial.leg_assumed,
            )
            why = explain(observation.vector, *nodes) if nodes else Explanation()
            measures = deviations(record.nrmsd, most=most, source=self.name_of(trial))
            found.append(Matched(trial, through, record, measures, why))
        return found

    def _inspected(self, trial: Trial) -> Inspection:
        return next(
            inspection
            for one, inspection in zip(self.trials, self.inspections, strict=True)
            if one is trial
        )

    def doubts(self, seen: Sequence[Matched], *, misfit: bool) -> list[Doubt]:
        """Questions on all histories, and why they may not be what they were taken for.

        Parameters
        ----------
        seen
            The histories beside their best curves.
        misfit
            Whether that is the verdict.
        """
        found: list[Doubt] = []
        for repeats in self.groups:
            for one in (one for one in seen if one.trial.leg == repeats.leg):
                history, (scenario, curves, density, varied) = one.trial.history, one.through
                question = one.question(misfit=misfit)
                # A zero that is seen to be off is told as such.
                if self.spoilt and question is not None and question.code in OFFSETS:
                    question = None
                said = [question, unlike(history, scenario, repeats.leg, varied=varied)]
                if question is None:
                    contact = self._inspected(one.trial).contact
                    said += [contact.doubt() if contact else None]
                    said += slips(one.record.observation, curves)
                said.append(other_density(history, density))
                source = self.name_of(one.trial)
                found += [replace(doubt, source=source) for doubt in said if doubt is not None]
            numbers = {"leg": repeats.leg, "spacing_deg": DENSE_DEG}
            found += [Doubt("read_twice", numbers, t.source) for t in repeats.read_twice]
        return found

    def check_noise(self, noise: Noise) -> None:
        """Refuse noise that a history cannot have."""
        for trial in self.trials:
            noise.check_against(trial.history, source=trial.source)


@dataclass(frozen=True, eq=False, kw_only=True)
class Ways:
    """How to infer, as in :func:`~terraphi.inference.inversion.invert`, and what is known already.

    Attributes
    ----------
    likelihood, sampler, noise, discrepancy, seed, steps, calibration
        As there; ``None`` where nobody said.
    priors
        Of every parameter that the library varies, and of the density if it has one; empty: φ alone
        is uniform over the library.
    density
        Bulk density of the soil [kg/m³]; ``None`` if it is inferred, or the library's is assumed.
    density_assumed
        Whether it is a guess.
    """

    likelihood: str | None
    sampler: str | None
    noise: Noise
    discrepancy: str | Learnt | None
    seed: int
    steps: int | None
    calibration: Calibration | None
    priors: Mapping[str, Marginal]
    density: float | None
    density_assumed: bool


@contextmanager
def named(trial: Trial) -> Iterator[None]:
    """Name the history in what is refused."""
    try:
        yield
    except InputError as error:
        if trial.source and trial.source not in str(error):
            raise InputError(f"{trial.source}: {error}") from error
        raise


def look(trials: Sequence[Trial], library: Library) -> Looked:
    """Look for what a damaged sensor leaves in each history, and put those of a leg together.

    Parameters
    ----------
    trials
        One or more.
    library
        Whose curves say where the leg may touch the soil.

    Raises
    ------
    InputError
        If there is none, the same history is given twice, or one cannot be used.
    """
    found, left = [], []
    for trial in trials:
        with named(trial):
            library.rotations(trial.leg, over_phi=False)
            # Where the library's leg is in air, one simulated otherwise may still lift soil.
            comparable = not trial.simulation or trial.made_as(library.cases[0].scenario)
            touches = touches_soil_deg(library, trial.leg) if comparable else None
            seen = inspect_record(trial.history, touches_deg=touches)
            # What a simulation's geometry is it says itself.
            if not trial.simulation:
                seen = replace(seen, contact=first_contact(seen.history, trial.leg, library))
            found.append(seen)
            left.append(replace(trial, history=seen.history))
            try:
                seen.history.observation()
            except InputError as error:
                said = [f"{error}.", *(of_doubt(one.doubt()) for one in seen.defects)]
                raise InputError(" ".join(said).rstrip(".")) from error
    return Looked(tuple(left), tuple(found), tuple(grouped(left)))


def grouped(trials: Sequence[Trial]) -> list[Repeats]:
    """Trials by leg; all are observed where each of that leg has forces, and where the coarsest is.

    Parameters
    ----------
    trials
        One or more.

    Raises
    ------
    InputError
        If there is none, the same history is given twice, or one cannot be used.
    """
    if not trials:
        raise InputError("there is no force history; give one or more")
    seen: dict[tuple[str, bytes], str] = {}
    for trial in trials:
        key = (trial.leg, trial.history.force.tobytes())
        if key in seen:
            raise InputError(
                f"{trial.source or 'a history'} has the same forces as {seen[key] or 'another'}: "
                "a trial that counts twice would make the interval too narrow; drop one of the two"
            )
        seen[key] = trial.source
    found = []
    for leg in dict.fromkeys(t.leg for t in trials):
        same = tuple(t for t in trials if t.leg == leg)
        bare = Repeats(leg, same, ())
        cut = tuple(t.history.as_read_at(bare.readings).observation() for t in same)
        found.append(Repeats(leg, same, cut))
    return found


def check_origin(trials: Sequence[Trial]) -> None:
    """Refuse simulated histories beside measured ones: they are of no one soil."""
    simulated, measured = (
        [t for t in trials if bool(t.simulation) is kind] for kind in (True, False)
    )
    if simulated and measured:
        raise InputError(
            f"{simulated[0].source} is simulated and {measured[0].source} is measured; histories "
            "that are inverted together are of one soil: invert them apart"
        )


def common_density(trials: Sequence[Trial]) -> tuple[float | None, bool]:
    """Density that the sources agree on [kg/m3], and whether it is a guess.

    Raises
    ------
    InputError
        If they do not agree.
    """
    known = [t for t in trials if t.density is not None]
    one = next(iter(known), None)
    if one is None:
        return None, True
    other = next((t for t in known if t.density != one.density), None)
    if other is not None:
        raise InputError(
            f"{one.source} is of soil of {one.density:g} kg/m³ and {other.source} of "
            f"{other.density:g} kg/m³; histories that are inverted together are of one soil: give "
            "its density, or invert them apart"
        )
    return one.density, all(t.density_assumed for t in known)


def check_trials(
    repeats: Repeats,
    scenario: Scenario,
    density: float | None,
    *,
    varied: Iterable[str] = (),
) -> None:
    """Refuse what cannot be inverted with a library: odd magnitudes, or another leg or hip.

    Parameters
    ----------
    repeats
        Trials of one leg.
    scenario
        Of the library.
    density
        Density that is taken as known [kg/m3]; ``None`` if it is inferred.
    varied
        Keys that it varies, and that histories may differ in.

    Raises
    ------
    InputError
        With the number that is wrong.
    """
    _check_density(density, scenario)
    for trial, observation in zip(repeats.trials, repeats.observations, strict=True):
        with named(trial):
            _check_forces(observation)
            _check_same_setup(trial.history, scenario, varied)


def _check_density(density: float | None, scenario: Scenario) -> None:
    """Refuse one that can only be in another unit, and scaling where it does not hold."""
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


def _check_forces(observation: Observation) -> None:
    """Refuse forces that can only be in another unit, or of no sensor."""
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
    differences.sort(key=lambda one: one[0] not in FIRST)
    return Doubt("unlike", {"differences": differences}) if differences else None


def other_density(history: ForceHistory, density: float | None) -> Doubt | None:
    """A doubt if a history is of another density [kg/m³] than it is inverted with."""
    made_by = scenario_of(history)
    how = "simulated with" if made_by else "measured at"
    own = made_by.soil.density if made_by else history.provenance.get("density_kg_m3")
    if density and own and abs(own - density) > 1e-6 * density:
        return Doubt("other_density", {"made": how, "own": own, "used": density})
    return None


def slips(observation: Observation, curves: FloatArray) -> list[Doubt]:
    """Questions on units and signs.

    Parameters
    ----------
    observation
        Window means of a history.
    curves
        The library's, at the density of the soil [N], shape [case, 2 theta].
    """
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


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and their values."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _check_same_setup(history: ForceHistory, scenario: Scenario, varied: Iterable[str]) -> None:
    """Refuse a simulated history of a leg or hip unlike the library's."""
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
                f"the history was simulated with {name} = {found:g} m, the library "
                f"with {expected:g} m; build a library for this setup"
            )
