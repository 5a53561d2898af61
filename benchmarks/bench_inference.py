"""Speed of an inversion: what quadrature costs, and emcee beside it.

Prints lines ``name value``: medians over the truths of a shipped library. The core of an inversion,
likelihood and posterior, is the best of several turns; longer work is in seconds of the processor.
"""

from __future__ import annotations

import statistics
import time

from terraphi.inference.inversion import invert
from terraphi.library.store import Library

LIBRARY = "quick-plane-strain"
POSTERIORS = 14
TURNS = 7


def main() -> None:
    """Measure and print."""
    library = Library.load(LIBRARY)
    histories = [case.history for case in Library.load(f"{LIBRARY}-truths").cases if case.history]
    core: dict[str, float] = {}
    for discrepancy in ("none", "gp"):
        options = {"library": library, "likelihood": "calibrated", "discrepancy": discrepancy}
        invert(histories[0], **options)  # prepares the leg
        found, whole = [], []
        for history in histories:
            began = time.process_time()
            turns = [invert(history, **options).provenance["core_seconds"] for _ in range(TURNS)]
            whole.append((time.process_time() - began) / TURNS)
            found.append(min(turns))
        core[discrepancy] = statistics.median(found)
        print(f"core_{discrepancy}_ms {1e3 * core[discrepancy]:.2f}")
        print(f"inversion_{discrepancy}_ms {1e3 * statistics.median(whole):.2f}")
    print(f"core_gp_per_none {core['gp'] / core['none']:.2f}")
    for likelihood in ("calibrated", "paper"):
        began = time.process_time()
        for i in range(POSTERIORS):
            history = histories[i % len(histories)]
            invert(history, library=library, likelihood=likelihood, sampler="emcee", seed=i)
        seconds = time.process_time() - began
        print(f"emcee_{POSTERIORS}_posteriors_{likelihood}_s {seconds:.2f}")
        if likelihood == "calibrated":
            print(f"emcee_per_quadrature {seconds / POSTERIORS / core['none']:.0f}")


if __name__ == "__main__":
    main()
