"""φ under every footfall of a walk, and along its path: the answer, and its files."""

from __future__ import annotations

import importlib.metadata
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, BaseModel, Field, Json

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.errors import needing
from terraphi.experiment.files import NetcdfFile, atomic_files, atomic_write
from terraphi.experiment.outputs import SIGNATURE
from terraphi.experiment.priors import ATTITUDE_SD_DEG
from terraphi.experiment.results import Result, Variable
from terraphi.experiment.tables import write_csv
from terraphi.inference import grounds
from terraphi.inference.pool import MOST, Anchor, Normal, Observed, Pooled, pool
from terraphi.inference.records import density_warnings
from terraphi.inference.terms import TERMS
from terraphi.inference.touchdowns import (
    FEWEST,
    MOST_FITTED,
    PHI_RANGE,
    Fit,
    Prior,
    Touchdowns,
    evenly,
    fit,
    learn_exponent,
    learn_level,
    picked,
    sampled,
)
from terraphi.laws.foot import DEEPEST, LAWS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

USABLE = "usable"
SHALLOW, MISFIT = "too little sinkage", "the law does not fit"
TRODDEN, PRINT = "not virgin ground", "print of a fore foot"
TORN, SATURATED, EDGE = "timing unreliable", "saturated", "at a prior's edge"
FAULTY = "log contradicts the robot"
ELASTIC, CRUST, HARD = "ground springs back", "a crust broke", "hard ground below"
TILTED = "sole tilted"
NO_ANGLE = "no friction angle"
VERDICTS = (
    USABLE, SHALLOW, ELASTIC, NO_ANGLE, CRUST, HARD, TILTED, PRINT, TRODDEN, MISFIT, TORN,
    SATURATED, EDGE, FAULTY,
)  # fmt: skip
"""Verdicts of footfalls."""

LEAST_GAINED = 0.003
"""Way down that a footfall needs while the force rises from a sixth to five sixths [m]: on hard
ground a force comes without, and what creeps under a full load is no loading. Where the force grows
with the depth to the power of 1.7, it is half of a sinkage of 6 mm (hard ground in
``examples/sand_check.py`` has no usable footfall)."""
NEAR_RADII, BESIDE_RADII, BESIDE_SD_DEG = 1.5, 3.0, 1.5
"""Distances from an earlier footfall, in radii [-]: ground nearer than the first has been trodden,
ground nearer than the second has been moved, which adds a standard deviation to φ [deg]. In
simulated grains balls of 44 mm read φ + 7.9° in their own print, + 3.5° at one radius from it, +
0.5° at 1.5 and −0.9 to + 1.5° from 2 to 3."""
FAIR_MISFIT, WORST_MISFIT, MISFIT_SDS = 2.0, 6.0, 2.5
"""χ² over the degrees of freedom below which a law fits, above which it does not, and between both
how many standard deviations of ln χ² a footfall may lie above the median of its walk [-]. By the
right law it is 0.1 to 0.4; in uniform sand of another law the median is 0.5 to 2.6 and ln χ²
scatters by 0.6, without a relation to the error of φ. The scatter is that of the better half."""
MOST_TROUBLED = 0.25
"""Part of the feet under which a crust, hard ground or an edge of φ shows, from which on a walk's
misfits are no measure of what is usual [-]: 0.67 on a track that was walked before, 0.05 on sand of
four laws."""
MOST_RETURNED, WALK_RETURNED = 0.35, 0.15
"""Work that the ground gives back at the end of a stance over what the loading put in, above which
a footfall is on elastic ground, and the median above which a whole walk is [-]. Elastic ground
returns all of it, soil what its grains spring back. On simulated sand (six worlds, five gaits)
usable footfalls have 0.2 at most and walks a median of 0.01 to 0.06; mats of 2 to 10 kN/m and two
foams 0.6 to 1.6, and medians of 0.9 to 1.3. The limits are between; a mat of 3 kN/m and a foam that
nearly only creeps, tried afterwards, had medians of 1.0 and 1.4."""
MOST_BROKEN, WALK_BROKEN = 0.4, 0.15
"""Part of the force that is lost while a foot goes deeper, above which it broke through a crust,
and the median above which a walk is on a crust [-]. 80 walks on simulated sand: 0.34 at most and
medians of 0; by Hansen's formula, whose resistance falls at a depth of one breadth, medians of 0.1.
Crusts that break at 25, 40 and 60 N: medians of 0.2, 0.3 to 0.5 and 0.6 to 0.7."""
MOST_BORNE, DEEPER_M, MOST_DEEPER = 1.2, 0.003, 0.2
"""Force that the ground bears at the deepest point of a stance, over what the law that fits the
loading gives there, above which something hard lies below [-], if no more than a part of the feet
[-] go deeper by so much [m]. On simulated sand of the assumed law and others one of about 2,500
usable footfalls has 1.4, the others 1.07 at most; on a hard layer under 20 to 30 mm of sand the
median of a walk is 1.2, where its feet reach it."""
MOST_MISFITS = 0.2
"""Part of the footfalls that the law does not fit, compared with their walk, above which there is a
warning [-]: 2 % in sand of Archimedes' law, 35 and 52 % of two trots on a track that was walked
before (``examples/sand_check.py``)."""
SLOW_GROWTH = -0.35
"""Exponent of a walk, by law ``foot``, below which forces grow slower with depth than those of dry
sand that is stepped on slowly [-]: −0.1 to 0.1 on simulated dry sand, −0.18 in grains, −0.31 on
that of ``depth^0.7``; −0.38 and −0.43 in sand of a cohesion of 200 Pa, which reads 7 to 8° high,
and −0.36 to −0.45 on that of Meyerhof's formula, which does too."""
GAP_M, GAP_FEET = 0.25, 3
"""Length of a stretch of the path [m], and refused footfalls on it, from which a warning names it;
chosen."""
FEWEST_TYPICAL = 5
"""Footfalls that a median of a walk needs (chosen)."""
BACK_M = 0.3
"""Distance of the trunk from its former path below which feet may tread in their own prints [m]: a
robot's width."""
SLOPE_LOSS, SLOPE_LOSS_SD = 2.3, 0.5
"""Logarithm of the upward force of level ground over that of ground inclined by β, over tan²β [-],
and its standard deviation as a part of it. Balls that sink vertically to one and a half radii have
2.6 to 2.9 in the material point method with gravity turned (φ of 29 and 36°, β of 10 and 20°), and
in two beds of loose grains 2.5 at 10 and 1.4 at 20°; 15 % less force at 10° is 5."""
INCLINED_SDS = 2.0
"""Standard deviations above which an inclination is noted [-]."""
CONTRADICTED = 2.0
"""Standard deviations from the rest above which an anchor is doubted [-]; one sound anchor in
twenty is."""
SECOND = {"rft": "foot"}
"""Law of a second opinion, for each law; else ``rft``, which has few terms and is fast."""
BETTER = 0.5
"""Probability of another law above which its φ is noted [-]."""
GREY = "0.4"
CI95 = 1.959964
"""Half-width of a normal 95 % interval over its standard deviation [-]; of a 68 % one it is 1."""
EARTH_RADIUS = 6_371_000.0
"""[m]."""
TOPIC, MESSAGE = "/terraphi/footfalls", "terraphi_msgs/msg/Footfall"
FIELDS = ("x_m", "y_m", "surface_m", "sinkage_m", "phi_deg", "ci68_low_deg", "ci68_high_deg",
          "ci95_low_deg", "ci95_high_deg", "relative_sd_deg")  # fmt: skip
