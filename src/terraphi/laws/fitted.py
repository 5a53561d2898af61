"""A law that was fitted from simulations, of legs or of feet: what it is made of, and its file."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import BaseModel, Field, Json

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.files import NetcdfFile
from terraphi.experiment.results import Result, Variable, read

KIND = "law"


class LawAttributes(BaseModel):
    """Attributes of the file."""

    error_scale: float = Field(1.0, ge=1.0)
    model_error: Json[dict[str, dict[str, Any]]] = {}
    provenance: Json[dict[str, Any]] = {}


@dataclass(frozen=True, eq=False, repr=False)
class FittedLaw(Result):
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
        Numbers of the process between the cases, shape [1, number]; none of a table.
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

    KIND = KIND
    SCHEMA = 3
    ATTRIBUTES = LawAttributes
    VARIABLES = (
        Variable("axis", "axis", field="AXES", words=True, coordinate=True),
        Variable("place", "place", field="PLACES", coordinate=True),
        Variable("x", "case axis"),
        Variable("depth", "case"),
        Variable("force", "case channel place", packed=True),
        Variable("hyper", "process number"),
    )

    x: FloatArray
    depth: FloatArray
    force: FloatArray
    hyper: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    error_scale: float = 1.0
    model_error: dict[str, dict[str, Any]] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of all that changes an answer, hexadecimal: as precise as a file keeps it."""
        words = json.dumps([self.AXES, self.model_error], sort_keys=True)
        result = hashlib.sha256(words.encode())
        for array in (self.x, self.depth, self.PLACES, self.force, self.hyper, self.error_scale):
            result.update(np.asarray(array, np.float32).tobytes())
        return result.hexdigest()

    save = Result.to_netcdf

    @classmethod
    def _of_file(cls, file: NetcdfFile[LawAttributes]) -> Self:
        """A law; raises ValueError if the file is of another law."""
        numbers = read(file, cls.VARIABLES)
        axes, places = numbers.pop("AXES"), numbers.pop("PLACES")
        if axes != cls.AXES:
            raise ValueError(f"it is over {', '.join(axes)}, not {', '.join(cls.AXES)}")
        if not np.array_equal(places, cls.PLACES):
            raise ValueError("its places are those of another version")
        numbers["hyper"] = file.numbers("hyper", *cls.HYPER)
        return cls(**numbers, **dict(file.attrs))

    def _lines(self) -> list[str]:
        cases = f"{len(self.depth)} cases over {', '.join(self.AXES)}"
        return [f"{type(self).__name__}: {cases}", f"hash {self.hash[:12]}"]
