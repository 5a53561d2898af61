"""Forces on a leg from a table as people have it: columns, units, signs, strokes.

Columns are guessed from their names where they are not given, and each guess leaves a note. What is
wrong with a table is reported all at once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, Generic, Literal, NoReturn, Self, TypeVar

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from terraphi.experiment.arrays import FloatArray, IntArray, block_means
from terraphi.experiment.baseline import at_rest, without_baseline
from terraphi.experiment.documents import Strict, parse_toml, refuse, strictly, value_of
from terraphi.experiment.errors import GUESSED, NO_UNIT, InputError, nearest
from terraphi.experiment.history import ForceHistory, resolution
from terraphi.experiment.tables import CSV_COLUMNS, Table, origin, read_table, table_of
from terraphi.experiment.units import KINDS, unit_named

LOST, FAR_OUTSIDE = (999.0, 999.9, 9999.0, 9999.9, 99999.0), 2.0
"""Sizes that stand for no reading in some loggers where they repeat, and how far beyond all others
they then are [-], chosen."""
TURN_DEG = 10.0
"""Least way back of the leg that ends a stroke [deg]; less is jitter of the encoder."""
LEAST_STROKE_DEG = 38.0
"""Shortest stroke that counts [deg]."""
FEWEST_ROWS = 8
"""Rows up to which a stroke does not count."""
BIN_DEG = 0.25
"""Width of the bins that rows are averaged in, if the angle does not grow from row to row [deg]."""
SCATTERED_DEG = 5.0
"""Usual step of the angle from row to row above which the rows have no order [deg]."""
HEAVIER = 1.3
"""Ratio of forces on the way back to those forth at which the leg moves the other way [-]."""
LEAST_DEG = 7.0
"""Largest angle of a record below which its angles must be radians [deg]."""
HEAVIEST_DEG = (-60.0, 35.0)
"""Where half of the squared force has passed [deg]: -43 to 8 in the shipped measurements."""
CHANGED = (
    *("theta_sign", "theta_offset_deg", "fx_sign", "fz_sign", "sensor_angle_deg"),
    *("sensor_turns", "force_on"),
)
"""Options that change numbers, but for those of units."""
IN_SOIL, BETWEEN_DEG = 0.3, 20.0
"""Force over its largest from which on a leg is in soil [-], and least distance between contacts,
and their least path [deg]: with them each of 100 records of Li et al. and of grains has one contact
of 85 to 142°."""
USUAL_IN_SOIL_DEG, MOST_IN_SOIL_DEG = 110.0, 200.0
"""Path of such a contact [deg]: usual, and half as much again as the longest."""
UNEVEN_DEG = 7.0
"""Distance from a full turn at which a contact is no next one of a leg that turns evenly [deg]: 2 %
of the turn, more than contacts of trials differ by; chosen."""
NO_FORCE = r"#|row|nr|no|index|sample|test|comment|temp\w*"
"""Names of columns that are none of a force, where only a moment was found."""
OTHER_ANGLE = (
    r"temp|batt|heading|yaw|pitch|roll|tilt|incl|slope|azim|bearing|lat|lon|knee|ankle|phase|abad"
)
"""Names of columns in degrees that are no angle of a leg about its hip."""
SLIP = r"slip|schlupf|glissement"
"""What a column of a wheel's slip has in its name, and none of a leg's table."""
_NAMES = {
    "theta": r"theta|θ|angle|winkel|[aá]ngulo|"
    r"(leg|motor|hip|joint|bein|dreh|encoder)(angle|winkel|theta|pos)|"
    r"(angle|theta)(leg|motor|hip|joint)|rotation|ang|angular ?position",
    "fx": r"fx|(force|load|kraft|fuerza)(x|horizontal)|x(force|load|kraft)"
    r"|(thrust|drag|horizontal)(force|load|kraft)?|fhor\w*|vortrieb(skraft)?|f(orce|uerza)horizontale?",
    "fz": r"fz|(force|load|kraft|fuerza)(z|verti[ck]al)|z(force|load|kraft)"
    r"|(lift|verti[ck]al)(force|load|kraft|last)?|fver\w*|auftrieb(skraft)?|f(orce|uerza)verticale?",
    "time": r"t|time|zeit|timestamp|elapsed(time)?|(time|zeit)s?",
    "moment": r"m|my|moment|torque|(hip|joint|motor)(moment|torque)|drehmoment|ty|moment[yh]",
    "sinkage": r"sinkage|depth|penetration(depth)?|displacement|travel|position|z|s|tiefe"
    r"|einsinkung|weg|settlement|einsinktiefe|indentation|(wheel|rut)sinkage[hz]?|enfoncement",
    "force": r"f|fz|(normal|verti[ck]al|plate|contact)?(force|load|kraft|last)|(force|load)z",
    "pressure": r"p|q|pressure|(normal|contact|ground|plate|vertical)(pressure|stress)|stress|druck"
    r"|spannung|bearingpressure",
    "travel": r"x|travel|distance|way|weg|fahrweg|odometer",
    "slip": rf"s|i|(wheel|rad)?({SLIP})(rate|ratio)?[si]?",
    "wheel_speed": r"(wheel|rim|circumferential)(speed|velocity)|omegar|wr|umfangsgeschwindigkeit",
    "rotation": r"omega|ω|angular(speed|velocity|rate)|rotation(al)?(rate|speed)?|rpm|drehzahl"
    r"|wheelrotation",
    "travel_speed": r"v|vx|(travel|forward|vehicle|ground|carriage|rover)?(speed|velocity)"
    r"|(fahr)?geschwindigkeit",
    "load": r"(normal|verti[ck]al|wheel|axle|rad)?(load|weight|last)[wn]?|fz|fn|w"
    r"|(normal|verti[ck]al)(force|kraft)|charge",
    "pull": r"fx|dp|pull|drawbar(pull|force)?|netpull|(net)?traction|zugkraft"
    r"|(horizontal|longitudinal|tractive|forward)(force|kraft)",
    "torque": r"my|ty|(wheel|motor|drive|driving|input)?torque|moment|drehmoment|mt|couple",
    "side": r"fy|side(force)?|lateral(force)?|seitenkraft",
    "side_slip": r"beta|β|sideslip(angle)?|slipangle|skew(angle)?|skid(angle)?|schräglaufwinkel",
}
"""Names of columns, without units, signs and case."""
_LOOSE = {"theta": "theta|angle|winkel|θ", "fx": "fx|forcex|xforce", "fz": "fz|forcez|zforce"}
LEG = {"theta": "angle", "fx": "force", "fz": "force", "time": "time", "moment": "moment"}
PRESSED = {"sinkage": "length", "force": "force", "pressure": "pressure"}
WHEEL = {
    "time": "time", "travel": "way", "side_slip": "angle", "slip": "share",
    "wheel_speed": "speed", "rotation": "rate", "travel_speed": "speed", "load": "force",
    "sinkage": "length", "pull": "force", "torque": "moment", "side": "force",
}  # fmt: skip
"""Kinds of the columns of a leg, of a body that is pressed in, and of a wheel."""
KIND = LEG | PRESSED | WHEEL
UNIT_KEYS = {
    "angle": "theta_unit", "force": "unit", "length": "sinkage_unit", "pressure": "pressure_unit",
    "share": "slip_unit", "speed": "speed_unit", "rate": "rotation_unit",
}  # fmt: skip
"""Option that names the unit of a kind."""
WORDS = {"theta": "theta", "fx": "Fx", "fz": "Fz"}
WORDS |= {role: f"the {role.replace('_', ' ')}" for role in ("moment", *PRESSED, *WHEEL)}
ForceUnit = Literal["N", "kN", "mN", "MN", "lbf", "ozf", "kgf", "gf", "dyn"]


class Columns(Strict):
    """Which columns of a table are what, by name, from a file or in one line."""

    @field_validator("*", mode="before")
    @classmethod
    def _named(cls, value: Any, info: ValidationInfo) -> Any:
        """Our name of a unit that is written otherwise, such as ``lbs``."""
        name = str(info.field_name)
        refuse({"is empty; give a name or a value, or leave it out for a guess": value == ""})
        if isinstance(value, int) and cls.model_fields[name].annotation == str | None:
            return str(value)  # a header of numbers
        unit = isinstance(value, str) and name.endswith("unit")
        return (unit_named(value) if unit else None) or value

    @classmethod
    def of(cls, given: Self | Mapping[str, Any] | Path | str | None) -> Self:
        """Columns from a mapping, a TOML file or ``key=value,key=value``; raises InputError."""
        if isinstance(given, cls):
            return given
        if isinstance(given, Path) or (isinstance(given, str) and "=" not in given):
            return parse_toml(Path(given), cls)
        if isinstance(given, str):
            pairs = [pair.partition("=") for pair in re.split("[,;]", given) if pair.strip()]
            given = {key.strip(): value_of(text) for key, _, text in pairs}
        options = {k: value for k, value in dict(given or {}).items() if value is not None}
        return strictly(options, cls, "columns")


class ForceColumns(Columns):
    """Which columns of a table of forces are what, their units and their signs."""

    theta: str | None = None
    """Column of the leg angle; if not given, it is guessed."""
    fx: str | None = None
    """Column of the forward force; if not given, it is guessed."""
    fz: str | None = None
    """Column of the vertical force; if not given, it is guessed."""
    moment: str | None = None
    """Column of the moment about the hip, which may stand in place of the forces."""
    time: str | None = None
    """Column of the time, for `rate_deg_s`."""
    rate_deg_s: float | None = Field(None, gt=0)
    """Constant rate of the leg [deg/s], where the table has a time instead of an angle."""
    unit: ForceUnit | None = None
    """Unit of the forces; if not given, that of the header, else N. A header that has another is
    refused, as of every unit."""
    theta_unit: Literal["deg", "rad", "mrad", "rev", "gon"] | None = None
    """Unit of the angle; if not given, that of the header, else deg."""
    theta_offset_deg: float = 0.0
    """Added to the angle of the table [deg], before its sign is turned."""
    theta_sign: Literal[1, -1] = 1
    """-1 where the angle of the table falls as the leg moves through the soil."""
    theta_scale: float | None = Field(None, gt=0, le=360)
    """Angle for one unit of the angle's column [deg], in place of `theta_unit`: 360 over the counts
    of a turn, for an encoder; 180 / (π r), for a string in mm on a pulley of radius r mm."""
    fx_sign: Literal[1, -1] = 1
    """-1 where the x axis of the table points backward."""
    fz_sign: Literal[1, -1] = 1
    """-1 where the z axis of the table points down."""
    sensor_angle_deg: float = Field(0.0, ge=-180, le=180)
    """Angle α [deg] by which the load cell is turned about y, positive where its z axis tips
    forward, as θ grows: Fx = Fx' cos α + Fz' sin α and Fz = Fz' cos α - Fx' sin α, with the signs
    of Fx' and Fz' put right."""
    sensor_turns: bool = False
    """The load cell is mounted on the leg and turns with it: it is turned by θ + α."""
    force_on: Literal["leg", "soil"] = "leg"
    """The body that the forces act on: the leg or the soil."""
    air_before_deg: float | None = None
    """Below this leg angle [deg] the leg is in air, and the forces are tared; -180 for not at all.
    If not given, `invert` takes that of the rig."""
    air_after_deg: float | None = None
    """Leg angle [deg] above which it is in air again; 180 for not at all."""

    @model_validator(mode="after")
    def _one_scale(self) -> Self:
        for key in ("theta_unit", "rate_deg_s") if self.theta_scale is not None else ():
            sentence = f"theta_scale and {key} exclude each other; give one of them"
            refuse({sentence: getattr(self, key) is not None})
        return self


def sensor_turn(angle_deg: float | FloatArray) -> FloatArray:
    """Matrix from (Fx', Fz') of a load cell turned by an angle to (Fx, Fz), [..., 2, 2].

    By hand: z' of a cell on the leg points from the tip to the hip where α = 0. With the leg level
    ahead of the hip, θ = -90°, z' points backward and x' up: Fx = -Fz' and Fz = Fx'.
    """
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.moveaxis(np.array([[c, s], [-s, c]]), (0, 1), (-2, -1))


Given = TypeVar("Given", bound=Columns)


def read_forces(source: Any, **columns: Any) -> ForceHistory:
    """Read the forces on a leg over its angle from a table.

    Parameters
    ----------
    source
        A text file (any separator, decimal sign and encoding), ``-`` for standard input, a
        ``pandas.DataFrame`` or an ``xarray.Dataset``.
    **columns
        Options of :class:`ForceColumns` by name:

        - ``theta``, ``fx``, ``fz``, ``moment``, ``time``: names of the columns, with or without
          their unit; by default they are guessed. A moment about the hip, of the soil on the leg or
          of the motor, may replace one force or both.
        - ``rate_deg_s``: constant rate of the leg [deg/s], where there is a time instead of an
          angle.
        - ``unit``, ``theta_unit``: of forces (``N``, ``kN``, ``mN``, ``lbf``, ``kgf``, ``gf`` …)
          and angle (``deg``, ``rad``, ``rev`` …); by default those of the header, else N and
          degrees.
        - ``theta_scale``: degrees for one unit of the angle's column, in place of its unit, such as
          360 over the counts of a turn.
        - ``theta_offset_deg``, ``theta_sign``: θ is ``theta_sign`` times the sum of the angle in
          the table and the offset [deg].
        - ``fx_sign``, ``fz_sign``: -1 where an axis of the table points backward or down.
        - ``sensor_angle_deg``: angle by which the load cell is turned about y [deg], positive where
          its z axis tips forward; what it reads is turned back.
        - ``sensor_turns``: true of a load cell on the leg, which is turned by θ and that angle. It
          is tared in its own axes, in which its zero is constant and the leg's weight turns.
        - ``force_on``: ``leg`` or ``soil``, what the forces act on.
        - ``air_before_deg``, ``air_after_deg``: leg angles below and above which the leg is in air
          [deg], where the forces are tared; by default they are not.

    Returns
    -------
    ForceHistory
        Of the stroke in which θ grows. What was guessed and left out is in
        ``provenance["reading"]``, a sentence each.

    Raises
    ------
    InputError
        With everything that is wrong with the table; or if it holds several strokes, which
        :func:`terraphi.invert` takes as trials.

    Examples
    --------
    >>> import pandas as pd
    >>> table = {"angle [deg]": range(-85, 86), "Fx": [0.5] * 171, "lift": [1.0] * 171}
    >>> terraphi.read_forces(pd.DataFrame(table), fz="lift", unit="kgf")
    ForceHistory(171 samples, theta -85 to 85 deg, Fx 4.9 to 4.9 N, Fz 9.81 to 9.81 N)
    """
    [history] = read_trials(source, columns, is_single=True)
    return history


def read_trials(
    source: Any, columns: ForceColumns | Mapping[str, Any] | Path | str | None = None, *,
    is_single: bool = False,
) -> list[ForceHistory]:  # fmt: skip
    """Forces of each stroke in which θ grows, of a ``Table`` or what :func:`read_forces` takes."""
    reader = _LegTable(source, ForceColumns.of(columns))
    name, table = reader.source, reader.table
    reader.refuse_wrong()
    theta, values, steps = reader.values()
    ours: dict[str, Any] = {}
    if reader.given.model_fields_set <= {"air_before_deg", "air_after_deg"} and (
        {*CSV_COLUMNS} == {*reader.names.values()}
    ):
        ours = origin(
            Path(name),
            table.comments,
            np.column_stack([table.columns[name] for name in CSV_COLUMNS]),
        )
    if not ours:
        values = reader.tared(theta, values)
    if reader.given.sensor_turns:
        values = reader.turned(theta, values)
    strokes = reader.strokes(theta, reader.forces(values))
    if is_single and len(strokes) > 1:
        reader.refuse(f"{len(strokes)} strokes; give it to invert, or cut it into files of one")
    unit = reader.unit(f"f{reader.axes[-1]}")[0] if reader.axes else "N"
    file = "standard input" if name == "-" else Path(name).name
    # Options that numbers were changed by, and degrees for a unit of the angle or of the time.
    changes = reader.given.model_dump(exclude_defaults=True, include={*CHANGED})
    if "theta" not in reader.names:
        changes["rate_deg_s"] = reader.given.rate_deg_s
    elif (scale := reader.unit("theta")[1]) != 1.0:
        changes["theta_scale"] = scale
    about: dict[str, Any] = {
        "force_unit": "" if unit == "N" else unit,
        "resolution": steps if any(steps.values()) else {},
        "columns": changes,
    }
    histories = []
    for i, which in enumerate(strokes):
        position, rows = _increasing(theta[which], values[which])
        if i == 0 and len(position) < len(which):
            averaged = f"{len(which)} rows become {len(position)}"
            reader.notes.append(f"Averaged in bins of {BIN_DEG:g}°: {averaged}.")
        moment = rows[:, -1].copy() if "M" in reader.channels else None
        if moment is not None and np.trapezoid(moment, position) > 0.0:
            moment = -moment  # soil resists the leg, so that this is the motor's
        about["file"] = f"{file} (stroke {i + 1})" if len(strokes) > 1 else file
        about["reading"] = reader.notes if i == 0 else []
        provenance = ours | {key: value for key, value in about.items() if value}
        force = rows[:, : len(reader.axes)].copy()
        forces = np.radians(position), force, "theta", reader.axes, provenance, moment
        histories.append(ForceHistory(*forces))
    reader.refuse_other_zero(histories[0])
    return histories


def preview(
    source: Any, columns: ForceColumns | Mapping[str, Any] | Path | str | None = None
) -> dict[str, Any]:
    """First rows of a table and the guesses of :func:`read_forces`, whether it refuses it or not.

    Returns
    -------
    dict
        ``columns``: all names; ``units``: by our names, ``None`` where there is none; ``rows``:
        cells, NaN where there is no number; ``roles``: column of each role that is given or guessed
        (theta or time, fx, fz, moment); ``candidates``: columns of each role that has none.

    Raises
    ------
    InputError
        If it holds no rows of numbers, or an option is wrong.
    """
    reader = _LegTable(source, ForceColumns.of(columns))
    table = reader.table
    written = [table.units.get(name) or unit for name, (_, unit) in reader.parts.items()]
    return {
        "columns": list(reader.parts),
        "units": [unit_named(unit or "") for unit in written],
        "rows": np.column_stack([*table.columns.values()])[:6].tolist(),
        "roles": reader.names,
        "candidates": {role: reader.like(role) for role in LEG if role not in reader.names},
    }


class ColumnReader(Generic[Given]):
    """One table and the columns that have a role in it; what was guessed, and what is wrong."""

    def __init__(self, source: Any, given: Given) -> None:
        if isinstance(source, str | Path):
            self.source, self.table = str(source), read_table(Path(source))
        else:
            self.source = type(source).__name__
            self.table = source if isinstance(source, Table) else table_of(source)
        self.given = given
        self.names: dict[str, str] = {}
        self.wrong: list[str] = []
        self.notes: list[str] = []
        self.parts = {name: _split(str(name)) for name in self.table.columns}
        self.header = ", ".join(f"'{name[:30]}'" for name in [*self.parts][:8])

    def refuse(self, sentence: str) -> NoReturn:
        """Raise InputError that names the table."""
        raise InputError(f"{self.source}: {sentence}")

    def refuse_wrong(self) -> None:
        """Raise InputError with all that is wrong, if anything is."""
        if self.wrong:
            self.refuse("; ".join(self.wrong))

    def take(self, role: str, column: str) -> None:
        """The column of a name, which may lack its unit."""
        same = [name for name, (bare, _) in self.parts.items() if column in (name, bare)]
        if len(same) == 1 or column in same:
            self.names[role] = column if column in same else same[0]
        else:
            hint = nearest(column, [*self.parts])
            hint = f"it fits {' and '.join(map(repr, same))}" if same else hint
            self.wrong.append(f"no column '{column[:40]}' for {role}; {hint[:200]}")

    def guess(self, role: str, columns: list[str]) -> bool:
        """Take the only column that fits a role, or complain about several; False of none."""
        if len(columns) == 1:
            self.names[role] = columns[0]
        elif columns:
            listed = " or ".join(f"'{name[:40]}'" for name in columns[:4])
            self.wrong.append(f"{WORDS[role]} may be {listed}; add --columns '{role}={columns[0]}'")
        return bool(columns)

    def like(self, role: str) -> list[str]:
        """Columns whose names fit a role."""
        taken = self.names.values()
        plain = {
            name: re.sub(r"[\W_]+", "", bare.lower())
            for name, (bare, _) in self.parts.items() if name not in taken
        }  # fmt: skip
        columns = [name for name, text in plain.items() if re.fullmatch(_NAMES[role], text)]
        if role in _LOOSE and not columns:
            columns = [name for name, text in plain.items() if re.search(_LOOSE[role], text)]
        if role == "theta" and not columns:  # the one whose unit is that of an angle
            columns = [
                name for name, text in plain.items()
                if unit_named(self.written(name) or "") in KINDS["angle"]
                and not re.search(OTHER_ANGLE, text)
            ]  # fmt: skip
        return columns

    def written(self, column: str) -> str | None:
        """Unit of a column as the table has it."""
        return self.table.units.get(column) or self.parts[column][1]

    def unit(self, role: str) -> tuple[str, float]:
        """Unit of a column and what it is in our own; NaN if it is unknown."""
        kind = KIND[role]
        unit = getattr(self.given, UNIT_KEYS.get(kind, ""), None)
        unit = unit or unit_named(self.written(self.names[role]) or next(iter(KINDS[kind])))
        return (unit, KINDS[kind][unit]) if unit in KINDS[kind] else ("?", math.nan)

    def check(self, role: str) -> None:
        """Complain about words among the numbers of a column, and about its unit."""
        column, kind = self.names[role], KIND[role]
        words = self.table.words.get(column, [])
        if words:
            (place, cell), more = words[0], f" and {len(words) - 1} more" if len(words) > 1 else ""
            wrong = f"{place}: {column[:40]} = {cell[:30]!r}{more} is not a number"
            self.wrong.append(f"{wrong}; leave the cell blank or remove the row")
        if math.isnan(self.unit(role)[1]):
            key = UNIT_KEYS.get(kind)
            remedy = f"add --columns {key}=UNIT" if key else "rename it"
            scale = ", or theta_scale=DEGREES for one of them" if kind == "angle" else ""
            unknown = f"column '{column[:40]}': '{self.written(column)}' is no known unit of {kind}"
            self.wrong.append(f"{unknown}; {remedy}, one of {', '.join(KINDS[kind])}{scale}")

    def find(self, roles: Iterable[str], is_taken: Callable[[str], bool]) -> set[str]:
        """Take the columns that are given, and guess the others unless they are not needed.

        Returns the roles whose columns are given.
        """
        chosen: dict[str, str] = self.given.model_dump(include={*roles}, exclude_none=True)
        for role, column in chosen.items():
            self.take(role, column)
        for role in roles if not self.wrong else ():
            if role not in chosen and not is_taken(role):
                self.guess(role, self.like(role))
        return {*chosen}

    def mend(self, role: str, unit: str) -> str:
        """Advice that gives a column another unit: in its header, or else by an option."""
        written = self.written(self.names[role])
        option = f"add --columns {UNIT_KEYS[KIND[role]]}={unit}"
        return f"write {unit} in place of {written} in the header" if written else option

    def settle(self, chosen: set[str], units: Mapping[str, str]) -> None:
        """Check all columns, ask for the units of some, and note those that were guessed."""
        contradicted: dict[str, list[str]] = {}
        for role, name in self.names.items():
            self.check(role)
            key = UNIT_KEYS.get(KIND[role], "")
            given, written = getattr(self.given, key, None), unit_named(self.written(name) or "")
            if given and written in KINDS[KIND[role]] and written != given:
                sentence = f"in {written} by the header and in {given} by {key}={given}"
                contradicted.setdefault(sentence, []).append(f"'{name[:40]}'")
            if role in units and not (self.written(name) or given):
                named = f"{key}={units[role]}, or name it such as {role}_{units[role]}"
                self.wrong.append(f"column '{name[:40]}' has no unit; add --columns {named}")
        for sentence, columns in contradicted.items():
            verb = "are" if len(columns) > 1 else "is"
            listed = f"{' and '.join(columns)} {verb}"
            self.wrong.append(f"{listed} {sentence}; leave out the option, or correct the header")
        guessed = [
            f"{WORDS[role]} from '{name}' [{self.unit(role)[0]}]"
            for role, name in self.names.items() if role not in chosen
        ]  # fmt: skip
        if guessed:
            self.notes.append(f"{GUESSED}{', '.join(guessed)}.")

    def column(self, role: str) -> FloatArray:
        """A column in the first unit of its kind; NaN for codes of lost readings, noted."""
        (_, factor), name = self.unit(role), self.names[role]
        values = np.array(self.table.columns[name], dtype=np.float64)
        for code in LOST:
            lost = np.abs(values) == code
            largest = np.nanmax(np.abs(values[~lost]), initial=0.0)
            if lost.sum() > 1 and code > FAR_OUTSIDE * largest > 0.0:
                at, values[lost] = f"{values[lost][0]:g} in '{name[:40]}'", np.nan
                self.notes.append(f"{at} is read as no number, in {lost.sum()} rows.")
        return np.asarray(factor * values)


class _LegTable(ColumnReader[ForceColumns]):
    """A table of forces on a leg over its angle."""

    def __init__(self, source: Any, given: ForceColumns) -> None:
        """Find the column of each role: as given, by our own names, or by a guess."""
        super().__init__(source, given)
        self.channels: list[str] = []
        lacking, chosen = [], set()
        our_names = dict(zip(("theta", "fx", "fz"), CSV_COLUMNS, strict=True))
        along = "theta" if given.rate_deg_s is None else "time"
        for role in (along, "fx", "fz", "moment"):
            ours = our_names.get(role) in self.parts and our_names[role]
            if column := getattr(given, role) or ours:
                self.take(role, column)
                chosen.add(role)
            elif role == "moment":  # not needed: only if there is no doubt
                unambiguous = [name for name in self.like(role) if name not in self.table.words]
                if len(self.like(role)) == 1 and unambiguous:
                    self.names[role] = unambiguous[0]
                    if math.isnan(self.unit(role)[1]):
                        del self.names[role]
            elif not self.guess(role, self.like(role)):
                lacking.append(role)
        if "moment" in self.names and {"fx", "fz"} & {*lacking}:
            lacking = self._without_forces(lacking)
        if lacking:
            self._ask(lacking)
        self.settle(chosen, {})
        unwritten = {role for role, name in self.names.items() if not self.written(name)}
        if unwritten & {"fx", "fz"} and given.unit is None:
            self.notes.append(f"The forces {NO_UNIT} N.")
        if "moment" in unwritten and len(self.axes) < 2:
            self.notes.append("The moment has no unit, and is taken as N m.")

    def _without_forces(self, lacking: list[str]) -> list[str]:
        """Roles that still lack a column where the moment may stand for forces; noted."""
        free, no_force = {*self.parts} - {*self.names.values()}, f"{NO_FORCE}|{_NAMES['time']}"
        may_be_forces = not all(re.fullmatch(no_force, name.lower()) for name in free)
        if may_be_forces and self.given.moment is None:
            return lacking
        without = [WORDS[role] for role in lacking if role != "theta"]
        beware = "" if len(without) == 1 else " It cannot show a wrong leg or a wrong scale."
        self.notes.append(f"The moment is used in place of {' and '.join(without)}.{beware}")
        return [role for role in lacking if role == "theta"]

    def _ask(self, lacking: list[str]) -> None:
        """Complain about roles without a column."""
        lacked = f"no column of {', '.join(WORDS[role] for role in lacking)} among {self.header}"
        slips = [name for name in self.parts if re.search(SLIP, name.lower())]
        if slips and "theta" in lacking:
            looks = f"with '{slips[0][:30]}' it looks like the table of a wheel"
            self.wrong.append(f"{lacked}; {looks}: give --tool wheel:DIAMETERxWIDTH [mm]")
            return
        header = list(self.parts)
        unnamed = len(header) >= len(lacking) and all(name.startswith("column ") for name in header)
        names = header if unnamed else ["NAME"] * len(lacking)
        pairs = ",".join(f"{role}={name}" for role, name in zip(lacking, names, strict=False))
        more = ", or rate_deg_s=RATE for a time" if "theta" in lacking else ""
        if "theta" in lacking and self.like("sinkage"):
            more += "; of a plate or ball pressed in, give --tool plate:MM or FILE@plate:MM"
        if "moment" in self.names and {"fx", "fz"} & {*lacking}:
            more += f", or 'moment={self.names['moment']}' to do without a force"
        self.wrong.append(f"{lacked}; add --columns '{pairs}'{more}")

    def unit(self, role: str) -> tuple[str, float]:
        """Unit of a column and what it is in our own; of the angle its scale, if that is given."""
        scale = self.given.theta_scale if role == "theta" else None
        return super().unit(role) if scale is None else (f"{scale:g}°", scale)

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the forces that the table has."""
        return tuple(axis for axis in "xz" if f"f{axis}" in self.names)

    def values(self) -> tuple[FloatArray, FloatArray, dict[str, float]]:
        """θ [deg] and :attr:`channels` [N] or [N m] of whole rows, [row, channel]; their steps."""
        given = self.given
        soil = -1.0 if given.force_on == "soil" else 1.0
        signs = {"fx": soil * given.fx_sign, "fz": soil * given.fz_sign, "moment": 1.0}
        columns = {r: sign * self.column(r) for r, sign in signs.items() if r in self.names}
        if "theta" in self.names:
            along = self.column("theta")
        else:
            along = (given.rate_deg_s or 1.0) * self.column("time")
        theta = given.theta_sign * (along + given.theta_offset_deg)
        needed = [v for role, v in columns.items() if role != "moment" or len(self.axes) < 2]
        full = np.asarray(np.isfinite([theta, *needed]).all(axis=0))
        if not full.any():
            self.refuse("no row has all that is needed; check the columns")
        if not full.all():
            first = self.table.place(int(np.flatnonzero(~full)[0]))
            lacking = f"{(~full).sum()} of {len(full)} rows lack a number"
            self.notes.append(f"{lacking} and are left out, the first at {first}.")
        rows, theta = np.flatnonzero(full), theta[full]
        values = np.column_stack(list(columns.values()))[full]
        self.channels = [*(f"F{axis}" for axis in self.axes), "M"][: len(columns)]
        if not np.isfinite(values).all():
            self.notes.append("The moment lacks numbers, and is not used.")
            self.channels, values = self.channels[:-1], values[:, :-1]
        steps = np.array([resolution(row) for row in values.T])
        key = "sensor_turns" if given.sensor_turns else "sensor_angle_deg"
        if getattr(given, key):
            if len(self.axes) < 2:
                self.refuse(f"{key} turns Fx and Fz, and one of them is missing; drop it")
            turn = sensor_turn(given.sensor_angle_deg + (theta if given.sensor_turns else 0.0))
            steps[:2] = np.sqrt((turn**2 @ steps[:2] ** 2).reshape(-1, 2).mean(axis=0))
            if not given.sensor_turns:  # else after it is tared
                values[:, :2] = values[:, :2] @ turn.T
        kept = np.ones(len(theta), dtype=bool)
        if not _scattered(theta):  # an angle that jumps away and is back in the next row
            around = np.median(np.stack([theta[:-2], theta[1:-1], theta[2:]]), axis=0)
            kept[1:-1] = np.abs((theta[1:-1] - around + 180.0) % 360.0 - 180.0) <= TURN_DEG
        if not kept.all():
            self.notes.append(f"{(~kept).sum()} rows in which the angle jumps are left out.")
        theta, values = theta[kept], values[kept]
        theta = self._within_a_turn(theta, self.forces(values), rows[kept])
        small = np.ptp(theta) > 0.0 and np.abs(theta).max() < LEAST_DEG
        if "theta" in self.names and self.unit("theta")[0] == "deg" and small:
            ends = f"{theta.min():.2f} to {theta.max():.2f}"
            self.refuse(f"the angle runs from {ends}, in radians; {self.mend('theta', 'rad')}")
        return theta, values, dict(zip(self.channels, steps.tolist(), strict=True))

    def forces(self, values: FloatArray) -> FloatArray:
        """Both forces of the channels, or the moment, [row, channel]."""
        return values[:, :2] if len(self.axes) == 2 else values[:, -1:]

    def _within_a_turn(self, theta: FloatArray, force: FloatArray, rows: IntArray) -> FloatArray:
        """θ [deg] less full turns; refuses one over which the forces are those of no leg."""
        jumps = np.abs(np.diff(theta)).max(initial=0.0) > 180.0  # it starts again at a full turn
        scattered = _scattered(theta)
        along = np.unwrap(theta, period=360.0) if jumps and not scattered else theta
        order = np.argsort(along, kind="stable") if scattered else np.arange(len(theta))
        contacts = [order[each] for each in _contacts(along[order], force[order])]
        if "theta" not in self.names:
            self._refuse_uneven(along, contacts, rows)
        longest = max((float(np.ptp(along[each])) for each in contacts), default=0.0)
        if longest > MOST_IN_SOIL_DEG:
            key, now = ("theta_scale", self.unit("theta")[1]) if "theta" in self.names else (
                "rate_deg_s", self.given.rate_deg_s or 1.0)  # fmt: skip
            usual = now * USUAL_IN_SOIL_DEG / longest
            remedy = f"add --columns {key}={usual:.2g} or so"
            if key == "theta_scale":
                remedy += " (360 over the counts of a turn)"
                remedy = self.mend("theta", "deg") if 0.7 < usual < 1.4 else remedy
            path = f"{longest:.0f}°, of which less than {MOST_IN_SOIL_DEG:g} are possible"
            self.refuse(f"the leg is in soil over {path}; check the angle, and {remedy}")
        if not jumps and np.ptp(theta) <= 360.0:
            return theta
        if len(contacts) == 1 and not jumps:  # no leg that goes round and round
            return theta - 360.0 * round(float(np.mean(along[contacts[0]])) / 360.0)
        return np.where(np.abs(theta) > 180.0, (theta + 180.0) % 360.0 - 180.0, theta)

    def _refuse_uneven(self, along: FloatArray, contacts: list[IntArray], rows: IntArray) -> None:
        """Complain about times at which the leg comes back too early or late."""
        rate = self.given.theta_sign * (self.given.rate_deg_s or 1.0)
        time = along / rate - self.given.theta_offset_deg / abs(rate)

        def place(i: int) -> str:
            return f"{time[i]:.4g} s ({self.table.place(int(rows[i]))})"

        for before, after in pairwise(contacts):
            turn = (along[after[0]] - along[before[0]]) * self.given.theta_sign
            if turn > 0.0 and abs(turn - 360.0 * max(round(turn / 360.0), 1)) > UNEVEN_DEG:
                self.refuse(
                    f"the leg meets the soil at {place(before[0])} and {turn:.0f}° later at "
                    f"{place(after[0])}, so that it does not turn evenly; record the angle, or cut "
                    "the table to one stroke"
                )

    def tared(self, theta: FloatArray, values: FloatArray) -> FloatArray:
        """Channels less what they read while the leg is in air; noted."""
        low, high = self.given.air_before_deg, self.given.air_after_deg
        air = np.zeros(len(theta), dtype=bool)
        if low is not None:
            air |= theta < low
        if high is not None:
            air |= theta > high
        # Angles that the user has stated are believed, even if they are few.
        stated = [
            f"{name} = {value:g}"
            for name, value in (("air_before_deg", low), ("air_after_deg", high))
            if value is not None and abs(value) < 180.0 and name in self.given.model_fields_set
        ]
        if _scattered(theta):
            if stated:
                self.notes.append(f"{' and '.join(stated)}: not used, the angles go to and fro.")
            return values
        fewest: dict[str, Any] = {"fewest": 1, "least": 0.0} if stated else {}
        notes: list[str] = []
        if air.any():
            values, notes = without_baseline(theta, values, air, self.channels, **fewest)
        if stated and not notes:
            why = "readings there are not those of air" if air.any() else "no reading is there"
            self.refuse(f"{' and '.join(stated)}, and {why}; give the angles in air, or none")
        self.notes += notes
        return values

    def turned(self, theta: FloatArray, values: FloatArray) -> FloatArray:
        """Channels of a cell that turns with the leg, with its forces along x and z; noted."""
        angle = self.given.sensor_angle_deg
        self.notes.append(f"The forces are turned from the load cell's axes, by θ {angle:+g}°.")
        turn = sensor_turn(theta + angle)
        return np.column_stack([np.matmul(turn, values[:, :2, None])[..., 0], values[:, 2:]])

    # -- strokes ---------------------------------------------------------------------------------

    def strokes(self, theta: FloatArray, force: FloatArray) -> list[Any]:
        """Rows of each stroke in which θ grows."""
        rows = np.arange(len(theta))
        if _scattered(theta):
            return [rows]
        moving = ~at_rest(theta)
        rows, theta, force = rows[moving], theta[moving], force[moving]
        turns = _turns(theta)
        pieces = [slice(a, b + 1) for a, b in pairwise(turns)]
        pieces = [p for p in pieces if p.stop - p.start > FEWEST_ROWS]  # not where it jumps back
        up = [p for p in pieces if theta[p][-1] - theta[p][0] >= LEAST_STROKE_DEG]
        down = [p for p in pieces if theta[p][0] - theta[p][-1] >= LEAST_STROKE_DEG]
        up, down = (up, down) if up else (down, [])
        path = np.linspace(theta.min(), theta.max(), 1000)
        passed = np.array([(theta[p].min() <= path) & (path <= theta[p].max()) for p in up])
        if not up or (not down and passed.any(axis=0).sum() > 0.9 * passed.sum()):
            return [rows]  # one stroke, or parts of one

        def size(of: list[slice]) -> float:
            return float(np.median([np.sqrt(np.square(force[p]).mean()) for p in of]))

        if down and size(down) > HEAVIER * size(up):
            sign = f"theta_sign={-self.given.theta_sign}"
            self.refuse(f"the forces are larger while the angle falls; add --columns {sign}")
        if down:
            self.notes.append("The leg goes forth and back; the way back is left out.")
        if len(up) > 1:
            self.notes.append(f"{len(up)} strokes in one table, taken as trials in one soil.")
        return [rows[p] for p in up]

    def refuse_other_zero(self, history: ForceHistory) -> None:
        """Complain about an angle that is not zero where the leg hangs down.

        The soil bears most where the leg moves down into it, before θ = 0.
        """
        theta = history.theta_deg
        forces = np.stack([history.channel(name) for name in history.channels])
        if "M" in history.channels:  # another unit
            forces /= np.maximum(np.abs(forces).max(axis=1, keepdims=True), 1e-300)
        size = np.linalg.norm(forces, axis=0)
        low, high = theta[[0, -1]]
        middle = 0.5 * (low + high)
        if high - low < 90.0 or abs(middle) < 30.0 or max(size[0], size[-1]) > 0.3 * size.max():
            return  # a part of a stroke, or nearly right
        begins, heaviest, ends = np.interp(
            [0.02, 0.5, 0.98], np.cumsum(size**2) / np.square(size).sum(), theta
        )
        if HEAVIEST_DEG[0] <= heaviest <= HEAVIEST_DEG[1]:
            return
        sign = self.given.theta_sign
        offset = self.given.theta_offset_deg - sign * round(middle)
        turned = f",theta_sign={-sign}" if heaviest > middle + 10.0 else ""
        self.refuse(
            f"the forces are from {begins:.0f} to {ends:.0f}°, and the leg hangs down at 0°; add "
            f"--columns theta_offset_deg={offset:g}{turned}"
        )


