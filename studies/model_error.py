r"""Learn how real soils differ from a library's model, and write that into the library's file.

    python studies/model_error.py --library sand3d.nc

Two kinds of soil are compared. Simulated grains (`grains/`) have friction angles that a shear cell
measured, and an apparatus known exactly; the media of Li et al. (2013) are real, and three have an
angle of repose.

Grains of 4 to 9 mm on a leg of 25 mm raise its forces, and sand does not. So the **size of grains**
is taken out of their records first: with F the force over density and over its root mean square in
grains of 6 mm,

    F(θ, d) = F(θ, 0) + d D(θ),

D of each leg and force by least squares over soils stirred in several sizes, each with its own
F(θ, 0), and smooth over θ. What a library reads off the records, by least squares with a shift of
θ, then gives for a leg

- the **offset**: over loose grains, the angle read less the critical angle, a line over φ, with the
  covariance of its coefficients: that of least squares, and that from the size of grains, by the
  jackknife over soils stirred in several sizes;
- what **soils** and **legs** differ by, from a soil's mean over legs and from each leg's distance
  to that. What media of known repose differ by more is common to an apparatus. A prior worth
  PRIOR_SOILS of PRIOR_SD_DEG (PRIOR_COMMON_DEG) keeps each from vanishing;
- the **mean residual** over the model's peak-to-peak, and the limit of a misfit: what remains less
  the mean of all other soils, at the quantile LIMIT over records, times MARGIN.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from terraphi.experiment.history import OBSERVATION_ANGLES, WINDOW_DEG, ForceHistory
from terraphi.experiment.measurements import measurement, names
from terraphi.inference.checks import log_strength, without_faults
from terraphi.inference.likelihood import Likelihood
from terraphi.inference.records import Record, open_record
from terraphi.laws.law import CENTRE_DEG
from terraphi.laws.store import Library

sys.path.insert(0, str(Path(__file__).parent / "grains"))
import elements
import run

GRAINS = Path(__file__).parent / "data" / "grains"
ANGLES_DEG = np.arange(-84.0, 80.0)
"""Leg angles of grains' forces [deg]."""
SMOOTH_DEG, COMMON_MM = 5.0, 6.0
"""Width over which the effect of the size of grains is smoothed [deg]; size that all soils have."""
THETA_DEG = np.linspace(-WINDOW_DEG, WINDOW_DEG, OBSERVATION_ANGLES)
SIZES = ("coarse", "fine")
"""Last parts of the names of soils that are others in another size."""
AGAIN = "second engine"
"""Behind the name of soils that another engine has simulated; nothing is learnt from them."""
SECOND = {
    ("B-loose", "straight", "B_loose_d44_straight.csv"): (4.4, 1426.0),
    ("B-loose", "straight", "B_loose_d60_straight.csv"): (6.0, 1418.0),
    ("B-loose", "c", "B_loose_d60_c.csv"): (6.0, 1418.0),
    ("B-dense", "straight", "B_dense_d60_straight.csv"): (6.0, 1592.0),
}
"""Soil, leg and file of these: diameter [mm] and density [kg/m³]."""
SECOND_DEG = {"B-loose": (26.2, 29.0), "B-dense": (26.2, 38.7)}
"""Critical and peak angle in that engine's shear cell [deg]."""
PRIOR_SOILS, PRIOR_SD_DEG, PRIOR_COMMON_DEG = 2, 1.0, 1.5
LIMIT, MARGIN = 0.95, 1.1
SLOPE_SD = 0.3
"""Standard deviation of the offset's slope over φ before anything is known [-]."""
REPOSE_SD_DEG = 3.0
"""Standard deviation of a critical angle that is known as an angle of repose [deg]."""


class Reading(NamedTuple):
    """What a library reads off the record of one soil with one leg."""

    soil: str
    leg: str
    packing: str
    """``loose``, ``medium`` or ``dense``; of a real medium, as Li et al. have it."""
    real: bool
    """Whether it is a medium of Li et al."""
    record: Record
    """Mean over beds, the size of grains taken out."""
    critical_deg: float
    """Friction angle in plane strain, critical state [deg]; NaN if unknown."""
    peak_deg: float
    """The same at the peak."""
    read_deg: float
    """Angle that the library reads [deg]."""
    with_size_deg: float
    """The same off the record of the finest grains as it is [deg]."""
    shift_deg: float
    """Shift of θ [deg]."""
    strength: float
    """ln of the factor on the library's curves with which the record fits best [-]."""
    residual: np.ndarray
    """Data less curve over the model's peak-to-peak [-], shape [2, theta]."""
    share: np.ndarray
    """Peak-to-peak of the model over that of the data [-], shape [2]."""
    jackknife_deg: tuple[float, ...] = ()
    """Angles read with each soil in several sizes left out of the effect of size [deg]."""


