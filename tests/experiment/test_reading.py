"""One record written as people export theirs, by pandas and csv: the same forces come back."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import constants

from terraphi.experiment import tables
from terraphi.experiment.errors import InputError
from terraphi.experiment.measurements import measurement
from terraphi.experiment.reading import read_forces, read_trials
from terraphi.experiment.units import ANGLE, FORCE, MOMENT, unit_named

SHIPPED = measurement("li2013:yuma/straight").history
THETA, FX, FZ = SHIPPED.theta_deg, SHIPPED.Fx, SHIPPED.Fz
LBF, KGF = 4.4482216152605, 9.80665
N = len(THETA)

Export = tuple[bytes, dict[str, Any]]
EXPORTS: dict[str, Callable[[], Export]] = {}


def export(make: Callable[[], Export]) -> Callable[[], Export]:
    EXPORTS[make.__name__] = make
    return make


def frame(theta: Any = THETA, fx: Any = FX, fz: Any = FZ, names: str = "theta Fx Fz") -> Any:
    return pd.DataFrame(dict(zip(names.split(), (theta, fx, fz), strict=True)))


def text(table: Any, **options: Any) -> bytes:
    encoding = options.pop("encoding", "utf-8")
    return table.to_csv(index=options.pop("index", False), **options).encode(encoding)


@export
def german_excel_with_missing_values() -> Export:
    table = frame().set_axis(["Winkel [°]", "Fx (N)", "Fz (N)"], axis=1).astype(object)
    gaps = pd.DataFrame([["#N/A", 1.0, 2.0], [3.5, None, 2.0], [None] * 3], columns=table.columns)
    table = pd.concat([table[:9], gaps, table[9:]])
    return text(table, sep=";", decimal=",", encoding="utf-8-sig"), {}


@export
def utf16_without_a_mark() -> Export:
    return text(frame(names="angle Fx Fz"), sep="\t", encoding="utf-16-le"), {}


@export
def units_row() -> Export:
    body = text(frame(theta=np.radians(THETA), fx=FX / 1e3, fz=FZ / 1e3), header=False, sep="\t")
    return b"theta\tFx\tFz\nrad\tkN\tkN\n" + body, {}


@export
def units_row_among_other_columns() -> Export:
    table = frame().assign(Temp=21.5, Fy=0.3, time=0.01 * np.arange(N), note="ok")
    head = "theta,Fx,Fz,Temp,Fy,time,note\n[deg],[mN],[mN],[°C],[mN],[s],\n"
    table[["Fx", "Fz"]] *= 1e3
    return head.encode() + text(table, header=False), {}


@export
def extra_columns_in_another_order() -> Export:
    table = frame(names="theta_deg Fx_N Fz_N").assign(sample=range(N), Fy_N=0.1, valid=True)
    return text(table[["sample", "valid", "Fz_N", "Fy_N", "theta_deg", "Fx_N"]]), {}


@export
def savetxt() -> Export:
    stream = io.StringIO()
    table = np.stack([THETA, FX, FZ], axis=1)
    np.savetxt(stream, table, fmt="%.10g", header="theta_deg Fx_N Fz_N")
    return stream.getvalue().encode(), {}


@export
def matlab() -> Export:
    rows = [f"  {t: .7e}  {x: .7e}  {z: .7e}" for t, x, z in zip(THETA, FX, FZ, strict=True)]
    return "\n".join(["% theta [deg]   Fx [N]   Fz [N]", *rows]).encode(), {}


@export
def labview() -> Export:
    head = "LabVIEW Measurement\t\nSeparator\tTab\nTime\t10:11:12,5\n***End_of_Header***\t\n\n"
    table = frame(names="Angle Force_X Force_Z")
    table.insert(0, "X_Value", 0.01 * np.arange(N))
    return head.encode() + text(table, sep="\t", decimal=","), {}


@export
def header_with_line_breaks() -> Export:
    return text(frame().set_axis(["Angle", "Force X\n(N)", "Force Z\n(N)"], axis=1)), {}


@export
def angle_known_by_its_unit() -> Export:
    table = pd.DataFrame({"t": np.arange(N), "Motor Position (rad)": np.radians(THETA)})
    return text(table.assign(**{"Force horizontale (N)": FX, "fuerza_z": FZ})), {}


@export
def no_header() -> Export:
    columns = {"theta": "column 1", "fx": "column 2", "fz": "column 3"}
    return text(frame(), header=False, sep=" "), columns


@export
def index_and_clock() -> Export:
    return text(frame().assign(clock="12:00:01.5"), index=True), {}


@export
def fixed_width_columns() -> Export:
    return frame(names="theta_deg Fx_N Fz_N").to_string(index=False).encode(), {}


@export
def metadata_above_the_header() -> Export:
    head = "Prüfstand 3\nDatum;27.11.2026\nBeinlänge;76,2;mm\n\n% sand, dry\n"
    body = text(frame(names="Leg_angle_deg Force_X Force_Z"), sep=";", decimal=",")
    return head.encode() + body, {}


@export
def pounds_and_radians_given() -> Export:
    table = frame(theta=np.radians(THETA), fx=FX / LBF, fz=FZ / LBF, names="q load_a load_b")
    return text(table), {
        "theta": "q", "fx": "load_a", "fz": "load_b", "unit": "lbs", "theta_unit": "radians",
    }  # fmt: skip


@export
def angle_from_zero_and_turned() -> Export:
    table = frame(theta=140.0 - THETA)[::-1]
    return text(table), {"theta_offset_deg": -140.0, "theta_sign": -1}


@export
def force_on_the_soil() -> Export:
    return text(frame(fx=-FX, fz=-FZ)), {"force_on": "soil"}


@export
def z_down() -> Export:
    return text(frame(fz=-FZ)), {"fz_sign": -1}


@export
def load_cell_turned_by_its_mount() -> Export:
    """What it reads are the components along its axes; its z axis tips forward by 30°."""
    forward, up = np.array([np.cos(np.pi / 6), -0.5]), np.array([0.5, np.cos(np.pi / 6)])
    force = np.column_stack([FX, FZ])
    return text(frame(fx=-(force @ forward), fz=force @ up)), {
        "sensor_angle_deg": 30.0, "fx_sign": -1,
    }  # fmt: skip


def on_the_leg(fx: Any = FX, fz: Any = FZ) -> Any:
    """Forces along the leg, from tip to hip, and across it, ahead of it where it hangs down.

    The tip is at (-sin θ, -cos θ): θ is negative ahead of the hip.
    """
    tip = np.stack([-np.sin(np.radians(THETA)), -np.cos(np.radians(THETA))])
    return -tip[0] * fx - tip[1] * fz, -tip[1] * fx + tip[0] * fz


@export
def load_cell_on_the_leg() -> Export:
    along, across = on_the_leg()
    return text(frame(fx=across, fz=along)), {"sensor_turns": True}


@export
def load_cell_on_the_leg_with_its_axis_across() -> Export:
    """Its z axis points forward where the leg hangs down, and its x axis then down."""
    along, across = on_the_leg()
    return text(frame(fx=-along, fz=across)), {"sensor_turns": True, "sensor_angle_deg": 90.0}


@export
def counts_of_an_encoder() -> Export:
    """4096 to a turn, from a zero of its own, which grows over its full turn."""
    counts = (THETA + 150.0) * 4096 / 360
    return text(frame(counts, names="Encoder[counts] Fx Fz")), {
        "theta": "Encoder", "theta_scale": 360 / 4096, "theta_offset_deg": -150.0,
    }  # fmt: skip


@export
def encoder_that_wraps() -> Export:
    return text(frame(theta=THETA % 360.0)), {}


@export
def shuffled_rows() -> Export:
    return text(frame().sample(frac=1.0, random_state=0)), {}


@export
def falling_rows_with_line_ends_of_windows() -> Export:
    return text(frame()[::-1], lineterminator="\r\n"), {}


@export
def repeats_of_a_coarse_encoder() -> Export:
    jitter = np.tile([-0.3, 0.1, 0.2], N)
    each = [np.repeat(column, 3) for column in (THETA, FX, FZ)]
    return text(frame(each[0], each[1] + jitter, each[2] - jitter)), {}


@export
def time_at_a_stated_rate() -> Export:
    table = frame(theta=(THETA + 132.0) / 30.0 * 1e3, names="time_ms Fx Fz")
    return text(table), {"rate_deg_s": 30.0, "theta_offset_deg": -132.0}


@export
def stroke_forth_and_back() -> Export:
    back = frame(fx=0.2 * FX, fz=0.2 * FZ)[::-1]
    return text(pd.concat([frame(), back])), {}


@export
def quoted_with_trailing_separators() -> Export:
    stream = io.StringIO()
    writer = csv.writer(stream, delimiter=";", quoting=csv.QUOTE_ALL)
    writer.writerow(["theta", "Fx", "Fz", ""])
    writer.writerows([t, x, z, ""] for t, x, z in zip(THETA, FX, FZ, strict=True))
    return stream.getvalue().encode(), {}


@export
def groups_of_thousands_and_minus_signs() -> Export:
    def german(value: float) -> str:
        return f"{value:,.6f}".translate(str.maketrans(",.", ".,")).replace("-", "\u2212")

    rows = [";".join(map(german, row)) for row in zip(THETA, 1e3 * FX, 1e3 * FZ, strict=True)]
    return "\n".join(["theta;Fx/mN;Fz/mN", *rows]).encode(), {}


@pytest.mark.parametrize("name", EXPORTS)
def test_every_export_gives_the_same_forces(name: str, tmp_path: Path) -> None:
    content, options = EXPORTS[name]()
    (tmp_path / "x.csv").write_bytes(content)
    history = read_forces(tmp_path / "x.csv", **options)
    assert history.theta_deg == pytest.approx(THETA, abs=1e-6)
    assert history.Fx == pytest.approx(FX, abs=1e-6)
    assert history.Fz == pytest.approx(FZ, abs=1e-6)
    notes = " ".join(history.provenance.get("reading", []))
    lost = {"german_excel_with_missing_values": "2 of 267", "stroke_forth_and_back": "way back"}
    assert lost.get(name, "") in notes


@settings(max_examples=75)
@given(data=st.data())
def test_any_mixture_of_habits_gives_the_same_forces(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    def choose(*values: Any) -> Any:
        return data.draw(st.sampled_from(values))

    angle, degrees = choose(("deg", 1.0), ("°", 1.0), ("rad", np.degrees(1.0)), ("rev", 360.0))
    unit, newtons = choose(("N", 1.0), ("kN", 1e3), ("mN", 1e-3), ("lbf", LBF), ("kgf", KGF))
    style = choose("{} [{}]", "{} ({})", "{}/{}", "{} in {}", "{}_{}", "row")
    names = [choose("theta", "Angle", "leg angle", "WINKEL", "θ")]
    names += choose(("Fx", "Fz"), ("Force X", "Force Z"), ("F_x", "F_z"), ("Kraft x", "Kraft z"))
    units = [angle, unit, unit]
    heads = [n if style == "row" else style.format(n, u) for n, u in zip(names, units, strict=True)]
    separator, decimal = choose((",", "."), (";", ","), (";", "."), ("\t", ","), ("\t", "."))
    quoting = choose(csv.QUOTE_MINIMAL, csv.QUOTE_NONNUMERIC)
    table = frame(THETA / degrees, FX / newtons, FZ / newtons).set_axis(heads, axis=1)
    if choose(False, True):
        table.insert(data.draw(st.integers(0, 3)), "note", choose("a", 1, None))
    if choose(False, True):
        table = table.sample(frac=1.0, random_state=1)
    head, _, body = table.to_csv(
        sep=separator, decimal=decimal, quoting=quoting, index=choose(False, True),
        lineterminator=choose("\n", "\r\n"),
    ).partition("\n")  # fmt: skip
    if style == "row":
        place = dict(zip(heads, units, strict=True))
        cells = next(csv.reader([head.rstrip("\r")], delimiter=separator))
        body = separator.join(place.get(cell, "") for cell in cells) + "\n" + body
    content = choose("", "# 27.11.2026\n\n", "Day;3\n") + head + "\n" + body
    file = tmp_path_factory.getbasetemp() / "habits.csv"
    encodings = ("utf-8", "utf-8-sig", "utf-16") + (() if "θ" in content else ("cp1252",))
    file.write_bytes(content.encode(choose(*encodings)))
    history = read_forces(file)
    assert history.theta_deg == pytest.approx(THETA, abs=1e-6)
    assert np.abs(history.force - SHIPPED.force).max() < 1e-6


def test_pandas_reads_the_same_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Long tables are read by pandas, short ones are not."""
    odd = 'a,b,c\n1,-nan,0.1\n2\n3,<NA>,1e400\n 4 ,Infinity,x\n5,"6",-1.#IND\n'
    path = tmp_path / "forces.txt"
    for content in (odd.encode(), *(make()[0] for make in EXPORTS.values())):
        path.write_bytes(content)
        short = tables.read_table(path)
        with monkeypatch.context() as patch:
            patch.setattr(tables, "_SHORT", 0)
            long = tables.read_table(path)
        assert short.words == long.words
        pd.testing.assert_frame_equal(
            pd.DataFrame(short.columns), pd.DataFrame(long.columns), check_exact=True
        )


