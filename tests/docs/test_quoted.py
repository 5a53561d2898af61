"""Paths, options, make targets and names in backticks exist, in pages and in docstrings."""

from __future__ import annotations

import fnmatch
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path

import click

from terraphi.cli.main import cli

ROOT = Path(__file__).parents[2]
FOLDERS = ("src", "docs", "tests", "studies", "examples", "verification", "benchmarks", "packaging")
PAGES = [ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY")] + [
    page for page in sorted((ROOT / "docs").rglob("*.md")) if "auto_notebooks" not in page.parts
]
MODULES = [module for folder in FOLDERS for module in sorted((ROOT / folder).rglob("*.py"))]
FENCE = re.compile(r"^ *(```|~~~).*?^ *\1", re.DOTALL | re.MULTILINE)
SPAN = re.compile(r"(?<![`}:\w])(`{1,2})([^`\n]+)\1(?!`)")  # no roles: Sphinx checks these
DOCSTRING = re.compile(r'"""(.*?)"""', re.DOTALL)
ENDINGS = ("py", "md", "toml", "csv", "nc", "xml", "msg", "json", "txt", "yaml", "html", "tif")
# A word in capitals stands for any name.
PLACEHOLDER = re.compile(r"(?<![A-Za-z])[A-Z]{3,}(?![a-z])|(?<=-)K(?=\.)")

FOREIGN_OPTIONS = {
    "--extra": "of uv",
    "--group": "of pip and uv",
    "--editable": "of pip",
}
FOREIGN_PATHS = {
    "columns.toml": "of a user",
    "high.toml": "of a user",
    "rig.toml": "of a user, or written by demo",
    "soil.csv": "written by footfalls --out soil.nc",
    "demo-output/walk.csv": "written by demo",
    "walk/truth.nc": "written by examples/go2_walk.py",
    "data/anymal_state_actuator.tar": "of a mission of GrandTour",
}


def files() -> list[Path]:
    """Files of the repository that are not built."""
    below = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*")]
    built = {"_build", "__pycache__", "auto_notebooks"}
    return [
        path for path in (*ROOT.iterdir(), *below) if path.is_file() and not built & {*path.parts}
    ]


def endings_of(path: str) -> set[str]:
    """A path, and what is left of it without its first folders."""
    parts = path.split("/")
    return {"/".join(parts[k:]) for k in range(len(parts))}


TREE = {
    each.relative_to(ROOT).as_posix()
    for path in files()
    for each in (path, *path.parents)
    if ROOT in each.parents
}
TAILS = set[str]().union(*map(endings_of, TREE))
TOPS = {path.split("/")[-1] for path in TREE if path.count("/") <= 2 and "." not in path}
"""Names of folders that a path may start with: those of the repository, and of src/terraphi."""
SOURCES = {
    module.relative_to(ROOT).as_posix(): module.read_text(encoding="utf-8") for module in MODULES
}
LITERALS = set(re.findall(r"[\"']([\w.-]+)[\"']", "\n".join(SOURCES.values())))
"""Words in quotes in the code, such as the names of files that it writes."""
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def options_of(command: click.Command) -> set[str]:
    """Options of a command and of those below it."""
    below = command.commands.values() if isinstance(command, click.Group) else ()
    names = {name for each in command.params for name in (*each.opts, *each.secondary_opts)}
    return names.union(*(options_of(each) for each in below)) | {"--help"}


OPTIONS = options_of(cli)


def exists(path: str) -> bool:
    """Whether a path, from the root or from any folder, is in the repository or written by it."""
    stem = path.rstrip("/")
    if stem in TAILS or ("/" not in stem and {stem, stem.rsplit(".", 1)[0]} & LITERALS):
        return True
    pattern = PLACEHOLDER.sub("*", stem)
    return "*" in pattern and bool(fnmatch.filter(TAILS, pattern))


def is_path(word: str) -> bool:
    """Whether a word of code is to be a path of the repository."""
    if not re.fullmatch(r"[\w*][\w.*-]*(/[\w.*-]+)*/?", word):
        return False
    ending = word.rsplit(".", 1)[-1] if "." in word else ""
    return ending in ENDINGS or ("/" in word and word.split("/")[0] in TOPS)


SCRIPTS = {
    ending: source
    for module, source in SOURCES.items()
    if "add_argument(" in source or "click.option(" in source
    for ending in endings_of(module)
}
"""Sources of scripts that have options, by their paths."""


def scripts_in(text: str) -> str:
    """The sources of all scripts that a text names."""
    named = {*re.findall(r"[\w/]+\.py\b", text)}
    return "\n".join(SCRIPTS[name] for name in named & SCRIPTS.keys())


def wrong(text: str, source: str = "") -> Iterator[str]:
    """What is in backticks in a text and does not exist.

    Options are those of terraphi, of ``source`` and of the scripts that the text names. A file of
    the reader's is shown in a block of code of the same text, or is one of :data:`FOREIGN_PATHS`.
    """
    source += scripts_in(text)
    blocks = "\n".join(match[0] for match in FENCE.finditer(text))
    users = {*re.split(r"[\s=,\"'()@:]+", blocks)} | FOREIGN_PATHS.keys()
    for match in SPAN.finditer(FENCE.sub("", text)):
        span = match[2]
        for target in re.findall(r"(?:^|\s)make ([a-z-]+)", span):
            if not re.search(rf"^{target}:", MAKEFILE, re.MULTILINE):
                yield f"make {target}"
        is_command = span.startswith("terraphi ")
        for word in re.split(r"[\s=,]+", span):
            if re.match(r"--[a-z]", word):
                if not (word in OPTIONS or word in FOREIGN_OPTIONS or f'"{word}"' in source):
                    yield word
            elif re.fullmatch(r"terraphi(\.\w+)+", word):
                try:
                    pkgutil.resolve_name(word)
                except (AttributeError, ImportError):
                    yield word
            elif not word.endswith(".py") and (is_command or word in users):
                continue
            elif is_path(word) and not exists(word):
                yield word


def test_what_pages_and_docstrings_quote_exists() -> None:
    missing = {}
    for page in PAGES:
        if words := list(wrong(page.read_text(encoding="utf-8"))):
            missing[page.relative_to(ROOT).as_posix()] = words
    for module, source in SOURCES.items():
        text = "\n\n".join(DOCSTRING.findall(source))
        if words := list(wrong(text, source)):
            missing[module] = words
    assert not missing
