r"""The likelihood of records: one normal distribution, whose covariance is a sum of named terms.

Let d be the window means of all records in a row, and g(φ, δ) the law's curves, read and averaged
as the records were. Then

    d = g(φ, δ) + Σ_t e_t,    e_t ~ N(0, C_t).

A measured record has an unknown shift δ of its leg angle. Three causes delay its forces: the zero
of the angle, the height of the hip, and soil at the surface that yields before it bears. δ is
uniform within ± 15°. It is fitted to each record together with φ, and marginalized.

The table :data:`~terraphi.inference.terms.TERMS` has each term t, the source of its size, and the
records that share its error. The covariances C_t are

========================  ==========================================================================
term                      covariance
========================  ==========================================================================
noise                     of the readings, through the windows
emulator                  of the curves between the law's simulations
particle scatter          between seeds; simulated records only
leg friction, hip height  (one standard deviation × ∂g of it)², measured records only, as all below
density, gain             (relative standard deviation × g)²
model: soil, leg, rig,    (standard deviation × ∂g/∂φ)²: how real soils, legs in them, rigs and beds
bed                       differ from the law (:mod:`~terraphi.laws.model_error`)
model: offset             (∂g/∂φ × error of what the law reads too much on average)²
cohesion                  (∂g/∂φ × standard deviation of φ over the likely cohesions)², see below
missing angles            (∂g/∂φ × 1.8° √(1/h − 1))²: the record has the share h of a stroke, below
missing forces            (∂g/∂φ × 0.9°)²: the record has the hip's moment in place of a force
second opinion            (∂g/∂φ × disagreement)²: another physics gives an angle outside both
                          intervals
========================  ==========================================================================

where (e)² is the matrix e e'.

**Estimate.** φ and δ are those of least squares, each force over its peak-to-peak p. With
S = ∂g/∂(φ, δ) at the best point and A = diag(1/p²), the weights are c = (S'AS)⁻¹S'A, and c (d − g)
is normal with the variance V = Σ_t c C_t c'. This is the sandwich (White 1980, Econometrica
48:817). The terms neither move the estimate nor narrow it, for two reasons. The course of a real
soil's residual over θ is unknown, and that of particle scatter is known from few simulations. And a
model error that may look like a change of φ would replace that change (Brynjarsdottir & O'Hagan
2014, doi 10.1088/0266-5611/30/11/114007). Curves that were left out of a library have errors as
large as stated with these weights, and up to 1.7 times as large with those of generalized least
squares. Records with one angle have an angle between theirs; weighted by their shared errors it
could lie outside (Peelle's puzzle).

**Cohesion.** Forces determine the cohesion worse than φ, or not at all: 38° without cohesion fit
legs in dry grains as well as 30° with 200 Pa. So the user states it; dry soil has none. A cohesion
that is known with a standard deviation, or unknown, is averaged over. With S(c) the mean squared
residual of the best φ and δ at the cohesion c,

    p(c | d) ∝ S(c)^(−ν/2) p(c),

the marginal of a residual of unknown variance with ν independent values: the windows in soil over
:data:`WINDOWS_PER_RESIDUAL`. p(c) is normal, or half of Student's t (:data:`COHESION_PA`) if c is
unknown. φ and all curves are those at the mean of c, and the standard deviation of φ(c) is the
term.

**Parts of the stroke.** The windows of a record have the share

    h = Σ_record (∂g/∂φ / p)² / Σ_stroke (∂g/∂φ / p)²

of the information on φ in a whole stroke. Real soils differ from the model by another angle at
each θ, so that a part gives another φ than the whole (:data:`PART_DEG`).

All terms are taken at the best point, so that their size is no evidence on φ. Of measured records g
is linear about that point: terms of degrees are known to first order only, and the curvature of g
would move the median by an unknown amount.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import FORCES, WINDOW_DEG, ForceHistory
from terraphi.experiment.units import GRAVITY
from terraphi.inference.estimator import Best, least_squares, weights
from terraphi.inference.records import Record, rig_name
from terraphi.inference.terms import TERMS, ordered_budget
from terraphi.laws.law import STEP, LegLaw
from terraphi.laws.legs import LawOfLegs, Legs, law_of
from terraphi.laws.model_error import MIDDLE_DEG, ModelError

if TYPE_CHECKING:
    from terraphi.inference.calibration import Calibration

SHIFT_DEG = 15.0
"""Largest shift of the leg angle of measured records [deg]: chosen. C legs have 11 to 15° in grains
and shipped media; with 20° their angles move by 0.1°."""
COHESIONS = np.array([0.0, 0.025, 0.05, 0.0875, 0.125, 0.175, 0.25, 0.35, 0.475, 0.625, 0.8, 1.0])
"""Unknown cohesions at which φ is fitted, over the largest of the law [-]; chosen."""
ABOUT = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
"""Known cohesions at which φ is fitted, in standard deviations from the mean [-]; chosen."""
FINE, EVENLY = 400, 0.03
"""Number of cohesions that are averaged over, in even steps of ln(1 + c / (0.03 ρ g L)) [-]."""
ANGLES = 400
"""Number of angles at which scaled forces are compared with the law."""
COHESION_PA, COHESION_DEGREES = 40.0, 3
"""Scale [Pa] and degrees of freedom of an unknown cohesion's prior, half of a t distribution;
chosen: a little moisture gives sand hundreds of pascals."""
WINDOWS_PER_RESIDUAL = 7
"""Window means that carry one independent residual. Residuals in grains are correlated over 7
windows of straight, 9 of C and 5 of reversed C legs."""
COHESION_STEP = 0.05
"""Step of derivatives with the cohesion, of the law's largest [-]."""
RIDGE = 2e-3
"""Standard deviation added to each window mean, of peak-to-peak [-]: the emulator's largest error
in unseen simulations of an exact model."""
BEYOND_DEG, LIMITS_DEG = 12.0, (0.5, 80.0)
"""Range of φ beyond the law's ends, where forces continue linearly, and the limits of any answer
[deg]; chosen."""
FAR_OFF = 3.0
"""Factor between data and best curve at which no angle fits [-]: chosen."""
PART_DEG = 1.8
"""Standard deviation of φ by the missing part of a stroke at h = ½ [deg]: shipped records, cut to
ten windows of 40° to 140°, move by 1.2° √(1/h − 1), and from 0° on by 2.6°. Chosen in between."""
NODES = 801
"""Nodes of the quadrature, over eight standard deviations to either side."""
ROUGHNESS = 1.5
"""Exponent of the correlation of a residual over θ [-]: residuals of the shipped records have a
larger density by it than by 1 (12 of 12); 1.75 is better for 6 of 12 (``studies/roughness.py``)."""
MOMENT_DEG = 0.9
"""Standard deviation of φ by a moment minus φ by both forces [deg]: chosen."""
TORQUE_DEG = {"straight": 0.3, "c": -0.9, "reversed_c": 3.0}
"""Mean of φ by the torque alone minus φ by both forces, by leg [deg]: of 34 records of grains of
three shapes, from which each differs by 0.4° (root mean square). The lever arms are those of
resistive force theory."""