def test_tables_in_memory_give_the_same_forces() -> None:
    table = frame(names="theta_deg Fx_N Fz_N")
    dataset = xr.Dataset(
        {"Fx": ("theta", FX / 1e3, {"units": "kN"}), "Fz": ("theta", FZ / 1e3, {"units": "kN"})},
        {"theta": ("theta", np.radians(THETA), {"units": "rad"})},
    )
    for source in (table, table.set_index("theta_deg"), table.astype(str), dataset):
        history = read_forces(source)
        assert history.theta_deg == pytest.approx(THETA, abs=1e-6)
        assert np.abs(history.force - SHIPPED.force).max() < 1e-6


def test_jitter_of_the_encoder_is_averaged() -> None:
    rng, theta = np.random.default_rng(0), np.linspace(-90.0, 90.0, 20_000)
    fx, fz = 5.0 * np.cos(np.radians(theta)), np.sin(np.radians(2.0 * theta))
    history = read_forces(frame(theta + 0.05 * rng.standard_normal(theta.size), fx, fz))
    assert 700 < history.position.size < 730
    # 28 readings a bin, each off by 0.05° times a slope of 0.09 N/°: 0.0008 N, and five times that.
    assert history.Fx == pytest.approx(5.0 * np.cos(history.position), abs=4e-3)
    assert history.Fz == pytest.approx(np.sin(2.0 * history.position), abs=4e-3)


