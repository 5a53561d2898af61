"""What people are told about a word or a document that cannot be used."""

from __future__ import annotations

from typing import Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from terraphi.experiment.errors import InputError, nearest, sentence_from_validation


class Wheel(BaseModel):
    model_config = ConfigDict(extra="forbid")

    radius_mm: float = Field(gt=0)
    tread: Literal["smooth", "lugged"] = "smooth"


class Rover(BaseModel):
    model_config = ConfigDict(extra="forbid")

    wheels: list[Wheel] = []
    spare: Wheel | None = None


def sentence(content: object) -> str:
    with pytest.raises(ValidationError) as caught:
        Rover.model_validate(content)
    return sentence_from_validation(caught.value, "rover.toml", Rover)


@pytest.mark.parametrize(
    ("word", "choices", "hint"),
    [
        ("yumma", ["mojave", "yuma"], "did you mean 'yuma'?"),
        ("YUMA", ["mojave", "yuma"], "did you mean 'yuma'?"),
        ("curved", ["straight", "c", "reversed_c"], "known: c, reversed_c, straight"),
        ("fz_n", ["theta_deg", "Fx_N", "Fz_N"], "did you mean 'Fz_N'?"),
        ("FX", ["theta_deg", "Fx_N", "Fz_N"], "did you mean 'Fx_N'?"),
        ("qqq", ["mojave", "yuma"], "known: mojave, yuma"),
        ("qqq", [], "known: none"),
        ("", ["b", "a"], "known: a, b"),
        ("sand3d-quick", ["sand3d", "sand3d-friction"], "did you mean 'sand3d'?"),
        ("paper-coed", ["paper", "paper-code"], "did you mean 'paper-code'?"),
        ("-x", ["", "y"], "known: , y"),
    ],
)
def test_nearest(word: str, choices: list[str], hint: str) -> None:
    assert nearest(word, choices) == hint


def test_unknown_keys_are_named_with_the_nearest_at_their_own_place() -> None:
    assert sentence({"weels": []}) == "rover.toml: unknown key 'weels'; did you mean 'wheels'?"
    found = sentence({"wheels": [{"radius": 3}]})
    assert found == "rover.toml: unknown key 'wheels.0.radius'; did you mean 'radius_mm'?"
    found = sentence({"spare": {"radius_mm": 3, "thread": "smooth"}})
    assert found == "rover.toml: unknown key 'spare.thread'; did you mean 'tread'?"


def test_values_are_named_with_what_is_right() -> None:
    found = sentence({"spare": {"radius_mm": -3}})
    assert found == "rover.toml: spare.radius_mm = -3: should be greater than 0"
    assert sentence({"spare": {}}) == "rover.toml: key 'spare.radius_mm' is missing"
    found = sentence({"spare": {"radius_mm": 1, "tread": "luged"}})
    assert found == (
        "rover.toml: spare.tread = 'luged': should be 'smooth' or 'lugged'; did you mean 'lugged'?"
    )
    found = sentence({"spare": {"radius_mm": 1, "tread": "xyz"}})
    assert found == "rover.toml: spare.tread = 'xyz': should be 'smooth' or 'lugged'"


def test_an_input_error_is_a_value_error() -> None:
    assert issubclass(InputError, ValueError)
