"""Particle scatter of simulated forces: its model, and how it is estimated."""

from terraphi.scatter.estimation import corrected, estimate, with_tail
from terraphi.scatter.model import Scatter

__all__ = ["Scatter", "corrected", "estimate", "with_tail"]
