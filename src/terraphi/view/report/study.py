"""The report of a study: its tables, its page and its pictures."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from terraphi.experiment.errors import InputError
from terraphi.view.report.parts import Part, Pictures, Section, Text, pairs
from terraphi.view.table import Table

WIDEST_PICTURE = 1400
"""Width of a picture in the page [px]."""
MOST_PICTURE_BYTES = 2_000_000
"""Of all pictures together."""
MOST_DATA_BYTES = 20_000_000
MOST_ROWS = 300


def section(folder: Path) -> Section:
    """Report of a study.

    Parameters
    ----------
    folder
        Of ``terraphi study --out``.

    Raises
    ------
    InputError
        If ``data.json`` is not that of a study.
    """
    data = _data(folder / "data.json")
    own = _own_table(data)
    parts: list[Part] = [replace(own, title="In numbers")] if own else []
    if beside := data.get("beside_paper"):
        columns = (("", "{what}"), ("ours", "{ours}"), ("Xu & Wang", "{paper}"))
        parts.append(replace(Table.of("Ours beside the paper's", columns, beside), wide=True))
    if notes := data.get("notes"):
        parts.append(Text("In words", tuple(str(note).replace("`", "") for note in notes)))
    parts += pictures(folder, "Pictures")
    parts += [_page(file) for file in sorted(folder.glob("*.md"))]
    hidden = {"study", "about", "notes", "beside_paper", "table"}
    rows = pairs(_shortened({k: v for k, v in data.items() if k not in hidden}))
    note = f"The first {MOST_ROWS} of {len(rows)}." if len(rows) > MOST_ROWS else ""
    parts.append(
        Table("All data", ("key", "value"), rows[:MOST_ROWS], note=note, wide=True, folded=True)
    )
    about = str(data.get("about", ""))
    return Section(
        kind="study",
        title=str(data.get("study", "")) or folder.resolve().name,
        headline=(own and own.title) or f"A study of {len(data)} results",
        reason=f"{about[:1].upper()}{about[1:]}",
        parts=parts,
        provenance={
            "result": folder.resolve().name,
            **{key: data[key] for key in ("library", "plan", "software") if key in data},
        },
    )


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


def _own_table(data: Mapping[str, Any]) -> Table | None:
    """The study's own table; ``None`` if its data have none."""
    own = data.get("table")
    if not own:
        return None
    rows = [[str(cell) for _, cell in zip(own["header"], row, strict=True)] for row in own["rows"]]
    return Table(str(own["title"]), [str(name) for name in own["header"]], rows, wide=True)


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
    """A page in Markdown as HTML. Tags and links in it stay text; its pictures are left out."""
    from markdown_it import MarkdownIt

    renderer = MarkdownIt("commonmark", {"html": False}).enable("table")
    renderer.disable(["link", "autolink"])
    renderer.add_render_rule("image", lambda *_: "")
    return Text(f"The study's page ({path.name})", html=renderer.render(_text(path)), folded=True)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")[:400_000]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a text") from error


def pictures(folder: Path, title: str) -> list[Part]:
    """The PNG files of a folder, made smaller, up to :data:`MOST_PICTURE_BYTES` in all."""
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
    return [Pictures(title, found, note)]


def _embedded(path: Path) -> str | None:
    """A PNG, made smaller, as a ``data:`` URL; ``None`` if the file is not a picture."""
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
