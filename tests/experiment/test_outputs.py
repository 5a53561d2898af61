"""Folders of results are whole, and nothing of other origin is written over or removed."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.outputs import (
    MANIFEST,
    SIGNATURE,
    changed,
    check_file,
    check_folder,
    output_folder,
)


def fill(place: Path, **content: str) -> None:
    with output_folder(place, kind="test", last="z.txt") as made:
        for name, text in content.items():
            (made / f"{name}.txt").write_text(text)


def contents(place: Path) -> dict[str, str]:
    files = (path for path in place.iterdir() if path.is_file())
    return {path.name: path.read_text() for path in files if path.name != MANIFEST}


def test_results_replace_earlier_ones_and_nothing_else(tmp_path: Path) -> None:
    place = tmp_path / "new" / "folder"
    fill(place, a="1", z="2")
    (place / "mine.md").write_text("a note")
    fill(place, b="3", z="4")
    assert contents(place) == {"a.txt": "1", "b.txt": "3", "z.txt": "4", "mine.md": "a note"}
    (place / "c.txt").write_text("mine")
    with pytest.raises(InputError, match=r"holds 'c\.txt', not written by terraphi"):
        fill(place, a="5", c="6")
    with pytest.raises(InputError, match=r"holds results of 'test'"):
        check_folder(place, kind="another")
    assert contents(place)["c.txt"] == "mine"
    assert [path.name for path in place.parent.iterdir()] == ["folder"]


@pytest.mark.parametrize("before", [{}, {"a": "1", "z": "2"}])
def test_what_fails_leaves_things_as_they_were(tmp_path: Path, before: dict[str, str]) -> None:
    place = tmp_path / "o"
    if before:
        fill(place, **before)

    def write() -> None:
        with output_folder(place, kind="test", last="z.txt") as made:
            (made / "a.txt").write_text("3")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write()
    assert place.exists() == bool(before)
    if before:
        assert contents(place) == {"a.txt": "1", "z.txt": "2"}


KILLED = """
import os
import subprocess
import sys
from pathlib import Path
from terraphi.experiment.outputs import output_folder
replace = Path.replace
Path.replace = lambda file, to: os._exit(9) if file.name == "c.txt" else replace(file, to)
with output_folder(Path("o"), kind="test", last="z.txt") as made:
    for name, text in {"a": "4", "c": "5", "z": "6"}.items():
        (made / f"{name}.txt").write_text(text)
