"""Machine code is served to those sources alone of which it was made."""

from __future__ import annotations

import importlib
import os
import re
import shutil
import subprocess
import sys
import textwrap
import time
import tokenize

import numba
import pytest

from terraphi.forward import compiled


@pytest.fixture(name="sources")
def _sources(tmp_path, monkeypatch):
    inner = tmp_path / "forward" / "mpm"
    inner.mkdir(parents=True)
    files = [inner / "scalar.py", inner / "contact.py", tmp_path / "leg.py"]
    for number, file in enumerate(files):
        file.write_text(f"value = {number}\n")
    monkeypatch.setattr(compiled, "_FOLDER", inner)
    monkeypatch.setattr(compiled, "_SOURCES", files)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "own"))
    return files


def test_the_place_of_machine_code_is_that_of_the_sources(sources, monkeypatch):
    place = compiled._place_of_cache()
    assert place.parent == sources[0].parent / "__pycache__"
    assert compiled._place_of_cache() == place
    result = {place}
    for source in sources:
        source.write_text("value = 99\n")
        result.add(compiled._place_of_cache())
    monkeypatch.setattr(compiled.numba, "__version__", "0.0.1")
    result.add(compiled._place_of_cache())
    assert len(result) == 5
    assert all(each.is_dir() for each in result)


def test_sources_that_cannot_have_a_cache_beside_them_have_it_elsewhere(sources, monkeypatch):
    (sources[0].parent / "__pycache__").write_text("a file where the folder would be")
    reference = sources[2].parent / "own"
    assert compiled._place_of_cache().parent == reference / "terraphi"
    (reference / "terraphi").rename(reference / "away")
    (reference / "terraphi").write_text("here too")
    assert compiled._place_of_cache() is None
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(reference / "chosen"))
    assert compiled._place_of_cache().parent == reference / "chosen"


def test_machine_code_of_other_sources_goes_when_nobody_has_used_it_for_long(sources):
    parent = sources[0].parent / "__pycache__"
    kept = []
    for name, days in (("of-another-version", 1.0), ("of-long-ago", 30.0)):
        folder = parent / (compiled._NAME + name) / "mpm_1"
        folder.mkdir(parents=True)
        for file in ("step.py311.nbi", "step.py311.1.nbc"):
            (folder / file).write_bytes(b"x")
        used = time.time() - 86400.0 * days
        os.utime(folder.parent, (used, used))
        kept.append(folder)
    (parent / "scalar.cpython-311.pyc").write_bytes(b"x")
    place = compiled._place_of_cache()
    assert kept[0].is_dir()
    names = {"scalar.cpython-311.pyc", kept[0].parent.name, place.name}
    assert {entry.name for entry in parent.iterdir()} == names


SOURCE = "from inner import factor\nfrom compiled import entry\n\n\n@entry\ndef times(x):\n"
FACTOR = "from compiled import kernel\n\n\n@kernel\ndef factor(x):\n    return {} * x\n"


@pytest.fixture(name="python")
def _python(tmp_path):
    """Runs code beside sources of a small model of its own: ``times``, which inlines ``factor``."""
    folder = tmp_path / "forward" / "mpm"
    (tmp_path / "forward" / "experiment").mkdir(parents=True)
    folder.mkdir()
    shutil.copy(compiled.__file__, folder)
    for name in ("arrays", "leg", "motion", "scenario", "soil", "units"):
        (tmp_path / "forward" / "experiment" / f"{name}.py").touch()
    (folder / "outer.py").write_text(SOURCE + "    return factor(x)\n")
    (folder / "inner.py").write_text(FACTOR.format("2.0"))
    kept = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    environment = {**kept, "PYTHONPATH": os.pathsep.join(sys.path)}

    def run(code):
        head = (
            f"import pathlib, subprocess, sys\ninner = pathlib.Path({str(folder)!r}, 'inner.py')\n"
        )
        command = [sys.executable, "-c", head + textwrap.dedent(code)]
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, check=True, text=True
        )
        return done.stdout.split()

    return run


PRINT = "import outer; print(outer.times(1.0), sum(outer.times.stats.cache_hits.values()))"


def test_code_that_is_compiled_after_its_source_has_changed_is_not_served(python):
    """Another process has started in between, and one more starts after."""
    assert python(PRINT) == ["2.0", "0"]
    python(f"""
        import outer
        inner.write_text({FACTOR.format("3.0")!r})
        subprocess.run([sys.executable, "-c", "import outer"], check=True)
        outer.times(1)
    """)
    assert python("import outer; print(outer.times(1))") == ["3.0"]
    assert python(PRINT) == ["3.0", "0"]
    inner = FACTOR.format("2.0")
    assert python(f"inner.write_text({inner!r}); {PRINT}") == ["2.0", "1"]


def test_a_process_that_reads_changed_sources_keeps_nothing(python):
    changed, first = FACTOR.format("3.0"), FACTOR.format("2.0")
    assert python(f"import compiled; inner.write_text({changed!r}); {PRINT}") == ["3.0", "0"]
    assert python(f"inner.write_text({first!r}); {PRINT}") == ["2.0", "0"]


def test_a_module_that_is_not_as_written_is_seen(tmp_path, monkeypatch):
    file = tmp_path / "shape_of_a_test.py"
    file.write_text("def area(x):\n    return 2.0 * x\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    module = importlib.import_module("shape_of_a_test")
    assert compiled._is_as_written(module)
    file.write_text("def area(x):\n    return 3.0 * x\n")
    assert not compiled._is_as_written(module)


def test_every_compiled_source_is_watched():
    """And all that stands in its folder, for kernels inline what they import from there."""
    sources = {file: file.read_text() for file in compiled._FOLDER.parent.rglob("*.py")}
    marked = [f for f, text in sources.items() if re.search("^@(kernel|entry)$", text, re.M)]
    assert {file.parent.name for file in marked} == {"forward", "mpm", "plane"}
    beside = {other for file in marked for other in file.parent.rglob("*.py")}
    assert beside | {*compiled._INLINED} == set(compiled._SOURCES)


def test_no_power_in_a_kernel():
    """Numba would compile it once for all, with the options of whoever asked first."""
    for source in compiled._SOURCES:
        if "@kernel" in source.read_text() or "@entry" in source.read_text():
            with source.open("rb") as stream:
                powers = [t.start for t in tokenize.tokenize(stream.readline) if t.string == "**"]
            # Keywords handed on are powers to the tokenizer as well; kernels know none.
            assert powers == [], f"{source.name}: {powers}"


def test_bits_do_not_depend_on_what_was_compiled_before(tmp_path):
    """A power compiled without our options first, as any other user of Numba may do."""
    first = "import numba; numba.njit(lambda x: x**2, error_model='numpy')(1.5); "
    run = (
        "import numpy as np; from terraphi.forward.mpm import transfer; "
        "x = np.random.default_rng(1).uniform(0.5, 1.5, 50); "
        "print([[w.hex() for w in transfer.weights(float(v))] for v in x])"
    )
    result = []
    for number, code in enumerate((run, first + run)):
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(sys.path),
            "NUMBA_CACHE_DIR": str(tmp_path / str(number)),
        }
        command = [sys.executable, "-c", code]
        result.append(subprocess.run(command, env=environment, capture_output=True, check=True))
    assert result[0].stdout == result[1].stdout


def test_options_keep_numbers_that_are_not_numbers():
    @compiled.kernel
    def inside(low: float, value: float, high: float) -> bool:
        return low < value < high

    assert not inside(0.0, float("nan"), 1.0)
