"""Forces on a leg from a table as people have it: columns, units, signs, strokes.

Columns are guessed from their names where they are not given, and each guess leaves a note. What is
wrong with a table is reported all at once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, NoReturn, Self

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.baseline import at_rest, baseline
from terraphi.experiment.documents import Strict, parse_toml, strictly
from terraphi.experiment.errors import GUESSED, InputError, nearest
from terraphi.experiment.force_table import CSV_COLUMNS, origin
from terraphi.experiment.history import CHANNEL_UNITS, ForceHistory, resolution
from terraphi.experiment.tables import Table, read_table, table_of
from terraphi.experiment.units import KINDS, unit_named

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
PREVIEW_ROWS = 6
"""Rows of a preview."""
TURNED = ("theta_sign", "fx_sign", "fz_sign", "force_on")
"""Options that turn a sign."""
ROLES = ("theta", "fx", "fz")
NO_FORCE = r"#|row|nr|no|index|sample|test|comment|temp\w*"
"""Names of columns that are none of a force, where only a moment was found."""
OTHER_ANGLE = (
    r"temp|batt|heading|yaw|pitch|roll|tilt|incl|slope|azim|bearing|lat|lon|knee|ankle|phase|abad"
)
"""Names of columns in degrees that are no angle of a leg about its hip."""
_NAMES = {
    "theta": r"theta|θ|angle|winkel|[aá]ngulo|"
    r"(leg|motor|hip|joint|bein|dreh|encoder)(angle|winkel|theta|pos)|"
    r"(angle|theta)(leg|motor|hip|joint)|rotation|ang|angular ?position",
    "fx": r"fx|(force|load|kraft|fuerza)x|x(force|load|kraft)|(thrust|horizontal)(force)?|fhor\w*|"
    r"horizontalkraft|vortrieb|f(orce|uerza)horizontale?",
    "fz": r"fz|(force|load|kraft|fuerza)z|z(force|load|kraft)|(lift|vertical)(force)?|fver\w*|"
    r"vertikalkraft|auftrieb|f(orce|uerza)verticale?",
    "time": r"t|time|zeit|timestamp|elapsed(time)?|(time|zeit)s?",
    "moment": r"m|my|moment|torque|(hip|joint|motor)(moment|torque)|drehmoment|ty|moment[yh]",
    "sinkage": r"sinkage|depth|penetration(depth)?|displacement|travel|position|z|s|tiefe"
    r"|einsinkung|weg|settlement|einsinktiefe|indentation",
    "force": r"f|fz|force|load|(normal|vertical|plate|contact)(force|load)|(force|load)z|kraft"
    r"|last",
    "pressure": r"p|q|pressure|(normal|contact|ground|plate|vertical)(pressure|stress)|stress|druck"
    r"|spannung|bearingpressure",
}
"""Names of columns, without units, signs and case."""
_LOOSE = {"theta": "theta|angle|winkel|θ", "fx": "fx|forcex|xforce", "fz": "fz|forcez|zforce"}
KIND = {"theta": "angle", "fx": "force", "fz": "force", "time": "time", "moment": "moment"}
PRESSED = {"sinkage": "length", "force": "force", "pressure": "pressure"}
"""Kinds of the columns of a leg, and of a body that is pressed in."""
_Unit = Literal["N", "kN", "mN", "MN", "lbf", "ozf", "kgf", "gf", "dyn"]


class Columns(Strict):
    """Which columns of a table are what, by name, from a file or in one line."""

    @field_validator("*", mode="before")
    @classmethod
    def _named(cls, value: Any, info: ValidationInfo) -> Any:
        """Our name of a unit that is written otherwise, such as ``lbs``."""
        name = str(info.field_name)
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
            pairs = [pair.partition("=") for pair in re.split("[,;]", given)]
            given = {key.strip(): _value(text.strip()) for key, _, text in pairs}
        known = {k: value for k, value in dict(given or {}).items() if value is not None}
        return strictly(known, cls, "columns")


class PressColumns(Columns):
    """Which columns of a table of a body pressed in are what, and their units."""

    sinkage: str | None = None
    """Column of the sinkage; if not given, it is guessed."""
    force: str | None = None
    """Column of the force; if not given, it is guessed."""
    pressure: str | None = None
    """Column of the pressure, in place of a force; if not given, it is guessed."""
    sinkage_unit: Literal["mm", "cm", "m", "in", "ft"] | None = None
    """Unit of the sinkage; if not given, that of the header."""
    unit: _Unit | None = None
    """Unit of the force; if not given, that of the header."""
    pressure_unit: Literal["kPa", "Pa", "MPa", "bar", "psi"] | None = None
    """Unit of the pressure; if not given, that of the header."""


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
    unit: _Unit | None = None
    """Unit of the forces; if not given, that of the header, else N."""
    theta_unit: Literal["deg", "rad", "mrad", "rev", "gon"] | None = None
    """Unit of the angle; if not given, that of the header, else deg."""
    theta_offset_deg: float = 0.0
    """Added to the angle of the table [deg], before its sign is turned."""
    theta_sign: Literal[1, -1] = 1
    """-1 where the angle of the table falls as the leg moves through the soil."""
    fx_sign: Literal[1, -1] = 1
    """-1 where the x axis of the table points backward."""
    fz_sign: Literal[1, -1] = 1
    """-1 where the z axis of the table points down."""
    force_on: Literal["leg", "soil"] = "leg"
    """Whether the forces act on the leg or on the soil."""
    air_before_deg: float | None = None
    """Below this leg angle [deg] the leg is in air, and the forces are tared; -180 for not at all.
    If not given, `invert` takes that of the rig."""
    air_after_deg: float | None = None
    """Leg angle [deg] above which it is in air again; 180 for not at all."""


def _value(text: str) -> Any:
    """A number if the text is one."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text.strip("'\"")


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
        - ``theta_offset_deg``, ``theta_sign``: θ is ``theta_sign`` times the sum of the angle in
          the table and the offset [deg].
        - ``fx_sign``, ``fz_sign``: -1 where an axis of the table points backward or down.
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
    found = read_trials(source, columns)
    if len(found) > 1:
        raise InputError(
            f"{_name_of(source)}: {len(found)} strokes; give the table to invert, which takes them "
            "as trials, or cut it into files of one stroke"
        )
    return found[0]


