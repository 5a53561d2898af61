"""Checks of a record: sensor faults before inference, and warnings after it.

Readings with faults that hide the force (dropouts, held values, spikes) are left out. Faults that
shift many readings (a clipped top, a step, a force in air) stay, since the right readings cannot be
identified, and make any answer a misfit.

A misfit is searched for its cause: the residual of the record is minimized over φ and the shift of
the leg angle for each leg of the law and each other reading of the columns (:class:`Reading`). The
verdict and the advice read that one table. A warning is a sentence with one remedy.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.baseline import OFFSET
from terraphi.experiment.errors import NO_UNIT, InputError
from terraphi.experiment.history import (
    CHANNEL_UNITS,
    FORCES,
    OBSERVATION_ANGLES,
    WINDOW_DEG,
    ForceHistory,
)
from terraphi.experiment.measurements import measurement
from terraphi.experiment.reading import sensor_turn
from terraphi.experiment.rig import AIR_MARGIN_DEG, Rig
from terraphi.experiment.units import FORCE, GRAVITY
from terraphi.forward.rft import to_plane_strain
from terraphi.inference.answer import Estimate, RecordFit
from terraphi.inference.likelihood import SHIFT_DEG, Likelihood, squared_residuals
from terraphi.inference.records import Record, density_warnings, is_ceiling
from terraphi.inference.verdict import LITTLE_KNOWN, USUAL_DEG, unusual
from terraphi.laws.law import LegLaw
from terraphi.laws.legs import VARIED, law_of
from terraphi.laws.model_error import FINE_MM
from terraphi.laws.theory import Theory

LOADED = 0.05
"""Force over the largest above which an exact zero is a dropout [-]."""
HELD, JUMP = 5, 5.0
"""Equal readings in a row, under load, that are a held value, and the jump after them in steps of
the record's resolution."""
SPIKE = 8.0
"""Distance from the running median of a spike, over the usual one [-]."""
LARGE_SPIKE = 0.15
"""The same over the force's peak-to-peak [-]."""
CLIPPED, SLOPE_DEG, HIDDEN, ROUND = 3, 5.0, 0.02, 4.0
"""Equal largest readings in a row that may be a clipped top; path on either side of it [deg]; rise
that it must hide, of peak-to-peak and more of steps of rounding: a round top hides up to three."""
STEP = 0.2
"""Jump between neighbouring readings that is a step, of peak-to-peak [-]."""
STEP_SPACING_DEG = 1.5
"""Spacing of readings above which no steps are looked for [deg]."""
MOST_LEFT_OUT = 0.5
"""Share of the readings that may be left out [-]."""
BETTER, MUCH_BETTER, FITS, ALONE = 0.6, 1.0 / 3.0, 2.0, 2.0
"""Residual of a record read otherwise below which that fits: over that as given, with another leg
or unit, and with other columns; over the limit of a misfit. It is proposed if no other fits with a
residual of less than so many times its own [-]. Chosen, as the next ones, on 27 records of Li et
al. and of grains, each damaged in 45 ways."""
FITS_TURNED, FITS_SCALED = 0.8, 0.4
"""Residual over the limit of a misfit below which a turned cell, and a scale of θ, are proposed
[-]: with more they fit other errors too, and where they fit best no reading is proposed."""
TURNS_DEG = np.array([a for a in range(-135, 136, 5) if abs(a) >= 20], dtype=np.float64)
"""Angles of a load cell that are tried [deg]: smaller ones pass or fit other errors, and larger
ones are near the forces on the soil."""
SCALES = np.array([s for s in np.geomspace(0.35, 2.85, 43).round(2) if abs(np.log(s)) > 0.22])
"""Scales of θ that are tried [-], 5 % apart: the reader refuses larger ones."""
MOIST_PA, LIKE_GRAINS, MOIST_DEG = 40.0, 1.25, 1.5
"""Cohesion above which dry soil may be damp [Pa], and what grains of a size d add to it, over
ρ g d; standard deviation of φ by a cohesion that an answer names [deg]. Dry media of Li et al.
(2013) fit up to 24 Pa; dry grains of 4 to 9 mm pass the limit in 3 of 90 records."""
LARGE_SHIFT_DEG = 8.5
"""Distance of the leg angle's shift from the usual one above which an answer says so [deg]: media
of Li et al. (2013) have up to 7.5°."""
ONSET, LATE_DEG = 0.1, 11.0
"""Force over its largest at which contact has begun [-]; difference of that angle from the model's
that another leg makes [deg]: at most 9° in the shipped records."""
OTHER_ARM = 1.3
"""Factor between a moment and that of the forces that another leg makes: 0.91 to 1.27 in grains."""
NEARLY_ALL = 0.98
"""Share of a stroke's information that counts as all of it [-]."""
NEAR_DEG = 1.0
"""Distance from the soils that the law's error was learned from within which it is known [deg];
chosen."""
OF_SIZE_DEG, COARSE_MM = 0.6, 6.0
"""What a mm of grain diameter adds to the angle from which an answer says so [deg], as a mean up to
coarse grains [mm]; chosen."""
REPEATS_DEG = 3.0
"""Largest difference of φ between records of one soil on one rig [deg]: beds of loose grains of 6
to 9 mm differ by 0.7 to 1.1° (standard deviation), so that one pair in twenty differs by more."""
HIP_MM, HIP_RESIDUAL, HIP_SURE = 4.0, 0.05, 2.58
"""Error of the hip's height above which an answer names it [mm], and over its standard deviation,
one in a hundred [-]; residual of both forces below which it is looked for [-]. In the records of Li
et al. (2013) whose residual is below 5 % the forces give the hip within 2.5 mm. Of 88 records of
grains none is named; two would be by the first number alone. Held out were 8 records of grains by
another program and 17 simulations of Li's legs: none is named; with a hip 8 mm too low all
simulations are."""
UNUSUAL = 2.0
"""Standard deviations that are unusual [-]: one in twenty."""
FAR_APART_DEG = 10.0
"""Distance of two opinions above which answers doubt the record [deg]: at most 8.5° with the right
leg in simulated grains and shipped media, 14° where a wrong leg is consistent."""
UNITS = ("N", "lbf", "kgf", "gf", "kN", "mN")
"""Units of force that a record may be in."""


