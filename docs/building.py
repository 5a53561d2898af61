"""Formulas as MathML, tables of keys, and the gallery of examples, for Sphinx."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from docutils.utils.math import latex2mathml
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

import browser  # in this folder
from terraphi.experiment.files import atomic_write
from terraphi.view.keys import DOCUMENTS, HEADER, tables

HERE = Path(__file__).parent
EXAMPLES = ("own_forces", "calibration", "own_leg", "own_log", "map", "export", "grains", "paper")
"""Scripts of notebooks/ in the order of the gallery."""


def inline_math(translator: Any, node: Any) -> None:
    """Write a formula as MathML, which browsers draw without a script."""
    _math(translator, node, block=False)


def display_math(translator: Any, node: Any) -> None:
    """Write a formula that stands by itself."""
    _math(translator, node, block=True)


def _math(translator: Any, node: Any, *, block: bool) -> None:
    from docutils.nodes import SkipNode

    # TeX takes \tfrac12 for a half; docutils would take it for twelve over what follows.
    formula = re.sub(r"(\\[dt]?frac)\s*(\d)\s*(\d)", r"\1{\2}{\3}", node.astext())
    tree = latex2mathml.tex2mathml(formula, as_block=block)
    translator.body.append(f'<div class="math">{tree}</div>' if block else str(tree))
    raise SkipNode


def write_keys(_app: Any) -> None:
    """Write the tables of keys, from the models that read them."""
    for name in DOCUMENTS:
        path = HERE / "reference" / f"{name}-keys.md"
        text = markdown(name)
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            with atomic_write(path) as temporary:
                temporary.write_text(text, encoding="utf-8")


def write_package(app: Any, error: Exception | None) -> None:
    """Write what the page try.md loads: the package, its laws as arrays of NumPy, its metadata."""
    if error is None and app.builder.format == "html":
        browser.write(Path(app.outdir) / "_static" / "terraphi.zip")


def place(script: str) -> int:
    """Place of an example in the gallery."""
    return EXAMPLES.index(Path(script).stem)


def figures(_block: Any, script: dict[str, Any], settings: Any) -> str:
    """Save the figure that a block of an example ends with, and return how to show it."""
    last = script["example_globals"].get("___")
    if not isinstance(last, Figure) or last is script.get("shown"):
        return ""
    script["shown"] = last
    path = next(script["image_path_iterator"])
    last.savefig(path, dpi=150)
    return str(figure_rst([path], settings["src_dir"]))


def markdown(document: str) -> str:
    """Tables of a document as a page, from the second level of headings down."""
    parts = []
    for one in tables(document):
        title, _, about = one.title.partition(": ")
        rows = [
            (f"`{row[0]}`", *(cell.replace("<", "&lt;") for cell in row[1:])) for row in one.rows
        ]
        lines = [HEADER, ["---"] * len(HEADER), *rows]
        cells = [[re.sub(r"(?<!\\)\|", r"\\|", cell) for cell in line] for line in lines]
        table = "\n".join(f"| {' | '.join(line)} |" for line in cells)
        parts += [f"## `{title}`", about, table]
    return "\n\n".join(parts) + "\n"
