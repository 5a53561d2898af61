"""Damaged files of every kind: an answer or one sentence, never a stack, and in bounds.

As a script, it prints how a number of them ends, by kind of file: python test_damaged_files.py 500
"""

from __future__ import annotations

import contextlib
import io
import json
import random
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pytest

MOST_SECONDS, MOST_BYTES = 10, 1 << 30
LETTERS = 200_000
MEASURED = "li2013:yuma/c"
INVERT = f"invert {MEASURED} --law"
POINTS = "map points.csv --dem dem.tif --draws 16 --out made"
WALKED = "map FILE --dem dem.tif --start 5,5,60 --draws 16 --out made"
COMMANDS = {
    "answer/answer.nc": ("report FILE --out r.html", "export FILE --to newton --draws 3 --anyway"),
    "answer/answer.json": ("export FILE --to chrono-scm --anyway",),
    "answer/manifest.json": ("report answer --out r.html",),
    "simulation.nc": ("report FILE --out r.html", "invert FILE --law rft3d"),
    "library.nc": ("library show FILE", "report FILE --out r.html"),
    "footfalls.nc": ("report FILE --out r.html", WALKED),
    "forces.nc": ("report FILE --out r.html",),
    "law.nc": (f"{INVERT} FILE",),
    "calibration.toml": (f"{INVERT} rft3d --calibration FILE",),
    "scenario.toml": ("simulate FILE",),
    "plan.toml": ("library build FILE --out built.nc",),
    "columns.toml": ("invert forces.csv --rig li2013 --leg c --law rft3d --columns FILE",),
    "robot.toml": ("forces log.csv --robot FILE",),
    "forces.csv": ("invert FILE --rig li2013 --leg c --law rft3d",),
    "day.csv": ("invert --table FILE --rig li2013 --leg c --law rft3d",),
    "points.csv": (POINTS,),
    "map/map.json": ("report map --out r.html",),
    "dem.tif": (POINTS,),
    "log.csv": ("forces FILE",),
    "log.mcap": ("forces FILE",),
    "bag/bag.db3": ("forces bag",),
    "bag/metadata.yaml": ("forces bag",),
}
"""File to the commands that read it."""


class Slow(BaseException):
    """A command took too long."""


class Ending(NamedTuple):
    """How a command ended: ``good``, or what is wrong with it."""

    kind: str
    about: str


