"""Time of an inversion with library ``sand3d``: the first one in a process, and those after it.

Prints lines ``name value``, in seconds of the processor, and the ratio of the two.
"""

from __future__ import annotations

import statistics
import time

import terraphi

RECORDS = ("li2013:yuma/straight", "li2013:poppy_loose/straight", "li2013:glass03_close/straight")


def seconds(record: str) -> float:
    """Processor time of an inversion [s]."""
    began = time.process_time()
    terraphi.invert(record, law="sand3d")
    return time.process_time() - began


def main() -> None:
    """Measure and print."""
    first = seconds(RECORDS[0])
    later = statistics.median(seconds(record) for record in RECORDS[1:] for _ in range(3))
    print(f"first_inversion_s {first:.3f}")
    print(f"later_inversion_s {later:.3f}")
    print(f"first_per_later {first / later:.1f}")


if __name__ == "__main__":
    main()
