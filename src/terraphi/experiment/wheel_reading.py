"""A wheel's slip, load and sinkage, and what else was measured, from a table as people have it."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.reading import WHEEL, ColumnReader, Columns, ForceUnit
from terraphi.experiment.tables import ToolTable

SPEEDS = ("wheel_speed", "rotation", "travel_speed")
"""Columns from which the slip follows."""
MEASURED = ("pull", "torque")
"""Values that stand in for a sinkage that was not measured."""
PERCENT = 1.5
"""Median of the slip's size above which it must be in percent [-]."""
EITHER = 0.05
"""Slip below zero up to which both definitions are alike, within 0.0025 [-]."""
MOST_WRONG = 0.5
"""Share of rows with a fault above which a table is refused [-]; chosen."""


class WheelColumns(Columns):
    """Which columns of a table of a wheel are what, and their units."""

    slip: str | None = None
    """Column of the slip; if not given, it is guessed, or follows from both speeds."""
    slip_is: Literal["driven", "travel"] | None = None
    """How a slip below zero is defined: `driven`, 1 - v / (ω R) as above zero, without an end; or
    `travel`, ω R / v - 1, of which -1 is a locked wheel."""
    wheel_speed: str | None = None
    """Column of the speed of the rim, ω R."""
    rotation: str | None = None
    """Column of the rate of rotation ω, in place of the speed of the rim."""
    travel_speed: str | None = None
    """Column of the speed v at which the wheel travels."""
    load: str | None = None
    """Column of the vertical load on the wheel."""
    sinkage: str | None = None
    """Column of the sinkage of the rim, with lugs of their tips."""
    pull: str | None = None
    """Column of the drawbar pull, negative where the wheel is pushed or towed."""
    torque: str | None = None
    """Column of the torque that drives the wheel."""
    side: str | None = None
    """Column of the side force."""
    side_slip: str | None = None
    """Column of the angle of side slip, between where the wheel points and where it moves."""
    travel: str | None = None
    """Column of the way travelled."""
    time: str | None = None
    """Column of the time."""
    speed_unit: Literal["m/s", "cm/s", "mm/s", "m/min", "km/h"] | None = None
    """Unit of both speeds; if not given, that of the header."""
    rotation_unit: Literal["rad/s", "deg/s", "rpm"] | None = None
    """Unit of the rotation; if not given, that of the header."""
    slip_unit: Literal["part", "%"] | None = None
    """Unit of the slip, a part of one or percent; if not given, that of the header, else a part."""
    sinkage_unit: Literal["mm", "cm", "m", "in", "ft"] | None = None
    """Unit of the sinkage; if not given, that of the header."""
    unit: ForceUnit | None = None
    """Unit of the forces; if not given, that of the header."""


def read_rolled(source: Any, radius: float, columns: Any = None) -> ToolTable:
    """Read the rows of a wheel of a radius to its lugs' tips [m]; columns and units are guessed.

    Raises
    ------
    InputError
        With what is wrong with the table.
    """
    reader = _WheelTable(source, WheelColumns.of(columns))
    reader.refuse_wrong()
    values = {role: reader.column(role) for role in reader.names}
    if "slip" not in values:
        values["slip"] = reader.slip_of_speeds(values, radius)
    needed = ("sinkage",) if "sinkage" in values else [r for r in MEASURED if r in values]
    numeric = [values[role] for role in ("slip", "load", *needed)]
    full = np.asarray(np.isfinite(numeric).all(axis=0))
    if not full.any():
        reader.refuse(f"no row has a slip, a load and a {' and a '.join(needed)}")
    values.setdefault("sinkage", np.full(full.size, np.nan))
    if "slip" in reader.names:
        values["slip"] = reader.checked_slip(values["slip"], full)
    # What no wheel has is left out where it is rare, as a spike of a sensor.
    wrong = reader.wrong_rows(values, radius)
    kept = full & ~wrong
    faults = {"lack a number": ~full, "have what no wheel has": full & wrong}
    for fault, which in faults.items():
        if which.any():
            reader.notes.append(f"{which.sum()} of {full.size} rows {fault} and are left out.")
    unused = [name for name in reader.parts if name not in reader.names.values()]
    if unused:
        reader.notes.append(f"Not used: {', '.join(unused[:8])}.")
    if "side" in reader.names and "side_slip" not in reader.names:
        reader.notes.append("A side force without an angle of side slip: taken as none.")
    values = {role: column[kept] for role, column in values.items() if role not in SPEEDS}
    values["side_slip"] = np.nan_to_num(values.get("side_slip", np.zeros(int(kept.sum()))))
    return ToolTable(values, full.size, reader.notes)


