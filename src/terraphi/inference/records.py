r"""Records: measured or simulated forces as window means, and how a library's curve becomes alike.

A record has c channels: Fx and Fz, or the moment M about the hip in place of one of them or of
both. It is compared with the library through m window means of each: 40 windows over |θ| ≤
85°, as Xu & Wang have it, or those of them that the record covers. With x the readings, taken to be
linear in between, the means are W x; a curve y known as means over 1° is read at the angles of the
readings, R y, so that

    d = W x,    g = W R y,    cov(noise) = σ² W W'.

Whatever the readings' spacing, both sides are averaged alike.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import label_of, number_with_sd
from terraphi.experiment.history import (
    CHANNEL_UNITS,
    FORCES,
    OBSERVATION_ANGLES,
    WIDEST_GAP_DEG,
    WINDOW_DEG,
    ForceHistory,
    resolution,
)
from terraphi.experiment.leg import RotatingShape
from terraphi.experiment.measurements import Measurement, measurement_of, open_forces
from terraphi.experiment.priors import DENSITY_SD_PART, SENSOR_GAIN
from terraphi.experiment.reading import ForceColumns, read_trials
from terraphi.experiment.rig import LEG_NAMES, Rig
from terraphi.experiment.scenario import Scenario

FEWEST_WINDOWS = 9
"""Windows that a record must have: those within 40° of its path."""
MOST_READINGS = 4000
"""Readings above which a record is averaged in bins of 0.05°, or wider."""
USUAL_DENSITY = (1250.0, 2100.0)
"""Bulk density of dry mineral soils [kg/m³]: loose uniform sand has 1480, glacial till 2100 (Das,
*Principles of Geotechnical Engineering*, table of typical dry unit weights); the loosest angular
sand and simulated grains of this project have 1300."""
SMALLEST_GRAIN_MM = 0.02
"""Least size of grains [mm], of coarse silt: a smaller number is one in meters."""
LARGEST_GRAIN = 0.4
"""Largest diameter of grains over the width of a leg [-]: of those that were simulated 0.35."""


@dataclass(frozen=True, eq=False)
class Record:
    """One force history, ready to be compared with a library.

    Attributes
    ----------
    source
        File, or name of a shipped measurement.
    history
        Readings that can be used.
    rig
        The apparatus.
    density_kg_m3, density_sd_kg_m3, density_assumed
        Bulk density of the soil [kg/m³], its standard deviation, and whether it is a guess; the
        density is ``None`` if nothing is known.
    scenario, simulated
        Of a simulated history, if it carries one; and whether the forces are a simulation's.
    measurement
        Name of the shipped measurement that it is; empty for any other.
    n_left_out
        Readings that were left out as damaged.
    notes
        What was done with the readings, a sentence each.
    damage
        What makes any answer unbelievable, a sentence each.
    noise
        Standard deviation of a reading of each channel [N], of a moment [N m].
    resolution
        Step that the readings of each channel are rounded to [N], of a moment [N m]; 0 if fine.
    grain_size_mm
        Mean diameter of the grains [mm]; 0 of sand.
    gain, gain_sd
        What the forces were divided by, and its relative standard deviation [-].
    scale_given
        Whether density and gain both came with a standard deviation.
    """

    source: str
    history: ForceHistory
    rig: Rig
    density_kg_m3: float | None = None
    density_sd_kg_m3: float = 0.0
    density_assumed: bool = False
    scenario: Scenario | None = None
    simulated: bool = False
    measurement: str = ""
    n_left_out: int = 0
    notes: tuple[str, ...] = ()
    damage: tuple[str, ...] = ()
    noise: tuple[float, ...] = (0.0, 0.0)
    resolution: tuple[float, ...] = (0.0, 0.0)
    gain: float = 1.0
    gain_sd: float = 0.0
    scale_given: bool = False
    grain_size_mm: float = 0.0

    @property
    def leg(self) -> RotatingShape:
        """Shape of the leg."""
        return self.rig.leg

    @property
    def channels(self) -> tuple[str, ...]:
        """``Fx``, ``Fz`` and ``M``: those that are compared."""
        return self.history.channels

    @cached_property
    def _windows(self) -> tuple[FloatArray, FloatArray]:
        """Centres of the windows that the record covers [deg], and their weights W [m, reading]."""
        theta = self.history.theta_deg
        centre = np.linspace(-WINDOW_DEG, WINDOW_DEG, OBSERVATION_ANGLES)
        half = WINDOW_DEG / (OBSERVATION_ANGLES - 1)
        low, high = np.maximum(centre - half, theta[0]), np.minimum(centre + half, theta[-1])
        first, last = np.searchsorted(theta, low), np.searchsorted(theta, high, side="right")
        kept = (high - low > 0.999 * half) & (last > first)
        if kept.sum() < FEWEST_WINDOWS:
            raise InputError(
                f"{self.source}: theta covers {theta[0]:.1f} to {theta[-1]:.1f} deg with "
                f"{len(theta)} readings; at least 40 deg within |theta| <= {WINDOW_DEG:g} deg, "
                f"read every {2 * half:.1f} deg, are needed"
            )
        inside = theta[(theta >= low[kept][0]) & (theta <= high[kept][-1])]
        gaps = np.diff(inside)
        if gaps.size and gaps.max() > WIDEST_GAP_DEG:
            at = int(gaps.argmax())
            left = f" ({self.n_left_out} were left out as faulty)" if self.n_left_out else ""
            raise InputError(
                f"{self.source}: no reading between {inside[at]:.1f} and {inside[at + 1]:.1f} deg"
                f"{left}; gaps of at most {WIDEST_GAP_DEG:g} deg are accepted"
            )
        weights = (_hats(high[kept], theta) - _hats(low[kept], theta)) / (high - low)[kept, None]
        return centre[kept], weights

    @property
    def theta_deg(self) -> FloatArray:
        """Centres of the windows [deg], shape [m]."""
        return self._windows[0]

    @cached_property
    def data(self) -> FloatArray:
        """Window means of the channels [N], of a moment [N m], shape [c, m]."""
        return np.stack([self.means(self.history.channel(name)) for name in self.channels])

    def means(self, values: FloatArray) -> FloatArray:
        """Window means of values at each reading, shape [reading] -> [m]."""
        return np.asarray(self._windows[1] @ values)

    @property
    def span(self) -> FloatArray:
        """Peak-to-peak of the data of each channel, shape [c]."""
        return np.asarray(np.ptp(self.data, axis=1))

    @cached_property
    def noise_covariance(self) -> FloatArray:
        """Covariance of the data from noise and rounding of readings [N²], shape [c m, c m].

        Rounding to steps of q has the variance q²/12, one error for equal readings in a row.
        """
        weights = self._windows[1]
        found = np.kron(np.diag(np.square(self.noise)), weights @ weights.T)
        m = len(weights)
        for i, (name, step) in enumerate(zip(self.channels, self.resolution, strict=True)):
            if step:
                changes = np.abs(np.diff(self.history.channel(name))) > step / 2.0
                runs = np.add.reduceat(weights, np.flatnonzero(np.append(True, changes)), axis=1)
                found[i * m : (i + 1) * m, i * m : (i + 1) * m] += step**2 / 12.0 * runs @ runs.T
        return found

    def operator(self, theta_deg: FloatArray) -> FloatArray:
        """W R: turns a curve of means over 1° at leg angles [deg] into window means, [m, n]."""
        return self._windows[1] @ _interpolation(self.history.theta_deg, theta_deg)

    def checked(self) -> Record:
        """The same record; raises InputError if a force is constant or nearly nothing was read."""
        for axis, name in zip(self.data, self.channels, strict=True):
            if np.ptp(axis) <= 1e-9 * max(float(np.abs(self.data).max()), 1e-300):
                raise InputError(
                    f"{self.source}: {name} is the same at every angle; check the sensor"
                )
        return self

    def binned(self) -> Record:
        """The same record, averaged in equal bins of the leg angle if it is long."""
        history, count = self.history, len(self.history.position)
        if count <= MOST_READINGS:
            return self
        low, high = history.position[[0, -1]]
        bins = min(MOST_READINGS, int(np.ceil(np.degrees(high - low) / 0.05)))
        at = np.minimum(((history.position - low) / (high - low) * bins).astype(int), bins - 1)
        number = np.bincount(at, minlength=bins)
        moment = [] if history.moment is None else [history.moment]
        sums = [np.bincount(at, c, bins) for c in (history.position, *history.force.T, *moment)]
        means = np.stack(sums)[:, number > 0] / number[number > 0]
        fewer = replace(
            history,
            position=means[0],
            force=means[1 : 1 + len(history.axes)].T,
            moment=means[-1] if moment else None,
        )
        factor = np.sqrt(means.shape[1] / count)
        return replace(self, history=fewer, noise=tuple(factor * one for one in self.noise))

    def without(self, mask: BoolArray, notes: Sequence[str], damage: Sequence[str]) -> Record:
        """The same record without some readings (a mask of those to drop), with what is noted."""
        return replace(
            self,
            history=self.history.chosen(~mask),
            n_left_out=int(mask.sum()),
            notes=(*self.notes, *notes),
            damage=(*self.damage, *damage),
        )


def _hats(at: FloatArray, x: FloatArray) -> FloatArray:
    """Integral from x[0] to some places of each reading's hat function, shape [place, reading]."""
    width = np.diff(x)
    passed = np.clip((at[:, None] - x[:-1]) / width, 0.0, 1.0)
    rising, falling = 0.5 * width * passed**2, width * (passed - 0.5 * passed**2)
    total = np.zeros((at.size, x.size))
    total[:, 1:] += rising
    total[:, :-1] += falling
    return total


