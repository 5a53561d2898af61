"""The command line: parses, calls, prints.

Commands import what they need when they run, so that ``--help`` answers at once.
"""

from __future__ import annotations

import re
import signal
import sys
import warnings

import click

from terraphi.cli.footfalls import footfalls
from terraphi.cli.forces import forces
from terraphi.cli.invert import calibrate, demo, invert
from terraphi.cli.library import library
from terraphi.cli.paper import paper
from terraphi.cli.simulate import simulate
from terraphi.cli.terrain import convert, export, slope_map
from terraphi.cli.tools import app, doctor, keys, report
from terraphi.experiment.errors import HIDDEN, InputError, SimulationError, printable

CONTROL = re.compile(rf"\x1b(?!\[(0|1|2|3|22)m)|(?![\t\n\x1b]){HIDDEN.pattern}")
"""Hidden characters but those of lines and of our own styles."""
UNUSABLE, SIGNALLED = 2, 128
"""Exit status where the input cannot be used; and, plus its number, after a signal, as in shells:
130 after Ctrl-C, 143 after ``kill``."""


class Commands(click.Group):
    """A group whose help lists its commands in the order in which they were added."""

    def list_commands(self, _ctx: click.Context) -> list[str]:
        """Names."""
        return list(self.commands)


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(package_name="terraphi")
def cli() -> None:
    """Friction angle of soil, with its uncertainty, from the forces on a leg that moved through it.

    Example: terraphi invert li2013:yuma/straight
    """


for command in (
    *(demo, invert, calibrate, simulate, library, paper, forces, footfalls),
    *(export, convert, slope_map, report, app, doctor, keys),
):
    cli.add_command(command)


def main() -> None:
    """Run the command line; what cannot be used is one sentence on standard error."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal without φ shows another letter
            stream.reconfigure(errors="replace")
    write = sys.stdout.write

    def escaped(text: str) -> int:  # a name in a file may hold codes that rewrite a terminal
        return write(CONTROL.sub(lambda m: f"\\u{ord(m[0]):04x}", text))  # as JSON has them

    sys.stdout.write = escaped  # type: ignore[method-assign]
    if not sys.warnoptions:  # they name our source, and mean nothing to a user
        warnings.simplefilter("ignore", RuntimeWarning)
    received: list[int] = []

    def interrupt(number: int, _frame: object) -> None:
        received.append(number)
        raise KeyboardInterrupt

    def hang_up(_number: int, _frame: object) -> None:  # which the app's server does not know
        signal.raise_signal(signal.SIGTERM)

    handlers = {signal.SIGHUP: hang_up, signal.SIGINT: interrupt, signal.SIGTERM: interrupt}
    for number, handler in handlers.items():
        if signal.getsignal(number) != signal.SIG_IGN:  # as with nohup
            signal.signal(number, handler)
    try:
        cli.main(prog_name="terraphi", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
    except click.ClickException as error:
        _leave(error.format_message(), UNUSABLE)
    except (InputError, SimulationError) as error:
        _leave(str(error), UNUSABLE)
    except OSError as error:
        _leave(f"the operating system reports: {error}", UNUSABLE)
    except (OverflowError, RecursionError) as error:
        _leave(f"a number in the input is too large, or it is nested too deep: {error}", UNUSABLE)
    except (click.Abort, KeyboardInterrupt):
        _leave(
            "interrupted; a simulation or build with --out continues with the same command",
            SIGNALLED + (received or [signal.SIGINT])[0],
        )


def _leave(sentence: str, status: int) -> None:
    click.echo(f"terraphi: {printable(sentence)}", err=True)
    sys.exit(status)
