r"""How real soils differ from a law's model, and soils of known angle in one's own apparatus.

The angle that a law reads off a record of measured forces is

    φ_read = ψ + offset,    ψ = φ + b + s + l,

the offset that of a shape of leg, b common to all soils in one apparatus, s of the soil, l of the
leg or rig in it, each normal about zero. The offset has an error, and no slope over ψ within an
error, so that it is known less away from the soils it was learned from. Forces show none of them:
they look like another angle. They are learned from soils whose angle was measured otherwise, and
stand in the law's file.

A calibration is such a soil in the user's own apparatus, in which the height of the hip, the
friction of the leg and the gain of the sensor stay as they are. Its y_i = ψ_i − φ_i is a draw of a
normal distribution, of which

    k_ij = b² + [same rig] rig_i rig_j + [same shape of leg] o(ψ_i, ψ_j)

is what a record shares with it, o the covariance of the offset's error, and s², var(φ), var(ψ) and
of each rig l² come on top where i and j are one soil. The mean and variance of b, and with it of
the offset of a shape and the error of a rig that were calibrated, follow by conditioning on y
(Rasmussen & Williams 2006, section 2.2).

Repeats, records of one soil on one rig, are pooled first: their y is the mean, and of l² only the
part that beds of one soil differ by is divided by their number. Taken as equal but for what their
standard deviations differ by, two repeats would explain a difference of 0.05° by an error of 3°.
Two rigs in one soil share of var(ψ) the smaller: what the other has on top is its own.
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
"""Standard deviation of ψ between beds of one soil on one leg [deg], a part of ``leg_sd_deg``: 27
repeats in loose grains have 0.8 (6 mm) and 1.0 (8.8 mm), together 0.7 to 1.1 with 95 % confidence.
The smaller is averaged over repeats, for beds of fine sand differ less; the larger is the scatter
at which repeats disagree."""
DISAGREE = 1.96
"""Standard deviations of the scatter at which repeats disagree [-]: one sound repeat in twenty."""


def rig_name(rig: Rig) -> str:
    """The leg with its sizes and its friction, by which rigs are distinguished."""
    return f"{rig}, friction {rig.leg_friction:g}"


def soil_name(name: Any) -> str:
    """Name of a soil; raises InputError if it is no text, or has hidden characters."""
    if not isinstance(name, str) or visible(name) != name:
        raise InputError(f"soil = {name!r:.60}; give a name of printable characters")
    return name


class CalibrationSoil(Strict):
    """A record in a soil of known friction angle."""

    source: str
    """Its file."""
    soil: Annotated[str, BeforeValidator(soil_name)] = ""
    """Name of the soil; records of one name, or without one, are of one soil."""
    leg: str
    """Shape of the leg."""
    rig: str = ""
    """Its :func:`rig_name`; another rig has errors of its own."""
    phi_deg: float = Field(gt=0, lt=90)
    """Friction angle that was measured otherwise [deg], in the law's convention."""
    phi_sd_deg: float = Field(ge=0, le=90)
    """Its standard deviation [deg]."""
    read_deg: float
    """Angle that the law reads off the record, its offset taken off: ψ [deg]."""
    read_sd_deg: float = Field(ge=0, le=90)
    """Standard deviation of that from noise, density and the law [deg]."""
    rig_sd_deg: float = Field(0.0, ge=0, le=90)
    """The same from the height of the hip, the friction of the leg and the gain, which stay."""
    gain: float = Field(1.0, gt=0)
    """Gain of the sensor that its forces were divided by [-]."""


class Calibration(Strict):
    """Soils of known friction angle in one apparatus, read by one law."""

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
        """A sentence for each soil with a repeat farther from the others than beds of it are."""
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
        own, own_rig = legs == leg, (legs == leg) & (rigs == rig)
        sd = math.sqrt(float(np.square(rig_sd[own_rig]).mean())) if own_rig.any() else 0.0
        same_leg = legs[:, None] == legs
        same_rig = same_leg & (rigs[:, None] == rigs)
        # Rigs in one soil share s, φ and most of what makes φ_read uncertain.
        of_soil = error.soil_sd_deg**2 + phi_sd**2 + np.minimum.outer(read_sd, read_sd) ** 2
        bed = min(BED_SD_DEG, error.leg_sd_deg)
        total = same_leg * error.offset_covariance(read, read) + same_rig * np.outer(rig_sd, rig_sd)
        total += error.common_sd_deg**2 + (soils[:, None] == soils) * of_soil
        total += np.diag(1e-6 + error.leg_sd_deg**2 - bed**2 * (1.0 - 1.0 / count))
        flat = phi_deg.ravel()
        across = error.common_sd_deg**2 + own * error.offset_covariance(flat, read)
        across += own_rig * sd * rig_sd
        solved = np.linalg.solve(total, across.T)
        prior = error.common_sd_deg**2 + sd**2
        prior += own.any() * np.diag(error.offset_covariance(flat, flat))
        variance = np.maximum(prior - (across.T * solved).sum(axis=0), 0.0)
        mean = ((read - phi) @ solved).reshape(phi_deg.shape)
        return mean, np.sqrt(variance).reshape(phi_deg.shape)

    @cached_property
    def _pooled(self) -> list[FloatArray]:
        """Leg, rig, soil, φ, its sd, mean ψ, its sd, that of the rig, and number of repeats."""
        rows = []
        for records in self.repeats:
            first, n = records[0], len(records)
            read = sum(record.read_deg for record in records) / n
            sds = [
                math.sqrt(sum(getattr(record, name) ** 2 for record in records) / n)
                for name in ("read_sd_deg", "rig_sd_deg")
            ]
            rows.append(
                (first.leg, first.rig, first.soil, first.phi_deg, first.phi_sd_deg, read, *sds, n)
            )
        return [np.array(column) for column in zip(*rows, strict=True)]

    def save(self, path: Path | str) -> None:
        """Write it as TOML; raises InputError if the place cannot be written."""
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
        """Read one that :meth:`save` wrote; raises InputError if it is none."""
        return parse_toml(Path(path), cls)
