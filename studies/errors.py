"""Fit one mixed model to the error of law `legs` in grains whose friction angle was measured.

    python studies/errors.py

    reading − φ = offset(leg) + size(leg) (d/w)^p + slope ln(w/D) + slope (φ − 27°)
                  + soil + soil × leg + rig + kind of grains or code + bed
                  + error of the shear cell + error of its protocol

by restricted maximum likelihood (REML). d is the diameter of the grains, w the width of the leg, D
the depth that it reaches; instead of d/w there may be d/D. A reading is the angle by the law
without any offset, with one of four cohesions (:data:`READINGS`). Beds scatter in proportion to
d/w. In the measured media of Li et al. φ is free: the differences between their legs determine
offsets. Angles of repose of loose media less 0.8° are critical angles within 1.3°: tilting beds of
seven simulated soils begin to flow so much later.

A form (reading, d/w or d/D, p, slopes) is chosen by soils and rigs that are left out of what is
learned from, inside of each left-out loop. Printed are the components, the forms and the distance
of three legs in one medium. ``benchmarks/phi_bench.py`` compares the model with simpler formulas.

With 89 loose records and Li's twelve, dry readings (c = 0) with (d/w)^½ and ln(w/D) transfer best:
CRPS .74, .72, .83, .64° to another soil, shape, rig and code, where the average over c with d/w has
.83, 1.16, .90, .71°. The average takes the C in tetrahedra 3.5° low, c = 0 1.4°. A size of 6 mm
adds 6.0 ± 0.8, 4.9 ± 1.0 and 11.6 ± 1.0° on Li's straight, C and reversed C leg, so that fine sand
depends on the power by 2 to 3°: legs two and three times as large will decide it. The slope over
ln(w/D) of 4.8 ± 0.6° is the law's: it changes too little with φ where legs are wide.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import optimize
from scipy.stats import norm
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parent / "grains"))
import elements
import records as cells
import run
import table

import pages
from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, names
from terraphi.experiment.rig import LI2013, Rig
from terraphi.experiment.scenario import GRAVITY
from terraphi.inference.checks import without_faults
from terraphi.inference.likelihood import SHIFT_DEG, Likelihood
from terraphi.inference.records import open_record
from terraphi.laws.legs import Legs
from terraphi.laws.theory import Theory

ROOT = Path(__file__).parents[1]
CACHE = ROOT / "build" / "readings.json"
SOURCES = ("experiment", "forward", "inference", "laws")
"""Folders of the package that readings depend on."""
SECOND_ENGINE = {"d44": (4.4, 1426.0), "d60": (6.0, 1418.0), "d88": (8.8, 1426.0)}
"""Diameters [mm] and bulk densities [kg/m³] of the beds of another code."""
MEDIA_MM = {"glass03": 0.27, "poppy": 0.7, "yuma": 0.3}
"""Diameters of measured grains [mm]; that of Yuma sand is assumed."""
CELL_SD_DEG, PROTOCOL_SD_DEG = 0.4, 0.6
"""Standard deviation of a truth by two or three shear cells, and of what all soils of a protocol
share: two codes differ by 0.3 to 1.3° in the same soils, with one sign [deg]."""
REPOSE_DEG, REPOSE_SD_DEG = 0.8, 1.3
"""Angle of repose of loose soil less its critical angle [deg]."""
MIDDLE_DEG, USUAL_SIZE = 27.0, 6.0 / 25.4
"""φ at which offsets hold [deg]; d/w of most records, at which the scatter of beds holds [-]."""
USUAL_DEPTH_MM = 56.2
COMPONENTS = ("soil", "soil × leg", "rig", "kind", "bed")
PRIOR_SD_DEG, PRIOR_LOG_SD, WIDE_DEG = 1.0, 1.0, 30.0
"""Each component is lognormal about 1° by a factor e beforehand, so that one with a single level
has a size; offsets and slopes are within 30°. Chosen."""


@dataclass(frozen=True)
class Record:
    """A stroke of a leg through soil whose friction angle is known or sought."""

    name: str
    soil: str
    """Kind of grains, or code, and soil: ``spheres/B``."""
    theta_deg: FloatArray
    force_N: FloatArray
    """Fx and Fz of the soil on the leg, shape [angle, 2]."""
    rig: Rig
    density: float
    """Bulk density [kg/m³]."""
    grain_size_mm: float
    phi_deg: float | None
    """Critical friction angle in plane strain; ``None`` where it is to be inferred."""
    phi_sd_deg: float = CELL_SD_DEG

    @property
    def letter(self) -> str:
        """The soil, in whichever code it was simulated."""
        return self.soil.partition("/")[2]

    @property
    def kind(self) -> str:
        """Shape of the grains, or code."""
        return self.soil.partition("/")[0]

    @property
    def size(self) -> float:
        """Diameter of the grains over the width of the leg [-]."""
        return self.grain_size_mm / self.rig.width_mm

    @property
    def depth_mm(self) -> float:
        """Depth that the leg reaches [mm]."""
        return self.rig.length_mm - self.rig.hip_height_mm

    @property
    def usual(self) -> bool:
        """Whether the rig has the width of that of Li et al. (2013)."""
        return self.rig.width_mm == LI2013["width_mm"]

    @property
    def body(self) -> str:
        """Shape and sizes of leg and hip."""
        sizes = (self.rig.length_mm, self.rig.width_mm, self.rig.thickness_mm,
                 self.rig.hip_height_mm)  # fmt: skip
        return f"{self.rig.leg} {sizes}"


def grains() -> Iterator[Record]:
    """Records of legs in loose simulated grains, by both codes."""
    soils, truth = run.soils(), cache(cells.truth)
    for learn in (True, False):
        for name, soil, _, record, size in table.records(learn=learn):
            if soil.endswith("-loose"):
                kind = soils[soil].clump.split(" ")[0] or "spheres"
                yield Record(
                    name, f"{kind}/{soil[0]}", record.history.theta_deg, record.history.force,
                    record.rig, float(record.density_kg_m3 or 0.0),
                    size * record.rig.width_mm / 25.4, truth(soil),
                )  # fmt: skip
    folder = table.GRAINS / "second_engine"
    _, ux, _, tau, sigma, *_, height = np.loadtxt(
        folder / "B_loose_shear.csv", delimiter=",", skiprows=1, unpack=True
    )
    phi = float(elements.critical(ux / height, tau / sigma).mean())
    exact = {"hip_height_sd_mm": 0.0, "leg_friction": 0.35}
    for path in sorted({*folder.glob("B_loose_*_straight*.csv"), *folder.glob("B_loose_*_c.csv")}):
        _, _, beds, leg, *_ = path.stem.split("_")
        theta, *force = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)[:3]
        size, density = SECOND_ENGINE[beds]
        rig = Rig.of("li2013", leg).model_copy(update=exact)
        yield Record(
            path.stem, "second code/B", theta, np.transpose(force), rig, density, size, phi
        )


def media() -> Iterator[Record]:
    """Measured records of Li et al. (2013)."""
    for name in names():
        stroke, medium = measurement(name), name.partition(":")[2].partition("/")[0]
        repose = stroke.angle_of_repose_deg if medium.endswith("_loose") else None
        yield Record(
            name, f"measured/{medium}", stroke.history.theta_deg, stroke.history.force,
            Rig.of(stroke.rig), float(stroke.density_kg_m3 or 0.0),
            MEDIA_MM[medium.partition("_")[0]], repose and repose - REPOSE_DEG, REPOSE_SD_DEG,
        )  # fmt: skip


# -- readings ------------------------------------------------------------------------------------


@cache
def law() -> Legs:
    """Law `legs` without what was learned of its error."""
    return table.without_offset(Legs.load(table.LAW))


@cache
def stored() -> tuple[bytes, dict[str, dict[str, float]]]:
    """Hash of law and code, and the readings that were made with any."""
    package = ROOT / "src" / "terraphi"
    files = [table.LAW, *sorted(x for name in SOURCES for x in package.glob(f"{name}/*.py"))]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in files)).digest()
    return digest, json.loads(CACHE.read_text()) if CACHE.exists() else {}


def readings(record: Record) -> dict[str, float]:
    """Angles that law `legs` and resistive force theory read off a record, without an offset [deg].

    By law `legs` the cohesion is averaged over, 0, or ½ and 1 times ρ g d. They are kept on disk.
    """
    digest, angles = stored()
    parts = (record.rig.model_dump_json(), record.density, record.grain_size_mm)
    arrays = record.theta_deg.tobytes() + np.ascontiguousarray(record.force_N).tobytes()
    key = hashlib.sha256(digest + repr(parts).encode() + arrays).hexdigest()
    if key not in angles:
        angles[key] = {name: round(angle, 4) for name, angle in fitted(record).items()}
        CACHE.parent.mkdir(exist_ok=True)
        CACHE.write_text(json.dumps(angles))
    return angles[key]


def fitted(record: Record) -> dict[str, float]:
    """Angles of a record, as `readings` returns them."""
    history = ForceHistory(np.radians(record.theta_deg), record.force_N)
    stroke = without_faults(open_record(history, rig=record.rig, density=f"{record.density}±0"))
    likelihood = Likelihood([stroke], law())
    start = [likelihood.least_squares, float(likelihood.shift_deg[0])]
    low, high = likelihood.ends
    theory = Likelihood([stroke], Theory()).least_squares
    angles = {"averaged c": start[0], "theory": theory}

    def residual(parameters: FloatArray, cohesion: float) -> FloatArray:
        curve = likelihood.curves(parameters[None, :1], parameters[1:], cohesion)[0]
        return (likelihood.data - curve) / likelihood.span

    for name, share in (("c = ρgd", 1.0), ("c = ½ρgd", 0.5), ("c = 0", 0.0)):
        cohesion = share * record.density * GRAVITY * 1e-3 * record.grain_size_mm
        start = optimize.least_squares(
            residual, np.clip(start, [low + 0.1, -14.9], [high - 0.1, 14.9]), args=(cohesion,),
            bounds=([low, -SHIFT_DEG], [high, SHIFT_DEG]), x_scale=[10.0, 1.0],
        ).x  # fmt: skip
        angles[name] = float(start[0])
    return angles


# -- the mixed model -----------------------------------------------------------------------------


class Form(NamedTuple):
    """How a reading's error is written."""

    reading: str
    length: str
    """What the size of the grains is over: ``w``, the width of the leg, or ``D``, its depth."""
    power: float
    """p of that; 0: the size does not matter."""
    slope: bool
    """Whether the error has a slope over φ."""
    breadth: bool
    """Whether it has one over ln(w/D)."""


