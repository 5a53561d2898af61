r"""Calibration soils in the user's own apparatus: further rows of the mixed model of real soil.

A calibration soil has a friction angle that was measured otherwise. Its record reads ψ, the law's
mean offset taken off, and y_i = ψ_i − φ_i is normal about 0 with the covariance of the model
(:mod:`~terraphi.laws.model_error`)

    K_ij = x_i'C x_j + [same rig] (r² + rig_i rig_j)
           + [same soil] (s² + var(φ) + var(ψ) + [same leg] l²) + [i = j] e_i² / n_i,

with rig_i the standard deviation of ψ by what an apparatus keeps: the height of the hip, the
friction of the leg and the gain of the sensor (the fixed terms of the table
:data:`~terraphi.inference.terms.TERMS`). A record in another soil shares

    k_i = x'C x_i + [same rig] (r² + rig rig_i)

with it. The mean and variance of its offset's error, of its rig's if that was calibrated, follow by
conditioning on y (Rasmussen & Williams 2006, section 2.2).

Repeats, records of one soil on one rig, are pooled first. Their y is the mean, and only the part by
which beds of one soil differ is divided by their number n. Two repeats with independent errors of
their standard deviations alone would explain a difference of 0.05° by an error of 3°. Two rigs in
one soil share the smaller of their var(ψ).
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
from terraphi.inference.checks import in_air, leg_readings, without_faults
from terraphi.inference.inversion import FAR, judge, law_for, record_fits
from terraphi.inference.likelihood import Likelihood
from terraphi.inference.records import Record, open_records, rig_name
from terraphi.inference.terms import TERMS, root_sum_square
from terraphi.laws.law import AnyLaw
from terraphi.laws.legs import LawOfLegs
from terraphi.laws.model_error import ModelError

MOST_BED_SD_DEG = 1.1
"""Largest standard deviation of ψ between beds of one soil on one leg [deg]: 27 repeats in loose
grains have 0.8 (6 mm) and 1.0 (8.8 mm), together 0.7 to 1.1 with 95 % confidence."""
DISAGREE = 1.96
"""Distance from the other repeats, over its standard deviation, that is warned of [-]: one sound
repeat in twenty."""


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
    """Its :func:`~terraphi.inference.records.rig_name`."""
    phi_deg: float = Field(gt=0, lt=90)
    """Friction angle by another test [deg], in the law's convention."""
    phi_sd_deg: float = Field(ge=0, le=90)
    """Its standard deviation [deg]."""
    read_deg: float
    """ψ: angle that the law reads off the record, minus the law's offset [deg]."""
    read_sd_deg: float = Field(ge=0, le=90)
    """Standard deviation of ψ by noise, density and the law [deg]."""
    row: tuple[float, ...] = ()
    """x: its row in the mixed model of the law's error, shape [effect]."""
    bed_sd_deg: float = Field(0.0, ge=0, le=90)
    """Standard deviation of ψ between beds [deg]."""
    rig_sd_deg: float = Field(0.0, ge=0, le=90)
    """Standard deviation of ψ by hip height, leg friction and gain, which the rig keeps [deg]."""
    grain_size_mm: float = Field(0.0, ge=0)
    """Mean diameter of its grains; 0 in fine sand."""
    gain: float = Field(1.0, gt=0)
    """Gain of the sensor that its forces were divided by [-]."""
    readings: str = ""
    """Its :attr:`~terraphi.inference.records.Record.readings_hash`; empty in earlier files."""


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
                angles_given = f"{soil} φ = {angles[record.soil]} and {angle}"
                raise ValueError(f"{angles_given}; give each soil a name (--soil) and one angle")
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
            # From the mean of the n − 1 others: rᵢ − (Σ r − rᵢ) / (n − 1) = (rᵢ − r̄) n / (n − 1).
            # Its variance is σ² n / (n − 1).
            distance = (read - read.mean()) * n / (n - 1)
            worst = int(np.abs(distance).argmax())
            limit = DISAGREE * MOST_BED_SD_DEG * math.sqrt(n / (n - 1))
            if abs(distance[worst]) > limit:
                yield (
                    f"{records[worst].source} differs by {distance[worst]:+.1f}° from the other "
                    f"repeats, beds at most {limit:.1f}°: check the soil, the density and the leg."
                )

    def check(self, library: LawOfLegs, gains: Mapping[str, float]) -> None:
        """Refuse another law, or another gain of a rig's sensor, than those of the calibration.

        Raises
        ------
        InputError
            If the law is another, or has changed, or a gain is another.
        """
        if (library.name, library.hash) != (self.library, self.library_hash):
            laws = f"law '{self.library}' as it was then, not for '{library.name}'"
            raise InputError(f"the calibration is for {laws}; take that law, or calibrate again")
        for soil in self.soils:
            given = gains.get(soil.rig, soil.gain)
            if abs(given - soil.gain) > 1e-6 * soil.gain:
                made = f"the calibration of this rig was made with {soil.gain:g}"
                raise InputError(f"gain = {given:g}, and {made}; give the same --gain")

    def offset(self, error: ModelError, rig: str, row: FloatArray) -> tuple[float, FloatArray]:
        """Mean of the offset's error of a record, and its independent causes [deg].

        The error of a calibrated rig and what the apparatus keeps belong to it. A cause has the
        size of one standard deviation, with the sign; all records share the causes, shape [cause].

        Parameters
        ----------
        error
            Of the law.
        rig
            Its :func:`~terraphi.inference.records.rig_name`.
        row
            x of the record, shape [effect].

        Raises
        ------
        InputError
            If the calibration is one by an earlier version.
        """
        first = [records[0] for records in self.repeats]
        # Mean ψ of repeats, and its variances by record, rig and beds.
        pooled = [
            np.mean([(r.read_deg, r.read_sd_deg**2, r.rig_sd_deg**2, r.bed_sd_deg**2 / len(records))
                     for r in records], axis=0) for records in self.repeats
        ]  # fmt: skip
        read, read_variance, rig_variance, bed_variance = np.array(pooled).T
        if {len(soil.row) for soil in first} != {row.size}:
            raise InputError("the calibration has no rows of the law's error; calibrate again")
        soils, legs, on_rigs = (
            np.array([getattr(soil, key) for soil in first]) for key in ("soil", "leg", "rig")
        )
        # Effects z are those of the mixed model and one for each calibrated rig. S is their
        # covariance, and E has a row for each soil.
        rigs = np.unique(on_rigs)
        is_on = on_rigs[:, None] == rigs
        effects = np.hstack([np.array([soil.row for soil in first]), is_on])
        kept = rig_variance @ is_on / is_on.sum(axis=0)
        k = row.size
        prior = np.diag(np.append(np.zeros(k), error.rig_sd_deg**2 + kept))
        prior[:k, :k] = error.covariance_deg2
        # y = read − φ = E z + e, where e is independent between soils. Records of one soil share
        # its error and that of φ, records of one leg in it that of soil × leg, and of the errors of
        # two readings the smaller.
        of_soil = error.soil_sd_deg**2 + error.leg_sd_deg**2 * (legs[:, None] == legs)
        of_soil = of_soil + np.minimum.outer(read_variance, read_variance)
        of_soil += np.square([soil.phi_sd_deg for soil in first])
        total = effects @ prior @ effects.T + (soils[:, None] == soils) * of_soil
        total += np.diag(1e-6 + bed_variance)
        # Mean and covariance of z given y, by Gaussian conditioning: G = S E' K⁻¹, z = G y and
        # S − G E S. The record has the row (x, is on the rig).
        gain = np.linalg.solve(total, effects @ prior).T
        values, vectors = np.linalg.eigh(prior - gain @ effects @ prior)
        of_record = np.append(row, rigs == rig)
        mean = float(of_record @ gain @ (read - [soil.phi_deg for soil in first]))
        return mean, of_record @ (vectors * np.sqrt(np.maximum(values, 0.0)))

    def save(self, path: Path | str) -> None:
        """Write a TOML file; raises InputError if the place cannot be written."""
        head = self.model_dump(exclude={"soils"})
        lines = [f"# {SIGNATURE}: a calibration"]
        for title, part in [("", head), *(("[[soils]]", s.model_dump()) for s in self.soils)]:
            lines += ["", title] if title else []
            lines += [f"{k} = {json.dumps(v, ensure_ascii=False)}" for k, v in part.items()]
        with atomic_write(Path(path)) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path | str) -> Calibration:
        """Read a file of :meth:`save`; raises InputError if it is no calibration."""
        return parse_toml(Path(path), cls)


