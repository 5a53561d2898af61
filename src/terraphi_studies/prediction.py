"""Prediction: calibrated on the straight leg, what becomes of the C and the reversed C.

Preset ``resolved``, plane strain. For each measured sand the friction angle φ and the friction
μ of sand on the leg are fitted to the forces on the straight leg alone, by least squares of both
forces over their measured peak-to-peak; the other two legs are then simulated with that pair and
compared with forces that the fit has not seen. Forces between the simulated pairs come from a cubic
spline over φ and a parabola over μ, and are proportional to the density, as the soil has no
cohesion. Nothing is tuned to a medium.

Through libraries, which have one friction of the leg, φ alone is fitted to the straight leg in the
same way, and their own forces on the other legs are what they foretell. Through one of them the
height of the hip above the soil, or the friction of the leg, is fitted too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import Measurement, measurement, medium_and_leg, names
from terraphi.experiment.scenario import Scenario
from terraphi.inference.prepared_leg import prepare
from terraphi.library.plan import Plan, Step, value_of
from terraphi.library.shipped import companion
from terraphi.library.store import Case, Library
from terraphi.view.plots import BLUE, ORANGE, Curve
from terraphi.view.table import Table
from terraphi_studies import PAPER_LIBRARY, Study, benchmark, page
from terraphi_studies.benchmark import LEGS, FinishedCase, in_the_sand
from terraphi_studies.measures import (
    FORCES,
    PHI,
    WHOLE_DEG,
    both,
    means_of,
    nrmsd_of_means,
    nrmsd_percent,
)
from terraphi_studies.pictures import legs_figure
from terraphi_studies.planned import Simulations, missing_from, not_yet

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

NAME = "prediction"
TITLE = "Calibrated on the straight leg, and what that foretells of the C and the reversed C"
FRICTION, SHAPE, HIP = "leg.friction", "leg.shape", "motion.hip.1"
CALIBRATED_ON = "straight"
OURS = "resolved"
LIBRARIES = ("resolved-2", "sand3d", "rft3d")
"""Libraries through which φ alone is fitted, and which foretell the other legs."""
TWO_OF = "sand3d"
"""The library of these that has cases with another hip or another friction of the leg."""
HEIGHT, ROUGHNESS = ", height too", ", friction too"
TOO = {HEIGHT: ("raised", HIP), ROUGHNESS: ("friction", FRICTION)}
"""What is added to its name where something else is fitted: the role of the library that has those
cases, and the key that differs."""
BETWEEN = 31
"""Values of that key that are tried."""
COLUMNS = (
    ("medium", "{medium}"),
    ("leg", "{leg}"),
    ("model", "{model}"),
    ("NRMSD Fz", "{Fz:.1f} %"),
    ("NRMSD Fx", "{Fx:.1f} %"),
)
PAPERS = "the paper's MPM"
OTHERS = {"mpm": "preset paper-1", "rft2d": "RFT 2-D", "rft3d": "RFT 3-D"}
"""Models of the benchmark that stand beside ours in Yuma sand."""
METHOD = (
    "Preset `resolved` (plane strain), φ and the leg's friction μ fitted to the straight leg "
    "alone; C and reversed C are simulated with that pair. NRMSD on 1° means over |θ| < 85°, in "
    "percent of the measured peak-to-peak. Through libraries φ alone is fitted to that leg, "
    "through one of them the height of the hip above the soil or the leg's friction too; their "
    "forces on the other legs are what they foretell, of a library that ships refined (`sand3d`) "
    "the refined ones, in all its rows. The other models are not fitted here: theirs is the 35° "
    "that Xu & Wang use for Yuma sand, and RFT 2-D has the generic coefficients of Li "
    f"et al. times {benchmark.YUMA_SCALE}, which gives their own curves for that sand. Plan: "
    "`prediction`. Run again: `terraphi study prediction`."
)
PICTURE = "forces on the three legs in Yuma sand, measured and from the calibrated model"


@dataclass(frozen=True)
class Calibration:
    """What the straight leg says of a sand.

    Attributes
    ----------
    phi_deg, friction
        Friction angle [deg] and friction coefficient of sand on the leg [-], rounded to what is
        then simulated: 0.1° and 0.01.
    at_edge
        Whether the fit ended at an edge of what was simulated.
    nrmsd_percent
        Of the interpolated forces at that pair, by force [%].
    """

    phi_deg: float
    friction: float
    at_edge: bool
    nrmsd_percent: Mapping[str, float]


@dataclass(frozen=True)
class Foretold:
    """What a library makes of a sand, by the straight leg.

    Attributes
    ----------
    phi_deg
        Friction angle, to 0.1° [deg].
    raised_m
        How much higher the hip is than the library's [m]; 0 if that is not fitted.
    friction
        Of the leg [-]; the library's if that is not fitted.
    at_edge
        Whether the angle, or what is fitted beside it, is the first or last that was simulated.
    nrmsd_percent
        Of each measured leg that the library has, by leg and force [%].
    """

    phi_deg: float
    raised_m: float
    friction: float
    at_edge: bool
    nrmsd_percent: Mapping[str, Mapping[str, float]]


def run(*, cases: Simulations) -> Study:
    """Calibrate and predict every shipped sand.

    Parameters
    ----------
    cases
        Where they are, and who simulates what is missing.

    Returns
    -------
    Study
        ``data``: ``calibrated`` (``phi_deg``, ``friction``, ``at_edge`` by medium),
        ``libraries`` (by library and medium ``phi_deg``, ``raised_m``, ``friction`` and
        ``at_edge``),
        ``nrmsd_percent`` by medium, leg, model and force, ``foretold_percent`` (by model that
        foretold all legs, and force: the mean over the C and the reversed C of all media),
        ``better_than`` (of the deviations in Yuma sand, by each model that is not fitted, how many
        of ours lie ``below`` theirs, ``of`` how many; the same of the C and the reversed C alone,
        ``foretold_below`` and ``foretold_of``), ``missing``.

    Raises
    ------
    InputError
        If a straight leg is not simulated yet, the folder cannot be written, or a simulation
        failed.
    """
    plan = Plan.load(NAME)
    finished = cases.histories(plan)
    absent = [s for s in plan.cases() if s.hash not in finished]
    if absent:
        raise InputError(
            f"study '{NAME}': {len(absent)} of {len(plan.cases())} straight legs are not simulated "
            "yet; --build FOLDER simulates what is missing"
        )
    forces = Interpolated(plan, finished)
    media = sands()
    fits = {medium: calibrate(legs[CALIBRATED_ON], forces) for medium, legs in media.items()}
    lacking = missing_from(foretold(plan, media, fits), finished)
    if lacking:
        finished |= cases.histories(legs_plan(plan, lacking))
    own = {name: Library.load(name) for name in LIBRARIES}
    libraries = {
        name: {medium: through(library, legs) for medium, legs in media.items()}
        for name, library in own.items()
    }
    for too, (role, key) in TOO.items():
        others = companion(TWO_OF, role)
        libraries[f"{TWO_OF}{too}"] = {
            medium: through(own[TWO_OF], legs, others, key) for medium, legs in media.items()
        }
    return study_of(plan, media, fits, finished, libraries)


def sands() -> dict[str, dict[str, Measurement]]:
    """The shipped measurements by medium and leg, of the media whose straight leg was measured."""
    found: dict[str, dict[str, Measurement]] = {}
    for name in names():
        one = measurement(name)
        found.setdefault(medium_and_leg(name)[0], {})[one.leg] = one
    return {m: legs for m, legs in found.items() if CALIBRATED_ON in legs}


class Interpolated:
    """Forces on the straight leg between the simulated pairs of φ and μ.

    Parameters
    ----------
    plan
        A sweep over φ and μ.
    finished
        All its histories, by the hash of their scenario.
    """

    def __init__(self, plan: Plan, finished: Mapping[str, ForceHistory]) -> None:
        from scipy.interpolate import CubicSpline

        at = {(s.soil.friction_angle_deg, s.leg.friction): s.hash for s in plan.cases()}
        self.phi_deg, self.friction = (
            np.array(sorted(set(values))) for values in zip(*at, strict=True)
        )
        self.density = plan.scenario.soil.density
        grid = [
            [means_of(finished[at[phi, mu]]) for mu in self.friction.tolist()]
            for phi in self.phi_deg.tolist()
        ]
        self._over_phi = CubicSpline(self.phi_deg, np.array(grid))

    def __call__(self, phi_deg: float, friction: float) -> FloatArray:
        """1° means [N] over |θ| < 85°, shape [theta, 2], of the library's density."""
        weights = _weights(self.friction, np.array([friction]))[0]
        return np.asarray(np.tensordot(weights, self._over_phi(phi_deg), axes=1))


