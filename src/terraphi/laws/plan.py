"""A plan: what a library is to contain, written in TOML.

The cases of a plan are all combinations of the values of its swept keys, or points drawn in a box
of several keys, or the base scenario with one key changed at a time.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any, Self

from pydantic import Field, JsonValue, model_validator

from terraphi.experiment.documents import Strict, located, parse_toml
from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.rig import Rig, similar_scenario
from terraphi.experiment.scenario import Scenario

MOST_CASES = 10_000
"""Cases of a plan at most."""
RIG_ANGLES_DEG = (35.0, 30.0, 40.0, 25.0, 45.0, 20.0, 15.0, 50.0)
"""Friction angles of a library of one's own rig [deg]; between them law legs interpolates."""
HIGHEST = 0.7
"""Largest height of the hip over the length of the leg [-]; above it the leg barely scratches."""


class Sample(Strict):
    """Points in a box of several keys, from a scrambled Sobol sequence."""

    keys: dict[str, tuple[float, float]] = Field(min_length=1)
    """Dotted scenario key to its lower and upper bound."""
    count: int = Field(ge=1, le=MOST_CASES)
    """Number of points; a larger count continues the sequence of a smaller one."""
    seed: int = Field(0, ge=0)
    """Seed of the scrambling (Owen, *J. Complexity* 14:466, 1998)."""

    @model_validator(mode="after")
    def _is_a_box(self) -> Self:
        for key, (low, high) in self.keys.items():
            if not low < high:
                raise ValueError(f"'{key}': the bounds {low:g} and {high:g} are not in order")
        return self

    def points(self) -> list[dict[str, float]]:
        """Key to value of each point, rounded to six digits."""
        with needing("[sample] of a plan", "SciPy", extra="simulate"):
            from scipy.stats import qmc

        exponent = (self.count - 1).bit_length()
        unit = qmc.Sobol(len(self.keys), scramble=True, rng=self.seed).random_base2(exponent)
        box = qmc.scale(unit[: self.count], *zip(*self.keys.values(), strict=True))
        return [
            {key: float(f"{value:.6g}") for key, value in zip(self.keys, point, strict=True)}
            for point in box
        ]


class More(Strict):
    """A further sweep, such as angles between those of the first."""

    sweep: dict[str, list[JsonValue]] = Field(min_length=1)
    """Dotted scenario key to its values."""
    seed: int | None = Field(None, ge=0)
    """Particle seed of its first case, with ``vary_seed``; ``None``: that of the scenario."""


