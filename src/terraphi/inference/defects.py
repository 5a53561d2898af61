"""What a damaged sensor leaves in a record: looked for before an angle is inferred from it.

Each defect is one that no leg in soil makes. What hides a few readings (dropouts, held values,
spikes, a short clipped top) is left out, and the library is then read at the readings that are
left. What hides too much is refused. What shifts many readings (a step, an offset in air) is left
in, for nobody knows which of them are right, and makes any answer a misfit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import WIDEST_GAP_DEG, WINDOW_DEG, ForceHistory
from terraphi.inference.findings import Doubt
from terraphi.inference.first_contact import Contact
from terraphi.inference.noise import resolution_of
from terraphi.library.store import Library

Mask = NDArray[np.bool_]

NEAR = 5
"""Readings to either side that a reading is compared with."""
LOADED = 0.05
"""Force over the largest above which a reading of exactly zero is a dropout [-]."""
ANY_LOAD = 0.003
"""The same where both forces are exactly zero: one may pass zero, hardly both at once [-]."""
NOTHING = (0.01, 0.2)
"""Force that is nearly nothing, and one about it that is a large one, over the largest [-]."""
FEWEST_HELD = 3
"""Equal readings in a row that may be a held value."""
QUANTA = 5.0
"""Steps of the record's resolution that a value must change by after it was held [-]."""
FINELY = 100.0
"""Steps of the record's resolution in a value that is held to the record's end [-]."""
BY_CHANCE = 1e-3
"""Runs of equal readings that a coarse record may have by chance."""
SPIKE = (8.0, 1.0)
"""Deviation from the running median that is a spike: of its usual size, and of the median's range
[-]."""
STEP, TIMES_ROUGH, STEP_DEG = 0.2, 3.0, 3.0
"""Jump between two readings that is a step: of peak-to-peak and of the range of the readings to
either side [-], over that much of the path [deg]."""
FLAT = 0.02
"""Rise, of peak-to-peak, that a clipped top must hide for it to be told from a rounded one [-]."""
STEP_SPACING_DEG = 0.1
"""Spacing of the readings that are looked at for steps, where there are more [deg]."""
COARSE_DEG = 2.0
"""Spacing of readings above which no steps are looked for [deg]."""
FINE, CRESTS_DEG = 5e-4, 3.0
"""Resolution, of peak-to-peak [-], below which three equal largest readings that far apart [deg]
are clipped crests: a round top of a coarser record has as many."""
WORTH_DEG = 5.0
"""Path next to a flat top from which its slope is taken [deg]."""
OFFSET, SURE = 0.02, 4.0
"""Median force in air above which the zero is off: of peak-to-peak, and in standard errors [-]. The
shipped measurements have up to 0.013."""
IN_AIR, MARGIN_DEG = 0.005, 5.0
"""Force over the largest below which a simulated leg counts as in air [-], and how much further
from the soil a measured one has to be [deg]."""
MOST_LEFT_OUT = 0.5
"""Share of readings that may be left out [-]."""
BRIEFLY = {
    "dropout": "dropouts",
    "held": "held values",
    "spike": "spikes",
    "clipped": "a clipped top",
}
"""Kinds of defects that are left out, in a word or two."""


