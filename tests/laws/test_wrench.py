"""Force and moment on feet in simulators: against the law, the plain sum, other arrays, MuJoCo."""

from __future__ import annotations

import itertools
import math
import sys
from typing import Any

import mujoco
import numpy as np
import pytest
from go2.model import FOOT_RADIUS, Physics, build, joint_dofs
from go2.walk import POSTURE
from scipy.optimize import brentq, least_squares
from scipy.spatial import ConvexHull

import terraphi
from terraphi.experiment.errors import InputError
from terraphi.forward.feet import FADE, compiled
from terraphi.forward.rft import from_plane_strain, stress_scale, unit_stress
from terraphi.laws import wrench as wrench_module
from terraphi.laws.foot import LAWS, Foot, inertial_force
from terraphi.laws.wrench import Mesh, force, wrench
from terraphi.robot.joint_log import FEET

SAND: dict[str, Any] = {"phi_deg": 33.0, "density": 1600.0, "surface_friction": 0.4}
RADIUS = 0.022
PHI, DEPTHS = (18.0, 25.0, 32.0, 40.0, 48.0), (0.1, 0.3, 0.6, 1.0, 1.5, 2.0, 3.5)


def lattice(count: int) -> np.ndarray:
    return np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)


def triangles(points: Any, normals: Any, areas: Any) -> Mesh:
    """Equilateral triangles of these centres, normals and areas."""
    across = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1)[:, None]
    size = np.sqrt(4.0 / (3.0 * np.sqrt(3.0)) * areas)[:, None]
    turn = 2.0 * np.pi / 3.0 * np.arange(3)
    sides = [across * np.cos(a) + np.cross(normals, across) * np.sin(a) for a in turn]
    return Mesh(points[:, None] + size[:, None] * np.stack(sides, axis=1))


def ball(count: int = 2000, radius: float = RADIUS) -> Mesh:
    """The hull of a Fibonacci lattice, of the area of a sphere."""
    up, turn = 1.0 - (2.0 * np.arange(count // 2) + 1.0) / (count // 2), lattice(count // 2)
    level = np.sqrt(1.0 - up**2)
    places = np.stack([level * np.cos(turn), level * np.sin(turn), up], axis=1)
    hull = ConvexHull(places)
    corners = radius * math.sqrt(4.0 * math.pi / hull.area) * places[hull.simplices]
    inward = np.linalg.det(corners) < 0.0
    corners[inward] = corners[inward, ::-1]
    return Mesh(corners)


def disc(count: int = 400) -> Mesh:
    """The two sides of a thin disc."""
    far, turn = RADIUS * np.sqrt((np.arange(count) + 0.5) / count), lattice(count)
    points = np.stack([far * np.cos(turn), far * np.sin(turn), 0.0 * turn], axis=1)
    sides = np.repeat([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], count, axis=0)
    return triangles(np.tile(points, (2, 1)), sides, np.full(2 * count, np.pi * RADIUS**2 / count))


CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
TRIANGLES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7],
             [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3], [0, 0, 1]]  # fmt: skip


def sole(longest: float | None = None) -> Mesh:
    """A box of triangles."""
    return Mesh.of((CORNERS - 0.5) * [0.1, 0.06, 0.03], TRIANGLES, longest=longest)


def box(size: tuple[float, float, float], n: int = 8) -> Mesh:
    """A sole of triangles as small as the longest side over a number."""
    return Mesh.of((CORNERS - 0.5) * size, TRIANGLES, longest=max(size) / n)


def going(descent_deg: float, heading: float = 0.0) -> np.ndarray:
    turn = math.radians(descent_deg)
    ahead = math.cos(turn)
    return 0.3 * np.array([ahead * math.cos(heading), ahead * math.sin(heading), -math.sin(turn)])


@pytest.mark.parametrize(
    ("shape", "limit"), [("ball", 0.02), ("disc", 0.001)], ids=["ball", "disc"]
)
def test_meshes_of_a_ball_and_a_disc_have_the_force_of_the_law(shape: Any, limit: float) -> None:
    """The error that the docs state: 2 % of the force for a ball and 0.1 % for a disc.

    Friction on a flat sole is at most μ_s times the lift, where the law's drag goes beyond it.
    """
    mesh, foot = (ball(8000) if shape == "ball" else disc()), Foot(RADIUS, shape)
    phi, ratio = (grid.ravel() for grid in np.meshgrid(PHI, DEPTHS))
    place = np.zeros((phi.size, 3))
    place[:, 2] = RADIUS * ((shape == "ball") - ratio)
    for mu, descent in itertools.product((0.2, 0.35, 0.5), (90.0, 75.0, 45.0, 20.0, 10.0)):
        soil = {"density": 1600.0, "surface_friction": mu}
        result, _ = force(mesh, place, going(descent), phi_deg=phi, **soil)
        expected = LAWS["foot"].force(
            foot, ratio * RADIUS, math.radians(descent), friction_angle_deg=phi, **soil
        )
        if shape == "disc":
            expected[:, 0] = np.maximum(expected[:, 0], -mu * expected[:, 1])
        size = np.linalg.norm(expected, axis=1)
        assert (np.linalg.norm(result[:, [0, 2]] - expected, axis=1) < limit * size).all()
        assert np.abs(result[:, 1]).max() < 1e-3 * size.max()