@pytest.mark.parametrize("back", [False, True])
def test_strokes_are_trials(back: bool) -> None:
    tables = []
    for gain in (1.0, 0.9, 1.1):
        tables.append(frame(fx=gain * FX, fz=gain * FZ))
        if back:
            tables.append(frame(fx=0.2 * FX, fz=0.2 * FZ)[::-1])
    trials = read_trials(pd.concat(tables))
    assert len(trials) == 3
    for gain, item in zip((1.0, 0.9, 1.1), trials, strict=True):
        inside = np.abs(item.theta_deg) < 90.0
        expected = gain * np.interp(item.theta_deg, THETA, FX)
        assert item.Fx[inside] == pytest.approx(expected[inside], abs=1e-6)
    with pytest.raises(InputError, match="3 strokes"):
        read_forces(pd.concat(tables))


def test_glitches_of_the_encoder_are_left_out() -> None:
    theta = THETA.copy()
    theta[[50, 120, 190]] = [-999.0, 400.0, 0.0]
    history = read_forces(frame(theta))
    kept = np.delete(np.arange(N), [50, 120, 190])
    assert history.theta_deg == pytest.approx(THETA[kept])
    assert history.Fz == pytest.approx(FZ[kept])


@pytest.mark.parametrize("code", [-999.0, 9999.0])
def test_codes_of_lost_readings_are_no_numbers(code: float) -> None:
    lost = np.isin(np.arange(N), [60, 61, 62, 150])
    history = read_forces(frame(fx=np.where(lost, code, FX), fz=np.where(lost, code, FZ)))
    assert history.theta_deg == pytest.approx(THETA[~lost])
    assert history.Fx == pytest.approx(FX[~lost])
    # One alone may be a spike, and larger forces have such values.
    large = 999.0 * FX / np.abs(FX).max()
    assert len(read_forces(frame(fx=np.where(lost, 999.0, large))).Fx) == N