def _interpolation(at: FloatArray, x: FloatArray) -> FloatArray:
    """Weights of samples at x in their linear interpolation at some places, constant beyond."""
    i = np.clip(np.searchsorted(x, at) - 1, 0, len(x) - 2)
    share = np.clip((at - x[i]) / (x[i + 1] - x[i]), 0.0, 1.0)
    found = np.zeros((len(at), len(x)))
    found[np.arange(len(at)), i] = 1.0 - share
    found[np.arange(len(at)), i + 1] += share
    return found


def with_body(source: Any) -> tuple[Any, Any]:
    """Forces with the leg, rig or tool that they name, or ``None``.

    ``"forces.csv@c"``, ``"forces.csv@rig.toml"``, ``"plate.csv@plate:60"``, or such a pair.
    """
    if isinstance(source, str) and "@" in source and not Path(source).exists():
        forces, _, own = source.rpartition("@")
        if not _is_body(own):
            raise InputError(
                f"{source}: after @ comes a leg ({', '.join(LEG_NAMES)}), a rig (rig.toml) or a "
                "tool (plate:60, ball:44)"
            )
        return forces, own
    pair = isinstance(source, tuple) and len(source) == 2 and _is_body(source[1])
    return source if pair else (source, None)


def _is_body(own: Any) -> bool:
    """Whether this is a leg, a rig or a tool."""
    if isinstance(own, str | Path):
        return own in LEG_NAMES or Path(own).suffix == ".toml" or is_tool(own)
    return isinstance(own, Rig | Mapping)


