"""Force over sinkage of a body pressed in, from a table as people have it."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from terraphi.experiment.arrays import block_means
from terraphi.experiment.reading import FEWEST_ROWS, PRESSED, ColumnReader, Columns, ForceUnit
from terraphi.experiment.tables import ToolTable

BLOCKS, EXCHANGED, FEWEST_EXCHANGED = 100, 0.02, 3
"""Blocks of rows, and the share and number of their steps in which a body rises while its force
grows, from which both columns are taken as exchanged if a force that falls on a body that sinks is
ten times as rare. Of 105 records (grains, plates on sands) all are found when exchanged, none as
they are, nor with 0.5 mm of noise in the sinkage; with 0.2 mm and 5 averaged forces 2."""


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
    sinkage_zero: float = 0.0
    """Value of the column where the body touches the surface [its unit]: 120 where a height falls
    from there to 75."""
    unit: ForceUnit | None = None
    """Unit of the force; if not given, that of the header."""
    pressure_unit: Literal["kPa", "Pa", "MPa", "bar", "psi"] | None = None
    """Unit of the pressure; if not given, that of the header."""


def read_pressed(source: Any, area: float | None, columns: Any = None) -> ToolTable:
    """Read sinkage and force, or pressure on an area [m²]; columns, units and signs are guessed.

    A ball has no area, and a pressure is refused.

    Raises
    ------
    InputError
        With what is wrong with the table.
    """
    reader = ColumnReader(source, PressColumns.of(columns))
    # One of force and pressure does; what is given goes first.
    either = {"force", "pressure"}
    chosen = reader.find(PRESSED, lambda role: role in either and bool(either & {*reader.names}))
    if not reader.wrong and not ("sinkage" in reader.names and len(reader.names) > 1):
        lacking = "force or pressure" if "sinkage" in reader.names else "sinkage"
        lacked = f"no column of {lacking} among {reader.header}"
        reader.wrong.append(f"{lacked}; add --columns '{lacking.partition(' ')[0]}=NAME'")
    reader.settle(chosen, {"sinkage": "mm", "force": "N", "pressure": "kPa"})
    reader.refuse_wrong()
    role = "force" if "force" in reader.names else "pressure"
    zero = reader.given.sinkage_zero * reader.unit("sinkage")[1]
    sinkage, force = reader.column("sinkage") - zero, reader.column(role)
    if role == "pressure":
        if area is None:
            remedy = "give its force, or --tool plate:DIAMETER of a plate"
            reader.refuse(f"'{reader.names[role]}' is a pressure, and a ball has none; {remedy}")
        force = force * area
    full = np.isfinite(sinkage) & np.isfinite(force)
    if not full.all():
        reader.notes.append(f"{(~full).sum()} of {len(full)} rows lack a number and are left out.")
    sinkage, force = sinkage[full], force[full]
    if len(force) < FEWEST_ROWS or np.ptp(force) == 0.0 or np.ptp(sinkage) == 0.0:
        reader.refuse(
            f"{len(force)} rows have sinkage and force; {FEWEST_ROWS} that differ are needed"
        )
    if force[np.abs(force).argmax()] < 0.0:  # the soil presses up
        force = -force
        reader.notes.append("The force is negative in the soil: its sign is turned.")
    course = float(np.corrcoef(sinkage, force)[0, 1])
    # A force that falls with depth, as of a hard layer, decides nothing: the larger end is below.
    if course < -0.5 or (course < 0.5 and -sinkage.min() > sinkage.max()):
        sinkage = -sinkage
        reader.notes.append("The sinkage is negative in the soil: its sign is turned.")
    # Soil yields under a body that sinks; no soil lifts a body that presses on it more. Means over
    # blocks of rows, of which noise in the sinkage leaves little.
    first = np.unique(np.linspace(0, len(force), BLOCKS, endpoint=False, dtype=int))
    sinking, growth = (np.diff(block_means(values, first)) for values in (sinkage, force))
    lifted, yielded = (((d * sinking < 0.0) & (d * growth > 0.0)).sum() for d in (1.0, -1.0))
    if lifted >= max(FEWEST_EXCHANGED, EXCHANGED * growth.size, 10.0 * yielded):
        where = f"the body rises while its force grows in {lifted} of {growth.size} steps"
        reader.refuse(f"{where}; check whether sinkage and {role} are exchanged, or average rows")
    return ToolTable({"sinkage": sinkage, "force": force}, len(full), reader.notes)