def test_turns_of_a_rotating_leg_are_trials() -> None:
    theta = np.arange(-180.0, 900.0, 1.0)
    angle = (theta + 180.0) % 360.0 - 180.0
    inside = np.abs(angle) < 132.0
    table = frame(theta, *(np.where(inside, np.interp(angle, THETA, f), 0.0) for f in (FX, FZ)))
    trials = read_trials(table)
    assert len(trials) == 3
    for item in trials:
        assert item.between(*np.radians([-90.0, 90.0])).Fz == pytest.approx(FZ[42:-42], abs=1e-6)


def test_a_moment_may_replace_forces() -> None:
    """Where nothing else is in the table, or where it is named."""
    alone = pd.DataFrame({"angle": THETA, "torque [N m]": FZ})
    assert read_forces(alone).channels == ("M",)
    assert read_forces(alone.assign(Fz=FZ)).channels == ("Fz", "M")
    more = alone.assign(A=FX, B=FZ)
    with pytest.raises(InputError, match="moment="):
        read_forces(more)
    history = read_forces(more, moment="torque")
    assert history.channels == ("M",)
    assert history.channel("M") == pytest.approx(-FZ)


def test_the_moment_comes_along() -> None:
    """As that of the soil, which resists, whether it was given so or as the motor's."""
    for sign in (1.0, -1.0):
        history = read_forces(frame().assign(**{"M [N mm]": sign * 1e3 * FZ}))
        assert history.moment == pytest.approx(-FZ)
    for other in ("M [kg]", "torque [A]"):  # not a moment, and no reason to refuse the table
        assert read_forces(frame().assign(**{other: 1.0})).moment is None


