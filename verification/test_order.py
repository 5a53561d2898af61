r"""Order of convergence.

Smooth solutions in elastic soil are computed on finer and finer grids, with step and grid refined
together. At second order half the cell size gives a quarter of the error, until the integration by
particles sets a floor.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from runs import Run, block_of, elastic, floating, lame_mode, unchecked
from terraphi.paper.plane.bed import Particles

pytestmark = pytest.mark.slow

DOMAIN = 0.32
"""Side of the domain [m], which 16, 32, 64, ... cells divide evenly."""
BOX = {
    "numerics.domain": DOMAIN,
    "bed.left": 0.08,
    "bed.floor": 0.08,
    "bed.width": 0.16,
    "bed.height": 0.16,
    "bed.floor_friction": "smooth",
    "motion.hip": [0.16, 0.28],
    "leg.chord": 0.03,
}
TINY, LARGE = 1e-6, 0.3
"""Amplitudes [rad]: all is linear, and soil is sheared by 0.9 and moves through several cells."""
SCHEME = "the order is reached in the limit; on these grids it is met within 0.2"


def rms(values):
    """Root of the mean square."""
    return float(np.sqrt((values**2).sum() / len(values)))


def errors_of(scenario, soil, moved, velocity, stress):
    """Relative errors of displacement [m], velocity [m/s] and one stress component [Pa].

    Each argument is a pair of what was found and what is exact.
    """
    pair = np.stack([stress[0] - stress[1], stress[1]], axis=1)
    nodes = nodal_means(soil, scenario, pair)
    return {
        "displacement": rms(moved[0] - moved[1]) / rms(moved[1]),
        "velocity": rms(velocity[0] - velocity[1]) / rms(velocity[1]),
        "stress": rms(nodes[:, 0]) / rms(nodes[:, 1]),
    }


def nodal_means(soil, scenario, values):
    """Means of particles around the nodes inside the body, weighed by the splines."""
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
    return total[inside] / share[inside, None]


# -- the generalised vortex ------------------------------------------------------------------------

RING, HALF_WIDTH = 0.07, 0.06
"""Radius of the ring's middle and half its width [m]."""
DURATION = 2e-3
"""Time in which the ring turns and turns back [s]."""


class Vortex:
    r"""A ring of soil whose circles turn by angles of their own, by α(r, t) = g(t) h(r).

    Kamojjala, Brannon, Sadeghirad and Guilkey (2015), Eng. Comput. 31, 193. With the Jaumann rate
    the stress has a closed form: in the frame that turns with a particle it is that of simple shear
    by γ = r ∂α/∂r, σ_rθ = G sin γ and σ_θθ = -σ_rr = G (1 - cos γ). It takes the body force
    b = a - div σ/ρ, with a_r = -r (∂α/∂t)² and a_θ = r ∂²α/∂t². h = (1 - s²)⁴ across the ring.
    """

    def __init__(self, start, amplitude, shear_modulus, density):
        self.centre = np.array([0.5 * DOMAIN, 0.5 * DOMAIN])
        self.r = np.hypot(*(start - self.centre).T)
        self.angle = np.arctan2(*(start - self.centre).T[::-1])
        self.amplitude, self.shear_modulus, self.density = amplitude, shear_modulus, density
        s = np.clip((self.r - RING) / HALF_WIDTH, -1.0, 1.0)
        q = 1.0 - s * s
        self.h, self.h1 = q**4, -8.0 * s * q**3 / HALF_WIDTH
        self.h2 = (48.0 * s * s * q**2 - 8.0 * q**3) / HALF_WIDTH**2

    @property
    def top_speed(self):
        """Largest speed at any time [m/s]."""
        return float(self.amplitude * math.pi / DURATION * (self.r * self.h).max())

    def at(self, time):
        """Exact position [m], velocity [m/s], σ_xz [Pa] and body force [m/s²] of each particle."""
        pace, half = 2.0 * math.pi / DURATION, 0.5 * self.amplitude
        g = half * (1.0 - math.cos(pace * time))
        g1 = half * pace * math.sin(pace * time)
        g2 = half * pace**2 * math.cos(pace * time)
        r, shear, turned = self.r, self.r * g * self.h1, self.angle + g * self.h
        sine, cosine = np.sin(shear), np.cos(shear)
        # σ_rr = -σ_θθ, so that div σ has (∂/∂r + 2/r) of both σ_rr and σ_rθ.
        stiffness, growth = self.shear_modulus / self.density, g * (self.h1 + r * self.h2)
        inward = -r * (g1 * self.h) ** 2
        inward = inward + stiffness * (sine * growth + 2.0 * (1.0 - cosine) / r)
        around = r * g2 * self.h - stiffness * (cosine * growth + 2.0 * sine / r)
        e_r = np.stack([np.cos(turned), np.sin(turned)], axis=1)
        e_t = np.stack([-e_r[:, 1], e_r[:, 0]], axis=1)
        c, s = e_r.T
        s_rr, s_rt = -self.shear_modulus * (1.0 - cosine), self.shear_modulus * sine
        return (
            self.centre + r[:, None] * e_r,
            (r * g1 * self.h)[:, None] * e_t,
            2.0 * s_rr * c * s + s_rt * (c * c - s * s),
            inward[:, None] * e_r + around[:, None] * e_t,
        )


