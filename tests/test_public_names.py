"""The names that `terraphi` itself has."""

from __future__ import annotations

import pytest

import terraphi


@pytest.mark.parametrize("name", terraphi.__all__)
def test_public_name_can_be_imported(name: str) -> None:
    assert callable(getattr(terraphi, name))


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        _ = terraphi.nonsense
