"""Tables of forces: the unusable refused with place and remedy, the origin of ours kept."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terraphi.experiment.errors import InputError
from terraphi.experiment.force_table import column_names, read_force_table
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, open_forces
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate

HEADER = "theta_deg,Fx_N,Fz_N\n"
NINE = "".join(f"{theta},1.0,2.0\n" for theta in range(-80, 81, 20))


def refusal(tmp_path: Path, content: str | bytes) -> str:
    """The sentence with which a table is refused, after the file's name."""
    file = tmp_path / "forces.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        read_force_table(file)
    message = str(caught.value)
    assert message.startswith(str(file))
    assert "\n" not in message
    assert message.isprintable()
    assert len(message) < 400
    return message.removeprefix(str(file))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", ["empty", "theta_deg,Fx_N,Fz_N"]),
        (HEADER + "-80,1_000,2\n", ["line 2", "Fx_N = '1_000' is not a number"]),
        (HEADER + "-80,\uff11,2\n", ["line 2", "Fx_N = '\uff11' is not a number"]),
        ("# ours\n" + HEADER + "-80,1,2\n# no\n-60,x,2\n", ["line 5", "Fx_N = 'x'"]),
        ("# theta_deg,Fx_N,Fz_N\n-80,1,2\n", ["line 2", "in a comment: remove its '#'"]),
        ("theta_deg;Fx_N;Fz_N\n1,5;2,0;3,0\n", ["line 1", "semicolons", "commas are expected"]),
        ("theta_deg\tFx_N\tFz_N\n", ["line 1", "tabs"]),
        (" \n\n", ["empty"]),
        (HEADER, ["no numbers under the header"]),
        ("theta_deg,Fx_N\n1,2\n", ["line 1", "'Fz_N' is missing", "theta_deg,Fx_N,Fz_N"]),
        ("theta_deg,Fx_N,FzN\n1,2,3\n", ["line 1", "'FzN'", "did you mean 'Fz_N'?"]),
        ("theta,Fx_N,Fz_N\n1,2,3\n", ["line 1", "'theta'", "did you mean 'theta_deg'?"]),
        (
            "theta_deg,Fx_N,Fz_N,Fy_N\n1,2,3,4\n",
            ["line 1", "column 'Fy_N'", "remove it"],
        ),
        ("theta_deg,Fx_N,Fx_N,Fz_N\n1,2,3,4\n", ["line 1", "'Fx_N' stands twice"]),
        (NINE, ["line 1", "write theta_deg,Fx_N,Fz_N", "as the line above"]),
        (HEADER + "-80,1,2\n\n-60,abc,2\n", ["line 4", "Fx_N = 'abc'", "not a number"]),
        (HEADER + "-80,1,2\n-60,,2\n", ["line 3", "Fx_N = ''", "not a number"]),
        (HEADER + "-80,1,nan\n", ["line 2", "Fz_N = nan", "not finite", "remove"]),
        (HEADER + "-80,-inf,1\n", ["line 2", "Fx_N = -inf", "not finite"]),
        (HEADER + "-80,1e999,1\n", ["line 2", "Fx_N = inf", "not finite"]),
        (
            HEADER + "-80,1,nan\n\n-79,1,1\n-78,nan,1\n",
            ["lines 2, 5: 2 rows", "not finite", "the first Fz_N = nan; remove them"],
        ),
        (
            HEADER + "".join(f"{theta},1,nan\n" for theta in range(-80, 80)),
            ["lines 2, 3, 4, 5, 6 and 155 more: 160 rows have numbers that are not finite"],
        ),
        (HEADER + "-80,1,2\n-60,1\n", ["line 3", "2 cells", "theta_deg,Fx_N,Fz_N"]),
        (HEADER + "-80,1,2,3\n", ["line 2", "4 cells"]),
        (HEADER + '-80,"1,2\n-60,1,2\n', ["not a row of a CSV"]),
        (HEADER + '-80,"' + "1" * 200_000 + '",2\n', ["line 2", "not a row of a CSV"]),
        (HEADER + "-80," + "x" * 5000 + ",2\n", ["line 2", "Fx_N = 'xxx", "not a number"]),
        (
            HEADER + "-80,1,2\n-60,1,2\n-70,1,2\n0,1,2\n",
            ["line 4", "theta_deg = -70 falls below the value before (-60)", "sort"],
        ),
        (
            HEADER + "-80,1,2\n-60,1,2\n-60,1,2\n",
            ["line 4", "theta_deg = -60 repeats", "average repeats"],
        ),
        (HEADER + "80,1,2\n0,1,2\n-80,1,2\n", ["theta_deg decreases", "sort"]),
        (HEADER + "-1.48,1,2\n0,1,2\n1.48,1,2\n", ["1.48", "radians", "degrees are expected"]),
        (",,\n,,\n", ["the file is empty", "theta_deg,Fx_N,Fz_N"]),
        ("\n \n" + HEADER.replace("Fx_N", "F_N") + "-80,1,2\n", ["line 3", "'F_N'"]),
        (b"\x89HDF\r\n\x1a\n" + bytes(range(256)), ["not a text file", "UTF-8"]),
        (bytes(range(1, 32)) * 40, ["line 1", "unexpected column"]),
        (b"\x00" * 4096, ["line 1", "unexpected column"]),
    ],
)
def test_unusable_tables(tmp_path: Path, content: str | bytes, said: list[str]) -> None:
    message = refusal(tmp_path, content)
    for part in said:
        assert part in message


