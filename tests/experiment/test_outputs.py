"""Nothing is written over, or removed, that this program did not write."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.outputs import MANIFEST, check_file, check_folder, filling


def fill(place: Path, **content: str) -> None:
    with filling(place, kind="test", last="z.txt") as made:
        for name, text in content.items():
            (made / f"{name}.txt").write_text(text)


def contents(place: Path) -> dict[str, str]:
    files = (path for path in place.iterdir() if path.is_file() and path.name != MANIFEST)
    return {file.name: file.read_text() for file in files}


def test_a_folder_of_ours_is_filled_anew(tmp_path: Path) -> None:
    place = tmp_path / "new" / "folder"
    fill(place, a="1", z="2")
    (place / "mine.md").write_text("a note")
    fill(place, b="3", z="4")
    assert contents(place) == {"b.txt": "3", "z.txt": "4", "mine.md": "a note"}
    fill(place, a="5")
    assert contents(place) == {"a.txt": "5", "mine.md": "a note"}


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    check_folder(tmp_path, kind="test")
    fill(tmp_path, a="1")
    assert contents(tmp_path) == {"a.txt": "1"}


def test_a_folder_of_others_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("theirs")
    with pytest.raises(InputError, match=r"holds what terraphi did not write, such as 'a\.txt'"):
        fill(tmp_path, a="1")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
    check_folder(tmp_path, kind="test", besides=["a.txt"])
    (tmp_path / MANIFEST).write_text('{"name": "an extension of a browser"}')
    with pytest.raises(InputError, match="did not write"):
        check_folder(tmp_path, kind="test")


def test_results_of_another_command_are_left_alone(tmp_path: Path) -> None:
    fill(tmp_path, a="1")
    with pytest.raises(InputError, match=r"holds the results of another command \(test\); name"):
        check_folder(tmp_path, kind="another")


def test_a_file_of_others_in_a_folder_of_ours_is_left_alone(tmp_path: Path) -> None:
    fill(tmp_path / "o", a="1", z="2")
    (tmp_path / "o" / "b.txt").write_text("theirs")
    with pytest.raises(InputError, match=r"b\.txt: is not one of terraphi's; move it away"):
        check_folder(tmp_path / "o", kind="test", names=["b.txt"])
    with pytest.raises(InputError, match=r"b\.txt: is not one of terraphi's"):
        fill(tmp_path / "o", b="3")
    assert contents(tmp_path / "o") == {"a.txt": "1", "z.txt": "2", "b.txt": "theirs"}


def test_a_file_of_ours_that_somebody_changed_is_left_alone(tmp_path: Path) -> None:
    fill(tmp_path / "o", a="1", z="2")
    (tmp_path / "o" / "a.txt").write_text("with a remark")
    for content in ({"a": "3"}, {"z": "3"}):
        with pytest.raises(InputError, match=r"a\.txt: was changed since terraphi wrote it; move"):
            fill(tmp_path / "o", **content)
    assert contents(tmp_path / "o") == {"a.txt": "with a remark", "z.txt": "2"}
    (tmp_path / "o" / "a.txt").unlink()
    fill(tmp_path / "o", z="3")
    assert contents(tmp_path / "o") == {"z.txt": "3"}


@pytest.mark.parametrize("there", [None, "empty", "ours"])
def test_what_fails_leaves_things_as_they_were(tmp_path: Path, there: str | None) -> None:
    place = tmp_path / "o"
    if there == "empty":
        place.mkdir()
    elif there == "ours":
        fill(place, a="1", z="2")

    def interrupted() -> None:
        with filling(place, kind="test", last="z.txt") as made:
            (made / "a.txt").write_text("3")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert place.is_dir() == (there is not None)
    if there is not None:
        found = contents(place)
        assert found == ({"a.txt": "1", "z.txt": "2"} if there == "ours" else {})
        assert (place / MANIFEST).exists() == (there == "ours")


@pytest.mark.parametrize("moves", [0, 1, 2])
def test_a_change_that_is_cut_off_can_be_done_again(
    tmp_path: Path, moves: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that is killed between two renames leaves a folder that is still ours."""
    place, replace = tmp_path / "o", Path.replace
    done: list[str] = []
    fill(place, a="1", b="2", z="3")

    def killed(self: Path, target: Path) -> Path:
        if ".unfinished" in str(self):
            if len(done) == moves:
                raise KeyboardInterrupt
            done.append(self.name)
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            fill(place, a="4", c="5", z="6")
    assert "z.txt" not in contents(place)  # what speaks of the others goes first and comes last
    fill(place, a="7", z="8")
    assert contents(place) == {"a.txt": "7", "z.txt": "8"}


