"""``terraphi paper``: the results of Xu & Wang, repeated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from terraphi.cli.options import PATH, choice, json_option
from terraphi.experiment.errors import needing
from terraphi.view.console import Table, as_text, present, progress_bar

NAMES = (
    *("recovery", "benchmark", "sensitivity", "phi_sensitivity", "k0", "prototype", "surrogate"),
    "figures",
)


@click.command()
@click.argument("name", required=False, metavar="[NAME]", type=click.Choice(NAMES))
@choice("--library", ("paper", "paper-code"), "paper",
        "Text of the paper, or its code (recovery, phi_sensitivity, k0, surrogate).")  # fmt: skip
@click.option("--out", type=PATH, help="Folder for data.json and figures.")
@json_option
def paper(name: str | None, library: str, out: Path | None, as_json: bool) -> None:
    """Repeat the results of Xu & Wang.

    NAME is one of these; without it all but the figures, in about two minutes.

    \b
    recovery         fourteen friction angles, by quadrature and by emcee
    benchmark        three legs against forces measured in Yuma sand
    phi_sensitivity  peak forces over the friction angle
    k0               what the stress at rest changes
    surrogate        the two Gaussian processes on cases held out
    sensitivity      what moves the simulated forces
    prototype        what the contact of the paper's code counts and applies
    figures          its figures, ready to print (13 minutes)

    Example: terraphi paper recovery --out recovery
    """  # noqa: D301
    from terraphi.experiment.outputs import check_folder, output_folder

    with needing("terraphi paper", "emcee, Matplotlib, Numba and SciPy", extra="plot,simulate"):
        from terraphi.paper import numbers
    if out is not None:
        check_folder(out, kind="paper", names=["data.json"])
    last = None
    with progress_bar("computing") as report:
        if name is None:
            results, last = numbers.number_by_number(lambda done: report(done, 1.0))
        else:
            result = numbers.run(name, library=library, progress=lambda done: report(done, 1.0))
            results = {name: result}
    data: dict[str, Any] = {name: result.data for name, result in results.items()}
    data = data[name] if name is not None else data
    if out is not None:
        with output_folder(out, kind="paper", last="data.json") as made:
            made.joinpath("data.json").write_text(as_text(data), encoding="utf-8")
            for result in results.values():
                for figure, drawn in result.figures.items():
                    drawn().savefig(made.joinpath(f"{figure}.png"), dpi=300)
    parts: list[str | Table] = []
    for result in results.values():
        parts.append(Table(**result.data["table"]))
        if result.compared and last is None:
            parts.append(Table("", ("quantity", "ours", "Xu & Wang"), result.compared))
        parts += [f"{note}\n" for note in result.notes]
    parts += [] if last is None else [Table(**last)]
    parts += [] if out is None else [f"Written: {out}"]
    present(data, *parts, as_json=as_json)
