"""What wheels in grains of known friction angle are read as, and a published wheel.

    python studies/wheels.py [--out docs]

Prints what ``WHEEL_ERROR`` of ``terraphi.laws.wheel`` is learned as from all soils, and writes the
page. The table leaves each soil out of the offset that it is read with.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parent / "grains"))
import records as grains
import run

import pages
import terraphi
from terraphi.experiment.documents import shipped_file
from terraphi.experiment.rig import Tool
from terraphi.inference.rolled import wheel_of
from terraphi.laws.wheel import FRICTIONS, WHEEL_ERROR, Wheel, rolling, wheel_forces

SETTLED = 0.5
"""Way after a change of depth that is left out, over the radius of the wheel [-]."""
LEARNED = (0.0, 0.35)
"""Slips from which the offset is learned [-]."""
JUDGES = {"I-loose": "dimers", "K-loose": "tetrahedra"}
"""Soils that nothing is learned from: other shapes of grains."""
MIDDLE_MM = 14.0
"""Between both depths [mm]."""
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00")
"""Of soils."""
DING = "wheel:314.7x165"
WORDS = """\
A wheel of 120 by 25 mm rolled through loose spheres of 6 mm, made by one code, at a constant \
depth and a given slip. φ is that of `terraphi invert --tool wheel:120x25 --grain-size 6`, less \
that measured in a shear cell; the offset of a soil is learned from the other soils of spheres, \
and nothing from clumps. {n} \
runs with slips of 0 to 0.3, at two depths each, have errors of {rms:.1f}° (root mean square), \
by resistive force theory without an offset (`rft`) {rft_rms:.1f}° ({rft_bias:+.1f}° on average). \
Soils are read too far apart, and \
deeper wheels higher than shallow ones by {deeper:+.1f}°. No change with the slip is learned from \
grains but for braked wheels.

A published wheel (Ding et al. 2011, smooth, 80 N, sand with a friction angle printed as 31.9° \
and 0.25 kPa of cohesion, by a test that we have not seen) gives {foot:.0f} ± {sd:.1f}° for all \
its slips together, {rft:.0f}° by `rft`. As a true cohesion 0.25 kPa would bear 9 of the 12 kPa \
under it at no slip (c N_c), and φ be far lower; `--cohesion` is refused. Bekker's law with \
handbook numbers of dry sand (n = 1.1, k_φ = 1528 kN/m³·¹, k_c = 0.99 kN/m²·¹) has a sinkage of \
12 mm at no slip, where 5 mm were measured."""
LIMITS = """\
- **Slip.** Of a rim's tangential velocity the law counts a part as large as the friction as \
motion against the soil, as wheels by the material point method show \
([data](../studies/data/wheel_slip.csv)): with all of it φ would rise by 4° from a slip of 0.2 to \
0.5. As it is, φ changes by {driven:+.1f}° in grains under a rim of a friction of 0.35, by \
{ding:+.1f}° on that sand, with 0.55, and by {under_lugs:+.1f}° under lugs, where all of it \
counts, as for a wheel that `soil.force` has as a mesh. Without slip the answer takes off 1.3°, by \
the same simulations; grains have {free:+.1f}°. \
Rims of 0.2, 0.35 and 0.5 read the same φ within {rough:.1f}°. Wheels of 180 mm, of which \
nothing was learned, read {large}. Braked wheels read \
{braked:.0f}° more at a slip of −0.3, for they push a mound. Nothing was learned beyond −0.5 \
and 0.6.
- **Pull and torque** do not depend on φ at a given sinkage. They show the friction of the rim, \
and contradictions: pull without torque, torque that no soil bears.
- **Lugs** closer than three times their height count as a rough rim of the radius to their \
tips; from six times on the rim bears the load, and the lugs cut in; between, in part. They add \
pull that is not in the law. Wheels with twelve and 36 \
lugs of 6 mm in soils A, B and C have errors of {lugs} (slips of 0.2 and 0.5, two depths).
- **Without a sinkage** torque and pull together show the resistance, and by it φ: here with \
errors of {bias:+.1f}° on average and {rms:.1f}° (root mean square), stated ± {stated:.1f}° \
({inside:.0f} % within 95 %). Pull \
or torque alone show the friction of the rim: the answer is the prior, 18 to 50°."""
MEANS = ("slip", "soil A, 20°", "soil B, 26°", "soil C, 32°", "clumps, 30 and 32°", "stated ±")
PICTURE = (
    "Left: error of the friction angle over the slip for wheels in simulated soils; middle and "
    "right: sinkage, pull and torque over slip of a published wheel, measured and by the law"
)


