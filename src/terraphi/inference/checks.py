"""What looks wrong with a record: sensor faults before inference, units and signs after.

Faults that hide a few readings (dropouts, held values, spikes) are left out. Faults that shift many
readings (a clipped top, a step, a force in air) are left in, since the right readings cannot be
identified, and make any answer a misfit. A doubt is a sentence with one remedy.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.baseline import OFFSET
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import CHANNEL_UNITS, FORCES, OBSERVATION_ANGLES, WINDOW_DEG
from terraphi.experiment.measurements import measurement
from terraphi.experiment.reading import sensor_turn
from terraphi.experiment.rig import AIR_MARGIN_DEG, Rig
from terraphi.experiment.scenario import GRAVITY
from terraphi.experiment.units import FORCE
from terraphi.forward.rft import to_plane_strain
from terraphi.inference.answer import Estimate, RecordFit
from terraphi.inference.likelihood import SHIFT_DEG, Likelihood, squared_residuals
from terraphi.inference.records import Record, density_doubts
from terraphi.laws.law import LegLaw
from terraphi.laws.legs import VARIED, law_of
from terraphi.laws.store import Library, differences
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
USUAL_DEG = (18.0, 50.0)
"""Friction angles of dry soils in plane strain [deg]: from glass beads, 21 to 24° (Jop, Forterre &
Pouliquen 2006, Nature 441:727), to dense quartz sand at its peak, 48° (Bolton 1986, Géotechnique
36:65, table 1, whose critical angles are about 30 to 37°)."""
MOIST_PA, COHESIVE_PA, KNOWN, MOIST_DEG = 20.0, 100.0, 1.5, 1.5
"""Cohesions above which an answer names them, if they are so many standard deviations [-], and
above which dry soil must be coarse [Pa]; standard deviation of φ by a cohesion above which an
answer says so [deg]: chosen; grains of 4 mm act like 20 to 50 Pa, measured sands like 0 to 30."""
LARGE_SHIFT_DEG = 8.5
"""Distance of the leg angle's shift from the usual one above which an answer says so [deg]: media
of Li et al. (2013) have up to 8.2°."""
ONSET, LATE_DEG = 0.1, 11.0
"""Force over its largest at which contact has begun [-]; difference of that angle from the model's
that another leg makes [deg]: at most 9° in the shipped records."""
OTHER_ARM = 1.3
"""Factor between a moment and that of the forces that another leg makes: 0.91 to 1.27 in grains."""
NEARLY_ALL = 0.995
"""Share of a stroke's information that counts as all of it [-]."""
OF_SIZE_DEG = 0.5
"""What a mm of grain diameter adds to the angle from which an answer says so [deg]; chosen."""
HIP_MM, HIP_RESIDUAL, HIP_SURE = 4.0, 0.05, 2.58
"""Error of the hip's height above which an answer names it [mm], and over its standard deviation,
one in a hundred [-]; residual of both forces below which it is looked for [-]. In the records of Li
et al. (2013) whose residual is below 5 % the forces give the hip within 2.5 mm. Of 88 records of
grains none is named; two would be by the first number alone. Held out were 8 records of grains by
another program and 17 simulations of Li's legs: none is named, with a hip 8 mm too low 16 are."""
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
        If more than half of the readings are faulty.
    """
    theta, notes = record.history.theta_deg, []
    damage: list[str] = []
    forces = {name: record.history.channel(name) for name in record.channels}
    largest = {name: float(np.abs(force).max()) for name, force in forces.items()}
    of_forces = max((size for name, size in largest.items() if name != "M"), default=0.0)
    bad = np.zeros(len(theta), dtype=bool)
    all_zero = np.all([force == 0.0 for force in forces.values()], axis=0)
    steps = dict(zip(record.channels, record.resolution, strict=True))
    first, last = np.array(record.rig.air_deg()) + (AIR_MARGIN_DEG + LATE_DEG) * np.array([1, -1])
    in_soil = np.array([theta[0] > first, theta[-1] < last])
    for name, force in forces.items():
        span, load = float(np.ptp(force)), LOADED * (largest["M"] if name == "M" else of_forces)
        faults = {
            "dropouts": _dropouts(force, all_zero, max(load, 1.01 * steps[name]), in_soil),
            "held values": _held(force, span),
            "spikes": _spikes(force, span, steps[name]),
        }
        for what, found in faults.items():
            if count := int(found.sum()):
                low, high = theta[found][[0, -1]]
                readings = "1 reading" if count == 1 else f"{count} readings"
                place = f"between {low:.1f} and {high:.1f}°" if high > low else f"at {low:.1f}°"
                notes.append(f"{readings} of {name} left out as {what} {place}.")
                bad |= found
    if bad.mean() > MOST_LEFT_OUT:
        raise InputError(
            f"{record.source}: {bad.mean():.0%} of the readings are faulty ({' '.join(notes)}); "
            "check the sensor and record again"
        )
    for name, force in forces.items():
        kept, where = force[~bad], theta[~bad]
        q = steps[name]
        damage += filter(None, (_clipped(name, kept, where, q), _step(name, kept, where, q)))
    return record.without(bad, notes, damage).binned().checked()


def _dropouts(force: FloatArray, all_zero: BoolArray, load: float, in_soil: BoolArray) -> BoolArray:
    """Exact zeros between loaded readings: of this force, or of all.

    Zeros up to an end of the record are dropouts if that end is in the soil; in air zero is right.
    """
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
    changes = np.abs(np.diff(force))
    found = np.zeros(len(force), dtype=bool)
    some = changes[changes > 1e-12 * span]
    quantum = float(some.min()) if some.size else span
    ends = np.flatnonzero(np.append(changes, np.inf) > 0.0)
    for first, last in zip(np.append(-1, ends[:-1]) + 1, ends, strict=True):
        long = last - first + 1 >= HELD and last + 1 < len(force)
        inside = abs(force[first]) > LOADED * span and force.min() < force[first] < force.max()
        if long and inside and changes[last] > JUMP * quantum:
            found[first + 1 : last + 1] = True
    return found


def _spikes(force: FloatArray, span: float, resolution: float) -> BoolArray:
    """Readings far from the median of their neighbours."""
    padded = np.pad(force, 3, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 7)
    apart = np.abs(force - np.median(windows, axis=1))
    usual = max(float(1.4826 * np.median(apart)), 1e-9 * span, resolution / np.sqrt(12.0))
    scale = np.maximum(usual, 0.5 * np.median(np.abs(np.diff(windows, axis=1)), axis=1))
    return np.asarray((apart > SPIKE * scale) & (apart > LARGE_SPIKE * span))


def _clipped(name: str, force: FloatArray, theta: FloatArray, resolution: float) -> str:
    """A sentence if the record is cut off flat at its largest readings.

    A round top has equal readings too, if the sensor is coarse. The slopes on either side of a
    clipped one meet well above it.
    """
    for end in (force.max(), force.min()):
        at = np.flatnonzero(force == end)
        if at.size < CLIPPED or abs(end) < 0.2 * np.ptp(force) or np.any(np.diff(at) > 1):
            continue
        first, last = theta[at[0]], theta[at[-1]]
        rise = (theta >= first - SLOPE_DEG) & (theta <= first)
        fall = (theta >= last) & (theta <= last + SLOPE_DEG)
        if rise.sum() < 3 or fall.sum() < 3:
            continue
        up = abs(np.polyfit(theta[rise], force[rise], 1)[0])
        down = abs(np.polyfit(theta[fall], force[fall], 1)[0])
        hidden = (last - first) * up * down / max(up + down, 1e-12)
        if hidden > HIDDEN * np.ptp(force) + ROUND * resolution:
            return (
                f"{name} is cut off at {end:.3g} N between {first:.0f} and {last:.0f}°: check "
                "whether the sensor saturated."
            )
    return ""


def _step(name: str, force: FloatArray, theta: FloatArray, resolution: float) -> str:
    """A sentence if the force jumps and stays there."""
    if len(force) < 20 or np.median(np.diff(theta)) > STEP_SPACING_DEG:
        return ""
    width = max(3, int(2.0 / np.median(np.diff(theta))))
    if 2 * width >= len(force):
        return ""
    means = np.convolve(force, np.ones(width) / width, "valid")
    jumps = means[width:] - means[:-width]
    sharp = np.abs(np.diff(force))[width - 1 : width - 1 + len(jumps)]
    usual = np.median(np.abs(np.diff(force)))
    at = int(np.argmax(sharp))
    size = float(np.diff(force)[width - 1 + at])
    if (
        abs(size) > STEP * np.ptp(force)
        and abs(jumps[at]) > 0.7 * abs(size)
        and abs(size) > max(20 * usual, 2.0 * resolution)
    ):
        place = theta[width - 1 + at]
        return f"{name} jumps by {size:.2g} N at {place:.0f}°: repair the record or use another."
    return ""


# -- after the fit -------------------------------------------------------------------------------


def in_air(likelihood: Likelihood) -> list[str]:
    """A sentence for each measured force that is not zero where the leg is in the air."""
    found = []
    for record, shift in zip(likelihood.records, likelihood.shift_deg, strict=True):
        first, last = shift + np.array(record.rig.air_deg())
        theta = record.history.theta_deg
        # Soil that the leg carries along may press on it a little where the model has none left.
        for side, air, limit in (
            ("before the leg meets the soil", theta < first, OFFSET),
            ("after it has left the soil", theta > last, 2.0 * OFFSET),
        ):
            for name in record.channels:
                values = record.history.channel(name)
                if air.sum() < 3 or record.simulated:
                    continue
                # Soil that is met early is met more and more; an offset is there all the way.
                size = float(np.quantile(np.abs(values[air]), 0.2))
                size *= float(np.sign(np.median(values[air])))
                if abs(size) > limit * np.ptp(values):
                    found.append(
                        f"{record.source}: {name} is {size:.2g} {CHANNEL_UNITS[name]} "
                        f"{side}; tare the sensor, or check the leg."
                    )
    return found


def warnings(
    likelihood: Likelihood,
    fits: Sequence[RecordFit],
    phi: Estimate,
    verdict: str,
    second: Mapping[str, Any] | None,
) -> Iterator[str]:
    """Sentences on an answer, in the order of their consequence, the gravest first."""
    records, law, air = likelihood.records, likelihood.library, in_air(likelihood)
    # The forces are wrong, whatever the soil.
    yield from (f"{likelihood.prefix(one)}{text}" for one in records for text in one.damage)
    yield from air
    # Leg, columns, sizes or units may be others than stated.
    if not air:
        yield from others(likelihood, misfit=verdict != "consistent")
    apart = 0.0
    if second and law.scenario.convention == "plane_strain":
        apart = abs(second["median"] - phi.median)
    if second and apart > FAR_APART_DEG:
        yield (
            f"Resistive force theory gives {second['median']:.0f}°, farther than for any record "
            "whose leg is known: check the leg and the columns."
        )
    for fit in fits if likelihood.measured else ():
        late = fit.shift_deg - likelihood.errors[fit.rig.leg].shift_deg
        if abs(late) > LARGE_SHIFT_DEG:
            yield (
                f"{fit.source}: the forces come {abs(late):.0f}° "
                f"{'later' if late > 0 else 'earlier'} than those of such a leg usually do; check "
                "the zero of theta and the height of the hip."
            )
    if likelihood.measured and verdict == "consistent":
        yield from _other_hip(likelihood)
    yield from _unusual(likelihood, phi, verdict)
    # The angle or its interval rests on what was not measured.
    if likelihood.disagreement_deg and second:
        yield (
            f"Resistive force theory gives {second['median']:.0f}°, {apart:.0f}° from {law.name} "
            "and outside both intervals: the interval is wider by that."
        )
    if likelihood.calibration is not None:
        yield f"Calibrated with {likelihood.calibration}. The error that each soil has remains."
        yield from likelihood.calibration.warnings()
    yield from guesses(likelihood)
    if law.caveat:
        yield f"Law {law.name}: {law.caveat}"
    # What was done with the readings.
    yield from (f"{likelihood.prefix(one)}{text}" for one in records for text in one.notes)


def _unusual(likelihood: Likelihood, phi: Estimate, verdict: str) -> Iterator[str]:
    """Sentences on an angle that the forces hardly determine, or that few soils have."""
    if likelihood.sd[0] > np.ptp(likelihood.ends) / np.sqrt(12.0):
        yield "The forces carry almost no information on φ: the posterior equals the prior."
    for leg, error in likelihood.errors.items() if verdict == "consistent" else ():
        ends = error.phi_deg if likelihood.measured else None
        if ends and not ends[0] <= phi.median <= ends[1]:
            yield (
                f"φ = {phi.median:.1f}° lies outside {ends[0]:.1f} to {ends[1]:.1f}°, where the "
                f"offset of leg {leg} was learned: its error there is "
                f"{error.offset_sd_at(phi.median):.1f}°."
            )
    low, high = USUAL_DEG
    if likelihood.measured and not low <= phi.median <= high:
        yield (
            f"φ = {phi.median:.0f}° is unusual for dry soil ({low:g} to {high:g}°): check density, "
            "unit of force and leg."
        )


def guesses(likelihood: Likelihood) -> Iterator[str]:
    """Sentences on what an answer takes for granted of its records."""
    for i, record in enumerate(likelihood.records):
        density, part = likelihood.density[i], likelihood.coverage[i]
        name = likelihood.prefix(record)
        spacing = float(np.median(np.diff(record.history.theta_deg)))
        if spacing > 2.0 * WINDOW_DEG / (OBSERVATION_ANGLES - 1):
            yield f"{name}The readings are {spacing:.0f}° apart; peaks between them are missed."
        known = "hip height" in likelihood.terms
        if likelihood.measured and record.rig.hip_height_sd_mm > 0.0 and not known:
            yield (
                f"{name}The ± {record.rig.hip_height_sd_mm:g} mm of the hip's height are not in "
                f"this interval: law {likelihood.library.name} does not have their effect."
            )
        if part.share < NEARLY_ALL and likelihood.measured:
            ends = np.clip(record.history.theta_deg[[0, -1]], -WINDOW_DEG, WINDOW_DEG)
            low, high = ends.round() + 0.0
            yield (
                f"{name}The record covers {low:.0f} to {high:.0f}° of ±{WINDOW_DEG:g}°, with "
                f"{part.share:.0%} of the information on φ of a whole stroke."
            )
        if record.grain_size_mm and not likelihood.of_size_deg(record):
            yield f"{name}Law {likelihood.library.name} does not know what large grains add."
        grown = likelihood.of_size_deg(record)
        if abs(grown) > 0.05:
            yield (
                f"{name}For grains of {record.grain_size_mm:g} mm, the angle that this leg reads "
                f"is corrected by {-grown:+.1f}°."
            )
        per_mm = likelihood.of_size_deg(replace(record, grain_size_mm=1.0))
        if not record.grain_size_mm and per_mm > OF_SIZE_DEG:
            yield (
                f"{name}The grains are taken as fine: each mm of their diameter adds "
                f"{per_mm:.1f}° on this leg; give --grain-size."
            )
        cohesive = any(law.most_cohesion for law in likelihood.laws)
        if record.simulated and record.scenario is None and cohesive:
            yield f"{name}Simulated without a scenario: the soil is taken as dry."
        if i == 0 and (sentence := _moisture(likelihood)):
            yield sentence
        doubts = density_doubts(density) if likelihood.measured else []
        if (
            doubts
            and record.measurement
            and measurement(record.measurement).density_kg_m3 == density
        ):
            doubts = []  # the seeds of Li et al. are light
        yield from (f"{name}{doubt}" for doubt in doubts)
        if record.density_kg_m3 is None or record.density_assumed:
            yield (
                f"{name}The density {density:g} kg/m³ is assumed; an error of 10 % moves φ by "
                "about 1°."
            )


def densities(density: FloatArray, sd: FloatArray) -> list[str]:
    """A sentence if records of one soil have different densities [kg/m³], shape [record] each."""
    if np.ptp(density) <= UNUSUAL * sd.max():
        return []
    ends = f"from {density.min():g} to {density.max():g} kg/m³"
    return [
        f"The records have densities {ends}, and are inverted as one soil: check that they are."
    ]


def others(likelihood: Likelihood, *, misfit: bool) -> Iterator[str]:
    """Sentences on legs, columns, sizes and units that may be others than stated.

    Parameters
    ----------
    likelihood
        Of the records.
    misfit
        Whether the model describes them badly; only then other readings of them are proposed.
    """
    density = np.array(likelihood.density)
    yield from densities(density, likelihood.density_sd * density)
    for i, record in enumerate(likelihood.records):
        name = likelihood.prefix(record)
        if record.scenario is not None:
            apart = differences(record.scenario, likelihood.library.scenario)
            known = set() if isinstance(likelihood.library, Library) else VARIED
            apart = [key for key in apart if key not in known]
            if apart:
                listed = ", ".join(apart[:3]) + (", …" if len(apart) > 3 else "")
                yield (
                    f"{name}The simulation differs from law {likelihood.library.name} in "
                    f"{listed}: the angle may be off."
                )
        else:
            found = list(_other_readings(likelihood, record)) if misfit else []
            for sentence in found or [*_other_arm(likelihood, i), *_other_size(likelihood, i)]:
                yield f"{name}{sentence}"


class Reading(NamedTuple):
    """A record read otherwise."""

    option: str
    """What does it, such as ``--columns fx_sign=-1``."""
    residual: float
    fits: float
    """Residual below which it fits [-]."""
    proposed: float
    """Residual below which it is proposed where it fits best [-]."""
    form: str = "The record would fit with {}: check the columns."
    changes: int = 1
    """Number of things that are read otherwise."""


def _other_readings(likelihood: Likelihood, record: Record) -> Iterator[str]:
    """The only column, unit, scale or leg by which a misfit would be described much better."""
    if record.channels != FORCES or record.damage:
        return
    given = residual(record.data, record, likelihood, record.leg, likelihood.cohesion)
    readings = [*_columns_otherwise(likelihood, record, given)]
    most = min(BETTER * given, FITS * likelihood.errors[record.leg].nrmsd_limit)
    for leg in likelihood.library.legs:
        if leg != record.leg:
            size = residual(record.data, record, likelihood, leg)
            form = "The record would fit with {}: check the leg."
            readings.append(Reading(f"--leg {leg}", size, most, most, form))
    fitting = sorted((r for r in readings if r.residual < r.fits), key=lambda r: r.residual)
    # Two signs at once only where no single reading fits nearly as well.
    near = [r for r in fitting if r.residual < ALONE * fitting[0].residual]
    fitting = [r for r in near if r.changes == 1] or near
    if not fitting or fitting[0].residual >= fitting[0].proposed:
        return
    fitting = [r for r in fitting if r.residual < r.proposed]
    legs = [r for r in fitting if r.option.startswith("--leg")]
    if len(legs) == len(fitting) > 1:
        agreeing = [r for r in legs if _opinions_agree(likelihood, record, r.option[6:])]
        fitting = agreeing if len(agreeing) == 1 else fitting
    if len(fitting) == 1:
        yield fitting[0].form.format(fitting[0].option)
    else:
        listed = " or ".join(r.option.replace("--columns ", "").replace("--", "") for r in fitting)
        yield f"The record would fit with either {listed}: check which is right."


def _opinions_agree(likelihood: Likelihood, record: Record, leg: str) -> bool:
    """Whether other physics gives much the same angle of a record by another leg."""
    other = Likelihood([replace(record, rig=Rig.of(record.rig, leg))], likelihood.library)
    opinion = second_opinion(other)
    apart = np.inf if opinion is None else opinion["median"] - other.least_squares[0]
    return bool(abs(apart) <= FAR_APART_DEG)


def _columns_otherwise(
    likelihood: Likelihood, record: Record, residual_as_given: float
) -> Iterator[Reading]:
    """A record of both forces with other signs, axes, units, and angles of load cell and leg."""
    try:
        law, force = _usual_forces(likelihood, record, record.leg, usual=True)
    except InputError:
        return
    limit, history = likelihood.errors[record.leg].nrmsd_limit, record.history
    read_as = history.provenance.get("columns", {})  # an option that was given is turned back
    cell_deg = read_as.get("sensor_angle_deg", 0.0)
    theta, fx, fz = (f"{n}_sign={-read_as.get(f'{n}_sign', 1)}" for n in ("theta", "fx", "fz"))
    on = "force_on=" + ("leg" if read_as.get("force_on") == "soil" else "soil")
    cell = sensor_turn(cell_deg)
    back, forth, swap = np.diag([-1.0, 1.0]), np.diag([1.0, -1.0]), np.eye(2)[::-1]
    signs = {fx: cell @ back @ cell.T, fz: cell @ forth @ cell.T, on: -np.eye(2)}
    axes = signs | {"fx=FZ_COLUMN,fz=FX_COLUMN": cell @ swap @ cell.T}

    def sizes(other: Record, changes: Iterable[FloatArray]) -> list[float]:
        data = np.stack([change @ other.data for change in changes])
        return residuals(data, other, law, force, likelihood.measured).tolist()

    most = min(MUCH_BETTER * residual_as_given, FITS * limit)
    turned = replace(history, position=-history.position[::-1], force=history.force[::-1],
                     moment=None)  # fmt: skip
    turned_signs = {"": np.eye(2)} | signs
    for option, size in zip(axes, sizes(record, axes.values()), strict=True):
        yield Reading(f"--columns {option}", size, most, most)
    each = zip(turned_signs, sizes(replace(record, history=turned), turned_signs.values()),
               strict=True)  # fmt: skip
    for option, size in each:
        changed = f"--columns {option and option + ','}{theta}"
        yield Reading(changed, size, most, most, changes=2 if option else 1)

    read_in = history.provenance.get("force_unit", "N")
    units = {u: FORCE[u] / FORCE[read_in] * np.eye(2) for u in UNITS if u != read_in}
    loose = min(BETTER * residual_as_given, FITS * limit)
    form = "The record would fit with {}: check the columns, and the length of the leg."
    for unit, size in zip(units, sizes(record, units.values()), strict=True):
        yield Reading(f"--columns unit={unit}", size, loose, loose, form)

    turns = sizes(record, map(sensor_turn, TURNS_DEG))
    turn_deg, size = TURNS_DEG[int(np.argmin(turns))], min(turns)
    angle = (cell_deg + turn_deg + 180.0) % 360.0 - 180.0
    form = (f"A load cell turned by about {angle:.0f}° would fit: check how it is mounted "
            "({}).")  # fmt: skip
    option, well = f"--columns sensor_angle_deg={angle:.0f}", min(most, FITS_TURNED * limit)
    yield Reading(option, size, loose, well, form)

    scaled = {}
    for scale in SCALES.tolist():
        other = replace(record, history=replace(history, position=scale * history.position))
        with suppress(InputError):  # too short a part of the stroke
            [scaled[scale]] = sizes(other, [np.eye(2)])
    scale = min(scaled, key=lambda one: scaled[one], default=1.0)
    key = "rate_deg_s" if "rate_deg_s" in read_as else "theta_scale"
    form = f"An angle about {scale:g} times as large would fit: check its unit and zero ({{}})."
    option = f"--columns {key}={read_as.get(key, 1.0) * scale:.3g}"
    if offset_deg := read_as.get("theta_offset_deg"):
        option += f",theta_offset_deg={offset_deg * scale:.3g}"
    yield Reading(option, scaled.get(scale, np.inf), loose, min(most, FITS_SCALED * limit), form)


def _other_arm(likelihood: Likelihood, i: int) -> Iterator[str]:
    """A sentence if the moment about the hip is not that of the forces, with the model's arms."""
    record, law = likelihood.records[i], likelihood.laws[i]
    if record.channels != FORCES or record.history.moment is None or law.arm is None:
        return
    theta_deg = law.theta_deg + likelihood.shift_deg[i]
    arm = np.stack([np.interp(record.theta_deg, theta_deg, row) for row in law.arm])
    of_forces = (arm * record.data).sum(axis=0)
    factor = float(of_forces @ record.means(record.history.moment) / (of_forces @ of_forces))
    if abs(np.log(max(factor, 1e-3))) > np.log(OTHER_ARM):
        # Forces in another unit than they are read in, beside a moment in N m.
        of_unit = [
            f"; forces in {unit} would make it equal (--columns unit={unit})"
            for unit in ("lbf", "kgf")
            if abs(np.log(max(factor, 1e-3) / FORCE[unit])) < np.log(OTHER_ARM)
        ]
        yield (
            f"The moment is {factor:.2g} times that of the forces about the hip: check the length "
            "of the leg, the units, and about which axis the moment is"
            f"{''.join(of_unit)}."
        )


