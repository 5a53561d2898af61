"""One inversion of several force histories, for one parameter or several."""

from terraphi.inference.joint.answer import JointInversion
from terraphi.inference.joint.inversion import invert_jointly
from terraphi.inference.joint.trials import Trial

__all__ = ["JointInversion", "Trial", "invert_jointly"]
