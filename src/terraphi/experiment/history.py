"""Forces on a leg as a function of its angle, and the observation vector made of them.

Signs are those of Li et al. (2013): x forward, z up; ``Fz > 0`` lifts and ``Fx > 0`` thrusts
forward; the force is the soil's on the leg.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import open_netcdf, positions, write_netcdf
from terraphi.experiment.force_table import read_force_table, write_force_table

WINDOW_DEG = 85.0
"""Half width of the engaged window of the paper [deg]."""
OBSERVATION_ANGLES = 40
"""Number M of angles in the paper's observation vector."""
SCHEMA = 1

_SHOWN = [
    *("scenario_hash", "model_version", "particles", "steps", "momentum_mismatch", "momentum"),
    *("counted_impulse_kg_m_s", "applied_impulse_kg_m_s", "seconds"),
]
_APPLIED = "applied_force"
"""Where a history's provenance keeps what its contact applied, if it counts something else."""
_UNITS = {"theta": "rad", "displacement": "m", "time": "s"}


@dataclass(frozen=True)
class Observation:
    """Window means of a history at M angles, the data of an inversion.

    Attributes
    ----------
    theta_deg
        Angles θ_j [deg], shape [M].
    Fx, Fz
        Mean forces over ± half a spacing around each angle [N], shape [M].
    """

    theta_deg: FloatArray
    Fx: FloatArray
    Fz: FloatArray

    @property
    def vector(self) -> FloatArray:
        """D = [Fx(θ_1..M), Fz(θ_1..M)] [N], shape [2M]."""
        return np.concatenate([self.Fx, self.Fz])


@dataclass(frozen=True)
class Peaks:
    """Largest forces of a history, taken on 1° means."""

    Fx: float
    """Peak forward thrust [N]."""
    Fz: float
    """Peak lift [N]."""
    theta_Fx_deg: float
    """Angle of the peak thrust [deg]."""
    theta_Fz_deg: float
    """Angle of the peak lift [deg]."""