def is_tool(own: Any) -> bool:
    """Whether a body is a tool, such as ``"plate:60"``."""
    return isinstance(own, str) and re.match(r"\w+:[\d.]", own) is not None


def open_record(forces: Any, **options: Any) -> Record:
    """The record of one stroke; as :func:`open_records`."""
    found = open_records(forces, **options)
    if len(found) > 1:
        raise InputError(f"{found[0].source}: {len(found)} strokes, expected one")
    return found[0]


def open_records(
    forces: Any, *, columns: Any = None, leg: str | None = None, rig: Any = None, **options: Any
) -> list[Record]:
    """Records from whatever forces come in, one for each stroke; tables are tared in air.

    Parameters
    ----------
    forces
        Path of a table or NetCDF, ``li2013:MEDIUM/LEG``, a measurement, a force history, a
        DataFrame or an xarray Dataset.
    columns
        Which columns of a table are what: a
        :class:`~terraphi.experiment.reading.ForceColumns`, a mapping, or a TOML file.
    leg, rig, options
        As of :func:`record_of`.

    Raises
    ------
    InputError
        If the forces, the rig or the density cannot be used.
    """
    if isinstance(forces, Measurement):
        known = [forces]
    elif isinstance(forces, ForceHistory):
        known = [measurement_of(forces)]
    elif isinstance(forces, str | Path):
        known = open_forces(forces, tared(columns, rig, leg))
    elif hasattr(forces, "to_dataframe") or hasattr(forces, "columns"):
        known = list(map(measurement_of, read_trials(forces, tared(columns, rig, leg))))
    else:
        raise InputError(
            f"forces of type {type(forces).__name__}; give a path, a shipped name, a ForceHistory, "
            "a DataFrame or an xarray Dataset"
        )
    return [record_of(one, leg=leg, rig=rig, **options) for one in known]


