"""φ under every footfall of a log, and along its path: from a log to the answer."""

from __future__ import annotations

import html
import importlib.metadata
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import number_with_sd, plain_number
from terraphi.experiment.plausibility import LIMITS
from terraphi.laws.foot import LAWS
from terraphi.robot.footfall_fit import (
    MOST_FITTED,
    PHI_RANGE,
    SHARED,
    Fit,
    Prior,
    evenly,
    fit,
    picked,
    shared_sd,
    with_exponent,
)
from terraphi.robot.footfall_map import ANCHOR_POINTS, Anchor, Observed, Pooled, pool, weigh
from terraphi.robot.forces import without_broken_accelerometer
from terraphi.robot.joint_log import FEET, JointLog
from terraphi.robot.legs import rotation
from terraphi.robot.logs.columns import Columns
from terraphi.robot.model import Quadruped
from terraphi.robot.results import foot_forces
from terraphi.robot.touchdowns import FEWEST, Motion, Touchdowns, sensitivity, touchdowns, track

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

USABLE = "usable"
SHALLOW, MISFIT = "too little sinkage", "the law does not fit"
TRODDEN, PRINT = "not virgin ground", "print of a fore foot"
TORN, SATURATED, EDGE = "timing unreliable", "saturated", "at a prior's edge"
VERDICTS = (USABLE, SHALLOW, PRINT, TRODDEN, MISFIT, TORN, SATURATED, EDGE)
"""Verdicts of footfalls."""

LEAST_GAINED = 0.003
"""Way down that a footfall needs while the force rises from a sixth to five sixths [m]: on hard
ground a force comes without, and what creeps under a full load is no loading. Where the force grows
with the depth to the power of 1.7, it is half of a sinkage of 6 mm (hard ground in
``examples/sand_check.py`` has no usable footfall)."""
NEAR_RADII = 2.0
"""Ground nearer than this many radii to an earlier footfall has been trodden [-]: feet side by
side."""
WORST_MISFIT = 2.0
"""χ² over the degrees of freedom above which a law does not fit [-]: with noise of twice the usual
size and more it is 0.1 to 0.4 on simulated walks."""
LEVEL_DEG = 5.0
"""Inclination of the ground that is worth a note [deg]: 1.4° at most on simulated level sand."""
CONTRADICTED = 2.0
"""Standard deviations above which an anchor is doubted [-]: one sound anchor in twenty."""
SECOND = "rft"
"""Law of a second opinion on the mean φ: of few terms, and fast."""
CONTACT_PART = 0.4
"""Of the radius below a sunk ball's centre, where soil pushes [-]: by resistive force theory 0.9 to
0.5 at a third of the radius' depth, 0.3 at a radius, 0.2 at one and a half."""
PATH_STEP = 0.05
"""Spacing of the map along the path, at least [m]: about two radii of a foot."""
MOST_POINTS = 1500
SMOOTH_PATH_S = 0.6
"""The trunk's sway is averaged over this time before the path, and its first heading, the x of the
map, are measured [s]: half a stride of a walk."""


