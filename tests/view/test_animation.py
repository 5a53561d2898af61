"""Animations: each frame shows the particles, the leg and the forces of its moment."""

from __future__ import annotations

import itertools
import math
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image
from terraphi.forward.plane.fields import FieldSeries

from terraphi import forward
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.forward.vtk import read_points, read_series
from terraphi.view import animation
from terraphi.view.animation import Scene, _tick, animate, check_animation
from terraphi.view.plots import ORANGE

BASE = {
    "numerics": {"cells": 32, "speed_up": 20.0, "time_step": 5e-5, "contact_band_cells": 0.5},
    "bed": {"left": 0.010, "floor": 0.010, "width": 0.280, "height": 0.160},
    "leg": {"shape": "reversed_c"},
}
ROTATION = {"start_deg": -80.0, "stop_deg": 60.0}
TRANSLATION = {
    "kind": "translation",
    "start": [0.1, 0.24],
    "velocity": [0.02, 0.0],
    "distance": 0.02,
    "bin_width": 5e-4,
}


class Made(NamedTuple):
    scenario: Scenario
    history: ForceHistory
    series: Path


def make(folder: Path, motion: object, frames: int) -> Made:
    scenario = Scenario.model_validate({**BASE, "motion": motion})
    observe = FieldSeries(folder, scenario, frames=frames)
    history = forward.simulate(scenario, observe=observe)
    return Made(scenario, history, observe.particles)


@pytest.fixture(name="made", scope="module")
def _made(tmp_path_factory) -> Made:
    return make(tmp_path_factory.mktemp("series"), ROTATION, 7)


def colours_in(picture: Image.Image) -> set[tuple[int, ...]]:
    return {tuple(c) for c in np.asarray(picture.convert("RGB")).reshape(-1, 3)[::7].tolist()}


def axes_of(scene: Scene, label: str) -> Any:
    """The axes whose ordinate is so called."""
    (found,) = (axes for axes in scene.figure.axes if label in axes.get_ylabel())
    return found


def test_a_gif_has_a_picture_a_frame_and_the_pictures_differ(made: Made, tmp_path) -> None:
    told: list[float] = []
    animate(tmp_path / "a.gif", made.history, made.scenario, made.series, progress=told.append)
    assert [file.name for file in tmp_path.iterdir()] == ["a.gif"]
    assert told == pytest.approx(np.arange(1, 8) / 7)
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 7
        pictures, lasts = [], []
        for number in range(film.n_frames):
            film.seek(number)
            lasts.append(film.info["duration"])
            pictures.append(np.asarray(film.convert("RGB")))
    assert all((a != b).any() for a, b in itertools.pairwise(pictures))
    # As long as the simulation took from each to the next, in hundredths of a second.
    times = np.array([time for time, _ in read_series(made.series)[0]])
    wanted = 1000 / 12 * np.diff(times) / np.diff(times).mean()
    assert lasts[:-1] == pytest.approx(np.maximum(wanted, 20.0), abs=5.1)


def test_colours_stay_the_same_from_frame_to_frame(made: Made, tmp_path) -> None:
    animate(tmp_path / "a.gif", made.history, made.scenario, made.series)
    seen = set()
    with Image.open(tmp_path / "a.gif") as film:
        for number in range(film.n_frames):
            film.seek(number)
            seen |= set(map(tuple, np.asarray(film.convert("RGB")).reshape(-1, 3)))
    assert len(seen) <= 256
    # The arrow's and the markers' own colour is among them, not the nearest of a frame's.
    assert tuple(round(255 * part) for part in to_rgb(ORANGE)) in seen


