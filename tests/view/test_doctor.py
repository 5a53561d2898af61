"""What ``terraphi doctor`` finds, in a sound installation and in broken ones."""

from __future__ import annotations

import importlib.metadata
import json
import re
import shutil
import sys
from pathlib import Path

import numba
import pytest

from terraphi.experiment import documents
from terraphi.experiment.documents import DATA, shipped_names
from terraphi.view import doctor


def found() -> dict[str, doctor.Check]:
    """What is said of packages and machine; the shipped files, which take long, are left out."""
    parts = (doctor._software(), doctor._machine(), doctor._kernels())
    return {check.name: check for part in parts for check in part}


def test_this_installation_is_sound(terraphi) -> None:
    status, out, _ = terraphi("doctor", "--json")
    answer = json.loads(out)
    assert status == 0
    assert answer["sound"] is True
    checks = {check["name"]: check["found"] for check in answer["checks"]}
    assert checks["numba"] == numba.__version__
    for name in shipped_names("libraries", ".nc"):
        assert "cases" in checks[f"library {name}"]
    assert checks["vectors"].split()[0] in {"512", "256", "128"}


@pytest.mark.parametrize(("bits", "state"), [(512, "ok"), (256, "note"), (128, "note")])
def test_narrow_vectors_are_told_with_what_they_cost(bits: int, state: str, monkeypatch) -> None:
    monkeypatch.setattr("terraphi.forward.plane.packing.register_bits", lambda: bits)
    check = found()["vectors"]
    assert check.state == state
    assert check.found.startswith(f"{bits} bits, {bits // 64} doubles at a time")
    if state == "note":
        factor = float(re.search(r"about ([\d.]+) times as long", check.found)[1])
        # Half or a quarter of the doubles at a time, and less of the rest of a step.
        assert 1.0 < factor < 512 / bits


def test_people_are_told_in_words(terraphi) -> None:
    status, out, _ = terraphi("doctor")
    assert status == 0
    assert "All is well." in out
    assert "cores" in out


@pytest.fixture
def own_libraries(tmp_path, monkeypatch) -> Path:
    """A copy of the shipped libraries, to break."""
    place = tmp_path / "terraphi" / "data"
    shutil.copytree(DATA / "libraries", place / "libraries")
    for kind in ("scenarios", "plans", "li2013"):
        (place / kind).symlink_to(DATA / kind)
    monkeypatch.setattr(documents, "DATA", place)
    return place / "libraries"


def test_a_library_cut_short_is_a_problem(own_libraries, terraphi) -> None:
    file = own_libraries / "rft3d.nc"
    whole = file.read_bytes()
    file.unlink()
    file.write_bytes(whole[: len(whole) // 2])
    status, out, _ = terraphi("doctor", "--json")
    checks = {check["name"]: check for check in json.loads(out)["checks"]}
    assert status == 1
    assert checks["library rft3d"]["state"] == "problem"
    assert checks["library quick-paper"]["state"] == "ok"


def test_no_library_at_all_is_a_problem(own_libraries, terraphi) -> None:
    for file in own_libraries.glob("*.nc"):
        file.unlink()
    status, out, _ = terraphi("doctor")
    assert status == 1
    assert "Problems: 1." in out


def versions(monkeypatch, changed: dict[str, str | None]) -> None:
    """Pretend that some packages have another version, or none."""
    real = importlib.metadata.version

    def version(name: str) -> str:
        if name not in changed:
            return real(name)
        if changed[name] is None:
            raise importlib.metadata.PackageNotFoundError(name)
        return str(changed[name])

    monkeypatch.setattr(importlib.metadata, "version", version)


def test_a_package_that_is_too_old_is_a_problem(monkeypatch) -> None:
    versions(monkeypatch, {"xarray": "2024.1.0"})
    check = found()["xarray"]
    assert check.state == "problem"
    assert "2024.1.0" in check.found
    assert ">=2025.10" in check.found


def test_a_missing_package_is_a_problem_and_a_missing_extra_is_none(monkeypatch) -> None:
    versions(monkeypatch, {"emcee": None, "mcap": None, "sphinx": None})
    checks = found()
    assert checks["emcee"].state == "problem"
    assert checks["extra 'robot'"].state == "note"
    assert "mcap" in checks["extra 'robot'"].found
    assert not any("sphinx" in check.found for check in checks.values())


def test_a_compiler_that_fails_is_a_problem(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "terraphi.forward.checkpoint", None)
    check = found()["kernels"]
    assert check.state == "problem"