@pytest.mark.parametrize(
    "names",
    ["angle drag lift", "Winkel horizontal vertikal", "Winkel KraftHorizontal KraftVertikal"],
)
def test_forces_have_other_names(names: str) -> None:
    history = read_forces(frame(names=names))
    assert history.force == pytest.approx(SHIPPED.force)
    assert read_forces(frame().rename(columns={"Fz": "vertical load"})).Fz == pytest.approx(FZ)


def test_units_are_those_of_scipy() -> None:
    pound, foot, inch = constants.lbf, constants.foot, constants.inch
    ours = {**FORCE, **MOMENT, **{name: np.radians(value) for name, value in ANGLE.items()}}
    reference = {
        "lbf": pound, "ozf": pound / 16, "kgf": constants.kgf, "dyn": constants.dyn,
        "N mm": 1e-3, "N cm": 1e-2, "kgf cm": constants.kgf / 100, "kgf m": constants.kgf,
        "lbf ft": pound * foot, "lbf in": pound * inch, "ozf in": pound / 16 * inch,
        "deg": constants.degree, "rad": 1.0, "rev": 2 * np.pi, "gon": np.pi / 200, "mrad": 1e-3,
    }  # fmt: skip
    assert {name: ours[name] for name in reference} == pytest.approx(reference, rel=1e-9)
    for written, name in (
        ("°", "deg"), ("Lbs", "lbf"), ("N·m", "N m"), ("mN", "mN"), ("MN", "MN"), ("KN", "kN"),
        ("Newton", "N"), ("[µs]", "us"), ("foo", None), ("", None),
    ):  # fmt: skip
        assert unit_named(written) == name


# -- what is wrong -------------------------------------------------------------------------------


def test_a_unit_that_contradicts_the_header_is_one_sentence() -> None:
    table = frame(names="theta_deg Fx_kN Fz_kN")
    assert read_forces(table, unit="kN", theta_unit="deg").Fx == pytest.approx(1e3 * FX)
    with pytest.raises(InputError, match="'Fx_kN' and 'Fz_kN' are in kN by the header") as caught:
        read_forces(table, unit="N")
    assert str(caught.value).count("unit=N") == 1
    with pytest.raises(InputError, match="write rad in place of deg in the header"):
        read_forces(table.assign(theta_deg=np.radians(THETA)))


@pytest.mark.parametrize("columns", ["fx=", "fz=Fz,fx", "fx=''", {"fx": ""}, "unit="])
def test_a_key_without_a_value_is_refused(columns: Any) -> None:
    key = "unit" if "unit" in columns else "fx"
    with pytest.raises(InputError, match=f"^columns: {key}: is empty; give"):
        read_trials(frame(), columns)
    assert read_trials(frame(), "fx=Fx, ")[0].Fx == pytest.approx(FX)


