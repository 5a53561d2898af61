"""A library made ready for calibrated inversions: one leg's joint surrogate on nodes over phi.

Whatever does not depend on the forces that are inverted is computed here, once: the curves and
their covariance at the nodes, and their decomposition together with a noise covariance. All is in
the library's own force unit; an inversion divides by the ratio of densities instead.

**What readings leave open.** Nodes of the grid enter and leave the leg's contact one by one, so
that simulated forces ripple by a few per cent with a period near a degree. A record that is read
every degree or so may show the ripple's crests alone, or its troughs; and one that is read every
few degrees knows nothing of the path between. How far a sensor averages is not known, nor where
crests would be on another grid. So a library is compared through means about the readings
(:meth:`ForceHistory.as_read_at`), and the errors of that have a covariance, learnt from the
library's own curves:

- of points beside means about them, with the readings moved along by fractions of their spacing;
- of means about the readings beside means of the whole path. What all curves share of it is in
  the library's curves too, since they are read alike; what one has beside its neighbours over φ is
  not.

**Finer simulations.** Forces of a library that is refined (`finer`) are corrected by these
(`fidelity`), and the correction's error is part of the covariance.

A few dozen curves that share one grid show fewer patterns than there are, and what they do not show
would count as known. So variance is added at each window by itself: as much as makes the errors of
φ of curves that were left out, read like the record, as large as the rest of the curves say.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.library.finer import CAUSES, fine_curves
from terraphi.library.store import Case, Curves, Library
from terraphi.surrogate.fidelity import Correction, FidelityKernel, Refinement, priors_of
from terraphi.surrogate.joint import JointKernel, JointSurrogate, window_spans
from terraphi.surrogate.kronecker import single_threaded
from terraphi.surrogate.scatter import Scatter, estimate

log = logging.getLogger(__name__)

STRIDE = 8
"""Nodes over phi from one to the next at which the covariance of a correction, which is smooth, is
computed."""
NODES = 281
"""Nodes over phi, between which chi-square and log-determinant are splines: intervals are right to
a few thousandths of their width; half the nodes leave some hundredths at worst."""
REMEMBERED = 8
"""Prepared legs that are kept, each some 30 MB."""
DECOMPOSED = 3
"""Decompositions that are kept, each some 100 MB: records with other readings need other ones."""


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
        Of what the surrogate and the readings leave open, and of the particle scatter [N^2], shape
        [node, 2 theta, 2 theta].
    reading
        What readings at points leave open.
    opened
        The same of one record, by :meth:`read_for` [N^2], shape [2 theta, 2 theta].
    trials
        Records that the data are the mean of: their particle scatter is that of a mean.
    """

    surrogate: JointSurrogate
    curves: Curves
    phi_deg: FloatArray = field(repr=False)
    mean: FloatArray = field(repr=False)
    covariance: FloatArray = field(repr=False)
    scatter: FloatArray = field(repr=False)
    reading: Reading = field(repr=False)
    opened: FloatArray = field(repr=False)
    trials: int = 1

    @classmethod
    def of(
        cls, surrogate: JointSurrogate, curves: Curves, reading: Reading | None = None
    ) -> PreparedLeg:
        """Evaluate a surrogate at the nodes; ``None``: readings leave nothing open."""
        phi = np.linspace(*surrogate.phi_bounds_deg, NODES)
        variance = surrogate.standard_variance(phi)
        left = surrogate.scatter.sigma(phi)[:, :, None] * surrogate.basis
        right = left.transpose(0, 2, 1)
        covariance, mean = (left * variance[:, None, :]) @ right, surrogate.predict(phi)
        if surrogate.correction is not None:
            some = phi[::STRIDE]
            forces = surrogate.as_simulated.predict(some)
            known = surrogate.correction.covariance(some, forces)
            below, part = np.divmod(np.arange(NODES), STRIDE)
            above, share = np.minimum(below + 1, len(some) - 1), part[:, None, None] / STRIDE
            covariance += (1.0 - share) * known[below] + share * known[above]
        none = np.zeros(covariance.shape[1:])
        of_readings = reading or Reading()
        return cls(surrogate, curves, phi, mean, covariance, left @ right, of_readings, none)

    def read_for(self, data: FloatArray) -> PreparedLeg:
        """The same for one record, with what its readings leave open.

        That is taken at the angle whose forces are nearest, for all angles alike: it grows with
        the friction angle, and how rough a record is would else be evidence of its angle.

        Parameters
        ----------
        data
            Its observation vector [N], shape [2 theta].
        """
        if self.reading.errors is None:
            return self
        near = int(np.square(self.mean - data).sum(axis=1).argmin())
        opened = self.reading.covariance(float(self.phi_deg[near]), self.mean[near])
        total = self.covariance + opened
        return replace(self, covariance=total, opened=opened)

    def averaged(self, trials: int) -> PreparedLeg:
        """The same for the mean of some records: beds differ, what is not known of the model not.

        Parameters
        ----------
        trials
            How many.
        """
        if trials == 1:
            return self
        return replace(self, scatter=self.scatter / trials, trials=trials)

    def scatter_at(self, phi_deg: float) -> FloatArray:
        """Particle scatter of the data at a friction angle [N^2], shape [2 theta, 2 theta]."""
        return self.surrogate.scatter.covariance(phi_deg) / self.trials

    def known(self, phi_deg: float) -> FloatArray:
        """Covariance of surrogate and readings at a friction angle [N^2], [2 theta, 2 theta]."""
        return self.surrogate.covariance(phi_deg) + self.opened

    def spectra(self, shape: FloatArray) -> Spectra:
        """Covariance and noise in a common basis, for each size of the scatter.

        Parameters
        ----------
        shape
            W, the noise covariance of unit size [-], positive definite, [2 theta, 2 theta].
        """
        return _spectra(self, shape.tobytes())


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


