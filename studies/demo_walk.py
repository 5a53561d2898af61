"""Make the log that ``terraphi demo`` leaves: eight seconds of a Go2 on simulated sand.

    PYTHONPATH=examples python studies/demo_walk.py

The walk of ``examples/sand_walk.py --gait walk --seed 1``, without its foot sensors; every second
sample and five digits are kept, which moves φ by 0.1°.
"""

from __future__ import annotations

from pathlib import Path

from go2.logs import table
from sand_walk import sand_log, sand_walk

from terraphi.experiment.files import atomic_write

OUT = Path(__file__).parents[1] / "src" / "terraphi" / "data" / "robots" / "walk.csv"
SEED, DURATION_S, EVERY = 1, 8.0, 2


def main() -> None:
    """Simulate, thin and write."""
    walk = sand_walk("walk", seed=SEED, duration=DURATION_S)
    log = table(sand_log(walk.run(), seed=SEED)).iloc[::EVERY]
    log = log.drop(columns=[name for name in log if "count" in name])
    times = log.pop("time_s").map("{:.3f}".format)
    log = log.map("{:.5g}".format)
    log.insert(0, "time_s", times)
    with atomic_write(OUT) as temporary:
        log.to_csv(temporary, index=False)


if __name__ == "__main__":
    main()
