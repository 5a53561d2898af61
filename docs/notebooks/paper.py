"""
The paper of Xu & Wang
======================

Their simulated forces against measured ones, and their test: is a known angle found again?
:doc:`/paper` compares every number.
"""

# %%
# Forces
# ------
# The library ``paper`` holds their simulations in plane strain, as printed, ``paper-code`` those
# with the contact of their public code. Li et al. measured the same leg in Yuma sand. The angle
# of 35° is in the paper's own convention: see :doc:`/explanation/friction-angle`.

import matplotlib.pyplot as plt
import numpy as np

import terraphi
from terraphi.paper.numbers import recovery


def simulated(name):
    """The forces at 35°."""
    cases = terraphi.Library.load(name).cases
    return next(c.history for c in cases if c.scenario.soil.friction_angle_deg == 35.0)


curves = {
    "measured": terraphi.measurement("li2013:yuma/straight").history,
    "by the text": simulated("paper"),
    "by the code": simulated("paper-code"),
}

# %%
# Recovery
# --------
# Fourteen simulations that the library does not contain, inferred with the paper's two Gaussian
# processes and its likelihood.

cases = recovery("paper", draws=False).data["cases"]
true = np.array([case["phi_true_deg"] for case in cases])
median = np.array([case["phi_median_deg"] for case in cases])
low, high = np.transpose([case["ci68"] for case in cases])
inside = np.sum((low <= true) & (true <= high))
print(f"largest error {np.abs(median - true).max():.2f}°, {inside} of {true.size} inside 68 %")

# %%

figure, (left, middle, right) = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
for label, history in curves.items():
    style = {"color": "black", "lw": 2} if label == "measured" else {"lw": 1}
    left.plot(history.theta_deg, history.Fx, **style, label=label)
    middle.plot(history.theta_deg, history.Fz, **style)
left.set(xlabel="leg angle θ [deg]", ylabel="$F_x$ [N]", xlim=(-100, 100))
middle.set(xlabel="leg angle θ [deg]", ylabel="$F_z$ [N]", xlim=(-100, 100))
left.legend(frameon=False, fontsize="small")
right.errorbar(true, median - true, [median - low, high - median], fmt="o", ms=4)
right.axhline(0.0, color="0.5", lw=0.8)
right.set(xlabel="true φ [deg]", ylabel="error of φ, 68 % [deg]", title="recovery, by the text")
figure

# %%
# Both are right: the method finds the angle of its own model within a tenth of a degree, and the
# model in plane strain does not have the forces of the sand. That is why :doc:`measured forces
# </explanation/model>` are inverted with a model in three dimensions.