@dataclass(frozen=True)
class FootfallMap:
    """φ under footfalls and along the path.

    Attributes
    ----------
    time
        Touch-downs on the log's clock [s], shape [footfall].
    foot
        ``FR``, ``FL``, ``RR`` or ``RL``, shape [footfall].
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
        What all footfalls share, by name: mean, standard deviation and its share of φ's.
    by_law
        Mean φ of the usable footfalls by the law, and by :data:`SECOND` [deg].
    notes
        Warnings.
    provenance
        Log, robot, priors and versions.
    """

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
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def usable(self) -> BoolArray:
        """Which footfalls determine φ, shape [footfall]."""
        return np.array([verdict == USABLE for verdict in self.verdict], dtype=bool)

    def counts(self) -> dict[str, int]:
        """Footfalls by verdict, those that occur."""
        return {v: self.verdict.count(v) for v in VERDICTS if v in self.verdict}

    def summary(self) -> pd.DataFrame:
        """A row for each footfall, as in the CSV of ``terraphi footfalls --out``."""
        import pandas as pd

        x, y, surface = self.place.T
        return pd.DataFrame(
            {
                "t_s": self.time, "foot": self.foot, "x_m": x, "y_m": y, "surface_m": surface,
                "sinkage_m": self.sinkage, "phi_deg": self.phi,
                "absolute_sd_deg": np.hypot(self.sd, self.shared_sd),
                "relative_sd_deg": self.sd, "shared_sd_deg": self.shared_sd,
                "verdict": self.verdict,
            }
        )  # fmt: skip

    def plot(self) -> Figure:
        """Footfalls on the ground, and φ along the path, as a Matplotlib figure."""
        from terraphi.robot.pictures import footfalls_figure

        return footfalls_figure(self)

    def to_netcdf(self, path: Path | str) -> None:
        """Write NetCDF-4, and a GeoJSON and a CSV of the same name next to it.

        Raises InputError if the place cannot be written.
        """
        from terraphi.robot.footfall_files import write_footfalls

        write_footfalls(self, Path(path))

    def __repr__(self) -> str:
        """A few lines for a prompt."""
        counts = ", ".join(f"{n} {verdict}" for verdict, n in self.counts().items())
        lines = [f"{self.provenance.get('log', 'log')}: {len(self.verdict)} footfalls: {counts}"]
        if self.usable.any():
            mean, wide = self.path_phi.mean(), self.path_absolute_sd.mean()
            low, high = self.path_phi.min(), self.path_phi.max()
            lines.append(f"φ = {mean:.1f}° ± {wide:.1f}°, {low:.1f} to {high:.1f}° along the path")
        if self.notes:
            lines.append(f"warnings in .notes: {len(self.notes)}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """The same for a notebook, with a table of footfalls."""
        table = self.summary().to_html(max_rows=10, float_format="{:.3g}".format)
        return f"<pre>{html.escape(repr(self))}</pre>{table}"


def footfalls(
    log: Path | str | JointLog,
    *,
    robot: Quadruped | Path | str = "go2",
    density: str | float | None = None,
    law: str = "foot",
    prior: Prior | None = None,
    anchors: Sequence[Anchor | str] | str = (),
    lag_s: float = 0.0,
    topic: str | None = None,
    joint_names: Sequence[str] | None = None,
    columns: Columns | Path | str | None = None,
) -> FootfallMap:
    """φ under each footfall of a walk, and a map of it along the path.

    Parameters
    ----------
    log
        A file or folder that :func:`~terraphi.robot.logs.read_log` reads, or its result.
    robot
        The robot, or its name, TOML, URDF or MJCF.
    density
        Bulk density of the soil [kg/m³], such as ``1550`` (5 % uncertain) or ``"1550±80"``.
        ``None``: that of the prior, with a note.
    law
        One of :data:`~terraphi.laws.foot.LAWS`.
    prior
        Distributions of soil, foot, sensors and law; the foot's radius is the robot's.
    anchors
        Friction angles known on stretches of the path, such as ``"x=0:0.5,phi=34±1"``, or the mean
        over all of it, ``"phi=34±2"``.
    lag_s, topic, joint_names, columns
        As in :func:`terraphi.foot_forces`.

    Raises
    ------
    InputError
        If the log cannot be used, has no attitude, or its forces are not those of this robot; if an
        option is unknown or an anchor lies off the path.

    Examples
    --------
    >>> found = terraphi.footfalls("walk.csv", density="1550±80")
    >>> found.counts()
    {'usable': 31}
    >>> found.to_netcdf("soil.nc")
    """
    body = robot if isinstance(robot, Quadruped) else Quadruped.load(robot)
    if law not in LAWS:
        raise InputError(f"law '{law}' is unknown; {nearest(law, LAWS)}")
    if body.foot_radius <= 0.0:
        raise InputError(f"robot '{body.name}' lacks its foot_radius, which footfalls need")
    chosen = replace(prior or Prior(), radius=body.foot_radius)
    if density is not None:
        mean, sd = _density(str(density))
        chosen = replace(chosen, density=mean, density_sd=sd)
    given = [anchors] if isinstance(anchors, str) else anchors
    known = [anchor_from(a) if isinstance(a, str) else a for a in given]
    name = "the log" if isinstance(log, JointLog) else str(log)
    analysis = foot_forces(
        log, robot=body, contact_part=CONTACT_PART, lag_s=lag_s, topic=topic,
        joint_names=joint_names, columns=columns,
    )  # fmt: skip
    if not analysis.stances:
        raise InputError(f"{name}: {analysis.notes[-1]}")
    if analysis.grave:
        raise InputError(f"{name}: no footfall can be read: {analysis.grave[0]}")
    log, forces = without_broken_accelerometer(analysis.log)[0], analysis.forces
    lift = forces.force[:, :, 2].astype(np.float64)
    motion = _from_the_start(track(log, body, forces.place, lift), log)
    per = sensitivity(log, forces)
    seen = touchdowns(log, forces, motion, analysis.stances, per, radius=body.foot_radius)
    # The centre of mass accelerates otherwise than the trunk: legs are half of the robot.
    acceleration = motion.lift_acceleration + forces.leg_inertia / body.mass
    chosen = _taught(seen, law, chosen)
    found = fit(seen, law, chosen)
    verdict = verdicts(seen, found, chosen.radius)
    usable = verdict == USABLE
    common = weigh(
        log.time, lift, acceleration, per, shared_sd(chosen, forces.friction), mass=body.mass
    )
    path = _path(motion, log.time)
    stretches = [(anchor, _stretch(anchor, path)) for anchor in known]
    fields = {key: np.full(len(verdict), np.nan) for key in ("phi", "sd", "shared_sd")}
    of_path = ("path_phi", "path_relative_sd", "path_absolute_sd")
    fields |= {key: np.full(len(path), np.nan) for key in of_path}
    shared: dict[str, Any] = {}
    by_law: dict[str, float] = {}
    contradicted: list[str] = []
    if usable.any():
        phi, moves = found.phi[usable], found.shared[usable]
        moves[:, SHARED.index("law_slope")] = phi - phi.mean()
        observed = Observed(phi, found.sd[usable], moves, seen.place[usable, :2])
        pooled = pool(
            observed, common, path[:, 1:], stretches, mean=chosen.phi_deg, mean_sd=chosen.phi_sd_deg
        )
        for key, values in fields.items():
            values[usable if key not in of_path else slice(None)] = getattr(pooled, key)
        shared = _shared_summary(pooled, chosen)
        by_law[law] = float(pooled.phi.mean())
        if law != SECOND:  # with what was learned of sensors and anchors
            some = evenly(picked(seen, usable), MOST_FITTED)
            own_prior = with_exponent(some, SECOND, replace(chosen, exponent=0.0))
            second = fit(some, SECOND, own_prior).phi
            by_law[SECOND] = float(second.mean() + (pooled.phi - phi).mean())
        contradicted = [
            f"the anchor of {anchor.phi_deg:g} ± {anchor.sd_deg:g}° is {off:.1f} standard "
            "deviations from what footfalls, law and other anchors give: check it"
            for anchor, off in zip(known, pooled.surprise, strict=True) if off > CONTRADICTED
        ]  # fmt: skip
    sinkage = np.where(verdict == SHALLOW, found.gained, found.sinkage)
    notes = [*contradicted, *(n for n in analysis.notes if "the axis of Fx" not in n)]
    # Inclination of the plane through places where feet met the ground.
    x, y, z = seen.place.T
    rise = np.linalg.lstsq(np.stack([x, y, np.ones_like(x)], axis=-1), z)[0][:2]
    if (slope := math.degrees(math.atan(float(np.linalg.norm(rise))))) > LEVEL_DEG:
        notes.append(
            f"the ground is inclined by {slope:.0f}°: the law is of level ground, and soil on a "
            "slope bears less"
        )
    if density is None and prior is None:
        notes.insert(0, f"density {chosen.density:g} ± {chosen.density_sd:g} kg/m³, assumed")
    if not usable.any():
        notes.append("no footfall is usable: the map is empty")
    if usable.any() and not known:
        notes.append("no anchor: only differences along the path are as sure as the relative band")
    return FootfallMap(
        time=seen.begin,
        foot=tuple(FEET[i] for i in seen.foot),
        place=seen.place + np.outer(sinkage, [0.0, 0.0, 1.0]),
        sinkage=sinkage,
        **fields,
        misfit=found.misfit,
        verdict=tuple(verdict.tolist()),
        path=path,
        shared=shared,
        by_law=by_law,
        notes=tuple(notes),
        provenance={
            "log": name, "robot": body.name, "law": law, "prior": asdict(chosen),
            "anchors": [anchor._asdict() for anchor in known],
            "terraphi": importlib.metadata.version("terraphi"), "forces": analysis.provenance(),
        },
    )  # fmt: skip


def _taught(seen: Touchdowns, law: str, prior: Prior) -> Prior:
    """The prior with the law's error, and its growth with depth if enough touch-downs are deep."""
    if prior.law_sd_deg is None:
        prior = replace(prior, law_sd_deg=LAWS[law].sd_deg)
    seen = evenly(picked(seen, ~_trodden(seen, prior.radius)[0]), MOST_FITTED)
    first = verdicts(seen, fit(seen, law, prior), prior.radius)
    deep = np.isin(first, (USABLE, MISFIT))
    if deep.sum() < FEWEST:
        return prior
    return with_exponent(picked(seen, deep), law, prior)


def verdicts(seen: Touchdowns, found: Fit, radius: float) -> NDArray[np.str_]:
    """Verdict of each footfall: the first reason against it, else :data:`USABLE`.

    Parameters
    ----------
    seen, found
        The touch-downs of a log, in the order of time, and their fit.
    radius
        Of the foot [m].
    """
    trodden, printed = _trodden(seen, radius)
    rests = seen.used.sum(axis=1) < FEWEST
    reasons = (
        (TORN, seen.torn),
        (SATURATED, seen.saturated),
        (SHALLOW, (found.gained < LEAST_GAINED) | rests),
        (PRINT, printed),
        (TRODDEN, trodden),
        (EDGE, np.isin(found.phi, PHI_RANGE)),
        (MISFIT, found.misfit > WORST_MISFIT),
    )
    words = [word for word, _ in reasons]
    return np.select([holds for _, holds in reasons], words, USABLE)


def _trodden(seen: Touchdowns, radius: float) -> tuple[BoolArray, BoolArray]:
    """Whether a foot had stood there before, and whether a fore foot had where a rear one steps."""
    from scipy.spatial import cKDTree

    trodden, printed = np.zeros((2, len(seen.foot)), dtype=bool)
    near = cKDTree(seen.place[:, :2]).query_pairs(NEAR_RADII * radius, output_type="ndarray")
    first, second = near.min(axis=1), near.max(axis=1)
    trodden[second] = True
    printed[second[(seen.foot[first] < 2) & (seen.foot[second] >= 2)]] = True
    return trodden, printed


def _from_the_start(motion: Motion, log: JointLog) -> Motion:
    """Turn the motion so that x is the robot's first heading."""
    assert log.quaternion is not None, "checked when the log was read"
    early = log.time <= log.time[0] + SMOOTH_PATH_S
    x, y = rotation(log.quaternion[early])[:, :2, 0].mean(axis=0)
    size = math.hypot(x, y)
    back = np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, size]]) / size
    return motion._replace(trunk=motion.trunk @ back.T, feet=motion.feet @ back.T)