def read_trials(
    source: Any, columns: ForceColumns | Mapping[str, Any] | Path | str | None = None
) -> list[ForceHistory]:
    """Forces of each stroke in which θ grows, of a ``Table`` or what :func:`read_forces` takes."""
    found = _Reading(source, ForceColumns.of(columns))
    name, table = found.source, found.table
    if found.wrong:
        found.refuse("; ".join(found.wrong))
    theta, force, moment = found.values()
    steps = {f"F{axis}": resolution(row) for axis, row in zip(found.axes, force.T, strict=True)}
    steps["M"] = resolution(moment)
    turned = found.given.model_dump(exclude_defaults=True, include={*TURNED})
    known: dict[str, Any] = {}
    if found.given.model_fields_set <= {"air_before_deg", "air_after_deg"} and (
        {*CSV_COLUMNS} == {*found.names.values()}
    ):
        known = origin(Path(name), table.comments, table.frame[list(CSV_COLUMNS)].to_numpy())
    if not known:
        force, moment = found.tared(theta, force, moment)
    strokes = found.strokes(theta, force if len(found.axes) == 2 else moment[:, None])
    histories = []
    unit = found._unit(f"f{found.axes[-1]}")[0] if found.axes else "N"
    for i, which in enumerate(strokes):
        position, values = _increasing(theta[which], np.column_stack([force, moment])[which])
        if i == 0 and len(position) < len(which):
            found.notes.append(
                f"Rows are averaged in bins of {BIN_DEG:g}°: {len(which)} become {len(position)}."
            )
        turning = values[:, -1] if np.isfinite(values[:, -1]).all() else None
        if turning is None and "moment" in found.names and i == 0:
            found.notes.append("The moment lacks numbers, and is not used.")
        if turning is not None and np.trapezoid(turning, position) > 0.0:
            turning = -turning  # soil resists the leg, so that this is the motor's
        trial = f" (stroke {i + 1})" if len(strokes) > 1 else ""
        file = "standard input" if name == "-" else Path(name).name
        histories.append(
            ForceHistory(
                np.radians(position),
                values[:, :-1].copy(),
                axes=found.axes,
                provenance=known | {"file": file + trial} | (
                    {"force_unit": unit} if unit != "N" else {}
                ) | ({"resolution": steps} if any(steps.values()) else {}) | (
                    {"columns": turned} if turned else {}
                ) | (
                    {"reading": found.notes} if found.notes and i == 0 else {}
                ),
                moment=turning,
            )
        )  # fmt: skip
    found.refuse_other_zero(histories[0])
    return histories


