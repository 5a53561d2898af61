"""A plan: which simulations to make, written in TOML.

A plan is a scenario and what to change in it: keys to sweep, all combinations of their values; keys
to change one at a time, each by itself, as a study of sensitivity does; or named steps, each of
which changes some keys of the scenario before it or of the base.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from terraphi.documents import parse_toml, shipped_file
from terraphi.errors import InputError, sentence_from_validation
from terraphi.scenario import Scenario

BASE = "base"
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


class Step(BaseModel):
    """A change of some keys at once.

    Attributes
    ----------
    name
        For people.
    changes
        Dotted scenario key to its value.
    after
        What is changed: the ``previous`` step's scenario, or the ``base``.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(min_length=1)
    changes: dict[str, JsonValue] = Field(min_length=1)
    after: Literal["previous", "base"] = "previous"


class Plan(BaseModel):
    """What a library or a study is to contain.

    Attributes
    ----------
    name, description
        For people.
    scenario
        What all cases share.
    sweep
        Dotted scenario key to its values; the cases are all combinations, the first key slowest.
    one_at_a_time
        Instead of a sweep: dotted scenario key to its values; the cases are the scenario itself,
        the base, and then one for each value of each key, all other keys as in the base.
    steps
        Instead of a sweep: changes with names, one after another; the cases are the base and one
        for each step.
    presets
        Names of shipped scenarios to set beside the base, each a case as it stands.
    vary_seed
        Whether case number i of a sweep takes the scenario's seed plus i, so that the particle
        scatter of neighbouring cases is independent.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(min_length=1)
    description: str = ""
    scenario: Scenario = Field(default_factory=Scenario)
    sweep: dict[str, list[JsonValue]] = Field(default_factory=dict)
    one_at_a_time: dict[str, list[JsonValue]] = Field(default_factory=dict)
    steps: list[Step] = Field(default_factory=list)
    presets: list[str] = Field(default_factory=list)
    vary_seed: bool = False

    @model_validator(mode="after")
    def _is_one_of_two_kinds(self) -> Self:
        apart = self.one_at_a_time or self.steps or self.presets
        if not self.sweep and not apart:
            raise ValueError("'sweep' is missing or empty; name a key in it, or in 'one_at_a_time'")
        if self.sweep and apart:
            raise ValueError(
                "'sweep' combines its keys, 'one_at_a_time', 'steps' and 'presets' do not; "
                "make two plans"
            )
        if self.vary_seed and apart:
            raise ValueError("vary_seed changes the seed in every case; it is for a sweep only")
        return self

    def cases(self) -> list[Scenario]:
        """Scenarios of all cases.

        Raises
        ------
        InputError
            If a key to change does not exist or a value cannot be.
        """
        if not self.sweep:
            return [variant.scenario for variant in self.variants()]
        for key, values in self.sweep.items():
            if not values:
                raise InputError(f"plan '{self.name}': sweep key '{key}' has no values")
            if self.vary_seed and key == "numerics.seed":
                raise InputError(
                    f"plan '{self.name}': vary_seed sets numerics.seed, so it cannot be swept as "
                    "well; drop one of the two"
                )
        seed = self.scenario.numerics.seed
        found = []
        for i, combination in enumerate(itertools.product(*self.sweep.values())):
            changes = dict(zip(self.sweep, combination, strict=True))
            if self.vary_seed:
                changes["numerics.seed"] = seed + i
            found.append(self._changed("sweep", changes))
        return found

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
        for step in self.steps:
            start = found[-1].scenario if step.after == "previous" else self.scenario
            scenario = self._changed(f"step '{step.name}'", step.changes, start)
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
        if Path(source).suffix != ".toml" and not Path(source).is_file():
            source = shipped_file("plans", str(source), ".toml")
        plan = parse_toml(Path(source), cls)
        plan.cases()
        return plan


def label(variant: Variant) -> str:
    """A variant in words, such as ``numerics.cells = 64``."""
    return variant.key if variant.value is None else f"{variant.key} = {variant.value}"


def describe(plan: Plan, scenario: Scenario) -> str:
    """What makes a case of a plan differ from the others, for people."""
    if not plan.sweep:
        found = (label(v) for v in plan.variants() if v.scenario.hash == scenario.hash)
        return next(found, scenario.name or scenario.hash[:12])  # a preset may have changed since
    return ", ".join(f"{key} = {value_of(scenario, key)}" for key in plan.sweep)


def value_of(scenario: Scenario, key: str) -> Any:
    """Value of a dotted key of a scenario; raises KeyError if there is no such key."""
    value: Any = scenario.model_dump(mode="json")
    for section in key.split("."):
        value = value[section]
    return value
