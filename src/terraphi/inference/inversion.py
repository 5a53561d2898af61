"""The inversion from end to end: force histories and a library in, an answer out.

One history is the special case of several, and the friction angle alone that of several parameters:
that one is inferred by quadrature (`friction_angle`), several from draws (`several_parameters`).
"""

from __future__ import annotations

import functools
import importlib.metadata
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import Measurement, measurement_of, medium_and_leg
from terraphi.inference import friction_angle, several_parameters
from terraphi.inference.answer import PHI, Inversion
from terraphi.inference.discrepancy import Learnt, default_library, learnt_for
from terraphi.inference.explanation import OFFSETS, SLIPS, USUAL_DEG
from terraphi.inference.findings import Doubt
from terraphi.inference.known_soils import Calibration, Compared, compared
from terraphi.inference.noise import Noise
from terraphi.inference.prior import Marginal, is_on, priors
from terraphi.inference.trials import Looked, Trial, Ways, check_origin, common_density, look
from terraphi.library.finer import CAUSES, untold
from terraphi.library.shipped import is_there_to_try_others
from terraphi.library.store import Library
from terraphi.surrogate.training import DENSITY, is_of_several, parameters

History = ForceHistory | Measurement | Trial
"""What can be inverted."""
LIKELIHOODS = ("calibrated", "paper")
SAMPLERS = ("quadrature", "emcee")
DISCREPANCIES = ("none", "gp", "soils")

ALL_ONE = ("damaged", "against_prior")
"""Misfits of which no history more than another is the reason."""
_SOFTWARE = ("terraphi", "numpy", "scipy", "emcee")


def invert(
    histories: History | Sequence[History],
    *,
    library: Library | Path | str | None = None,
    prior: Sequence[str] = (),
    leg: str | None = None,
    density: float | None = None,
    density_assumed: bool = False,
    likelihood: str | None = None,
    noise: float | str | Path | None = None,
    discrepancy: str | Learnt | None = None,
    sampler: str | None = None,
    seed: int = 0,
    source: str = "",
    steps: int | None = None,
    calibration: Calibration | Path | str | None = None,
) -> Inversion:
    """Infer the friction angle, and what else a library varies, from one history or several.

    With c = 0 and a fixed stiffness the forces are proportional to the density, so the library's
    curves are multiplied by ρ / ρ_library.

    Parameters
    ----------
    histories
        Forces over the whole window |θ| ≤ 85°: of one trial, or of several in one soil. One that
        was simulated, or shipped, knows its leg and its density.
    library
        Simulations over φ, or over several parameters, with every leg of the histories; or their
        file, or the name of a shipped one. ``None``: the one that
        :func:`~terraphi.inference.discrepancy.default_library` names.
    prior
        As in :func:`~terraphi.inference.prior.priors`; parameters without one are uniform over the
        library. A prior on ``soil.density`` makes the density a parameter whether the library
        varies it or not.
    leg, source
        Shape of the leg that was moved, and where the forces come from, of histories that are no
        :class:`~terraphi.inference.trials.Trial`, which says so itself. ``None``: as a measurement,
        or a history, says itself; else a straight leg is assumed.
    density
        Bulk density of the soil [kg/m³]. ``None`` infers it if the library varies it, and else
        takes that of the trials, or assumes the library's.
    density_assumed
        Whether a density given is itself a guess.
    likelihood
        Of φ alone: ``calibrated``, the default, or ``paper``: as printed by Xu & Wang.
    noise
        Standard deviation of a force reading [N], or a TOML file with ``sigma_Fx_N`` and
        ``sigma_Fz_N``; ``None`` or ``inferred`` infers it. Not of the paper's likelihood. Of
        several parameters, noise that is inferred is of one size in newtons for both forces.
    discrepancy
        ``soils``: the model is wrong as it is for real soils, by what was learnt of the library
        from measured media (`discrepancy`; or an object of that kind); ``gp``: it may be wrong by
        a Gaussian process over θ; ``none``: it is right. ``None`` takes ``none`` for histories
        simulated as the library was, ``soils`` for measured ones if it was learnt, and ``gp`` for
        any other. Likewise.
    sampler
        Of φ alone: ``quadrature`` (exact, the default) or ``emcee`` (for comparison).
    seed
        Of all draws.
    steps
        Of each ensemble to begin with, of several parameters; ``None``: 1500. They double until the
        draws have converged.
    calibration
        The library compared with soils of known friction angle, or its file: of φ alone.

    Returns
    -------
    Inversion

    Raises
    ------
    InputError
        If a history, the leg, the density, a prior or an option cannot be used.
    """
    _check_options(likelihood, sampler, noise, discrepancy)
    if seed < 0:
        raise InputError(f"seed = {seed}: expected a whole number, 0 or more")
    began = time.perf_counter()
    trials, why = _trials(histories, leg, source), ""
    check_origin(trials)
    if library is None:
        name, why = default_library([trial.history for trial in trials])
        library = _shipped(name)
    elif not isinstance(library, Library):
        library = Library.load(library)
    by_soils = _by_soils(calibration, library, trials, likelihood, discrepancy)
    phi_alone, marginals, density, assumed = _known(
        trials, library, prior, density, density_assumed
    )
    looked = look(trials, library)
    ways = Ways(
        likelihood=likelihood,
        noise=Noise.parse(noise),
        discrepancy=discrepancy,
        sampler=sampler,
        seed=seed,
        steps=steps,
        calibration=by_soils,
        priors=marginals,
        density=density,
        density_assumed=assumed,
    )
    if library.fine and (likelihood == "paper" or not phi_alone):
        raise InputError(
            f"library '{library.name}' is refined, and only the calibrated likelihood of φ alone "
            "knows the correction; infer φ alone with that, or take a library that is not refined"
        )
    infer = friction_angle.infer if phi_alone else several_parameters.infer
    found = infer(looked, library, ways)
    return replace(
        found,
        warnings=_warnings(looked, found, library),
        library_reason=why if phi_alone else "",
        compared=_compared(looked, found, library),
        provenance=_provenance(found, library, by_soils, time.perf_counter() - began),
    )