@dataclass(frozen=True)
class Wheeled:
    """One wheel at one depth in grains."""

    name: str
    soil: str
    truth_deg: float
    slip: float
    read_deg: float
    """φ by law foot, half a grain added to the sinkage, before any offset [deg]."""
    rft_deg: float
    depth_mm: float
    pull: float
    """Over the load [-]."""
    torque: float
    """Over load times radius [-]."""
    load_N: float
    density: float
    wheel: Wheel
    friction: float
    """Of the rim [-]."""
    stated: terraphi.Answer
    unsunk: terraphi.Answer
    """Without the sinkage."""


def wheels() -> list[Wheeled]:
    """All wheels in grains, at each depth at which their axle moves level."""
    rows = []
    for path in sorted(grains.GRAINS.glob("*_wheel_*.csv")):
        name, body = path.stem.rsplit("_", 1)[0].split("_", 1)
        size, slip = body.split("_")[1], float(body.rpartition("_s")[2])
        tool = f"wheel:{size.replace('+', '+lugs:')}"
        head = path.read_text(encoding="utf-8")
        density = re.findall(r"density (\d+)", head)[0]
        table = pd.read_csv(path, comment="#")
        radius = 1e3 * Tool.of(tool).radius
        for depth in sorted(set(table.sinkage_mm)):
            level = table[(table.sinkage_mm - depth).abs() < 0.01]
            level = level[level.travel_mm > level.travel_mm.min() + SETTLED * radius]
            if len(level) < 10:
                continue
            mean = level.mean()
            row = {"slip": [slip], **{key: [mean[key]] for key in ("load_N", "sinkage_mm")}}
            options = {
                "tool": tool, "density": f"{density}±0", "columns": {"slip_is": "travel"},
                "grain_size_mm": run.soils()[name].median_mm,
            }  # fmt: skip
            answer, by_rft = (
                terraphi.invert(pd.DataFrame(row), law=law, **options) for law in (None, "rft")
            )
            forces = {name: [mean[name]] for name in ("load_N", "pull_N", "torque_Nm")}
            unsunk = terraphi.invert(pd.DataFrame({"slip": [slip], **forces}), **options)
            back = float(WHEEL_ERROR.of(slip))
            rows.append(Wheeled(
                path.stem, name, grains.truth(name)[0], slip, answer.phi.median + back,
                by_rft.phi.median, depth, mean.pull_N / mean.load_N,
                1e3 * mean.torque_Nm / (mean.load_N * radius), mean.load_N, float(density),
                wheel_of(Tool.of(tool)), run.soils()[name].leg_friction, answer, unsunk,
            ))  # fmt: skip
    return rows


def learned(rows: list[Wheeled]) -> float:
    """Offset in spheres of wheels that are driven, without the effect of the slip [deg].

    Soils weigh alike.
    """
    low, high = LEARNED
    errors: dict[str, list[float]] = {}
    for row in rows:
        if low <= row.slip <= high and row.soil not in JUDGES:
            errors.setdefault(row.soil, []).append(error_of(row) + WHEEL_ERROR.offset_deg)
    return float(np.mean([np.mean(each) for each in errors.values()]))


def error_of(row: Wheeled) -> float:
    """φ less that of the shear cell, with the shipped error taken off [deg]."""
    return row.read_deg - row.truth_deg - float(WHEEL_ERROR.of(row.slip))


def change(rows: list[Wheeled], low: float, high: float) -> float:
    """Mean change of φ between two slips, within soils and depths [deg]."""
    read: dict[tuple[str, float], dict[float, list[float]]] = {}
    for row in rows:
        if row.soil not in JUDGES:
            by_slip = read.setdefault((row.soil, row.depth_mm), {})
            by_slip.setdefault(row.slip, []).append(row.read_deg)
    return float(np.mean([
        np.mean(each[high]) - np.mean(each[low]) for each in read.values() if {low, high} <= {*each}
    ]))  # fmt: skip


def resistance(row: Wheeled) -> float:
    """T/R − P over the load, less that of the law at the true φ [-]."""
    curve = rolling(
        row.wheel, row.load_N, row.slip, np.array([row.truth_deg]), np.array([row.density]),
        surface_friction=min(row.friction, FRICTIONS[-1]),
    )  # fmt: skip
    by_law = curve["torque_Nm"] / row.wheel.reach - curve["pull_N"]
    return row.torque - row.pull - float(by_law[0] / row.load_N)


