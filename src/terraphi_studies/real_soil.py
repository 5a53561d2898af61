"""Real soil: what a library leaves of measured sands, learnt from some and tried on the others.

Every shipped medium is left out in turn: the discrepancy is learnt from the others, and the medium
is inverted with it. Records that are of no soil, or not what they were said to be, are inverted the
same way: none of them should pass for a real soil.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import Measurement, measurement, medium_and_leg, names
from terraphi.forward import simulate
from terraphi.inference.answer import Inversion
from terraphi.inference.discrepancy import FOLDER, Fitted, Learnt, Seen, learn
from terraphi.inference.inversion import invert
from terraphi.inference.prepared_leg import prepare
from terraphi.inference.trials import Trial
from terraphi.library.store import Library
from terraphi.view.console import as_text
from terraphi.view.table import Table
from terraphi_studies import Progress, Study, page, steps
from terraphi_studies.measures import answer_of
from terraphi_studies.pictures import measured_figure

NAME = "real_soil"
TITLE = "Measured sands, each inverted with what the others taught"
LIBRARY = "resolved"
COLUMNS = (
    ("medium", "{medium}"),
    ("leg", "{leg}"),
    ("repose", lambda a: f"{r:g}°" if (r := a["angle_of_repose_deg"]) is not None else "–"),
    ("φ [deg]", "{phi_median_deg:.1f}"),
    ("68 %", "{ci68_deg[0]:.0f} to {ci68_deg[1]:.0f}"),
    ("95 %", "{ci95_deg[0]:.0f} to {ci95_deg[1]:.0f}"),
    ("deviation", "{deviation:.1f}"),
    ("verdict", lambda a: a["verdict"].replace("_", " ")),
)
METHOD = (
    "`terraphi invert` on every shipped measurement of Li et al. (2013); its discrepancy is learnt "
    "from the other media alone. Deviation: of the record from the mean shape of the others, or "
    "from the model itself if that is nearer, over the typical one of theirs; of all legs the "
    "largest, of which more is accepted. Run again: `terraphi study real_soil`; with `--out` it "
    f"writes the file that the package ships in `data/{FOLDER}`, learnt from all media."
)
LEG_FRICTION_DEG = 0.6
PARTS_DEG = {
    "resolved": {"grid": 1.9, "speed_up": 0.8},
    "resolved-2": {"grid": 0.4, "speed_up": 0.6},
}
"""Parts of the level that are known, by library [deg]: halving the cells moves the mean forces of
preset `resolved` by 1.5° (F_z) and 2.3° (F_x), halving the speed-up by 0.8°, and those of
`resolved-2` by 0 and 0.8° (`study resolution`) and by 0.4 and 0.8° (on 96 cells,
`docs/convergence.md`). Of any library: a friction of the leg anywhere between 0.2 and 0.5 has a
standard deviation of 0.087, worth 0.6° by the mean forces of the cases of `study prediction` at
30°."""
SPACE_DEG = (15.0, 20.0, 25.0, 30.0, 35.0, 40.0)
"""Friction angles of the records by resistive force theory in three dimensions [deg]."""
PLANE = {"poppy_loose": 638.0, "glass03_loose": 1450.0, "glass03_close": 1550.0}
"""Media of the one in two dimensions, and their densities [kg/m³]."""
SCALES = (0.2, 0.4, 0.6, 0.8)
"""Sizes of its generic medium, of 1650 kg/m³ [-]."""
GRAVITIES = {"Moon": 1.0 / 6.0, "Mars": 0.38, "2.5 g": 2.5}
"""Gravities, of the Earth's [-]."""
PICTURE = "friction angles by medium and leg, with their 95 % intervals"
PASSED = "consistent"


class Wrong(NamedTuple):
    """A record that is of no soil, or not what it was said to be."""

    kind: str
    name: str
    medium: str
    trial: Trial