"""Numbers of a message; φ and its absolute intervals are not a number where it was refused."""
LAST_STAMP = 2**31 - 1
"""Largest time of a ROS message [s]."""


class FootfallAttributes(BaseModel):
    """Attributes of a file of footfalls: fields of a map, as JSON."""

    shared: Json[dict[str, Any]]
    by_law: Json[dict[str, float]] = Field(alias="by_law_deg")
    warnings: Json[tuple[str, ...]] = Field(validation_alias=AliasChoices("warnings", "notes"))
    provenance: Json[dict[str, Any]]


@dataclass(frozen=True, repr=False)
class FootfallMap(Result):
    """φ under footfalls and along the path.

    Attributes
    ----------
    time
        Touch-downs on the log's clock [s], shape [footfall].
    foot
        Name of the foot, such as ``FR``, shape [footfall].
    place
        Where the foot ended its loading, from the trunk's first place: x along the robot's first
        heading, y to its left, z of the soil's surface [m], shape [footfall, 3].
    sinkage
        Depth of the foot's lowest point at the end of the loading [m], shape [footfall]; where it
        was too little, how far the foot went down under load.
    phi, sd, shared_sd
        φ of each footfall by itself, its standard deviation against the other footfalls and the
        one that it shares with them [deg], shape [footfall]; not a number where it was refused.
    misfit
        χ² over the degrees of freedom [-], shape [footfall].
    verdict
        One of :data:`VERDICTS`, shape [footfall].
    path
        Points of the path: s along it, x, y [m], shape [point, 3].
    path_phi, path_relative_sd, path_absolute_sd
        Map of φ on the path [deg], shape [point]; not a number if no footfall is usable.
    shared
        Errors shared by all footfalls, by name: mean, standard deviation and its share of φ's.
    by_law
        Mean φ of the usable footfalls by the law, and by a second one [deg].
    warnings
        A sentence each.
    provenance
        Log, robot, priors and versions.
    """

    KIND = "footfalls"
    SCHEMA = 2
    ATTRIBUTES = FootfallAttributes
    VARIABLES = (
        Variable("time_s", "footfall", "s", "touch-down", "time"),
        Variable("foot", "footfall", words=True),
        Variable("x_m", "footfall", "m", "along the first heading", "place", 0),
        Variable("y_m", "footfall", "m", "to its left", "place", 1),
        Variable("surface_m", "footfall", "m", "level of the surface", "place", 2),
        Variable("sinkage_m", "footfall", "m", "depth of the foot at the end of the loading",
                 "sinkage", holes=True),
        Variable("phi_deg", "footfall", "degree", "friction angle, by this footfall alone",
                 "phi", holes=True),
        Variable("absolute_sd_deg", "footfall", "degree", "standard deviation of phi_deg, absolute",
                 "absolute_sd", derived=True),
        Variable("relative_sd_deg", "footfall", "degree",
                 "standard deviation, relative to the others",
                 "sd", holes=True),
        Variable("shared_sd_deg", "footfall", "degree", "that it shares with all footfalls",
                 "shared_sd", holes=True),
        Variable("verdict", "footfall", words=True),
        Variable("chi2", "footfall", "1", "chi squared over the degrees of freedom",
                 "misfit", holes=True),
        Variable("s_m", "point", "m", "along the path", "path", 0, coordinate=True),
        Variable("path_x_m", "point", "m", "along the first heading", "path", 1),
        Variable("path_y_m", "point", "m", "to its left", "path", 2),
        Variable("path_phi_deg", "point", "degree", "friction angle, footfalls pooled",
                 "path_phi", holes=True),
        Variable("path_relative_sd_deg", "point", "degree", "standard deviation, relative",
                 "path_relative_sd", holes=True),
        Variable("path_absolute_sd_deg", "point", "degree", "standard deviation, absolute",
                 "path_absolute_sd", holes=True),
    )  # fmt: skip

    time: FloatArray
    foot: tuple[str, ...]
    place: FloatArray
    sinkage: FloatArray
    phi: FloatArray
    sd: FloatArray
    shared_sd: FloatArray
    misfit: FloatArray
    verdict: tuple[str, ...]
    path: FloatArray
    path_phi: FloatArray
    path_relative_sd: FloatArray
    path_absolute_sd: FloatArray
    shared: Mapping[str, Any]
    by_law: Mapping[str, float]
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def usable(self) -> BoolArray:
        """Mask of the footfalls that determine φ, shape [footfall]."""
        return np.array([verdict == USABLE for verdict in self.verdict], dtype=bool)

    @property
    def absolute_sd(self) -> FloatArray:
        """Standard deviation of φ of each footfall, with all that is shared [deg]."""
        return np.hypot(self.sd, self.shared_sd)

    def counts(self) -> dict[str, int]:
        """Footfalls by verdict, those that occur."""
        return {v: self.verdict.count(v) for v in VERDICTS if v in self.verdict}

    def summary(self) -> pd.DataFrame:
        """A row for each footfall, as in the CSV of ``terraphi footfalls --out``."""
        return self._frame("footfall").rename(columns={"time_s": "t_s"}).drop(columns="chi2")

    def as_dict(self) -> dict[str, Any]:
        """Answer as ``terraphi footfalls --json`` prints it; null where there is no number.

        ``phi_deg`` of a footfall holds its absolute bands, ``phi_relative_deg`` those against the
        other footfalls of the walk, without what soil, foot, law and sensors add to all of them.
        """
        x, y, surface = self.place.T
        columns = {
            "t_s": _numbers(self.time), "foot": self.foot, "x_m": _numbers(x), "y_m": _numbers(y),
            "surface_mm": _numbers(1e3 * surface, 2), "sinkage_mm": _numbers(1e3 * self.sinkage, 2),
            "phi_deg": _each(self.phi, self.absolute_sd),
            "phi_relative_deg": _each(self.phi, self.sd),
            "chi2": _numbers(self.misfit), "verdict": self.verdict,
        }  # fmt: skip
        path = dict(zip(("s_m", "x_m", "y_m"), map(_numbers, self.path.T), strict=True))
        bands = _bands(self.path_phi, self.path_relative_sd, "_relative")
        bands |= _bands(self.path_phi, self.path_absolute_sd, "_absolute")
        return {
            "law": self.provenance.get("law"),
            "counts": self.counts(),
            "footfalls": [
                dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)
            ],
            "path": {**path, "phi_deg": _numbers(self.path_phi), **bands},
            "shared": self.shared,
            "by_law_deg": dict(zip(self.by_law, _numbers(self.by_law.values()), strict=True)),
            "warnings": list(self.warnings),
        }

    def to_mcap(self, path: Path | str) -> None:
        """Write the footfalls as an MCAP file with the topic ``/terraphi/footfalls``.

        Foxglove opens it together with the robot's MCAP on one time line, that of recording. The
        messages are those of ROS 2, with the fields ``header``, ``foot``, ``verdict``, ``x_m``,
        ``y_m``, ``surface_m``, ``sinkage_m``, ``phi_deg``, ``ci68_low_deg`` and so on.

        Raises
        ------
        InputError
            If the place cannot be written, or the extra ``robot`` is missing.
        """
        with needing(f"{path}: writing MCAP", "mcap and rosbags", extra="robot"):
            from mcap.writer import CompressionType, Writer
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store: Any = get_typestore(Stores.ROS2_HUMBLE)
        text = "std_msgs/Header header\nstring foot\nstring verdict\n"
        text += "".join(f"float64 {name}\n" for name in FIELDS)
        store.register(get_types_from_msg(text, MESSAGE))
        definition, _ = store.generate_msgdef(MESSAGE, ros_version=2)
        log = self.provenance.get("forces", {}).get("log", {})
        recorded = log.get("recorded_ns", 0)
        bands = [
            self.phi + side * size * self.absolute_sd for size in (1.0, CI95) for side in (-1, 1)
        ]
        numbers = np.column_stack([self.place, self.sinkage, self.phi, *bands, self.sd])
        times = np.rint(1e9 * np.clip(self.time, 0.0, LAST_STAMP)).astype(np.int64).tolist()
        rows = zip(times, self.foot, self.verdict, numbers.tolist(), strict=True)
        content = io.BytesIO()
        writer: Any = Writer(content, compression=CompressionType.NONE)
        writer.start(profile="ros2", library=SIGNATURE)
        schema = writer.register_schema(MESSAGE, "ros2msg", definition.encode())
        channel = writer.register_channel(TOPIC, "cdr", schema)
        header, stamp = (
            store.types[name] for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")
        )
        for i, (time, foot, verdict, row) in enumerate(rows):
            stamped, when = (
                min(max(start + time, 0), LAST_STAMP * 10**9)
                for start in (log.get("start_ns", recorded), recorded)
            )
            at = header(stamp(*divmod(stamped, 10**9)), "")
            data = bytes(
                store.serialize_cdr(store.types[MESSAGE](at, foot, verdict, *row), MESSAGE)
            )
            writer.add_message(channel, when, data, when, i)
        writer.finish()
        with atomic_write(Path(path)) as temporary:
            temporary.write_bytes(content.getvalue())

    def to_netcdf(self, path: Path | str) -> None:
        """Write NetCDF-4, and a GeoJSON and a CSV of the same name next to it.

        Raises InputError if the place cannot be written.
        """
        path = Path(path)
        with atomic_files(path, path.parent, last=path.name) as made:
            place = made / path.name
            super().to_netcdf(place)
            features = json.dumps(self._geojson(), ensure_ascii=False)
            place.with_suffix(".geojson").write_text(features, encoding="utf-8")
            first = f"# {SIGNATURE}: footfalls; x, y from the robot's first place and heading\n"
            write_csv(place.with_suffix(".csv"), self.summary(), first=first, float_format="%.4f")

    def _geojson(self) -> dict[str, Any]:
        """Footfalls as points, metres east and north of (0°, 0°) as degrees."""
        degrees = self.place[:, :2] * 180.0 / (math.pi * EARTH_RADIUS)
        keys = ("t_s", "foot", "x_m", "y_m", "sinkage_mm", "phi_deg", "phi_relative_deg",
                "verdict")  # fmt: skip
        features = [
            {
                "type": "Feature",
                "geometry": {"type": "Point", "coordinates": _numbers(place, 9)},
                "properties": {key: entry[key] for key in keys},
            }
            for place, entry in zip(degrees, self.as_dict()["footfalls"], strict=True)
        ]
        about = (
            f"{SIGNATURE}; a log has no place on earth: x_m and y_m are metres from the robot's "
            "first place, and the coordinates the same as if that were longitude 0, latitude 0, "
            "heading east"
        )
        return {"type": "FeatureCollection", "about": about, "features": features}

    @classmethod
    def _of_file(cls, file: NetcdfFile[Any]) -> Self:
        """A map; raises ValueError if a verdict is unknown, or a usable footfall lacks φ."""
        walk = super()._of_file(file)
        if unknown := set(walk.verdict) - set(VERDICTS):
            raise ValueError(f"verdict {unknown.pop()!r}")
        pooled = walk.path_phi if walk.usable.any() else 0.0
        each = np.stack([walk.phi, walk.sd, walk.shared_sd])[:, walk.usable]
        if not (np.isfinite(each).all() and np.isfinite(pooled).all()):
            raise ValueError("a usable footfall has no phi_deg")
        return walk

    def plot(self) -> Figure:
        """Maps of φ and of its error, and φ along the path with both bands, by Matplotlib."""
        from matplotlib.layout_engine import ConstrainedLayoutEngine

        from terraphi.experiment.figure import Figure as NewFigure

        # Limits that follow the aspect change labels after their room is measured.
        figure = NewFigure(figsize=(11.0, 6.0), layout=ConstrainedLayoutEngine(w_pad=0.2))
        panels = figure.subplot_mosaic([["φ", "s"], ["±", "s"]], width_ratios=(1.1, 1.0))
        usable, (x, y) = self.usable, self.place[:, :2].T
        refused = int((~usable).sum())
        for name, values, along, label in (
            ("φ", self.phi, self.path_phi, "φ [deg]"),
            ("±", self.sd, self.path_relative_sd, "± of φ between places [deg]"),
        ):
            plan = panels[name]
            plan.scatter(x[~usable], y[~usable], marker="x", s=14, color=GREY, lw=0.8,
                         label=f"{refused} refused footfalls" if name == "φ" else "")  # fmt: skip
            if usable.any():
                shown = plan.scatter(
                    [*x[usable], *self.path[:, 1]], [*y[usable], *self.path[:, 2]],
                    [22] * int(usable.sum()) + [3] * len(along), [*values[usable], *along],
                )  # fmt: skip
                figure.colorbar(shown, ax=plan, label=label, shrink=0.9)
            plan.set(xlabel="x, along the first heading [m]", ylabel="y [m]")
            plan.set_aspect("equal", adjustable="datalim")
        panels["φ"].set_title(f"Footfalls ({int(usable.sum())} usable) and path")
        self._draw_course(panels["s"])
        figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize="small")
        return figure

    def _draw_course(self, axes: Axes) -> None:
        s, phi, usable = self.path[:, 0], self.path_phi, self.usable
        title = "φ along the path, 68 % bands"
        axes.set(xlabel="s, along the path [m]", ylabel="φ [deg]", title=title)
        if not usable.any():
            axes.text(0.5, 0.5, "no footfall is usable", transform=axes.transAxes, ha="center")
            return
        for sd, colour, alpha, label in (
            (self.path_absolute_sd, GREY, 0.2, "absolute: soil, foot and law uncertain"),
            (self.path_relative_sd, "C0", 0.35, "relative: between places"),
        ):
            axes.fill_between(s, phi - sd, phi + sd, color=colour, alpha=alpha, lw=0, label=label)
        axes.plot(s, phi, color="C0", lw=1.5)
        away = self.place[usable, None, :2] - self.path[:, 1:]  # [foot, point, 2]
        near = np.square(away).sum(axis=2).argmin(axis=1)
        # Feet tread ahead of the trunk and behind it: the path is continued along its ends.
        heading = np.gradient(self.path[:, 1:], s, axis=0) if s.size > 1 else np.eye(1, 2)
        at = s[near] + (away[np.arange(near.size), near] * heading[near]).sum(axis=1)
        axes.errorbar(
            at, self.phi[usable], self.sd[usable], fmt="o", ms=3, lw=0.6,
            color="C1", label="footfalls, usable", zorder=1, alpha=0.7,
        )  # fmt: skip

    def _lines(self) -> list[str]:
        counts = ", ".join(f"{n} {verdict}" for verdict, n in self.counts().items())
        lines = [f"{self.provenance.get('log', 'log')}: {len(self.verdict)} footfalls: {counts}"]
        if self.usable.any():
            mean, wide = self.path_phi.mean(), self.path_absolute_sd.mean()
            low, high = self.path_phi.min(), self.path_phi.max()
            lines.append(f"φ = {mean:.1f}° ± {wide:.1f}°, {low:.1f} to {high:.1f}° along the path")
        if self.warnings:
            lines.append(f"warnings in .warnings: {len(self.warnings)}")
        return lines

    _table = summary


