"""Types of options, and options that commands share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

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


class Float(click.types.FloatParamType):
    """A finite number."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """The number."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
leg_option = click.option(
    "--leg", type=click.Choice(LEGS), help="Shape of the leg.  [default: as in FORCES]"
)
density_option = click.option(
    "--density",
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
    metavar="GAIN[±SD]",
    help="Gain of the sensor.  [default: 1±0.02]",
)
library_option = click.option(
    "--library",
    metavar="NAME|FILE",
    help="Shipped library or .nc file.  [default: sand3d; for simulations the nearest]",
)
