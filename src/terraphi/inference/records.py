r"""Records: forces on one body, opened from a file, a name, a table or an object.

A record carries its body from here on: that of a leg (:class:`Record`) has forces over the leg
angle θ and a rig, that of a tool (:class:`~terraphi.inference.pressed.PressedRecord`) forces over
sinkage and a plate or ball.

A record of a leg has c channels: Fx and Fz, or the moment M about the hip in place of one of them
or of both. Record and law are compared by m window means of each channel: 40 windows over |θ| ≤
85° (Xu & Wang), or those of them that the record covers. With x the readings, linear in between,
the means are W x. A law's curve y, means over 1°, is interpolated to the angles of the readings,
R y, and averaged in the same windows:

    d = W x,    g = W R y,    cov(noise) = σ² W W'.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.experiment.arrays import FloatArray, IntArray, block_means
from terraphi.experiment.bodies import OUTLINES, TOOLS
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
    window_weights,
)
from terraphi.experiment.measurements import Measurement, measurement_of, open_forces
from terraphi.experiment.priors import COHESION_SD_PART, DENSITY, DENSITY_SD_PART, SENSOR_GAIN
from terraphi.experiment.reading import ForceColumns, read_trials
from terraphi.experiment.rig import Rig, Tool

if TYPE_CHECKING:
    from terraphi.experiment.scenario import Scenario
    from terraphi.inference.pressed import PressedRecord

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
MOST_COHESION_PA = 5000.0
"""Largest cohesion that is accepted [Pa]: that of stiff clay in kPa would be a wrong unit; laws end
below it."""
LARGEST_GRAIN = 0.4
"""Largest diameter of grains over the width of a leg [-]: of those that were simulated 0.35."""

CEILING, CEILING_OVER, COARSEST = 6, 5.0, 0.12
"""Readings of one largest value that are a clipped top whatever lies between them, how many times
those of each of the next three steps below, and the largest such step over peak-to-peak [-]. Of 100
records of grains and 12 of Li et al., rounded to 0 to 8 % of the largest, none has more than 3.5
times, and a top as flat as 1 − θ⁴ has 4.6; clipped at 70 % of it 8 to 9 of 10 have."""


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
        Bulk density of the soil [kg/m³], its standard deviation, and whether it is a guess, such as
        that of the prior.
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
    cohesion_pa, cohesion_sd_pa
        Cohesion of the soil [Pa], and its standard deviation, which is infinite of an unknown one.
    gain, gain_sd
        What the forces were divided by, and its relative standard deviation [-].
    scale_given
        Whether density and gain both came with a standard deviation.
    """

    source: str
    history: ForceHistory
    rig: Rig
    density_kg_m3: float = DENSITY.mean
    density_sd_kg_m3: float = DENSITY.sd
    density_assumed: bool = True
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
    cohesion_pa: float = 0.0
    cohesion_sd_pa: float = 0.0

    @property
    def conditions(self) -> tuple[object, ...]:
        """All that records have in common that are strokes of one rig in one state of the soil."""
        cell = self.scenario and self.scenario.numerics.cell_size
        return (self.rig, self.channels, self.density_kg_m3, self.density_sd_kg_m3,
                self.grain_size_mm, self.gain_sd, self.simulated, cell)  # fmt: skip

    @property
    def channels(self) -> tuple[str, ...]:
        """``Fx``, ``Fz`` and ``M``: those that are compared."""
        return self.history.channels

    @cached_property
    def _windows(self) -> tuple[FloatArray, FloatArray, tuple[IntArray, ...]]:
        """Centres of the windows that the record covers [deg], and their weights W [m, reading].

        Then window and reading of each weight that is not 0, shape [entry] each.
        """
        theta = self.history.theta_deg
        centre = np.linspace(-WINDOW_DEG, WINDOW_DEG, OBSERVATION_ANGLES)
        half = WINDOW_DEG / (OBSERVATION_ANGLES - 1)
        # Windows meet, each as wide as the spacing of their centres. One at an end of the record
        # counts if at least half of it is covered, and is a mean over the covered part.
        low, high = np.maximum(centre - half, theta[0]), np.minimum(centre + half, theta[-1])
        first, last = np.searchsorted(theta, low), np.searchsorted(theta, high, side="right")
        kept = (high - low > 0.999 * half) & (last > first)
        if kept.sum() < FEWEST_WINDOWS:
            raise InputError(
                f"{self.source}: theta covers {theta[0]:.1f} to {theta[-1]:.1f} deg, {len(theta)} "
                f"readings; give 40 deg within ±{WINDOW_DEG:g}, read every {2 * half:.1f} deg"
            )
        inside = theta[(theta >= low[kept][0]) & (theta <= high[kept][-1])]
        gaps = np.diff(inside)
        if gaps.size and gaps.max() > WIDEST_GAP_DEG:
            at = int(gaps.argmax())
            faulty = f" ({self.n_left_out} were left out as faulty)" if self.n_left_out else ""
            gap = f"no reading between {inside[at]:.1f} and {inside[at + 1]:.1f} deg{faulty}"
            raise InputError(f"{self.source}: {gap}; at most {WIDEST_GAP_DEG:g} deg are accepted")
        weights = window_weights(theta, low[kept], high[kept])
        return centre[kept], weights, np.nonzero(weights)

    @property
    def theta_deg(self) -> FloatArray:
        """Centres of the windows [deg], shape [m]."""
        return self._windows[0]

    @cached_property
    def data(self) -> FloatArray:
        """Window means of the channels [N], of a moment [N m], shape [c, m]."""
        return np.stack([self.means(self.history.channel(name)) for name in self.channels])

    @property
    def readings_hash(self) -> str:
        """:func:`readings_hash` of the window means."""
        return readings_hash(self.data)

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
        # Readings have independent errors of one size a channel: cov(W e) = σ² W W'.
        covariance = np.kron(np.diag(np.square(self.noise)), weights @ weights.T)
        m = len(weights)
        for i, (name, step) in enumerate(zip(self.channels, self.resolution, strict=True)):
            if step:
                # Weights of equal readings in a row add up, for their rounding is one error.
                changes = np.abs(np.diff(self.history.channel(name))) > step / 2.0
                runs = np.add.reduceat(weights, np.flatnonzero(np.append(True, changes)), axis=1)
                block = slice(i * m, (i + 1) * m)
                covariance[block, block] += step**2 / 12.0 * runs @ runs.T
        return covariance

    def operator(self, theta_deg: FloatArray, shift_deg: FloatArray | float = 0.0) -> FloatArray:
        """W R: window means of a curve given at leg angles [deg] that comes late by shifts [deg].

        R interpolates linearly, and is constant beyond the ends. Shape [n] and [...] for
        [..., m, n].
        """
        _, weights, (window, reading) = self._windows
        shifts, weight = np.asarray(shift_deg), weights[window, reading]
        # A reading lies between two angles of the curve, to which its weight goes by its distance
        # from either. Windows have few readings each, so that W R is summed up from its entries.
        at = self.history.theta_deg[reading] - shifts.reshape(-1, 1)
        i = np.clip(np.searchsorted(theta_deg, at) - 1, 0, len(theta_deg) - 2)
        share = np.clip((at - theta_deg[i]) / np.diff(theta_deg)[i], 0.0, 1.0)
        shape = len(at), self.theta_deg.size, len(theta_deg)
        place = np.ravel_multi_index((np.arange(len(at))[:, None], window, i), shape).ravel()
        total = np.bincount(place, (weight * (1.0 - share)).ravel(), math.prod(shape))
        total += np.bincount(place + 1, (weight * share).ravel(), math.prod(shape))
        return np.asarray(total.reshape(*shifts.shape, *shape[1:]), np.float64)

    def binned(self) -> Record:
        """The record averaged in equal bins of the leg angle, if it is long."""
        history, count = self.history, len(self.history.position)
        if count <= MOST_READINGS:
            return self
        # Means over bins have less noise by the root of the number of readings in each.
        low, high = history.position[[0, -1]]
        bins = min(MOST_READINGS, int(np.ceil(np.degrees(high - low) / 0.05)))
        at = np.minimum(((history.position - low) / (high - low) * bins).astype(int), bins - 1)
        first = np.flatnonzero(np.diff(at, prepend=-1))
        fewer = replace(
            history,
            position=block_means(history.position, first),
            force=block_means(history.force, first),
            moment=None if history.moment is None else block_means(history.moment, first),
        )
        factor = np.sqrt(first.size / count)
        return replace(self, history=fewer, noise=tuple(factor * sd for sd in self.noise))


