"""A plan: which simulations to make, written in TOML.

A plan is a scenario and what to change in it: keys to sweep, all combinations of their values; keys
to sample, points that fill the box of their bounds evenly (beside a sweep every point with every
combination); keys to change one at a time, each by itself, as a study of sensitivity does; or named
steps, each of which changes some keys of the scenario before it or of the base.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any, NamedTuple, Self

from pydantic import Field, JsonValue, ValidationError, model_validator

from terraphi.experiment.documents import Strict, parse_toml, shipped_file
from terraphi.experiment.errors import InputError, nearest, sentence_from_validation
from terraphi.experiment.files import is_there
from terraphi.experiment.scenario import Scenario
from terraphi.forward.forecast import refuse_what_cannot_fit

MOST_CASES = 100_000
"""Cases that a plan may have: of more, the scenarios alone would fill the memory."""
MOST_POINTS = 65536
"""Points of a sample."""
LONGEST_CAVEAT = 25
"""Words of a caveat."""
BASE, PREVIOUS = "base", "previous"
PRESET = "preset"


class Variant(NamedTuple):
    """The plan's scenario with one thing changed."""

    key: str
    """Dotted scenario key that was changed, or the name of a step; ``base`` for none, ``preset``
    for another preset."""
    value: JsonValue
    """Its value; the name of the preset; ``None`` for the base and for a step."""
    scenario: Scenario
    """The whole."""


class Step(Strict):
    """A change of some keys at once."""

    name: str = Field(min_length=1)
    """Name of the step, for people."""
    changes: dict[str, JsonValue] = Field(min_length=1)
    """Dotted scenario key to its value."""
    after: str = PREVIOUS
    """What is changed: the ``previous`` step's scenario, the ``base``, or an earlier step by its
    name."""


class Sample(Strict):
    """Points in the box of several keys' bounds, by a scrambled Sobol sequence.

    A larger count goes on where a smaller one of the same seed ended, so that a library built
    anew with more points computes only those.
    """

    keys: dict[str, tuple[float, float]] = Field(min_length=1)
    """Dotted scenario key, of a number, to its lower and upper bound."""
    count: int = Field(ge=0, le=MOST_POINTS)
    """Number of points; powers of two fill the box most evenly."""
    seed: int = Field(0, ge=0)
    """Seed of the scrambling (Owen, *J. Complexity* 14:466, 1998)."""
    also: list[list[float]] = Field(default_factory=list)
    """Further points, values in the order of the keys, such as those that ``terraphi library
    suggest`` names."""

    @model_validator(mode="after")
    def _is_a_box(self) -> Self:
        for key, (low, high) in self.keys.items():
            if not low < high:
                raise ValueError(f"'{key}' is to lie between {low:g} and {high:g}; low first")
        for point in self.also:
            if len(point) != len(self.keys):
                raise ValueError(f"'also' has {point}; a number for each of {list(self.keys)}")
        if self.count + len(self.also) == 0:
            raise ValueError("there is no point; raise 'count'")
        return self

    def points(self) -> list[dict[str, float]]:
        """Key to value, rounded to six digits, for each point."""
        from scipy.stats import qmc

        found: list[list[float]] = []
        if self.count:
            # Drawn as a whole power of two, lest SciPy should warn of what we know.
            exponent = (self.count - 1).bit_length()
            unit = qmc.Sobol(len(self.keys), scramble=True, rng=self.seed).random_base2(exponent)
            box = qmc.scale(unit[: self.count], *zip(*self.keys.values(), strict=True))
            found = [[float(f"{value:.6g}") for value in point] for point in box]
        return [dict(zip(self.keys, p, strict=True)) for p in [*found, *self.also]]

    def numbers(self) -> list[int]:
        """Number of each point, which it keeps when others are added.

        Those of ``also`` count from :data:`MOST_POINTS`.
        """
        return [*range(self.count), *range(MOST_POINTS, MOST_POINTS + len(self.also))]


