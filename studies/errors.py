"""Fit one mixed model to the error of law `legs` in grains whose friction angle was measured.

    python studies/errors.py [--learn]

    reading − φ = offset(leg) + size(leg) d/w + curve (d/w)^½ + (a + b reading) ln(w/D)
                  + soil + soil × leg + rig + kind of grains or code + bed
                  + error of the shear cell + error of its protocol
                  + measured: errors of hip, friction, gain and density

by restricted maximum likelihood (REML). d is the diameter of the grains, w the width of the leg, D
the depth that it reaches; :mod:`terraphi.laws.model_error` has the row of a record. A reading is
the angle by the law without any offset, of dry soil. Beds scatter in proportion to d/w. In the
measured media of Li et al. φ is free: the differences between their legs determine offsets. Angles
of repose of loose media are critical angles within 1.6°: tilting beds of fourteen simulated soils
begin to flow 0.2° earlier.

What is printed: the components, the effects, and the distance of three legs in one medium.
``--learn`` writes the model into the law's file, where real soil is another kind of grains, of
which Li's media are the only ones; for each shape of leg also the range of φ, the usual shift and
the limit of a misfit. ``benchmarks/phi_bench.py`` compares the model with simpler formulas.

The law changes too little with φ where legs are wide for their depth: that is b. The size of the
grains may act with d/w or its root, by which fine sand differs by 1 to 2°; legs two and three times
as large will decide it, and the curve, within 2°, has this error.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
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

import pages
from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, names
from terraphi.experiment.priors import DENSITY_SD_PART
from terraphi.experiment.rig import LI2013, Rig
from terraphi.inference.checks import without_faults
from terraphi.inference.likelihood import Likelihood
from terraphi.inference.records import open_record
from terraphi.laws.legs import Legs
from terraphi.laws.model_error import MIDDLE_DEG, USUAL_SIZE, ModelError, OfLeg
from terraphi.laws.theory import Theory

ROOT = Path(__file__).parents[1]
CACHE = ROOT / "build" / "readings.json"
SOURCES = ("experiment", "forward", "inference", "laws")
"""Folders of the package that readings depend on."""
SECOND_ENGINE = {"d44": (4.4, 1426.0), "d60": (6.0, 1418.0), "d88": (8.8, 1426.0)}
"""Diameters [mm] and bulk densities [kg/m³] of the beds of another code."""
MEDIA_MM = {"glass03": 0.27, "poppy": 0.7, "yuma": 0.3}
"""Diameters of measured grains [mm]; that of Yuma sand is assumed."""
PROTOCOL_SD_DEG = 0.4
"""Standard deviation of what all truths of a protocol share [deg]: cells of two programs differ by
−0.5 to 0.7° in five soils (:data:`~elements.CRITICAL_STRAIN`), YADE's by 0.6° in soil B."""
REPOSE_DEG, REPOSE_SD_DEG = -0.2, 1.6
"""Angle of repose of loose soil less its critical angle [deg], in fourteen tilted soils. Seven are
spheres (0.5 and 1.1°); four soils of clumps flow 1.6 to 3° earlier."""
LIMIT, MARGIN = 0.98, 1.2
"""Quantile of the residuals over records, and the limit of a misfit over it [-]; chosen."""
COMPONENTS = ("soil", "soil × leg", "rig", "kind", "bed")
PRIOR_SD_DEG, PRIOR_LOG_SD, WIDE_DEG, CURVE_DEG = 1.0, 1.0, 30.0, 2.0
"""Each component is lognormal about 1° by a factor e beforehand, so that one with a single level
has a size; effects are within 30°, the curve over the size within 2°. Chosen."""


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
    phi_sd_deg: float = cells.CELL_SD_DEG

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
    for name, record in cells.records():
        soil = cells.packing(name)
        if soil.endswith("-loose"):
            kind = soils[soil].clump.split(" ")[0] or "spheres"
            yield Record(
                name, f"{kind}/{soil[0]}", record.history.theta_deg, record.history.force,
                record.rig, float(record.density_kg_m3 or 0.0), record.grain_size_mm, *truth(soil),
            )  # fmt: skip
    folder = cells.GRAINS / "second_engine"
    phi = float(elements.critical(*cells.second_cell()).mean())
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
    return replace(Legs.load(cells.LAW), model_error={})