READINGS = ("averaged c", "c = 0", "c = ½ρgd", "c = ρgd")
SIZES = (("w", 0.0), ("w", 0.5), ("w", 1.0), ("D", 0.5), ("D", 1.0))
FORMS = [
    Form(reading, *size, False, breadth)
    for reading, size, breadth in itertools.product(READINGS, SIZES, (False, True))
]
LEGS = tuple(pages.LEGS)


def alike(keys: Sequence[object]) -> FloatArray:
    """1 where two records have the same key, shape [n, n]."""
    labels = np.unique([str(key) for key in keys], return_inverse=True)[1]
    return np.equal.outer(labels, labels).astype(float)


def shared(rows: Sequence[Record]) -> tuple[FloatArray, FloatArray]:
    """Covariance by each component of 1° [component, n, n], and that of the truths [deg²]."""
    bed = np.array([row.size for row in rows]) / USUAL_SIZE
    apparatus = [(row.kind == "measured", row.body) for row in rows]
    legs = [(row.letter, row.rig.leg) for row in rows]
    unit = np.stack([
        alike([row.letter for row in rows]), alike(legs), alike(apparatus),
        alike([row.kind for row in rows]), np.diag(bed**2),
    ])  # fmt: skip
    sd = np.array([row.phi_sd_deg for row in rows])
    protocol = alike([row.kind if row.kind in {"measured", "second code"} else "" for row in rows])
    truth = np.outer(sd, sd) * alike([row.soil for row in rows]) + PROTOCOL_SD_DEG**2 * protocol
    return unit, truth