@pytest.mark.parametrize(
    ("shape", "descent"), [("ball", 50.0), ("ball", -40.0), ("disc", 90.0), ("disc", 10.0)]
)
def test_a_foot_has_the_force_of_the_law_in_its_heading(shape: Any, descent: float) -> None:
    foot, heading = Foot(RADIUS, shape), 2.0
    place = np.array([0.3, -0.2, RADIUS * ((shape == "ball") - 1.3) + 0.05])
    result, moment = force(
        foot, place, going(descent, heading), surface=0.05, inertia=False, **SAND
    )
    along, lift = LAWS["foot"].force(
        foot, 1.3 * RADIUS, math.radians(descent), friction_angle_deg=33.0, density=1600.0,
        surface_friction=0.4,
    )  # fmt: skip
    expected = [along * math.cos(heading), along * math.sin(heading), lift]
    np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-9)
    # What turns a ball is friction, which acts against its motion below its center.
    ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
    turning = moment @ np.cross([0.0, 0.0, 1.0], ahead)
    assert np.linalg.norm(moment) == pytest.approx(abs(turning), abs=1e-12)
    assert abs(turning) <= 0.4 * RADIUS * np.linalg.norm(result) * (shape == "ball") + 1e-12


def test_resistive_force_theory_is_the_plain_sum_over_faces() -> None:
    mesh, velocity = ball(1000), going(50.0, 1.0)
    points = mesh.points + np.array([0.1, 0.2, 0.6 * RADIUS])
    about = np.array([0.1, 0.0, 0.3])
    result, moment = wrench(
        points, mesh.normals, mesh.areas, velocity, law="rft", about=about, **SAND
    )
    scale = stress_scale(from_plane_strain(33.0), 1600.0)
    alpha = scale * unit_stress(mesh.normals, velocity / 0.3, 0.4)
    each = alpha * (np.maximum(-points[:, 2], 0.0) * mesh.areas)[:, None]
    size = np.linalg.norm(each.sum(axis=0))
    # Faces that hardly lead or are nearly upright differ, where the published law jumps.
    np.testing.assert_allclose(result, each.sum(axis=0), atol=0.02 * size)
    torque = np.cross(points - about, each).sum(axis=0)
    np.testing.assert_allclose(moment, torque, atol=0.02 * np.linalg.norm(torque))


def test_stress_goes_over_from_one_side_of_the_vertical_to_the_other() -> None:
    tilt, velocity = np.linspace(-0.3, 0.3, 2401), np.array([1.0, 0.0, 0.0])
    normals = np.stack([np.cos(tilt), 0.0 * tilt, np.sin(tilt)], axis=1)
    moving = np.tile(velocity, (tilt.size, 1))
    jumps, smooth = (unit_stress(normals, moving, 0.3, **fade) for fade in ({}, {"fade": FADE}))
    assert np.abs(np.diff(jumps, axis=0)).max() > 0.03
    assert np.abs(np.diff(smooth, axis=0)).max() < 0.001
    far = np.abs(np.sin(tilt)) > FADE
    np.testing.assert_allclose(smooth[far], jumps[far], rtol=1e-12)
    # A vertical face has the mean of both sides.
    np.testing.assert_allclose(smooth[1200], jumps[[1198, 1202]].mean(axis=0), atol=1e-3)


def test_wrenches_of_many_feet_are_those_of_each() -> None:
    rng, mesh = np.random.default_rng(3), ball(30, 0.03)
    points = mesh.points + rng.uniform(-0.05, 0.05, (7, 4, 1, 3))
    velocity, about = (
        rng.standard_normal((7, 4, len(mesh.areas), 3)),
        rng.standard_normal((7, 4, 3)),
    )
    soil = {**SAND, "phi_deg": rng.uniform(25.0, 40.0, (7, 4)),
            "density": rng.uniform(1400.0, 1700.0, (7, 4))}  # fmt: skip
    result, moment = wrench(points, mesh.normals, mesh.areas, velocity, about=about, **soil)
    assert result.shape == moment.shape == (7, 4, 3)
    reference = {**soil, "phi_deg": soil["phi_deg"][2, 3], "density": soil["density"][2, 3]}
    first = wrench(
        points[2, 3], mesh.normals, mesh.areas, velocity[2, 3], about=about[2, 3], **reference
    )
    np.testing.assert_allclose(first, (result[2, 3], moment[2, 3]), rtol=1e-12)
    # About another point it differs by the force times the distance.
    _, other = wrench(points, mesh.normals, mesh.areas, velocity, **soil)
    np.testing.assert_allclose(other, moment + np.cross(about, result), rtol=1e-9, atol=1e-12)


