r"""The friction with which a simulator's grid carries the load that the soil would carry.

The material point method on a coarse grid loses force: a foot of a few voxels feels what the nodes
in it and next to it hold, and that depends on where the surface lies in its voxel. So the friction
of the soil, as :mod:`~terraphi.terrain.simulators` converts it, is not the one with which a foot
sinks as deep as it would. Here the foot is pressed with the simulator itself, on a CPU, and its
force over sinkage is compared with that of our law ``foot`` (:mod:`~terraphi.laws.foot`).

Forces are means over thirds of the depth and over three places of the surface in its voxel. What is
searched is :math:`q = \sqrt{J_2}/p`, which each simulator's parameter follows from. The best one
has the least squares of log force, weighted by the scatter of the means. Its interval is that of
draws of φ, of the law's own error and of the scatter. A voxel is too coarse where the best one's
force over sinkage differs from the soil's, or single places differ from one another, by more than
the law's own error.

Run were Newton 1.8.0 (Warp 1.19.0) and Genesis 1.4.5.
"""

from __future__ import annotations

import importlib.metadata
import math
import sys
import tempfile
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray, IntArray
from terraphi.experiment.errors import InputError, nearest, needing
from terraphi.experiment.files import plain_number, read_text
from terraphi.experiment.priors import FOOT_FRICTION
from terraphi.experiment.units import GRAVITY
from terraphi.laws.foot import LAWS, Foot
from terraphi.laws.wrench import Mesh, angles_deg, force
from terraphi.terrain.export import bed_of, described, file_for, interval_in_words, write
from terraphi.terrain.simulators import Simulator, simulator
from terraphi.terrain.simulators import in_words as value_in_words
from terraphi.terrain.soils import SoilDistribution, soil

THIRDS, PLACES = 3, 3
"""Parts of the depth, and places of the surface in its voxel at which each friction is tried."""
FINE = 40
"""Depths at which the law is averaged in each part."""
SAMPLES = 2000
"""Draws behind an interval."""
STEP, CLOSE = 1.4, 0.08
"""Ratio of neighboring frictions, and how near in log friction the best one has a neighbor; chosen
so that a dozen presses do."""
NODES = 6
"""Frictions tried at most."""
LEAST, MOST = 0.05, 2.0
"""Least and largest q [-]; Genesis' cone ends at √3, and is tried up to 1.7."""
WIDE, FLOOR = 3.0, 2.0
"""Half the bed's width and its depth below the deepest sinkage, over the foot's radius. Newton's
force on a disc was within 10 % of that in a bed of 4 and 3."""
PACE = 0.2
"""Speed over √(g R): the soil's inertia is below 2 % of the force (law of ``moved_mass``)."""


@dataclass(frozen=True)
class Sole:
    """The foot, a closed surface of triangles, with its lowest point at the origin's height.

    Attributes
    ----------
    name
        As it was given.
    vertices, faces
        [m], shape [vertex, 3]; indices, shape [face, 3], counterclockwise from outside.
    foot
        Its form in the law: a disc, a ball or the faces of a mesh.
    radius
        Of the circle with the area of the sole from below [m].
    """

    name: str
    vertices: FloatArray
    faces: IntArray
    foot: Foot | Mesh
    radius: float

    @classmethod
    def of(cls, text: str | Path) -> Sole:
        """A foot from ``disc:RADIUS``, ``ball:RADIUS`` [m], or a Wavefront OBJ in meters.

        A disc is a cylinder as high as its radius, so that no soil flows over it.

        Raises
        ------
        InputError
            If it is none of these, or the mesh is open or not between 5 mm and 1 m wide.
        """
        name = str(text)
        shape, _, size = name.partition(":")
        if shape in ("disc", "ball"):
            try:
                radius = plain_number(size)
            except ValueError:
                radius = math.nan
            if not 0.005 <= radius <= 0.5:
                raise InputError(f"foot {name}: give a radius of 0.005 to 0.5 m, as disc:0.05")
            foot = Foot(radius, "disc" if shape == "disc" else "ball")
            return cls(name, *_turned(foot), foot, radius)
        if Path(name).suffix.lower() != ".obj":
            raise InputError(f"foot {name}: give disc:RADIUS, ball:RADIUS (in m) or a .obj file")
        vertices, faces = _read_obj(Path(name))
        try:
            mesh = Mesh.of(vertices, faces)
        except InputError as error:
            raise InputError(f"{name}: {error}") from error
        deep = np.array([np.ptp(vertices[:, 2])])
        return cls(name, vertices, faces, mesh, float(mesh.footprint(deep)[0][0]))

    def force(
        self, depth: FloatArray, phi_deg: FloatArray, *, density: float, surface_friction: float
    ) -> FloatArray:
        """Upward force of law ``foot`` [N], shape [φ, depth]; InputError for φ outside its table.

        That of a mesh lies between those of a ball and a disc of its footprint
        (:mod:`~terraphi.laws.wrench`); other meshes than of these were compared with nothing.
        """
        ball = isinstance(self.foot, Foot) and self.foot.shape == "ball"
        height = (self.radius if ball else 0.0) - depth
        phi, height = np.broadcast_arrays(np.asarray(phi_deg)[:, None], height)
        lift, _ = force(
            self.foot, np.multiply.outer(height, [0.0, 0.0, 1.0]), [0.0, 0.0, -1.0], phi_deg=phi,
            density=density, surface_friction=surface_friction, inertia=False,
        )  # fmt: skip
        return np.asarray(lift[..., 2])