def without_faults(record: Record) -> Record:
    """A record without readings that no leg in soil makes, averaged in bins if it is long.

    Each kind of fault leaves a note.

    Raises
    ------
    InputError
        If more than half of the readings are faulty, or a force is constant.
    """
    theta, damage, notes = record.history.theta_deg, [], list(record.notes)
    forces = {name: record.history.channel(name) for name in record.channels}
    largest = {name: float(np.abs(force).max()) for name, force in forces.items()}
    of_forces = max((size for name, size in largest.items() if name != "M"), default=0.0)
    bad = np.zeros(len(theta), dtype=bool)
    all_zero = np.all([force == 0.0 for force in forces.values()], axis=0)
    steps = dict(zip(record.channels, record.resolution, strict=True))
    ends = np.array(record.rig.air_deg())
    in_air = (theta < ends[0]) | (theta > ends[1])
    first, last = ends + (AIR_MARGIN_DEG + LATE_DEG) * np.array([1, -1])
    in_soil = np.array([theta[0] > first, theta[-1] < last])
    for name, force in forces.items():
        span, load = float(np.ptp(force)), LOADED * (largest["M"] if name == "M" else of_forces)
        faults = {
            "dropouts": _dropouts(force, all_zero, max(load, 1.01 * steps[name]), in_soil),
            "held values": _held(force, span) & ~in_air,  # there a sensor without its zero rests
            "spikes": _spikes(force, span, steps[name]),
        }
        for kind, faulty in faults.items():
            if count := int(faulty.sum()):
                low, high = theta[faulty][[0, -1]]
                readings = "1 reading" if count == 1 else f"{count} readings"
                place = f"between {low:.1f} and {high:.1f}°" if high > low else f"at {low:.1f}°"
                notes.append(f"{readings} of {name} left out as {kind} {place}.")
                bad |= faulty
    if bad.mean() > MOST_LEFT_OUT:
        faulty = f"{bad.mean():.0%} of the readings are faulty ({' '.join(notes)})"
        raise InputError(f"{record.source}: {faulty}; check the sensor and record again")
    for name, force in forces.items():
        args = name, force[~bad], theta[~bad], steps[name]
        damage += [sentence for sentence in (_clipped(*args), _step(*args)) if sentence]
    sound = replace(
        record, history=record.history.chosen(~bad), n_left_out=int(bad.sum()),
        notes=tuple(notes), damage=(*record.damage, *damage),
    ).binned()  # fmt: skip
    for values, name in zip(sound.data, sound.channels, strict=True):
        if np.ptp(values) <= 1e-9 * max(float(np.abs(sound.data).max()), 1e-300):
            why = f"{name} is the same at every angle; check the sensor"
            raise InputError(f"{record.source}: {why}")
    return sound


def _dropouts(force: FloatArray, all_zero: BoolArray, load: float, in_soil: BoolArray) -> BoolArray:
    """Exact zeros between loaded readings: of this force, or of all.

    Zeros up to an end of the record are dropouts if that end is in the soil; in air zero is right.
    """
    # A zero is a dropout if the loaded readings next to it, before and after, exceed the limit: the
    # smaller of the two sizes counts. Beyond the first and last loaded reading the same size is
    # repeated, times 0 where that end of the record is in air.
    loaded = np.flatnonzero((force != 0.0) & ~all_zero)
    if loaded.size < 3:
        return np.zeros(len(force), dtype=bool)
    sizes = np.pad(np.abs(force[loaded]), 1, mode="edge")
    sizes[[0, -1]] *= in_soil
    after = np.searchsorted(loaded, np.arange(len(force))) + 1
    around = np.minimum(sizes[after - 1], sizes[after])
    return np.asarray((force == 0.0) & (around > load))


