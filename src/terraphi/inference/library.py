"""A library made ready for calibrated inversions: one leg's joint surrogate on nodes over phi.

Whatever does not depend on the forces that are inverted is computed here, once: the curves and
their covariance at the nodes, and their decomposition together with a noise covariance. All is in
the library's own force unit; an inversion divides by the ratio of densities instead.
"""

from __future__ import annotations

import functools
import logging
import weakref
from collections import OrderedDict
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from terraphi.errors import InputError
from terraphi.history import WINDOW_DEG
from terraphi.joint_surrogate import JointKernel, JointSurrogate
from terraphi.library import Curves, Library
from terraphi.readings import is_dense
from terraphi.scatter import Scatter, estimate

FloatArray = NDArray[np.float64]
log = logging.getLogger(__name__)

NODES = 281
"""Nodes over phi, between which chi-square and log-determinant are splines: intervals are right to
a few thousandths of their width; half the nodes leave some hundredths at worst."""
STEP_DEG = 0.05
"""Half the step of derivatives with respect to the friction angle [deg]."""
ENOUGH = 2
"""Readings in every window from which on a mean scatters as that over the whole window."""
REMEMBERED = 8
"""Prepared legs that are kept, and decompositions of each."""


class Spectrum(NamedTuple):
    """Covariance and noise at some nodes in a common basis, where both are diagonal.

    With C the covariance at one size of the scatter and W the shape of the noise, ``rotation`` Q
    makes Q C Q^T diagonal and Q W Q^T the identity: C + s^2 W has ``roots`` + s^2 there.
    """

    rotation: FloatArray
    """Q, shape [node, 2 theta, 2 theta]."""
    roots: FloatArray
    """Shape [node, 2 theta]."""
    mean: FloatArray
    """Q times the forces at the nodes, same shape."""


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
    _spectra: OrderedDict[bytes, Spectra] = field(default_factory=OrderedDict, repr=False)

    @classmethod
    def of(cls, surrogate: JointSurrogate, curves: Curves) -> PreparedLeg:
        """Evaluate a surrogate at the nodes."""
        phi = np.linspace(*surrogate.phi_bounds_deg, NODES)
        variance = surrogate.standard_variance(phi)
        left = surrogate.scatter.sigma(phi)[:, :, None] * surrogate.basis
        right = left.transpose(0, 2, 1)
        covariance = (left * variance[:, None, :]) @ right
        return cls(surrogate, curves, phi, surrogate.predict(phi), covariance, left @ right)

    def slope(self, phi_deg: float) -> FloatArray:
        """Derivative of the forces with respect to the friction angle [N/deg], shape [2 theta]."""
        around = np.clip(phi_deg + np.array([-STEP_DEG, STEP_DEG]), *self.surrogate.phi_bounds_deg)
        below, above = self.surrogate.predict(around)
        slope: FloatArray = (above - below) / (around[1] - around[0])
        return slope

    def spectra(self, shape: FloatArray) -> Spectra:
        """Covariance and noise in a common basis, for each size of the scatter.

        Parameters
        ----------
        shape
            W, the noise covariance of unit size [-], positive definite, [2 theta, 2 theta].
        """
        key = np.round(shape, 9).tobytes()
        if key not in self._spectra:
            self._spectra[key] = Spectra(self, shape)
        _forget_oldest(self._spectra)
        return self._spectra[key]


class Spectra:
    """Decompositions of one leg's covariances and a noise, each computed when it is asked for.

    Parameters
    ----------
    leg, shape
        As in :meth:`PreparedLeg.spectra`.

    Attributes
    ----------
    log_determinant
        Of W.
    """

    def __init__(self, leg: PreparedLeg, shape: FloatArray) -> None:
        self.leg = leg
        factor = np.linalg.cholesky(shape)
        self.log_determinant = 2.0 * float(np.log(np.diag(factor)).sum())
        self._inverse = np.linalg.inv(factor)
        self._sizes = leg.surrogate.scatter.sizes[0]
        count = (len(self._sizes), *leg.mean.shape)
        self._ready = np.zeros(count[:2], dtype=bool)
        self._rotation = np.empty((*count, count[2]))
        self._roots, self._mean = np.empty(count), np.empty(count)

    def at(self, size: int, nodes: NDArray[np.intp]) -> Spectrum:
        """Decompositions at one size of the scatter, by its index, and at evenly spaced nodes."""
        missing = nodes[~self._ready[size, nodes]]
        if missing.size:
            total = self.leg.covariance[missing] + self._sizes[size] * self.leg.scatter[missing]
            with single_threaded():
                roots, basis = np.linalg.eigh(self._inverse @ total @ self._inverse.T)
                rotation = basis.transpose(0, 2, 1) @ self._inverse
            self._rotation[size, missing], self._roots[size, missing] = rotation, roots
            mean = (rotation @ self.leg.mean[missing][:, :, None])[:, :, 0]
            self._mean[size, missing] = mean
            self._ready[size, missing] = True
        # A slice, not an index: these are megabytes that nobody should copy.
        step = int(nodes[1] - nodes[0]) if len(nodes) > 1 else 1
        part = slice(int(nodes[0]), int(nodes[-1]) + 1, step)
        arrays = (self._rotation, self._roots, self._mean)
        return Spectrum(*(array[size, part] for array in arrays))