@dataclass(frozen=True)
class ForceHistory:
    """Forces of the soil on the leg along its path.

    Attributes
    ----------
    position
        θ [rad], displacement [m] or time [s], increasing, shape [sample].
    force
        [N], shape [sample, axis].
    coordinate
        What ``position`` is: ``theta``, ``displacement`` or ``time``.
    axes
        Names of the force's axes, ``("x", "z")`` in the plane; those two are always there.
    provenance
        Where the history comes from: scenario, hash, versions, seed, timings; JSON-able.
    moment
        Of the soil on the leg about the hip, positive in the direction of increasing θ [N m],
        shape [sample], or ``None``.
    """

    position: FloatArray
    force: FloatArray
    coordinate: str = "theta"
    axes: tuple[str, ...] = ("x", "z")
    provenance: Mapping[str, Any] = field(default_factory=dict)
    moment: FloatArray | None = None

    def __post_init__(self) -> None:
        """Raise ValueError if axes, shapes or order are wrong."""
        if len({*self.axes}) < len(self.axes) or not {"x", "z"} <= {*self.axes}:
            raise ValueError(
                f"the force's axes are {', '.join(self.axes) or 'none'}; x, forward, and z, up, "
                "are expected"
            )
        expected = (len(self.position), len(self.axes))
        if self.force.shape != expected:
            raise ValueError(f"force has shape {self.force.shape}, expected {expected}")
        if self.coordinate not in _UNITS:
            raise ValueError(f"coordinate '{self.coordinate}' is not one of {sorted(_UNITS)}")
        if len(self.position) == 0:
            raise ValueError("there are no samples")
        if not (np.isfinite(self.position).all() and np.isfinite(self.force).all()):
            raise ValueError("positions and forces must be finite numbers")
        if np.any(np.diff(self.position) <= 0):
            raise ValueError("position must increase strictly")

    @property
    def theta_deg(self) -> FloatArray:
        """Leg angle [deg], shape [sample].

        Raises
        ------
        ValueError
            If the history is not a function of θ.
        """
        if self.coordinate != "theta":
            raise ValueError(f"this history is a function of {self.coordinate}, not of theta")
        return np.degrees(self.position)

    @property
    def Fx(self) -> FloatArray:
        """Forward force [N], shape [sample]."""
        return self.force[:, self.axes.index("x")]

    @property
    def Fz(self) -> FloatArray:
        """Vertical force, positive up [N], shape [sample]."""
        return self.force[:, self.axes.index("z")]

    def scaled(self, factor: float) -> ForceHistory:
        """Copy of this history with all forces multiplied by a factor [-]."""
        known = dict(self.provenance)
        if kept := known.get(_APPLIED):
            rest = {axis: (factor * np.array(kept[axis])).tolist() for axis in self._applied_axes}
            known[_APPLIED] = {**kept, **rest}
        return replace(self, force=self.force * factor, provenance=known)

    def applied(self) -> ForceHistory | None:
        """Forces that the leg applied to the soil, where its contact counts others.

        They are what the simulation kept beside the counted ones, means over a degree of a
        rotation, without what tells the two apart; ``None`` of any other contact, whose forces are
        the applied ones.
        """
        kept = self.provenance.get(_APPLIED)
        if kept is None:
            return None
        force = np.stack([kept[axis] for axis in self._applied_axes], axis=1)
        rest = {key: value for key, value in self.provenance.items() if key != _APPLIED}
        position = np.asarray(kept["position"], dtype=np.float64)
        return replace(self, position=position, force=force, provenance=rest)

    @property
    def _applied_axes(self) -> list[str]:
        return [f"{axis}_N" for axis in self.axes]

    def engaged(self, *, window_deg: float = WINDOW_DEG) -> ForceHistory:
        """Samples of this history within |θ| ≤ window [deg], the engaged window of the paper."""
        return self.between(-math.radians(window_deg), math.radians(window_deg))

    def between(self, low: float, high: float) -> ForceHistory:
        """Samples of this history at positions from low to high, in the unit of ``position``."""
        inside = between(self.position, low, high)
        return replace(self, position=self.position[inside], force=self.force[inside])

    def as_read_at(self, readings: FloatArray | None) -> ForceHistory:
        """Resample this history as a sensor with other reading angles would have recorded it.

        Window means of a record with a reading every few degrees are of lines between readings,
        and so are to be those of the curves that it is compared with.

        Parameters
        ----------
        readings
            Leg angles of that record [rad], increasing, shape [sample]; ``None`` leaves all as it
            is.

        Returns
        -------
        ForceHistory
            Its own samples between the first and the last reading if no gap between readings is
            wider than 0.5°. Otherwise one at each reading, the mean over its share of the path, of
            1° at most: what a reading averages over is not known, and few sensors read a point.
        """
        if readings is None:
            return self
        if not is_read_again(self.position, readings):
            return self.between(readings[0], readings[-1])
        seen = (readings >= self.position[0]) & (readings <= self.position[-1])
        force = self.means(readings[seen], 0.5 * shares(readings)[seen])
        return replace(self, position=readings[seen], force=force)

    def means(self, centre: FloatArray, half_width: float | FloatArray) -> FloatArray:
        """Mean forces over windows, by integrating the piecewise linear history.

        Parameters
        ----------
        centre
            Window centres in the unit of ``position``, shape [window].
        half_width
            Half the width of the windows, or of each, same unit; cut at the ends of the record.

        Returns
        -------
        ndarray
            [N], shape [window, axis].

        Raises
        ------
        ValueError
            If a window lies wholly outside the record.
        """
        from scipy.interpolate import make_interp_spline

        x = self.position
        low = np.maximum(centre - half_width, x[0])
        high = np.minimum(centre + half_width, x[-1])
        if np.any(high <= low):
            raise ValueError("a window lies outside the recorded range")
        integral = make_interp_spline(x, self.force, k=1).antiderivative()
        return np.asarray((integral(high) - integral(low)) / (high - low)[:, None])

    def observation(self, *, angles: int = OBSERVATION_ANGLES) -> Observation:
        """Observation vector of the paper: M means over |θ| ≤ window.

        Parameters
        ----------
        angles
            M; the angles are ``linspace(-window, window, M)``.

        Returns
        -------
        Observation

        Raises
        ------
        InputError
            If the record does not cover the window, has a wide gap in it, fewer angles than
            there are windows, or no force at all.
        """
        theta_deg = np.linspace(-WINDOW_DEG, WINDOW_DEG, angles)
        half_deg = WINDOW_DEG / (angles - 1)
        self._check_window(half_deg, angles)
        force = self.means(np.radians(theta_deg), math.radians(half_deg))
        fx, fz = force[:, self.axes.index("x")], force[:, self.axes.index("z")]
        return Observation(theta_deg, fx, fz)

    def _check_window(self, slack_deg: float, fewest: int) -> None:
        """Refuse too few readings, or too far apart, for window means, and no force.

        From fewer readings than means these are of lines between readings, and tell less than they
        seem to. A record may stop ``slack_deg`` short of the window's ends.
        """
        file = f"{self.provenance['file']}: " if "file" in self.provenance else ""
        theta_deg, window_deg = self.theta_deg, WINDOW_DEG
        # Angles a record's step short of the window's end still leave half a mean to take.
        if max(theta_deg[0] + window_deg, window_deg - theta_deg[-1]) > 0.999 * slack_deg:
            raise InputError(
                f"{file}theta covers {theta_deg[0]:.1f} to {theta_deg[-1]:.1f} deg, but the whole "
                f"window -{window_deg:g} to {window_deg:g} deg is needed"
            )
        inside = np.abs(theta_deg) <= window_deg
        if inside.sum() < fewest:
            raise InputError(
                f"{file}only {inside.sum()} angles lie within |theta| <= {window_deg:g} deg, "
                f"at least {fewest} are needed, one for each window mean"
            )
        gaps = np.diff(np.clip(theta_deg, -window_deg, window_deg))
        if gaps.max() > WIDEST_GAP_DEG:
            at = int(gaps.argmax())
            low, high = theta_deg[at : at + 2]
            raise InputError(
                f"{file}no angle between {low:.1f} and {high:.1f} deg; gaps of up to "
                f"{WIDEST_GAP_DEG:g} deg are accepted"
            )
        for axis, name in zip(self.force.T, self.axes, strict=True):
            if not np.any(axis[inside]):
                raise InputError(
                    f"{file}F{name} is zero at every angle within |theta| <= {window_deg:g} deg; "
                    "is the sensor connected?"
                )

    def peaks(self) -> Peaks:
        """Peak thrust and lift on 1° means at whole degrees within |θ| ≤ window [deg].

        On a plateau, its first angle.

        Raises
        ------
        ValueError
            If the history has no whole degree within the window.
        """
        theta = np.arange(-WINDOW_DEG, WINDOW_DEG + 0.5)
        theta = theta[(theta >= self.theta_deg[0]) & (theta <= self.theta_deg[-1])]
        if theta.size == 0:
            raise ValueError(f"the history has no whole degree within ±{WINDOW_DEG:g} deg")
        force = self.means(np.radians(theta), math.radians(0.5))
        x, z = self.axes.index("x"), self.axes.index("z")
        # The first of those that differ by round-off alone, on a plateau of rounded readings.
        slack = 1e-9 * np.abs(force).max(axis=0)
        at = (force >= force.max(axis=0) - slack).argmax(axis=0)
        at_x, at_z = int(at[x]), int(at[z])
        return Peaks(
            float(force[at_x, x]), float(force[at_z, z]), float(theta[at_x]), float(theta[at_z])
        )

    def summary(self) -> dict[str, Any]:
        """Peaks and provenance for people, JSON-able."""
        known = self.provenance
        shown: dict[str, Any] = {"samples": len(self.position), "coordinate": self.coordinate}
        try:
            peaks = self.peaks()
        except ValueError:  # no function of θ, or none within the window
            largest = np.abs(self.force).argmax(axis=0)
            for i, axis in enumerate(self.axes):
                shown[f"peak_F{axis}_N"] = float(self.force[largest[i], i])
        else:
            shown |= {
                "peak_Fx_N": peaks.Fx,
                "theta_peak_Fx_deg": peaks.theta_Fx_deg,
                "peak_Fz_N": peaks.Fz,
                "theta_peak_Fz_deg": peaks.theta_Fz_deg,
            }
        if (applied := self.applied()) is not None:
            peaks_of = applied.summary()
            shown |= {f"applied_peak_F{axis}_N": peaks_of[f"peak_F{axis}_N"] for axis in self.axes}
        return shown | {key: known[key] for key in _SHOWN if key in known}

    # -- files -----------------------------------------------------------------------------------

    @classmethod
    def from_csv(cls, path: Path | str) -> ForceHistory:
        """Read a CSV with exactly the columns ``theta_deg,Fx_N,Fz_N``.

        Parameters
        ----------
        path
            The file, a pipe, or ``-`` for standard input.

        Returns
        -------
        ForceHistory

        Raises
        ------
        InputError
            If anything is wrong with the file; the message names the line.
        """
        values, provenance = read_force_table(Path(path))
        name = "standard input" if str(path) == "-" else Path(path).name
        known = {**provenance, "file": name}
        return cls(np.radians(values[:, 0]), values[:, 1:].copy(), provenance=known)

    def to_csv(self, path: Path | str) -> None:
        """Write ``theta_deg,Fx_N,Fz_N``, and the provenance in a comment before it.

        Raises InputError if the place cannot be written.
        """
        known = {key: value for key, value in self.provenance.items() if key != "file"}
        write_force_table(Path(path), np.stack([self.theta_deg, self.Fx, self.Fz], axis=1), known)

    def to_netcdf(self, path: Path | str) -> None:
        """Write a self-describing NetCDF-4; raises InputError if the place cannot be written."""
        import xarray as xr

        angular = self.coordinate == "theta"
        name = "theta_deg" if angular else self.coordinate
        values = self.theta_deg if angular else self.position
        unit = "degree" if angular else _UNITS[self.coordinate]
        exact = {"theta": (name, self.position, {"units": "rad"})} if angular else {}
        dataset = xr.Dataset(
            {
                f"F{axis}": (name, self.force[:, i], {"units": "N", "long_name": f"force, {axis}"})
                for i, axis in enumerate(self.axes)
            },
            coords={name: (name, values, {"units": unit}), **exact},
            attrs={
                "terraphi_file": "force history",
                "terraphi_schema": SCHEMA,
                "coordinate": self.coordinate,
                "provenance": json.dumps(dict(self.provenance)),
            },
        )
        packing = {name: {"zlib": True, "shuffle": True} for name in dataset.variables}
        write_netcdf(dataset, Path(path), encoding=packing)

    @classmethod
    def from_netcdf(cls, path: Path | str) -> ForceHistory:
        """Read a history that :meth:`to_netcdf` wrote.

        Parameters
        ----------
        path
            The file.

        Returns
        -------
        ForceHistory

        Raises
        ------
        InputError
            If the file is not a whole NetCDF of this kind and schema.
        """
        dataset = open_netcdf(Path(path), kind="force history", schema=SCHEMA)
        try:
            axes = tuple(str(key)[1:] for key in dataset.data_vars)
            columns = [np.asarray(dataset[f"F{a}"].values, dtype=np.float64) for a in axes]
            return cls(
                positions(dataset),
                np.stack(columns, axis=1) if columns else np.empty((0, 0)),
                str(dataset.attrs["coordinate"]),
                axes,
                dict(json.loads(dataset.attrs["provenance"])),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{path}: not as terraphi writes a force history ({error}); make it again"
            ) from error


