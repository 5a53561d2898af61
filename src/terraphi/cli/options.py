"""Types of options, and options that commands share."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from terraphi.experiment.errors import nearest

# The same words stand in the modules that take them, which are too slow to import for --help.
LEGS = ("straight", "c", "reversed_c")
ESTIMATORS = ("quasi_static", "momentum_observer")
LAWS = ("foot", "rft", "meyerhof", "vesic", "hansen")
FRAMES = ("world", "body")
SIMULATORS = ("genesis", "newton", "isaaclab", "chrono-crm", "chrono-scm", "geotaichi", "rft3d",
              "mujoco")  # fmt: skip
MATCHES = ("plane-strain", "triaxial")
DP_TYPES = ("Circumscribed", "MiddleCircumscribed", "Inscribed")

PATH = click.Path(path_type=Path)
IntRange = click.IntRange


class Float(click.types.FloatParamType):
    """A finite number."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """The number."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


class WithSd(click.ParamType[str]):
    """A number with or without its standard deviation, such as 1600±80 or 1600+-80."""

    name = "mean±sd"

    def convert(self, value: Any, param: Any, ctx: Any) -> str:
        """The text, if it is one."""
        from terraphi.experiment.files import number_with_sd

        try:
            number_with_sd(value)
        except ValueError:
            self.fail(f"{value!r}: give a number, such as 1600 or 1600±80", param, ctx)
        return str(value)


class Choice(click.Choice[str]):
    """One of some words; the error for another names the nearest.

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
        raise click.UsageError(f"unknown {name} '{value}'; {nearest(value, self.choices)}", ctx)


def shipped(folder: str, suffix: str) -> Callable[[Any, Any, str], list[CompletionItem]]:
    """Shell completion with the names of shipped files, and with files."""

    def complete(_context: Any, _parameter: Any, begun: str) -> list[CompletionItem]:
        from terraphi.experiment.documents import shipped_names

        names = [name for name in shipped_names(folder, suffix) if name.startswith(begun)]
        return [CompletionItem(name) for name in names] or [CompletionItem(begun, type="file")]

    return complete


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
leg_option = click.option(
    "--leg", type=Choice(LEGS), help="Shape of the leg.  [default: as in FORCES]"
)
density_option = click.option(
    "--density",
    type=WithSd(),
    metavar="KG_M3[±SD]",
    help="Bulk density of the soil, as 1600 (± 5 %) or 1600±80.  [default: as in FORCES]",
)
columns_option = click.option(
    "--columns",
    metavar="FILE|KEY=VALUE",
    help="Columns, units, signs of FORCES ('terraphi keys forces').  [default: guessed]",
)
gain_option = click.option(
    "--gain",
    type=WithSd(),
    metavar="GAIN[±SD]",
    help="Gain of the sensor.  [default: 1±0.02]",
)
library_option = click.option(
    "--library",
    metavar="NAME|FILE",
    help="Shipped library or .nc file.  [default: sand3d; for simulations the nearest]",
    shell_complete=shipped("libraries", ".nc"),
)
