"""How the documentation is built: ``make docs``."""

from __future__ import annotations

import importlib.metadata
import re
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import building  # noqa: E402 - in this folder

project = "terraphi"
author = "The terraphi developers"
copyright = "The terraphi developers, BSD-3-Clause"  # noqa: A001 - Sphinx reads this name
release = importlib.metadata.version("terraphi")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
]
root_doc = "index"
exclude_patterns = ["_build", "notebooks", "reference/*-keys.md"]
nitpicky = False
smartquotes = False  # it would make a dash of the -- of options

myst_enable_extensions = ["attrs_block", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_inherit_docstrings = False
autodoc_preserve_defaults = True
autosummary_generate = False
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = True

# Scripts of notebooks/ are run, and become pages and .ipynb files in auto_notebooks/.
sphinx_gallery_conf = {
    "examples_dirs": "notebooks",
    "gallery_dirs": "auto_notebooks",
    "filename_pattern": "",  # all of them
    "abort_on_example_error": True,
    "backreferences_dir": "auto_notebooks/backreferences",  # minigallery wants one
    "download_all_examples": False,
    "inspect_global_variables": False,
    "ignore_repr_types": "Figure",  # the scraper saves them
    "image_scrapers": ("building.figures",),
    "min_reported_time": 1e9,
    "minigallery_sort_order": "building.place",
    "remove_config_comments": True,
    "show_signature": False,
    "thumbnail_size": (720, 300),
    "within_subsection_order": "building.place",
    "write_computation_times": False,
}

# A prompt is not a part of a command, and neither is what the command prints.
copybutton_prompt_text = "$ "
copybutton_line_continuation_character = "\\"

html_theme = "furo"
html_title = f"terraphi {release}"
html_static_path = ["_static"]
html_css_files = ["terraphi.css"]
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
html_math_renderer = "mathml"
pygments_style = "friendly"
pygments_dark_style = "github-dark"

# Fx stands for the same force in more than one class; a reference to it leads to either.
suppress_warnings = ["config.cache", "ref.python"]


def plain_bars(_app: Any, _what: str, _name: str, _object: Any, _options: Any, lines: Any) -> None:
    """Keep |θ| in docstrings from being read as a substitution, and tables as line blocks."""
    text = "\n".join(lines)
    table = re.compile(r"(?:^\|.*\|\n?)+", re.MULTILINE)
    text = table.sub(lambda found: "::\n\n" + re.sub("^", "    ", found[0], flags=re.M), text)
    bars = re.compile(r"(?<!`)\|(?=[^\s|`](?:[^|`\n]*[^\s|`])?\|)")
    lines[:] = [s if s.startswith("    |") else bars.sub(r"\\|", s) for s in text.split("\n")]


def one_name_each(
    _app: Any, _what: str, _name: str, _object: Any, _options: Any, lines: Any
) -> None:
    """Give each of several names with one description its own, as attributes need."""
    several = re.compile(r"^(\w+(?:, \w+)+)\n((?:    .*(?:\n|$))+)", re.MULTILINE)
    text = several.sub(
        lambda found: "".join(f"{name}\n{found[2]}" for name in found[1].split(", ")),
        "\n".join(lines),
    )
    lines[:] = text.split("\n")


def examples_as_code(_app: Any, _context: Any, lines: list[str]) -> None:
    """Set the example of a command's help as code."""
    lines[:] = [re.sub(r"^(\s*Example: )(.+)$", r"\1``\2``", line) for line in lines]


def setup(app: Any) -> None:
    """Connect our own functions."""
    app.connect("autodoc-process-docstring", one_name_each, priority=100)
    app.connect("autodoc-process-docstring", plain_bars, priority=900)
    app.connect("sphinx-click-process-description", examples_as_code)
    app.connect("builder-inited", building.write_keys)
    app.connect("build-finished", building.write_package)
    app.add_html_math_renderer(
        "mathml", (building.inline_math, None), (building.display_math, None)
    )
