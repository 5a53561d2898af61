"""Answers as files have them: their strict reader, and an answer without its curves."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, Json, model_validator

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import strictly
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import NetcdfFile, open_netcdf, read_bytes
from terraphi.inference.answer import (
    Answer,
    AnswerSummary,
    Name,
    RecordFit,
    RecordSummary,
    endings,
)

RENAMED = {"questions": "warnings", "library": "law", "library_reason": "law_reason"}
"""Keys of version 0.3, and what they are called since."""


class Opinion(BaseModel, strict=True):
    """φ by another law [deg]."""

    law: Name
    median: float
    sd: float
    force_size_deg: float | None = None


class StoredAngle(BaseModel, strict=True):
    """A friction angle [deg] in some convention."""

    median: float
    sd: float = Field(0.0, ge=0.0)
    ci68: tuple[float, float]
    ci95: tuple[float, float]
    convention: str = Field("", alias="yield")

    @model_validator(mode="after")
    def _ordered(self) -> StoredAngle:
        (low68, high68), (low95, high95) = self.ci68, self.ci95
        if not 0.0 < low95 <= low68 <= self.median <= high68 <= high95 < 90.0:
            raise ValueError("ci95, ci68 and median do not lie within each other, in 0 to 90 deg")
        return self


@dataclass(frozen=True, eq=False, kw_only=True)
class Stored(AnswerSummary):
    """What :meth:`Answer.as_dict` wrote, as far as it is read back."""

    phi_deg: StoredAngle | None
    phi_plane_strain_deg: StoredAngle | None
    records: list[RecordSummary] = field(default_factory=list)
    second_opinion: Annotated[
        Mapping[str, Any], AfterValidator(lambda given: Opinion.model_validate(given).model_dump())
    ] | None = None  # fmt: skip


class AnswerAttributes(BaseModel):
    """Attributes of an answer's file."""

    answer: Json[Stored]


def read_answer(path: Path) -> Answer:
    """Read the NetCDF of :meth:`Answer.to_netcdf`; raises InputError if it is not whole."""
    with open_netcdf(path, AnswerAttributes, kind=Answer.KIND, schema=None) as file:
        return _answer_of(file)


def _answer_of(file: NetcdfFile[AnswerAttributes]) -> Answer:
    """The answer in an open file; raises ValueError if it has no records or no posterior."""
    stated, at, size = file.attrs.answer, "constant_data/", 0
    records: list[RecordFit] = []
    for record, end in zip(stated.records, endings(stated.records), strict=True):
        dims = len(record.nrmsd), f"{record.coordinate}{end}"
        fit = RecordFit(
            **vars(record),
            theta_deg=file.numbers(f"observed_data/{dims[1]}", dims[1]),
            data=file.numbers(f"observed_data/force{end}", *dims),
            curve=file.numbers(f"{at}curve{end}", *dims),
            band=file.numbers(f"{at}band{end}", 2, *dims),
            tangent=file.numbers(f"{at}tangent{end}", 2, *dims),
            measured=file.numbers(f"{at}measured{end}", 4, dims[1], finite=False)
            if f"{at}measured{end}" in file.variables
            else None,
        )
        records.append(fit)
        size += fit.data.size
    grid, density = (file.numbers(at + name, "grid") for name in ("grid_deg", "density"))
    if not (records and records[0].theta_deg.size and density.sum() > 0.0 and stated.phi_deg):
        raise ValueError("no records, or no posterior")
    return Answer(
        convention=stated.phi_deg.convention,
        records=tuple(records),
        grid_deg=grid,
        density=density,
        covariance=file.numbers(f"{at}covariance", size, size),
        **{part.name: getattr(stated, part.name) for part in fields(AnswerSummary)},
    )


class StoredAnswer(NamedTuple):
    """What a file or folder says about an inversion."""

    source: str
    """Its name."""
    answer: dict[str, Any]
    """As :meth:`Answer.as_dict` has it."""
    draws_deg: FloatArray
    """Draws of φ in the answer's convention [deg], shape [draw]; empty if the file has none."""

    @classmethod
    def of(cls, answer: Any) -> StoredAnswer:
        """An answer without its curves, from memory or from a file.

        Parameters
        ----------
        answer
            An answer; the folder of ``terraphi invert --out``, its ``answer.nc``, or the output of
            ``--json`` (``-``: standard input), which has no draws.

        Raises
        ------
        InputError
            If it is missing, damaged or no answer.
        """
        if isinstance(answer, StoredAnswer):
            return answer
        source = ""
        if isinstance(answer, str | Path):
            source = str(answer)
            if not (Path(answer).is_dir() or source.endswith(".nc")):
                text = read_bytes(Path(answer))
                if not text.lstrip().startswith(b"{"):
                    raise InputError(f"{source}: no answer; give the folder of 'invert --out'")
                strictly(text, Stored, source)
                stored = json.loads(text)
                written = {RENAMED.get(key, key): value for key, value in stored.items()}
                is_old = written.keys() != stored.keys()
                old = ["The answer is of version 0.3: invert again."] * is_old
                written["warnings"] = [*written.get("warnings", ()), *old]
                return cls(source, written, np.zeros(0))
            answer = Answer.load(answer)
        if not isinstance(answer, Answer):
            kind = type(answer).__name__
            raise InputError(f"answer of type {kind}; give an Answer, or its folder or file")
        return cls(source or answer.source, answer.as_dict(), answer.phi_draws())
