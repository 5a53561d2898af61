"""Checkpoints: the state of a run in a file, from which the same run can go on.

A run that goes on from a checkpoint ends in the same bits as one that was never stopped, because
the state between two blocks of steps is all that the kernels know. A file is written whole or not
at all. Beside the state it names all that the bits depend on (scenario, kernel, compiler,
processor); if any of it has changed, the file is not used.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import logging
import os
import platform
import time
import zipfile
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import numpy as np

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import replacing
from terraphi.experiment.scenario import Scenario
from terraphi.forward import model_version
from terraphi.forward.compiled import SOURCE_DIGEST, SOURCE_DIGEST_IN_SPACE
from terraphi.forward.mpm.bed import Soil
from terraphi.forward.plane.bed import Particles
from terraphi.forward.plane.packing import lane_count
from terraphi.forward.plane.scalar import Audit
from terraphi.forward.state import State
from terraphi.forward.watch import Checkpoint

log = logging.getLogger(__name__)

_ARCHIVE = b"PK\x03\x04"
SCHEMA = 1
"""Version of the layout of a checkpoint."""
DEAREST = 0.01
"""Largest share of a run's time that may be spent on writing checkpoints [-]."""


class Keeper:
    """Writes the state of a run to its checkpoint now and then, and reads it back.

    Parameters
    ----------
    where
        The checkpoint; ``None`` keeps nothing.
    scenario
        What is simulated.
    kernel
        Name of the kernel.

    Attributes
    ----------
    resumed_at
        Steps at which the run was taken up again.
    seconds
        Time that the processes before this one have spent on the run [s].
    cost
        Time that this process has spent on checkpoints [s].
    """

    def __init__(self, where: Checkpoint | None, scenario: Scenario, kernel: str) -> None:
        self._where = where
        self._kind: Any = Particles if scenario.dimensions == 2 else Soil
        self._fitting = fitting(scenario, kernel) if where else {}
        self._began = self._last = time.perf_counter()
        self._pause = where.every if where else 0.0
        self.resumed_at: list[int] = []
        self.seconds = 0.0
        self.cost = 0.0

    def resumed(self) -> State | None:
        """State that the checkpoint holds, or ``None`` if the run must start from the beginning.

        Raises
        ------
        InputError
            If a person named the file, and it is no checkpoint of this run.
        """
        if self._where is None:
            return None
        for file in self._where.unfinished():
            file.unlink(missing_ok=True)
        path = self._where.path
        if not path.exists():
            return None
        try:
            state, head = self._read()
        except _MisfitError as error:
            # A checkpoint that was cut off still begins as one: another's file is left alone.
            if self._where.named or not _begins_as_archive(path):
                raise InputError(f"{path}: {error}; remove it, or name another file") from error
            log.warning("%s: %s; it is ignored, and the simulation starts anew", path, error)
            return None
        self.resumed_at = [*head["resumed_at"], state.step]
        self.seconds = head["seconds"]
        log.info("%s: going on from step %d", path, state.step)
        return state

    def offer(self, state: State) -> None:
        """Write a state if the last one was written long enough ago."""
        if self._where is not None and time.perf_counter() - self._last >= self._pause:
            self.save(state)

    def save(self, state: State) -> bool:
        """Write a state now, unless it is the one before the first step, which is soon made anew.

        Parameters
        ----------
        state
            Between two blocks.

        Returns
        -------
        bool
            Whether it was written. On a full disk this warns, and the simulation goes on.
        """
        if self._where is None or state.step == 0:
            return False
        began = time.perf_counter()
        try:
            self._write(state)
        except InputError as error:
            log.warning("no checkpoint: %s", error)
            return False
        finally:
            self._last = time.perf_counter()
            self.cost += self._last - began
            if self._where.every > 0.0:
                self._pause = max(self._where.every, (self._last - began) / DEAREST)
        return True

    def last_resort(self, state: State) -> str:
        """Write the last good state of a run that broke down.

        Returns
        -------
        str
            Half a sentence for the message that says where the state is; empty if nothing is kept.
        """
        if self.save(state):
            assert self._where is not None
            return f"; the last good state, before step {state.step}, is in {self._where.path}"
        if self._where is not None and state.step == 0:
            return "; the last good state is the first one"
        return ""

    def _write(self, state: State) -> None:
        assert self._where is not None
        head = {
            "terraphi_file": "checkpoint",
            "terraphi_schema": SCHEMA,
            "fitting": self._fitting,
            "step": state.step,
            "resumed_at": self.resumed_at,
            "seconds": self.seconds + time.perf_counter() - self._began,
        }
        arrays = {f"soil.{name}": field for name, field in state.soil._asdict().items()}
        arrays |= {f"audit.{name}": field for name, field in state.audit._asdict().items()}
        arrays |= {"impulse": state.impulse, "held": state.held}
        with replacing(self._where.path) as temporary, temporary.open("wb") as stream:
            np.savez(stream, head=np.array(json.dumps(head)), **arrays)
            # On the disk before it takes the place of the one before.
            stream.flush()
            os.fsync(stream.fileno())

    def _read(self) -> tuple[State, dict[str, Any]]:
        assert self._where is not None
        try:
            # Opened here, because NumPy leaves a file open that it finds to be broken.
            with self._where.path.open("rb") as stream, np.load(stream) as file:
                head = dict(json.loads(str(file["head"])))
                self._check(head)
                state = State(
                    self._kind(*(file[f"soil.{name}"] for name in self._kind._fields)),
                    Audit(*(file[f"audit.{name}"] for name in Audit._fields)),
                    file["impulse"],
                    file["held"],
                    int(head["step"]),
                )
        except (OSError, EOFError, KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
            if isinstance(error, _MisfitError):
                raise
            raise _MisfitError("not a whole checkpoint (truncated, or another file)") from error
        return state, head

    def _check(self, head: dict[str, Any]) -> None:
        """Raise if a checkpoint would not go on in the same bits."""
        if (head["terraphi_file"], head["terraphi_schema"]) != ("checkpoint", SCHEMA):
            raise _MisfitError("a checkpoint of another version of terraphi")
        there = head["fitting"]
        for name, here in self._fitting.items():
            if there.get(name) != here:
                raise _MisfitError(
                    f"the checkpoint has {name.replace('_', ' ')} {_short(there.get(name))} "
                    f"where this run has {_short(here)}"
                )


class _MisfitError(ValueError):
    """A file is no checkpoint of this run; the message says why."""


def _begins_as_archive(path: Path) -> bool:
    """Whether a file is empty, or begins as what NumPy writes."""
    with path.open("rb") as stream:
        return stream.read(len(_ARCHIVE)) in (b"", _ARCHIVE)


def fitting(scenario: Scenario, kernel: str) -> dict[str, Any]:
    """Names and values that a checkpoint must share with a run that goes on from it.

    Parameters
    ----------
    scenario
        What is simulated.
    kernel
        Name of the kernel.

    Returns
    -------
    dict
        What the result depends on to the last bit; JSON-able.
    """
    return {
        "scenario_hash": scenario.hash,
        "model_version": model_version(scenario),
        **rests_on(kernel, dimensions=scenario.dimensions),
    }


def rests_on(kernel: str, *, dimensions: int = 2) -> dict[str, Any]:
    """What the last bit of a result depends on, besides the scenario; JSON-able.

    Parameters
    ----------
    kernel
        Name of the kernel.
    dimensions
        Those of the scenario.
    """
    features = getattr(numba.config, "CPU_FEATURES", None)
    if features is None:
        features = llvmlite.binding.get_host_cpu_features().flatten()
    return {
        "kernel": kernel,
        "kernel_source": SOURCE_DIGEST if dimensions == 2 else SOURCE_DIGEST_IN_SPACE,
        **{name: importlib.metadata.version(name) for name in ("numpy", "numba", "llvmlite")},
        "libc": " ".join(platform.libc_ver()),  # sine, cosine and exponential
        "processor": getattr(numba.config, "CPU_NAME", None)
        or llvmlite.binding.get_host_cpu_name(),
        "processor_features": hashlib.sha256(features.encode()).hexdigest(),
        "vector_lanes": lane_count(),
    }


def _short(value: Any) -> str:
    """A value for a message; a hash is cut after its first digits."""
    text = str(value)
    return text if len(text) <= 24 else f"{text[:12]}..."