def _held(force: FloatArray, span: float) -> BoolArray:
    """Runs of equal readings under load that end with a jump, as of a value that was held."""
    changes = np.append(np.abs(np.diff(force)), np.inf)
    # A sensor that holds its last value catches up with a jump of several of its smallest steps.
    quantum = changes[changes > 1e-12 * span].min(initial=span)
    last = np.flatnonzero(changes > 0.0)
    first = np.append(0, last[:-1] + 1)
    value, length = force[first], last - first + 1
    is_held = (length >= HELD) & (last + 1 < len(force)) & (changes[last] > JUMP * quantum)
    is_held &= (np.abs(value) > LOADED * span) & (force.min() < value) & (value < force.max())
    # The first reading of a run is right.
    held = np.repeat(is_held, length)
    held[first] = False
    return held


def _spikes(force: FloatArray, span: float, resolution: float) -> BoolArray:
    """Readings far from the median of their neighbours."""
    padded = np.pad(force, 3, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 7)
    distance = np.abs(force - np.median(windows, axis=1))
    # Usual distances: the median one, as a standard deviation, or half the step between neighbours
    # where the force is steep.
    usual = max(float(1.4826 * np.median(distance)), 1e-9 * span, resolution / np.sqrt(12.0))
    scale = np.maximum(usual, 0.5 * np.median(np.abs(np.diff(windows, axis=1)), axis=1))
    return np.asarray((distance > SPIKE * scale) & (distance > LARGE_SPIKE * span))


def _clipped(name: str, force: FloatArray, theta: FloatArray, resolution: float) -> str:
    """A sentence if the record is cut off flat at its largest readings.

    A round top has equal readings too, if the sensor is coarse. The slopes on either side of a
    clipped one meet well above it.
    """
    for end in (force.max(), force.min()):
        at = np.flatnonzero(force == end)
        if at.size < CLIPPED or abs(end) < 0.2 * np.ptp(force):
            continue
        first, last = theta[at[0]], theta[at[-1]]
        if is_ceiling(force, float(end), resolution):
            return _saturated(name, end, first, last)
        if np.any(np.diff(at) > 1):
            continue
        rise = (theta >= first - SLOPE_DEG) & (theta <= first)
        fall = (theta >= last) & (theta <= last + SLOPE_DEG)
        if rise.sum() < 3 or fall.sum() < 3:
            continue
        up = abs(np.polyfit(theta[rise], force[rise], 1)[0])
        down = abs(np.polyfit(theta[fall], force[fall], 1)[0])
        # Lines of slopes a and b over a flat top of width w meet w a b / (a + b) above it.
        hidden = (last - first) * up * down / max(up + down, 1e-12)
        if hidden > HIDDEN * np.ptp(force) + ROUND * resolution:
            return _saturated(name, end, first, last)
    return ""


def _saturated(name: str, end: float, first: float, last: float) -> str:
    stays = f"{name} stays at its extreme, {end:.3g} N, from {first:.0f} to {last:.0f}°"
    return f"{stays}: check whether the sensor saturates."


def _step(name: str, force: FloatArray, theta: FloatArray, resolution: float) -> str:
    """A sentence if the force jumps and stays there."""
    if len(force) < 20 or np.median(np.diff(theta)) > STEP_SPACING_DEG:
        return ""
    width = max(3, int(2.0 / np.median(np.diff(theta))))
    if 2 * width >= len(force):
        return ""
    # The means over 2° before and after a step differ by nearly the jump itself; those about a
    # spike do not, and a slope has no jump that is large among its neighbours.
    means = np.convolve(force, np.ones(width) / width, "valid")
    jumps = means[width:] - means[:-width]
    near = np.diff(theta) <= STEP_SPACING_DEG  # across a gap the force may change
    sharp = (near * np.abs(np.diff(force)))[width - 1 : width - 1 + len(jumps)]
    usual = np.median(np.abs(np.diff(force)))
    at = int(np.argmax(sharp))
    size = float(np.diff(force)[width - 1 + at])
    if (
        abs(size) > STEP * np.ptp(force)
        and abs(jumps[at]) > 0.7 * abs(size)
        and abs(size) > max(20 * usual, 2.0 * resolution)
    ):
        place = theta[width - 1 + at]
        return f"{name} jumps by {size:.2g} N at {place:.0f}° and stays there: record it again."
    return ""


# -- after the fit -------------------------------------------------------------------------------


