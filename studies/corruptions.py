"""Damaged records: answers of `terraphi invert` to 30 kinds of damage of each shipped record.

A damage is silent if the answer is consistent, warns of nothing new compared with the
undamaged record, and lies outside the 95 % interval of the undamaged record. That a record was
tared is no warning here. Wrong sizes of the leg are counted separately: another leg in another soil
may have the same forces.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np
import pandas as pd

import pages
import terraphi
from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.measurements import measurement, names
from terraphi.experiment.rig import LI2013

SIZES = {"length_mm": (50, 60, 90, 100, 150), "width_mm": (10, 15, 40, 50),
         "thickness_mm": (3, 12), "hip_height_mm": (0, 10, 15, 25, 30, 40)}  # fmt: skip
"""Sizes of the leg that are typed in instead of Li's [mm]."""
POUND, KILOGRAM = 4.448, 9.81
"""Newtons of a pound and of a kilogram of force."""


class Damaged(NamedTuple):
    """A record, or one that was damaged."""

    kind: str
    theta: FloatArray
    """[deg]."""
    fx: FloatArray
    """[N]."""
    fz: FloatArray
    """[N]."""
    density: float = 1.0
    """Over the true one [-]."""
    leg: str = ""
    """Another leg than that of the record."""
    size: tuple[str, float] | None = None
    """A wrong size of the leg [mm]."""


