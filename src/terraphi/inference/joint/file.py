"""A joint posterior as a tree of groups in ArviZ's layout."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from terraphi.inference.convergence import chains
from terraphi.inference.joint.identifiability import label

if TYPE_CHECKING:
    from terraphi.inference.joint.answer import JointInversion

FloatArray = NDArray[np.float64]

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
