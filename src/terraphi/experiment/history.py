"""Forces on a leg as a function of its angle.

Signs are those of Li et al. (2013): x forward, z up; ``Fz > 0`` lifts and ``Fx > 0`` thrusts
forward; the force is the soil's on the leg. Its moment about the hip is positive where it drives
the leg on, in the direction of increasing θ.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import BaseModel, Json

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import NetcdfFile
from terraphi.experiment.results import Result, Variable, read
from terraphi.experiment.tables import write_force_table
from terraphi.experiment.units import FORCE

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

WINDOW_DEG = 85.0
"""Half width of the engaged window of the paper [deg]."""
OBSERVATION_ANGLES = 40
"""Number M of angles in the paper's observation vector."""
WIDEST_GAP_DEG = 20.0
"""Widest gap between readings within the window [deg]."""
_SHOWN = (
    *("scenario_hash", "model_version", "particles", "steps", "momentum_mismatch", "momentum"),
    *("counted_impulse_kg_m_s", "applied_impulse_kg_m_s", "seconds"),
)
"""What the summary shows of the provenance."""
FORCES = ("Fx", "Fz")
"""Channels of a history that has both forces."""
CHANNEL_UNITS = {"Fx": "N", "Fz": "N", "M": "N m"}
"""Unit of each channel."""
_UNITS = {"theta": "rad", "displacement": "m", "time": "s"}
COORDINATES = tuple(
    Variable(name, "position", unit, coordinate=True, optional=True)
    for name, unit in {"theta_deg": "degree", **_UNITS}.items()
)
"""Positions of readings in files."""
_SHOWN_IN = {"theta": (180.0 / math.pi, "deg"), "displacement": (1e3, "mm"), "time": (1.0, "s")}


COARSE, SPIKES = 0.01, 0.05
"""Step of readings from which on it counts, of peak-to-peak [-], and share of the readings that has
to differ from the median by it [-]; chosen."""


def resolution(values: FloatArray) -> float:
    """Step of which all differences of readings are multiples; 0 if there is none, or a fine one.

    Parameters
    ----------
    values
        Of one channel, shape [sample].
    """
    steps = np.abs(np.diff(values))
    least = COARSE * float(np.ptp(values))
    step = float(min(steps[steps > 1e-3 * least], default=0.0))
    multiples = steps / max(step, 1e-300)
    if step <= least or not np.allclose(multiples, multiples.round(), atol=0.02):
        return 0.0
    # A spike of a thousand times the forces rounds the others to one level.
    levels = np.round((values - np.median(values)) / step)
    return step if np.count_nonzero(levels) > SPIKES * levels.size else 0.0


def force_label(channel: str) -> str:
    """Label of an axis that shows a channel of a force history."""
    symbol = "$M$" if channel == "M" else f"$F_{channel[1]}$"
    return f"{symbol} [{CHANNEL_UNITS[channel]}]"


def force_variables(dims: str, **options: Any) -> tuple[Variable, ...]:
    """Variables of files with forces and the moment, over dimensions."""
    units = {"Fx": "N", "Fy": "N", "Fz": "N", "M": "N m"}
    return tuple(Variable(n, dims, unit, optional=True, **options) for n, unit in units.items())


def positions(values: Mapping[str, Any], coordinate: str) -> FloatArray:
    """Positions [rad or m or s] among the variables of a file; of θ degrees alone will do.

    Raises ValueError if there are none.
    """
    if values.get(coordinate) is not None:
        return np.asarray(values[coordinate])
    if coordinate == "theta" and values["theta_deg"] is not None:
        return np.radians(values["theta_deg"])
    raise ValueError(f"no variable '{coordinate}'")


class ProvenanceSchema(BaseModel, strict=True, extra="allow"):
    """Types of those entries of a history's provenance that are read back."""

    file: str = ""
    measurement: str = ""
    reading: list[str] = []
    resolution: dict[str, float] = {}
    columns: dict[str, bool | int | float | str] = {}
    force_unit: Literal[*FORCE] = "N"  # type: ignore[valid-type]
    scenario: dict[str, Any] | None = None


class HistoryAttributes(BaseModel):
    """Attributes of a file of ours with a history."""

    coordinate: Literal["theta", "displacement", "time"]
    provenance: Json[ProvenanceSchema]


