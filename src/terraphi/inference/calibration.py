r"""How real soils differ from a law's model, and calibration soils in the user's own apparatus.

The angle that a law reads off a record of measured forces is

    φ_read = ψ + offset,    ψ = φ + b + s + l.

The offset is that of a shape of leg. Its error has a height and a slope over ψ, so that it grows
away from the training soils. b is common to all soils in one apparatus, s belongs to the soil, and
l to the leg or rig in it; each is normal about zero. They look like another angle, so that forces
show none of them. They are learned from soils whose angle was measured otherwise, and stand in the
law's file. The table :data:`~terraphi.inference.terms.TERMS` has them as model: offset, apparatus,
soil and leg.

A calibration soil is such a soil in the user's own apparatus, which keeps the height of the hip,
the friction of the leg and the gain of the sensor (the fixed terms of the table). Its
y_i = ψ_i − φ_i is normal, and

    k_ij = b² + [same rig] rig_i rig_j + [same shape of leg] o(ψ_i, ψ_j)

is what a record shares with it, o the covariance of the offset's error. Where i and j are one soil,
s², var(φ), var(ψ) and of each rig l² are added. The mean and variance of b follow by conditioning
on y (Rasmussen & Williams 2006, section 2.2); those of a calibrated shape include its offset's
error, and those of a calibrated rig its own error.

Repeats, records of one soil on one rig, are pooled first. Their y is the mean, and only the part of
l² by which beds of one soil differ is divided by their number. Two repeats with independent errors
of their standard deviations alone would explain a difference of 0.05° by an error of 3°. Two rigs
in one soil share the smaller of their var(ψ).
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import Strict, parse_toml
from terraphi.experiment.errors import InputError, visible
from terraphi.experiment.files import atomic_write
from terraphi.experiment.outputs import SIGNATURE
from terraphi.experiment.rig import Rig
from terraphi.laws.law import ModelError
from terraphi.laws.legs import LawOfLegs

BED_SD_DEG, MOST_BED_SD_DEG = 0.7, 1.1
"""Standard deviation of ψ between beds of one soil on one leg [deg], a part of ``leg_sd_deg``. 27
repeats in loose grains have 0.8 (6 mm) and 1.0 (8.8 mm), together 0.7 to 1.1 with 95 % confidence.
The mean of repeats uses the smaller, because beds of fine sand differ less; the test of repeats
uses the larger."""
DISAGREE = 1.96
"""Distance from the other repeats, over its standard deviation, that is warned of [-]: one sound
repeat in twenty."""


def rig_name(rig: Rig) -> str:
    """Name of a rig: the leg, its sizes and its friction."""
    return f"{rig}, friction {rig.leg_friction:g}"


def soil_name(name: Any) -> str:
    """Name of a soil; raises InputError if it is no text, or has hidden characters."""
    if not isinstance(name, str) or visible(name) != name:
        raise InputError(f"soil = {name!r:.60}; give a name of printable characters")
    return name


class CalibrationSoil(Strict):
    """A record in a calibration soil."""

    source: str
    """Its file."""
    soil: Annotated[str, BeforeValidator(soil_name)] = ""
    """Name of the soil; records of one name, or without one, are of one soil."""
    leg: str
    """Shape of the leg."""
    rig: str = ""
    """Its :func:`rig_name`."""
    phi_deg: float = Field(gt=0, lt=90)
    """Friction angle by another test [deg], in the law's convention."""
    phi_sd_deg: float = Field(ge=0, le=90)
    """Its standard deviation [deg]."""
    read_deg: float
    """ψ: angle that the law reads off the record, minus the law's offset [deg]."""
    read_sd_deg: float = Field(ge=0, le=90)
    """Standard deviation of ψ by noise, density and the law [deg]."""
    rig_sd_deg: float = Field(0.0, ge=0, le=90)
    """Standard deviation of ψ by hip height, leg friction and gain, which the rig keeps [deg]."""
    gain: float = Field(1.0, gt=0)
    """Gain of the sensor that its forces were divided by [-]."""