def in_air(likelihood: Likelihood) -> list[str]:
    """Warn of each measured force that is not zero where the leg is in the air."""
    sentences = []
    for record, shift in zip(likelihood.records, likelihood.shift_deg, strict=True):
        first, last = shift + np.array(record.rig.air_deg())
        theta = record.history.theta_deg
        # Soil that the leg carries along may press on it a little where the model has none left.
        for side, air, limit in (
            ("before the leg meets the soil", theta < first, OFFSET),
            ("after it has left the soil", theta > last, 2.0 * OFFSET),
        ):
            for name in record.channels if air.sum() >= 3 and not record.simulated else ():
                values = record.history.channel(name)
                # Soil that is met early is met more and more; an offset is there all the way.
                size = float(np.quantile(np.abs(values[air]), 0.2))
                size *= float(np.sign(np.median(values[air])))
                if abs(size) > limit * np.ptp(values):
                    force = f"{name} is {size:.2g} {CHANNEL_UNITS[name]} in air, {side}"
                    remedy = "tare the sensor, or check the leg"
                    sentences.append(f"{record.source}: {force}: {remedy}.")
    return sentences


def warnings(
    likelihood: Likelihood,
    fits: Sequence[RecordFit],
    phi: Estimate,
    verdict: str,
    opinion: Mapping[str, Any] | None,
    legs: Sequence[Sequence[Reading]],
    air: Sequence[str],
) -> Iterator[str]:
    """Sentences on an answer, in the order of their consequence, the gravest first."""
    records, law = likelihood.records, likelihood.library
    # The forces are wrong, whatever the soil.
    yield from (f"{likelihood.prefix(r)}{text}" for r in records for text in r.damage)
    yield from air
    units, notes = (
        [f"{likelihood.prefix(r)}{text}" for r in records for text in r.notes
         if (NO_UNIT in text) == is_unit]
        for is_unit in (True, False)
    )  # fmt: skip
    yield from units
    yield from _unusual(likelihood, phi, verdict)
    # Leg, columns, sizes or units may be others than stated.
    if not air:
        for i, readings in enumerate(legs):
            for sentence in misread(likelihood, i, readings, verdict):
                yield f"{likelihood.prefix(records[i])}{sentence}"
    yield from _calibrated_otherwise(likelihood)
    separation_deg, theory = 0.0, ""
    if opinion and law.convention == "plane_strain":
        separation_deg = abs(opinion["median"] - phi.median)
        other = f"{opinion['median']:.0f}°, {separation_deg:.0f}° from law {law.name}"
        theory = f"Resistive force theory gives {other}"
    if separation_deg > FAR_APART_DEG:
        yield f"{theory}, more than the usual {FAR_APART_DEG:g}°: check the leg and the columns."
    if likelihood.measured:
        yield from _displaced(likelihood, fits, verdict)
    # The angle or its interval rests on what was not measured.
    if likelihood.disagreement_deg:
        yield f"{theory} and outside both intervals: the interval is wider by that."
    if likelihood.calibration is not None:
        yield f"Calibrated with {likelihood.calibration}. The error of each soil remains."
        yield from likelihood.calibration.warnings()
    for i, record in enumerate(records):
        yield from (f"{likelihood.prefix(record)}{text}" for text in _assumed(likelihood, i))
        if i == 0:
            yield from () if air else _moisture(likelihood)
            yield from _repeats(likelihood)
    if law.caveat:
        yield f"Law {law.name}: {law.caveat}"
    # What was done with the readings.
    yield from notes


def _calibrated_otherwise(likelihood: Likelihood) -> Iterator[str]:
    """Warn of a calibration of these very forces, or of the size of grains given for it alone."""
    soils = likelihood.calibration.soils if likelihood.calibration else ()
    hashes = {record.readings_hash for record in likelihood.records}
    yield from (f"The calibration was made of this record, {soil.source}: agreement shows nothing."
                for soil in soils if soil.readings in hashes)  # fmt: skip
    largest = max((soil.grain_size_mm for soil in soils), default=0.0)
    if largest >= FINE_MM and not any(r.grain_size_mm for r in likelihood.records):
        yield f"The calibration is of grains of {largest:g} mm: give --grain-size of large ones."


def _displaced(likelihood: Likelihood, fits: Sequence[RecordFit], verdict: str) -> Iterator[str]:
    """Warn of forces that come early or late, and of a hip of another height that fits better."""
    for fit in fits:
        late = fit.shift_deg - likelihood.error.of_leg(fit.rig.leg).shift_deg
        if abs(late) > LARGE_SHIFT_DEG:
            when = f"{abs(late):.0f}° {'later' if late > 0 else 'earlier'} than usual"
            check = "check the zero of theta and the hip height"
            yield f"{fit.source}: the forces come {when} for this leg: {check}."
    for i, record in enumerate(likelihood.records if verdict == "consistent" else ()):
        free = likelihood.free_cohesion(i, with_hip=True) if "Fx" in record.channels else None
        if free is None:
            continue
        higher, sd = free.higher_mm, free.higher_sd_mm
        limit = max(HIP_MM, HIP_SURE * sd, UNUSUAL * record.rig.hip_height_sd_mm)
        if free.residual < HIP_RESIDUAL and abs(higher) > limit:
            side = "higher" if higher > 0 else "lower"
            yield (
                f"{likelihood.prefix(record)}The forces fit a hip {abs(higher):.0f} ± {sd:.0f} mm "
                f"{side} than {record.rig.hip_height_mm:g} mm: check the hip height and the leg "
                "length."
            )


