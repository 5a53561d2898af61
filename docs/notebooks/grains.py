"""
Simulated grains, next to a shear test
======================================

Soils whose friction angle is known: spheres are sheared in a cell, and stirred by the leg.
:doc:`/grains` has all of them.
"""

# %%
# The shear test
# --------------
# Shear stress over normal stress, over the shear strain. In the steady state, in plane strain,
# sin φ = τ/σ.

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import terraphi

grains = "../../studies/data/grains/B-loose"
test = pd.concat(pd.read_csv(f"{grains}_shear_{seed}.csv", comment="#") for seed in (1, 2))
phi = np.degrees(np.arcsin(test.tau_Pa / test.sigma_Pa))
critical = phi[test.strain > 0.5].mean()
print(f"{critical:.1f}°")

# %%
# The leg
# -------
# The same soil in grains of three sizes: diameter [mm] and density [kg/m³] by file. The larger
# the grains, the larger the angle, because the leg is only 25 mm wide.

sizes = {"-fine": (4.4, 1431), "": (6.0, 1418), "-coarse": (8.8, 1406)}
answers = {}
for name, (diameter, density) in sizes.items():
    record = f"{grains}{name}_straight_1.csv"
    answers[diameter] = terraphi.invert(
        record, rig="li2013", leg="straight", density=f"{density}±7"
    )
pd.DataFrame({f"{d} mm": {"φ": a.phi.median, "sd": a.phi.sd} for d, a in answers.items()}).round(1)

# %%
# Zero grain size
# ---------------
# Sand is much finer than the leg is wide. So the line through the three is read at zero size.

slope, at_zero = np.polyfit([*answers], [a.phi.median for a in answers.values()], 1)
print(f"φ = {at_zero:.1f}°, {slope:.1f}° more a millimetre")

# %%

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), sharey=True, layout="constrained")
left.plot(test.strain, phi, ".", ms=2, color="C1")
left.set(xlabel="shear strain", ylabel="φ [deg], plane strain", title="shear cell")
for diameter, answer in answers.items():
    right.plot([diameter] * 2, answer.phi.ci95, color="C0", lw=0.8)
    right.plot([diameter] * 2, answer.phi.ci68, color="C0", lw=3)
    right.plot(diameter, answer.phi.median, "o", color="C0")
right.plot([0, 9], [at_zero, at_zero + 9 * slope], "--", color="C0", lw=1)
right.plot(0, at_zero, "o", color="C0", mfc="white", clip_on=False, zorder=3)
right.set(xlabel="diameter of the grains [mm]", title="leg", xlim=(0, 9.5), ylim=(15, 37))
for axes in (left, right):
    axes.axhline(critical, color="C1", lw=1)
figure

# %%
# These grains are among those from which the error of the model was learned. On
# :doc:`/grains` each soil is left out of what was learned before it is inverted.
