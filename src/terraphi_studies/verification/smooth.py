r"""Errors of smooth solutions, at the end of some steps on a grid.

A manufactured solution at any amplitude: the generalised vortex, for the Jaumann rate.

Kamojjala, Brannon, Sadeghirad & Guilkey (2015, Eng. Comput. 31, 193, doi
10.1007/s00366-013-0342-x) let every circle of a body turn by an angle of its own,
:math:`\alpha(r, t) = g(t)\,h(r)`, so that the body is sheared without any change of volume, and
give the body force that this takes. With the Jaumann rate the stress has a closed form: in the
frame that turns with a particle it is that of simple shear by :math:`\gamma = r\,\partial\alpha/
\partial r`,

.. math:: \sigma_{r\theta} = G \sin\gamma, \qquad
          \sigma_{\theta\theta} = -\sigma_{rr} = G (1 - \cos\gamma),

and the body force is :math:`b = a - \nabla\cdot\sigma/\rho` with :math:`a_r = -r\dot\alpha^2`,
:math:`a_\theta = r\ddot\alpha`. Here h(r) vanishes outside a ring, so that neither walls nor a
surface play a part.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward.plane.bed import Particles, geostatic_bed
from terraphi_studies.verification.driver import Rig, advance, block_of, rig_of
from terraphi_studies.verification.waves import elastic, lame_mode

FloatArray = NDArray[np.float64]
Errors = dict[str, float]

DOMAIN = 0.32
"""Side of the domain [m]: 16, 32, 64, ... cells divide it and the bodies in it evenly."""
BOX = {
    "bed.left": 0.08,
    "bed.floor": 0.08,
    "bed.width": 0.16,
    "bed.height": 0.16,
    "motion.hip": [0.16, 0.28],
    "leg.chord": 0.03,
}
"""A box whose edges lie on nodes, and a leg that has room above it, were it asked for."""
TINY = 1e-6
"""Amplitude at which everything is linear, in radians or as a share of a length [-]."""


def vortex_errors(cells: int, per_side: int, amplitude: float, courant: float = 0.3) -> Errors:
    """Errors of the vortex, each relative to the root mean square of its field.

    Parameters
    ----------
    cells
        Cells along a side of the domain.
    per_side
        Particles along a side of a cell.
    amplitude
        Largest angle [rad].
    courant
        Part of a cell that a wave passes in a step, carried along by the soil [-].

    """
    scenario = _scenario(cells, per_side)
    spacing = scenario.numerics.cell_size / per_side
    soil = block_of((0.02, 0.02), (0.28, 0.28), spacing, scenario.soil.density)
    middle = (0.5 * DOMAIN, 0.5 * DOMAIN)
    # Beyond the ring nothing happens.
    near = np.hypot(*(soil.position - middle).T) < RING + 0.07
    soil = Particles(*(values[near] for values in soil))
    exact = Vortex(
        soil.start, middle, amplitude, scenario.soil.shear_modulus, scenario.soil.density
    )
    end = 0.75 * DURATION
    fastest = scenario.soil.p_wave_speed + exact.top_speed
    steps = math.ceil(end * fastest / (courant * scenario.numerics.cell_size))
    time_step = end / steps
    rig = rig_of(scenario).open_box().changed(gravity=0.0, time_step=time_step)
    soil.velocity[:] = exact.at(-0.5 * time_step).velocity
    advance(soil, rig, steps, kernel="scalar", body_force=lambda t: exact.at(t).body_force)
    wanted = exact.at(end)
    return _errors(
        soil,
        scenario,
        soil.position - soil.start,
        wanted.position - soil.start,
        (exact.at(end - 0.5 * time_step).velocity, wanted.velocity),
        wanted.stress[:, 2],
        soil.stress[:, 2],
    )


def lame_errors(cells: int, per_side: int = 2) -> Errors:
    """Errors of a free block in Lamé's mode; see :func:`vortex_errors`."""
    side = 0.16
    scenario = _scenario(cells, per_side)
    soil, mode, gradient = lame_mode(scenario, side)
    speed = math.sqrt(scenario.soil.shear_modulus / scenario.soil.density)
    wave = Wave(math.sqrt(2.0) * math.pi * speed / side, TINY * side, mode, gradient)
    rig = rig_of(scenario).open_box().changed(gravity=0.0)
    return _wave_errors(scenario, soil, rig, wave, 2.0 * scenario.soil.shear_modulus, axis=0)