def _path(motion: Motion, time: FloatArray) -> FloatArray:
    """Points s, x, y of the trunk's way at even steps [m], shape [point, 3]."""
    from scipy.ndimage import uniform_filter1d

    width = max(1, round(SMOOTH_PATH_S / float(np.median(np.diff(time)))))
    smooth = uniform_filter1d(motion.trunk[:, :2], 2 * width, axis=0, mode="nearest")
    gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(smooth, axis=0).T))])
    count = int(np.clip(gone[-1] / PATH_STEP + 1, 1, MOST_POINTS))
    s = np.linspace(0.0, gone[-1], count)
    return np.column_stack([s, *(np.interp(s, gone, column) for column in smooth.T)])


def _stretch(anchor: Anchor, path: FloatArray) -> FloatArray:
    """Points of the path on an anchor's stretch [m], shape [point, 2]."""
    along = path[:, "sxy".index(anchor.axis)]
    inside = np.flatnonzero((along >= anchor.begin - 1e-9) & (along <= anchor.end + 1e-9))
    if not len(inside):
        raise InputError(
            f"anchor {anchor.axis}={anchor.begin:g}:{anchor.end:g}: the path has {anchor.axis} "
            f"from {along.min():.2f} to {along.max():.2f} m; name a stretch of it"
        )
    some = np.unique(np.linspace(0, len(inside) - 1, ANCHOR_POINTS).round().astype(int))
    return path[inside[some], 1:]