class Bed(NamedTuple):
    """Forces on a leg in grains of one size, mean over beds."""

    diameter_mm: float
    force: np.ndarray
    """[N], at ANGLES_DEG, shape [theta, 2]."""
    density: float
    """[kg/m³]."""


Beds = dict[tuple[str, str], list[Bed]]


def of_grains(folder: Path) -> Beds:
    """Mean forces over the beds of each simulated soil and leg, by size, the finest first."""
    found: Beds = {}
    for name, soil in run.soils().items():
        base, packing, *variant = name.split("-", 2)
        if variant and variant[0] not in SIZES:
            continue
        for leg in soil.legs:
            paths = sorted(folder.glob(f"{name}_{leg}_*.csv"))
            if not paths:
                continue
            beds = [run.load(path) for path in paths]
            force = np.mean([[np.interp(ANGLES_DEG, theta, f) for f in forces]
                             for theta, forces, _ in beds], axis=0).T  # fmt: skip
            density = float(np.mean([density for _, _, density in beds]))
            found.setdefault((f"{base}-{packing}", leg), []).append(
                Bed(soil.diameter_mm, force, density)
            )
    return {key: sorted(beds) for key, beds in found.items()}


def without_size(beds: Beds, left_out: str = "") -> dict[tuple[str, str], np.ndarray]:
    """Force over density of each soil and leg, extrapolated to zero grain size, [theta, 2].

    The effect of size may be learned without one soil, ``A-loose``.
    """
    kernel = np.exp(-0.5 * np.square((ANGLES_DEG[:, None] - ANGLES_DEG) / SMOOTH_DEG))
    kernel /= kernel.sum(axis=1)[:, None]
    size, effect = {}, {}
    for key, own in beds.items():
        bed = min(own, key=lambda one: abs(one.diameter_mm - COMMON_MM))
        size[key] = np.sqrt(np.square(bed.force).mean(axis=0)) / bed.density
    for leg in {leg for _, leg in beds}:
        rows, diameters = [], []
        for key, own in beds.items():
            if key[1] == leg and key[0] != left_out and len(own) > 1 and AGAIN not in key[0]:
                forces = np.array([bed.force / bed.density / size[key] for bed in own])
                d = np.array([bed.diameter_mm for bed in own])
                rows.append(forces - forces.mean(axis=0))
                diameters.append(d - d.mean())
        d = np.concatenate(diameters)
        effect[leg] = kernel @ np.tensordot(d, np.concatenate(rows), axes=1) / (d @ d)
    return {
        key: np.mean(
            [b.force / b.density - b.diameter_mm * size[key] * effect[key[1]] for b in own], axis=0
        )
        for key, own in beds.items()
    }


def record_of(name: str, leg: str, force: np.ndarray, density: float) -> Record:
    """A record of simulated grains."""
    history = ForceHistory(np.radians(ANGLES_DEG), force)
    record = open_record(
        history, rig="li2013", leg=leg, density=f"{density:.1f}±{0.005 * density:.1f}"
    )
    return replace(record, source=f"grains {name}, {leg}")


def read(library: Library, record: Record) -> tuple[float, float, float, np.ndarray, np.ndarray]:
    """Angle, shift, strength, residual and share of a record, as `Reading` has them."""
    likelihood = Likelihood([without_faults(record)], replace(library, model_error={}))
    best, record = likelihood.least_squares, likelihood.records[0]
    curve = likelihood.curves(best[None])[0].reshape(2, -1)
    share = (record.data - curve) / np.ptp(curve, axis=1)[:, None]
    rows = np.stack([np.interp(THETA_DEG, record.theta_deg, row) for row in share])
    return (
        float(best[0]), float(likelihood.shift_deg[0]), log_strength(likelihood, record)[0], rows,
        np.ptp(curve, axis=1) / record.span,
    )  # fmt: skip