def test_a_pose_is_the_mesh_turned_and_moved() -> None:
    """Against the corners that MuJoCo's own quaternions place."""
    rng, mesh = np.random.default_rng(5), box((0.1, 0.06, 0.03))
    for _ in range(10):
        quaternion, spin, linear = rng.standard_normal(4), *rng.standard_normal((2, 3))
        quaternion /= np.linalg.norm(quaternion)
        place, turn = rng.uniform(-0.05, 0.03, 3), np.zeros(9)
        mujoco.mju_quat2Mat(turn, quaternion)
        moving = np.concatenate([linear, spin])
        turned = mesh.corners @ turn.reshape(3, 3).T
        expected = force(Mesh(turned), place, moving, **SAND)
        total_force = force(mesh, np.concatenate([place, quaternion]), moving, **SAND)
        np.testing.assert_allclose(total_force, expected, rtol=1e-9, atol=1e-9)
        # The same motion about another origin: v + ω × d there, and the moment less d × F.
        arm = rng.uniform(-0.05, 0.05, 3)
        moving = np.concatenate([linear + np.cross(spin, arm), spin])
        f, moment = force(Mesh(turned - arm), place + arm, moving, **SAND)
        np.testing.assert_allclose(f, expected[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(moment + np.cross(arm, f), expected[1], rtol=1e-9, atol=1e-9)


def test_points_normals_and_areas_are_for_another_function() -> None:
    with pytest.raises(InputError, match="call wrench"):
        Mesh(np.zeros((1, 3)), np.ones((1, 3)), np.ones(1))


def test_triangles_are_submerged_in_part() -> None:
    """A sole in any attitude has the force of faces that are small, and their moment."""
    rng = np.random.default_rng(0)
    pose = np.zeros((20, 7))
    pose[:, 2], pose[:, 3] = rng.uniform(-0.02, 0.02, 20), 1.0
    pose[:, 4:6] = rng.normal(0.0, 0.2, (20, 2))
    velocity = rng.normal(0.0, 0.1, (20, 3)) - [0.0, 0.0, 0.1]
    coarse, fine = (force(sole(longest), pose, velocity, **SAND) for longest in (0.2, 0.01))
    assert len(sole(0.2).areas) == 12
    size = np.abs(fine[0]).max()
    # Exact but for rounding, for the soil's stress is linear in the depth.
    np.testing.assert_allclose(coarse[0], fine[0], atol=1e-9 * size)
    np.testing.assert_allclose(coarse[1], fine[1], atol=1e-9 * size)
    # And as faces by their centres, which are in soil or not.
    small, turns = sole(0.002), np.zeros((20, 9))
    for turn, at in zip(turns, pose, strict=True):
        mujoco.mju_quat2Mat(turn, at[3:] / np.linalg.norm(at[3:]))
    points, normals = (
        np.einsum("fij,kj->fki", turns.reshape(-1, 3, 3), vectors)
        for vectors in (small.points, small.normals)
    )
    expected = wrench(points + pose[:, None, :3], normals, small.areas, velocity[:, None],
                      about=pose[:, :3], **SAND)  # fmt: skip
    np.testing.assert_allclose(coarse[0], expected[0], atol=3e-3 * size)
    np.testing.assert_allclose(coarse[1], expected[1], atol=3e-3 * size * 0.05)


def test_a_mesh_of_triangles_has_the_faces_and_faces_outward() -> None:
    corners, triangles = CORNERS, TRIANGLES
    assert len(Mesh.of(corners, triangles, longest=2.0).areas) == 12
    mesh = Mesh.of(corners, triangles)
    assert len(mesh.areas) == 48
    assert mesh.areas.sum() == pytest.approx(6.0)
    # Of a closed surface: no net area, and its volume.
    np.testing.assert_allclose(mesh.normals.T @ mesh.areas, 0.0, atol=1e-12)
    assert np.vecdot(mesh.points, mesh.normals) @ mesh.areas / 3.0 == pytest.approx(1.0)
    broken = (corners + np.inf, triangles)
    for wrong in ((corners[:, :2], triangles), (corners, [[0, 0, 1]]), (object(),), broken):
        with pytest.raises(InputError, match="mesh"):
            Mesh.of(*wrong)


def rim(radius: float = 0.06, width: float = 0.05, count: int = 240) -> Mesh:
    """The rim of a smooth wheel, its axle along y."""
    turn = (np.arange(count) + 0.5) / count * 2.0 * np.pi
    normals = np.stack([np.sin(turn), 0.0 * turn, -np.cos(turn)], axis=1)
    return triangles(
        radius * normals, normals, np.full(count, 2.0 * np.pi * radius * width / count)
    )


def bounded_faces(stress: Any, normals: Any, velocities: Any, friction: float) -> np.ndarray:
    """Forces on faces that take energy and keep Coulomb's bound, face by face."""
    forces = []
    for f, n, velocity in zip(stress, normals, velocities, strict=True):
        v = velocity / np.linalg.norm(velocity)
        f = f - max(f @ v, 0.0) * v
        pressure = max(-f @ n, 0.0)
        along = f + pressure * n
        size = max(float(np.linalg.norm(along)), 1e-30)
        forces.append(along * min(1.0, friction * pressure / size) - pressure * n)
    return np.array(forces)


BODIES = {
    # Faces, height of the origin, velocity and spin of a wheel with slip, a box and a ball.
    "wheel": (rim(), 0.048, (0.8 * 0.06, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "braked wheel": (rim(), 0.048, (1.3 * 0.06, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "box": (box((0.1, 0.06, 0.03), 6), -0.01, (0.05, 0.0, -0.1), (0.0, 0.3, 0.0)),
    "ball": (ball(300), 0.005, (0.07, 0.0, -0.1), (0.0, 0.0, 0.0)),
}


@pytest.mark.parametrize(("body", "friction"), [*zip(BODIES, [0.2, 0.3, 0.5, 0.3], strict=True)])
def test_each_face_keeps_the_bound_of_coulomb(body: str, friction: float) -> None:
    """With d and l from force and lift, the moment is that of faces that keep the bound."""
    mesh, height, linear, spin = BODIES[body]
    about, scale = np.array([0.0, 0.0, height]), 1600.0 * 9.81
    points, velocities = mesh.points + about, np.cross(spin, mesh.points) + linear
    result, moment = wrench(
        points, mesh.normals, mesh.areas, velocities, about=about, phi_deg=30.0, density=1600.0,
        surface_friction=friction, rest_speed=1e-6,
    )  # fmt: skip

    direction = velocities / np.linalg.norm(velocities, axis=1)[:, None]
    stress = unit_stress(mesh.normals, direction, friction, fade=FADE)
    stress *= (scale * np.maximum(-points[:, 2], 0.0) * mesh.areas)[:, None]

    def faces(ratios: np.ndarray) -> np.ndarray:
        d, lift = ratios
        return bounded_faces(stress * [d, d, lift], mesh.normals, velocities, friction)

    def missing(ratios: np.ndarray) -> np.ndarray:
        return faces(ratios).sum(axis=0)[[0, 2]] - result[[0, 2]]

    ratios = least_squares(missing, [20.0, 30.0], x_scale="jac", xtol=1e-14, ftol=1e-14).x
    size = np.linalg.norm(result)
    assert np.abs(missing(ratios)).max() < 1e-6 * size
    torque = np.cross(mesh.points, faces(ratios)).sum(axis=0)
    np.testing.assert_allclose(moment, torque, atol=2e-4 * size * mesh.reach)


def test_friction_on_a_plate_keeps_the_bound_and_is_mobilized_by_shearing() -> None:
    """A face alone: its friction is bounded, and times 1 - exp(-j/K)."""
    turn, descent = np.radians([60.0, 30.0, 5.0, -20.0]), np.radians([85.0, 60.0, 30.0, 10.0])
    tilt, down = (grid.ravel() for grid in np.meshgrid(turn, descent))
    normals = np.stack([np.sin(tilt), 0.0 * tilt, -np.cos(tilt)], axis=1)
    velocities = np.stack([np.cos(down), 0.0 * down, -np.sin(down)], axis=1)
    plates = (np.tile([0.0, 0.0, -0.02], (tilt.size, 1, 1)), normals[:, None], [1e-3],
              velocities[:, None])  # fmt: skip
    soil = {**SAND, "surface_friction": 0.3}
    full, _ = wrench(*plates, **soil)
    pressure = -np.vecdot(full, normals)
    friction = full + pressure[:, None] * normals
    assert (pressure >= 0.0).all()
    assert (np.linalg.norm(friction, axis=1) <= 0.3 * pressure + 1e-9).all()
    assert (np.linalg.norm(friction, axis=1) > 0.29 * pressure)[pressure > 0.0].any()
    sheared = np.linspace(0.0, 0.03, tilt.size)
    half, _ = wrench(*plates, mobilization=0.01, sheared=sheared[:, None], **soil)
    share = 1.0 - np.exp(-sheared / 0.01)
    expected = share[:, None] * friction - pressure[:, None] * normals
    np.testing.assert_allclose(half, expected, atol=1e-9)
    published = soil | {"law": "rft"}
    none, _ = wrench(*plates, mobilization=0.01, sheared=0.0 * sheared[:, None], **published)
    along = none - (none * normals).sum(axis=1, keepdims=True) * normals
    np.testing.assert_allclose(along, 0.0, atol=1e-9)  # no friction before it shears


def test_a_foot_deeper_than_was_simulated_is_warned_of() -> None:
    for foot, radius in ((Foot(RADIUS), RADIUS), (ball(200), RADIUS)):
        force(foot, [0.0, 0.0, -3.5 * radius], going(90.0), **SAND)
        place = np.array([[0.0, 0.0, -1000.0 * radius]])
        for call in (force, terraphi.soil("loose dry sand").force):
            with pytest.warns(UserWarning, match="deeper than 5") as warned:
                call(foot, place, going(90.0)[None], **SAND)
            assert warned[0].filename == __file__  # of who called


def test_traced_arrays_have_the_same_force() -> None:
    jax = pytest.importorskip("jax")
    pose, velocity = np.tile([0.0, 0.0, 0.005], (4, 1)), np.tile(going(60.0), (4, 1))
    held = np.zeros((4, 3)), np.zeros((4, 3))

    def moved(place: Any, speed: Any, phi: Any, before: Any) -> Any:
        return force(
            Foot(RADIUS), place, speed, phi_deg=phi, density=1600.0, held=before, step=0.01,
            stiffness=1e4,
        )  # fmt: skip

    phi = np.array([30.0, 32.0, 34.0, 36.0])
    given = [jax.numpy.asarray(item) for item in (pose, velocity, phi)]
    traced = jax.jit(moved)(*given, tuple(map(jax.numpy.asarray, held)))
    np.testing.assert_allclose(traced[0], moved(pose, velocity, phi, held)[0], rtol=1e-4)


def test_a_flat_sole_bears_as_a_disc_of_its_area_and_changes_steadily_with_its_tilt() -> None:
    sole, size = box((0.1, 0.06, 0.03), 20), math.sqrt(0.006 / math.pi)
    flat, _ = force(sole, [0.0, 0.0, -0.005], going(90.0), **SAND)
    disc_, _ = force(Foot(size, "disc"), [0.0, 0.0, -0.02], going(90.0), inertia=False, **SAND)
    assert flat[2] == pytest.approx(disc_[2], rel=1e-3)
    half = 0.5 * np.radians(np.linspace(-20.0, 20.0, 401))
    pose = np.stack([0 * half, 0 * half, 0 * half - 0.005, np.cos(half), 0 * half, np.sin(half),
                     0 * half], axis=1)  # fmt: skip
    tilted, moment = force(sole, pose, going(90.0), **SAND)
    assert np.abs(np.diff(tilted, axis=0)).max() < 0.02 * flat[2]
    np.testing.assert_allclose(tilted[:, 2], tilted[::-1, 2], rtol=1e-9)
    # It is turned back to the level: down by the right means a moment to the left, and reverse.
    assert (moment[250:, 1] < 0.0).all()
    assert (moment[:150, 1] > 0.0).all()


FEET_OF_ALL_KINDS = {"ball": Foot(RADIUS), "disc": Foot(RADIUS, "disc"), "mesh": ball(200),
                     "box": box((0.1, 0.06, 0.03))}  # fmt: skip


@pytest.mark.filterwarnings("ignore:a foot is")  # 0.3 m deep
@pytest.mark.parametrize("foot", FEET_OF_ALL_KINDS.values(), ids=FEET_OF_ALL_KINDS)
def test_soil_takes_energy_and_gives_numbers_everywhere(foot: Any) -> None:
    """At rest, on the way up, in the air and upside down."""
    for speed, height in itertools.product((0.0, 1e-12, 0.3), (-0.3, -0.03, 0.0, 0.1)):
        rng = np.random.default_rng(1)
        pose = np.concatenate([np.zeros((50, 2)), np.full((50, 1), height),
                               rng.standard_normal((50, 4))], axis=1)  # fmt: skip
        pose[0, 3:] = 0.0, 1.0, 0.0, 0.0
        velocity = speed * np.array([*rng.standard_normal((47, 3)), *(0.0, 0.0, 1.0) * np.array(
            [[1.0], [-1.0], [0.0]])])  # fmt: skip
        result, moment = force(foot, pose, velocity, **SAND)
        assert np.isfinite([result, moment]).all()
        assert (np.vecdot(result, velocity) <= 1e-12).all()
        assert not result.any() or (speed > 0.0 and height < 0.06)
        held = force(foot, pose, velocity, held=(result, moment), step=0.002, stiffness=2e4, **SAND)
        assert np.isfinite(held).all()
        assert not np.any(held) or height < 0.06


@pytest.mark.filterwarnings("ignore:a foot is")
@pytest.mark.parametrize("foot", [*FEET_OF_ALL_KINDS.values(), sole()],
                         ids=[*FEET_OF_ALL_KINDS, "triangles"])  # fmt: skip
@pytest.mark.parametrize(("columns", "is_held"), [((3, 3), False), ((3, 6), True), ((7, 6), False)])
def test_feet_one_after_the_other_have_the_force_of_arrays(
    foot: Any, columns: tuple[int, int], is_held: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compiled numbers against operations on arrays: equal but for rounding."""
    rng = np.random.default_rng(3)
    pose, velocity = (rng.standard_normal((60, count)) * 0.2 for count in columns)
    pose[:, :3] *= 0.1
    velocity[0] = 0.0
    soil = {"phi_deg": rng.uniform(20.0, 45.0, 60), "density": rng.uniform(1200.0, 1800.0, 60)}
    before = tuple(rng.normal(0.0, 5.0, (2, 60, 3)))
    held = {"held": before, "step": 0.002, "stiffness": 3e3} if is_held else {}
    results = force(foot, pose, velocity, **held, **soil)
    first = {key: value[0] for key, value in soil.items()}
    few = force(foot, pose, velocity, **held, **first)
    monkeypatch.setattr(wrench_module, "_one_by_one", lambda *_, **__: None)
    for ours, options in ((results, soil), (few, first)):
        arrays = force(foot, pose, velocity, **held, **options)
        for part, other in zip(ours, arrays, strict=True):
            np.testing.assert_allclose(part, other, rtol=1e-9, atol=1e-12 * np.abs(other).max())


def test_numba_that_cannot_be_imported_leaves_plain_numbers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As one that does not fit the version of NumPy."""
    pose, velocity = np.zeros((3, 3)), np.full((3, 3), -0.1)
    expected = force(Foot(RADIUS), pose, velocity, **SAND), force(sole(), pose, velocity, **SAND)
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, "terraphi.forward.compiled", raising=False)
    caches = (compiled, wrench_module._function)
    for cache in caches:
        cache.cache_clear()
    try:
        assert compiled() is None
        plain = force(Foot(RADIUS), pose, velocity, **SAND), force(sole(), pose, velocity, **SAND)
    finally:
        for cache in caches:
            cache.cache_clear()
    np.testing.assert_allclose(plain, expected, rtol=1e-12, atol=1e-12)


def test_arrays_that_cannot_be_written_are_not_compiled_for_once_more() -> None:
    """As those of JAX are in NumPy, and rows of a file."""
    pytest.importorskip("numba")
    function = compiled().feet
    pose, velocity = np.zeros((3, 4)).T, np.full((4, 3), -0.1)
    expected, _ = force(Foot(RADIUS), pose, velocity, **SAND)
    count = len(function.signatures)
    for array in (pose, velocity):
        array.flags.writeable = False
    np.testing.assert_array_equal(force(Foot(RADIUS), pose, velocity, **SAND)[0], expected)
    np.testing.assert_array_equal(force(Foot(RADIUS), pose.copy(), velocity, **SAND)[0], expected)
    assert len(function.signatures) == count


@pytest.mark.parametrize("shape", ["ball", "disc"])
def test_a_foot_that_lands_feels_the_momentum_of_the_soil(shape: Any) -> None:
    foot, place = Foot(RADIUS, shape), np.array([0.0, 0.0, (shape == "ball") * RADIUS - 0.015])
    for speed in (0.02, 2.0):
        down = np.array([0.0, 0.0, -speed])
        landing, static = (force(foot, place, down, inertia=on, **SAND)[0][2]
                           for on in (True, False))  # fmt: skip
        pushed = inertial_force(foot, 0.015, speed, 0.0, SAND["density"])
        assert landing - static == pytest.approx(float(pushed), rel=1e-9)
    rising, still = (force(foot, place, np.array([0.0, 0.0, 1.0]), inertia=on, **SAND)[0]
                     for on in (True, False))  # fmt: skip
    assert (rising == still).all()


def test_what_is_held_follows_the_law_and_stays_at_rest() -> None:
    """Against the exact solution for a force that is constant: 1 - exp(-k x / F)."""
    foot, place, stiffness = Foot(RADIUS), np.array([0.0, 0.0, 0.0]), 2e4
    down, step = np.array([0.0, 0.0, -0.1]), 1e-4
    law, _ = force(foot, place, down, **SAND)
    held = (np.zeros(3), np.zeros(3))
    for _ in range(20):
        held = force(foot, place, down, held=held, step=step, stiffness=stiffness, **SAND)
    way = 20 * step * 0.1
    assert held[0][2] == pytest.approx(law[2] * (1.0 - math.exp(-stiffness * way / law[2])))
    still = force(foot, place, 0.0 * down, held=held, step=1.0, stiffness=stiffness, **SAND)
    np.testing.assert_array_equal(still, held)
    out = force(
        foot, place + np.array([0.0, 0.0, 0.1]), -down, held=held, step=step, stiffness=2e4, **SAND
    )
    assert not np.any(out)


class Standing:
    """A Go2 that stands on soil: how its feet move in the end."""

    def __init__(self, step: float, share: float, phi_deg: float = 42.0) -> None:
        """Stand for 1.5 s with a stiffness of a share of the bound 2 m / h²."""
        model = build(Physics(step=step, floor=False))
        data = mujoco.MjData(model)
        dofs, feet = joint_dofs(model).ravel(), [model.body(f"{foot}_foot").id for foot in FEET]
        posture = np.tile(POSTURE, 4)
        data.qpos[dofs + 1], data.qpos[3:7] = posture, (1.0, 0.0, 0.0, 0.0)
        mujoco.mj_forward(model, data)
        data.qpos[2] += FOOT_RADIUS - data.xpos[feet[0]][2]
        mujoco.mj_forward(model, data)
        jacobian, mass = np.zeros((12, model.nv)), np.zeros((model.nv, model.nv))
        for i, foot in enumerate(feet):
            mujoco.mj_jacBody(model, data, jacobian[3 * i : 3 * i + 3], None, foot)
        mujoco.mj_fullM(model, data, mass)
        self.mass = 1.0 / np.linalg.eigvalsh(jacobian @ np.linalg.solve(mass, jacobian.T))[-1]
        stiffness = share * 2.0 * self.mass / step**2
        held, spatial, rows = (np.zeros((4, 3)), np.zeros((4, 3))), np.zeros(6), []
        for _ in range(round(1.5 / step)):
            mujoco.mj_step1(model, data)
            lag = posture - data.qpos[dofs + 1]
            data.qfrc_applied[dofs] = 200.0 * lag - 2.0 * data.qvel[dofs]
            speed = np.zeros((4, 3))
            for i, foot in enumerate(feet):
                mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, foot, spatial, 0)
                speed[i] = spatial[3:]
            held = force(
                Foot(FOOT_RADIUS), data.xpos[feet], speed, phi_deg=phi_deg, density=1550.0,
                surface_friction=0.4, held=held, step=step, stiffness=stiffness,
            )  # fmt: skip
            data.xfrc_applied[feet, :3], data.xfrc_applied[feet, 3:] = held
            mujoco.mj_step2(model, data)
            rows.append([FOOT_RADIUS - data.xpos[feet, 2], held[0][:, 2],
                         np.linalg.norm(speed, axis=1)])  # fmt: skip
        self.weight = 9.81 * float(model.body_mass.sum())
        last = np.array(rows[-round(0.3 / step) :])
        self.depth, self.load, self.speed = last[-1, 0], last[..., 1, :], last[..., 2, :]


@pytest.mark.filterwarnings("ignore:a foot is")  # beyond the bound
@pytest.mark.parametrize("step", [0.0005, 0.002])
def test_a_go2_stands_on_soil_up_to_the_bound_and_shakes_beyond(step: float) -> None:
    at_bound, beyond = Standing(step, 1.0), Standing(step, 8.0)
    assert at_bound.load.sum(axis=1) == pytest.approx(at_bound.weight, rel=0.02)
    assert at_bound.speed.max() < 0.005
    assert beyond.speed.mean() > 0.05
    # Its weight comes at once. So it sinks until the soil's work is that of the load, up to twice
    # as deep as the law bears it.
    for load, depth in zip(at_bound.load[-1], at_bound.depth, strict=True):
        static = brentq(
            lambda z, load=load: LAWS["foot"].force(
                Foot(FOOT_RADIUS), z, math.pi / 2, friction_angle_deg=42.0, density=1550.0,
                surface_friction=0.4,
            )[1] - load, 1e-4, 0.1,
        )  # fmt: skip
        assert 0.99 * static < depth < 2.4 * static


@pytest.mark.parametrize(
    "foot", [Foot(RADIUS), ball(200), sole()], ids=["ball", "mesh", "triangles"]
)
@pytest.mark.parametrize("library", ["array_api_strict", "torch", "jax.numpy"])
def test_other_arrays_have_the_forces_of_numpy(foot: Any, library: str) -> None:
    xp = pytest.importorskip(library)
    if library == "torch":
        pytest.importorskip("array_api_compat")
    rng = np.random.default_rng(0)
    pose, velocity = rng.standard_normal((300, 7)), rng.standard_normal((300, 6))
    pose[:, 2] = rng.uniform(-0.08, 0.08, 300)
    soil = {"phi_deg": rng.uniform(20.0, 45.0, 300), "density": 1600.0}
    expected = force(foot, pose, velocity, **soil)
    soil["phi_deg"] = xp.asarray(soil["phi_deg"])
    total_force = force(foot, xp.asarray(pose), xp.asarray(velocity), **soil)
    again = force(
        foot,
        xp.asarray(pose),
        xp.asarray(velocity),
        held=total_force,
        step=0.01,
        stiffness=2e4,
        **soil,
    )
    for first, other, numpy in zip(total_force, again, expected, strict=True):
        assert type(first) is type(other) is type(xp.asarray(pose))
        exact = 1e-9 if np.asarray(first).dtype == np.float64 else 1e-4  # JAX's default is single
        np.testing.assert_allclose(
            np.asarray(first), numpy, atol=exact * np.abs(numpy).max() + 1e-12
        )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"phi_deg": 60.0}, r"phi_deg = 60: 14 to 55 deg in plane strain"),
        ({"pose": np.full((2, 3), [[0.0], [math.nan]])}, r"pose\[1, 0\] = nan"),
        ({"pose": np.zeros(4)}, "the last axis is 3 or 7"),
        ({"surface_friction": np.array([0.3, 0.4])}, "surface_friction is an array; give a number"),
        ({"pose": np.array([0, 0, 0, 0, 0, 0, 0.0])}, "length of the quaternion"),
        ({"held": (np.zeros(3), np.zeros(3))}, "as step"),
        ({"foot": 0.022}, "foot of type float"),
    ],
)
def test_a_wrong_argument_is_refused(changes: dict[str, Any], words: str) -> None:
    given = {"foot": Foot(RADIUS), "pose": np.zeros(3), "velocity": np.full(3, -0.1), **SAND}
    with pytest.raises(InputError, match=words):
        force(**{**given, **changes})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"law": "foots"}, "did you mean 'foot'"),
        ({"velocities": np.full(3, math.nan)}, r"velocities\[0\] = nan"),
        ({"normals": -2.0 * np.eye(3)[2:]}, r"normals: length\[0\] = 2"),
        ({"phi_deg": -5.0, "law": "rft"}, "phi_deg = -5"),
        ({"surface_friction": -1.0, "law": "rft"}, "surface_friction = -1"),
        ({"mobilization": 0.01}, "sheared"),
    ],
)
def test_faces_have_the_checks_of_feet(changes: dict[str, Any], words: str) -> None:
    given = {"points": np.zeros((1, 3)), "normals": -np.eye(3)[2:], "areas": [1.0],
             "velocities": np.full(3, -0.1), **SAND}  # fmt: skip
    with pytest.raises(InputError, match=words):
        wrench(**{**given, **changes})