@dataclass(frozen=True)
class Press:
    """A foot that goes straight down into a box of soil, in SI units.

    ``place`` is that of the surface above a node, over the voxel, and ``seed`` that of the
    particles. ``time_step`` is Newton's; Genesis' follows from its stiffness.
    """

    sole: Sole
    voxel: float
    depth: float
    density: float
    surface_friction: float
    time_step: float
    place: float = 0.5
    seed: int = 0

    def check(self) -> None:
        """Check what can be simulated; raises InputError."""
        radius = self.sole.radius
        slowest = 0.5 * self.depth / THIRDS / self.speed
        bounds = {
            "voxel": (self.voxel, 0.05 * radius, 2.0 * radius),
            "depth": (self.depth, 0.05 * radius, 2.0 * radius),
            "density": (self.density, 500.0, 3000.0),
            # Two steps of Newton at least in each part of the depth.
            "time_step": (self.time_step, 1e-4, slowest),
        }
        for what, (value, least, most) in bounds.items():
            if not least <= value <= most:
                raise InputError(f"{what} = {value:g}: {least:.3g} to {most:.3g} are accepted here")

    @property
    def speed(self) -> float:
        """Downward [m/s]."""
        return PACE * math.sqrt(GRAVITY * self.sole.radius)

    @property
    def box(self) -> tuple[float, float]:
        """Half the width, and the depth of the bed [m], in whole voxels."""
        half = max(math.ceil(WIDE * self.sole.radius / self.voxel), 3) * self.voxel
        deep = math.ceil((FLOOR * self.sole.radius + self.depth) / self.voxel)
        return half, max(deep, 3) * self.voxel


Engine = Callable[[Press, float], tuple[FloatArray, FloatArray]]
"""Sinkage [m] and upward force [N] of a press with a simulator's parameter, step by step."""


