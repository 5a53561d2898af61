"""What is known of each parameter before the forces are seen."""

from __future__ import annotations

import math
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
    bounds: Mapping[str, tuple[float, float]],
    given: Sequence[str] = (),
    *,
    density: float | None = None,
) -> dict[str, Marginal]:
    """Prior of each parameter of a library, and of the density if it is asked for.

    Parameters
    ----------
    bounds
        Dotted key of each parameter that the library varies to its bounds.
    given
        What a person wrote: ``KEY=LOW:HIGH`` (uniform), ``KEY=MEAN+-SD`` (normal) or ``KEY=VALUE``
        (known); the key may be shortened to its last parts. The others are uniform.
    density
        Of the soil, if it is known [kg/m³].

    Raises
    ------
    InputError
        If a key is none of these or comes twice, a number cannot be read, or a prior or the density
        leaves the library.
    """
    found = {key: Marginal(*ends) for key, ends in bounds.items()}
    keys = dict.fromkeys([*bounds, DENSITY])
    written: dict[str, str] = {}
    for text in given:
        name, _, value = text.partition("=")
        matches = [k for k in keys if is_on(text, k)]
        if len(matches) != 1 or not value:
            raise InputError(
                f"prior '{text}': expected KEY=LOW:HIGH, KEY=MEAN+-SD or KEY=VALUE with a key of "
                f"the library; {nearest(name, list(keys))}"
            )
        key = matches[0]
        if key in written:
            raise InputError(f"priors '{written[key]}' and '{text}' are both on {key}; give one")
        written[key] = text
        found[key] = parsed(text, value, Marginal(*bounds.get(key, DENSITIES)))
        _check_within(bounds, key, found[key], f"prior '{text}'")
    if density is not None:
        found[DENSITY] = Marginal(float(density), float(density))
        _check_within(bounds, DENSITY, found[DENSITY], f"density = {density:g} kg/m³")
    return found


def _check_within(
    bounds: Mapping[str, tuple[float, float]], key: str, marginal: Marginal, told: str
) -> None:
    """Refuse a prior that leaves the library, or a density that is none of a soil."""
    low, high = bounds.get(key, DENSITIES)
    slack = 1e-9 * (high - low)
    if not low - slack <= marginal.low <= marginal.high <= high + slack:
        reach = "" if marginal.fixed else f" reaches from {marginal.low:g} to {marginal.high:g}"
        where = "in this library" if key in bounds else "in soils"
        verb = ": " if marginal.fixed else "; "
        raise InputError(f"{told}{reach}{verb}{key} lies between {low:g} and {high:g} {where}")


def is_on(text: str, key: str) -> bool:
    """Whether a prior as a person wrote it is one on a key."""
    name = text.partition("=")[0]
    return name == key or key.endswith("." + name)


def parsed(text: str, value: str, within: Marginal) -> Marginal:
    """A prior as a person wrote it; a normal one is cut off where the library ends."""
    expected = "expected KEY=LOW:HIGH with LOW below HIGH, KEY=MEAN+-SD or KEY=VALUE"
    try:
        if ":" in value:
            low, high = (plain_number(part) for part in value.split(":"))
            if low < high:
                return Marginal(low, high)
        mean, sd = number_with_sd(value)
    except ValueError as error:
        raise InputError(f"prior '{text}': {expected}") from error
    if not math.isfinite(mean) or not (sd is None or math.isfinite(sd)):
        raise InputError(f"prior '{text}': {expected}, all of them finite numbers")
    if sd is None:
        return Marginal(mean, mean)
    if sd <= 0.0:
        raise InputError(f"prior '{text}': the standard deviation has to be above 0")
    low, high = max(mean - FAR * sd, within.low), min(mean + FAR * sd, within.high)
    if low >= high:
        raise InputError(
            f"prior '{text}': lies more than {FAR:g} standard deviations outside {within.low:g} to "
            f"{within.high:g}, which is what can be inferred"
        )
    return Marginal(low, high, (mean, sd))