def _shared_summary(pooled: Pooled, prior: Prior) -> dict[str, Any]:
    """Value, standard deviation and part of φ's standard deviation of each shared quantity."""
    mean, sd, terms = pooled.shared_mean, pooled.shared_sd_each, pooled.terms
    found: dict[str, Any] = {}
    for name, rows in (("torque_gain", slice(12)), ("joint_friction_Nm", slice(12, 24))):
        worth = float(np.sqrt((terms[rows] ** 2).sum()))
        found[name] = {"mean": mean[rows].tolist(), "sd": sd[rows].tolist(), "worth_deg": worth}
    shown = {
        "drop": ("odometry_drop", 0.0, 1.0),
        "log_density": ("density_kg_m3", prior.density, prior.density),
        "surface_friction": ("surface_friction", prior.surface_friction, 1.0),
        "radius": ("foot_radius_mm", 1e3 * prior.radius, 1e3),
        "law_offset": ("law_offset_deg", 0.0, 1.0),
        "law_exponent": ("law_exponent", prior.exponent, 1.0),
    }
    for i, key in enumerate(SHARED[24:], start=24):
        name, centre, scale = shown.get(key, (key, 0.0, 1.0))
        numbers = {"mean": centre + scale * mean[i], "sd": scale * sd[i], "worth_deg": terms[i]}
        found[name] = {what: float(value) for what, value in numbers.items()}
    sizes = {"amplitude_deg": pooled.amplitude, "length_m": pooled.length}
    return {**found, "field": {**sizes, "scatter_deg": pooled.scatter}}