def _unusual(likelihood: Likelihood, phi: Estimate, verdict: str) -> Iterator[str]:
    """Warn of an angle that the forces hardly determine, or that few soils have."""
    if likelihood.sd > np.ptp(likelihood.ends) / np.sqrt(12.0):
        yield LITTLE_KNOWN
    if not likelihood.measured:
        return
    leg = likelihood.rig.leg
    low, high = likelihood.error.of_leg(leg).phi_deg or (-np.inf, np.inf)
    is_inside = low - NEAR_DEG <= phi.median <= high + NEAR_DEG
    if verdict == "consistent" and not is_inside:
        ends = f"{low:.1f} to {high:.1f}°, where the error of the law was learned on leg {leg}"
        yield f"φ = {phi.median:.1f}° lies outside {ends}: it may be larger there."
    yield from unusual(phi.median, "leg")


def _assumed(likelihood: Likelihood, i: int) -> Iterator[str]:
    """Sentences on what an answer assumes of a record."""
    record, law, density = likelihood.records[i], likelihood.library, likelihood.density
    rig, share, grains = record.rig, likelihood.coverage[i].share, record.grain_size_mm
    spacing = float(np.median(np.diff(record.history.theta_deg)))
    window_deg = 2.0 * WINDOW_DEG / (OBSERVATION_ANGLES - 1)
    if spacing > window_deg:
        yield f"The readings are {spacing:.0f}° apart: record one every {window_deg:.0f}° at least."
    has_height = likelihood.calibration or "hip height" in likelihood.terms
    if likelihood.measured and rig.hip_height_sd_mm > 0.0 and not has_height:
        height = f"± {rig.hip_height_sd_mm:g} mm of the hip height"
        yield f"The interval leaves out the {height}, whose effect law {law.name} lacks."
    if share < NEARLY_ALL and likelihood.measured:
        ends = np.clip(record.history.theta_deg[[0, -1]], -WINDOW_DEG, WINDOW_DEG)
        low, high = ends.round() + 0.0
        covered = f"{low:.0f} to {high:.0f}° of ±{WINDOW_DEG:g}°"
        yield f"The record covers {covered}, {100.0 * share:.0f} % of a stroke's information on φ."
    of_size_deg = likelihood.of_size_deg(grains)
    if grains and not any(name.startswith("grains") for name in likelihood.error.effects):
        yield f"Law {law.name} has no correction for large grains."
    elif abs(of_size_deg) > 0.05:
        yield f"φ is corrected by {-of_size_deg:+.1f}° for grains of {grains:g} mm."
    per_mm = likelihood.of_size_deg(COARSE_MM) / COARSE_MM
    if not grains and per_mm > OF_SIZE_DEG:
        raised = f"each mm of grain diameter raises φ by {per_mm:.1f}° on this leg"
        yield f"Fine grains are assumed: {raised}; give --grain-size."
    if record.simulated and record.scenario is None and likelihood.law.most_cohesion:
        yield "The simulated forces have no scenario: dry soil is assumed."
    unusual = density_warnings(density) if likelihood.measured else []
    if unusual and record.measurement and measurement(record.measurement).density_kg_m3 == density:
        unusual = []  # the seeds of Li et al. are light
    yield from unusual
    if record.density_assumed:
        yield f"The density {density:g} kg/m³ is assumed; an error of 10 % moves φ by about 1°."


def _repeats(likelihood: Likelihood) -> Iterator[str]:
    """Warn if records of one soil on one rig have angles far from each other."""
    if len(likelihood.records) < 2 or not likelihood.measured:
        return
    angles = likelihood.angle_of_each()
    low, high = int(angles.argmin()), int(angles.argmax())
    if angles[high] - angles[low] > REPEATS_DEG:
        names = [likelihood.records[i].source for i in (low, high)]
        alone = f"{names[0]} alone has about {angles[low]:.0f}°, {names[1]} {angles[high]:.0f}°"
        yield f"{alone}: check whether both are of one soil at one density."


def _moisture(likelihood: Likelihood) -> Iterator[str]:
    """Warn of dry soil whose forces fit a cohesion better, or if an unknown one matters."""
    if "cohesion" in likelihood.terms:
        c, sd, phi_sd = likelihood.averaged
        if phi_sd > MOIST_DEG:
            yield f"φ is uncertain by {phi_sd:.1f}° because the cohesion is {c:.0f} ± {sd:.0f} Pa."
        return
    for i, record in enumerate(likelihood.records if likelihood.measured else ()):
        free = likelihood.free_cohesion(i)
        like_grains = LIKE_GRAINS * likelihood.density * GRAVITY * 1e-3 * record.grain_size_mm
        if free and free.cohesion_pa > record.cohesion_pa + MOIST_PA + like_grains:
            size = "" if record.grain_size_mm else ", whether its grains are large (--grain-size)"
            yield (
                f"{likelihood.prefix(record)}The forces fit a cohesion of about "
                f"{free.cohesion_pa:.0f} Pa better, and φ would be lower: check whether the soil "
                f"is damp (--cohesion){size}, the hip height, the density and the unit of force."
            )