class More(Strict):
    """Cases that a sweep got later, such as angles between its own."""

    sweep: dict[str, list[JsonValue]] = Field(min_length=1)
    """Values of the same keys as those of the plan's own sweep."""
    seed: int | None = Field(None, ge=0)
    """Particle seed of the first of them; the next ones count from it. With ``vary_seed`` alone,
    where it has to be given."""


class Plan(Strict):
    """What a library or a study is to contain."""

    name: str = Field(min_length=1)
    """Name of the plan, for people."""
    description: str = ""
    """What it is for, for people."""
    caveat: str = ""
    """What every answer through the library has to say of it, in at most 25 words."""
    scenario: Scenario = Field(default_factory=Scenario)
    """What all cases share."""
    sweep: dict[str, list[JsonValue]] = Field(default_factory=dict)
    """Dotted scenario key to its values; the cases are all combinations, the first key slowest."""
    more: list[More] = Field(default_factory=list)
    """Further sweeps of the same keys, whose cases follow: a library that is made denser keeps
    the simulations that it has."""
    sample: Sample | None = None
    """Points in the bounds of some keys, each with all combinations of the sweep, if there is
    one."""
    one_at_a_time: dict[str, list[JsonValue]] = Field(default_factory=dict)
    """Instead of a sweep: dotted scenario key to its values; the cases are the scenario itself,
    the base, and then one for each value of each key, all other keys as in the base."""
    steps: list[Step] = Field(default_factory=list)
    """Instead of a sweep: changes with names, one after another; the cases are the base and one
    for each step."""
    presets: list[str] = Field(default_factory=list)
    """Names of shipped scenarios to set beside the base, each a case as it stands."""
    vary_seed: bool = False
    """Whether case number i of a sweep takes the scenario's seed plus i, so that the particle
    scatter of neighbouring cases is independent. In a sample it is counted point by point, so that
    further points change no seed."""

    @model_validator(mode="after")
    def _is_one_of_two_kinds(self) -> Self:
        if (count := len(self.caveat.split())) > LONGEST_CAVEAT:
            raise ValueError(f"'caveat' has {count} words; at most {LONGEST_CAVEAT} are expected")
        apart = self.one_at_a_time or self.steps or self.presets
        combines = self.sweep or self.sample
        if not combines and not apart:
            raise ValueError("'sweep' is missing or empty; name a key in it, or in 'one_at_a_time'")
        if combines and apart:
            raise ValueError(
                f"'{'sweep' if self.sweep else 'sample'}' combines its keys, 'one_at_a_time', "
                "'steps' and 'presets' do not; make two plans"
            )
        if self.sample and (both := sorted(set(self.sweep) & set(self.sample.keys))):
            raise ValueError(f"'{both[0]}' is both swept and sampled; drop one of the two")
        for more in self.more:
            if (more.seed is not None) != self.vary_seed:
                raise ValueError(
                    "'more' needs a seed of its own with vary_seed, and without it none"
                )
            if list(more.sweep) != list(self.sweep):
                raise ValueError(
                    f"'more' sweeps {list(more.sweep)} and 'sweep' {list(self.sweep)}; let both "
                    "have the same keys in the same order"
                )
        if self.vary_seed and apart:
            raise ValueError("vary_seed changes the seed in every case; it is for a sweep only")
        return self

    def cases(self) -> list[Scenario]:
        """Scenarios of all cases.

        Raises
        ------
        InputError
            If a key to change does not exist, a value cannot be, or there are too many.
        """
        self._refuse_too_many()
        if not self.combined_keys:
            return [variant.scenario for variant in self.variants()]
        for key, values in itertools.chain(*(sweep.items() for sweep, _ in self._sweeps())):
            if not values:
                raise InputError(f"plan '{self.name}': sweep key '{key}' has no values")
        if self.vary_seed and "numerics.seed" in self.combined_keys:
            raise InputError(
                f"plan '{self.name}': vary_seed sets numerics.seed, so it cannot be swept as "
                "well; drop one of the two"
            )
        table = "sample" if self.sample else "sweep"
        points: list[dict[str, float]] = self.sample.points() if self.sample else [{}]
        numbers = self.sample.numbers() if self.sample else [0]
        found = []
        for sweep, seed in self._sweeps():
            combinations = list(itertools.product(*sweep.values()))
            every = itertools.product(enumerate(combinations), zip(numbers, points, strict=True))
            for (i, combination), (number, point) in every:
                changes: dict[str, JsonValue] = {
                    **dict(zip(sweep, combination, strict=True)), **point,
                }  # fmt: skip
                if self.vary_seed:
                    changes["numerics.seed"] = seed + number * len(combinations) + i
                found.append(self._changed(table, changes))
        self._refuse_repeats(found)
        return found

    def _sweeps(self) -> list[tuple[dict[str, list[JsonValue]], int]]:
        """Every sweep and the particle seed that it begins with."""
        own = (self.sweep, self.scenario.numerics.seed)
        return [own, *((more.sweep, more.seed or 0) for more in self.more)]

    @property
    def swept(self) -> dict[str, list[JsonValue]]:
        """Keys of all sweeps, each with the values of one sweep after another."""
        return {key: [v for sweep, _ in self._sweeps() for v in sweep[key]] for key in self.sweep}

    def _refuse_repeats(self, found: list[Scenario]) -> None:
        """Raise InputError if a case comes twice, or further sweeps have seeds of earlier ones."""
        if not self.more:
            seen: set[str] = set()
            for case in found:
                if case.hash in seen:
                    raise InputError(
                        f"plan '{self.name}': {describe(self, case)} is asked for more than once; "
                        "drop one of the two, or let vary_seed = true make them differ"
                        f"{', or widen the bounds of the sample' if self.sample else ''}"
                    )
                seen.add(case.hash)
            return
        kinds = {unseeded(case) for case in found}
        if len(kinds) < len(found):
            raise InputError(
                f"plan '{self.name}': a case of 'more' stands in an earlier sweep; drop it there"
            )
        if self.vary_seed and len({case.numerics.seed for case in found}) < len(found):
            raise InputError(
                f"plan '{self.name}': the seeds of a sweep of 'more' overlap with earlier ones; "
                "give it one that is further away"
            )

    @property
    def count(self) -> int:
        """Number of cases; none of them is made for it."""
        if self.combined_keys:
            points = self.sample.count + len(self.sample.also) if self.sample else 1
            return points * sum(math.prod(map(len, s.values())) for s, _ in self._sweeps())
        changed = sum(map(len, self.one_at_a_time.values()))
        return 1 + changed + len(self.steps) + len(self.presets)

    def refuse_what_cannot_fit(self, *, memory: float | None = None) -> None:
        """Refuse a plan of which a case could not be held or finished, before any is begun.

        Parameters
        ----------
        memory
            As :func:`terraphi.forward.forecast.refuse_what_cannot_fit` has it [byte].

        Raises
        ------
        InputError
            Names the case, unless all share it, the key that is to blame, and what to do.
        """
        for scenario in self.cases():
            refused = _why_it_cannot_fit(scenario, memory)
            if refused is not None:
                # What all cases share is not for one of them to answer for.
                shared = str(_why_it_cannot_fit(self.scenario, memory)) == str(refused)
                case = "" if shared else f", {describe(self, scenario)}"
                raise InputError(f"plan '{self.name}'{case}: {refused}") from refused

    def _refuse_too_many(self) -> None:
        if self.count <= MOST_CASES:
            return
        sizes = {key: len(values) for key, values in {**self.one_at_a_time, **self.swept}.items()}
        sizes |= {"steps": len(self.steps), "presets": len(self.presets)}
        if self.sample:
            sizes |= {"sample.count": self.sample.count, "sample.also": len(self.sample.also)}
        largest = max(sizes, key=lambda key: sizes[key])
        a_sample = ", or let a [sample] fill the same box with fewer"
        raise InputError(
            f"plan '{self.name}': {self.count:,} cases, and at most {MOST_CASES:,} are possible; "
            f"most come of '{largest}', {sizes[largest]:,}; drop some"
            f"{a_sample if largest in self.sweep else ''}"
        )

    @property
    def combined_keys(self) -> tuple[str, ...]:
        """Keys that are swept, then those that are sampled."""
        return (*self.sweep, *(self.sample.keys if self.sample else ()))

    def variants(self) -> list[Variant]:
        """The base, every change of one key, the steps, the presets; of a sweep, the base alone.

        Raises
        ------
        InputError
            If a key to change or a preset does not exist, a value cannot be, or two cases are the
            same.
        """
        found = [Variant(BASE, None, self.scenario)]
        for key, values in self.one_at_a_time.items():
            if not values:
                raise InputError(f"plan '{self.name}': one_at_a_time key '{key}' has no values")
            for value in values:
                scenario = self._changed("one_at_a_time", {key: value})
                found.append(Variant(key, value, scenario))
        earlier = {BASE: self.scenario, PREVIOUS: found[-1].scenario}
        for step in self.steps:
            if step.name in earlier:
                raise InputError(
                    f"plan '{self.name}': the name '{step.name}' of a step is taken, by the base "
                    "or a step before it; give it another"
                )
            if step.after not in earlier:
                raise InputError(
                    f"plan '{self.name}': step '{step.name}' is after '{step.after}', which is no "
                    f"step before it; {nearest(step.after, earlier)}"
                )
            scenario = self._changed(f"step '{step.name}'", step.changes, earlier[step.after])
            earlier |= {step.name: scenario, PREVIOUS: scenario}
            found.append(Variant(step.name, None, scenario))
        found += [Variant(PRESET, name, Scenario.load(name)) for name in self.presets]
        seen: dict[str, str] = {}
        for variant in found:
            twin = seen.get(variant.scenario.hash)
            if twin is not None:
                raise InputError(
                    f"plan '{self.name}': {label(variant)} is the same case as {twin}; "
                    "drop one of the two"
                )
            seen[variant.scenario.hash] = label(variant)
        return found

    def _changed(
        self, table: str, changes: dict[str, JsonValue], start: Scenario | None = None
    ) -> Scenario:
        """The plan's scenario, or another, with some keys replaced."""
        try:
            return (start or self.scenario).replace(**changes)
        except ValidationError as error:
            sentence = sentence_from_validation(error, f"plan '{self.name}', {table}", Scenario)
            raise InputError(sentence) from error

    @classmethod
    def load(cls, source: Path | str) -> Plan:
        """Read a plan from a TOML file, or a shipped one by its name.

        Raises
        ------
        InputError
            If the file is missing, not TOML, has an unknown key or a value that cannot be.
        """
        if Path(source).suffix != ".toml" and not is_there(Path(source)):
            source = shipped_file("plans", str(source), ".toml")
        plan = parse_toml(Path(source), cls)
        plan.cases()
        return plan