def calibrate(measured: Measurement, forces: Interpolated) -> Calibration:
    """Fit φ and μ to one measured history of the leg that was simulated."""
    from scipy.optimize import least_squares

    data = means_of(measured.history)
    spans = np.ptp(data, axis=0)
    density = measured.density_kg_m3 or forces.density
    low = np.array([forces.phi_deg[0], forces.friction[0]])
    high = np.array([forces.phi_deg[-1], forces.friction[-1]])

    def residual(pair: FloatArray) -> FloatArray:
        guess = density / forces.density * forces(pair[0], pair[1])
        return np.asarray((guess - data) / spans).ravel()

    # The sum of squares may have more than one valley.
    middle = 0.5 * (low[1] + high[1])
    fits = [
        least_squares(residual, [phi, middle], bounds=(low, high), x_scale=high - low)
        for phi in forces.phi_deg[1:-1:2]
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    phi, mu = float(round(best.x[0], 1)), float(round(best.x[1], 2))
    rest = residual(np.array([phi, mu])).reshape(-1, 2)
    fx, fz = (100.0 * np.sqrt(np.mean(np.square(rest), axis=0))).tolist()
    near = np.minimum(best.x - low, high - best.x) < 1e-3 * (high - low)
    return Calibration(phi, mu, bool(near.any()), {"Fx": fx, "Fz": fz})


def through(
    library: Library,
    legs: Mapping[str, Measurement],
    others: Library | None = None,
    key: str = FRICTION,
) -> Foretold:
    """Fit φ to the straight leg of one sand, and compare all its legs with the library there.

    A leg that either library lacks there, or has for other angles alone, is left out.

    Parameters
    ----------
    library
        Whose forces foretell.
    legs
        Measurements of the sand by leg, the straight one among them.
    others
        Cases of the library with other values of ``key``, which is fitted too: between the values
        forces go as the polynomial through all of them. What finer cases change of a library that
        is refined is added to all.
    key
        Dotted scenario key.
    """
    own = library.plan.scenario
    relative = (legs[CALIBRATED_ON].density_kg_m3 or own.soil.density) / own.soil.density
    levels: dict[float, list[Case]] = {value_of(own, key): list(library.cases)}
    for case in others.cases if others else ():
        levels.setdefault(value_of(case.scenario, key), []).append(case)
    curves = [_over_phi(cases) for cases in levels.values()]
    if library.fine:
        curves = [_refined(library, of_level) for of_level in curves]
    ends = {
        leg: (max(c[leg].x[0] for c in curves), min(c[leg].x[-1] for c in curves))
        for leg in legs
        if all(leg in of_level for of_level in curves)
    }
    data = {leg: means_of(legs[leg].history) for leg in ends}
    low, high = ends[CALIBRATED_ON]
    phi = np.round(np.arange(round(10.0 * low), round(10.0 * high) + 1) / 10.0, 1)
    tried = np.linspace(min(levels), max(levels), BETWEEN if others else 1)
    weights = _weights(np.array(list(levels)), tried)

    def forces(leg: str, at: FloatArray) -> FloatArray:
        """Of a sand with each value and angle, shape [value, angle, theta, 2]."""
        return relative * np.tensordot(weights, np.array([c[leg](at) for c in curves]), axes=1)

    off = forces(CALIBRATED_ON, phi) - data[CALIBRATED_ON]
    squares = np.sum(np.square(off / np.ptp(data[CALIBRATED_ON], axis=0)), axis=(2, 3))
    best, angle = np.unravel_index(int(np.argmin(squares)), squares.shape)
    found = own.replace(**{key: float(tried[best])})
    return Foretold(
        float(phi[angle]),
        value_of(found, HIP) - value_of(own, HIP),
        found.leg.friction,
        angle in (0, len(phi) - 1) or (others is not None and best in (0, len(tried) - 1)),
        {
            leg: nrmsd_of_means(data[leg], forces(leg, phi[angle : angle + 1])[best, 0])
            for leg, (first, last) in ends.items()
            if first <= phi[angle] <= last
        },
    )


def _weights(knots: FloatArray, at: FloatArray) -> FloatArray:
    """Of values at knots in the polynomial through them (Lagrange) [-], shape [at, knot]."""
    factors = [
        np.prod([(at - b) / (a - b) for b in knots if b != a], axis=0) * np.ones(at.size)
        for a in knots
    ]
    return np.stack(factors, axis=1)


def _over_phi(cases: Iterable[Case]) -> dict[str, CubicSpline]:
    """1° means [N] over φ [deg] by leg, shape [theta, 2] at each angle."""
    from scipy.interpolate import CubicSpline

    means: dict[str, dict[float, FloatArray]] = {}
    for case in cases:
        if case.history:
            of_leg = means.setdefault(case.scenario.leg.shape, {})
            of_leg[case.scenario.soil.friction_angle_deg] = means_of(case.history)
    return {
        leg: CubicSpline(sorted(of_leg), np.array([of_leg[phi] for phi in sorted(of_leg)]))
        for leg, of_leg in means.items()
    }


def _refined(library: Library, of_level: Mapping[str, CubicSpline]) -> dict[str, CubicSpline]:
    """What :func:`_over_phi` found, with what finer cases change of a library's own forces."""
    from scipy.interpolate import CubicSpline

    found = {}
    for leg, simulated in of_level.items():
        surrogate = prepare(library, leg).surrogate
        change = surrogate.predict(simulated.x) - surrogate.as_simulated.predict(simulated.x)
        parts = [
            [np.interp(WHOLE_DEG, surrogate.theta_deg, force) for force in np.split(row, 2)]
            for row in change
        ]
        found[leg] = CubicSpline(
            simulated.x, simulated(simulated.x) + np.moveaxis(np.array(parts), 1, 2)
        )
    return found


def foretold(
    plan: Plan,
    media: Mapping[str, Mapping[str, Measurement]],
    fits: Mapping[str, Calibration],
) -> dict[str, Scenario]:
    """Each measured leg, ``MEDIUM/LEG``, with its sand's pair; the straight one checks the fit."""
    return {
        f"{medium}/{leg}": plan.scenario.replace(
            **{SHAPE: leg, PHI: fit.phi_deg, FRICTION: fit.friction}
        )
        for medium, fit in fits.items()
        for leg in LEGS
        if leg in media[medium]
    }


def legs_plan(plan: Plan, wanted: Mapping[str, Scenario]) -> Plan:
    """What is wanted as a plan, once where two sands came to the same pair."""
    distinct = {s.hash: (name, s) for name, s in wanted.items()}
    steps = [
        Step(
            name=name,
            after="base",
            changes={
                SHAPE: s.leg.shape,
                PHI: s.soil.friction_angle_deg,
                FRICTION: s.leg.friction,
            },
        )
        for name, s in distinct.values()
    ]
    return Plan(name=NAME, scenario=plan.scenario, steps=steps)


def study_of(
    plan: Plan,
    media: Mapping[str, Mapping[str, Measurement]],
    fits: Mapping[str, Calibration],
    finished: Mapping[str, ForceHistory],
    libraries: Mapping[str, Mapping[str, Foretold]],
) -> Study:
    """The study on what is finished, as :func:`run` says.

    Parameters
    ----------
    plan
        Of the straight legs.
    media, fits
        Measurements and calibrations by medium.
    finished
        Histories by the hash of their scenario.
    libraries
        What libraries make of the media, by library and medium.
    """
    deviations: dict[str, dict[str, dict[str, Mapping[str, float]]]] = {}
    curves: dict[str, dict[str, list[Curve]]] = {}
    wanted = foretold(plan, media, fits)
    for name, scenario in wanted.items():
        medium, leg = name.split("/")
        measured, fit = media[medium][leg], fits[medium]
        row = deviations.setdefault(medium, {}).setdefault(leg, {})
        if scenario.hash in finished:
            ours = in_the_sand(FinishedCase(scenario, finished[scenario.hash]), measured)
            row[OURS] = nrmsd_percent(measured.history, ours)
            label = (
                f"{OURS}, φ = {fit.phi_deg:.1f}° ({scenario.convention}), μ = {fit.friction:.2f}: "
                f"fitted to the {CALIBRATED_ON} leg, the others foretold"
            )
            sand = Curve("measured, Li et al. 2013", measured.history, ORANGE, "")
            curves.setdefault(medium, {})[leg] = [sand, Curve(label, ours, BLUE)]
        row |= {
            name: of_media[medium].nrmsd_percent[leg]
            for name, of_media in libraries.items()
            if leg in of_media[medium].nrmsd_percent
        }
        if medium == "yuma":
            row |= _others(leg)
    means = _means(deviations, (OURS, *libraries))
    better = _better(deviations.get("yuma", {}))
    rows = [
        {"medium": medium, "leg": leg, "model": _said(model), **percent}
        for medium, legs in deviations.items()
        for leg, models in legs.items()
        for model, percent in models.items()
    ]
    table, missing = Table.of(TITLE, COLUMNS, rows), missing_from(wanted, finished)
    repose = {medium: legs[CALIBRATED_ON].angle_of_repose_deg for medium, legs in media.items()}
    notes = [*_notes(fits, libraries, repose), *_compared(means, better), *not_yet(NAME, missing)]
    return Study(
        table=table,
        data={
            "calibrated": {medium: vars(fit) for medium, fit in fits.items()},
            "libraries": _reached_by(libraries),
            "nrmsd_percent": deviations,
            "foretold_percent": means,
            "better_than": better,
            "missing": list(missing),
        },
        figures={f"{NAME}-{medium}": legs_figure(legs) for medium, legs in curves.items()},
        documents=page(NAME, table, METHOD, notes, PICTURE, f"{NAME}-yuma"),
        notes=notes,
    )


def _said(model: str) -> str:
    """A model's name for people; the preset and its library differ."""
    return f"library {model}" if _is_library(model) else model


def _is_library(model: str) -> bool:
    """Whether a model is one of the libraries, whatever is fitted."""
    return any(model.removesuffix(too) in LIBRARIES for too in TOO)


def _others(leg: str) -> dict[str, Mapping[str, float]]:
    """Deviations of the other models in Yuma sand, ours and printed."""
    histories, _ = benchmark.histories_of(PAPER_LIBRARY, leg)
    ours = benchmark.deviations_of(histories)
    fz, fx = benchmark.PAPER_NRMSD[leg]
    return {
        PAPERS: {"Fz": fz, "Fx": fx},
        **{name: ours[model] for model, name in OTHERS.items()},
    }


def _better(legs: Mapping[str, Mapping[str, Mapping[str, float]]]) -> dict[str, dict[str, int]]:
    """Of the deviations that both have, fitted or foretold, how many of ours lie below."""
    found: dict[str, dict[str, int]] = {}
    for leg, models in legs.items():
        for name in [n for n in models if n != OURS and not _is_library(n) and OURS in models]:
            below = sum(models[OURS][force] < models[name][force] for force in FORCES)
            count = found.setdefault(
                name, dict.fromkeys(("below", "of", "foretold_below", "foretold_of"), 0)
            )
            for part in ("", "foretold_") if leg != CALIBRATED_ON else ("",):
                count[f"{part}below"] += below
                count[f"{part}of"] += len(FORCES)
    return found


def _reached_by(libraries: Mapping[str, Mapping[str, Foretold]]) -> dict[str, dict[str, object]]:
    """What each library reached by the straight leg of each medium, JSON-able."""
    keys = ("phi_deg", "raised_m", "friction", "at_edge")
    return {
        name: {medium: {key: getattr(one, key) for key in keys} for medium, one in found.items()}
        for name, found in libraries.items()
    }


def _means(
    deviations: Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]], models: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Mean over all legs that were foretold [%], by model that foretold all of them and force."""
    rows = [
        of_models
        for legs in deviations.values()
        for leg, of_models in legs.items()
        if leg != CALIBRATED_ON
    ]
    return {
        name: {force: float(np.mean([row[name][force] for row in rows])) for force in FORCES}
        for name in models
        if rows and all(name in row for row in rows)
    }


def _notes(
    fits: Mapping[str, Calibration],
    libraries: Mapping[str, Mapping[str, Foretold]],
    repose: Mapping[str, float | None],
) -> list[str]:
    """What the straight leg says of each medium."""
    edge = " (at an edge of what was simulated)"
    return [
        f"{medium}: φ = {fit.phi_deg:.1f}°, μ = {fit.friction:.2f} from the straight leg"
        + (f", where the angle of repose is {repose[medium]:g}°" if repose[medium] else "")
        + f"{edge if fit.at_edge else ''}. Through libraries: "
        + "; ".join(_reached(name, of_media[medium]) for name, of_media in libraries.items())
        + "."
        for medium, fit in fits.items()
    ]


def _reached(name: str, found: Foretold) -> str:
    """What a library reached by the straight leg, in a few words."""
    fitted = {HEIGHT: f"{1e3 * found.raised_m:.1f} mm", ROUGHNESS: f"μ = {found.friction:.2f}"}
    too = "".join(f" and {told}" for ending, told in fitted.items() if name.endswith(ending))
    edge = " (at an edge)" if found.at_edge else ""
    return f"{name} {found.phi_deg:.1f}°{too}{edge}"


def _compared(
    means: Mapping[str, Mapping[str, float]], better: Mapping[str, Mapping[str, int]]
) -> list[str]:
    """How the models that were fitted compare with each other, and ours with the others."""
    rank = ", ".join(f"{_said(name)} {both(percent, ' %')}" for name, percent in means.items())
    return [
        f"Mean deviation Fz / Fx of the C and the reversed C, foretold: {rank}.",
        *(
            f"In Yuma sand {count['below']} of the {count['of']} deviations of {OURS} lie below "
            f"those of {name}, {count['foretold_below']} of the {count['foretold_of']} foretold."
            for name, count in better.items()
        ),
    ]
