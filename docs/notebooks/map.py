"""
φ at points → where slopes may slide
====================================

Friction angles along a walk, a model of the terrain, and the probability that a slope slides.
:doc:`/how-to/map` has the limits, which matter.
"""

# %%
# Points and terrain
# ------------------
# Yours are the output of ``terraphi footfalls`` and a GeoTIFF. Here a hill is made up, and the
# angles of a walk around it.

import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import rasterio

folder = Path(tempfile.mkdtemp())
x, y = np.meshgrid(np.arange(1.0, 200.0, 2.0), np.arange(199.0, 0.0, -2.0))
hill = 40.0 * np.exp(-((x - 110) ** 2 + (y - 100) ** 2) / 2800) + 5.0 * np.sin(x / 18 + y / 25)
form = {"driver": "GTiff", "crs": "EPSG:32611", "height": 100, "width": 100, "count": 1}
form |= {"dtype": "float64", "transform": rasterio.transform.from_origin(0.0, 200.0, 2.0, 2.0)}
with rasterio.open(folder / "dem.tif", "w", **form) as file:
    file.write(hill, 1)

turn = np.linspace(-2.5, 1.5, 60)
walk = pd.DataFrame({"x_m": 105 + 65 * np.cos(turn), "y_m": 100 + 60 * np.sin(turn)})
noise = np.random.default_rng(0).normal(0.0, 1.0, turn.size)
walk["phi_deg"] = 35.0 - 0.05 * walk.x_m + noise
walk["sd_deg"], walk["shared_sd_deg"] = 1.0, 2.0
walk.to_csv(folder / "points.csv", index=False)

# %%
# The map
# -------
# Dry soil without roots. What is not known of the slope has a wide default.

options = "--prior cohesion_Pa=0:500 --prior root_cohesion_Pa=0 --prior wetness=0"
command = f"-m terraphi map points.csv --dem dem.tif --out slopes {options}".split()
done = subprocess.run([sys.executable, *command], cwd=folder, check=True, capture_output=True)
print(done.stdout.decode())

# %%
# Contours are heights. Faded cells are far from the walk, or steeper or higher than it.

layers = ("phi_median", "p_unstable", "extrapolated")
phi, p, far = (rasterio.open(folder / "slopes" / f"{name}.tif").read(1) for name in layers)
figure, axes = plt.subplots(1, 2, figsize=(9, 3.9), layout="constrained", sharey=True)
shown = ((phi, "φ [deg]", "viridis"), (p, "probability of sliding", "magma_r"))
for one, (layer, title, colors) in zip(axes, shown, strict=True):
    image = one.imshow(layer, extent=(0, 200, 0, 200), cmap=colors)
    one.contour(x, y, hill, 10, colors="black", linewidths=0.4)
    one.contourf(x, y, far, [0.5, 1.5], colors="white", alpha=0.5)
    one.plot(walk.x_m, walk.y_m, "o", ms=3, color="white", mec="black", mew=0.5)
    one.set(title=title, xlabel="x [m]", ylabel="y [m]")
    figure.colorbar(image, ax=one, shrink=0.85)
figure