def single_threaded() -> AbstractContextManager[Any]:
    """Context in which BLAS uses one thread: more cost small matrices far more than they gain."""
    limit: AbstractContextManager[Any] = _threads().limit(limits=1, user_api="blas")
    return limit


@functools.cache
def _threads() -> ThreadpoolController:
    """Threads of NumPy's BLAS and of SciPy's, which is another and must have been loaded."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()


_Key = tuple[int, str, bytes]
_KNOWN: OrderedDict[_Key, tuple[weakref.ref[Library], PreparedLeg]] = OrderedDict()


def prepare(library: Library, leg: str, *, readings: FloatArray | None = None) -> PreparedLeg:
    """Make a leg of a library ready, or recall it.

    Parameters
    ----------
    library
        Simulations over the friction angle. Scatter and hyperparameters that it carries are used;
        otherwise, and for records with fewer than two readings in a window, they are estimated
        from its curves.
    leg, readings
        As in :meth:`Library.curves`.

    Raises
    ------
    InputError
        As :meth:`Library.curves` does.
    """
    key = (id(library), leg, _sampling(readings))
    known = _KNOWN.get(key)
    if known and known[0]() is library:
        return known[1]
    curves = library.curves(leg, readings=readings)
    prepared = PreparedLeg.of(surrogate_of(library, leg, curves, readings=readings), curves)
    _KNOWN[key] = (weakref.ref(library), prepared)
    _forget_oldest(_KNOWN)
    return prepared


def _sampling(readings: FloatArray | None) -> bytes:
    """What tells how curves are seen; records that are read densely differ by their ends alone."""
    if readings is None:
        return b""
    return np.round(readings[[0, -1]] if is_dense(readings) else readings, 9).tobytes()


def surrogate_of(
    library: Library, leg: str, curves: Curves, *, readings: FloatArray | None = None
) -> JointSurrogate:
    """Joint surrogate of one leg: as the library's calibration says, or fitted."""
    carried = library.calibration.get("legs", {}).get(leg)
    again = library.repeated(leg, readings=readings)
    if carried is not None and library.calibration.get("library_hash") == library.hash:
        try:
            scatter = Scatter.from_dict(carried["scatter"])
            kernel = JointKernel.from_dict(carried["kernel"])
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise InputError(
                f"library '{library.name}' carries a calibration of another version of terraphi; "
                "calibrate it again (terraphi library calibrate)"
            ) from error
        # Its scatter is that of means over many readings, and few leave more of it.
        sparse = readings is not None and _fewest(readings, curves.theta_deg) < ENOUGH
        if not sparse and np.allclose(scatter.theta_deg, curves.theta_deg, atol=1e-6):
            means, repeats = _means(curves, again)
            log.info("library %s, leg %s: surrogate as its calibration has it", library.name, leg)
            return JointSurrogate.fit(
                curves.phi_deg, curves.theta_deg, means, scatter, kernel=kernel, repeats=repeats
            )
    log.info("library %s, leg %s: fitting a surrogate, as none fits", library.name, leg)
    return learn(curves, again)


def _fewest(readings: FloatArray, theta_deg: FloatArray) -> int:
    """Fewest readings that the mean of a window is taken over."""
    half = WINDOW_DEG / (theta_deg.size - 1)
    found = np.searchsorted(np.degrees(readings), [theta_deg - half, theta_deg + half])
    return int(np.diff(found, axis=0).min())


def learn(curves: Curves, replicates: Sequence[tuple[float, FloatArray]] = ()) -> JointSurrogate:
    """Estimate scatter and hyperparameters from a library's curves, and replicates if there are.

    Parameters
    ----------
    curves
        Of one leg.
    replicates
        As from :meth:`Library.repeated`. Forces at their angles are known the better for them.
    """
    vectors = np.hstack([curves.Fx, curves.Fz])
    means, repeats = _means(curves, replicates)
    with single_threaded():
        scatter = estimate(curves.theta_deg, curves.phi_deg, vectors, replicates)
        return JointSurrogate.fit(curves.phi_deg, curves.theta_deg, means, scatter, repeats=repeats)


def _means(
    curves: Curves, replicates: Sequence[tuple[float, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """Mean of all simulations of each case [N], shape [case, 2 theta], and how many they are."""
    means, repeats = np.hstack([curves.Fx, curves.Fz]), np.ones(len(curves.phi_deg))
    for phi, vectors in replicates:
        (case,) = np.flatnonzero(curves.phi_deg == phi)
        means[case], repeats[case] = vectors.mean(axis=0), len(vectors)
    return means, repeats


def _forget_oldest(kept: OrderedDict[Any, Any]) -> None:
    while len(kept) > REMEMBERED:
        kept.popitem(last=False)