class Free(NamedTuple):
    """Hip and cohesion that fit a record best, to first order."""

    higher_mm: float
    """Correction of the height of the hip [mm]."""
    higher_sd_mm: float
    """Its standard deviation [mm], by a residual of which one in
    :data:`WINDOWS_PER_RESIDUAL` windows is independent."""
    residual: float
    """Residual with it, root mean square over the ranges of both forces [-]."""
    cohesion_pa: float
    """Cohesion [Pa]."""


class Coverage(NamedTuple):
    """How much of a whole stroke a record has."""

    share: float
    """Share h of the information on φ [-]."""
    part: float
    """Share of the window means [-]."""
    span: FloatArray
    """Peak-to-peak of each channel over a whole stroke, by the record or the model, shape [c]."""


def window_means(
    record: Record, force: FloatArray, law: LegLaw, shift_deg: FloatArray | float
) -> FloatArray:
    """Forces [N] over the angles of a law, as a record reads them at shifts of shape [...].

    Shape [k, 2, theta] -> [..., k, c m].
    """
    if record.channels != FORCES:
        rows = {"Fx": force[..., 0, :], "Fz": force[..., 1, :], "M": (force * law.arm).sum(axis=-2)}
        force = np.stack([rows[name] for name in record.channels], axis=-2)
    operator = record.operator(law.theta_deg, shift_deg).swapaxes(-1, -2)
    means = force.reshape(-1, force.shape[-1]) @ operator
    return np.asarray(means.reshape(*operator.shape[:-2], len(force), -1))


