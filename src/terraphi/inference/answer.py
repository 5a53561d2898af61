"""The answer of an inversion: what was inferred from one history or several, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import Observation
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.soil import plane_strain_friction_angle_deg
from terraphi.inference.budget import Budget
from terraphi.inference.findings import Doubt, Verdict
from terraphi.inference.identifiability import Identifiability, axis_label, label
from terraphi.inference.known_soils import Compared
from terraphi.inference.posterior import Posterior
from terraphi.inference.prior import Marginal
from terraphi.inference.sampler import Draws
from terraphi.inference.words import of_doubt, reason

PHI = "soil.friction_angle_deg"
NARROW_DEG = 0.1
"""Width of the 68 % interval below which angles are shown with another digit [deg]."""
QUANTILES = 4000
"""Quantiles that stand for a posterior by quadrature where draws are wanted."""
MOST_NAMED = 5
"""Parameters that a representation has room for."""


def decimals(ci68: Sequence[float]) -> int:
    """Decimals that an angle [deg] deserves by its interval, as in 34 ± 4 and in 34.1 ± 0.4."""
    half = max(0.5 * (ci68[1] - ci68[0]), 1e-3)
    return min(max(math.ceil(-math.log10(half)), 0), 3)


def decimals_of_sd(sd: float) -> int:
    """Decimals of any parameter for its standard deviation, in its unit: two digits of that."""
    places = -math.floor(math.log10(0.5 * sd)) if sd > 0.0 else 2
    return min(max(places, 0), 12)


@dataclass(frozen=True)
class AngleSummary:
    """Median and equal-tailed intervals of a friction angle [deg]."""

    median: float
    ci68: tuple[float, float]
    ci95: tuple[float, float]

    def __str__(self) -> str:
        """Median and intervals [deg], with the digits that the narrower one deserves."""
        width = self.ci68[1] - self.ci68[0]
        digits = 3 if width < NARROW_DEG else 2
        spans = (f"{low:.{digits}f} to {high:.{digits}f}" for low, high in (self.ci68, self.ci95))
        return "{:.{}f} deg, 68 %: {}, 95 %: {}".format(self.median, digits, *spans)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return asdict(self)


@dataclass(frozen=True)
class Summary(AngleSummary):
    """The same of any parameter, in its unit, with its standard deviation."""

    sd: float

    @classmethod
    def of(cls, draws: FloatArray) -> Summary:
        """From draws of any shape."""
        q = np.quantile(draws, [0.5, 0.16, 0.84, 0.025, 0.975]).tolist()
        return cls(q[0], (q[1], q[2]), (q[3], q[4]), float(draws.std()))

    @classmethod
    def of_posterior(cls, posterior: Posterior) -> Summary:
        """From a posterior of the friction angle [deg]."""
        ends = posterior.interval(0.68), posterior.interval(0.95)
        return cls(posterior.median, *ends, posterior.sd)


@dataclass(frozen=True, eq=False)
class Record:
    """One of the histories that were inverted.

    Attributes
    ----------
    source
        Where the forces come from.
    leg, leg_assumed
        Shape of the leg, and whether nobody said so.
    observation
        The data d.
    readings
        Leg angles at which the record was read [rad], shape [sample].
    best
        Curve at the median of φ alone, or at the best draw of several parameters [N], shape [2M].
    nrmsd
        Misfit of that curve by force, fractions of peak-to-peak.
    data
        What was found in the record before the inversion: readings (``rows``), how many were
        ``left_out``, and the ``defects`` that they show; JSON-able.
    simulation
        What a history that was simulated says of its simulation; empty for any other.
    left_out_deg
        Leg angles of the readings that were left out [deg], shape [sample].
    band
        Smallest and largest force over the 95 % interval of φ alone [N], shape [2, 2M].
    expected
        Measured forces as real soils would have them: ``best`` and their mean deviation from the
        model [N], shape [2M]; ``None`` where no deviation was learnt.
    """

    source: str
    leg: str
    observation: Observation
    readings: FloatArray
    best: FloatArray
    nrmsd: Mapping[str, float]
    data: Mapping[str, Any] = field(default_factory=dict)
    simulation: Mapping[str, Any] = field(default_factory=dict)
    left_out_deg: FloatArray = field(default_factory=lambda: np.empty(0))
    band: FloatArray | None = None
    expected: FloatArray | None = None
    leg_assumed: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and words, without the forces."""
        return {
            "source": self.source,
            "leg": self.leg,
            "leg_assumed": self.leg_assumed,
            "nrmsd": dict(self.nrmsd),
            "data": dict(self.data),
        }


