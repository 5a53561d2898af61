"""Many records, each inverted by itself: a table with a row a record."""

from __future__ import annotations

import glob
import importlib.util
import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import replacing, writable
from terraphi.experiment.measurements import open_forces
from terraphi.inference.answer import PHI, Inversion
from terraphi.inference.inversion import invert
from terraphi.inference.prior import Marginal, is_on, parsed
from terraphi.inference.trials import Trial
from terraphi.library.store import Library

if TYPE_CHECKING:
    from pandas import DataFrame

log = logging.getLogger(__name__)

RECORDS = (".csv", ".nc")
"""Suffixes of the records in a folder."""
COLUMNS = (
    "source", "leg", "leg_assumed", "phi_deg", "phi_sd_deg", "phi_ci68_low_deg",
    "phi_ci68_high_deg",
    "phi_ci95_low_deg", "phi_ci95_high_deg", "yield", "phi_plane_strain_deg",
    "phi_plane_strain_ci95_low_deg", "phi_plane_strain_ci95_high_deg", "verdict", "reason", "edge",
    "nrmsd_Fx", "nrmsd_Fz", "density_kg_m3", "density_assumed", "library", "likelihood", "seconds",
    "error",
)  # fmt: skip
"""Of the table; those of an answer are missing where ``error`` says why there is none."""


def invert_many(
    sources: Sequence[str | Path],
    *,
    library: Library | None = None,
    leg: str | None = None,
    progress: Callable[[float, float], None] = lambda _done, _all: None,
    **options: Any,
) -> DataFrame:
    """Invert records one by one; one that cannot be inverted is a row with the reason.

    Parameters
    ----------
    sources
        As in :func:`~terraphi.experiment.measurements.open_forces`.
    library
        Simulations over φ; ``None``: of each record the one that :func:`invert` takes for it.
    leg
        Shape of the leg of all of them; ``None``: as measured, else straight.
    progress
        Called with the records done and all of them.
    options
        As in :func:`~terraphi.inference.inversion.invert`.

    Returns
    -------
    pandas.DataFrame
        With :data:`COLUMNS`, in the order of the sources.

    Raises
    ------
    InputError
        If there are no sources, a prior fixes φ, or none of them can be inverted: with the reason
        of the first.
    """
    import pandas as pd

    for text in options.get("prior", ()):
        if is_on(text, PHI) and parsed(text, text.partition("=")[2], Marginal(0.0, 90.0)).fixed:
            raise InputError(
                f"prior '{text}' fixes φ; a table is of friction angles that are inferred"
            )
    rows = []
    for done, source in enumerate(sources):
        progress(done, len(sources))
        began = time.perf_counter()
        try:
            trial = Trial.of(open_forces(source), leg)
            row = _row(invert(trial, library=library, **options))
        except InputError as error:
            row = {"error": str(error)}
        except Exception as error:
            # One odd file must not cost the answers of a thousand others.
            log.info("%s:", source, exc_info=True)
            row = {"error": f"an error of terraphi itself ({type(error).__name__}: {error})"}
        rows.append({**row, "source": str(source), "seconds": time.perf_counter() - began})
    progress(len(sources), len(sources))
    failed = [row["error"] for row in rows if row.get("error")]
    if len(failed) == len(rows):
        first = f"; the first: {failed[0]}" if failed else ""
        raise InputError(f"none of {len(rows)} records could be inverted{first}")
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _row(found: Inversion) -> dict[str, Any]:
    """The answer's numbers, by column; InputError if φ is none of them."""
    if PHI not in found.keys:
        raise InputError("the library's φ does not vary; a table is of friction angles")
    phi, plane, record = found.phi, found.phi_plane_strain, found.record
    told: dict[str, Any] = {
        "leg": record.leg,
        "leg_assumed": record.leg_assumed,
        "phi_deg": phi.median,
        "phi_sd_deg": found.marginal["soil.friction_angle_deg"].sd,
        "yield": found.convention,
        "verdict": found.verdict.verdict,
        "reason": found.reason,
        "edge": found.verdict.edge,
        "nrmsd_Fx": record.nrmsd["Fx"],
        "nrmsd_Fz": record.nrmsd["Fz"],
        "density_kg_m3": found.density,
        "density_assumed": found.density_assumed,
        "library": found.library,
        "likelihood": found.likelihood,
        "error": "",
    }
    spans = {"phi_ci68": phi.ci68, "phi_ci95": phi.ci95}
    if plane is not None:
        told["phi_plane_strain_deg"] = plane.median
        spans["phi_plane_strain_ci95"] = plane.ci95
    for name, (low, high) in spans.items():
        told |= {f"{name}_low_deg": low, f"{name}_high_deg": high}
    return told


def records_in(places: Sequence[str]) -> list[str]:
    """Records that folders and patterns stand for, sorted; names of other things as they are.

    A table of answers that lies among them is none.

    Raises
    ------
    InputError
        If a folder or a pattern has no records.
    """
    found: list[str] = []
    for place in places:
        if Path(place).is_dir():
            files = [str(f) for f in Path(place).iterdir() if f.suffix.lower() in RECORDS]
        elif glob.has_magic(place) and not Path(place).exists():
            files = glob.glob(place)  # noqa: PTH207 - absolute patterns too
        else:
            found.append(place)
            continue
        inside = sorted(file for file in files if not _is_table(file))
        if not inside:
            raise InputError(f"{place}: no records (.csv or .nc) there")
        found += inside
    return list(dict.fromkeys(found))


def _is_table(name: str) -> bool:
    """Whether a file is a table of answers, such as an earlier run wrote beside the records."""
    path = Path(name)
    return path.suffix == ".csv" and path.is_file() and _columns_of(path) == COLUMNS


def check_table(path: Path) -> None:
    """Raise InputError before any work if a table cannot be written, or is somebody else's."""
    if path.suffix not in (".csv", ".parquet"):
        raise InputError(f"{path}: a table is a .csv or .parquet file")
    if path.suffix == ".parquet" and importlib.util.find_spec("pyarrow") is None:
        raise InputError(
            f"{path}: Parquet needs pyarrow, which is not installed; pip install "
            "'terraphi[parquet]', or name a .csv file"
        )
    writable(path)
    if path.is_file() and path.stat().st_size and _columns_of(path) != COLUMNS:
        raise InputError(
            f"{path}: is there, and no table that terraphi wrote; name another file, or move that "
            "one away"
        )


def _columns_of(path: Path) -> tuple[str, ...]:
    import pandas as pd

    try:
        if path.suffix == ".csv":
            return tuple(pd.read_csv(path, nrows=0).columns)
        import pyarrow.parquet as parquet

        return tuple(parquet.read_schema(path).names)
    except (OSError, ValueError):  # no table at all
        return ()


def write_table(table: DataFrame, path: Path) -> None:
    """Write a table as the suffix says, whole or not at all."""
    with replacing(path) as temporary:
        if path.suffix == ".csv":
            table.to_csv(temporary, index=False)
        else:
            table.to_parquet(temporary, engine="pyarrow", index=False)
