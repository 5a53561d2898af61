"""README and docs: every command shown exists, with its options, and every link leads somewhere."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest

from terraphi.cli.main import cli

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"```console\n(.*?)```", re.DOTALL)
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_commands_and_links_of_a_page_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not [wrong for shown in commands(text) for wrong in unknown(shown)]
    assert not [link for link in LINK.findall(text) if not (page.parent / link).exists()]