def test_the_table_of_a_wheel_is_named_as_such() -> None:
    table = frame(names="slip load sinkage")
    with pytest.raises(InputError, match="--tool wheel:DIAMETERxWIDTH") as caught:
        read_forces(table)
    assert "--columns" not in str(caught.value)


@pytest.mark.parametrize(
    ("table", "remedy"),
    [
        (frame(theta=np.radians(THETA)), {"theta_unit": "rad"}),
        (frame(theta=THETA + 132.0), {"theta_offset_deg": -132.0}),
        (frame(theta=180.0 + THETA), {"theta_offset_deg": -180.0}),
        (frame(theta=132.0 - THETA)[::-1], {"theta_offset_deg": -132.0, "theta_sign": -1}),
        (
            pd.concat([frame(theta=-THETA), frame(theta=-THETA, fx=0.2 * FX, fz=0.2 * FZ)[::-1]]),
            {"theta_sign": -1},
        ),
    ],
)
def test_an_impossible_angle_is_refused_with_the_option_that_mends_it(
    table: Any, remedy: dict[str, Any]
) -> None:
    with pytest.raises(InputError) as caught:
        read_forces(table)
    offered = str(caught.value).partition("--columns ")[2]
    result = dict(pair.split("=") for pair in offered.split(","))
    assert {key: float(v) if key != "theta_unit" else v for key, v in result.items()} == remedy
    assert read_forces(table, **remedy).theta_deg == pytest.approx(THETA, abs=1e-6)


@pytest.mark.parametrize(
    ("factor", "given", "key", "right"),
    [
        (4096 / 360, {}, "theta_scale", 360 / 4096),
        (-4096 / 360, {}, "theta_scale", 360 / 4096),
        (1.0, {"theta_unit": "rad"}, "theta_unit", "deg"),
        (3.0, {"rate_deg_s": 2.0, "theta": None}, "rate_deg_s", 2.0 / 3.0),
    ],
)
def test_an_angle_over_which_no_leg_is_in_soil_is_refused_with_its_scale(
    factor: float, given: dict[str, Any], key: str, right: Any
) -> None:
    """By the usual path in soil, so that it is right within a third."""
    name = "time" if "rate_deg_s" in given else "theta"
    along = factor * THETA / (2.0 if name == "time" else 1.0)
    with pytest.raises(InputError, match="the leg is in soil over") as caught:
        read_forces(frame(along, names=f"{name} Fx Fz"), **given)
    offered = str(caught.value).partition(f"--columns {key}=")[2].split()[0]
    if key == "theta_unit":
        assert offered == right
    else:
        assert float(offered) == pytest.approx(right, rel=0.35)


@pytest.mark.parametrize(
    "given",
    [
        {"theta_scale": 0.1, "theta_unit": "rad"},
        {"theta_scale": 0.1, "rate_deg_s": 3.0},
        {"theta_scale": 0.0},
        {"sensor_angle_deg": 200.0},
    ],
)
def test_a_scale_and_a_turn_are_checked(given: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(given))):
        read_forces(frame(), **given)
    with pytest.raises(InputError, match="one of them is missing"):
        read_forces(frame()[["theta", "Fx"]].assign(torque=FZ), sensor_angle_deg=30.0)
    with pytest.raises(InputError, match="one of them is missing"):
        read_forces(frame()[["theta", "Fx"]].assign(torque=FZ), sensor_turns=True)
    for value in ("True", "yes", 1):
        with pytest.raises(InputError, match="true or false"):
            read_forces(frame(), sensor_turns=value)


@pytest.mark.parametrize("weight", [0.0, 4.0])
def test_a_load_cell_on_the_leg_is_tared_in_its_axes(weight: float) -> None:
    """Its zero is constant there, and the weight of what hangs from it turns.

    Both are recovered exactly where the forces in air are zero.
    """
    loaded = np.abs(THETA) < 76.0
    fx, fz = loaded * FX, loaded * FZ
    along, across = on_the_leg(fx, fz - weight)
    table = frame(fx=across + 3.0, fz=along - 5.0)
    air = {"air_before_deg": -78.0, "air_after_deg": 78.0}
    read = read_forces(table, sensor_turns=True, **air)
    np.testing.assert_allclose(read.Fx, fx, atol=1e-6)
    np.testing.assert_allclose(read.Fz, fz, atol=1e-6)


