"""Checkpoints: the state of a run in a file, from which the same run can go on.

A run that goes on from a checkpoint ends in the same bits as one that was never stopped, because
the state between two blocks of steps is all that the kernels know. A file is written whole or not
at all, so that a run may be killed at any time. With the state it names all that the bits depend on
(scenario, kernel, compiler, processor); if any of it has changed, the file is not used.
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
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import atomic_write, check_is_file
from terraphi.experiment.scenario import Scenario

log = logging.getLogger(__name__)

EVERY = 20.0
"""Least time between two checkpoints [s]; longer where writing takes more than the share below."""
DEAREST = 0.01
"""Largest share of a run's time that may be spent on writing checkpoints [-]."""


class State(NamedTuple):
    """State of a run between two blocks of steps; the kernels change its arrays in place."""

    soil: Any
    """A named tuple of arrays: the particles, in the order in which they were made."""
    audit: Any
    """The soil's momentum so far, :class:`~terraphi.forward.ledger.Audit`."""
    impulse: Any
    """Impulses of the soil on the leg, as of :func:`~terraphi.forward.ledger.empty_reaction`."""
    held: Any
    """Number of steps in each bin of the history [-], shape [bin]."""
    step: int
    """Number of steps taken."""


class Keeper:
    """Writes the state of a run to its checkpoint now and then, and reads it back.

    Parameters
    ----------
    path
        File of the checkpoint; ``None`` keeps nothing.
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
    """

    def __init__(self, path: Path | None, scenario: Scenario, kernel: str) -> None:
        self._path = path
        self._fitting = fitting(scenario, kernel) if path else {}
        self._began = self._last = time.perf_counter()
        self._pause = EVERY
        self.resumed_at: list[int] = []
        self.seconds = 0.0

    def resumed(self, first: State) -> State:
        """State that the checkpoint holds, or ``first`` if the run must start from the beginning.

        Raises
        ------
        InputError
            If the file is no checkpoint. One of another run is ignored, with a warning.
        """
        path = self._path
        if path is None or not path.exists():
            return first
        check_is_file(path)
        try:
            # Opened here, because NumPy leaves a file open that it finds to be broken.
            with path.open("rb") as stream, np.load(stream) as file:
                head = json.loads(str(file["head"]))
                there = head["fitting"]
                other = [k for k, here in self._fitting.items() if there.get(k) != here]
                if not other:
                    soil, audit = (
                        type(part)(*(file[f"{name}.{field}"] for field in part._fields))
                        for name, part in (("soil", first.soil), ("audit", first.audit))
                    )
                    state = State(soil, audit, file["impulse"], file["held"], int(head["step"]))
                    self.resumed_at, self.seconds = (
                        [*head["resumed_at"], state.step],
                        head["seconds"],
                    )
                    log.info("%s: going on from step %d", path, state.step)
                    return state
            name, was, now = other[0], there.get(other[0]), self._fitting[other[0]]
            why = (
                f"the checkpoint has {name.replace('_', ' ')} {str(was)[:12]} where this run has "
                f"{str(now)[:12]}"
            )
        except (OSError, EOFError, KeyError, TypeError, ValueError, zipfile.BadZipFile):
            why = "not a whole checkpoint (truncated, or another file)"
        # A checkpoint that was cut off still begins as one: another's file is left alone.
        with path.open("rb") as stream:
            ours = stream.read(4) in (b"", b"PK\x03\x04")
        if not ours:
            raise InputError(f"{path}: {why}; remove it, or name another file")
        log.warning("%s: %s; it is ignored, and the simulation starts anew", path, why)
        return first

    def offer(self, state: State) -> None:
        """Write a state if the last one was written long enough ago; on a full disk, warn."""
        began = time.perf_counter()
        if self._path is None or began - self._last < self._pause:
            return
        head = {
            "fitting": self._fitting,
            "step": state.step,
            "resumed_at": self.resumed_at,
            "seconds": self.seconds + began - self._began,
        }
        arrays = {f"soil.{name}": field for name, field in state.soil._asdict().items()}
        arrays |= {f"audit.{name}": field for name, field in state.audit._asdict().items()}
        arrays |= {"impulse": state.impulse, "held": state.held}
        try:
            with atomic_write(self._path) as temporary, temporary.open("wb") as stream:
                np.savez(stream, head=np.array(json.dumps(head)), **arrays)
                # On the disk before it takes the place of the one before.
                stream.flush()
                os.fsync(stream.fileno())
        except InputError as error:
            log.warning("no checkpoint: %s", error)
        self._last = time.perf_counter()
        self._pause = max(EVERY, (self._last - began) / DEAREST)


def fitting(scenario: Scenario, kernel: str) -> dict[str, Any]:
    """Everything that the last bit of a result depends on, by name; JSON-able."""
    import llvmlite.binding
    import numba

    from terraphi.forward.compiled import SOURCE_DIGEST

    features = getattr(numba.config, "CPU_FEATURES", None)
    if features is None:
        features = llvmlite.binding.get_host_cpu_features().flatten()
    return {
        "scenario_hash": scenario.hash,
        "kernel": kernel,
        "source": SOURCE_DIGEST,
        **{name: importlib.metadata.version(name) for name in ("numpy", "numba", "llvmlite")},
        "libc": " ".join(platform.libc_ver()),  # sine, cosine and exponential
        "processor": getattr(numba.config, "CPU_NAME", None)
        or llvmlite.binding.get_host_cpu_name(),
        "processor_features": hashlib.sha256(features.encode()).hexdigest(),
    }