@functools.lru_cache(maxsize=DECOMPOSED)
def _spectra(leg: PreparedLeg, shape: bytes) -> Spectra:
    return Spectra(leg, np.frombuffer(shape).reshape(leg.opened.shape))


def prepare(
    library: Library, leg: str, *, readings: FloatArray | None = None, legs: int = 1
) -> PreparedLeg:
    """Make a leg of a library ready, or recall it.

    Parameters
    ----------
    library
        Simulations over the friction angle. Scatter and hyperparameters that it carries are used,
        otherwise they are estimated from its curves.
    leg, readings
        As in :meth:`Library.curves`. What the readings leave open of the path is part of the
        covariance.
    legs
        Legs that are inverted together, this one among them. Their corrections err alike, and
        likelihoods are added as if they did not: variances of the correction are so many times
        what they are, which bounds the covariance of all whatever the legs have in common.

    Raises
    ------
    InputError
        As :meth:`Library.curves` does.
    """
    return _prepared(library, leg, None if readings is None else readings.tobytes(), legs)


@functools.lru_cache(maxsize=REMEMBERED)
def _prepared(
    library: Library, leg: str, readings_as_bytes: bytes | None, legs: int
) -> PreparedLeg:
    readings = None if readings_as_bytes is None else np.frombuffer(readings_as_bytes)
    curves = library.curves(leg, readings=readings)
    surrogate = surrogate_of(library, leg, curves, readings=readings)
    if library.fine:
        correction = refinement_of(library, leg, surrogate, readings=readings)
        surrogate = replace(surrogate, correction=correction.widened(np.sqrt(legs)))
    reading = None if readings is None else learn_reading(library, leg, readings, surrogate)
    return PreparedLeg.of(surrogate, curves, reading)


def surrogate_of(
    library: Library, leg: str, curves: Curves, *, readings: FloatArray | None = None
) -> JointSurrogate:
    """Joint surrogate of one leg as simulated: as the library's calibration says, or fitted."""
    learnt = _carried(library, leg)
    if learnt is None or not np.allclose(learnt[0].theta_deg, curves.theta_deg, atol=1e-6):
        log.info("library %s, leg %s: fitting a surrogate, as none fits", library.name, leg)
        # From the whole path: what few readings leave of it is told by them, and not by scatter.
        whole = learn(library.curves(leg), library.repeated(leg))
        learnt = whole.scatter, whole.kernel
    means, repeats = _means(curves, library.repeated(leg, readings=readings))
    scatter, kernel = learnt
    return JointSurrogate.fit(
        curves.phi_deg, curves.theta_deg, means, scatter, kernel=kernel, repeats=repeats
    )


