"""Results: one writer, one strict reader and one display, by declared variables."""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np

from terraphi.experiment.files import NetcdfFile, open_netcdf, write_netcdf

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from pydantic import BaseModel

MOST_LINES = 5
"""Lines of a result at a prompt, at most."""
PACKED = {"zlib": True, "shuffle": True, "dtype": "float32"}
"""Encoding of variables that are stored in single precision."""


class Variable(NamedTuple):
    """A variable of a result and of its file."""

    name: str
    """Name in the file."""
    dims: str
    """Names of its dimensions, with spaces between."""
    unit: str = ""
    text: str = ""
    """What it is; the attribute ``long_name``."""
    field: str = ""
    """Attribute of the result that holds it; by default that of its name."""
    column: int | None = None
    """Column of that attribute, if it has several variables."""
    words: bool = False
    """True for text; other variables are numbers."""
    holes: bool = False
    """True if values may be not a number, or infinite; else a file with such values is refused."""
    optional: bool = False
    """True if a file may lack it; the result then has ``None``."""
    coordinate: bool = False
    packed: bool = False
    derived: bool = False
    """True if it is computed from the others, and not read."""

    def of(self, result: Any) -> Any:
        """Its values in a result."""
        values = getattr(result, self.field or self.name)
        return values if self.column is None else values[..., self.column]


def dataset_of(variables: Iterable[Variable], values: Mapping[str, Any]) -> xr.Dataset:
    """Dataset of those variables that have values, with their units and ``long_name``.

    Parameters
    ----------
    variables
        What is declared.
    values
        Arrays, or sequences of text, by the names of variables.
    """
    import xarray as xr

    data: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    for variable in variables:
        if values.get(variable.name) is None:
            continue
        array = np.asarray(values[variable.name], str if variable.words else None)
        stated = {"units": variable.unit, "long_name": variable.text}
        stated = {key: text for key, text in stated.items() if text}
        encoding = PACKED if variable.packed else None
        part = coordinates if variable.coordinate else data
        part[variable.name] = (variable.dims.split(), array, stated, encoding)
    return xr.Dataset(data, coordinates)


def read(file: NetcdfFile[Any], variables: Iterable[Variable]) -> dict[str, Any]:
    """Values by field, of several variables as columns; ``None`` where an optional one is missing.

    Raises ValueError if a variable is missing, of another type or shape, or not finite.
    """
    fields: dict[str, list[Any]] = {}
    for variable in variables:
        name, dims, values = variable.name, variable.dims.split(), None
        if variable.derived:
            continue
        if name in file.variables or not variable.optional:
            values = (
                file.texts(name, *dims)
                if variable.words
                else file.numbers(name, *dims, finite=not variable.holes)
            )
        fields.setdefault(variable.field or name, []).append(values)
    return {name: np.column_stack(v) if len(v) > 1 else v[0] for name, v in fields.items()}


class Shown:
    """Base of what shows itself at a prompt and in a notebook, without arrays."""

    def _lines(self) -> list[str]:
        """Lines for a prompt, without arrays; the first one names the result."""
        raise NotImplementedError

    def _table(self) -> pd.DataFrame | None:
        """Table that a notebook shows below the lines, if there is one."""
        return None

    def __repr__(self) -> str:
        """A few lines for a prompt."""
        return "\n".join(self._lines()[:MOST_LINES])

    def _repr_html_(self) -> str:
        """The same for a notebook, with a table."""
        table = self._table()
        rows = "" if table is None else table.to_html(max_rows=10, float_format="{:.4g}".format)
        return f"<pre>{html.escape(repr(self))}</pre>{rows}"


class Written(Shown):
    """Base of results with files: from declared variables to NetCDF."""

    KIND: ClassVar[str]
    """Attribute ``terraphi_file`` of the file."""
    SCHEMA: ClassVar[int | None] = None
    """Version of its layout."""
    ATTRIBUTES: ClassVar[type[BaseModel]]
    """Attributes of the file, each a field or property of the result."""
    VARIABLES: ClassVar[tuple[Variable, ...]] = ()
    REMEDY: ClassVar[str] = ""
    """What to do with a file of another kind, after a semicolon."""

    def _variables(self) -> dict[str, Any]:
        """Values of the declared variables, by name."""
        return {variable.name: variable.of(self) for variable in self.VARIABLES}

    def _attributes(self) -> dict[str, Any]:
        """Attributes of the file: numbers and words as they are, everything else as JSON."""
        stated: dict[str, Any] = {"terraphi_file": self.KIND, "terraphi_schema": self.SCHEMA}
        for name, info in self.ATTRIBUTES.model_fields.items():
            value = getattr(self, name)
            value = value() if callable(value) else value
            plain = isinstance(value, str | float)
            stated[info.alias or name] = value if plain else json.dumps(value, default=dict)
        return stated

    def to_xarray(self) -> xr.Dataset:
        """Variables as a Dataset, with units, as in the NetCDF."""
        return dataset_of(self.VARIABLES, self._variables())

    def to_netcdf(self, path: Path | str) -> None:
        """Write a self-describing NetCDF-4; raises InputError if the place cannot be written."""
        write_netcdf(self.to_xarray().assign_attrs(self._attributes()), Path(path))

    def _frame(self, dims: str) -> pd.DataFrame:
        """Table of the variables of some dimensions, a column each."""
        import pandas as pd

        return pd.DataFrame({v.name: v.of(self) for v in self.VARIABLES if v.dims == dims})

    @classmethod
    def opened(cls, path: Path | str) -> AbstractContextManager[NetcdfFile[Any]]:
        """Variables and attributes of a file, as of ``open_netcdf``."""
        return open_netcdf(
            Path(path), cls.ATTRIBUTES, kind=cls.KIND, schema=cls.SCHEMA, remedy=cls.REMEDY
        )


class Result(Written):
    """Base of results that are read back from their files."""

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a NetCDF of :meth:`to_netcdf`; raises InputError if it is not whole."""
        with cls.opened(path) as file:
            return cls._of_file(file)

    @classmethod
    def _of_file(cls, file: NetcdfFile[Any]) -> Self:
        """A result from the variables and attributes of a file; raises ValueError."""
        return cls(**read(file, cls.VARIABLES), **dict(file.attrs))
