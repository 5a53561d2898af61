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
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FIXED = 0.25
"""Posterior over prior standard deviation below which a parameter counts as fixed [-]."""
OPEN = 0.75
"""The same above which it counts as not learnt [-]."""
CONFOUNDED = 3.0
"""Standard deviation of a parameter over that with all others known, from which on it is bound up
with others [-]."""
LOADING = 0.3
"""Least part of a combination that is named [-]."""
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


def label(key: str) -> tuple[str, str]:
    """Name for people and unit of a dotted key."""
    return LABELS.get(key, (key, ""))


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
        """Combinations of parameters that are far better known together than each."""
        bound = (self.sd / self.conditional_sd > CONFOUNDED) & (self.sd / self.prior_sd > FIXED)
        found: list[tuple[str, ...]] = []
        for direction in self.directions.T[::-1]:
            named = tuple(
                key
                for key, part, is_bound in zip(self.keys, direction, bound, strict=True)
                if is_bound and abs(part) > LOADING
            )
            if len(named) > 1 and named not in found:
                found.append(named)
        return found

    def sentences(self) -> list[str]:
        """The findings in words, with numbers."""
        found = []
        for i, (key, kind) in enumerate(self.kinds.items()):
            name, unit = label(key)
            verb = {
                "fixed": "is fixed",
                "narrowed": "is narrowed",
                "open": "is not learnt from these forces",
            }[kind]
            found.append(
                f"{name} {verb}: {self.sd[i] / self.prior_sd[i]:.0%} of its prior standard "
                f"deviation is left ({self.sd[i]:.3g}{' ' + unit if unit else ''}; "
                f"{self.conditional_sd[i]:.3g} if all else were known)."
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
        scaled = self.correlation * np.outer(self.sd / self.prior_sd, self.sd / self.prior_sd)
        roots, vectors = np.linalg.eigh(scaled[np.ix_(members, members)])
        step = np.sqrt(roots[-1]) * vectors[:, -1] * np.sign(vectors[0, -1])
        parts = []
        for i, part in zip(members, step, strict=True):
            name, unit = label(self.keys[i])
            parts.append(f"{name} {part * self.prior_sd[i]:+.3g}{' ' + unit if unit else ''}")
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