def readings(library: Library, folder: Path = GRAINS) -> list[Reading]:
    """All records of grains and of Li et al., read by a library."""
    found = []
    beds = of_grains(folder)
    known = {name: elements.measured(folder, name) for name in {name for name, _ in beds}}
    # The critical state is one of the grains, whatever their packing.
    angles = {
        name: (known[f"{name.split('-')[0]}-loose"].phi_critical_deg, tests.phi_peak_deg)
        for name, tests in known.items()
    }
    for (name, leg, file), (diameter, density) in SECOND.items():
        theta, *force = np.loadtxt(folder / "second_engine" / file, delimiter=",", skiprows=1).T[:3]
        force = np.array([np.interp(ANGLES_DEG, theta, row) for row in force]).T
        key = f"{name} {AGAIN}", leg
        beds.setdefault(key, []).append(Bed(diameter, force, density))
        angles[key[0]] = SECOND_DEG[name]
    fine = without_size(beds)
    sized = sorted({name for (name, _), own in beds.items() if len(own) > 1 and AGAIN not in name})
    jackknife = [without_size(beds, name) for name in sized]
    for (name, leg), own in beds.items():
        density = float(np.mean([bed.density for bed in own]))
        record = record_of(name, leg, density * fine[name, leg], density)
        with_size = record_of(name, leg, own[0].force, own[0].density)
        angle, *rest = read(library, record)
        packing = name.split()[0].split("-")[1]
        found.append(
            Reading(
                name, leg, packing, False, record, *angles[name], angle,
                read(library, with_size)[0], *rest, tuple(
                    read(library, record_of(name, leg, density * one[name, leg], density))[0]
                    for one in jackknife
                ),
            )
        )  # fmt: skip
    for name in names():
        medium, leg = name.removeprefix("li2013:").split("/")
        repose = measurement(name).angle_of_repose_deg
        packing = "dense" if medium.endswith("close") else "loose"
        critical = np.nan if repose is None or packing == "dense" else repose
        peak = np.nan if repose is None else repose
        record = open_record(name)
        angle, *rest = read(library, record)
        found.append(
            Reading(medium, leg, packing, True, record, critical, peak, angle, angle, *rest)
        )
    return found


