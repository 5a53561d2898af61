"""
My robot's log → φ under each footfall
======================================

Foot forces from joint torques, and φ along the path of a walk.
:doc:`/how-to/footfalls` explains the numbers.
"""

# %%
# A log
# -----
# Yours is a CSV, Parquet, MCAP or rosbag2: skip this step. Here a Go2 trots on sand in MuJoCo, by
# an example of the repository that writes ``walk.csv`` and ``truth.csv``, φ where its feet stood.

# sphinx_gallery_thumbnail_number = 3
import subprocess
import sys
import tempfile

import numpy as np
import pandas as pd

import terraphi

walk = f"{tempfile.mkdtemp()}/walk"
options = ["--out", walk, "--gait", "trot", "--duration", "4", "--seed", "4"]
script = [sys.executable, "../../examples/sand_walk.py", *options]
print(subprocess.run(script, check=True, capture_output=True, text=True).stdout)

# %%
# Foot forces
# -----------
# First look whether the log is sound: the feet should carry the weight of the robot.

forces = terraphi.foot_forces(f"{walk}/walk.csv", robot="go2")
forces

# %%

forces.plot()

# %%
# Footfalls
# ---------
# Refused footfalls have a reason instead of an angle.

soil = terraphi.footfalls(f"{walk}/walk.csv", robot="go2", density="1550±80")
soil

# %%

soil.plot()

# %%
# With an anchor
# --------------
# What all footfalls share (density, foot, force law) is most of the interval. A shear test on a
# stretch of the path removes most of it. Here the truth is known, and stands for the test.

truth = pd.read_csv(f"{walk}/truth.csv")
start = truth.phi_deg[truth.x_m < 0.4].mean()
anchor = f"x=0:0.4,phi={start:.1f}±1"
anchored = terraphi.footfalls(f"{walk}/walk.csv", density="1550±80", anchors=anchor)
figure = anchored.plot()
figure.axes[1].plot(truth.x_m, truth.phi_deg, "k.", label="truth")
figure.axes[1].legend(fontsize="small")
figure

# %%
# The mean of the interval's half width along the path [deg], before and after:

print(np.round([soil.path_absolute_sd.mean(), anchored.path_absolute_sd.mean()], 1))

# %%
# Keep it
# -------
# NetCDF, and a CSV and a GeoJSON of the same name. :doc:`map` puts them on a slope.

anchored.to_netcdf(f"{walk}/soil.nc")
