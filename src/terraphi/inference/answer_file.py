"""The file of an answer: its posterior in the layout of ArviZ, which opens it.

ArviZ 0.x reads the groups into an ``InferenceData``, ArviZ 1.x into a ``DataTree``: the file is
the same. Groups ``posterior`` and ``prior`` (chain and draw first; a variable each parameter,
``phi_deg`` or named by the last parts of its key), ``observed_data`` (the window means of each
record, and where it was read), ``posterior_predictive_mean`` (its best curve) and, of φ alone,
``curves_within_ci95`` (the least and the largest force of the curves within the interval),
``with_mean_deviation`` (the best curve with what real soils deviate on average, if that was learnt)
and, if there is a budget, ``information_share`` (what each angle told of φ); the answer stands in
the attributes.

A posterior by quadrature is written as quantiles of equal probability in a random order, which are
as good as independent draws; of an ensemble one step in every autocorrelation time is kept, a chain
each.
"""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import check_is_file, damage_told, read_bytes, write_netcdf
from terraphi.inference.identifiability import label
from terraphi.inference.sampler import chains

if TYPE_CHECKING:
    from terraphi.inference.answer import Inversion


KIND, SCHEMA = "inversion", 2
"""What the file says that it is, and the version of its layout; 1 had one history alone."""
CHAINS = 4
"""Into which draws that stand for a posterior by quadrature are put."""
PRIOR_DRAWS = 2000
"""Draws of the prior in a file."""


def write(found: Inversion, path: Path) -> None:
    """Write an answer.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    import xarray as xr

    root = {
        "terraphi_file": KIND,
        "terraphi_schema": SCHEMA,
        "answer": json.dumps(found.as_dict()),
    }
    about = {
        "created_at": dt.datetime.now(tz=dt.UTC).isoformat(timespec="seconds"),
        "inference_library": found.sampler,
        "sampler": found.sampler,
        "yield": found.convention,
    }
    rng = np.random.default_rng(found.seed or 0)
    prior = {key: found.priors[key].draw(PRIOR_DRAWS, rng)[None] for key in found.keys}
    tree = xr.DataTree.from_dict(
        {
            "/": xr.Dataset(attrs=root),
            "/posterior": _drawn(*_posterior(found), about),
            "/prior": _drawn(prior, {}, about),
            **_data(found),
        }
    )
    write_netcdf(tree, path)


class Told(NamedTuple):
    """What a file or folder says of an inversion."""

    source: str
    """Its name."""
    answer: Mapping[str, Any]
    """As :meth:`~terraphi.inference.answer.Inversion.as_dict` has it."""
    draws_deg: FloatArray
    """Draws of φ in the convention of the answer [deg], shape [draw]; empty if not there."""


def read(path: Path) -> Told:
    """Read an answer that ``terraphi invert`` wrote or printed.

    Parameters
    ----------
    path
        Folder of ``--out``, its ``posterior.nc``, or what ``--json`` printed (``-``: standard
        input), which has no draws.

    Raises
    ------
    InputError
        If it is not there, damaged, or no answer.
    """
    if path.is_dir():
        inside = [path / name for name in ("posterior.nc", "answer.json")]
        path = next((file for file in inside if file.is_file()), inside[0])
    wrong = f"{path}: not an answer of 'terraphi invert --out' or --json"
    draws = np.empty(0)
    if path.suffix == ".nc":
        check_is_file(path)
        with damage_told(wrong, AttributeError, TypeError):
            import h5netcdf

            with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
                answer = json.loads(str(file.attrs["answer"]))
                if "phi_deg" in file["posterior"].variables:
                    draws = np.asarray(file["posterior/phi_deg"][...], dtype=np.float64).ravel()
    else:
        content = read_bytes(path)
        try:
            answer = json.loads(content)
        except ValueError as error:
            raise InputError(wrong) from error
    wanted = {"phi_deg", "phi_plane_strain_deg", "verdict", "reason", "library"}
    if not isinstance(answer, dict) or not wanted <= set(answer) or not np.isfinite(draws).all():
        raise InputError(wrong)
    return Told(str(path), answer, draws)


def short(key: str) -> str:
    """Name of a parameter in a file: the last part of its key, or the last two of a list's."""
    parts = key.split(".")
    if parts[-1] == "friction_angle_deg":
        return "phi_deg"
    return "_".join(parts[-2:]) if parts[-1].isdecimal() else parts[-1]


