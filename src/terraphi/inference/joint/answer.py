"""The answer of a joint inversion."""

from __future__ import annotations

import datetime as dt
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.files import write_netcdf
from terraphi.inference.answer import AngleSummary
from terraphi.inference.convergence import chains
from terraphi.inference.findings import Doubt, Verdict
from terraphi.inference.joint.identifiability import Identifiability, axis_label, label
from terraphi.inference.joint.prior import Marginal
from terraphi.inference.joint.sampler import Draws
from terraphi.inference.joint.trials import Repeats
from terraphi.inference.words import of_doubt, reason

FloatArray = NDArray[np.float64]

PHI = "soil.friction_angle_deg"
MOST_NAMED = 5
"""Parameters that a representation has room for."""


@dataclass(frozen=True)
class Summary:
    """Median, standard deviation and equal-tailed intervals of a parameter, in its unit."""

    median: float
    sd: float
    ci68: tuple[float, float]
    ci95: tuple[float, float]

    @classmethod
    def of(cls, draws: FloatArray) -> Summary:
        """From draws of any shape."""
        q = np.quantile(draws, [0.5, 0.16, 0.84, 0.025, 0.975]).tolist()
        return cls(q[0], float(draws.std()), (q[1], q[2]), (q[3], q[4]))

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {
            "median": self.median, "sd": self.sd, "ci68": list(self.ci68), "ci95": list(self.ci95),
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class JointInversion:
    """What an inversion of several histories or parameters found.

    Attributes
    ----------
    groups
        The histories by leg.
    library, convention
        Name of the library, and what φ means there.
    phi_plane_strain
        The friction angle as one of plane strain [deg]; ``None`` where there is no equivalent or
        the angle was not inferred.
    plane_strain_reason
        Why there is none; empty if there is one.
    density
        Bulk density, if it was given or taken from the library [kg/m3]; ``None`` if inferred.
    density_assumed
        Whether it is the library's for want of a better one, or a guess.
    keys
        Parameters that were inferred, dotted scenario keys.
    priors
        Of every parameter, fixed ones too.
    draws
        Of the parameters, and then of noise and discrepancy as far as they were inferred.
    noise_N, amplitude
        Draws of the noise of a window mean of the noisier force [N], and of the relative size of
        the discrepancy [-].
    marginal
        Summary of each parameter.
    conditional
        The same with all others held at the best draw.
    best
        The most probable of the draws nearest to the median, with all parameters.
    identifiability
        Which are fixed, which bound up with each other.
    expected_sd
        What each leg alone, and all together, would leave of each parameter by linearisation at
        the best draw: leg, or ``all``, to standard deviations, shape [d].
    fits
        Curve of each leg at the best draw [N], shape [2 theta].
    nrmsd
        Misfit of that curve by force, fractions of peak-to-peak; one a history, leg by leg.
    verdict
        Whether to believe it.
    discrepancy
        ``none`` or ``gp``.
    warnings
        Why the answer may not be what was asked for.
    provenance
        Versions, hashes and time taken [s]; JSON-able.
    """

    groups: tuple[Repeats, ...]
    library: str
    convention: str
    phi_plane_strain: AngleSummary | None
    plane_strain_reason: str
    density: float | None
    density_assumed: bool
    keys: tuple[str, ...]
    priors: Mapping[str, Marginal]
    draws: Draws
    noise_N: FloatArray
    amplitude: FloatArray
    marginal: Mapping[str, Summary]
    conditional: Mapping[str, Summary]
    best: Mapping[str, float]
    identifiability: Identifiability
    expected_sd: Mapping[str, FloatArray]
    fits: Mapping[str, FloatArray]
    nrmsd: tuple[Mapping[str, float], ...]
    verdict: Verdict
    discrepancy: str
    warnings: tuple[Doubt, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def reason(self) -> str:
        """The verdict and all warnings, in words."""
        return reason(self.verdict, self.warnings)

    def __repr__(self) -> str:
        """What a person at a prompt wants to see; :meth:`as_dict` has all numbers."""
        count, legs = sum(len(g.trials) for g in self.groups), ", ".join(g.leg for g in self.groups)
        named = [
            f"  {self.axis_name(key)}: {one.median:{self.digits(key)}}, 68 %: "
            + " to ".join(f"{end:{self.digits(key)}}" for end in one.ci68)
            for key, one in self.marginal.items()
        ]
        if len(named) > MOST_NAMED:
            named[MOST_NAMED - 1 :] = [f"  and {len(named) - MOST_NAMED + 1} more, in .marginal"]
        lines = (
            f"JointInversion of {count} {'history' if count == 1 else 'histories'}, legs {legs}",
            f"  library {self.library} ({self.convention})",
            *named,
            f"  converged: {'yes' if self.draws.converged else 'no'}",
            f"  verdict: {self.verdict.verdict}; why: .reason",
        )
        return "\n".join(lines)

    def axis_name(self, key: str) -> str:
        """Name of a parameter for people, with its unit, and φ with its convention."""
        return f"φ, {self.convention} [deg]" if key == PHI else axis_label(key)

    def digits(self, key: str) -> str:
        """Format that gives the numbers of a parameter the digits they deserve."""
        smallest = min(self.marginal[key].sd, self.conditional[key].sd)
        places = -math.floor(math.log10(0.5 * smallest)) if smallest > 0.0 else 2
        return f".{min(max(places, 0), 12)}f"

    def as_dict(self) -> dict[str, Any]:
        """Answer as the command line prints it with ``--json``."""
        diagnostics = dict(zip(self.keys, self.draws.diagnostics, strict=False))
        phi = self.marginal.get(PHI)
        equivalent = self.phi_plane_strain
        trials = [(t, g) for g in self.groups for t in g.trials]
        return {
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
            "n_angles": len(self.groups[0].observations[0].theta_deg),
            "histories": [
                {"source": t.source, "leg": g.leg, "nrmsd": dict(misfit)}
                for (t, g), misfit in zip(trials, self.nrmsd, strict=True)
            ],
            "parameters": {
                key: {
                    "name": label(key)[0],
                    "unit": label(key)[1],
                    **self.marginal[key].as_dict(),
                    "conditional": self.conditional[key].as_dict(),
                    "prior": self.priors[key].as_dict(),
                    "convergence": diagnostics[key].as_dict(),
                }
                for key in self.keys
            },
            "fixed": {k: p.low for k, p in self.priors.items() if p.fixed},
            "best": dict(self.best),
            "identifiability": self.identifiability.as_dict(),
            "expected_sd": {
                name: dict(zip(self.keys, map(float, sd), strict=True))
                for name, sd in self.expected_sd.items()
            },
            "noise_N": Summary.of(self.noise_N).as_dict(),
            "discrepancy": self.discrepancy,
            "discrepancy_of_peak": Summary.of(self.amplitude).as_dict(),
            "library": self.library,
            "likelihood": "joint",
            "sampler": "emcee",
            "converged": self.draws.converged,
            "acceptance_fraction": self.draws.acceptance_fraction,
            "seed": self.draws.seed,
            "provenance": dict(self.provenance),
        }

    def to_netcdf(self, path: Path | str) -> None:
        """Write the posterior in ArviZ's layout: groups, with chain and draw first.

        ArviZ 0.x reads the groups into an ``InferenceData``, ArviZ 1.x into a ``DataTree``: the
        file is the same. Groups ``posterior`` and ``prior`` (a variable each parameter, named by
        the last parts of its key), ``observed_data`` and ``posterior_predictive_mean`` (window
        means and best curve of each leg). A chain is an ensemble, of which one step in every
        autocorrelation time is kept; the answer stands in the attributes.

        Parameters
        ----------
        path
            The file.

        Raises
        ------
        InputError
            If the place cannot be written.
        """
        write_netcdf(tree_of(self), Path(path))


SCHEMA = 1
"""Version of the layout."""
PRIOR_DRAWS = 2000
"""Draws of the prior in a file."""


def tree_of(found: JointInversion) -> Any:
    """The answer as an ``xarray.DataTree``; see :meth:`JointInversion.to_netcdf`."""
    import xarray as xr

    draws = found.draws
    shape = draws.values.shape[:3]
    rng = np.random.default_rng(draws.seed)
    prior = {key: found.priors[key].draw(PRIOR_DRAWS, rng)[None] for key in found.keys}
    values = chains(draws.values, draws.stride)
    posterior = {key: values[:, :, i] for i, key in enumerate(found.keys)}
    errors = {
        name: chains(drawn.reshape(shape), draws.stride)
        for name, drawn in (("noise_N", found.noise_N), ("discrepancy_of_peak", found.amplitude))
    }
    about = {
        "created_at": dt.datetime.now(tz=dt.UTC).isoformat(timespec="seconds"),
        "inference_library": "emcee",
    }
    root = {
        "terraphi_file": "joint_inversion",
        "terraphi_schema": SCHEMA,
        "answer": json.dumps(found.as_dict()),
    }
    tree = {
        "/": xr.Dataset(attrs=root),
        "/posterior": _draws_dataset(posterior, errors, {**about, "yield": found.convention}),
        "/prior": _draws_dataset(prior, {}, about),
        **_observed(found),
    }
    return xr.DataTree.from_dict(tree)


def short(key: str) -> str:
    """Name of a parameter in a file: the last part of its key, or the last two of a list's."""
    parts = key.split(".")
    return "_".join(parts[-2:]) if parts[-1].isdecimal() else parts[-1]


def _observed(found: JointInversion) -> dict[str, Any]:
    """Groups of the data and of the best curves; a variable each leg and force."""
    import xarray as xr

    data, model = {}, {}
    theta = found.groups[0].observations[0].theta_deg
    newton = {"units": "N"}
    for group in found.groups:
        halves = {"Fx": slice(0, theta.size), "Fz": slice(theta.size, None)}
        for force, half in halves.items():
            name, trial = f"{force}_{group.leg}", f"trial_{group.leg}"
            data[name] = ((trial, "theta_deg"), group.vectors[:, half], newton)
            model[name] = ("theta_deg", found.fits[group.leg][half], newton)
    angle = {"theta_deg": ("theta_deg", theta, {"units": "degree"})}
    sources = {
        f"source_{g.leg}": (f"trial_{g.leg}", np.array([t.source for t in g.trials], object))
        for g in found.groups
    }
    return {
        "/observed_data": xr.Dataset(data, coords={**angle, **sources}),
        "/posterior_predictive_mean": xr.Dataset(model, coords=angle),
    }


def _draws_dataset(
    by_key: Mapping[str, FloatArray], extra: Mapping[str, FloatArray], attrs: Mapping[str, str]
) -> Any:
    import xarray as xr

    over = ("chain", "draw")
    variables = {
        short(key): (over, drawn, {"units": label(key)[1] or "1", "key": key})
        for key, drawn in by_key.items()
    }
    units = {"noise_N": {"units": "N"}}
    variables |= {
        name: (over, drawn, units.get(name, {"units": "1"})) for name, drawn in extra.items()
    }
    count = next(iter(by_key.values())).shape
    coords = {name: np.arange(size) for name, size in zip(over, count, strict=True)}
    return xr.Dataset(variables, coords=coords, attrs=dict(attrs))
