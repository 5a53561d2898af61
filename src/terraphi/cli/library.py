"""``terraphi library``: build, list and show libraries of simulations."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from terraphi.cli.options import PATH, SOME_FAILED, json_option, rig_options
from terraphi.cli.simulate import announce
from terraphi.experiment.errors import InputError
from terraphi.view.console import Table, present, progress_bar

if TYPE_CHECKING:
    from terraphi.laws.law import AnyLaw


@click.group()
def library() -> None:
    """Build, list and show libraries of simulations.

    Example: terraphi library list
    """


@library.command("build")
@click.argument("plan", required=False)
@rig_options
@click.option("--out", type=PATH, required=True, help="NetCDF file to make.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes.  [default: all cores]")
@click.option("--cluster", metavar="ADDRESS", help="Dask scheduler, as tcp://127.0.0.1:8786.")
@click.option("--share", metavar="K/N", help="Simulate the cases K, K+N, ... alone.")
@json_option
def library_build(
    plan: str | None, out: Path, workers: int | None, cluster: str | None, share: str | None,
    as_json: bool, **rig: Any,
) -> None:  # fmt: skip
    """Simulate all cases of a PLAN (a TOML file or the name of a shipped plan), or of your rig.

    'terraphi keys plan' lists the keys of a plan. For a rig, bed, cells and steps follow from its
    sizes. After an interruption the same command continues. With --share, many machines work at one
    library; the command without it gathers their cases.

    Example: terraphi library build wide.toml --out wide.nc --workers 4

    Example: terraphi library build --rig rig.toml --out mine.nc
    """
    from terraphi.experiment.outputs import check_file
    from terraphi.experiment.rig import Rig, with_rig
    from terraphi.experiment.workers import workers as processes
    from terraphi.laws import build as builder
    from terraphi.laws.plan import Plan

    check_file(out, kind="library")
    given = with_rig(rig)
    if (plan is None) == (given["rig"] is None) or (plan and given["leg"]):
        raise InputError("give a PLAN, or a rig by --leg with its four sizes, or by --rig FILE")
    chosen = Plan.load(plan) if plan is not None else Plan.of_rig(Rig.of(**given))
    (number, of), lacking, made = share_of(share), 0, None
    cases = chosen.cases()[number - 1 :: of]
    count = min(workers or os.cpu_count() or 1, len(cases) or 1)
    with builder.cluster(cluster) if cluster else processes(count) as executor:
        announce(cases)
        with progress_bar("simulating") as report:
            if share is None:
                made = builder.build(chosen, out, executor=executor, progress=report)
            else:
                lacking = builder.build_share(
                    chosen, out, (number, of), executor=executor, progress=report
                )
    if made is not None:
        print_library(made, as_json)
    else:
        total = len(cases)
        words = f"Share {share}: {total - lacking} of {total} cases are there; "
        again = "without --share it gathers"
        again = "the same command tries the others again" if lacking else again
        data = {"share": share, "cases": total, "lacking": lacking}
        present(data, f"{words}{again}.", as_json=as_json)
        if lacking:
            sys.exit(SOME_FAILED)


def share_of(text: str | None) -> tuple[int, int]:
    """Number of a share and of all shares, of ``K/N``; the whole without one."""
    match = re.fullmatch(r"([1-9][0-9]{0,5})/([1-9][0-9]{0,5})", text or "1/1")
    if match is None or int(match[1]) > int(match[2]):
        raise InputError(f"--share {text}; give K/N, such as 3/16 for the third of sixteen")
    return int(match[1]), int(match[2])


@library.command("list")
@json_option
def library_list(as_json: bool) -> None:
    """List the shipped libraries, and the soils that have a name.

    Example: terraphi library list
    """
    from terraphi.laws.named import shipped
    from terraphi.terrain.soils import named

    summaries = [law.summary() for law in shipped()]
    rows = [
        (law["name"], f"{law['model']}, {law['dimensions']}-D",
         "{:g} to {:g}".format(*law["phi_deg"]), law["convention"], ", ".join(law["legs"]),
         str(law["cases"]))
        for law in summaries
    ]  # fmt: skip
    header = ("library", "model", "φ [deg]", "φ means", "legs", "cases")
    sands = named()
    soils = {
        name: {"phi_plane_strain_deg": soil.phi, "density_kg_m3": soil.density,
               "source": soil.source}
        for name, soil in sands.items()
    }  # fmt: skip
    named_rows = [
        (name, "{:.1f} ± {:.1f}".format(*soil.phi), "{:g} ± {:g}".format(*soil.density),
         soil.source)
        for name, soil in sands.items()
    ]  # fmt: skip
    named_header = ("soil", "φ in plane strain [deg]", "density [kg/m³]", "source")
    present(
        {"libraries": summaries, "soils": soils},
        Table("", header, rows), Table("", named_header, named_rows),
        as_json=as_json,
    )  # fmt: skip


@library.command("show")
@click.argument("name")
@json_option
def library_show(name: str, as_json: bool) -> None:
    """Show the contents and the origin of library NAME, or of a .nc file.

    Example: terraphi library show rft3d
    """
    from terraphi.laws.named import stored

    print_library(stored(name), as_json)


def print_library(law: AnyLaw, as_json: bool) -> None:
    """Print the summary of a library, with its plan as JSON alone."""
    summary = law.summary()
    values = {**summary, **summary["provenance"]}
    shown = {k: v for k, v in values.items() if v is not None and k not in ("provenance", "plan")}
    present(summary, shown, as_json=as_json)
