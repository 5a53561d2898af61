"""Xu & Wang as printed: two Gaussian processes, their likelihood, emcee, every number and figure.

`gaussian_process` is the surrogate, `likelihood` the residual covariance, the posterior and the
sampler, `numbers` each result next to the one that the paper prints, `figures` the pictures.
"""

from terraphi.experiment.errors import needing

with needing("terraphi paper", "emcee, Matplotlib, Numba and SciPy", extra="plot,simulate"):
    import matplotlib as mpl  # noqa: F401
    import scipy  # noqa: F401