def _provenance(
    found: Inversion, library: Library, by_soils: Calibration | None, seconds: float
) -> dict[str, Any]:
    """Where an answer comes from."""
    about: dict[str, Any] = {
        **_versions(),
        "library": dict(library.provenance),
        "library_hash": library.hash,
    }
    if library.fine:
        about["refined"] = True
    if len(found.records) == 1 and found.records[0].simulation:
        about["simulation"] = dict(found.records[0].simulation)
    about |= {"seconds": seconds, **found.provenance}
    if by_soils is not None:
        about["calibration"] = by_soils.model_dump(mode="json")
    return about


def _by_soils(
    given: Calibration | Path | str | None,
    library: Library,
    trials: Sequence[Trial],
    likelihood: str | None,
    discrepancy: str | Learnt | None,
) -> Calibration | None:
    """A calibration, or that of a file; refused if it is for another kind of inversion."""
    if given is None:
        return None
    found = given if isinstance(given, Calibration) else Calibration.load(given)
    found.check(library)
    if likelihood == "paper" or discrepancy is not None:
        raise InputError(
            "a calibration is for the likelihood and the discrepancy that it was made with, the "
            "defaults; drop --likelihood and --discrepancy, or the calibration"
        )
    if any(trial.simulation for trial in trials):
        raise InputError("a calibration is for measured forces; drop it for simulated ones")
    return found


def _compared(looked: Looked, found: Inversion, library: Library) -> Compared | None:
    """Measured forces beside those of known soils in the same apparatus."""
    if found.origin == "simulated" or found.density is None:
        return None
    forces = [
        (r.leg, r.observation.vector, str(t.history.provenance.get("measurement", "")))
        for r, t in zip(found.records, looked.trials, strict=True)
    ]
    return compared(forces, found.density, library.cases[0].scenario)


def _two_soils(found: Inversion) -> list[Doubt]:
    """A doubt if histories together are a misfit, and no slip is asked about that explains it."""
    asked = {*SLIPS, *OFFSETS} & {doubt.code for doubt in found.warnings}
    if found.verdict.verdict != "misfit" or asked or found.verdict.code in ALL_ONE:
        return []
    every = [one for one in found.verdict.measures if one.source]
    of_each = [one for one in every if one.code == "soil_deviation"]
    of_each = of_each or [one for one in every if one.code == "nrmsd"]
    if not of_each:
        return []
    worst = max(of_each, key=lambda one: one.value)
    return [Doubt("two_soils", {"worst": worst.source})]


def _warnings(looked: Looked, found: Inversion, library: Library) -> tuple[Doubt, ...]:
    """Doubts about the library, then what was found in the records, then about these."""
    return (*_of_library(found, library), *found.warnings, *_doubts(looked, found, library))


def _of_library(found: Inversion, library: Library) -> list[Doubt]:
    """What everyone who inverts with a library should know of it."""
    name, doubts = library.name, []
    if library.caveat:
        doubts.append(Doubt("caveat", {"name": name, "caveat": library.caveat}))
    if is_there_to_try_others(name):
        doubts.append(Doubt("tries_others", {"name": name}))
    for cause, legs in (untold(library) if library.fine else {}).items():
        if legs == library.legs:
            doubts.append(Doubt("refined_in_part", {"name": name, "cause": CAUSES[cause]}))
    if found.likelihood == "calibrated" and not _as_soil(found):
        for leg, held in library.unheld.items():
            if leg in found.legs:
                told = {"name": name, "leg": leg, "held": held}
                doubts.append(Doubt("intervals_do_not_hold", told))
    return doubts


