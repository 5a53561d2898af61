"""Assumptions about what was not measured stand in one module, within what is published."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from terraphi.experiment.priors import DENSITY, FOOT_FRICTION, FRICTION

SOURCE = Path(__file__).parents[2] / "src" / "terraphi"
ASSUMED = re.compile(
    r"(bulk_|soil_|assumed_|unknown_)?density(_sd)?(_kg_m3)?"
    r"|(leg_|surface_|foot_|soil_)?(friction|mu)(_sd)?|gain(_sd)?|hip_height_sd(_mm)?"
)
"""Names of values that only ``experiment/priors.py`` may set, in lower case."""
EXEMPT = {
    ("experiment/soil.py", "density"),  # of a simulated soil
    ("experiment/leg.py", "friction"),  # of a simulated leg
    ("laws/legs.py", "density"),  # of the soil that the law was simulated with
    ("laws/theory.py", "density"),  # cancels with the scale of the law
    ("laws/theory.py", "density"),  # of the poses that the law is scaled from
    ("robot/friction.py", "gain_sd"),  # threshold of a fit
}
"""Modules and values that assume nothing about a measurement."""
NOTHING = {0.0, 1.0}
"""No friction, no error; a gain of one."""


def numbers(node: ast.AST | None) -> list[float]:
    """Number, numbers of a tuple, or default of a ``Field`` that a value is."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return [float(node.value)]
    if isinstance(node, ast.Tuple):
        parts = [numbers(part) for part in node.elts]
        return [part[0] for part in parts] if all(parts) else []
    if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Field":
        return numbers(node.args[0]) if node.args else []
    return []


def values(tree: ast.AST) -> Iterator[tuple[str, ast.AST | None]]:
    """Names in a module with the values that it gives them."""
    for node in ast.walk(tree):
        if isinstance(node, ast.arguments):
            positional = [*node.posonlyargs, *node.args]
            yield from (
                (a.arg, d)
                for a, d in zip(reversed(positional), reversed(node.defaults), strict=False)
            )
            yield from ((a.arg, d) for a, d in zip(node.kwonlyargs, node.kw_defaults, strict=True))
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id, node.value
        elif isinstance(node, ast.Assign):
            for target in node.targets:
                parts = target.elts if isinstance(target, ast.Tuple) else [target]
                yield from ((n.id, node.value) for n in parts if isinstance(n, ast.Name))
        elif isinstance(node, ast.Call):
            yield from ((k.arg, k.value) for k in node.keywords if k.arg)
        elif isinstance(node, ast.Dict):
            pairs = zip(node.keys, node.values, strict=True)
            yield from ((str(k.value), v) for k, v in pairs if isinstance(k, ast.Constant))


def assumed(tree: ast.AST) -> set[str]:
    """Names of densities, frictions and gains to which a module gives a number."""
    return {
        name.lower() for name, value in values(tree)
        if ASSUMED.fullmatch(name.lower()) and {*numbers(value)} - NOTHING
    }  # fmt: skip


@pytest.mark.parametrize(
    ("code", "name"),
    [
        ("DENSITY, DENSITY_SD = 1550.0, 80.0", "density"),
        ("class Rig(Strict):\n    leg_friction: float = Field(0.3, ge=0)", "leg_friction"),
        ('soil = {"density": 1600.0}', "density"),
    ],
)
def test_number_for_an_unmeasured_quantity_is_found(code: str, name: str) -> None:
    assert name in assumed(ast.parse(code))
    assert not assumed(ast.parse(re.sub(r"\d+\.\d+", "DENSITY.mean", code)))


def test_no_other_module_assumes_a_density_friction_or_gain() -> None:
    elsewhere = {
        (path.relative_to(SOURCE).as_posix(), name)
        for path in SOURCE.rglob("*.py")
        if path.name != "priors.py" and path.relative_to(SOURCE).parts[0] != "paper"
        for name in assumed(ast.parse(path.read_text(encoding="utf-8")))
    }
    assert elsewhere == EXEMPT


def test_friction_covers_steel_on_sand() -> None:
    """Smooth and rusted steel on sand at its critical angle (Potyondy 1961; Bolton 1986)."""
    for part, most in ((0.54, 1.0), (0.76, 2.0)):
        friction = math.tan(math.radians(part * 33.0))
        assert abs(friction - FRICTION.mean) < most * FRICTION.sd


def test_friction_of_a_foot_is_between_polished_steel_and_soil_on_soil() -> None:
    """Published limits: 0.1 to 0.2 for polished steel, the soil's own friction for rough bodies."""
    low, high = (FOOT_FRICTION.mean + k * math.sqrt(3.0) * FOOT_FRICTION.sd for k in (-1.0, 1.0))
    assert 0.1 <= low < FRICTION.mean < high <= math.tan(math.radians(33.0))


def test_density_covers_uniform_sand() -> None:
    """Quartz of 2650 kg/m³ with the porosities of Terzaghi, Peck & Mesri (1996)."""
    loose, dense = (2650.0 * (1.0 - porosity) for porosity in (0.46, 0.34))
    assert DENSITY.mean == pytest.approx(0.5 * (loose + dense), rel=0.01)
    assert DENSITY.sd == pytest.approx(0.5 * (dense - loose), rel=0.02)