def run(*, library: str | None = None, progress: Progress | None = None) -> Study:
    """Learn from all media but one, and try the result on it; then on false records.

    Parameters
    ----------
    library
        Name or file of the library; :data:`LIBRARY` if not given.
    progress
        Called with the number of inversions done and of all.

    Returns
    -------
    Study
        ``data``: ``answers`` (list, one a record), ``joint`` (one a medium, all legs), ``false``
        (list), ``passed`` by kind (how many of how many are consistent), ``summary`` and
        ``discrepancy``, what is learnt from all media.
    """
    through = Library.load(library or LIBRARY)
    sands = [measurement(name) for name in names()]
    seen = [seen_through(through, one) for one in sands]
    media = sorted({one.medium for one in seen})
    learnt = {m: learn(through, [s for s in seen if s.medium != m]) for m in media}
    whole = learn(
        through, seen, parts_deg=parts_of(through, seen), provenance={"made_by": f"study {NAME}"}
    )
    wrong = list(false_records(sands))
    step = steps(len(sands) + len(media) + len(wrong), progress)

    def inverted(trials: Trial | Sequence[Trial], by: Learnt) -> Inversion:
        return step(invert(trials, library=through, discrepancy=by))

    def answer(one: Measurement, found: Inversion) -> dict[str, Any]:
        return {**answer_of(one, found), **_outcome(found)}

    answers = [
        answer(one, inverted(Trial.of(one), learnt[medium_and_leg(one.name)[0]])) for one in sands
    ]
    joint = []
    for medium in media:
        own = [one for one in sands if medium_and_leg(one.name)[0] == medium]
        found = inverted([Trial.of(one) for one in own], learnt[medium])
        joint.append({**answer(own[0], found), "leg": "all"})
    false = [
        {
            "kind": one.kind,
            "name": one.name,
            "leg": one.trial.leg,
            **_outcome(inverted(one.trial, learnt.get(one.medium, whole))),
        }
        for one in wrong
    ]
    return study_of(answers, joint, false, whole)


def seen_through(library: Library, one: Measurement) -> Seen:
    """A measured record through a library."""
    prepared = prepare(library, one.leg, readings=one.history.position)
    own = prepared.curves.scenario.soil.density
    density = own if one.density_kg_m3 is None else one.density_kg_m3
    data = one.history.observation().vector * own / density
    fitted = Fitted.of(prepared, data, np.ptp(data.reshape(2, -1), axis=1))
    medium, theta_deg = medium_and_leg(one.name)[0], prepared.surrogate.theta_deg
    c, errors = fitted.shift, prepared.surrogate.corrections(fitted.phi_deg)
    corrected = {cause: float(np.sqrt(c @ error @ c)) for cause, error in errors.items()}
    return Seen(medium, one.leg, one.angle_of_repose_deg, fitted, theta_deg, corrected)


def parts_of(library: Library, seen: Sequence[Seen]) -> dict[str, float]:
    """Parts of the level [deg]: of a refined library by its own correction's error."""
    causes = seen[0].corrected_deg
    of_each = {c: [one.corrected_deg[c] for one in seen] for c in causes}
    known = {**PARTS_DEG.get(library.name, {}), "leg_friction": LEG_FRICTION_DEG}
    return {**known, **{c: float(np.sqrt(np.mean(np.square(v)))) for c, v in of_each.items()}}


def false_records(sands: Sequence[Measurement]) -> Iterator[Wrong]:
    """Records by resistive force theory, and measured ones with something wrong."""
    laws = {}
    for case in Library.load("rft3d").cases:
        scenario = case.scenario
        laws[scenario.leg.shape] = scenario
        if case.history and scenario.soil.friction_angle_deg in SPACE_DEG:
            name = f"{scenario.soil.friction_angle_deg:g}°"
            yield _by_law("RFT 3-D", name, scenario.leg.shape, case.history, scenario.soil.density)
    for leg, scenario in laws.items():
        media = [(m, 1.0, density) for m, density in PLANE.items()]
        for medium, scale, density in [*media, *(("generic", s, 1650.0) for s in SCALES)]:
            changed = {"dimensions": 2, "rft.medium": medium, "rft.scale": scale}
            made = simulate(scenario.replace(**changed))
            yield _by_law("RFT 2-D", f"{medium} × {scale:g}", leg, made, density)
    for one in sands:
        yield from _spoilt(one)


def _by_law(kind: str, name: str, leg: str, made: ForceHistory, density: float) -> Wrong:
    """A simulated record as a plain file of forces would have it."""
    return Wrong(kind, name, "", Trial(replace(made, provenance={}), leg, name, density))


