"""Footfalls as JSON, NetCDF, GeoJSON and CSV."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
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
VARIABLES = {
    "time_s": ("time", "footfall", "s", "touch-down"),
    "sinkage_m": ("sinkage", "footfall", "m", "depth of the foot at the end of the loading"),
    "phi_deg": ("phi", "footfall", "degree", "friction angle, by this footfall alone"),
    "sd_deg": ("sd", "footfall", "degree", "its own standard deviation (relative)"),
    "shared_sd_deg": ("shared_sd", "footfall", "degree", "that it shares with all footfalls"),
    "chi2": ("misfit", "footfall", "1", "chi squared over the degrees of freedom"),
    "path_phi_deg": ("path_phi", "point", "degree", "friction angle, footfalls pooled"),
    "path_relative_sd_deg": ("path_relative_sd", "point", "degree", "standard deviation, relative"),
    "path_absolute_sd_deg": ("path_absolute_sd", "point", "degree", "standard deviation, absolute"),
}
"""Variable of a file to the field of a map that it holds, its dimension, unit and meaning."""

CSV_COLUMNS = ["t_s", "foot", "x_m", "y_m", "surface_m", "sinkage_m", "phi_deg", "sd_deg",
               "shared_sd_deg", "verdict"]  # fmt: skip


def _number(value: float, digits: int = 4) -> float | None:
    return round(float(value), digits) if math.isfinite(value) else None


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
            "phi_deg": None
            if math.isnan(found.phi[i])
            else {
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
    ]
    return {
        "law": found.provenance.get("law"),
        "counts": found.counts(),
        "footfalls": footfalls,
        "path": _path(found),
        "shared": found.shared,
        "by_law_deg": {name: _number(value) for name, value in found.by_law.items()},
        "notes": list(found.notes),
    }


def _path(found: FootfallMap) -> dict[str, Any]:
    def band(sd: FloatArray, factor: float) -> list[list[float | None]]:
        return [_interval(p, factor * s) for p, s in zip(found.path_phi, sd, strict=True)]

    return {
        "s_m": [_number(s) for s in found.path[:, 0]],
        "x_m": [_number(x) for x in found.path[:, 1]],
        "y_m": [_number(y) for y in found.path[:, 2]],
        "phi_deg": [_number(p) for p in found.path_phi],
        "ci68_relative": band(found.path_relative_sd, 1.0),
        "ci95_relative": band(found.path_relative_sd, CI95),
        "ci68_absolute": band(found.path_absolute_sd, 1.0),
        "ci95_absolute": band(found.path_absolute_sd, CI95),
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
        name: (over, getattr(found, field), {"units": units, "long_name": about})
        for name, (field, over, units, about) in VARIABLES.items()
    }
    ahead, aside = (
        {"units": "m", "long_name": about} for about in ("along the first heading", "to its left")
    )
    level = {"units": "m", "long_name": "level of the surface"}
    dataset = xr.Dataset(
        {
            **variables,
            "foot": ("footfall", np.array(found.foot, dtype="U2")),
            "verdict": ("footfall", np.array(found.verdict, dtype="U24")),
            "x_m": ("footfall", found.place[:, 0], ahead),
            "y_m": ("footfall", found.place[:, 1], aside),
            "surface_m": ("footfall", found.place[:, 2], level),
            "path_x_m": ("point", found.path[:, 1], ahead),
            "path_y_m": ("point", found.path[:, 2], aside),
        },
        coords={"s_m": ("point", found.path[:, 0], {"units": "m", "long_name": "along the path"})},
        attrs={
            "terraphi_file": KIND,
            "terraphi_schema": SCHEMA,
            "shared": json.dumps(found.shared),
            "by_law_deg": json.dumps(found.by_law),
            "notes": json.dumps(found.notes),
            "provenance": json.dumps(found.provenance),
        },
    )
    names = path, path.with_suffix(".geojson"), path.with_suffix(".csv")
    write_netcdf(dataset, names[0])
    rows = [
        [found.time[i], found.foot[i], *found.place[i], found.sinkage[i], found.phi[i], found.sd[i],
         found.shared_sd[i], verdict]
        for i, verdict in enumerate(found.verdict)
    ]  # fmt: skip
    with replacing(names[2]) as temporary, temporary.open("w", newline="") as stream:
        stream.write(f"# {SIGNATURE}: footfalls; x, y from the robot's first place and heading\n")
        table = pd.DataFrame(rows, columns=CSV_COLUMNS)
        table.to_csv(stream, index=False, float_format="%.4f", lineterminator="\n")
    with replacing(names[1]) as temporary:
        temporary.write_text(json.dumps(_geojson(found), ensure_ascii=False), encoding="utf-8")
    return names


def read_footfalls(path: Path) -> FootfallMap:
    """Read what :func:`write_footfalls` wrote; raises InputError if it is not whole."""
    data = open_netcdf(path, kind=KIND, schema=SCHEMA)
    try:
        found = FootfallMap(
            **{field: data[name].values for name, (field, *_) in VARIABLES.items()},
            foot=tuple(map(str, data["foot"].values)),
            verdict=tuple(map(str, data["verdict"].values)),
            place=np.column_stack([data[n].values for n in ("x_m", "y_m", "surface_m")]),
            path=np.column_stack([data[n].values for n in ("s_m", "path_x_m", "path_y_m")]),
            shared=json.loads(data.attrs["shared"]),
            by_law=json.loads(data.attrs["by_law_deg"]),
            notes=tuple(json.loads(data.attrs["notes"])),
            provenance=json.loads(data.attrs["provenance"]),
        )
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
        f"{SIGNATURE}; a log says no place on earth: x_m and y_m are metres from the robot's first "
        "place, and the coordinates the same as if that were longitude 0, latitude 0, heading east"
    )
    return {"type": "FeatureCollection", "about": about, "features": features}
