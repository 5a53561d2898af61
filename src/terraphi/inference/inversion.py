"""The front door: forces in, the friction angle out."""

from __future__ import annotations

import functools
import importlib.metadata
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.priors import DAMP_PA
from terraphi.experiment.rig import with_rig
from terraphi.inference.answer import BY_LAW, Answer, Edge, Estimate, RecordFit
from terraphi.inference.checks import (
    UNUSUAL,
    Reading,
    in_air,
    leg_readings,
    second_opinion,
    warnings,
    without_faults,
)
from terraphi.inference.likelihood import Likelihood, quadrature
from terraphi.inference.records import Record, open_records, rig_name, with_sd
from terraphi.inference.verdict import Judgment, consistent, large_residual, misfit, out_of_range
from terraphi.laws.legs import FORMER_NAME, LawOfLegs, Legs, shipped_legs
from terraphi.laws.model_error import FINE_MM

if TYPE_CHECKING:
    from terraphi.inference.calibration import Calibration
    from terraphi.inference.pressed import PressedRecord
    from terraphi.laws.law import AnyLaw

BETTER_LEG = 0.9
"""Residual by another leg over that by the record's own at which the leg is taken for wrong [-]:
at least 0.95 in all training records."""
LEAST_COVERAGE = 0.9
"""Share of a stroke's information on φ that a comparison with other legs needs [-]; chosen."""
FAR = 4.0
"""Standard deviations above which chance explains nothing (1 in 16,000) [-]: of chi-square of a
simulated record, and of a calibration soil's known angle."""
SHARE, SHARE_ENDS = (0.57, 0.18), (0.25, 1.0)
"""Where φ of dense soil lies from critical to peak, mean and standard deviation [-]: seven packed
records of simulated grains, by their size (``docs/grains.md``); a strip footing on Toyoura sand has
0.59 to 0.72 (``docs/sheared_sands.md``). The ends are chosen."""
DENSEST_DEG, LOOSEST_DEG = 20.0, -5.0
"""Peak less critical angle [deg] at relative densities I_D of 1 and 0, in plane strain: 5 I_R with
I_R = 5 I_D − 1 below 150 kPa, and none of looser soil (Bolton 1986, 1987, Géotechnique 36:65 and
37:225). Every relative density is as likely."""
LOOSE, CONTRADICTED = 1.64, 2.58
"""Standard deviations below which φ is not above the critical angle [-], one in twenty; and above
which both contradict each other, one in a hundred."""
SIMULATED = 0.08
"""Residual of a simulation above which law ``legs`` does not describe it, over the range [-]:
chosen; simulations of Li's legs that nothing was fitted to have 1 to 3 %."""
SHORTEST = 0.7
"""Least part of a stroke over which the limit is shared out [-], so that it grows by a fifth at
most: residuals of 125 records of grains, cut to 0.5 to 0.9 of a stroke in five ways, are 1.06 to
1.20 times those of the whole (median). Of 48 parts of Li's strokes whose Fx was multiplied by 0.7
or 1.4, 15 are misfits with it, 6 with 0.5 and 20 with 1."""


