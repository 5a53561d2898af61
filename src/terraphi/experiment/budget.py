"""What a file may cost: the limits of all readers, in one place."""

from __future__ import annotations

import errno
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from terraphi.experiment.errors import InputError

BYTES = 1 << 30
"""Largest file or pipe, and size of all variables of a NetCDF [byte]; an hour of foot forces takes
0.2 GB, an hour of a robot's log at 500 Hz 0.7 GB as CSV."""
UNPACKED, LEAST_UNPACKED = 50, 3 << 28
"""Memory that a file may take while it is unpacked, over its size [-], and that any file may take
[byte]. A log of noise in MCAP takes 3 times its size; 1.5 million messages take the latter."""
SECONDS = 600.0
"""Longest time to read a bag [s]."""
POINTS = 500
"""Points from which the field of a map is inferred, and a window of it: 3 s of processor time for
all; time grows as their cube. The length is inferred from so many of more, drawn at random."""
PARTS = 10_000
"""Elements of a robot's model, copies counted; the Go2 has some 200."""
ITEMS, NESTING = 4_000, 3
"""Variables and groups of a NetCDF, and groups within each other; an answer has 8 variables for
each record, in groups within none."""
_one_at_a_time = threading.RLock()


@contextmanager
def unpacking(what: str, files: list[Path]) -> Iterator[None]:
    """Limit memory and disk that a block takes to unpack files; InputError, with ``what`` needs it.

    They are limits of the whole process, by POSIX; that on memory holds on Linux alone.
    """
    import resource  # browsers have none

    most = LEAST_UNPACKED + UNPACKED * sum(file.stat().st_size for file in files)
    limits = {resource.RLIMIT_FSIZE: most}
    with suppress(OSError):  # Linux alone has it
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limits[resource.RLIMIT_AS] = pages * resource.getpagesize() + most
    with _one_at_a_time:
        before = {kind: resource.getrlimit(kind) for kind in limits}
        try:
            for kind, (soft, hard) in before.items():
                finite = [end for end in (soft, hard) if end != resource.RLIM_INFINITY]
                resource.setrlimit(kind, (min([limits[kind], *finite]), hard))
            yield
        except (MemoryError, OSError) as error:
            if isinstance(error, OSError) and error.errno != errno.EFBIG:
                raise
            why = f"takes more than {most / 1e9:.2g} GB when it is unpacked"
            raise InputError(f"{what} {why}; it is damaged, copy or make it again") from error
        finally:
            for kind, ends in before.items():
                resource.setrlimit(kind, ends)
