"""Xu & Wang as printed: their solver, two Gaussian processes, a likelihood, emcee, every number.

`plane` simulates in plane strain, `gaussian_process` is the surrogate, `likelihood` the residual
covariance, the posterior and the sampler, `numbers` each result next to the one that the paper
prints, `figures` the pictures.
"""
