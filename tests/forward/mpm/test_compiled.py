"""The cache of machine code is dropped when, and only when, a kernel's source has changed."""

from __future__ import annotations

import os
import subprocess
import sys
import tokenize

import numba
import pytest

from terraphi.forward.mpm import compiled


@pytest.fixture(name="sources")
def _sources(tmp_path, monkeypatch):
    inner = tmp_path / "forward" / "mpm"
    inner.mkdir(parents=True)
    files = [inner / "scalar.py", inner / "contact.py", tmp_path / "leg.py"]
    for number, file in enumerate(files):
        file.write_text(f"value = {number}\n")
    monkeypatch.setattr(compiled, "_FOLDER", inner)
    monkeypatch.setattr(compiled, "_SOURCES", files)
    return files


def fill_caches(sources):
    made = []
    for folder in {source.parent for source in sources}:
        cache = folder / "__pycache__"
        cache.mkdir(exist_ok=True)
        for name in ("step.py311.nbi", "step.py311.1.nbc", "other.cpython-311.pyc"):
            (cache / name).write_bytes(b"x")
            made.append(cache / name)
    return made


def compiled_code(files):
    return [file for file in files if file.suffix in (".nbi", ".nbc")]


def test_cache_of_unknown_origin_is_dropped(sources):
    made = fill_caches(sources)
    compiled._drop_stale_cache()
    assert not any(file.exists() for file in compiled_code(made))


def test_cache_is_kept_while_the_sources_stay(sources):
    compiled._drop_stale_cache()
    made = fill_caches(sources)
    compiled._drop_stale_cache()
    assert all(file.exists() for file in made)


@pytest.mark.parametrize("changed", [0, 1, 2])
def test_change_in_any_source_drops_all_compiled_code_and_nothing_else(sources, changed):
    compiled._drop_stale_cache()
    made = fill_caches(sources)
    sources[changed].write_text("value = 99\n")
    compiled._drop_stale_cache()
    code = compiled_code(made)
    assert not any(file.exists() for file in code)
    assert all(file.exists() for file in made if file not in code)
    # And the new stamp holds.
    again = fill_caches(sources)
    compiled._drop_stale_cache()
    assert all(file.exists() for file in again)


def test_another_numba_drops_the_cache(sources, monkeypatch):
    compiled._drop_stale_cache()
    made = fill_caches(sources)
    monkeypatch.setattr(compiled.numba, "__version__", "0.0.1")
    compiled._drop_stale_cache()
    assert not any(file.exists() for file in compiled_code(made))


def test_folder_that_cannot_hold_a_cache_is_no_error(sources):
    (sources[0].parent / "__pycache__").write_text("a file where the folder would be")
    compiled._drop_stale_cache()


def test_every_compiled_source_is_watched():
    folder = compiled._FOLDER
    assert set(folder.glob("*.py")) < set(compiled._SOURCES)
    assert folder.parents[1] / "experiment" / "leg.py" in compiled._SOURCES
    assert all(source.is_file() for source in compiled._SOURCES)


def test_what_bits_rest_on_is_code_and_not_words_about_it(tmp_path):
    file = tmp_path / "one.py"

    def code(text: str) -> str:
        file.write_text(text)
        return compiled._code_of(file)

    plain = code("def f(x):\n    return 2 * x\n")
    assert plain == code(
        '"""What."""\n\n\ndef f(x):  # so\n    """Double."""\n\n    return 2 * x\n'
    )
    assert plain != code("def f(x):\n    return 3 * x\n")
    assert plain != code('def f(x):\n    return "2" * x\n')
    # A string that is a value is code.
    assert code("a = 'one'\n") != code("a = 'two'\n")


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
    found = []
    for number, code in enumerate((run, first + run)):
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(sys.path),
            "NUMBA_CACHE_DIR": str(tmp_path / str(number)),
        }
        command = [sys.executable, "-c", code]
        found.append(subprocess.run(command, env=environment, capture_output=True, check=True))
    assert found[0].stdout == found[1].stdout


def test_options_keep_numbers_that_are_not_numbers():
    @compiled.kernel
    def inside(low: float, value: float, high: float) -> bool:
        return low < value < high

    assert not inside(0.0, float("nan"), 1.0)


def test_folder_that_the_user_chose_for_the_cache_is_looked_after_as_well(
    sources, tmp_path, monkeypatch
):
    """Named as Numba names it, which another process shows."""
    chosen = tmp_path / "chosen"
    sources[0].write_text(
        "import numba\n\n@numba.njit(cache=True)\ndef twice(x):\n    return 2 * x\n\ntwice(1.0)\n"
    )
    subprocess.run(
        [sys.executable, "-c", "import scalar"],
        cwd=sources[0].parent,
        env={**os.environ, "NUMBA_CACHE_DIR": str(chosen)},
        check=True,
    )
    made = [*chosen.rglob("*.nbi"), *chosen.rglob("*.nbc")]
    assert made
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(chosen))
    compiled._drop_stale_cache()
    assert not any(file.exists() for file in made)


LAW = '''"""A law."""

from a import MU


def law(x):
    """Return it."""
    return MU * x  # by Coulomb
'''
STEP = """
from a.law import law


def step(x):
    return x - law(x)
"""


def digest_of(folder, **sources):
    folder.mkdir()
    for name, text in sources.items():
        (folder / f"{name}.py").write_text(text)
    return compiled._digest_of_model(folder.glob("*.py"))


def test_code_that_moves_to_another_file_keeps_its_digest(tmp_path):
    before = digest_of(tmp_path / "a", law=LAW, step=STEP)
    moved = STEP.replace("a.law", "b.friction")
    assert digest_of(tmp_path / "b", friction=LAW, whole=moved) == before
    assert digest_of(tmp_path / "c", one=LAW + STEP) == before


def test_code_that_does_something_else_has_another_digest(tmp_path):
    before = digest_of(tmp_path / "a", law=LAW, step=STEP)
    assert digest_of(tmp_path / "b", law=LAW.replace("MU * x", "x * MU"), step=STEP) != before
    assert digest_of(tmp_path / "c", law=LAW) != before
