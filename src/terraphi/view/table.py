"""A table of words and numbers, for a terminal and for pages."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from terraphi.experiment.errors import visible

if TYPE_CHECKING:
    from rich.table import Table as RichTable

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

    def terminal(self) -> RichTable:
        """The columns for a terminal, without title and note."""
        from rich import box
        from rich.table import Table as RichTable

        made = RichTable(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
        for name, numeric in zip(self.header, self.numeric, strict=True):
            made.add_column(name, justify="right" if numeric else "left")
        for row in self.rows:
            made.add_row(*map(visible, row))
        return made