def _spoilt(one: Measurement) -> Iterator[Wrong]:
    medium = medium_and_leg(one.name)[0]
    density = one.density_kg_m3 or 0.0
    right = Trial.of(one)

    def record(kind: str, **changes: Any) -> Wrong:
        return Wrong(kind, one.name, medium, replace(right, **changes))

    for leg in ("straight", "c", "reversed_c"):
        if leg != one.leg:
            yield record("wrong leg", leg=leg)
    yield record("density halved", density=0.5 * density)
    yield record("density doubled", density=2.0 * density)
    exchanged = replace(one.history, force=one.history.force[:, ::-1])
    yield record("columns exchanged", history=exchanged)
    for name, share in GRAVITIES.items():
        lighter = replace(one.history, force=share * one.history.force)
        yield record(f"gravity: {name}", history=lighter)


def _outcome(found: Inversion) -> dict[str, Any]:
    return {
        "phi_median_deg": found.phi.median,
        "ci68_deg": list(found.phi.ci68),
        "ci95_deg": list(found.phi.ci95),
        "verdict": found.verdict.verdict,
        "deviation": max(m.value for m in found.verdict.measures if m.code == "soil_deviation"),
    }


def study_of(
    answers: Sequence[Mapping[str, Any]],
    joint: Sequence[Mapping[str, Any]],
    false: Sequence[Mapping[str, Any]],
    learnt: Learnt,
) -> Study:
    """What the answers come to."""
    kinds = dict.fromkeys(one["kind"] for one in false)
    passed = {
        kind: {
            "consistent": sum(o["kind"] == kind and o["verdict"] == PASSED for o in false),
            "of": sum(o["kind"] == kind for o in false),
        }
        for kind in kinds
    }
    told = summary(answers)
    table = Table.of(TITLE, COLUMNS, [*answers, *joint])
    against = (
        f"Against the angles of repose the medians err by {told['rms_deg']:.1f}° root mean square "
        f"({told['mean_deg']:+.1f}° on average). Of {told['with_repose']} records the 95 % "
        f"interval holds them in {told['held95']}, the 68 % interval in {told['held68']}. On "
        f"{told['legs_in_order']} of {told['legs']} legs the media come out in their order."
    )
    false_ones = ", ".join(f"{k} {v['consistent']} of {v['of']}" for k, v in passed.items())
    notes = [
        f"{told['consistent']} of {len(answers)} records are consistent.",
        against,
        f"Median half-width of the 68 % intervals: {told['half_width68_deg']:.1f}°.",
        f"False records that pass for a real soil: {false_ones}.",
    ]
    data = {
        "answers": list(answers),
        "joint": list(joint),
        "false": list(false),
        "passed": passed,
        "summary": told,
        "discrepancy": learnt.as_dict(),
    }
    documents = {
        **page(NAME, table, METHOD, notes, PICTURE),
        f"{learnt.library}.json": as_text(learnt.as_dict()) + "\n",
    }
    figures = {NAME: measured_figure(answers)}
    return Study(table=table, data=data, figures=figures, documents=documents, notes=notes)


def summary(answers: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Errors against the angles of repose, and how often intervals hold them."""
    from scipy.stats import spearmanr

    known = [a for a in answers if a["angle_of_repose_deg"] is not None]
    off = np.array([a["phi_median_deg"] - a["angle_of_repose_deg"] for a in known])

    def held(key: str) -> int:
        return sum(a[key][0] <= a["angle_of_repose_deg"] <= a[key][1] for a in known)

    ranks = {}
    for leg in dict.fromkeys(a["leg"] for a in known):
        own = [a for a in known if a["leg"] == leg]
        pair = [[a[k] for a in own] for k in ("angle_of_repose_deg", "phi_median_deg")]
        ranks[leg] = float(spearmanr(*pair).statistic)
    return {
        "consistent": sum(a["verdict"] == PASSED for a in answers),
        "rms_deg": float(np.sqrt(np.mean(np.square(off)))),
        "mean_deg": float(off.mean()),
        "held68": held("ci68_deg"),
        "held95": held("ci95_deg"),
        "with_repose": len(known),
        "spearman": ranks,
        "legs": len(ranks),
        "legs_in_order": sum(rank > 0.999 for rank in ranks.values()),
        "half_width68_deg": float(np.median([0.5 * np.ptp(a["ci68_deg"]) for a in answers])),
    }
