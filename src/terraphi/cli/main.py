"""The command line: parses, calls, prints. Nothing is computed here."""

from __future__ import annotations

import io
import logging
import sys
from pathlib import Path
from shutil import which

import click

from terraphi.cli.app import app
from terraphi.cli.calibrate import calibrate, library_calibrate
from terraphi.cli.doctor import doctor
from terraphi.cli.footfalls import footfalls
from terraphi.cli.forces import forces
from terraphi.cli.invert import KIND, MADE, invert, save_inversion
from terraphi.cli.keys import keys
from terraphi.cli.library import library
from terraphi.cli.options import PATH, json_option, tells_as_much_as_asked
from terraphi.cli.report import report
from terraphi.cli.simulate import simulate
from terraphi.cli.study import study
from terraphi.cli.suggest import library_suggest
from terraphi.cli.terrain import convert, export, slope_map
from terraphi.experiment.errors import InputError, SimulationError
from terraphi.experiment.interrupts import ignore_interrupts
from terraphi.view.console import listen, print_json

UNUSABLE = 2
"""Exit status when the input could not be used."""
OURS = 1
"""Exit status when something is wrong with the program."""
log = logging.getLogger("terraphi")
DEMO_FIGURE = "demo.png"
DEMO_SOURCES = ("li2013:glass03_close/straight", "li2013:glass03_loose/straight")


class Commands(click.Group):
    """All commands; refuses empty arguments, such as those of unset shell variables."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Check that no argument is empty, then parse as usual."""
        before = ""
        command: click.Command = self
        for word in args:
            name, given, value = word.partition("=")
            if not word.strip():
                name = before if _takes_a_value(command, before) else "an argument"
            elif not (given and not value.strip() and word.startswith("--")):
                before = word
                if isinstance(command, click.Group):
                    command = command.commands.get(word, command)
                continue
            raise click.UsageError(f"{name} is empty; give it a value, or leave it out")
        return super().parse_args(ctx, args)


def _takes_a_value(command: click.Command, word: str) -> bool:
    """Whether a word is an option that takes a value, as ``--out`` does."""
    options = (option for option in command.params if isinstance(option, click.Option))
    return any(word in o.opts and not (o.is_flag or o.count) for o in options)


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(package_name="terraphi")
def cli() -> None:
    """Friction angle of soil, with its uncertainty, from the forces on a leg that moved through it.

    Example: terraphi invert li2013:yuma/straight
    """


@cli.command()
@click.option(
    "--out",
    type=PATH,
    default="terraphi-demo",
    show_default=True,
    help="Folder for the figure and the answers.",
)
@json_option
def demo(out: Path, as_json: bool) -> None:
    """Recover a friction angle that is known, then infer those of two measured sands.

    Example: terraphi demo
    """
    from terraphi.experiment.outputs import check_folder, filling
    from terraphi.view import plots
    from terraphi.view.demo import answers, told

    names = ("known", *(one.partition(":")[2].replace("/", "-") for one in DEMO_SOURCES))
    places = [out.joinpath(name) for name in names]
    check_folder(out, kind="demo", names=[DEMO_FIGURE])
    for place in places:
        check_folder(place, kind=KIND, names=MADE)
    found = answers(DEMO_SOURCES)
    with filling(out, kind="demo", last=DEMO_FIGURE) as made:
        plots.save(plots.inversions_figure(found), made.joinpath(DEMO_FIGURE))
    picture = out.joinpath(DEMO_FIGURE)
    for inversion, place in zip(found, places, strict=True):
        save_inversion(inversion, place)
    if as_json:
        print_json({"inversions": [f.as_dict() for f in found], "figure": str(picture)})
        return
    for sentence in told(found):
        click.echo(sentence)
    click.echo(f"Figure: {picture}")
    click.echo(f"Answers: {', '.join(map(str, places))}")
    # In an environment that is not activated the shell does not find it by its name.
    name = "terraphi" if which("terraphi") else sys.argv[0]
    click.echo(f"Next, on forces of your own: {name} invert FORCES.csv --leg LEG --density KG_M3")


for command in (
    *(invert, calibrate, simulate, library, study, report, app, keys, doctor),
    *(export, convert, slope_map, forces, footfalls),
):
    cli.add_command(command)
for command in (library_calibrate, library_suggest):
    library.add_command(command)
tells_as_much_as_asked(cli)


def main() -> None:
    """Run the command line; every expected failure is one sentence and exit status 2.

    An error of the program itself is one sentence too, with status 1; its traceback is in the log.
    """
    for stream in (sys.stdout, sys.stderr):
        # An angle in the wrong letters beats no angle on a terminal that lacks φ.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    listen()
    try:
        cli.main(prog_name="terraphi", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as asked:
        click.echo(asked.format_message())
    except (Exception, KeyboardInterrupt) as error:
        sentence, status = told(error)
        click.echo(f"terraphi: {sentence}", err=True)
        sys.exit(status)


def told(error: BaseException) -> tuple[str, int]:
    """What a person is told of an error, and the exit status."""
    if isinstance(error, click.ClickException):
        return error.format_message(), UNUSABLE
    if isinstance(error, InputError | SimulationError):
        return str(error), UNUSABLE
    if isinstance(error, click.Abort | KeyboardInterrupt):
        ignore_interrupts()
        return (
            "interrupted; files that were finished before stay, and nothing else was written",
            UNUSABLE,
        )
    if isinstance(error, OSError):
        return f"the operating system reports: {error}; nothing more was written", UNUSABLE
    if isinstance(error, MemoryError):
        why = f" ({error})" if str(error) else ""
        remedy = "give less, or ask for a coarser grid"
        return f"this needs more memory than there is{why}; {remedy}", UNUSABLE
    if isinstance(error, ImportError):
        return f"{error}; install terraphi and its packages again", OURS
    log.info("the traceback:", exc_info=error)
    what = " ".join(f"{type(error).__name__}: {error}".split())[:200]
    asked = "please report it with the command that you ran and what it prints as"
    return f"an error of terraphi itself ({what}); {asked} 'terraphi -v ...'", OURS
