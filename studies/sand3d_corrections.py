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
what one grid has and another has not: a factor of each force, and noise over θ. Hyperparameters
were found once by their posterior density under log-normal priors; three to six friction angles
determine them badly, hence the factor FEW on all standard deviations.

The result is the mean correction and, for each cause, the principal components of its covariance
over (φ, θ) together. Leg friction (0.30 ± 0.087) and hip height (± 2 mm) are added as one mode
each, from simulations with another friction and another height.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import terraphi
from terraphi.inference.emulator import Emulator
from terraphi.library.store import THETA_DEG, Correction, Library

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
FEW = 1.25
"""Factor on standard deviations, since hyperparameters are few curves' [-]."""
HYPER = {
    ("straight", "cells"): (0.213, 0.0846, 20.0, 15.2, 0.0281, 0.00575),
    ("straight", "speed-up"): (0.0607, 0.0299, 26.0, 16.7, 0.00493, 0.0019),
    ("c", "cells"): (0.5, 0.2975, 53.7, 60.0, 0.031, 0.00138),
    ("c", "speed-up"): (0.0666, 0.0608, 9.2, 9.39, 0.00496, 0.00926),
    ("reversed_c", "cells"): (0.3138, 0.1657, 47.6, 32.9, 0.0212, 0.00331),
    ("reversed_c", "speed-up"): (0.0379, 0.0131, 8.07, 20.0, 0.0047, 0.006),
}
"""By leg and cause: level, amplitude, length over φ [deg], over θ [deg], offset, ripple [-]."""
FOUND_DEG = np.arange(15.0, 51.0, 5.0)
"""Friction angles of the library's curves that the hyperparameters were found with [deg]."""
SCATTER = 0.44
"""Standard deviation of a finer simulation's scatter over that of the library's [-]."""
GRID_DEG = np.linspace(-85.0, 85.0, 40)
"""Leg angles at which corrections are computed [deg]: the windows of an inversion."""
HALF = np.radians(85.0 / 39.0)
"""Half the width of a window [rad]."""
MODES = 6
"""Components of each cause's covariance that are kept."""
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