LONGEST_PATH = 1e6
"""End of an anchor that names no stretch [m]."""


def anchor_from(text: str) -> Anchor:
    """Parse an anchor such as ``x=0:0.5,phi=34±1`` (or ``34+-1``), or ``phi=34±2``: the whole path.

    Raises InputError if it is written otherwise, or out of range.
    """
    where, _, phi = text.replace(" ", "").rpartition("phi=")
    where = where.removesuffix(",") or f"s=0:{LONGEST_PATH:g}"
    axis, _, ends = where.partition("=")
    low, high = PHI_RANGE
    try:
        begin, end = sorted(map(plain_number, ends.split(":")))
        mean, sd = number_with_sd(phi)
        if axis in {"x", "y", "s"} and low <= mean <= high and sd is not None and 0 < sd <= 15:
            return Anchor(begin, end, mean, sd, axis)
    except ValueError:
        pass
    raise InputError(
        f"anchor '{text}': expected one such as x=0:0.5,phi=34±1, or phi=34+-1 of the whole path, "
        f"with phi from {low:g} to {high:g} degrees and its uncertainty above 0 and at most 15"
    )


def _density(text: str) -> tuple[float, float]:
    """Mean and standard deviation of a density such as ``1550±80``, ``1550+-80`` or ``1550``."""
    low, high, _ = LIMITS["soil.density"]
    try:
        mean, sd = number_with_sd(text)
        sd = mean * Prior.density_sd / Prior.density if sd is None else sd
        if low <= mean <= high and 0.0 < sd <= 0.3 * mean:
            return mean, sd
    except ValueError:
        pass
    raise InputError(
        f"density '{text}': expected kg/m³ such as 1550 or 1550±80, from {low:g} to {high:g}, "
        "its standard deviation above 0 and at most 30 % of it"
    )