def test_files_of_ours_are_replaced_and_no_others(tmp_path: Path) -> None:
    file, theta = tmp_path / "h.nc", np.linspace(-1.5, 1.5, 50)
    check_file(file, kind="force history")
    file.touch()  # as mktemp does
    check_file(file, kind="force history")
    ForceHistory(theta, np.stack([theta, theta], axis=1)).to_netcdf(file)
    check_file(file, kind="force history")
    with pytest.raises(InputError, match=r"h\.nc: is there, and not a library written by terraphi"):
        check_file(file, kind="library")
    with h5py.File(tmp_path / "theirs.nc", "w") as theirs:
        theirs["a"] = 1.0
    (tmp_path / "thesis.html").write_text("<p>On terraphi</p>")
    (tmp_path / "cut.nc").write_bytes(file.read_bytes()[:2000])
    Image.new("P", (2, 2)).save(tmp_path / "cat.gif")
    for name, kind in (
        ("theirs.nc", "force history"), ("thesis.html", ""), ("cut.nc", "library"), ("cat.gif", ""),
    ):  # fmt: skip
        with pytest.raises(InputError, match=rf"{name}: is there, and not .*written by terraphi"):
            check_file(tmp_path / name, kind=kind)
    with pytest.raises(InputError, match="null: is a device or a pipe; name a file"):
        check_file(Path("/dev/null"))
    with pytest.raises(InputError, match="is a folder; name a file"):
        check_file(tmp_path)


def test_an_answer_does_not_touch_a_strangers_pictures(terraphi, tmp_path) -> None:
    for name in ("figure.png", "corner.png"):
        (tmp_path / name).write_text("mine")
    for command in (
        ("invert", "li2013:yuma/straight", "--library", "rft3d"), ("demo",), ("study", "k0"),
    ):  # fmt: skip
        ran = terraphi(*command, "--out", ".")
        assert (ran.status, ran.out) == (2, "")
        assert ran.err == (
            "terraphi: .: holds what terraphi did not write, such as 'corner.png'; name a new or "
            "an empty folder\n"
        )
    assert contents(tmp_path) == {"figure.png": "mine", "corner.png": "mine"}


def test_a_strangers_file_is_refused_before_the_work(terraphi, tmp_path) -> None:
    for name in ("h.nc", "r.html", "a.gif", "f.nc"):
        (tmp_path / name).write_text("mine")
    before = contents(tmp_path)
    for command in (
        ("simulate", "quick", "--out", "h.nc"),
        ("simulate", "quick", "--animate", "a.gif"),
        ("report", "no-answer", "--out", "r.html"),
        ("forces", "no-log.csv", "--out", "f.nc"),
        ("library", "calibrate", "no-library", "--out", "f.nc"),
    ):
        ran = terraphi(*command)
        assert (ran.status, ran.out) == (2, "")
        assert f"{command[-1]}: is there, and not" in ran.err
    assert "is a folder" in terraphi("library", "build", "rft3d", "--out", ".").err
    assert contents(tmp_path) == before


def test_frames_of_others_are_left_alone(terraphi, tmp_path) -> None:
    (tmp_path / "f").mkdir()
    for name in ("particles_0001.vtu", ".legacy"):
        (tmp_path / "f" / name).write_text("mine")
    ran = terraphi("simulate", "quick", "--fields", "f")
    assert (ran.status, ran.out) == (2, "")
    assert "particles_0001.vtu: is there, and of no series that terraphi wrote" in ran.err
    assert set(contents(tmp_path / "f")) == {"particles_0001.vtu", ".legacy"}


def test_pages_and_histories_of_ours_are_replaced(terraphi, tmp_path) -> None:
    (tmp_path / "s.toml").write_text('model = "rft"\ndimensions = 3\n')
    for _ in range(2):
        assert terraphi("simulate", "s.toml", "--out", "h.nc").status == 0
        assert terraphi("report", "h.nc", "--out", "r.html").status == 0


def test_a_netcdf_is_called_so(terraphi, tmp_path) -> None:
    # A file "resolved" would be taken for the library of that name.
    for command in (
        ("simulate", "quick", "--out"),
        ("library", "build", "rft3d", "--out"),
        ("library", "refine", "resolved-2", "--fine", "resolved-2-cells-384", "--out"),
        ("library", "calibrate", "rft3d", "--out"),
    ):
        ran = terraphi(*command, "resolved")
        assert (ran.status, ran.out) == (2, "")
        assert "resolved: is written as NetCDF; name it resolved.nc" in ran.err
    assert not contents(tmp_path)
