r"""Run what the pages show, and compare what comes out with what they say.

    python docs/run_pages.py [--write] [--slow] PAGE...

runs the blocks of each page, in order and in a folder of its own: ``console`` (lines after ``$``),
``python`` (one namespace a page; a ``text`` block right after it is what it prints) and files. With
``--write`` what came out takes the place of what was shown.

A comment before a block says more of it::

    <!-- file: NAME -->        the block is the file NAME
    <!-- exit: 2 -->           the last command of the block ends with this status
    <!-- slow -->              minutes, or tens of seconds: only with --slow
    <!-- drawn -->             numbers rest on random draws, and on the processor's rounding
    <!-- in: checkout -->      needs files of the checkout: examples/ is linked into the folder
    <!-- not run: REASON -->   not to be run here

In what is shown, a line ``...`` stands for any lines. Decimal numbers may differ by one in their
last digit, numbers that were drawn by 2 % or five in their last digit; everything else must be the
same, but for the width of blanks and rules. Forecasts, which are of the machine, are left out.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import itertools
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
ROOT = DOCS.parent
ANY = "..."
GENERATED = {
    "verification.md", "sensitivity.md", "resolution.md",
    "calibration.md", "calibration-k4-plane-strain.md", "spacing.md",
}  # fmt: skip
"""Pages that studies write; tests of those studies look after them."""
RUN = {"console", "python"}
INERT = {"text", ""}
"""Languages of blocks that are no code: pictures, formats, and what code prints."""

FORECAST = re.compile(r"terraphi: forecast: ")
_FENCE = re.compile(r"^(?P<fence>`{3,})(?P<info>.*)$")
_COMMENT = re.compile(r"^<!-- (?P<word>file|exit|slow|drawn|in|not run)(?:: (?P<value>.*))? -->$")
_TOKEN = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|─+|[^\s\d─]+")


class PageError(AssertionError):
    """What a page shows is not what comes out."""


@dataclass
class Block:
    """A fenced block of a page.

    Attributes
    ----------
    language
        First word after the fence.
    first, last
        Lines of its content, counted from 0; ``last`` is that of the closing fence.
    lines
        Its content.
    options
        Comments before it, word to value.
    """

    language: str
    first: int
    last: int
    lines: list[str]
    options: dict[str, str] = field(default_factory=dict)


def hand_written() -> list[Path]:
    """Every page that people write, with the README."""
    pages = [p for p in DOCS.rglob("*.md") if not {"_build", "gallery"} & set(p.parts)]
    kept = [p for p in pages if p.name not in GENERATED and not p.name.endswith("-keys.md")]
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(kept)]


def blocks(text: str) -> list[Block]:
    """Fenced blocks of a page, in order; directives of MyST are none."""
    found: list[Block] = []
    options: dict[str, str] = {}
    lines = text.split("\n")
    number = 0
    while number < len(lines):
        comment, fence = _COMMENT.match(lines[number]), _FENCE.match(lines[number])
        if comment:
            options[comment["word"]] = comment["value"] or ""
        elif fence:
            end = next(
                i for i in range(number + 1, len(lines)) if lines[i].startswith(fence["fence"])
            )
            if not fence["info"].startswith("{"):
                language = fence["info"].strip()
                found.append(Block(language, number + 1, end, lines[number + 1 : end], options))
            options, number = {}, end
        elif lines[number].strip():
            options = {}
        number += 1
    return found


# -- comparing -----------------------------------------------------------------------------------


def same(shown: list[str], came: list[str], *, drawn: bool = False) -> bool:
    """Whether what came out is what is shown, as nearly as numbers that were drawn can be."""
    alike = _alike_drawn if drawn else _alike
    chunks: list[list[str]] = [[]]
    for line in shown:
        if line.strip() == ANY:
            chunks.append([])
        else:
            chunks[-1] += _TOKEN.findall(line)
    tokens = [token for line in came for token in _TOKEN.findall(line)]
    at = _find(chunks[0], tokens, 0, alike, anchored=True)
    if len(chunks) == 1:
        return at == len(tokens)
    for chunk in chunks[1:-1]:
        at = _find(chunk, tokens, at, alike, anchored=False) if at >= 0 else -1
    end = len(tokens) - len(chunks[-1])
    return at >= 0 and end >= at and _find(chunks[-1], tokens, end, alike, anchored=True) >= 0


def _find(
    chunk: list[str],
    tokens: list[str],
    start: int,
    alike: Callable[[str, str], bool],
    *,
    anchored: bool,
) -> int:
    """Where the first match of a chunk ends, or -1."""
    last = start if anchored else len(tokens) - len(chunk)
    for at in range(start, last + 1):
        there = tokens[at : at + len(chunk)]
        if len(there) == len(chunk) and all(map(alike, chunk, there)):
            return at + len(chunk)
    return -1


def _alike(shown: str, came: str) -> bool:
    if shown == came or (shown[0] == came[0] == "─"):
        return True
    try:
        one, other = (float(word.replace("−", "-")) for word in (shown, came))
    except ValueError:
        return False
    mantissa, _, exponent = shown.lower().partition("e")
    _, point, decimals = mantissa.partition(".")
    if not point:
        return one == other
    return abs(one - other) < 1.5 * 10.0 ** (int(exponent or 0) - len(decimals))


def _alike_drawn(shown: str, came: str) -> bool:
    if _alike(shown, came):
        return True
    try:
        one, other = (float(word.replace("−", "-")) for word in (shown, came))
    except ValueError:
        return False
    mantissa, _, exponent = shown.lower().partition("e")
    last_digit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    return abs(one - other) <= max(0.02 * abs(one), 5.0 * last_digit)


# -- running -------------------------------------------------------------------------------------


@dataclass
class Page:
    """A page that is being run.

    Attributes
    ----------
    path
        The page.
    folder
        Where it is run.
    write
        Whether what comes out takes the place of what was shown.
    slow
        Whether slow blocks are run.
    """

    path: Path
    folder: Path
    write: bool = False
    slow: bool = False

    def run(self) -> None:
        """Run all blocks; raises PageError at the first that is not as shown."""
        text = self.path.read_text(encoding="utf-8")
        lines = text.split("\n")
        found = blocks(text)
        namespace: dict[str, Any] = {"__name__": "__main__"}
        changes: list[tuple[Block, list[str]]] = []
        with contextlib.chdir(self.folder):
            for block, after in itertools.zip_longest(found, found[1:]):
                if "not run" in block.options or ("slow" in block.options and not self.slow):
                    continue
                if "in" in block.options and not Path("examples").exists():
                    Path("examples").symlink_to(ROOT / "examples")
                if "file" in block.options:
                    Path(block.options["file"]).write_text("\n".join([*block.lines, ""]))
                elif block.language == "console":
                    changes.append((block, self._console(block)))
                elif block.language == "python":
                    came = _python("\n".join(block.lines), namespace)
                    follows = after and after.language == "text" and _adjacent(lines, block, after)
                    if after and follows:
                        changes.append((after, self._compared(after, after.lines, came)))
        if self.write:
            for block, came in reversed(changes):
                lines[block.first : block.last] = came
            self.path.write_text("\n".join(lines), encoding="utf-8")

    def _console(self, block: Block) -> list[str]:
        """Run the commands of a block; its lines as they should be."""
        made: list[str] = []
        steps = _steps(block.lines)
        for number, (command, shown) in enumerate(steps):
            status, came = _shell(command)
            wanted = int(block.options.get("exit", 0)) if number == len(steps) - 1 else 0
            if status != wanted:
                self._fail(block, f"{command}\nended with status {status}, not {wanted}", came)
            made += [f"$ {line}" if not i else line for i, line in enumerate(command.split("\n"))]
            made += self._compared(block, shown, came) if shown else []
        return made

    def _compared(self, block: Block, shown: list[str], came: list[str]) -> list[str]:
        if self.write and ANY not in shown:
            return came
        if same(shown, came, drawn="drawn" in block.options):
            return shown
        self._fail(block, "shown:\n" + "\n".join(shown), came)
        raise AssertionError  # never reached

    def _fail(self, block: Block, what: str, came: list[str]) -> None:
        place = f"{self.path.relative_to(ROOT)}, line {block.first + 1}"
        raise PageError(f"{place}: {what}\ncame out:\n" + "\n".join(came))


def _adjacent(lines: list[str], block: Block, after: Block) -> bool:
    """Whether only blank lines lie between two blocks."""
    return not any(line.strip() for line in lines[block.last + 1 : after.first - 1])


def _steps(lines: list[str]) -> list[tuple[str, list[str]]]:
    """Commands and what is shown after each; a line that ends in a backslash goes on."""
    found: list[tuple[str, list[str]]] = []
    goes_on = False
    for line in lines:
        if goes_on:
            command, _ = found.pop()
            found.append((f"{command}\n{line}", []))
        elif line.startswith("$ "):
            found.append((line[2:], []))
        else:
            found[-1][1].append(line)
        goes_on = line.endswith("\\") and not found[-1][1]
    return found


def _python(code: str, namespace: dict[str, Any]) -> list[str]:
    """Run a block of Python; the lines that it printed."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(code, "page", "exec"), namespace)
    return _lines(out.getvalue())


