"""
A leg of my own
===============

Five sizes make a rig. :doc:`/how-to/own-leg` describes them.
"""

# %%
# The rig
# -------
# 110 mm from the hip to the tip, 40 mm wide, 8 mm thick, the hip 35 ± 1 mm above the soil.

import matplotlib.pyplot as plt
import numpy as np

import terraphi

rig = terraphi.Rig(leg="straight", length_mm=110, width_mm=40, thickness_mm=8, hip_height_mm="35±1")
print(rig)

# %%
# Forces of a soil whose angle is known: simulated with three-dimensional resistive force theory,
# with the noise of a sensor.

scenario = terraphi.Scenario.load("quick").replace(
    **{"leg.chord": 0.110, "leg.width": 0.040, "leg.half_thickness": 0.004},
    **{"motion.hip.1": 0.170 + 0.035, "soil.friction_angle_deg": 33.0},
)
truth = terraphi.simulate(scenario)
noise = np.random.default_rng(0).normal(0.0, 0.05, truth.force.shape)
record = terraphi.ForceHistory(truth.position, truth.force + noise)

# %%
# A rough angle at once
# ---------------------
# Resistive force theory needs no simulations: law ``rft3d`` covers any rig in a fraction
# of a second. With ``simulated=True`` the model is exact.

options = {"rig": rig, "density": "1650±1", "law": "rft3d"}
answer = terraphi.invert(record, **options, simulated=True)
answer

# %%
# 33° is inside. For measured sand leave ``simulated`` out: the theory differs from real soils.

rough = terraphi.invert(record, **options)
rough

# %%
# The other way round, an answer for the wrong size looks right and is not: the forces of this leg,
# taken for those on the 76 mm leg of Li et al. (2013).

wrong = terraphi.invert(record, **options | {"rig": "li2013", "leg": "straight"})
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for name, one in (("110 mm", rough), ("76 mm", wrong)):
    axes.plot(one.grid_deg, one.density, label=f"{name}: {one.verdict.replace('_', ' ')}")
axes.axvline(33.0, color="black", ls=":", label="true")
axes.set(xlabel="φ of rft3d [deg]", ylabel="posterior density [1/deg]", xlim=(10, 62), ylim=0)
axes.legend(frameon=False)
figure

# %%
# The law of legs
# ---------------
# Without ``law`` measured forces are read by law ``legs``, simulated in three dimensions for many
# proportions. Here it reads forces that another theory made.

terraphi.invert(record, rig=rig, density=1650)

# %%
# Simulations of one's own
# ------------------------
# Legs outside these proportions need simulations of their own: two to five minutes of a core for
# each of three angles. Bed, cells and steps follow from the sizes of the rig.

plan = terraphi.Plan.of_rig(rig)
print(plan.count, "cases in cells of", 1e3 * plan.scenario.numerics.cell_size, "mm")

# %%
# The leg is simulated at the length of Li's, since slow soil has no length of its own; inversion
# scales the forces. Build it with all cores, or on a cluster (:doc:`/how-to/own-library`):
#
# .. code-block:: console
#
#    $ terraphi library build --rig rig.toml --out mine.nc
#    $ terraphi invert forces.csv --rig rig.toml --law mine.nc --density 1600
#
# They join the cases of law ``legs``, which has learned from all of them what friction, cohesion
# and the height of the hip do, and from simulated grains how real soils differ from it.