def _why_it_cannot_fit(scenario: Scenario, memory: float | None) -> InputError | None:
    """What a scenario would be refused with."""
    try:
        refuse_what_cannot_fit(scenario, memory=memory)
    except InputError as error:
        return error
    return None


def label(variant: Variant) -> str:
    """A variant in words, such as ``numerics.cells = 64``."""
    return variant.key if variant.value is None else f"{variant.key} = {variant.value}"


def describe(plan: Plan, scenario: Scenario) -> str:
    """What makes a case of a plan differ from the others, for people."""
    if not plan.combined_keys:
        found = (label(v) for v in plan.variants() if v.scenario.hash == scenario.hash)
        return next(found, scenario.name or scenario.hash[:12])  # a preset may have changed since
    keys = list(plan.combined_keys)
    if any(value in values[:i] for values in plan.sweep.values() for i, value in enumerate(values)):
        keys.append("numerics.seed")  # the same case more than once
    return ", ".join(f"{key} = {value_of(scenario, key)}" for key in keys)


def unseeded(scenario: Scenario) -> str:
    """Hash of a scenario but for its particle seed."""
    return scenario.replace(**{"numerics.seed": 0}).hash


def value_of(scenario: Scenario, key: str) -> Any:
    """Value of a dotted key of a scenario; raises KeyError if there is no such key."""
    value: Any = scenario.model_dump(mode="json")
    for section in key.split("."):
        value = value[int(section) if isinstance(value, list) else section]
    return value