def _other_size(likelihood: Likelihood, i: int) -> Iterator[str]:
    """A sentence if contact begins elsewhere than in the model, as of a leg of another length."""
    record, part = likelihood.records[i], likelihood.parts[i]
    curve = likelihood.curves(likelihood.inside[None])[0, part].reshape(len(record.channels), -1)
    begins = []
    for force in (record.data, curve):
        size = np.linalg.norm(force / np.ptp(force), axis=0)
        begins.append(int(np.argmax(size > ONSET * size.max())))
    theta = record.theta_deg[begins]
    theta[1] -= likelihood.shift_deg[i]
    if min(begins) > 0 and abs(theta[0] - theta[1]) > LATE_DEG:
        yield (
            f"Contact begins at {theta[0]:.0f}°, in the model at {theta[1]:.0f}°: check the length "
            "of the leg and the height of its hip."
        )


def _other_hip(likelihood: Likelihood) -> Iterator[str]:
    """A sentence for each record that a hip of another height describes better."""
    for i, record in enumerate(likelihood.records):
        higher, sd, size = likelihood.hip_error(i) or (0.0, 0.0, 1.0)
        limit = max(HIP_MM, HIP_SURE * sd, UNUSUAL * record.rig.hip_height_sd_mm)
        if size < HIP_RESIDUAL and abs(higher) > limit:
            yield (
                f"{likelihood.prefix(record)}A hip {abs(higher):.0f} ± {sd:.0f} mm "
                f"{'higher' if higher > 0 else 'lower'} than given would fit the forces: check "
                "the height of the hip and the length of the leg."
            )