# -- opening -------------------------------------------------------------------------------------


def open_records(
    forces: Any,
    *,
    leg: str | None = None,
    rig: Any = None,
    tool: str | None = None,
    columns: Any = None,
    friction: float | str | None = None,
    **options: Any,
) -> list[Record | PressedRecord]:
    """Open forces as records, one for each stroke of a leg or press of a tool.

    Tables of legs are tared in air.

    Parameters
    ----------
    forces
        Path of a table or NetCDF, ``li2013:MEDIUM/LEG``, a measurement, a force history, a
        DataFrame or an xarray Dataset; or a list of these. Each may name its body, as
        ``"forces.csv@c"``, ``"forces.csv@rig.toml"``, ``"plate.csv@plate:60"`` or a pair.
    leg, rig, tool
        Body of the records that name none.
    columns
        Which columns of a table are what: a
        :class:`~terraphi.experiment.reading.ForceColumns`, a mapping, or a TOML file. Where there
        are legs, the columns are those of legs.
    friction
        Coulomb friction between soil and tools [-]; that of a leg belongs to its rig.
    options
        As of :func:`record_of`.

    Raises
    ------
    InputError
        If the forces, the body or the density cannot be used.
    """
    fallback = None if tool is None else Tool.of(tool)
    sources = [(s, fallback if body is None else body) for s, body in _sources(forces)]
    # Options of legs do not go with tools alone, nor a friction of tools with legs alone.
    has_leg = not all(isinstance(body, Tool) for _, body in sources)
    excluded = {"leg": leg, "rig": rig, **options}
    of_tools = ("density", "grain_size_mm", "cohesion")
    wrong = [name for name, value in excluded.items() if value is not None and not has_leg
             and name not in of_tools]  # fmt: skip
    if wrong:
        raise InputError(f"a tool excludes {', '.join(wrong)}; leave out one or the other")
    has_tool = any(isinstance(body, Tool) for _, body in sources)
    if friction is not None and not has_tool:
        raise InputError("--friction goes with a rig or a tool; add its sizes, or --rig li2013")
    if has_tool and _cohesion(options.get("cohesion"), "a tool") != (0.0, 0.0):
        dry = "a plate, ball or wheel is inverted as in dry soil, and φ of damp soil is too high"
        raise InputError(f"{dry}; leave out cohesion, and take φ as a limit")
    records: list[Record | PressedRecord] = []
    for source, body in sources:
        if isinstance(body, Tool):
            from terraphi.inference.pressed import open_pressed

            given = {name: options.get(name) for name in ("density", "grain_size_mm")}
            of_tool = None if has_leg else columns
            opened: list[Any] = [open_pressed(source, body.on(friction), of_tool, **given)]
        else:
            apparatus = {"leg": leg, "rig": rig} if body is None else {"leg": None, "rig": body}
            if isinstance(body, str) and body in OUTLINES:
                apparatus = {"leg": body, "rig": rig}
            measurements = _measurements(source, tared(columns, **apparatus))
            opened = [record_of(item, **apparatus, **options) for item in measurements]
        records += opened
    originals: dict[object, Record | PressedRecord] = {}
    for record in records:
        original = originals.setdefault((record.rig, record.readings_hash), record)
        if original is not record:
            copy = f"{record.source}: has the readings of {original.source}"
            raise InputError(f"{copy}; leave one out, a repeat is another stroke")
    return records


