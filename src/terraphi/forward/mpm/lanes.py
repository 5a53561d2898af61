"""What a step does to one packet: the same arithmetic in every lane, without branches.

``plain`` with slopes of the kind ``cell``, in single precision. Within a cell a component v of the
velocity is taken as its value at the middle and nine moments,

    A = Δx ∇v,    B = Δx² ∇∇v    (x, y, z;  xx, yy, zz, xy, xz, yz),

so that the gradient at a particle, an offset r [cell] from the middle, is A + B r. The moments are
found once for all particles of a cell, from 27 nodes, an axis at a time: value (W), slope (D) and
second slope (H) of the spline over z, y and x are each a sum over three nodes. The forces go the
same way back: a cell's sums of stress and of stress times offset, then an axis at a time.

All that passes between the stages lies in one array, ``work``, in rows: a row has one number for
each cell of a block, or for each node that they reach. The loops over ``lanes`` are what the
compiler turns into vector instructions. It does so only if their length is an argument, if all
indices are unsigned and all arrays flat, and if the distances between what is read and written are
known to it; ``tests/forward/mpm`` looks at the instructions that come of it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.compiled import kernel, wide_vectors
from terraphi.forward.mpm import packing
from terraphi.forward.mpm.lattice import LANES, MARGIN
from terraphi.forward.mpm.plasticity import SHORT_OF_TIP, Material, bulk_modulus

Work = NDArray[np.float32]
Index: TypeAlias = Any
"""An unsigned integer of 64 bits."""
Six = tuple[Any, Any, Any, Any, Any, Any]

ONE, TWO, THREE, FOUR, FIVE, SIX, SEVEN, EIGHT, NINE = (np.uint64(n) for n in range(1, 10))
ROW = LANES + LANES
"""Length of a row of ``work``."""
VELOCITY = np.uint64(0)
"""27 rows: component, then node (z, y) of the window."""
ACROSS = np.uint64(27) * ROW
"""18 rows: component, then (W W, D W, W D, H W, W H, D D) over (y, z)."""
MOMENT = np.uint64(45) * ROW
"""27 rows: component, then the nine moments times the time step [-]."""
SUM = np.uint64(72) * ROW + MARGIN
"""24 rows: six stresses, then for each its product with the offset (x, y, z) [Pa], with zeros
before and behind."""
BACK = np.uint64(96) * ROW
"""6 rows of forces on their way back: (W W, D W, W D, H W, W H, D D) over (y, z)."""
MIDDLE = np.uint64(102) * ROW
"""3 rows: mean offset of a cell's particles (x, y, z) [cell]."""
RATE = np.uint64(105) * ROW
"""1 row: volumetric strain there [-]."""
SWELL = np.uint64(106) * ROW
"""3 rows: of each cell number, swelling and yielding, as ``plain.Cells`` has them [-]."""
SHARE = np.uint64(109) * ROW
"""1 row: change of the mean stress that a cell's particles share [Pa]."""
WORK = np.uint64(110) * ROW + ROW

_FIELD = [np.uint64(field) * LANES for field in range(packing.FIELDS)]
X, Y, Z, SXX, SYY, SZZ, SXY, SXZ, SYZ, STRAIN, VOLUME = _FIELD
FIELDS = np.uint64(packing.FIELDS) * LANES

_F = np.float32
ZERO, HALF, UNIT, DOUBLE, TRIPLE = (_F(n) for n in (0.0, 0.5, 1.0, 2.0, 3.0))
THIRD, TWO_THIRDS = _F(1.0 / 3.0), _F(2.0 / 3.0)
SIDE, CENTRE = _F(0.125), _F(0.75)
"""Spline weights in the middle of a cell."""
ROOT = _F(0.5 * math.sqrt(3.0))
LODE, SIZE = _F(1.5 * math.sqrt(3.0)), _F(2.0 / math.sqrt(3.0))
FOURFOLD, TINY = _F(4.0), _F(1e-18)
SHORT = _F(SHORT_OF_TIP)
SMALL = _F(1e-9)
"""Keeps a quotient of vanishing stresses from being no number [Pa]."""
C0, C1, C2, C3, C4, C5, C6 = (
    _F(c)
    for c in (
        0.500000163, 0.577333461, -0.110823049, 0.0515479343, -0.0265382503, 0.0106230692,
        -0.00214345224,
    )
)  # fmt: skip
"""Chebyshev fit of cos(⅔ arccos s) on 0 ≤ s ≤ 1, with an error of 2·10⁻⁷."""


