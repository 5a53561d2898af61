"""The front door: forces in, the friction angle out."""

from __future__ import annotations

import importlib.metadata
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, visible
from terraphi.experiment.priors import DENSITY
from terraphi.experiment.rig import LEG_NAMES, with_rig
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.soil import plane_strain_friction_angle_deg
from terraphi.forward.rft import to_plane_strain
from terraphi.inference.answer import Answer, Edge, Estimate, RecordFit, Verdict, worst_nrmsd
from terraphi.inference.calibration import Calibration, CalibrationSoil, rig_name, soil_name
from terraphi.inference.checks import (
    UNUSUAL,
    in_air,
    residual,
    second_opinion,
    warnings,
    without_faults,
)
from terraphi.inference.combined import combined
from terraphi.inference.likelihood import (
    LEAST_COVERAGE,
    Likelihood,
    coverage_of,
    quadrature,
)
from terraphi.inference.pressed import invert_pressed
from terraphi.inference.records import Record, is_tool, open_records, with_body, with_sd
from terraphi.inference.terms import root_sum_square, term
from terraphi.laws.legs import FORMER_NAME, LawOfLegs, Legs, law_named, nearest_law, shipped_legs
from terraphi.laws.store import PHI

BETTER_LEG = 0.9
"""Residual by another leg over that by the record's own at which the leg is taken for wrong [-]:
at least 0.95 in all training records."""
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
SEVERAL = 1.3
"""Limit of a residual of several records with one angle, over that of one [-]: chosen, for legs
differ."""