class _WheelTable(ColumnReader[WheelColumns]):
    """A table of a wheel."""

    def __init__(self, source: Any, given: WheelColumns) -> None:
        """Find the columns: as given, or by their names."""
        super().__init__(source, given)
        chosen = self.find(WHEEL, lambda role: role in SPEEDS and "slip" in self.names)
        self._ask()
        units = {"sinkage": "mm", "load": "N", "rotation": "rad/s"}
        self.settle(chosen, units | dict.fromkeys(("wheel_speed", "travel_speed"), "m/s"))

    def _ask(self) -> None:
        """Complain about what is missing."""
        if self.wrong:
            return
        rim = "wheel_speed" in self.names or "rotation" in self.names
        if "slip" not in self.names and not (rim and "travel_speed" in self.names):
            options = "'slip=NAME', or 'rotation=NAME,travel_speed=NAME'"
            self.wrong.append(f"no column of the slip among {self.header}; add --columns {options}")
        if "load" not in self.names:
            lacked = f"no column of the load among {self.header}"
            self.wrong.append(f"{lacked}; add --columns 'load=NAME'")
        if not {"sinkage", *MEASURED} & {*self.names}:
            lacked = f"no column of the sinkage among {self.header}, nor of pull or torque"
            self.wrong.append(f"{lacked}; add --columns 'sinkage=NAME'")

    def written(self, column: str) -> str | None:
        """Unit of a column as the table has it; of a slip in parts of one there is none."""
        unit = super().written(column)
        return None if unit in ("-", "1", "m/m") else unit

    def slip_of_speeds(self, values: dict[str, FloatArray], radius: float) -> FloatArray:
        """Slip from the speed of the rim and that of travel [-]."""
        rim = values["wheel_speed"] if "wheel_speed" in values else radius * values["rotation"]
        travel = values["travel_speed"]
        if np.nanmedian(rim) < 0.0 and np.nanmedian(travel) < 0.0:
            rim, travel = -rim, -travel
        still = np.maximum(rim, travel) < 1e-6
        fastest = np.where(still, np.nan, np.maximum(rim, travel))
        if "rotation" in values:
            self.notes.append(f"The rim's speed is the rotation times {1e3 * radius:g} mm.")
        return np.asarray((rim - travel) / fastest)

    def checked_slip(self, slip: FloatArray, full: BoolArray) -> FloatArray:
        """Slip as the law has it [-]; raises InputError if its definition is in doubt."""
        name, there = self.names["slip"][:40], slip[full]
        if np.median(np.abs(there)) > PERCENT and self.unit("slip")[0] == "part":
            reaches = f"column '{name}' reaches {there.max():g}, in percent"
            self.refuse(f"{reaches}; {self.mend('slip', '%')}")
        if there.min() < -EITHER and self.given.slip_is is None:
            options = "slip_is=driven for 1 - v/(ωR) there, or slip_is=travel for ωR/v - 1"
            self.refuse(f"column '{name}' falls to {there.min():g}; add --columns {options}")
        if self.given.slip_is == "driven":
            # 1 − v/(ωR) = s gives ωR/v − 1 = 1/(1 − s) − 1.
            return np.where(slip < 0.0, 1.0 / (1.0 - slip) - 1.0, slip)
        return slip

    def wrong_rows(self, values: dict[str, FloatArray], radius: float) -> BoolArray:
        """Rows that no wheel has, shape [row]; raises InputError if they are most of them."""
        load, sunk, slip = (values[role] for role in ("load", "sinkage", "slip"))
        sentences = {
            "the load is negative; give it positive, as what the soil carries": load <= 0.0,
            f"the sinkage reaches {1e3 * np.fmax.reduce(sunk):.4g} mm, beyond the radius of "
            f"{1e3 * radius:g} mm; check its unit, its zero and the wheel": sunk >= radius,
            "the sinkage is negative; give it positive into the soil": sunk <= 0.0,
            "the slip is beyond -1 and 1; check its unit and definition": np.abs(slip) > 1.0,
        }
        for sentence, wrong in sentences.items():
            if wrong.mean() > MOST_WRONG:
                self.refuse(sentence)
        return np.asarray(np.any([*sentences.values()], axis=0))