def open_record(forces: Any, **options: Any) -> Record:
    """Open the record of one stroke; as :func:`open_records`."""
    record, *further = open_records(forces, **options)
    if further or not isinstance(record, Record):
        raise InputError(f"{record.source}: {1 + len(further)} records, expected one of a leg")
    return record


def _sources(forces: Any) -> list[tuple[Any, Any]]:
    """Split forces into single sources, each with the leg, rig or tool that it names."""
    body: Any = None
    if isinstance(forces, tuple) and len(forces) == 2 and _is_body(forces[1]):
        forces, body = forces
    elif isinstance(forces, list | tuple):
        if not forces:
            raise InputError("no forces: the list is empty")
        return [source for item in forces for source in _sources(item)]
    elif isinstance(forces, str) and "@" in forces and not Path(forces).exists():
        source, _, body = forces.rpartition("@")
        if not _is_body(body):
            raise InputError(
                f"{forces}: after @ comes a leg ({', '.join(OUTLINES)}), a rig (rig.toml) or a "
                f"tool ({', '.join(shape.form for shape in TOOLS.values())})"
            )
        forces = source
    return [(forces, Tool.of(body) if is_tool(body) else body)]


def _is_body(body: Any) -> bool:
    """True if this names a leg, a rig or a tool."""
    if isinstance(body, str | Path):
        return body in OUTLINES or Path(body).suffix == ".toml" or is_tool(body)
    return isinstance(body, Rig | Tool | Mapping)


