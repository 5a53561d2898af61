"""Documents that people write: the sentence for what is wrong with them, and shipped files."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import pytest
from pydantic import Field

from terraphi.experiment.documents import Strict, parse_toml
from terraphi.experiment.errors import InputError, nearest


class Wheel(Strict):
    radius_mm: float = Field(gt=0)
    tread: Literal["smooth", "lugged"] = "smooth"


class Rover(Strict):
    wheels: list[Wheel] = Field(default_factory=list)
    spare: Wheel | None = None
    size: tuple[float, float] = (1.0, 1.0)


@pytest.mark.parametrize(
    ("word", "choices", "hint"),
    [
        ("YUMA", ["mojave", "yuma"], "did you mean 'yuma'?"),
        ("curved", ["straight", "c", "reversed_c"], "known: c, reversed_c, straight"),
        ("qqq", [], "known: none"),
    ],
)
def test_nearest(word: str, choices: list[str], hint: str) -> None:
    assert nearest(word, choices) == hint


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("weels = []", "unknown key 'weels'; did you mean 'wheels'?"),
        ("[[wheels]]\nradius = 3", "unknown key 'wheels.0.radius'; did you mean 'radius_mm'?"),
        ("[spare]\nradius_mm = -3", "spare.radius_mm = -3: should be greater than 0"),
        ("[spare]\ntread = 'lugged'", "key 'spare.radius_mm' is missing"),
        (
            "[spare]\nradius_mm = 1\ntread = 'luged'",
            "spare.tread = 'luged': should be 'smooth' or 'lugged'; did you mean 'lugged'?",
        ),
        ("[wheels]", "[wheels] is one table and there may be several: write [[wheels]]"),
        ("size = 1\nsize rft", "not valid TOML: Expected '=' after a key in a key/value pair (at"),
    ],
)
def test_what_is_wrong_is_named_in_one_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    file = tmp_path / "rover.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        parse_toml(file, Rover)
    assert str(caught.value).startswith(f"{file}: {sentence}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content", [bytes(range(128, 256)), b"a = " + b"[" * 50_000, b"a = " + b"9" * 5_000]
)
def test_files_that_are_no_documents(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "x.toml"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"x\.toml: not (a text file|valid TOML)"):
        parse_toml(file, Rover)


def test_a_byte_order_mark_and_arrays_for_tuples_are_read(tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    file.write_bytes(b"\xef\xbb\xbfsize = [2, 3.5]\r\n")
    assert parse_toml(file, Rover).size == (2.0, 3.5)