def invert(
    forces: Any,
    *,
    leg: str | None = None,
    rig: Any = None,
    tool: str | None = None,
    friction: float | str | None = None,
    density: float | str | None = None,
    grain_size_mm: float | None = None,
    cohesion: float | str | None = None,
    columns: Any = None,
    law: AnyLaw | Path | str | None = None,
    noise: float | tuple[float, float] | None = None,
    gain: float | str | None = None,
    calibration: Calibration | Path | str | None = None,
    critical: float | str | None = None,
    simulated: bool | None = None,
) -> Answer:
    """Infer the friction angle from forces on a leg or a tool.

    Parameters
    ----------
    forces
        A table of text or a NetCDF file, a shipped measurement such as ``"li2013:yuma/c"``, a force
        history, a DataFrame, an xarray Dataset; or a list of these, of one soil.
    leg
        Shape of the leg: ``straight``, ``c`` or ``reversed_c``; ``None``: that of the rig.
    rig
        The apparatus: a :class:`Rig`, a mapping of its keys, a TOML file, or ``"li2013"`` for that
        of Li et al. (2013); ``None``: from the forces' file, which tables of text do not have.
        Records of another leg or rig in a list are named such as ``"forces.csv@c"``,
        ``"forces.csv@rig.toml"`` or ``(table, rig)``; different rigs are joined by their angles.
    tool
        ``plate:151``, ``plate:38x25`` or ``ball:44`` [mm] in place of a leg: a body pressed
        straight down, with the columns sinkage and force or pressure; or
        ``wheel:314x165+lugs:30x10``, a wheel, with the columns slip, load and sinkage; or a
        :class:`~terraphi.experiment.rig.Tool`. ``law`` is then one of feet. Of records of several
        bodies in one soil, those of tools are named such as ``"plate.csv@plate:151"``, or
        ``(table, "plate:151")``; ``law`` and ``columns`` are then those of the legs.
    friction
        Coulomb friction between soil and tools [-], as ``"0.5±0.05"``; that of a leg belongs to its
        rig.
    density
        Bulk density [kg/m³], as a number (± 5 %) or ``"1600±80"``; ``None``: from the forces' file,
        else that of :mod:`~terraphi.experiment.priors`.
    grain_size_mm
        Mean diameter of the grains [mm], where they are not small compared with the leg or tool:
        what simulated grains of 4 to 9 mm raise φ by is taken off.
    cohesion
        Cohesion of the soil [Pa], as a number, as ``"150±50"``, or ``"unknown"``; ``None``: dry.
        Forces on a leg determine the cohesion worse than φ.
    columns
        Which columns of a table are what, as a mapping of the options of
        :func:`terraphi.read_forces`, or a TOML file of them; ``None``: guessed.
    law
        A law, its file or its name, or a library, which is joined to law ``legs``; ``None``:
        ``legs``, and for forces that resistive force theory simulated ``rft3d``.
    noise
        Standard deviation of one reading [N], of both forces or of each; ``None``: from the
        readings' roughness.
    gain
        What the sensor reads over the true force [-], as ``"1.05±0.01"``; ``None``: 1 ± 2 %.
    calibration
        Soils of known friction angle in the same apparatus, or their file.
    critical
        Critical angle of the soil in plane strain [deg], as a number (± 1°) or ``"33±1"``: φ is not
        below it, and of dense soil the answer has the peak angle, of which a leg in grains reads a
        share (``SHARE``).
    simulated
        Whether the forces are simulated, so that the library's model is exact; ``None``: from
        their file.

    Returns
    -------
    Answer
        Its ``records`` are in the order of the list, but those on one rig together, and
        those of tools last.

    Raises
    ------
    InputError
        If the rig is not known, or forces, rig, density, library or calibration cannot be used.

    Examples
    --------
    >>> terraphi.invert("li2013:poppy_loose/straight").verdict
    'consistent'
    """
    began = time.perf_counter()
    records = open_records(
        forces, leg=leg, rig=rig, tool=tool, friction=friction, density=density,
        grain_size_mm=grain_size_mm, cohesion=cohesion, columns=columns, noise=noise, gain=gain,
        simulated=simulated,
    )  # fmt: skip
    answer, *further = _answers(records, law, calibration, began)
    if further:
        from terraphi.inference.combined import combined

        answer = combined([answer, *further])
    return answer if critical is None else with_critical(answer, critical)