def make_files(folder: Path) -> None:
    """Write a whole file of every kind."""
    import rasterio
    from go2.logs import write_csv, write_mcap, write_rosbag2

    import terraphi
    from terraphi.cli.main import cli
    from terraphi.inference.footfalls import FootfallMap
    from terraphi.laws.store import Case
    from terraphi.robot.joint_log import JointLog

    terraphi.invert(MEASURED, law="rft3d").save(folder / "answer")
    quick = Path(terraphi.__file__).with_name("data") / "scenarios" / "quick.toml"
    shutil.copy(quick, folder / "scenario.toml")
    scenario = terraphi.Scenario.load(folder / "scenario.toml")
    terraphi.simulate(scenario).to_netcdf(folder / "simulation.nc")
    angles = [{"leg.shape": "c", "soil.friction_angle_deg": phi} for phi in (20.0, 30.0, 40.0)]
    cases = [
        Case(item, terraphi.simulate(item)) for item in (scenario.replace(**x) for x in angles)
    ]
    terraphi.Library("small", tuple(cases)).save(folder / "library.nc")
    shutil.copy(quick.parents[1] / "laws" / "legs.nc", folder / "law.nc")
    place, item = np.linspace(0.0, 10.0, 8), np.ones(8)
    walk = FootfallMap(
        time=place, foot=("FR", "FL", "RR", "RL") * 2, place=np.column_stack([place, place, place]),
        sinkage=0.02 * item, phi=30.0 + item, sd=item, shared_sd=3.0 * item, misfit=item,
        verdict=("usable",) * 8, path=np.column_stack([place, place, place]), path_phi=30.0 + item,
        path_relative_sd=item, path_absolute_sd=3.0 * item, shared={"density": 1.0},
        by_law={"rft": 31.0}, warnings=("a note",), provenance={"law": "foot"},
    )  # fmt: skip
    walk.to_netcdf(folder / "footfalls.nc")
    time = np.arange(0.0, 2.0, 0.01)
    angle = np.tile([0.0, 0.7, -1.4], (len(time), 4, 1)) + 0.1 * np.sin(time)[:, None, None]
    torque = np.tile([0.1, -0.3, 4.0], (len(time), 4, 1)) * (1.0 + np.sin(9 * time)[:, None, None])
    log = JointLog(time, angle, 0.1 * angle, torque, np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1)),
                   np.zeros((len(time), 3)), np.tile([0.0, 0.0, 9.81], (len(time), 1)))  # fmt: skip
    write_csv(folder / "log.csv", log)
    write_mcap(folder / "log.mcap", log)
    write_rosbag2(folder / "bag", log)
    terraphi.foot_forces(log).to_netcdf(folder / "forces.nc")
    terraphi.measurement(MEASURED).history.to_csv(folder / "forces.csv")
    (folder / "columns.toml").write_text('theta = "theta_deg"\nfx = "Fx_N"\nfz = "Fz_N"\n')
    (folder / "robot.toml").write_bytes(quick.parents[1].joinpath("robots/go2.toml").read_bytes())
    shutil.copy(quick.parents[1] / "robots" / "go2.xml", folder)
    (folder / "day.csv").write_text(f"file,leg,density\nforces.csv,c,1500±50\n{MEASURED},,\n")
    sweep = "[sweep]\n'soil.friction_angle_deg' = [20.0, 30.0]\n[scenario]\nmodel = 'rft'\n"
    (folder / "plan.toml").write_text(f"name = 'small'\n{sweep}dimensions = 3\n")
    rows = [f"{x},{x},{30 + x % 3},2,1" for x in range(3, 18)]
    names = "# crs: EPSG:32611\nx_m,y_m,phi_deg,sd_deg,shared_sd_deg"
    (folder / "points.csv").write_text("\n".join([names, *rows]))
    heights = np.add.outer(0.5 * np.arange(20.0), 0.1 * np.sin(np.arange(20.0)))
    with rasterio.open(
        folder / "dem.tif", "w", driver="GTiff", height=20, width=20, count=1, dtype="float32",
        crs="EPSG:32611", transform=rasterio.Affine(1.0, 0.0, 0.0, 0.0, -1.0, 20.0), nodata=-9999.0,
    ) as file:  # fmt: skip
        file.write(heights.astype("float32"), 1)
    with contextlib.chdir(folder):
        for line in (
            "calibrate forces.csv --leg c --law rft3d --phi 30±2 --out calibration.toml",
            POINTS.replace("made", "map"),
        ):
            cli.main(line.split(), standalone_mode=False)


# -- damage ---------------------------------------------------------------------------------------


def odd_value(rng: random.Random) -> Any:
    return rng.choice([
        None, True, 0, -1, 10**30, 1e308, -0.5, "", "x", "é\n", [], [1], [[1.0, 2.0]], {}, {"a": 1},
        float("nan"), float("inf"), [None] * 3, "1" * 50, ["a", 2],
    ])  # fmt: skip


def spoil_json(text: str, rng: random.Random) -> str:
    """A JSON in which one value at a place chosen by chance is gone, moved or another."""
    content = json.loads(text)
    places: list[tuple[Any, Any]] = []

    def walk(value: Any) -> None:
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            places.append((value, key))
            if isinstance(item, dict | list):
                walk(item)

    if not isinstance(content, dict | list) or rng.random() < 0.1:
        return json.dumps(odd_value(rng))
    walk(content)
    if not places:
        return json.dumps(odd_value(rng))
    # As often near the root as in the depth of a long list.
    outer = [place for place in places if place[0] is content]
    where, key = rng.choice(outer if rng.random() < 0.4 else places)
    action = rng.randrange(4)
    if action == 0:
        del where[key]
    elif action == 1 and isinstance(where, dict):
        where[f"{key}x"] = where.pop(key)
    else:
        where[key] = odd_value(rng)
    return json.dumps(content)