def second_opinion(likelihood: Likelihood) -> dict[str, Any] | None:
    """Angle of measured forces by resistive force theory, as one of plane strain."""
    if not likelihood.measured or isinstance(likelihood.library, Theory):
        return None
    try:
        other = Likelihood(likelihood.records, Theory())
    except InputError:
        return None  # it does not cover the angles of the record
    read = float(other.least_squares[0])
    if not other.low[0] <= read <= min(other.high[0], 43.0):
        return None  # beyond its library, or nearly without an equivalent in plane strain
    below, median, above = to_plane_strain(read + np.array([-1.0, 0.0, 1.0])).tolist()
    sd = float(other.sd[0])
    # φ at which forces are as large, whatever their shape.
    phi = np.linspace(likelihood.low[0], likelihood.high[0], 71)
    size = np.square(likelihood.curves(phi[:, None]) / likelihood.span).sum(axis=1)
    measured = float(np.square(likelihood.data / likelihood.span).sum())
    of_size = float(np.interp(measured, np.maximum.accumulate(size), phi))
    sd *= (above - below) / 2.0
    return {"law": Theory.name, "median": median, "sd": sd, "force_size_deg": of_size}


def _moisture(likelihood: Likelihood) -> str:
    """A sentence if the soil has a cohesion, or if it is not known and would matter."""
    cohesion, sd = likelihood.cohesion, likelihood.cohesion_sd
    if sd and cohesion > max(MOIST_PA, KNOWN * sd):
        check = "; else check the density and the unit of force" * (cohesion > COHESIVE_PA)
        return (
            f"The forces show a cohesion of {cohesion:.0f} ± {sd:.0f} Pa: damp soil has one, and "
            f"grains that are large compared with the leg act like one{check}."
        )
    if likelihood.budget().get("cohesion", 0.0) > MOIST_DEG:
        return (
            "These forces hardly tell a cohesion from friction: if the soil is damp, or its grains "
            "are large compared with the leg, its angle may be smaller."
        )
    return ""


