"""Footfalls as JSON, NetCDF, GeoJSON and CSV."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import open_netcdf, replacing, write_netcdf
from terraphi.experiment.outputs import SIGNATURE
from terraphi.robot.footfalls import VERDICTS, FootfallMap

KIND = "footfalls"
SCHEMA = 1
CI95 = 1.959964
"""Half-width of a normal 95 % interval over its standard deviation [-]; of a 68 % one it is 1."""
EARTH_RADIUS = 6_371_000.0
"""[m]."""
COLUMNS = {
    "time_s": ("time", "s", "touch-down"),
    "sinkage_m": ("sinkage", "m", "depth of the foot at the end of the loading"),
    "phi_deg": ("phi", "degree", "friction angle, by this footfall alone"),
    "sd_deg": ("sd", "degree", "its own standard deviation (relative)"),
    "shared_sd_deg": ("shared_sd", "degree", "that it shares with all footfalls"),
    "chi2": ("misfit", "1", "chi squared over the degrees of freedom"),
    "path_phi_deg": ("path_phi", "degree", "friction angle, footfalls pooled"),
    "path_relative_sd_deg": ("path_relative_sd", "degree", "standard deviation, relative"),
    "path_absolute_sd_deg": ("path_absolute_sd", "degree", "standard deviation, absolute"),
}
"""Variable of a file to the field of a map that it holds, its unit and meaning."""
PLACES = {
    "x_m": ("place", 0, "along the first heading"),
    "y_m": ("place", 1, "to its left"),
    "surface_m": ("place", 2, "level of the surface"),
    "s_m": ("path", 0, "along the path"),
    "path_x_m": ("path", 1, "along the first heading"),
    "path_y_m": ("path", 2, "to its left"),
}
"""The same for the columns of a field [m]."""
TEXTS = {"shared": "shared", "by_law_deg": "by_law", "notes": "notes", "provenance": "provenance"}
"""Attribute of a file to the field that it holds as JSON."""


def _number(value: float, digits: int = 4) -> float | None:
    return round(float(value), digits) if math.isfinite(value) else None


def _over(field: str) -> str:
    return "point" if field.startswith("path") else "footfall"


def _interval(phi: float, half: float) -> list[float | None]:
    return [_number(phi - half), _number(phi + half)]


def summary(found: FootfallMap) -> dict[str, Any]:
    """All numbers, JSON-able; null where there is none.

    ``ci68`` and ``ci95`` of a footfall are its relative interval, independent of the others';
    with ``_absolute``, what it shares with them is in it too.
    """
    whole = np.hypot(found.sd, found.shared_sd)
    footfalls = [
        {
            "t_s": _number(found.time[i], 4),
            "foot": found.foot[i],
            "x_m": _number(found.place[i, 0]),
            "y_m": _number(found.place[i, 1]),
            "surface_mm": _number(1e3 * found.place[i, 2], 2),
            "sinkage_mm": _number(1e3 * found.sinkage[i], 2),
            "phi_deg": None if math.isnan(found.phi[i]) else {
                "median": _number(found.phi[i]),
                "ci68": _interval(found.phi[i], found.sd[i]),
                "ci95": _interval(found.phi[i], CI95 * found.sd[i]),
                "ci68_absolute": _interval(found.phi[i], whole[i]),
                "ci95_absolute": _interval(found.phi[i], CI95 * whole[i]),
            },
            "chi2": _number(found.misfit[i]),
            "verdict": verdict,
        }
        for i, verdict in enumerate(found.verdict)
    ]  # fmt: skip
    columns = zip(("s_m", "x_m", "y_m"), found.path.T, strict=True)
    path: dict[str, Any] = {name: list(map(_number, column)) for name, column in columns}
    path["phi_deg"] = list(map(_number, found.path_phi))
    sds = {"relative": found.path_relative_sd, "absolute": found.path_absolute_sd}
    for kind, sd in sds.items():
        for percent, factor in ((68, 1.0), (95, CI95)):
            band = zip(found.path_phi, factor * sd, strict=True)
            path[f"ci{percent}_{kind}"] = [_interval(*each) for each in band]
    return {
        "law": found.provenance.get("law"),
        "counts": found.counts(),
        "footfalls": footfalls,
        "path": path,
        "shared": found.shared,
        "by_law_deg": {name: _number(value) for name, value in found.by_law.items()},
        "notes": list(found.notes),
    }


def write_footfalls(found: FootfallMap, path: Path) -> tuple[Path, ...]:
    """Write NetCDF-4, and the footfalls as GeoJSON and CSV.

    Parameters
    ----------
    found
        What :func:`~terraphi.robot.footfalls.find_footfalls` found.
    path
        The NetCDF to make or replace; the others have its name with ``.geojson`` and ``.csv``.

    Returns
    -------
    tuple of Path
        What was written.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    import pandas as pd
    import xarray as xr

    variables: dict[str, Any] = {
        name: (_over(field), getattr(found, field), {"units": units, "long_name": about})
        for name, (field, units, about) in COLUMNS.items()
    }
    variables |= {
        name: (_over(field), getattr(found, field)[:, i], {"units": "m", "long_name": about})
        for name, (field, i, about) in PLACES.items()
    }
    variables["foot"] = ("footfall", np.array(found.foot, dtype="U2"))
    variables["verdict"] = ("footfall", np.array(found.verdict, dtype="U24"))
    texts = {name: json.dumps(getattr(found, field)) for name, field in TEXTS.items()}
    dataset = xr.Dataset(
        variables, attrs={"terraphi_file": KIND, "terraphi_schema": SCHEMA, **texts}
    ).set_coords("s_m")
    names = path, path.with_suffix(".geojson"), path.with_suffix(".csv")
    write_netcdf(dataset, names[0])
    table = {
        "t_s": found.time, "foot": found.foot,
        **dict(zip(("x_m", "y_m", "surface_m"), found.place.T, strict=True)),
        "sinkage_m": found.sinkage, "phi_deg": found.phi, "sd_deg": found.sd,
        "shared_sd_deg": found.shared_sd, "verdict": found.verdict,
    }  # fmt: skip
    with replacing(names[2]) as temporary, temporary.open("w", newline="") as stream:
        stream.write(f"# {SIGNATURE}: footfalls; x, y from the robot's first place and heading\n")
        pd.DataFrame(table).to_csv(stream, index=False, float_format="%.4f", lineterminator="\n")
    with replacing(names[1]) as temporary:
        temporary.write_text(json.dumps(_geojson(found), ensure_ascii=False), encoding="utf-8")
    return names