def columns(rows: Sequence[Record], form: Form, phi_deg: FloatArray) -> FloatArray:
    """Columns of the fixed effects, each of a standard deviation of WIDE_DEG, [n, column].

    The last is that of the slope. Where φ is NaN, it is free.
    """
    leg = np.array([[row.rig.leg == name for name in LEGS] for row in rows], float)
    sizes = [(r.depth_mm / USUAL_DEPTH_MM, r.rig.width_mm / 25.4, r.size) for r in rows]
    depth, width, size = np.array(sizes).T[:, :, None]
    size = size / USUAL_SIZE * (width / depth if form.length == "D" else 1.0)
    free = alike([row.soil for row in rows]) * np.isnan(phi_deg)[:, None]
    slope = form.slope * np.nan_to_num(phi_deg - MIDDLE_DEG) / WIDE_DEG
    of_size = [leg * size**form.power] if form.power else []
    breadth = form.breadth * np.log(width / depth)
    return np.hstack([leg, *of_size, np.unique(free, axis=1), breadth, slope[:, None]])


class Model:
    """The mixed model, fitted to records.

    Attributes
    ----------
    sd_deg
        Standard deviation of each component [deg].
    """

    def __init__(self, rows: Sequence[Record], form: Form) -> None:
        self.rows, self.form = list(rows), form
        self.phi = np.array([np.nan if row.phi_deg is None else row.phi_deg for row in rows])
        self.y = self._read(rows) - np.where(np.isnan(self.phi), MIDDLE_DEG, self.phi)
        self._unit, truth = shared(rows)
        self._columns = columns(rows, form, self.phi)
        # Fixed effects with a wide prior are integrated out, which is REML.
        self._fixed = truth + WIDE_DEG**2 * self._columns @ self._columns.T
        start, bounds = np.zeros(len(COMPONENTS)), [(-4.0, 3.0)] * len(COMPONENTS)
        best = optimize.minimize(self._cost, start, jac=True, method="L-BFGS-B", bounds=bounds)
        self.log_sd = best.x
        self.sd_deg = dict(zip(COMPONENTS, (PRIOR_SD_DEG * np.exp(best.x)).tolist(), strict=True))

    def _read(self, rows: Sequence[Record]) -> FloatArray:
        """Readings [deg]."""
        return np.array([readings(row)[self.form.reading] for row in rows])

    def _variance(self, log_sd: FloatArray) -> FloatArray:
        """Covariance of the readings [deg²]."""
        return self._fixed + np.tensordot(PRIOR_SD_DEG**2 * np.exp(2.0 * log_sd), self._unit, 1)

    def _cost(self, log_sd: FloatArray) -> tuple[float, FloatArray]:
        """Negative log density of the readings and the components, and its slope."""
        variance = self._variance(log_sd)
        precision = np.linalg.inv(variance)
        weighted = precision @ self.y
        cost = 0.5 * (np.linalg.slogdet(variance)[1] + self.y @ weighted)
        flat = self._unit.reshape(len(COMPONENTS), -1)
        trace, square = flat @ precision.ravel(), (self._unit @ weighted) @ weighted
        slope = PRIOR_SD_DEG**2 * np.exp(2.0 * log_sd) * (trace - square)
        prior = log_sd / PRIOR_LOG_SD**2
        return cost + 0.5 * float(log_sd @ prior), slope + prior

    @cached_property
    def precision(self) -> FloatArray:
        """Inverse of the covariance of the readings [1/deg²], shape [n, n]."""
        return np.linalg.inv(self._variance(self.log_sd))

    @cached_property
    def effects(self) -> tuple[FloatArray, FloatArray]:
        """Means of the fixed effects [deg] and their covariance."""
        gain = WIDE_DEG**2 * self._columns.T @ self.precision
        covariance = WIDE_DEG**2 * (np.eye(gain.shape[0]) - gain @ self._columns)
        return gain @ self.y, covariance

    def factors(self) -> FloatArray:
        """Factors of the components to either side, by the curvature at the best point."""
        step = 1e-3
        curvature = [
            (self._cost(self.log_sd + move)[1] - self._cost(self.log_sd - move)[1]) / (2.0 * step)
            for move in step * np.eye(len(COMPONENTS))
        ]
        return np.exp(np.sqrt(np.diag(np.linalg.inv(curvature))))

    def predict(self, rows: Sequence[Record]) -> tuple[FloatArray, FloatArray]:
        """φ of other records [deg] and their covariance [deg²]."""
        joint, n = [*self.rows, *rows], len(self.rows)
        slope = float(self.effects[0][-1]) / WIDE_DEG
        unit, truth = shared(joint)
        variance = np.tensordot(np.square([*self.sd_deg.values()]), unit, 1) + truth
        middle = np.full(len(rows), MIDDLE_DEG)
        x = columns(joint, self.form, np.concatenate([self.phi, middle]))
        mean = (variance + WIDE_DEG**2 * x @ x.T)[n:, :n] @ self.precision @ self.y
        phi = MIDDLE_DEG + (self._read(rows) - MIDDLE_DEG - mean) / (1.0 + slope)
        x = columns(joint, self.form, np.concatenate([self.phi, phi]))
        variance = variance + WIDE_DEG**2 * x @ x.T
        gain = variance[n:, :n] @ self.precision
        return phi, (variance[n:, n:] - gain @ variance[:n, n:]) / (1.0 + slope) ** 2

    def left_out(self) -> float:
        """Sum of the CRPS of left-out soils and of rigs that are left out with their soil [deg].

        With the precision P of all, a group g is e_g = P_gg⁻¹ (P y)_g from its prediction by the
        others, with the covariance P_gg⁻¹; components stay as they are.
        """
        letters, bodies = (np.array([getattr(r, k) for r in self.rows]) for k in ("letter", "body"))
        sheared = [row for row in self.rows if row.kind != "measured"]
        groups = {(row.letter, "") for row in sheared}
        groups |= {(row.letter, row.body) for row in sheared if not row.usual}
        slope, outcomes = 1.0 + float(self.effects[0][-1]) / WIDE_DEG, {}
        for letter, body in groups:
            group = (letters == letter) | (bodies == body)
            scored = ((letters == letter) & ((bodies == body) | (not body)))[group]
            covariance = np.linalg.inv(self.precision[np.ix_(group, group)])
            error = covariance @ (self.precision @ self.y)[group] / slope
            sd = np.sqrt(np.diag(covariance)) / slope
            triples = zip(error[scored], sd[scored], itertools.repeat(letter), strict=False)
            outcomes.setdefault(bool(body), []).extend(triples)
        return sum(score(triples)["crps"] for triples in outcomes.values())


