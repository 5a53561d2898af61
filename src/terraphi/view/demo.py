"""The demonstration: a known angle recovered, two measured soils inferred, a picture."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.experiment.errors import InputError
from terraphi.view.plots import save

if TYPE_CHECKING:
    from terraphi.experiment.history import ForceHistory
    from terraphi.inference.answer import Answer

TRUTH_DEG = 33.0
"""Friction angle that is simulated [deg]."""
NOISE_N = 0.5
"""Standard deviation of the noise that is added to each simulated reading [N]."""
SOILS = {"yuma": "li2013:yuma/straight", "poppy": "li2013:poppy_loose/straight"}
"""Measured records, by the name of their folder; the first is left as a table, with its rig."""


def run(out: Path) -> tuple[list[Answer], str]:
    """Invert three records; write answers, picture, and tables to try into a folder.

    The walk is that of a Go2 on simulated sand of 41 to 42° (``studies/demo_walk.py``), the plate
    was pressed into simulated grains, the wheel is published (Ding et al. 2011).

    Returns
    -------
    answers, path of the picture or why there is none
    """
    from terraphi.experiment.documents import shipped_file
    from terraphi.experiment.files import atomic_write, made_folder
    from terraphi.experiment.measurements import measurement
    from terraphi.inference.inversion import invert

    answers = {"simulated": invert(known_record(), noise=NOISE_N)}
    answers |= {name: invert(source) for name, source in SOILS.items()}
    made_folder(out)
    for name, answer in answers.items():
        answer.save(out / name)
    name = next(iter(SOILS.values()))
    measurement(name).history.to_csv(out / "forces.csv")
    sizes = answers[next(iter(SOILS))].rigs[0].model_dump(exclude_defaults=True)
    lines = [f"{key} = {json.dumps(value)}\n" for key, value in sizes.items()]
    with atomic_write(out / "rig.toml") as temporary:
        temporary.write_text("".join(lines), encoding="utf-8")
    for folder, name in (("robots", "walk"), ("examples", "plate"), ("examples", "wheel")):
        with atomic_write(out / f"{name}.csv") as temporary:
            shutil.copyfile(shipped_file(folder, name, ".csv"), temporary)
    try:
        from terraphi.experiment.figure import Figure
    except InputError as error:  # without Matplotlib
        return list(answers.values()), str(error)
    figure = Figure(figsize=(11.0, 9.6), layout="constrained")
    rows: Any = figure.subfigures(len(answers), 1)
    for answer, row in zip(answers.values(), rows, strict=True):
        answer.plot(row)
        row.suptitle(f"{answer.source}: {answer.verdict.replace('_', ' ')}", fontsize="medium")
    save(figure, out / "demo.png")
    return list(answers.values()), str(out / "demo.png")


def known_record() -> ForceHistory:
    """A simulation of known friction angle (3-D resistive force theory), with noise."""
    from terraphi.experiment.scenario import Scenario
    from terraphi.forward import simulate

    truth = simulate(Scenario.load("quick").replace(**{"soil.friction_angle_deg": TRUTH_DEG}))
    noise = NOISE_N * np.random.default_rng(0).standard_normal(truth.force.shape)
    named = {**truth.provenance, "file": f"simulation with φ = {TRUTH_DEG:g}°"}
    return replace(truth, force=truth.force + noise, provenance=named)
