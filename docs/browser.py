"""What the page try.md loads: the package in an archive, with its laws as arrays of NumPy."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np

import terraphi
from terraphi.experiment import files

LAW = "laws/legs.nc"
"""File that an inversion by law ``legs`` reads; HDF5 is not needed for arrays."""


def write(path: Path) -> None:
    """Write the ZIP archive out of which ``_static/try.py`` inverts."""
    folder, version = Path(terraphi.__file__).parent, terraphi.__version__
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for one in sorted(folder.rglob("*")):
            if one.suffix in (".csv", ".py", ".pyi", ".toml"):
                archive.write(one, one.relative_to(folder.parent))
        attributes, arrays = files._read(folder / "data" / LAW)
        arrays = {n: a.astype(str) if a.dtype.kind == "O" else a for n, a in arrays.items()}
        plain = {n: a.item() if isinstance(a, np.generic) else a for n, a in attributes.items()}
        content = io.BytesIO()
        np.savez_compressed(content, attributes=json.dumps(plain), **arrays)
        archive.writestr(f"terraphi/data/{LAW}", content.getvalue())
        metadata = f"Metadata-Version: 2.1\nName: terraphi\nVersion: {version}\n"
        archive.writestr(f"terraphi-{version}.dist-info/METADATA", metadata)