def tared(columns: Any, rig: Any = None, leg: str | None = None) -> ForceColumns:
    """Options of a table, with the angles at which the leg of a rig is in air."""
    given, ends = ForceColumns.of(columns), ("air_before_deg", "air_after_deg")
    if rig is None or {*ends} & given.model_fields_set:
        return given
    return given.model_copy(update=dict(zip(ends, Rig.of(rig, leg).air_deg(), strict=True)))


def record_of(
    known: Measurement,
    *,
    leg: str | None = None,
    rig: Any = None,
    density: float | str | None = None,
    noise: float | tuple[float, float] | None = None,
    gain: float | str | None = None,
    grain_size_mm: float | None = None,
    simulated: bool | None = None,
) -> Record:
    """The record of a measurement.

    Parameters
    ----------
    known
        Forces, with what is known of leg and soil.
    leg
        Shape of the leg; ``None``: that of the rig.
    rig
        The apparatus, as :meth:`Rig.of` takes it; ``None``: from the forces' file.
    density
        Bulk density [kg/m³], as a number or as ``"1600±80"``; ``None``: from the forces' file.
        Without a standard deviation 5 % are assumed.
    noise
        Standard deviation of a reading [N], of both forces or of each; ``None``: from the readings'
        roughness. That of a moment always is.
    gain
        What the sensor reads over the true force [-], as ``"1.05±0.01"``; ``None``: 1 ± 2 %.
    grain_size_mm
        Mean diameter of the grains [mm]; ``None``: small compared with the leg.
    simulated
        Whether the forces are a simulation's; ``None``: from their file. Their soil has the
        cohesion of their scenario, and none without one.

    Raises
    ------
    InputError
        If the rig is not known, or forces, rig or density cannot be used.
    """
    if leg is not None and leg not in LEG_NAMES:
        raise InputError(f"unknown leg '{leg}'; {nearest(leg, tuple(LEG_NAMES))}")
    source = known.rig if rig is None else rig
    if source is None:
        raise InputError(
            f"{known.name}: the size of the leg is not known; add it in mm, as --leg "
            f"{leg or 'straight'} --length 110 --width 40 --thickness 8 --hip-height 35±1, or "
            f"--rig li2013 --leg {leg or 'straight'} for that of Li et al. (2013)"
        )
    history = known.history
    made_by = known.scenario
    stated = known.density_kg_m3 if density is None else density
    mean, sd = (None, 0.0) if stated is None else density_with_sd(stated, known.name)
    if made_by is not None and density is None:
        sd = 0.0
    excluded = {"sizes of the leg": rig, "gain": gain, "size of grains": grain_size_mm}
    wrong = [name for name, value in excluded.items() if value is not None]
    if made_by is not None and wrong:
        raise InputError(
            f"{known.name}: a simulation knows its rig, and has no sensor and no grains; leave out "
            f"the {' and the '.join(wrong)}"
        )
    rig = Rig.of(source, leg)
    grains = grain_size(grain_size_mm, rig.width_mm, known.name)
    factor, gain_sd = SENSOR_GAIN.mean, None
    if gain is not None:
        factor, gain_sd = with_sd(
            f"{known.name}: gain", gain, "it as 1.05 or 1.05±0.01", (0.1, 10.0)
        )
    scale_given = None not in (gain_sd, stated) and number_with_sd(str(stated))[1] is not None
    gain_sd = SENSOR_GAIN.sd if gain_sd is None else gain_sd / factor
    if factor != 1.0:
        history = history.scaled(1.0 / factor)
    few, channels = len(history.theta_deg) < 12, history.channels
    sensor = tuple(0.0 if few else roughness(history.channel(name)) for name in channels)
    coarse = known.history.provenance.get("resolution", {})
    steps = np.array([coarse.get(n, resolution(known.history.channel(n))) for n in channels])
    steps /= factor
    if noise is not None and not history.axes:
        raise InputError(f"{known.name}: noise is that of forces, and there is a moment alone")
    if noise is not None:
        given = tuple(noise) if isinstance(noise, list | tuple) else (noise, noise)
        numbers = len(given) == 2 and all(isinstance(one, int | float) for one in given)
        if not numbers or not all(0.0 <= one <= np.ptp(history.force) for one in given):
            raise InputError(
                f"noise = {noise!r}; give one number of newtons, or one for each force, from 0 to "
                f"{np.ptp(history.force):.3g} N, the range of the forces"
            )
        of_forces = dict(zip(FORCES, given, strict=True))
        pairs = zip(history.channels, sensor, strict=True)
        sensor = tuple(of_forces.get(name, one) for name, one in pairs)
    if (made_by is not None or simulated) and history.channels != FORCES:
        raise InputError(f"{known.name}: Fx and Fz of a simulation are needed")
    return Record(
        source=label_of(known.name),
        history=history,
        rig=rig,
        density_kg_m3=mean,
        density_sd_kg_m3=sd,
        density_assumed=known.density_assumed and density is None,
        scenario=made_by,
        simulated=made_by is not None if simulated is None else simulated,
        measurement=str(history.provenance.get("measurement", "")),
        notes=(*history.provenance.get("reading", ()), *_rounded(history, steps)),
        noise=sensor,
        resolution=tuple(steps.tolist()),
        gain=factor,
        gain_sd=gain_sd,
        scale_given=scale_given,
        grain_size_mm=grains,
    )