WIDEST_GAP_DEG = 20.0
"""Widest gap between readings within the window [deg]."""
DENSE_DEG = 0.5
"""Widest gap between readings at which window means equal those of the whole curve [deg]."""
READING_DEG = 1.0
"""Largest part of the path that one reading stands for [deg]."""


def is_dense(readings: FloatArray) -> bool:
    """Whether window means of a record read at these angles [rad] are those of the whole curve."""
    # Degrees turned to radians and back may be off by a rounding error.
    return bool(np.degrees(np.diff(readings).max()) <= DENSE_DEG + 1e-9)


def between(position: FloatArray, low: float, high: float) -> NDArray[np.bool_]:
    """Mask of the positions from low to high, both included; all in one unit, shape [sample]."""
    # Degrees turned to radians and back may miss an end by a rounding error.
    slack = 1e-9 * (1.0 + np.abs(position))
    return np.asarray((position >= low - slack) & (position <= high + slack))


def is_read_again(position: FloatArray, readings: FloatArray) -> bool:
    """Whether curves must be resampled to be compared with a record of these readings.

    Parameters
    ----------
    position, readings
        Leg angles [rad], increasing, shape [sample] each.
    """
    own = position[between(position, readings[0], readings[-1])]
    return not (is_dense(readings) or np.array_equal(own, readings))


def shares(readings: FloatArray) -> FloatArray:
    """Part of the path that each reading stands for [rad], shape [sample].

    As far as the nearer neighbour, and 1° at most: what a reading averages over is not known, and
    few sensors read a point.

    Parameters
    ----------
    readings
        Leg angles [rad], increasing, shape [sample].
    """
    gaps = np.diff(readings)
    nearer = np.minimum(np.append(gaps, np.inf), np.append(np.inf, gaps))
    return np.minimum(nearer, np.radians(READING_DEG))