def invert(
    forces: Any,
    *,
    leg: str | None = None,
    rig: Any = None,
    tool: str | None = None,
    density: float | str | None = None,
    grain_size_mm: float | None = None,
    columns: Any = None,
    law: LawOfLegs | Path | str | None = None,
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
        straight down, with the columns sinkage and force or pressure. ``law`` is then one
        of feet. Of records of several bodies in one soil, those of tools are named such as
        ``"plate.csv@plate:151"``, or ``(table, "plate:151")``; ``law`` and ``columns`` are then
        those of the legs.
    density
        Bulk density [kg/m³], as a number (± 5 %) or ``"1600±80"``; ``None``: from the forces' file,
        else the library's.
    grain_size_mm
        Mean diameter of the grains [mm], where they are not small compared with the leg or tool:
        what simulated grains of 4 to 9 mm raise φ by is taken off.
    columns
        Which columns of a table are what, as a mapping of the options of
        :func:`terraphi.read_forces`, or a TOML file of them; ``None``: guessed.
    law
        Library, file or shipped name; ``None``: ``legs``, and for forces that were simulated
        otherwise the library whose scenario is nearest.
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
    every = _listed(forces)
    of_legs = [one for one in every if tool is None and not is_tool(one[1])]
    of_tools = [(one, tool or own) for one, own in every if tool is not None or is_tool(own)]
    given = {"leg": leg, "rig": rig, "noise": noise, "gain": gain, "calibration": calibration,
             "simulated": simulated}  # fmt: skip
    wrong = [name for name, value in given.items() if value is not None and not of_legs]
    wrong += [f"@{own}" for _, own in every if tool is not None and own is not None]
    if of_tools and wrong:
        raise InputError(f"a tool excludes {', '.join(wrong)}; leave out one or the other")
    answers = []
    if of_legs:
        answers = _of_legs(of_legs, density=density, law=law, columns=columns,
                           grain_size_mm=grain_size_mm, **given)  # fmt: skip
        # One soil has one density, and its columns and law are those of the legs.
        first = answers[0]
        density, law, columns = f"{first.density_kg_m3}±{first.density_sd_kg_m3}", None, None
    answers += [invert_pressed(*one, density=density, law=law, columns=columns,
                               grain_size_mm=grain_size_mm) for one in of_tools]  # fmt: skip
    answer = combined(answers) if len(answers) > 1 else answers[0]
    return answer if critical is None else with_critical(answer, critical)


def _of_legs(
    sources: Sequence[tuple[Any, Any]],
    *,
    law: LawOfLegs | Path | str | None,
    calibration: Calibration | Path | str | None,
    **options: Any,
) -> list[Answer]:
    """Answers of legs: one, or by law ``legs`` one for each rig."""
    from threadpoolctl import threadpool_limits

    began = time.perf_counter()
    # The matrices are small: threads would only wait for each other.
    with threadpool_limits(limits=1, user_api="blas"):
        records = _records(sources, **options)
        found, reason = _law_for(records, law)
        if isinstance(calibration, str | Path):
            calibration = Calibration.load(calibration)
        if not isinstance(calibration, Calibration | None):
            raise InputError(
                f"calibration of type {type(calibration).__name__}; give the result of calibrate, "
                "or a file"
            )
        if calibration is not None:
            calibration.check(found, {rig_name(record.rig): record.gain for record in records})
        # The offset of law legs is that of one rig alone, so that different ones are joined by
        # their angles. In one fit, which shared a cohesion, grains were read 4° wrong.
        rigs = dict.fromkeys(record.rig for record in records)
        apart = isinstance(found, Legs) and not all(record.simulated for record in records)
        groups = [[r for r in records if r.rig == one] for one in rigs] if apart else [records]
        return [_answer(Likelihood(group, found, calibration), reason, began) for group in groups]


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
        sentence = (
            f"φ is {far} {given} by more than both errors allow, and that angle is not used: check "
            "it, the density and the force."
        )
        return replace(answer, warnings=(sentence, *answer.warnings))
    alone = f"{answer.phi}".partition("  ")[0]
    sentence = f"φ is that of soil with {given}; by the forces alone it is {alone}."
    if excess < least:
        sentence = f"φ may be {given}, that of loose soil; by the forces alone it is {alone}."
    density, peak = critical_posterior(*answer.posterior, (mean, sd))
    phi = Estimate.of_density(answer.grid_deg, density)
    narrower = phi.sd / answer.phi.sd
    return replace(
        answer,
        density=density,
        parameters={PHI: phi},
        phi_plane_strain=phi,
        phi_peak=peak if excess >= least else None,
        # What half the force would read is of the forces alone.
        phi_of_force_deg=None,
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
    middles = (np.arange(40) + 0.5) / 40.0
    shares = np.clip([NormalDist(*SHARE).inv_cdf(p) for p in middles.tolist()], *SHARE_ENDS)
    excess = np.maximum(LOOSEST_DEG + (DENSEST_DEG - LOOSEST_DEG) * middles, 0.0)
    above, excess = (shares[:, None] * excess).ravel(), np.tile(excess, shares.size)
    mean, sd = critical[0], max(critical[1], grid[1] - grid[0])
    joint = density[:, None] * np.exp(-0.5 * ((grid[:, None] - above - mean) / sd) ** 2)
    posterior = joint.sum(axis=1)
    ends = np.arange(0.0, 90.1, 0.1)
    peak, _ = np.histogram(grid[:, None] - above + excess, ends, weights=joint, density=True)
    whole = np.trapezoid(posterior, grid)
    return np.asarray(posterior / whole), Estimate.of_density(0.5 * (ends[1:] + ends[:-1]), peak)


def _listed(forces: Any) -> list[tuple[Any, Any]]:
    """Each of one input or a list, with the body that it names."""
    several = isinstance(forces, list | tuple) and with_body(forces)[1] is None
    if several and not forces:
        raise InputError("no forces: the list is empty")
    return [with_body(one) for one in (forces if several else [forces])]


def _records(sources: Sequence[tuple[Any, Any]], **options: Any) -> list[Record]:
    """Records without faulty readings, of forces and their own legs or rigs, if any."""
    records: list[Record] = []
    for forces, own in sources:
        of_shape = isinstance(own, str) and own in LEG_NAMES
        body = {"leg": own} if of_shape else {} if own is None else {"rig": own, "leg": None}
        records += map(without_faults, open_records(forces, **options | body))
    return records


def calibrate(
    forces: Any,
    phi_deg: float,
    phi_sd_deg: float,
    *,
    soil: str = "",
    law: LawOfLegs | Path | str | None = None,
    leg: str | None = None,
    rig: Any = None,
    density: float | str | None = None,
    grain_size_mm: float | None = None,
    columns: Any = None,
    noise: float | tuple[float, float] | None = None,
    gain: float | str | None = None,
) -> Calibration:
    """Compare a library with soils of known friction angle in one's own apparatus.

    Parameters
    ----------
    forces
        As of :func:`invert`; the records of a list are of one soil.
    phi_deg, phi_sd_deg
        Friction angle in the library's convention and its standard deviation [deg].
    soil
        Name of the soil, by which calibrations of several soils, or of several days, are joined.
    law, leg, rig, density, grain_size_mm, columns, noise, gain
        As of :func:`invert`.

    Raises
    ------
    InputError
        As :func:`invert` does.

    Examples
    --------
    >>> calibration = terraphi.calibrate("li2013:poppy_loose/straight", 36.0, 1.0)
    >>> after = terraphi.invert("li2013:yuma/straight", calibration=calibration)
    >>> after.phi.sd < terraphi.invert("li2013:yuma/straight").phi.sd
    True
    """
    if not all(isinstance(one, int | float) for one in (phi_deg, phi_sd_deg)):
        raise InputError(f"phi = {phi_deg!r} ± {phi_sd_deg!r}; give two numbers of degrees")
    if not (0.0 < phi_deg < 90.0 and 0.0 <= phi_sd_deg < 90.0):
        raise InputError(f"phi = {phi_deg:g} ± {phi_sd_deg:g}°; 0 to 90° are accepted")
    soils, soil = [], soil_name(soil)
    records = _records(
        _listed(forces), leg=leg, rig=rig, density=density, grain_size_mm=grain_size_mm,
        columns=columns, noise=noise, gain=gain,
    )  # fmt: skip
    found, _ = _law_for(records, law)
    for i, record in enumerate(records):
        for other in records[:i]:
            if record.rig == other.rig and np.array_equal(record.data, other.data):
                raise InputError(
                    f"{record.source}: has the forces of {other.source}; a repeat is another stroke"
                )
        likelihood = Likelihood([record], found)
        if not likelihood.measured:
            raise InputError(f"{record.source}: simulated forces calibrate nothing")
        best = likelihood.least_squares
        fits = _fits(likelihood, best, (best[0], best[0]))
        verdict, why, _ = _verdict(likelihood, fits, best, damaged=bool(in_air(likelihood)))
        if verdict != "consistent":
            raise InputError(f"{record.source}: cannot calibrate with it. {why}")
        read = float(best[0])
        shares = likelihood.budget()
        fixed = [name for name in shares if term(name).fixed]
        model = [name for name in shares if name.startswith("model: ")]
        sd = root_sum_square(shares, *fixed, *model)
        rig_sd = math.hypot(*(shares[name] for name in fixed))
        error = likelihood.errors[record.leg]
        apart = read - phi_deg
        usual = math.hypot(error.common_sd_deg, error.soil_sd_deg, error.leg_sd_deg,
                           error.offset_sd_at(read), rig_sd, phi_sd_deg, sd)  # fmt: skip
        if abs(apart) > FAR * usual:
            raise InputError(
                f"{record.source}: forces and angle disagree by {apart:+.0f}°, at most "
                f"{FAR * usual:.0f}° are accepted; check phi = {phi_deg:g}° (in "
                f"{found.scenario.convention.replace('_', ' ')}), the density and the leg"
            )
        soils.append(
            CalibrationSoil(
                source=visible(record.source), soil=soil, leg=record.leg, rig=rig_name(record.rig),
                phi_deg=phi_deg, phi_sd_deg=phi_sd_deg, read_deg=read, read_sd_deg=sd,
                rig_sd_deg=rig_sd, gain=record.gain,
            )
        )  # fmt: skip
    return Calibration(library=found.name, library_hash=found.hash, soils=soils)


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
    try:
        return invert(**with_rig(row)) if isinstance(row, dict) else invert(row)
    except InputError as error:
        name = str(row["forces"]) if isinstance(row, dict) else str(row)
        return error if name in str(error) else InputError(f"{name}: {error}")


def _law_for(
    records: Sequence[Record], law: LawOfLegs | Path | str | None
) -> tuple[LawOfLegs, str]:
    """The law to take, and why, if none was named."""
    if isinstance(law, LawOfLegs):
        return law, ""
    if law is not None:
        return law_named(law), "what sand3d is now" if str(law) == FORMER_NAME else ""
    scenarios = [record.scenario for record in records]
    if all(scenario is not None for scenario in scenarios):
        assert scenarios[0] is not None
        return nearest_law(scenarios[0]), "the nearest to the simulation"
    return shipped_legs(), "the default for measured forces"


def _answer(likelihood: Likelihood, reason: str, began: float) -> Answer:
    """Posterior, verdict and all that goes with them."""
    records, library = likelihood.records, likelihood.library
    second = second_opinion(likelihood)
    grid, density = quadrature(likelihood)
    phi = Estimate.of_density(grid, density)
    if second is not None and (wider := _disagreement_deg(likelihood, phi, second)):
        likelihood = Likelihood(records, library, likelihood.calibration, disagreement_deg=wider)
        grid, density = quadrature(likelihood)
        phi = Estimate.of_density(grid, density)
    middle = np.array([phi.median])
    fits = _fits(likelihood, middle, phi.ci95)
    air = in_air(likelihood)
    verdict, why, edge = _verdict(likelihood, fits, middle, damaged=bool(air))
    scenario = library.scenario
    plane, no_plane = _plane_strain(phi, scenario)
    first, density_kg_m3 = records[0], likelihood.density[0]
    unknown = first.density_kg_m3 is None
    return Answer(
        parameters={PHI: phi},
        convention=scenario.convention,
        phi_plane_strain=plane,
        phi_plane_strain_reason=no_plane,
        verdict=verdict,
        reason=why,
        edge=edge,
        budget_deg=likelihood.budget() if likelihood.beyond is None else {},
        density_kg_m3=density_kg_m3,
        density_sd_kg_m3=DENSITY.sd if unknown else first.density_sd_kg_m3,
        density_assumed=unknown or first.density_assumed,
        phi_of_force_deg=_phi_of_force(likelihood) if verdict == "consistent" else None,
        law=library.name,
        law_reason=reason,
        second_opinion=second,
        warnings=tuple(warnings(likelihood, fits, phi, verdict, second)),
        records=tuple(fits),
        grid_deg=grid,
        density=density,
        covariance=likelihood.predictive_covariance(),
        leg_friction=likelihood.laws[0].leg_friction,
        cohesion_pa=likelihood.cohesion if isinstance(library, Legs) else None,
        provenance={
            "terraphi": importlib.metadata.version("terraphi"),
            "law_hash": library.hash,
            "gain": [record.gain for record in records],
            "noise": [[float(one) for one in record.noise] for record in records],
            "seconds": round(time.perf_counter() - began, 3),
            **({"calibration": likelihood.calibration.model_dump(mode="json")}
               if likelihood.calibration else {}),
        },
    )  # fmt: skip


def _phi_of_force(likelihood: Likelihood) -> dict[str, float | None] | None:
    """Angles by half and by twice the force, unless its scale was measured."""
    given = all(record.scale_given for record in likelihood.records)
    if given or not likelihood.measured:
        return None
    return dict(zip(("half", "twice"), likelihood.at_scaled_forces([0.5, 2.0]), strict=True))


def _fits(likelihood: Likelihood, middle: FloatArray, ci95: tuple[float, float]) -> list[RecordFit]:
    """Each record with the curve at the median, and the curves at the ends of the 95 % interval."""
    points = np.append(np.clip(ci95, *likelihood.ends), middle)[:, None]
    curves = likelihood.curves(points)
    slope = likelihood.slope(middle)
    tangent = np.vstack([curves[2] - slope @ middle, slope.T])
    found = []
    for record, part, whole, shift in zip(
        likelihood.records, likelihood.parts, likelihood.coverage, likelihood.shift_deg, strict=True
    ):
        low, high, curve = (one.reshape(len(record.channels), -1) for one in curves[:, part])
        span, error = whole.span, likelihood.errors[record.leg]
        size = np.sqrt(np.square(record.data - curve).mean(axis=1)) / span
        noise = record.noise_covariance.diagonal().reshape(size.size, -1).mean(axis=1) / span**2
        limit = SIMULATED if isinstance(likelihood.library, Legs) else None
        if not record.simulated:
            several = SEVERAL if len(likelihood.records) > 1 else 1.0
            limit = math.hypot(error.nrmsd_limit * several, math.sqrt(noise.max()))
        found.append(
            RecordFit(
                source=record.source, rig=record.rig,
                simulated=record.simulated, n_readings=len(record.history.position),
                n_left_out=record.n_left_out, theta_deg=record.theta_deg, data=record.data,
                curve=curve, tangent=tangent[:, part].reshape(-1, *curve.shape),
                band=np.stack([np.minimum(low, high), np.maximum(low, high)]),
                nrmsd=dict(zip(record.channels, size.tolist(), strict=True)),
                shift_deg=float(shift),
                limit=limit,
            )
        )  # fmt: skip
    return found


def _percent(share: float, *, digits: int = 0) -> str:
    """A share as a percentage."""
    return f"{100.0 * share:.{digits}f} %"


def _verdict(
    likelihood: Likelihood, fits: Sequence[RecordFit], middle: FloatArray, *, damaged: bool
) -> tuple[Verdict, str, Edge | None]:
    """Verdict, reason, and the end of the library beyond which φ lies."""
    if damaged or any(record.damage for record in likelihood.records):
        return "misfit", "Misfit: the record is damaged. Do not use the angle.", None
    misfit = _large_residual(likelihood, fits)
    by_library = not likelihood.measured and not isinstance(likelihood.library, Legs)
    if not misfit and likelihood.measured:
        misfit = _other_leg(likelihood)
    elif by_library:
        misfit = _misfit(likelihood, middle)
    edge = _edge(likelihood)
    if edge is not None:
        end, word = (likelihood.low[0], "below") if edge == "low" else (likelihood.high[0], "above")
        end -= float(likelihood.offset(likelihood.records[0], end))
        why = (
            f"Out of range: φ lies {word} {end:.0f}°, the "
            f"{'lower' if edge == 'low' else 'upper'} end of law {likelihood.library.name}."
        )
        return "out_of_range", f"{why} {misfit}".rstrip(), edge
    if misfit:
        return "misfit", misfit, None
    if by_library:
        return "consistent", "Consistent: noise and scatter explain the residual.", None
    followed = " and ".join(f"{c} within {_percent(size)}" for c, size in worst_nrmsd(fits).items())
    kind = "sand" if likelihood.measured else "simulations"
    return (
        "consistent",
        f"Consistent: the model follows {followed} of the range, usual for {kind}.",
        None,
    )


def _large_residual(likelihood: Likelihood, fits: Sequence[RecordFit]) -> str:
    """A sentence if a record differs from the model by more than soils or simulations do."""
    origin = "training soils" if likelihood.measured else "simulations"
    for fit, record, (_, span) in zip(fits, likelihood.records, likelihood.coverage, strict=True):
        size = max(fit.nrmsd.values())
        if fit.limit is not None and size > fit.limit:
            apart = (fit.data - fit.curve) / span[:, None]
            i, j = np.unravel_index(np.abs(apart).argmax(), apart.shape)
            far = apart[i, j]
            shown = f"{100.0 * far:+.0f} % of" if abs(far) < 2.0 else f"{far:+.1f} times"
            return (
                f"Misfit: {record.channels[i]} differs from the model by "
                f"{shown} its range at {fit.theta_deg[j]:.0f}°. The "
                f"residual is {_percent(size, digits=1)}; the limit is "
                f"{_percent(fit.limit, digits=1)}, from {origin}. Do not use the angle."
            )
    return ""


def _other_leg(likelihood: Likelihood) -> str:
    """A sentence if another leg describes a record better."""
    for record in likelihood.records:
        if coverage_of(record) < LEAST_COVERAGE:
            continue
        cohesion = likelihood.cohesion
        sizes = {leg: residual(record.data, record, likelihood, leg, cohesion)
                 for leg in likelihood.library.legs}  # fmt: skip
        leg = min(sizes, key=lambda one: sizes[one])
        if sizes[leg] < BETTER_LEG * sizes[record.leg]:
            return (
                f"Misfit: leg {leg} describes the record with a residual of "
                f"{_percent(sizes[leg])}, leg {record.leg} with {_percent(sizes[record.leg])}. "
                "Check the leg. Do not use the angle."
            )
    return ""


def _misfit(likelihood: Likelihood, middle: FloatArray) -> str:
    """A sentence if noise and scatter do not explain a simulated record."""
    free = likelihood.data.size - 1
    ratio = likelihood.chi2(middle) / free
    # Wilson & Hilferty 1931: the cube root of chi-square is nearly normal.
    deviate = (ratio ** (1.0 / 3.0) - 1.0 + 2.0 / (9.0 * free)) / math.sqrt(2.0 / (9.0 * free))
    if deviate <= FAR:
        return ""
    return (
        f"Misfit: chi-square is {ratio:.1f} times its degrees of freedom; noise and scatter do not "
        "explain the residual. Do not use the angle."
    )


def _edge(likelihood: Likelihood) -> Edge | None:
    """End of the library's range beyond which φ lies, by the forces alone."""
    if likelihood.beyond is not None:
        return "low" if likelihood.beyond[0] < likelihood.low[0] else "high"
    read = float(likelihood.least_squares[0])
    offsets = [float(likelihood.offset(r, np.array(read))) for r in likelihood.records]
    if read < likelihood.low[0] - min(offsets):
        return "low"
    return "high" if read > likelihood.high[0] - max(offsets) else None


def _plane_strain(phi: Estimate, scenario: Scenario) -> tuple[Estimate | None, str]:
    """φ as that of Mohr-Coulomb soil in plane strain; quantiles map one to one."""
    soil = scenario.soil

    def convert(angle: float) -> float:
        if scenario.convention == "rft3d":
            if angle >= 45.0:
                raise InputError(
                    "resistive force theory yields at √J₂ = p tan φ, which has no plane-strain "
                    "equivalent from φ = 45°"
                )
            return float(to_plane_strain(angle))
        dilation = angle if soil.flow == "associated" else soil.dilation_angle_deg
        return plane_strain_friction_angle_deg(
            angle, soil.yield_criterion, dilation_angle_deg=dilation
        )

    try:
        ends = [convert(one) for one in (*phi.ci68, *phi.ci95)]
        sd = phi.sd * (ends[1] - ends[0]) / (phi.ci68[1] - phi.ci68[0])
        return Estimate(convert(phi.median), sd, (ends[0], ends[1]), (ends[2], ends[3])), ""
    except InputError as error:
        return None, str(error)


def _disagreement_deg(likelihood: Likelihood, own: Estimate, second: dict[str, Any]) -> float:
    """Standard deviation that makes up for another opinion [deg]; 0 if that is not far away.

    With it the two differ by :data:`UNUSUAL` of their common standard deviation.
    """
    convention = likelihood.library.scenario.convention
    if convention != "plane_strain" or likelihood.beyond is not None:
        return 0.0
    apart = second["median"] - own.median
    return math.sqrt(max((apart / UNUSUAL) ** 2 - own.sd**2 - second["sd"] ** 2, 0.0))