def spoil_bytes(content: bytes, rng: random.Random) -> bytes:
    data, at = bytearray(content), rng.randrange(max(len(content), 1))
    action = rng.randrange(6)
    if action == 0:
        return content[:at]
    if action == 1:
        data[at : at + 1] = bytes([rng.randrange(256)])
    elif action == 2:
        data[at : at + 64] = rng.randbytes(64)
    elif action == 3:
        del data[at : at + rng.randrange(1, 500)]
    elif action == 4:
        data[at:at] = data[at : at + rng.randrange(1, 500)]
    else:
        for _ in range(8):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def spoil_text(content: bytes, rng: random.Random) -> bytes:
    """Lines and cells of a table or a TOML changed."""
    lines = content.decode().split("\n")
    at = rng.randrange(len(lines))
    sign = next((s for s in ",=:" if s in lines[at]), ",")
    cells = lines[at].split(sign)
    cell = rng.randrange(len(cells))
    odd = rng.choice(["", "x", "1e999", "-1", "nan", '"', "'", "[", "{}", "[[1]]", "true", "\0",
                      "9" * 400, "a" * LETTERS, f'"{"b" * LETTERS}"', "#", "=1+1", "1e-320",
                      '"a\nb"', "1979-05-27", "\u202e"])  # fmt: skip
    action = rng.randrange(5)
    if action == 0:
        del lines[at]
    elif action == 1:
        lines.insert(at, lines[rng.randrange(len(lines))])
    elif action == 2:
        cells.insert(cell, odd)
        lines[at] = sign.join(cells)
    else:
        cells[cell] = odd
        lines[at] = sign.join(cells)
    return "\n".join(lines).encode()


FOREIGN = ("external", "virtual", "linked", "lzf", "scaleoffset")
"""Ways to write a variable that must be refused."""


def make_foreign(file: h5py.File, name: str, way: str) -> None:
    """Give a variable the same values, but in another file or packed by a filter of few readers."""
    data, place = np.asarray(file[name][()]), Path(file.filename).parent
    dims = [[*dim.values()][:1] for dim in file[name].dims]
    attributes = {k: v for k, v in file[name].attrs.items() if k != "DIMENSION_LIST"}
    del file[name]
    if way == "external":
        data.tofile(place / "private")
        full = [("private", 0, data.nbytes)]
        file.create_dataset(name, data.shape, data.dtype, external=full)
    elif way in ("virtual", "linked"):
        with h5py.File(place / "private", "w") as private:
            private["x"] = data
        if way == "linked":
            file[name] = h5py.ExternalLink("private", "x")
            return
        layout = h5py.VirtualLayout(data.shape, data.dtype)
        layout[...] = h5py.VirtualSource("private", "x", data.shape)
        file.create_virtual_dataset(name, layout)
    else:
        packing = {"compression": "lzf"} if way == "lzf" else {"scaleoffset": 9}
        file.create_dataset(name, data=data, chunks=data.shape, **packing)
    file[name].attrs.update(attributes)
    for i, scales in enumerate(dims):
        for scale in scales:
            file[name].dims[i].attach_scale(scale)


def numbers_of(file: h5py.File) -> list[str]:
    """Names of variables of numbers that are no coordinates."""
    names: list[str] = []
    file.visit(names.append)
    sets = [name for name in names if isinstance(file[name], h5py.Dataset)]
    return [n for n in sets if file[n].dtype.kind == "f" and file[n].size and not file[n].is_scale]