def _split(header: str) -> tuple[str, str | None]:
    """Name and unit of a column from its header, such as ``Force X (N)`` or ``Fz_N``."""
    match = re.fullmatch(r"(.*?)\s*[\[({<]\s*([^\])}>]*)\s*[\])}>]", header)
    if match and match[1]:
        return match[1].strip(), match[2] or None
    if match := re.fullmatch(r"(.+?)[_\s](m|cm|mm|rad|deg)_s", header):  # such as v_m_s
        return match[1], f"{match[2]}/s"
    for pattern in (r"(.+?)\s+in\s+(.+)", r"(.+?)\s*[/,]\s*(.+)", r"(.+?)[_\s]+([^_\s]+)"):
        match = re.fullmatch(pattern, header)
        if match and unit_named(match[2]) and match[2] not in ("h", "u", "g"):
            return match[1].strip(), match[2]
    return header, None


def _contacts(along: FloatArray, force: FloatArray) -> list[IntArray]:
    """Rows of each contact with soil, of forces over a path [deg] in its order, [row, channel]."""
    zero = np.linspace(force[:3].mean(axis=0), force[-3:].mean(axis=0), len(force))
    size = np.linalg.norm(force - zero, axis=1)
    loaded = np.flatnonzero(size > IN_SOIL * np.quantile(size, 0.99))
    gap = max(BETWEEN_DEG, 3.0 * float(np.median(np.abs(np.diff(along, prepend=along[0])))))
    contacts = np.split(loaded, np.flatnonzero(np.abs(np.diff(along[loaded])) > gap) + 1)
    return [rows for rows in contacts if len(rows) and np.ptp(along[rows]) > BETWEEN_DEG]


