"""Hillslopes and points on them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest


@pytest.fixture
def hill(tmp_path) -> Callable[..., Path]:
    """Write an elevation model: a plane of some slope, or an array."""
    rasterio = pytest.importorskip("rasterio")

    def write(
        slope_deg: float = 30.0,
        *,
        n: int = 60,
        name: str = "dem.tif",
        crs: str | None = "EPSG:32611",
        heights: Any = None,
        left: float = 0.0,
        bottom: float = 0.0,
        unit: str = "",
        bands: int = 1,
    ) -> Path:
        if heights is None:
            rise = np.tan(np.radians(slope_deg)) * (n - np.arange(n) - 0.5)
            heights = np.repeat(rise[:, None], n, axis=1)
        shape, dtype = heights.shape, "complex64" if np.iscomplexobj(heights) else "float32"
        place = rasterio.Affine(1.0, 0.0, left, 0.0, -1.0, bottom + shape[0])
        with rasterio.open(
            tmp_path / name, "w", driver="GTiff", height=shape[0], width=shape[1], count=bands,
            dtype=dtype, crs=crs, transform=place, nodata=-9999.0,
        ) as file:  # fmt: skip
            file.write(heights.astype(dtype), 1)
            file.units = (unit,) * bands
        return tmp_path / name

    return write


@pytest.fixture
def points(tmp_path) -> Callable[..., Path]:
    """Write points as a CSV."""

    def write(x: Any, y: Any, phi: Any, sd: Any = 2.0, shared: Any = None, first: str = "") -> Path:
        columns = [x, y, phi, sd, *([] if shared is None else [shared])]
        rows = np.broadcast_arrays(*columns)
        names = "x_m,y_m,phi_deg,sd_deg" + ("" if shared is None else ",shared_sd_deg")
        lines = [",".join(f"{v:.6f}" for v in row) for row in np.stack(rows, axis=-1)]
        (tmp_path / "points.csv").write_text(
            "\n".join([*([first] if first else []), names, *lines])
        )
        return tmp_path / "points.csv"

    return write