class Laws(NamedTuple):
    """Constants of a phase as the lanes take them, all in single precision."""

    lame_lambda: Any
    """λ [Pa]."""
    shear: Any
    """G [Pa]."""
    sin_dilation: Any
    """sin ψ at the peak [-]."""
    sin_critical: Any
    """sin φ in the critical state [-]."""
    sin_excess: Any
    """sin φ at the peak beyond that [-]."""
    per_softening: Any
    """1 over the plastic shear strain to the critical state [-]."""
    strength: Any
    """2 c cos φ [Pa]."""
    cutoff: Any
    """Mean stress beyond which a trial state goes to the tip [Pa]."""
    tip: Any
    """Mean stress at the tip [Pa]."""
    drop: Any
    """2 K, or 0 if the mean stress is held [Pa]."""
    per_slip: Any
    """1 / (2 G) [1/Pa]."""
    apex: Any
    """Mean stress at the tip had it not been cut off [Pa]."""
    nakai: Any
    """1 for Matsuoka and Nakai's surface, else 0."""
    cone: Any
    """1 for Drucker and Prager's surface, else 0."""
    cone_slope: Any
    """3 α [-]."""
    cone_multiplier: Any
    """1 / (G + 9 K α β) [1/Pa]."""
    cone_swelling: Any
    """3 β [-]."""
    intercept: Any
    """k of the cone [Pa]."""
    averaging: Any
    """1 if the volumetric strain is the mean of the cell's particles, else 0."""


def laws_of(material: Material, *, averaging: bool) -> Laws:
    """Constants of a material."""
    shear, bulk = material.shear_modulus, bulk_modulus(material)
    values = (
        material.lame_lambda,
        shear,
        material.sin_dilation,
        material.sin_critical,
        material.sin_friction - material.sin_critical,
        material.per_softening,
        material.strength,
        material.cutoff,
        material.tip,
        2.0 * bulk,
        0.5 / shear,
        material.apex,
        float(material.nakai),
        float(material.cone),
        3.0 * material.alpha,
        1.0 / (shear + 9.0 * bulk * material.alpha * material.beta),
        3.0 * material.beta,
        material.intercept,
        float(averaging),
    )
    return Laws(*(np.float32(value) for value in values))


@kernel
def gather_across(work: Work, component: Index, wide: Index) -> None:
    """Sums over y and z of a velocity component, at every x that a block reaches."""
    wide_vectors()
    v, to = VELOCITY + component * NINE * ROW, ACROSS + component * SIX * ROW
    for i in range(wide):
        a, b, c = work[v + i], work[v + ROW + i], work[v + TWO * ROW + i]
        w0, d0, h0 = SIDE * (a + c) + CENTRE * b, HALF * (c - a), a + c - DOUBLE * b
        a, b, c = work[v + THREE * ROW + i], work[v + FOUR * ROW + i], work[v + FIVE * ROW + i]
        w1, d1, h1 = SIDE * (a + c) + CENTRE * b, HALF * (c - a), a + c - DOUBLE * b
        a, b, c = work[v + SIX * ROW + i], work[v + SEVEN * ROW + i], work[v + EIGHT * ROW + i]
        w2, d2, h2 = SIDE * (a + c) + CENTRE * b, HALF * (c - a), a + c - DOUBLE * b
        work[to + i] = SIDE * (w0 + w2) + CENTRE * w1
        work[to + ROW + i] = SIDE * (d0 + d2) + CENTRE * d1
        work[to + TWO * ROW + i] = HALF * (w2 - w0)
        work[to + THREE * ROW + i] = SIDE * (h0 + h2) + CENTRE * h1
        work[to + FOUR * ROW + i] = w0 + w2 - DOUBLE * w1
        work[to + FIVE * ROW + i] = HALF * (d2 - d0)