def _scattered(theta: FloatArray) -> bool:
    """True if the rows have no order in the angle, or are too few to have one."""
    return len(theta) < 3 or bool(np.median(np.abs(np.diff(theta))) > SCATTERED_DEG)


def _turns(theta: FloatArray) -> list[int]:
    """Rows at which the leg turns back by ``TURN_DEG`` or more, with the first and the last."""
    turns, way, low, high = [0], 0, 0, 0
    for i, angle in enumerate(theta.tolist()):
        if angle > theta[high]:
            high = i
        if angle < theta[low]:
            low = i
        if way >= 0 and angle < theta[high] - TURN_DEG:
            turns, way, low = [*turns, high] if way else turns, -1, i
        elif way <= 0 and angle > theta[low] + TURN_DEG:
            turns, way, high = [*turns, low] if way else turns, 1, i
    return [*turns, len(theta) - 1]


def _increasing(theta: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows in the order of θ; averaged in bins if θ does not grow from row to row."""
    if np.all(np.diff(theta) > 0.0):
        return theta, values
    order = np.argsort(theta, kind="stable")
    theta, values = theta[order], values[order]
    if np.all(np.diff(theta) > 0.1 * BIN_DEG):
        return theta, values
    first = np.flatnonzero(np.diff(np.floor(theta / BIN_DEG + 0.5), prepend=-np.inf))
    means = block_means(np.column_stack([theta, values]), first)
    return means[:, 0], means[:, 1:]