def newton(press: Press, friction: float) -> tuple[FloatArray, FloatArray]:
    """Newton's implicit solver with its own defaults and 27 particles in a voxel.

    Force on a kinematic body, from ``collect_collider_impulses``.
    """
    with needing("tune newton", "newton", extra="tune-newton"):
        import newton as nt
        import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    voxel, (half, deep) = press.voxel, press.box
    builder = nt.ModelBuilder()
    nt.solvers.SolverImplicitMPM.register_custom_attributes(builder)
    rng = np.random.default_rng(press.seed)
    shift = np.array([*rng.uniform(-0.5, 0.5, 2), press.place]) * voxel
    places, cell = bed_of(press.box, voxel, rng)
    places += shift
    builder.add_particles(
        pos=places.tolist(),
        vel=np.zeros_like(places).tolist(),
        mass=[press.density * cell**3] * len(places),
        radius=[cell / 2] * len(places),
        custom_attributes={"mpm:friction": float(friction)},
    )
    rough = nt.ModelBuilder.ShapeConfig(mu=press.surface_friction)
    for side, axis in [(1, 0), (-1, 0), (1, 1), (-1, 1), (-1, 2)]:
        size = np.full(3, half + deep)
        size[axis] = 2 * voxel
        at = shift.copy()
        at[axis] += side * ((deep if axis == 2 else half) + 2 * voxel)
        builder.add_shape_box(
            -1, xform=wp.transform(wp.vec3(*at), wp.quat_identity()),
            hx=size[0], hy=size[1], hz=size[2], cfg=rough,
        )  # fmt: skip
    body = builder.add_body(is_kinematic=True, mass=1.0)
    sole = press.sole
    mesh = nt.Mesh(sole.vertices.astype(np.float32), sole.faces.astype(np.int32).ravel())
    builder.add_shape_mesh(body, mesh=mesh, cfg=rough)
    model = builder.finalize(device="cpu")
    model.set_gravity((0.0, 0.0, -GRAVITY))
    solver = nt.solvers.SolverImplicitMPM(
        model, config=nt.solvers.SolverImplicitMPM.Config(voxel_size=voxel)
    )
    ours = np.flatnonzero(solver.collider_body_index.numpy() == body)
    state, pose, velocity = model.state(), np.zeros((1, 7)), np.zeros((1, 6))
    pose[0, 6] = 1.0

    def moved(height: float, speed: float) -> float:
        """Lift after a step that begins at a height of the foot above the surface."""
        pose[0, 2], velocity[0, 2] = height + shift[2], -speed
        state.body_q.assign(pose)
        state.body_qd.assign(velocity)
        solver.step(state, state, None, None, press.time_step)
        impulses, _, colliders = solver.collect_collider_impulses(state)
        mine = np.isin(colliders.numpy(), ours)
        return float(impulses.numpy()[mine, 2].sum() / press.time_step)

    for _ in range(5):  # the bed rests after the first
        moved(3 * voxel, 0.0)
    shift[2] -= _sunk(press, places, state.particle_q.numpy())
    stride = press.speed * press.time_step
    steps = np.arange(-math.ceil(0.5 * voxel / stride), math.ceil(press.depth / stride))
    forces = [moved(-step * stride, press.speed) for step in steps]
    return np.asarray((steps + 1) * stride), np.array(forces)


def genesis(press: Press, friction_angle: float) -> tuple[FloatArray, FloatArray]:
    """Genesis' solver and its legacy coupler with their own defaults.

    Force on a rigid body, too heavy to be slowed, from what the coupler gives its link.
    """
    with needing("tune genesis", "genesis-world and torch", extra="tune-genesis"):
        import genesis as gs
        import torch  # noqa: F401
        from genesis.utils.misc import qd_to_numpy

    if not getattr(gs, "_initialized", False):
        gs.init(backend=gs.cpu, logging_level="error", seed=press.seed)
    voxel, sole, (half, deep) = press.voxel, press.sole, press.box
    pad, top = 3 * voxel, press.place * voxel
    sand = gs.materials.MPM.Sand(friction_angle=friction_angle, rho=press.density)
    # A quarter of the time that its pressure waves need for a voxel.
    step = 0.25 * voxel / math.sqrt(1.2 * sand.E / press.density)
    scene = gs.Scene(
        sim_options=gs.options.SimOptions(dt=step, substeps=1, gravity=(0.0, 0.0, -GRAVITY)),
        mpm_options=gs.options.MPMOptions(
            grid_density=1.0 / voxel,
            lower_bound=(-half - pad, -half - pad, -deep - pad),
            upper_bound=(half + pad, half + pad, math.ceil(4 * sole.radius / voxel) * voxel + pad),
        ),
        show_viewer=False,
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "sole.obj")
        with file.open("w", encoding="utf-8") as target:
            np.savetxt(target, sole.vertices, "v %.7g %.7g %.7g")
            np.savetxt(target, sole.faces + 1, "f %d %d %d")
        foot = scene.add_entity(
            morph=gs.morphs.Mesh(
                file=str(file), convexify=False, decimate=False, file_meshes_are_zup=True
            ),
            material=gs.materials.Rigid(
                rho=1e6, coup_friction=press.surface_friction, gravity_compensation=1.0
            ),
        )
        bed = scene.add_entity(
            morph=gs.morphs.Box(lower=(-half, -half, -deep), upper=(half, half, top)), material=sand
        )
        scene.build()
    link = foot.links[0].idx
    aside = np.random.default_rng(press.seed).uniform(-0.5, 0.5, 2) * voxel

    def moved(speed: float) -> float:
        foot.set_dofs_velocity(np.array([0.0, 0.0, -speed, 0.0, 0.0, 0.0]))
        scene.step()
        wrenches = qd_to_numpy(scene.sim.rigid_solver.dyn_state.links.cfrc_coupling_vel)
        return -float(wrenches[link].ravel()[2])

    def lift_to(height: float) -> None:
        foot.set_pos((*aside, top + height))

    lift_to(3 * voxel)
    before = bed.get_particles_pos().cpu().numpy().reshape(-1, 3)
    for _ in range(math.ceil(0.05 / step)):
        moved(0.0)
    top -= _sunk(press, before, bed.get_particles_pos().cpu().numpy().reshape(-1, 3))
    lift_to(0.5 * voxel)
    stride = press.speed * step
    count = math.ceil((0.5 * voxel + press.depth) / stride)
    forces = np.array([moved(press.speed) for _ in range(count)])
    scene.destroy()
    return np.asarray(np.arange(1, count + 1) * stride - 0.5 * voxel), forces