def choose(rows: Sequence[Record], forms: Sequence[Form] = FORMS) -> Model:
    """The model of the form that reads left-out soils and rigs best; of a single form, that."""
    if len(forms) == 1:
        return Model(rows, forms[0])
    best = min((Model(rows, form) for form in forms), key=Model.left_out)
    return min(best, Model(rows, best.form._replace(slope=True)), key=Model.left_out)


# -- transfer ------------------------------------------------------------------------------------


def crps(error: FloatArray, sd: FloatArray) -> FloatArray:
    """Continuous ranked probability score of normal predictions [deg].

    Gneiting & Raftery (2007, J. Am. Stat. Assoc. 102:359), equation 21.
    """
    z = error / sd
    return np.asarray(sd * (z * (2.0 * norm.cdf(z) - 1.0) + 2.0 * norm.pdf(z) - np.pi**-0.5))


def score(outcomes: Sequence[tuple[float, float, str]]) -> dict[str, float]:
    """CRPS, RMS, bias, z and coverage of errors with their SD and soil, soils weighing alike."""
    error, sd = np.array([outcome[:2] for outcome in outcomes]).T
    same = alike([soil for _, _, soil in outcomes])
    weight = 1.0 / same.sum(axis=1) / (1.0 / same.sum(axis=1)).sum()
    z = error / sd
    return {
        "crps": float(weight @ crps(error, sd)), "rms": float(np.sqrt(weight @ error**2)),
        "bias": float(weight @ error), "z": float(np.sqrt(weight @ z**2)),
        "in68": float(weight @ (np.abs(z) < norm.ppf(0.84))),
        "in95": float(weight @ (np.abs(z) < norm.ppf(0.975))), "n": len(error),
    }  # fmt: skip


