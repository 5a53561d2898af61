"""The answer of an inversion: the friction angle, its interval, the verdict, and a file of them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import write_netcdf
from terraphi.experiment.history import Observation
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.soil import plane_strain_friction_angle_deg
from terraphi.inference.budget import Budget
from terraphi.inference.findings import Doubt, Verdict
from terraphi.inference.posterior import Posterior
from terraphi.inference.words import of_doubt, reason

__all__ = ["AngleSummary", "Inversion", "plane_strain_summary"]

FloatArray = NDArray[np.float64]

NARROW_DEG = 0.1
"""Width of the 68 % interval below which angles are shown with another digit [deg]."""
QUADRATURE_DRAWS = (4, 1000)
"""Chains and draws that stand for a posterior by quadrature in a file."""


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
    readings
        Leg angles at which the record was read [rad], shape [sample].
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
    warnings
        Why the answer may not be what was asked for.
    likelihood
        Name of the likelihood.
    data
        What was found in the record before the inversion: readings (``rows``), how many were
        ``left_out``, and the ``defects`` that they show; JSON-able.
    budget
        Where the interval comes from; ``None`` under the paper's likelihood.
    provenance
        Versions of the software, hash and versions of the library, time taken [s]; JSON-able.
    """

    source: str
    observation: Observation
    readings: FloatArray
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
    warnings: tuple[Doubt, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    budget: Budget | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def origin(self) -> str:
        """What its forces are, in a word: ``measured`` or ``simulated``."""
        return "simulated" if "simulation" in self.provenance else "measured"

    @property
    def reason(self) -> str:
        """The verdict and all warnings, in words."""
        return reason(self.verdict, self.warnings)

    def __repr__(self) -> str:
        """What a person at a prompt wants to see; :meth:`as_dict` has all numbers."""
        assumed = ", assumed" if self.density_assumed else ""
        equal = self.phi_plane_strain if self.convention != "plane_strain" else None
        deviation = " and ".join(f"{share:.1%} ({name})" for name, share in self.nrmsd.items())
        lines = (
            f"Inversion of {self.source or 'a force history'}",
            f"  leg {self.leg}, library {self.library}, density {self.density:g} kg/m³{assumed}",
            f"  {self.likelihood} likelihood, {self.posterior.sampler}",
            f"  φ ({self.convention}): {self.phi}",
            f"  φ, equivalent in plane strain: {equal}" if equal else "",
            f"  deviation of the best curve: {deviation} of peak-to-peak",
            f"  verdict: {self.verdict.verdict}; why: .reason",
        )
        return "\n".join(filter(None, lines))

    def as_dict(self) -> dict[str, Any]:
        """Answer as the command line prints it with ``--json``."""
        equivalent = self.phi_plane_strain
        return {
            "phi_deg": {**self.phi.as_dict(), "yield": self.convention},
            "phi_plane_strain_deg": equivalent.as_dict() if equivalent else None,
            "phi_plane_strain_reason": self.plane_strain_reason,
            "verdict": self.verdict.verdict,
            "reason": self.reason,
            "edge": self.verdict.edge,
            "warnings": list(map(of_doubt, self.warnings)),
            "measures": [measure.as_dict() for measure in self.verdict.measures],
            "data": dict(self.data),
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
            "error_budget": self.budget.as_dict() if self.budget else None,
            "provenance": dict(self.provenance),
        }

    def to_netcdf(self, path: Path | str) -> None:
        """Write the posterior in the layout of ArviZ, which can open it.

        Groups ``posterior`` (``phi_deg`` over chain and draw), ``observed_data`` (the window
        means, and where the record was read), ``posterior_predictive_mean`` (the best curve) and,
        if there is a budget, ``information_share`` (what each angle told of φ); the answer stands
        in the attributes. A posterior by quadrature is written as quantiles of equal probability
        in a random order, which are as good as independent draws.

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
        pairs = {
            "observed_data": (self.observation.Fx, self.observation.Fz, "N"),
            "posterior_predictive_mean": (self.best[:half], self.best[half:], "N"),
        }
        if self.budget is not None:
            pairs["information_share"] = (*self.budget.information, "1")
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
                **{
                    f"/{name}": xr.Dataset(
                        {
                            "Fx": ("theta_deg", fx, {"units": units}),
                            "Fz": ("theta_deg", fz, {"units": units}),
                        },
                        coords={"theta_deg": angle},
                    )
                    for name, (fx, fz, units) in pairs.items()
                },
            }
        )
        tree["observed_data/reading_deg"] = xr.DataArray(
            np.degrees(self.readings), dims="reading", attrs={"units": "degree"}
        )
        write_netcdf(tree, Path(path))

    def _chains(self) -> FloatArray:
        """Draws of φ [deg], shape [chain, draw]."""
        if self.posterior.draws_deg is not None:
            return self.posterior.chains()
        count = QUADRATURE_DRAWS[0] * QUADRATURE_DRAWS[1]
        draws = np.array([self.posterior.quantile((i + 0.5) / count) for i in range(count)])
        return np.random.default_rng(0).permutation(draws).reshape(QUADRATURE_DRAWS)


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
