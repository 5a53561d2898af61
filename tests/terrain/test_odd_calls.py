"""Each argument of a public function on arrays with each odd value: an answer or one sentence."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import terraphi
from terraphi.experiment.errors import InputError
from terraphi.laws.foot import Foot
from terraphi.laws.wrench import Mesh, force, wrench

ODD = {
    "NaN": math.nan, "infinite": math.inf, "negative": -1.0, "zero": 0.0, "huge": 1e300,
    "larger than a float": 10**400, "complex": 1.0 + 2.0j, "bool": True, "text": "1", "none": None,
    "object": object(), "ragged": [[1.0, 2.0], [3.0]], "table": [[1.0, 2.0], [3.0, 4.0]],
    "empty": [], "dictionary": {"a": 1.0},
}  # fmt: skip
MOST = 1e6
"""Largest force [N] or moment [N m] that a foot of centimeters can have in any soil here."""
CORNERS = np.array([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)])
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
SAND = {"phi_deg": 33.0, "density": 1600.0, "surface_friction": 0.4}
POSES = np.array([[0.0, 0.0, -0.01], [0.1, 0.0, -0.02]])
HELD = {"held": (np.ones((2, 3)), np.ones((2, 3))), "step": 0.01, "stiffness": 1e3}
PLATES = {
    "points": np.array([[0.0, 0.0, -0.02], [0.01, 0.0, -0.02]]), "normals": -np.eye(3)[[2, 2]],
    "areas": np.array([1e-4, 1e-4]), "velocities": np.full((2, 3), -0.1), "about": np.zeros(3),
    "surface": 0.0, "rest_speed": 0.01, **SAND,
}  # fmt: skip
TETRAHEDRON = Mesh.of(CORNERS, FACES)
FEET = {
    "foot": Foot(0.022), "pose": POSES, "velocity": np.full((2, 3), -0.1), "surface": 0.0,
    "rest_speed": 0.01, **SAND,
}  # fmt: skip


def mesh_force(**given: Any) -> Any:
    return force(Mesh(**given), [0.0, 0.0, -0.01], [0.0, 0.0, -0.1], **SAND)


def mesh_of(**given: Any) -> Any:
    mesh = Mesh.of(given.pop("mesh"), given.pop("triangles"), **given)
    return mesh.faces


def soil_force(**given: Any) -> Any:
    sand = terraphi.soil(given.pop("what"), phi=given.pop("phi"), density=given.pop("density"))
    return sand.force(Foot(0.022), [0.0, 0.0, 0.0], [0.0, 0.0, -0.1])


def ball_force(**given: Any) -> Any:
    return force(Foot(**given), [0.0, 0.0, 0.0], [0.0, 0.0, -0.1], **SAND)


CALLS: dict[str, tuple[Any, dict[str, Any]]] = {
    "force on a ball": (force, FEET),
    "force held": (force, {**FEET, **HELD}),
    "force on a mesh": (
        force,
        {**FEET, "foot": TETRAHEDRON, "pose": np.hstack([POSES, np.eye(4)[[0, 0]]]),
         "velocity": np.full((2, 6), -0.1)},
    ),
    "wrench": (wrench, {**PLATES, "law": "foot"}),
    "wrench by rft": (wrench, {**PLATES, "law": "rft"}),
    "Mesh": (mesh_force, {"corners": TETRAHEDRON.corners}),
    "Mesh.of": (mesh_of, {"mesh": CORNERS, "triangles": FACES, "longest": 0.05}),
    "Foot": (ball_force, {"radius": 0.022, "shape": "ball"}),
    "soil": (soil_force, {"what": None, "phi": 33.0, "density": 1600.0}),
    "soil.draws": (lambda **given: terraphi.soil(33).draws(**given), {"n": 5, "rng": 1}),
}  # fmt: skip
"""Functions, and arguments that are right."""
FILES = ("points", "dem", "wetness", "covariate")
NAMES = {"what": "soil|phi", "n": "draws", "x_m": "x_m|outside", "y_m": "y_m|outside",
         **{name: f"{name}|no such file" for name in FILES}}  # fmt: skip
"""What a sentence calls an argument, if not by its name."""


def with_odd(array: Any, value: Any) -> Any:
    """An array with a value in its last place."""
    if isinstance(array, tuple):
        return (array[0], with_odd(array[1], value))
    rows = array.astype(object)
    rows[(-1,) * rows.ndim] = value
    try:
        return rows.astype(type(value)) if isinstance(value, bool | complex | float) else rows
    except (TypeError, ValueError):
        return rows


def odd_values(right: Any) -> Iterator[tuple[str, Any]]:
    """Values in place of an argument, and in the last place of an array."""
    for odd, value in ODD.items():
        yield odd, value
        if isinstance(right, np.ndarray | tuple):
            yield f"with {odd}", with_odd(right, value)


def outcome(function: Any, given: dict[str, Any], name: str) -> str:
    """``answer``, ``refusal``, or what is wrong with the one or the other."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            warnings.simplefilter("ignore", UserWarning)
            answer = function(**given)
    except InputError as error:
        named = re.search(NAMES.get(name, name), str(error)) and "\n" not in str(error)
        return "refusal" if named else f"a sentence without its argument: {error}"
    except Exception as error:
        return f"raw {type(error).__name__}: {error}"
    numbers = np.concatenate([np.ravel(np.asarray(part, dtype=np.float64)) for part in answer])
    sane = np.isfinite(numbers).all() and np.abs(numbers).max(initial=0.0) < MOST
    return "answer" if sane else f"nonsense: {numbers[:6]}"


def check(function: Any, right: dict[str, Any], values: Any = odd_values) -> None:
    """Call a function with odd values in place of each argument."""
    assert outcome(function, right, "") == "answer"
    outcomes = {
        f"{name} {odd}": outcome(function, {**right, name: value}, name)
        for name in right for odd, value in values(right[name])
    }  # fmt: skip
    assert not {key: text for key, text in outcomes.items() if text not in ("answer", "refusal")}


@pytest.mark.parametrize("call", CALLS)
def test_an_odd_value_has_an_answer_or_one_sentence(call: str) -> None:
    check(*CALLS[call])


def slope_map(points: Any, dem: Any, **given: Any) -> Any:
    layers = getattr(terraphi, "map")(points, dem, **given).layers  # noqa: B009
    return layers["p_unstable"], layers["phi_median"]


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
def test_an_odd_value_of_a_map_has_an_answer_or_one_sentence(hill: Any) -> None:
    pytest.importorskip("rasterio")
    rng, pandas = np.random.default_rng(0), pytest.importorskip("pandas")
    rows = {"x_m": rng.uniform(2.0, 18.0, 8), "y_m": rng.uniform(2.0, 18.0, 8),
            "phi_deg": rng.normal(33.0, 2.0, 8), "sd_deg": np.full(8, 2.0)}  # fmt: skip
    right = {
        "points": pandas.DataFrame(rows), "dem": hill(n=20), "start": None, "draws": 16, "seed": 0,
        "prior": ["wetness=0.2"], "wetness": None, "covariate": None,
    }  # fmt: skip
    check(slope_map, right, lambda given: ((k, v) for k, v in ODD.items() if v is not given))

    def map_of_columns(**columns: Any) -> Any:
        return slope_map(pandas.DataFrame({**rows, **columns}), right["dem"], draws=16)

    def in_last_row(column: Any) -> Any:
        return ((odd, with_odd(column, value)) for odd, value in ODD.items())

    check(map_of_columns, {name: rows[name] for name in ("x_m", "phi_deg")}, in_last_row)
