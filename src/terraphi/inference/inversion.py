"""The inversion from end to end: a force history and a library in, an answer out."""

from __future__ import annotations

import importlib.metadata
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from terraphi.errors import InputError, nearest
from terraphi.files import write_netcdf
from terraphi.history import ForceHistory, Observation
from terraphi.inference.posterior import Posterior, ensemble, quadrature
from terraphi.inference.residual import PaperLikelihood
from terraphi.inference.verdict import Verdict, judge, nrmsd
from terraphi.library import Library
from terraphi.scenario import Scenario
from terraphi.soil import plane_strain_friction_angle_deg
from terraphi.surrogate import LegSurrogate

__all__ = ["LIKELIHOODS", "SAMPLERS", "AngleSummary", "Inversion", "invert"]

FloatArray = NDArray[np.float64]
Likelihood = Literal["paper"]
Sampler = Literal["quadrature", "emcee"]
LIKELIHOODS: tuple[Likelihood, ...] = ("paper",)
SAMPLERS: tuple[Sampler, ...] = ("quadrature", "emcee")

DENSITIES = (100.0, 10000.0)
"""Bulk densities that are accepted [kg/m³]; 1.6 is one in g/cm³."""
FORCES = (1e-4, 1e5)
"""Peak forces that are accepted [N]."""
_SOFTWARE = ("terraphi", "numpy", "scipy", "emcee")

QUADRATURE_DRAWS = (4, 1000)
"""Chains and draws that stand for a posterior by quadrature in a file."""


@dataclass(frozen=True)
class AngleSummary:
    """Median and equal-tailed intervals of a friction angle [deg]."""

    median: float
    ci68: tuple[float, float]
    ci95: tuple[float, float]

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {"median": self.median, "ci68": list(self.ci68), "ci95": list(self.ci95)}


