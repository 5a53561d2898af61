"""The first five minutes: help, examples, completion, and what is said to a slip of the finger."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from terraphi.cli import options
from terraphi.cli.main import cli
from terraphi.experiment.leg import LEG_SHAPES
from terraphi.inference import inversion
from terraphi.robot import footfall_fit, forces
from terraphi.view import keys

PROGRAM = Path(sys.executable).with_name("terraphi")


def commands(command: click.Command = cli, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    yield path
    if isinstance(command, click.Group):
        for name, inner in command.commands.items():
            yield from commands(inner, (*path, name))


@pytest.mark.parametrize("path", list(commands()), ids=" ".join)
def test_every_help_has_an_example_of_its_own(path, terraphi) -> None:
    status, out, _ = terraphi(*path, "--help")
    assert status == 0
    assert " ".join(["Example: terraphi", *path]) in " ".join(out.split())


@pytest.mark.parametrize("path", list(commands()), ids=" ".join)
def test_every_option_says_what_it_does(path) -> None:
    command: click.Command = cli
    for name in path:
        assert isinstance(command, click.Group)
        command = command.commands[name]
    for option in command.params:
        assert not isinstance(option, click.Option) or option.help, option.name


@pytest.mark.parametrize(
    ("words", "right"),
    [
        (["invrt", "x.csv"], "invert"),
        (["library", "shwo", "rft3d"], "show"),
        (["invert", "x.csv", "--densty", "1600"], "--density"),
        (["study", "recovry"], "recovery"),
        (["simulate", "quik"], "quick"),
        (["keys", "scenaro"], "scenario"),
        (["invert", "li2013:yuma/strait"], "li2013:yuma/straight"),
        (["library", "show", "rtf3d"], "rft3d"),
        (["library", "suggest", "rft3d", "--leg", "plat"], "plate"),
        (["forces", "walk.csv", "--estimator", "quasi_statc"], "quasi_static"),
        (["forces", "walk.csv", "--frame", "worl"], "world"),
        (["invert", "li2013:yuma/c", "--discrepancy", "no"], "none"),
        (["invert", "li2013:yuma/c", "--leg", "reverse_c"], "reversed_c"),
        (["invert", "li2013:yuma/c", "--library", "rft3d", "--sampler", "emcee3"], "emcee"),
        (["invert", "li2013:yuma/c", "--library", "rft3d", "--likelihood", "papr"], "paper"),
    ],
)
def test_a_slip_is_answered_with_the_right_name(words, right, terraphi) -> None:
    status, out, err = terraphi(*words)
    assert status == 2
    assert out == ""
    assert right in err
    assert "Traceback" not in err


def test_a_choice_is_refused_in_one_sentence(terraphi) -> None:
    status, out, err = terraphi("invert", "absent.csv", "--sampler", "emce")
    assert (status, out) == (2, "")
    assert err == "terraphi: unknown sampler 'emce'; did you mean 'emcee'?\n"
    err = terraphi("convert", "0.5", "--from", "newtn").err
    assert err == "terraphi: unknown simulator 'newtn'; did you mean 'newton'?\n"


def test_choices_are_those_of_the_rooms_that_take_them() -> None:
    assert options.LEGS == LEG_SHAPES
    assert options.LIKELIHOODS == inversion.LIKELIHOODS
    assert options.SAMPLERS == inversion.SAMPLERS
    assert options.DISCREPANCIES == inversion.DISCREPANCIES
    assert options.ESTIMATORS == forces.ESTIMATORS
    assert options.FRAMES == forces.FRAMES
    assert tuple(footfall_fit.LAW_SETS) == options.LAW_SETS
    assert set(options.DOCUMENTS) == set(keys.DOCUMENTS)


def test_help_of_invert_groups_its_options_and_lists_their_choices(terraphi) -> None:
    _, out, _ = terraphi("invert", "--help")
    what, how, output = (
        out.index(f"\n{name}:\n") for name in ("What is inverted", "How", "Output")
    )
    assert what < out.index("--leg [straight|c|reversed_c|plate]") < how
    assert how < out.index("--sampler [quadrature|emcee]") < output < out.index("--out PATH")
    named = re.findall(r"^  (?:-\w, )?(--[a-z]+)", out, flags=re.MULTILINE)
    command = cli.commands["invert"]
    wanted = [o.opts[-1] for o in command.params if isinstance(o, click.Option)]
    assert sorted(named) == sorted([*wanted, "--help"])


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_script_of_each_shell(shell: str) -> None:
    environment = {**os.environ, "_TERRAPHI_COMPLETE": f"{shell}_source"}
    done = subprocess.run(
        [PROGRAM], env=environment, capture_output=True, text=True, check=True, timeout=60
    )
    assert "_TERRAPHI_COMPLETE" in done.stdout


@pytest.mark.parametrize(
    ("words", "offered", "not_offered"),
    [
        ("terraphi in", "invert", "simulate"),
        ("terraphi invert --lib", "--library", "--leg"),
        ("terraphi invert --library rf", "rft3d", "quick-paper"),
        ("terraphi invert --leg s", "straight", "plate"),
        ("terraphi invert --sampler e", "emcee", "quadrature"),
        ("terraphi forces --frame h", "heading", "body"),
        ("terraphi keys pl", "plan", "robot"),
        ("terraphi study rec", "recovery", "k0"),
        ("terraphi simulate pap", "paper-1", "quick"),
        ("terraphi library build quick-k", "quick-k0-half", "rft3d"),
        ("terraphi simulate mine", "file,mine", "quick"),
    ],
)
def test_tab_completes(words: str, offered: str, not_offered: str) -> None:
    number = len(words.split()) - 1
    environment = {
        **os.environ,
        "_TERRAPHI_COMPLETE": "bash_complete",
        "COMP_WORDS": words,
        "COMP_CWORD": str(number),
    }
    done = subprocess.run(
        [PROGRAM], env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    lines = done.stdout.splitlines()
    assert offered in {*lines, *(line.partition(",")[2] for line in lines)}
    assert not any(not_offered in line for line in lines)


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_bash_takes_the_completion() -> None:
    line = f'eval "$(_TERRAPHI_COMPLETE=bash_source {PROGRAM})" && complete -p terraphi'
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert "_terraphi_completion" in done.stdout
