r"""Correct the curves of library ``sand3d`` for cell size and speed-up, from finer simulations.

    python studies/sand3d_corrections.py --library sand3d-simulated.nc --out sand3d.nc

The library has cells of 5 mm and a motion sped up k = 10 times. Its error vanishes with the cell
size h, or with k − 1, by an unknown power p. With r the ratio of a finer simulation's h (or k − 1)
to the library's, g the library's curves and y those of the finer one,

    y(r) − g = Σ_p (1 − r^p) c_p + ripple_r + scatter,    limit − g = Σ_p c_p,

p = 1/2, 1, 2 with shares of the variance, partly common (errors of h and h² seldom cancel). Each c
is

    c(φ, θ) = a(φ) g(φ, θ) + s(φ) w(θ) δ(φ, θ),

a the level, normal and smooth over φ; s the peak-to-peak of each force; w where the leg is in soil;
δ a Gaussian process, Matérn 5/2 over φ and θ (Kennedy & O'Hagan 2000, Biometrika 87:1). A ripple is
what one grid has and another has not: a factor of each force, and noise over θ. The seven
hyperparameters of a cause are those of the largest marginal likelihood of all three legs together,
found here: three to six friction angles determine those of one leg badly.

The result is the mean correction. Finer simulations left out in turn are met as well by a line over
φ for each θ with a power p of 1, but then dense glass beads on the reversed C are a misfit. What
the limit may be wrong by is part of the offset, which is learned from soils of known angle with
these curves (``model_error.py``). Leg friction (0.30 ± 0.087) and hip height (± 2 mm) are added as
one mode each, from simulations with another friction and another height.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

import terraphi
from terraphi.laws.emulator import Emulator
from terraphi.laws.store import THETA_DEG, Correction, Library

DATA = Path(__file__).parent / "data" / "libraries"
FINER = {
    "cells": ("sand3d-cells-86", "sand3d-cells-120", "sand3d-cells-150"),
    "speed-up": ("sand3d-speed-up",),
}
"""Libraries of finer simulations by cause."""
STEP = {"cells": lambda n: n.cell_size, "speed-up": lambda n: n.speed_up - 1.0}
"""What an error is a power of, by cause, from the numerics of a scenario."""
POWERS, WEIGHTS, ALIKE = np.array([0.5, 1.0, 2.0]), np.array([0.5, 0.25, 0.25]), 0.4
"""Powers, their shares of the variance, and the share that they have in common [-]."""
CONSTANT, LEVEL_LENGTH_DEG = 0.3, 20.0
"""Share of the level that is one for all φ, and correlation length of the rest."""
HYPER = {
    "level": (0.1, 0.01, 0.5),
    "amplitude": (0.05, 0.002, 0.5),
    "length over φ [deg]": (20.0, 8.0, 60.0),
    "length over θ [deg]": (20.0, 4.0, 60.0),
    "offset": (0.01, 0.0005, 0.1),
    "ripple": (0.003, 0.0005, 0.05),
    "scatter": (0.5, 0.2, 5.0),
}
"""Hyperparameters: where the search begins, and its ends. Scatter is the standard deviation of that
of a finer simulation over the library's; all but lengths are without unit."""
LEAST_DEG = 15.0
"""Friction angle below which the correction is that at it, in proportion to the forces [deg]."""
GRID_DEG = np.linspace(-85.0, 85.0, 40)
"""Leg angles at which corrections are computed [deg]: the windows of an inversion."""
HALF = np.radians(85.0 / 39.0)
"""Half the width of a window [rad]."""
FRICTION_SD, HEIGHT_SD_MM = 0.087, 2.0
"""Standard deviations of the leg's friction (uniform on 0.15 to 0.45) and of the hip's height."""


def matern(one: np.ndarray, other: np.ndarray, length: float) -> np.ndarray:
    """Matérn 5/2 correlation, shape [k, n]."""
    lag = np.sqrt(5.0) * np.abs(one[:, None] - other) / length
    return (1.0 + lag + lag**2 / 3.0) * np.exp(-lag)


def at_grid(emulator: Emulator, phi_deg: np.ndarray) -> np.ndarray:
    """Library curves at friction angles on the coarse grid of θ [N], shape [k, 2, theta]."""
    return onto(emulator.curves.theta_deg, emulator(np.asarray(phi_deg)[:, None]), GRID_DEG)


def onto(theta_deg: np.ndarray, force: np.ndarray, grid_deg: np.ndarray) -> np.ndarray:
    """Curves at other leg angles: means over neighbours, then linear; shape [..., theta]."""
    wide = np.median(np.diff(grid_deg)) > np.median(np.diff(theta_deg))
    if wide:
        half = 0.5 * float(np.median(np.diff(grid_deg)))
        near = np.abs(theta_deg[None, :] - grid_deg[:, None]) <= half
        return force @ (near / np.maximum(near.sum(axis=1, keepdims=True), 1)).T
    flat = force.reshape(-1, force.shape[-1])
    return np.stack([np.interp(grid_deg, theta_deg, row) for row in flat]).reshape(
        *force.shape[:-1], len(grid_deg)
    )


