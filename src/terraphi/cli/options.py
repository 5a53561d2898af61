"""Options and types of options that commands share."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from terraphi.experiment.errors import InputError, nearest
from terraphi.view.console import listen


class _Plain(click.ParamType[Any]):
    """A number as data files have it: not what only Python takes for one, as ``1_000``, nor ∞."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """The number."""
        from terraphi.experiment.files import plain_number

        try:
            finite = not isinstance(value, str) or math.isfinite(plain_number(value))
        except ValueError:
            finite = False
        if not finite:
            sentence = f"{value[:40]!r} is not a number; expected one such as 1000 or 0.25"
            self.fail(sentence, param, ctx)
        return super().convert(value, param, ctx)


class Float(_Plain, click.types.FloatParamType):
    """A number on the command line: ``1000``, ``0.25``, ``2e7``."""


class FloatRange(_Plain, click.FloatRange):
    """A number within bounds."""


class IntRange(_Plain, click.IntRange):
    """A whole number within bounds."""


PATH = click.Path(path_type=Path)


class Choice(click.Choice[str]):
    """One of some words: help lists them, tab completes them, and a slip is told the nearest.

    Parameters
    ----------
    choices
        The words.
    noun
        What each of them is, for messages; by default the option's name.
    """

    def __init__(self, choices: Sequence[str], noun: str = "") -> None:
        super().__init__(choices)
        self._noun = noun

    def convert(self, value: Any, param: click.Parameter | None, ctx: Any) -> str:
        """The word, if it is one of the choices."""
        if value in self.choices:
            return str(value)
        name = self._noun or (param.opts[0].lstrip("-") if param is not None else "word")
        hint = nearest(str(value), self.choices)
        raise click.UsageError(f"unknown {name} '{value}'; {hint}", ctx)


class Grouped(click.Command):
    """A command whose help shows its options under headings.

    Parameters
    ----------
    groups
        Heading to the names of its options, as ``--leg``; the others come last, under
        ``Output``.
    """

    def __init__(self, *args: Any, groups: Mapping[str, Sequence[str]], **options: Any) -> None:
        super().__init__(*args, **options)
        self.groups = groups

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, heading by heading."""
        found: dict[str, list[tuple[str, str]]] = {name: [] for name in [*self.groups, "Output"]}
        for option in self.get_params(ctx):
            record = option.get_help_record(ctx)
            if record is not None and isinstance(option, click.Option):
                named = (name for name, some in self.groups.items() if option.opts[0] in some)
                found[next(named, "Output")].append(record)
        for name, records in found.items():
            with formatter.section(name):
                formatter.write_dl(records)


# The same words stand in the rooms that take them, which are too heavy to import for --help;
# tests/cli/test_help.py compares them.
LEGS = ("straight", "c", "reversed_c", "plate")
LIKELIHOODS = ("calibrated", "paper")
SAMPLERS = ("quadrature", "emcee")
DISCREPANCIES = ("none", "gp", "soils")
ESTIMATORS = ("quasi_static", "momentum_observer")
LAW_SETS = ("rft", "bearing", "all")
FRAMES = ("world", "body")
SIMULATORS = ("genesis", "newton", "isaaclab", "chrono-crm", "chrono-scm", "geotaichi", "mujoco")
MATCHES = ("plane-strain", "triaxial")
DP_TYPES = ("Circumscribed", "MiddleCircumscribed", "Inscribed")
DOCUMENTS = ("scenario", "plan", "robot", "columns")

EVERY_SECONDS = 20.0
"""Least time between two checkpoints [s]."""

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
checkpoint_every_option = click.option(
    "--checkpoint-every",
    type=FloatRange(min=0.0),
    default=EVERY_SECONDS,
    show_default=True,
    metavar="SECONDS",
    help="Least time between two checkpoints; longer if writing them took over 1 % of the time.",
)


def _listen(context: click.Context, parameter: click.Parameter, value: int) -> int:
    """Set how much is printed on standard error, by --verbose or --quiet of any command."""
    if value:
        opposite = context.meta.setdefault("terraphi.loudness", parameter.name) != parameter.name
        if opposite:
            raise click.UsageError("--verbose and --quiet are opposites; give one of them")
        if parameter.name == "quiet":
            listen(logging.ERROR)
        else:
            listen(logging.INFO if value == 1 else logging.DEBUG)
    return value


def tells_as_much_as_asked(command: click.Command) -> None:
    """Add --verbose and --quiet to a command and to the commands in it."""
    more = [
        click.Option(
            ["-v", "--verbose"],
            count=True,
            expose_value=False,
            callback=_listen,
            help="Print on standard error what is being done; -vv: in detail.",
        ),
        click.Option(
            ["-q", "--quiet"],
            is_flag=True,
            expose_value=False,
            callback=_listen,
            help="Print only errors on standard error: no warnings, no progress.",
        ),
    ]
    command.params.extend(more)
    for inner in command.commands.values() if isinstance(command, click.Group) else ():
        tells_as_much_as_asked(inner)


def completed(
    names: Callable[[], Iterable[str]], *, files: bool = False
) -> Callable[[Any, Any, str], list[CompletionItem]]:
    """Shell completion with some names; with files too, where a file is allowed."""

    def complete(_context: Any, _parameter: Any, begun: str) -> list[CompletionItem]:
        found = [CompletionItem(name) for name in names() if name.startswith(begun)]
        # Only the shell knows the files; it is asked where no name fits.
        return found or ([CompletionItem(begun, type="file")] if files else [])

    return complete


def shipped(folder: str, suffix: str) -> Callable[[Any, Any, str], list[CompletionItem]]:
    """Shell completion with the names of shipped files, and with files."""

    def names() -> list[str]:
        from terraphi.experiment.documents import shipped_names

        return shipped_names(folder, suffix)

    return completed(names, files=True)


def studies_package() -> Any:
    """Load the package of studies, which terraphi finds by its entry point.

    Raises
    ------
    InputError
        If none is installed.
    """
    from importlib.metadata import entry_points

    for found in entry_points(group="terraphi.studies"):
        return found.load()
    raise InputError("no studies are installed; install terraphi again, by 'make install' or pip")


def _studies() -> Iterable[str]:
    return ["list", *studies_package().STUDIES]


study_names = completed(_studies)
library_names = shipped("libraries", ".nc")
cluster_option = click.option(
    "--cluster",
    metavar="ADDRESS",
    help="Address of a Dask scheduler to simulate on, such as tcp://127.0.0.1:8786.",
)
