"""The pages say what is so: what they show is run, and they hang together."""

from __future__ import annotations

import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
pages = SimpleNamespace(**runpy.run_path(str(DOCS / "run_pages.py")))

ALL = pages.hand_written()


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks_of(page: Path) -> list:
    return pages.blocks(page.read_text(encoding="utf-8"))


def is_run(block) -> bool:
    return block.language in pages.RUN and "not run" not in block.options


RUN = [page for page in ALL if any(map(is_run, blocks_of(page)))]
SLOW = [page for page in RUN if any("slow" in block.options for block in blocks_of(page))]


@pytest.mark.parametrize("page", RUN, ids=name_of)
def test_what_a_page_shows_comes_out(page: Path) -> None:
    pages.run_page(page)


@pytest.mark.slow
@pytest.mark.parametrize("page", SLOW, ids=name_of)
def test_slow_blocks_of_a_page(page: Path) -> None:
    pages.run_page(page, slow=True)


@pytest.mark.parametrize("page", ALL, ids=name_of)
def test_every_block_is_run_or_says_why_not(page: Path) -> None:
    for block in blocks_of(page):
        where = f"{name_of(page)}, line {block.first}"
        assert block.language in pages.RUN | pages.INERT or "file" in block.options, where
        assert block.options.get("not run", "a reason"), f"{where}: say why it is not run"


@pytest.mark.parametrize("page", ALL, ids=name_of)
def test_files_are_named_to_the_reader(page: Path) -> None:
    lines = page.read_text(encoding="utf-8").splitlines()
    for block in blocks_of(page):
        if "file" in block.options:
            before = " ".join(lines[block.first - 6 : block.first - 2])
            assert f"`{block.options['file']}`" in before, f"{name_of(page)}, line {block.first}"


def test_most_blocks_are_run() -> None:
    found = [block for page in ALL for block in blocks_of(page) if block.language in pages.RUN]
    left_out = [block for block in found if not is_run(block)]
    assert len(found) > 40
    assert len(left_out) < 0.15 * len(found)


def test_the_counts_of_the_verification_are_those_of_its_page() -> None:
    found = re.compile(r"(\d+) checks[^.;]*? pass,? (?:and )?(\d+) miss")
    (counts,) = found.findall((DOCS / "verification.md").read_text(encoding="utf-8"))
    for page in (ROOT / "README.md", DOCS / "explanation" / "accuracy.md"):
        assert found.findall(page.read_text(encoding="utf-8")) == [counts], page.name


def comes_out(ours: str, paper: str) -> bool:
    """Whether all numbers agree within 3 %, or the one is below a bound."""
    mine, theirs = ([float(n) for n in re.findall(r"-?\d+(?:\.\d+)?", s)] for s in (ours, paper))
    if paper.startswith("below"):
        return mine[0] < theirs[0]
    return all(abs(m - t) <= 0.03 * abs(t) for m, t in zip(mine, theirs, strict=True))


def printed_on(page: Path) -> dict[str, list[list[str]]]:
    """Lines ``what, ours, the paper's`` that a page shows, by the arguments of ``terraphi``."""
    printed: dict[str, list[list[str]]] = {}
    for line in (line for block in blocks_of(page) for line in block.lines):
        if line.startswith("$ "):
            printed[(command := line.removeprefix("$ terraphi "))] = []
        elif len(cells := re.split(r"\s{2,}", line.strip())) == 3:
            printed[command].append(cells)
    return printed


def test_the_paper_number_by_number_is_what_the_studies_print() -> None:
    page = DOCS / "explanation" / "paper.md"
    text = page.read_text(encoding="utf-8")
    line = r"^\| (.+) \| `(\w+)` \| (.+) \| (.+) \| (.+) \| (.+) \| (.*) \|$"
    lines = re.findall(line, text, re.M)
    printed = printed_on(page)
    by_code = [row for command, rows in printed.items() for row in rows
               if command == "study prototype" or "paper-code" in command
               or "prototype" in row[0]]  # fmt: skip
    for what, _, paper, ours, verdict, code, code_verdict in lines:
        assert verdict.startswith("yes" if comes_out(ours, paper) else "no"), what
        if code == "the same":
            assert not code_verdict, what
        else:
            assert [what.replace(", MPM:", ", prototype:"), code, paper] in by_code
            assert code_verdict.startswith("yes" if comes_out(code, paper) else "no"), what
    studies = ("phi_sensitivity", "k0", "benchmark", "surrogate", "recovery")
    assert {study for _, study, *_ in lines} == set(studies)
    for study in studies:
        mine = [[what, ours, paper] for what, s, paper, ours, *_ in lines if s == study]
        shown = [row for row in printed[f"study {study}"] if "prototype" not in row[0]]
        assert sorted(mine) == sorted(shown)


# -- the pages hang together ---------------------------------------------------------------------

LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
TOCTREE = re.compile(r"```\{toctree\}\n(.*?)```", re.S)
MADE_AT_BUILD = "gallery"
SOURCES = [p for p in DOCS.rglob("*.md") if not {"_build", MADE_AT_BUILD} & set(p.parts)]
SOURCES = [p for p in SOURCES if not p.name.endswith("-keys.md")]


