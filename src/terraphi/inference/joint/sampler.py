"""Draws of a joint posterior by emcee, from several independent ensembles.

R-hat between walkers of one ensemble means nothing, so at least four ensembles run, each from its
own draws of the prior (see `convergence`). All advance until every parameter has converged, the
number of steps doubling, up to a limit; what they have come to is reported either way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.inference.convergence import EnsembleDiagnostics, diagnose

FloatArray = NDArray[np.float64]
LogPosterior = Callable[[FloatArray], FloatArray]
"""Log density up to a constant of points, shape [k, d] -> [k]."""

RHAT_LIMIT = 1.01
LENGTH_LIMIT = 50.0
"""Autocorrelation times that an ensemble must be long."""
POOL = 20
"""Draws of the prior among which each walker's start is found."""
DOUBLINGS = 3


@dataclass(frozen=True, eq=False)
class Draws:
    """What the ensembles drew.

    Attributes
    ----------
    values
        After burn-in, shape [ensemble, walker, step, d].
    log_posterior
        Of each, up to a constant, shape [ensemble, walker, step].
    diagnostics
        Of each dimension.
    acceptance_fraction
        Mean fraction of accepted proposals [-].
    seed
        Of all random streams.
    """

    values: FloatArray
    log_posterior: FloatArray
    diagnostics: tuple[EnsembleDiagnostics, ...]
    acceptance_fraction: float
    seed: int

    @property
    def best(self) -> FloatArray:
        """The most probable draw, shape [d]."""
        flat = self.values.reshape(-1, self.values.shape[-1])
        best: FloatArray = flat[int(self.log_posterior.argmax())]
        return best

    @property
    def stride(self) -> int:
        """Steps after which the slowest dimension has forgotten where it was."""
        return int(np.ceil(max(d.autocorrelation_time_steps for d in self.diagnostics)))

    @property
    def converged(self) -> bool:
        """Whether every dimension has R-hat and length within the limits."""
        return all(
            d.split_rhat <= RHAT_LIMIT and d.steps_per_autocorrelation_time >= LENGTH_LIMIT
            for d in self.diagnostics
        )


def sample(
    log_posterior: LogPosterior,
    draw_prior: Callable[[int, np.random.Generator], FloatArray],
    *,
    walkers: int = 32,
    steps: int = 1500,
    ensembles: int = 4,
    doublings: int = DOUBLINGS,
    seed: int = 0,
) -> Draws:
    """Draw from a posterior.

    Parameters
    ----------
    log_posterior
        Called with half the walkers of an ensemble at once.
    draw_prior
        Draws of the prior, ``(count, rng) -> [count, d]``.
    walkers
        Of an ensemble, even, at least twice the dimensions.
    steps
        Of each ensemble, of which the first third is burn-in.
    ensembles
        At least 4.
    doublings
        How often the steps may double if the draws have not converged.
    seed
        Of all random streams; NumPy's global state is neither used nor changed.

    Raises
    ------
    ValueError
        If a number is too small, or the log density is NaN or nearly everywhere minus infinity.
    """
    import emcee

    if ensembles < 4:
        raise ValueError(f"ensembles is {ensembles}; it must be at least 4")
    moves = [(emcee.moves.StretchMove(), 0.4), (emcee.moves.DEMove(), 0.5),
             (emcee.moves.DESnookerMove(), 0.1)]  # fmt: skip
    running = []
    for stream in np.random.SeedSequence(seed).spawn(ensembles):
        first, second = stream.spawn(2)
        start = _start(log_posterior, draw_prior, walkers, np.random.default_rng(first))
        random = np.random.RandomState(np.random.MT19937(second))
        sampler = emcee.EnsembleSampler(
            walkers, start.shape[1], log_posterior, vectorize=True, moves=moves
        )
        sampler.run_mcmc(emcee.State(start, random_state=random.get_state()), steps)
        running.append(sampler)
    found = _gathered(running, seed)
    for _ in range(doublings):
        if found.converged:
            break
        for sampler in running:
            sampler.run_mcmc(None, sampler.iteration)
        found = _gathered(running, seed)
    return found


def _start(
    log_posterior: LogPosterior,
    draw_prior: Callable[[int, np.random.Generator], FloatArray],
    walkers: int,
    rng: np.random.Generator,
) -> FloatArray:
    """The most probable of many draws of the prior: dispersed, but none in a far corner."""
    pool = draw_prior(POOL * walkers, rng)
    log_p = log_posterior(pool)
    if np.isnan(log_p).any():
        raise ValueError("the log posterior is not a number at a draw of the prior")
    best = np.argsort(log_p)[-walkers:]
    if not np.isfinite(log_p[best]).all():
        raise ValueError("the log posterior is minus infinity at nearly all draws of the prior")
    return pool[best]


def _gathered(running: list[Any], seed: int) -> Draws:
    chains, log_p = [], []
    for sampler in running:
        discard = sampler.iteration // 3
        chains.append(sampler.get_chain(discard=discard).transpose(1, 0, 2))
        log_p.append(sampler.get_log_prob(discard=discard).T)
    values = np.stack(chains)
    accepted = float(np.mean([sampler.acceptance_fraction for sampler in running]))
    diagnostics = tuple(diagnose(values[..., i]) for i in range(values.shape[-1]))
    return Draws(values, np.stack(log_p), diagnostics, accepted, seed)
