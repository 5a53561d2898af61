"""
A robot's log
=============

A Unitree Go2 trots in MuJoCo, and writes a log as the robot would: quantised, noisy, late, and
not whole. The simulation knows the true forces on its feet, so that we can see how well the
estimators do.
"""

# %%
# The walk
# --------
#
# The simulation lies in ``examples/go2``.

import numpy as np
from go2.sensors import Sensors, realistic_log
from go2.walk import Walk

from terraphi.robot.joint_log import FEET
from terraphi.robot.results import analyse
from terraphi.view.robot_plots import forces_figure, stance_figure

truth = Walk(duration=4.0).run()
log = realistic_log(truth, Sensors(), seed=0)
print(f"{truth.time[-1]:.1f} s, {len(log.time)} samples logged")

# %%
# Forces and stances
# ------------------

found = analyse(log)
forces = forces_figure(found)
for foot in FEET:
    mean = found.feet[foot]
    print(
        f"{foot}: {mean.count} stances of {mean.duration:.2f} s, "
        f"mean peaks {mean.peak('z'):.0f} N up and {mean.peak('x'):.0f} N along x"
    )

# %%
# The mean course of a stance, over all stances and feet:

stances = stance_figure(found)

# %%
# How well?
# ---------
#
# Root mean square error while a foot stands, for each estimator. The paper's, ``quasi_static``,
# leaves out the weight and the inertia of the legs, and the friction of the joints.


def error_in_stance(result):
    """Root mean square error of x, y, z [N], where the ground truly carries the foot."""
    force, time = result.forces.force, result.forces.time
    true = np.empty(force.shape)
    for place in np.ndindex(4, 3):
        own = (slice(None), *place)
        true[own] = np.interp(time, truth.time, truth.force[own])
    standing = true[:, :, 2] > 1.0
    return np.sqrt(np.nanmean((force - true)[standing] ** 2, axis=0))


for estimator in ("quasi_static", "gravity", "inverse_dynamics", "momentum_observer"):
    x, y, z = error_in_stance(analyse(log, estimator=estimator))
    print(f"{estimator:18s} x {x:.1f} N, y {y:.1f} N, z {z:.1f} N")
