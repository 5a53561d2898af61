"""``terraphi simulate``: run one simulation, write its results, resume it if interrupted."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

import click

from terraphi.cli.options import PATH, IntRange, checkpoint_every_option, json_option, shipped
from terraphi.experiment.errors import InputError
from terraphi.view.console import note, print_json, print_pairs, progress_bar

if TYPE_CHECKING:
    from terraphi.experiment.history import ForceHistory
    from terraphi.experiment.scenario import Scenario
    from terraphi.forward import Checkpoint
    from terraphi.forward.forecast import Forecast
    from terraphi.forward.plane.fields import FieldSeries

log = logging.getLogger(__name__)
FRAMES = 100
"""Of fields and animation, if nobody says otherwise."""


@click.command()
@click.argument("scenario", shell_complete=shipped("scenarios", ".toml"))
@click.option("--out", type=PATH, help="NetCDF file for the history.")
@click.option("--fields", type=PATH, help="Folder for particles and leg as VTK (ParaView).")
@click.option("--animate", type=PATH, help="A .gif or .mp4 of particles and growing forces.")
@click.option(
    "--frames",
    type=IntRange(min=2),
    help="Frames of the fields and the animation; at most one every 2000 steps, or 400 in space.  "
    "[default: 100]",
)
@click.option(
    "--checkpoint",
    type=PATH,
    help="File for the state, kept until all output is written; by default beside the output.",
)
@checkpoint_every_option
@json_option
def simulate(
    scenario: str,
    out: Path | None,
    fields: Path | None,
    animate: Path | None,
    frames: int | None,
    checkpoint: Path | None,
    checkpoint_every: float,
    as_json: bool,
) -> None:
    """Simulate SCENARIO, a TOML file or the name of a shipped preset.

    Presets: quick, paper-1, paper-code-1, resolved, resolved-2.

    The same command resumes a simulation that was interrupted or killed; the result is
    bit-identical to that of an uninterrupted run.

    Example: terraphi simulate quick --out quick.nc
    """
    from terraphi.experiment.files import writable
    from terraphi.experiment.outputs import check_file
    from terraphi.experiment.plausibility import doubts
    from terraphi.experiment.scenario import Scenario

    chosen = Scenario.load(scenario)
    expected = forecast_of(chosen, scenario)
    if frames is not None and fields is None and animate is None:
        raise InputError("--frames: nothing has frames here; name --fields or --animate, too")
    for file, kind in ((out, "force history"), (animate, "")):
        if file is not None:
            check_file(file, kind=kind)
    if checkpoint is not None:
        writable(checkpoint)
    if animate is not None:
        from terraphi.view.animation import check_animation

        check_animation(animate)
    kept = kept_state(chosen, checkpoint, out or animate or fields, checkpoint_every)
    series = field_series(chosen, fields, animate, FRAMES if frames is None else frames)
    for doubt in doubts(chosen):
        log.warning(doubt)
    note(expected.sentence())
    history = run(chosen, kept, series)
    if out is not None:
        history.to_netcdf(out)
    if animate is not None and series is not None:
        draw(animate, history, chosen, series)
        if fields is None:
            series.remove()
    if kept is not None:
        kept.remove()
    made = {"out": out, "fields": fields, "animation": animate}
    summary = {
        **history.summary(),
        **{name: str(path) for name, path in made.items() if path is not None},
    }
    if as_json:
        print_json({**summary, "forecast": expected.as_dict()})
        return
    print_pairs(summary)


def forecast_of(scenario: Scenario, source: str) -> Forecast:
    """Forecast time and memory; raises InputError with the file's name if it cannot fit."""
    from terraphi.forward.forecast import foreseen, refuse_what_cannot_fit

    try:
        refuse_what_cannot_fit(scenario)
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    return foreseen([scenario])


def kept_state(
    scenario: Scenario, named: Path | None, made: Path | None, every: float
) -> Checkpoint | None:
    """The checkpoint: in the file that was named, or else beside the output."""
    from terraphi.forward import Checkpoint

    if scenario.model != "mpm":
        if named is not None:
            raise InputError(
                f"model = '{scenario.model}' takes under a second and has no checkpoints: "
                "leave out --checkpoint"
            )
        return None
    if named is not None:
        return Checkpoint(named, every, named=True)
    if made is None:
        return None
    made = made if made.name else made.resolve()  # "." has no name of its own
    return Checkpoint(made.with_name(made.name + ".checkpoint"), every)


def field_series(
    scenario: Scenario, fields: Path | None, animation: Path | None, frames: int
) -> FieldSeries | None:
    """Folder of the fields; for an animation alone, a temporary one beside it."""
    place = fields
    if place is None and animation is not None:
        place = animation.with_name(animation.name + ".frames")
    if place is None:
        return None
    if scenario.model != "mpm":
        raise InputError(
            f"model = '{scenario.model}' has no particles to look at: --fields and --animate need "
            "model = 'mpm'"
        )
    from terraphi.forward.plane.fields import FieldSeries

    return FieldSeries(place, scenario, frames=frames)


def run(scenario: Scenario, kept: Checkpoint | None, series: FieldSeries | None) -> ForceHistory:
    """Simulate; Ctrl-C raises InputError that says how to resume."""
    from terraphi import forward

    try:
        with progress_bar("simulating", simulates=[scenario]) as report:
            return forward.simulate(
                scenario,
                progress=lambda fraction: report(fraction, 1.0),
                checkpoint=kept,
                observe=series,
            )
    except KeyboardInterrupt:
        raise InputError(
            f"interrupted; the state so far is kept in {kept.path}, and the same command goes on "
            "from there"
            if kept is not None and kept.path.exists()
            else "interrupted; no history was written"
        ) from None


def draw(path: Path, history: ForceHistory, scenario: Scenario, series: FieldSeries) -> None:
    """Draw the animation."""
    from terraphi.view.animation import animate

    try:
        with progress_bar("drawing") as report:
            animate(
                path,
                history,
                scenario,
                series.particles,
                progress=lambda fraction: report(fraction, 1.0),
            )
    except KeyboardInterrupt:
        raise InputError(
            f"{path}: interrupted before it was drawn; its frames are kept in "
            f"{series.particles.parent}, and the same command goes on from there"
        ) from None
