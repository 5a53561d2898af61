"""A library made ready for calibrated inversions: one leg's joint surrogate on nodes over phi.

Whatever does not depend on the forces that are inverted is computed here, once: the curves and
their covariance at the nodes, and their decomposition together with a noise covariance. All is in
the library's own force unit; an inversion divides by the ratio of densities instead.
"""

from __future__ import annotations

import functools
import weakref
from collections import OrderedDict
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from terraphi.joint_surrogate import JointKernel, JointSurrogate
from terraphi.library import Curves, Library
from terraphi.scatter import Scatter, estimate

FloatArray = NDArray[np.float64]

NODES = (71, 281)
"""Nodes over phi, between which chi-square and log-determinant are splines; the larger number where
the forces fix phi to a small fraction of the distance of the fewer nodes."""
FRACTION = 0.04
REMEMBERED = 8
"""Prepared legs that are kept, and decompositions of each."""


class Spectrum(NamedTuple):
    """Covariance and noise at the nodes in a common basis, where both are diagonal.

    With C the covariance at one size of the scatter and W the shape of the noise, ``rotation`` Q
    makes Q C Q^T diagonal and Q W Q^T the identity: C + s^2 W has ``roots`` + s^2 there.
    """

    rotation: FloatArray
    """Q, shape [node, 2 theta, 2 theta]."""
    roots: FloatArray
    """Shape [node, 2 theta]."""
    mean: FloatArray
    """Q times the forces at the nodes, same shape."""
    log_determinant: float
    """Of W."""


@dataclass(frozen=True, eq=False)
class PreparedLeg:
    """One leg of a library, at nodes over the friction angle.

    Attributes
    ----------
    surrogate
        Its joint surrogate.
    curves
        The observation vectors of its cases.
    phi_deg
        Nodes [deg], shape [node].
    mean
        Forces there [N], shape [node, 2 theta].
    covariance, scatter
        Of the surrogate, and of the particle scatter [N^2], shape [node, 2 theta, 2 theta].
    """

    surrogate: JointSurrogate
    curves: Curves
    phi_deg: FloatArray = field(repr=False)
    mean: FloatArray = field(repr=False)
    covariance: FloatArray = field(repr=False)
    scatter: FloatArray = field(repr=False)
    _spectra: OrderedDict[bytes, list[Spectrum]] = field(default_factory=OrderedDict, repr=False)

    @classmethod
    def of(cls, surrogate: JointSurrogate, curves: Curves) -> PreparedLeg:
        """Evaluate a surrogate at the nodes."""
        phi = np.linspace(*surrogate.phi_bounds_deg, NODES[0])
        if _sharpest_deg(surrogate, phi) < FRACTION * (phi[1] - phi[0]):
            phi = np.linspace(*surrogate.phi_bounds_deg, NODES[1])
        variance = surrogate.standard_variance(phi)
        left = surrogate.scatter.sigma(phi)[:, :, None] * surrogate.basis
        right = left.transpose(0, 2, 1)
        covariance = (left * variance[:, None, :]) @ right
        return cls(surrogate, curves, phi, surrogate.predict(phi), covariance, left @ right)

    def spectra(self, shape: FloatArray) -> list[Spectrum]:
        """Covariance and noise in a common basis, for each size of the scatter.

        Parameters
        ----------
        shape
            W, the noise covariance of unit size [-], positive definite, [2 theta, 2 theta].
        """
        key = np.round(shape, 9).tobytes()
        if key not in self._spectra:
            with single_threaded():
                factor = np.linalg.cholesky(shape)
                inverse = np.linalg.inv(factor)
                log_determinant = 2.0 * float(np.log(np.diag(factor)).sum())
                found = []
                for size in self.surrogate.scatter.sizes[0]:
                    total = self.covariance + size * self.scatter
                    roots, basis = np.linalg.eigh(inverse @ total @ inverse.T)
                    rotation = basis.transpose(0, 2, 1) @ inverse
                    mean = (rotation @ self.mean[:, :, None])[:, :, 0]
                    found.append(Spectrum(rotation, roots, mean, log_determinant))
            self._spectra[key] = found
        _forget_oldest(self._spectra)
        return self._spectra[key]


def _sharpest_deg(surrogate: JointSurrogate, phi: FloatArray) -> float:
    """Least standard deviation of phi [deg] that forces without noise leave, anywhere."""
    slope = np.gradient(surrogate.predict(phi), phi, axis=0) / surrogate.scatter.sigma(phi)
    squares = np.square(slope @ surrogate.whitener.T) / (surrogate.standard_variance(phi) + 1.0)
    return float(1.0 / np.sqrt(squares.sum(axis=1).max()))


def single_threaded() -> AbstractContextManager[Any]:
    """Context in which BLAS uses one thread: more cost small matrices far more than they gain."""
    limit: AbstractContextManager[Any] = _threads().limit(limits=1, user_api="blas")
    return limit


@functools.cache
def _threads() -> ThreadpoolController:
    """Threads of NumPy's BLAS and of SciPy's, which is another and must have been loaded."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()


_Key = tuple[int, str, tuple[float, float]]
_KNOWN: OrderedDict[_Key, tuple[weakref.ref[Library], PreparedLeg]] = OrderedDict()


def prepare(library: Library, leg: str, *, within: tuple[float, float]) -> PreparedLeg:
    """Make a leg of a library ready, or recall it.

    Parameters
    ----------
    library
        Simulations over the friction angle. Scatter and hyperparameters that it carries are used;
        otherwise they are estimated from its curves.
    leg, within
        As in :meth:`Library.curves`.

    Raises
    ------
    InputError
        As :meth:`Library.curves` does.
    """
    ends = (round(float(within[0]), 9), round(float(within[1]), 9))
    key = (id(library), leg, ends)
    known = _KNOWN.get(key)
    if known and known[0]() is library:
        return known[1]
    curves = library.curves(leg, within=within)
    prepared = PreparedLeg.of(surrogate_of(library, leg, curves), curves)
    _KNOWN[key] = (weakref.ref(library), prepared)
    _forget_oldest(_KNOWN)
    return prepared


def surrogate_of(library: Library, leg: str, curves: Curves) -> JointSurrogate:
    """Joint surrogate of one leg: as the library's calibration says, or fitted."""
    vectors = np.hstack([curves.Fx, curves.Fz])
    carried = library.calibration.get("legs", {}).get(leg)
    if carried is not None and library.calibration.get("library_hash") == library.hash:
        scatter, kernel = Scatter.from_dict(carried["scatter"]), None
        if np.allclose(scatter.theta_deg, curves.theta_deg, atol=1e-6):
            kernel = JointKernel.from_dict(carried["kernel"])
            return JointSurrogate.fit(
                curves.phi_deg, curves.theta_deg, vectors, scatter, kernel=kernel
            )
    return learn(curves)


def learn(curves: Curves, replicates: Sequence[tuple[float, FloatArray]] = ()) -> JointSurrogate:
    """Estimate scatter and hyperparameters from a library's curves, and replicates if there are.

    Parameters
    ----------
    curves
        Of one leg.
    replicates
        As in :func:`terraphi.scatter.estimate`.
    """
    vectors = np.hstack([curves.Fx, curves.Fz])
    with single_threaded():
        scatter = estimate(curves.theta_deg, curves.phi_deg, vectors, replicates)
        return JointSurrogate.fit(curves.phi_deg, curves.theta_deg, vectors, scatter)


def _forget_oldest(kept: OrderedDict[Any, Any]) -> None:
    while len(kept) > REMEMBERED:
        kept.popitem(last=False)
