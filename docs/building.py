"""What the documentation needs beside Sphinx's own: figures, formulas, tables of keys."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from docutils.utils.math import latex2mathml
from sphinx_gallery.scrapers import figure_rst

from terraphi.experiment.files import replacing
from terraphi.view.keys import DOCUMENTS, markdown

HERE = Path(__file__).parent


def figures(_block: Any, variables: dict[str, Any], conf: dict[str, Any]) -> str:
    """Save the figures that a block of a notebook has made, and show them.

    terraphi's figures are made without pyplot, which Sphinx-Gallery's own scraper looks at.
    """
    from matplotlib.figure import Figure

    known = variables.setdefault("figures_shown", set())
    paths = []
    for value in variables["example_globals"].values():
        if isinstance(value, Figure) and id(value) not in known:
            known.add(id(value))
            path = next(variables["image_path_iterator"])
            value.savefig(path, dpi=110)
            paths.append(path)
    # One below the other: side by side, nobody could read them.
    return "".join(figure_rst([path], conf["src_dir"]) for path in paths)


def inline_math(translator: Any, node: Any) -> None:
    """Write a formula as MathML, which browsers draw without a script from elsewhere."""
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
            with replacing(path) as temporary:
                temporary.write_text(text, encoding="utf-8")