def test_what_cannot_be_a_foot_is_refused() -> None:
    corners = np.array([(x, y, z) for z in (0, 0.02) for y in (0, 0.1) for x in (0, 0.2)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    assert Mesh.of(corners, faces).areas.sum() == pytest.approx(0.052)
    # Corners that are not merged are no opening; a tube is, though its areas cancel.
    difference = np.arange(faces.size).reshape(faces.shape)
    assert Mesh.of(corners[faces].reshape(-1, 3), difference).areas.sum() == pytest.approx(0.052)
    for mesh, match in [
        ((corners, faces[:, ::-1]), "inside out"),
        ((corners, faces[1:]), "not closed"),
        ((corners, faces[4:]), "not closed"),
        ((corners, np.concatenate([faces, faces])), "a face twice"),
        ((1e3 * corners, faces), "meters"),
    ]:
        with pytest.raises(InputError, match=match):
            Mesh.of(*mesh)
    for size in (22.0, -0.02, math.nan):
        with pytest.raises(InputError, match="radius"):
            Foot(size)
    here = ([0.0, 0.0, 0.0], [0.0, 0.0, -0.1])
    for changed, match in [({"density": 1.6}, "density"), ({"phi_deg": [30.0, 31.0]}, "phi_deg")]:
        with pytest.raises(InputError, match=match):
            force(Foot(0.022), *here, **{"phi_deg": 30.0, "density": 1550.0, **changed})
