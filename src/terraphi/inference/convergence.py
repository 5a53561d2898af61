"""Convergence diagnostics that hold for ensemble samplers.

The walkers of one ensemble are not independent chains: each proposal is made from the positions of
the others. Split-R-hat across them is small however badly the whole ensemble is stuck, so it is
taken here between independent ensembles, whose draws are pooled over their walkers. Autocorrelation
times are those of Goodman & Weare (Comm. App. Math. Comp. Sci. 5:65, 2010) as emcee estimates them;
R-hat and the standard error of the median are those of Vehtari et al. (Bayesian Analysis 16:667,
2021), with the effective sample size of the ensembles in place of that of chains.

Draws have shape [ensemble, walker, step] throughout.
"""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass

import numpy as np

from terraphi.experiment.arrays import FloatArray


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