class Plan(Strict):
    """The simulations that a library is made of.

    Examples
    --------
    >>> plan = terraphi.Plan(name="mine", sweep={"soil.friction_angle_deg": [25.0, 30.0, 35.0]})
    >>> [case.soil.friction_angle_deg for case in plan.cases()]
    [25.0, 30.0, 35.0]
    """

    name: str = Field(min_length=1)
    """Name of the library."""
    description: str = ""
    """Purpose of the library."""
    caveat: str = ""
    """A warning that goes with every answer from it, at most 25 words."""
    scenario: Scenario = Field(default_factory=Scenario)
    """Scenario from which the cases differ by the keys below."""
    sweep: dict[str, list[JsonValue]] = Field(default_factory=dict)
    """Dotted scenario key to its values; the cases are all combinations, the first key slowest."""
    more: list[More] = Field(default_factory=list)
    """Further sweeps."""
    sample: Sample | None = None
    """Points in a box, each combined with the sweep."""
    one_at_a_time: dict[str, list[JsonValue]] = Field(default_factory=dict)
    """The base scenario, then each value of each key alone; instead of ``sweep``."""
    vary_seed: bool = False
    """Give each case a particle seed of its own, counted from that of the scenario."""

    @model_validator(mode="after")
    def _is_of_one_kind(self) -> Self:
        if self.one_at_a_time and (self.sweep or self.more or self.sample or self.vary_seed):
            raise ValueError("one_at_a_time excludes sweep, more, sample and vary_seed")
        if not (self.sweep or self.sample or self.one_at_a_time):
            raise ValueError("there are no cases: give sweep, sample or one_at_a_time")
        return self

    @property
    def _sweeps(self) -> list[tuple[dict[str, list[JsonValue]], int]]:
        """Each sweep with its first particle seed."""
        seed = self.scenario.numerics.seed
        first = [(self.sweep, seed)]
        return first + [
            (more.sweep, seed if more.seed is None else more.seed) for more in self.more
        ]

    @property
    def count(self) -> int:
        """Number of cases."""
        if self.one_at_a_time:
            return 1 + sum(map(len, self.one_at_a_time.values()))
        points = self.sample.count if self.sample else 1
        return points * sum(math.prod(map(len, sweep.values())) for sweep, _ in self._sweeps)

    def cases(self) -> list[Scenario]:
        """Scenarios of all cases.

        Raises
        ------
        InputError
            If a key does not exist, a value is not accepted, a case comes twice or there are too
            many.
        """
        if not 0 < self.count <= MOST_CASES:
            raise InputError(
                f"plan '{self.name}': {self.count} cases; give every key a value, and at most "
                f"{MOST_CASES} cases in all"
            )
        changes: list[dict[str, JsonValue]] = []
        if self.one_at_a_time:
            changes = [{}] + [
                {key: value} for key, values in self.one_at_a_time.items() for value in values
            ]
        points: list[dict[str, Any]] = list(self.sample.points()) if self.sample else [{}]
        for sweep, seed in self._sweeps if not self.one_at_a_time else []:
            combinations = itertools.product(itertools.product(*sweep.values()), points)
            for i, (values, point) in enumerate(combinations):
                change = {**dict(zip(sweep, values, strict=True)), **point}
                changes.append({**change, "numerics.seed": seed + i} if self.vary_seed else change)
        source = f"plan '{self.name}'"
        scenarios = [self.scenario.replace(source, **change) for change in changes]
        if len({case.hash for case in scenarios}) < len(scenarios):
            raise InputError(
                f"plan '{self.name}': a case comes twice; drop one, or set vary_seed = true"
            )
        return scenarios

    @classmethod
    def of_rig(cls, rig: Rig) -> Plan:
        """The plan of a library for a rig: material point method in three dimensions, dry soil.

        Bed, cells and steps follow from the rig's ratios (:func:`similar_scenario`); the leg has
        the length of Li's, and inversion scales the forces.

        Raises
        ------
        InputError
            If a ratio is outside what can be simulated.

        Examples
        --------
        >>> plan = terraphi.Plan.of_rig(terraphi.Rig.of("li2013", "c"))
        >>> plan.count, plan.scenario.leg.shape
        (8, 'c')
        """
        if rig.ratios.hip_height > HIGHEST:
            raise InputError(
                f"hip_height_mm = {rig.hip_height_mm:g} is {rig.ratios.hip_height:.2f} of the "
                f"length; at most {HIGHEST:g} can be simulated"
            )
        first, *further = RIG_ANGLES_DEG
        scenario = similar_scenario(
            rig.leg, rig.ratios, friction_angle_deg=first, leg_friction=rig.leg_friction
        )
        return cls(
            name=f"{rig.leg}-{rig.length_mm:g}",
            description=str(rig),
            scenario=scenario,
            sweep={"soil.friction_angle_deg": [first, *further]},
            vary_seed=True,
        )

    @classmethod
    def load(cls, source: Path | str) -> Plan:
        """Read a plan from a TOML file, or a shipped one by its name.

        Raises
        ------
        InputError
            If the file is missing, not TOML, has an unknown key or a value that is not accepted.
        """
        plan = parse_toml(located(source, "plans", ".toml"), cls)
        plan.cases()
        return plan