# -- one search over legs and readings -----------------------------------------------------------


class Reading(NamedTuple):
    """A leg, or another reading of the columns, and the least residual with it."""

    option: str
    """Option for it, such as ``--columns fx_sign=-1``."""
    residual: float
    """Root mean square of data less curve over φ and shift, over peak-to-peak [-]."""
    fits: float = 0.0
    """Residual below which it fits [-]."""
    proposed: float = 0.0
    """Residual below which it is proposed where it fits best [-]."""
    check: str = "check the columns"
    leg: str = ""
    """Shape of the leg; empty for a reading of the columns."""
    changes: int = 1
    """Number of options that are changed."""


def leg_readings(likelihood: Likelihood, record: Record) -> list[Reading]:
    """Least residual of measured forces by each leg of the law, in the sizes of the record's.

    At the cohesion of the answer; infinite for a leg that the law does not have in these sizes.
    """
    if record.scenario is not None or record.channels != FORCES:
        return []
    readings = []
    for leg in likelihood.library.legs:
        size = np.inf
        with suppress(InputError):
            law, force = _forces(likelihood, record, leg, likelihood.cohesion)
            [size] = _residuals(record, record.data[None], law, force, likelihood.measured)
        readings.append(Reading(f"--leg {leg}", size, check="check the leg", leg=leg))
    return readings


def _forces(
    likelihood: Likelihood, record: Record, leg: str, cohesion: float = 0.0, *, usual: bool = False
) -> tuple[LegLaw, FloatArray]:
    """Law of a leg in the sizes of a record's, and its forces over φ [N], [k, 2, theta].

    At a cohesion [Pa]; of usual soils alone, if asked. Raises InputError if the law does not have
    the leg in these sizes.
    """
    rig = Rig.of(record.rig, leg)
    law = law_of(likelihood.library, rig, record.scenario)
    density = record.density_kg_m3
    number = cohesion / (density * GRAVITY * rig.length)
    low, high = law.bounds[0][0], law.bounds[1][0]
    # Columns are judged by angles of real soil alone: at any angle some curve resembles any forces.
    if usual:
        ends = np.array(USUAL_DEG)
        low, high = np.clip(ends + likelihood.offset(ends), low, high)
    return law, density / law.density * law(np.linspace(low, high, 65)[:, None], number)


def _residuals(
    record: Record, data: FloatArray, law: LegLaw, force: FloatArray, measured: bool
) -> list[float]:
    """Least residual of window means over forces and shifts, over peak-to-peak [-].

    Shapes: data [h, c, m], forces [k, 2, theta]; [h].
    """
    shifts = np.arange(-SHIFT_DEG, SHIFT_DEG + 1.0, 3.0) if measured else np.zeros(1)
    squares = squared_residuals(record, data, force, law, shifts)
    return [math.sqrt(least / data[0].size) for least in squares.min(axis=(1, 2)).tolist()]