def anchors(text: str) -> set[str]:
    """Anchors of headings, as GitHub and MyST name them."""
    titles = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", text, flags=re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", [*SOURCES, ROOT / "README.md"], ids=name_of)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for link in LINK.findall(text):
        if re.match(r"[a-z]+:", link):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        if MADE_AT_BUILD in target.parts:
            target = DOCS / "notebooks" / f"{target.stem}.py"
        assert target.exists(), f"{name_of(page)}: {link}"
        if anchor and not (target.parent / f"{target.stem}-keys.md").exists():
            known = anchors(target.read_text(encoding="utf-8"))
            # Tables of keys are headings that the build makes.
            made = "-keys.md" in target.read_text(encoding="utf-8")
            assert made or anchor in known, f"{name_of(page)}: {link}"


def test_every_page_is_in_a_table_of_contents() -> None:
    reached, waiting = set(), [DOCS / "index.md"]
    while waiting:
        page = waiting.pop()
        reached.add(page)
        for tree in TOCTREE.findall(page.read_text(encoding="utf-8")):
            entries = [line for line in tree.splitlines() if line and not line.startswith(":")]
            for entry in entries:
                if entry.startswith(MADE_AT_BUILD):
                    continue
                found = page.parent / f"{entry}.md"
                assert found.is_file(), f"{name_of(page)}: {entry}"
                if found not in reached:
                    waiting.append(found)
    assert set(SOURCES) == reached


@pytest.mark.slow
def test_the_documentation_is_built_without_a_warning(tmp_path: Path) -> None:
    for name in ("examples", "src"):
        (tmp_path / name).symlink_to(ROOT / name)
    for name in ("CHANGELOG.md", "CONTRIBUTING.md", "README.md"):
        shutil.copy(ROOT / name, tmp_path)
    place = tmp_path / "docs"
    shutil.copytree(DOCS, place, ignore=shutil.ignore_patterns("_build", MADE_AT_BUILD))
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    done = subprocess.run(
        [*command, str(place), str(tmp_path / "html")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr.strip()
    assert "peaks Fz / Fx at 25°" in (tmp_path / "html/gallery/paper_study.html").read_text()
    texts = [page.read_text() for page in (tmp_path / "html").rglob("*.html")]
    fetched = re.compile(r'<(?:script|link|img)[^>]*(?:src|href)="https?://')
    assert not [text[:200] for text in texts if fetched.search(text)], "read without a network"
    assert "remap_interval" in (tmp_path / "html/reference/scenario.html").read_text()


# -- the comparison itself -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shown", "came", "alike"),
    [
        ("φ 22.85 to 24.10", "φ  22.85 to 24.10", True),
        ("φ 22.85", "φ 22.86", True),
        ("φ 22.85", "φ 22.87", False),
        ("8 of 8 cases", "7 of 8 cases", False),
        ("at -36°", "at 36°", False),
        ("1.5e-16 of it", "1.6e-16 of it", True),
        ("1.5e-16 of it", "1.5e-15 of it", False),
        ("───", "─────", True),
        ("Verdict: misfit.", "Verdict: consistent.", False),
        ("one", "one\ntwo", False),
        ("one\n...", "one\ntwo\nthree", True),
        ("...\nthree", "one\ntwo\nthree", True),
        ("one\n...\nthree\n...", "one\ntwo\nthree\nfour", True),
        ("one\n...\nfive\n...", "one\ntwo\nthree\nfour", False),
        ("one\n...\nfour", "one\nfour\nfive", False),
        ("...", "", True),
    ],
)
def test_comparison_on_known_cases(shown: str, came: str, alike: bool) -> None:
    assert pages.same(shown.splitlines(), came.splitlines()) is alike


@pytest.mark.parametrize(
    ("shown", "came", "alike"),
    [
        ("φ 22.85 to 24.10", "φ 22.90 to 24.05", True),
        ("ρ 1599.6", "ρ 1575.0", True),
        ("φ 22.85", "φ 23.85", False),
        ("φ 0.0061", "φ 0.0068", False),
        ("2 histories", "3 histories", True),
        ("Verdict: misfit.", "Verdict: consistent.", False),
    ],
)
def test_comparison_of_what_was_drawn(shown: str, came: str, alike: bool) -> None:
    assert pages.same([shown], [came], drawn=True) is alike


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("```console\n$ terraphi --version\nterraphi, version 99.0\n```\n", "99.0"),
        ("```console\n$ false\n```\n", "ended with status 1"),
        ("<!-- exit: 2 -->\n```console\n$ true\n```\n", "not 2"),
        ("```python\nprint(1 + 1)\n```\n\n```text\n3\n```\n", "shown:\n3"),
    ],
)
def test_a_page_that_is_wrong_is_found_out(
    text: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "page.md"
    page.write_text(text)
    monkeypatch.setitem(pages.run_page.__globals__, "ROOT", tmp_path)
    with pytest.raises(AssertionError, match=re.escape(message)):
        pages.run_page(page)


def test_what_comes_out_can_be_written_into_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "page.md"
    page.write_text("```python\nx = 1 + 1\nprint(x)\n```\n\n```text\n3\n```\n\nEnd.\n")
    monkeypatch.setitem(pages.run_page.__globals__, "ROOT", tmp_path)
    pages.run_page(page, write=True)
    assert "```text\n2\n```\n\nEnd.\n" in page.read_text()
    pages.run_page(page)
