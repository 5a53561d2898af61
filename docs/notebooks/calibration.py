"""
A soil of known φ → a narrower interval
=======================================

A soil whose friction angle you measured takes off a part of the error of model and apparatus.
:doc:`/how-to/calibrate` has the steps.
"""

# %%
# Two soils in one apparatus
# --------------------------
# Both are simulated spheres of 6 mm, stirred by the straight leg. A shear cell measured both:
# 25.7 and 31.4°. The first calibrates. The angle of the second is kept for the comparison.

import matplotlib.pyplot as plt

import terraphi

grains = "../../studies/data/grains"
known, other = f"{grains}/B-loose_straight_1.csv", f"{grains}/C-loose_straight_1.csv"
leg = {"rig": "li2013", "leg": "straight"}

before = terraphi.invert(other, **leg, density="1335±7")
before

# %%
# Too high: grains that are large compared with the leg raise its forces, and the model is a
# continuum. Sand has no such error, but every apparatus has some.
#
# Calibrate
# ---------
# The calibration soil has the same error.

calibration = terraphi.calibrate(known, 25.7, 1.0, **leg, density="1418±7")
after = terraphi.invert(other, **leg, density="1335±7", calibration=calibration)
after

# %%
# The calibration takes off a part of the difference that its soil shows. The rest may be of that
# soil alone: more calibration soils take off more.

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
for name, answer, color in (("before", before, "0.5"), ("calibrated", after, "C0")):
    low, high = answer.phi.ci68
    grid, density = answer.grid_deg, answer.density
    label = f"{name}: {answer.phi.median:.1f}° ± {(high - low) / 2:.1f}°"
    axes.plot(grid, density, color=color, label=label)
    inside = (low <= grid) & (grid <= high)
    axes.fill_between(grid[inside], density[inside], color=color, alpha=0.3, lw=0)
axes.axvline(31.4, color="black", ls=":", label="shear cell: 31.4°")
axes.set(xlabel="φ [deg], plane strain", ylabel="posterior density [1/deg]", xlim=(20, 50), ylim=0)
axes.legend(frameon=False)
figure

# %%
# The sources of error, before and after [deg]. The height of the hip, the friction of the leg and
# the gain of the sensor stay in an apparatus: with the same leg they are part of what was
# calibrated.

for name, before_deg in before.budget_deg.items():
    print(f"{name:25} {before_deg:4.1f} → {after.budget_deg.get(name, 0.0):.1f}")
