"""Commands that need more than a few lines, and the options that commands share."""

from __future__ import annotations

import click

EVERY_SECONDS = 20.0
"""Least time between two checkpoints [s]."""

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
checkpoint_every_option = click.option(
    "--checkpoint-every",
    type=click.FloatRange(min=0.0),
    default=EVERY_SECONDS,
    show_default=True,
    metavar="SECONDS",
    help="Least time between two checkpoints; longer where they would take over 1 % of the time.",
)
cluster_option = click.option(
    "--cluster",
    metavar="ADDRESS",
    help="Simulate on the Dask cluster whose scheduler answers there, as at tcp://127.0.0.1:8786.",
)