def _numbers(values: Any, digits: int = 4) -> list[float | None]:
    return [round(float(v), digits) if math.isfinite(v) else None for v in values]


def _bands(phi: FloatArray, sd: FloatArray, kind: str = "") -> dict[str, list[Any]]:
    """Intervals of 68 and 95 %, by name."""
    return {
        f"{name}{kind}": [_numbers(ends) for ends in np.stack([phi - half, phi + half], axis=1)]
        for name, half in (("ci68", sd), ("ci95", CI95 * sd))
    }


def _each(phi: FloatArray, sd: FloatArray) -> list[dict[str, Any] | None]:
    """Median and intervals of each footfall; None where it was refused."""
    return [
        None if median is None else {"median": median, "ci68": inner, "ci95": outer}
        for median, inner, outer in zip(_numbers(phi), *_bands(phi, sd).values(), strict=True)
    ]


def infer(
    touchdowns: Touchdowns,
    torques: Normal,
    path: FloatArray,
    *,
    prior: Prior,
    law: str,
    anchors: Sequence[Anchor],
    feet: Sequence[str],
    notes: Sequence[str],
    provenance: Mapping[str, Any],
) -> FootfallMap:
    """Infer φ of the touch-downs of a walk and along its path.

    Parameters
    ----------
    touchdowns
        In the order of time.
    torques
        Errors of the joints' torques, in the order of
        :attr:`~terraphi.inference.touchdowns.Fit.shared`.
    path
        Points of the path: s along it, x, y [m], shape [point, 3].
    prior, law, anchors
        As of :func:`terraphi.footfalls`.
    feet
        Names of the feet.
    notes, provenance
        Warnings about the log, and its origin.
    """
    stretches = [anchor.stretch(path) for anchor in anchors]
    prior = with_growth(touchdowns, law, prior)
    fits = fit(touchdowns, law, prior)
    verdict, ground, laws = judged(touchdowns, fits, law, prior)
    usable, sinkage = verdict == USABLE, surface_depth(fits, verdict)
    place = touchdowns.place + np.outer(sinkage, [0.0, 0.0, 1.0])
    prior = (slope := inclination(place[~touchdowns.faulty])).added_to(prior)
    footfall_phi, path_phi = np.full((3, len(verdict)), np.nan), np.full((3, len(path)), np.nan)
    shared: dict[str, Any] = {}
    by_law: dict[str, float] = {}
    scale_sd, contradicted = prior.slope_sd, list[str]()
    if usable.any():
        sound = picked(touchdowns, usable)
        wide, (prior, sound_fits) = prior, _with_levels(touchdowns, sound, usable, law, prior)
        prior, second, sensitivity, scale_sd = _compare_laws(
            sound, sound_fits, law, prior, wide, laws
        )
        pooled = pool(
            Observed(sound_fits.phi, sound_fits.sd, sensitivity, sound.place[:, :2]),
            _shared_errors(torques, prior), path[:, 1:], list(zip(anchors, stretches, strict=True)),
            torques=len(torques.mean), mean=prior.phi_deg, mean_sd=prior.phi_sd_deg,
        )  # fmt: skip
        footfall_phi[:, usable] = pooled.phi, pooled.sd, pooled.shared_sd
        path_phi[:] = pooled.path_phi, pooled.path_relative_sd, pooled.path_absolute_sd
        shared = _shared_summary(pooled, prior)
        # The second law is shifted by what was learned about sensors and from anchors, too.
        learned = float((pooled.phi - sound_fits.phi).mean())
        by_law = {law: float(pooled.phi.mean())}
        by_law |= {name: float(phi.mean()) + learned for name, phi in second.items()}
        contradicted = _contradicted(anchors, pooled.surprise)
    warnings = [
        *ground, *_ground_notes(touchdowns, fits, verdict), *contradicted,
        *density_warnings(prior.density),
        *notes, *slope.notes(prior), *_limits_of_the_law(fits, usable, law, prior),
        *_limits_of_the_path(path, verdict, prior, scale_sd, anchored=bool(anchors)),
        *_gaps(path, touchdowns.place, verdict),
    ]  # fmt: skip
    return FootfallMap(
        time=touchdowns.begin,
        foot=tuple(feet[i] for i in touchdowns.foot),
        place=place,
        sinkage=sinkage,
        **dict(zip(("phi", "sd", "shared_sd"), footfall_phi, strict=True)),
        **dict(zip(("path_phi", "path_relative_sd", "path_absolute_sd"), path_phi, strict=True)),
        misfit=fits.misfit,
        verdict=tuple(verdict.tolist()),
        path=path,
        shared=shared,
        by_law=by_law,
        warnings=tuple(warnings),
        provenance={
            **provenance, "law": law, "law_hash": LAWS[law].hash, "prior": asdict(prior),
            "anchors": [anchor._asdict() for anchor in anchors],
            "terraphi": importlib.metadata.version("terraphi"),
        },
    )  # fmt: skip