def simulated(name: str, leg: str) -> Iterator[tuple[terraphi.Scenario, np.ndarray]]:
    """Cases of a leg in a library of `DATA`, and their forces at GRID_DEG [N], shape [2, theta]."""
    for case in Library.load(DATA / f"{name}.nc").cases:
        if case.scenario.leg.shape == leg and case.history is not None:
            yield case.scenario, case.history.means(np.radians(GRID_DEG), HALF).T


class Finer(NamedTuple):
    """Finer simulations of a leg, and the library's curves there."""

    phi: np.ndarray
    """Friction angles [deg], shape [k]."""
    ratio: np.ndarray
    """Cell size, or speed-up less one, over the library's [-], shape [k]."""
    change: np.ndarray
    """Their forces less the library's [N], shape [k, 2 theta]."""
    force: np.ndarray
    """The library's [N], shape [k, 2 theta]."""
    profile: np.ndarray
    """Where the leg is in soil [-], shape [2 theta]."""
    scatter: np.ndarray
    """Covariance of the scatter of one simulation [N²], shape [k, 2 theta, 2 theta]."""
    shared: np.ndarray
    """That of the library's curve [N²], which simulations of one φ share, of the same shape."""


def finer(emulator: Emulator, leg: str, cause: str) -> Finer:
    """Finer simulations of a cause."""
    step = STEP[cause]
    rows = [
        (s.soil.friction_angle_deg, step(s.numerics) / step(emulator.curves.scenario.numerics), f)
        for name in FINER[cause]
        for s, f in simulated(name, leg)
    ]
    phi, ratio, fine = (np.array(column) for column in zip(*rows, strict=True))
    relative = at_grid(emulator, emulator.curves.x[:, 0])
    relative = relative / np.ptp(relative, axis=2, keepdims=True)
    profile = np.sqrt(np.square(relative).mean(axis=(0, 1)))
    profile = np.maximum(np.convolve(profile, np.ones(3) / 3.0, "same") / profile.max(), 0.05)
    coarse = onto(emulator.curves.theta_deg, np.eye(emulator.curves.theta_deg.size), GRID_DEG)
    both = np.kron(np.eye(2), coarse.T)
    own = [both @ emulator.interpolation(np.array([angle])) for angle in phi]
    force = at_grid(emulator, phi)
    return Finer(
        phi, ratio.round(4), (fine - force).reshape(len(phi), -1), force.reshape(len(phi), -1),
        np.tile(profile, 2),
        np.array([both @ emulator.scatter(np.array([angle])) @ both.T for angle in phi]),
        np.array([one @ one.T for one in own]),
    )  # fmt: skip