def _answers(
    records: Sequence[Record | PressedRecord],
    law: AnyLaw | Path | str | None,
    calibration: Calibration | Path | str | None,
    began: float,
) -> list[Answer]:
    """Answers by law and body: legs, by law ``legs`` one for each rig, then tools one by one."""
    legs = [without_faults(record) for record in records if isinstance(record, Record)]
    tools = [record for record in records if not isinstance(record, Record)]
    if calibration is not None and not legs:
        raise InputError("a tool excludes calibration; leave out one or the other")
    answers: list[Answer] = []
    cohesions = sorted({(record.cohesion_pa, record.cohesion_sd_pa) for record in legs})
    if len(cohesions) > 1:
        texts = " and ".join(f"{mean:g}±{sd:g} Pa" for mean, sd in cohesions)
        raise InputError(f"soils with a cohesion of {texts} are not one soil; infer each alone")
    if legs:
        from threadpoolctl import threadpool_limits

        law, reason = law_for(legs, law)
        calibration = None if calibration is None else _opened(calibration, law, legs)
        # The offset of law legs is that of one rig alone, so that answers of different rigs are
        # joined by their angles. In one fit, which shared a cohesion, grains were read 4° wrong.
        # The matrices are small: threads would only wait for each other.
        with threadpool_limits(limits=1, user_api="blas"):
            for conditions in dict.fromkeys(record.conditions for record in legs):
                strokes = [record for record in legs if record.conditions == conditions]
                answers.append(_answer(strokes, law, calibration, reason, began))
        # One soil has one density, and the law that was named is one of legs.
        density, sd = answers[0].density_kg_m3, answers[0].density_sd_kg_m3 or 0.0
        tools = [
            replace(tool, density_kg_m3=density, density_sd_kg_m3=sd, density_assumed=False)
            for tool in tools
        ]
        law = None
    if tools:
        from terraphi.inference.pressed import invert_pressed

        answers += [invert_pressed(tool, law) for tool in tools]
    return answers


def _opened(
    calibration: Calibration | Path | str, law: LawOfLegs, records: Sequence[Record]
) -> Calibration:
    """A calibration from memory or its file, that is of a law and the gains of records."""
    from terraphi.inference.calibration import Calibration

    if isinstance(calibration, str | Path):
        calibration = Calibration.load(calibration)
    if not isinstance(calibration, Calibration):
        raise InputError(
            f"calibration of type {type(calibration).__name__}; give its file, or a Calibration"
        )
    calibration.check(law, {rig_name(record.rig): record.gain for record in records})
    return calibration


def with_critical(answer: Answer, critical: float | str) -> Answer:
    """An answer of soil whose critical angle is known [deg]: φ is not below it.

    The relative density is as likely at each value, so that φ moves toward the critical angle.
    Soil is loose if φ by the forces exceeds the critical angle by less than 1.64 standard
    deviations of both; otherwise the answer has the peak angle as well.

    Raises
    ------
    InputError
        If it is no angle, or the answer's φ is none of plane strain.
    """
    mean, sd = with_sd("critical", critical, "degrees as 33 or 33±1", (0.0, 60.0))
    sd = 1.0 if sd is None else sd
    if answer.convention != "plane_strain" or answer.records[0].simulated:
        raise InputError("critical is of measured forces by a law in plane strain; leave it out")
    if answer.verdict != "consistent":
        return answer
    joint_sd = math.hypot(answer.phi.sd, sd)
    excess, least, most = answer.phi.median - mean, LOOSE * joint_sd, CONTRADICTED * joint_sd
    given = f"the critical angle of {mean:g} ± {sd:g}°"
    if excess < -most or excess > DENSEST_DEG + most:
        far = "below" if excess < 0.0 else f"more than {DENSEST_DEG:g}° above"
        beyond = f"φ is {far} {given} by more than both errors allow"
        sentence = f"{beyond}: the critical angle is not used; check it, the density and the force."
        return replace(answer, warnings=(sentence, *answer.warnings))
    alone = f"{answer.phi}".partition("  ")[0]
    sentence = f"φ is that of soil with {given}; by the forces alone it is {alone}."
    if excess < least:
        sentence = f"φ may be {given}, that of loose soil; by the forces alone it is {alone}."
    density, peak = critical_posterior(answer.grid_deg, answer.density, (mean, sd))
    phi = Estimate.of_density(answer.grid_deg, density)
    narrower = phi.sd / answer.phi.sd
    return replace(
        answer,
        density=density,
        phi_peak=peak if excess >= least else None,
        provenance={k: v for k, v in answer.provenance.items() if k not in BY_LAW}
        | {"critical": [mean, sd]},
        # What half the force, or damp soil, would read is of the forces alone.
        phi_of_force_deg=None,
        phi_if_damp_deg=None,
        budget_deg={name: narrower * term for name, term in answer.budget_deg.items()},
        warnings=(sentence, *answer.warnings),
    )