class Preview(NamedTuple):
    """First rows of a table, and what its columns are taken for."""

    columns: list[str]
    """Names of all columns."""
    units: list[str | None]
    """Unit of each in the table, by our name; ``None`` where there is none."""
    rows: list[list[float]]
    """Cells of the first rows; NaN where there is no number."""
    roles: dict[str, str]
    """Column of each role that is given or guessed: theta or time, fx, fz, moment."""
    candidates: dict[str, list[str]]
    """Columns that may have a role of which none was chosen."""


def preview(
    source: Any, columns: ForceColumns | Mapping[str, Any] | Path | str | None = None
) -> Preview:
    """First rows of a table and the guesses of :func:`read_forces`, whether it refuses it or not.

    Raises
    ------
    InputError
        If it holds no rows of numbers, or an option is wrong.
    """
    found = _Reading(source, ForceColumns.of(columns))
    table = found.table
    written = [table.units.get(name) or unit for name, (_, unit) in found.parts.items()]
    return Preview(
        list(found.parts),
        [unit_named(unit or "") for unit in written],
        table.frame.head(PREVIEW_ROWS).to_numpy().tolist(),
        found.names,
        {role: found._like(role) for role in KIND if role not in found.names},
    )


def _name_of(source: Any) -> str:
    return str(source) if isinstance(source, str | Path) else type(source).__name__


def _table(source: Any) -> Table:
    if isinstance(source, str | Path):
        return read_table(Path(source))
    return source if isinstance(source, Table) else table_of(source)