def _sunk(press: Press, before: FloatArray, after: FloatArray) -> float:
    """Mean way down of particles under the foot that began within a voxel of the surface [m]."""
    top = before[:, 2].max() - press.voxel
    under = (before[:, 2] > top) & (np.hypot(*before[:, :2].T) < press.sole.radius + press.voxel)
    return float((before - after)[under, 2].mean())


ENGINES: dict[str, Engine] = {"newton": newton, "isaaclab": newton, "genesis": genesis}


@dataclass(frozen=True)
class Fit:
    """Result of :func:`fit`.

    Attributes
    ----------
    ratio, draws
        Best q [-]; draws of it, shape [draw].
    lost
        Share of draws that no q in the limits reaches; ``draws`` has the limit there.
    factor
        Draws of the factor of density with which the soil's own q does, shape [draw].
    forces, carried
        Mean force in each part of the depth at the best q and at the soil's own [N], shape [part].
    residual
        Root mean square of log force over that of the law at the best q.
    scatter
        Standard deviation between single places of the mean force over the depth, over its mean.
    tolerance
        The law's own error in log force, which both may reach.
    presses
        How many there were.
    at_limit
        ``low`` or ``high`` where the best q is an end of the limits.
    """

    ratio: float
    draws: FloatArray
    lost: float
    factor: FloatArray
    forces: FloatArray
    carried: FloatArray
    residual: float
    scatter: float
    tolerance: float
    presses: int
    at_limit: str = ""

    @property
    def fits(self) -> bool:
        """True if a friction has the soil's force over sinkage within the law's own error."""
        return not self.at_limit and max(self.residual, self.scatter) <= self.tolerance


def _next_q(
    nodes: FloatArray, logs: FloatArray, best: int, drawn: IntArray, limits: tuple[float, float]
) -> list[float]:
    """The q to try next, within limits: farther out, or at the best one; none if all is known.

    Draws at an end of what was tried need a q beyond it, and the best one a neighbor. ``best`` and
    ``drawn`` are indices into ln q, ``logs``, of the q nearest to the soil's forces, and to each
    draw of them.
    """
    last, (low, high) = len(logs) - 1, limits
    is_inside = 0 < best < last
    if len(nodes) >= NODES and is_inside:
        return []
    first_draw, last_draw = np.quantile(drawn, [0.025, 0.975])
    if last_draw >= last and nodes[-1] < high * 0.999:
        return [min(nodes[-1] * STEP, high)]
    if first_draw <= 0 and nodes[0] > low * 1.001:
        return [max(nodes[0] / STEP, low)]
    if is_inside and np.min(np.abs(np.log(nodes) - logs[best])) > CLOSE:
        return [float(np.exp(logs[best]))]
    return []


