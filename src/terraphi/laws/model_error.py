r"""How real soils differ from a law of legs: a linear mixed model of what it reads minus φ.

    φ_read − φ = x'β + s + l + r + e

β are fixed effects with the mean and covariance that training soils leave them, and x is the row of
a record (:func:`effects`): the offset of its leg, the size of the grains over the width of the leg,
the width over the depth, and what real soil has in common. s is the error of a soil, l of a shape
of leg in it, r of a rig, and e of a bed, which fades with the size of the grains. All are normal,
and look like another angle, so that forces show none of them.

``studies/errors.py`` fits the model by restricted maximum likelihood and writes it into the file of
law ``legs``. The table :data:`~terraphi.inference.terms.TERMS` has its parts as *model: offset*,
*soil*, *leg*, *rig* and *bed*; :class:`~terraphi.inference.calibration.Calibration` conditions it
on soils of known angle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property

import numpy as np
from pydantic import Field, model_validator

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import Strict
from terraphi.experiment.rig import Rig

MIDDLE_DEG = 27.0
"""Reading at which the effect of the width over the depth holds [deg]."""
USUAL_SIZE, USUAL_BREADTH = 6.0 / 25.4, 25.4 / 56.2
"""Diameter of the grains over the width of the leg [-] for which their effects are given, and width
over depth [-] for which those of breadth are 0: of most simulated records, on the rig of Li et al.
(2013)."""

FINE_MM = 0.35
"""Diameter of sand whose grains are not known, and the smallest that counts [mm]: the geometric
mean of sand, which has 0.063 to 2 mm (ISO 14688-1). Twice of it moves φ by 0.2 to 0.4°."""


def relative_size(rig: Rig, grain_size_mm: float) -> float:
    """Diameter of the grains over the width of the leg, over :data:`USUAL_SIZE` [-]."""
    return max(grain_size_mm, FINE_MM) / rig.width_mm / USUAL_SIZE


def effects(rig: Rig, grain_size_mm: float) -> dict[str, float]:
    """Row x of a record by the names of the effects, at a reading of :data:`MIDDLE_DEG`.

    Effects that are absent are 0. ``breadth × reading`` is for each 10° of the reading above that.
    """
    # Grains count by their diameter over the width, linearly for each shape and by its square root
    # for all of them. The breadth is the width over the depth of the leg, as a logarithm.
    size = relative_size(rig, grain_size_mm)
    depth_mm = rig.length_mm - rig.hip_height_mm
    breadth = math.log(rig.width_mm / depth_mm / USUAL_BREADTH)
    return {
        f"offset {rig.leg}": 1.0, f"grains {rig.leg}": size, "grains curve": math.sqrt(size),
        "breadth": breadth, "real soil": 1.0,
    }  # fmt: skip


class OfLeg(Strict):
    """What training records of a shape of leg have."""

    phi_deg: tuple[float, float] | None = None
    """Smallest and largest angle of the soils [deg]."""
    shift_deg: float = 0.0
    """Mean shift of the leg angle [deg]."""
    nrmsd_limit: float = Field(0.25, gt=0)
    """Residual above which a record in fine soil is a misfit [-]."""
    nrmsd_of_size: float = Field(0.0, ge=0)
    """Its growth with the grains, for a size of :data:`USUAL_SIZE` [-]."""
    training: tuple[str, ...] = ()
    """Names of the records."""


class ModelError(Strict):
    """Error of a law of legs on real soil; by default that of a law of which nothing is learned."""

    effects: tuple[str, ...] = ("real soil",)
    """Names of the fixed effects, of :func:`effects` and ``breadth × reading``."""
    mean_deg: tuple[float, ...] = (0.0,)
    """Their means [deg]."""
    covariance_deg2: tuple[tuple[float, ...], ...] = ((9.0,),)
    """Their covariance [deg²]."""
    soil_sd_deg: float = Field(4.0, ge=0)
    """Standard deviation of s, between soils [deg]."""
    leg_sd_deg: float = Field(2.0, ge=0)
    """Standard deviation of l, between shapes of leg in one soil [deg]."""
    rig_sd_deg: float = Field(0.0, ge=0)
    """Standard deviation of r, between rigs [deg]."""
    bed_sd_deg: float = Field(0.0, ge=0)
    """Standard deviation of e, between beds of grains of :data:`USUAL_SIZE` [deg]."""
    legs: Mapping[str, OfLeg] = Field(default_factory=dict)
    """By shape of leg."""

    @model_validator(mode="after")
    def _one_size(self) -> ModelError:
        k = len(self.effects)
        if np.shape(self.mean_deg) != (k,) or [len(row) for row in self.covariance_deg2] != [k] * k:
            raise ValueError("effects, mean_deg and covariance_deg2 differ in their number")
        return self

    def of_leg(self, leg: str) -> OfLeg:
        """What is known of a shape of leg."""
        return self.legs.get(leg, OfLeg())

    def row(self, rig: Rig, grain_size_mm: float, read_deg: float = MIDDLE_DEG) -> FloatArray:
        """Row x of a record at what the law reads [deg], shape [effect]."""
        values = effects(rig, grain_size_mm)
        values["breadth × reading"] = values["breadth"] * (read_deg - MIDDLE_DEG) / 10.0
        return np.array([values.get(name, 0.0) for name in self.effects])

    def offset(self, rig: Rig, grain_size_mm: float, phi_deg: FloatArray) -> FloatArray:
        """Mean of φ_read − φ at friction angles φ of the soil [deg].

        With φ_read − φ = a + b (φ_read − 27°) it is (a + b (φ − 27°)) / (1 − b).
        """
        # Only the breadth acts with the reading. The equation for the reading,
        # φ_read = φ + a + b (φ_read − 27°), is solved for φ_read − φ.
        row, mean = effects(rig, grain_size_mm), dict(zip(self.effects, self.mean_deg, strict=True))
        a = sum(value * mean.get(name, 0.0) for name, value in row.items())
        b = 0.1 * row["breadth"] * mean.get("breadth × reading", 0.0)
        return np.asarray((a + b * (phi_deg - MIDDLE_DEG)) / (1.0 - b))

    @cached_property
    def root(self) -> FloatArray:
        """Square root R of the covariance C = R R' of the effects [deg], shape [effect, cause]."""
        # By eigenvectors, for a covariance of few soils may be singular, and its least eigenvalue
        # negative by rounding. A column is a cause that answers by one law share.
        values, vectors = np.linalg.eigh(np.array(self.covariance_deg2))
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))

    def nrmsd_limit(self, rig: Rig, grain_size_mm: float) -> float:
        """Residual above which a record is a misfit [-]."""
        leg = self.of_leg(rig.leg)
        return leg.nrmsd_limit + leg.nrmsd_of_size * relative_size(rig, grain_size_mm)

    def bed_sd(self, rig: Rig, grain_size_mm: float) -> float:
        """Standard deviation of φ between beds, in proportion to the size of the grains [deg]."""
        return self.bed_sd_deg * relative_size(rig, grain_size_mm)