def rig_name(rig: Rig) -> str:
    """Name of a rig: the leg, its sizes and its friction."""
    return f"{rig}, friction {rig.leg_friction:g}"


def is_tool(body: Any) -> bool:
    """True if a body is written as a tool, such as ``"plate:60"``."""
    keywords = tuple(f"{shape.keyword}:" for shape in TOOLS.values())
    return isinstance(body, str) and body.strip().lower().startswith(keywords)


def _measurements(forces: Any, columns: ForceColumns) -> list[Measurement]:
    """Forces on a leg, with what their origin has of rig and soil."""
    if isinstance(forces, Measurement):
        return [forces]
    if isinstance(forces, ForceHistory):
        return [measurement_of(forces)]
    if isinstance(forces, str | Path):
        return open_forces(forces, columns)
    if hasattr(forces, "to_dataframe") or hasattr(forces, "columns"):
        return [measurement_of(history) for history in read_trials(forces, columns)]
    kinds = "a path, a shipped name, a ForceHistory, a DataFrame or an xarray Dataset"
    raise InputError(f"forces of type {type(forces).__name__}; give {kinds}")


def tared(columns: Any, rig: Any = None, leg: str | None = None) -> ForceColumns:
    """Options of a table, with the angles at which the leg of a rig is in air."""
    given, ends = ForceColumns.of(columns), ("air_before_deg", "air_after_deg")
    if rig is None or {*ends} & given.model_fields_set:
        return given
    of_rig = given.model_copy(update=dict(zip(ends, Rig.of(rig, leg).air_deg(), strict=True)))
    of_rig.model_fields_set.difference_update(ends)  # not stated by the user
    return of_rig


