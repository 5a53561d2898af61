"""The forces on a leg over several parameters: simulations at scattered points, and between them."""

from terraphi.design_surrogate.leg import DesignSurrogate
from terraphi.design_surrogate.process import DesignGP, DesignKernel
from terraphi.design_surrogate.training import Training, training

__all__ = ["DesignGP", "DesignKernel", "DesignSurrogate", "Training", "training"]
