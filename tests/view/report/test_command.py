"""The command."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from terraphi.cli.report import report
from terraphi.experiment.errors import InputError


@pytest.mark.parametrize("name", ["x.pdf", "x", "x.md"])
def test_a_page_is_written_under_no_other_suffix(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"name it \.html, and print it .* PDF"):
        CliRunner().invoke(report, ["rft3d", "--out", str(tmp_path / name)], catch_exceptions=False)
    assert not list(tmp_path.iterdir())


def test_htm_will_do(tmp_path: Path) -> None:
    done = CliRunner().invoke(report, ["rft3d", "--out", str(tmp_path / "x.HTM")])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "x.HTM").stat().st_size > 1000