def _contradicted(anchors: Sequence[Anchor], surprise: FloatArray) -> list[str]:
    """Warn of anchors that lie off the rest by some standard deviations."""
    return [
        f"the anchor of {anchor.phi_deg:g} ± {anchor.sd_deg:g}° is {off:.1f} standard "
        "deviations off φ by the footfalls, the law and other anchors: check it"
        for anchor, off in zip(anchors, surprise, strict=True) if off > CONTRADICTED
    ]  # fmt: skip


def judged(
    touchdowns: Touchdowns, fits: Fit, law: str, prior: Prior
) -> tuple[NDArray[np.str_], list[str], grounds.Comparison]:
    """Verdicts, sentences on the ground of the whole walk, and φ by other laws of sand."""
    verdict = verdicts(touchdowns, fits, prior)
    sank = np.isin(verdict, (USABLE, MISFIT, HARD, EDGE))
    chosen = grounds.slow(picked(touchdowns, sank), prior)
    count = len(chosen.foot)
    enough = count >= FEWEST
    if not enough:
        chosen = evenly(picked(touchdowns, sank), FEWEST)
    if not len(chosen.foot):
        return verdict, [], grounds.Comparison("", {}, {})
    laws = grounds.compared(chosen, law, prior, enough=enough)
    if laws.ground:
        return np.where(sank, NO_ANGLE, verdict), [laws.ground], laws
    notes = []
    if not enough and (verdict == USABLE).any():
        few = f"{count} slow footfalls are too few to tell sand from clay or a mat, or how likely "
        notes = [f"{few}other laws are, so that the absolute interval is wide; {FEWEST} are needed"]
    best = max(laws.probability, key=laws.probability.__getitem__)
    if best != law and laws.probability[best] > BETTER and (verdict == USABLE).any():
        grow = f"forces grow with depth as by law {best} rather than {law}"
        if prior.exponent < grounds.LEAST_EXPONENT:
            grow += ", or as on clay that stiffens with depth"
        notes = [f"{grow}: by it φ is {laws.phi_deg[best]:.0f}°, and the absolute interval is wide"]
    return verdict, notes, laws


