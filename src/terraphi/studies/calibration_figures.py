"""The picture of study calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from terraphi.inference.coverage import Coverage
from terraphi.inference.library import PreparedLeg
from terraphi.plots import BLUE, GREEN, GREY, ORANGE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]


def calibration_figure(coverage: Coverage, leg: PreparedLeg, one_library: FloatArray) -> Figure:
    """Rank histogram, coverage over its nominal value, half-widths, and the particle scatter.

    Parameters
    ----------
    coverage
        Of the simulated worlds.
    leg
        The leg of the library.
    one_library
        Coverage of 68 % intervals in each world that the one library may be of [-], shape [world].
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 7.2), layout="constrained")
    (ranks, covers), (widths, scatter) = figure.subplots(2, 2)
    counts = coverage.histogram
    expected = counts.sum() / counts.size
    ranks.bar((np.arange(counts.size) + 0.5) / counts.size, counts, 0.9 / counts.size, color=BLUE)
    slack = 2.0 * np.sqrt(expected)
    ranks.axhspan(expected - slack, expected + slack, color=GREY, alpha=0.3, lw=0)
    ranks.set_xlabel("rank of the truth in its posterior")
    ranks.set_ylabel("worlds")
    ranks.set_title(f"uniform with p = {coverage.chi2_probability:.2g}; grey: ± 2 σ", fontsize=10)

    nominal = np.linspace(0.02, 0.98, 49)
    covers.plot([0, 1], [0, 1], color=GREY, lw=0.8)
    covers.plot(
        nominal, [coverage.within(p) for p in nominal], color=BLUE, label="simulated worlds"
    )
    covers.plot(
        np.full(one_library.size, 0.68), one_library, "_", color=ORANGE, ms=9,
        label="one library, world by world",
    )  # fmt: skip
    covers.set_xlabel("mass of the interval")
    covers.set_ylabel("fraction that hold the truth")
    covers.legend(frameon=False, fontsize=9)

    widths.plot(coverage.truth_deg, coverage.half_width_deg, ".", ms=2, color=BLUE)
    widths.set_yscale("log")
    widths.set_xlabel("true friction angle [deg]")
    widths.set_ylabel("half-width of the 68 % interval [deg]")

    model = leg.surrogate.scatter
    theta = model.theta_deg
    angles = np.quantile(leg.surrogate.phi_deg, [0.1, 0.5, 0.9]).tolist()
    looks = ((GREEN, "-"), (BLUE, "--"), (ORANGE, ":"))
    for phi, (colour, style) in zip(angles, looks, strict=True):
        fz = model.sigma([phi])[0, theta.size :]
        scatter.plot(theta, fz, style, color=colour, label=f"φ = {phi:.1f}°")
    scatter.set_yscale("log")
    scatter.set_xlabel("leg angle θ [deg]")
    scatter.set_ylabel("particle scatter of $F_z$ [N]")
    scatter.legend(frameon=False, fontsize=9)
    return figure
