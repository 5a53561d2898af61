"""The posterior of a likelihood: by quadrature over φ, by ensemble MCMC over several parameters."""

from __future__ import annotations

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import needing
from terraphi.inference.likelihood import Likelihood

NODES = 801
"""Nodes of the quadrature, over eight standard deviations to either side."""
ENSEMBLES, WALKERS, STEPS = 4, 24, 1200
"""Independent ensembles, their walkers (at least twice the parameters), and steps of each."""


def quadrature(likelihood: Likelihood) -> tuple[FloatArray, FloatArray]:
    """Posterior density of φ under a uniform prior, on a grid that resolves its peak.

    The prior reaches from 12° below the library's smallest angle to 12° above its largest. Where no
    angle fits even there, the density is uniform over the 12° beyond that end.

    Parameters
    ----------
    likelihood
        Of φ alone.

    Returns
    -------
    grid, density
        [deg] and [1/deg], shape [node] each.
    """
    if likelihood.beyond is not None:
        low, high = likelihood.beyond
        return np.linspace(low, high, NODES), np.full(NODES, 1.0 / (high - low))
    best, reach = likelihood.least_squares, 8.0 * likelihood.sd
    low, high = (float(np.clip(best + way, *likelihood.ends)[0]) for way in (-reach, reach))
    grid = np.linspace(low, high, NODES)
    value = likelihood(grid[:, None])
    density = np.exp(value - value.max())
    return grid, density / np.trapezoid(density, grid)


def sample(
    likelihood: Likelihood, *, seed: int = 0, steps: int = STEPS
) -> tuple[dict[str, FloatArray], dict[str, dict[str, float]]]:
    """Draws of several parameters under a uniform prior over the library, by emcee.

    Walkers of one ensemble depend on each other, so that R̂ compares several ensembles.

    Returns
    -------
    draws, diagnostics
        Of each dotted key: draws, shape [ensemble, draw]; split-R̂, effective sample size and
        autocorrelation time.
    """
    with needing("a posterior of several parameters", "emcee and SciPy", extra="simulate"):
        import emcee
        import scipy  # noqa: F401 - for split_rhat

    count, walkers = len(likelihood.keys), max(WALKERS, 2 * len(likelihood.keys) + 2)
    low, high, start = likelihood.low, likelihood.high, likelihood.least_squares

    def log_posterior(x: FloatArray) -> FloatArray:
        inside = np.all((x >= low) & (x <= high), axis=1)
        found = np.full(len(x), -np.inf)
        if inside.any():
            found[inside] = likelihood(x[inside])
        return found

    chains, taus = [], []
    spread = np.minimum(likelihood.sd, 0.3 * (high - low))
    for child in np.random.SeedSequence(seed).spawn(ENSEMBLES):
        rng = np.random.default_rng(child)
        first = np.clip(start + spread * rng.standard_normal((walkers, count)), low, high)
        first += 1e-6 * (high - low) * (rng.random(first.shape) - 0.5)
        first = np.clip(first, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
        sampler = emcee.EnsembleSampler(walkers, count, log_posterior, vectorize=True)
        sampler.random_state = np.random.RandomState(rng.integers(2**31)).get_state()
        sampler.run_mcmc(first, steps)
        taus.append(sampler.get_autocorr_time(quiet=True, tol=0))
        chains.append(sampler.get_chain(discard=steps // 4, thin=5))
    tau = np.max(taus, axis=0)
    # [ensemble, draw, walker, key]
    every = np.stack(chains)
    draws, diagnostics = {}, {}
    for i, key in enumerate(likelihood.keys):
        values = every[..., i]
        flat = values.reshape(ENSEMBLES, -1)
        ess = ENSEMBLES * walkers * (steps - steps // 4) / float(tau[i])
        draws[key] = flat
        diagnostics[key] = {
            "rhat": split_rhat(values.transpose(0, 2, 1)),
            "ess": ess,
            "tau": float(tau[i]),
        }
    return draws, diagnostics


def split_rhat(draws: FloatArray) -> float:
    """Rank-normalized split-R̂ between ensembles [-] (Vehtari et al., Bayesian Anal. 16:667, 2021).

    Draws have the shape [ensemble, walker, step]. The early and the late half of an ensemble, each
    pooled over its walkers, count as two chains.
    The larger of the bulk and the folded value is returned: ensembles that agree in location but
    not in spread are noticed too. 1 if all draws are equal.
    """
    from scipy.special import ndtri
    from scipy.stats import rankdata

    half = draws.shape[2] // 2
    halves = np.stack([draws[:, :, :half], draws[:, :, -half:]], axis=1)
    chains = halves.reshape(2 * len(draws), -1)

    def rhat(values: FloatArray) -> float:
        ranks = rankdata(values, axis=None).reshape(values.shape)
        scores = ndtri((ranks - 0.375) / (values.size + 0.25))
        within = float(scores.var(axis=1, ddof=1).mean())
        between = float(scores.mean(axis=1).var(ddof=1))
        if within == 0.0:
            return 1.0 if between == 0.0 else float(np.finfo(float).max)
        size = scores.shape[1]
        return float(np.sqrt((size - 1) / size + between / within))

    return max(rhat(chains), rhat(np.abs(chains - np.median(chains))))