def vortex_errors(cells, per_side, amplitude, courant=0.3):
    """Errors at three quarters of the vortex's duration."""
    scenario = elastic(cells, per_side=per_side, **BOX)
    spacing = scenario.numerics.cell_size / per_side
    soil = block_of((0.02, 0.02), (0.28, 0.28), spacing, scenario.soil.density)
    # Nothing happens beyond the ring.
    near = np.hypot(*(soil.position - 0.5 * DOMAIN).T) < RING + 0.07
    soil = Particles(*(values[near] for values in soil))
    exact = Vortex(soil.start, amplitude, scenario.soil.shear_modulus, scenario.soil.density)
    end, speed = 0.75 * DURATION, scenario.soil.p_wave_speed + exact.top_speed
    steps = math.ceil(end * speed / (courant * scenario.numerics.cell_size))
    time_step = end / steps
    soil.velocity[:] = exact.at(-0.5 * time_step)[1]
    run = Run(unchecked(floating(scenario), "numerics", time_step=time_step), soil)
    run.advance(steps, body_force=lambda t: exact.at(t)[3])
    position, _, shear, _ = exact.at(end)
    return errors_of(
        scenario,
        soil,
        (soil.position - soil.start, position - soil.start),
        (soil.velocity, exact.at(end - 0.5 * time_step)[1]),
        (soil.stress[:, 2], shear),
    )


# -- standing waves --------------------------------------------------------------------------------


def wave_errors(scenario, soil, wave, modulus, axis, resting=None):
    """Errors after 0.6 of a period of a wave: displacement = size sin(pace time) mode.

    `wave` is pace [rad/s], size [m], mode and its gradient [1/m]; `modulus` is stress over strain
    along the axis [Pa]. The motion of `resting`, the same soil without the wave, is taken off.
    """
    pace, size, mode, gradient = wave
    end = 0.6 * 2.0 * math.pi / pace
    steps = math.ceil(end / scenario.numerics.time_step)
    time_step, top = end / steps, size * pace
    scenario = unchecked(scenario, "numerics", time_step=time_step)
    begin = top * math.cos(0.5 * pace * time_step)
    soil.velocity[:], soil.gradient[:] = begin * mode, begin * gradient
    Run(scenario, soil).advance(steps)
    moved, velocity, stress = soil.position - soil.start, soil.velocity, soil.stress[:, axis]
    if resting is not None:
        Run(scenario, resting).advance(steps)
        moved = soil.position - resting.position
        velocity, stress = velocity - resting.velocity, stress - resting.stress[:, axis]
    reached = size * math.sin(pace * end)
    exact = top * math.cos(pace * (end - 0.5 * time_step)) * mode
    strain = reached * gradient[:, 3 * axis]
    return errors_of(
        scenario, soil, (moved, reached * mode), (velocity, exact), (stress, modulus * strain)
    )


def upright(soil, foot, height, speed):
    """Compression wave of a column that is held at its foot."""
    k, above = 0.5 * math.pi / height, soil.start[:, 1] - foot
    mode, gradient = np.zeros((len(above), 2)), np.zeros((len(above), 4))
    mode[:, 1], gradient[:, 3] = np.sin(k * above), k * np.cos(k * above)
    return k * speed, TINY * height, mode, gradient


