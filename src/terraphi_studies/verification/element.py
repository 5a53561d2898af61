"""One material point on a strain path, by the stress update of either kernel."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.soil import Soil
from terraphi.forward.mpm.plasticity import (
    Four,
    cone_of,
    jaumann_predictor,
    material_of,
    return_mapping,
    return_to_cone,
)

FloatArray = NDArray[np.float64]

Update = Callable[[Four, Four, float], Four]
"""From stress [Pa], gradient of the displacement in the plane [-] and strain across it [-]."""

MAPPINGS = ("return_mapping", "return_to_cone")
"""The return mapping of the reference kernel and that of the fast one."""
STRAIN_STEPS = 800
LARGE_STRAIN_STEPS = 10_000
CONFINEMENT = 1000.0
"""Stress that is held along a path [Pa], that of soil six centimetres deep."""
ELASTIC_COHESION = 1e12
"""Cohesion with which soil never yields [Pa]."""


class Failure(NamedTuple):
    """Where a path ends: the soil flows and its stress changes no more."""

    stress: FloatArray
    """(σ_xx, σ_zz, σ_xz, σ_yy) [Pa]."""
    strain: FloatArray
    """Last increment of (ε_xx, ε_zz, γ_xz, ε_yy) [-], all of it plastic by then."""

    @property
    def mean(self) -> float:
        """In-plane mean stress p, compression negative [Pa]."""
        return float(0.5 * (self.stress[0] + self.stress[1]))

    @property
    def radius(self) -> float:
        """Radius of Mohr's circle in the plane, (σ1 - σ3)/2 [Pa]."""
        return math.hypot(0.5 * (self.stress[0] - self.stress[1]), self.stress[2])

    @property
    def root_j2(self) -> float:
        """√J2 [Pa]."""
        sxx, szz, sxz, syy = self.stress
        third = (sxx + szz + syy) / 3.0
        normal = (sxx - third) ** 2 + (szz - third) ** 2 + (syy - third) ** 2
        return math.sqrt(0.5 * normal + sxz**2)

    @property
    def i1(self) -> float:
        """First invariant, compression negative [Pa]."""
        return float(self.stress[0] + self.stress[1] + self.stress[3])

    @property
    def dilatancy(self) -> float:
        """Volumetric strain rate over the rate of the largest shear strain in the plane [-]."""
        exx, ezz, gxz, _ = self.strain
        return float((exx + ezz) / math.hypot(exx - ezz, gxz))


def update_of(soil: Soil, mapping: str) -> Update:
    """Stress update of a soil.

    Parameters
    ----------
    soil
        Any soil.
    mapping
        One of :data:`MAPPINGS`.

    Returns
    -------
    callable
        The kernels' own predictor and return mapping. Strain across the plane, which they never
        see, adds its elastic part to the trial stress: what the return does with it is theirs.
    """
    material = material_of(soil)
    cone = cone_of(material)
    across = np.array([material.lame_lambda] * 2 + [0.0, material.lame_lambda])
    across[3] += 2.0 * material.shear_modulus

    def update(stress: Four, gradient: Four, strain_yy: float) -> Four:
        trial = jaumann_predictor(
            stress, gradient, 1.0, material.lame_lambda, material.shear_modulus
        )
        sxx, szz, sxz, syy = (np.array(trial) + across * strain_yy).tolist()
        if mapping == "return_mapping":
            return return_mapping((sxx, szz, sxz, syy), material)
        return return_to_cone((sxx, szz, sxz, syy), cone)

    return update


def held(guess: float, wanted: float, component: Callable[[float], float]) -> float:
    """Strain at which a stress component has the wanted value, by secants.

    Parameters
    ----------
    guess
        A strain of the right size, not zero [-].
    wanted
        [Pa].
    component
        From strain to stress [Pa].

    Returns
    -------
    float
        [-].
    """
    before, here = 0.0, guess
    low, high = component(before) - wanted, component(here) - wanted
    for _ in range(60):
        if high == low or abs(high) <= 1e-12 * abs(wanted):
            break
        before, here, low = here, here - high * (here - before) / (high - low), high
        high = component(here) - wanted
    return here