@cache
def stored() -> tuple[bytes, dict[str, dict[str, float]]]:
    """Hash of law and code, and the readings that were made with any."""
    package = ROOT / "src" / "terraphi"
    files = [
        Path(__file__),
        cells.LAW,
        *sorted(x for name in SOURCES for x in package.glob(f"{name}/*.py")),
    ]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in files)).digest()
    return digest, json.loads(CACHE.read_text()) if CACHE.exists() else {}


def readings(record: Record) -> dict[str, float]:
    """What is read off a record without an offset; it is kept on disk.

    Angles by law `legs` and by resistive force theory; by the first the shift of the leg angle
    [deg], the residual of the force that is met worse [-], and of measured records the standard
    deviation of the angle by each of :data:`APPARATUS` [deg].
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
    """What is read off a record, as `readings` returns it."""
    is_measured = record.kind == "measured"
    history = ForceHistory(np.radians(record.theta_deg), record.force_N)
    density = f"{record.density}±{DENSITY_SD_PART * record.density if is_measured else 0.0}"
    stroke = without_faults(open_record(history, rig=record.rig, density=density))
    likelihood = Likelihood([stroke], law())
    residual = (likelihood.data - likelihood.curves(likelihood.least_squares)[0]) / likelihood.span
    budget = likelihood.budget() if is_measured else {}
    return {
        "read": likelihood.least_squares,
        "theory": Likelihood([stroke], Theory()).least_squares,
        "shift": float(likelihood.shift_deg[0]),
        "nrmsd": float(np.sqrt(np.square(residual).reshape(2, -1).mean(axis=1)).max()),
        **{name: budget.get(name, 0.0) for name in APPARATUS},
    }


# -- the mixed model -----------------------------------------------------------------------------


APPARATUS = ("hip height", "leg friction", "gain", "density")
"""What is not known of measured records: the first three alike in all, the last in a soil."""
LEGS = tuple(pages.LEGS)
EFFECTS = (*(f"{cause} {leg}" for cause in ("offset", "grains") for leg in LEGS),
           "grains curve", "breadth", "breadth × reading")  # fmt: skip
PRIOR_OF_EFFECTS_DEG = np.where(np.array(EFFECTS) == "grains curve", CURVE_DEG, WIDE_DEG)
"""Standard deviation of each effect beforehand [deg]."""


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
    soils = alike([row.soil for row in rows])
    truth = np.outer(sd, sd) * soils + PROTOCOL_SD_DEG**2 * protocol
    for name in APPARATUS:
        error = np.array([readings(row).get(name, 0.0) for row in rows])
        truth += np.outer(error, error) * (soils if name == "density" else 1.0)
    return unit, truth


def angles(rows: Sequence[Record]) -> FloatArray:
    """What is read off records by law `legs` [deg]."""
    return np.array([readings(row)["read"] for row in rows])


def columns(rows: Sequence[Record]) -> FloatArray:
    """Columns of the effects and of the free angles, each of a standard deviation of 1°."""
    k = len(EFFECTS)
    names = ModelError(effects=EFFECTS, mean_deg=(0.0,) * k, covariance_deg2=((0.0,) * k,) * k)
    x = np.array([names.row(r.rig, r.grain_size_mm, readings(r)["read"]) for r in rows])
    is_free = np.array([row.phi_deg is None for row in rows])
    free = np.unique(alike([row.soil for row in rows]) * is_free[:, None], axis=1)
    return np.hstack([PRIOR_OF_EFFECTS_DEG * x, WIDE_DEG * free])


class Model:
    """The mixed model, fitted to records.

    Parameters
    ----------
    rows
        Records.

    Attributes
    ----------
    sd_deg
        Standard deviation of each component [deg].
    """

    def __init__(self, rows: Sequence[Record]) -> None:
        self.rows = list(rows)
        phi = [MIDDLE_DEG if row.phi_deg is None else row.phi_deg for row in rows]
        self.y = angles(rows) - phi
        self._unit, truth = shared(rows)
        self._columns = columns(rows)
        # Fixed effects with a wide prior are integrated out, which is REML.
        self._fixed = truth + self._columns @ self._columns.T
        start, bounds = np.zeros(len(COMPONENTS)), [(-4.0, 3.0)] * len(COMPONENTS)
        best = optimize.minimize(self._cost, start, jac=True, method="L-BFGS-B", bounds=bounds)
        self.log_sd = best.x
        self.sd_deg = dict(zip(COMPONENTS, (PRIOR_SD_DEG * np.exp(best.x)).tolist(), strict=True))

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
        """Means of the effects and of the kind of measured media [deg], and their covariance."""
        sd, kind = np.append(PRIOR_OF_EFFECTS_DEG, 1.0), self.sd_deg["kind"]
        is_measured = np.array([[row.kind == "measured"] for row in self.rows])
        across = (
            np.hstack([self._columns[:, : len(EFFECTS)], kind**2 * is_measured]).T * sd[:, None]
        )
        prior = np.diag(np.append(PRIOR_OF_EFFECTS_DEG, kind) ** 2)
        gain = across @ self.precision
        return gain @ self.y, prior - gain @ across.T

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
        unit, truth = shared(joint)
        x = columns([replace(row, phi_deg=row.phi_deg or MIDDLE_DEG) if i >= n else row
                     for i, row in enumerate(joint)])  # fmt: skip
        variance = np.tensordot(np.square([*self.sd_deg.values()]), unit, 1) + truth + x @ x.T
        gain = variance[n:, :n] @ self.precision
        return angles(rows) - gain @ self.y, variance[n:, n:] - gain @ variance[:n, n:]


# -- transfer ------------------------------------------------------------------------------------


def crps(error: FloatArray, sd: FloatArray) -> FloatArray:
    """Continuous ranked probability score of normal predictions [deg].

    Gneiting & Raftery (2007, J. Am. Stat. Assoc. 102:359), equation 21.
    """
    z = error / sd
    return np.asarray(sd * (z * (2.0 * norm.cdf(z) - 1.0) + 2.0 * norm.pdf(z) - np.pi**-0.5))


Outcome = tuple[float, float, str]
"""Error and its standard deviation [deg], and the soil."""


def score(outcomes: Sequence[Outcome]) -> dict[str, float]:
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


def predictions(method: Method, parts: Sequence[Split]) -> dict[str, list[Outcome]]:
    """Error, standard deviation and soil by task; a method does not see what is to be inferred.

    In measured media the truth of a leg is the mean of what the other legs read.
    """
    outcomes: dict[str, list[Outcome]] = {}
    for task, train, test in parts:
        kept = 0.0 if task == "measured" else 1.0
        hidden = [replace(row, phi_deg=None, phi_sd_deg=kept * row.phi_sd_deg) for row in test]
        phi, sd = np.array(method(train, hidden), float).reshape(len(test), 2).T
        if task == "measured":
            same = alike([row.soil for row in test]) - np.eye(len(test))
            truth = same @ phi / same.sum(axis=1)
        else:
            truth = np.array([row.phi_deg for row in test], float)
        soils = [row.soil for row in test]
        outcomes.setdefault(task, []).extend(zip(phi - truth, sd, soils, strict=True))
    return outcomes


def evaluate(method: Method, parts: Sequence[Split]) -> dict[str, dict[str, float]]:
    """Scores of a method by task."""
    return {task: score(outcomes) for task, outcomes in predictions(method, parts).items()}


def terraphi_method(train: list[Record], test: list[Record]) -> list[tuple[float, float]]:
    """φ of test records and its standard deviation, by the mixed model [deg]."""
    phi, covariance = Model(train).predict(test)
    return list(zip(phi.tolist(), np.sqrt(np.diag(covariance)).tolist(), strict=True))


# -- report --------------------------------------------------------------------------------------


def legs_apart(rows: Sequence[Record], measured_rows: Sequence[Record]) -> FloatArray:
    """Distance of legs in one medium, each from their mean: observed and stated RMS [deg].

    The medium is left out; the others are learned from, with φ free where it is not known.
    """
    squares = np.zeros(2)
    soils = sorted({row.soil for row in measured_rows})
    for soil in soils:
        test = [row for row in measured_rows if row.soil == soil]
        train = [*rows, *(row for row in measured_rows if row.soil != soil)]
        phi, covariance = Model(train).predict(test)
        mean = np.eye(len(test)) - 1.0 / len(test)
        squares += np.square(mean @ phi).sum(), np.trace(mean @ covariance)
    return np.sqrt(squares / (len(measured_rows) - len(soils)))


def of_components(model: Model) -> str:
    """A table: components and effects."""
    pairs = zip(model.sd_deg.items(), model.factors(), strict=True)
    rows = [(name, f"{sd:.2f}°", f"{sd / x:.2f} to {sd * x:.2f}°") for (name, sd), x in pairs]
    mean, covariance = model.effects
    sds = np.sqrt(np.diag(covariance))
    named = zip((*EFFECTS, "real soil"), mean, sds, strict=True)
    rows += [(name, f"{value:+.2f}°", f"± {sd:.2f}°") for name, value, sd in named]
    return pages.table(("component", "value", "68 %"), rows)


def residual_limit(rows: Sequence[Record]) -> tuple[float, float]:
    """Limit of a misfit on a leg in fine soil, and its growth up to grains of USUAL_SIZE [-].

    A line over the size of the grains, times the quantile of the residuals over it; soils weigh
    alike in both.
    """
    size = np.array([row.size for row in rows]) / USUAL_SIZE
    nrmsd = np.array([readings(row)["nrmsd"] for row in rows])
    x, weight = (
        np.stack([np.ones_like(size), size], axis=1),
        alike([r.soil for r in rows]).sum(axis=1),
    )
    line, _ = optimize.nnls(x / np.sqrt(weight)[:, None], nrmsd / np.sqrt(weight))
    top = np.quantile(nrmsd / (x @ line), LIMIT, weights=1.0 / weight, method="inverted_cdf")
    limit = MARGIN * top * line
    return float(limit[0]), float(limit[1])


def learned(model: Model) -> ModelError:
    """The model of error that the law's file has."""
    mean, covariance = model.effects
    legs = {}
    for leg in LEGS:
        group = [row for row in model.rows if row.rig.leg == leg and row.kind != "measured"]
        read = [readings(row) for row in group]
        phi = [row.phi_deg for row in group if row.phi_deg is not None]
        limit, of_size = residual_limit([row for row in model.rows if row.rig.leg == leg])
        legs[leg] = OfLeg(
            phi_deg=(round(min(phi), 1), round(max(phi), 1)),
            shift_deg=round(float(np.mean([each["shift"] for each in read])), 1),
            nrmsd_limit=round(limit, 3),
            nrmsd_of_size=round(of_size, 3),
            training=tuple(sorted(row.name for row in group)),
        )
    sd = {name: round(value, 3) for name, value in model.sd_deg.items()}
    return ModelError(
        effects=(*EFFECTS, "real soil"), mean_deg=tuple(mean.round(3).tolist()),
        covariance_deg2=tuple(map(tuple, covariance.round(5).tolist())),
        soil_sd_deg=sd["soil"], leg_sd_deg=sd["soil × leg"], rig_sd_deg=sd["rig"],
        bed_sd_deg=sd["bed"], legs=legs,
    )  # fmt: skip


def main() -> None:
    """Print or write what was learned."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--learn", action="store_true", help="write the law's error")
    options = parser.parse_args()
    with threadpool_limits(1):
        rows, measured_rows = list(grains()), list(media())
        model = Model([*rows, *measured_rows])
        if options.learn:
            shipped = Legs.load(cells.LAW)
            error = {shipped.name: learned(model).model_dump(mode="json")}
            replace(shipped, model_error=error).save(cells.LAW)
        print(f"{of_components(model)}\n")
        observed, stated = legs_apart(rows, measured_rows)
    print(f"Legs in one medium are {observed:.2f}° apart, {stated:.2f}° as stated.")


if __name__ == "__main__":
    main()
