"""Assumptions for what a user did not measure: one value each, its standard deviation, its source.

They belong to measurements. The soil and leg of a simulation have defaults of their own
(:class:`~terraphi.experiment.soil.Soil`, :class:`~terraphi.experiment.leg.Leg`), and a fitted law
keeps the density and the friction that it was simulated with.
"""

from __future__ import annotations

from typing import NamedTuple


class Assumption(NamedTuple):
    """Mean and standard deviation of a quantity that was not measured."""

    mean: float
    sd: float

    def __str__(self) -> str:
        """Mean and standard deviation as a user writes them, such as ``0.3±0.09``."""
        return f"{self.mean:g}±{round(self.sd, 2):g}"


DENSITY = Assumption(1600.0, 160.0)
"""Bulk density of dry soil [kg/m³]. Uniform quartz sand has 1430 (loose, porosity 0.46) to 1750
(dense, 0.34), mixed-grained sand 1590 to 1860 (Terzaghi, Peck & Mesri 1996, typical porosities).
The mean is the middle of uniform sand, of which test beds are made, and 10 % hold half of the
mixed-grained sands, too. Porous or light grains are outside: poppy seeds have 640."""
DENSITY_SD_PART = 0.05
"""Standard deviation of a density given without one, over it [-]; chosen."""
FRICTION = Assumption(0.30, 0.0866)
"""Coulomb friction between dry soil and a leg or a plate [-]: uniform on 0.15 to 0.45. Smooth
steel on sand has 0.54 of the friction angle, rusted steel 0.76 (Potyondy 1961, Géotechnique
11:339): 0.32 and 0.47 at a critical angle of 33°. Polished steel goes down to 0.1, and friction
grows with the roughness over the grain size (Uesugi & Kishida 1986, Soils and Foundations
26:139)."""
FRICTION_BY_TORQUE_SD = 0.05
"""Standard deviation of a wheel's friction by its torque [-]; chosen."""
FOOT_FRICTION = Assumption(0.40, 0.1155)
"""Coulomb friction between dry soil and a robot's foot of rubber [-]: uniform on 0.2 to 0.6, from
polished steel to soil on soil, which no surface exceeds (Uesugi & Kishida 1986); chosen."""
SENSOR_GAIN = Assumption(1.0, 0.02)
"""Gain of a load cell [-]; chosen."""
HIP_HEIGHT_SD_MM = 2.0
"""Height of a leg's hip [mm]; chosen."""
COHESION_SD_PART = 1.0 / 3.0
"""Cohesion that is given without its error, over it [-]; chosen."""
DAMP_PA = 100.0
"""Cohesion of damp soil that an answer states φ for [Pa]: simulated grains with 1 % of liquid have
40 to 180 Pa."""
CONTACT_SD_M, CONTACT_SD_PART = 1e-3, 0.03
"""Sinkage of a plate at first contact [m], and over its radius [-]; the larger counts; chosen."""

TORQUE_GAIN_SD = 0.1
"""Gain of each joint's torque [-]: walking controllers are trained for motors that differ by ± 10 %
(Margolis & Agrawal, CoRL 2022)."""
JOINT_FRICTION_SD_NM = 0.2
"""Coulomb friction of a joint that does not swing [N m]: ``frictionloss`` of the Go2's joints in
MuJoCo Menagerie."""
JOINT_FRICTION_SD_PART = 0.2
"""Coulomb friction of a joint that was measured in swing, over it [-]: its error in walks of known
friction (``tests/robot/test_friction.py``)."""
ATTITUDE_SD_DEG = 1.0
"""Roll and pitch [deg]: an error of g/57 in the mean reading of an accelerometer that shakes with
the trunk."""
ROBOT_MASS_SD_PART = 0.02
"""Mass of a robot, over it [-]: a payload of 0.3 kg on a Go2; chosen."""
FOOT_RADIUS_SD_M = 0.0005
"""Radius of a robot's foot [m]; chosen."""
TOUCHDOWN_DEPTH_SD_M = 0.01
"""Depth of a foot in the soil at the first force [m]; chosen."""
SOLE_DEPTH_SD_PART = 0.015
"""Depth of a flat sole in the soil at the first force, which is large at once, over its length [-]:
an error of its tilt of 1° lifts an end by 0.009, and the soil gives way; chosen."""
ODOMETRY_DRIFT_SD = 0.01
"""Vertical speed by which odometry drifts [m/s]; chosen."""
DROP_SD_PART = 0.02
"""Way that feet go down by odometry, over it [-]: standing feet give way while the load moves over,
and the attitude errs; chosen."""