def published_change(table: pd.DataFrame) -> float:
    """Change of φ of that wheel from a slip of 0.2 to 0.5, by least squares [deg]."""
    driven = table[table.slip >= 0.2]
    read = [
        terraphi.invert(driven.iloc[[i]], tool=DING, density=1605, friction="0.55±0.05").phi.median
        for i in range(len(driven))
    ]
    return 0.3 * float(np.polyfit(driven.slip, read, 1)[0])


def published() -> tuple[pd.DataFrame, terraphi.Answer, terraphi.Answer]:
    """The wheel of Ding et al. (2011), and its answers by laws foot and rft."""
    path = shipped_file("examples", "wheel", ".csv")
    by_foot, by_rft = (
        terraphi.invert(path, tool=DING, density=1605, law=law) for law in (None, "rft")
    )
    return pd.read_csv(path, comment="#"), by_foot, by_rft


def sinkages(table: pd.DataFrame, phi_deg: float, law: str) -> np.ndarray:
    """Sinkage of that wheel at each slip by a law [mm]."""
    wheel, depths = wheel_of(Tool.of(DING)), np.geomspace(1e-3, 0.09, 60)
    result = []
    for row in table.itertuples():
        borne = wheel_forces(
            wheel, depths, row.slip, phi_deg=phi_deg, density=1605.0, surface_friction=0.5, law=law
        ).load
        result.append(1e3 * np.interp(row.load_N, borne, depths))
    return np.array(result)


def drawn(rows: list[Wheeled], errors: list[float]) -> Figure:
    """Errors over the slip, and the published wheel's sinkage over its slip."""
    figure = Figure(figsize=(14.0, 3.8), layout="constrained")
    left, right, forces = figure.subplots(1, 3)
    soils = sorted({row.soil for row in rows})
    for soil, color in zip(soils, COLORS, strict=True):
        for is_deep in (False, True):
            points = [
                (row.slip, error) for row, error in zip(rows, errors, strict=True)
                if row.soil == soil and (row.depth_mm > MIDDLE_MM) == is_deep
            ]  # fmt: skip
            shape = color if is_deep else "none"
            label = "" if is_deep else JUDGES.get(soil, soil[0])
            left.plot(*np.array(points).T, "o", color=color, mfc=shape, label=label)
    left.axhline(0.0, color="0.4", lw=0.8)
    left.set(xlabel="slip", ylabel="φ less that of a shear cell [deg]",
             title="wheels in simulated grains (filled: deeper)")  # fmt: skip
    left.set_ylim(top=left.get_ylim()[1] + 3.0)
    left.legend(fontsize="small", ncols=5, loc="upper center", columnspacing=0.8)
    table, by_foot, by_rft = published()
    right.plot(table.slip, table.sinkage_mm, "ko", label="measured")
    for law, answer in (("foot", by_foot), ("rft", by_rft)):
        read = answer.phi.median + (WHEEL_ERROR.offset_deg if law == "foot" else 0.0)
        right.plot(table.slip, sinkages(table, read, law), label=f"law {law}, one φ")
    right.set(xlabel="slip", ylabel="sinkage [mm]", title="a published wheel (Ding et al. 2011)")
    right.legend(fontsize="small")
    slip = np.linspace(0.0, 0.6, 31)
    phi, density = np.array([by_foot.phi.median]), np.array([1605.0])
    wheel = wheel_of(Tool.of(DING))
    curve = rolling(wheel, 80.0, slip, phi, density, surface_friction=by_foot.leg_friction or 0.5)
    of_table = {"pull": table.pull_N, "torque over radius": table.torque_Nm / wheel.radius}
    by_law = curve["pull_N"][0], curve["torque_Nm"][0] / wheel.radius
    for (name, values), law_values, color in zip(of_table.items(), by_law, COLORS, strict=False):
        forces.plot(table.slip, values, "o", color=color, label=f"{name}, measured")
        forces.plot(slip, law_values, color=color, label=f"{name}, law foot")
    forces.set(xlabel="slip", ylabel="force [N]", title="the same wheel")
    forces.legend(fontsize="small")
    return figure


def means(rows: list[Wheeled], errors: list[float]) -> list[tuple[str, ...]]:
    """Means over both depths, a row for each slip."""
    table = pd.DataFrame({
        "soil": ["clumps" if row.soil in JUDGES else row.soil for row in rows],
        "slip": [row.slip for row in rows], "error": errors,
        "sd": [row.stated.phi.sd for row in rows],
    })  # fmt: skip
    soils = sorted(set(table.soil))
    lines = []
    for slip, part in table.groupby("slip"):
        of_soil = part.groupby("soil").error.mean()
        shown = (f"{of_soil[soil]:+.1f}°" if soil in of_soil else "" for soil in soils)
        lines.append((f"{slip:g}", *shown, f"{part.sd.mean():.1f}°"))
    return lines