@settings(max_examples=50, deadline=None)
@given(garbage=st.binary(max_size=300))
def test_garbage_is_refused_and_never_a_surprise(
    tmp_path_factory: pytest.TempPathFactory, garbage: bytes
) -> None:
    refusal(tmp_path_factory.getbasetemp(), garbage)


def test_missing_tables(tmp_path: Path) -> None:
    for place, said in ((tmp_path / "absent.csv", "no such file"), (tmp_path, "is a folder")):
        with pytest.raises(InputError, match=said):
            read_force_table(place)


def test_columns_come_in_any_order_with_quotes_spaces_and_a_byte_order_mark(
    tmp_path: Path,
) -> None:
    file = tmp_path / "x.csv"
    file.write_bytes(b'\xef\xbb\xbf"Fz_N", theta_deg ,"Fx_N"\r\n3,-10,"2"\r\n\r\n 5 ,+1e1, 4 \r\n')
    assert read_force_table(file).values.tolist() == [[-10.0, 2.0, 3.0], [10.0, 4.0, 5.0]]
    file.write_text("\n,,\ntheta_deg,Fx_N,Fz_N\n-10,2,3\n10,4,5\n")
    assert read_force_table(file).values.tolist() == [[-10.0, 2.0, 3.0], [10.0, 4.0, 5.0]]


# -- where forces come from ----------------------------------------------------------------------


def simulated(friction_angle_deg: float = 31.0) -> ForceHistory:
    scenario = {
        "model": "rft", "dimensions": 3, "rft": {"panels": 10}, "leg": {"shape": "c"},
        "soil": {"friction_angle_deg": friction_angle_deg, "density": 1500.0},
    }  # fmt: skip
    return simulate(Scenario.model_validate(scenario))


