"""Learn how real soils differ from a library's model, and write that into the library's file.

    python studies/model_error.py --library sand3d.nc

Three of the shipped media have an angle of repose, which stands for φ here; all four have a
residual. For each leg: the mean residual over the peak-to-peak of the model, the residual of each
medium less the mean of the others, and the limit above which a record is a misfit, a tenth above
the largest of these. In φ: the mean offset is not subtracted, since an angle of repose is no
friction angle of dense soil; its square and the spread between media, with a prior worth four soils
of 3°, are the width.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from terraphi.experiment.history import OBSERVATION_ANGLES, WINDOW_DEG
from terraphi.experiment.measurements import measurement
from terraphi.inference.checks import without_faults
from terraphi.inference.likelihood import Likelihood
from terraphi.inference.records import open_record
from terraphi.library.store import Library

MEDIA = ("poppy_loose", "glass03_loose", "glass03_close", "yuma")
THETA_DEG = np.linspace(-WINDOW_DEG, WINDOW_DEG, OBSERVATION_ANGLES)
PRIOR_SOILS, PRIOR_SD_DEG = 4, 3.0
MARGIN = 1.1
"""Limit of a misfit over the largest residual of a training record [-]."""


def read(library: Library, medium: str, leg: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Angle by least squares [deg], and residual over the model's peak-to-peak [-], [2, theta].

    The last is the model's peak-to-peak of each force over the data's [-], [2].
    """
    record = without_faults(open_record(f"li2013:{medium}/{leg}"))
    likelihood = Likelihood([record], replace(library, model_error={}))
    best = likelihood.least_squares
    curve = likelihood.curves(best[None])[0].reshape(2, -1)
    share = (record.data - curve) / np.ptp(curve, axis=1)[:, None]
    rows = np.stack([np.interp(THETA_DEG, record.theta_deg, row) for row in share])
    return float(best[0]), rows, np.ptp(curve, axis=1) / record.span


def learn(library: Library) -> dict[str, dict]:
    """Model error by leg, as `terraphi.inference.soils.ModelError` has it."""
    found = {(m, leg): read(library, m, leg) for m in MEDIA for leg in library.legs}
    level = {}
    for medium in MEDIA:
        repose = measurement(f"li2013:{medium}/straight").angle_of_repose_deg
        if repose is not None:
            level[medium] = np.array([found[medium, leg][0] - repose for leg in library.legs])
    means = np.array([each.mean() for each in level.values()])
    square = (PRIOR_SOILS * PRIOR_SD_DEG**2 + means @ means) / (PRIOR_SOILS + len(means))
    legs = np.sqrt(np.mean([each.var(ddof=1) for each in level.values()]))
    sizes, errors = {}, {}
    for leg in library.legs:
        residual = {medium: found[medium, leg][1] for medium in MEDIA}
        for medium in MEDIA:
            others = np.mean([residual[one] for one in MEDIA if one != medium], axis=0)
            # Over the data's peak-to-peak, as the verdict has it.
            spans = found[medium, leg][2]
            left = [(np.sqrt(np.square(r).mean(axis=1)) * spans).max()
                    for r in (residual[medium], residual[medium] - others)]  # fmt: skip
            sizes[medium, leg] = min(left)
            print(
                f"{medium:14} {leg:11} φ {found[medium, leg][0]:5.1f}°  residual {left[0]:.3f}, "
                f"less the mean of the other media {left[1]:.3f}"
            )
        errors[leg] = {
            "offset_deg": 0.0,
            "common_sd_deg": round(float(np.sqrt(max(square - PRIOR_SD_DEG**2, 0.0))), 2),
            "soil_sd_deg": PRIOR_SD_DEG,
            "leg_sd_deg": round(float(legs), 2),
            "theta_deg": THETA_DEG.round(3).tolist(),
            "residual": np.mean(list(residual.values()), axis=0).round(4).tolist(),
            "training": [f"li2013:{medium}/{leg}" for medium in MEDIA],
        }
    limit = MARGIN * max(sizes.values())
    for leg in errors:
        errors[leg] |= {"nrmsd_limit": round(float(limit), 3)}
    print({key: value for key, value in errors["straight"].items() if not isinstance(value, list)})
    return errors


def main() -> None:
    """Learn, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--library", required=True, help="file; changed in place")
    library = Library.load(parser.parse_args().library)
    path = parser.parse_args().library
    replace(library, model_error=learn(library)).save(path)


if __name__ == "__main__":
    main()
