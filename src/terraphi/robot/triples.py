"""Vectors and matrices in space as tuples of their components, each an array over samples and feet.

A component that is 0, or 1, for all feet is that plain number, and sums and products leave it out.
So the equations of a leg whose joints turn about any axes, written once, cost for the usual leg,
whose frames are parallel to the axes, what formulas worked out for it by hand would cost.
"""

from __future__ import annotations

import numpy as np

from terraphi.experiment.arrays import FloatArray

Part = FloatArray | float
Triple = tuple[Part, Part, Part]
Matrix = tuple[Triple, Triple, Triple]
"""Three rows."""

ZERO: Triple = (0.0, 0.0, 0.0)


def part_of(values: FloatArray) -> Part:
    """A component from its values for each foot, shape [foot]."""
    first = float(values[0])
    return first if first in (0.0, 1.0) and np.all(values == first) else values


def triple_of(vectors: FloatArray) -> Triple:
    """A vector from its values for each foot, shape [foot, 3]."""
    x, y, z = (part_of(column) for column in vectors.T)
    return x, y, z


def matrix_of(matrices: FloatArray) -> Matrix:
    """A matrix from its values for each foot, shape [foot, 3, 3]."""
    x, y, z = (triple_of(matrices[:, i]) for i in range(3))
    return x, y, z


def stacked(u: Triple, shape: tuple[int, ...]) -> FloatArray:
    """A vector as one array, shape [..., 3], of components that broadcast to a shape."""
    return np.stack([np.broadcast_to(part, shape) for part in u], axis=-1)


def plus(a: Part, b: Part) -> Part:
    """Sum of two components."""
    if isinstance(a, float) and a == 0.0:
        return b
    return a if isinstance(b, float) and b == 0.0 else a + b


def times(a: Part, b: Part) -> Part:
    """Product of two components."""
    for one, other in ((a, b), (b, a)):
        if isinstance(one, float) and one in (0.0, 1.0):
            return other if one else 0.0
    return a * b


def added(u: Triple, v: Triple) -> Triple:
    """Sum u + v."""
    return plus(u[0], v[0]), plus(u[1], v[1]), plus(u[2], v[2])


def scaled(u: Triple, by: Part) -> Triple:
    """Product of a vector and a number."""
    return times(u[0], by), times(u[1], by), times(u[2], by)


def dot(u: Triple, v: Triple) -> Part:
    """Scalar product u · v."""
    return plus(plus(times(u[0], v[0]), times(u[1], v[1])), times(u[2], v[2]))


def cross(u: Triple, v: Triple) -> Triple:
    """Vector product u × v."""
    x, y, z = (plus(times(u[i], v[j]), -times(u[j], v[i])) for i, j in ((1, 2), (2, 0), (0, 1)))
    return x, y, z


def turned(m: Matrix, v: Triple) -> Triple:
    """Product M v."""
    return dot(m[0], v), dot(m[1], v), dot(m[2], v)


def transposed(m: Matrix) -> Matrix:
    """Mᵀ."""
    x, y, z = zip(*m, strict=True)
    return x, y, z


def product(m: Matrix, n: Matrix) -> Matrix:
    """M N."""
    x, y, z = transposed(n)
    return transposed((turned(m, x), turned(m, y), turned(m, z)))


def outer(u: Triple, v: Triple) -> Matrix:
    """Product u vᵀ."""
    return scaled(v, u[0]), scaled(v, u[1]), scaled(v, u[2])


def summed(m: Matrix, n: Matrix) -> Matrix:
    """Sum M + N."""
    return added(m[0], n[0]), added(m[1], n[1]), added(m[2], n[2])