def test_a_simulation_keeps_its_origin_through_a_csv(tmp_path: Path) -> None:
    made, file = simulated(), tmp_path / "s.csv"
    made.to_csv(file)
    assert column_names(file) == ["theta_deg", "Fx_N", "Fz_N"]
    found = open_forces(file)
    assert found.history.provenance == {**made.provenance, "file": "s.csv"}
    assert (found.leg, found.density_kg_m3, found.medium) == ("c", 1500.0, "simulated (rft)")
    # And once more, the very same.
    found.history.to_csv(tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_bytes() == file.read_bytes()


def test_a_shipped_record_keeps_its_leg_and_density_through_a_csv(tmp_path: Path) -> None:
    shipped = measurement("li2013:poppy_loose/c")
    shipped.history.to_csv(tmp_path / "p.csv")
    found = open_forces(tmp_path / "p.csv")
    assert (found.leg, found.density_kg_m3, found.source) == ("c", 638.0, shipped.source)
    assert found.name == str(tmp_path / "p.csv")


def test_other_readers_skip_the_comment(tmp_path: Path) -> None:
    file = tmp_path / "s.csv"
    made = simulated()
    made.to_csv(file)
    names = ["theta_deg", "Fx_N", "Fz_N"]
    assert file.read_text().splitlines()[1] == ",".join(names)
    table = pd.read_csv(file, comment="#")
    assert table.columns.tolist() == names
    assert table["Fz_N"].to_numpy() == pytest.approx(made.Fz, rel=5e-6)
    named = np.genfromtxt(file, delimiter=",", names=True, skip_header=1)
    assert named["Fz_N"].tolist() == table["Fz_N"].tolist()
    plain = np.genfromtxt(file, delimiter=",")  # the names' line is one without numbers
    assert plain[1:, 2].tolist() == table["Fz_N"].tolist()


CHANGES = {
    "a force": lambda text: text.rstrip() + "1\n",
    "the scenario": lambda text: text.replace("1500.0", "1600.0"),
    "its end": lambda text: text.replace("}\n", "\n", 1),
    "its schema": lambda text: text.replace('"schema": 1', '"schema": 2'),
    "all of it": lambda text: text.replace('{"schema"', '[["schema"', 1),
    "nested": lambda text: text.replace('{"schema"', "[" * 100_000, 1),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_was_changed_by_hand_counts_as_measured(
    change: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "s.csv"
    simulated().to_csv(file)
    text = file.read_text()
    file.write_text(CHANGES[change](text))
    assert file.read_text() != text
    with caplog.at_level(logging.WARNING):
        found = open_forces(file)
    assert found.history.provenance == {"file": "s.csv"}
    assert (found.leg, found.density_kg_m3) == ("straight", None)
    (said,) = caplog.messages
    assert said.startswith(
        f"{file}, line 1: the comment on where these forces come from is ignored"
    )
    assert "\n" not in said


def test_a_comment_by_other_hands_is_a_comment(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "x.csv"
    file.write_text('# "my\n #leg, {}\n' + HEADER + "# half way\n" + NINE)
    found = read_force_table(file)
    assert found.values[:, 0].tolist() == list(range(-80, 81, 20))
    assert found.provenance == {}
    assert caplog.messages == []
    assert column_names(file) == ["theta_deg", "Fx_N", "Fz_N"]


def test_an_origin_of_another_version_ends_in_a_sentence(tmp_path: Path) -> None:
    made = simulated()
    old = {**made.provenance, "scenario": {"soil": {"wetness": 3}}}
    ForceHistory(made.position, made.force, provenance=old).to_csv(tmp_path / "s.csv")
    with pytest.raises(InputError, match=r"s\.csv, scenario: .*wetness.*; remove that comment"):
        open_forces(tmp_path / "s.csv")


# -- quickly, and from anywhere ------------------------------------------------------------------


@settings(max_examples=200, deadline=None)
@given(
    cells=st.lists(
        st.text("0123456789+-.eE_ \t#,naif\uff11\u00a0", max_size=6), min_size=3, max_size=3
    )
)
def test_all_at_once_takes_what_row_by_row_takes(
    tmp_path_factory: pytest.TempPathFactory, cells: list[str]
) -> None:
    """The quick way and the one that says what is wrong agree on every row."""
    file = tmp_path_factory.getbasetemp() / "either.csv"

    def outcome(end: str) -> list[list[float]] | str:
        file.write_text(HEADER + "-80,1,2\n" + ",".join(cells) + "\n" + end)
        try:
            return [row for row in read_force_table(file).values.tolist() if row[0] != 170.0]
        except InputError as error:
            return str(error)

    # A quoted number makes the quick way give up.
    quick, slow = outcome(""), outcome('170,"1",2\n')
    assert quick == slow or "theta_deg" in str(slow)


def test_a_pipe_is_read_like_a_file(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=lambda: pipe.write_text(HEADER + NINE))
    writer.start()
    found = open_forces(pipe).history
    writer.join()
    assert found.theta_deg == pytest.approx(np.arange(-80.0, 81.0, 20.0))


@pytest.mark.slow
def test_a_million_rows_fit_into_little_memory(tmp_path: Path) -> None:
    theta = np.linspace(-135.0, 135.0, 1_000_000)
    table = np.stack([theta, np.sin(theta), np.cos(theta)], axis=1)
    np.savetxt(tmp_path / "m.csv", table, "%.9g", ",", header=HEADER.strip(), comments="")
    code = (
        "import resource, sys; from terraphi.experiment.history import ForceHistory; "
        "read = ForceHistory.from_csv(sys.argv[1]); assert len(read.position) == 1_000_000; "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "m.csv")], capture_output=True, check=True
    )
    assert int(done.stdout) < 400_000  # kB
