"""A leg and a tool that are entered in their tables alone can be inverted and simulated."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

import terraphi
from terraphi.experiment.bodies import OUTLINES, TOOLS, Outline, ToolShape
from terraphi.experiment.leg import Leg
from terraphi.experiment.rig import Rig, Tool
from terraphi.forward.body import distance_to_leg, intruder_of

SIZES = {"length_mm": 76.2, "width_mm": 25.4, "thickness_mm": 6.4, "hip_height_mm": "20±0"}
BEND = 0.5
"""Curvature of the new leg over that of a semicircle."""


@pytest.fixture(autouse=True)
def new_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    """A shallow C, and a square plate with a word of its own."""
    monkeypatch.setitem(OUTLINES, "shallow", Outline("shallow C leg", BEND))
    square = ToolShape(
        "square", ("side",), "disc", lambda side: side / math.sqrt(math.pi), lambda _side: 0.98
    )
    monkeypatch.setitem(TOOLS, "square", square)


def test_new_leg_has_the_geometry_of_its_arc() -> None:
    """An arc on a chord 2 R sin α has the length 2 R α and the sagitta R (1 - cos α)."""
    leg = Leg(shape="shallow", chord=0.08, half_thickness=0.003)
    radius, alpha = 0.08, math.asin(BEND)
    assert leg.length == pytest.approx(2.0 * radius * alpha)
    line = leg.centre_line(2001)
    assert line.centre[:, 1].max() == pytest.approx(radius * (1.0 - math.cos(alpha)), rel=1e-5)
    assert line.length.sum() == pytest.approx(leg.length)
    np.testing.assert_allclose(leg.signed_distance(line.centre)[0], -0.003, rtol=1e-9)
    np.testing.assert_allclose(leg.signed_distance(leg.outline())[0], 0.0, atol=1e-12)
    # A quarter of the line left out at the tip: the chord of three quarters of the angle.
    chord, lean = leg.chord_without(0.25 * leg.length)
    assert chord == pytest.approx(2.0 * radius * math.sin(0.75 * alpha))
    assert lean == pytest.approx(0.25 * alpha)


@pytest.mark.parametrize("inset", [0.0, 0.01])
def test_new_leg_is_that_of_the_kernels(inset: float) -> None:
    leg = Leg(shape="shallow", chord=0.08, half_thickness=0.003)
    points = np.random.default_rng(0).uniform(-0.05, 0.12, (50, 2))
    intruder = intruder_of(leg, inset=inset)
    compiled = [distance_to_leg(intruder, s, m)[0] for s, m in points.tolist()]
    np.testing.assert_allclose(compiled, leg.signed_distance(points, inset=inset)[0], atol=1e-12)


def test_new_leg_is_inverted() -> None:
    rig = Rig.model_validate({"leg": "shallow", **SIZES})
    assert str(rig).startswith("shallow C leg 76.2")
    forces, of_straight = (
        terraphi.law("rft3d").forces({"leg": leg, **SIZES}, [32.0], density=1600.0)["forces"][0]
        for leg in ("shallow", "straight")
    )
    table = pd.DataFrame({
        "theta_deg": forces["theta_deg"].to_numpy(),
        "Fx_N": forces.sel(force="Fx").to_numpy(), "Fz_N": forces.sel(force="Fz").to_numpy(),
    })  # fmt: skip
    assert float(abs(forces - of_straight).max()) > 0.1 * np.ptp(table["Fz_N"])
    answer = terraphi.invert(table, rig=rig, density="1600±1", law="rft3d")
    assert answer.phi.median == pytest.approx(32.0, abs=0.3)
    with pytest.raises(terraphi.InputError, match="law legs has no shallow C leg"):
        terraphi.law("legs").forces(rig, [32.0])


def test_new_tool_is_inverted() -> None:
    """A square bears as the rectangle with two equal sides."""
    assert str(Tool.of("square:50")) == "square 50 mm"
    z = np.linspace(0.0, 40.0, 81)
    table = pd.DataFrame({"sinkage_mm": z, "force_N": 0.9 * z})
    square, rectangle = (
        terraphi.invert(table, tool=tool, density="1600±10")
        for tool in ("square:50", "plate:50x50")
    )
    assert square.phi.median == pytest.approx(rectangle.phi.median, abs=1e-9)
    assert square.phi.sd == pytest.approx(rectangle.phi.sd, abs=1e-9)
    named = terraphi.invert([(table, "square:50")], density="1600±10")
    assert named.phi.median == pytest.approx(square.phi.median, abs=1e-9)


@pytest.mark.parametrize("text", ["square:50x60", "cube:50", "plate:0.5"])
def test_tool_of_another_form_is_refused_with_the_forms(text: str) -> None:
    with pytest.raises(terraphi.InputError, match="plate:DIAMETER or plate:SIDExSIDE or ball:DIA"):
        Tool.of(text)
