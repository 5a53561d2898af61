"""Pages of the studies: a table, two sentences and a figure, written into the docs."""

from __future__ import annotations

import argparse
import csv
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from terraphi.experiment.bodies import OUTLINES

ROOT = Path(__file__).parent
LIBRARIES = ROOT / "data" / "libraries"
DOCS = ROOT.parent / "docs"
LEGS = dict(zip(OUTLINES, ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00"), strict=False))
"""Shapes of legs, and their colours in all pictures."""
WIDEST = 6
"""Columns of a table on a page; wider tables go into a CSV file next to it."""
NUMBER = r"[-+]?\d+(\.\d+)?"
UNITS = {"°": "deg", " %": "%", "%": "%", " kPa": "kPa", " Pa": "Pa", " mm": "mm"}
"""Endings of cells, and the units that they stand for."""


def out_from(description: str) -> Path:
    """Folder of the page, from the command line."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the page [docs]")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    return out


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Format a table in Markdown, of :data:`WIDEST` columns at most."""
    if len(header) > WIDEST:
        raise ValueError(f"{len(header)} columns: {header}")
    lines = [header, ["---"] * len(header), *([str(cell) for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def excerpt(
    out: Path, name: str, header: Sequence[str], rows: Iterable[Sequence[object]],
    shown: Sequence[str] = (), filled: str = "", words: str = "",
) -> str:  # fmt: skip
    """Write a table to NAME.csv, and format some of its columns for the page.

    The page leaves out rows without a value in the column ``filled``; without any column it has the
    line that names the file alone. ``words`` on the file stand there in place of "All columns". In
    the file a unit that all cells of a column share stands in the header.
    """
    cells = [[str(cell) for cell in row] for row in rows]
    columns = dict(zip(header, map(list, zip(*cells, strict=True)), strict=True))
    selected = [header.index(key) for key in shown]
    page = table(shown, [[row[k] for k in selected] for row in cells
                         if not filled or row[header.index(filled)]])  # fmt: skip
    plain = {}
    for key, column in columns.items():
        shared = [s for s in UNITS if all(re.fullmatch(rf"({NUMBER}{s})?", c) for c in column)]
        suffix = shared[0] if any(column) and shared else ""
        unit = f" [{UNITS[suffix]}]" if suffix else ""
        plain[key + unit] = [cell.removesuffix(suffix) for cell in column]
    with (out / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([[*plain], *zip(*plain.values(), strict=True)])
    words = words or f"All {'rows and ' * bool(filled)}columns"
    return f"{page}\n\n" * bool(shown) + f"{words}: [{name}.csv]({name}.csv)."


def write(
    out: Path, name: str, title: str, parts: Sequence[str], figure: Figure | None = None,
    alt: str = "", script: str = "",
) -> None:  # fmt: skip
    """Write NAME.md and, of a figure, NAME.png; print the page.

    Parameters
    ----------
    out, name
        Folder and name.
    title, parts
        Heading, and paragraphs and tables.
    figure, alt
        Picture, and what it shows in words.
    script
        That writes it, if it is not called as the page is.
    """
    pictures = []
    if figure is not None:
        figure.savefig(out / f"{name}.png", dpi=150)
        pictures = [f"![{alt}]({name}.png)"]
    made = f"Written by `python studies/{script or f'{name}.py'}`."
    text = "\n\n".join([f"# {title}", *parts, *pictures, made]) + "\n"
    (out / f"{name}.md").write_text(text, encoding="utf-8")
    print(text)