class _Reading:
    """One table on its way to forces, with what was guessed and what is wrong."""

    kinds = KIND
    unit_keys: ClassVar = {"angle": "theta_unit", "force": "unit"}
    """Option that names the unit of a kind."""

    def __init__(self, source: Any, given: ForceColumns, units: Columns | None = None) -> None:
        self.given, self.units, self.source = given, units or given, _name_of(source)
        self.table = _table(source)
        self.names: dict[str, str] = {}
        self.wrong: list[str] = []
        self.notes: list[str] = []
        self.parts = {name: _split(str(name)) for name in self.table.frame.columns}
        self._choose()

    def refuse(self, sentence: str) -> NoReturn:
        """Raise InputError that names the table."""
        raise InputError(f"{self.source}: {sentence}")

    # -- columns ---------------------------------------------------------------------------------

    def _choose(self) -> None:
        """Find the column of each role: as given, by our own names, or by a guess."""
        guessed, lacking = [], []
        timed = self.given.rate_deg_s is not None
        for role in ("time" if timed else "theta", "fx", "fz", "moment"):
            column = getattr(self.given, role)
            if column is not None:
                self._take(role, column)
                continue
            own = dict(zip(ROLES, CSV_COLUMNS, strict=True)).get(role)
            if own in self.parts:
                self.names[role] = str(own)
                continue
            found = self._like(role)
            if role == "moment":  # not needed: only if there is no doubt
                found = [n for n in found if len(found) == 1 and n not in self.table.words]
            if len(found) == 1:
                self.names[role] = found[0]
                if role == "moment" and math.isnan(self._unit(role)[1]):
                    del self.names[role]
                    continue
                guessed.append(f"{_WORDS[role]} from '{found[0]}' [{self._unit(role)[0]}]")
            elif found:
                listed = " or ".join(f"'{name[:40]}'" for name in found[:4])
                self.wrong.append(
                    f"{_WORDS[role]} may be {listed}; add --columns '{role}={found[0]}'"
                )
            elif role != "moment":
                lacking.append(role)
        if "moment" in self.names and {"fx", "fz"} & {*lacking}:
            rest = [n for n in self.parts if n not in self.names.values()]
            rest = [n for n in rest if not re.fullmatch(f"{NO_FORCE}|{_NAMES['time']}", n.lower())]
            if self.given.moment is not None or not rest:
                without = [_WORDS[role] for role in lacking if role != "theta"]
                beware = (
                    "" if len(without) == 1 else " It cannot show a wrong leg or a wrong scale."
                )
                self.notes.append(
                    f"The moment is used in place of {' and '.join(without)}.{beware}"
                )
                lacking = [role for role in lacking if role == "theta"]
        if lacking:
            self._ask(lacking, timed)
        if guessed:
            self.notes.append(f"{GUESSED}{', '.join(guessed)}.")
        for role in self.names:
            self._check(role)
        bare = [role for role in ("fx", "fz") if role in self.names and not self._written(role)]
        if bare and self.given.unit is None:
            self.notes.append("The forces have no unit, and are taken as N.")
        alone = "moment" in self.names and not {"fx", "fz"} <= {*self.names}
        if alone and not self._written("moment"):
            self.notes.append("The moment has no unit, and is taken as N m.")

    def _take(self, role: str, column: str) -> None:
        """The column of a name, which may lack its unit."""
        same = [name for name, (bare, _) in self.parts.items() if column in (name, bare)]
        if len(same) == 1 or column in same:
            self.names[role] = column if column in same else same[0]
        else:
            header = list(self.parts)
            hint = f"it fits {' and '.join(map(repr, same))}" if same else nearest(column, header)
            self.wrong.append(f"no column '{column[:40]}' for {role}; {hint[:200]}")

    def _like(self, role: str) -> list[str]:
        """Columns whose names fit a role."""
        plain = {
            name: re.sub(r"[\W_]+", "", bare.lower()) for name, (bare, _) in self.parts.items()
        }
        taken = set(self.names.values())

        def fitting(pattern: str, *, whole: bool) -> list[str]:
            match = re.fullmatch if whole else re.search
            return [n for n, text in plain.items() if match(pattern, text) and n not in taken]

        found = fitting(_NAMES[role], whole=True)
        found = found or (fitting(_LOOSE[role], whole=False) if role in _LOOSE else [])
        if role == "theta" and not found:  # the one whose unit is that of an angle
            units = {
                n: unit_named(self.table.units.get(n) or self.parts[n][1] or "") for n in plain
            }
            found = [n for n, unit in units.items() if unit in KINDS["angle"] and n not in taken]
            found = [n for n in found if not re.search(OTHER_ANGLE, plain[n])]
        return found

    def _ask(self, lacking: list[str], timed: bool) -> None:
        """Complain about roles without a column."""
        header = list(self.parts)
        listed = ", ".join(f"'{name[:30]}'" for name in header[:8])
        unnamed = len(header) >= len(lacking) and all(name.startswith("column ") for name in header)
        names = header if unnamed else ["NAME"] * len(lacking)
        pairs = ",".join(f"{role}={name}" for role, name in zip(lacking, names, strict=False))
        more = ", or rate_deg_s=RATE for a time" if "theta" in lacking and not timed else ""
        if "theta" in lacking and self._like("sinkage"):
            more += "; of a plate or ball pressed in, give --tool plate:MM or FILE@plate:MM"
        if "moment" in self.names and {"fx", "fz"} & {*lacking}:
            more += f", or 'moment={self.names['moment']}' to do without a force"
        self.wrong.append(
            f"no column of {', '.join(_WORDS[role] for role in lacking)} among {listed}; add "
            f"--columns '{pairs}'{more}"
        )

    def _unit(self, role: str) -> tuple[str, float]:
        """Unit of a column and what it is in N, degrees, seconds or N m; NaN if it is unknown."""
        kind = self.kinds[role]
        unit = getattr(self.units, self.unit_keys.get(kind, ""), None)
        unit = unit or unit_named(self._written(role) or next(iter(KINDS[kind])))
        return (unit, KINDS[kind][unit]) if unit in KINDS[kind] else ("?", math.nan)

    def _written(self, role: str) -> str | None:
        """Unit of a column as the table has it."""
        column = self.names[role]
        return self.table.units.get(column) or self.parts[column][1]

    def _check(self, role: str) -> None:
        """Complain about words among the numbers of a column, and about its unit."""
        column, kind = self.names[role][:40], self.kinds[role]
        words = self.table.words.get(self.names[role], [])
        if words:
            (place, cell), more = words[0], f" and {len(words) - 1} more" if len(words) > 1 else ""
            self.wrong.append(
                f"{place}: {column} = {cell[:30]!r}{more} is not a number; leave the cell blank or "
                "remove the row"
            )
        if math.isnan(self._unit(role)[1]):
            key = self.unit_keys.get(kind)
            remedy = f"add --columns {key}=UNIT" if key else "rename it"
            self.wrong.append(
                f"column '{column}': '{self._written(role)}' is no known unit of {kind}; {remedy}, "
                f"one of {', '.join(KINDS[kind])}"
            )

    # -- numbers ---------------------------------------------------------------------------------

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the forces that the table has."""
        return tuple(axis for axis in "xz" if f"f{axis}" in self.names)

    def values(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """θ [deg], force [N] (row, axis) and moment [N m] of the rows that are whole."""
        column = {role: self._column(role) for role in self.names}
        soil = -1.0 if self.given.force_on == "soil" else 1.0
        signs = {"x": self.given.fx_sign, "z": self.given.fz_sign}
        count = len(self.table.frame)
        force = np.array([soil * signs[a] * column[f"f{a}"] for a in self.axes])
        force = force.reshape(len(self.axes), count).T
        rate = self.given.rate_deg_s or 1.0
        along = column["theta"] if "theta" in column else rate * column["time"]
        theta = self.given.theta_sign * (along + self.given.theta_offset_deg)
        whole = np.isfinite(theta) & np.isfinite(force).all(axis=1)
        moment = column.get("moment", np.full(count, np.nan))
        if len(self.axes) < 2:
            whole &= np.isfinite(moment)
        if not whole.any():
            self.refuse("no row has all that is needed; check the columns")
        if not whole.all():
            first = self.table.place(int(np.flatnonzero(~whole)[0]))
            self.notes.append(
                f"{(~whole).sum()} of {len(whole)} rows lack a number and are left out, the first "
                f"at {first}."
            )
        theta, force, moment = theta[whole], force[whole], moment[whole]
        if np.ptp(theta) > 360.0 or np.abs(np.diff(theta)).max(initial=0.0) > 180.0:
            # The encoder counts turns, or starts again at a full one.
            theta = np.where(np.abs(theta) > 180.0, (theta + 180.0) % 360.0 - 180.0, theta)
        theta, force, moment = self._without_glitches(theta, force, moment)
        largest = float(np.abs(theta).max())
        if "theta" in self.names and self._unit("theta")[0] == "deg" and largest < LEAST_DEG:
            self.refuse(
                f"the angle runs from {theta.min():.2f} to {theta.max():.2f}, which must be "
                "radians; add --columns theta_unit=rad"
            )
        return theta, force, moment

    def _without_glitches(self, *columns: FloatArray) -> tuple[FloatArray, ...]:
        """Columns without the rows in which the angle jumps away and is back in the next."""
        theta = columns[0]
        if _scattered(theta):
            return columns
        around = np.median(np.stack([theta[:-2], theta[1:-1], theta[2:]]), axis=0)
        apart = (theta[1:-1] - around + 180.0) % 360.0 - 180.0
        kept = np.ones(len(theta), dtype=bool)
        kept[1:-1] = np.abs(apart) <= TURN_DEG
        if not kept.all():
            self.notes.append(f"{(~kept).sum()} rows in which the angle jumps are left out.")
        return tuple(column[kept] for column in columns)

    def _column(self, role: str) -> FloatArray:
        """A column in N, degrees, seconds or N m."""
        _, factor = self._unit(role)
        return np.asarray(factor * self.table.frame[self.names[role]].to_numpy(np.float64))

    def tared(
        self, theta: FloatArray, force: FloatArray, moment: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Forces and moment less what they read while the leg is in air; noted."""
        low, high = self.given.air_before_deg, self.given.air_after_deg
        air = (theta < (-np.inf if low is None else low)) | (
            theta > (np.inf if high is None else high)
        )
        if _scattered(theta) or not air.any():
            return force, moment
        whole = np.isfinite(moment).all()
        values = np.column_stack([force, moment]) if whole else force
        names = [(name, CHANNEL_UNITS[name]) for name in (*(f"F{a}" for a in self.axes), "M")]
        found = baseline(theta, values, air, names[: values.shape[1]])
        self.notes += found.notes
        values = values - found.values
        return values[:, : len(self.axes)], values[:, -1] if whole else moment

    # -- strokes ---------------------------------------------------------------------------------

    def strokes(self, theta: FloatArray, force: FloatArray) -> list[Any]:
        """Rows of each stroke in which θ grows."""
        every = np.arange(len(theta))
        if _scattered(theta):
            return [every]
        moving = ~at_rest(theta)
        every, theta, force = every[moving], theta[moving], force[moving]
        turns = _turns(theta)
        pieces = [slice(a, b + 1) for a, b in pairwise(turns)]
        pieces = [p for p in pieces if p.stop - p.start > FEWEST_ROWS]  # not where it jumps back
        up = [p for p in pieces if theta[p][-1] - theta[p][0] >= LEAST_STROKE_DEG]
        down = [p for p in pieces if theta[p][0] - theta[p][-1] >= LEAST_STROKE_DEG]
        up, down = (up, down) if up else (down, [])
        if not up or (not down and _covered(theta, up) > 0.9 * sum(np.ptp(theta[p]) for p in up)):
            return [every]  # one stroke, or parts of one

        def size(of: list[slice]) -> float:
            return float(np.median([np.sqrt(np.square(force[p]).mean()) for p in of]))

        if down and size(down) > HEAVIER * size(up):
            self.refuse(
                "the forces are larger while the angle falls, so the leg goes that way; add "
                f"--columns theta_sign={-self.given.theta_sign}"
            )
        if down:
            self.notes.append("The leg goes forth and back; the way back is left out.")
        if len(up) > 1:
            self.notes.append(f"{len(up)} strokes in one table, taken as trials in one soil.")
        return [every[p] for p in up]

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
            f"the angle runs from {low:.0f} to {high:.0f}° and the forces from {begins:.0f} to "
            f"{ends:.0f}°, but it is zero where the leg hangs down; add --columns "
            f"theta_offset_deg={offset:g}{turned}"
        )