def fit(
    press: Callable[[float, int], FloatArray],
    target: FloatArray,
    targets: FloatArray,
    *,
    tolerance: float,
    start: float,
    limits: tuple[float, float],
    seed: int = 0,
    report: Callable[[float, float], None] = lambda _done, _total: None,
) -> Fit:
    """Find the q whose forces are nearest to the soil's, for any engine.

    Parameters
    ----------
    press
        Mean forces in each part of the depth [N], shape [part], from q and the index of a place.
    target
        The soil's, shape [part].
    targets
        Draws of it, with all that is uncertain about the soil, shape [draw, part].
    tolerance
        Error of the law in log force.
    start
        The soil's own q.
    limits
        Least and largest q.
    seed
        Of the draws of the scatter.
    report
        Called with the presses done and an estimate of all.

    Raises
    ------
    InputError
        If the foot feels no force.
    """
    from scipy.interpolate import PchipInterpolator

    start = min(max(start, limits[0]), limits[1])
    waiting = [start, min(start * STEP, limits[1])]
    runs: dict[float, FloatArray] = {}
    rng = np.random.default_rng(seed)
    while True:
        for ratio in waiting:
            runs[ratio] = np.array([press(ratio, place) for place in range(PLACES)])
            report(PLACES * len(runs), PLACES * max(len(runs) + 1, 4))
        nodes = np.array(sorted(runs))
        forces = np.array([runs[node] for node in nodes])  # [q, place, part]
        means = np.maximum(forces.mean(axis=1), 1e-3 * target)
        if not np.isfinite(forces).all() or not (forces > 0.0).any():
            raise InputError("the foot felt no force, or one that is no number: take finer voxels")
        # Deviations of single places, of which a mean over places has 1/√PLACES.
        freedom = len(nodes) * (PLACES - 1)
        deviations = (forces - forces.mean(axis=1, keepdims=True)) / means[:, None]
        deviations = deviations.reshape(-1, len(target)) / math.sqrt(freedom * PLACES)
        weights = 1.0 / (np.square(deviations).sum(axis=0) + 0.1**2)  # no part within a tenth
        weights /= weights.sum()
        # Log force over ln q: a monotone spline through the means over places.
        logs = np.linspace(np.log(nodes[0]), np.log(nodes[-1]), 801)
        log_force = PchipInterpolator(np.log(nodes), np.log(means))
        curve = log_force(logs)
        # The variance of the places is itself an estimate: Student's t.
        scatter = rng.standard_normal((len(targets), len(deviations))) @ deviations
        scatter /= np.sqrt(rng.chisquare(freedom, (len(targets), 1)) / freedom)
        rows = np.vstack([np.log(target), np.log(targets) - scatter])
        best, *nearest_q = [int(np.argmin(np.square(curve - row) @ weights)) for row in rows]
        drawn, last = np.array(nearest_q), len(logs) - 1
        waiting = _next_q(nodes, logs, best, drawn, limits)
        if not waiting:
            break
    levels = forces.mean(axis=2)
    level = np.maximum(levels.mean(axis=1), 1e-3 * target.mean())
    at_start = log_force(math.log(start))
    residual = curve[best] - np.log(target)
    return Fit(
        ratio=float(np.exp(logs[best])),
        draws=np.exp(logs[drawn]),
        lost=1.0 - float(((drawn > 0) & (drawn < last)).mean()),
        factor=np.exp((np.log(targets) - scatter - at_start) @ weights),
        forces=np.exp(curve[best]),
        carried=np.exp(at_start),
        residual=math.sqrt(float(np.square(residual) @ weights)),
        scatter=float(np.sqrt(np.mean(np.var(levels, axis=1, ddof=1) / level**2))),
        tolerance=tolerance,
        presses=PLACES * len(runs),
        at_limit={0: "low", last: "high"}.get(best, ""),
    )


