"""What is known of each parameter before the forces are seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import number_with_sd, plain_number
from terraphi.surrogate.training import DENSITY

DENSITIES = (100.0, 10000.0)
"""Bulk densities that are accepted [kg/m³]; 1.6 is one in g/cm³."""
FAR = 6.0
"""Standard deviations at which a normal prior ends."""


@dataclass(frozen=True)
class Marginal:
    """Prior of one parameter: uniform between its bounds, or normal and cut off there.

    Attributes
    ----------
    low, high
        Bounds; equal if the parameter is fixed.
    normal
        Mean and standard deviation; ``None`` if uniform.
    """

    low: float
    high: float
    normal: tuple[float, float] | None = None

    @property
    def fixed(self) -> bool:
        """Whether there is nothing to infer."""
        return self.low == self.high

    @property
    def middle(self) -> float:
        """Mean, of a normal one before it is cut off."""
        return self.normal[0] if self.normal else 0.5 * (self.low + self.high)

    @property
    def cut_off(self) -> tuple[bool, bool]:
        """Whether more lies beyond the bounds: not where a normal prior has run out by itself."""
        if self.normal is None:
            return True, True
        mean, sd = self.normal
        low, high = mean - 0.999 * FAR * sd, mean + 0.999 * FAR * sd
        return self.low > low, self.high < high

    def log_density(self, values: FloatArray) -> FloatArray:
        """Log density up to a constant; minus infinity beyond the bounds."""
        inside = (values >= self.low) & (values <= self.high)
        shape = np.zeros_like(values)
        if self.normal is not None:
            shape = -0.5 * np.square((values - self.normal[0]) / self.normal[1])
        return np.where(inside, shape, -np.inf)

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Independent draws, shape [count]."""
        if self.normal is None:
            return rng.uniform(self.low, self.high, count)
        from scipy.stats import truncnorm

        mean, sd = self.normal
        ends = ((self.low - mean) / sd, (self.high - mean) / sd)
        return truncnorm.rvs(*ends, mean, sd, size=count, random_state=rng)

    @property
    def sd(self) -> float:
        """Standard deviation."""
        if self.normal is None:
            return float((self.high - self.low) / np.sqrt(12.0))
        from scipy.stats import truncnorm

        mean, sd = self.normal
        return float(truncnorm.std((self.low - mean) / sd, (self.high - mean) / sd, mean, sd))

    def as_dict(self) -> dict[str, float | str]:
        """Plain numbers."""
        if self.fixed:
            return {"kind": "fixed", "value": self.low}
        if self.normal is not None:
            return {"kind": "normal", "mean": self.normal[0], "sd": self.normal[1]}
        return {"kind": "uniform", "low": self.low, "high": self.high}


def priors(
    bounds: Mapping[str, tuple[float, float]], given: Sequence[str] = ()
) -> dict[str, Marginal]:
    """Prior of each parameter of a library, and of the density if it is asked for.

    Parameters
    ----------
    bounds
        Dotted key of each parameter that the library varies to its bounds.
    given
        What a person wrote: ``KEY=LOW:HIGH`` (uniform), ``KEY=MEAN+-SD`` (normal) or ``KEY=VALUE``
        (known); the key may be shortened to its last parts. The others are uniform.

    Raises
    ------
    InputError
        If a key is none of these, a number cannot be read, or the prior leaves the library.
    """
    found = {key: Marginal(*ends) for key, ends in bounds.items()}
    keys = dict.fromkeys([*bounds, DENSITY])
    for text in given:
        name, _, value = text.partition("=")
        matches = [k for k in keys if is_on(text, k)]
        if len(matches) != 1 or not value:
            raise InputError(
                f"prior '{text}': expected KEY=LOW:HIGH, KEY=MEAN+-SD or KEY=VALUE with a key of "
                f"the library; {nearest(name, list(keys))}"
            )
        key = matches[0]
        marginal = parsed(text, value, found.get(key))
        low, high = bounds.get(key, DENSITIES)
        slack = 1e-9 * (high - low)
        if not low - slack <= marginal.low <= marginal.high <= high + slack:
            raise InputError(
                f"prior '{text}' reaches from {marginal.low:g} to {marginal.high:g}; {key} lies "
                f"between {low:g} and {high:g} in this library"
            )
        found[key] = marginal
    return found


def is_on(text: str, key: str) -> bool:
    """Whether a prior as a person wrote it is one on a key."""
    name = text.partition("=")[0]
    return name == key or key.endswith("." + name)


def parsed(text: str, value: str, within: Marginal | None) -> Marginal:
    """A prior as a person wrote it; a normal one is cut off where the library ends."""
    try:
        if ":" in value:
            low, high = (plain_number(part) for part in value.split(":"))
            if low < high:
                return Marginal(low, high)
        mean, sd = number_with_sd(value)
        if sd is None:
            return Marginal(mean, mean)
        if sd > 0.0:
            low, high = mean - FAR * sd, mean + FAR * sd
            if within is not None:
                low, high = max(low, within.low), min(high, within.high)
            if low < high:
                return Marginal(low, high, (mean, sd))
    except ValueError:
        pass
    raise InputError(
        f"prior '{text}': expected KEY=LOW:HIGH with LOW below HIGH, KEY=MEAN+-SD or KEY=VALUE"
    )