class Peaks(NamedTuple):
    """Largest forces of a history, taken on 1° means."""

    Fx: float
    """Peak forward thrust [N]."""
    Fz: float
    """Peak lift [N]."""
    theta_Fx_deg: float
    """Angle of the peak thrust [deg]."""
    theta_Fz_deg: float
    """Angle of the peak lift [deg]."""


def window_means(
    x: FloatArray, values: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Means over windows from low to high of readings at x, [..., reading] -> [..., window].

    Readings are joined by lines: a mean is the integral of these over the width of the window.
    """
    steps, ends = np.diff(x), np.stack([low, high])
    passed = np.cumsum(0.5 * (values[..., 1:] + values[..., :-1]) * steps, axis=-1)
    passed = np.concatenate([np.zeros_like(values[..., :1]), passed], axis=-1)
    # Integral from the first reading to each end: of whole intervals, and of a part of one.
    i = np.clip(np.searchsorted(x, ends, side="right") - 1, 0, x.size - 2)
    part, slope = ends - x[i], (values[..., i + 1] - values[..., i]) / steps[i]
    integral = passed[..., i] + part * (values[..., i] + 0.5 * part * slope)
    return np.asarray((integral[..., 1, :] - integral[..., 0, :]) / (high - low))


def window_weights(x: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Weights of readings at x in :func:`window_means`, shape [window, reading]."""
    width, rows, ends = np.diff(x), np.arange(low.size), []
    trapezoids = 0.5 * (np.append(0.0, width) + np.append(width, 0.0))
    for end in (low, high):
        # Integral from the first reading: trapezoids up to reading i, and of the interval of width
        # h after it the part p, in which the hat of i has h (p − p²/2), that of i + 1 h p²/2.
        i = np.clip(np.searchsorted(x, end, side="right") - 1, 0, x.size - 2)
        h, p = width[i], (end - x[i]) / width[i]
        weights = np.where(np.arange(x.size) <= i[:, None], trapezoids, 0.0)
        weights[rows, i] += h * (p - 0.5 * p**2) - 0.5 * h
        weights[rows, i + 1] += 0.5 * h * p**2
        ends.append(weights)
    return np.asarray((ends[1] - ends[0]) / (high - low)[:, None])


@dataclass(frozen=True, repr=False)
class ForceHistory(Result):
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
        Names of the force's axes: ``x``, forward, and ``z``, up, unless the moment is known, and
        others.
    provenance
        Where the history comes from: scenario, hash, versions, seed, timings; JSON-able.
    moment
        Moment of the force about the hip [N m], positive in the direction of increasing θ, shape
        [sample]; ``None`` if it is not known.

    Examples
    --------
    >>> import numpy as np
    >>> theta = np.radians(np.arange(-85.0, 86.0))
    >>> force = np.stack([8.0 * np.cos(theta), 12.0 * np.cos(theta)], axis=1)
    >>> terraphi.ForceHistory(theta, force)
    ForceHistory(171 samples, theta -85 to 85 deg, Fx 0.697 to 8 N, Fz 1.05 to 12 N)
    """

    KIND = "force history"
    SCHEMA = 1
    ATTRIBUTES = HistoryAttributes
    VARIABLES = (*COORDINATES, *force_variables("position"))
    REMEDY = "; give other forces as a CSV of theta_deg, Fx_N, Fz_N"

    position: FloatArray
    force: FloatArray
    coordinate: str = "theta"
    axes: tuple[str, ...] = ("x", "z")
    provenance: Mapping[str, Any] = field(default_factory=dict)
    moment: FloatArray | None = None

    def __post_init__(self) -> None:
        """Raise ValueError if axes, shapes or order are wrong."""
        for name in ("position", "force", "moment"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, np.asarray(getattr(self, name)))
        size = len(self.position)
        lacking = not {"x", "z"} <= {*self.axes} and self.moment is None
        if len({*self.axes}) < len(self.axes) or lacking:
            raise ValueError(f"axes {', '.join(self.axes) or 'none'}; x and z are expected")
        if self.coordinate not in _UNITS:
            raise ValueError(f"coordinate '{self.coordinate}' is not one of {sorted(_UNITS)}")
        expected = {"force": (size, len(self.axes)), "moment": (size,)}
        for name, shape in expected.items():
            values = getattr(self, name)
            if values is not None and values.shape != shape:
                raise ValueError(f"{name} has shape {values.shape}, expected {shape}")
            if values is not None and not np.isfinite(values).all():
                raise ValueError(f"{name} must be finite numbers")
        if not size or not np.isfinite(self.position).all() or np.any(np.diff(self.position) <= 0):
            raise ValueError("position must be finite numbers that increase, one or more")

    @property
    def theta_deg(self) -> FloatArray:
        """Leg angle [deg], shape [sample]; raises ValueError if there is none."""
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

    @property
    def channels(self) -> tuple[str, ...]:
        """What there is for a comparison: Fx and Fz, or one of them and M, or M alone."""
        forces = tuple(f"F{axis}" for axis in "xz" if axis in self.axes)
        return forces if len(forces) == 2 else (*forces, "M")

    def channel(self, name: str) -> FloatArray:
        """Fx [N], Fz [N] or the moment M [N m], shape [sample]."""
        if name == "M" and self.moment is not None:
            return self.moment
        return self.force[:, self.axes.index(name[1:])]

    # -- copies ----------------------------------------------------------------------------------

    def scaled(self, factor: float) -> ForceHistory:
        """Copy of this history with all forces and moments multiplied by a factor [-]."""
        origin = {key: value for key, value in self.provenance.items() if key != "applied_force"}
        moment = None if self.moment is None else factor * self.moment
        return replace(self, provenance=origin, force=factor * self.force, moment=moment)

    def chosen(self, mask: BoolArray) -> ForceHistory:
        """Samples that a mask chooses, shape [sample]."""
        moment = None if self.moment is None else self.moment[mask]
        return replace(self, position=self.position[mask], force=self.force[mask], moment=moment)

    def applied(self) -> ForceHistory | None:
        """Forces that the leg applied to the soil, where its contact counts others.

        Means over a degree of a rotation; ``None`` of any contact but ``unbalanced``.
        """
        kept = self.provenance.get("applied_force")
        if kept is None:
            return None
        force = np.stack([kept[f"{axis}_N"] for axis in self.axes], axis=1).astype(np.float64)
        return ForceHistory(np.array(kept["position"]), force, self.coordinate, self.axes)

    def between(self, low: float, high: float) -> ForceHistory:
        """Samples at positions from low to high, both included, in the unit of ``position``."""
        # Degrees turned to radians and back may be off by a rounding error.
        slack = 1e-9 * (1.0 + np.abs(self.position))
        return self.chosen((self.position >= low - slack) & (self.position <= high + slack))

    # -- means -----------------------------------------------------------------------------------

    def means(self, centre: FloatArray, half_width: float | FloatArray) -> FloatArray:
        """Means of the force over windows, by :func:`window_means`.

        Parameters
        ----------
        centre
            Window centers in the unit of ``position``, shape [window].
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
        x = self.position
        low, high = np.maximum(centre - half_width, x[0]), np.minimum(centre + half_width, x[-1])
        if np.any(high <= low):
            raise ValueError("a window lies outside the recorded range")
        return window_means(x, self.force.T, low, high).T

    def peaks(self) -> Peaks:
        """Peak thrust and lift on 1° means at whole degrees within |θ| ≤ window [deg].

        On a plateau, its first angle. Raises ValueError if there is no whole degree in the window,
        or a force is missing.
        """
        if self.channels != FORCES:
            raise ValueError("a force is missing")
        theta = np.arange(-WINDOW_DEG, WINDOW_DEG + 0.5)
        theta = theta[(theta >= self.theta_deg[0]) & (theta <= self.theta_deg[-1])]
        if theta.size == 0:
            raise ValueError(f"the history has no whole degree within ±{WINDOW_DEG:g} deg")
        force = self.means(np.radians(theta), math.radians(0.5))
        force = force[:, [self.axes.index("x"), self.axes.index("z")]]
        # The first of those that differ by round-off alone.
        slack = 1e-9 * np.abs(force).max(axis=0)
        first = (force >= force.max(axis=0) - slack).argmax(axis=0)
        return Peaks(*force[first, [0, 1]].tolist(), *theta[first].tolist())

    def summary(self) -> dict[str, Any]:
        """Peaks and provenance, JSON-able."""
        shown: dict[str, Any] = {"samples": len(self.position), "coordinate": self.coordinate}
        try:
            peaks = self.peaks()
            shown |= {"peak_Fx_N": peaks.Fx, "theta_peak_Fx_deg": peaks.theta_Fx_deg}
            shown |= {"peak_Fz_N": peaks.Fz, "theta_peak_Fz_deg": peaks.theta_Fz_deg}
        except ValueError:  # no function of θ, or none within the window
            for name in self.channels:
                values, unit = self.channel(name), CHANNEL_UNITS[name].replace(" ", "")
                shown[f"peak_{name}_{unit}"] = float(values[np.abs(values).argmax()])
        return shown | {key: self.provenance[key] for key in _SHOWN if key in self.provenance}

    def _lines(self) -> list[str]:
        scale, unit = _SHOWN_IN[self.coordinate]
        low, high = scale * self.position[[0, -1]]
        forces = ", ".join(
            f"{name} {self.channel(name).min():.3g} to {self.channel(name).max():.3g}"
            f" {CHANNEL_UNITS[name]}"
            for name in self.channels
        )
        along = f"{self.coordinate} {low:.4g} to {high:.4g} {unit}"
        return [f"ForceHistory({len(self.position)} samples, {along}, {forces})"]

    def plot(self, figure: Figure | None = None) -> Figure:
        """Forces along the path, as a Matplotlib figure.

        Parameters
        ----------
        figure
            Where to draw; ``None`` makes a figure. One that has panels gets another curve in each.
        """
        from terraphi.experiment.figure import Figure as NewFigure

        figure = figure or NewFigure(figsize=(8.0, 3.0), layout="constrained")
        panels = figure.axes or figure.subplots(1, len(self.channels), squeeze=False)[0]
        scale, unit = _SHOWN_IN[self.coordinate]
        names = {"theta": "leg angle θ"}
        for axes, name in zip(panels, self.channels, strict=True):
            axes.plot(scale * self.position, self.channel(name))
            axes.set_xlabel(f"{names.get(self.coordinate, self.coordinate)} [{unit}]")
            axes.set_ylabel(force_label(name))
        return figure

    # -- files -----------------------------------------------------------------------------------

    def to_csv(self, path: Path | str) -> None:
        """Write ``theta_deg,Fx_N,Fz_N``, and the provenance in a comment before it.

        Raises InputError if the place cannot be written, or a force is missing.
        """
        if self.channels != FORCES:
            raise InputError(f"{path}: Fx and Fz are needed; write NetCDF (to_netcdf) instead")
        left_out = ("file", "reading", "force_unit", "columns")
        origin = {key: value for key, value in self.provenance.items() if key not in left_out}
        write_force_table(Path(path), np.stack([self.theta_deg, self.Fx, self.Fz], axis=1), origin)

    def _variables(self) -> dict[str, Any]:
        theta_deg = self.theta_deg if self.coordinate == "theta" else None
        forces = {f"F{axis}": values for axis, values in zip(self.axes, self.force.T, strict=True)}
        return forces | {
            self.coordinate: self.position, "theta_deg": theta_deg, "M": self.moment
        }  # fmt: skip

    def to_xarray(self) -> xr.Dataset:
        """Forces over θ in degrees, or over the displacement or time, as in the NetCDF."""
        dim = "theta_deg" if self.coordinate == "theta" else self.coordinate
        return super().to_xarray().swap_dims(position=dim)

    @classmethod
    def _of_file(cls, file: NetcdfFile[HistoryAttributes]) -> Self:
        values, coordinate = read(file, cls.VARIABLES), file.attrs.coordinate
        position = positions(values, coordinate)
        axes = tuple(axis for axis in "xyz" if values[f"F{axis}"] is not None)
        nothing = np.empty((len(position), 0))
        force = np.column_stack([nothing, *(values[f"F{axis}"] for axis in axes)])
        origin = file.attrs.provenance.model_dump(exclude_unset=True)
        return cls(position, force, coordinate, axes, origin, values["M"])