def _column_readings(likelihood: Likelihood, record: Record, given: float) -> Iterator[Reading]:
    """Least residuals with other signs, axes, units, and angles of load cell and leg.

    Of usual dry soils; ``given`` is the residual of the record as it is read [-].
    """
    law, force = _forces(likelihood, record, record.rig.leg, usual=True)
    limit, history = likelihood.error.nrmsd_limit(record.rig, record.grain_size_mm), record.history
    # Limits of a residual: a third, or 0.6, of that of the columns as they are, and twice the limit
    # of a misfit at most.
    strict, loose = min(MUCH_BETTER * given, FITS * limit), min(BETTER * given, FITS * limit)
    read_as = history.provenance.get("columns", {})  # an option that was given is turned back

    def sizes(changes: Iterable[FloatArray], other: ForceHistory = history) -> list[float]:
        """Residuals with other angles and with forces changed by matrices, [2, 2] or [m, 2, 2]."""
        of_other = record if other is history else replace(record, history=other)
        data = np.stack([(m @ of_other.data.T[..., None])[..., 0].T for m in changes])
        return _residuals(of_other, data, law, force, likelihood.measured)

    # Signs and axes of the forces, in the axes of the load cell.
    cell_deg, turns_with_leg = read_as.get("sensor_angle_deg", 0.0), "sensor_turns" in read_as
    cell = sensor_turn(cell_deg + turns_with_leg * record.theta_deg)
    back = np.swapaxes(cell, -1, -2)
    theta, fx, fz = (f"{n}_sign={-read_as.get(f'{n}_sign', 1)}" for n in ("theta", "fx", "fz"))
    on = "force_on=" + ("leg" if read_as.get("force_on") == "soil" else "soil")
    signs = {
        fx: cell @ np.diag([-1.0, 1.0]) @ back,
        fz: cell @ np.diag([1.0, -1.0]) @ back,
        on: -np.eye(2),
    }
    axes = signs | {"fx=FZ_COLUMN,fz=FX_COLUMN": cell @ np.eye(2)[::-1] @ back}
    # The sign of θ, alone or with that of a force.
    reversed_path = replace(history, position=-history.position[::-1], force=history.force[::-1],
                            moment=None)  # fmt: skip
    turned = {theta: np.eye(2)} | {f"{option},{theta}": sign for option, sign in signs.items()}
    # Not of a cell that turns: its forces along x and z would be others.
    paths = ((axes, history), (turned, reversed_path))[: 2 - turns_with_leg]
    for options, path in paths:
        for option, size in zip(options, sizes(options.values(), path), strict=True):
            changes = 1 + option.endswith(f",{theta}")
            yield Reading(f"--columns {option}", size, strict, strict, changes=changes)

    read_in = history.provenance.get("force_unit", "N")
    units = {u: FORCE[u] / FORCE[read_in] * np.eye(2) for u in UNITS if u != read_in}
    check = "check the columns and the leg length"
    # A unit that the header names excludes the option.
    is_free = "unit" in read_as or any(NO_UNIT in text for text in record.notes)
    for unit, size in zip(units, sizes(units.values()), strict=True):
        option = f"--columns unit={unit}" if is_free else f"the unit {unit} in the header"
        yield Reading(option, size, loose, loose, check)

    turns = sizes(map(sensor_turn, TURNS_DEG))
    angle = (cell_deg + TURNS_DEG[int(np.argmin(turns))] + 180.0) % 360.0 - 180.0
    option, close = f"--columns sensor_angle_deg={angle:.0f}", min(strict, FITS_TURNED * limit)
    mounted = "check how the load cell is mounted"
    yield Reading(option, min(turns), loose, close, mounted)
    sign = -1.0 if turns_with_leg else 1.0
    mounts = [0.0, 90.0, -90.0, 180.0]
    turns = sizes(sensor_turn(a + sign * record.theta_deg) for a in mounts)
    angle = 180.0 - (180.0 - cell_deg - mounts[int(np.argmin(turns))]) % 360.0
    option = f"--columns sensor_turns={str(not turns_with_leg).lower()}"
    option += f",sensor_angle_deg={angle:g}" if angle != cell_deg else ""
    yield Reading(option, min(turns), loose, close, mounted)

    scaled = {}
    for scale in SCALES.tolist():
        with suppress(InputError):  # too short a part of the stroke
            longer = replace(history, position=scale * history.position)
            [scaled[scale]] = sizes([np.eye(2)], longer)
    scale = min(scaled, key=scaled.__getitem__, default=1.0)
    key = "rate_deg_s" if "rate_deg_s" in read_as else "theta_scale"
    option = f"--columns {key}={read_as.get(key, 1.0) * scale:.3g}"
    if offset_deg := read_as.get("theta_offset_deg"):
        option += f",theta_offset_deg={offset_deg * scale:.3g}"
    close = min(strict, FITS_SCALED * limit)
    check = "check the unit and the zero of theta"
    yield Reading(option, scaled.get(scale, np.inf), loose, close, check)


def _other_readings(
    likelihood: Likelihood, record: Record, legs: Sequence[Reading]
) -> Iterator[str]:
    """Advise the only column, unit, scale or leg by which a misfit would be described much better.

    Parameters
    ----------
    legs
        Rows of the search by :func:`leg_readings`, which the columns are added to.
    """
    if record.damage or not legs:
        return
    [given] = [reading.residual for reading in legs if reading.leg == record.rig.leg]
    most = min(
        BETTER * given, FITS * likelihood.error.nrmsd_limit(record.rig, record.grain_size_mm)
    )
    table = [*_column_readings(likelihood, record, given)]
    table += [r._replace(fits=most, proposed=most) for r in legs if r.leg != record.rig.leg]
    fitting = sorted((r for r in table if r.residual < r.fits), key=lambda r: r.residual)
    # Two signs at once only where no single reading fits nearly as well.
    near = [r for r in fitting if r.residual < ALONE * fitting[0].residual]
    fitting = [r for r in near if r.changes == 1] or near
    if not fitting or fitting[0].residual >= fitting[0].proposed:
        return
    fitting = [r for r in fitting if r.residual < r.proposed]
    if len(fitting) > 1 and all(r.leg for r in fitting):
        agreeing = [r for r in fitting if _opinions_agree(likelihood, record, r.leg)]
        fitting = agreeing if len(agreeing) == 1 else fitting
    best, options = fitting[0], [r.option for r in fitting]
    falls = f"The residual would fall to {100.0 * best.residual / given:.0f} % of its size"
    if len(fitting) == 1:
        yield f"{falls} with {best.option}: {best.check}."
    else:
        listed = " or ".join(o.replace("--columns ", "").replace("--", "") for o in options)
        yield f"{falls} with either {listed}: check which is right."


