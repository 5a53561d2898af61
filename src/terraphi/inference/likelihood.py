r"""The likelihood of records: one normal distribution, whose covariance is a sum of named terms.

With d the window means of all records, one after the other, g(x) the library's curves at parameters
x (the friction angle, or several), read and averaged as the records were,

    d = g(x) + Σ_t e_t,    e_t ~ N(0, C_t).

========================  ==========================================================================
term                      covariance
========================  ==========================================================================
noise                     of the readings, through the windows
emulator                  of the curves between the library's cases
particle scatter          between seeds: of a simulated record
cells, speed-up           of the correction to small cells and a slow motion
leg friction, hip height  a standard deviation of each, times how the curves change with it
zero of θ                 1° times dg/dθ
density                   relative standard deviation times g, to which forces are proportional
model: offset             what looks like another angle: (b² + s²) (∂g/∂φ)(∂g/∂φ)' (``soils``)
model: leg                the same of each leg by itself, l²
missing angles            where a record has a part of the stroke (``partial``)
shape                     whatever does not look like a change of x
========================  ==========================================================================

Corrections and what follows, but for the shape, are of measured records; particle scatter is of
simulated ones. All
terms are taken at the best point, so that their size is no evidence of x. For measured records g is
linear about that point: several of the terms are degrees wide and known to first order only, and
the curvature of g would move the median by what is not known.

**Shape.** Let S = ∂g/∂x, A = diag(1/p²), p the peak-to-peak of each force, and c = (S'AS)⁻¹S'A the
least-squares estimator. How the residual of a real soil varies with θ is unknown, and that of
particle scatter is known from few simulations. So the residual has the covariance P (κp)² P' with P
= I − Sc and κ large, which is nothing along S. Then the estimate is that of least squares whatever
the other terms are, and its variance is the sum of c C_t c' over these (a large covariance in
directions that c does not see can neither move nor narrow an estimate). A model error that is
allowed to look like a change of φ would take its place (Brynjarsdottir & O'Hagan 2014, doi
10.1088/0266-5611/30/11/114007). Curves left out of `sand3d` in turn are read with errors as large
as stated so, and up to 1.7 times larger if scatter is taken at its word (generalised least
squares).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.inference.emulator import emulator_of
from terraphi.inference.partial import missing_angles
from terraphi.inference.records import Record
from terraphi.inference.soils import Calibration, model_error
from terraphi.library.store import PHI, Curves, Library

DIFFUSE = 30.0
"""κ: standard deviation of an unknown shape, of peak-to-peak [-]."""
ZERO_SD_DEG = 1.0
"""Standard deviation of the zero of θ [deg]."""
RIDGE = 2e-3
"""Standard deviation added to each window mean, of peak-to-peak [-]."""
UNKNOWN_DENSITY = 0.10
"""Relative standard deviation of a density of which nothing is known [-]."""
BEYOND_DEG = 12.0
"""How far beyond the library's ends angles are looked for, with forces that continue linearly."""
FAR_OFF = 3.0
"""Factor between data and best curve at which no angle fits [-]."""
STEP = 1e-3
"""Step of numerical derivatives, of a parameter's range [-]."""


