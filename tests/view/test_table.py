"""One table, shown in three ways."""

from __future__ import annotations

import io
import re
from xml.etree import ElementTree as ET

import pytest
from markdown_it import MarkdownIt
from rich.console import Console

from terraphi.view.table import Table

TABLE = Table(
    "Peaks",
    ("leg", "peak", "where"),
    [("c", "7.2 N", "at -36°"), ("a|b", "-", "<b>"), ("d", "−12.0 N", "")],
)


def cells(html: str) -> list[list[str]]:
    """Texts of a table in HTML, row by row, as an XML parser reads them."""
    tree = ET.fromstring(f"<all>{html}</all>")
    return [["".join(cell.itertext()) for cell in row] for row in tree.iter("tr")]


EVERYTHING = [list(TABLE.header), *(list(row) for row in TABLE.rows)]


def test_html_has_every_cell_as_text() -> None:
    assert cells(TABLE.html()) == EVERYTHING


def test_markdown_has_every_cell() -> None:
    html = MarkdownIt("commonmark", {"html": False}).enable("table").render(TABLE.markdown())
    assert cells(html) == EVERYTHING


def test_bars_that_are_quoted_already_stay_as_they_are() -> None:
    assert Table("", ("a",), [(r"`x \| y`",)]).markdown().splitlines()[-1] == r"| `x \| y` |"


def test_numbers_are_aligned_to_the_right_wherever_they_are_shown() -> None:
    seen = io.StringIO()
    Console(file=seen, width=80, markup=False).print(TABLE.terminal())
    lines = seen.getvalue().splitlines()
    ends = {re.search(pattern, line).end() for pattern, line in
            [(r"peak", lines[0]), (r"7\.2 N", lines[2]), (r"−12\.0 N", lines[4])]}  # fmt: skip
    assert len(ends) == 1
    assert re.findall(r'<td class="number">(.*?)</td>', TABLE.html()) == ["7.2 N", "-", "−12.0 N"]


@pytest.mark.parametrize("column", [["1", "2 m"], ["18 to 20"], ["", "-"]])
def test_words_and_ranges_are_aligned_to_the_left(column: list[str]) -> None:
    assert Table("", ("",), [[cell] for cell in column]).numeric() == [False]


def test_without_names_of_columns_there_is_no_head() -> None:
    assert "<thead>" in TABLE.html()
    assert "<thead>" not in Table("", ("", ""), [("a", "b")]).html()


def test_a_note_stands_below_in_a_page() -> None:
    assert Table("", ("a",), [("1",)], "x < y").html().endswith('<p class="note">x &lt; y</p>')


def test_cells_of_records_are_written_by_formats_or_functions() -> None:
    columns = (("x", "{x:.1f} N"), ("of", "{of[Fz]}"), ("more", lambda one: "-" * one["x"]))
    table = Table.of("t", columns, [{"x": 2, "of": {"Fz": "a"}}])
    assert (table.title, table.header) == ("t", ("x", "of", "more"))
    assert table.rows == [("2.0 N", "a", "--")]