@dataclass(frozen=True)
class Defect:
    """Readings that are not to be believed.

    Attributes
    ----------
    code
        A key of `words.DEFECTS`.
    force
        ``"Fx"``, ``"Fz"`` or ``"both"``.
    rows
        How many readings.
    theta_deg
        First and last leg angle [deg].
    size_N
        Of a step or an offset [N].
    """

    code: str
    force: str
    rows: int
    theta_deg: tuple[float, float]
    size_N: float | None = None

    @property
    def left_out(self) -> bool:
        """Whether its readings are left out."""
        return self.size_N is None

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and words."""
        treatment = "left out" if self.left_out else "kept"
        return {**vars(self), "theta_deg": list(self.theta_deg), "treatment": treatment}

    def doubt(self, source: str = "") -> Doubt:
        """Why an answer from the rest may not be what was asked for, of a history by its name."""
        return Doubt(self.code, {k: v for k, v in vars(self).items() if k != "code"}, source)


@dataclass(frozen=True, eq=False)
class Inspection:
    """A record without the readings that are not to be believed.

    Attributes
    ----------
    history
        What is left.
    rows
        Readings within the window before.
    defects
        What was left out, and why.
    zero_N
        How far the zeros of Fx and Fz may be off by what was read in air [N]: a standard error of
        the median, or the median if it is three of them; ``None`` if next to nothing was read.
    left_out_deg
        Leg angles of the readings that were left out [deg], shape [sample].
    contact
        Where the leg first meets the soil, of a measured record if it tells.
    """

    history: ForceHistory
    rows: int
    defects: tuple[Defect, ...] = ()
    zero_N: tuple[float, float] | None = None
    left_out_deg: FloatArray = field(default_factory=lambda: np.empty(0))
    contact: Contact | None = None

    def as_dict(self) -> dict[str, Any]:
        """The ``data`` part of an answer."""
        return {
            "rows": self.rows,
            "left_out": sum(d.rows for d in self.defects if d.left_out),
            "defects": [d.as_dict() for d in self.defects],
            **({"first_contact": self.contact.as_dict()} if self.contact else {}),
        }

    @property
    def spoilt(self) -> bool:
        """Whether any answer is a misfit: readings are wrong, and nobody knows which."""
        return not all(d.left_out for d in self.defects)


def inspect_record(
    history: ForceHistory, *, touches_deg: tuple[float, float] | None = None
) -> Inspection:
    """Look for what a damaged sensor leaves, and leave it out.

    Parameters
    ----------
    history
        Forces over the leg angle.
    touches_deg
        Leg angles between which the leg may touch the soil [deg]; what is read beyond them is read
        in air. ``None``: not known.

    Raises
    ------
    InputError
        If too little would be left of the record.
    """
    inside = np.abs(history.theta_deg) <= WINDOW_DEG
    theta, force = history.theta_deg[inside], np.stack([history.Fx, history.Fz], axis=1)[inside]
    if len(theta) < 4 * NEAR or not np.ptp(force, axis=0).all():
        return Inspection(history, len(theta))
    bad = np.zeros(len(theta), dtype=bool)
    defects = []
    for code, name, found in _found(theta, force):
        fresh = found & ~bad
        if fresh.any():
            bad |= found
            where = theta[fresh]
            defects.append(Defect(code, name, int(fresh.sum()), (where[0], where[-1])))
    _refuse_what_is_lost(theta, bad, defects)
    defects += _steps(theta[~bad], force[~bad])
    zero = None
    if touches_deg is not None:
        offsets, zero = _offsets(history, np.ptp(force[~bad], axis=0), touches_deg)
        defects += offsets
    if not bad.any():
        return Inspection(history, len(theta), tuple(defects), zero)
    kept = np.ones(len(history.position), dtype=bool)
    kept[np.flatnonzero(inside)[bad]] = False
    left = replace(history, position=history.position[kept], force=history.force[kept])
    return Inspection(left, len(theta), tuple(defects), zero, theta[bad])


def touches_soil_deg(library: Library, leg: str) -> tuple[float, float] | None:
    """Leg angles between which a leg may touch the soil [deg], by a library's own curves.

    Infinite on a side where a simulation ends before its leg is out of the soil; ``None`` for a leg
    that the library does not have.

    Parameters
    ----------
    library
        Simulations of that leg.
    leg
        Its shape.
    """
    low, high = np.inf, -np.inf
    for case in library.cases:
        if case.history is not None and case.scenario.leg.shape == leg:
            size = np.hypot(case.history.Fx, case.history.Fz)
            theta = case.history.theta_deg
            loaded = theta[size > IN_AIR * size.max()]
            first, last = loaded[0] - theta[0] < MARGIN_DEG, theta[-1] - loaded[-1] < MARGIN_DEG
            low = min(low, -np.inf if first else loaded[0])
            high = max(high, np.inf if last else loaded[-1])
    return None if high < low else (float(low) - MARGIN_DEG, float(high) + MARGIN_DEG)


def _found(theta: FloatArray, force: FloatArray) -> list[tuple[str, str, Mask]]:
    """Code, force and readings of each kind of defect that there may be."""
    both = (force == 0.0).all(axis=1)
    size = np.hypot(*force.T)
    loaded = _loaded(size, both, share=ANY_LOAD, resolution=max(map(resolution_of, force.T)))
    every = [("dropout", "both", (both & loaded) | _sudden_nothing(size))]
    for name, values in zip(("Fx", "Fz"), force.T, strict=True):
        zero = (values == 0.0) & ~both
        loaded = _loaded(values, zero | both, resolution=resolution_of(values))
        every.append(("dropout", name, zero & loaded))
    for name, values in zip(("Fx", "Fz"), force.T, strict=True):
        known = ~every[0][2] & (values != 0.0)
        every += [
            ("clipped", name, _flat_top(theta, values, known)),
            ("held", name, _held(values)),
            ("spike", name, _spikes(values, known)),
        ]
    return every


def _sudden_nothing(size: FloatArray) -> Mask:
    """Readings of nearly nothing amid a large force: dropouts of a sensor that is not quite tared.

    Parameters
    ----------
    size
        Of the force [N], shape [sample].
    """
    nothing, lots = (share * size.max() for share in NOTHING)
    where = np.flatnonzero(size > nothing)
    if where.size < 2 * NEAR:
        return np.zeros(len(size), dtype=bool)
    after = np.searchsorted(where, np.arange(len(size)))
    padded = np.concatenate([np.zeros(NEAR), size[where], np.zeros(NEAR)])
    about = padded[after[:, None] + np.arange(2 * NEAR)].reshape(len(size), 2, NEAR)
    return (size <= nothing) & (np.median(about, axis=2).min(axis=1) > lots)


def _loaded(values: FloatArray, zero: Mask, *, resolution: float, share: float = LOADED) -> Mask:
    """Where the nearest readings to either side that are not zero show a load, and the same one.

    A leg that enters the soil comes from zeros, and a force that changes its sign passes zero.
    """
    where = np.flatnonzero(~zero)
    after = np.searchsorted(where, np.arange(len(values)))
    padded = np.concatenate([[0.0], values[where], [0.0]])
    before, behind = padded[after], padded[after + 1]
    least = np.minimum(np.abs(before), np.abs(behind))
    load = max(share * np.abs(values).max(), QUANTA * resolution)
    return (before * behind > 0.0) & (least > load)


def _held(values: FloatArray) -> Mask:
    """Repetitions of a loaded value that then jumps, or to an end of the record.

    Where the record resolves far smaller changes.
    """
    steps = np.abs(np.diff(values))
    changes, resolution = steps[steps > 0.0], resolution_of(values)
    if not changes.size:
        return np.zeros(len(values), dtype=bool)
    # A coarse record repeats itself by chance: runs count if so long a one hardly comes about.
    repeats = resolution / (resolution + 2.0 * float(np.median(changes)))
    shortest = 1.0 + np.log(len(values) / BY_CHANCE) / -np.log(repeats)
    starts = np.flatnonzero(np.append(True, steps > 0.0))
    ends = np.append(starts[1:], len(values))
    held = np.zeros(len(values), dtype=bool)
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        if end - start < max(FEWEST_HELD, shortest):
            continue
        # What hardly is a load, and does not change, may be that of a leg in air; so may what both
        # ends of a record show. At its end no jump tells a held value from a round top.
        load = abs(values[start])
        if start == 0:
            load = min(load, abs(values[start] - values[-1]))
        if end == len(values):
            load = min(load, abs(values[start] - values[0]))
            told = load > FINELY * resolution
        else:
            told = steps[end - 1] > QUANTA * resolution
        if load > LOADED * np.ptp(values) and told:
            held[start + 1 : end] = True
    return held


def _spikes(values: FloatArray, known: Mask) -> Mask:
    """Single readings far from all about them."""
    where = np.flatnonzero(known)
    found = np.zeros(len(values), dtype=bool)
    if where.size < 4 * NEAR:
        return found
    windows = np.lib.stride_tricks.sliding_window_view(values[where], 2 * NEAR + 1)
    middle = values[where][NEAR:-NEAR]
    medians = np.median(windows, axis=1)
    apart = np.abs(middle - medians)
    # Of a rough stretch all readings lie apart.
    usual = np.median(np.abs(windows - medians[:, None]), axis=1)
    times, share = SPIKE
    spike = (apart > times * usual) & (apart > share * np.ptp(medians))
    found[where[NEAR:-NEAR][spike]] = True
    return found


def _flat_top(theta: FloatArray, values: FloatArray, known: Mask) -> Mask:
    """The stretch over which a force stays at its very largest, or least, and should not."""
    found = np.zeros(len(values), dtype=bool)
    span, resolution = float(np.ptp(values)), resolution_of(values)
    for sign in (1.0, -1.0) if known.any() else ():
        top = sign * values
        at = np.flatnonzero(known & (top >= top[known].max() - 1e-9 * span))
        if at.size < FEWEST_HELD or top[at[0]] < 0.25 * span:
            continue
        first, last = int(at[0]), int(at[-1])
        if resolution < FINE * span and theta[last] - theta[first] > CRESTS_DEG:
            # So finely resolved, readings of a rough record do not meet at the top by chance.
            found[first : last + 1] = True
            continue
        if at.size < 0.5 * known[first : last + 1].sum():
            continue
        before = (theta >= theta[first] - WORTH_DEG) & (theta < theta[first])
        behind = (theta > theta[last]) & (theta <= theta[last] + WORTH_DEG)
        slopes = _slope(theta, top, known & before), -_slope(theta, top, known & behind)
        # Were the force to go on rising from either side, and fall off halfway.
        hidden = 0.25 * (theta[last] - theta[first]) * float(np.mean(slopes))
        if min(slopes) > 0.0 and hidden > max(FLAT * span, QUANTA * resolution):
            found[first : last + 1] = True
    return found


def _slope(theta: FloatArray, values: FloatArray, which: Mask) -> float:
    """Slope of a straight line through some readings [N/deg]; 0 if they are too few."""
    if which.sum() < 2:
        return 0.0
    return float(np.polyfit(theta[which], values[which], 1)[0])


def _refuse_what_is_lost(theta: FloatArray, bad: Mask, defects: list[Defect]) -> None:
    """Refuse a record of which too little is left."""
    if not bad.any():
        return
    held = sum(d.rows for d in defects if d.code == "held")
    # A slow sensor in a fast log holds every value; what it has read is as good as ever.
    if bad.sum() - held > MOST_LEFT_OUT * (len(bad) - held):
        raise InputError(
            f"{bad.mean():.0%} of the readings are damaged ({_named(defects)}); mend the record"
        )
    ends = np.concatenate([[-WINDOW_DEG], theta[~bad], [WINDOW_DEG]])
    gaps = np.diff(ends)
    widest = int(gaps.argmax())
    if gaps[widest] > WIDEST_GAP_DEG:
        low, high = ends[widest], ends[widest + 1]
        within = [d for d in defects if d.theta_deg[0] < high and d.theta_deg[1] > low]
        if not within:  # nothing was left out there: the record has no such angles
            return
        remedy = "a wider range" if any(d.code == "clipped" for d in within) else "a sound sensor"
        raise InputError(
            f"no undamaged reading between {low:.1f} and {high:.1f}° ({_named(within)}); measure "
            f"again with {remedy}: gaps of at most {WIDEST_GAP_DEG:g}° are accepted"
        )


def _named(defects: list[Defect]) -> str:
    """Kinds of defects in a few words."""
    forces = {d.code: "Fx and Fz" for d in defects}
    for code in forces:
        named = {d.force for d in defects if d.code == code}
        if len(named) == 1 and "both" not in named:
            forces[code] = named.pop()
    return ", ".join(f"{BRIEFLY[code]} of {force}" for code, force in forces.items())


def _steps(theta_deg: FloatArray, force: FloatArray) -> list[Defect]:
    """Where the zero of a force moved in the middle of the stroke."""
    found = []
    for name, whole in zip(("Fx", "Fz"), force.T, strict=True):
        # A million readings show a step no better than a few thousand.
        every = max(1, int(STEP_SPACING_DEG / float(np.median(np.diff(theta_deg)))))
        theta, values = theta_deg[::every], whole[::every]
        spacing = float(np.median(np.diff(theta)))
        near = max(NEAR, round(STEP_DEG / spacing))
        # Of a record that is read every few degrees, all forces are steps.
        if len(values) < 4 * near or spacing > COARSE_DEG:
            continue
        windows = np.lib.stride_tricks.sliding_window_view(values, 2 * near)
        before, after = windows[:, :near], windows[:, near:]
        jump = np.abs(np.median(after, axis=1) - np.median(before, axis=1))
        rough = np.maximum(np.ptp(before, axis=1), np.ptp(after, axis=1))
        rough = np.maximum(rough, 2.0 * QUANTA * resolution_of(values) / TIMES_ROUGH)
        step = (jump > STEP * np.ptp(values)) & (jump > TIMES_ROUGH * rough)
        # A leg that meets or leaves the soil jumps as well, from or to nothing.
        low = np.minimum(np.abs(before).max(axis=1), np.abs(after).max(axis=1))
        step &= low > LOADED * np.ptp(values)
        # So does a force across a gap.
        path = theta[2 * near - 1 :] - theta[: len(theta) - 2 * near + 1]
        step &= path < 1.5 * np.median(path)
        if step.any():
            at = int(np.argmax(jump * step)) + near
            where = (float(theta[at - 1]), float(theta[at]))
            rows = len(whole) - at * every
            found.append(Defect("step", name, rows, where, float(jump[at - near])))
    return found


def _offsets(
    history: ForceHistory, span: FloatArray, touches_deg: tuple[float, float]
) -> tuple[list[Defect], tuple[float, float] | None]:
    """Where a force is not zero although the leg is in air, and what is read there."""
    theta, found = history.theta_deg, []
    force = np.stack([history.Fx, history.Fz], axis=1)
    for air in (theta < touches_deg[0], theta > touches_deg[1]):
        if air.sum() < NEAR:
            continue
        mean, error = _median(force[air])  # a hip a little low meets the soil before
        # More than the noise of so many readings makes of none.
        least = np.maximum(OFFSET * span, SURE * error)
        # A count more or less may be all that a coarse sensor tells.
        least = np.maximum(least, 1.5 * np.array([resolution_of(one) for one in force.T]))
        for axis in np.flatnonzero(np.abs(mean) > least):
            where = (float(theta[air][0]), float(theta[air][-1]))
            name, rows = ("Fx", "Fz")[int(axis)], int(air.sum())
            found.append(Defect("offset", name, rows, where, float(mean[axis])))
    beyond = (theta < touches_deg[0]) | (theta > touches_deg[1])
    if beyond.sum() < NEAR:
        return found, None
    mean, error = _median(force[beyond])
    fx, fz = np.where(np.abs(mean) > 3.0 * error, np.abs(mean), error).tolist()
    return found, (fx, fz)


def _median(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Median of each column of normal values and its standard error."""
    median: FloatArray = np.median(values, axis=0)
    spread = 1.4826 * np.median(np.abs(values - median), axis=0)
    return median, 1.2533 * spread / math.sqrt(len(values))