_WORDS = {"theta": "theta", "fx": "Fx", "fz": "Fz", "moment": "the moment", "time": "the time"}
_WORDS |= {"sinkage": "the sinkage", "force": "the force", "pressure": "the pressure"}


class Pressed(NamedTuple):
    """A body pressed in, in the order of time."""

    sinkage: FloatArray
    """Positive into the soil, from the zero of the table [m]."""
    force: FloatArray
    """Up on the body [N]."""
    rows: int
    """Number of rows of the table."""
    notes: list[str]
    """What was guessed and left out."""


def read_pressed(source: Any, area: float, columns: Any = None) -> Pressed:
    """Read sinkage and force, or pressure on an area [m²]; columns, units and signs are guessed.

    Raises
    ------
    InputError
        With what is wrong with the table.
    """
    found = _PressReading(source, PressColumns.of(columns))
    if found.wrong:
        found.refuse("; ".join(found.wrong))
    role = "force" if "force" in found.names else "pressure"
    sinkage, force = found._column("sinkage"), found._column(role)
    force = force * (area if role == "pressure" else 1.0)
    whole = np.isfinite(sinkage) & np.isfinite(force)
    if not whole.all():
        found.notes.append(f"{(~whole).sum()} of {len(whole)} rows lack a number and are left out.")
    sinkage, force = sinkage[whole], force[whole]
    if len(force) < FEWEST_ROWS or np.ptp(force) == 0.0 or np.ptp(sinkage) == 0.0:
        found.refuse(f"{len(force)} rows with a sinkage and a force; {FEWEST_ROWS} that differ "
                     "are needed")  # fmt: skip
    if force[np.abs(force).argmax()] < 0.0:  # the soil presses up
        force = -force
        found.notes.append("The force is negative in the soil: its sign is turned.")
    course = float(np.corrcoef(sinkage, force)[0, 1])
    # A force that falls with depth, as of a hard layer, decides nothing: the larger end is below.
    if course < -0.5 or (course < 0.5 and -sinkage.min() > sinkage.max()):
        sinkage = -sinkage
        found.notes.append("The sinkage is negative in the soil: its sign is turned.")
    return Pressed(sinkage, force, len(whole), found.notes)