def by_friction(rough: list[Wheeled], rows: list[Wheeled]) -> float:
    """Largest difference of φ between rims of other frictions and of 0.35 in soil B [deg]."""
    same = {(row.slip, round(row.depth_mm)): row.read_deg for row in rows
            if row.name.startswith("B-loose_") and row.name.endswith("_1")}  # fmt: skip
    return max(abs(row.read_deg - same[row.slip, round(row.depth_mm)]) for row in rough)


def main() -> None:
    """Print what is learned, and write the page."""
    out = pages.out_from(__doc__.splitlines()[0])
    all_rows = wheels()
    # Nothing is learned from the larger wheels, other rims and lugs.
    rows = [row for row in all_rows if "_120x25_" in row.name and "leg" not in row.soil]
    table, by_foot, by_rft = published()
    driven, braked = change(rows, 0.2, 0.5), change(rows, 0.0, -0.3)
    lugged = change([row for row in all_rows if "+" in row.name], 0.2, 0.5)
    shares = np.array([(row.truth_deg, row.slip, resistance(row)) for row in all_rows])
    print(f"WHEEL_ERROR: {learned(rows):.1f}, braked {braked / 0.3:.1f}")
    print(f"RESISTANCE_SD: {shares[:, 2].std():.3f} about {shares[:, 2].mean():+.3f}; by slip "
          + ", ".join(f"{slip:g}: {shares[shares[:, 1] == slip, 2].mean():+.2f}"
                      for slip in np.unique(shares[:, 1])))  # fmt: skip
    errors = [
        error_of(row) + WHEEL_ERROR.offset_deg
        - learned([other for other in rows if other.soil != row.soil])
        for row in rows
    ]  # fmt: skip
    inner, by_theory = np.array([
        (error, row.rft_deg - row.truth_deg)
        for error, row in zip(errors, rows, strict=True) if 0.0 <= row.slip <= 0.3
    ]).T  # fmt: skip
    header = ("soil", "slip", "sinkage", "φ less truth", "stated ±", "by rft", "pull / load",
              "torque / (load radius)")  # fmt: skip
    cells = [
        (row.soil, f"{row.slip:g}", f"{row.depth_mm:.0f} mm", f"{error:+.1f}°",
         f"{row.stated.phi.sd:.1f}°", f"{row.rft_deg - row.truth_deg:+.1f}°", f"{row.pull:+.2f}",
         f"{row.torque:.2f}")
        for row, error in zip(rows, errors, strict=True)
    ]  # fmt: skip
    words = WORDS.format(
        n=len(inner) // 2, rms=np.sqrt(np.square(inner).mean()),
        rft_rms=np.sqrt(np.square(by_theory).mean()), rft_bias=by_theory.mean(),
        foot=by_foot.phi.median, sd=by_foot.phi.sd, rft=by_rft.phi.median,
        deeper=np.mean([(1 if row.depth_mm > MIDDLE_MM else -1) * 2.0 * error
                        for row, error in zip(rows, errors, strict=True)]),
    )  # fmt: skip
    pages.excerpt(out, "wheels", header, cells, header[:6])
    unsunk = [row.unsunk.phi.median - row.truth_deg for row in all_rows]
    lugs, large = (
        [f"{error_of(row):+.1f}°" for row in all_rows if mark in row.name]
        for mark in ("+", "_180x")
    )  # fmt: skip
    parts = [
        words,
        pages.table(MEANS, means(rows, errors)),
        "All: [wheels.csv](wheels.csv).",
        LIMITS.format(
            lugs=", ".join(lugs),
            large=", ".join(large),
            driven=driven,
            ding=published_change(table),
            under_lugs=lugged,
            braked=braked,
            free=-change(rows, 0.0, 0.2),
            rough=by_friction([row for row in all_rows if "-leg" in row.soil], rows),
            bias=np.mean(unsunk),
            rms=np.sqrt(np.square(unsunk).mean()),
            inside=100.0
            * np.mean(
                [
                    row.unsunk.phi.ci95[0] < row.truth_deg < row.unsunk.phi.ci95[1]
                    for row in all_rows
                ]
            ),
            stated=np.mean([row.unsunk.phi.sd for row in all_rows]),
        ),
    ]
    pages.write(out, "wheels", "Wheels", parts, drawn(rows, errors), PICTURE)


if __name__ == "__main__":
    main()