@kernel
def gather_along(work: Work, component: Index, scale: Any, lanes: Index) -> None:
    """Moments of a velocity component in every cell, times ``scale`` = Δt/Δx."""
    wide_vectors()
    v, to = ACROSS + component * SIX * ROW, MOMENT + component * NINE * ROW
    for i in range(lanes):
        a, b, c = work[v + i], work[v + i + ONE], work[v + i + TWO]
        work[to + i] = scale * HALF * (c - a)
        work[to + THREE * ROW + i] = scale * (a + c - DOUBLE * b)
        a, b, c = work[v + ROW + i], work[v + ROW + i + ONE], work[v + ROW + i + TWO]
        work[to + ROW + i] = scale * (SIDE * (a + c) + CENTRE * b)
        work[to + SIX * ROW + i] = scale * HALF * (c - a)
        a, b, c = (
            work[v + TWO * ROW + i],
            work[v + TWO * ROW + i + ONE],
            work[v + TWO * ROW + i + TWO],
        )
        work[to + TWO * ROW + i] = scale * (SIDE * (a + c) + CENTRE * b)
        work[to + SEVEN * ROW + i] = scale * HALF * (c - a)
    for i in range(lanes):
        r, m = v + THREE * ROW + i, to + FOUR * ROW + i
        work[m] = scale * (SIDE * (work[r] + work[r + TWO]) + CENTRE * work[r + ONE])
        r, m = v + FOUR * ROW + i, to + FIVE * ROW + i
        work[m] = scale * (SIDE * (work[r] + work[r + TWO]) + CENTRE * work[r + ONE])
        r, m = v + FIVE * ROW + i, to + EIGHT * ROW + i
        work[m] = scale * (SIDE * (work[r] + work[r + TWO]) + CENTRE * work[r + ONE])


@kernel
def rate_of_cells(work: Work, lanes: Index) -> None:
    """Volumetric strain at the mean offset of each cell's particles, which is their mean."""
    wide_vectors()
    x = MOMENT
    y, z = x + NINE * ROW, x + NINE * TWO * ROW
    for i in range(lanes):
        bent = work[x + THREE * ROW + i] + work[y + SIX * ROW + i] + work[z + SEVEN * ROW + i]
        rate = work[x + i] + work[y + ROW + i] + work[z + TWO * ROW + i] + bent * work[MIDDLE + i]
        bent = work[x + SIX * ROW + i] + work[y + FOUR * ROW + i] + work[z + EIGHT * ROW + i]
        rate += bent * work[MIDDLE + ROW + i]
        bent = work[x + SEVEN * ROW + i] + work[y + EIGHT * ROW + i] + work[z + FIVE * ROW + i]
        work[RATE + i] = rate + bent * work[MIDDLE + TWO * ROW + i]


@kernel
def press_middle(work: Work, laws: Laws, lanes: Index) -> None:
    """Let the mean stress act at the mean offset, the transpose of :func:`rate_of_cells`."""
    wide_vectors()
    for i in range(lanes):
        total = work[SUM + i] + work[SUM + ROW + i] + work[SUM + TWO * ROW + i]
        mean = laws.averaging * THIRD * total
        x, y, z = work[MIDDLE + i], work[MIDDLE + ROW + i], work[MIDDLE + TWO * ROW + i]
        to = SUM + SIX * ROW + i
        add_moments(work, to, mean, x, y, z)
        add_moments(work, to + THREE * ROW, mean, x, y, z)
        add_moments(work, to + SIX * ROW, mean, x, y, z)