def record_of(
    measurement: Measurement,
    *,
    leg: str | None = None,
    rig: Any = None,
    density: float | str | None = None,
    noise: float | tuple[float, float] | None = None,
    gain: float | str | None = None,
    grain_size_mm: float | None = None,
    cohesion: float | str | None = None,
    simulated: bool | None = None,
) -> Record:
    """Make the record of a measurement.

    Parameters
    ----------
    measurement
        Forces, with leg and soil where their origin has them.
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
    cohesion
        Cohesion of measured soil [Pa], as a number, ``"150±50"`` or ``"unknown"``; ``None``: dry.
    simulated
        Whether the forces are a simulation's; ``None``: from their file. Their soil has the
        cohesion of their scenario, and none without one.

    Raises
    ------
    InputError
        If there is no rig, or forces, rig or density cannot be used.
    """
    name, scenario, raw = measurement.name, measurement.scenario, measurement.history
    excluded = {"sizes of the leg": rig, "gain": gain, "size of grains": grain_size_mm,
                "cohesion": cohesion}  # fmt: skip
    wrong = [label for label, value in excluded.items() if value is not None]
    if scenario is not None and wrong:
        listed = " and the ".join(wrong)
        raise InputError(f"{name}: a simulation has its own rig and soil; leave out the {listed}")
    if simulated and cohesion is not None:
        raise InputError(f"{name}: simulated forces are of dry soil; leave out the cohesion")
    if (scenario is not None or simulated) and raw.channels != FORCES:
        raise InputError(f"{name}: Fx and Fz of a simulation are needed")
    apparatus = _apparatus(measurement, rig, leg)
    stated = measurement.density_kg_m3 if density is None else density
    mean, sd = DENSITY if stated is None else density_with_sd(stated, name)
    factor, gain_sd = SENSOR_GAIN.mean, None
    if gain is not None:
        factor, gain_sd = with_sd(f"{name}: gain", gain, "it as 1.05 or 1.05±0.01", (0.1, 10.0))
    # Only where density and gain were both measured is the scale of the forces certain.
    has_scale = None not in (gain_sd, stated) and number_with_sd(str(stated))[1] is not None
    # Steps of rounding: as the table had them before it was averaged, else from the readings.
    channels, measured = raw.channels, raw.provenance.get("resolution", {})
    steps = {key: measured.get(key, resolution(raw.channel(key))) / factor for key in channels}
    coarse = " and ".join(
        f"{key} to {step:.2g} {CHANNEL_UNITS[key]}" for key, step in steps.items() if step
    )
    cohesion_pa, cohesion_sd_pa = _cohesion(cohesion, name)
    if scenario is not None:
        cohesion_pa = scenario.soil.cohesion
    rounded = [f"Readings are rounded, {coarse}: the interval includes that."] if coarse else []
    history = raw if factor == 1.0 else raw.scaled(1.0 / factor)
    return Record(
        source=label_of(name),
        history=history,
        rig=apparatus,
        density_kg_m3=mean,
        density_sd_kg_m3=0.0 if scenario is not None and density is None else sd,
        density_assumed=stated is None or (measurement.density_assumed and density is None),
        scenario=scenario,
        simulated=scenario is not None if simulated is None else simulated,
        measurement=str(raw.provenance.get("measurement", "")),
        notes=(*raw.provenance.get("reading", ()), *rounded),
        noise=_noise(history, noise, name),
        resolution=tuple(steps.values()),
        gain=factor,
        gain_sd=SENSOR_GAIN.sd if gain_sd is None else gain_sd / factor,
        scale_given=has_scale,
        grain_size_mm=grain_size(grain_size_mm, apparatus.width_mm, name),
        cohesion_pa=cohesion_pa,
        cohesion_sd_pa=cohesion_sd_pa,
    )


def _apparatus(measurement: Measurement, rig: Any, leg: str | None) -> Rig:
    """The rig that is given, or that of the measurement, with the leg that is given."""
    if leg is not None and leg not in OUTLINES:
        raise InputError(f"unknown leg '{leg}'; {nearest(leg, tuple(OUTLINES))}")
    rig = measurement.rig if rig is None else rig
    if rig is None:
        shape = leg or "straight"
        sizes = f"--leg {shape} --length 110 --width 40 --thickness 8 --hip-height 35±1"
        raise InputError(
            f"{measurement.name}: the size of the leg is not known; add it in mm, as {sizes}, or "
            f"--rig li2013 --leg {shape} for that of Li et al. (2013)"
        )
    return Rig.of(rig, leg)


def _cohesion(given: float | str | None, name: str) -> tuple[float, float]:
    """Cohesion and its standard deviation [Pa]; 0 of dry soil, infinite if unknown."""
    if given is None:
        return 0.0, 0.0
    if str(given).strip().lower() == "unknown":
        return 0.0, math.inf
    try:
        mean, sd = number_with_sd(str(given))
    except ValueError:
        mean, sd = -1.0, None
    if not 0.0 <= mean <= MOST_COHESION_PA or not 0.0 <= (sd or 0.0) <= MOST_COHESION_PA:
        accepted = f"Pa as 0 (dry), 150 or 150±50, at most {MOST_COHESION_PA:g}, or unknown"
        raise InputError(f"{name}: cohesion = {given}; give {accepted}")
    return mean, COHESION_SD_PART * mean if sd is None else sd