def _gaps(path: FloatArray, place: FloatArray, verdict: NDArray[np.str_]) -> list[str]:
    """Warn of stretches of the path without a usable footfall on which the ground was refused."""
    from scipy.spatial import cKDTree

    nearest = cKDTree(path[:, 1:]).query(place[:, :2])[1]
    s, usable = path[nearest, 0], verdict == USABLE
    refused = np.sort(s[np.isin(verdict, (SHALLOW, ELASTIC, NO_ANGLE))])
    ends = np.concatenate([[path[0, 0]], np.sort(s[usable]), [path[-1, 0]]])
    stretches = [
        f"{low:.1f} to {high:.1f} m" for low, high in pairwise(ends.tolist())
        if high - low > GAP_M and np.count_nonzero((refused > low) & (refused < high)) >= GAP_FEET
    ]  # fmt: skip
    if not stretches or not usable.any():
        return []
    where = " and ".join(stretches)
    return [f"no footfall from {where} along the path is usable: φ there is that of its ends"]


def surface_depth(fits: Fit, verdict: NDArray[np.str_]) -> FloatArray:
    """Sinkage of each footfall [m]: of the fit, or the way down under load if that is shallow."""
    return np.where(verdict == SHALLOW, fits.gained, fits.sinkage)


def with_growth(touchdowns: Touchdowns, law: str, prior: Prior) -> Prior:
    """Add the law's error to the prior, and its growth with depth if enough feet sink in."""
    if prior.law_sd_deg is None:
        prior = replace(prior, law_sd_deg=LAWS[law].sd_deg)
    trodden, _ = trodden_before(prints_of(touchdowns), NEAR_RADII, prior)
    # The exponent is learned on virgin ground, by feet that sank in and whose footfalls have no
    # fault; a misfit may be due to the very growth that is learned.
    virgin = evenly(picked(touchdowns, ~trodden), MOST_FITTED)
    deep = np.isin(verdicts(virgin, fit(virgin, law, prior), prior), (USABLE, MISFIT))
    return learn_exponent(picked(virgin, deep), law, prior) if deep.sum() >= FEWEST else prior