def critical_posterior(
    grid: FloatArray, density: FloatArray, critical: tuple[float, float]
) -> tuple[FloatArray, Estimate]:
    """Posterior of φ and of the peak angle of soil whose critical angle is known.

    φ = φ_c + share (φ_p − φ_c), with φ_p − φ_c by the relative density (:data:`DENSEST_DEG`).

    Parameters
    ----------
    grid, density
        Of φ by the forces alone [deg], [1/deg], shape [k]; the grid's steps are equal.
    critical
        Mean and standard deviation of φ_c [deg].
    """
    # Forty equally likely shares, and forty relative densities. Of loose soil, whose peak is the
    # critical angle, the excess of the peak is 0.
    middles = (np.arange(40) + 0.5) / 40.0
    shares = np.clip([NormalDist(*SHARE).inv_cdf(p) for p in middles.tolist()], *SHARE_ENDS)
    excess = np.maximum(LOOSEST_DEG + (DENSEST_DEG - LOOSEST_DEG) * middles, 0.0)
    above, excess = (shares[:, None] * excess).ravel(), np.tile(excess, shares.size)
    # p(φ, share, density) ∝ p(φ | forces) N(φ − share · excess; φ_c): what the critical angle would
    # have to be, at each of 1,600 pairs, shape [k, pair].
    mean, sd = critical[0], max(critical[1], grid[1] - grid[0])
    joint = density[:, None] * np.exp(-0.5 * ((grid[:, None] - above - mean) / sd) ** 2)
    posterior = joint.sum(axis=1)
    # The peak is φ − share · excess + excess, with the same probabilities.
    ends = np.arange(0.0, 90.1, 0.1)
    peak, _ = np.histogram(grid[:, None] - above + excess, ends, weights=joint, density=True)
    posterior /= np.trapezoid(posterior, grid)
    return posterior, Estimate.of_density(0.5 * (ends[1:] + ends[:-1]), peak)


def invert_many(
    rows: Sequence[Any], *, map_: Callable[..., Any] = map
) -> list[Answer | InputError]:
    """Invert many records, each by itself; what cannot be used gives its error, in the same order.

    Parameters
    ----------
    rows
        Forces, or arguments of :func:`invert` by name, ``forces`` among them.
    map_
        Applies a function to each row, such as that of an executor.

    Examples
    --------
    >>> rows = ["li2013:yuma/straight", {"forces": "lost.csv", "leg": "c"}]
    >>> [type(one).__name__ for one in terraphi.invert_many(rows)]
    ['Answer', 'InputError']
    """
    return list(map_(_attempt, rows))


def _attempt(row: Any) -> Answer | InputError:
    """An answer, or why there is none."""
    from terraphi.experiment.workers import attempt

    named = row if isinstance(row, dict) else {"forces": row}
    return attempt(str(named["forces"]), lambda: invert(**with_rig(named)))


@functools.lru_cache(maxsize=4)
def _law_named(name: Path | str | AnyLaw, _changed_ns: int) -> LawOfLegs:
    """A law by its name or its file, kept for the next record until the file changes."""
    from terraphi.laws.named import law_named

    return law_named(name)


def law_for(records: Sequence[Record], law: AnyLaw | Path | str | None) -> tuple[LawOfLegs, str]:
    """The law to take, and why, if none was named."""
    if law is not None:
        file = Path(law) if isinstance(law, str | Path) else None
        changed_ns = file.stat().st_mtime_ns if file and file.is_file() else 0
        return _law_named(law, changed_ns), "what sand3d is now" if str(law) == FORMER_NAME else ""
    first = records[0].scenario
    if first is not None and all(record.scenario is not None for record in records):
        from terraphi.laws.named import law_of_simulation

        return law_of_simulation(first), "the nearest to the simulation"
    return shipped_legs(), "the default for measured forces"