def _noise(
    history: ForceHistory, noise: float | tuple[float, float] | None, name: str
) -> tuple[float, ...]:
    """Standard deviation of a reading of each channel: as given, else from the roughness [N]."""
    is_short, channels = len(history.theta_deg) < 12, history.channels
    rough = {key: 0.0 if is_short else roughness(history.channel(key)) for key in channels}
    if noise is None:
        return tuple(rough.values())
    if not history.axes:
        raise InputError(f"{name}: noise is that of forces, and there is a moment alone")
    given = tuple(noise) if isinstance(noise, list | tuple) else (noise, noise)
    numbers = len(given) == 2 and all(isinstance(sd, int | float) for sd in given)
    if not numbers or not all(0.0 <= sd <= np.ptp(history.force) for sd in given):
        most = f"{np.ptp(history.force):.3g} N, the range of the forces"
        raise InputError(f"noise = {noise!r}; give one number, or two for Fx, Fz, 0 to {most}")
    of_forces = dict(zip(FORCES, given, strict=True))
    return tuple(of_forces.get(key, sd) for key, sd in rough.items())


def density_warnings(density: float) -> list[str]:
    """Warn of a bulk density that hardly any dry soil has [kg/m³]."""
    least, most = USUAL_DENSITY
    if least <= density <= most:
        return []
    usual = f"dry sand and gravel have {least:g} to {most:g} kg/m³"
    return [f"The density {density:g} kg/m³ is unusual: {usual}. Half of it moves φ by 4 to 9°."]


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
        accepted = f"{form}, from {ends[0]:g} to {ends[1]:g}, with ± below the value"
        raise InputError(f"{what} = {text}; give {accepted}")
    return mean, sd


def grain_size(given: float | str | None, width_mm: float, name: str) -> float:
    """Mean diameter of the grains on a body of a width [mm], 0 if not given; raises InputError."""
    try:
        grains = float(given or 0.0)
    except (TypeError, ValueError):
        raise InputError(f"{name}: grain_size_mm = {given!r} is no number") from None
    largest = LARGEST_GRAIN * width_mm
    if given is not None and not SMALLEST_GRAIN_MM <= grains <= largest:
        accepted = f"{SMALLEST_GRAIN_MM:g} to {largest:.3g} mm are accepted on {width_mm:g} mm"
        raise InputError(f"{name}: grain_size_mm = {grains:g}; {accepted}")
    return grains


def readings_hash(values: FloatArray) -> str:
    """Hash of readings [N], [m] to a billionth, by which a record is recognized."""
    return hashlib.sha256((values.round(9) + 0.0).tobytes()).hexdigest()[:16]


def is_ceiling(force: FloatArray, end: float, resolution: float) -> bool:
    """True if a force stops at its extreme ``end``, as of a sensor that saturates."""
    # Forces of rough soil fall below a ceiling in between. Few readings are just below it, where
    # those at a round top become fewer step by step.
    below = np.abs(force - end)
    span, gap = float(np.ptp(force)), float(min(below[below > 0.0], default=0.0))
    step = max(resolution, 1e-3 * span, gap if gap < COARSEST * span else 0.0, 1e-300)
    steps = np.floor(below / step + 1e-9)
    nearby = max(np.count_nonzero(steps == k) for k in (1, 2, 3))
    return bool(np.count_nonzero(force == end) >= max(CEILING, CEILING_OVER * nearby))


def roughness(values: FloatArray) -> float:
    """Noise of readings, from their second differences, in which noise is √6 times as large."""
    # Forces are smooth from reading to reading: e₁ − 2 e₂ + e₃ has the variance 6 σ². The median
    # absolute value over 0.6745 is a standard deviation that spikes do not raise.
    return float(1.4826 * np.median(np.abs(np.diff(values, n=2))) / np.sqrt(6.0))
