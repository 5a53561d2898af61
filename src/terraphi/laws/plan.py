"""A plan: what a library is to contain, written in TOML.

The cases of a plan are all combinations of the values of its swept keys.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path

from pydantic import Field, JsonValue

from terraphi.experiment.documents import Strict, located, parse_toml
from terraphi.experiment.errors import InputError
from terraphi.experiment.rig import Rig, similar_scenario
from terraphi.experiment.scenario import Scenario

MOST_CASES = 10_000
"""Cases of a plan at most."""
RIG_ANGLES_DEG = (30.0, 45.0, 15.0)
"""Friction angles of a library of one's own rig [deg]; what lies between them law legs has learned
from other legs. On Li's three legs, which the law knew from twice as wide ones alone, φ of other
simulations is off by 0.2 to 0.4° (root mean square), and with eight angles by 0.1 to 0.5°."""
HIGHEST = 0.7
"""Largest height of the hip over the length of the leg [-]; above it the leg barely scratches."""


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
    sweep: dict[str, list[JsonValue]] = Field(min_length=1)
    """Dotted scenario key to its values; the cases are all combinations, the first key slowest."""
    more: list[More] = Field(default_factory=list)
    """Further sweeps."""
    vary_seed: bool = False
    """Give each case a particle seed of its own, counted from that of the scenario."""

    @property
    def count(self) -> int:
        """Number of cases."""
        sweeps = (self.sweep, *(more.sweep for more in self.more))
        return sum(math.prod(map(len, sweep.values())) for sweep in sweeps)

    def cases(self) -> list[Scenario]:
        """Scenarios of all cases.

        Raises
        ------
        InputError
            If a key does not exist, a value is not accepted, a case comes twice or there are too
            many.
        """
        source, scenarios = f"plan '{self.name}'", []
        if not 0 < self.count <= MOST_CASES:
            why = f"{self.count} cases; give every key a value, and at most {MOST_CASES} cases"
            raise InputError(f"{source}: {why}")
        for part in (More(sweep=self.sweep), *self.more):
            seed = self.scenario.numerics.seed if part.seed is None else part.seed
            for i, values in enumerate(itertools.product(*part.sweep.values())):
                change = dict(zip(part.sweep, values, strict=True))
                if self.vary_seed:
                    change["numerics.seed"] = seed + i
                scenarios.append(self.scenario.replace(source, **change))
        if len({case.hash for case in scenarios}) < len(scenarios):
            raise InputError(f"{source}: a case comes twice; drop one, or set vary_seed = true")
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
        (3, 'c')
        """
        if rig.ratios.hip_height > HIGHEST:
            ratio = f"{rig.ratios.hip_height:.2f} of the length; at most {HIGHEST:g}"
            raise InputError(f"hip_height_mm = {rig.hip_height_mm:g} is {ratio} can be simulated")
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