@kernel
def strain_of(work: Work, at: Index, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """Gradient of a velocity component at an offset [cell], times the time step [-].

    ``at`` is where its first moment stands in ``work``.
    """
    xy, xz, yz = work[at + SIX * ROW], work[at + SEVEN * ROW], work[at + EIGHT * ROW]
    return (
        work[at] + work[at + THREE * ROW] * x + xy * y + xz * z,
        work[at + ROW] + xy * x + work[at + FOUR * ROW] * y + yz * z,
        work[at + TWO * ROW] + xz * x + yz * y + work[at + FIVE * ROW] * z,
    )


@kernel
def cosine_of_two_thirds(s: Any) -> Any:
    """cos(⅔ arccos s), 0 ≤ s ≤ 1."""
    return C0 + s * (C1 + s * (C2 + s * (C3 + s * (C4 + s * (C5 + s * C6)))))


@kernel
def softened(strain: Any, laws: Laws) -> tuple[Any, Any]:
    """Mobilised sin φ and sin ψ at a plastic shear strain [-]."""
    left = UNIT - laws.per_softening * strain
    left = left if left > ZERO else ZERO
    return laws.sin_critical + left * laws.sin_excess, left * laws.sin_dilation


@kernel
def coulomb_gaps(
    mean: Any, high: Any, low: Any, sin_phi: Any, sin_psi: Any, laws: Laws
) -> tuple[Any, Any, Any, Any]:
    """Return to the Mohr-Coulomb surface, as in ``plasticity``, without branches."""
    plus, minus = UNIT + sin_phi, UNIT - sin_phi
    gain, loss = UNIT + sin_psi, UNIT - sin_psi
    double = DOUBLE * laws.shear
    first = mean + THIRD * (DOUBLE * high + low)
    excess = plus * first - minus * (first - high - low) - laws.strength
    excess = excess if excess > ZERO else ZERO
    common = FOURFOLD * laws.lame_lambda * sin_phi * sin_psi
    face = common + double * (plus * gain + minus * loss)
    multiplier = excess / face
    high_face, low_face = high - double * gain * multiplier, low - double * loss * multiplier
    on_high, on_low = high_face < ZERO, low_face < ZERO
    second = plus * high if on_high else minus * low
    other = common + (double * minus * loss if on_high else double * plus * gain)
    both = (DOUBLE * excess - second) / (face + other)
    flow = both if (on_high or on_low) else multiplier
    swelling = DOUBLE * sin_psi * flow
    new = mean - HALF * laws.drop * swelling
    gap = TRIPLE * (laws.strength - DOUBLE * sin_phi * new)
    gap = gap / (TRIPLE - sin_phi if on_high else TRIPLE + sin_phi)
    new_high = ZERO if on_high else (gap if on_low else high_face)
    new_low = gap if on_high else (ZERO if on_low else low_face)
    beyond = new > laws.tip or mean > laws.cutoff
    new = laws.tip if beyond else new
    new_high, new_low = ZERO if beyond else new_high, ZERO if beyond else new_low
    return new, new_high, new_low, ZERO if beyond else swelling


@kernel
def nakai_shrink(
    mean: Any, radius: Any, cosine: Any, span: Any, sin_phi: Any, sin_psi: Any, laws: Laws
) -> tuple[Any, Any, Any]:
    """Return to Matsuoka and Nakai's surface, as in ``plasticity``.

    The new mean stress [Pa], what is left of √J₂, and the plastic change of volume [-].
    """
    cosine = HALF * sin_phi * (TRIPLE - sin_phi * sin_phi) * cosine
    third: Any = math.sqrt(HALF * (UNIT + cosine))
    slope = ROOT * sin_phi / cosine_of_two_thirds(third)
    excess = radius - slope * (laws.apex - mean)
    excess = excess if excess > ZERO else ZERO
    shear = DOUBLE * laws.shear / span
    bulk = HALF * laws.drop
    slip = excess / (shear * radius + slope * bulk * sin_psi)
    swelling, left = sin_psi * slip, UNIT - shear * slip
    new = mean - bulk * swelling
    apart = new > laws.tip or mean > laws.cutoff
    beyond = left < ZERO or apart
    new, left = laws.tip if beyond else new, ZERO if beyond else left
    return new, left, ZERO if apart else swelling


@kernel
def cone_shrink(mean: Any, radius: Any, laws: Laws) -> tuple[Any, Any, Any]:
    """Return to the Drucker-Prager cone, as :func:`nakai_shrink`."""
    excess = radius + laws.cone_slope * mean - laws.intercept
    excess = excess if excess > ZERO else ZERO
    multiplier = laws.cone_multiplier * excess
    new_radius = radius - laws.shear * multiplier
    swelling = laws.cone_swelling * multiplier
    new = mean - HALF * laws.drop * swelling
    apart = new > laws.tip or mean > laws.cutoff
    beyond = new_radius < ZERO or apart
    new, left = laws.tip if beyond else new, ZERO if beyond else new_radius / radius
    return new, left, ZERO if apart else swelling


@kernel
def return_stress(trial: Six, strain: Any, laws: Laws) -> tuple[Six, Any, Any]:
    """Bring a trial stress [Pa] back to the yield surface.

    And the increment of κ and the plastic change of volume [-], all as
    :func:`terraphi.forward.mpm.plasticity.return_mapping`.
    """
    xx, yy, zz, xy, xz, yz = trial
    mean = THIRD * (xx + yy + zz)
    xx, yy, zz = xx - mean, yy - mean, zz - mean
    second = HALF * (xx * xx + yy * yy + zz * zz) + (xy * xy + xz * xz + yz * yz) + TINY
    third = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    radius = math.sqrt(second)
    cosine = LODE * third / (second * radius)
    cosine = cosine if cosine < UNIT else UNIT
    cosine = cosine if cosine > -UNIT else -UNIT
    # With cos 3θ known, half-angle formulas give cos θ and cos(60° - θ) through one polynomial.
    up: Any = math.sqrt(HALF * (UNIT + cosine))
    down: Any = math.sqrt(HALF * (UNIT - cosine))
    up, down = cosine_of_two_thirds(up), cosine_of_two_thirds(down)
    size = SIZE * radius
    last = -size * down
    high, low = size * (DOUBLE * up - down), size * (DOUBLE * down - up)
    high, low = high if high > SMALL else SMALL, low if low > SMALL else SMALL
    sin_phi, sin_psi = softened(strain, laws)
    new, new_high, new_low, swelling = coulomb_gaps(mean, high, low, sin_phi, sin_psi, laws)
    cone_mean, cone, cone_swelling = cone_shrink(mean, radius, laws)
    nakai_mean, nakai, nakai_swelling = nakai_shrink(
        mean, radius, cosine, high + low, sin_phi, sin_psi, laws
    )
    is_cone, radial = laws.cone > HALF, laws.cone + laws.nakai > HALF
    shrink = cone if is_cone else nakai
    new = (cone_mean if is_cone else nakai_mean) if radial else new
    swelling = (cone_swelling if is_cone else nakai_swelling) if radial else swelling
    slope_high = shrink if radial else new_high / high
    slope_low = shrink if radial else new_low / low
    bend = (slope_high - slope_low) / (high + low)
    slope = slope_high + bend * last
    even = new - bend * TWO_THIRDS * second
    xy_xy, xz_xz, yz_yz = xy * xy, xz * xz, yz * yz
    made = (
        even + slope * xx + bend * (xx * xx + xy_xy + xz_xz),
        even + slope * yy + bend * (xy_xy + yy * yy + yz_yz),
        even + slope * zz + bend * (xz_xz + yz_yz + zz * zz),
        slope * xy + bend * (xx * xy + xy * yy + xz * yz),
        slope * xz + bend * (xx * xz + xy * yz + xz * zz),
        slope * yz + bend * (xy * xz + yy * yz + yz * zz),
    )
    slip = laws.per_slip * (high * (UNIT - slope_high) + low * (UNIT - slope_low))
    return made, slip if slip > ZERO else ZERO, swelling


@kernel
def predicted(state: Work, work: Work, at: Index, i: Index, laws: Laws) -> Six:
    """Trial stress of a particle [Pa], as ``plasticity.jaumann_predictor``."""
    x, y, z = state[at + X], state[at + Y], state[at + Z]
    m = MOMENT + i
    dxx, axy, axz = strain_of(work, m, x, y, z)
    ayx, dyy, ayz = strain_of(work, m + NINE * ROW, x, y, z)
    azx, azy, dzz = strain_of(work, m + NINE * TWO * ROW, x, y, z)
    trace = dxx + dyy + dzz
    volumetric = laws.averaging * work[RATE + i] + (UNIT - laws.averaging) * trace
    xx, yy, zz = state[at + SXX], state[at + SYY], state[at + SZZ]
    xy, xz, yz = state[at + SXY], state[at + SXZ], state[at + SYZ]
    wxy, wxz, wyz = HALF * (axy - ayx), HALF * (axz - azx), HALF * (ayz - azy)
    double = DOUBLE * laws.shear
    even = laws.lame_lambda * volumetric + double * THIRD * (volumetric - trace)
    return (
        xx + even + double * dxx + DOUBLE * (wxy * xy + wxz * xz),
        yy + even + double * dyy + DOUBLE * (wyz * yz - wxy * xy),
        zz + even + double * dzz - DOUBLE * (wxz * xz + wyz * yz),
        xy + laws.shear * (axy + ayx) + wxy * (yy - xx) + wxz * yz + wyz * xz,
        xz + laws.shear * (axz + azx) + wxz * (zz - xx) + wxy * yz - wyz * xy,
        yz + laws.shear * (ayz + azy) + wyz * (zz - yy) - wxy * xz - wxz * xy,
    )


@kernel
def settle(state: Work, work: Work, at: Index, i: Index, trial: Six, laws: Laws) -> None:
    """Return a trial stress [Pa] of a particle, keep it, and add it to the sums of its cell."""
    made, slip, _ = return_stress(trial, state[at + STRAIN], laws)
    xx, yy, zz, xy, xz, yz = made
    state[at + SXX], state[at + SYY], state[at + SZZ] = xx, yy, zz
    state[at + SXY], state[at + SXZ], state[at + SYZ] = xy, xz, yz
    state[at + STRAIN] += slip
    full, to = state[at + VOLUME], SUM + i
    xx, yy, zz, xy, xz, yz = full * xx, full * yy, full * zz, full * xy, full * xz, full * yz
    work[to] += xx
    work[to + ROW] += yy
    work[to + TWO * ROW] += zz
    work[to + THREE * ROW] += xy
    work[to + FOUR * ROW] += xz
    work[to + FIVE * ROW] += yz
    # Where the volumetric strain is one for a cell, so is the mean stress: see press_middle.
    mean = laws.averaging * THIRD * (xx + yy + zz)
    x, y, z = state[at + X], state[at + Y], state[at + Z]
    add_moments(work, to + SIX * ROW, xx - mean, x, y, z)
    add_moments(work, to + NINE * ROW, yy - mean, x, y, z)
    add_moments(work, to + (SIX + SIX) * ROW, zz - mean, x, y, z)
    add_moments(work, to + (NINE + SIX) * ROW, xy, x, y, z)
    add_moments(work, to + (NINE + NINE) * ROW, xz, x, y, z)
    add_moments(work, to + (NINE + NINE + THREE) * ROW, yz, x, y, z)


@kernel
def strain_packet(state: Work, work: Work, packet: Index, lanes: Index, laws: Laws) -> None:
    """Update the stress of a packet, and add it to the sums of the cells."""
    wide_vectors()
    for i in range(lanes):
        at = packet * FIELDS + i
        settle(state, work, at, i, predicted(state, work, at, i, laws), laws)


@kernel
def predict_packet(state: Work, work: Work, packet: Index, lanes: Index, laws: Laws) -> None:
    """Put the trial stress of a packet in the place of its stress."""
    wide_vectors()
    for i in range(lanes):
        at = packet * FIELDS + i
        xx, yy, zz, xy, xz, yz = predicted(state, work, at, i, laws)
        state[at + SXX], state[at + SYY], state[at + SZZ] = xx, yy, zz
        state[at + SXY], state[at + SXZ], state[at + SYZ] = xy, xz, yz


@kernel
def shared(state: Work, work: Work, at: Index, i: Index) -> Six:
    """Trial stress of a particle [Pa] with its cell's share."""
    more = work[SHARE + i]
    return (
        state[at + SXX] + more, state[at + SYY] + more, state[at + SZZ] + more,
        state[at + SXY], state[at + SXZ], state[at + SYZ],
    )  # fmt: skip


@kernel
def swell_packet(
    state: Work, work: Work, packet: Index, lanes: Index, laws: Laws, held: Laws
) -> None:
    """Add the plastic changes of volume of a packet to the sums of its cells, as ``plain``."""
    wide_vectors()
    for i in range(lanes):
        at = packet * FIELDS + i
        trial, strain, full = shared(state, work, at, i), state[at + STRAIN], state[at + VOLUME]
        _, _, alone = return_stress(trial, strain, laws)
        size = abs(trial[0]) + abs(trial[1]) + abs(trial[2])
        over = THIRD * (trial[0] + trial[1] + trial[2]) - laws.tip + SHORT * size
        over = over if over > ZERO else ZERO
        clamped = (trial[0] - over, trial[1] - over, trial[2] - over, trial[3], trial[4], trial[5])
        _, _, most = return_stress(clamped, strain, held)
        both = alone * most > ZERO
        work[SWELL + i] += full
        work[SWELL + ROW + i] += full * most
        work[SWELL + TWO * ROW + i] += full * (most / (alone if both else UNIT) if both else UNIT)


@kernel
def share(work: Work, lanes: Index, laws: Laws) -> None:
    """Take a Newton step towards the change of mean stress that a cell's particles share."""
    wide_vectors()
    for i in range(lanes):
        number, swelling, slope = (
            work[SWELL + i],
            work[SWELL + ROW + i],
            work[SWELL + TWO * ROW + i],
        )
        slope = slope if number > ZERO else UNIT
        work[SHARE + i] -= (number * work[SHARE + i] + HALF * laws.drop * swelling) / slope


@kernel
def return_packet(state: Work, work: Work, packet: Index, lanes: Index, held: Laws) -> None:
    """Return the trial stress of a packet at the mean stress that it has with its cell's share."""
    wide_vectors()
    for i in range(lanes):
        at = packet * FIELDS + i
        settle(state, work, at, i, shared(state, work, at, i), held)


@kernel
def add_moments(work: Work, to: Index, stress: Any, x: Any, y: Any, z: Any) -> None:
    """Add a stress times the offset to three rows."""
    work[to] += stress * x
    work[to + ROW] += stress * y
    work[to + TWO * ROW] += stress * z


@kernel
def give_along(work: Work, x: Index, y: Index, z: Index, scale: Any, wide: Index) -> None:
    """Forces that a row of cells gives along x, still to be spread over y and z.

    The transpose of :func:`gather_along`.

    Parameters
    ----------
    work
        Holds the sums; the six rows of ``BACK`` are filled.
    x, y, z
        Which of the six stresses act on the faces across x, y and z.
    scale
        Minus volume over Δx [m²].
    wide
        Nodes along x that a block reaches.
    """
    wide_vectors()
    s = SUM - TWO  # node i of the window is the last of cell i - 2, the first of cell i
    xs, ys, zs = s + x * ROW, s + y * ROW, s + z * ROW
    xm = s + (SIX + THREE * x) * ROW
    ym = s + (SIX + THREE * y) * ROW
    zm = s + (SIX + THREE * z) * ROW
    for i in range(wide):
        a, c = work[xs + i], work[xs + i + TWO]
        ha, hb, hc = work[xm + i], work[xm + i + ONE], work[xm + i + TWO]
        work[BACK + i] = scale * (HALF * (a - c) + ha + hc - DOUBLE * hb)
        value = SIDE * (work[ys + i] + work[ys + i + TWO]) + CENTRE * work[ys + i + ONE]
        bent = work[xm + ROW + i] + work[ym + i] - work[xm + ROW + i + TWO] - work[ym + i + TWO]
        work[BACK + ROW + i] = scale * (value + HALF * bent)
        value = SIDE * (work[zs + i] + work[zs + i + TWO]) + CENTRE * work[zs + i + ONE]
        r = xm + TWO * ROW + i
        bent = work[r] + work[zm + i] - work[r + TWO] - work[zm + i + TWO]
        work[BACK + TWO * ROW + i] = scale * (value + HALF * bent)
    for i in range(wide):
        r = ym + ROW + i
        value = SIDE * (work[r] + work[r + TWO]) + CENTRE * work[r + ONE]
        work[BACK + THREE * ROW + i] = scale * value
        r = zm + TWO * ROW + i
        value = SIDE * (work[r] + work[r + TWO]) + CENTRE * work[r + ONE]
        work[BACK + FOUR * ROW + i] = scale * value
        p, r = ym + TWO * ROW + i, zm + ROW + i
        side = work[p] + work[r] + work[p + TWO] + work[r + TWO]
        value = SIDE * side + CENTRE * (work[p + ONE] + work[r + ONE])
        work[BACK + FIVE * ROW + i] = scale * value


@kernel
def give_across(
    work: Work, force: Work, at: Index, y: tuple[Any, Any, Any], z: tuple[Any, Any, Any],
    wide: Index,
) -> None:  # fmt: skip
    """Add forces to one row of nodes, given its splines' (W, D, H) over y and z."""
    wide_vectors()
    ww, dw, wd = y[0] * z[0], y[1] * z[0], y[0] * z[1]
    hw, wh, dd = y[2] * z[0], y[0] * z[2], y[1] * z[1]
    for i in range(wide):
        first = ww * work[BACK + i] + dw * work[BACK + ROW + i]
        second = wd * work[BACK + TWO * ROW + i] + hw * work[BACK + THREE * ROW + i]
        third = wh * work[BACK + FOUR * ROW + i] + dd * work[BACK + FIVE * ROW + i]
        force[at + i] += first + second + third