class Likelihood:
    """Log-likelihood of one record or several through a library.

    Parameters
    ----------
    records
        Of one soil.
    library
        Has every leg of the records.
    calibration
        Soils of known angle in the same apparatus, or ``None``.

    Attributes
    ----------
    keys
        Dotted scenario keys of the parameters.
    density
        Bulk density that the curves of each record are scaled to [kg/m³].
    """

    def __init__(
        self, records: Sequence[Record], library: Library, calibration: Calibration | None = None
    ) -> None:
        self.records, self.library, self.calibration = tuple(records), library, calibration
        self.measured = not all(record.simulated for record in records)
        legs = {record.leg for record in records}
        self.emulators = {
            leg: emulator_of(library, leg, corrected=self.measured) for leg in sorted(legs)
        }
        first = next(iter(self.emulators.values()))
        self.keys = first.curves.keys
        self._phi = self.keys.index(PHI) if PHI in self.keys else None
        own = first.curves.scenario.soil.density
        # A library that varies the density needs no scaling.
        self._scaled = "soil.density" not in self.keys
        self.density = [
            (record.density_kg_m3 or own) if self._scaled else own for record in records
        ]
        self._ratio = np.array(self.density) / own
        for record in records:
            theta = self._curves_of(record).theta_deg
            if record.theta_deg[0] < theta[0] - 4.4 or record.theta_deg[-1] > theta[-1] + 4.4:
                raise InputError(
                    f"library '{library.name}' covers theta from {theta[0]:.0f} to {theta[-1]:.0f} "
                    f"deg only, {record.source} {record.theta_deg[0]:.0f} to "
                    f"{record.theta_deg[-1]:.0f} deg; cut the record or build the library anew"
                )
        self.operators = [r.operator(self._curves_of(r).theta_deg) for r in records]
        ends = np.cumsum([0, *(2 * r.theta_deg.size for r in records)])
        self.parts = [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]
        self.data = np.concatenate([record.data.ravel() for record in records])
        self.span = np.concatenate([np.repeat(r.span, r.theta_deg.size) for r in records])
        self.errors = {leg: model_error(library, leg) for leg in legs}
        bounds = [emulator.bounds for emulator in self.emulators.values()]
        self.low = np.max([low for low, _ in bounds], axis=0)
        self.high = np.min([high for _, high in bounds], axis=0)

    def _curves_of(self, record: Record) -> Curves:
        return self.emulators[record.leg].curves

    # -- curves ----------------------------------------------------------------------------------

    def offset(self, leg: str) -> float:
        """Mean of the read angle less the soil's, of measured forces [deg]."""
        if not self.measured:
            return 0.0
        error = self.errors[leg]
        return error.offset_deg + (self.calibration.common(error)[0] if self.calibration else 0.0)

    def curves(self, x: FloatArray) -> FloatArray:
        """Window means g(x) [N] of all records, shape [k, key] -> [k, n]."""
        of_legs = {leg: self._forces(leg, x) for leg in self.emulators}
        means = [
            ratio * self._project(record, of_legs[record.leg])
            for record, ratio in zip(self.records, self._ratio, strict=True)
        ]
        return np.hstack(means)

    def _forces(self, leg: str, x: FloatArray) -> FloatArray:
        """Curves [N] of a leg, [k, 2, theta]; beyond the library's ends of φ they are linear."""
        emulator = self.emulators[leg]
        if self._phi is None:
            return emulator(x)
        x = x.copy()
        x[:, self._phi] += self.offset(leg)
        low, high = emulator.phi_bounds_deg
        inside = np.clip(x[:, self._phi], low, high)
        beyond = x[:, self._phi] - inside
        x[:, self._phi] = inside
        force = emulator(x)
        out = np.flatnonzero(beyond)
        if out.size:
            step = STEP * (high - low)
            inner = x[out].copy()
            inner[:, self._phi] -= np.sign(beyond[out]) * step
            slope = (force[out] - emulator(inner)) / step
            force[out] += np.abs(beyond[out])[:, None, None] * slope
        return force

    def _project(self, record: Record, force: FloatArray) -> FloatArray:
        """Window means of curves as a record reads them, [..., 2, theta] -> [..., 2 m]."""
        operator = self.operators[self.records.index(record)]
        means = force @ operator.T
        return np.asarray(means.reshape(*means.shape[:-2], -1))

    def forces_of(self, record: Record, i: int) -> FloatArray:
        """Means as another record of leg and soil of the i-th has them, 1° below, at and above φ.

        Shape [3, 2, m] [N].
        """
        x = np.repeat(np.clip(self.least_squares, self.low, self.high)[None], 3, axis=0)
        x[:, self._phi or 0] += [-1.0, 0.0, 1.0]
        operator = record.operator(self._curves_of(record).theta_deg)
        return np.asarray(self._ratio[i] * self._forces(record.leg, x) @ operator.T)

    def slope(self, x: FloatArray) -> FloatArray:
        """∂g/∂x at a point [N/unit], shape [key] -> [n, key]."""
        steps = np.diag(STEP * (self.high - self.low))
        ahead, behind = self.curves(x + steps), self.curves(x - steps)
        return np.asarray((ahead - behind).T / (2.0 * np.diag(steps)))

    # -- best point ------------------------------------------------------------------------------

    @cached_property
    def least_squares(self) -> FloatArray:
        """Parameters of the smallest squared residual, each force over its peak-to-peak, [key].

        The friction angle may lie beyond the library's ends.
        """
        if len(self.keys) == 1:
            reach = BEYOND_DEG if self._phi == 0 else 0.0
            x = np.linspace(self.low - reach, self.high + reach, 257)
        else:
            x = self.low + (self.high - self.low) * np.random.default_rng(0).random(
                (512, len(self.keys))
            )
        residual = (self.data - self.curves(x)) / self.span
        best = x[int(np.square(residual).sum(axis=1).argmin())]
        for _ in range(20):
            slope = self.slope(best) / self.span[:, None]
            rest = (self.data - self.curves(best[None])[0]) / self.span
            step = np.linalg.lstsq(slope, rest, rcond=None)[0]
            # Half the spacing of the first search at most: the global minimum is near.
            limit = (self.high - self.low) / (256 if len(self.keys) == 1 else 8)
            step = np.clip(step, -limit, limit)
            best = self._held(best + step)
            if np.all(np.abs(step) < 1e-6 * (self.high - self.low)):
                break
        return best

    def _held(self, x: FloatArray) -> FloatArray:
        """Parameters within the library, the friction angle up to 12° beyond."""
        reach = np.zeros(len(self.keys))
        if self._phi is not None:
            reach[self._phi] = BEYOND_DEG
        return np.clip(x, self.low - reach, self.high + reach)

    @cached_property
    def beyond(self) -> tuple[float, float] | None:
        """Where φ lies if no angle within 12° of the library fits [deg]; ``None`` if one does.

        None fits if the best curve ends at the bound, or would have to be three times as large.
        """
        if self._phi is None:
            return None
        best, i = float(self.least_squares[self._phi]), self._phi
        low, high = float(self.low[i]), float(self.high[i])
        curve, data = self.curves(self.least_squares[None])[0] / self.span, self.data / self.span
        scale = float(curve @ data) / max(float(curve @ curve), 1e-12)
        if best >= high + 0.999 * BEYOND_DEG or scale > FAR_OFF:
            return high, high + BEYOND_DEG
        if best <= low - 0.999 * BEYOND_DEG or abs(scale) < 1.0 / FAR_OFF:
            return low - BEYOND_DEG, low
        return None

    # -- covariance ------------------------------------------------------------------------------

    @cached_property
    def terms(self) -> dict[str, FloatArray]:
        """Covariance C_t of each term at the best point [N²], shape [n, n] each."""
        x = self.least_squares
        curve, slope = self.curves(x[None])[0], self.slope(x)
        found = {"noise": self._blocks([r.noise_covariance for r in self.records])}
        found["noise"] += np.diag(np.square(RIDGE * self.span))
        inside = np.clip(x, self.low, self.high)
        of_legs = {leg: e.interpolation(inside) for leg, e in self.emulators.items()}
        found["emulator"] = self._shared_by_leg(of_legs)
        if not self.measured:
            scatter = {leg: e.scatter(inside) for leg, e in self.emulators.items()}
            blocks = []
            for record, operator, ratio in zip(
                self.records, self.operators, self._ratio, strict=True
            ):
                both = ratio * np.kron(np.eye(2), operator)
                blocks.append(both @ scatter[record.leg] @ both.T)
            found["particle scatter"] = self._blocks(blocks)
            found["shape"] = self._shape(slope)
            return found
        found |= self._of_corrections(inside)
        if self._phi is not None:
            found |= self._model_offset(slope[:, self._phi])
            found |= missing_angles(self, slope[:, self._phi])
        found["density"] = np.outer(*[self._density_error * curve] * 2)
        turned = self._turned(x, curve)
        found["zero of θ"] = self._blocks(
            [np.outer(turned[part], turned[part]) for part in self.parts]
        )
        found["shape"] = self._shape(slope)
        return found

    @property
    def _density_error(self) -> FloatArray:
        """Relative standard deviation of the density at each window mean [-], shape [n]."""
        if not self._scaled:
            return np.zeros(self.data.size)
        of_records = [
            UNKNOWN_DENSITY if r.density_kg_m3 is None else r.density_sd_kg_m3 / r.density_kg_m3
            for r in self.records
        ]
        return np.repeat(of_records, [2 * r.theta_deg.size for r in self.records])

    def _blocks(self, blocks: Sequence[FloatArray]) -> FloatArray:
        """Block-diagonal covariance of records whose errors are independent."""
        found = np.zeros((self.data.size, self.data.size))
        for part, block in zip(self.parts, blocks, strict=True):
            found[part, part] = block
        return found

    def _shared_by_leg(self, factors: dict[str, FloatArray]) -> FloatArray:
        """Covariance of errors that all records of a leg share, by factors [2 theta, k] a leg."""
        found = np.zeros((self.data.size, self.data.size))
        for leg, factor in factors.items():
            stacked = np.zeros((self.data.size, factor.shape[1]))
            curves = factor.T.reshape(factor.shape[1], 2, -1)
            for record, part, ratio in zip(self.records, self.parts, self._ratio, strict=True):
                if record.leg == leg:
                    stacked[part] = ratio * self._project(record, curves).T
            found += stacked @ stacked.T
        return found

    def _of_corrections(self, x: FloatArray) -> dict[str, FloatArray]:
        """Terms of the correction's modes, by cause."""
        if self._phi is None:
            return {}
        of_causes: dict[str, dict[str, FloatArray]] = {}
        for leg, emulator in self.emulators.items():
            correction = self.library.corrections.get(leg)
            modes = correction.modes_at(float(x[self._phi])) if correction else {}
            for cause, mode in modes.items():
                on = correction.theta_deg if correction else emulator.curves.theta_deg
                at = np.searchsorted(on, emulator.curves.theta_deg)
                factor = mode[:, :, at].reshape(len(mode), -1).T
                of_causes.setdefault(cause, {})[leg] = factor
        return {cause: self._shared_by_leg(factors) for cause, factors in of_causes.items()}

    def _model_offset(self, slope: FloatArray) -> dict[str, FloatArray]:
        """Covariance of what looks like another angle: of all records alike, and of each leg."""
        of_legs = {leg: np.zeros_like(slope) for leg in self.errors}
        shared = np.zeros_like(slope)
        for record, part in zip(self.records, self.parts, strict=True):
            error = self.errors[record.leg]
            common = self.calibration.common(error)[1] if self.calibration else error.common_sd_deg
            shared[part] = slope[part] * np.hypot(common, error.soil_sd_deg)
            of_legs[record.leg][part] = slope[part] * error.leg_sd_deg
        return {
            "model: offset": np.outer(shared, shared),
            "model: leg": np.asarray(sum(np.outer(one, one) for one in of_legs.values())),
        }

    def _turned(self, x: FloatArray, curve: FloatArray) -> FloatArray:
        """Change of the curves if θ is off by one standard deviation [N], shape [n]."""
        found = np.zeros_like(curve)
        for record, part, ratio in zip(self.records, self.parts, self._ratio, strict=True):
            theta = self._curves_of(record).theta_deg
            force = self._forces(record.leg, x[None])[0]
            rate = np.gradient(force, theta, axis=1) * ZERO_SD_DEG
            found[part] = ratio * self._project(record, rate)
        return found

    def _shape(self, slope: FloatArray) -> FloatArray:
        """P (κp)² P' of all records together.

        So several records give the angle of their common least squares, between those of each. With
        their shared errors as weights it could lie outside (Peelle's puzzle).
        """
        s, p = slope, self.span
        weighted = s / p[:, None] ** 2
        projector = np.eye(len(p)) - s @ np.linalg.pinv(s.T @ weighted) @ weighted.T
        factor = projector * (DIFFUSE * p)
        return np.asarray(factor @ factor.T)

    @cached_property
    def covariance(self) -> FloatArray:
        """Sum of all terms [N²], shape [n, n]."""
        return np.asarray(sum(self.terms.values()))

    @cached_property
    def _whitening(self) -> FloatArray:
        """Inverse of the covariance's Cholesky factor."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))

    def __call__(self, x: FloatArray) -> FloatArray:
        """Log-likelihood up to a constant, shape [k, key] -> [k]."""
        if self.measured:
            best = self.least_squares
            curves = self.curves(best[None]) + (x - best) @ self.slope(best).T
        else:
            curves = self.curves(x)
        return np.asarray(-0.5 * np.square((self.data - curves) @ self._whitening.T).sum(axis=1))

    def chi2(self, x: FloatArray) -> float:
        """Squared residual at a point, over all terms but the shape [-]."""
        known = self.covariance - self.terms["shape"]
        residual = self.data - self.curves(x[None])[0]
        return float(residual @ np.linalg.solve(known, residual))

    def sd(self, x: FloatArray) -> FloatArray:
        """Standard deviation of each parameter from all terms, linear about a point, [key]."""
        white = self._whitening @ self.slope(x)
        return np.sqrt(np.diag(np.linalg.pinv(white.T @ white)))

    def budget(self, x: FloatArray, key: str = PHI) -> dict[str, float]:
        """Share of each term in the standard deviation of a parameter, in its unit.

        With c the weights of the estimate, c'C_t c; the squares add up to the variance. The
        largest comes first, and what is below a hundredth of it is left out.
        """
        white = self._whitening @ self.slope(x)
        c = self._whitening.T @ white @ np.linalg.pinv(white.T @ white)
        c = c[:, self.keys.index(key)]
        shares = {n: math.sqrt(max(float(c @ term @ c), 0.0)) for n, term in self.terms.items()}
        most = max(shares.values())
        ordered = sorted(shares.items(), key=lambda item: -item[1])
        return {name: share for name, share in ordered if share > 0.01 * most}