class Calibration(Strict):
    """Calibration soils in one apparatus, read by one law."""

    library: str
    """Name of the law."""
    library_hash: str
    """Its hash."""
    soils: list[CalibrationSoil] = Field(min_length=1)
    """The records."""

    @model_validator(mode="after")
    def _one_angle_a_soil(self) -> Calibration:
        angles: dict[str, str] = {}
        for record in self.soils:
            angle = f"{record.phi_deg:g} ± {record.phi_sd_deg:g}°"
            if angles.setdefault(record.soil, angle) != angle:
                soil = f"soil '{record.soil}' has" if record.soil else "records without a soil have"
                raise ValueError(
                    f"{soil} φ = {angles[record.soil]} and {angle}; give each soil a name (--soil, "
                    'or soil = "NAME" in the file) and one angle'
                )
        return self

    def __str__(self) -> str:
        """Soils with their angles and records."""
        records: dict[str, list[CalibrationSoil]] = defaultdict(list)
        for record in self.soils:
            records[record.soil].append(record)
        return ", ".join(
            f"{f'soil {soil}' if soil else 'a soil'} of {of_soil[0].phi_deg:g} ± "
            f"{of_soil[0].phi_sd_deg:g}° ({', '.join(record.source for record in of_soil)})"
            for soil, of_soil in records.items()
        )

    @cached_property
    def repeats(self) -> list[list[CalibrationSoil]]:
        """Records by soil, leg and rig."""
        groups: dict[tuple[str, ...], list[CalibrationSoil]] = defaultdict(list)
        for record in self.soils:
            groups[record.soil, record.leg, record.rig].append(record)
        return list(groups.values())

    def warnings(self) -> Iterator[str]:
        """A sentence for each soil with a repeat that differs by more than beds of a soil do."""
        for records in self.repeats:
            read, n = np.array([record.read_deg for record in records]), len(records)
            if n == 1:
                continue
            distance = (read - read.mean()) * n / (n - 1)
            worst = int(np.abs(distance).argmax())
            limit = DISAGREE * MOST_BED_SD_DEG * math.sqrt(n / (n - 1))
            if abs(distance[worst]) > limit:
                yield (
                    f"{records[worst].source} reads {distance[worst]:+.1f}° from the other repeats "
                    f"of its soil, and beds differ by at most {limit:.1f}°: check that the soil, "
                    "the density and the leg are the same."
                )

    def check(self, library: LawOfLegs, gains: Mapping[str, float]) -> None:
        """Refuse another law, or another gain of a rig's sensor, than those of the calibration.

        Raises
        ------
        InputError
            If the law is another, or has changed, or a gain is another.
        """
        if (library.name, library.hash) != (self.library, self.library_hash):
            raise InputError(
                f"the calibration is for law '{self.library}' as it was then, and this is "
                f"'{library.name}'; invert with that law, or calibrate again"
            )
        for soil in self.soils:
            given = gains.get(soil.rig, soil.gain)
            if abs(given - soil.gain) > 1e-6 * soil.gain:
                raise InputError(
                    f"gain = {given:g}, and the calibration of this rig was made with "
                    f"{soil.gain:g}; give the same --gain"
                )

    def common(
        self, error: ModelError, leg: str, rig: str, phi_deg: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of b at angles ψ, given the calibration soils [deg].

        Where the shape of the leg was calibrated they are those of b and its offset's error
        together, and where the rig was, those of its own error as well.
        """
        legs, rigs, soils, phi, phi_sd, read, read_sd, rig_sd, count = self._pooled
        on_leg, on_rig = legs == leg, (legs == leg) & (rigs == rig)
        sd = math.sqrt(float(np.square(rig_sd[on_rig]).mean())) if on_rig.any() else 0.0
        b = error.common_sd_deg**2
        # K of the soils, y = read − phi.
        same_leg = legs[:, None] == legs
        same_rig = same_leg & (rigs[:, None] == rigs)
        of_soil = error.soil_sd_deg**2 + phi_sd**2 + np.minimum.outer(read_sd, read_sd) ** 2
        bed = min(BED_SD_DEG, error.leg_sd_deg)
        total = b + same_leg * error.offset_covariance(read, read)
        total += same_rig * np.outer(rig_sd, rig_sd) + (soils[:, None] == soils) * of_soil
        total += np.diag(1e-6 + error.leg_sd_deg**2 - bed**2 * (1.0 - 1.0 / count))
        # k between the record's angles and the soils, and conditioning on y.
        flat = phi_deg.ravel()
        across = b + on_leg * error.offset_covariance(flat, read) + on_rig * sd * rig_sd
        solved = np.linalg.solve(total, across.T)
        prior = b + sd**2 + on_leg.any() * np.diag(error.offset_covariance(flat, flat))
        variance = np.maximum(prior - (across.T * solved).sum(axis=0), 0.0)
        mean = ((read - phi) @ solved).reshape(phi_deg.shape)
        return mean, np.sqrt(variance).reshape(phi_deg.shape)

    @cached_property
    def _pooled(self) -> list[FloatArray]:
        """Leg, rig, soil, φ, its sd, mean ψ, its sd, that of the rig, and number of repeats."""
        rows = []
        for records in self.repeats:
            first = records[0]
            read, *variances = np.mean(
                [(r.read_deg, r.read_sd_deg**2, r.rig_sd_deg**2) for r in records], axis=0
            )
            sds = np.sqrt(variances)
            rows.append((first.leg, first.rig, first.soil, first.phi_deg, first.phi_sd_deg, read,
                         *sds, len(records)))  # fmt: skip
        return [np.array(column) for column in zip(*rows, strict=True)]

    def save(self, path: Path | str) -> None:
        """Write a TOML file; raises InputError if the place cannot be written."""
        lines = [
            f"# {SIGNATURE}: a calibration",
            f'library = "{self.library}"',
            f'library_hash = "{self.library_hash}"',
        ]
        for soil in self.soils:
            lines += ["", "[[soils]]"]
            for key, value in soil.model_dump().items():
                lines.append(f"{key} = {json.dumps(value, ensure_ascii=False)}")
        with atomic_write(Path(path)) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path | str) -> Calibration:
        """Read a file of :meth:`save`; raises InputError if it is no calibration."""
        return parse_toml(Path(path), cls)