def residual(
    data: FloatArray, record: Record, likelihood: Likelihood, leg: str, cohesion: float = 0.0
) -> float:
    """Smallest residual of data over the law's angles [-], of peak-to-peak, at a cohesion [Pa].

    Infinite for a leg that the law does not know in these sizes.
    """
    try:
        law, force = _usual_forces(likelihood, record, leg, cohesion)
    except InputError:
        return np.inf
    return float(residuals(data[None], record, law, force, likelihood.measured)[0])


def _usual_forces(
    likelihood: Likelihood, record: Record, leg: str, cohesion: float = 0.0, *, usual: bool = False
) -> tuple[LegLaw, FloatArray]:
    """Law of a leg in the sizes of a record's, and its forces over φ [N], [k, 2, theta].

    At a cohesion [Pa]; of usual soils alone, if asked. Raises InputError if the law does not know
    the leg in these sizes.
    """
    rig = Rig.of(record.rig, leg)
    law = law_of(likelihood.library, rig, record.scenario, strict=False)
    density = record.density_kg_m3 or law.density
    number = cohesion / (density * GRAVITY * rig.length)
    low, high = law.bounds[0][0], law.bounds[1][0]
    if usual:
        ends = np.array(USUAL_DEG)
        low, high = np.clip(ends + likelihood.offset(record, ends), low, high)
    return law, density / law.density * law(np.linspace(low, high, 65)[:, None], number)


def residuals(
    data: FloatArray, record: Record, law: LegLaw, force: FloatArray, measured: bool
) -> FloatArray:
    """Smallest residual of window means over forces and shifts, of peak-to-peak [-].

    Shapes: data [h, c, m], forces [k, 2, theta]; [h].
    """
    shifts = np.arange(-SHIFT_DEG, SHIFT_DEG + 1.0, 3.0) if measured else np.zeros(1)
    squares = squared_residuals(record, data, force, law, shifts)
    return np.asarray(np.sqrt(squares.min(axis=(1, 2)) / data[0].size))
