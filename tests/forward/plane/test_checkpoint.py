"""Checkpoints: whatever stops a run, and however often, the same bits come out at the end."""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
import random
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.forward import MODEL_VERSIONS
from terraphi.forward import checkpoint as checkpoints
from terraphi.forward import driver as solver
from terraphi.forward.checkpoint import Keeper
from terraphi.forward.driver import simulate, step_count
from terraphi.forward.state import copy_of, first_state
from terraphi.forward.watch import Checkpoint

MOTION = {"motion.start_deg": -80.0, "motion.stop_deg": 10.0}
"""Four blocks of steps; the relief sets in at θ = 0, between two of them."""


@pytest.fixture(name="scenario", scope="module")
def _scenario(coarse):
    return coarse(**MOTION)


@pytest.fixture(name="whole", scope="module")
def _whole(scenario) -> ForceHistory:
    """The run that nothing has stopped."""
    return simulate(scenario)


def bits_of(history: ForceHistory) -> str:
    """Forces, balances and all that a run leaves but for its times."""
    known = {
        key: value
        for key, value in history.provenance.items()
        if key not in ("seconds", "resumed_at_step")
    }
    return hashlib.sha256(history.force.tobytes() + json.dumps(known).encode()).hexdigest()


class StopError(Exception):
    """Stops a run."""


def stopping_after(blocks: int):
    """Report of progress that has enough after some blocks."""
    told = []

    def progress(fraction: float) -> None:
        told.append(fraction)
        if len(told) == blocks:
            raise StopError

    return progress


def stopped(scenario, checkpoint: Checkpoint, blocks: int, **options: Any) -> None:
    with pytest.raises(StopError):
        simulate(scenario, checkpoint=checkpoint, progress=stopping_after(blocks), **options)


# -- the same bits -----------------------------------------------------------------------------


def test_a_run_of_several_blocks(scenario) -> None:
    assert step_count(scenario) > 3 * solver.BLOCK


@pytest.mark.parametrize("every", [0.0, 1e9], ids=["each block", "never"])
def test_keeping_changes_nothing(scenario, whole, tmp_path, every) -> None:
    kept = Checkpoint(tmp_path / "c", every=every)
    assert bits_of(simulate(scenario, checkpoint=kept)) == bits_of(whole)
    assert kept.path.exists() == (every == 0.0)


@pytest.mark.parametrize("kernel", ["packets", "scalar"])
@pytest.mark.parametrize("blocks", [1, 2, 3])
def test_a_run_taken_up_again_ends_in_the_same_bits(
    scenario, whole, tmp_path, kernel, blocks
) -> None:
    """Between any two blocks; the last part of a block that was cut short is done again."""
    kept = Checkpoint(tmp_path / "c")
    stopped(scenario, kept, blocks, kernel=kernel)
    again = simulate(scenario, checkpoint=kept, kernel=kernel)
    assert again.provenance["resumed_at_step"] == [blocks * solver.BLOCK]
    expected = whole if kernel == "packets" else simulate(scenario, kernel="scalar")
    assert bits_of(again) == bits_of(expected)


@pytest.mark.parametrize(
    "options",
    [
        {"soil.yield_criterion": "triaxial"},
        {"soil.yield_criterion": "plane_strain", "numerics.particle_volume": "updated"},
    ],
    ids=["out of plane", "volume"],
)
def test_options_that_carry_more_state_are_taken_up_as_well(coarse, tmp_path, options) -> None:
    """σ_yy and the volume ratio, which other scenarios leave alone."""
    scenario = coarse(**MOTION, **options)
    kept = Checkpoint(tmp_path / "c")
    stopped(scenario, kept, 3)
    assert bits_of(simulate(scenario, checkpoint=kept)) == bits_of(simulate(scenario))


def test_a_run_stopped_at_every_block(scenario, whole, tmp_path) -> None:
    kept = Checkpoint(tmp_path / "c")
    times = 0
    while True:
        try:
            history = simulate(scenario, checkpoint=kept, progress=stopping_after(1))
        except StopError:
            times += 1
        else:
            break
    assert times == 4
    assert history.provenance["resumed_at_step"] == [2000, 4000, 6000, step_count(scenario)]
    assert bits_of(history) == bits_of(whole)


def test_a_run_stopped_in_the_middle_of_a_block_keeps_its_start(
    scenario, whole, tmp_path, monkeypatch
) -> None:
    """Ctrl-C may come while the kernel has changed half of the particles."""
    kept, (fine, phased) = Checkpoint(tmp_path / "c"), solver.KERNELS["packets"]
    calls = 0

    def interrupted(soil, *rest) -> int:
        nonlocal calls
        calls += 1
        lost = fine(soil, *rest)
        if calls == 3:
            soil.position[::2] = 0.0
            raise KeyboardInterrupt
        return lost

    with monkeypatch.context() as patch:
        patch.setitem(solver.KERNELS, "packets", (interrupted, phased))
        with pytest.raises(KeyboardInterrupt):
            simulate(scenario, checkpoint=kept)
    again = simulate(scenario, checkpoint=kept)
    assert again.provenance["resumed_at_step"] == [4000]
    assert bits_of(again) == bits_of(whole)


