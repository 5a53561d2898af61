"""Forces on a leg as a CSV with the columns ``theta_deg,Fx_N,Fz_N``.

Lines that begin with ``#`` are comments. In one of them, before the names of the columns, a history
of ours keeps its origin: pandas skips it with ``comment="#"``, numpy.genfromtxt with
``skip_header=1``.
"""

from __future__ import annotations

import csv
import hashlib
import json
import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.files import atomic_write

log = logging.getLogger(__name__)

CSV_COLUMNS = ("theta_deg", "Fx_N", "Fz_N")
MARK = "# terraphi force history "
"""Beginning of our comment line; JSON follows on the same line."""
SCHEMA = 1
"""Version of what our comment holds."""


def write_force_table(path: Path, values: FloatArray, provenance: Mapping[str, Any]) -> None:
    """Write a CSV, with its provenance in a comment if there is any.

    Parameters
    ----------
    path
        The file to make or replace.
    values
        Columns θ [deg], Fx [N], Fz [N], shape [row, 3].
    provenance
        JSON-able.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    provenance = json.loads(json.dumps(dict(provenance)))  # as it will be read
    # Twelve digits keep neighboring angles apart and hide the round-off of radians.
    rows = [(f"{t:.12g}", f"{x:.6g}", f"{z:.6g}") for t, x, z in values.tolist()]
    with (
        atomic_write(path) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as stream,
    ):
        if provenance:
            digest = _digest(np.array(rows, dtype=np.float64), provenance)
            content = {"schema": SCHEMA, "digest": digest, "provenance": provenance}
            stream.write(f"{MARK}{json.dumps(content)}\n")
        csv.writer(stream, lineterminator="\n").writerows([CSV_COLUMNS, *rows])


def origin(path: Path, comments: Iterable[str], values: FloatArray) -> dict[str, Any]:
    """Provenance in our comment, if there is one.

    Empty, with a warning in the log, if comment or numbers were changed since.

    Parameters
    ----------
    path
        The file, for the warning.
    comments
        Its lines of comment.
    values
        As in :func:`write_force_table`, as read.
    """
    ours = [line.removeprefix(MARK) for line in comments if line.startswith(MARK)]
    if not ours:
        return {}
    try:
        content = json.loads(ours[0])
        provenance = dict(content["provenance"])
        if content["schema"] == SCHEMA and content["digest"] == _digest(values, provenance):
            return provenance
    except (KeyError, RecursionError, TypeError, ValueError):
        pass
    log.warning("%s: the comment on the origin of these forces does not fit them; ignored", path)
    return {}


def _digest(values: FloatArray, provenance: Mapping[str, Any]) -> str:
    """SHA-256 of numbers and their provenance, hexadecimal."""
    content = json.dumps(provenance, sort_keys=True).encode()
    return hashlib.sha256(content + np.ascontiguousarray(values, "<f8").tobytes()).hexdigest()
