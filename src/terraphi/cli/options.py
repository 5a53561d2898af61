"""Types of options, and options that commands share."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import reduce
from pathlib import Path
from typing import Any

import click

from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.errors import InputError
from terraphi.experiment.priors import FRICTION, HIP_HEIGHT_SD_MM, SENSOR_GAIN

# The same words stand in the modules that take them, which are too slow to import for --help.
ESTIMATORS = ("quasi_static", "momentum_observer")
LAWS = ("foot", "rft", "meyerhof", "vesic", "hansen")
FRAMES = ("world", "body")
TUNED = ("newton", "isaaclab", "genesis")

PATH = click.Path(path_type=Path)
SOME_FAILED = 1
"""Exit status where some records or logs of a table cannot be used."""


class Float(click.types.FloatParamType):
    """A finite number."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """The number."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


@contextmanager
def some_may_fail(results: Sequence[Any]) -> Iterator[int]:
    """Print the errors among results before a block, give their number, and end with status 1.

    Raises InputError if all of them are errors.
    """
    failed = [str(result) for result in results if isinstance(result, InputError)]
    if failed and len(failed) == len(results):
        raise InputError(failed[0])
    for sentence in failed:
        click.echo(f"Failed: {sentence}", err=True)
    yield len(failed)
    if failed:
        sys.exit(SOME_FAILED)


def option_group(*each: Callable[..., Any]) -> Callable[..., Any]:
    """One decorator of several, in their order."""
    return lambda command: reduce(lambda inner, option: option(inner), reversed(each), command)


def choice(name: str, choices: Sequence[str], default: str, text: str) -> Callable[..., Any]:
    """An option that is one of some words, with a default that the help shows."""
    kind = click.Choice(choices)
    return click.option(name, type=kind, default=default, show_default=True, help=text)


rig_options = option_group(
    click.option("--leg", type=click.Choice([*OUTLINES]), help="Shape of the leg."),
    click.option("--length", metavar="MM", help="From the hip to the outermost tip."),
    click.option("--width", metavar="MM", help="Of the leg, across the plane of motion."),
    click.option("--thickness", metavar="MM", help="Of the leg."),
    click.option(
        "--hip-height", metavar="MM[±SD]",
        help=f"Above the soil.  [default SD: {HIP_HEIGHT_SD_MM:g}]",
    ),
    click.option(
        "--friction", "--leg-friction", "leg_friction", metavar="MU[±SD]",
        help=f"Of leg or tool on soil.  [default: {FRICTION}]",
    ),
    click.option("--rig", metavar="FILE|li2013", help="These in TOML, or Li et al.'s (and --leg)."),
)  # fmt: skip
"""A rig: its leg and four sizes, or a file."""
density_option = click.option(
    "--density", metavar="KG_M3[±SD]", help="Bulk density, as 1600 (± 5 %) or 1600±80."
)
soil_options = option_group(
    density_option,
    click.option(
        "--grain-size", "grain_size_mm", metavar="MM", type=Float(),
        help="Mean diameter of the grains.  [default: that of sand]",
    ),
    click.option(
        "--cohesion", metavar="PA[±SD]|unknown",
        help="Of damp soil; without ±SD a third.  [default: 0, dry]",
    ),
)  # fmt: skip
"""What is known of the soil."""
record_options = option_group(
    rig_options,
    soil_options,
    click.option(
        "--columns", metavar="FILE|KEY=VALUE", multiple=True,
        callback=lambda _context, _option, given: ",".join(given) or None,
        help="As in 'terraphi keys forces', or guessed.",
    ),
    click.option(
        "--gain", metavar="GAIN[±SD]", help=f"Gain of the sensor.  [default: {SENSOR_GAIN}]"
    ),
    click.option(
        "--law", "--library", "law", metavar="NAME|FILE", help="Name or .nc file.  [default: legs]"
    ),
)  # fmt: skip
"""Rig, soil, table and law of a record."""
