"""
φ → a simulator's friction
==========================

An answer as the parameter of Newton's sand, with its uncertainty.
:doc:`/how-to/simulators` has the other simulators.
"""

# %%
# The parameter
# -------------
# Newton's friction μ limits the shear stress by √J₂ ≤ μ p. In plane strain μ = sin φ.

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import terraphi

answer = terraphi.invert("li2013:yuma/straight")
soil = terraphi.export(answer, to="newton", draws=2000)
low, high = soil["ci95"]
print(f"{soil['title']}: {soil['parameter']} {soil['value']:.3f}, 95 %: {low:.3f} to {high:.3f}")
print("Not inferred:", soil["not_inferred"])

# %%
# ``out="soil.py"`` writes a module with a function that sets it. One draw for each world of a
# simulation makes a robot train on soils that all agree with the measurement.
#
# A common mistake
# ----------------
# tan φ in place of sin φ makes another soil:

wrong = float(np.tan(np.radians(answer.phi.median)))
acts = terraphi.convert(wrong, from_="newton")["phi_plane_strain_deg"]

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
axes.hist(soil["draws"], bins=50, density=True, color="C0", alpha=0.4, label="draws")
axes.axvline(soil["value"], color="C0", label=f"sin φ = {soil['value']:.2f}")
axes.axvline(wrong, color="C3", ls="--", label=f"tan φ = {wrong:.2f} acts as {acts:.0f}°")
axes.set(xlabel="Newton's friction of a particle", ylabel="density", title=f"φ = {answer.phi}")
axes.legend(frameon=False)
figure

# %%
# In other simulators
# -------------------
# One soil, six numbers:

names = ("genesis", "newton", "isaaclab", "chrono-crm", "chrono-scm", "geotaichi")
found = [terraphi.export(answer, to=name) for name in names]
pd.DataFrame(found, index=names)[["parameter", "value", "unit"]].round(2)