class Split(NamedTuple):
    """Records to learn from, and others to be read, of a task."""

    task: str
    train: list[Record]
    test: list[Record]


def splits(rows: Sequence[Record], measured_rows: Sequence[Record]) -> Iterator[Split]:
    """Splits of all tasks; no soil is in both parts.

    A rig is left out together with the soil that it stirs.
    """
    spheres = [row for row in rows if row.kind == "spheres"]
    tasks = [("soil", row.letter, "", "spheres") for row in spheres]
    tasks += [("code" if row.kind == "second code" else "shape", "", "", row.kind)
              for row in rows if row.kind != "spheres"]  # fmt: skip
    tasks += [("rig", row.letter, row.body, "spheres") for row in spheres if not row.usual]
    for task, letter, body, kind in dict.fromkeys(tasks):
        test = [row for row in rows if row.kind == kind
                and letter in {"", row.letter} and body in {"", row.body}]  # fmt: skip
        letters = {row.letter for row in test}
        train = [row for row in rows if row.letter not in letters and row.body != body]
        if kind != "spheres":
            train = [row for row in train if row.kind != kind]
        yield Split(task, train, test)
    yield Split("measured", list(rows), list(measured_rows))


Method = Callable[[list[Record], list[Record]], Sequence[tuple[float, float]]]


