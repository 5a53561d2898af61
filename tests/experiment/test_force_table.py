"""Tables of forces: the unusable refused with place and remedy, the origin of ours kept."""

from __future__ import annotations

import logging
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, open_forces
from terraphi.experiment.reading import read_forces
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate

HEADER = "theta_deg,Fx_N,Fz_N\n"
NINE = "".join(f"{theta},1.0,2.0\n" for theta in range(-80, 81, 20))


def refusal(tmp_path: Path, content: str | bytes) -> str:
    """The sentence with which a table is refused, after the file's name."""
    file = tmp_path / "forces.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        read_forces(file)
    message = str(caught.value)
    assert message.startswith(str(file))
    assert message.isprintable()
    assert len(message) < 400
    return message.removeprefix(str(file))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", ["empty"]),
        (HEADER, ["no numbers under the header"]),
        (NINE, ["no column of theta", "theta=column 1,fx=column 2"]),
        ("# ours\n" + HEADER + "-80,1,2\n# no\n-60,x,2\n", ["line 5", "Fx_N = 'x'"]),
        (HEADER + "-80,\uff11,2\n", ["line 2", "Fx_N = '\uff11' is not a number"]),
        (HEADER + "-80,1e999,1\n", ["no row has"]),
        (HEADER + "-80,1,2\n-60,1,2,3\n" * 2 + "1,2,3\n" * 200, ["line 3"]),
        (HEADER + "-1.48,1,2\n0,1,2\n1.48,1,2\n", ["1.48", "write rad in place of deg"]),
        (b"\x89HDF\r\n\x1a\n" + bytes(range(256)), ["not a text file", "UTF-8"]),
    ],
)
def test_unusable_tables(tmp_path: Path, content: str | bytes, words: list[str]) -> None:
    message = refusal(tmp_path, content)
    for part in words:
        assert part in message


@settings(max_examples=50, deadline=None)
@given(garbage=st.binary(max_size=300))
def test_garbage_is_refused_in_a_sentence(
    tmp_path_factory: pytest.TempPathFactory, garbage: bytes
) -> None:
    refusal(tmp_path_factory.getbasetemp(), garbage)


def test_columns_come_in_any_order_with_quotes_spaces_and_a_byte_order_mark(
    tmp_path: Path,
) -> None:
    file = tmp_path / "x.csv"
    for content in (
        b'\xef\xbb\xbf"Fz_N", theta_deg ,"Fx_N"\r\n3,-10,"2"\r\n\r\n 5 ,+1e1, 4 \r\n',
        f'# "my\n #leg, {{}}\n\n,,\n{HEADER}# half way\n-10,2,3\n10,4,5\n'.encode(),
    ):
        file.write_bytes(content)
        history = read_forces(file)
        assert history.theta_deg == pytest.approx([-10.0, 10.0])
        assert history.force.tolist() == [[2.0, 3.0], [4.0, 5.0]]


# -- where forces come from ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def made() -> ForceHistory:
    scenario = {
        "model": "rft", "dimensions": 3, "rft": {"panels": 10}, "leg": {"shape": "c"},
        "soil": {"density": 1500.0},
    }  # fmt: skip
    return simulate(Scenario.model_validate(scenario))


def test_a_simulation_keeps_its_origin_through_a_csv(made: ForceHistory, tmp_path: Path) -> None:
    file = tmp_path / "s.csv"
    made.to_csv(file)
    [result] = open_forces(file)
    assert result.history.provenance == {**made.provenance, "file": "s.csv"}
    assert (result.rig.leg, result.density_kg_m3, result.medium) == ("c", 1500.0, "simulated (rft)")
    result.history.to_csv(tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_bytes() == file.read_bytes()
    table = pd.read_csv(file, comment="#")
    assert table["Fz_N"].to_numpy() == pytest.approx(made.Fz, rel=5e-6)


def test_a_shipped_record_keeps_its_leg_and_density_through_a_csv(tmp_path: Path) -> None:
    shipped = measurement("li2013:poppy_loose/c")
    shipped.history.to_csv(tmp_path / "p.csv")
    [result] = open_forces(tmp_path / "p.csv")
    assert (result.rig.leg, result.density_kg_m3, result.source) == ("c", 638.0, shipped.source)


@pytest.mark.parametrize(
    ("old", "new"), [("\n-134.95,", "\n-134.96,"), ("1500.0", "1600.0"), ('{"schema"', "[" * 9999)]
)
def test_what_was_changed_by_hand_counts_as_measured(
    made: ForceHistory, old: str, new: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "s.csv"
    made.to_csv(file)
    file.write_text(file.read_text().replace(old, new, 1))
    with caplog.at_level(logging.WARNING):
        [result] = open_forces(file)
    assert result.history.provenance == {"file": "s.csv"}
    assert (result.rig, result.density_kg_m3) == (None, None)
    assert "s.csv: the comment on the origin of these forces does not fit" in caplog.text


def test_an_origin_of_another_version_ends_in_a_sentence(
    made: ForceHistory, tmp_path: Path
) -> None:
    old = {**made.provenance, "scenario": {"soil": {"wetness": 3}}}
    ForceHistory(made.position, made.force, provenance=old).to_csv(tmp_path / "s.csv")
    with pytest.raises(InputError, match=r"s\.csv, scenario: .*wetness.*; simulate it again"):
        open_forces(tmp_path / "s.csv")