def _answer(
    records: Sequence[Record],
    law: LawOfLegs,
    calibration: Calibration | None,
    law_reason: str,
    began: float,
) -> Answer:
    """Posterior, verdict and warnings of records of one soil by one law."""
    likelihood = Likelihood(records, law, calibration)
    opinion = second_opinion(likelihood)
    if opinion and law.convention == "plane_strain" and likelihood.beyond is None:
        # A term of this size leaves the two angles UNUSUAL of their common standard deviation
        # apart; it is 0 where they already agree as well as that.
        separation_deg = opinion["median"] - likelihood.least_squares
        lacking = (separation_deg / UNUSUAL) ** 2 - likelihood.sd**2 - opinion["sd"] ** 2
        if lacking > 0.0:
            wider = math.sqrt(lacking)
            likelihood = Likelihood(records, law, calibration, disagreement_deg=wider)
    grid, density = quadrature(likelihood)
    phi = Estimate.of_density(grid, density)
    fits = record_fits(likelihood, phi.median, phi.ci95)
    air = in_air(likelihood)
    # The one search over legs: verdict and advice read it.
    legs = [leg_readings(likelihood, record) for record in records]
    verdict, reason, edge = judge(likelihood, fits, legs, damaged=bool(air))
    scaled, is_sound = None, verdict == "consistent" and likelihood.measured
    if is_sound and not all(r.scale_given for r in records):
        scaled = dict(zip(("half", "twice"), likelihood.at_scaled_forces([0.5, 2.0]), strict=True))
    first = records[0]
    is_dry = first.cohesion_pa == first.cohesion_sd_pa == 0.0
    offset_deg = float(likelihood.offset(np.array(phi.median)))
    return Answer(
        convention=law.convention, verdict=verdict, reason=reason, edge=edge,
        budget_deg=likelihood.budget() if likelihood.beyond is None else {},
        density_kg_m3=first.density_kg_m3, density_sd_kg_m3=first.density_sd_kg_m3,
        density_assumed=first.density_assumed,
        phi_of_force_deg=scaled,
        phi_if_damp_deg=likelihood.at_cohesion(DAMP_PA) if is_sound and is_dry else None,
        law=law.name, law_reason=law_reason, second_opinion=opinion,
        warnings=tuple(warnings(likelihood, fits, phi, verdict, opinion, legs, air)),
        records=tuple(fits), grid_deg=grid, density=density,
        covariance=likelihood.predictive_covariance(),
        leg_friction=likelihood.law.leg_friction,
        cohesion_pa=likelihood.cohesion if isinstance(law, Legs) else None,
        offset_causes_deg=tuple(likelihood.offset_causes_deg.tolist()),
        provenance={
            "terraphi": importlib.metadata.version("terraphi"),
            "law_hash": law.hash,
            "law_phi_deg": phi.median + offset_deg, "offset_deg": offset_deg,
            "gain": [record.gain for record in records],
            "soil": {
                "grain_size_mm": first.grain_size_mm or None,
                "gain": f"{first.gain}±{first.gain * first.gain_sd}",
                "cohesion": "unknown"
                if math.isinf(first.cohesion_sd_pa)
                else f"{first.cohesion_pa}±{first.cohesion_sd_pa}",
            },
            "noise": [[float(sd) for sd in record.noise] for record in records],
            "seconds": round(time.perf_counter() - began, 3),
            **({"calibration": calibration.model_dump(mode="json")} if calibration else {}),
        },
    )  # fmt: skip


