"""Both forces of a leg over phi, and the covariance of all that is not known of them."""

from terraphi.joint_surrogate.evidence import JointKernel
from terraphi.joint_surrogate.process import JointSurrogate

__all__ = ["JointKernel", "JointSurrogate"]