@dataclass(frozen=True, eq=False)
class Together:
    """What is to be said of several histories or parameters beside their posterior.

    Attributes
    ----------
    conditional
        Summary of each parameter with all others held at the best point.
    point
        The best point, all parameters: where the curves are drawn.
    identifiability
        Which parameters are fixed, which bound up with each other.
    expected_sd
        What each leg alone, and all together, would leave of each parameter: leg, or ``all``, to
        standard deviations, shape [d].
    noise_N, amplitude
        Draws of the noise of a window mean of the noisier force [N], and of the relative size of
        the discrepancy [-], shape [draw] or that of the draws.
    discrepancy
        ``none``, ``gp`` or ``soils``.
    """

    conditional: Mapping[str, Summary]
    point: Mapping[str, float]
    identifiability: Identifiability
    expected_sd: Mapping[str, FloatArray]
    noise_N: FloatArray
    amplitude: FloatArray
    discrepancy: str

    def as_dict(self, keys: tuple[str, ...]) -> dict[str, Any]:
        """Plain numbers, lists and words."""
        return {
            "best": dict(self.point),
            "identifiability": self.identifiability.as_dict(),
            "expected_sd": {
                name: dict(zip(keys, map(float, sd), strict=True))
                for name, sd in self.expected_sd.items()
            },
            "noise_N": Summary.of(self.noise_N).as_dict(),
            "discrepancy": self.discrepancy,
            "discrepancy_of_peak": Summary.of(self.amplitude).as_dict(),
        }