def _with_levels(
    touchdowns: Touchdowns, sound: Touchdowns, usable: BoolArray, law: str, prior: Prior
) -> tuple[Prior, Fit]:
    """Learn levels from usable footfalls, and fit them again; verdicts leave each its own."""
    prior = learn_level(evenly(sound, MOST_FITTED), law, prior)
    fits = fit(sound, law, prior)
    # Ground near an earlier print was moved, so that φ has a further error.
    near_print, _ = trodden_before(prints_of(touchdowns), BESIDE_RADII, prior)
    return prior, fits._replace(sd=np.hypot(fits.sd, BESIDE_SD_DEG * near_print[usable]))


def _compare_laws(
    touchdowns: Touchdowns, fits: Fit, law: str, prior: Prior, wide: Prior, laws: grounds.Comparison
) -> tuple[Prior, dict[str, FloatArray], FloatArray, float]:
    """Compare usable footfalls with a second law, whose growth with φ is another.

    ``wide`` is the prior before levels of the walk were learned. Returns the prior with the second
    law's weight and the law's error by all others, φ by the second law [deg], the sensitivities
    with the columns ``law_slope`` and ``other_law`` filled in, and the relative standard deviation
    of the scale of differences of φ.
    """
    name = SECOND.get(law, "rft")
    sample = evenly(touchdowns, MOST_FITTED)
    second_prior = learn_exponent(sample, name, grounds.prior_of(name, wide))
    second_prior = learn_level(sample, name, second_prior)
    phi, sensitivity = fits.phi, fits.shared.copy()
    # What other laws read is an error of all places alike by their probabilities; differences
    # between places are uncertain by that of the second law where any of them is right.
    spread = laws.spread_deg(law)
    other = 1.0 - laws.probability.get(law, 1.0)
    prior = replace(
        prior, other_law_sd=math.sqrt(other), law_sd_deg=math.hypot(prior.law_sd_deg or 0.0, spread)
    )
    second = fit(touchdowns, name, second_prior).phi
    # A wrong slope of the law scales the deviations of φ from the mean; the other law, at its
    # weight, adds its difference.
    deviation, difference = phi - phi.mean(), phi - second - (phi - second).mean()
    for term, column in (("law_slope", deviation), ("other_law", difference)):
        sensitivity[:, list(prior.shared()).index(term) - len(prior.shared())] = column
    # By how much the other law makes differences larger or smaller: the slope of a regression, for
    # on uniform soil the two laws differ by their noise.
    stretch = abs(float(deviation @ difference)) / max(float(deviation @ deviation), 1e-9)
    scale_sd = math.hypot(prior.slope_sd, prior.other_law_sd * stretch)
    return prior, {name: second}, sensitivity, scale_sd


def _shared_errors(torques: Normal, prior: Prior) -> Normal:
    """Joint distribution of θ − θ₀: torques, then :meth:`Prior.shared`, which are independent.

    Footfalls are fitted as on level ground; what its slope takes is the mean of that error.
    """
    sd = np.array([sd for _, sd in prior.shared().values()])
    mean = np.where(np.array(list(prior.shared())) == "ground_slope", prior.incline, 0.0)
    count = len(torques.mean)
    covariance = np.zeros((len(sd) + count,) * 2)
    covariance[:count, :count] = torques.covariance
    covariance[count:, count:] = np.diag(sd**2)
    return Normal(np.append(torques.mean, mean), covariance)


def _shared_summary(pooled: Pooled, prior: Prior) -> dict[str, Any]:
    """Posterior mean and standard deviation of θ, and its share of the uncertainty of φ [deg]."""
    shared: dict[str, Any] = {}
    pairs = prior.shared()
    count = pooled.shared.shape[1] - len(pairs)
    by_joint = np.split(pooled.shared[:, :count], 2, axis=1)
    for name, columns in zip(("torque_gain", "joint_friction_Nm"), by_joint, strict=True):
        mean, sd, terms = columns
        worth = float(np.sqrt((terms**2).sum()))
        shared[name] = {"mean": mean.tolist(), "sd": sd.tolist(), "worth_deg": worth}
    # The pool has θ − θ₀: what is printed is θ.
    rows = pooled.shared[:, count:].T.tolist()
    for (name, (centre, _)), (off, sd, worth) in zip(pairs.items(), rows, strict=True):
        shared[name] = {"mean": centre + off, "sd": sd, "worth_deg": worth}
    for name, summary in shared.items():
        summary["source"] = TERMS[name].source
    return shared | {"field": pooled.field}