def _opinions_agree(likelihood: Likelihood, record: Record, leg: str) -> bool:
    """True if the law and resistive force theory give much the same angle by another leg."""
    other = Likelihood([replace(record, rig=Rig.of(record.rig, leg))], likelihood.library)
    opinion = second_opinion(other)
    return bool(opinion and abs(opinion["median"] - other.least_squares) <= FAR_APART_DEG)


def misread(likelihood: Likelihood, i: int, legs: Sequence[Reading], verdict: str) -> Iterator[str]:
    """Warn of a leg, columns, sizes and units of a record that may be others than stated.

    Other readings are proposed for a misfit alone.
    """
    record, law = likelihood.records[i], likelihood.library
    if record.scenario is not None:
        from terraphi.laws.store import differences

        keys = [k for k in differences(record.scenario, law.scenario) if k not in VARIED]
        if keys:
            listed = ", ".join(keys[:3]) + (", …" if len(keys) > 3 else "")
            yield f"The simulation differs from law {law.name} in {listed}: φ may be wrong."
        return
    advice = [] if verdict == "consistent" else [*_other_readings(likelihood, record, legs)]
    yield from advice or [*_other_arm(likelihood, i), *_other_size(likelihood, i)]


def _other_arm(likelihood: Likelihood, i: int) -> Iterator[str]:
    """Warn of a moment about the hip that is not that of the forces, with the model's arms."""
    record, law = likelihood.records[i], likelihood.law
    if record.channels != FORCES or record.history.moment is None:
        return
    theta_deg = law.theta_deg + likelihood.shift_deg[i]
    arm = np.stack([np.interp(record.theta_deg, theta_deg, row) for row in law.arm])
    of_forces = (arm * record.data).sum(axis=0)
    # Least squares of the measured moment on that of the forces, through the origin.
    factor = float(of_forces @ record.means(record.history.moment) / (of_forces @ of_forces))
    ratio = np.log(max(factor, 1e-3))
    if abs(ratio) > np.log(OTHER_ARM):
        # Forces in another unit than they are read in, next to a moment in N m.
        units = [u for u in ("lbf", "kgf") if abs(ratio - np.log(FORCE[u])) < np.log(OTHER_ARM)]
        equal = "".join(f" In {u} they would be equal (--columns unit={u})." for u in units)
        moments = f"The moment is {factor:.2g} times that of the forces about the hip"
        yield f"{moments}: check the leg length, the units and the axis of the moment.{equal}"


def _other_size(likelihood: Likelihood, i: int) -> Iterator[str]:
    """Warn of a contact that begins elsewhere than in the model, as of a leg of another length."""
    record, part = likelihood.records[i], likelihood.parts[i]
    best = np.clip(likelihood.least_squares, likelihood.low, likelihood.high)
    curve = likelihood.curves(best)[0, part].reshape(len(record.channels), -1)
    # Contact begins where the magnitude of the force passes a tenth of its largest.
    begins = []
    for force in (record.data, curve):
        size = np.linalg.norm(force / np.ptp(force), axis=0)
        begins.append(int(np.argmax(size > ONSET * size.max())))
    theta = record.theta_deg[begins]
    theta[1] -= likelihood.shift_deg[i]
    if min(begins) > 0 and abs(theta[0] - theta[1]) > LATE_DEG:
        places = f"{theta[0]:.0f}° in the record and at {theta[1]:.0f}° in the model"
        yield f"Contact begins at {places}: check the leg length and the hip height."


# -- another law on the same records -------------------------------------------------------------


def second_opinion(likelihood: Likelihood) -> dict[str, Any] | None:
    """Angle of measured forces by law ``rft3d``, as one of plane strain.

    With it goes φ at which forces by the first law are as large, whatever their shape.
    """
    if not likelihood.measured or isinstance(likelihood.library, Theory):
        return None
    theory = Theory()
    dry = [replace(r, cohesion_pa=0.0, cohesion_sd_pa=0.0) for r in likelihood.records]
    try:
        other = Likelihood(dry, theory)
    except InputError:
        return None  # it does not cover the angles of the record
    read = other.least_squares
    if not other.low <= read <= min(other.high, 43.0):
        return None  # beyond its range, or nearly without an equivalent in plane strain
    below, median, above = to_plane_strain(read + np.array([-1.0, 0.0, 1.0])).tolist()
    phi = np.linspace(likelihood.low, likelihood.high, 71)
    # φ at which Σ (g/p)² equals Σ (d/p)²: forces grow with φ, and a running maximum makes the
    # table monotone for its inversion.
    size = np.square(likelihood.curves(phi) / likelihood.span).sum(axis=1)
    measured = float(np.square(likelihood.data / likelihood.span).sum())
    return {
        "law": theory.name,
        "median": median,
        "sd": other.sd * (above - below) / 2.0,
        "force_size_deg": float(np.interp(measured, np.maximum.accumulate(size), phi)),
    }