class Load(NamedTuple):
    """Mean force of the soil on the foot in each part of the depth, by law ``foot``.

    Attributes
    ----------
    force, draws
        At the median φ [N], shape [part]; draws of it, shape [draw, part].
    phi_deg, density
        The draws of φ in plane strain [deg] and of the density [kg/m³] behind them, shape [draw].
    tolerance
        The law's own error in log force.
    """

    force: FloatArray
    draws: FloatArray
    phi_deg: FloatArray
    density: FloatArray
    tolerance: float

    @classmethod
    def of(
        cls, press: Press, ground: SoilDistribution, *, is_rigid: bool, rng: np.random.Generator
    ) -> Load:
        """Load on a foot, with all that is uncertain about the soil and the law.

        ``is_rigid``: the simulator's force is in proportion to the density, as the law's is. So is
        that of Newton's rigid soil. Genesis' is elastic: twice the density gave 1.4 times the force
        (voxels of 30 mm). It keeps the density of the presses. Raises InputError if φ is outside
        the law.
        """
        sole, middle = press.sole, ground.phi.median
        low, high = angles_deg(press.surface_friction)
        if not low <= middle <= high:
            raise InputError(f"φ = {middle:g}: law 'foot' is for {low:g} to {high:g} deg")
        degrees = np.arange(low, high + 0.5)
        depths = press.depth * (np.arange(THIRDS * FINE) + 0.5) / (THIRDS * FINE)
        forces = sole.force(
            depths, degrees, density=ground.density, surface_friction=press.surface_friction
        )
        logs = np.log(forces.reshape(-1, THIRDS, FINE).mean(axis=2))

        def law(phi_deg: FloatArray) -> FloatArray:
            """Mean force in each part of the depth, shape [φ, part]; NaN outside the table."""
            rows = [np.interp(phi_deg, degrees, row, np.nan, np.nan) for row in logs.T]
            return np.exp(np.stack(rows, axis=-1))

        law_sd = LAWS["foot"].sd_deg
        drawn = ground.draws(SAMPLES, rng=rng)
        # Beyond the law's table its ends: without these draws the others would have another median.
        angles = drawn.phi_deg + rng.normal(0.0, law_sd, SAMPLES)
        draws, density = law(np.clip(angles, low, high)), drawn.density
        if isinstance(sole.foot, Mesh):  # a quarter of log force where a mesh is half round; chosen
            thirds = np.linspace(0.0, press.depth, THIRDS + 1)[1:]
            roundness = sole.foot.footprint(thirds)[1]
            shape_sd = float((roundness * (1.0 - roundness)).max())
            draws *= np.exp(rng.normal(0.0, shape_sd, (SAMPLES, 1)))
        if not is_rigid:
            draws *= (density / ground.density)[:, None]
            density = np.full(SAMPLES, ground.density)
        steps = np.diff(np.log(law(middle + law_sd * np.array([-1.0, 0.0, 1.0]))), axis=0)
        force = law(np.array([middle]))[0]
        return cls(force, draws, drawn.phi_deg, density, float(np.nanmean(steps)))


def tune(
    name: str,
    *,
    voxel: float,
    foot: str | Path,
    phi: Any,
    density: float | str | None = None,
    surface_friction: float = FOOT_FRICTION.mean,
    depth: float | None = None,
    time_step: float = 0.01,
    draws: int = 64,
    seed: int = 0,
    anyway: bool = False,
    out: Path | str | None = None,
    progress: Callable[[float, float], None] = lambda _done, _total: None,
) -> dict[str, Any]:
    """Find the friction with which a simulator's grid carries a foot as the soil would.

    The foot is pressed in about a dozen times with the simulator itself, on a CPU: minutes.

    Parameters
    ----------
    name
        ``newton``, ``isaaclab`` (Newton's solver) or ``genesis``.
    voxel
        Size of a cell of its grid [m].
    foot
        ``disc:RADIUS``, ``ball:RADIUS`` [m] or a closed Wavefront OBJ [m], z up.
    phi
        φ of the soil in plane strain [deg] as ``"33±2"``, or the name of a soil or an answer (see
        :func:`~terraphi.terrain.soils.soil`).
    density
        Bulk density [kg/m³], as ``1600`` (± 5 %) or ``"1600±40"``; by default that of the soil. An
        answer has its own. Its error is in the interval of Genesis; Newton's force is in proportion
        to the density, as the soil's.
    surface_friction
        Coulomb coefficient between foot and soil [-], also given to the simulator.
    depth
        Largest sinkage [m]; by default half the foot's radius.
    time_step
        Newton's [s], on which its force depends; Genesis takes its own.
    draws, seed
        How many draws of the friction are returned; seed of all draws and particles.
    anyway
        Whether an answer that is a misfit or out of range is accepted, and a file is written
        although no friction has the soil's force over sinkage.
    out
        A ``.py``, ``.json`` or, of newton and isaaclab, ``.usda`` file to write.
    progress
        Called with the presses done and an estimate of all.

    Returns
    -------
    dict
        ``parameter``, ``value``, ``ci68``, ``ci95``, ``draws``; ``density_factor`` with which the
        soil's own friction carries as much (Newton); ``residual``, ``scatter``; ``verdict``
        (``carries`` or ``no value``) and its ``reason``; ``forces_N`` by depth.

    Raises
    ------
    InputError
        If an option cannot be used, the package is missing, or no friction does and a file is
        wanted without ``anyway``.
    """
    if name not in ENGINES:
        raise InputError(f"cannot press with '{name}'; {nearest(name, ENGINES)}")
    path, to, is_newton = file_for(out, name), simulator(name), name != "genesis"
    ground = soil(phi, density=density, anyway=anyway)
    sole = Sole.of(foot)
    depth = 0.5 * sole.radius if depth is None else depth
    press = Press(sole, voxel, depth, ground.density, surface_friction, time_step, seed=seed)
    press.check()
    rng = np.random.default_rng(seed)
    load = Load.of(press, ground, is_rigid=is_newton, rng=rng)
    edges = np.linspace(0.0, press.depth, THIRDS + 1)

    def forces(ratio: float, place: int) -> FloatArray:
        here = replace(press, place=(place + 0.5) / PLACES, seed=seed + place)
        with redirect_stdout(sys.stderr):  # which simulators write to
            sinkage, force = ENGINES[name](here, to.law.value(ratio))
        part = np.searchsorted(edges, sinkage - 1e-9) - 1
        return np.array([force[part == k].mean() for k in range(THIRDS)])

    best = fit(
        forces, load.force, load.draws, tolerance=load.tolerance,
        start=math.sin(math.radians(ground.phi.median)),
        limits=(LEAST, MOST if is_newton else 1.7), seed=seed, report=progress,
    )  # fmt: skip
    reason = _reason(to.title, best, load.force, press)
    chosen = rng.choice(SAMPLES, draws) if draws else np.empty(0, dtype=np.int64)
    result = {
        **_result(to, press, ground, load, best, chosen),
        "reason": reason,
        "caution": " ".join(filter(None, ["" if best.fits else reason, ground.caution])),
    }
    if path is not None and not (best.fits or anyway):
        raise InputError(f"{reason} To write a file all the same, add --anyway")
    write(result, path)
    return result