def test_phases_end_in_the_same_bits_wherever_they_were_stopped(coarse, tmp_path) -> None:
    """Blocks are whole phases, and the elastic slip along the leg is kept."""
    options = {
        "numerics.remap_interval": 7 * 5e-5,
        "numerics.contact": "surface",
        "numerics.dilatation": "cell",
        "motion.stop_deg": -20.0,
    }
    scenario = coarse(**options)
    uninterrupted = simulate(scenario)
    kept, times = Checkpoint(tmp_path / "c", 0.0), 0

    def stop(snapshot) -> None:
        nonlocal times
        times += 1
        if times == 2:
            assert np.abs(snapshot.soil.slip).max() > 0
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(scenario, checkpoint=kept, observe=stop)
    again = simulate(scenario, checkpoint=kept)
    assert again.provenance["resumed_at_step"] == [solver.block_length(scenario)] == [1995]
    assert bits_of(again) == bits_of(uninterrupted)


def test_looking_on_changes_nothing_and_cannot(scenario, whole) -> None:
    seen = []

    def look(snapshot) -> None:
        seen.append((snapshot.step, float(np.degrees(snapshot.pose.theta[0]))))
        for field in snapshot.soil:
            with pytest.raises(ValueError, match="read-only"):
                field[0] = 0.0

    assert bits_of(simulate(scenario, observe=look)) == bits_of(whole)
    assert [step for step, _ in seen] == [0, 2000, 4000, 6000, step_count(scenario)]
    np.testing.assert_allclose([seen[0][1], seen[-1][1]], [-80.0, 10.0], atol=0.02)


KILLED = """
import hashlib, sys
from pathlib import Path
from terraphi.forward.driver import simulate
from terraphi.forward.watch import Checkpoint
from terraphi.experiment.scenario import Scenario
scenario = Scenario.model_validate_json(sys.stdin.read())
kept = Checkpoint(Path(sys.argv[1]), every=0.0)
print("ready", flush=True)
history = simulate(scenario, checkpoint=kept, progress=lambda _: print("block", flush=True))
print(len(history.provenance["resumed_at_step"]))
print(hashlib.sha256(history.force.tobytes()).hexdigest())
"""


def test_kill_9_at_any_moment(coarse, tmp_path) -> None:
    """Killed without a word after random times, again and again, until a run gets through."""
    scenario = coarse(**{"motion.start_deg": -130.0, "motion.stop_deg": 60.0})
    blocks = math.ceil(step_count(scenario) / solver.BLOCK)
    simulate(scenario)  # compiles
    began = time.perf_counter()
    whole = simulate(scenario)
    block_seconds = (time.perf_counter() - began) / blocks
    rng = random.Random(20)
    for life in range(5):
        started = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(tmp_path / "c")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )
        assert started.stdin is not None
        assert started.stdout is not None
        started.stdin.write(scenario.model_dump_json())
        started.stdin.close()
        started.stdin = None  # or communicate would flush it
        for _ in range(1 + rng.randrange(3)):
            started.stdout.readline()
        time.sleep(rng.uniform(0.0, 1.5 * block_seconds))
        if life < 4:
            started.kill()
        said = started.communicate()[0].split()
        if started.returncode == 0:
            break
        assert started.returncode == -signal.SIGKILL
    assert started.returncode == 0
    assert int(said[-2]) >= 2
    assert said[-1] == hashlib.sha256(whole.force.tobytes()).hexdigest()


# -- what the file is --------------------------------------------------------------------------


def test_only_what_fits_is_taken_up(scenario, coarse, tmp_path, monkeypatch, caplog) -> None:
    kept = Checkpoint(tmp_path / "c")
    stopped(scenario, kept, 1)
    content = kept.path.read_bytes()
    named = Checkpoint(kept.path, named=True)
    other = coarse(**MOTION, **{"soil.friction_angle_deg": 34.0})

    def refused(word: str, scenario=scenario, kernel: str = "packets") -> None:
        with pytest.raises(InputError, match=rf"c: .*{word}.*remove it, or name another file"):
            simulate(scenario, checkpoint=named, kernel=kernel)
        assert kept.path.read_bytes() == content

    refused("scenario hash", other)
    refused("kernel packets where this run has scalar", kernel="scalar")
    for name, change in {
        "model version": (MODEL_VERSIONS, "mpm", 99),
        "processor": (checkpoints.numba.config, "CPU_NAME", "pentium"),
        "kernel source": (checkpoints, "SOURCE_DIGEST", "0" * 64),
        "vector lanes": (checkpoints, "lane_count", lambda: 3),
    }.items():
        with monkeypatch.context() as patch:
            place, key, value = change
            set_it = patch.setitem if isinstance(place, dict) else patch.setattr
            set_it(place, key, value)
            refused(name)

    with caplog.at_level(logging.WARNING):
        history = simulate(other, checkpoint=kept)
    assert "scenario hash" in caplog.text
    assert "starts anew" in caplog.text
    assert "resumed_at_step" not in history.provenance
    assert bits_of(history) == bits_of(simulate(other))