def record_fits(
    likelihood: Likelihood, median: float, ci95: tuple[float, float]
) -> list[RecordFit]:
    """Each record with the curve at the median, and the curves at the ends of the 95 % interval."""
    # Curves at the ends of the interval and at the median, and the tangent there: predictions of
    # an answer's file are g(median) + (φ − median) ∂g/∂φ, as value at 0° and slope.
    low95, high95 = likelihood.curves(np.clip(ci95, *likelihood.ends))
    x = np.append(median, likelihood.shift_deg)[None]
    residual, slopes = likelihood.linearized(x, likelihood.cohesion)
    best, slope = likelihood.data - residual[0], slopes[0, :, 0]
    tangent = np.stack([best - slope * median, slope])
    fits = []
    for record, part, stroke, shift in zip(
        likelihood.records, likelihood.parts, likelihood.coverage, likelihood.shift_deg, strict=True
    ):
        low, high, curve = (
            row[part].reshape(len(record.channels), -1) for row in (low95, high95, best)
        )
        span = stroke.span
        size = np.sqrt(np.square(record.data - curve).mean(axis=1)) / span
        noise = record.noise_covariance.diagonal().reshape(size.size, -1).mean(axis=1) / span**2
        limit = SIMULATED if isinstance(likelihood.library, Legs) else None
        if not record.simulated:
            limit = likelihood.error.nrmsd_limit(record.rig, record.grain_size_mm)
            # Most of a stroke's residual is where soil bears, which a part consists of.
            limit /= math.sqrt(max(stroke.part, SHORTEST))
            limit = math.hypot(limit, math.sqrt(noise.max()))
        fits.append(
            RecordFit(
                source=record.source, rig=record.rig, limit=limit, shift_deg=float(shift),
                simulated=record.simulated, n_readings=len(record.history.position),
                n_left_out=record.n_left_out, theta_deg=record.theta_deg, data=record.data,
                curve=curve, tangent=tangent[:, part].reshape(-1, *curve.shape),
                band=np.sort([low, high, curve], axis=0)[::2],
                nrmsd=dict(zip(record.channels, size.tolist(), strict=True)),
            )
        )  # fmt: skip
    return fits


def judge(
    likelihood: Likelihood,
    fits: Sequence[RecordFit],
    legs: Sequence[Sequence[Reading]],
    *,
    damaged: bool,
) -> Judgment:
    """Verdict, reason, and the end of the law beyond which φ lies."""
    if damaged or any(record.damage for record in likelihood.records):
        return misfit("the record is damaged.")
    law, training = likelihood.library, "training soils" if likelihood.measured else "simulations"
    by_chance = not likelihood.measured and not isinstance(law, Legs)
    bad = large_residual(fits, training)
    if not bad:
        bad = _unexplained(likelihood) if by_chance else _better_leg(likelihood, legs)
    if likelihood.beyond is not None:
        edge: Edge | None = "low" if likelihood.beyond[0] < likelihood.low else "high"
    else:
        # By the forces alone, as angles of soil.
        best = np.array(likelihood.least_squares)
        read = best + likelihood.offset(best)
        edge = "high" if read > likelihood.high else "low" if read < likelihood.low else None
    if edge is not None:
        end = likelihood.low if edge == "low" else likelihood.high
        end -= float(likelihood.offset(np.array(end)))
        verdict, where, _ = out_of_range(law.name, edge, end)
        return verdict, f"{where} {bad[1] if bad else ''}".rstrip(), edge
    if bad:
        return bad
    if by_chance:
        return "consistent", "Consistent: noise and scatter explain the residual.", None
    if not likelihood.measured:
        return consistent(fits, "simulations")
    grains = likelihood.grain_size_mm
    return consistent(fits, f"grains of {grains:g} mm" if grains >= FINE_MM else "sand")


def _better_leg(likelihood: Likelihood, legs: Sequence[Sequence[Reading]]) -> Judgment | None:
    """Misfit if another leg describes a measured record better."""
    for record, coverage, readings in zip(
        likelihood.records, likelihood.coverage, legs, strict=True
    ):
        if not likelihood.measured or coverage.share < LEAST_COVERAGE or not readings:
            continue
        best = min(readings, key=lambda reading: reading.residual)
        [given] = [reading for reading in readings if reading.leg == record.rig.leg]
        if best.residual < BETTER_LEG * given.residual:
            sizes = (f"{100.0 * r.residual:.0f} % with leg {r.leg}" for r in (given, best))
            return misfit(f"the residual is {' and '.join(sizes)}. Check the leg.")
    return None


def _unexplained(likelihood: Likelihood) -> Judgment | None:
    """Misfit if noise and scatter do not explain the residual of simulated records."""
    free, residual = likelihood.data.size - 1, likelihood.residual
    ratio = float(residual @ np.linalg.solve(likelihood.covariance, residual)) / free
    # Wilson & Hilferty 1931: the cube root of chi-square is nearly normal.
    deviate = (ratio ** (1.0 / 3.0) - 1.0 + 2.0 / (9.0 * free)) / math.sqrt(2.0 / (9.0 * free))
    if deviate <= FAR:
        return None
    return misfit(f"chi-square is {ratio:.1f} times what noise and scatter explain.")