def squared_residuals(
    record: Record, data: FloatArray, force: FloatArray, law: LegLaw, shifts: FloatArray
) -> FloatArray:
    """Sum over a record of (d − g)²/p² for data and forces at shifts of the leg angle [-].

    p is the peak-to-peak of the data. Shapes: data [h, c, m], forces [k, 2, theta]; [h, shift, k].
    """
    # Σ w (d − g)² = Σ w d² − 2 Σ w d g + Σ w g² with w = 1/p²: two matrix products give it for all
    # data, shifts and angles at once. Differences of large sums may round below 0.
    largest = np.abs(data).max(axis=(1, 2))[:, None]
    span = np.maximum(np.ptp(data, axis=2), 1e-6 * largest)
    weight, flat = np.repeat(span**-2.0, data.shape[2], axis=1), data.reshape(len(data), -1)
    curves = window_means(record, force, law, shifts)
    squares = (weight * flat**2).sum(axis=1)[:, None, None]
    squares = squares - 2.0 * np.tensordot(weight * flat, curves, axes=(1, 2))
    squares += np.tensordot(weight, np.square(curves), axes=(1, 2))
    return np.asarray(np.maximum(squares, 0.0))


class Likelihood:
    """Log-likelihood of one record, or of several strokes of one rig, through a library.

    Parameters
    ----------
    records
        Of one soil of one cohesion, with the same
        :attr:`~terraphi.inference.records.Record.conditions`.
    library
        Has the leg of the records.
    calibration
        Soils of known angle in the same apparatus, or ``None``.
    disagreement_deg
        Standard deviation of φ because other physics gives another angle [deg].

    Attributes
    ----------
    density, density_sd
        Bulk density that the curves are scaled to [kg/m³], and its standard deviation over it [-].
    """

    def __init__(
        self,
        records: Sequence[Record],
        library: LawOfLegs,
        calibration: Calibration | None = None,
        *,
        disagreement_deg: float = 0.0,
    ) -> None:
        self.records, self.library, self.calibration = tuple(records), library, calibration
        self.disagreement_deg = disagreement_deg
        first = records[0]
        self.rig, self.grain_size_mm, self.measured = (
            first.rig, first.grain_size_mm, not first.simulated
        )  # fmt: skip
        try:
            self.law: LegLaw = law_of(library, first.rig, first.scenario)
        except InputError as error:
            raise InputError(f"{first.source}: {error}") from None
        self.density = first.density_kg_m3
        self.density_sd = first.density_sd_kg_m3 / self.density
        ends = np.cumsum([0, *(r.data.size for r in records)])
        self.parts = [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]
        self.data = np.concatenate([record.data.ravel() for record in records])
        self.span = np.concatenate([np.repeat(r.span, r.theta_deg.size) for r in records])
        self._weight = np.diag(self.span**-2)
        """A = diag(1/p²), p the peak-to-peak of each force, shape [n, n]."""
        # The record of each window mean.
        self._record_index = np.repeat(np.arange(len(records)), [r.data.size for r in records])
        self.error = library.error if isinstance(library, Legs) else ModelError()
        # c / (ρ g L) for a cohesion of 1 Pa.
        self._per_pascal = 1.0 / (self.density * GRAVITY * first.rig.length)
        self._cohesions = self._fitted_cohesions()
        # Largest δ [deg]; of simulated records 0, whose angle is exact.
        self._most_shift = SHIFT_DEG if self.measured else 0.0
        self.low, self.high = (float(end[0]) for end in self.law.bounds)
        self.ends = max(self.low - BEYOND_DEG, LIMITS_DEG[0]), min(self.high + BEYOND_DEG,
                                                                   LIMITS_DEG[1])  # fmt: skip
        rigs = {soil.rig for soil in calibration.soils} if calibration else set()
        self._is_calibrated = rig_name(first.rig) in rigs

    def _fitted_cohesions(self) -> FloatArray:
        """Cohesions that φ is fitted at [Pa].

        Raises InputError if it exceeds the law's range.
        """
        mean, sd = self.records[0].cohesion_pa, self.records[0].cohesion_sd_pa
        most = self.law.most_cohesion / self._per_pascal
        if not self.measured and not most:
            return np.zeros(1)
        if (mean or sd) and not most:
            raise InputError(f"law {self.library.name} is of dry soil; leave out the cohesion")
        if mean > most:
            soil = f"{self.records[0].source}: its soil has a cohesion of {mean:g} Pa"
            raise InputError(f"{soil}, law {self.library.name} at most {most:.0f} Pa on this leg")
        if math.isinf(sd):
            return most * COHESIONS
        if not sd:
            return np.array([mean])
        # A wide distribution is averaged over the whole range of the law.
        is_wide = sd > 0.5 * mean
        nodes = [mean, *(most * COHESIONS)] if is_wide else mean + sd * ABOUT
        return np.unique(np.clip(nodes, 0.0, most))

    def prefix(self, record: Record) -> str:
        """Name of a record before a sentence on it, if there are several."""
        return f"{record.source}: " if len(self.records) > 1 else ""

    # -- curves ----------------------------------------------------------------------------------

    def offset(self, phi_deg: FloatArray) -> FloatArray:
        """Mean of φ as the law reads it off measured forces, minus φ of the soil [deg]."""
        if not self.measured:
            return np.zeros_like(phi_deg)
        learned = self.error.offset(self.rig, self.grain_size_mm, phi_deg)
        if self.records[0].channels == ("M",) and isinstance(self.library, Legs):
            learned = learned + TORQUE_DEG.get(self.rig.leg, 0.0)
        return learned + (self._calibrated_error[0] if self.calibration else 0.0)

    def row(self, phi_deg: float) -> FloatArray:
        """Row x in the mixed model, at an angle of the soil [deg], shape [effect]."""
        offset_deg = self.error.offset(self.rig, self.grain_size_mm, np.array(phi_deg))
        return self.error.row(self.rig, self.grain_size_mm, phi_deg + float(offset_deg))

    @cached_property
    def _calibrated_error(self) -> tuple[float, FloatArray]:
        """Mean of the offset's error by the calibration, and its causes [deg].

        The row is that of the angle that is in the middle of the soils of the calibration.
        """
        assert self.calibration
        middle = float(np.mean([soil.phi_deg for soil in self.calibration.soils]))
        return self.calibration.offset(self.error, rig_name(self.rig), self.row(middle))

    @cached_property
    def offset_causes_deg(self) -> FloatArray:
        """Error of the offset by a standard deviation of each cause [deg], shape [cause].

        There is no cause of simulated records.
        """
        if not self.measured:
            return np.empty(0)
        if self.calibration:
            return self._calibrated_error[1]
        return self.row(self.least_squares) @ self.error.root

    def of_size_deg(self, grain_size_mm: float) -> float:
        """Part of the offset that comes with a size of the grains [deg]."""
        if not self.measured:
            return 0.0
        sizes, middle = (grain_size_mm, 0.0), np.array(MIDDLE_DEG)
        grains, fine = (float(self.error.offset(self.rig, size, middle)) for size in sizes)
        return grains - fine

    def curves(self, phi_deg: ArrayLike, cohesion: float | None = None) -> FloatArray:
        """Window means g [N] at k angles φ, the best δ, and the best c or another [Pa], [k, n]."""
        force = self._force(phi_deg, self.cohesion if cohesion is None else cohesion)
        return self._means(force, self.shift_deg)

    def _means(self, force: FloatArray, shift_deg: FloatArray) -> FloatArray:
        """Window means of forces on the leg [N], [k, 2, theta].

        Shape [..., record] of the shifts for [..., k, n].
        """
        shifts = zip(self.records, shift_deg.T, strict=True)
        means = [window_means(record, force, self.law, shift) for record, shift in shifts]
        return np.concatenate(means, axis=-1)

    def _means_by_law(self, rows: FloatArray) -> FloatArray:
        """Window means [N] of forces in soil of the law's density [N], [k, 2 theta] -> [k, n]."""
        force = self.density / self.law.density * rows.reshape(len(rows), 2, -1)
        return self._means(force, self.shift_deg)

    def _force(self, phi_deg: ArrayLike, cohesion: float) -> FloatArray:
        """Forces [N] on the leg at k angles φ and a cohesion [Pa], shape [k, 2, theta]."""
        phi = np.reshape(np.asarray(phi_deg, np.float64), (-1, 1))
        force = self.law(phi + self.offset(phi), cohesion * self._per_pascal)
        return self.density / self.law.density * force

    def linearized(self, x: FloatArray, cohesion: float) -> tuple[FloatArray, FloatArray]:
        """Residual d − g [N], shape [1, n], and slopes by φ and each δ, shape [1, n, 1 + record].

        At φ and δ, shape [1, 1 + record], and a cohesion [Pa]; by central differences [N/deg].
        """
        step = STEP * (self.high - self.low)
        force = self._force(x[0, 0] + step * np.array([1.0, -1.0, 0.0]), cohesion)
        shifts = x[0, 1:] + np.array([[0.0], [0.1], [-0.1]])
        (above, below, curve), (*_, later), (*_, earlier) = self._means(force, shifts)
        of_record = np.eye(len(self.records))[self._record_index]
        # The shift of one record does not move the others.
        of_shift = of_record * (later - earlier)[:, None] / 0.2
        slope = np.column_stack([(above - below) / (2.0 * step), of_shift])
        return (self.data - curve)[None], slope[None]

    # -- best point ------------------------------------------------------------------------------

    @property
    def least_squares(self) -> float:
        """φ of the smallest squared residual, each force over its peak-to-peak [deg].

        It may lie up to 12° outside the law.
        """
        return float(self._best.x[0, 0])

    @property
    def shift_deg(self) -> FloatArray:
        """δ of each record at that φ [deg], shape [record]; positive if the forces come late."""
        return self._best.x[0, 1:]

    @property
    def residual(self) -> FloatArray:
        """Residual d − g at the best point [N], shape [n]."""
        return self._best.residual[0]

    @property
    def cohesion(self) -> float:
        """Mean cohesion of the soil [Pa]; 0 by laws of dry soil."""
        return self.averaged[0]

    @cached_property
    def coverage(self) -> list[Coverage]:
        """Part of a whole stroke that each record has, at the best point."""
        coverage = []
        best = np.clip(self.least_squares, self.low, self.high)
        force = self._force(best + np.array([-1.0, 0.0, 1.0]), self.cohesion)
        for record, shift in zip(self.records, self.shift_deg, strict=True):
            # A record of the same channels over a whole stroke, whose windows read the law 1°
            # below and above the best angle: their difference is proportional to ∂g/∂φ.
            theta = np.radians(np.arange(-WINDOW_DEG - 3.0, WINDOW_DEG + 3.5))
            axes = record.history.axes
            zero = ForceHistory(theta, np.zeros((theta.size, len(axes))), axes=axes,
                                moment=0 * theta)  # fmt: skip
            stroke = replace(record, history=zero)
            means = window_means(stroke, force, self.law, shift)
            below, curve, above = means.reshape(3, len(stroke.channels), -1)
            # A part of a stroke may lack the peak, so that p is the model's where that is larger.
            measured = np.isin(stroke.theta_deg.round(6), record.theta_deg.round(6))
            is_full = measured.all()
            span = record.span if is_full else np.maximum(record.span, np.ptp(curve, axis=1))
            information = np.square((above - below) / span[:, None])
            share = float((information * measured).sum() / information.sum())
            coverage.append(Coverage(share, float(measured.mean()), span))
        return coverage

    @cached_property
    def _best(self) -> Best:
        """φ and δ of the smallest squared residual, at the mean cohesion."""
        fits = self._by_cohesion
        near = int(np.abs(self._cohesions - self.cohesion).argmin())
        return fits[near] if len(fits) == 1 else self._fitted(self.cohesion, fits[near].x)

    @cached_property
    def _by_cohesion(self) -> list[Best]:
        """φ and δ of the smallest residual at each cohesion, each fit begun at the last."""
        # The squared residual has several minima, so that the first fit begins at the smallest
        # value on a grid. All records have one φ, and each has the δ that is best at that φ.
        shifts = np.arange(-self._most_shift, self._most_shift + 1.0)
        x = np.linspace(*self.ends, 257)
        force = self._force(x, float(self._cohesions[0]))
        squares = [
            squared_residuals(record, record.data[None], force, self.law, shifts)[0]
            for record in self.records
        ]
        first = int(sum(each.min(axis=0) for each in squares).argmin())
        best_shifts = shifts[[int(each[:, first].argmin()) for each in squares]]
        start, fits = np.append(x[first], best_shifts)[None], []
        settled = 1e-8 if len(self._cohesions) == 1 else 1e-4
        for cohesion in self._cohesions.tolist():
            fits.append(self._fitted(cohesion, start, settled))
            start = fits[-1].x
        return fits

    def _fitted(self, cohesion: float, start: FloatArray, settled: float = 1e-8) -> Best:
        """Least squares at a cohesion [Pa]."""
        (low, high), most = self.ends, np.full(len(self.records), self._most_shift)
        return least_squares(
            lambda x, _: self.linearized(x, cohesion),
            self._weight[None],
            start,
            bounds=(np.append(low, -most), np.append(high, most)),
            scale=np.append(self.high - self.low, np.ones(len(self.records))),
            settled=settled,
        )

    @cached_property
    def averaged(self) -> tuple[float, float, float]:
        """Mean and standard deviation of the cohesion by its posterior [Pa], and of φ by it [deg].

        The latter is about the angle at the mean; both are 0 at a single cohesion.
        """
        c = self._cohesions
        if len(c) == 1:
            return float(c[0]), 0.0, 0.0
        unit, first = 1.0 / self._per_pascal, self.records[0]
        # Between two cohesions the residual is nearly linear along ln(1 + c / (EVENLY ρ g L)), and
        # its square may be near zero.
        along = np.log1p(c / (EVENLY * unit))
        fine = np.linspace(along[0], along[-1], FINE)
        residuals = np.array([best.residual[0] for best in self._by_cohesion]) / self.span
        squares = np.mean([np.interp(fine, along, row) ** 2 for row in residuals.T], axis=0)
        phi = np.interp(fine, along, [best.x[0, 0] for best in self._by_cohesion])
        c = EVENLY * unit * np.expm1(fine)
        if math.isinf(first.cohesion_sd_pa):
            prior = np.log1p(np.square(c / COHESION_PA) / COHESION_DEGREES)
            prior *= -0.5 * (COHESION_DEGREES + 1)
        else:
            prior = -0.5 * np.square((c - first.cohesion_pa) / first.cohesion_sd_pa)
        # ln p(c | d) = ln p(c) − ν/2 ln S(c): ν residuals of a size that is not known.
        log = prior - 0.5 * self._independent_residuals * np.log(squares + RIDGE**2)
        weight = np.exp(log - log.max()) * np.gradient(c)
        weight /= weight.sum()
        mean = float(weight @ c)
        deviations = c - mean, phi - np.interp(mean, c, phi)
        sd, phi_sd = (math.sqrt(float(weight @ np.square(x))) for x in deviations)
        return mean, sd, phi_sd

    @property
    def _independent_residuals(self) -> float:
        """Number ν of independent residuals, by the windows in soil of different records."""
        # Repeats have the same residual by the law, so that they count once.
        windows = set()
        low, high = self.rig.air_deg()
        for record in self.records:
            places = record.theta_deg.round(3)
            in_soil = places[(low <= places) & (places <= high)].tolist()
            # Of Fx, Fz and the moment two give the third.
            windows |= {*itertools.product(record.channels[:2], in_soil)}
        return len(windows) / WINDOWS_PER_RESIDUAL

    def angle_of_each(self) -> FloatArray:
        """φ of each record by itself, to first order about the best point [deg], shape [record]."""
        slope, residual = self._best.slope[0] / self.span[:, None], self.residual / self.span
        angles = [
            np.linalg.lstsq(slope[part][:, [0, 1 + i]], residual[part], rcond=None)[0][0]
            for i, part in enumerate(self.parts)
        ]
        return self.least_squares + np.array(angles)

    def free_cohesion(self, i: int, *, with_hip: bool = False) -> Free | None:
        """Correction of the hip's height and cohesion that fit the i-th record best.

        To first order about the best point; φ and δ are free as well, and the cohesion is not
        below 0. ``None`` where the law has no cohesion, or no other hips.
        """
        part, law = self.parts[i], self.law
        slope = law.of_hip(*self._by_law()) if with_hip else np.zeros((0, 1))
        if slope is None or not law.most_cohesion:
            return None
        step = COHESION_STEP * law.most_cohesion / self._per_pascal
        # The difference is central, or forward where the cohesion is next to 0.
        low = max(self.cohesion - step, 0.0)
        damp, dry = (
            self.curves(self.least_squares, cohesion=c)[0, part]
            for c in (self.cohesion + step, low)
        )
        # Columns: φ, δ, the height of the hip, the cohesion.
        columns = np.column_stack([
            self._best.slope[0, part][:, [0, 1 + i]],
            *(self._means_by_law(slope.T)[:, part] if with_hip else ()),
            (damp - dry) / (self.cohesion + step - low),
        ]) / self.span[part, None]  # fmt: skip
        residuals = self.residual[part] / self.span[part]
        solution = np.linalg.lstsq(columns, residuals, rcond=None)[0]
        cohesion = self.cohesion + float(solution[-1])
        if cohesion < 0.0:
            # The best cohesion that is allowed is 0: its column at −c goes to the residuals.
            residuals, columns = residuals + self.cohesion * columns[:, -1], columns[:, :-1]
            solution, cohesion = np.linalg.lstsq(columns, residuals, rcond=None)[0], 0.0
        size = float(np.sqrt(np.square(residuals - columns @ solution).mean()))
        if not with_hip:
            return Free(0.0, 0.0, size, cohesion)
        # Of the hip, the third column, (X'X)⁻¹ r'r / (ν − p): residuals are independent in one of
        # seven windows, and the fit takes one for each of p parameters.
        freedom = len(residuals) / WINDOWS_PER_RESIDUAL - columns.shape[1]
        variance = np.linalg.pinv(columns.T @ columns)[2, 2] * len(residuals) * size**2
        sd = math.sqrt(variance / freedom) if freedom > 0.0 else math.inf
        return Free(float(solution[2]), sd, size, cohesion)

    def at_scaled_forces(self, factors: Sequence[float]) -> list[float | None]:
        """φ by forces that are larger by factors [deg]; ``None`` outside the law.

        At the shift and the cohesion of the unscaled forces.
        """
        phi = np.linspace(*self.ends, ANGLES)
        curves, data = self.curves(phi) / self.span, self.data / self.span
        # The squared residual at a factor f is d'd − 2 g'd / f + g'g / f².
        likeness, size = curves @ data, np.square(curves).sum(axis=1)
        # φ at each factor is that of the grid; its difference from φ at the factor 1 on the same
        # grid is added to the estimate.
        angles = [phi[(size / f**2 - 2.0 * likeness / f).argmin()] for f in (1.0, *factors)]
        answers = self.least_squares + np.array(angles[1:]) - angles[0]
        by_law = answers + self.offset(answers)
        in_range = (self.low <= by_law) & (by_law <= self.high)
        return [phi if ok else None for phi, ok in zip(answers.tolist(), in_range, strict=True)]

    def at_cohesion(self, cohesion_pa: float) -> float | None:
        """φ by soil of a cohesion [deg]; ``None`` outside the law."""
        if cohesion_pa * self._per_pascal > self.law.most_cohesion:
            return None
        return float(self._fitted(cohesion_pa, self._best.x).x[0, 0])

    @cached_property
    def beyond(self) -> tuple[float, float] | None:
        """Range of φ if no angle within 12° of the law fits [deg]; ``None`` if one does.

        No angle fits if the best curve ends at the bound, or differs from the data by a factor of
        :data:`FAR_OFF`.
        """
        best, (least, most) = self.least_squares, self.ends
        # The factor by which the best curve would have to be multiplied: g'd / g'g.
        curve, data = (self.data - self.residual) / self.span, self.data / self.span
        scale = float(curve @ data) / max(float(curve @ curve), 1e-12)
        if best >= most - 0.01 or scale > FAR_OFF:
            return self.high, most
        if best <= least + 0.01 or abs(scale) < 1.0 / FAR_OFF:
            return least, self.low
        return None

    # -- covariance ------------------------------------------------------------------------------

    @cached_property
    def terms(self) -> dict[str, FloatArray]:
        """Covariance C_t of each term at the best point [N²], shape [n, n] each.

        Raises LookupError if the table of terms lacks a name.
        """
        # Errors of the law: its interpolation between its simulations; of measured records a
        # standard deviation of the leg's friction and of the hip's height; of simulated ones the
        # scatter between seeds. It has each as a factor F [2 theta, k] of its forces: k independent
        # causes, one standard deviation each. Read as records read forces, F' is B: B'B.
        factors = self.law.errors(*self._by_law(), is_measured=self.measured)
        means = {name: self._means_by_law(factor.T) for name, factor in factors.items()}
        covariances = {name: b.T @ b for name, b in means.items()}
        covariances["noise"] = np.diag(np.square(RIDGE * self.span))
        for record, part in zip(self.records, self.parts, strict=True):
            covariances["noise"][part, part] += record.noise_covariance
        if self.measured:
            # One cause moves all windows together: its covariance is e e', with e a part of the
            # curve if it scales the forces, or of the slope if it looks like another φ.
            curve, slope = self.data - self.residual, self._best.slope[0, :, 0]
            errors = {name: (sds, slope) for name, sds in self._angle_sds().items()}
            errors["density"] = self.density_sd, curve
            errors["gain"] = self.records[0].gain_sd, curve
            for name, (sds, change) in errors.items():
                error = np.broadcast_to(sds, len(self.records))[self._record_index] * change
                covariances[name] = np.outer(error, error)
        # Strokes of one rig have all errors in common but those of a record.
        is_same = np.equal.outer(self._record_index, self._record_index)
        for name, covariance in covariances.items():
            covariance *= is_same | (TERMS[name].key != "record")
            # What a calibration of the rig includes is no further error of its records.
            covariance *= not (TERMS[name].fixed and self._is_calibrated)
        return {name: each for name, each in covariances.items() if each.any()}

    def _by_law(self) -> tuple[FloatArray, float]:
        """Best φ as the law reads it [deg], shape [1], and c / (ρ g L)."""
        phi = np.array([self.least_squares])
        return phi + self.offset(phi), self.cohesion * self._per_pascal

    def _angle_sds(self) -> dict[str, Any]:
        """Standard deviation of φ by what looks like another angle [deg], or [record] of them."""
        error = self.error
        # 1/h − 1 is the variance of φ by the part of a stroke that is missing, over that at ½.
        share = np.clip([coverage.share for coverage in self.coverage], 1e-3, 1.0)
        return {
            "model: offset": np.linalg.norm(self.offset_causes_deg),
            "model: soil": error.soil_sd_deg,
            "model: leg": error.leg_sd_deg,
            "model: rig": 0.0 if self._is_calibrated else error.rig_sd_deg,
            "model: bed": error.bed_sd(self.rig, self.grain_size_mm),
            "missing angles": PART_DEG * np.sqrt(1.0 / share - 1.0),
            "missing forces": MOMENT_DEG * (self.records[0].channels != FORCES),
            "second opinion": self.disagreement_deg,
            "cohesion": self.averaged[2],
        }

    @cached_property
    def covariance(self) -> FloatArray:
        """Sum of all terms [N²], shape [n, n]."""
        return np.asarray(sum(self.terms.values()))

    def predictive_covariance(self) -> FloatArray:
        """Covariance of the data about the curve of the right parameters [N²], shape [n, n].

        To the terms it adds what noise, emulator and scatter lack of the mean square of each
        channel's residual e. The correlation of that, exp(−a k^p) over k windows with p =
        :data:`ROUGHNESS`, is such that a window differs from the mean of its neighbors as those of
        the record do: to first order, Σ (eᵢ − (eᵢ₋₁ + eᵢ₊₁) / 2)² / Σ eᵢ² = a (2 − 2^(p − 1)).
        """
        covariance = self.covariance.copy()
        stated = np.sum(
            [each.diagonal() for name, each in self.terms.items() if TERMS[name].residual], axis=0
        )
        for record, part in zip(self.records, self.parts, strict=True):
            # Mean square of e of each channel, less the mean variance that the terms state.
            e = self.residual[part].reshape(len(record.channels), -1)
            lacking = np.square(e).mean(axis=1) - stated[part].reshape(e.shape).mean(axis=1)
            # Σ (second difference)² is four times the numerator of the equation above.
            unit = e / record.span[:, None]
            rough = np.square(np.diff(unit, n=2)).sum() / (4.0 * max(np.square(unit).sum(), 1e-300))
            theta = record.theta_deg
            steps = np.abs(theta[:, None] - theta) / np.median(np.diff(theta))
            correlation = np.exp(-rough / (2.0 - 2.0 ** (ROUGHNESS - 1.0)) * steps**ROUGHNESS)
            covariance[part, part] += np.kron(np.diag(np.maximum(lacking, 0.0)), correlation)
        return covariance

    @cached_property
    def weights(self) -> FloatArray:
        """Weights c of φ at the best point [deg/N], shape [n]."""
        slope, shift = self._best.slope.copy(), np.abs(self.shift_deg)
        # A shift at its bound is not fitted.
        slope[0, :, 1:] *= shift < self._most_shift
        return weights(slope, self._weight[None])[0][0, 0]

    @cached_property
    def sd(self) -> float:
        """Standard deviation √V of φ by all terms [deg]."""
        return math.sqrt(float(self.weights @ self.covariance @ self.weights))

    def budget(self) -> dict[str, float]:
        """Share of each term in the standard deviation of φ [deg].

        With c the weights of the estimate it is √(c'C_t c); the squares add up to the variance.
        """
        c = self.weights
        variances = {name: max(float(c @ term @ c), 0.0) for name, term in self.terms.items()}
        return ordered_budget({name: math.sqrt(variance) for name, variance in variances.items()})