def calibrate(
    forces: Any,
    phi_deg: float,
    phi_sd_deg: float,
    *,
    soil: str = "",
    law: AnyLaw | Path | str | None = None,
    leg: str | None = None,
    rig: Any = None,
    density: float | str | None = None,
    grain_size_mm: float | None = None,
    cohesion: float | str | None = None,
    columns: Any = None,
    noise: float | tuple[float, float] | None = None,
    gain: float | str | None = None,
) -> Calibration:
    """Compare a library with soils of known friction angle in one's own apparatus.

    Parameters
    ----------
    forces
        As of :func:`invert`; the records of a list are of one soil.
    phi_deg, phi_sd_deg
        Friction angle in the library's convention and its standard deviation [deg].
    soil
        Name of the soil, by which calibrations of several soils, or of several days, are joined.
    law, leg, rig, density, grain_size_mm, cohesion, columns, noise, gain
        As of :func:`invert`.

    Raises
    ------
    InputError
        As :func:`invert` does.

    Examples
    --------
    >>> calibration = terraphi.calibrate("li2013:poppy_loose/straight", 36.0, 1.0)
    >>> after = terraphi.invert("li2013:yuma/straight", calibration=calibration)
    >>> after.phi.sd < terraphi.invert("li2013:yuma/straight").phi.sd
    True
    """
    numbers = all(isinstance(angle, int | float) for angle in (phi_deg, phi_sd_deg))
    if not (numbers and 0.0 < phi_deg < 90.0 and 0.0 <= phi_sd_deg < 90.0):
        raise InputError(f"phi = {phi_deg!r} ± {phi_sd_deg!r}; give two numbers from 0 to 90°")
    opened = open_records(
        forces, leg=leg, rig=rig, density=density, grain_size_mm=grain_size_mm, cohesion=cohesion,
        columns=columns, noise=noise, gain=gain,
    )  # fmt: skip
    records = [without_faults(record) for record in opened if isinstance(record, Record)]
    if len(records) < len(opened):
        raise InputError("calibrate takes forces on legs; leave out those on tools")
    leg_law, _ = law_for(records, law)
    truth = phi_deg, phi_sd_deg, soil_name(soil)
    soils = [_calibration_soil(record, leg_law, *truth) for record in records]
    return Calibration(library=leg_law.name, library_hash=leg_law.hash, soils=soils)


