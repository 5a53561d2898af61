r"""The likelihood of records: one normal distribution, whose covariance is a sum of named terms.

With d the window means of all records, one after the other, g(x) the library's curves at parameters
x (the friction angle, or several), read and averaged as the records were,

    d = g(x; δ) + Σ_t e_t,    e_t ~ N(0, C_t).

A measured record has an unknown shift δ of its leg angle, by which its forces come later than the
model's: the zero of the angle, the height of the hip, soil at the surface that gives way before it
bears. δ is uniform on ± 15°, fitted to each record with x and marginalised.

========================  ==========================================================================
term                      covariance
========================  ==========================================================================
noise                     of the readings, through the windows
emulator                  of the curves between the library's cases
particle scatter          between seeds: of a simulated record
leg friction, hip height  a standard deviation of each, times how the curves change with it
density, gain             relative standard deviation of the density, and of the gain of the sensor,
                          times g
model: apparatus, soil    what looks like another angle: b² and s² times (∂g/∂φ)(∂g/∂φ)' (``soils``)
model: leg, offset        the same of each leg by itself, l²; and the error of its offset over φ,
                          which includes that of the correction to small cells and a slow motion
missing angles            where a record has a part of the stroke (``partial``)
missing forces            where it has the moment about the hip in place of a force: the angles
                          read off both differ by that
second opinion            where other physics gives an angle outside both intervals
========================  ==========================================================================

Corrections and what follows are of measured records; particle scatter is of simulated ones.

**Estimate.** With S = ∂g/∂(x, δ) at the best point, A = diag(1/p²), p the peak-to-peak of each
force, and c = (S'AS)⁻¹S'A, the parameters are those of least squares, and c (d − g(x)) is normal
with the variance V = Σ_t c C_t c': the sandwich (White 1980, Econometrica 48:817). How the residual
of a real soil varies with θ is unknown, and that of particle scatter is known from few simulations,
so the terms neither move the estimate nor narrow it: in what c does not see a residual may be
anything. A model error that is allowed to look like a change of φ would take its place
(Brynjarsdottir & O'Hagan 2014, doi 10.1088/0266-5611/30/11/114007). Curves left out of `sand3d` in
turn are read with errors as large as stated so, and up to 1.7 times larger if scatter is taken at
its word (generalised least squares). Several records give the angle of their common least squares,
between those of each; with their shared errors as weights it could lie outside (Peelle's puzzle). A
shift has no term of its own: c does not see it.

All terms are taken at the best point, so that their size is no evidence of x. For measured records
g is linear about that point: several of the terms are degrees wide and known to first order only,
and the curvature of g would move the median by what is not known.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import FORCES
from terraphi.experiment.rig import Rig
from terraphi.inference.emulator import emulator_of
from terraphi.inference.partial import Part, missing_parts, part_of
from terraphi.inference.records import Record
from terraphi.inference.soils import Calibration, model_error
from terraphi.library.store import PHI, Curves, Library

SHIFT_DEG = 15.0
"""Largest shift of the leg angle of measured records [deg]: chosen, above the 13° of the shipped
and simulated records."""
RIDGE = 2e-3
"""Standard deviation added to each window mean, of peak-to-peak [-]: the emulator's largest error
in unseen simulations of an exact model (tests/inference/test_emulator.py)."""
UNKNOWN_DENSITY = 0.10
"""Relative standard deviation of a density of which nothing is known [-]: chosen."""
BEYOND_DEG, LIMITS_DEG = 12.0, (0.5, 80.0)
"""How far beyond the library's ends angles are looked for, with forces that continue linearly; and
angles that can be answered [deg]; chosen."""
FAR_OFF = 3.0
"""Factor between data and best curve at which no angle fits [-]: chosen."""
SIMILAR = {"leg.width": 0.02, "motion.hip.1": 0.015, "leg.half_thickness": 0.015}
"""How far a rig may be from the library's: in the width over it, in the height of the hip and in
the thickness over the length. Each moves φ by at most 0.5° (2 mm of Li's hip by 1°, 10 % of force
by 1.6 to 2°), which is less than what is assumed of sizes that were not measured."""
OF_RIG = ("leg friction", "hip height", "gain")
"""Causes that stay as they are in an apparatus."""
STEP = 1e-3
"""Step of numerical derivatives, of a parameter's range [-]."""


