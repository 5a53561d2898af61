"""Pages: a section of each kind, offline, safe from what stands in files."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import h5py
import pytest

from terraphi import Answer, InputError, Scenario, simulate
from terraphi.inference.footfalls import FootfallMap
from terraphi.view.console import Table
from terraphi.view.page import render, sections
from terraphi.view.sections import Picture, Section, kind_of

HOSTILE = "</script><img src=x onerror=alert(1)>"


def test_each_kind_of_result_is_recognised_and_drawn(results: dict[str, str]) -> None:
    assert {kind_of(source) for source in results.values()} == {*results}
    result = sections(list(results.values()))
    assert [item.kind for item in result] == [*results]
    page = render(result)
    for section in result:
        assert section.headline in page.replace("&#39;", "'").replace("&gt;", ">")
        pictures = [part.image for part in section.parts if isinstance(part, Picture)]
        assert pictures
        assert all(image in page for image in pictures)


def test_a_simulated_body_that_is_no_leg_is_named() -> None:
    scenario = {
        "name": "pressed", "model": "rft", "dimensions": 3,
        "leg": {"shape": "plate", "chord": 0.04, "width": 0.02, "half_thickness": 0.001},
        "motion": {"kind": "translation", "start": [0.15, 0.17], "orientation_deg": 90.0,
                   "velocity": [0.0, -0.01], "distance": 0.03},
    }  # fmt: skip
    history = simulate(Scenario.model_validate(scenario))
    assert "plate, φ = " in sections([history])[0].headline


def test_an_answer_that_was_changed_is_shown_with_a_warning(answer: Answer, tmp_path: Path) -> None:
    answer.save(tmp_path / "a")
    (full,) = sections([str(tmp_path / "a")])
    (tmp_path / "a" / "manifest.json").write_text("{")
    (broken,) = sections([str(tmp_path / "a")])
    assert "manifest.json is damaged" in broken.lines[0]
    assert broken.lines[1:] == full.lines


def test_a_folder_of_answers_stands_for_each(
    answer: Answer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer.save(tmp_path / "a")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    monkeypatch.chdir(tmp_path)
    assert [item.kind for item in sections(["."])] == ["answer"] * 2


def test_names_from_files_stay_text_and_no_script_runs() -> None:
    part = Table(HOSTILE, (HOSTILE,), [(HOSTILE,)], HOSTILE)
    picture = Picture.of_png(HOSTILE, b"")
    section = Section("answer", HOSTILE, HOSTILE, [HOSTILE], [picture, part], [(HOSTILE, HOSTILE)])
    page = render([section])
    assert "<img src=x" not in page
    assert "<script" not in page
    assert "default-src 'none'" in page


def test_what_turns_the_direction_of_writing_is_escaped_in_a_page() -> None:
    name = "a\u202egpj.exe\u2028b\u2066"
    section = Section("answer", name, name, [name], [Table(name, (name,), [(name,)], name)], [
        (name, name)
    ])  # fmt: skip
    assert not set("\u202e\u2028\u2066") & {*render([section])}


def test_a_page_loads_nothing_and_is_small(results: dict[str, str]) -> None:
    page = render(sections([results["answer"]]))
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert len(page) < 1_000_000


@pytest.mark.parametrize("name", ["a.bin", "a.nc", "folder"])
def test_what_is_no_result_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.mkdir() if name == "folder" else path.write_bytes(b"\x89HDF nothing")
    with pytest.raises(InputError, match=name):
        kind_of(str(path))


@pytest.mark.slow
@pytest.mark.parametrize("width", [360, 1280])
def test_a_browser_shows_every_picture_offline(
    width: int, browser: Any, results: dict[str, str], tmp_path: Path
) -> None:
    (tmp_path / "r.html").write_text(render(sections(list(results.values()))))
    context = browser.new_context(offline=True, viewport={"width": width, "height": 800})
    page = context.new_page()
    trouble: list[str] = []
    page.on("pageerror", lambda error: trouble.append(str(error)))
    page.on("console", lambda one: trouble.append(one.text) if one.type != "log" else None)
    page.goto((tmp_path / "r.html").as_uri())
    drawn = page.evaluate("[...document.images].map(image => image.naturalWidth)")
    assert min(drawn) > 0
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert trouble == []
    context.close()


def test_foot_forces_and_footfalls_of_version_0_3_show_their_warnings(
    results: dict[str, str], tmp_path: Path
) -> None:
    """They are called ``notes`` there."""
    for kind in ("foot forces", "footfalls"):
        (old := tmp_path / f"{kind}.nc").write_bytes(Path(results[kind]).read_bytes())
        with h5py.File(old, "r+") as file:
            if kind == "footfalls":
                file.attrs["notes"] = file.attrs.pop("warnings")
            else:
                file.attrs["summary"] = file.attrs["summary"].replace('"warnings"', '"notes"')
        (section,) = sections([str(old)])
        assert {"No attitude.", "Density is assumed."} & {*section.lines}
    assert FootfallMap.load(tmp_path / "footfalls.nc").warnings == ("density is assumed",)