def _shell(command: str) -> tuple[int, list[str]]:
    """Run a command; its status and the lines that it printed on either stream."""
    words = shlex.split(command)
    if words[0] == "terraphi" and not re.search(r"[|><;&$]", command):
        return _terraphi(words)
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-c", command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment,
        timeout=1200,
        check=False,
    )
    return done.returncode, _lines(done.stdout)


def _terraphi(words: list[str]) -> tuple[int, list[str]]:
    """Run our own command here, which saves the time to start Python."""
    from terraphi.cli.main import main

    out, before, status = io.StringIO(), sys.argv, 0
    sys.argv = words
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            main()
    except SystemExit as leaving:
        status = int(leaving.code or 0)
    finally:
        sys.argv = before
    return status, _lines(out.getvalue())


def _lines(text: str) -> list[str]:
    lines = [line.rstrip() for line in text.rstrip().split("\n") if not FORECAST.match(line)]
    return lines if any(lines) else []


def run_page(path: Path, *, write: bool = False, slow: bool = False) -> None:
    """Run a page in a temporary folder; raises PageError if it does not show what comes out."""
    with tempfile.TemporaryDirectory() as folder:
        Page(path, Path(folder), write=write, slow=slow).run()


def main() -> None:
    """Run pages from the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pages", nargs="*", type=Path, help="all, if not given")
    parser.add_argument("--write", action="store_true", help="write what comes out into the pages")
    parser.add_argument("--slow", action="store_true", help="run slow blocks as well")
    given = parser.parse_args()
    for page in [p.resolve() for p in given.pages] or hand_written():
        run_page(page, write=given.write, slow=given.slow)


if __name__ == "__main__":
    main()
