"""A law that was fitted from simulations, of legs or of feet: what it is made of, and its file."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import BaseModel, Field, Json

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.files import open_netcdf, write_netcdf

KIND, SCHEMA = "law", 3
DIMS = {
    "x": ("case", "axis"),
    "depth": ("case",),
    "force": ("case", "channel", "place"),
    "hyper": ("process", "number"),
}
"""Dimensions of what is stored."""


class LawAttributes(BaseModel):
    """Attributes of the file."""

    error_scale: float = Field(1.0, ge=1.0)
    model_error: Json[dict[str, dict[str, Any]]] = {}
    provenance: Json[dict[str, Any]] = {}


@dataclass(frozen=True, eq=False)
class FittedLaw:
    """Dimensionless forces of simulations, and what was learned from them and from real soil.

    Attributes
    ----------
    x
        Cases over :attr:`AXES`, shape [case, axis].
    depth
        Of each, over the length of the body [-], shape [case]; of feet 1.
    force
        In the law's unit at :attr:`PLACES` [-], shape [case, 2, place].
    hyper
        Numbers of the process between the cases, shape [1, number]; ``None``: not known yet.
    error_scale
        Errors of cases that are left out over the process's own standard deviation, root mean
        square [-]: standard deviations are so much larger.
    model_error
        How real soils differ from the law, by body, as of :class:`~terraphi.laws.law.ModelError`.
    provenance
        Versions and cases.
    """

    AXES: ClassVar[tuple[str, ...]]
    """Names of the parameters of a case."""
    PLACES: ClassVar[FloatArray]
    """Along the motion, or depths, as the law has them [-]."""
    HYPER: ClassVar[tuple[int, int]] = (0, 0)
    """Shape of the hyperparameters."""

    x: FloatArray
    depth: FloatArray
    force: FloatArray
    hyper: FloatArray | None = None
    error_scale: float = 1.0
    model_error: dict[str, dict[str, Any]] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def hyperparameters(self) -> FloatArray:
        """Those of the process, as ``hyper``; none of a table."""
        return np.empty((0, 0)) if self.hyper is None else self.hyper

    @cached_property
    def hash(self) -> str:
        """SHA-256 of all that changes an answer, hexadecimal: as precise as a file keeps it."""
        words = json.dumps([self.AXES, self.model_error], sort_keys=True)
        digest = hashlib.sha256(words.encode())
        arrays = self.x, self.depth, self.PLACES, self.force, self.hyperparameters
        for array in (*arrays, self.error_scale):
            digest.update(np.asarray(array, np.float32).tobytes())
        return digest.hexdigest()

    def save(self, path: Path) -> None:
        """Write one NetCDF-4 file; raises InputError if the place cannot be written."""
        import xarray as xr

        numbers = {**vars(self), "hyper": self.hyperparameters}
        data = {name: (dims, numbers[name]) for name, dims in DIMS.items()}
        coordinates = {"axis": np.array(self.AXES, dtype=object), "place": self.PLACES}
        words = {key: json.dumps(getattr(self, key)) for key in ("model_error", "provenance")}
        attrs = {"terraphi_file": KIND, "terraphi_schema": SCHEMA, "error_scale": self.error_scale}
        packed = {"force": {"zlib": True, "dtype": "float32"}}
        write_netcdf(xr.Dataset(data, coordinates, attrs | words), path, encoding=packed)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what :meth:`save` wrote; raises InputError if it is not whole, or of another law."""
        with open_netcdf(path, LawAttributes, kind=KIND, schema=SCHEMA) as file:
            axes, places = file.texts("axis", "axis"), file.numbers("place", "place")
            if axes != cls.AXES:
                raise ValueError(f"it is over {', '.join(axes)}, not {', '.join(cls.AXES)}")
            if not np.array_equal(places, cls.PLACES):
                raise ValueError("its places are those of another version")
            shapes = DIMS | {"hyper": cls.HYPER}
            numbers: dict[str, Any] = {n: file.numbers(n, *dims) for n, dims in shapes.items()}
            return cls(**numbers, **dict(file.attrs))