def line(some: Sequence[Reading], read_deg: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Angle read less the critical one at CENTRE_DEG [deg], and its slope over φ [-].

    The slope has a prior of 0 ± SLOPE_SD, against a scatter of 1° about the line. The second array
    is the covariance of both at that scatter, [2, 2].
    """
    phi = np.array([r.critical_deg for r in some]) - CENTRE_DEG
    design = np.vstack([np.column_stack([np.ones_like(phi), phi]), [0.0, 1.0 / SLOPE_SD]])
    excess = np.append(np.subtract(read_deg, [r.critical_deg for r in some]), 0.0)
    return np.linalg.lstsq(design, excess, rcond=None)[0], np.linalg.inv(design.T @ design)


def size_covariance(some: Sequence[Reading]) -> np.ndarray:
    """Covariance of a line from the effect of the size of grains, by the jackknife, [2, 2]."""
    reads = np.array([r.jackknife_deg for r in some]).T
    if len(reads) < 2:
        return np.zeros((2, 2))
    apart = np.array([line(some, read)[0] for read in reads])
    apart -= apart.mean(axis=0)
    return (len(reads) - 1) / len(reads) * apart.T @ apart


def learn(every: Sequence[Reading]) -> dict[str, dict]:
    """Model error by leg, as `terraphi.laws.law.ModelError` has it."""
    every = [r for r in every if AGAIN not in r.soil]
    loose = [r for r in every if r.packing == "loose" and not np.isnan(r.critical_deg)]
    grains, media = ([r for r in loose if r.real == real] for real in (False, True))
    legs = sorted({r.leg for r in every})
    of_leg = {leg: [r for r in grains if r.leg == leg] for leg in legs}
    lines = {leg: line(some, [r.read_deg for r in some]) for leg, some in of_leg.items()}

    def of_soils(some: Sequence[Reading]) -> list[np.ndarray]:
        """Angles read less those of the leg's line, as angles of the soil, by soil [deg]."""
        apart: dict[str, list[float]] = {}
        for r in some:
            offset, slope = lines[r.leg][0]
            excess = r.read_deg - r.critical_deg - offset - slope * (r.critical_deg - CENTRE_DEG)
            apart.setdefault(r.soil, []).append(excess / (1.0 + slope))
        return [np.array(values) for _, values in sorted(apart.items())]

    def sd(squares: float, count: float, prior: float = PRIOR_SD_DEG) -> float:
        """Root mean square of so many values, with the prior [deg]."""
        total = PRIOR_SOILS * prior**2 + max(squares, 0.0)
        return round(float(np.sqrt(total / (PRIOR_SOILS + count))), 2)

    apart = of_soils(grains)
    several = [one for one in apart if one.size > 1]
    within = sum(float(np.square(one - one.mean()).sum()) for one in several)
    # Each leg has a line of its own, of which all but one take from what legs differ by.
    leg_sd = sd(within, sum(one.size - 1 for one in several) - 2 * (len(legs) - 1))
    squares = [float(one.mean() ** 2) - leg_sd**2 / one.size for one in apart]
    soil_sd = sd(sum(squares), len(apart) - 2)
    # All media are in one apparatus: their mean is the only draw of b.
    of_media = of_soils(media)
    common = 0.0
    if of_media:
        errors = soil_sd**2 + REPOSE_SD_DEG**2
        errors += leg_sd**2 * float(np.mean([1.0 / one.size for one in of_media]))
        common = float(np.mean([one.mean() for one in of_media])) ** 2 - errors / len(of_media)
    common_sd = sd(common, 1 if of_media else 0, PRIOR_COMMON_DEG)
    found = {}
    for leg in legs:
        own = [r for r in every if r.leg == leg]
        left = [remaining(r, own) for r in own]
        (offset, slope), of_fit = lines[leg]
        of_fit = (soil_sd**2 + leg_sd**2) * (1.0 + slope) ** 2 * of_fit
        critical = [r.critical_deg for r in of_leg[leg]]
        found[leg] = {
            "offset_deg": round(float(offset), 2),
            "slope": round(float(slope), 3),
            "covariance": (of_fit + size_covariance(of_leg[leg])).round(5).tolist(),
            "phi_deg": [round(min(critical), 1), round(max(critical), 1)],
            "common_sd_deg": common_sd,
            "soil_sd_deg": soil_sd,
            "leg_sd_deg": leg_sd,
            "shift_deg": round(float(np.mean([r.shift_deg for r in own])), 1),
            "strength": round(float(np.mean([r.strength for r in own])), 2),
            "strength_sd": round(float(np.std([r.strength for r in own], ddof=1)), 2),
            "nrmsd_limit": round(MARGIN * float(np.quantile(left, LIMIT)), 3),
            "theta_deg": THETA_DEG.round(3).tolist(),
            "residual": np.mean([r.residual for r in own], axis=0).round(4).tolist(),
            "training": sorted(r.record.source for r in own),
        }
    return found


def remaining(reading: Reading, every: Sequence[Reading]) -> float:
    """Residual of a record, with or without the mean of all other soils, of peak-to-peak [-]."""
    others = np.mean([r.residual for r in every if r.soil != reading.soil], axis=0)
    return min(
        float((np.sqrt(np.square(rows).mean(axis=1)) * reading.share).max())
        for rows in (reading.residual, reading.residual - others)
    )


def main() -> None:
    """Learn, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--library", required=True, help="file; changed in place")
    path = parser.parse_args().library
    library = Library.load(path)
    every = readings(library)
    for r in every:
        residual = np.sqrt(np.square(r.residual).mean(axis=1))
        print(
            f"{r.soil:14} {r.leg:11} φ {r.read_deg:5.1f}° (with size {r.with_size_deg:5.1f}°)  "
            f"critical {r.critical_deg:5.1f}°  peak {r.peak_deg:5.1f}°  shift {r.shift_deg:+5.1f}°"
            f"  residual {residual.round(3)}"
        )
    error = learn(every)
    for medium in dict.fromkeys(r.soil for r in every if r.real):
        for leg, without in learn([r for r in every if r.soil != medium]).items():
            error[leg].setdefault("without", {})[f"li2013:{medium}"] = without
    for leg, one in error.items():
        print(leg, {key: value for key, value in one.items() if isinstance(value, float)})
    replace(library, model_error=error).save(path)


if __name__ == "__main__":
    main()