def read_footfalls(path: Path) -> FootfallMap:
    """Read what :func:`write_footfalls` wrote; raises InputError if it is not whole."""
    data = open_netcdf(path, kind=KIND, schema=SCHEMA)
    try:
        fields: dict[str, Any] = {f: data[name].values for name, (f, *_) in COLUMNS.items()}
        fields |= {f: json.loads(data.attrs[name]) for name, f in TEXTS.items()}
        for whole in ("place", "path"):
            names = [name for name, (field, *_) in PLACES.items() if field == whole]
            fields[whole] = np.column_stack([data[name].values for name in names])
        fields |= {name: tuple(map(str, data[name].values)) for name in ("foot", "verdict")}
        found = FootfallMap(**{**fields, "notes": tuple(fields["notes"])})
        unknown = set(found.verdict) - set(VERDICTS)
        if unknown:
            raise ValueError(f"verdict {unknown.pop()!r}")
    except (KeyError, TypeError, ValueError) as error:
        why = f"{path}: not as terraphi writes footfalls ({error}); make it again"
        raise InputError(why) from error
    return found


def _geojson(found: FootfallMap) -> dict[str, Any]:
    """Footfalls as points, metres east and north of (0°, 0°) as degrees: a map without a place."""
    degrees = 180.0 / (math.pi * EARTH_RADIUS)
    features = [
        {
            "type": "Feature",
            "geometry": {
                "type": "Point",
                "coordinates": [round(float(v) * degrees, 9) for v in found.place[i, :2]],
            },
            "properties": {
                key: entry[key]
                for key in ("t_s", "foot", "x_m", "y_m", "sinkage_mm", "phi_deg", "verdict")
            },
        }
        for i, entry in enumerate(summary(found)["footfalls"])
    ]
    about = (
        f"{SIGNATURE}; a log has no place on earth: x_m and y_m are metres from the robot's first "
        "place, and the coordinates the same as if that were longitude 0, latitude 0, heading east"
    )
    return {"type": "FeatureCollection", "about": about, "features": features}
