r"""How real soils differ from a library's model, learnt from measured media, and what follows.

The window means d of a measured record are those of the model at some angle, and a deviation that
real soils have in common:

    d = g(phi*) + p (m + u) + e,        phi* = phi + level,

p the peak-to-peak of each force of the model (a deviation scales with the force), m the mean shape
over the leg angle, u what one soil has beside it, e everything else (scatter, noise, ...).

**The angle.** With s = dg/dphi, A = diag(1 / p_d^2) the weights of least squares (p_d: peak-to-peak
of the data) and c = A s / (s^T A s), c^T r is the change of phi by which a residual r is fitted
best. m and u are what is left of deviations once their part along s is taken away,

    P = I - s c^T,    c^T P = 0:

orthogonal to s in the metric of the likelihood. With a residual covariance C = C_e + P D P^T and
C_e = v A^-1, C c = v A^-1 c is along s, so that C^-1 s is along c: the estimate is c^T r and its
variance c^T C_e c, *whatever* D is. A learnt shape can neither move the angle nor narrow it; it
only says whether a deviation is one that real soils have. So phi* is that of least squares, and its
variance the sum of c^T C_i c over the terms of e, each in degrees.

**The level.** Forces that a soil has beside the model's at its own angle look like another angle.
No residual shows it; measured angles of repose do. The level is Student-t about zero: with n media
whose (mean) level is l_i, and a prior worth FREEDOM soils of a spread of SPREAD_DEG,

    scale^2 = (FREEDOM SPREAD_DEG^2 + sum l_i^2) / (FREEDOM + n),    nu = FREEDOM + n.

It is one for all legs of a soil; legs differ by a normal term of their own. What the grid, the
speed-up and the leg's friction do to the level was seen through the same library and is in that
scale already: the budget shows them as parts of it.

**The verdict.** With rho = P r / p the shape of a record, m the mean of n media, K a Matern 3/2
kernel over the leg angle, of LENGTH_DEG, plus WHITE^2 I, and s free,

    T = min(|rho - m|^2 / (1 + 1/n), |rho|^2),   |z|^2 = z^T (K + kappa s s^T)^-1 z :

a soil may deviate as others do, or not at all, where the model describes it by itself. ln T of
soils that were left out in turn has a mean and a standard deviation; a new record is consistent up
to their Student-t quantile at ACCEPTED: it deviates as real soils do, or less. The media are few,
so only the size of the kernel and the mean are learnt. LENGTH_DEG, WHITE and ACCEPTED were chosen
once: about three hundred settings of the kernel and the threshold were scanned for those that tell
the shipped media best from false records. The likelihood of the shapes alone would take a shorter
and smoother kernel. That a record may also be near the model came later, when library `sand3d`
described poppy seeds to 3 % and they were unlike other soils. So what `study real_soil` finds of
the verdict flatters it; of the angles it does not.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import shipped_file, shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.inference.budget import Budget, covariance_terms, information_share
from terraphi.inference.calibrated import Problem, matern32, shift_of
from terraphi.inference.findings import Measure
from terraphi.inference.posterior import Posterior
from terraphi.inference.prepared_leg import PreparedLeg
from terraphi.library.store import Library
from terraphi.surrogate.joint import window_spans

FOR_SIMULATED = "quick-plane-strain"
"""Library for simulated records."""
FOLDER = "discrepancies"
"""Of the package's data: a file for each library whose discrepancy was learnt."""
SPREAD_DEG = 3.0
"""Spread of the level between soils before media are seen [deg]: of eight media through several
libraries, about any calibration."""
FREEDOM = 4.0
"""Soils that it is worth."""
LENGTH_DEG = 60.0
"""Correlation length of a soil's own deviation over the leg angle [deg]."""
WHITE = 0.5
"""Standard deviation of its rough part, over that of its smooth one [-]."""
ACCEPTED = 0.8
"""Share of real records that are to be consistent [-]: four in five."""
ALONE = 0.95
"""The same for one of several records that are judged together."""
FREE = 1e4
"""Variance along s, which tells nothing of the shape."""
FEWEST_MEDIA = 3
"""Media from which a discrepancy is learnt at least."""
DENSITY_ERROR = 0.05
"""Standard deviation of a density that is assumed, of itself [-]."""
FURTHEST_DEG = 15.0
"""Step beyond the library's end that is believed of a linear model [deg]."""
WIDEST = 4.0
"""Scales of the level beyond the library's ends up to which an angle is looked for."""
QUANTILES = 101
"""Of the library's angle, that stand for it beside a level, which is wider."""
ANGLES_DEG = (1.0, 75.0)
"""Friction angles that may be answered [deg]."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A record fitted by least squares, in the library's force unit.

    Attributes
    ----------
    phi_deg
        Angle of the best curve, within the library [deg].
    step_deg
        What the linear model adds to it; it is large only at the library's ends [deg].
    slope, shift
        s [N/deg] and c [deg/N] there, shapes [2 theta].
    forces
        The best curve [N], shape [2 theta].
    residual
        Data less that [N], shape [2 theta].
    spans
        Peak-to-peak of each force of the curve at each window [N], shape [2 theta].
    """

    phi_deg: float
    step_deg: float
    slope: FloatArray
    shift: FloatArray
    forces: FloatArray
    residual: FloatArray
    spans: FloatArray

    @classmethod
    def of(cls, leg: PreparedLeg, data: FloatArray, spans: FloatArray) -> Fitted:
        """Fit a record; ``spans``: of the data, by which forces are weighted [N], shape [2]."""
        weights = np.repeat(1.0 / np.square(spans), data.size // 2)
        squares = np.square(data - leg.mean) @ weights
        node = int(squares.argmin())
        low, high = leg.surrogate.phi_bounds_deg
        phi = float(leg.phi_deg[node])
        for _ in range(2):  # Gauss-Newton from the nearest node, some hundredths of a degree away
            slope = leg.surrogate.slope(phi)
            forces = leg.surrogate.predict([phi])[0]
            shift = shift_of(slope, spans)
            step = float(shift @ (data - forces))
            if not low < phi + step < high:
                break
            phi += step
        slope, forces = leg.surrogate.slope(phi), leg.surrogate.predict([phi])[0]
        shift, residual = shift_of(slope, spans), data - forces
        beyond = float(np.clip(shift @ residual, -FURTHEST_DEG, FURTHEST_DEG))
        return cls(phi, beyond, slope, shift, forces, residual, window_spans(forces))

    @property
    def angle_deg(self) -> float:
        """phi* [deg]."""
        return self.phi_deg + self.step_deg

    @cached_property
    def shape(self) -> FloatArray:
        """Rho = P r / p [-], shape [2 theta]."""
        return (self.residual - self.slope * (self.shift @ self.residual)) / self.spans

    @property
    def along(self) -> FloatArray:
        """Direction of s among shapes, of unit length, shape [2 theta]."""
        found = self.slope / self.spans
        return found / np.linalg.norm(found)


@dataclass(frozen=True, eq=False)
class Seen:
    """A measured record through a library: what a discrepancy is learnt from.

    ``corrected_deg``: error of its angle by each cause that a refined library corrects [deg].
    """

    medium: str
    leg: str
    repose_deg: float | None
    fitted: Fitted
    theta_deg: FloatArray
    corrected_deg: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Level:
    """Student-t distribution of an angle about one that a library's forces give.

    Attributes
    ----------
    offset_deg
        Its centre: what is added to the library's angle [deg].
    parts_deg
        Independent parts of its scale, by name [deg].
    freedom
        Its degrees of freedom.
    """

    offset_deg: float
    parts_deg: Mapping[str, float]
    freedom: float

    @property
    def scale_deg(self) -> float:
        """Its scale [deg]."""
        return float(np.linalg.norm(list(self.parts_deg.values())))

    def wider(self, part: str, sd_deg: float) -> Level:
        """The same with another, independent error."""
        return replace(self, parts_deg={**self.parts_deg, part: sd_deg})

    def bounds(self, low: float, high: float) -> tuple[float, float]:
        """Angles that may be answered, for a library's ends [deg]."""
        reach = WIDEST * self.scale_deg
        return (
            max(low + min(self.offset_deg, 0.0) - reach, ANGLES_DEG[0]),
            min(high + max(self.offset_deg, 0.0) + reach, ANGLES_DEG[1]),
        )

    def log_density(self, core: Posterior, phi_deg: FloatArray) -> FloatArray:
        """Log density of the angle, given the library's: their convolution, shape [k] -> [k]."""
        shares = (np.arange(QUANTILES) + 0.5) / QUANTILES
        at = np.interp(shares, core.cdf, core.phi_deg)
        apart = (phi_deg[:, None] - at - self.offset_deg) / self.scale_deg
        tail = np.square(apart) / self.freedom
        return np.log((np.power(1.0 + tail, -0.5 * (self.freedom + 1.0))).mean(axis=1))


@dataclass(frozen=True, eq=False)
class Learnt:
    """The discrepancy of a library, learnt from measured media.

    Attributes
    ----------
    library, library_hash
        Of which.
    media
        From which, sorted.
    theta_deg
        Leg angles of the shapes [deg], shape [theta].
    shapes
        Mean shape m by leg [-], shape [2 theta] each.
    typical, spread
        Mean and standard deviation of ln T of records that were left out in turn.
    records
        How many records that were.
    levels_deg
        Level of each medium with an angle of repose: mean over its legs of phi* less that [deg].
    between_legs_deg
        Standard deviation of phi* between legs in one medium [deg].
    rms_deg
        Root mean square of phi* less the angle of repose, all records [deg].
    parts_deg
        Standard deviations of parts of the level whose cause is known, by name [deg].
    provenance
        Versions; JSON-able.
    """

    library: str
    library_hash: str
    media: tuple[str, ...]
    theta_deg: FloatArray
    shapes: Mapping[str, FloatArray]
    typical: float
    spread: float
    records: int
    levels_deg: Mapping[str, float]
    between_legs_deg: float
    rms_deg: float
    parts_deg: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def level(self) -> Level:
        """Between soils; see the module."""
        seen = np.array(list(self.levels_deg.values()))
        freedom = FREEDOM + len(seen)
        square = (FREEDOM * SPREAD_DEG**2 + float(seen @ seen)) / freedom
        rest = square - float(np.square(list(self.parts_deg.values())).sum())
        soils = {"soils": float(np.sqrt(max(rest, 0.0)))}
        return Level(0.0, {**self.parts_deg, **soils}, freedom)

    def most(self, accepted: float = ACCEPTED) -> float:
        """Largest deviation that is consistent, over the typical one [-]."""
        from scipy.special import stdtrit

        quantile = float(stdtrit(self.records - 1, accepted))
        # T is a square.
        return float(np.exp(0.5 * quantile * self.spread * np.sqrt(1.0 + 1.0 / self.records)))

    def deviation(self, leg: str, fitted: Fitted, extra: FloatArray | None = None) -> float:
        """Size of a record's deviation, over the typical one of real soils [-].

        It is the smaller of those from their mean and from the model.

        Parameters
        ----------
        leg
            That was moved.
        fitted
            The record.
        extra
            Covariance of what else differs, over that of soils [-], shape [2 theta, 2 theta].
        """
        size, _ = self._apart(leg, fitted, extra)
        return float(np.sqrt(size) * np.exp(-0.5 * self.typical))

    def _apart(
        self, leg: str, fitted: Fitted, extra: FloatArray | None = None
    ) -> tuple[float, FloatArray]:
        return _nearest(fitted, self.shapes[leg], len(self.media), self.theta_deg, extra)

    def expected(self, leg: str, forces: FloatArray) -> FloatArray:
        """Forces of the model with the mean deviation of real soils, g + p m [N], [2 theta]."""
        return forces + window_spans(forces) * self.shapes[leg]

    @property
    def amplitude(self) -> float:
        """Standard deviation of the smooth part of a soil's own shape [-]."""
        # T is a sum of as many squares as there are windows, were the kernel the true one.
        return float(np.exp(0.5 * self.typical) / np.sqrt(2 * len(self.theta_deg)))

    def where(self, leg: str, fitted: Fitted) -> dict[str, Any]:
        """The stretch of leg angles that deviates most: force, angles [deg] and percent of span."""
        apart = self._apart(leg, fitted)[1].reshape(2, -1)
        force, at = np.unravel_index(int(np.abs(apart).argmax()), apart.shape)
        row = apart[force] * np.sign(apart[force, at])
        outside = np.flatnonzero(row < 0.5 * row[at])
        first = int(max(outside[outside < at], default=-1)) + 1
        last = int(min(outside[outside > at], default=row.size)) - 1
        return {
            "force": ("Fx", "Fz")[int(force)],
            "low": float(self.theta_deg[first]),
            "high": float(self.theta_deg[last]),
            "percent": 100.0 * float(apart[force, at]),
        }

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, as its file has them."""
        shapes = {leg: np.round(shape, 6).tolist() for leg, shape in self.shapes.items()}
        return {**vars(self), "theta_deg": np.round(self.theta_deg, 6).tolist(), "shapes": shapes}

    @classmethod
    def from_dict(cls, told: Mapping[str, Any]) -> Learnt:
        """Inverse of :meth:`as_dict`."""
        shapes = {leg: np.array(shape) for leg, shape in told["shapes"].items()}
        theta, media = np.array(told["theta_deg"]), tuple(told["media"])
        return cls(**{**told, "media": media, "theta_deg": theta, "shapes": shapes})


def _nearest(
    fitted: Fitted,
    mean: FloatArray,
    media: int,
    theta_deg: FloatArray,
    extra: FloatArray | None = None,
) -> tuple[float, FloatArray]:
    """T of a record [-], and its shape beside what it is nearer: the media's mean or the model."""
    others, model = fitted.shape - mean, fitted.shape
    from_others = _size(others, fitted, theta_deg, extra) / (1.0 + 1.0 / media)
    from_model = _size(model, fitted, theta_deg, extra)
    return (from_others, others) if from_others < from_model else (from_model, model)


def _size(
    z: FloatArray, fitted: Fitted, theta_deg: FloatArray, extra: FloatArray | None = None
) -> float:
    """z^T (K + kappa s s^T)^-1 z [-]."""
    kernel = np.kron(np.eye(2), matern32(theta_deg, LENGTH_DEG)) + WHITE**2 * np.eye(z.size)
    kernel += FREE * np.outer(fitted.along, fitted.along)
    if extra is not None:
        kernel += extra
    return float(z @ np.linalg.solve(kernel, z))


def learn(
    library: Library,
    seen: Sequence[Seen],
    *,
    parts_deg: Mapping[str, float] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> Learnt:
    """Learn a library's discrepancy from records of several media.

    Parameters
    ----------
    library
        Through which they were seen.
    seen
        Records: every medium on every leg.
    parts_deg, provenance
        As in :class:`Learnt`.

    Raises
    ------
    InputError
        If the media are too few.
    """
    media = tuple(sorted({one.medium for one in seen}))
    if len(media) < FEWEST_MEDIA:
        raise InputError(
            f"{len(media)} media are too few to learn a discrepancy from; {FEWEST_MEDIA} are needed"
        )
    theta = seen[0].theta_deg
    shapes, sizes = {}, []
    for leg in sorted({one.leg for one in seen}):
        own = [one for one in seen if one.leg == leg]
        rows = np.stack([one.fitted.shape for one in own])
        shapes[leg] = rows.mean(axis=0)
        others = len(own) - 1
        for one, row in zip(own, rows, strict=True):
            # From the mean of the others: as a new soil is seen from the mean of all.
            mean = (rows.sum(axis=0) - row) / others
            sizes.append(_nearest(one.fitted, mean, others, theta)[0])
    logs = np.log(sizes)
    known = [one for one in seen if one.repose_deg is not None]
    off = {m: [_off(one) for one in known if one.medium == m] for m in media}
    every = np.array([_off(one) for one in known])
    of_media = [np.array([o.fitted.angle_deg for o in seen if o.medium == m]) for m in media]
    within = sum(float(np.square(a - a.mean()).sum()) for a in of_media)
    free = sum(len(a) - 1 for a in of_media)
    return Learnt(
        library=library.name,
        library_hash=library.hash,
        media=media,
        theta_deg=theta,
        shapes=shapes,
        typical=float(logs.mean()),
        spread=float(logs.std(ddof=1)),
        records=len(logs),
        levels_deg={m: float(np.mean(o)) for m, o in off.items() if o},
        between_legs_deg=float(np.sqrt(within / max(free, 1))),
        rms_deg=float(np.sqrt(np.mean(np.square(every)))) if every.size else float("nan"),
        parts_deg=dict(parts_deg or {}),
        provenance=dict(provenance or {}),
    )


def _off(one: Seen) -> float:
    assert one.repose_deg is not None
    return one.fitted.angle_deg - one.repose_deg


@cache
def shipped() -> Mapping[str, Learnt]:
    """Discrepancies that are shipped, by the name of the library."""
    found = {}
    for name in shipped_names(FOLDER, ".json"):
        text = shipped_file(FOLDER, name, ".json").read_text(encoding="utf-8")
        found[name] = Learnt.from_dict(json.loads(text))
    return found


def learnt_for(library: Library) -> Learnt | None:
    """What is shipped for a library; ``None`` if nothing was learnt of just these simulations."""
    found = shipped().get(library.name)
    return found if found is not None and found.library_hash == library.hash else None


def default_library(histories: Sequence[ForceHistory]) -> tuple[str, str]:
    """The shipped library for histories if nobody names one, and why."""
    best = min(shipped().values(), key=lambda one: one.rms_deg)
    if all("scenario" in history.provenance for history in histories):
        return FOR_SIMULATED, "simulated forces: the library of the same model's coarse preset"
    media = ", ".join(sorted(best.levels_deg))
    return best.library, (
        "measured forces: it comes closest to the angles of repose of the shipped media "
        f"({best.rms_deg:.1f}° root mean square over {media})"
    )


class SoilLikelihood:
    """Log-likelihood of phi* of a measured record: normal about the angle of least squares.

    Parameters
    ----------
    problem
        The data; its noise is inferred from the residual's roughness where it is not given.
    learnt
        The library's discrepancy.
    leg
        That was moved.

    Attributes
    ----------
    fitted
        The record by least squares.
    terms
        Covariance of each term of the residual, by name [N^2], shape [2 theta, 2 theta].
    noise_N
        Noise of a window mean [N].
    """

    def __init__(self, problem: Problem, learnt: Learnt, leg: str) -> None:
        self.problem, self.learnt, self.leg = problem, learnt, leg
        self.fitted = fitted = Fitted.of(problem.leg, problem.data, problem.spans)
        shape, given = problem.noise_shape, problem.noise_sigma
        rough = np.diff(fitted.residual.reshape(2, -1), n=2, axis=1)
        # A second difference of white noise has six times its variance.
        inferred = float(np.sqrt(np.square(rough).mean() / 6.0 / np.diag(shape).mean()))
        self.noise_N = inferred if given is None else given
        deviation = learnt.amplitude * fitted.spans
        self.terms = covariance_terms(
            problem,
            fitted.phi_deg,
            noise_variance=self.noise_N**2,
            discrepancy=np.diag(np.square(deviation)),
        )
        self._extra = problem.leg.opened + (0.0 if given is None else given**2) * shape

    @cached_property
    def sd_deg(self) -> dict[str, float]:
        """Standard deviation of phi* by each term, and between legs [deg]."""
        c = self.fitted.shift
        found = {name: float(np.sqrt(c @ term @ c)) for name, term in self.terms.items()}
        # A deviation that is orthogonal to the slope moves no angle; and what is left of a
        # library's cells and speed-up was seen through it in all media: it is in the level.
        none = dict.fromkeys(found.keys() & {"discrepancy", "refinement"}, 0.0)
        return {**found, **none, "legs": self.learnt.between_legs_deg}

    def __call__(self, phi_deg: FloatArray, /) -> FloatArray:
        """Log-likelihood up to a constant of friction angles [deg], shape [k] -> [k]."""
        square = float(np.square(list(self.sd_deg.values())).sum())
        return -0.5 * np.square(phi_deg - self.fitted.angle_deg) / square

    @cached_property
    def deviation(self) -> float:
        """Size of the record's deviation, over the typical one of real soils [-]."""
        scale = self.learnt.amplitude * self.fitted.spans
        return self.learnt.deviation(self.leg, self.fitted, self._extra / np.outer(scale, scale))

    def measure(self, *, source: str, accepted: float) -> Measure:
        """The deviation beside what real soils have."""
        most = self.learnt.most(accepted)
        return Measure("soil_deviation", self.deviation, most=most, source=source)

    @property
    def by_density_deg(self) -> float:
        """Error of phi* by a density that is assumed [deg]."""
        return DENSITY_ERROR * abs(float(self.fitted.shift @ self.fitted.forces))

    def budget(self, level: Level, *, scale: float) -> Budget:
        """Where the interval comes from, in degrees.

        Parameters
        ----------
        level
            Of the answer.
        scale
            Factor from the library's force unit to the data's [-].
        """
        problem = self.problem
        # The metric of least squares, as a covariance.
        metric = np.diag(np.repeat(np.square(problem.spans), problem.data.size // 2))
        return Budget.of(
            problem,
            self.terms,
            information_share(metric, self.fitted.slope),
            noise=self.noise_N,
            scale=scale,
            discrepancy_of_peak=self.learnt.amplitude,
            fit=None,
            offset=None,
            discrepancy="soils",
            degrees={**self.sd_deg, **level.parts_deg},
        )