def evaluate(method: Method, parts: Sequence[Split]) -> dict[str, dict[str, float]]:
    """Scores of a method by task; it does not see what is to be inferred.

    In measured media the truth of a leg is the mean of what the other legs read.
    """
    outcomes: dict[str, list[tuple[float, float, str]]] = {}
    for task, train, test in parts:
        hidden = [replace(row, phi_deg=None, phi_sd_deg=CELL_SD_DEG) for row in test]
        phi, sd = np.array(method(train, hidden), float).reshape(len(test), 2).T
        if task == "measured":
            same = alike([row.soil for row in test]) - np.eye(len(test))
            truth = same @ phi / same.sum(axis=1)
        else:
            truth = np.array([row.phi_deg for row in test], float)
        soils = [row.soil for row in test]
        outcomes.setdefault(task, []).extend(zip(phi - truth, sd, soils, strict=True))
    return {task: score(triples) for task, triples in outcomes.items()}


def terraphi_method(
    train: list[Record], test: list[Record], forms: Sequence[Form] = FORMS
) -> list[tuple[float, float]]:
    """φ of test records and its standard deviation, by the mixed model [deg]."""
    phi, covariance = choose(train, forms).predict(test)
    return list(zip(phi.tolist(), np.sqrt(np.diag(covariance)).tolist(), strict=True))


# -- report --------------------------------------------------------------------------------------


def legs_apart(rows: Sequence[Record], measured_rows: Sequence[Record], form: Form) -> FloatArray:
    """Distance of legs in one medium, each from their mean: observed and stated RMS [deg].

    The medium is left out; the others are learned from, with φ free where it is not known.
    """
    squares = np.zeros(2)
    soils = sorted({row.soil for row in measured_rows})
    for soil in soils:
        test = [row for row in measured_rows if row.soil == soil]
        train = [*rows, *(row for row in measured_rows if row.soil != soil)]
        phi, covariance = Model(train, form).predict(test)
        mean = np.eye(len(test)) - 1.0 / len(test)
        squares += np.square(mean @ phi).sum(), np.trace(mean @ covariance)
    return np.sqrt(squares / (len(measured_rows) - len(soils)))


def of_components(model: Model) -> str:
    """A table: components, offsets and effects of grains of 6 mm on the leg of Li et al."""
    pairs = zip(model.sd_deg.items(), model.factors(), strict=True)
    rows = [(name, f"{sd:.2f}°", f"{sd / x:.2f} to {sd * x:.2f}°") for (name, sd), x in pairs]
    mean, covariance = model.effects
    causes = ["offset", "grains"][: 1 + bool(model.form.power)]
    labels = [*itertools.product(causes, LEGS), ("ln(w/D)", ""), (f"φ, for {WIDE_DEG:g}°", "")]
    places = [*range(len(labels) - 2), -2, -1]
    for (cause, leg), i in zip(labels, places, strict=True):
        if covariance[i, i] < 0.99 * WIDE_DEG**2:
            rows.append((f"{cause} {leg}", f"{mean[i]:+.2f}°", f"± {covariance[i, i] ** 0.5:.2f}°"))
    return pages.table(("component", "value", "68 %"), rows)


def label(form: Form) -> str:
    """A form in words."""
    size = f"(d/{form.length})^{form.power:g}" if form.power else "no size"
    return f"{form.reading}, {size}{', φ' * form.slope}{', w/D' * form.breadth}"


def main() -> None:
    """Print components, forms, and the distance of legs."""
    rows, measured_rows = list(grains()), list(media())
    parts = list(splits(rows, measured_rows))
    tasks = list(dict.fromkeys(part.task for part in parts))
    table_rows = []
    with threadpool_limits(1):
        chosen = choose([*rows, *measured_rows])
        print(f"# {label(chosen.form)}\n\n{of_components(chosen)}\n")
        candidates = [[form] for form in [*FORMS, chosen.form._replace(slope=True)]]
        for forms in [list(FORMS), *candidates]:
            scores = evaluate(partial(terraphi_method, forms=forms), parts)
            form = chosen.form if len(forms) > 1 else forms[0]
            apart = legs_apart(rows, measured_rows, form)
            texts = [
                f"{x['crps']:.2f}; {x['rms']:.1f} ({x['bias']:+.1f}); {x['z']:.1f}; "
                f"{x['in68']:.0%}, {x['in95']:.0%}"
                for x in (scores[task] for task in tasks)
            ]
            texts[-1] += "; {:.2f} / {:.2f}".format(*apart)
            name = label(form) if len(forms) == 1 else "chosen in the loop"
            table_rows.append((name, *texts))
    print(pages.table(("form", *tasks), table_rows))
    print(
        "\nCRPS; RMS (bias) [deg]; z; in 68 and 95 %. Last: legs apart, as read / as stated [deg]."
    )


if __name__ == "__main__":
    main()
