"""Xu & Wang as printed: two Gaussian processes, their likelihood, emcee, every number and figure.

`gaussian_process` is the surrogate, `likelihood` the residual covariance, the posterior and the
sampler, `numbers` each result next to the one that the paper prints, `figures` the pictures.
"""
