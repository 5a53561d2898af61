"""Force histories that are inverted together: several legs, repeated trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import (
    DENSE_DEG,
    ForceHistory,
    Observation,
    is_dense,
    is_read_again,
)
from terraphi.experiment.scenario import Scenario
from terraphi.inference.checks import check_magnitudes, check_same_setup, doubts, unlike
from terraphi.inference.findings import Doubt
from terraphi.surrogate.training import Training

FloatArray = NDArray[np.float64]


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
    density_assumed
        Whether that is a guess.
    """

    history: ForceHistory
    leg: str
    source: str = ""
    density: float | None = None
    density_assumed: bool = False

    def made_as(self, training: Training) -> bool:
        """Whether the library's own model made it, whatever the parameters that it varies."""
        known = "scenario" in self.history.provenance
        varied = training.bounds
        return known and not unlike(self.history, training.scenario, self.leg, varied=varied)


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
    def vectors(self) -> FloatArray:
        """Observation vectors [N], shape [trial, 2 theta]."""
        return np.stack([o.vector for o in self.observations])


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
    for trial in trials:
        trial.history.observation()  # refuses by itself what does not cover the window
    found = []
    for leg in dict.fromkeys(t.leg for t in trials):
        same = tuple(t for t in trials if t.leg == leg)
        bare = Repeats(leg, same, ())
        cut = tuple(t.history.as_read_at(bare.readings).observation() for t in same)
        found.append(Repeats(leg, same, cut))
    return found


def common_density(trials: Sequence[Trial]) -> tuple[float | None, bool]:
    """Density that the sources agree on [kg/m3], and whether it is a guess.

    Raises
    ------
    InputError
        If they do not agree.
    """
    known = {t.density: t for t in trials if t.density is not None}
    if len(known) > 1:
        one, other = list(known.values())[:2]
        raise InputError(
            f"{one.source} is of soil of {one.density:g} kg/m³ and {other.source} of "
            f"{other.density:g} kg/m³; histories that are inverted together are of one soil: give "
            "its density, or invert them apart"
        )
    if not known:
        return None, True
    ((density, trial),) = known.items()
    return density, trial.density_assumed


def check_trials(
    repeats: Repeats, scenario: Scenario, varied: Mapping[str, object], density: float | None
) -> None:
    """Refuse what cannot be inverted with a library: odd magnitudes, or another leg or hip.

    Parameters
    ----------
    repeats
        Trials of one leg.
    scenario
        Of the library.
    varied
        Keys that it varies, and that histories may differ in.
    density
        Density that is taken as known [kg/m3]; ``None`` if it is inferred.

    Raises
    ------
    InputError
        With the number that is wrong.
    """
    for trial, observation in zip(repeats.trials, repeats.observations, strict=True):
        check_magnitudes(density, observation, scenario)
        check_same_setup(trial.history, scenario, source=trial.source, varied=varied)


def warnings_on(repeats: Repeats, training: Training, density: float | None) -> list[Doubt]:
    """Why the trials of a leg may not be what they were taken for.

    Parameters
    ----------
    repeats
        Trials of one leg.
    training
        What the library holds of it.
    density
        Density that the trials are inverted with [kg/m3]; ``None`` if it is inferred.
    """
    found = [
        Doubt("read_twice", {"leg": repeats.leg, "spacing_deg": DENSE_DEG}, trial.source)
        for trial in repeats.read_twice
    ]
    curves = training.forces
    if density is not None:
        curves = curves * (density / training.density)[:, None]
    for trial, observation in zip(repeats.trials, repeats.observations, strict=True):
        other = unlike(trial.history, training.scenario, repeats.leg, varied=training.bounds)
        said = [*filter(None, [other]), *doubts(trial.history, observation, curves, density)]
        found += [replace(one, source=trial.source) for one in said]
    return found
