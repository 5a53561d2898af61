"""The answer of a joint inversion, and a file of it."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.files import write_netcdf
from terraphi.inference.joint.identifiability import Identifiability, label
from terraphi.inference.joint.prior import Marginal
from terraphi.inference.joint.sampler import Draws
from terraphi.inference.joint.trials import Repeats
from terraphi.inference.verdict import Verdict

FloatArray = NDArray[np.float64]

PRIOR_DRAWS = 2000
"""Draws of the prior in a file."""


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
    keys
        Parameters that were inferred, dotted scenario keys.
    priors
        Of every parameter, fixed ones too.
    draws
        Of the parameters, and then of noise and discrepancy as far as they were inferred.
    noise_N, amplitude
        Draws of the noise of a window mean [N] and the relative size of the discrepancy [-].
    marginal
        Summary of each parameter.
    conditional
        The same with all others held at the most probable draw.
    best
        The most probable draw of all parameters, fixed ones included.
    identifiability
        Which are fixed, which bound up with each other.
    expected_sd
        What each leg alone, and all together, would leave of each parameter by linearisation at
        the most probable draw: leg, or ``all``, to standard deviations, shape [d].
    fits
        Curve of each leg at the most probable draw [N], shape [2 theta].
    nrmsd
        Misfit of that curve by history, fractions of peak-to-peak.
    verdict
        Whether to believe it.
    discrepancy
        ``none`` or ``gp``.
    provenance
        Versions, hashes and time taken [s]; JSON-able.
    """

    groups: tuple[Repeats, ...]
    library: str
    convention: str
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
    nrmsd: Mapping[str, Mapping[str, float]]
    verdict: Verdict
    discrepancy: str
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Answer as the command line prints it with ``--json``."""
        diagnostics = dict(zip(self.keys, self.draws.diagnostics, strict=False))
        return {
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
            "yield": self.convention,
            "most_probable": dict(self.best),
            "identifiability": self.identifiability.as_dict(),
            "expected_sd": {
                name: dict(zip(self.keys, map(float, sd), strict=True))
                for name, sd in self.expected_sd.items()
            },
            "verdict": self.verdict.verdict,
            "reason": self.verdict.reason,
            "edge": self.verdict.edge,
            "histories": [
                {"source": t.source, "leg": g.leg, "nrmsd": dict(self.nrmsd[t.source])}
                for g in self.groups
                for t in g.trials
            ],
            "noise_N": Summary.of(self.noise_N).as_dict(),
            "discrepancy": self.discrepancy,
            "discrepancy_of_peak": Summary.of(self.amplitude).as_dict(),
            "library": self.library,
            "sampler": "emcee",
            "converged": self.draws.converged,
            "acceptance_fraction": self.draws.acceptance_fraction,
            "seed": self.draws.seed,
            "provenance": dict(self.provenance),
        }

    def to_netcdf(self, path: Path | str) -> None:
        """Write the posterior in ArviZ's layout: a group each, chain and draw first.

        ArviZ 0.x reads the groups into an ``InferenceData``, ArviZ 1.x into a ``DataTree``: the
        file is the same. Groups ``posterior`` and ``prior`` (a variable each parameter, named by
        the last parts of its key), ``observed_data`` and ``posterior_predictive_mean`` (window
        means and best curve of each leg); a chain is one walker. The answer stands in the
        attributes.

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

        values = self.draws.values
        chains = values.reshape(-1, *values.shape[2:])
        rng = np.random.default_rng(self.draws.seed)
        prior = {key: self.priors[key].draw(PRIOR_DRAWS, rng)[None] for key in self.keys}
        when = dt.datetime.now(tz=dt.UTC).isoformat(timespec="seconds")
        about = {"created_at": when, "inference_library": "emcee"}
        posterior = {key: chains[:, :, i] for i, key in enumerate(self.keys)}
        extra = {
            "noise_N": self.noise_N.reshape(chains.shape[:2]),
            "discrepancy_of_peak": self.amplitude.reshape(chains.shape[:2]),
        }
        tree = {
            "/": xr.Dataset(
                attrs={
                    "terraphi_file": "joint_inversion",
                    "terraphi_schema": 1,
                    "answer": json.dumps(self.as_dict()),
                }
            ),
            "/posterior": _draws_dataset(posterior, extra, {**about, "yield": self.convention}),
            "/prior": _draws_dataset(prior, {}, about),
            **self._observed(),
        }
        write_netcdf(xr.DataTree.from_dict(tree), Path(path))

    def _observed(self) -> dict[str, Any]:
        """Groups of the data and of the best curves; a variable each leg and force."""
        import xarray as xr

        data, model = {}, {}
        theta = self.groups[0].observations[0].theta_deg
        for group in self.groups:
            half = theta.size
            for i, force in enumerate(("Fx", "Fz")):
                part = slice(i * half, (i + 1) * half)
                name = f"{force}_{group.leg}"
                data[name] = ((f"trial_{group.leg}", "theta_deg"), group.vectors[:, part],
                              {"units": "N"})  # fmt: skip
                model[name] = ("theta_deg", self.fits[group.leg][part], {"units": "N"})
        angle = {"theta_deg": ("theta_deg", theta, {"units": "degree"})}
        sources = {
            f"source_{g.leg}": (f"trial_{g.leg}", np.array([t.source for t in g.trials], object))
            for g in self.groups
        }
        return {
            "/observed_data": xr.Dataset(data, coords={**angle, **sources}),
            "/posterior_predictive_mean": xr.Dataset(model, coords=angle),
        }


def short(key: str) -> str:
    """Name of a parameter in a file: the last part of its key, or the last two of a list's."""
    parts = key.split(".")
    return "_".join(parts[-2:]) if parts[-1].isdecimal() else parts[-1]


def _draws_dataset(
    by_key: Mapping[str, FloatArray], extra: Mapping[str, FloatArray], attrs: Mapping[str, str]
) -> Any:
    import xarray as xr

    variables = {
        short(key): (("chain", "draw"), draws, {"units": label(key)[1] or "1", "key": key})
        for key, draws in by_key.items()
    }
    variables |= {name: (("chain", "draw"), draws, {}) for name, draws in extra.items()}
    count = next(iter(variables.values()))[1].shape
    return xr.Dataset(
        variables,
        coords={"chain": np.arange(count[0]), "draw": np.arange(count[1])},
        attrs=dict(attrs),
    )
