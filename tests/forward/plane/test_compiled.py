"""Machine code is served to those sources alone of which it was made."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import textwrap

import pytest

from terraphi.forward import compiled

SOURCE = "from inner import factor\nfrom compiled import entry\n\n\n@entry\ndef times(x):\n"
FACTOR = "from compiled import kernel\n\n\n@kernel\ndef factor(x):\n    return {} * x\n"


@pytest.fixture(name="python")
def _python(tmp_path):
    """Runs code next to the sources of a small model: ``times``, which inlines ``factor``."""
    folder = tmp_path / "forward"
    (tmp_path / "experiment").mkdir()
    folder.mkdir()
    shutil.copy(compiled.__file__, folder)
    for name in ("leg", "motion", "scenario", "soil"):
        (tmp_path / "experiment" / f"{name}.py").touch()
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
    assert python(PRINT) == ["3.0", "1"]
    inner = FACTOR.format("2.0")
    assert python(f"inner.write_text({inner!r}); {PRINT}") == ["2.0", "1"]


def test_every_compiled_source_is_watched():
    folder = compiled._FOLDER
    for inner in (folder, folder / "plane", folder / "mpm"):
        assert set(inner.glob("*.py")) < set(compiled._SOURCES)
    assert folder.parent / "experiment" / "leg.py" in compiled._SOURCES
    assert all(source.is_file() for source in compiled._SOURCES)


def test_no_power_in_a_kernel():
    """Numba would compile it once for all, with the options of whoever asked first."""
    for source in compiled._SOURCES:
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and node.decorator_list:
                powers = [
                    n.lineno for n in ast.walk(node) if isinstance(getattr(n, "op", None), ast.Pow)
                ]
                assert powers == [], f"{source.name}, {node.name}: {powers}"