class Inclination(NamedTuple):
    """Inclination of the plane through the footfalls, and its standard deviation [rad]."""

    angle: float
    sd: float

    def added_to(self, prior: Prior) -> Prior:
        """Prior with what it does to the logarithm of forces."""
        # The square of a noisy angle is too large by its variance.
        tan, spread = math.tan(self.angle), math.tan(self.sd)
        loss = SLOPE_LOSS * max(tan**2 - spread**2, 0.0)
        sd = math.hypot(SLOPE_LOSS_SD * loss, SLOPE_LOSS * (2.0 * tan + spread) * spread)
        return replace(prior, incline=-loss, incline_sd=sd)

    def notes(self, prior: Prior) -> list[str]:
        """A sentence if the ground is not level by more than the error."""
        if self.angle < INCLINED_SDS * self.sd:
            return []
        angle, sd = np.degrees(self)
        text = f"the ground is inclined by {angle:.0f} ± {sd:.0f}°: φ is corrected for the "
        return [f"{text}{1.0 - math.exp(prior.incline):.0%} less that it bears"]


def inclination(place: FloatArray) -> Inclination:
    """Inclination of the plane through places [m], shape [footfall, 3]."""
    if len(place) < FEWEST_TYPICAL:
        return Inclination(0.0, math.radians(ATTITUDE_SD_DEG))
    # z = a x + b y + c by least squares; where x, y lie on a line it is level across that.
    design = np.column_stack([place[:, :2] - place[:, :2].mean(axis=0), np.ones(len(place))])
    inverse = np.linalg.inv(design.T @ design + np.diag([1e-3, 1e-3, 0.0]))
    rise = inverse @ (design.T @ place[:, 2])
    off = place[:, 2] - design @ rise
    size = max(float(np.linalg.norm(rise[:2])), 1e-9)
    along = np.append(rise[:2] / size, 0.0)
    variance = along @ inverse @ along * (off @ off) / (len(place) - 3)
    sd = math.hypot(math.sqrt(variance), math.radians(ATTITUDE_SD_DEG))
    return Inclination(math.atan(size), sd)


def _limits_of_the_law(fits: Fit, usable: BoolArray, law: str, prior: Prior) -> list[str]:
    """Warnings where the law was not simulated or not tested: depth, growth with depth."""
    notes = []
    if law == "foot" and (deep := fits.sinkage[usable] > DEEPEST * prior.radius).any():
        notes.append(
            f"{int(deep.sum())} of {len(deep)} usable feet sank deeper than {DEEPEST:g} "
            "radii, where law foot was not simulated: their φ is less certain than stated"
        )
    if law == "foot" and prior.exponent < SLOW_GROWTH:
        notes.append(
            f"forces grow slower with depth than in dry sand, by a power of {prior.exponent:.2f}: "
            "if the soil is damp, φ may be up to 8° too high"
        )
    return notes


def _limits_of_the_path(
    path: FloatArray, verdict: NDArray[np.str_], prior: Prior, scale_sd: float, *, anchored: bool
) -> list[str]:
    """Warnings about prints of before, a map without footfalls, or one without an anchor."""
    notes = []
    if comes_back(path):
        notes.append(
            f"the path comes back to itself: earlier prints are recognized within "
            f"{1e3 * NEAR_RADII * prior.radius:.0f} mm, if the odometry is as accurate"
        )
    if (count := np.count_nonzero(verdict == USABLE)) > MOST:
        notes.append(f"the path's map is by {MOST} of {count} usable footfalls, evenly chosen")
    if not count:
        hard = 2 * np.count_nonzero(verdict == SHALLOW) > len(verdict)
        why = "feet hardly sink, as on hard ground" if hard else "the map is empty"
        notes.append(f"no footfall is usable: {why}")
    elif not anchored:
        notes.append(
            "no anchor: the relative band holds for differences along the path only, and their "
            f"scale is uncertain by {scale_sd:.0%}"
        )
    return notes


class Typical(NamedTuple):
    """What is usual in a walk, with which its footfalls are compared.

    Attributes
    ----------
    returned
        Median work returned by the ground [-].
    misfit
        χ² over the degrees of freedom above which the law does not fit [-].
    deep
        Drop that few feet exceed [m].
    """

    returned: float = 0.0
    misfit: float = FAIR_MISFIT
    deep: float = -math.inf

    @classmethod
    def of(cls, rows: FloatArray) -> Typical:
        """Usual values of rows of :func:`traits`, those of feet that sank in.

        Feet that hardly sink stand on hard ground, which a walk may cross before and after the
        soil. Fewer than :data:`FEWEST_TYPICAL` have none.
        """
        sound, gained, returned, misfit, deepest, troubled = rows.T
        sank = (sound > 0.0) & (gained >= LEAST_GAINED)
        if sank.sum() < FEWEST_TYPICAL:
            return cls()
        low, median = np.percentile(np.log(np.maximum(misfit[sank], 1e-6)), (16.0, 50.0))
        most = math.exp(median + MISFIT_SDS * (median - low))
        one_soil = troubled[sank].mean() < MOST_TROUBLED
        return cls(
            float(np.median(returned[sank])),
            min(max(most, FAIR_MISFIT), WORST_MISFIT) if one_soil else FAIR_MISFIT,
            float(np.quantile(deepest[sank], 1.0 - MOST_DEEPER)) - DEEPER_M,
        )


def traits(touchdowns: Touchdowns, fits: Fit) -> FloatArray:
    """What :class:`Typical` is learned from, shape [footfall, 6].

    Whether log and timing are sound, how far the foot went down under load [m], work returned,
    misfit, deepest drop [m], and whether a crust, hard ground or a prior's edge shows.
    """
    troubled = (touchdowns.broken > MOST_BROKEN) | (fits.borne > MOST_BORNE)
    return np.column_stack([
        ~(touchdowns.torn | touchdowns.faulty), fits.gained, touchdowns.returned, fits.misfit,
        touchdowns.deepest, troubled | np.isin(fits.phi, PHI_RANGE),
    ])  # fmt: skip