def quadrature(likelihood: Likelihood) -> tuple[FloatArray, FloatArray]:
    """Posterior density of φ under a uniform prior, on a grid that resolves its peak.

    The prior reaches from 12° below the library's smallest angle to 12° above its largest. Where no
    angle fits even there, the density is uniform over the 12° beyond that end.

    Returns
    -------
    grid, density
        [deg] and [1/deg], shape [node] each.
    """
    if likelihood.beyond is not None:
        # No angle fits: only the end of the law is determined beyond which φ lies.
        low, high = likelihood.beyond
        return np.linspace(low, high, NODES), np.full(NODES, 1.0 / (high - low))
    best, sd = likelihood.least_squares, likelihood.sd
    low, high = np.clip([best - 8.0 * sd, best + 8.0 * sd], *likelihood.ends).tolist()
    grid = np.linspace(low, high, NODES)
    # Of measured records g is linear about the best point, so that c (d − g(φ)) is the best angle
    # less φ; the curves of simulated records are exact, and are taken as they are.
    deviation = grid - best
    if not likelihood.measured:
        deviation = (likelihood.curves(grid) - likelihood.data) @ likelihood.weights
    squares = np.square(deviation / sd)
    density = np.exp(0.5 * (squares.min() - squares))
    return grid, density / np.trapezoid(density, grid)
