"""
My CSV → φ
==========

A table as an instrument exports it, read and inverted.
:doc:`/how-to/own-forces` describes the table.
"""

# %%
# A messy table
# -------------
# This one is made from a shipped measurement, so that the page needs no file of yours: decimal
# commas, units in the header, an angle from 0 to 180°, empty cells, noise.

# sphinx_gallery_thumbnail_number = 2
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

import terraphi

shipped = terraphi.measurement("li2013:yuma/straight").history
noise = np.random.default_rng(0).normal(0.0, 0.1, shipped.force.shape)
pounds = (shipped.force + noise) / 4.448
columns = {
    "Winkel [°]": shipped.theta_deg + 90.0,
    "Force X (lbf)": pounds[:, 0],
    "Force Z (lbf)": pounds[:, 1],
}
table = pd.DataFrame(columns)[np.abs(shipped.theta_deg) < 88.0]
table.iloc[40:43, 1] = np.nan
folder = Path(tempfile.mkdtemp())
forces = folder / "forces.csv"
table.to_csv(forces, sep=";", decimal=",", index=False, float_format="%.3f")
print(forces.read_text(encoding="utf-8")[:160])

# %%
# Read it
# -------
# What cannot be guessed is refused, with the option to add. In Python the options of ``--columns``
# are keywords.

try:
    terraphi.read_forces(forces)
except terraphi.InputError as error:
    print(error)

# %%

history = terraphi.read_forces(forces, theta_offset_deg=-90.0)
print(*history.provenance["reading"], sep="\n")
history.plot()

# %%
# Invert it
# ---------
# The forces go with the size of the leg, which is asked for: ``terraphi.Rig`` has its shape and
# sizes, and ``li2013`` is the apparatus of this record. Measure the density as well: the verdict
# hardly notices a wrong one.

answer = terraphi.invert(history, rig="li2013", leg="straight", density="1650±50")
answer

# %%
# The curve is the model at the median.

answer.plot()

# %%
# The standard deviation of φ by source [deg], and the warnings:

print(pd.Series(answer.budget_deg).round(2).to_string())
print(*answer.warnings, sep="\n")

# %%
# Most of the interval is the error of the model on real grains: :doc:`calibration` narrows it.
#
# Keep it
# -------
# The folder holds the numbers, the posterior for ArviZ and the picture.

answer.save(folder / "answer")
terraphi.report(answer, folder / "answer.html")