def test_each_frame_shows_its_moment(made: Made) -> None:
    scene = Scene(made.history, made.scenario)
    frames, _ = read_series(made.series)
    soil_axes, thrust, lift = (
        axes_of(scene, label) for label in ("z [mm]", "F_x$ [N]", "F_z$ [N]")
    )
    assert soil_axes.get_aspect() == 1.0
    assert "x [mm]" in soil_axes.get_xlabel()
    mean = made.history.means(made.history.position[5:-5], math.radians(0.5))
    # Nothing that will be drawn lies beyond what the axes show from the beginning.
    for axes, column in ((thrust, 0), (lift, 1)):
        low, high = axes.get_ylim()
        assert low <= min(0.0, mean[:, column].min())
        assert high >= mean[:, column].max()
    for time, name in frames:
        soil = read_points(made.series.parent / name)
        scene.show(time, soil)
        theta_deg = -80.0 + math.degrees(0.2 * 20.0 * time)
        (dots,) = soil_axes.collections
        np.testing.assert_allclose(dots.get_offsets(), 1e3 * soil.points[:, [0, 2]], rtol=1e-6)
        # Speeds are those of the leg's own pace, and the scale ends at that of its tip.
        np.testing.assert_allclose(dots.get_array(), 1e3 * soil.point_data["speed"] / 20.0)
        assert dots.norm.vmax == pytest.approx(1e3 * 0.2 * made.scenario.leg.reach())
        title = scene.figure.get_suptitle()
        assert "reversed C leg, φ = 35° (paper)" in title
        assert f"θ = {theta_deg:+.0f}°" in title
        for axes, column in ((thrust, 0), (lift, 1)):
            curve = max(axes.lines, key=lambda line: len(np.atleast_1d(line.get_xdata())))
            shown = np.asarray(curve.get_xdata())
            if len(shown) > 10:
                assert shown.max() == pytest.approx(theta_deg, abs=0.2)
                i = np.searchsorted(made.history.theta_deg[5:-5], shown[len(shown) // 2])
                value = np.asarray(curve.get_ydata())[len(shown) // 2]
                assert value == pytest.approx(mean[i, column], rel=0.05, abs=0.5)


def arrows(scene: Scene) -> list[np.ndarray]:
    """Tail and head of the arrows: the key, then the force."""
    from matplotlib.patches import FancyArrowPatch

    patches = [p for p in scene.figure.axes[0].patches if isinstance(p, FancyArrowPatch)]
    return [np.array(p._posA_posB) for p in patches]


def test_the_arrow_is_the_force_on_the_scale_of_the_key(made: Made) -> None:
    scene = Scene(made.history, made.scenario)
    frames, _ = read_series(made.series)
    time, name = frames[2]
    scene.show(time, read_points(made.series.parent / name))
    key, force = arrows(scene)
    words = next(
        t.get_text() for t in scene.figure.axes[0].texts if "force on the leg" in t.get_text()
    )
    unit = float(words.split(",")[1].removesuffix("N"))
    at = math.radians(-80.0) + 0.2 * 20.0 * time
    expected = made.history.means(np.array([at]), math.radians(0.5))[0]
    per_newton = np.hypot(*(key[1] - key[0])) / unit
    np.testing.assert_allclose((force[1] - force[0]) / per_newton, expected, rtol=0.1, atol=0.5)
    # The key stands above the picture, where it covers nothing; the force begins at the leg.
    assert key[:, 1].min() > scene.figure.axes[0].get_ylim()[1]
    leg = read_points(made.series.parent / name.replace("particles", "leg"))
    gaps = np.hypot(*(1e3 * leg.points[:, [0, 2]] - force[0]).T)
    assert gaps.min() < 4.0
    # Before the leg touches anything there is no arrow, and the old one is gone.
    scene.show(0.0, read_points(made.series.parent / frames[0][1]))
    drawn = len(arrows(scene))
    scene.show(time, read_points(made.series.parent / name))
    assert drawn <= 2
    assert len(arrows(scene)) == 2


def test_what_has_lost_its_weight_is_pale(made: Made) -> None:
    scene = Scene(made.history, made.scenario)
    frames, _ = read_series(made.series)
    soil = read_points(made.series.parent / frames[-1][1])
    assert soil.point_data["weight"].min() < 0.5
    scene.show(frames[-1][0], soil)
    opacity = np.asarray(scene.figure.axes[0].collections[0].get_alpha())
    np.testing.assert_allclose(opacity, np.maximum(soil.point_data["weight"], 0.2))


def test_a_translation_is_drawn_over_its_distance(tmp_path) -> None:
    made = make(tmp_path / "f", TRANSLATION, 3)
    scene = Scene(made.history, made.scenario)
    frames, _ = read_series(made.series)
    scene.show(frames[-1][0], read_points(made.series.parent / frames[-1][1]))
    assert "displacement [mm]" in axes_of(scene, "F_z$").get_xlabel()
    # Nothing fades where the leg does not rotate.
    assert "pale" not in axes_of(scene, "speed").get_ylabel()
    assert "20.0 mm" in scene.figure.get_suptitle()
    animate(tmp_path / "a.gif", made.history, made.scenario, made.series)
    with Image.open(tmp_path / "a.gif") as film:
        assert len(colours_in(film)) > 20


def test_a_leg_that_touches_nothing_has_no_arrow(tmp_path) -> None:
    motion = {"hip": [0.150, 0.215], "start_deg": -180.0, "stop_deg": -170.0}
    made = make(tmp_path, motion, 2)
    scene = Scene(made.history, made.scenario)
    scene.show(0.0, read_points(made.series.parent / "particles_0000.vtu"))
    assert arrows(scene) == []


FFMPEG = """#!{python}
import sys
arguments = sys.argv[1:]
width, height = map(int, arguments[arguments.index("-s") + 1].split("x"))
frames = len(sys.stdin.buffer.read()) / (4 * width * height)
rate = arguments[arguments.index("-framerate") + 1]
open(arguments[-1], "w").write(f"{{frames}} frames at {{rate}}")
"""


def test_an_mp4_is_left_to_ffmpeg(made: Made, tmp_path, monkeypatch) -> None:
    """One that counts the frames that it is given."""
    program = tmp_path / "ffmpeg"
    program.write_text(FFMPEG.format(python=sys.executable))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    # Moments that are twice as far apart are shown twice as long.
    monkeypatch.setattr(animation, "durations", lambda _: [83, 166, 83, 83, 166, 83, 83])
    monkeypatch.setattr(animation, "DOTS_PER_INCH", 30)  # nobody looks at it
    animate(tmp_path / "b.mp4", made.history, made.scenario, made.series)
    assert (tmp_path / "b.mp4").read_text() == "9.0 frames at 12"
    program.write_text(f"#!{sys.executable}\nimport sys\nsys.stdin.buffer.read()\nsys.exit(8)\n")
    with pytest.raises(InputError, match=r"ffmpeg ended with status 8; one that can encode"):
        animate(tmp_path / "c.mp4", made.history, made.scenario, made.series)
    assert not (tmp_path / "c.mp4").exists()


def test_ticks_are_parts_of_a_turn_however_long_the_way() -> None:
    spans = {20.0: 5.0, 270.0: 45.0, 630.0: 90.0, 720.0: 180.0, 5000.0: 360.0}
    assert {span: _tick(np.array([-135.0, span - 135.0])) for span in spans} == spans


def test_what_cannot_be_drawn(made: Made, tmp_path, monkeypatch) -> None:
    for name in ("a.png", "a", "gif"):
        with pytest.raises(InputError, match=r"an animation is a \.gif or an \.mp4"):
            check_animation(tmp_path / name)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"needs the program ffmpeg.*install it, or name a \.gif"):
        check_animation(tmp_path / "a.mp4")
    with pytest.raises(InputError, match=r"cannot be written"):
        animate(tmp_path / "no" / "a.gif", made.history, made.scenario, made.series)
    with pytest.raises(InputError, match=r"no such file"):
        animate(tmp_path / "a.gif", made.history, made.scenario, tmp_path / "particles.pvd")
    assert list(tmp_path.iterdir()) == []
