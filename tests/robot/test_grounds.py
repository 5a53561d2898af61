"""Walks on ground whose law is not one of ours: without φ it is refused by name, sand is not."""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from terraphi.inference.footfalls import NO_ANGLE, USABLE
from terraphi.inference.grounds import Comparison
from terraphi.laws.foot import LAWS, Foot
from terraphi.robot.footfalls import footfalls
from terraphi.robot.joint_log import cut
from terraphi.robot.online import Footfalls

RADIUS = 0.022
GroundWalk = runpy.run_path(str(Path(__file__).with_name("walker.py")))["GroundWalk"]


def clay(strength: float, hardening: float = 0.0) -> Callable[[np.ndarray], np.ndarray]:
    """Nine times its strength [Pa], which grows with depth [Pa/m], on the area of contact."""

    def force(depth: np.ndarray) -> np.ndarray:
        cap = np.clip(depth, 0.0, RADIUS)
        area = np.pi * cap * (2.0 * RADIUS - cap)
        # A little more with depth, so that there is one depth for each force.
        return 9.0 * (strength + hardening * depth) * area + 10.0 * np.maximum(depth, 0.0)

    return force


def layer(stiffness: float, power: float = 1.0) -> Callable[[np.ndarray], np.ndarray]:
    return lambda depth: stiffness * RADIUS * (np.maximum(depth, 0.0) / RADIUS) ** power


def displaced(phi_deg: float) -> Callable[[np.ndarray], np.ndarray]:
    """Archimedes' law for grains, as large as law foot one radius deep."""

    def volume(depth: np.ndarray) -> np.ndarray:
        cap = np.clip(depth, 0.0, RADIUS)
        below = np.maximum(depth - RADIUS, 0.0)
        return np.pi * cap**2 * (RADIUS - cap / 3.0) + np.pi * RADIUS**2 * below

    scale = by_law("foot", phi_deg)(np.array(RADIUS)) / volume(np.array(RADIUS))
    return lambda depth: scale * volume(depth)


def by_law(name: str, phi_deg: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda depth: LAWS[name].force(
        Foot(RADIUS), depth, 0.5 * np.pi, friction_angle_deg=phi_deg, density=1550.0,
        surface_friction=0.4,
    )[..., 1]  # fmt: skip


@pytest.mark.parametrize(
    ("ground", "name"),
    [
        (clay(6.5e3), r"clay, turf .*shear strength [67] kPa"),
        (layer(6e3), r"mat, foam, snow .*by [56]\.\d N/mm"),
        pytest.param(clay(8e3), r"clay, turf .*[78] kPa", marks=pytest.mark.slow),
        pytest.param(clay(3e3, 1e5), "mat, foam, snow or clay", marks=pytest.mark.slow),
        pytest.param(layer(4e3), "mat, foam, snow", marks=pytest.mark.slow),
        pytest.param(layer(4e3, 0.6), "clay, turf", marks=pytest.mark.slow),
    ],
)
def test_ground_without_an_angle_is_refused_by_name(ground: Callable, name: str) -> None:  # type: ignore[type-arg]
    result = footfalls(GroundWalk(duration=8.0, ground=ground).log()[0], density=1550)
    assert not result.usable.any()
    assert result.verdict.count(NO_ANGLE) > 0.8 * len(result.verdict)
    assert np.isnan(result.path_phi).all()
    assert re.search(f"not a soil with a friction angle: .*{name}", result.warnings[0])


@pytest.mark.parametrize(
    ("ground", "phi_deg"),
    [
        (displaced(40.0), 40.0),
        (by_law("hansen", 38.0), None),
        pytest.param(displaced(36.0), 36.0, marks=pytest.mark.slow),
        pytest.param(by_law("rft", 42.0), None, marks=pytest.mark.slow),
        pytest.param(by_law("meyerhof", 38.0), None, marks=pytest.mark.slow),
    ],
)
def test_sand_of_another_law_is_usable(ground: Callable, phi_deg: float | None) -> None:  # type: ignore[type-arg]
    result = footfalls(GroundWalk(duration=8.0, ground=ground).log()[0], density=1550)
    assert result.usable.mean() > 0.8
    if phi_deg is not None:
        assert result.phi[result.usable].mean() == pytest.approx(phi_deg, abs=2.0)
    assert result.phi[result.usable].std() < 0.9


@pytest.mark.slow
@pytest.mark.parametrize("ground", [clay(3e3, 2e5), by_law("meyerhof", 38.0)])
def test_clay_that_triples_its_strength_cannot_be_told_from_meyerhofs_sand(
    ground: Callable,  # type: ignore[type-arg]
) -> None:
    """Both grow with depth alike: the walk says that it may be either."""
    result = footfalls(GroundWalk(duration=8.0, ground=ground).log()[0], density=1550)
    assert result.usable.all()
    assert "clay that stiffens with depth" in result.warnings[0]
    assert result.phi[result.usable].mean() == pytest.approx(
        38.0, abs=2.0 * result.absolute_sd.max()
    )


def test_a_robot_that_walks_on_clay_has_no_angle_from_the_first_footfalls_on() -> None:
    log = GroundWalk(duration=13.0, ground=clay(6.5e3)).log()[0]
    walk, footfalls_so_far = Footfalls(density=1550), []
    for start in range(0, len(log.time), 500):
        footfalls_so_far += walk.update(cut(log, slice(start, start + 500)), wait=True)
    assert len(footfalls_so_far) > 30
    assert not any(footfall.verdict == USABLE for footfall in footfalls_so_far)
    assert any("clay" in text for text in walk.warnings)
    assert walk.map().verdict.count(NO_ANGLE) > 30


def test_too_few_footfalls_to_know_the_ground_are_noted() -> None:
    log = GroundWalk(duration=3.0, ground=clay(6.5e3)).log()[0]
    result = footfalls(log, density=1550)
    assert "too few to tell sand from clay" in result.warnings[0]
    assert "absolute interval is wide" in result.warnings[0]


def test_laws_are_compared_by_what_they_read_of_the_same_footfalls() -> None:
    """Slow footfalls may lie on another soil than the rest, which is no difference of laws."""
    laws = Comparison("", {"foot": 0.7, "rft": 0.3}, {"foot": 35.0, "rft": 40.0}, read_deg=36.0)
    assert laws.spread_deg("foot") == pytest.approx(4.0 * 0.3**0.5)
