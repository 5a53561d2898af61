"""The report of a study: its tables, its page and its pictures."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from terraphi.errors import InputError
from terraphi.report.parts import Part, Pictures, Section, Table, Text, pairs
from terraphi.report.study_plots import known_plots
from terraphi.studies import STUDIES

WIDEST_PICTURE = 1400
"""Width of a picture in the page [px]."""
MOST_PICTURE_BYTES = 2_000_000
"""Of all pictures together."""
MOST_DATA_BYTES = 20_000_000
MOST_ROWS = 300
SIGNATURES = {
    "recovery": {"cases", "inside68"},
    "benchmark": {"nrmsd_percent", "peaks"},
    "sensitivity": {"groups", "tolerance_percent"},
    "resolution": {"waterfall", "halved"},
    "verification": {"families", "tier"},
    "phi_sensitivity": {"peaks_increase"},
    "k0": {"max_relative_change"},
    "surrogate": {"held_out"},
    "reading": {"readings"},
    "calibration": {"coverage68", "strangers"},
}
"""Keys by which the data of a study, which do not name it, are told."""


def section(folder: Path) -> Section:
    """Report of a study.

    Parameters
    ----------
    folder
        Of ``terraphi study --out``.

    Returns
    -------
    Section

    Raises
    ------
    InputError
        If ``data.json`` is not that of a study.
    """
    data = _data(folder / "data.json")
    name = name_of(data)
    parts: list[Part] = []
    beside = _beside_paper(data)
    if beside:
        parts.append(Table("Ours beside the paper's", ("", "ours", "Xu & Wang"), beside, wide=True))
    plots = known_plots(name, data)
    parts += plots
    parts += _pictures(folder, folded=bool(plots))
    parts += [_page(file) for file in sorted(folder.glob("*.md"))]
    hidden = {"beside_paper"}
    rows = pairs(_shortened({k: v for k, v in data.items() if k not in hidden}))
    note = f"The first {MOST_ROWS} of {len(rows)}." if len(rows) > MOST_ROWS else ""
    parts.append(
        Table("All data", ("key", "value"), rows[:MOST_ROWS], note=note, wide=True, folded=True)
    )
    return Section(
        kind="study",
        title=name or folder.resolve().name,
        headline=headline(name, data),
        reason=STUDIES.get(name, "")[:1].upper() + STUDIES.get(name, "")[1:],
        parts=parts,
        provenance={
            "result": folder.resolve().name,
            **{key: data[key] for key in ("library", "plan", "software") if key in data},
        },
    )


def name_of(data: Mapping[str, Any]) -> str:
    """Name of the study that data are of; empty if they are of none that is known."""
    return next((name for name, keys in SIGNATURES.items() if keys <= set(data)), "")


def headline(name: str, data: Mapping[str, Any]) -> str:
    """What came out in one sentence, for the studies whose data have one number to say."""
    try:
        return _headline(name, data)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        return f"A study of {len(data)} results."


def _headline(name: str, data: Mapping[str, Any]) -> str:
    if name == "recovery":
        count, error = len(data["cases"]), data["abs_error_deg"]
        return (
            f"{count} friction angles ({data['yield']}) recovered with a median error of "
            f"{error['median']:.2f}°, the largest {error['max']:.2f}°; {data['inside68']} lie "
            f"inside their 68 % interval and {data['inside95']} inside their 95 % interval."
        )
    if name == "verification":
        total = data["passed"] + data["missed"]
        return f"{data['passed']} of {total} checks against known answers passed."
    if name == "benchmark":
        best = min(
            (max(forces.values()), leg, model)
            for leg, models in data["nrmsd_percent"].items()
            for model, forces in models.items()
        )
        return (
            f"Closest to the measured forces: {best[2]} on the {best[1]} leg, {best[0]:.1f} % of "
            "peak-to-peak in the worse of both forces."
        )
    if name == "sensitivity":
        return f"One setting changed at a time, {len(data['groups'])} settings."
    if name == "resolution":
        first, last = data["waterfall"][0], data["waterfall"][-1]
        return (
            f"Peak lift goes from {first['peaks_N']['Fz']:.1f} N ({first['step']}) to "
            f"{last['peaks_N']['Fz']:.1f} N ({last['step']})."
        )
    if name == "k0":
        change = 100.0 * data["max_relative_change"]
        return f"The stress at rest changes a force history by at most {change:.2g} %."
    return f"A study of {len(data)} results."


def _data(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MOST_DATA_BYTES:
            raise InputError(f"{path}: larger than {MOST_DATA_BYTES / 1e6:g} MB, no study's data")
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not the data of a study") from error
    if not isinstance(found, dict):
        raise InputError(f"{path}: not the data of a study")
    return found


def _beside_paper(data: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    lines = data.get("beside_paper", [])
    if not isinstance(lines, list) or not all(isinstance(line, dict) for line in lines):
        return []
    return [(*(str(line.get(key, "")) for key in ("what", "ours", "paper")),) for line in lines]  # type: ignore[misc]


def _shortened(value: Any) -> Any:
    """Long lists by their length, so that a table stays readable."""
    if isinstance(value, Mapping):
        return {key: _shortened(inner) for key, inner in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        if len(value) > 12 or any(isinstance(inner, dict | list) for inner in value):
            return f"{len(value)} entries"
        return list(value)
    return value


def _page(path: Path) -> Text:
    """A page in Markdown; HTML and links in it stay text, and its pictures are elsewhere."""
    from markdown_it import MarkdownIt

    renderer = MarkdownIt("commonmark", {"html": False}).enable("table")
    renderer.disable(["image", "link", "autolink"])
    return Text(f"The study's page ({path.name})", html=renderer.render(_text(path)), folded=True)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")[:400_000]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a text") from error


def _pictures(folder: Path, *, folded: bool) -> list[Part]:
    """The figures of the folder, made smaller, as far as there is room."""
    found: list[tuple[str, str]] = []
    room = MOST_PICTURE_BYTES
    left_out = []
    for path in sorted(folder.glob("[!.]*.png")):
        source = _embedded(path)
        if source is None or len(source) > room:
            left_out.append(path.name)
            continue
        room -= len(source)
        found.append((path.stem.replace("-", " ").replace("_", " "), source))
    note = f"Left out, no pictures or for want of room: {', '.join(left_out)}." if left_out else ""
    if not found and not note:
        return []
    return [Pictures("Figures as the study drew them", found, note, folded=folded)]


def _embedded(path: Path) -> str | None:
    """A picture as a data address; ``None`` for what is none."""
    from PIL import Image

    try:
        with Image.open(path, formats=["PNG"]) as image:
            image.load()
            small = image.convert("RGB")
            small.thumbnail((WIDEST_PICTURE, 4 * WIDEST_PICTURE))
            buffer = io.BytesIO()
            small.save(buffer, "WEBP", quality=80, method=4)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None
    return f"data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