class _PressReading(_Reading):
    """One table of a body that is pressed in."""

    kinds = PRESSED
    unit_keys: ClassVar = {
        "length": "sinkage_unit", "force": "unit", "pressure": "pressure_unit"
    }  # fmt: skip

    def __init__(self, source: Any, columns: PressColumns) -> None:
        super().__init__(source, ForceColumns(), columns)

    def _choose(self) -> None:
        """Find sinkage and force, or the pressure."""
        given: dict[str, str] = self.units.model_dump(include=set(PRESSED), exclude_none=True)
        if {"force", "pressure"} <= given.keys():
            self.wrong.append("--columns names a force and a pressure; one of them is needed")
        for role, column in given.items():
            self._take(role, column)
        for role in PRESSED if not self.wrong else ():
            # One of force and pressure does; what is given goes first.
            borne = {"force", "pressure"} - {role} if role != "sinkage" else set()
            found = [] if role in given or borne & {*self.names} else self._like(role)
            if len(found) == 1:
                self.names[role] = found[0]
            elif found:
                listed = " or ".join(f"'{name[:40]}'" for name in found[:4])
                self.wrong.append(
                    f"{_WORDS[role]} may be {listed}; add --columns '{role}={found[0]}'"
                )
        listed = ", ".join(f"'{name[:30]}'" for name in [*self.parts][:8])
        if not self.wrong and not ("sinkage" in self.names and len(self.names) > 1):
            lacking = "force or pressure" if "sinkage" in self.names else "sinkage"
            key = lacking.partition(" ")[0]
            self.wrong.append(
                f"no column of {lacking} among {listed}; add --columns '{key}=NAME', or name the "
                "columns such as sinkage_mm and force_N or pressure_kPa"
            )
        for role in self.names:
            self._check(role)
            key = self.unit_keys[PRESSED[role]]
            if not (self._written(role) or getattr(self.units, key)):
                unit = {"sinkage": "mm", "force": "N", "pressure": "kPa"}[role]
                self.wrong.append(
                    f"column '{self.names[role][:40]}' has no unit; add --columns {key}={unit}, or "
                    f"name it such as {role}_{unit}"
                )
        guessed = [
            f"{_WORDS[role]} from '{name}'" for role, name in self.names.items()
            if role not in given
        ]  # fmt: skip
        if guessed:
            self.notes.append(f"{GUESSED}{', '.join(guessed)}.")


