"""Inverts a table in the browser: run by Pyodide, on the page try.md.

The shipped laws lie in terraphi.zip as arrays of NumPy under the names of their NetCDF files, so
that no HDF5 has to be loaded. Everything else is the package as it is installed.
"""

import json
from pathlib import Path

import numpy as np

import terraphi
from terraphi.experiment import files
from terraphi.view.answers import in_words

ATTRIBUTES = "attributes"
"""Name of the array that holds the attributes of a file as JSON."""


def read(path):
    """Attributes and variables, as of a NetCDF file."""
    with np.load(path) as arrays:
        found = {n: a.astype(object) if a.dtype.kind == "U" else a for n, a in arrays.items()}
    return json.loads(str(found.pop(ATTRIBUTES))), found


files._read = read
files.netcdf_kind = lambda path: str(read(path)[0]["terraphi_file"])


def example():
    """A shipped record: the C leg in Yuma sand."""
    measured = Path(terraphi.__file__).parent / "data" / "li2013" / "yuma-c.csv"
    return measured.read_text(encoding="utf-8")


def invert(name, content, options):
    """Invert a file of some bytes.

    Parameters
    ----------
    name
        Its name, for messages.
    content
        Its bytes.
    options
        Arguments of ``terraphi.invert`` as JSON.

    Returns
    -------
    str
        JSON: ``text`` as ``terraphi invert`` prints it, all warnings included, and ``answer`` as
        ``--json`` has it; or ``error``.
    """
    path = Path(Path(name).name or "forces.csv")
    path.write_bytes(bytes(content))
    try:
        answer = terraphi.invert(str(path), **json.loads(options))
    except terraphi.InputError as error:
        return json.dumps({"error": str(error)})
    finally:
        path.unlink()
    text = "\n".join(in_words(answer))
    return json.dumps({"text": text, "answer": answer.as_dict()}, default=str)