def damages(theta: FloatArray, x: FloatArray, z: FloatArray) -> Iterator[Damaged]:
    """All damages of one record."""
    rng = np.random.default_rng(1)
    peak, count = max(np.ptp(x), np.ptp(z)), len(theta)
    ramp, turn = np.linspace(0.0, 1.0, count), np.radians(theta)

    def one(kind: str, fx: FloatArray = x, fz: FloatArray = z, at: FloatArray = theta) -> Damaged:
        return Damaged(kind, at, fx, fz)

    whole = one("")
    for factor in (0.1, 0.25, 0.5, 0.75, 1.25, 1.5, 2, 4, 10, 1 / POUND, POUND, 1 / KILOGRAM,
                   KILOGRAM, 1e-3, 1e3):  # fmt: skip
        yield one("both forces or their unit", factor * x, factor * z)
    for factor in (0.5, 0.7, 1.3, 2.0):
        yield whole._replace(kind="density", density=factor)
    for name, values in SIZES.items():
        for value in values:
            yield whole._replace(kind=f"size: {name[:-3].replace('_', ' ')}", size=(name, value))
    for leg in pages.LEGS:
        yield whole._replace(kind="another leg", leg=leg)
    for fx, fz in (
        (-x, z),
        (x, -z),
        (-x, -z),
        (z, x),
        (-z, x),
        (abs(x), abs(z)),
        (np.maximum(x, 0), np.maximum(z, 0)),
        (z, z),
        (x, x),
        (0 * x, z),
        (x, 0 * z),
    ):
        yield one("signs, axes exchanged, one missing", fx, fz)
    for factor in (0.25, 0.5, 0.75, 1.5, 2, 4):
        yield one("gain of one force", fx=factor * x)
        yield one("gain of one force", fz=factor * z)
    for part in (0.05, 0.1, 0.2, 0.5, -0.05, -0.1, -0.2, -0.5):
        yield one("zero of one force", fx=x + part * peak)
        yield one("zero of one force", fz=z + part * peak)
    for part in (0.1, 0.2, 0.5, -0.1, -0.2, -0.5):
        yield one("drift of one force", fx=x + part * peak * ramp)
        yield one("drift of one force", fz=z + part * peak * ramp)
    for off in (-30, -20, -10, -5, 5, 10, 20, 30, 90):
        yield one("zero of θ", at=theta + off)
    for factor in (0.5, 0.8, 0.9, 1.1, 1.2, 2.0, np.pi / 180.0, 180.0 / np.pi):
        yield one("scale of θ", at=factor * theta)
    yield one("time reversed", x[::-1], z[::-1], -theta[::-1])
    yield one("one force late", fx=np.interp(theta - 10.0, theta, x))
    for part in (0.3, 0.5, 0.7, 0.9):
        most = part * abs(x).max(), part * abs(z).max()
        yield one("clipped", np.clip(x, -most[0], most[0]), np.clip(z, -most[1], most[1]))
        yield one("clipped", fz=np.clip(z, -most[1], most[1]))
    for part in (0.05, 0.1, 0.2, 0.3):
        yield one(
            "dead zone",
            *(np.sign(f) * np.maximum(abs(f) - part * abs(f).max(), 0.0) for f in (x, z)),
        )
    for start, length in ((0.2, 0.2), (0.4, 0.2), (0.6, 0.2), (0.3, 0.4), (0.5, 0.3)):
        lost = (ramp > start) & (ramp < start + length)
        first = np.flatnonzero(lost)[0]
        yield one("stuck or lost", np.where(lost, x[first], x), np.where(lost, z[first], z))
        yield one("stuck or lost", np.where(lost, 0.0, x), np.where(lost, 0.0, z))
        yield one("stuck or lost", fz=np.where(lost, 0.0, z))
    for part in (0.05, 0.1, 0.2, 0.5):
        yield one("noise", *(f + part * peak * rng.normal(size=count) for f in (x, z)))
    for width in (10, 20, 40, 60):
        size = max(int(width / max((theta[-1] - theta[0]) / (count - 1), 1e-6)), 1)
        yield one("smoothed", *(
            np.convolve(np.pad(f, (size // 2, size - 1 - size // 2), mode="edge"),
                        np.ones(size) / size, "valid") for f in (x, z)))  # fmt: skip
    for number in (3, 10):
        fx, fz, at = x.copy(), z.copy(), rng.choice(count, number, replace=False)
        fx[at] *= 20.0
        fz[at] *= -20.0
        yield one("spikes", fx, fz)
    for part in (0.1, 0.25):
        yield one("coarse steps", *(np.round(f / (part * peak)) * part * peak for f in (x, z)))
    for angle in (*np.radians([-20, -10, -5, 5, 10, 20, 45, 90]), turn, -turn):
        yield one("axes turned, or of the leg", x * np.cos(angle) + z * np.sin(angle),
                  z * np.cos(angle) - x * np.sin(angle))  # fmt: skip
    for part in (0.1, 0.2, 0.4):
        yield one("crosstalk", x + part * z, z + part * x)
    for part in (0.1, 0.2, 0.5):
        yield one("weight of the leg", x + part * peak * np.sin(turn),
                  z - part * peak * np.cos(turn))  # fmt: skip
    for power in (0.5, 1.5, 2.0):
        yield one("not linear", *(np.sign(f) * abs(f / peak) ** power * peak for f in (x, z)))
    for low, high in ((0, 0.5), (0.5, 1), (0.25, 0.75), (0, 0.7), (0.3, 1)):
        part = (low <= ramp) & (ramp <= high)
        yield one("part of the stroke", x[part], z[part], theta[part])
        for factor in (0.7, 1.4):
            yield one("a part, gain of one force", factor * x[part], z[part], theta[part])
    yield one("mean taken off", x - x.mean(), z - z.mean())
    yield one("no signal", np.full(count, x.mean()), np.full(count, z.mean()))
    yield one("no signal", *(peak * rng.normal(size=count) for _ in range(2)))


def inverted(damaged: Damaged, leg: str, density: float) -> terraphi.Answer:
    """The answer to a damaged record, its density known to 3 %."""
    sizes = {key: value for key, value in LI2013.items() if key != "leg"}
    sizes |= dict([damaged.size] if damaged.size else [])
    density *= damaged.density
    return terraphi.invert(
        pd.DataFrame({"theta_deg": damaged.theta, "Fx_N": damaged.fx, "Fz_N": damaged.fz}),
        rig=terraphi.Rig(leg=damaged.leg or leg, **sizes), density=f"{density}±{0.03 * density}",
    )  # fmt: skip


def warnings(answer: terraphi.Answer) -> set[str]:
    """Warnings of an answer without their numbers; not that it was tared."""
    return {
        re.sub(r"[-+]?\d[\d.]*", "#", warning) for warning in answer.warnings
        if not warning.startswith("Tared")
    }  # fmt: skip


def outcomes(name: str) -> list[tuple[str, str]]:
    """Kind and outcome of each damage of a shipped record.

    Raises
    ------
    InputError
        If the whole record has no consistent answer.
    """
    record, leg = measurement(name), name.rpartition("/")[2]
    history, density = record.history, float(record.density_kg_m3 or 0.0)
    order = np.argsort(history.theta_deg)
    forces = [column[order] for column in (history.theta_deg, history.Fx, history.Fz)]
    whole = inverted(Damaged("", *forces), leg, density)
    if whole.verdict != "consistent" or whole.phi is None:
        raise terraphi.InputError(f"{name}: the whole record is not consistent")
    (low, high), found = whole.phi.ci95, []
    for damaged in damages(*forces):
        if damaged.leg == leg:
            continue
        try:
            answer = inverted(damaged, leg, density)
        except terraphi.InputError:
            found.append((damaged.kind, "refused"))
            continue
        if answer.verdict != "consistent" or answer.phi is None:
            outcome = "refused"
        elif warnings(answer) - warnings(whole):
            outcome = "warned"
        else:
            outcome = "inside" if low <= answer.phi.median <= high else "silent"
        found.append((damaged.kind, outcome))
    return found


def main() -> None:
    """Damage all records, and write the page."""
    out = pages.out_from(__doc__.splitlines()[0])
    with ProcessPoolExecutor() as pool:
        counts = Counter(itertools.chain.from_iterable(pool.map(outcomes, names())))
    columns = ("refused", "warned", "inside", "silent")
    kinds = sorted(dict.fromkeys(kind for kind, _ in counts), key=lambda kind: kind[:5] == "size:")
    rows = [
        (kind, sum(counts[kind, c] for c in columns), *(counts[kind, c] for c in columns))
        for kind in kinds
    ]
    sizes = [row for row in rows if row[0].startswith("size:")]
    (total, silent), (of_size, silent_size) = (
        [sum(row[k] for row in some) for k in (1, -1)] for some in (rows, sizes)
    )
    right, of_right = silent - silent_size, total - of_size
    parts = [
        (
            f"The {len(names())} records of Li et al., each damaged in {total / len(names()):.0f} "
            "ways. *Refused*: an error, a misfit or out of range. *Warned*: consistent, with a "
            "warning that the whole record does not have. *Inside*: the angle stays within the "
            "95 % interval of the whole record. *Silent*: it does not, without a warning."
        ),
        pages.table(("damage", *columns), [(kind, *numbers) for kind, _, *numbers in rows]),
        (
            f"Silent are {silent} of {total} ({silent / total:.1%}); with the right sizes of the "
            f"leg {right} of {of_right} ({right / of_right:.1%})."
        ),
    ]
    pages.write(out, "corruptions", "Damaged records", parts)


if __name__ == "__main__":
    main()