def spoil_netcdf(path: Path, rng: random.Random) -> bool:
    """Change one variable, group or attribute of a NetCDF; whether it must be refused."""
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        sets = [name for name in names if isinstance(file[name], h5py.Dataset)]
        name, action = rng.choice(sets), rng.randrange(19)
        if action > 15:
            make_foreign(file, rng.choice(numbers_of(file)), rng.choice(FOREIGN))
            return True
        values = file[name][()]
        numeric = isinstance(values, np.ndarray) and values.dtype.kind in "iuf"
        if action < 5:
            holders = [file, *(file[name] for name in names if len(file[name].attrs))]
            holder = file if rng.random() < 0.8 else rng.choice(holders)
            ours = [key for key in holder.attrs if key not in ("terraphi_file", "_NCProperties")]
            if not ours:
                return False
            key = rng.choice(ours)
            value = holder.attrs[key]
            text = isinstance(value, str) and value.startswith(("{", "["))
            if action < 3 and text:
                holder.attrs[key] = spoil_json(value, rng)
            elif action == 3:
                del holder.attrs[key]
            else:
                holder.attrs[key] = rng.choice([
                    3, -1.5, [1.0, 2.0], 1j, "", "x", "{}", "[1]", "null", b"\xff\xfe",
                    np.float64("nan"), h5py.Empty("f8"), h5py.Empty(h5py.string_dtype()),
                    np.dtype([("a", "f4")]).type(0), '{"a": ' * 300,
                ])  # fmt: skip
            return False
        if action == 5 and "/" in name:
            del file[name.split("/")[0]]
            return False
        del file[name]
        if action == 6:
            file[f"{name}_x"] = values
        elif action == 7:
            file[name] = np.dtype("f8")  # a named type
        elif action == 8:
            file.create_group(name)
        elif action == 9:
            file.create_dataset(name, data=h5py.Empty("f8"))
        elif action == 10:
            shape = np.shape(values)
            file.create_dataset(name, data=np.zeros(shape, "c16"))
        elif action == 11:
            shape = np.shape(values)
            file.create_dataset(name, data=np.full(shape, "x", object), dtype=h5py.string_dtype())
        elif action == 12 and numeric:
            part = rng.choice([values.ravel(), values[..., None], values[:1], values[:0], values.T])
            file.create_dataset(name, data=part)
        elif action == 13 and numeric:
            spoiled = np.array(values, np.float64)
            spoiled.flat[:: rng.choice([1, 7])] = rng.choice([np.nan, np.inf, -1e300, 0.0])
            file.create_dataset(name, data=spoiled)
        elif action == 14:
            file.create_dataset(name, data=rng.choice([5, -1.0]))
        # else the variable is gone
    return False


def spoil(path: Path, rng: random.Random) -> bool:
    """Damage a file in a way that suits its kind, or its bytes; whether it must be refused."""
    if path.suffix == ".nc" and rng.random() < 0.85:
        return spoil_netcdf(path, rng)
    if path.suffix == ".json" and rng.random() < 0.85:
        path.write_text(spoil_json(path.read_text(encoding="utf-8"), rng))
    elif path.suffix in (".csv", ".toml", ".yaml") and rng.random() < 0.75:
        path.write_bytes(spoil_text(path.read_bytes(), rng))
    else:
        path.write_bytes(spoil_bytes(path.read_bytes(), rng))
    return False


# -- endings --------------------------------------------------------------------------------------


def ending(line: str, *, sound: bool = False) -> Ending:
    """Run a command in this process, within the limits of processor time and memory."""
    from terraphi.cli.main import main

    def late(*_: Any) -> None:
        raise Slow

    out, err, status, given = io.StringIO(), io.StringIO(), 0, sys.argv
    limits = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = signal.signal(signal.SIGPROF, late)
    sys.argv = ["terraphi", *line.split()]
    try:
        if not sound:
            signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
            resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, limits[1]))
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
    except SystemExit as leaving:
        status = int(leaving.code or 0)
    except Slow:
        return Ending("slow", traceback.format_exc())
    except BaseException as error:
        frames = traceback.extract_tb(error.__traceback__)
        ours = [f for f in frames if "terraphi" in f.filename and f.name != "main"][-1:]
        at = "".join(f"{Path(f.filename).name}:{f.lineno}" for f in ours)
        return Ending("stack", f"{type(error).__name__}: {str(error)[:90]} at {at}")
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, limits)
        signal.signal(signal.SIGPROF, before)
        sys.argv = given
    lines = [item for item in err.getvalue().splitlines() if item]
    if "Traceback" in err.getvalue():
        return Ending("stack", err.getvalue())
    if status == 2 and len(lines) == 1 and lines[0].startswith("terraphi: "):
        last_resort = lines[0].startswith("terraphi: unexpected ")
        return Ending("last resort" if last_resort else "good", lines[0])
    if status == 0 or (status == 1 and "--table" in line):
        return Ending("good", "")
    return Ending("other", f"exit {status}: {err.getvalue()[:300]}")