def _carried(library: Library, leg: str) -> tuple[Scatter, JointKernel] | None:
    """Scatter and hyperparameters of a leg that a library's calibration has; ``None`` if none."""
    carried = library.calibration.get("legs", {}).get(leg)
    if carried is None or library.calibration.get("library_hash") != library.as_simulated.hash:
        return None
    try:
        return Scatter.from_dict(carried["scatter"]), JointKernel.from_dict(carried["kernel"])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(
            f"library '{library.name}' carries a calibration of another version of terraphi; "
            "calibrate it again (terraphi library calibrate)"
        ) from error


def refinement_of(
    library: Library, leg: str, coarse: JointSurrogate, *, readings: FloatArray | None = None
) -> Refinement:
    """Correction of one leg of a refined library.

    Parameters
    ----------
    library
        Hyperparameters that it carries are used, otherwise they are found.
    leg, readings
        As in :func:`prepare`.
    coarse
        The leg's surrogate, as simulated.
    """
    of_legs = {one: fine_curves(library, one, readings=readings) for one in library.legs}
    parts = {}
    for cause in CAUSES:
        count = {one: len(of[cause].phi_deg) for one, of in of_legs.items() if cause in of}
        if not count:
            continue
        # Of legs with fine curves, the one with most stands for those without.
        source = leg if leg in count else max(count, key=lambda one: count[one])
        surrogate = coarse
        if source != leg:
            surrogate = surrogate_of(
                library, source, library.curves(source, readings=readings), readings=readings
            )
        priors = priors_of(cause, library.plan.scenario)
        kernel = FidelityKernel.known(library.refinement.get(source, {}).get(cause))
        if kernel is None and library.refinement:
            log.info("refined by another version: hyperparameters of leg %s are found anew", source)
            whole = surrogate_of(library, source, library.curves(source))
            kernel = Correction.of(whole, fine_curves(library, source)[cause], priors=priors).kernel
        found = Correction.of(surrogate, of_legs[source][cause], kernel, priors=priors)
        parts[cause] = found if source == leg else found.for_leg(coarse)
    return Refinement(parts)


def learn(curves: Curves, replicates: Sequence[tuple[float, FloatArray]] = ()) -> JointSurrogate:
    """Estimate scatter and hyperparameters from a library's curves, and replicates if there are.

    Parameters
    ----------
    curves
        Of one leg.
    replicates
        As from :meth:`Library.repeated`. Forces at their angles are known the better for them.
    """
    means, repeats = _means(curves, replicates)
    with single_threaded():
        scatter = estimate(curves.theta_deg, curves.phi_deg, curves.vectors, replicates)
        return JointSurrogate.fit(curves.phi_deg, curves.theta_deg, means, scatter, repeats=repeats)


