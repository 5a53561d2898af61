"""``terraphi simulate``: one simulation, resumed if it was interrupted."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from terraphi.cli.options import PATH, json_option
from terraphi.experiment.errors import InputError
from terraphi.view.console import present, progress_bar

if TYPE_CHECKING:
    from terraphi.experiment.scenario import Scenario

FRAMES = 100
"""Frames of a VTK series."""


@click.command()
@click.argument("scenario")
@click.option("--set", "changes", multiple=True, metavar="KEY=VALUE",
              help="Change a key, as soil.friction_angle_deg=30; may be repeated.")  # fmt: skip
@click.option("--out", type=PATH, help="NetCDF file for the forces.")
@click.option("--vtk", type=PATH, help="Folder for particles and leg, for ParaView.")
@json_option
def simulate(
    scenario: str, changes: tuple[str, ...], out: Path | None, vtk: Path | None, as_json: bool
) -> None:
    """Simulate SCENARIO, a TOML file or the name of a preset.

    Presets: quick (seconds), sand3d, paper-1 and paper-code-1 (hours).

    With --out the same command continues an interrupted simulation, with the same result to the
    last bit. 'terraphi keys' lists the keys of a scenario.

    Example: terraphi simulate quick --set leg.shape="c" --out quick.nc
    """
    from terraphi import forward
    from terraphi.experiment.outputs import check_file
    from terraphi.experiment.scenario import Scenario

    chosen = changed(Scenario.load(scenario), changes)
    if out is not None:
        check_file(out, kind="force history")
    observe = None
    if vtk is not None:
        if chosen.model != "mpm":
            raise InputError(f"--vtk: model '{chosen.model}' has no particles; leave it out")
        from terraphi.forward.vtk import FieldSeries

        observe = FieldSeries(vtk, chosen, frames=FRAMES)
    announce([chosen])
    kept = out.with_name(f"{out.name}.checkpoint") if out else None
    with progress_bar("simulating") as report:
        history = forward.simulate(chosen, progress=lambda fraction: report(fraction, 1.0),
                                   checkpoint=kept, observe=observe)  # fmt: skip
    if out is not None and kept is not None:
        history.to_netcdf(out)
        kept.unlink(missing_ok=True)
    summary = {**history.summary(), **({"out": str(out)} if out else {})}
    present(summary, summary, as_json=as_json)


def announce(scenarios: Sequence[Scenario]) -> None:
    """Print warnings about scenarios.

    Raises InputError if the compiler that they need is not installed.
    """
    if any(scenario.model == "mpm" for scenario in scenarios):
        importlib.import_module("terraphi.forward.compiled")
    for warning in dict.fromkeys(text for scenario in scenarios for text in scenario.warnings()):
        click.echo(f"terraphi: {warning}", err=True)


def changed(scenario: Scenario, changes: tuple[str, ...]) -> Scenario:
    """A scenario with the keys of ``--set`` replaced; raises InputError if one cannot be."""
    from terraphi.experiment.documents import value_of

    replaced: dict[str, Any] = {}
    for change in changes:
        key, given, text = change.partition("=")
        if not given:
            raise InputError(f"--set {change}: give KEY=VALUE, such as leg.shape=c")
        replaced[key] = value_of(text)
    return scenario.replace("--set", **replaced)
