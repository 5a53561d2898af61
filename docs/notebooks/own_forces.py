"""
My CSV → φ
==========

A table as an instrument exports it, read, inverted and calibrated.
:doc:`/how-to/own-forces` says what the table must hold.
"""

# %%
# A messy table
# -------------
# This one is made from a shipped measurement, so that the page needs no file of yours: decimal
# commas, units in the header, an angle from 0 to 180°, empty cells, noise.

# sphinx_gallery_thumbnail_path = 'demo.png'
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
table.to_csv("forces.csv", sep=";", decimal=",", index=False, float_format="%.3f")
print(Path("forces.csv").read_text(encoding="utf-8")[:160])

# %%
# Read it
# -------
# What cannot be guessed is refused, with the option to add. In Python the options of ``--columns``
# are keywords.

try:
    terraphi.read_forces("forces.csv")
except terraphi.InputError as error:
    print(error)

# %%

history = terraphi.read_forces("forces.csv", theta_offset_deg=-90.0)
print(*history.provenance["reading"], sep="\n")
history.plot()

# %%
# Invert it
# ---------
# Measure the density: the verdict hardly notices a wrong one.

known = {
    "leg": "straight",
    "density": "1650±50",
    "columns": {"theta_offset_deg": -90.0},
}
answer = terraphi.invert("forces.csv", **known)
answer

# %%
# The dashed curve is the model at the median. The solid one adds the mean residual of real soils.

answer.plot()

# %%
# The standard deviation of φ by source [deg], and the warnings:

print(pd.Series(answer.budget_deg).round(2).to_string())
print(*answer.questions, sep="\n")

# %%
# Calibrate
# ---------
# Most of the interval is the error of the model on real grains. A soil whose φ you measured by
# other means narrows it. Here the record of another soil stands for yours, and its 36 ± 1° is an
# example, not a measurement.

calibration = terraphi.calibrate("li2013:poppy_loose/straight", 36.0, 1.0)
after = terraphi.invert("forces.csv", **known, calibration=calibration)
pd.concat({"before": answer.summary(), "calibrated": after.summary()}).round(1)

# %%
# Keep it
# -------
# ``answer`` holds the numbers, the posterior for ArviZ and the picture.

answer.save("answer")
terraphi.report(answer, "answer.html")