def column_errors(cells: int, per_side: int = 2) -> Errors:
    """Errors of a bed on a floor, between walls.

    What the bed does on its own is taken off: everything is linear but for the contact with the
    walls, which the weight keeps closed.
    """
    scenario = _scenario(cells, per_side)
    soil = geostatic_bed(scenario)
    height, speed = scenario.bed.height, scenario.soil.p_wave_speed
    wave = _upright(soil, scenario.bed.floor, height, speed)
    stiffness = scenario.soil.lame_lambda + 2.0 * scenario.soil.shear_modulus
    resting = geostatic_bed(scenario)
    return _wave_errors(scenario, soil, rig_of(scenario), wave, stiffness, axis=1, resting=resting)


def mirrored_errors(cells: int, per_side: int = 2) -> Errors:
    """Errors of the same wave with soil below in place of the floor: what a wall should do.

    A bar whose ends are free, swinging against its own mirror image. Poisson's ratio is zero, so
    that it needs no side walls.
    """
    scenario = _scenario(cells, per_side).replace(**{"soil.poisson_ratio": 0.0})
    height, middle = 0.12, 0.5 * DOMAIN
    spacing = scenario.numerics.cell_size / per_side
    soil = block_of((0.12, middle - height), (0.08, 2.0 * height), spacing, scenario.soil.density)
    wave = _upright(soil, middle, height, scenario.soil.p_wave_speed)
    rig = rig_of(scenario).open_box().changed(gravity=0.0)
    return _wave_errors(scenario, soil, rig, wave, scenario.soil.youngs_modulus, axis=1)


class Wave(NamedTuple):
    """A standing wave: displacement = size · sin(pace · time) · mode."""

    pace: float
    """[rad/s]"""
    size: float
    """[m]"""
    mode: FloatArray
    """At each particle [-], shape [particle, 2]."""
    gradient: FloatArray
    """Of the mode [1/m], shape [particle, 4]."""


def _upright(soil: Particles, foot: float, height: float, speed: float) -> Wave:
    """Compression wave of a column of some height [m] that is held at its foot."""
    k = 0.5 * math.pi / height
    above = soil.start[:, 1] - foot
    mode, gradient = np.zeros((len(above), 2)), np.zeros((len(above), 4))
    mode[:, 1], gradient[:, 3] = np.sin(k * above), k * np.cos(k * above)
    return Wave(k * speed, TINY * height, mode, gradient)


def _wave_errors(
    scenario: Scenario,
    soil: Particles,
    rig: Rig,
    wave: Wave,
    modulus: float,
    *,
    axis: int,
    resting: Particles | None = None,
) -> Errors:
    """Errors after 0.6 of a period, of the normal stress along one axis among them.

    Parameters
    ----------
    scenario, soil, rig, wave
        What swings, and how.
    modulus
        Stress over strain along the axis [Pa].
    axis
        0 for x, 1 for z.
    resting
        The same soil without the wave; its own motion is taken off.
    """
    whole = 0.6 * 2.0 * math.pi / wave.pace
    steps = math.ceil(whole / scenario.numerics.time_step)
    time_step = whole / steps
    top = wave.size * wave.pace
    begin = top * math.cos(0.5 * wave.pace * time_step)
    soil.velocity[:] = begin * wave.mode
    soil.gradient[:] = begin * wave.gradient
    advance(soil, rig.changed(time_step=time_step), steps)
    moved, stress = soil.position - soil.start, soil.stress[:, axis]
    if resting is not None:
        advance(resting, rig.changed(time_step=time_step), steps)
        moved, stress = soil.position - resting.position, stress - resting.stress[:, axis]
        soil = soil._replace(velocity=soil.velocity - resting.velocity)
    reached = wave.size * math.sin(wave.pace * whole)
    halfway = top * math.cos(wave.pace * (whole - 0.5 * time_step)) * wave.mode
    late = top * math.cos(wave.pace * whole) * wave.mode
    strain = reached * wave.gradient[:, 3 * axis]
    return _errors(
        soil, scenario, moved, reached * wave.mode, (halfway, late), modulus * strain, stress
    )