def _posterior(found: Inversion) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Draws of each parameter, and of the errors that were inferred with them, [chain, draw]."""
    draws, errors = found.draws, {}
    if draws is None:
        mixed = np.random.default_rng(0).permutation(found.drawn[:, 0])
        return {found.keys[0]: mixed.reshape(CHAINS, -1)}, {}
    values = chains(draws.values, draws.stride)
    if found.together is not None and found.of_phi is None:
        both = found.together.noise_N, found.together.amplitude
        shaped = (chains(one.reshape(draws.values.shape[:3]), draws.stride) for one in both)
        errors = dict(zip(("noise_N", "discrepancy_of_peak"), shaped, strict=True))
    return {key: values[:, :, i] for i, key in enumerate(found.keys)}, errors


def _data(found: Inversion) -> dict[str, Any]:
    """Groups of the data and of the best curves."""
    import xarray as xr

    theta = found.records[0].observation.theta_deg
    half = theta.size
    coords: dict[str, Any] = {
        "theta_deg": ("theta_deg", theta, {"units": "degree"}),
        "source": ("record", np.array([r.source for r in found.records], object)),
        "leg": ("record", np.array([r.leg for r in found.records], object)),
    }

    def both(vectors: FloatArray) -> Any:
        over, newton = ("record", "theta_deg"), {"units": "N"}
        parts = {"Fx": vectors[:, :half], "Fz": vectors[:, half:]}
        return xr.Dataset({k: (over, v, newton) for k, v in parts.items()}, coords=coords)

    observed = both(np.stack([r.observation.vector for r in found.records]))
    for i, record in enumerate(found.records):
        at = np.degrees(record.readings)
        observed[f"reading_{i}_deg"] = (f"reading_{i}", at, {"units": "degree"})
    groups = {
        "/observed_data": observed,
        "/posterior_predictive_mean": both(np.stack([r.best for r in found.records])),
    }
    angle = {"theta_deg": coords["theta_deg"]}
    band = found.records[0].band
    if len(found.records) == 1 and band is not None:
        ends = zip(("Fx", "Fz"), np.hsplit(band, 2), strict=True)
        within = {name: (("end", "theta_deg"), part, {"units": "N"}) for name, part in ends}
        groups["/curves_within_ci95"] = xr.Dataset(within, coords=angle)
    expected = found.records[0].expected
    if len(found.records) == 1 and expected is not None:
        groups["/with_mean_deviation"] = both(expected[None])
    if found.budget is not None:
        shares = zip(("Fx", "Fz"), found.budget.information, strict=True)
        told = {name: ("theta_deg", share, {"units": "1"}) for name, share in shares}
        groups["/information_share"] = xr.Dataset(told, coords=angle)
    return groups


def _drawn(
    by_key: Mapping[str, FloatArray], extra: Mapping[str, FloatArray], attrs: Mapping[str, str]
) -> Any:
    import xarray as xr

    over = ("chain", "draw")
    named = {"deg": "degree", "": "1"}
    variables = {
        short(key): (over, one, {"units": named.get(label(key)[1], label(key)[1]), "key": key})
        for key, one in by_key.items()
    }
    units = {"noise_N": "N"}
    variables |= {name: (over, one, {"units": units.get(name, "1")}) for name, one in extra.items()}
    count = next(iter(by_key.values())).shape
    coords = {name: np.arange(size) for name, size in zip(over, count, strict=True)}
    return xr.Dataset(variables, coords=coords, attrs=dict(attrs))
