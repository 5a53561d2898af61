"""A table for people, as a terminal, a page in Markdown and a page in HTML show it."""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table as RichTable

_NUMBER = re.compile(r"[-+−]?\d+(\.\d+)?( ?[%°]| N)?")
_NOTHING = ("", "-", "–")
"""Cells that say nothing about what their column holds."""
LONG = 24
"""Rows above which a table may be split where a page ends."""


Column = tuple[str, str | Callable[[Any], str]]
"""A column's name, and a cell of it: a format string over a record's keys, or a function of it."""


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    title
        What it shows; empty for none.
    header
        Names of the columns, with units where the cells have none.
    rows
        Cells as people read them, as many a row as there are columns.
    note
        What a reader should know about it.
    wide, folded
        In a page: whether it takes the whole width of its section, and whether it is folded away.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    wide: bool = False
    folded: bool = False
    part: str = field(default="table", init=False)

    @classmethod
    def of(
        cls, title: str, columns: Sequence[Column], records: Iterable[Mapping[str, Any]]
    ) -> Table:
        """A table with a row for each record."""
        rows = [
            tuple(
                cell.format_map(one) if isinstance(cell, str) else cell(one) for _, cell in columns
            )
            for one in records
        ]
        return cls(title, tuple(name for name, _ in columns), rows)

    def numeric(self) -> list[bool]:
        """Whether each column holds numbers alone, and so is aligned to the right."""
        columns = [
            [str(row[i]) for row in self.rows if row[i] not in _NOTHING]
            for i in range(len(self.header))
        ]
        return [bool(cells) and all(map(_NUMBER.fullmatch, cells)) for cells in columns]

    def terminal(self) -> RichTable:
        """The columns for a terminal, without title and note."""
        from rich import box
        from rich.table import Table as RichTable

        made = RichTable(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
        for name, numeric in zip(self.header, self.numeric(), strict=True):
            made.add_column(name, justify="right" if numeric else "left")
        for row in self.rows:
            made.add_row(*row)
        return made

    def markdown(self) -> str:
        """The columns in Markdown, without title and note; cells may hold Markdown."""
        lines = [self.header, ["---"] * len(self.header), *self.rows]
        return "\n".join(f"| {' | '.join(map(_unlike_an_edge, line))} |" for line in lines)

    def html(self) -> str:
        """The columns and the note in HTML, without the title; every cell stays text."""
        looks = [' class="number"' if numeric else "" for numeric in self.numeric()]
        size = ' class="long"' if len(self.rows) > LONG else ""
        lines = [f'<div class="scroll"><table{size}>']
        if any(self.header):
            names = (
                f'<th scope="col"{look}>{_text(name)}</th>'
                for name, look in zip(self.header, looks, strict=True)
            )
            lines.append(f"<thead><tr>{''.join(names)}</tr></thead>")
        lines.append("<tbody>")
        for first, *others in self.rows:
            cells = (
                f"<td{look}>{_text(cell)}</td>"
                for cell, look in zip(others, looks[1:], strict=True)
            )
            lines.append(f'<tr><th scope="row">{_text(first)}</th>{"".join(cells)}</tr>')
        lines.append("</tbody></table></div>")
        if self.note:
            lines.append(f'<p class="note">{_text(self.note)}</p>')
        return "\n".join(lines)


def _unlike_an_edge(cell: str) -> str:
    """A cell whose vertical bars, but those that are quoted already, are not taken for edges."""
    return re.sub(r"(?<!\\)\|", r"\\|", cell)


def _text(value: object) -> str:
    return html.escape(str(value))