def channels_of(record: Record, force: FloatArray, arm: FloatArray | None) -> FloatArray:
    """Channels of a record from (Fx, Fz) [N] and lever arms [m], [..., 2, m] -> [..., c, m].

    Raises InputError if the record has a moment and there are no lever arms.
    """
    if record.channels == FORCES:
        return force
    if arm is None:
        raise InputError(
            f"{record.source}: Fx and Fz are needed; the library has no moment about the hip"
        )
    rows = {"Fx": force[..., 0, :], "Fz": force[..., 1, :], "M": (force * arm).sum(axis=-2)}
    return np.stack([rows[name] for name in record.channels], axis=-2)


def window_means(record: Record, force: FloatArray, curves: Curves, shift_deg: float) -> FloatArray:
    """Forces [N] over the angles of curves, as a record reads them at a shift.

    Shape [..., 2, theta] -> [..., c m].
    """
    seen = channels_of(record, force, curves.arm)
    means = seen @ record.operator(curves.theta_deg + shift_deg).T
    return np.asarray(means.reshape(*means.shape[:-2], -1))


def squared_residuals(
    record: Record, data: FloatArray, force: FloatArray, curves: Curves, shifts: FloatArray
) -> FloatArray:
    """Sum over a record of (d − g)²/p² for forces at shifts of the leg angle, [shift, k] [-].

    The data and their peak-to-peak p are given, [c, m]; the forces have the shape [k, 2, theta].
    """
    spans, flat = np.repeat(np.ptp(data, axis=1), data.shape[1]), data.ravel()
    apart = [flat - window_means(record, force, curves, shift) for shift in shifts]
    return np.square(np.stack(apart) / spans).sum(axis=2)


def _square(error: FloatArray) -> FloatArray:
    """Covariance of one error, by its size at each window mean, shape [n] -> [n, n]."""
    return np.outer(error, error)


def scaled(record: Record, curves: Curves) -> tuple[float, Curves]:
    """Factor on a library's forces for a record's density and size [-], and arms of that size.

    F = ρ g L³ f with the same f for all rigs of the same ratios.
    """
    own, rig = curves.scenario.soil.density, Rig.of_scenario(curves.scenario)
    length = 1.0 if rig is None else record.rig.length / rig.length
    density = 1.0 if "soil.density" in curves.keys else (record.density_kg_m3 or own) / own
    arm = None if curves.arm is None else length * curves.arm
    return density * length**3, curves._replace(arm=arm)


def is_similar(record: Record, curves: Curves) -> bool:
    """Whether a record's rig has the proportions of a library's, but for what that varies."""
    rig = Rig.of_scenario(curves.scenario)
    if rig is None:
        return True
    own, theirs = record.rig.ratios, rig.ratios
    apart = {
        "leg.width": abs(own.width / theirs.width - 1.0),
        "motion.hip.1": abs(own.hip_height - theirs.hip_height),
        "leg.half_thickness": abs(own.thickness - theirs.thickness),
    }
    return all(apart[key] <= SIMILAR[key] for key in apart if key not in curves.keys)


