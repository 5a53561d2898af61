"""Several affine-invariant ensembles side by side: emcee's sampler with one vectorised move.

emcee's loop spends nearly all its time on what it does once a step, and on walkers one by one. So
all ensembles are the walkers of one sampler, under a stretch move that never mixes them: each keeps
its own halves and partners, and their draws are as independent as if they ran one after the other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import emcee
import numpy as np
from emcee.state import State
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray

STRETCH = 2.0
"""Scale a of the stretch move [-] (Goodman & Weare, *Commun. Appl. Math. Comput. Sci.* 5, 2010)."""
ATTEMPTS = 60
"""Times that a walker is given another start."""


class SideBySide(emcee.moves.Move):  # type: ignore[misc]  # emcee has no types
    """The stretch move within each of several ensembles.

    Parameters
    ----------
    ensembles
        Their number; the walkers of the first come first.
    """

    def __init__(self, ensembles: int) -> None:
        self.ensembles = ensembles

    def propose(self, model: Any, state: State) -> tuple[State, NDArray[np.bool_]]:
        """Move both halves of every ensemble, one after the other.

        Parameters
        ----------
        model
            emcee's log-probability and random generator.
        state
            Positions of all walkers and their log-probabilities.
        """
        random, dimensions = model.random, state.coords.shape[1]
        coords = state.coords.reshape(self.ensembles, -1, dimensions)
        old = state.log_prob.reshape(self.ensembles, -1)
        accepted = np.zeros(old.shape, dtype=bool)
        # New halves in every step, as emcee draws them, alike in all ensembles.
        order = random.permutation(old.shape[1])
        half = order.size // 2
        row = np.arange(self.ensembles)[:, None]
        for moved, others in ((order[:half], order[half:]), (order[half:], order[:half])):
            shape = (self.ensembles, moved.size)
            here = coords[:, moved]
            partner = coords[row, others[random.randint(others.size, size=shape)]]
            z = np.square((STRETCH - 1.0) * random.random_sample(shape) + 1.0) / STRETCH
            proposed = partner - (partner - here) * z[..., None]
            log_p = model.log_prob_fn(proposed.reshape(-1, dimensions)).reshape(shape)
            gain = (dimensions - 1.0) * np.log(z) + log_p - old[:, moved]
            better = np.log(random.random_sample(shape)) < gain
            coords[:, moved] = np.where(better[..., None], proposed, here)
            old[:, moved] = np.where(better, log_p, old[:, moved])
            accepted[:, moved] = better
        state.coords, state.log_prob = coords.reshape(-1, dimensions), old.ravel()
        return state, accepted.ravel()


def starts(
    log_posterior: Callable[[FloatArray], FloatArray],
    bounds_deg: tuple[float, float],
    shape: tuple[int, int],
    random: np.random.RandomState,
) -> FloatArray:
    """Draws of a uniform prior where walkers start, none where the posterior is zero.

    Parameters
    ----------
    log_posterior
        As in :func:`run`.
    bounds_deg
        Ends of the prior [deg].
    shape
        Number of ensembles and walkers of each; the result has [ensemble, walker, 1].
    random
        Random generator; used, and changed.

    Raises
    ------
    ValueError
        If the log-posterior is minus infinity nearly everywhere.
    """
    start = random.uniform(*bounds_deg, size=(shape[0] * shape[1], 1))
    # A walker that starts where the likelihood is zero may stay there for long after burn-in.
    for _ in range(ATTEMPTS):
        stranded = ~np.isfinite(log_posterior(start))
        if not stranded.any():
            return start.reshape(*shape, 1)
        start[stranded] = random.uniform(*bounds_deg, size=(np.count_nonzero(stranded), 1))
    raise ValueError(
        f"the log-likelihood is minus infinity at all or most draws within {bounds_deg} deg"
    )


def run(
    log_posterior: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    *,
    steps: int,
    burn_in: int,
    random: np.random.RandomState,
) -> tuple[FloatArray, float]:
    """Run all ensembles.

    Parameters
    ----------
    log_posterior
        Of positions, shape [k, dimension] -> [k].
    start
        Where the walkers start, shape [ensemble, walker, dimension].
    steps, burn_in
        Number of steps, and how many of the first are discarded.
    random
        Random generator; used, and changed.

    Returns
    -------
    tuple
        Draws, shape [ensemble, walker, step, dimension], and the fraction of accepted proposals.
    """
    ensembles, walkers, dimensions = start.shape
    total = ensembles * walkers
    sampler = emcee.EnsembleSampler(
        total, dimensions, log_posterior, vectorize=True, moves=SideBySide(ensembles)
    )
    # A state that brings its own generator replaces the copy of NumPy's global one.
    state = State(start.reshape(total, dimensions), random_state=random.get_state())
    sampler.run_mcmc(state, steps)
    chain: FloatArray = sampler.get_chain(discard=burn_in)
    draws = chain.reshape(-1, ensembles, walkers, dimensions).transpose(1, 2, 0, 3)
    return draws, float(np.mean(sampler.acceptance_fraction))