def _result(
    to: Simulator, press: Press, ground: SoilDistribution, load: Load, best: Fit, chosen: IntArray
) -> dict[str, Any]:
    """Numbers of :func:`tune`, JSON-able; ``chosen`` are the draws to list."""
    is_newton = to.name != "genesis"
    package = "newton" if is_newton else "genesis-world"
    try:
        version = importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        version = "of unknown version"
    values = np.array([to.law.value(q) for q in best.draws])
    summary = _summary(values, to.law.value(best.ratio))
    phi = ground.phi.median
    return {
        **described(to),
        "package": package,
        "version": version,
        "matched": f"force over sinkage of {press.sole.name} to {1e3 * press.depth:.3g} mm, with "
        f"voxels of {1e3 * press.voxel:.3g} mm in {package} {version}",
        "value": summary.pop("median"),
        **summary,
        "draws": values[chosen].round(6).tolist(),
        "density_draws_kg_m3": load.density[chosen].round(3).tolist(),
        "draws_without_equivalent": best.lost,
        "verdict": "carries" if best.fits else "no value",
        "residual": round(best.residual, 4),
        "scatter": round(best.scatter, 4),
        "tolerance": round(load.tolerance, 4),
        "own_value": round(to.law.value(math.sin(math.radians(phi))), 6),
        "carried": round(1.0 / float(np.median(best.factor)), 4),
        "density_factor": _summary(best.factor) if is_newton else None,
        "law_N": np.round(load.force, 4).tolist(),
        "forces_N": np.round(best.forces, 4).tolist(),
        "forces_own_N": np.round(best.carried, 4).tolist(),
        "presses": best.presses,
        "phi_plane_strain_deg": _summary(load.phi_deg, phi),
        "density_kg_m3": ground.density,
        "density_assumed": ground.density_assumed,
        "leg_friction_assumed": press.surface_friction,
        "leg_friction_about": "that between foot and soil, as given",
        "voxel_m": press.voxel,
        "bed_m": press.box,
        "cohesion_Pa": 0.0,
        "depth_m": press.depth,
        "time_step_s": press.time_step if is_newton else None,
        "source": {"answer": ground.name, "record": press.sole.name, "law": "foot"},
    }


def _summary(values: FloatArray, middle: float | None = None) -> dict[str, Any]:
    """Median, or a given middle, and intervals."""
    ends = np.quantile(values, [0.16, 0.84, 0.025, 0.975]).round(6).tolist()
    center = float(np.median(values)) if middle is None else middle
    return {"median": round(center, 6), "ci68": ends[:2], "ci95": ends[2:]}