def _calibration_soil(
    record: Record, law: LawOfLegs, phi_deg: float, phi_sd_deg: float, soil: str
) -> CalibrationSoil:
    """The angle that a law reads off a record in a soil of known angle; raises InputError."""
    likelihood = Likelihood([record], law)
    if not likelihood.measured:
        raise InputError(f"{record.source}: simulated forces calibrate nothing")
    read = likelihood.least_squares
    fits = record_fits(likelihood, read, (read, read))
    legs = [leg_readings(likelihood, record)]
    verdict, reason, _ = judge(likelihood, fits, legs, damaged=bool(in_air(likelihood)))
    if verdict != "consistent":
        raise InputError(f"{record.source}: cannot calibrate with it. {reason}")
    # A calibration removes from other records on the rig only what the rig keeps (`rig_sd`), not
    # the errors of this record (`sd`).
    shares, error = likelihood.budget(), likelihood.error
    fixed = [name for name in shares if TERMS[name].fixed]
    rig_sd = math.hypot(*(shares[name] for name in fixed))
    sd = root_sum_square(shares, *fixed, *(name for name in shares if name.startswith("model: ")))
    model = (shares[name] for name in shares if name.startswith("model: "))
    limit = FAR * math.hypot(*model, rig_sd, phi_sd_deg, sd)
    if abs(read - phi_deg) > limit:
        difference = f"forces and angle disagree by {read - phi_deg:+.0f}°, at most {limit:.0f}°"
        what = f"phi = {phi_deg:g}° ({law.convention.replace('_', ' ')}), the density and the leg"
        raise InputError(f"{record.source}: {difference} are accepted; check {what}")
    return CalibrationSoil(
        source=visible(record.source), soil=soil, leg=record.rig.leg, rig=rig_name(record.rig),
        phi_deg=phi_deg, phi_sd_deg=phi_sd_deg, read_deg=read, read_sd_deg=sd, rig_sd_deg=rig_sd,
        row=tuple(likelihood.row(phi_deg).tolist()),
        bed_sd_deg=error.bed_sd(record.rig, record.grain_size_mm), gain=record.gain,
        grain_size_mm=record.grain_size_mm, readings=record.readings_hash,
    )  # fmt: skip