def between(one: Finer, phi: np.ndarray, ratio: np.ndarray, force: np.ndarray, hyper) -> np.ndarray:
    """Covariance of finer simulations with others [N²], shape [k, n, 2 theta, 2 theta]."""
    level, amplitude, phi_length, theta_length, offset, ripple, _ = hyper
    sizes = [
        np.repeat(np.ptp(f.reshape(len(f), 2, -1), axis=2), f.shape[1] // 2, axis=1) * one.profile
        for f in (one.force, force)
    ]
    sizes = sizes[0][:, None, :, None] * sizes[1][None, :, None, :]
    sizes *= matern(one.phi, phi, phi_length)[:, :, None, None]
    over_theta = np.kron(np.eye(2), matern(GRID_DEG, GRID_DEG, theta_length))
    of_one = np.kron(np.eye(2), np.ones((GRID_DEG.size,) * 2))
    slow = CONSTANT + (1.0 - CONSTANT) * matern(one.phi, phi, LEVEL_LENGTH_DEG)
    alike = slow[:, :, None, None] * of_one
    alike *= one.force[:, None, :, None] * force[None, :, None, :]
    shares = [1.0 - r[:, None] ** POWERS for r in (one.ratio, ratio)]
    mean = (shares[0] @ WEIGHTS)[:, None] * (shares[1] @ WEIGHTS)
    powers = ALIKE * mean + (1.0 - ALIKE) * (shares[0] * WEIGHTS) @ shares[1].T
    # A change is that of two grids: each has its ripple, and the library's is in all.
    ripples = 1.0 + (one.ratio[:, None] == ratio)
    found = powers[:, :, None, None] * (amplitude**2 * over_theta * sizes + level**2 * alike)
    return found + ripples[:, :, None, None] * (
        ripple**2 * np.eye(len(over_theta)) * sizes + offset**2 * alike
    )


def matrix(blocks: np.ndarray) -> np.ndarray:
    """Blocks as one matrix, shape [k, n, a, b] -> [k a, n b]."""
    k, n, a, b = blocks.shape
    return blocks.transpose(0, 2, 1, 3).reshape(k * a, n * b)


def covariance(one: Finer, hyper) -> np.ndarray:
    """Covariance of the changes [N²], shape [k 2 theta, k 2 theta]."""
    blocks = between(one, one.phi, one.ratio, one.force, hyper)
    for i, angle in enumerate(one.phi):
        blocks[i, i] += hyper[-1] ** 2 * one.scatter[i]
        blocks[i, one.phi == angle] += one.shared[i]
    total = matrix(blocks)
    return total + 1e-8 * np.trace(total) / len(total) * np.eye(len(total))


def most_likely(legs: list[Finer]) -> np.ndarray:
    """Hyperparameters of the largest marginal likelihood of all legs together."""
    table = np.log(list(HYPER.values()))

    def loss(logarithms: np.ndarray) -> float:
        total = 0.0
        for one in legs:
            factor = np.linalg.cholesky(covariance(one, np.exp(logarithms)))
            white = np.linalg.solve(factor, one.change.ravel())
            total += 0.5 * float(white @ white) + float(np.log(np.diag(factor)).sum())
        return total

    found = minimize(loss, table[:, 0], method="L-BFGS-B", bounds=table[:, 1:])
    return np.exp(found.x)


def correction(one: Finer, hyper: np.ndarray, phi_deg: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Mean correction of the library's forces at friction angles [N], shape [k, 2, theta]."""
    flat = force.reshape(len(force), -1)
    across = matrix(between(one, phi_deg, np.zeros(len(phi_deg)), flat, hyper))
    solved = np.linalg.solve(covariance(one, hyper), one.change.ravel())
    return (across.T @ solved).reshape(force.shape)


def sensitivity(
    emulator: Emulator, leg: str, name: str, key: str, sd: float, phi_deg
) -> np.ndarray:
    """Change of the curves by one standard deviation of a key, shape [1, k, 2, theta] [N].

    The change over the forces' size is linear in the value of the key, and over φ between the
    simulated angles; beyond them it is that of the last.
    """
    base, scale = emulator.curves.scenario, {}
    for scenario, force in simulated(name, leg):
        phi = scenario.soil.friction_angle_deg
        step = (
            scenario.leg.friction - base.leg.friction
            if key == "leg.friction"
            else 1e3 * (scenario.hip_height - base.hip_height)
        )
        change = (force - at_grid(emulator, np.array([phi]))[0]) / step
        scale.setdefault(phi, []).append(change / emulator.size(np.array([[phi]]))[0])
    angles = np.array(sorted(scale))
    relative = np.array([np.mean(scale[phi], axis=0) for phi in angles])
    kernel = np.exp(-0.5 * np.square((GRID_DEG[:, None] - GRID_DEG) / 4.0))
    relative = relative @ (kernel / kernel.sum(axis=1, keepdims=True)).T
    flat = relative.reshape(len(angles), -1)
    rows = np.stack([np.interp(phi_deg, angles, column) for column in flat.T], axis=1)
    sizes = emulator.size(np.asarray(phi_deg)[:, None])[:, None]
    return (sd * sizes * rows).reshape(1, len(phi_deg), 2, len(GRID_DEG))


def main() -> None:
    """Write the library with its corrections."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--library", required=True, help="as simulated")
    parser.add_argument("--out", required=True)
    options = parser.parse_args()
    library = terraphi.Library.load(options.library)
    emulators = {leg: Emulator(library.curves(leg)) for leg in library.legs}
    found: dict[str, Correction] = {}
    hyper, legs = {}, {}
    for cause in FINER:
        legs[cause] = {leg: finer(emulator, leg, cause) for leg, emulator in emulators.items()}
        hyper[cause] = most_likely([*legs[cause].values()])
        print(cause, dict(zip(HYPER, hyper[cause].round(4).tolist(), strict=True)))
    for leg, emulator in emulators.items():
        every = np.unique(emulator.curves.x[:, 0])
        # Beyond, corrections are those of the last angle, in proportion to the forces.
        phi = np.clip(every, LEAST_DEG, max(one[leg].phi.max() for one in legs.values()))
        beyond = (emulator.size(every[:, None]) / emulator.size(phi[:, None]))[:, None, None]
        force = at_grid(emulator, phi)
        mean = sum(correction(legs[cause][leg], hyper[cause], phi, force) for cause in FINER)
        modes = {
            "leg friction": sensitivity(
                emulator, leg, "sand3d-friction", "leg.friction", FRICTION_SD, phi
            ),
            "hip height": sensitivity(emulator, leg, "sand3d-raised", "hip", HEIGHT_SD_MM, phi),
        }
        theta = THETA_DEG[emulator.curves.theta_deg[-1] >= THETA_DEG]
        found[leg] = Correction(
            every, theta, beyond * onto(GRID_DEG, mean, theta),
            {cause: beyond * onto(GRID_DEG, mode, theta) for cause, mode in modes.items()},
        )  # fmt: skip
    replace(library, corrections=found).save(options.out)


if __name__ == "__main__":
    main()
