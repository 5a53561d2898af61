"""From measured forces to a friction angle with its uncertainty, and whether to believe it.

`residual` holds the likelihood, `posterior` integrates it, `convergence` says how far draws can be
trusted, `verdict` whether the answer can.
"""

from terraphi.inference.convergence import (
    EnsembleDiagnostics,
    autocorrelation_time,
    diagnose,
    effective_sample_size,
    median_standard_error,
    split_rhat,
)
from terraphi.inference.findings import Verdict
from terraphi.inference.paper_likelihood import (
    Likelihood,
    PaperLikelihood,
    peak_to_peak,
    residual_correlation_length_deg,
)
from terraphi.inference.posterior import LogLikelihood, Posterior, ensemble, quadrature
from terraphi.inference.verdict import judge, nrmsd

__all__ = [
    "EnsembleDiagnostics",
    "Likelihood",
    "LogLikelihood",
    "PaperLikelihood",
    "Posterior",
    "Verdict",
    "autocorrelation_time",
    "diagnose",
    "effective_sample_size",
    "ensemble",
    "judge",
    "median_standard_error",
    "nrmsd",
    "peak_to_peak",
    "quadrature",
    "residual_correlation_length_deg",
    "split_rhat",
]
