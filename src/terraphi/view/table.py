"""A table of words and numbers, for a terminal and for pages."""

from __future__ import annotations

import itertools
import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from terraphi.experiment.errors import visible

_NUMBER = re.compile(r"[-+−]?\d+(\.\d+)?( ?[%°]| N)?|[-–]?")


@dataclass(frozen=True)
class Table:
    """A table of words and formatted numbers.

    Attributes
    ----------
    title
        What it shows; empty for none.
    header
        Names of the columns, with units where the cells have none.
    rows
        Cells, as many a row as there are columns.
    note
        A remark below it.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""

    @property
    def numeric(self) -> list[bool]:
        """Whether each column holds numbers alone, and so is aligned to the right."""
        return [
            bool(self.rows) and all(_NUMBER.fullmatch(str(row[i])) for row in self.rows)
            for i in range(len(self.header))
        ]

    def terminal(self, width: float = math.inf) -> str:
        """The columns for a terminal of some width, without title and note.

        Where they are wider, the widest column is wrapped, to twenty letters at least.
        """
        rows = [[visible(str(cell)) for cell in row] for row in (self.header, *self.rows)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        widest, whole = widths.index(max(widths)), sum(widths) + 2 * len(widths) - 2
        if whole > width:
            widths[widest] = min(widths[widest], max(20, int(widths[widest] + width - whole)))
        lines = []
        for row in rows:
            parts = [[cell] for cell in row]
            parts[widest] = textwrap.wrap(row[widest], widths[widest])
            for cells in itertools.zip_longest(*parts, fillvalue=""):
                placed = [
                    f"{cell:{'>' if numeric else '<'}{room}}"
                    for cell, numeric, room in zip(cells, self.numeric, widths, strict=True)
                ]
                lines.append("  ".join(placed).rstrip())
            if row is rows[0]:
                lines.append("─" * (sum(widths) + 2 * len(widths) - 2))
        return "\n".join(lines)
