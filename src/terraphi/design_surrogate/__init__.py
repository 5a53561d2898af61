"""Forces on a leg over several parameters, known at scattered points, and between them."""

from terraphi.design_surrogate.kernel import DesignKernel
from terraphi.design_surrogate.leg import DesignSurrogate
from terraphi.design_surrogate.process import DesignGP
from terraphi.design_surrogate.training import Training, training

__all__ = ["DesignGP", "DesignKernel", "DesignSurrogate", "Training", "training"]
