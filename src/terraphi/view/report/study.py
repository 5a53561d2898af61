"""The report of a study: its tables, its page and its pictures."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from terraphi.experiment.errors import InputError
from terraphi.view.report.parts import Part, Pictures, Section, Table, Text, pairs
from terraphi.view.report.study_plots import known_plots

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

    Returns
    -------
    Section

    Raises
    ------
    InputError
        If ``data.json`` is not that of a study.
    """
    data = _data(folder / "data.json")
    name = str(data.get("study", ""))
    parts: list[Part] = []
    beside = _beside_paper(data)
    if beside:
        parts.append(Table("Ours beside the paper's", ("", "ours", "Xu & Wang"), beside, wide=True))
    notes = data.get("notes", ())
    if isinstance(notes, list) and notes:
        parts.append(Text("In words", tuple(str(note).replace("`", "") for note in notes)))
    plots = known_plots(name, data)
    parts += plots
    parts += pictures(folder, "Figures as the study drew them", folded=bool(plots))
    parts += [_page(file) for file in sorted(folder.glob("*.md"))]
    hidden = {"study", "about", "notes", "beside_paper"}
    rows = pairs(_shortened({k: v for k, v in data.items() if k not in hidden}))
    note = f"The first {MOST_ROWS} of {len(rows)}." if len(rows) > MOST_ROWS else ""
    parts.append(
        Table("All data", ("key", "value"), rows[:MOST_ROWS], note=note, wide=True, folded=True)
    )
    return Section(
        kind="study",
        title=name or folder.resolve().name,
        headline=headline(name, data),
        reason=_sentence(data.get("about", "")),
        parts=parts,
        provenance={
            "result": folder.resolve().name,
            **{key: data[key] for key in ("library", "plan", "software") if key in data},
        },
    )


def _sentence(words: object) -> str:
    return f"{str(words)[:1].upper()}{str(words)[1:]}"


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
    """A page in Markdown; HTML and links in it stay text, its pictures are left out: see above."""
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


def pictures(folder: Path, title: str, *, folded: bool) -> list[Part]:
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
    return [Pictures(title, found, note, folded=folded)]


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


Data = Mapping[str, Any]


def headline(name: str, data: Data) -> str:
    """What came out, in one sentence.

    Parameters
    ----------
    name
        Of the study.
    data
        ``data.json``. If they are not those of such a study, the sentence is of their number.
    """
    try:
        return _SENTENCES[name](data)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        return f"A study of {len(data)} results."


def _recovery(data: Data) -> str:
    count, error = len(data["cases"]), data["abs_error_deg"]
    return (
        f"{count} friction angles ({data['yield']}) recovered with a median error of "
        f"{error['median']:.2f}°, the largest {error['max']:.2f}°; {data['inside68']} lie "
        f"inside their 68 % interval and {data['inside95']} inside their 95 % interval."
    )


def _calibration(data: Data) -> str:
    return (
        f"In {data['replicates']} simulated worlds 68 % intervals hold the truth in "
        f"{100.0 * data['coverage68']:.1f} % and 95 % intervals in "
        f"{100.0 * data['coverage95']:.1f} %."
    )


def _measured(data: Data) -> str:
    answers = data["answers"]
    believed = sum(answer["verdict"] == "consistent" for answer in answers)
    return (
        f"{len(answers)} inversions of measured forces, by {len(data['verdicts'])} libraries: "
        f"{believed or 'none'} consistent with the model."
    )


def _prediction(data: Data) -> str:
    sands = ", ".join(
        f"{medium} {fit['phi_deg']:.1f}° (μ = {fit['friction']:.2f})"
        for medium, fit in data["calibrated"].items()
    )
    return f"Friction angles that fit the straight leg: {sands}."


def _benchmark(data: Data) -> str:
    best = min(
        (max(forces.values()), leg, model)
        for leg, models in data["nrmsd_percent"].items()
        for model, forces in models.items()
    )
    return (
        f"Closest to the measured forces: {best[2]} on the {best[1]} leg, {best[0]:.1f} % of "
        "peak-to-peak in the worse of both forces."
    )


def _phi_sensitivity(data: Data) -> str:
    phi, peaks = data["phi_deg"], data["peak_Fz_N"]
    return (
        f"Peak lift goes from {peaks[0]:.1f} N at φ = {phi[0]:g}° to {peaks[-1]:.1f} N at "
        f"{phi[-1]:g}°."
    )


def _k0(data: Data) -> str:
    change = 100.0 * data["max_relative_change"]
    return f"The stress at rest changes a force history by at most {change:.2g} %."


def _surrogate(data: Data) -> str:
    errors = data["nrmsd_percent"]
    return (
        f"Held-out forces are predicted within {errors['Fz']:.2f} % (Fz) and "
        f"{errors['Fx']:.2f} % (Fx) of their peak-to-peak, root mean square."
    )


def _reading(data: Data) -> str:
    whole = [found for found in data["readings"] if found.get("off_by_percent") is not None]
    best = min(whole, key=lambda found: float(found["off_by_percent"]))
    return (
        f"Of {len(data['readings'])} readings of the paper's text the closest, "
        f"{best['reading']}, is {best['off_by_percent']:.0f} % off its peak forces."
    )


def _prototype(data: Data) -> str:
    shares = [
        100.0 * share
        for case in data["cases"]
        if case["model"] == "its code" and case["speed_up"] == 1.0
        for share in case["share_of_peaks"].values()
    ]
    return (
        f"The contact of the paper's prototype applies {min(shares):.0f} to {max(shares):.0f} % of "
        "the peak forces that it counts."
    )


def _sensitivity(data: Data) -> str:
    return f"One setting changed at a time, {len(data['groups'])} settings."


def _resolution(data: Data) -> str:
    first, last = data["waterfall"][0], data["waterfall"][-1]
    return (
        f"Peak lift goes from {first['peaks_N']['Fz']:.1f} N ({first['step']}) to "
        f"{last['peaks_N']['Fz']:.1f} N ({last['step']})."
    )


def _spacing(data: Data) -> str:
    found = ", ".join(
        f"{row['coverage68']:.0%} and {row['coverage95']:.0%} ({row['truths']})"
        for row in data["rows"]
        if row["spacing_deg"] is None
    )
    return f"Truths inside 68 and 95 % intervals, at all spacings: {found}."


def _design(data: Data) -> str:
    parts = []
    for found in data["comparisons"]:
        grid, suggested = (found[order][-1][0] for order in ("grid", "suggested"))
        parts.append(f"{len(found['keys'])} varied, {found['cases'][-1]} cases: {grid:.2g}° and "
                     f"{suggested:.2g}°")  # fmt: skip
    return f"Error of φ by an even grid, and in the suggested order: {'; '.join(parts)}."


def _verification(data: Data) -> str:
    total = data["passed"] + data["missed"]
    return f"{data['passed']} of {total} checks against known answers passed."


_SENTENCES: dict[str, Callable[[Data], str]] = {
    "recovery": _recovery,
    "calibration": _calibration,
    "measured": _measured,
    "prediction": _prediction,
    "benchmark": _benchmark,
    "phi_sensitivity": _phi_sensitivity,
    "k0": _k0,
    "surrogate": _surrogate,
    "reading": _reading,
    "prototype": _prototype,
    "sensitivity": _sensitivity,
    "resolution": _resolution,
    "spacing": _spacing,
    "design": _design,
    "verification": _verification,
}
