"""Files of earlier versions, in ``tests/data/``, are read with the numbers that were written.

``python tests/test_earlier_files.py FOLDER`` writes a file of each kind by the version at hand, and
its numbers as JSON, of which arrays are the SHA-256 of their values.
"""

from __future__ import annotations

import hashlib
import html
import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pydantic import BaseModel

from terraphi import Answer, ForceHistory, Library, Scenario, invert, simulate
from terraphi.inference.footfalls import FootfallMap
from terraphi.laws.fitted import FittedLaw
from terraphi.laws.store import PHI, Case
from terraphi.robot.joint_log import JointLog
from terraphi.robot.results import foot_forces
from terraphi.terrain.map import map_slopes

DATA = Path(__file__).parent / "data"
ANGLES = np.linspace(-60.0, 60.0, 25)


class SmallLaw(FittedLaw):
    """Of two axes and three places."""

    AXES = ("phi", "width")
    PLACES = np.array([0.0, 0.5, 1.0])
    HYPER = (1, 2)


def read_robot_forces(path: Path) -> dict[str, Any]:
    """Variables and the summary of foot forces, of which only a report reads the file."""
    import h5py

    with h5py.File(path) as file:
        names = ("force", "sigma", "stance_begin", "pooled_mean")
        variables = {name: file[name][()] for name in names}
        return {**variables, "summary": json.loads(file.attrs["summary"])}


def read_map(folder: Path) -> dict[str, Any]:
    """Layers and numbers of a slope map."""
    import rasterio

    layers = {path.stem: rasterio.open(path).read(1) for path in folder.glob("*.tif")}
    return {**layers, "summary": json.loads((folder / "map.json").read_text(encoding="utf-8"))}


READERS: dict[str, Callable[[Path], Any]] = {
    "history.nc": ForceHistory.load,
    "pressed.nc": ForceHistory.load,
    "library.nc": Library.load,
    "strokes.nc": Answer.load,
    "plate.nc": Answer.load,
    "footfalls.nc": FootfallMap.load,
    "forces.nc": read_robot_forces,
    "law.nc": SmallLaw.load,
    "map": read_map,
}


# -- numbers --------------------------------------------------------------------------------------


def numbers_of(value: Any) -> Any:
    """A result as JSON has it; arrays by their shape and the SHA-256 of their values."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if is_dataclass(value):
        content = {f.name: getattr(value, f.name) for f in fields(value)}
        if isinstance(value, Answer):  # files had its angles next to its density
            reason = value.as_dict()["phi_plane_strain_reason"]
            content |= {"phi_plane_strain": value.phi_plane_strain, "parameters": {PHI: value.phi}}
            content["phi_plane_strain_reason"] = reason
        return numbers_of(content)
    if hasattr(value, "_asdict"):
        return numbers_of(value._asdict())
    if isinstance(value, np.ndarray):
        digest = hashlib.sha256(np.asarray(value, np.float64).tobytes()).hexdigest()
        return {"shape": list(value.shape), "sha256": digest}
    if isinstance(value, Mapping):
        return {str(key): numbers_of(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [numbers_of(item) for item in value]
    return value


def differences(now: Any, written: Any, key: str = "") -> list[str]:
    """Keys of what was written that is another value now, or gone."""
    if isinstance(written, dict) and isinstance(now, dict):
        return [
            name
            for at, value in written.items()
            for name in differences(now.get(at, "absent"), value, f"{key}.{at}")
        ]
    if isinstance(written, list) and isinstance(now, list) and len(now) == len(written):
        pairs = enumerate(zip(now, written, strict=True))
        return [name for i, (a, b) in pairs for name in differences(a, b, f"{key}.{i}")]
    # What is computed from what was written may differ by rounding.
    is_number = isinstance(now, float) and isinstance(written, float)
    same = math.isclose(now, written, rel_tol=1e-12) if is_number else now == written
    return [] if same else [f"{key}: {now!r}, expected {written!r}"]


def stored() -> list[Path]:
    return sorted(file for file in DATA.glob("*/*") if file.name in READERS)


@pytest.mark.parametrize("path", stored(), ids=lambda path: f"{path.parent.name}/{path.name}")
def test_earlier_files_are_read_with_the_numbers_that_were_written(path: Path) -> None:
    written = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    now = json.loads(json.dumps(numbers_of(READERS[path.name](path)), default=str))
    assert differences(now, written) == []


def test_results_show_themselves_in_five_lines_without_arrays() -> None:
    for name in READERS.keys() - {"forces.nc", "map"}:
        result = READERS[name](next(DATA.glob(f"*/{name}")))
        shown = repr(result)
        assert 1 <= len(shown.splitlines()) <= 5
        assert "array" not in shown
        assert result._repr_html_().startswith(f"<pre>{html.escape(shown)}</pre>")


# -- writing --------------------------------------------------------------------------------------


def write(folder: Path) -> None:
    """A file of each kind, and its numbers as this version reads them."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    write_simulations(folder, rng)
    write_answers(folder)
    write_walk(folder, rng)
    write_map(folder)
    SmallLaw(
        rng.normal(size=(4, 2)), rng.normal(size=4), rng.normal(size=(4, 2, 3)),
        rng.normal(size=(1, 2)), 1.2, {"straight": {"offset_deg": 0.5}}, {"cases": 4},
    ).save(folder / "law.nc")  # fmt: skip
    for name, read in READERS.items():
        text = json.dumps(numbers_of(read(folder / name)), default=str, ensure_ascii=False)
        (folder / name).with_suffix(".json").write_text(text + "\n", encoding="utf-8")