@dataclass(frozen=True)
class Inversion:
    """What an inversion found.

    Attributes
    ----------
    source
        Where the forces come from.
    observation
        The data d.
    leg
        Shape of the leg.
    library
        Name of the library.
    convention
        What φ means: a yield criterion, or ``rft3d``.
    posterior
        Of φ in that convention.
    phi, phi_plane_strain
        Summaries [deg]; the latter ``None`` where there is no equivalent.
    plane_strain_reason
        Why there is no equivalent; empty if there is one.
    density
        Bulk density that the curves were scaled to [kg/m³].
    density_assumed
        Whether it was taken from the library for want of a better one.
    best, band
        Curve at the median [N], shape [2M], and the smallest and largest force over the 95 %
        interval [N], shape [2, 2M].
    nrmsd
        Misfit of the best curve by force, fractions of peak-to-peak.
    verdict
        Whether to believe it.
    likelihood
        Name of the likelihood.
    provenance
        Versions of the software, hash and versions of the library, time taken [s]; JSON-able.
    """

    source: str
    observation: Observation
    leg: str
    library: str
    convention: str
    posterior: Posterior
    phi: AngleSummary
    phi_plane_strain: AngleSummary | None
    plane_strain_reason: str
    density: float
    density_assumed: bool
    best: FloatArray
    band: FloatArray
    nrmsd: Mapping[str, float]
    verdict: Verdict
    likelihood: str
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Answer as the command line prints it with ``--json``."""
        equivalent = self.phi_plane_strain
        return {
            "phi_deg": {**self.phi.as_dict(), "yield": self.convention},
            "phi_plane_strain_deg": equivalent.as_dict() if equivalent else None,
            "phi_plane_strain_reason": self.plane_strain_reason,
            "verdict": self.verdict.verdict,
            "reason": self.verdict.reason,
            "edge": self.verdict.edge,
            "nrmsd": dict(self.nrmsd),
            "density_kg_m3": self.density,
            "density_assumed": self.density_assumed,
            "n_angles": len(self.observation.theta_deg),
            "source": self.source,
            "leg": self.leg,
            "library": self.library,
            "likelihood": self.likelihood,
            "sampler": self.posterior.sampler,
            "seed": self.posterior.seed,
            "convergence": self.posterior.convergence,
            "provenance": dict(self.provenance),
        }

    def to_netcdf(self, path: Path | str) -> None:
        """Write the posterior in the layout of ArviZ, which can open it.

        Groups ``posterior`` (``phi_deg`` over chain and draw), ``observed_data`` (the window
        means) and ``posterior_predictive_mean`` (the best curve); the answer stands in the
        attributes. A posterior by quadrature is written as quantiles of equal probability in a
        random order, which are as good as independent draws.

        Parameters
        ----------
        path
            The file.

        Raises
        ------
        InputError
            If the place cannot be written.
        """
        import xarray as xr

        angle = ("theta_deg", self.observation.theta_deg, {"units": "degree"})
        draws = self._chains()
        half = len(self.observation.theta_deg)
        tree = xr.DataTree.from_dict(
            {
                "/": xr.Dataset(
                    attrs={
                        "terraphi_file": "inversion",
                        "terraphi_schema": 1,
                        "answer": json.dumps(self.as_dict()),
                    }
                ),
                "/posterior": xr.Dataset(
                    {"phi_deg": (("chain", "draw"), draws, {"units": "degree"})},
                    coords={"chain": np.arange(draws.shape[0]), "draw": np.arange(draws.shape[1])},
                    attrs={"yield": self.convention, "sampler": self.posterior.sampler},
                ),
                "/observed_data": xr.Dataset(
                    {
                        "Fx": ("theta_deg", self.observation.Fx, {"units": "N"}),
                        "Fz": ("theta_deg", self.observation.Fz, {"units": "N"}),
                    },
                    coords={"theta_deg": angle},
                ),
                "/posterior_predictive_mean": xr.Dataset(
                    {
                        "Fx": ("theta_deg", self.best[:half], {"units": "N"}),
                        "Fz": ("theta_deg", self.best[half:], {"units": "N"}),
                    },
                    coords={"theta_deg": angle},
                ),
            }
        )
        write_netcdf(tree, Path(path))

    def _chains(self) -> FloatArray:
        """Draws of φ [deg], shape [chain, draw]."""
        if self.posterior.draws_deg is not None:
            return self.posterior.chains()
        count = QUADRATURE_DRAWS[0] * QUADRATURE_DRAWS[1]
        draws = np.array([self.posterior.quantile((i + 0.5) / count) for i in range(count)])
        return np.random.default_rng(0).permutation(draws).reshape(QUADRATURE_DRAWS)


def invert(
    history: ForceHistory,
    *,
    library: Library,
    leg: str = "straight",
    density: float | None = None,
    density_assumed: bool = False,
    likelihood: str = "paper",
    sampler: str = "quadrature",
    seed: int = 0,
    source: str = "",
) -> Inversion:
    """Infer the friction angle from a force history.

    With c = 0 and a fixed stiffness the forces are proportional to the density, so the library's
    curves are multiplied by ρ / ρ_library.

    Parameters
    ----------
    history
        Forces over the whole window |θ| ≤ 85°.
    library
        Simulations over φ.
    leg
        Shape of the leg that was moved.
    density
        Bulk density of the soil [kg/m³]; ``None`` assumes the library's.
    density_assumed
        Whether a density given is itself a guess.
    likelihood
        ``paper``: as printed by Xu & Wang.
    sampler
        ``quadrature`` (exact, one parameter) or ``emcee`` (the paper's settings).
    seed
        Seed of emcee.
    source
        Where the forces come from, for people.

    Returns
    -------
    Inversion

    Raises
    ------
    InputError
        If the history, the leg, the density or an option cannot be used.
    """
    if likelihood not in LIKELIHOODS:
        raise InputError(f"unknown likelihood '{likelihood}'; {nearest(likelihood, LIKELIHOODS)}")
    if sampler not in SAMPLERS:
        raise InputError(f"unknown sampler '{sampler}'; {nearest(sampler, SAMPLERS)}")
    began = time.perf_counter()
    observation = history.observation()
    curves = library.curves(leg, within=(history.position[0], history.position[-1]))
    scenario = curves.scenario
    _check_magnitudes(density, observation, scenario)
    _check_same_setup(history, scenario)
    surrogate = LegSurrogate.fit(curves.phi_deg, curves.theta_deg, curves.Fx, curves.Fz)
    used = scenario.soil.density if density is None else density
    scale = used / scenario.soil.density
    posterior = _sample(observation, surrogate, scale=scale, sampler=sampler, seed=seed)
    phi = AngleSummary(posterior.median, posterior.interval(0.68), posterior.interval(0.95))
    equivalent, why_not = plane_strain_summary(phi, scenario)
    best = surrogate.predict(np.array([phi.median]), scale=scale)[0]
    inside = surrogate.predict(np.linspace(*phi.ci95, 101), scale=scale)
    deviation = nrmsd(observation.vector, best)
    return Inversion(
        source=source or str(history.provenance.get("file", "")),
        observation=observation,
        leg=leg,
        library=library.name,
        convention=scenario.convention,
        posterior=posterior,
        phi=phi,
        phi_plane_strain=equivalent,
        plane_strain_reason=why_not,
        density=used,
        density_assumed=density is None or density_assumed,
        best=best,
        band=np.stack([inside.min(axis=0), inside.max(axis=0)]),
        nrmsd=deviation,
        verdict=judge(
            posterior,
            bounds_deg=surrogate.phi_bounds_deg,
            step_deg=surrogate.phi_step_deg,
            residual_nrmsd=deviation,
            convention=scenario.convention,
        ),
        likelihood=likelihood,
        provenance={**_provenance(library), "seconds": time.perf_counter() - began},
    )


def _provenance(library: Library) -> dict[str, Any]:
    """Versions of the software at work here, and what the library says of itself."""
    return {
        **{name: importlib.metadata.version(name) for name in _SOFTWARE},
        "library": dict(library.provenance),
        "library_hash": library.hash,
    }


def _check_magnitudes(density: float | None, observation: Observation, scenario: Scenario) -> None:
    """Refuse numbers that can only be in another unit, and scaling where it does not hold."""
    low, high = DENSITIES
    if density is not None and not low <= density <= high:
        raise InputError(
            f"density = {density:g} kg/m³ is not that of a soil; {low:g} to {high:g} kg/m³ is "
            "accepted"
        )
    if density not in (None, scenario.soil.density) and scenario.soil.cohesion > 0.0:
        raise InputError(
            f"density = {density:g} kg/m³: the library's soil has cohesion and a density of "
            f"{scenario.soil.density:g} kg/m³, and its forces are not proportional to the density"
        )
    for name, force in (("Fx", observation.Fx), ("Fz", observation.Fz)):
        # Exact equality would be lost to the rounding of the window means.
        if np.ptp(force) <= 1e-9 * np.abs(force).max():
            raise InputError(f"{name} is {force[0]:g} N at every angle; is the sensor connected?")
    low, high = FORCES
    peak = float(np.abs(observation.vector).max())
    if not low <= peak <= high:
        raise InputError(
            f"the largest mean force is {peak:g} N; {low:g} to {high:g} N is accepted: are the "
            "forces in newtons?"
        )


def _check_same_setup(history: ForceHistory, scenario: Scenario) -> None:
    """Refuse a simulated history of a leg or hip unlike the library's."""
    if "scenario" not in history.provenance:
        return
    made_by = Scenario.model_validate(history.provenance["scenario"])
    for name, found, expected in (
        ("leg.chord", made_by.leg.chord, scenario.leg.chord),
        ("leg.width", made_by.leg.width, scenario.leg.width),
        ("leg.half_thickness", made_by.leg.half_thickness, scenario.leg.half_thickness),
        ("hip above the surface", made_by.hip_height, scenario.hip_height),
    ):
        if abs(found - expected) > 1e-6:
            raise InputError(
                f"the history was simulated with {name} = {found:g} m, the library with "
                f"{expected:g} m; build a library for this setup"
            )


def _sample(
    observation: Observation, surrogate: LegSurrogate, *, scale: float, sampler: str, seed: int
) -> Posterior:
    """Posterior of φ under the paper's likelihood."""
    log_likelihood = PaperLikelihood(observation.vector, observation.theta_deg)

    def log_p(phi_deg: FloatArray) -> FloatArray:
        return log_likelihood(surrogate.predict(phi_deg, scale=scale))

    if sampler == "emcee":
        return ensemble(log_p, surrogate.phi_bounds_deg, seed=seed)
    return quadrature(log_p, surrogate.phi_bounds_deg)


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
        return AngleSummary(
            convert(phi.median),
            (convert(phi.ci68[0]), convert(phi.ci68[1])),
            (convert(phi.ci95[0]), convert(phi.ci95[1])),
        ), ""
    except InputError as error:
        return None, str(error)
