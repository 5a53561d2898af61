r"""Which parameters the forces fix, and which combinations they cannot tell apart.

In units of the prior's standard deviations, in which the prior covariance of independent parameters
is the identity, the eigenvectors of the posterior covariance are the combinations that are known
independently of each other, and its eigenvalues say what is left of the prior variance of each: 1
nothing was learnt, 0 all. For a linear Gaussian model -1/2 log2 of the product of the eigenvalues
is the information gained [bit] (Lindley, Ann. Math. Stat. 27:986, 1956), here as there a measure of
how much smaller the cloud of plausible parameters became.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray

FIXED = 0.25
"""Posterior over prior standard deviation below which a parameter counts as fixed [-]."""
OPEN = 0.75
"""The same above which it counts as not learnt [-]."""
CONFOUNDED = 3.0
"""Standard deviation of a parameter over that with all others known, from which on it is bound up
with others [-]."""
LINKED = 0.7
"""Least correlation of two parameters of one combination [-]."""
LABELS = {
    "soil.friction_angle_deg": ("φ", "deg"),
    "soil.density": ("ρ", "kg/m³"),
    "leg.friction": ("μ_leg", ""),
    "soil.dilation_angle_deg": ("ψ", "deg"),
    "soil.youngs_modulus": ("E", "Pa"),
    "motion.hip.1": ("hip height", "m"),
    "bed.surcharge": ("surcharge", "Pa"),
}
"""Names for people, and units, of dotted keys."""

VERBS = {
    "fixed": "is narrowed down",
    "narrowed": "is narrowed a little",
    "open": "is not learnt from these forces",
}


def label(key: str) -> tuple[str, str]:
    """Name for people and unit of a dotted key."""
    return LABELS.get(key, (key, ""))


def axis_label(key: str) -> str:
    """Name for people with its unit in brackets."""
    name, unit = label(key)
    return f"{name} [{unit or '-'}]"


def fisher(
    slopes: Sequence[FloatArray],
    curves: Sequence[FloatArray],
    variances: Sequence[FloatArray],
    factor2: FloatArray,
) -> FloatArray:
    """Fisher information G^T C^-1 G of parameters at some points, shape [x, key, key].

    Parameters
    ----------
    slopes, curves, variances
        Of each force, in a basis where its errors are independent: slopes G over the parameters
        [N per unit], shape [x, key, theta], forces [N] and variances of their errors [N^2], shape
        [x, theta].
    factor2
        Variance of a factor on both forces that is not known either [-], shape [x].
    """
    total, along, norm = 0.0, 0.0, 0.0
    for slope, curve, variance in zip(slopes, curves, variances, strict=True):
        weighted = slope / variance[:, None]
        total = total + np.einsum("xkt,xlt->xkl", weighted, slope)
        along = along + np.einsum("xkt,xt->xk", weighted, curve)
        norm = norm + np.sum(np.square(curve) / variance, axis=1)
    lost = factor2 / (1.0 + factor2 * norm)
    return total - lost[:, None, None] * np.einsum("xk,xl->xkl", along, along)


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What a posterior fixes of several parameters.

    Attributes
    ----------
    keys
        Parameters.
    prior_sd, sd
        Standard deviations before and after, in each parameter's unit, shape [d].
    conditional_sd
        After, if all others were known (from the precision matrix), shape [d].
    correlation
        Of the posterior, shape [d, d].
    variance_left
        Eigenvalues of the posterior covariance in units of the prior, increasing, shape [d].
    directions
        Eigenvectors in units of the prior's standard deviations, columns, shape [d, d].
    """

    keys: tuple[str, ...]
    prior_sd: FloatArray
    sd: FloatArray
    conditional_sd: FloatArray
    correlation: FloatArray
    variance_left: FloatArray
    directions: FloatArray

    @classmethod
    def of(
        cls, keys: Sequence[str], covariance: FloatArray, prior_sd: Sequence[float]
    ) -> Identifiability:
        """From the posterior covariance, in the units of the parameters.

        Parameters
        ----------
        keys
            Parameters, [d].
        covariance
            Shape [d, d], positive definite.
        prior_sd
            Standard deviations of the independent priors, [d].
        """
        before, sd = np.array(prior_sd), np.sqrt(np.diag(covariance))
        roots, directions = np.linalg.eigh(covariance / np.outer(before, before))
        # The sign of an eigenvector means nothing: its largest part is made positive.
        largest = np.take_along_axis(directions, np.abs(directions).argmax(axis=0)[None], axis=0)
        precision = np.linalg.inv(covariance / np.outer(sd, sd))
        return cls(
            tuple(keys), before, sd, sd / np.sqrt(np.diag(precision)),
            covariance / np.outer(sd, sd), roots, directions * np.sign(largest),
        )  # fmt: skip

    @property
    def bits(self) -> float:
        """Information gained [bit]."""
        return float(-0.5 * np.log2(self.variance_left).sum())

    @property
    def kinds(self) -> dict[str, str]:
        """Each parameter as ``fixed``, ``narrowed`` or ``open``."""
        left = self.sd / self.prior_sd
        kinds = ["fixed" if r < FIXED else "open" if r > OPEN else "narrowed" for r in left]
        return dict(zip(self.keys, kinds, strict=True))

    @property
    def confounded(self) -> list[tuple[str, ...]]:
        """Combinations of parameters, each of which would be far better known with the others.

        Chains of strong correlations; in one at least one parameter is not fixed.
        """
        bound = self.sd / self.conditional_sd > CONFOUNDED
        linked = (np.abs(self.correlation) > LINKED) & np.outer(bound, bound)
        # Powers of the graph's matrix: who is linked through others.
        reached = np.linalg.matrix_power(linked.astype(float), len(self.keys)) > 0.0
        groups = dict.fromkeys(tuple(np.flatnonzero(row).tolist()) for row in reached)
        loose = self.sd / self.prior_sd > FIXED
        return [
            tuple(self.keys[i] for i in group)
            for group in groups
            if len(group) > 1 and any(loose[i] for i in group)
        ]

    def sentences(self) -> list[str]:
        """The findings in words, with numbers."""
        found = []
        for i, (key, kind) in enumerate(self.kinds.items()):
            name, unit = label(key)
            left = float(self.sd[i] / self.prior_sd[i])
            known = f"; {self.conditional_sd[i]:.2g} if all else were known"
            known = known if len(self.keys) > 1 else ""
            verb = VERBS[kind]
            if kind != "open" and any(key in keys for keys in self.confounded):
                verb = "is known only as well as what it is bound up with"
            found.append(
                f"{name} {verb}: its standard deviation is {f'{self.sd[i]:.2g} {unit}'.rstrip()}, "
                f"{left:.{0 if left >= 0.1 else 1}%} of the prior's{known}."
            )
        for keys in self.confounded:
            names = " and ".join(label(k)[0] for k in keys)
            found.append(
                f"{names} cannot be told apart: {self._along(keys)} leave the forces nearly the "
                "same."
            )
        return found

    def _along(self, keys: Sequence[str]) -> str:
        """A step of one posterior standard deviation along the least known of a combination."""
        members = [self.keys.index(k) for k in keys]
        roots, vectors = np.linalg.eigh(self.correlation[np.ix_(members, members)])
        step = np.sqrt(roots[-1]) * vectors[:, -1] * np.sign(vectors[0, -1])
        parts = []
        for i, part in zip(members, step, strict=True):
            name, unit = label(self.keys[i])
            parts.append(f"{name} {part * self.sd[i]:+.2g}{' ' + unit if unit else ''}")
        return " with ".join(parts)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {
            "information_bits": self.bits,
            "kinds": self.kinds,
            "confounded": [list(keys) for keys in self.confounded],
            "directions": [
                {
                    "variance_left": float(root),
                    "in_prior_sd": dict(zip(self.keys, map(float, direction), strict=True)),
                }
                for root, direction in zip(self.variance_left, self.directions.T, strict=True)
            ],
            "correlation": self.correlation.tolist(),
            "sentences": self.sentences(),
        }
