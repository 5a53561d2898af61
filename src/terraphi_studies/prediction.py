"""Prediction: calibrated on the straight leg, what becomes of the C and the reversed C.

Preset ``resolved``, plane strain. For each measured sand the friction angle φ and the friction
μ of sand on the leg are fitted to the forces on the straight leg alone, by least squares of both
forces over their measured peak-to-peak; the other two legs are then simulated with that pair and
compared with forces that the fit has not seen. Forces between the simulated pairs come from a cubic
spline over φ and a parabola over μ, and are proportional to the density, as the soil has no
cohesion. Nothing is tuned to a medium.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import Measurement, measurement, medium_and_leg, names
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import Plan, Step
from terraphi.view.plots import BLUE, ORANGE, Curve
from terraphi.view.table import Table
from terraphi_studies import PAPER_LIBRARY, Study, benchmark, page
from terraphi_studies.benchmark import LEGS, FinishedCase, in_the_sand
from terraphi_studies.measures import FORCES, PHI, means_of, nrmsd_percent
from terraphi_studies.pictures import legs_figure
from terraphi_studies.planned import Simulations, missing_from, not_yet

NAME = "prediction"
TITLE = "Calibrated on the straight leg, and what that foretells of the C and the reversed C"
FRICTION, SHAPE = "leg.friction", "leg.shape"
CALIBRATED_ON = "straight"
OURS = "resolved"
COLUMNS = (
    ("medium", "{medium}"),
    ("leg", "{leg}"),
    ("model", "{model}"),
    ("NRMSD Fz", "{Fz:.1f} %"),
    ("NRMSD Fx", "{Fx:.1f} %"),
)
OTHERS = {"mpm": "preset paper-1", "rft2d": "RFT 2-D", "rft3d": "RFT 3-D"}
"""Models of the benchmark that stand beside ours in Yuma sand."""
METHOD = (
    "Preset `resolved` (plane strain), φ and the leg's friction μ fitted to the straight leg "
    "alone; C and reversed C are simulated with that pair. NRMSD on 1° means over |θ| < 85°, in "
    "percent of the measured peak-to-peak. The other models are not fitted here: theirs is the 35° "
    "that Xu & Wang use for Yuma sand, and RFT 2-D has the generic coefficients of Li et al. times "
    f"{benchmark.YUMA_SCALE}, which gives their own curves for that sand. Plan: `prediction`. Run "
    "again: `terraphi study prediction`."
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
        ``nrmsd_percent`` by medium, leg, model and force, ``better_than`` (of the
        deviations in Yuma sand, by each other model, how many of ours lie ``below`` theirs,
        ``of`` how many; the same of the C and the reversed C alone, ``foretold_below`` and
        ``foretold_of``), ``missing``.

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
    return study_of(plan, media, fits, finished)


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
        weights = [
            np.prod([(friction - b) / (a - b) for b in self.friction if b != a])
            for a in self.friction
        ]
        return np.asarray(np.tensordot(np.array(weights), self._over_phi(phi_deg), axes=1))


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
        if medium == "yuma":
            row |= _others(leg)
    better = _better(deviations.get("yuma", {}))
    rows = [
        {"medium": medium, "leg": leg, "model": model, **percent}
        for medium, legs in deviations.items()
        for leg, models in legs.items()
        for model, percent in models.items()
    ]
    table, missing = Table.of(TITLE, COLUMNS, rows), missing_from(wanted, finished)
    repose = {medium: legs[CALIBRATED_ON].angle_of_repose_deg for medium, legs in media.items()}
    notes = [*_notes(fits, repose, better), *not_yet(NAME, missing)]
    return Study(
        table=table,
        data={
            "calibrated": {medium: vars(fit) for medium, fit in fits.items()},
            "nrmsd_percent": deviations,
            "better_than": better,
            "missing": list(missing),
        },
        figures={f"{NAME}-{medium}": legs_figure(legs) for medium, legs in curves.items()},
        documents=page(NAME, table, METHOD, notes, PICTURE, f"{NAME}-yuma"),
        notes=notes,
    )


def _others(leg: str) -> dict[str, Mapping[str, float]]:
    """Deviations of the other models in Yuma sand, ours and printed."""
    histories, _ = benchmark.histories_of(PAPER_LIBRARY, leg)
    ours = benchmark.deviations_of(histories)
    fz, fx = benchmark.PAPER_NRMSD[leg]
    return {
        "the paper's MPM": {"Fz": fz, "Fx": fx},
        **{name: ours[model] for model, name in OTHERS.items()},
    }


def _better(legs: Mapping[str, Mapping[str, Mapping[str, float]]]) -> dict[str, dict[str, int]]:
    """Of the deviations that both have, fitted or foretold, how many of ours lie below."""
    found: dict[str, dict[str, int]] = {}
    for leg, models in legs.items():
        for name in [n for n in models if n != OURS and OURS in models]:
            below = sum(models[OURS][force] < models[name][force] for force in FORCES)
            count = found.setdefault(
                name, dict.fromkeys(("below", "of", "foretold_below", "foretold_of"), 0)
            )
            for part in ("", "foretold_") if leg != CALIBRATED_ON else ("",):
                count[f"{part}below"] += below
                count[f"{part}of"] += len(FORCES)
    return found


def _notes(
    fits: Mapping[str, Calibration],
    repose: Mapping[str, float | None],
    better: Mapping[str, Mapping[str, int]],
) -> list[str]:
    notes = [
        f"{medium}: φ = {fit.phi_deg:.1f}°, μ = {fit.friction:.2f} from the straight leg"
        + (f", where the angle of repose is {repose[medium]:g}°" if repose[medium] else "")
        + (", at an edge of what was simulated." if fit.at_edge else ".")
        for medium, fit in fits.items()
    ]
    return notes + [
        f"In Yuma sand {count['below']} of our {count['of']} deviations lie below those of {name}, "
        f"{count['foretold_below']} of the {count['foretold_of']} foretold."
        for name, count in better.items()
    ]