@pytest.mark.parametrize("package", ["numpy", "numba", "llvmlite"])
def test_another_compiler_is_another_run(scenario, tmp_path, monkeypatch, package) -> None:
    kept = Checkpoint(tmp_path / "c", named=True)
    stopped(scenario, kept, 1)
    version = checkpoints.importlib.metadata.version

    def newer(name: str) -> str:
        return "99.0" if name == package else version(name)

    monkeypatch.setattr(checkpoints.importlib.metadata, "version", newer)
    with pytest.raises(InputError, match=rf"has {package} .* where this run has 99\.0"):
        simulate(scenario, checkpoint=kept)


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "text", "array"])
def test_a_damaged_file_is_no_checkpoint(scenario, whole, tmp_path, caplog, damage) -> None:
    kept = Checkpoint(tmp_path / "c")
    stopped(scenario, kept, 2)
    content = bytearray(kept.path.read_bytes())
    if damage == "truncated":
        del content[-3000:]
    elif damage == "flipped":
        content[len(content) // 2] ^= 1
    elif damage == "array":
        with kept.path.open("wb") as stream:
            np.save(stream, np.zeros(3))
        content = bytearray(kept.path.read_bytes())
    else:
        content = bytearray(b"" if damage == "empty" else b"my thesis")
    kept.path.write_bytes(content)
    with pytest.raises(InputError, match="not a whole checkpoint"):
        simulate(scenario, checkpoint=Checkpoint(kept.path, named=True))
    assert kept.path.read_bytes() == content
    if damage in ("text", "array"):  # somebody else's, whatever its name
        with pytest.raises(InputError, match=r"not a whole checkpoint .*; remove it, or name"):
            simulate(scenario, checkpoint=kept)
        assert kept.path.read_bytes() == content
        return
    with caplog.at_level(logging.WARNING):
        assert bits_of(simulate(scenario, checkpoint=kept)) == bits_of(whole)
    assert "not a whole checkpoint" in caplog.text


def test_what_a_kill_left_unfinished_goes(scenario, tmp_path) -> None:
    kept = Checkpoint(tmp_path / "x.nc.checkpoint")
    left = tmp_path / ".x.nc.checkpoint.abc_1234.checkpoint"
    other = tmp_path / ".x.nc.abc_1234.nc"
    for file in (left, other):
        file.write_bytes(b"half")
    stopped(scenario, kept, 1)
    assert sorted(tmp_path.iterdir()) == [other, kept.path]
    left.write_bytes(b"half")
    kept.remove()
    assert list(tmp_path.iterdir()) == [other]


def test_a_full_disk_costs_the_checkpoint_and_not_the_run(
    scenario, whole, tmp_path, monkeypatch, caplog
) -> None:
    kept = Checkpoint(tmp_path / "c", every=0.0)

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoints.np, "savez", full)
    with caplog.at_level(logging.WARNING):
        assert bits_of(simulate(scenario, checkpoint=kept)) == bits_of(whole)
    assert "no checkpoint" in caplog.text
    assert list(tmp_path.iterdir()) == []


def test_checkpoints_are_spaced_by_what_they_cost(coarse, tmp_path, monkeypatch) -> None:
    """A clock of our own: a block takes 3 s, a checkpoint 0.5 s; the spacing is then 50 s."""
    scenario = coarse()
    now = 0.0
    monkeypatch.setattr(checkpoints.time, "perf_counter", lambda: now)
    keeper = Keeper(Checkpoint(tmp_path / "c", every=20.0), scenario, "packets")
    write = keeper._write

    def slow(state) -> None:
        nonlocal now
        write(state)
        now += 0.5

    monkeypatch.setattr(keeper, "_write", slow)
    state = first_state(scenario)._replace(step=2000)
    written, cost = [], 0.0
    for _ in range(1000):
        now += 3.0
        keeper.offer(state)
        if keeper.cost > cost:
            cost = keeper.cost
            written.append(now)
    assert written[0] == pytest.approx(21.5)
    assert np.diff(written).min() >= 50.0
    assert keeper.cost / now <= 0.01


def test_a_state_comes_back_as_it_went(scenario, tmp_path) -> None:
    stopped(scenario, kept := Checkpoint(tmp_path / "c"), 2)
    keeper = Keeper(kept, scenario, "packets")
    state = keeper.resumed()
    assert state is not None
    first = first_state(scenario)
    kinds = [*first.soil, *first.audit, first.impulse, first.held]
    fields = [*state.soil, *state.audit, state.impulse, state.held]
    for field, kind in zip(fields, kinds, strict=True):
        assert (field.dtype, field.shape) == (kind.dtype, kind.shape)
        assert field.flags.c_contiguous
        assert field.flags.aligned
        assert field.flags.writeable
    assert state.held.sum() == state.step == 4000
    copied = copy_of(state)
    copied.soil.position[:] = 0.0
    assert state.soil.position.all()