def density_doubts(density: float) -> list[str]:
    """A sentence if no dry soil is likely to have a bulk density [kg/m³]."""
    least, most = USUAL_DENSITY
    if least <= density <= most:
        return []
    sentence = (
        f"The density {density:g} kg/m³ is unusual: dry sand and gravel have {least:g} to "
        f"{most:g} kg/m³. Half or twice that density moves φ by 4 to 9°."
    )
    return [sentence]


def density_with_sd(density: float | str, name: str) -> tuple[float, float]:
    """Bulk density of what is named and its standard deviation [kg/m³]; raises InputError."""
    ends = (100.0, 10_000.0)
    mean, sd = with_sd(f"{name}: density", density, "kg/m³ as 1600 or 1600±80", ends)
    return mean, DENSITY_SD_PART * mean if sd is None else sd


def with_sd(
    what: str, text: float | str, form: str, ends: tuple[float, float]
) -> tuple[float, float | None]:
    """A number between two ends and its standard deviation, of ``"1600±80"``; raises InputError."""
    try:
        mean, sd = number_with_sd(str(text))
    except ValueError:
        raise InputError(f"{what} = '{text}'; give {form}") from None
    if not (ends[0] <= mean <= ends[1] and 0.0 <= (sd or 0.0) < mean):
        raise InputError(
            f"{what} = {text}; give {form}, from {ends[0]:g} to {ends[1]:g} and above its own ±"
        )
    return mean, sd


def grain_size(given: float | str | None, width_mm: float, name: str) -> float:
    """Mean diameter of the grains on a body of a width [mm], 0 if not given; raises InputError."""
    try:
        grains = float(given or 0.0)
    except (TypeError, ValueError):
        raise InputError(f"{name}: grain_size_mm = {given!r} is no number") from None
    largest = LARGEST_GRAIN * width_mm
    if grains and not SMALLEST_GRAIN_MM <= grains <= largest:
        raise InputError(
            f"{name}: grain_size_mm = {grains:g}; {SMALLEST_GRAIN_MM:g} to {largest:.3g} mm are "
            f"accepted on a body {width_mm:g} mm wide"
        )
    return grains


def roughness(values: FloatArray) -> float:
    """Noise of readings, from their second differences, of which it leaves √6."""
    return float(1.4826 * np.median(np.abs(np.diff(values, n=2))) / np.sqrt(6.0))


def _rounded(history: ForceHistory, steps: FloatArray) -> list[str]:
    """A sentence if channels are rounded."""
    pairs = zip(history.channels, steps, strict=True)
    coarse = [f"{name} to {step:.2g} {CHANNEL_UNITS[name]}" for name, step in pairs if step]
    listed = " and ".join(coarse)
    return [f"Readings are rounded, {listed}: the interval includes that."] if coarse else []