def _means(
    curves: Curves, replicates: Sequence[tuple[float, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """Mean of all simulations of each case [N], shape [case, 2 theta], and how many they are."""
    means, repeats = curves.vectors, np.ones(len(curves.phi_deg))
    for phi, vectors in replicates:
        (case,) = np.flatnonzero(curves.phi_deg == phi)
        means[case], repeats[case] = vectors.mean(axis=0), len(vectors)
    return means, repeats


MOST_SHIFTS = 10
"""Shifts of the readings within their spacing that are tried at most."""
GROWTH = (3, 8)
"""Cases over phi from which on the log of the size of errors is a line, and a quadratic."""
NEAR_DEG = 6.0
"""Standard deviation over phi of the weights of curves [deg]. Curves that are left out are met with
the narrowest intervals so, by 5 to 20 % against equal weights, in four libraries; 4 or 8 does as
well."""
FEWEST = 3
"""Angles between the ends above which curves are left out."""
WHITES = 0.01 * 400.0 ** (np.arange(21) / 13.0)
"""Variances that may be added at each window by itself, of that learnt [-]: up to 100."""
WHITE = 0.5
"""The same if curves are too few to leave some out."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Covariance of what a record's readings leave open, over the friction angle.

    Attributes
    ----------
    errors
        What curves show [-], none if nothing is open.
    white
        Variance added at each window by itself, of that learnt [-].
    """

    errors: _Errors | None = None
    white: float = 0.0

    def moment(self, phi_deg: float) -> FloatArray:
        """Covariance at a friction angle of forces of unit peak-to-peak [-], [2 theta, 2 theta]."""
        if self.errors is None:
            return np.zeros(())
        moment = self.errors.moment(phi_deg)
        return moment + self.white * np.diag(np.diag(moment))

    def covariance(self, phi_deg: float, forces: FloatArray) -> FloatArray:
        """Covariance of the window means of a record [N²], shape [2 theta, 2 theta].

        Parameters
        ----------
        phi_deg
            Friction angle [deg].
        forces
            Observation vector there [N], shape [2 theta].
        """
        spans = window_spans(forces)
        return spans[:, None] * self.moment(phi_deg) * spans


class _Errors(NamedTuple):
    """What each of some curves shows, over its peak-to-peak [-]."""

    phi_deg: FloatArray
    """Friction angles, shape [case]."""
    about: FloatArray
    """Points less means about them, shape [case, shift, 2 theta]."""
    beside: FloatArray
    """These less means of the whole path, beside the curve's neighbours, same shape."""
    spans: FloatArray
    """Peak-to-peak of the force of each window [N], shape [case, 2 theta]."""

    def of(self, which: NDArray[np.bool_]) -> _Errors:
        """Those of some curves; a mask."""
        return _Errors(*(part[which] for part in self))

    def moment(self, phi_deg: float) -> FloatArray:
        """Their covariance at a friction angle [-], shape [2 theta, 2 theta].

        The curves near it count most. Both parts are of one record, and are added as such; each
        grows over phi at a rate of its own.
        """
        about, beside = (
            part * np.exp(0.5 * self._log_growth(part, phi_deg))[:, None, None]
            for part in (self.about, self.beside)
        )
        total = about + beside
        weights = np.exp(-0.5 * np.square((self.phi_deg - phi_deg) / NEAR_DEG))
        rows = np.sqrt(weights / (weights.sum() * total.shape[1]))[:, None, None] * total
        rows = rows.reshape(-1, rows.shape[-1])
        return rows.T @ rows

    def _log_growth(self, part: FloatArray, phi_deg: float) -> FloatArray:
        """Log of the variance of a part at an angle over that at each curve's, shape [case]."""
        # Growth needs more than a few cases; and a path that nothing touches has no error.
        degree = int(np.searchsorted(GROWTH, len(np.unique(self.phi_deg)), side="right"))
        x = (self.phi_deg - phi_deg) / 10.0
        size = np.log(np.maximum(np.square(part).mean(axis=(1, 2)), 1e-30))
        fit = np.polynomial.polynomial.polyfit(x, size, degree)
        return fit[0] - np.polynomial.polynomial.polyval(x, fit)


def learn_reading(
    library: Library, leg: str, readings: FloatArray, surrogate: JointSurrogate
) -> Reading:
    """What readings leave open, from the library's own curves.

    Parameters
    ----------
    library
        Simulations over the friction angle.
    leg
        Shape of the leg.
    readings
        Leg angles of the record [rad], increasing, shape [sample].
    surrogate
        Of the leg, as from curves read like the record.

    Returns
    -------
    Reading
        Nothing for a record as dense as the library's bins.
    """
    cases = _simulations(library.cases, leg)
    phi, histories = list(cases), [found[0] for found in cases.values()]
    # Readings that lie no further apart than the samples of a curve leave nothing open.
    if np.diff(readings).max() <= 1.5 * np.median(np.diff(histories[0].position)):
        return Reading()
    repeated = _simulations(library.replicates, leg)
    around = [_relative_errors(history, readings)[1] for history in histories]
    found = []
    for i, angle in enumerate(phi):
        for history in (histories[i], *repeated.get(angle, ())):
            about, whole, spans = _relative_errors(history, readings)
            beside = _beside_neighbours(whole, i, around)
            found.append(_Errors(np.array(angle), about, beside, spans))
    errors = _Errors(*(np.stack(part) for part in zip(*found, strict=True)))
    return Reading(errors, white_of(errors, surrogate))


def _beside_neighbours(own: FloatArray, i: int, every: Sequence[FloatArray]) -> FloatArray:
    """What a curve has and its neighbours over phi do not, nor a surrogate of such curves.

    Beside the mean of its neighbours it has one and a half times the variance of its own part: as
    much as beside the surrogate. The first and the last have two neighbours on one side; what they
    have beside a line through these has four times that variance.
    """
    last = len(every) - 1
    if 0 < i < last:
        return own - 0.5 * (every[i - 1] + every[i + 1])
    inward = 1 if i == 0 else -1
    return 0.5 * (own - 2.0 * every[i + inward] + every[i + 2 * inward])


def _simulations(cases: Sequence[Case], leg: str) -> dict[float, list[ForceHistory]]:
    """Histories of one leg by friction angle [deg], increasing."""
    found: dict[float, list[ForceHistory]] = {}
    for case in sorted(cases, key=lambda case: case.scenario.soil.friction_angle_deg):
        if case.history and case.scenario.leg.shape == leg:
            found.setdefault(case.scenario.soil.friction_angle_deg, []).append(case.history)
    return found


def _relative_errors(
    history: ForceHistory, readings: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors as by :func:`reading_errors` over the peak-to-peak [-], and that [N], [2 theta]."""
    spans = window_spans(history.observation().vector)
    about, around = reading_errors(history, readings)
    return about / spans, around / spans, spans


def white_of(errors: _Errors, surrogate: JointSurrogate) -> float:
    """Variance to add at each window by itself, of that learnt [-].

    The curves of every friction angle but the first and the last are left out in turn, and their
    errors move the angle as they would in an inversion with the covariance that the others show: on
    average by as much as that says. Beyond the ends, which no inversion is, others show little of
    what is there.

    Parameters
    ----------
    errors
        Of all curves.
    surrogate
        Of the leg.
    """
    inner, ratios = np.unique(errors.phi_deg)[1:-1], []
    nothing = not (errors.about.any() or errors.beside.any())
    if len(inner) <= FEWEST or nothing:
        return WHITE
    for phi in inner.tolist():
        rest, left_out = errors.of(errors.phi_deg != phi), errors.of(errors.phi_deg == phi)
        spans, known = left_out.spans[0], surrogate.covariance(phi)
        known += surrogate.scatter.covariance(phi)
        learnt, slope = spans[:, None] * rest.moment(phi) * spans, surrogate.slope(phi)
        moved = (left_out.about + left_out.beside) * left_out.spans[:, None]
        ratio = []
        for white in WHITES:
            opened = learnt + white * np.diag(np.diag(learnt))
            direction = np.linalg.solve(known + opened, slope)
            ratio.append(np.square(moved @ direction).mean() / (direction @ opened @ direction))
        ratios.append(ratio)
    # The mean falls as the variance grows; where it crosses 1 is what is looked for.
    excess = np.mean(ratios, axis=0)
    return float(np.exp(np.interp(0.0, -np.log(excess), np.log(WHITES))))


def reading_errors(history: ForceHistory, readings: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors of observation vectors from a curve's readings, moved along the path.

    Parameters
    ----------
    history
        A dense curve.
    readings
        Leg angles of a record [rad], increasing, shape [sample].

    Returns
    -------
    about
        Of points less means about them [N], shape [shift, 2 theta].
    around
        Of these less means of the whole path, same.
    """
    seen = readings[(readings >= history.position[0]) & (readings <= history.position[-1])]
    bin_ = float(np.median(np.diff(history.position)))
    spacing = float(np.median(np.diff(seen)))
    count = max(round(spacing / bin_), 1)
    # Whole bins, where there are any: what lies between them is interpolated, and smoother.
    shifts = np.unique(np.linspace(0.0, count, MOST_SHIFTS, endpoint=False).round()) * bin_
    # As far as the curve reaches: a shift back by the rest of the spacing meets the same phase.
    low, high = seen[0] - history.position[0], history.position[-1] - seen[-1]
    both_ways = np.where(shifts <= high + 1e-9, shifts, shifts - count * bin_)
    about, around = [], []
    for shift in both_ways[both_ways >= -low - 1e-9]:
        moved = replace(history, position=history.position - shift)
        force = [np.interp(seen, moved.position, column) for column in history.force.T]
        points = replace(history, position=seen, force=np.stack(force, axis=1))
        means = moved.as_read_at(seen).observation().vector
        about.append(points.observation().vector - means)
        around.append(means - moved.between(seen[0], seen[-1]).observation().vector)
    return np.stack(about), np.stack(around)
