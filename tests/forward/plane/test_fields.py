"""Particle fields: what is written is what was simulated, whatever stops the simulation."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.forward.driver import BLOCK, simulate, step_count
from terraphi.forward.plane import fields
from terraphi.forward.plane.bed import geostatic_bed
from terraphi.forward.plane.fields import FieldSeries, frame_steps, particle_fields
from terraphi.forward.vtk import Grid, read_points, read_series
from terraphi.forward.watch import Checkpoint

MOTION = {"motion.start_deg": -80.0, "motion.stop_deg": 10.0, "leg.shape": "reversed_c"}


@pytest.fixture(name="scenario", scope="module")
def _scenario(coarse):
    return coarse(**MOTION)


def frames_of(folder: Path, name: str = "particles") -> list[tuple[float, Grid]]:
    frames, _ = read_series(folder / f"{name}.pvd")
    return [(time, read_points(folder / file)) for time, file in frames]


def content_of(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.fixture(name="series", scope="module")
def _series(scenario, tmp_path_factory) -> Path:
    """Folder with all frames of a run that nothing has stopped."""
    folder = tmp_path_factory.mktemp("series")
    simulate(scenario, observe=FieldSeries(folder, scenario, frames=100))
    return folder


def test_a_frame_each_block_and_the_forces_as_without(scenario, tmp_path) -> None:
    history = simulate(scenario, observe=FieldSeries(tmp_path, scenario, frames=100))
    assert history.force.tobytes() == simulate(scenario).force.tobytes()
    steps = [0, 2000, 4000, 6000, step_count(scenario)]
    for name in ("particles", "leg"):
        found = frames_of(tmp_path, name)
        assert [time for time, _ in found] == pytest.approx([5e-5 * step for step in steps])
        for time, frame in found:
            assert frame.field_data["TimeValue"].tolist() == [time]
            turned = math.degrees(0.2 * 20.0 * time)
            assert frame.field_data["theta_deg"][0] == pytest.approx(-80.0 + turned)
    assert len(list(tmp_path.iterdir())) == 2 * (len(steps) + 1)


def test_the_first_frame_is_the_bed_at_rest(scenario, series) -> None:
    _, frame = frames_of(series)[0]
    bed = geostatic_bed(scenario)
    np.testing.assert_allclose(frame.points[:, [0, 2]], bed.position, rtol=1e-6)
    assert not frame.points[:, 1].any()
    depth = 0.170 - bed.position[:, 1]
    vertical = -1650.0 * 9.81 * depth
    k0 = 1.0 - math.sin(math.radians(35.0))
    data = frame.point_data
    np.testing.assert_allclose(data["stress_zz"], vertical, rtol=1e-5)
    np.testing.assert_allclose(data["pressure"], -0.5 * (1.0 + k0) * vertical, rtol=1e-5)
    np.testing.assert_allclose(data["mohr_radius"], -0.5 * (1.0 - k0) * vertical, rtol=1e-5)
    for name in ("velocity", "speed", "displacement", "stress_xz"):
        assert not data[name].any()
    assert (data["weight"] == 1.0).all()
    assert (data["volume_ratio"] == 1.0).all()
    assert data["particle"].tolist() == list(range(len(bed.mass)))


def test_frames_agree_with_each_other(series, scenario) -> None:
    first, *_, last = frames_of(series)
    data = last[1].point_data
    np.testing.assert_allclose(data["displacement"], last[1].points - first[1].points, atol=1e-7)
    np.testing.assert_allclose(data["speed"], np.linalg.norm(data["velocity"], axis=1), rtol=1e-5)
    # Drucker-Prager of the paper: no circle of stress is larger than the cone allows.
    sine = (
        2.0 * math.sin(math.radians(35.0)) / (math.sqrt(3.0) * (3.0 - math.sin(math.radians(35))))
    )
    assert (data["mohr_radius"] <= sine * data["pressure"] * (1.0 + 1e-5) + 1e-3).all()
    # The leg pulls soil along: what touches it moves, and most of the bed does not.
    assert np.median(data["speed"]) < 0.05 * data["speed"].max()
    assert data["speed"].max() < 2.0 * 0.2 * 20.0 * scenario.leg.reach()


def test_the_leg_is_where_its_pose_is(series, scenario) -> None:
    """Hip and tip lie half a thickness inside the outline; no particle lies inside the leg."""
    for (time, leg), (_, soil) in zip(frames_of(series, "leg"), frames_of(series), strict=True):
        theta = math.radians(-80.0) + 0.2 * 20.0 * time
        hip = np.array([0.150, 0.190])
        tip = hip - 0.0762 * np.array([math.sin(theta), math.cos(theta)])
        for end in (hip, tip):
            distance = np.hypot(*(leg.points[:, [0, 2]] - end).T)
            assert distance.min() == pytest.approx(0.0032, rel=1e-6)
        axes = np.array([[-math.sin(theta), -math.cos(theta)], [-math.cos(theta), math.sin(theta)]])
        local = (soil.points[:, [0, 2]].astype(float) - hip) @ axes.T
        inside, _ = scenario.leg.signed_distance(local)
        assert inside.min() > -0.0032  # contact leaks a little on so coarse a grid


def test_fields_of_a_state_made_for_them(scenario) -> None:
    soil = geostatic_bed(scenario)
    soil.stress[0] = -300.0, -100.0, 75.0, -20.0
    soil.velocity[0] = 3.0, -4.0
    soil.position[0] = soil.start[0] + (1e-3, 2e-3)
    _, data = particle_fields(soil)
    assert data["pressure"][0] == 200.0
    assert data["mohr_radius"][0] == 125.0
    assert data["stress_yy"][0] == -20.0
    assert data["speed"][0] == 5.0
    assert data["velocity"][0].tolist() == [3.0, 0.0, -4.0]
    np.testing.assert_allclose(data["displacement"][0], [1e-3, 0.0, 2e-3], rtol=1e-6)


# -- frames --------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [1, BLOCK, BLOCK + 1, 10 * BLOCK, 147_263])
@pytest.mark.parametrize("frames", [2, 3, 10, 1000])
def test_frames_are_ends_of_blocks_evenly_spread(steps: int, frames: int) -> None:
    chosen = frame_steps(steps, frames)
    blocks = math.ceil(steps / BLOCK)
    assert len(chosen) == min(frames, blocks + 1)
    assert (chosen[0], chosen[-1]) == (0, steps)
    assert all(step % BLOCK == 0 for step in chosen[:-1])
    gaps = np.diff(chosen[:-1])
    assert gaps.size == 0 or gaps.max() - gaps.min() <= BLOCK


class StopError(Exception):
    """Stops a run."""


def test_frames_go_on_with_the_simulation(scenario, series, tmp_path) -> None:
    kept = Checkpoint(tmp_path / "c", every=0.0)
    folder = tmp_path / "frames"

    def stop(fraction: float) -> None:
        if fraction > 0.45:
            raise StopError

    looks = FieldSeries(folder, scenario, frames=100)
    with pytest.raises(StopError):
        simulate(scenario, checkpoint=kept, observe=looks, progress=stop)
    assert len(frames_of(folder)) == 3
    (folder / ".particles_0003.vtu.abc.vtu").write_text("half a frame, when the kill came")
    looks = FieldSeries(folder, scenario, frames=100)
    simulate(scenario, checkpoint=kept, observe=looks)
    assert content_of(folder) == content_of(series)


@pytest.mark.parametrize("last", ["write_points", "write_polygon", "write_series"])
def test_a_run_killed_within_its_first_frame_is_run_again(
    scenario, tmp_path, monkeypatch, last: str
) -> None:
    (tmp_path / "notes.txt").write_text("a stranger's")
    with monkeypatch.context() as context:
        write, calls = getattr(fields, last), []

        def killed(*args, **options) -> None:
            write(*args, **options)
            calls.append(args)
            if len(calls) == (3 if last == "write_series" else 1):
                raise StopError

        context.setattr(fields, last, killed)
        with pytest.raises(StopError):
            simulate(scenario, observe=FieldSeries(tmp_path, scenario, frames=2))
    assert (tmp_path / "particles_0000.vtu").exists()
    looks = FieldSeries(tmp_path, scenario, frames=2)

    def stop(fraction: float) -> None:
        if fraction > 0.0:
            raise StopError

    with pytest.raises(StopError):
        simulate(scenario, observe=looks, progress=stop)
    assert [time for time, _ in frames_of(tmp_path)] == [0.0]
    FieldSeries(tmp_path, scenario, frames=2).remove()
    assert content_of(tmp_path) == {"notes.txt": b"a stranger's"}


def test_frames_of_a_stranger_are_not_replaced(scenario, tmp_path) -> None:
    for name in ("particles_0000.vtu", "leg.pvd"):
        (tmp_path / name).write_text("a stranger's")
        with pytest.raises(InputError, match=rf"{name}: is there, and of no series that terraphi"):
            FieldSeries(tmp_path, scenario, frames=2)
        (tmp_path / name).unlink()


def test_frames_that_are_missing_are_said_to_be(scenario, tmp_path, caplog) -> None:
    kept = Checkpoint(tmp_path / "c", every=0.0)
    simulate(scenario, checkpoint=kept)
    with caplog.at_level(logging.WARNING):
        looks = FieldSeries(tmp_path / "f", scenario, frames=100)
        simulate(scenario, checkpoint=kept, observe=looks)
    assert f"4 frames before step {step_count(scenario)} are missing" in caplog.text
    assert len(frames_of(tmp_path / "f")) == 1


def test_frames_of_another_simulation_are_not_mixed_in(scenario, coarse, tmp_path) -> None:
    simulate(scenario, observe=FieldSeries(tmp_path, scenario, frames=100))
    other = coarse(**{**MOTION, "motion.stop_deg": -70.0})
    simulate(other, observe=FieldSeries(tmp_path, other, frames=100))
    assert [time for time, _ in frames_of(tmp_path)] == [0.0, 5e-5 * step_count(other)]


def test_a_folder_that_cannot_be_made(scenario, tmp_path) -> None:
    (tmp_path / "taken").touch()
    with pytest.raises(InputError, match="taken: cannot be made a folder"):
        FieldSeries(tmp_path / "taken", scenario, frames=3)