def write_simulations(folder: Path, rng: np.random.Generator) -> None:
    """Simulations of two angles and a failed one; forces along a displacement, with a moment."""
    few = {"rft.panels": 20, "motion.start_deg": -100.0, "motion.stop_deg": 100.0}
    base = Scenario.load("quick").replace(**few)
    first, second, third = (base.replace(**{PHI: phi}) for phi in (25.0, 40.0, 50.0))
    forces = [simulate(scenario) for scenario in (first, second)]
    thinned = [history.chosen(np.arange(len(history.position)) % 40 == 0) for history in forces]
    thinned[0].to_netcdf(folder / "history.nc")
    cases = [Case(*case) for case in zip((first, second), thinned, strict=True)]
    Library("small", (*cases, Case(third, None, "it broke down")), "two angles", "a test").save(
        folder / "library.nc"
    )
    numbers = np.linspace(0.0, 0.05, 20), rng.normal(size=(20, 3))
    origin = {"file": "made.csv", "measurement": "é"}
    pressed = ForceHistory(*numbers, "displacement", ("x", "y", "z"), origin, rng.normal(size=20))
    pressed.to_netcdf(folder / "pressed.nc")


def write_answers(folder: Path) -> None:
    """Of the moment in two strokes, and of a plate."""
    theta = np.radians(np.arange(-30.0, 61.0))
    moment = 0.3 * np.cos(theta) - 0.1 * np.sin(2.0 * theta)
    record = ForceHistory(theta, np.zeros((theta.size, 0)), axes=(), moment=moment)
    strokes = [record, record.scaled(1.1)]
    invert(strokes, rig="li2013", leg="straight", density=1600.0).to_netcdf(folder / "strokes.nc")
    sinkage = np.linspace(0.0, 30.0, 10)
    pressed = pd.DataFrame({"sinkage_mm": sinkage, "force_N": 8.0 * sinkage})
    invert(pressed, tool="plate:151", density=1500.0).to_netcdf(folder / "plate.nc")


def write_walk(folder: Path, rng: np.random.Generator) -> None:
    """Footfalls of which two are refused, and forces on the feet of a robot that does not move."""
    steps, points = np.arange(8), np.linspace(0.0, 1.4, 15)
    usable = np.where(steps < 6, 1.0, np.nan)
    place = rng.normal(size=(8, 3))
    FootfallMap(
        0.3 * steps, ("FR", "FL", "RR", "RL") * 2, place, np.full(8, 0.03), usable * (30.0 + steps),
        usable * 0.5, usable * 3.0, usable, ("usable",) * 6 + ("saturated", "too little sinkage"),
        np.column_stack([points, points, 0.0 * points]), 30.0 + points, np.full(15, 0.4),
        np.full(15, 3.0), {"field": {"sd_deg": 1.0}}, {"rft": 31.0}, ("density is assumed",),
        {"log": "walk.csv", "law": "rft"},
    ).to_netcdf(folder / "footfalls.nc")  # fmt: skip
    for ending in ("csv", "geojson"):
        (folder / f"footfalls.{ending}").unlink()
    time = 0.01 * np.arange(30)
    angle = np.broadcast_to([0.1, 0.8, -1.6], (len(time), 4, 3)).copy()
    torque = rng.normal(size=angle.shape) + 8.0 * np.sin(2.0 * np.pi * time / 0.4)[:, None, None]
    level, still = np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1)), np.zeros((len(time), 3))
    felt = np.tile([0.0, 0.0, 9.81], (len(time), 1))
    log = JointLog(time, angle, np.zeros_like(angle), torque, level, still, felt)
    foot_forces(log, estimator="quasi_static").to_netcdf(folder / "forces.nc")


def write_map(folder: Path) -> None:
    """Slopes of a hill of 12 m with twelve points on it, without its picture."""
    import rasterio

    place = rasterio.Affine(1.0, 0.0, 0.0, 0.0, -1.0, 12.0)
    heights = np.add.outer(0.5 * np.arange(12.0), 0.1 * np.sin(np.arange(12.0)))
    options = {"height": 12, "width": 12, "count": 1, "dtype": "float32", "crs": "EPSG:32611"}
    with rasterio.open(folder / "hill.tif", "w", "GTiff", transform=place, **options) as file:
        file.write(heights.astype("float32"), 1)
    x, y = (part.ravel() for part in np.meshgrid([2.0, 5.0, 8.0, 10.0], [2.0, 6.0, 10.0]))
    points = pd.DataFrame({"x_m": x, "y_m": y, "phi_deg": 30.0 + 0.3 * x, "sd_deg": 1.0})
    points.to_csv(folder / "points.csv", index=False)
    map_slopes(folder / "points.csv", folder / "hill.tif", draws=16).save(folder / "map")
    for name in ("hill.tif", "points.csv", "map/map.png", "map/manifest.json"):
        (folder / name).unlink()


if __name__ == "__main__":
    write(Path(sys.argv[1]))