def _as_soil(found: Inversion) -> bool:
    """Whether it is judged by how real soils deviate."""
    return any(one.code == "soil_deviation" for one in found.verdict.measures)


def _doubts(looked: Looked, found: Inversion, library: Library) -> list[Doubt]:
    """Doubts about records, and an angle that hardly any dry soil has."""
    doubts = _two_soils(found)
    learnt, plane = learnt_for(library), found.phi_plane_strain
    if learnt is not None and _as_soil(found):
        shipped = (str(t.history.provenance.get("measurement", "")) for t in looked.trials)
        # It was learnt from the very medium that is judged by it.
        known = {medium_and_leg(name)[0] for name in shipped} & set(learnt.media)
        doubts += [Doubt("known_soil", {"medium": medium}) for medium in sorted(known)]
    if learnt is not None and found.of_phi is None and found.origin == "measured":
        doubts.append(Doubt("with_others", {}))
    if library.fine and found.origin == "measured" and not _as_soil(found):
        doubts.append(Doubt("refined_without_soils", {"name": library.name}))
    low, high = USUAL_DEG
    if plane is not None and found.origin == "measured" and not low <= plane.median <= high:
        doubts.append(Doubt("unusual", {"median": plane.median, "low": low, "high": high}))
    return doubts


def _trials(histories: History | Sequence[History], leg: str | None, source: str) -> list[Trial]:
    """Each history with its leg and, of several, a name."""
    given = [histories] if isinstance(histories, History) else list(histories)
    found = []
    for number, one in enumerate(given, start=1):
        trial = one if isinstance(one, Trial) else _trial(one, leg, source)
        if len(given) > 1 and not trial.source:
            trial = replace(trial, source=f"history {number}")
        found.append(trial)
    return found


def _trial(one: ForceHistory | Measurement, leg: str | None, source: str) -> Trial:
    if isinstance(one, Measurement):
        return Trial.of(replace(one, name=source or one.name), leg)
    if one.coordinate != "theta":
        raise InputError(f"forces over {one.coordinate}, expected forces over the leg angle theta")
    return Trial.of(measurement_of(one, source), leg)


def _known(
    trials: Sequence[Trial],
    library: Library,
    prior: Sequence[str],
    density: float | None,
    guessed: bool,
) -> tuple[bool, dict[str, Marginal], float | None, bool]:
    """Whether φ alone is to be inferred, priors, and the density, and whether that is a guess."""
    varied = parameters(library) if prior or is_of_several(library) else {}
    said = any(is_on(text, DENSITY) for text in prior)
    if said and density is not None:
        raise InputError(f"the density is given twice, as {density:g} kg/m³ and as a prior")
    if density is None and not said and DENSITY not in varied:
        density, guessed = common_density(trials)
    if not varied:
        return True, {}, density, guessed
    marginals = priors(varied, prior, density=density)
    free = [key for key, marginal in marginals.items() if not marginal.fixed]
    if not free:
        raise InputError("every parameter is fixed; there is nothing to infer")
    fixed = marginals.get(DENSITY)
    if fixed is not None and fixed.fixed:
        density = fixed.low
    # Where other parameters are held, only the surrogate over all of them knows the curves.
    return free == [PHI] and set(varied) == {PHI}, marginals, density, guessed


def _check_options(
    likelihood: str | None,
    sampler: str | None,
    noise: float | str | Path | None,
    discrepancy: str | Learnt | None,
) -> None:
    """Refuse options that do not exist, or not together."""
    for name, given, known in (
        ("likelihood", likelihood, (*LIKELIHOODS, "joint")),
        ("sampler", sampler, SAMPLERS),
        ("discrepancy", None if isinstance(discrepancy, Learnt) else discrepancy, DISCREPANCIES),
    ):
        if given is not None and given not in known:
            raise InputError(f"unknown {name} '{given}'; {nearest(given, known)}")
    if likelihood == "paper" and (noise is not None or discrepancy is not None):
        raise InputError(
            "the paper's likelihood has neither noise nor discrepancy; take 'calibrated', or drop "
            "them"
        )


@functools.cache
def _shipped(name: str) -> Library:
    """A library that ships; kept, for many records are inverted one after another."""
    return Library.load(name)


@functools.cache
def _versions() -> dict[str, str]:
    """Versions of the software at work here."""
    return {name: importlib.metadata.version(name) for name in _SOFTWARE}