def verdicts(
    touchdowns: Touchdowns, fits: Fit, prior: Prior, *, typical: Typical | None = None,
    earlier: FloatArray | None = None,
) -> NDArray[np.str_]:  # fmt: skip
    """Verdict of each footfall: the first reason against it, else :data:`USABLE`.

    Parameters
    ----------
    touchdowns, fits
        The touch-downs of a log, in the order of time, and their fit.
    prior
        With the size of the foot.
    typical
        What is usual in the whole walk; by default in these touch-downs.
    earlier
        Prints of touch-downs before these, as of :func:`prints_of`; by default none.
    """
    typical = typical or Typical.of(traits(touchdowns, fits))
    before = np.empty((0, 4)) if earlier is None else earlier
    prints = np.vstack([before, prints_of(touchdowns)])
    trodden, printed = trodden_before(prints, NEAR_RADII, prior)[:, len(before) :]
    # Of a sole that stays above the surface with an end the law is less sure.
    risen = np.where(touchdowns.used, np.abs(touchdowns.rise).sum(axis=2), 0.0).max(axis=1)
    springs = (touchdowns.returned > MOST_RETURNED) | (typical.returned > WALK_RETURNED)
    # The order is that of causes: sensors and timing, ground that is no virgin soil, then the fit,
    # which each of the causes before it can spoil.
    reasons = (
        (FAULTY, touchdowns.faulty),
        (TORN, touchdowns.torn),
        (SATURATED, touchdowns.saturated),
        (SHALLOW, fits.gained < LEAST_GAINED),
        (TORN, sampled(touchdowns)[1]),
        (ELASTIC, springs),
        (CRUST, touchdowns.broken > MOST_BROKEN),
        (HARD, (fits.borne > MOST_BORNE) & (touchdowns.deepest >= typical.deep)),
        (TILTED, risen > np.where(touchdowns.used, touchdowns.drop, 0.0).max(axis=1)),
        (PRINT, printed),
        (TRODDEN, trodden | (touchdowns.moved < NEAR_RADII * prior.radius)),
        (EDGE, np.isin(fits.phi, PHI_RANGE)),
        (MISFIT, fits.misfit > typical.misfit),
    )
    return np.select([holds for _, holds in reasons], [word for word, _ in reasons], USABLE)


def comes_back(path: FloatArray) -> bool:
    """True if a path (s, x, y) comes nearer than :data:`BACK_M` to itself, a metre or so later."""
    from scipy.spatial import cKDTree

    # Points of a long path are farther apart than that.
    near = max(BACK_M, float(np.diff(path[:, 0]).max(initial=0.0)))
    first, second = cKDTree(path[:, 1:]).query_pairs(near, output_type="ndarray").T
    return bool(np.any(np.abs(path[second, 0] - path[first, 0]) > 4.0 * near))


def _ground_notes(touchdowns: Touchdowns, fits: Fit, verdict: NDArray[np.str_]) -> list[str]:
    """Warnings about ground that is not soil, or not only soil."""
    returned = Typical.of(traits(touchdowns, fits)).returned
    sank = ~(touchdowns.torn | touchdowns.faulty) & (fits.gained >= LEAST_GAINED)
    broken = np.median(touchdowns.broken[sank]) if sank.sum() >= FEWEST_TYPICAL else 0.0
    notes, (step, few) = [], sampled(touchdowns)
    if (few := few & (verdict == TORN)).any():
        text = (
            f"{few.sum()} of {len(few)} feet have too few samples while they go down, or gaps, at "
        )
        notes.append(f"{text}{1.0 / np.median(step[few]):.0f} Hz: log faster")
    if returned > WALK_RETURNED:
        text = f"the ground returns {returned:.0%} of the work of the feet, soil a few percent"
        notes.append(f"{text}: it is a mat, foam or floor, and has no φ")
    if broken > WALK_BROKEN:
        text = f"feet lose {broken:.0%} of their force while they go deeper: a crust breaks"
        notes.append(f"{text}, as on snow, and φ is not that of the soil")
    if hard := int((verdict == HARD).sum()):
        text = f"{hard} of {len(verdict)} feet ended on harder ground below the soil"
        notes.append(f"{text}: check how deep the soil is")
    misfits = int((verdict == MISFIT).sum())
    if misfits > MOST_MISFITS * len(verdict):
        text = f"the law does not fit {misfits} of {len(verdict)} footfalls: check whether"
        notes.append(f"{text} the ground was trodden before, or is stony, layered or damp")
    return notes


def prints_of(touchdowns: Touchdowns) -> FloatArray:
    """Place x, y [m], number of the foot and heading [rad] of touch-downs, [touchdown, 4]."""
    return np.column_stack([touchdowns.place[:, :2], touchdowns.foot, touchdowns.heading])


def trodden_before(prints: FloatArray, radii: float, prior: Prior) -> BoolArray:
    """Masks of prints nearer than some radii to an earlier one, and in a fore foot's, [2, print].

    Prints are those of :func:`prints_of`, in the order of time. Only a rear foot steps into the
    print of a fore foot. Soles have half of their length and width for radii, along the earlier
    print's sides.
    """
    from scipy.spatial import cKDTree

    masks = trodden, printed = np.zeros((2, len(prints)), dtype=bool)
    # Of a pair the larger number came later.
    place, foot, heading = prints[:, :2], prints[:, 2], prints[:, 3]
    sides = 0.5 * np.array(prior.sole or (0.0, 0.0))
    reach = radii * max(prior.radius, *(math.sqrt(2.0) * sides))
    near = cKDTree(place).query_pairs(reach, output_type="ndarray")
    first, second = near.min(axis=1), near.max(axis=1)
    if prior.sole:
        away = (place[second] - place[first]) @ [1.0, 1j] * np.exp(-1j * heading[first])
        inside = (np.abs([away.real, away.imag]) < radii * sides[:, None]).all(axis=0)
        first, second = first[inside], second[inside]
    trodden[second] = True
    printed[second[foot[first] // 2 < foot[second] // 2]] = True
    return masks