@dataclass(frozen=True, eq=False)
class Inversion:
    """What an inversion found.

    Attributes
    ----------
    records
        The histories.
    library, convention
        Name of the library, and what φ means there: a yield criterion, or ``rft3d``.
    likelihood, sampler, seed
        How: ``calibrated``, ``paper`` or ``joint``; ``quadrature`` or ``emcee``.
    marginal
        Summary of each parameter that was inferred, by its dotted scenario key.
    priors
        Of every parameter, fixed ones too.
    of_phi
        Posterior of φ by quadrature, if it alone was inferred.
    draws
        By emcee: of the parameters, and then of noise and discrepancy as far as they were inferred.
    phi_plane_strain
        The friction angle as one of plane strain [deg]; ``None`` where there is no equivalent or
        the angle was not inferred.
    plane_strain_reason
        Why there is none; empty if there is one.
    density
        Bulk density that the curves were scaled to [kg/m³]; ``None`` if it was inferred.
    density_assumed
        Whether it was taken from the library for want of a better one, or is a guess.
    verdict
        Whether to believe it.
    warnings
        Why the answer may not be what was asked for.
    budget
        Where the interval comes from; ``None`` but for one history, φ alone without a normal
        prior, and the calibrated likelihood.
    together
        What there is to say of several histories or parameters; ``None`` for one history and φ.
    library_reason
        Why the library was taken, if nobody named it.
    compared
        The forces beside those of known soils in the same apparatus, without any library;
        ``None`` if they cannot be compared.
    provenance
        Versions of the software, hash and versions of the library, time taken [s]; JSON-able.
    """

    records: tuple[Record, ...]
    library: str
    convention: str
    likelihood: str
    sampler: str
    seed: int | None
    marginal: Mapping[str, Summary]
    priors: Mapping[str, Marginal]
    of_phi: Posterior | None
    phi_plane_strain: AngleSummary | None
    plane_strain_reason: str
    density: float | None
    density_assumed: bool
    verdict: Verdict
    warnings: tuple[Doubt, ...] = ()
    budget: Budget | None = None
    together: Together | None = None
    library_reason: str = ""
    compared: Compared | None = None
    draws: Draws | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def keys(self) -> tuple[str, ...]:
        """Parameters that were inferred, dotted scenario keys."""
        return tuple(self.marginal)

    @property
    def phi(self) -> Summary:
        """Summary of φ [deg]; ValueError if it was not inferred."""
        if PHI not in self.marginal:
            raise ValueError("the friction angle was not inferred")
        return self.marginal[PHI]

    @property
    def posterior(self) -> Posterior:
        """Posterior of φ by quadrature; ValueError if it was not inferred alone."""
        if self.of_phi is None:
            raise ValueError("the friction angle was not inferred alone")
        return self.of_phi

    @property
    def reason(self) -> str:
        """The verdict and all warnings, in words."""
        return reason(self.verdict, self.warnings)

    @property
    def record(self) -> Record:
        """The history, if there is one alone; ValueError if there are several."""
        if len(self.records) != 1:
            raise ValueError(f"there are {len(self.records)} histories; take .records")
        return self.records[0]

    @property
    def source(self) -> str:
        """Where the forces of the only history come from, or of each."""
        return ", ".join(record.source for record in self.records)

    @property
    def origin(self) -> str:
        """What its forces are, in a word: ``measured`` or ``simulated``."""
        return "simulated" if all(r.simulation for r in self.records) else "measured"

    @property
    def drawn(self) -> FloatArray:
        """Draws of all parameters, or quantiles of equal probability of one, [draw, parameter]."""
        if self.draws is not None:
            return self.draws.flat[:, : len(self.keys)]
        shares = (np.arange(QUANTILES) + 0.5) / QUANTILES
        return np.array([self.posterior.quantile(share) for share in shares])[:, None]

    @property
    def legs(self) -> list[str]:
        """Legs of the histories, with a word on those that are assumed."""
        assumed = {r.leg for r in self.records if r.leg_assumed}
        return [f"{leg}, assumed" if leg in assumed else leg for leg in self.by_leg]

    @property
    def by_leg(self) -> dict[str, list[Record]]:
        """The histories of each leg."""
        found: dict[str, list[Record]] = {}
        for record in self.records:
            found.setdefault(record.leg, []).append(record)
        return found

    def __repr__(self) -> str:
        """What a person at a prompt wants to see; :meth:`as_dict` has all numbers."""
        assumed = ", assumed" if self.density_assumed else ""
        density = "" if self.density is None else f", density {self.density:g} kg/m³{assumed}"
        named = [
            f"  {self.axis_name(key)}: {one.median:{self.digits(key)}}, 68 %: "
            f"{self.span(key, one.ci68)}, 95 %: {self.span(key, one.ci95)}"
            for key, one in self.marginal.items()
        ]
        if len(named) > MOST_NAMED:
            named[MOST_NAMED - 1 :] = [f"  and {len(named) - MOST_NAMED + 1} more, in .marginal"]
        equal = self.phi_plane_strain if self.convention != "plane_strain" else None
        what = self.records[0].source or "a force history"
        if len(self.records) > 1:
            what = f"{len(self.records)} histories"
        leg = "legs" if len(self.by_leg) > 1 else "leg"
        lines = (
            f"Inversion of {what}",
            f"  {leg} {', '.join(self.legs)}, library {self.library}{density}",
            f"  {self.likelihood} likelihood, {self.sampler}",
            *named,
            f"  φ, equivalent in plane strain: {equal}" if equal else "",
            f"  verdict: {self.verdict.verdict}; why: .reason",
        )
        return "\n".join(filter(None, lines))

    def axis_name(self, key: str) -> str:
        """Name of a parameter for people, with its unit, and φ with its convention."""
        return f"φ, {self.convention} [deg]" if key == PHI else axis_label(key)

    def digits(self, key: str) -> str:
        """Format that gives the numbers of a parameter the digits they deserve."""
        one = self.marginal[key]
        if self.together is None or self.of_phi is not None:
            return f".{decimals(one.ci68)}f"
        return f".{decimals_of_sd(min(one.sd, self.together.conditional[key].sd))}f"

    def span(self, key: str, ends: tuple[float, float]) -> str:
        """An interval of a parameter, in words."""
        form = self.digits(key)
        return f"{ends[0]:{form}} to {ends[1]:{form}}"

    def convergence_of(self, key: str) -> dict[str, float]:
        """Diagnostics of a parameter."""
        if self.draws is None:
            return self.posterior.convergence
        told = self.draws.diagnostics[self.keys.index(key)].as_dict()
        if self.of_phi is None:
            return told
        return {**told, "acceptance_fraction": self.draws.acceptance_fraction}

    def as_dict(self) -> dict[str, Any]:
        """Answer as the command line prints it with ``--json``."""
        phi, equivalent = self.marginal.get(PHI), self.phi_plane_strain
        told: dict[str, Any] = {
            "phi_deg": {**phi.as_dict(), "yield": self.convention} if phi else None,
            "phi_plane_strain_deg": equivalent.as_dict() if equivalent else None,
            "phi_plane_strain_reason": self.plane_strain_reason,
            "verdict": self.verdict.verdict,
            "reason": self.reason,
            "edge": self.verdict.edge,
            "warnings": list(map(of_doubt, self.warnings)),
            "measures": [measure.as_dict() for measure in self.verdict.measures],
            "density_kg_m3": self.density,
            "density_assumed": self.density_assumed,
            "n_angles": len(self.records[0].observation.theta_deg),
            "histories": [record.as_dict() for record in self.records],
            "parameters": {key: self._parameter(key) for key in self.keys},
            "fixed": {k: p.low for k, p in self.priors.items() if p.fixed},
            "library": self.library,
            "library_reason": self.library_reason,
            "compared_with_known_soils": self.compared.as_dict() if self.compared else None,
            "likelihood": self.likelihood,
            "sampler": self.sampler,
            "seed": self.seed,
            "error_budget": self.budget.as_dict() if self.budget else None,
        }
        if len(self.records) == 1:
            told |= told["histories"][0]
        if self.together is not None:
            told |= self.together.as_dict(self.keys)
            told["converged"] = self.draws is None or self.draws.converged
        if self.of_phi is not None:
            told["convergence"] = self.convergence_of(PHI)
        elif self.draws is not None:
            told["acceptance_fraction"] = self.draws.acceptance_fraction
        return {**told, "provenance": dict(self.provenance)}

    def _parameter(self, key: str) -> dict[str, Any]:
        """One parameter, as plain numbers and words."""
        alone = self.marginal[key]
        known = alone if self.together is None else self.together.conditional[key]
        return {
            "name": label(key)[0],
            "unit": label(key)[1],
            **alone.as_dict(),
            "conditional": known.as_dict(),
            "prior": self.priors[key].as_dict(),
            "convergence": self.convergence_of(key),
        }

    def to_netcdf(self, path: Path | str) -> None:
        """Write the posterior in the layout of ArviZ, which can open it: see `answer_file`.

        Parameters
        ----------
        path
            The file.

        Raises
        ------
        InputError
            If the place cannot be written.
        """
        from terraphi.inference.answer_file import write

        write(self, Path(path))


def plane_strain_summary(phi: AngleSummary, scenario: Scenario) -> tuple[AngleSummary | None, str]:
    """The same strength as plane-strain Mohr-Coulomb angles; quantiles map one to one.

    Parameters
    ----------
    phi
        Summary in the scenario's convention [deg].
    scenario
        Its convention and flow rule.

    Returns
    -------
    tuple
        The summary, or ``None`` and the reason why there is none.
    """
    if scenario.convention == "rft3d":
        return None, (
            "the angle of resistive force theory is the parameter of an empirical law, "
            "not of a yield criterion"
        )
    soil = scenario.soil

    def convert(angle_deg: float) -> float:
        return plane_strain_friction_angle_deg(
            angle_deg,
            soil.yield_criterion,
            dilation_angle_deg=angle_deg if soil.flow == "associated" else soil.dilation_angle_deg,
        )

    try:
        low68, high68, low95, high95 = map(convert, (*phi.ci68, *phi.ci95))
        return AngleSummary(convert(phi.median), (low68, high68), (low95, high95)), ""
    except InputError as error:
        return None, str(error)