def check_rig(record: Record, library: Library, curves: Curves) -> None:
    """Raise InputError if a measured record's rig has other proportions than the library's."""
    if record.scenario is not None or is_similar(record, curves):
        return
    own, rig = record.rig, Rig.of_scenario(curves.scenario)
    sizes = own.sizes_mm.items()
    options = " ".join(f"--{key[:-3].replace('_', '-')} {size:g}" for key, size in sizes)
    raise InputError(
        f"{record.source}: library {library.name} is of a {rig}, and this leg has other "
        f"proportions; build one: terraphi library build --leg {own.leg} {options} --out mine.nc, "
        "and add --library mine.nc, or rft3d for a rough angle at once"
    )


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
    disagreement_deg
        Standard deviation of φ because other physics gives another angle [deg].

    Attributes
    ----------
    keys
        Dotted scenario keys of the parameters.
    density
        Bulk density that the curves of each record are scaled to [kg/m³].
    """

    def __init__(
        self,
        records: Sequence[Record],
        library: Library,
        calibration: Calibration | None = None,
        *,
        disagreement_deg: float = 0.0,
    ) -> None:
        self.records, self.library, self.calibration = tuple(records), library, calibration
        self.disagreement_deg = disagreement_deg
        self.measured = not all(record.simulated for record in records)
        legs: set[str] = {record.leg for record in records}
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
        for record in records:
            check_rig(record, library, self.emulators[record.leg].curves)
        self._ratio = np.array([scaled(r, self.emulators[r.leg].curves)[0] for r in records])
        for record in records:
            theta = self.curves_of(record).theta_deg
            if record.theta_deg[0] < theta[0] - 4.4 or record.theta_deg[-1] > theta[-1] + 4.4:
                raise InputError(
                    f"library '{library.name}' covers theta from {theta[0]:.0f} to {theta[-1]:.0f} "
                    f"deg only, {record.source} {record.theta_deg[0]:.0f} to "
                    f"{record.theta_deg[-1]:.0f} deg; cut the record or build the library anew"
                )
        ends = np.cumsum([0, *(r.data.size for r in records)])
        self.parts = [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]
        self.data = np.concatenate([record.data.ravel() for record in records])
        self.span = np.concatenate([np.repeat(r.span, r.theta_deg.size) for r in records])
        # The record of each window mean.
        self._of = np.repeat(np.arange(len(records)), [r.data.size for r in records])
        media = sorted({record.medium for record in records if record.medium})
        self.errors = {leg: model_error(library, leg, media) for leg in legs}
        bounds = [emulator.bounds for emulator in self.emulators.values()]
        self.low = np.max([low for low, _ in bounds], axis=0)
        self.high = np.min([high for _, high in bounds], axis=0)

    def curves_of(self, record: Record) -> Curves:
        """Curves of a record's leg in the library, with lever arms of the record's size."""
        return scaled(record, self.emulators[record.leg].curves)[1]

    # -- curves ----------------------------------------------------------------------------------

    def offset(self, leg: str, phi_deg: FloatArray) -> FloatArray:
        """Mean of the angle read off measured forces less the soil's [deg]."""
        if not self.measured:
            return np.zeros_like(phi_deg)
        error = self.errors[leg]
        common = self.calibration.common(error, leg, phi_deg)[0] if self.calibration else 0.0
        return np.asarray(error.offset_at(phi_deg + common) + common)

    def curves(self, x: FloatArray, shift_deg: FloatArray | None = None) -> FloatArray:
        """Window means g(x) [N] of all records at their shifts, or others, [k, key] -> [k, n]."""
        shift_deg = self.shift_deg if shift_deg is None else shift_deg
        of_legs = {leg: self._forces(leg, x) for leg in self.emulators}
        means = []
        for record, ratio, shift in zip(self.records, self._ratio, shift_deg, strict=True):
            curves = self.curves_of(record)
            means.append(ratio * window_means(record, of_legs[record.leg], curves, shift))
        return np.hstack(means)

    def _forces(self, leg: str, x: FloatArray) -> FloatArray:
        """Curves [N] of a leg, [k, 2, theta]; beyond the library's ends of φ they are linear."""
        emulator = self.emulators[leg]
        if self._phi is None:
            return emulator(x)
        x = x.copy()
        x[:, self._phi] += self.offset(leg, x[:, self._phi])
        low, high = (float(ends[self._phi]) for ends in emulator.bounds)
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

    def forces_of(self, record: Record, i: int) -> FloatArray:
        """Means as another record of leg and soil of the i-th has them, 1° below, at and above φ.

        Shape [3, c, m] [N].
        """
        x = np.repeat(self.inside[None], 3, axis=0)
        x[:, self._phi or 0] += [-1.0, 0.0, 1.0]
        force = self._forces(record.leg, x)
        means = window_means(record, force, self.curves_of(record), self.shift_deg[i])
        return np.asarray(self._ratio[i] * means.reshape(3, len(record.channels), -1))

    def slope(self, x: FloatArray, shift_deg: FloatArray | None = None) -> FloatArray:
        """∂g/∂x at a point [N/unit], at the records' shifts or others, shape [key] -> [n, key]."""
        steps = np.diag(STEP * (self.high - self.low))
        ahead, behind = (self.curves(x + h, shift_deg) for h in (steps, -steps))
        return np.asarray((ahead - behind).T / (2.0 * np.diag(steps)))

    def _shift_slope(self, x: FloatArray, shift_deg: FloatArray) -> FloatArray:
        """∂g/∂δ of each record [N/deg], shape [n, record]; of simulated records none, [n, 0]."""
        if not self.measured:
            return np.zeros((self.data.size, 0))
        ahead, behind = (self.curves(x[None], shift_deg + h)[0] for h in (0.1, -0.1))
        found = np.zeros((self.data.size, len(self.records)))
        for i, part in enumerate(self.parts):
            found[part, i] = (ahead - behind)[part] / 0.2
        return found

    # -- best point ------------------------------------------------------------------------------

    @property
    def least_squares(self) -> FloatArray:
        """Parameters of the smallest squared residual, each force over its peak-to-peak, [key].

        The friction angle may lie beyond the library's ends.
        """
        return self._best[0]

    @property
    def shift_deg(self) -> FloatArray:
        """Shift of each record with them [deg], shape [record]: its forces come so much later."""
        return self._best[1]

    @property
    def inside(self) -> FloatArray:
        """The best point within the library, where slopes are those of simulations, [key]."""
        return np.clip(self.least_squares, self.low, self.high)

    @cached_property
    def strokes(self) -> list[Part]:
        """What each record has of a whole stroke."""
        return [part_of(self, i) for i in range(len(self.records))]

    @cached_property
    def _best(self) -> tuple[FloatArray, FloatArray]:
        """Parameters and shifts of the smallest squared residual."""
        if len(self.keys) == 1:
            x = np.linspace(*self.ends, 257)
        else:
            x = self.low + (self.high - self.low) * np.random.default_rng(0).random(
                (512, len(self.keys))
            )
        of_legs = {leg: self._forces(leg, x) for leg in self.emulators}
        shifts = np.arange(-SHIFT_DEG, SHIFT_DEG + 1.0) if self.measured else np.zeros(1)
        squares = [
            squared_residuals(record, record.data, ratio * of_legs[record.leg],
                              self.curves_of(record), shifts)
            for record, ratio in zip(self.records, self._ratio, strict=True)
        ]  # fmt: skip
        first = int(sum(each.min(axis=0) for each in squares).argmin())
        best = x[first]
        shift = shifts[[int(each[:, first].argmin()) for each in squares]]
        for _ in range(20):
            slope = np.hstack([self.slope(best, shift), self._shift_slope(best, shift)])
            slope /= self.span[:, None]
            rest = (self.data - self.curves(best[None], shift)[0]) / self.span
            step = np.linalg.lstsq(slope, rest, rcond=None)[0]
            if self.measured:
                outward = step[best.size :] * np.sign(shift) > 0.0
                at_end = np.append(np.zeros(best.size, bool), (abs(shift) >= SHIFT_DEG) & outward)
                slope[:, at_end] = 0.0  # these shifts stay, and the rest is solved without them
                step = np.linalg.lstsq(slope, rest, rcond=None)[0]
            # Half the spacing of the first search at most: the global minimum is near.
            limit = (self.high - self.low) / (256 if len(self.keys) == 1 else 8)
            own = np.clip(step[: best.size], -limit, limit)
            best = np.clip(best + own, *self.ends)
            turn = np.clip(step[best.size :], -0.5, 0.5)
            if self.measured:
                shift = np.clip(shift + turn, -SHIFT_DEG, SHIFT_DEG)
            still = np.abs(turn) < 1e-3
            if np.all(np.abs(own) < 1e-6 * (self.high - self.low)) and np.all(still):
                break
        return best, shift

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest parameters that are looked at: of φ up to 12° beyond the library."""
        of_phi = np.array(self.keys) == PHI
        low = np.where(of_phi, np.maximum(self.low - BEYOND_DEG, LIMITS_DEG[0]), self.low)
        return low, np.where(of_phi, np.minimum(self.high + BEYOND_DEG, LIMITS_DEG[1]), self.high)

    @cached_property
    def beyond(self) -> tuple[float, float] | None:
        """Where φ lies if no angle within 12° of the library fits [deg]; ``None`` if one does.

        None fits if the best curve ends at the bound, or would have to be three times as large.
        """
        if self._phi is None:
            return None
        best, i = float(self.least_squares[self._phi]), self._phi
        low, high = float(self.low[i]), float(self.high[i])
        least, most = (float(end[i]) for end in self.ends)
        curve, data = self.curves(self.least_squares[None])[0] / self.span, self.data / self.span
        scale = float(curve @ data) / max(float(curve @ curve), 1e-12)
        if best >= most - 0.01 or scale > FAR_OFF:
            return high, most
        if best <= least + 0.01 or abs(scale) < 1.0 / FAR_OFF:
            return least, low
        return None

    # -- covariance ------------------------------------------------------------------------------

    @cached_property
    def terms(self) -> dict[str, FloatArray]:
        """Covariance C_t of each term at the best point [N²], shape [n, n] each."""
        x = self.least_squares
        curve, slope = self.curves(x[None])[0], self.slope(x)
        found = {"noise": self._blocks([r.noise_covariance for r in self.records])}
        found["noise"] += np.diag(np.square(RIDGE * self.span))
        inside = {leg: self._within(leg, x) for leg in self.emulators}
        of_legs = {leg: e.interpolation(inside[leg]) for leg, e in self.emulators.items()}
        found["emulator"] = self._shared_by_leg(of_legs)
        if not self.measured:
            scatter = {leg: e.scatter(inside[leg]) for leg, e in self.emulators.items()}
            blocks = []
            for record, ratio in zip(self.records, self._ratio, strict=True):
                operator = record.operator(self.curves_of(record).theta_deg)
                both = ratio * np.kron(np.eye(2), operator)
                blocks.append(both @ scatter[record.leg] @ both.T)
            found["particle scatter"] = self._blocks(blocks)
            return found
        found |= self._of_corrections(inside)
        if self._phi is not None:
            found |= self._model_offset(slope[:, self._phi])
            found |= missing_parts(self, slope[:, self._phi])
            if self.disagreement_deg:
                found["second opinion"] = _square(self.disagreement_deg * slope[:, self._phi])
        density = np.array([
            UNKNOWN_DENSITY if r.density_kg_m3 is None else r.density_sd_kg_m3 / r.density_kg_m3
            for r in self.records
        ])  # fmt: skip
        found["density"] = _square(self._scaled * density[self._of] * curve)
        gain = np.array([0.0 if self._calibrated(r.leg) else r.gain_sd for r in self.records])
        if gain.any():
            found["gain"] = _square(gain[self._of] * curve)
        return found

    def _within(self, leg: str, x: FloatArray) -> FloatArray:
        """Where a leg's curves are taken from, within the library, [key]."""
        x = x.copy()
        if self._phi is not None:
            x[self._phi] += self.offset(leg, x[self._phi])
        return np.clip(x, *self.emulators[leg].bounds)

    def _calibrated(self, leg: str) -> bool:
        """Whether a soil of known angle was read with this leg, whose rig is then known with b."""
        return self.calibration is not None and self.calibration.has(leg)

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
            for record, part, ratio, shift in zip(
                self.records, self.parts, self._ratio, self.shift_deg, strict=True
            ):
                if record.leg == leg:
                    means = window_means(record, curves, self.curves_of(record), shift)
                    stacked[part] = ratio * means.T
            found += stacked @ stacked.T
        return found

    def _of_corrections(self, inside: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Terms of the correction's modes, by cause."""
        if self._phi is None:
            return {}
        of_causes: dict[str, dict[str, FloatArray]] = {}
        for leg, emulator in self.emulators.items():
            correction = self.library.corrections.get(leg)
            modes = correction.modes_at(float(inside[leg][self._phi])) if correction else {}
            for cause, mode in modes.items():
                if self._calibrated(leg) and cause in OF_RIG:
                    continue  # included in what the calibration determines of the apparatus
                on = correction.theta_deg if correction else emulator.curves.theta_deg
                at = np.searchsorted(on, emulator.curves.theta_deg)
                factor = mode[:, :, at].reshape(len(mode), -1).T
                if cause == "hip height":
                    factor = factor * self._height_sd(leg)
                of_causes.setdefault(cause, {})[leg] = factor
        return {cause: self._shared_by_leg(factors) for cause, factors in of_causes.items()}

    def _height_sd(self, leg: str) -> float:
        """Standard deviation of the hip's height over that of the correction's mode [-]."""
        rigs = [record.rig for record in self.records if record.leg == leg]
        known = Rig.of("li2013", leg)
        each = [rig.hip_height_sd_mm / rig.length_mm for rig in rigs]
        return float(np.mean(each)) / (known.hip_height_sd_mm / known.length_mm)

    def _model_offset(self, slope: FloatArray) -> dict[str, FloatArray]:
        """Covariance of what looks like another angle: of an apparatus, a soil, and each leg."""
        known, legs = self.calibration, np.array([record.leg for record in self.records])
        phi = self.least_squares[self.keys.index(PHI)]
        sd = {
            leg: (
                float(known.common(error, leg, phi)[1]) if known else error.common_sd_deg,
                error.soil_sd_deg,
                error.leg_sd_deg,
                0.0 if self._calibrated(leg) else error.offset_sd_at(phi),
            )
            for leg, error in self.errors.items()
        }
        each = np.array([sd[leg] for leg in legs])[self._of].T
        apparatus, soil, leg, offset = map(_square, slope * each)
        same_leg = np.equal.outer(legs, legs)[self._of][:, self._of]
        return {
            "model: apparatus": apparatus,
            "model: soil": soil,
            "model: leg": leg * same_leg,
            "model: offset": offset * same_leg,
        }

    @cached_property
    def covariance(self) -> FloatArray:
        """Sum of all terms [N²], shape [n, n]."""
        return np.asarray(sum(self.terms.values()))

    @cached_property
    def _weights(self) -> FloatArray:
        """Weights c of each parameter at the best point, shape [key, n] [unit/N]."""
        of_shift = self._shift_slope(self.least_squares, self.shift_deg)
        if self.measured:
            of_shift[:, np.abs(self.shift_deg) >= SHIFT_DEG] = 0.0  # these shifts are not fitted
        s = np.hstack([self.slope(self.least_squares), of_shift]) / self.span[:, None]
        return np.asarray(np.linalg.pinv(s)[: len(self.keys)] / self.span)

    @cached_property
    def _variance(self) -> FloatArray:
        """Covariance V of the parameters, shape [key, key]."""
        return np.asarray(self._weights @ self.covariance @ self._weights.T)

    def __call__(self, x: FloatArray) -> FloatArray:
        """Log-likelihood up to a constant, shape [k, key] -> [k]."""
        apart = (
            x - self.least_squares if self.measured
            else (self.curves(x) - self.data) @ self._weights.T
        )  # fmt: skip
        return np.asarray(-0.5 * ((apart @ np.linalg.pinv(self._variance)) * apart).sum(axis=1))

    def chi2(self, x: FloatArray) -> float:
        """Squared residual at a point, over all terms [-]."""
        residual = self.data - self.curves(x[None])[0]
        return float(residual @ np.linalg.solve(self.covariance, residual))

    @property
    def sd(self) -> FloatArray:
        """Standard deviation of each parameter from all terms, [key]."""
        return np.sqrt(np.diag(self._variance))

    def budget(self, key: str = PHI) -> dict[str, float]:
        """Share of each term in the standard deviation of a parameter, in its unit.

        With c the weights of the estimate, c'C_t c; the squares add up to the variance. The
        largest comes first, and what is below a hundredth of it is left out.
        """
        c = self._weights[self.keys.index(key)]
        shares = {n: math.sqrt(max(float(c @ term @ c), 0.0)) for n, term in self.terms.items()}
        most = max(shares.values())
        ordered = sorted(shares.items(), key=lambda item: -item[1])
        return {name: share for name, share in ordered if share > 0.01 * most}
