"""The names that `terraphi` itself has."""

from __future__ import annotations

from types import ModuleType

import pytest

import terraphi


@pytest.mark.parametrize("name", terraphi.__all__)
def test_public_name_stays_what_it_is(name: str) -> None:
    first = getattr(terraphi, name)
    assert callable(first)
    assert not isinstance(first, ModuleType)
    assert getattr(terraphi, name) is first


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        _ = terraphi.nonsense