def simple_shear(soil: Soil, mapping: str) -> Failure:
    """Shear by γ_xz without strain along x, under a constant σ_zz.

    Parameters
    ----------
    soil, mapping
        As in :func:`update_of`.

    Returns
    -------
    Failure
    """
    update, shear = update_of(soil, mapping), _strain_step(soil)
    stress = (-CONFINEMENT, -CONFINEMENT, 0.0, -CONFINEMENT)
    rise = 0.1 * shear
    for _ in range(STRAIN_STEPS):
        now = stress
        rise = held(
            rise or shear,
            -CONFINEMENT,
            lambda ezz, now=now: update(now, (0.0, shear, 0.0, ezz), 0.0)[1],  # type: ignore[misc]
        )
        stress = update(stress, (0.0, shear, 0.0, rise), 0.0)
    return Failure(np.array(stress), np.array([0.0, rise, shear, 0.0]))


def biaxial(soil: Soil, mapping: str, *, confinement: float = CONFINEMENT) -> Failure:
    """Compression along z without strain across the plane, under a constant σ_xx.

    Parameters
    ----------
    soil, mapping
        As in :func:`update_of`.
    confinement
        -σ_xx [Pa].

    Returns
    -------
    Failure
    """
    return _compression(soil, mapping, confinement, 0.0)


def triaxial_compression(soil: Soil, mapping: str) -> Failure:
    """Compression along z under a constant σ_xx = σ_yy; for the ``triaxial`` criterion.

    Parameters
    ----------
    soil, mapping
        As in :func:`update_of`.

    Returns
    -------
    Failure
    """
    return _compression(soil, mapping, CONFINEMENT, 1.0)


def extension(soil: Soil, mapping: str) -> Failure:
    """Equal extension along x and z, far beyond what any soil bears.

    Parameters
    ----------
    soil, mapping
        As in :func:`update_of`.

    Returns
    -------
    Failure
    """
    update, step = update_of(soil, mapping), _strain_step(soil)
    stress = (0.0, 0.0, 0.0, 0.0)
    for _ in range(STRAIN_STEPS):
        stress = update(stress, (step, 0.0, 0.0, step), 0.0)
    return Failure(np.array(stress), np.array([step, step, 0.0, 0.0]))


def elastic_shear(soil: Soil, mapping: str, shear: float) -> Failure:
    """Simple shear from zero stress at constant volume, v_x = γ̇ z.

    Parameters
    ----------
    soil, mapping
        As in :func:`update_of`.
    shear
        γ at the end [-].

    Returns
    -------
    Failure
    """
    update, step = update_of(soil, mapping), shear / LARGE_STRAIN_STEPS
    stress = (0.0, 0.0, 0.0, 0.0)
    for _ in range(LARGE_STRAIN_STEPS):
        stress = update(stress, (0.0, step, 0.0, 0.0), 0.0)
    return Failure(np.array(stress), np.array([0.0, 0.0, step, 0.0]))


def _compression(soil: Soil, mapping: str, confinement: float, across: float) -> Failure:
    """Compression along z; strain across the plane is ``across`` times that along x."""
    update, step = update_of(soil, mapping), -_strain_step(soil)
    stress = (-confinement,) * 2 + (0.0, -confinement)
    wide = -0.3 * step
    for _ in range(STRAIN_STEPS):
        now = stress
        wide = held(
            wide,
            -confinement,
            lambda exx, now=now: update(now, (exx, 0.0, 0.0, step), across * exx)[0],  # type: ignore[misc]
        )
        stress = update(stress, (wide, 0.0, 0.0, step), across * wide)
    return Failure(np.array(stress), np.array([wide, step, 0.0, across * wide]))


def _strain_step(soil: Soil) -> float:
    """Increment: some dozens reach failure, the other hundreds flow until all is steady [-]."""
    return 0.05 * (CONFINEMENT + soil.cohesion) / soil.shear_modulus