def correction(emulator: Emulator, leg: str, cause: str, phi_deg: np.ndarray) -> tuple:
    """Mean [N] and modes [N] of the correction at friction angles, [k, 2, theta], [mode, …]."""
    hyper, base = HYPER[leg, cause], STEP[cause](emulator.curves.scenario.numerics)
    rows = [
        (s.soil.friction_angle_deg, round(STEP[cause](s.numerics) / base, 4), force)
        for name in FINER[cause]
        for s, force in simulated(name, leg)
    ]
    phi, ratio, fine = (np.array(column) for column in zip(*rows, strict=True))
    coarse_force, at = at_grid(emulator, phi), at_grid(emulator, phi_deg)
    relative = at_grid(emulator, emulator.curves.x[:, 0])
    relative = relative / np.ptp(relative, axis=2, keepdims=True)
    profile = np.sqrt(np.square(relative).mean(axis=(0, 1)))
    profile = np.maximum(np.convolve(profile, np.ones(3) / 3.0, "same") / profile.max(), 0.05)

    def prior(phi1, f1, phi2, f2):
        """Covariance of the powers' sum and of a ripple between two sets, [k, n, 2 t, 2 t]."""
        level, amplitude, phi_length, theta_length, offset, ripple = hyper
        size = [(np.ptp(f, axis=2, keepdims=True) * profile).reshape(len(f), -1) for f in (f1, f2)]
        over_theta = np.kron(np.eye(2), matern(GRID_DEG, GRID_DEG, theta_length))
        of_one = np.kron(np.eye(2), np.ones((len(GRID_DEG),) * 2))
        over_phi = matern(phi1, phi2, phi_length)
        slow = CONSTANT + (1.0 - CONSTANT) * matern(phi1, phi2, LEVEL_LENGTH_DEG)
        flat1, flat2 = f1.reshape(len(f1), -1), f2.reshape(len(f2), -1)
        sizes = over_phi[:, :, None, None] * size[0][:, None, :, None] * size[1][None, :, None, :]
        alike = slow[:, :, None, None] * of_one * flat1[:, None, :, None] * flat2[None, :, None, :]
        powers = amplitude**2 * over_theta * sizes + level**2 * alike
        return powers, ripple**2 * np.eye(len(over_theta)) * sizes + offset**2 * alike

    def shared(r1, r2):
        """Covariance of Σ(1 − r^p) c_p over that of a c, [k, n]."""
        one, two = (1.0 - np.asarray(r)[:, None] ** POWERS for r in (r1, r2))
        mean = (one @ WEIGHTS)[:, None] * (two @ WEIGHTS)
        return ALIKE * mean + (1.0 - ALIKE) * (one * WEIGHTS) @ two.T

    def matrix(blocks):
        k, n, a, b = blocks.shape
        return blocks.transpose(0, 2, 1, 3).reshape(k * a, n * b)

    powers, ripple = prior(phi, coarse_force, phi, coarse_force)
    of_rows = shared(ratio, ratio)[:, :, None, None] * powers
    of_rows += (1.0 + (ratio[:, None] == ratio))[:, :, None, None] * ripple
    coarse = onto(emulator.curves.theta_deg, np.eye(emulator.curves.theta_deg.size), GRID_DEG)
    both = np.kron(np.eye(2), coarse.T)
    for i, angle in enumerate(phi):
        of_rows[i, i] += SCATTER**2 * both @ emulator.scatter(np.array([angle])) @ both.T
        own = both @ emulator.interpolation(np.array([angle]))
        of_rows[i, phi == angle] += own @ own.T
    limit = np.zeros(len(phi_deg))
    powers, ripple = prior(phi_deg, at, phi, coarse_force)
    across = matrix(shared(limit, ratio)[:, :, None, None] * powers + ripple)
    powers, ripple = prior(phi_deg, at, phi_deg, at)
    own = matrix(shared(limit, limit)[:, :, None, None] * powers + ripple)
    total = matrix(of_rows)
    total += 1e-8 * np.trace(total) / len(total) * np.eye(len(total))
    solved = np.linalg.solve(total, across.T)
    mean = (solved.T @ (fine - coarse_force).ravel()).reshape(at.shape)
    values, vectors = np.linalg.eigh(FEW**2 * (own - across @ solved))
    kept = vectors[:, -MODES:] * np.sqrt(np.maximum(values[-MODES:], 0.0))
    print(
        f"{leg}, {cause}: {len(phi)} finer curves; modes have "
        f"{values[-MODES:].sum() / values.clip(0).sum():.0%} of the variance"
    )
    return mean, kept.T.reshape(MODES, *at.shape)


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
    # Hyperparameters were found with these curves, and go with them.
    low, high = FOUND_DEG[0], FOUND_DEG[-1]
    coarse = replace(
        library,
        **{
            kind: tuple(c for c in cases if c.scenario.soil.friction_angle_deg in FOUND_DEG)
            for kind, cases in (("cases", library.cases), ("replicates", library.replicates))
        },
    )
    found = {}
    for leg in library.legs:
        emulator = Emulator(coarse.curves(leg))
        every = np.unique(library.curves(leg).x[:, 0])
        # Beyond, corrections are those of the last angle, in proportion to the forces.
        phi = np.clip(every, low, high)
        beyond = (emulator.size(every[:, None]) / emulator.size(phi[:, None]))[:, None, None]
        parts = {cause: correction(emulator, leg, cause, phi) for cause in FINER}
        modes = {cause: part[1] for cause, part in parts.items()}
        # What goes with the product of both causes is in both; the smaller may be any share of it.
        one, other = (part[0] for part in parts.values())
        smaller = np.where(one * other > 0.0, np.sign(one) * np.minimum(abs(one), abs(other)), 0.0)
        modes["cells"] = np.concatenate([modes["cells"], FEW * smaller[None] / np.sqrt(3.0)])
        modes["leg friction"] = sensitivity(
            emulator, leg, "sand3d-friction", "leg.friction", FRICTION_SD, phi
        )
        modes["hip height"] = sensitivity(emulator, leg, "sand3d-raised", "hip", HEIGHT_SD_MM, phi)
        theta = THETA_DEG[emulator.curves.theta_deg[-1] >= THETA_DEG]
        found[leg] = Correction(
            every, theta, beyond * onto(GRID_DEG, one + other, theta),
            {cause: beyond * onto(GRID_DEG, mode, theta) for cause, mode in modes.items()},
        )  # fmt: skip
    replace(library, corrections=found).save(options.out)


if __name__ == "__main__":
    main()
