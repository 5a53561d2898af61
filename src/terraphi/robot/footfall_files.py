"""Footfalls as JSON, NetCDF, GeoJSON and CSV."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, Field, Json

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.files import atomic_write, open_netcdf, write_netcdf
from terraphi.experiment.outputs import SIGNATURE
from terraphi.experiment.tables import write_csv
from terraphi.robot.footfalls import VERDICTS, FootfallMap

KIND = "footfalls"
SCHEMA = 2
CI95 = 1.959964
"""Half-width of a normal 95 % interval over its standard deviation [-]; of a 68 % one it is 1."""
EARTH_RADIUS = 6_371_000.0
"""[m]."""
COLUMNS = {
    "time_s": ("time", None, "s", "touch-down"),
    "x_m": ("place", 0, "m", "along the first heading"),
    "y_m": ("place", 1, "m", "to its left"),
    "surface_m": ("place", 2, "m", "level of the surface"),
    "sinkage_m": ("sinkage", None, "m", "depth of the foot at the end of the loading"),
    "phi_deg": ("phi", None, "degree", "friction angle, by this footfall alone"),
    "relative_sd_deg": ("sd", None, "degree", "standard deviation against the walk's others"),
    "shared_sd_deg": ("shared_sd", None, "degree", "that it shares with all footfalls"),
    "chi2": ("misfit", None, "1", "chi squared over the degrees of freedom"),
    "s_m": ("path", 0, "m", "along the path"),
    "path_x_m": ("path", 1, "m", "along the first heading"),
    "path_y_m": ("path", 2, "m", "to its left"),
    "path_phi_deg": ("path_phi", None, "degree", "friction angle, footfalls pooled"),
    "path_relative_sd_deg": ("path_relative_sd", None, "degree", "standard deviation, relative"),
    "path_absolute_sd_deg": ("path_absolute_sd", None, "degree", "standard deviation, absolute"),
}
"""Variable of a file to the field of a map that it holds, the column in it, unit and meaning."""


class FootfallAttributes(BaseModel):
    """Attributes of a file of footfalls: fields of a map, as JSON."""

    shared: Json[dict[str, Any]]
    by_law: Json[dict[str, float]] = Field(alias="by_law_deg")
    notes: Json[tuple[str, ...]]
    provenance: Json[dict[str, Any]]


def _numbers(values: Any, digits: int = 4) -> list[float | None]:
    return [round(float(v), digits) if math.isfinite(v) else None for v in values]


def _bands(phi: FloatArray, sds: dict[str, FloatArray]) -> dict[str, list[list[float | None]]]:
    """Intervals of 68 and 95 %, by name."""
    return {
        f"ci{percent}{kind}": list(
            map(list, zip(_numbers(phi - factor * sd), _numbers(phi + factor * sd), strict=True))
        )
        for kind, sd in sds.items()
        for percent, factor in ((68, 1.0), (95, CI95))
    }


def _each(phi: FloatArray, sd: FloatArray) -> list[dict[str, Any] | None]:
    """Median and intervals of each footfall; None where it was refused."""
    bands = _bands(phi, {"": sd})
    return [
        None if median is None else {"median": median, **{k: v[i] for k, v in bands.items()}}
        for i, median in enumerate(_numbers(phi))
    ]


def summary(found: FootfallMap) -> dict[str, Any]:
    """All numbers, JSON-able; null where there is none.

    ``phi_deg`` of a footfall holds its absolute bands, ``phi_relative_deg`` those against the other
    footfalls of the walk, without what soil, foot, law and sensors add to all of them.
    """
    x, y, surface = found.place.T
    footfalls = {
        "t_s": _numbers(found.time), "foot": found.foot, "x_m": _numbers(x), "y_m": _numbers(y),
        "surface_mm": _numbers(1e3 * surface, 2), "sinkage_mm": _numbers(1e3 * found.sinkage, 2),
        "phi_deg": _each(found.phi, np.hypot(found.sd, found.shared_sd)),
        "phi_relative_deg": _each(found.phi, found.sd),
        "chi2": _numbers(found.misfit), "verdict": found.verdict,
    }  # fmt: skip
    sds = {"_relative": found.path_relative_sd, "_absolute": found.path_absolute_sd}
    path = dict(zip(("s_m", "x_m", "y_m"), map(_numbers, found.path.T), strict=True))
    return {
        "law": found.provenance.get("law"),
        "counts": found.counts(),
        "footfalls": [
            dict(zip(footfalls, row, strict=True)) for row in zip(*footfalls.values(), strict=True)
        ],
        "path": {**path, "phi_deg": _numbers(found.path_phi), **_bands(found.path_phi, sds)},
        "shared": found.shared,
        "by_law_deg": dict(zip(found.by_law, _numbers(found.by_law.values()), strict=True)),
        "notes": list(found.notes),
    }


def write_footfalls(found: FootfallMap, path: Path) -> tuple[Path, ...]:
    """Write NetCDF-4, and the footfalls as GeoJSON and CSV.

    Parameters
    ----------
    found
        A map of :func:`~terraphi.robot.footfalls.footfalls`.
    path
        The NetCDF to make or replace; the others have its name with ``.geojson`` and ``.csv``.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    import xarray as xr

    variables: dict[str, Any] = {}
    for name, (field, column, units, about) in COLUMNS.items():
        values = getattr(found, field)
        values = values if column is None else values[:, column]
        over = "point" if field.startswith("path") else "footfall"
        variables[name] = (over, values, {"units": units, "long_name": about})
    absolute = np.hypot(found.sd, found.shared_sd)
    about_it = {"units": "degree", "long_name": "standard deviation of phi_deg, absolute"}
    variables["absolute_sd_deg"] = ("footfall", absolute, about_it)
    variables["foot"] = ("footfall", np.array(found.foot, dtype="U2"))
    variables["verdict"] = ("footfall", np.array(found.verdict, dtype="U24"))
    texts = {
        known.alias or field: json.dumps(getattr(found, field))
        for field, known in FootfallAttributes.model_fields.items()
    }
    attributes = {"terraphi_file": KIND, "terraphi_schema": SCHEMA, **texts}
    names = path, path.with_suffix(".geojson"), path.with_suffix(".csv")
    write_netcdf(xr.Dataset(variables, attrs=attributes).set_coords("s_m"), path)
    first = f"# {SIGNATURE}: footfalls; x, y from the robot's first place and heading\n"
    write_csv(names[2], found.summary(), first=first, float_format="%.4f")
    with atomic_write(names[1]) as temporary:
        temporary.write_text(json.dumps(_geojson(found), ensure_ascii=False), encoding="utf-8")
    return names


