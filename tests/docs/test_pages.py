"""README and docs: every command shown exists, with its options, and every link leads somewhere."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from terraphi.cli.main import cli

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"```console\n(.*?)```", re.DOTALL)
PYTHON = re.compile(r"```python\n(.*?)```", re.DOTALL)
LINK = re.compile(r"\]\((?!https?:|#)([^)#\s]+)")


def commands(text: str) -> list[list[str]]:
    """The arguments of each `$ terraphi …` of a page."""
    shown = re.findall(r"^\$ terraphi (.*)$", "\n".join(BLOCK.findall(text)), re.MULTILINE)
    return [shlex.split(line, comments=True) for line in shown]


def unknown(arguments: list[str]) -> list[str]:
    """Words of a command that are no command or option of terraphi."""
    command: click.Command = cli
    words = list(arguments)
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        name = words.pop(0)
        if name not in command.commands:
            return [name]
        command = command.commands[name]
    options = {name for each in command.params for name in (*each.opts, *each.secondary_opts)}
    return [word for word in words if re.match(r"--?[a-z]", word) and word not in options]


def test_commands_and_links_of_all_pages_exist() -> None:
    wrong = {}
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        words = [word for shown in commands(text) for word in unknown(shown)]
        words += [link for link in LINK.findall(text) if not (page.parent / link).exists()]
        if words:
            wrong[page.relative_to(ROOT).as_posix()] = words
    assert not wrong


def test_lines_of_the_readme_run_in_their_order_in_an_empty_folder(
    terraphi: Callable[..., Any], tmp_path: Path
) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for arguments in commands(text):
        ran = terraphi(*arguments)
        assert ran.status == 0, ran.err
        assert "isfit" not in ran.out
    answers = [json.loads(path.read_text()) for path in Path("demo-output").glob("*/answer.json")]
    reference = [answer for answer in answers if answer["law"] == "rft3d"]
    assert sorted(answer["law"] for answer in answers) == ["legs", "legs", "rft3d"]
    low, high = reference[0]["phi_deg"]["ci95"]
    assert low <= 33.0 <= high
    assert reference[0]["verdict"] == "consistent"
    assert Path("demo-output", "demo.png").stat().st_size > 20_000
    shown = terraphi("report", "demo-output", "--out", "r.html", "--json")
    assert len(json.loads(shown.out)["results"]) == 3
    for block in PYTHON.findall(text):
        exec(block, {})
    left = {path.name for path in tmp_path.iterdir()}
    assert left >= {"demo-output", "my-answer", "soil.nc", "answer.png"}
