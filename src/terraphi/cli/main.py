"""The command line: parses, calls, prints.

Commands import what they need when they run, so that ``--help`` answers at once.
"""

from __future__ import annotations

import os
import re
import signal
import sys
import traceback
import warnings
from contextlib import suppress

import click

from terraphi.cli.invert import calibrate, demo, invert, plan
from terraphi.cli.library import library
from terraphi.cli.paper import paper
from terraphi.cli.robot import footfalls, forces
from terraphi.cli.simulate import simulate
from terraphi.cli.terrain import convert, export, slope_map, tune
from terraphi.cli.tools import app, doctor, keys, report
from terraphi.experiment.errors import HIDDEN, InputError, SimulationError, printable

CONTROL = re.compile(rf"\x1b(?!\[(0|1|2|3|22)m)|(?![\t\n\x1b]){HIDDEN.pattern}")
"""Hidden characters but those of lines and of our own styles."""
SENTENCES: dict[type[Exception], str] = {
    MemoryError: "there is not enough memory for this; give a smaller input",
    OSError: "the operating system reports: {}",
    OverflowError: "a number in the input is too large: {}",
    RecursionError: "the input is nested too deep: {}",
}
"""Errors that may come from any place."""
UNUSABLE, SIGNALLED = 2, 128
"""Exit status where the input cannot be used; and, plus its number, after a signal, as in shells:
130 after Ctrl-C, 143 after ``kill``."""


class Commands(click.Group):
    """A group whose help lists its commands in the order in which they were added."""

    def list_commands(self, _ctx: click.Context) -> list[str]:
        """Names."""
        return list(self.commands)


@click.group(
    cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}
)
@click.version_option(package_name="terraphi")
@click.option(
    "-v", "--verbose", is_flag=True, expose_value=False,
    help="Print the Python stack of an unexpected error, too.",
)  # fmt: skip
def cli() -> None:
    """Friction angle of soil, with its uncertainty, from the forces on a leg that moved through it.

    Example: terraphi invert li2013:yuma/straight
    """


for command in (
    *(demo, invert, plan, calibrate, simulate, library, paper, forces, footfalls),
    *(export, convert, tune, slope_map, report, app, doctor, keys),
):
    cli.add_command(command)


def main() -> None:
    """Run the command line; print any error as one sentence on standard error."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # closed by who started us
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal without φ shows another letter
            stream.reconfigure(errors="replace")
    write = sys.stdout.write

    def escaped(text: str) -> int:  # a name in a file may hold codes that rewrite a terminal
        return write(CONTROL.sub(lambda m: f"\\u{ord(m[0]):04x}", text))  # as JSON has them

    sys.stdout.write = escaped  # type: ignore[method-assign]
    if not sys.warnoptions:  # they name lines of our source
        warnings.simplefilter("ignore", RuntimeWarning)
    received: list[int] = []

    def raise_later(dropped: sys.UnraisableHookArgs) -> None:
        # Python drops what a signal raises in a finalizer or a callback, and prints its stack.
        if issubclass(dropped.exc_type, KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, 0.01)

    def interrupt(number: int, _frame: object) -> None:
        received.append(number)
        sys.unraisablehook = raise_later
        raise KeyboardInterrupt

    def hang_up(_number: int, _frame: object) -> None:  # which the app's server does not know
        signal.raise_signal(signal.SIGTERM)

    handlers = {
        signal.SIGHUP: hang_up, signal.SIGINT: interrupt, signal.SIGTERM: interrupt,
        signal.SIGALRM: interrupt,
    }  # fmt: skip
    for number, handler in handlers.items():
        if signal.getsignal(number) != signal.SIG_IGN:  # as with nohup
            signal.signal(number, handler)
    try:
        cli.main(prog_name="terraphi", standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
    except click.ClickException as error:
        _leave(error.format_message(), UNUSABLE)
    except (InputError, SimulationError) as error:
        _leave(str(error), UNUSABLE)
    except (click.Abort, KeyboardInterrupt):
        _leave(
            "interrupted; a simulation or build with --out continues with the same command",
            SIGNALLED + (received or [signal.SIGINT])[0],
        )
    except Exception as error:
        if {"-v", "--verbose"} & {*sys.argv}:
            traceback.print_exc()
        unknown = f"unexpected {type(error).__name__}: {{}}; 'terraphi -v' prints the stack"
        sentences = (text for kind, text in SENTENCES.items() if isinstance(error, kind))
        _leave(next(sentences, unknown).replace("{}", str(error)), UNUSABLE)


def _leave(sentence: str, status: int) -> None:
    """End with a sentence and an exit status, also where a standard stream cannot be written to."""
    with suppress(OSError):
        click.echo(f"terraphi: {printable(sentence)}", err=True)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:  # Python would try again when it ends, and print its stack
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    sys.exit(status)