def transfer_loss(cells: int, per_side: int) -> float:
    """What a step without forces takes from a velocity wave, over (kΔx)⁴ [-].

    Parameters
    ----------
    cells, per_side
        As in :func:`vortex_errors`.
    """
    scenario = _scenario(cells, per_side)
    cell = scenario.numerics.cell_size
    soil = block_of((0.02, 0.02), (0.28, 0.28), cell / per_side, scenario.soil.density)
    rig = rig_of(scenario).open_box().changed(gravity=0.0)
    rig = rig._replace(material=rig.material._replace(lame_lambda=0.0, shear_modulus=1e-9))
    k = 2.0 * math.pi / 0.08
    wave = np.sin(k * soil.start[:, 0])
    inside = (np.abs(soil.start - 0.5 * DOMAIN) < 0.04).all(axis=1)
    soil.velocity[:, 1] = TINY * wave
    # The gradients come to fit the velocities in a few steps.
    advance(soil, rig, 4)
    before = float(soil.velocity[inside, 1] @ wave[inside])
    advance(soil, rig, 4)
    after = float(soil.velocity[inside, 1] @ wave[inside])
    return float((1.0 - (after / before) ** 0.25) / (k * cell) ** 4)


def _scenario(cells: int, per_side: int) -> Scenario:
    """Elastic soil in a domain that halves well."""
    return elastic(
        cells,
        on_nodes=True,
        per_side=per_side,
        **{"numerics.domain": DOMAIN, **BOX, "bed.floor_friction": "smooth"},
    )


def _errors(
    soil: Particles,
    scenario: Scenario,
    moved: FloatArray,
    moved_exact: FloatArray,
    velocity_exact: tuple[FloatArray, FloatArray],
    stress_exact: FloatArray,
    stress: FloatArray,
) -> Errors:
    """Relative errors [-] of displacement [m], velocity [m/s] and one stress component [Pa].

    The velocity is compared with two: half a step before the end, and at the end.
    """
    halfway, late = velocity_exact
    nodes = _nodal_means(soil, scenario, np.stack([stress - stress_exact, stress_exact], axis=1))
    return {
        "displacement": _rms(moved - moved_exact) / _rms(moved_exact),
        "velocity": _rms(soil.velocity - halfway) / _rms(halfway),
        "velocity, half a step late": _rms(soil.velocity - late) / _rms(late),
        "stress of nodes": _rms(nodes[:, 0]) / _rms(nodes[:, 1]),
        "stress of particles": _rms(stress - stress_exact) / _rms(stress_exact),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).sum() / len(values)))


def _nodal_means(soil: Particles, scenario: Scenario, values: FloatArray) -> FloatArray:
    """Means of particles around the nodes inside the body, by the weights of the transfer."""
    numerics = scenario.numerics
    place = soil.position / numerics.cell_size
    base = np.floor(place - 0.5).astype(np.int64)
    offset = place - base
    spline = [0.5 * (1.5 - offset) ** 2, 0.75 - (offset - 1.0) ** 2, 0.5 * (offset - 0.5) ** 2]
    side = numerics.cells + 3
    total, share = np.zeros((side * side, values.shape[1])), np.zeros(side * side)
    for a in range(3):
        for b in range(3):
            weight = spline[a][:, 0] * spline[b][:, 1]
            node = (base[:, 0] + a) * side + base[:, 1] + b
            np.add.at(total, node, weight[:, None] * values)
            np.add.at(share, node, weight)
    inside = share > 0.9 * numerics.particles_per_cell_side**2
    return np.asarray(total[inside] / share[inside, None])


RING, HALF_WIDTH = 0.07, 0.06
"""Radius of the ring's middle, and half its width [m]."""
DURATION = 2e-3
"""Time in which the ring turns and turns back [s]."""
POWER = 4
"""h is (1 - s²) to this power, s from -1 to 1 across the ring: three derivatives are smooth."""