def test_the_steps_of_a_coarse_load_cell_turn_with_it() -> None:
    """Steps of 0.5 and 0.2 N are errors of q/√12 along its axes, independent of each other."""
    coarse = frame(fx=0.5 * np.round(FX / 0.5), fz=0.2 * np.round(FZ / 0.2))
    history = read_forces(coarse, sensor_angle_deg=30.0).provenance["resolution"]
    expected = np.sqrt([0.75 * 0.25 + 0.25 * 0.04, 0.25 * 0.25 + 0.75 * 0.04])
    assert [history["Fx"], history["Fz"]] == pytest.approx(expected, rel=1e-3)


def timed(*pieces: tuple[Any, Any]) -> Any:
    """A table with a time and no angle, 0.1 s a row, of pieces of Fx and Fz."""
    fx, fz = (np.concatenate(column) for column in zip(*pieces, strict=True))
    noise = 0.005 * np.ptp(FZ) * np.random.default_rng(0).standard_normal((2, len(fx)))
    return frame(0.1 * np.arange(len(fx)), fx + noise[0], fz + noise[1], "time_s Fx Fz")


AIR = (np.zeros(60), np.zeros(60))
RATE = {"rate_deg_s": 10.0, "theta_offset_deg": -132.0}


def test_a_second_stroke_is_named_where_there_is_a_time_alone() -> None:
    with pytest.raises(InputError, match="meets the soil") as caught:
        read_trials(timed((FX, FZ), AIR, (-0.2 * FX[::-1], 0.2 * FZ[::-1]), AIR, (FX, FZ)), RATE)
    words = str(caught.value).partition("soil at ")[2].split()
    begins, again = float(words[0]), float(words[words.index("at") + 1])
    assert again - begins == pytest.approx(0.1 * (2 * N + 120), abs=1.0)
    # A leg that goes round evenly, and a clock that starts anew with each stroke, are trials.
    turning = timed((FX, FZ), (np.zeros(360 - N),) * 2, (FX, FZ))
    anew = pd.concat([timed((FX, FZ)), timed((FX, FZ))])
    for table in (turning, anew):
        assert len(read_trials(table, RATE)) == 2


def test_all_that_is_wrong_is_reported_at_once(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(
        "angle_1,angle_2,Fx [foo],Fy\n" + "".join(f"{t},{t},{t},1\n" for t in range(-80, 81, 4))
    )
    with pytest.raises(InputError) as caught:
        read_forces(tmp_path / "x.csv")
    for part in ("'angle_1' or 'angle_2'", "'foo'", "no column of Fz"):
        assert part in str(caught.value)


@pytest.mark.parametrize("separator", ["\t", ";"])
def test_decimal_commas_with_three_decimals_are_no_thousands(
    tmp_path: Path, separator: str
) -> None:
    theta = np.arange(-75, 76)
    fx, fz = 4.0 * np.cos(np.radians(theta)), -0.9 * np.sin(np.radians(theta))
    rows = [separator.join([str(t), f"{x:.3f}".replace(".", ","), f"{z:.3f}".replace(".", ",")])
            for t, x, z in zip(theta, fx, fz, strict=True)]  # fmt: skip
    header = separator.join(["theta [deg]", "Fx [N]", "Fz [N]"])
    (tmp_path / "f.txt").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    [history] = read_trials(tmp_path / "f.txt")
    np.testing.assert_allclose(history.Fx, fx, atol=6e-4)
    np.testing.assert_allclose(history.Fz, fz, atol=6e-4)


@pytest.mark.parametrize("word", ["#N/A", "#DIV/0!"])
def test_errors_of_spreadsheets_are_missing_values_and_no_comments(
    tmp_path: Path, word: str
) -> None:
    rows = [f"{word if t == 0 else t},{t},{t + 1}" for t in range(-80, 81, 4)]
    (tmp_path / "x.csv").write_text("\n".join(["# N/A is missing", "theta_deg,Fx_N,Fz_N", *rows]))
    history = read_forces(tmp_path / "x.csv")
    assert len(history.position) == len(rows) - 1
    assert any("1 of 41 rows" in note for note in history.provenance["reading"])