def cases(count: int, seed: int = 0) -> Iterator[tuple[int, str, str]]:
    """Number, file and command of each damaged file, the kinds in turn."""
    turns = [(file, line) for file, lines in COMMANDS.items() for line in lines]
    for i in range(count):
        file, line = turns[i % len(turns)]
        yield seed + i, file, line.replace("FILE", file)


def endings(files: Path, count: int, seed: int = 0) -> Iterator[tuple[int, str, str, Ending]]:
    """How each damaged file ends; ``files`` holds one of every kind, whole."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name) / "work"
        for number, file, line in cases(count, seed):
            shutil.rmtree(place, ignore_errors=True)
            shutil.copytree(files, place)
            foreign = spoil(place / file, random.Random(number))
            with contextlib.chdir(place), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                end = ending(line)
                unseen = foreign and end == ("good", "")
                yield number, file, line, Ending("not refused", "") if unseen else end


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    make_files(folder)
    return folder


@pytest.mark.slow  # what the damaged ones are compared with
def test_whole_files_are_read(files: Path, tmp_path: Path) -> None:
    shutil.copytree(files, tmp_path / "work")
    with contextlib.chdir(tmp_path / "work"):
        for _, file, line in cases(sum(map(len, COMMANDS.values()))):
            assert ending(line, sound=True) == ("good", ""), file


@pytest.mark.parametrize("way", FOREIGN)
def test_values_in_other_files_and_unusual_filters_are_refused_by_every_reader(
    files: Path, tmp_path: Path, way: str
) -> None:
    for file, lines in COMMANDS.items():
        if file.endswith(".nc"):
            shutil.copytree(files, tmp_path / file)
            with h5py.File(tmp_path / file / file, "r+") as damaged:
                name = numbers_of(damaged)[0]
                make_foreign(damaged, name, way)
            for line in lines:
                with contextlib.chdir(tmp_path / file):
                    end = ending(line.replace("FILE", file))
                assert end.kind == "good", (line, end)
                assert f"'/{name}'" in end.about, (line, end)


@pytest.mark.parametrize(("count", "seed"), [
    (28, 0), pytest.param(500, 1000, marks=pytest.mark.slow),
])  # fmt: skip
def test_damaged_files_end_with_a_sentence(files: Path, count: int, seed: int) -> None:
    bad = [(number, file, line, end) for number, file, line, end in endings(files, count, seed)
           if end.kind != "good"]  # fmt: skip
    assert not bad


if __name__ == "__main__":
    ended: dict[str, Counter[str]] = {}
    count, seed = (*map(int, sys.argv[1:]), 0)[:2] if len(sys.argv) > 1 else (500, 0)
    with tempfile.TemporaryDirectory() as name:
        whole = Path(name)
        with contextlib.redirect_stdout(io.StringIO()):
            make_files(whole)
        with contextlib.chdir(whole):
            for _, file, line in cases(sum(map(len, COMMANDS.values()))):
                if (found := ending(line, sound=True)).kind != "good" or found.about:
                    sys.stdout.write(f"whole {file}, {line}: {found}\n")
        for number, file, line, end in endings(whole, count, seed):
            ended.setdefault(file, Counter())[end.kind] += 1
            if end.kind != "good":
                sys.stdout.write(f"{number} {line}: {end.kind}: {end.about[-300:]}\n")
    for file, counts in ended.items():
        sys.stdout.write(f"{file:24} {sum(counts.values()):4}  {dict(counts)}\n")
