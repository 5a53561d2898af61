"""Many records: a row each, whatever is wrong with some of them."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pandas as pd
import pytest

from terraphi.experiment.measurements import measurement
from terraphi.inference.inversion import invert
from terraphi.inference.many import COLUMNS, records_in
from terraphi.library.store import Library

QUICKLY = ("--library", "rft3d", "--likelihood", "paper")


@pytest.fixture
def records(tmp_path) -> Path:
    """A folder of two records that can be inverted and two that cannot."""
    place = tmp_path / "records"
    place.mkdir()
    for name in ("yuma/straight", "poppy_loose/c"):
        file = place / f"{name.replace('/', '-')}.csv"
        measurement(f"li2013:{name}").history.to_csv(file)
    (place / "cut.csv").write_text("theta_deg,Fx_N,Fz_N\n0,1\n")
    (place / "other.nc").write_bytes(b"nothing")
    (place / "notes.txt").write_text("not a record")
    return place


def test_a_row_each_and_a_reason_for_what_failed(terraphi, records, tmp_path) -> None:
    ran = terraphi("invert", "records", "--table", "a.csv", *QUICKLY)
    assert ran.status == 0, ran.err
    assert "4 records:" in ran.out
    assert "failed 2" in ran.out
    table = pd.read_csv(tmp_path / "a.csv").set_index("source")
    assert tuple(table.reset_index().columns) == COLUMNS
    assert len(table) == 4
    cut = table.loc["records/cut.csv"]
    assert "records/cut.csv, line 2" in cut["error"]
    assert pd.isna(cut["phi_deg"])
    one = table.loc["records/poppy_loose-c.csv"]
    alone = invert(measurement("li2013:poppy_loose/c").history, library=Library.load("rft3d"),
                   leg="c", density=one["density_kg_m3"], likelihood="paper")  # fmt: skip
    # A CSV has six digits of the forces.
    assert one["phi_deg"] == pytest.approx(alone.phi.median, abs=1e-3)
    assert one["verdict"] == alone.verdict.verdict
    assert one["leg"] == "c"
    # The same table may be written again, another not.
    glob = terraphi("invert", "records/*.csv", "--table", "a.csv", *QUICKLY, "--json")
    assert json.loads(glob.out)["records"] == 3


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("records", "--table", "a.txt"), "a .csv or .parquet file"),
        (("records", "--table", "mine.csv"), "no table that terraphi wrote"),
        (("records", "--table", "a.csv", "--out", "b"), "not with --out"),
        (("records/*.tsv", "--table", "a.csv"), "no records"),
        (("records/cut.csv", "--table", "a.csv"), "none of 1 records could be inverted"),
        (("records",), "is a folder"),
    ],
)
def test_what_makes_no_table(terraphi, records, tmp_path, args, words) -> None:
    (tmp_path / "mine.csv").write_text("x,y\n1,2\n")
    ran = terraphi("invert", *args, "--library", "rft3d")
    assert (ran.status, ran.out) == (2, "")
    assert words in ran.err
    assert ran.err.count("\n") == 1
    assert not (tmp_path / "a.csv").exists()


def test_parquet_says_what_it_needs(terraphi, records, tmp_path, monkeypatch) -> None:
    args = ("invert", "records", "--table", "a.parquet", *QUICKLY)
    find = importlib.util.find_spec
    with monkeypatch.context() as without:
        hidden = lambda name, *rest: None if name == "pyarrow" else find(name, *rest)  # noqa: E731
        without.setattr(importlib.util, "find_spec", hidden)
        assert "terraphi[parquet]" in terraphi(*args).err
    pytest.importorskip("pyarrow")
    for _ in range(2):
        assert terraphi(*args).status == 0
    assert pd.read_parquet(tmp_path / "a.parquet")["error"].str.len().gt(0).sum() == 2


def test_a_table_among_the_records_is_none_of_them(records) -> None:
    before = records_in([str(records)])
    (records / "answers.csv").write_text(",".join(COLUMNS) + "\n")
    assert records_in([str(records)]) == before
    assert not any("answers" in name for name in records_in([f"{records}/*.csv"]))


def test_a_table_of_angles_that_are_fixed_is_refused_as_what_it_is(terraphi) -> None:
    fixed = ("--prior", "friction_angle_deg=30", "--prior", "density=1500:1700")
    options = ("--table", "a.csv", "--library", "rft3d", *fixed)
    ran = terraphi("invert", "li2013:yuma/straight", *options)
    assert ran.status == 2
    assert "prior 'friction_angle_deg=30' fixes φ" in ran.err


def test_a_folder_has_its_records_whatever_the_case_of_their_suffix(tmp_path) -> None:
    for name in ("A.CSV", "b.csv", "c.NC", "d.txt"):
        (tmp_path / name).write_text("")
    found = [Path(name).name for name in records_in([str(tmp_path)])]
    assert found == ["A.CSV", "b.csv", "c.NC"]