def block_errors(cells):
    """Errors of a free block in Lamé's mode."""
    scenario, side = elastic(cells, **BOX), 0.16
    soil, mode, gradient = lame_mode(scenario, side)
    shear = scenario.soil.shear_modulus
    pace = math.sqrt(2.0 * shear / scenario.soil.density) * math.pi / side
    wave = (pace, TINY * side, mode, gradient)
    return wave_errors(floating(scenario), soil, wave, 2.0 * shear, 0)


def column_errors(cells):
    """Errors of a bed on a floor and between walls, less the bed at rest."""
    scenario = elastic(cells, **BOX)
    soil, resting = Run(scenario).soil, Run(scenario).soil
    speed = scenario.soil.p_wave_speed
    wave = upright(soil, scenario.bed.floor, scenario.bed.height, speed)
    return wave_errors(scenario, soil, wave, scenario.soil.density * speed**2, 1, resting)


# -- the tests -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("problem", "errors", "cells", "order", "why"),
    [
        ("Vortex, small, 4 particles a cell", lambda n: vortex_errors(n, 2, TINY), 128, 2.0,
         SCHEME),
        ("Vortex, sheared by 0.9, 9 particles a cell", lambda n: vortex_errors(n, 3, LARGE), 64,
         2.0, SCHEME + "; on finer ones the particles, no longer on a lattice, set a floor"),
        ("Free block in Lamé's mode", block_errors, 128, 2.0, SCHEME),
        ("Bed between walls", column_errors, 128, 1.0,
         "a one-sided wall holds the nodes beyond it at rest, which is of first order"),
    ],
    ids=["small vortex", "large vortex", "block", "walls"],
)  # fmt: skip
def test_errors_fall_with_the_order_of_the_scheme(check, problem, errors, cells, order, why):
    coarse, fine = errors(cells), errors(2 * cells)
    for quantity, error in fine.items():
        check(
            problem, f"order of {quantity}, {cells}² → {2 * cells}², error {error:.1e}",
            expected=order, found=math.log2(coarse[quantity] / error), within=0.2, absolute=True,
            sense="at_least", why=why,
        )  # fmt: skip


def test_transfer_damps_waves_as_its_symbol_says(check):
    """A step without forces multiplies a velocity wave by 1 - (m₄/4 - m₃² - 1/64) (kΔx)⁴.

    mₙ are the moments of the splines' weights about a particle, in cells; mean over the lattice.
    """
    per_side = 2
    place = (np.arange(per_side) + 0.5) / per_side - 0.5
    away = np.array([-1.0, 0.0, 1.0])[:, None] - place
    weight = np.where(np.abs(away) < 0.5, 0.75 - away**2, 0.5 * (1.5 - np.abs(away)) ** 2)
    third, fourth = (weight * away**3).sum(axis=0), (weight * away**4).sum(axis=0)
    scenario = elastic(128, per_side=per_side, **BOX)
    weak = unchecked(floating(scenario), "soil", youngs_modulus=1e-9)
    cell = scenario.numerics.cell_size
    soil = block_of((0.02, 0.02), (0.28, 0.28), cell / per_side, scenario.soil.density)
    k = 2.0 * math.pi / 0.08
    wave = np.sin(k * soil.start[:, 0])
    inside = (np.abs(soil.start - 0.5 * DOMAIN) < 0.04).all(axis=1)
    soil.velocity[:, 1] = TINY * wave
    run, sizes = Run(weak, soil), []
    for _ in range(2):  # the gradients come to fit the velocities in the first four steps
        run.advance(4)
        sizes.append(float(soil.velocity[inside, 1] @ wave[inside]))
    check(
        f"Loss of the transfer, {per_side**2} particles a cell, kΔx = {k * cell:.2f}",
        "loss of a step over (kΔx)⁴", expected=float((0.25 * fourth - third**2).mean() - 1.0 / 64),
        found=(1.0 - (sizes[1] / sizes[0]) ** 0.25) / (k * cell) ** 4, within=0.01,
        why="the next term of the symbol is (kΔx)² smaller, 4 %, times a factor below a fifth",
    )  # fmt: skip
