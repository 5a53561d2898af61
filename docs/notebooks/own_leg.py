"""
A library of my own leg
=======================

Simulations of one leg over a range of φ, checked with a soil of known φ.
:doc:`/how-to/own-leg` says what counts.
"""

# %%
# The leg
# -------
# 100 mm long, 30 mm wide, hip 25 mm above the surface. Resistive force theory (``rft``) takes a
# second a case.

import tempfile

import numpy as np

import terraphi

scenario = terraphi.Scenario(
    model="rft",
    dimensions=3,
    leg=terraphi.Leg(chord=0.100, half_thickness=0.004, width=0.030, friction=0.4),
    motion=terraphi.Rotation(hip=(0.150, 0.195)),
    bed={"floor": 0.005, "height": 0.165},
)
angles = [15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0]
sweep = {"soil.friction_angle_deg": angles}
plan = terraphi.Plan(name="my-leg", scenario=scenario, sweep=sweep)

# %%
# Build it
# --------
# An interrupted build continues where it stopped.

library = terraphi.build(plan, f"{tempfile.mkdtemp()}/my-leg.nc")
library

# %%

library.plot()

# %%
# Check it
# --------
# Forces of a soil of 33°, with the noise of a sensor:

truth = terraphi.simulate(scenario.replace(**{"soil.friction_angle_deg": 33.0}))
noise = np.random.default_rng(0).normal(0.0, 0.05, truth.force.shape)
record = terraphi.ForceHistory(truth.position, truth.force + noise)
options = {"library": library, "density": "1650±1"}
answer = terraphi.invert(record, **options, simulated=True)
answer

# %%
# 33° is inside. ``simulated=True`` says that the model is exact. For measured sand leave it out:

terraphi.invert(record, **options)

# %%
# That interval is wide: this library has not learned how real soils differ from it.
# :doc:`/how-to/calibrate` narrows it.
#
# A real one
# ----------
# For measured sand take the material point method, with the numerics of ``sand3d``. A case takes
# a core a few minutes at 5 mm cells, and hours at the 2 mm to which ``sand3d`` was corrected.
# Without such corrections expect an error of some degrees: see :doc:`/resolution`.

# The bed of ``sand3d`` is made for a leg of 76 mm: one of 100 mm comes to 40 mm from its ends.

base = terraphi.Plan.load("sand3d").scenario
mine = {"leg.chord": 0.100, "leg.width": 0.030, "motion.hip.1": base.bed.surface + 0.025}
real = terraphi.Plan(name="my-leg-mpm", scenario=base.replace(**mine), sweep=sweep)
print(real.count, "cases of", real.scenario.model, real.scenario.dimensions, "D")

# %%
# Build it with all cores, or on a cluster (:doc:`/how-to/own-library`):
#
# .. code-block:: python
#
#    from concurrent.futures import ProcessPoolExecutor
#
#    if __name__ == "__main__":
#        with ProcessPoolExecutor() as executor:
#            terraphi.build(real, "my-leg-mpm.nc", executor=executor)
