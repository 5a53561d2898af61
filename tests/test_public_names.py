"""The names that `terraphi` itself has."""

from __future__ import annotations

import subprocess
import sys
from types import ModuleType

import pytest

import terraphi


@pytest.mark.parametrize("name", terraphi.__all__)
def test_public_name_stays_what_it_is(name: str) -> None:
    first = getattr(terraphi, name)
    assert callable(first)
    assert not isinstance(first, ModuleType)
    assert getattr(terraphi, name) is first


@pytest.mark.parametrize(
    "line",
    [
        "from terraphi.build import build as function",
        "import terraphi.build",
        "from terraphi import simulate",
    ],
)
def test_a_module_does_not_hide_the_function_of_its_name(line: str) -> None:
    code = f"{line}\nimport terraphi\nprint(type(terraphi.build).__name__, terraphi.plan.__name__)"
    code = code.replace("import terraphi\n", "import terraphi, terraphi.plan\n")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["function", "terraphi.plan"]


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        _ = terraphi.nonsense