def _split(header: str) -> tuple[str, str | None]:
    """Name and unit of a column from its header, such as ``Force X (N)`` or ``Fz_N``."""
    match = re.fullmatch(r"(.*?)\s*[\[({<]\s*([^\])}>]*)\s*[\])}>]", header)
    if match and match[1]:
        return match[1].strip(), match[2] or None
    for pattern in (r"(.+?)\s+in\s+(.+)", r"(.+?)\s*[/,]\s*(.+)", r"(.+?)[_\s]+([^_\s]+)"):
        match = re.fullmatch(pattern, header)
        if match and unit_named(match[2]) and match[2] not in ("h", "u", "g"):
            return match[1].strip(), match[2]
    return header, None


def _scattered(theta: FloatArray) -> bool:
    """Whether the rows have no order in the angle, or are too few to have one."""
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


def _covered(theta: FloatArray, pieces: list[slice]) -> float:
    """Part of the path that any of the pieces covers [deg]."""
    ends = np.array(sorted((theta[p].min(), theta[p].max()) for p in pieces)).reshape(-1, 2)
    reached = np.maximum.accumulate(ends[:, 1])
    starts = np.maximum(ends[:, 0], np.concatenate([[-np.inf], reached[:-1]]))
    return float(np.maximum(ends[:, 1] - starts, 0.0).sum())


def _increasing(theta: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows in the order of θ; averaged in bins if θ does not grow from row to row."""
    if np.all(np.diff(theta) > 0.0):
        return theta, values
    order = np.argsort(theta, kind="stable")
    theta, values = theta[order], values[order]
    if np.all(np.diff(theta) > 0.1 * BIN_DEG):
        return theta, values
    _, first, count = np.unique(
        np.floor(theta / BIN_DEG + 0.5), return_index=True, return_counts=True
    )
    means = np.add.reduceat(np.column_stack([theta, values]), first) / count[:, None]
    return means[:, 0], means[:, 1:]