"""


def test_a_change_that_is_killed_can_be_done_again(tmp_path: Path) -> None:
    """A process that is killed between two renames leaves a folder that is still ours."""
    place = tmp_path / "o"
    fill(place, a="1", b="2", z="3")

    paths = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    killed = subprocess.run([sys.executable, "-c", KILLED], cwd=tmp_path, env=paths, check=False)
    assert killed.returncode == 9
    assert "z.txt" not in contents(place)  # it goes first and comes last
    fill(place, a="7", z="8")
    assert contents(place) == {"a.txt": "7", "b.txt": "2", "z.txt": "8"}
    manifest = json.loads((place / MANIFEST).read_text())
    (place / MANIFEST).write_text(json.dumps(manifest | {"files": ["thesis.txt", "z.txt"]}))
    (place / "thesis.txt").write_text("mine")
    fill(place, z="9")
    assert contents(place)["thesis.txt"] == "mine"


class Disk:
    """Renames and links as a file system refuses them."""

    def __init__(self, patch: pytest.MonkeyPatch, refuses: Callable[[int, Path, Path], bool]):
        self.renames = 0
        for name in ("rename", "replace", "link"):
            patch.setattr(os, name, self.checked(getattr(os, name), refuses))

    def checked(
        self, call: Callable[..., None], refuses: Callable[[int, Path, Path], bool]
    ) -> Callable[..., None]:
        def checked(source: Any, target: Any, **options: Any) -> None:
            self.renames += call.__name__ != "link"
            if refuses(self.renames, Path(source), Path(target)):
                raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))
            call(source, target, **options)

        return checked


@pytest.mark.parametrize("name", ["a", "b", "z"])
def test_a_folder_in_the_way_costs_no_other_file(name: str, tmp_path: Path) -> None:
    place = tmp_path / "o"
    fill(place, a="1", b="2", z="3")
    (place / f"{name}.txt").unlink()
    (place / f"{name}.txt" / "mine").mkdir(parents=True)
    before = sorted(place.rglob("*")), (place / MANIFEST).read_text()
    with pytest.raises(InputError, match="cannot be written"):
        fill(place, a="4", b="5", z="6")
    assert (sorted(place.rglob("*")), (place / MANIFEST).read_text()) == before
    rest = {"a": "1", "b": "2", "z": "3"}
    assert {n: place.joinpath(f"{n}.txt").read_text() for n in {*rest} - {name}} == {
        n: text for n, text in rest.items() if n != name
    }


def test_a_link_to_a_folder_on_another_disk_is_written_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there, link = tmp_path / "disk" / "res", tmp_path / "res"
    fill(there, a="1", z="2")
    link.symlink_to(there)
    with monkeypatch.context() as patch:
        Disk(
            patch,
            lambda _, source, target: (
                there.is_relative_to(target.resolve().parent)
                and not source.resolve().is_relative_to(there)
            ),
        )
        fill(link, a="3", z="4")
    assert link.is_symlink()
    assert contents(there) == {"a.txt": "3", "z.txt": "4"}
    assert len([*tmp_path.rglob(".*")]) == 0


def test_files_that_were_changed_are_named(tmp_path: Path) -> None:
    place = tmp_path / "o"
    fill(place, a="1", z="2")
    assert changed(place) == changed(place / "a.txt") == ""
    (place / "a.txt").write_text("edited")
    assert changed(place) == changed(place / "a.txt") == "a.txt was changed after terraphi wrote it"
    assert changed(place / "z.txt") == ""
    (place / MANIFEST).write_text('{"terraphi_file": "manifest", "files": 3}')
    assert "is damaged" in changed(place)


def test_files_of_ours_are_replaced_and_no_others(tmp_path: Path) -> None:
    file, theta = tmp_path / "h.nc", np.linspace(-1.5, 1.5, 50)
    check_file(file, kind="force history")
    ForceHistory(theta, np.stack([theta, theta], axis=1)).to_netcdf(file)
    check_file(file, kind="force history")
    (tmp_path / "table.csv").write_text(f"# {SIGNATURE}\n")
    check_file(tmp_path / "table.csv")
    with h5py.File(tmp_path / "theirs.nc", "w") as theirs:
        theirs["a"] = 1.0
    (tmp_path / "thesis.html").write_text("<p>On terraphi</p>")
    (tmp_path / "cut.nc").write_bytes(file.read_bytes()[:2000])
    kinds = {"h.nc": "library", "theirs.nc": "force history", "thesis.html": "", "cut.nc": "x"}
    for name, kind in kinds.items():
        with pytest.raises(InputError, match=rf"{name}: is there, and not a .*written by terraphi"):
            check_file(tmp_path / name, kind=kind)
    with pytest.raises(InputError, match=r"resolved: is written as NetCDF; name it resolved\.nc"):
        check_file(tmp_path / "resolved", kind="library")
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / MANIFEST).write_text('{"name": "an extension of a browser"}')
    with pytest.raises(InputError, match=r"holds 'manifest\.json', not written by"):
        fill(tmp_path / "o", a="1")


@pytest.mark.parametrize("name", ["/dev/zero", "pipe", "link", "../outside.txt"])
def test_a_manifest_opens_nothing_but_files_of_its_folder(tmp_path: Path, name: str) -> None:
    place = tmp_path / "o"
    fill(place, z="1")
    os.mkfifo(place / "pipe")
    (place / "link").symlink_to("/dev/zero")
    (tmp_path / "outside.txt").write_text("1")
    manifest = json.loads((place / MANIFEST).read_text())
    manifest["digests"][name] = manifest["digests"]["z.txt"]  # that of outside.txt too
    (place / MANIFEST).write_text(json.dumps(manifest))
    assert "damaged" in changed(place)
    (place / MANIFEST).unlink()
    os.mkfifo(place / MANIFEST)
    with pytest.raises(InputError, match="not written by terraphi"):
        check_folder(place, kind="test")
