"""Draws of a joint posterior by emcee, from several independent ensembles.

R-hat between walkers of one ensemble means nothing, so at least four ensembles run, each from its
own draws of the prior. A posterior may be ten thousand times narrower than its
prior, and a walker that starts far away may stay there; so each ensemble is led from its prior to
the posterior through powers of the density between 0 and 1, with walkers drawn anew by their
weights at each (sequential Monte Carlo; Del Moral, Doucet & Jasra, J. R. Stat. Soc. B 68:411,
2006). All advance until every parameter has converged, the number of steps doubling, up to a limit;
what they have come to is reported either way.

**Convergence.** The walkers of one ensemble are not independent chains: each proposal is made from
the positions of the others. Split-R-hat across them is small however badly the whole ensemble is
stuck, so it is taken here between independent ensembles, whose draws are pooled over their walkers.
Autocorrelation times are those of Goodman & Weare (Comm. App. Math. Comp. Sci. 5:65, 2010) as emcee
estimates them; R-hat and the standard error of the median are those of Vehtari et al. (Bayesian
Analysis 16:667, 2021), with the effective sample size of the ensembles in place of that of chains.

Draws have shape [ensemble, walker, step] throughout.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray

Coordinates = Callable[[FloatArray], FloatArray]
"""Parameters of coordinates, shape [k, d] -> [k, d]."""
LogPosterior = Callable[[FloatArray], FloatArray]
"""Log density up to a constant of points, shape [k, d] -> [k]."""

ENSEMBLES = 4
"""With fewer, R-hat between them means little."""
RHAT_LIMIT = 1.01
LENGTH_LIMIT = 50.0
"""Autocorrelation times that an ensemble must be long."""
POOL = 20
"""Draws of the prior from which each walker's start is drawn."""
STAGE_STEPS = 20
"""Steps of an ensemble at each temperature on the way from the prior to the posterior."""
STAGES = 200
DOUBLINGS = 3
BURN_IN = 5
"""One in so many steps is left out, from the beginning."""
NEAR = 0.01
"""Fraction of the draws that counts as near to the median [-]."""


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
    def flat(self) -> FloatArray:
        """All of them, shape [draw, d]."""
        return self.values.reshape(-1, self.values.shape[-1])

    @property
    def central(self) -> FloatArray:
        """The most probable of the draws nearest to the median, shape [d].

        The most probable of all may lie at the far end of a ridge along which the density hardly
        changes. Distances are those of Mahalanobis.
        """
        flat = self.flat
        apart = flat - np.median(flat, axis=0)
        precision = np.linalg.inv(np.cov(apart.T).reshape(apart.shape[1], apart.shape[1]))
        distance = np.einsum("ki,ij,kj->k", apart, precision, apart)
        nearest = np.argsort(distance)[: max(1, round(NEAR * len(flat)))]
        return flat[nearest[self.log_posterior.ravel()[nearest].argmax()]]

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
    doublings: int = DOUBLINGS,
    seed: int = 0,
    parameters: Coordinates = lambda coordinates: coordinates,
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
        Of each ensemble, of which the first fifth is burn-in.
    doublings
        How often the steps may double if the draws have not converged.
    seed
        Of all random streams; NumPy's global state is neither used nor changed.
    parameters
        What is drawn, of the coordinates in which ``log_posterior`` is a density and walkers move.

    Raises
    ------
    ValueError
        If the log density is NaN or nearly everywhere minus infinity.
    """
    running = []
    for stream in np.random.SeedSequence(seed).spawn(ENSEMBLES):
        first, second = stream.spawn(2)
        rng = np.random.default_rng(first)
        random = np.random.RandomState(np.random.MT19937(second))
        start = _annealed(
            log_posterior, *_start(log_posterior, draw_prior, walkers, rng), rng, random
        )
        sampler = _sampler(log_posterior, start.coords)
        sampler.run_mcmc(start, steps, skip_initial_state_check=True)
        running.append(sampler)
    found = _gathered(running, seed, parameters)
    for _ in range(doublings):
        if found.converged:
            break
        for sampler in running:
            sampler.run_mcmc(None, sampler.iteration)
        found = _gathered(running, seed, parameters)
    return found


def ensemble(start: FloatArray, log_density: LogPosterior, **options: Any) -> Any:
    """An ensemble sampler of emcee that prints nothing when it is interrupted.

    Parameters
    ----------
    start
        Where its walkers start, shape [walker, d].
    log_density
        Called with half the walkers at once.
    **options
        Of ``emcee.EnsembleSampler``.
    """
    import emcee

    sampler = emcee.EnsembleSampler(*start.shape, log_density, vectorize=True, **options)
    sampler.log_prob_fn = log_density  # as it is: emcee's wrapper prints a traceback at Ctrl-C
    return sampler


def _sampler(log_density: LogPosterior, start: FloatArray) -> Any:
    import emcee

    moves = [(emcee.moves.StretchMove(), 0.5), (emcee.moves.DEMove(), 0.5)]
    return ensemble(start, log_density, moves=moves)


def _start(
    log_posterior: LogPosterior,
    draw_prior: Callable[[int, np.random.Generator], FloatArray],
    walkers: int,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray, float]:
    """Walkers from many draws of the prior, their log density, and the power of it they follow."""
    pool = draw_prior(POOL * walkers, rng)
    log_p = log_posterior(pool)
    if np.isnan(log_p).any():
        raise ValueError("the log posterior is not a number at a draw of the prior")
    finite = np.isfinite(log_p)
    if finite.sum() < walkers:
        raise ValueError("the log posterior is minus infinity at nearly all draws of the prior")
    pool, log_p = pool[finite], log_p[finite]
    power = _next_power(log_p, 0.0, walkers)
    weights = np.exp(power * (log_p - log_p.max()))
    # Each draw once: an ensemble needs different walkers to know which way to go. The largest of
    # log weights plus Gumbel noise are a weighted sample without replacement.
    keys = np.log(weights + np.finfo(float).tiny) + rng.gumbel(size=weights.size)
    chosen = np.argsort(keys)[-walkers:]
    return pool[chosen], log_p[chosen], power


def _annealed(
    log_posterior: LogPosterior,
    walkers: FloatArray,
    log_p: FloatArray,
    power: float,
    rng: np.random.Generator,
    random: np.random.RandomState,
) -> Any:
    """An ensemble that follows the posterior, as emcee's state, from one at a power of it."""
    import emcee

    state = emcee.State(walkers, random_state=random.get_state())
    for _ in range(STAGES):
        sampler = _sampler(functools.partial(_raised, log_posterior, power), walkers)
        state = sampler.run_mcmc(state, STAGE_STEPS, skip_initial_state_check=True)
        log_p = state.log_prob / power
        if power >= 1.0:
            break
        following = _next_power(log_p, power, len(walkers) // 2)
        weights = np.exp((following - power) * (log_p - log_p.max()))
        chosen = rng.choice(len(weights), size=len(weights), p=weights / weights.sum())
        state = emcee.State(state.coords[chosen], random_state=state.random_state)
        power = following
    return emcee.State(state.coords, random_state=state.random_state)


def _raised(log_density: LogPosterior, power: float, points: FloatArray) -> FloatArray:
    """Logarithm of a power of a density."""
    return power * log_density(points)


def _next_power(log_p: FloatArray, power: float, worth: float) -> float:
    """Largest power up to 1 at which weighted walkers are still worth so many."""

    def left(following: float) -> float:
        weights = np.exp((following - power) * (log_p - log_p.max()))
        return float(weights.sum() ** 2 / np.square(weights).sum())

    if left(1.0) >= worth:
        return 1.0
    low, high = power, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if left(middle) >= worth else (low, middle)
    return low


def _gathered(running: list[Any], seed: int, parameters: Coordinates) -> Draws:
    chains: list[FloatArray] = []
    log_p: list[FloatArray] = []
    for sampler in running:
        discard = sampler.iteration // BURN_IN
        chains.append(sampler.get_chain(discard=discard).transpose(1, 0, 2))
        log_p.append(sampler.get_log_prob(discard=discard).T)
    coordinates: FloatArray = np.array(chains)
    flat = parameters(coordinates.reshape(-1, coordinates.shape[-1]))
    values: FloatArray = flat.reshape(coordinates.shape)
    accepted = float(np.mean([sampler.acceptance_fraction for sampler in running]))
    diagnostics = tuple(diagnose(values[..., i]) for i in range(flat.shape[1]))
    return Draws(values, np.array(log_p), diagnostics, accepted, seed)


@dataclass(frozen=True)
class EnsembleDiagnostics:
    """How far the draws of an ensemble sampler can be trusted.

    Attributes
    ----------
    split_rhat
        Rank-normalised split-R-hat between ensembles [-]; 1.01 is the usual limit.
    autocorrelation_time_steps
        Integrated autocorrelation time of the slowest ensemble [step].
    steps_per_autocorrelation_time
        Length of an ensemble over that time [-]; below 50 the time is itself uncertain.
    effective_sample_size
        Number of independent draws worth as much [-].
    median_standard_error
        Monte Carlo standard error of the median, in the unit of the draws.
    """

    split_rhat: float
    autocorrelation_time_steps: float
    steps_per_autocorrelation_time: float
    effective_sample_size: float
    median_standard_error: float

    def as_dict(self) -> dict[str, float]:
        """Plain floats by name, ready for JSON, which knows no infinity: the largest float."""
        return {name: min(value, sys.float_info.max) for name, value in asdict(self).items()}


def chains(draws: FloatArray, stride: int) -> FloatArray:
    """Draws as independent chains, shape [chain, draw, ...], as ArviZ wants them.

    A chain is an ensemble, never a walker, since the walkers of an ensemble depend on each other.
    Only one step in ``stride`` is kept, all its walkers side by side: with a stride of the
    autocorrelation time the draws of a chain follow in time and are nearly uncorrelated, so that
    diagnostics that presume a plain Markov chain are right about them.

    Parameters
    ----------
    draws
        Draws after burn-in, shape [ensemble, walker, step, ...].
    stride
        At least 1.
    """
    kept = draws[:, :, ::stride].swapaxes(1, 2)
    return kept.reshape(len(kept), -1, *kept.shape[3:])


def diagnose(draws: FloatArray) -> EnsembleDiagnostics:
    """All diagnostics of some draws.

    Parameters
    ----------
    draws
        Draws after burn-in, shape [ensemble, walker, step].
    """
    slowest = float(autocorrelation_time(draws).max())
    return EnsembleDiagnostics(
        split_rhat=split_rhat(draws),
        autocorrelation_time_steps=slowest,
        steps_per_autocorrelation_time=draws.shape[2] / slowest,
        effective_sample_size=effective_sample_size(draws),
        median_standard_error=median_standard_error(draws),
    )


def autocorrelation_time(draws: FloatArray) -> FloatArray:
    """Integrated autocorrelation time of each ensemble.

    The autocorrelation function is averaged over walkers and summed over Sokal's window of five
    autocorrelation times.

    Parameters
    ----------
    draws
        Draws after burn-in, shape [ensemble, walker, step].

    Returns
    -------
    FloatArray
        Times [step], at least 1 and at most the number of steps, shape [ensemble]. A walker that
        never moved makes it the number of steps: it is worth a single draw.
    """
    from emcee.autocorr import integrated_time

    steps = draws.shape[2]
    times = np.full(len(draws), float(steps))
    for i, ensemble in enumerate(draws):
        if (np.ptp(ensemble, axis=1) > 0.0).all():
            # tol=0 keeps emcee from logging about short chains: the diagnostics report that.
            times[i] = integrated_time(ensemble.T, tol=0, quiet=True)[0]
    return times.clip(1.0, float(steps))


def effective_sample_size(draws: FloatArray) -> float:
    """Effective sample size [-]: draws over autocorrelation time, summed over the ensembles.

    Parameters
    ----------
    draws
        Draws after burn-in, shape [ensemble, walker, step].
    """
    times = autocorrelation_time(draws)
    return float(np.sum(draws.shape[1] * draws.shape[2] / times))


def split_rhat(draws: FloatArray) -> float:
    """Rank-normalised split-R-hat between independent ensembles (Vehtari et al. 2021).

    The early and the late half of an ensemble, each pooled over its walkers, count as two chains.
    The larger of the bulk and the folded value is returned, so that ensembles that agree in
    location but not in spread are noticed too.

    Parameters
    ----------
    draws
        Draws after burn-in, shape [ensemble, walker, step].

    Returns
    -------
    float
        R-hat [-]; huge or infinite if halves differ but do not vary in themselves, 1 if all draws
        are equal.
    """
    half = draws.shape[2] // 2
    halves = np.stack([draws[:, :, :half], draws[:, :, -half:]], axis=1)
    chains = halves.reshape(2 * len(draws), -1)
    folded = np.abs(chains - np.median(chains))
    return max(_rhat(_normal_scores(chains)), _rhat(_normal_scores(folded)))


def median_standard_error(draws: FloatArray) -> float:
    """Monte Carlo standard error of the median (Vehtari et al. 2021).

    The rank of the median is uncertain like a beta variable whose counts are the effective sample
    size of the indicator ``draw <= median``. The error is half the distance of the quantiles at
    the 16 % and 84 % points of that variable, so no density needs to be estimated.

    Parameters
    ----------
    draws
        Draws after burn-in, shape [ensemble, walker, step].

    Returns
    -------
    float
        Standard error, in the unit of the draws.
    """
    from scipy.special import betaincinv, ndtr

    below = (draws <= np.median(draws)).astype(np.float64)
    count = effective_sample_size(below) / 2.0
    probabilities = betaincinv(count + 1.0, count + 1.0, ndtr([-1.0, 1.0]))
    low, high = np.quantile(draws, probabilities)
    return float(high - low) / 2.0


def _normal_scores(chains: FloatArray) -> FloatArray:
    """Normal quantiles of the pooled fractional ranks, ties averaged, shape [chain, draw]."""
    from scipy.special import ndtri
    from scipy.stats import rankdata

    ranks = rankdata(chains, axis=None).reshape(chains.shape)
    return ndtri((ranks - 0.375) / (chains.size + 0.25))


def _rhat(chains: FloatArray) -> float:
    """Square root of pooled over within-chain variance, shape [chain, draw]."""
    size = chains.shape[1]
    within = float(chains.var(axis=1, ddof=1).mean())
    between = float(chains.mean(axis=1).var(ddof=1))
    if within == 0.0:
        return 1.0 if between == 0.0 else float("inf")
    return float(np.sqrt((size - 1) / size + between / within))