class Fields(NamedTuple):
    """Exact state of particles at a time."""

    position: FloatArray
    """[m], shape [particle, 2]."""
    velocity: FloatArray
    """[m/s], shape [particle, 2]."""
    stress: FloatArray
    """(σ_xx, σ_zz, σ_xz) [Pa], shape [particle, 3]."""
    body_force: FloatArray
    """Acceleration [m/s²], shape [particle, 2]."""


class Vortex:
    """The solution for given particles.

    Parameters
    ----------
    start
        Positions at time 0 [m], shape [particle, 2].
    centre
        Centre of the ring (x, z) [m].
    amplitude
        Largest angle [rad]; the shear strain γ is at most three times as large.
    shear_modulus, density
        G [Pa], ρ [kg/m³].
    """

    def __init__(
        self,
        start: FloatArray,
        centre: tuple[float, float],
        amplitude: float,
        shear_modulus: float,
        density: float,
    ) -> None:
        self.centre = np.array(centre)
        self.radius = np.hypot(*(start - self.centre).T)
        self.angle = np.arctan2(*(start - self.centre).T[::-1])
        self.amplitude, self.shear_modulus, self.density = amplitude, shear_modulus, density
        self._shape = _profile(self.radius)

    @property
    def largest_shear(self) -> float:
        """Largest |γ| at any time [-]."""
        return float(self.amplitude * np.abs(self.radius * self._shape[1]).max())

    @property
    def top_speed(self) -> float:
        """Largest speed at any time [m/s]."""
        return float(self.amplitude * math.pi / DURATION * (self.radius * self._shape[0]).max())

    def at(self, time: float) -> Fields:
        """Exact fields at a time [s]."""
        h, h1, h2 = self._shape
        g, g1, g2 = self._course(time)
        r, shear = self.radius, self.radius * g * h1
        turned, rate = self.angle + g * h, g1 * h
        sine, cosine = np.sin(shear), np.cos(shear)
        # Per ρ: σ_rr = -σ_θθ, so that div σ has (∂/∂r + 2/r) of both σ_rr and σ_rθ.
        stiffness = self.shear_modulus / self.density
        growth = g * (h1 + r * h2)
        inward = -r * rate**2 + stiffness * (sine * growth + 2.0 * (1.0 - cosine) / r)
        around = r * g2 * h - stiffness * (cosine * growth + 2.0 * sine / r)
        e_r = np.stack([np.cos(turned), np.sin(turned)], axis=1)
        e_t = np.stack([-e_r[:, 1], e_r[:, 0]], axis=1)
        s_rr, s_rt = -self.shear_modulus * (1.0 - cosine), self.shear_modulus * sine
        c, s = e_r.T
        s_xx = s_rr * (c * c - s * s) - 2.0 * s_rt * c * s
        s_xz = 2.0 * s_rr * c * s + s_rt * (c * c - s * s)
        return Fields(
            self.centre + r[:, None] * e_r,
            (r * rate)[:, None] * e_t,
            np.stack([s_xx, -s_xx, s_xz], axis=1),
            inward[:, None] * e_r + around[:, None] * e_t,
        )

    def _course(self, time: float) -> tuple[float, float, float]:
        """Course g(t) and its first two derivatives: from 0 to the amplitude and back."""
        pace = 2.0 * math.pi / DURATION
        half = 0.5 * self.amplitude
        return (
            half * (1.0 - math.cos(pace * time)),
            half * pace * math.sin(pace * time),
            half * pace**2 * math.cos(pace * time),
        )


def _profile(radius: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Profile h(r) [-] and its first two derivatives [1/m, 1/m²], shape [particle] each."""
    s = np.clip((radius - RING) / HALF_WIDTH, -1.0, 1.0)
    q = 1.0 - s * s
    first = -2.0 * POWER * s * q ** (POWER - 1) / HALF_WIDTH
    second = 4.0 * POWER * (POWER - 1) * s * s * q ** (POWER - 2) - 2.0 * POWER * q ** (POWER - 1)
    return q**POWER, first, second / HALF_WIDTH**2
