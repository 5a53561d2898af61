"""Pages of the studies: a table, two sentences and a figure, written into the docs."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

ROOT = Path(__file__).parent
LIBRARIES = ROOT / "data" / "libraries"
DOCS = ROOT.parent / "docs"
LEGS = {"straight": "#0072b2", "c": "#d55e00", "reversed_c": "#009e73"}
"""Shapes of legs, and their colours in all pictures."""


def out_from(description: str) -> Path:
    """Folder of the page, from the command line."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the page [docs]")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    return out


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [header, ["---"] * len(header), *([str(cell) for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


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