def _reason(title: str, fit: Fit, target: FloatArray, press: Press) -> str:
    """The verdict in a sentence."""
    voxel = f"voxels of {1e3 * press.voxel:.3g} mm"
    if fit.fits:
        return (
            f"{title} with {voxel} carries {press.sole.name} as the soil does, within "
            f"{fit.residual:.0%} over the depth and {fit.scatter:.0%} between places of the "
            f"surface in its voxel (the law's own error: {fit.tolerance:.0%})."
        )
    by_part = ", ".join(f"{ratio - 1:+.0%}" for ratio in fit.forces / target)
    if fit.at_limit:
        end = "largest" if fit.at_limit == "high" else "least"
        why = f"at the {end} that was tried the forces are off by {by_part}"
    elif fit.residual <= fit.tolerance:
        places = f"± {fit.scatter:.0%} with the place of the surface in its voxel"
        why = f"the force differs by {places}, the law's own error is {fit.tolerance:.0%}"
    else:
        why = f"at the best one the forces of the thirds of the depth are off by {by_part}"
    return f"No friction does with {voxel}: {why}. Take finer voxels."


def in_words(tuned: dict[str, Any]) -> list[str]:
    """Result of :func:`tune`, a sentence each."""
    factor, lost = tuned["density_factor"], tuned["draws_without_equivalent"]
    soil_friction = value_in_words(tuned["own_value"], tuned["unit"])
    carried = (
        f"With the soil's own {soil_friction} the grid carries {tuned['carried']:.0%} of the load"
    )
    if factor:
        low, high = factor["ci95"]
        carried += f": density times {factor['median']:.2f} makes up for it, 95 %: {low:.2f} to "
        carried += f"{high:.2f}"
    value = f"{interval_in_words(tuned)} ({tuned['presses']} presses)."
    beyond = [f"No friction reaches {lost:.0%} of the draws: the interval ends there."]
    return [tuned["reason"], value, *(beyond if lost > 0.005 else []), f"{carried}."]


def _turned(foot: Foot) -> tuple[FloatArray, IntArray]:
    """A cylinder as high as its radius, or a ball: vertices and faces, its lowest point at zero."""
    from scipy.spatial import ConvexHull

    far, height = np.array([1.0, 1.0]), np.array([0.0, 1.0])
    if foot.shape == "ball":
        turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 25)
        far, height = np.cos(turn), 1.0 + np.sin(turn)
    sectors = 48
    # A facetted circle of the same area.
    far = far * np.sqrt(2 * np.pi / sectors / np.sin(2 * np.pi / sectors))
    around = 2 * np.pi * np.arange(sectors) / sectors
    x, y = far[:, None] * np.cos(around), far[:, None] * np.sin(around)
    points = np.stack([x, y, np.broadcast_to(height[:, None], x.shape)], axis=-1).reshape(-1, 3)
    points = foot.radius * np.unique(points.round(12), axis=0)
    faces = ConvexHull(points).simplices.astype(np.int64)
    # Six times the volume of the tetrahedron from the middle to a face, by its sense.
    inward = np.linalg.det((points - points.mean(axis=0))[faces]) < 0.0
    faces[inward] = faces[inward, ::-1]
    return points, faces


def _read_obj(path: Path) -> tuple[FloatArray, IntArray]:
    """Vertices and triangles of a Wavefront OBJ, centered, its lowest point at zero.

    Raises
    ------
    InputError
        If it cannot be read, has no faces, or has another size than a foot.
    """
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        key, *words = line.split() or [""]
        try:
            if key == "v":
                vertices.append([plain_number(word) for word in words[:3]])
            elif key == "f":
                corners = [int(word.partition("/")[0]) for word in words]
                corners = [at - 1 if at > 0 else len(vertices) + at for at in corners]
                faces += [[corners[0], *pair] for pair in pairwise(corners[1:])]
        except ValueError as error:
            raise InputError(f"{path}, line {number}: '{line[:60]}' is no number") from error
    points, index = np.array(vertices), np.array(faces, dtype=np.int64)
    sound = bool(faces) and points.ndim == 2 and points.shape[1] == 3 and np.isfinite(points).all()
    if not sound or index.min() < 0 or index.max() >= len(points):
        raise InputError(f"{path}: has no faces, or faces of vertices that it lacks")
    size = np.ptp(points, axis=0)
    if size[:2].min() < 0.005 or size.max() > 1.0:
        raise InputError(f"{path}: is {size.max():.3g} m long; the file's unit is the meter")
    if np.linalg.det(points[index]).sum() < 0.0:  # six times its volume
        index = index[:, ::-1]
    return points - [*(points.min(axis=0) + 0.5 * size)[:2], points[:, 2].min()], index