def read_footfalls(path: Path) -> FootfallMap:
    """Read a file of :func:`write_footfalls`; raises InputError if it is not whole."""
    with open_netcdf(path, FootfallAttributes, kind=KIND, schema=SCHEMA) as file:
        columns: dict[str, list[FloatArray]] = {}
        for name, (field, *_) in COLUMNS.items():
            over = "point" if field.startswith("path") else "footfall"
            values = file.numbers(name, over, finite=field in ("time", "place", "path"))
            columns.setdefault(field, []).append(values)
        fields: dict[str, Any] = {
            field: np.column_stack(each) if len(each) > 1 else each[0]
            for field, each in columns.items()
        }
        fields |= dict(file.attrs)
        fields |= {name: file.texts(name, "footfall") for name in ("foot", "verdict")}
        walk = FootfallMap(**fields)
        if unknown := set(walk.verdict) - set(VERDICTS):
            raise ValueError(f"verdict {unknown.pop()!r}")
        known = np.stack([walk.phi, walk.sd, walk.shared_sd], axis=1)[walk.usable]
        if not np.isfinite(known).all() or (known.size and not np.isfinite(walk.path_phi).all()):
            raise ValueError("a usable footfall has no phi_deg")
        return walk


def _geojson(found: FootfallMap) -> dict[str, Any]:
    """Footfalls as points, metres east and north of (0°, 0°) as degrees: a map without a place."""
    degrees = found.place[:, :2] * 180.0 / (math.pi * EARTH_RADIUS)
    keys = ("t_s", "foot", "x_m", "y_m", "sinkage_mm", "phi_deg", "phi_relative_deg",
            "verdict")  # fmt: skip
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": _numbers(place, 9)},
            "properties": {key: entry[key] for key in keys},
        }
        for place, entry in zip(degrees, summary(found)["footfalls"], strict=True)
    ]
    about = (
        f"{SIGNATURE}; a log has no place on earth: x_m and y_m are metres from the robot's first "
        "place, and the coordinates the same as if that were longitude 0, latitude 0, heading east"
    )
    return {"type": "FeatureCollection", "about": about, "features": features}
