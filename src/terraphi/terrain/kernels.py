"""A kernel of scikit-learn on some columns of its input, which it does not have itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from sklearn.gaussian_process.kernels import Hyperparameter, Kernel


class OnColumns(Kernel):  # type: ignore[misc]
    """``kernel`` on the columns named, as :class:`~sklearn.gaussian_process.kernels.Kernel`."""

    def __init__(self, kernel: Any, columns: tuple[int, ...]) -> None:
        self.kernel = kernel
        self.columns = columns

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Its parameters, and with ``kernel__`` before their names those inside."""
        inner = {f"kernel__{k}": v for k, v in self.kernel.get_params().items()} if deep else {}
        return {"kernel": self.kernel, "columns": self.columns, **inner}

    @property
    def hyperparameters(self) -> list[Any]:
        """Those inside."""
        return [
            Hyperparameter(f"kernel__{h.name}", h.value_type, h.bounds, h.n_elements)
            for h in self.kernel.hyperparameters
        ]

    @property
    def theta(self) -> Any:
        """Logarithms of those inside."""
        return self.kernel.theta

    @theta.setter
    def theta(self, theta: Any) -> None:
        self.kernel.theta = theta

    @property
    def bounds(self) -> Any:
        """Of ``theta``."""
        return self.kernel.bounds

    def __call__(self, X: Any, Y: Any = None, eval_gradient: bool = False) -> Any:
        """Covariance of rows."""
        columns = list(self.columns)
        other = None if Y is None else np.asarray(Y)[:, columns]
        return self.kernel(np.asarray(X)[:, columns], other, eval_gradient)

    def diag(self, X: Any) -> Any:
        """Variance of rows."""
        return self.kernel.diag(np.asarray(X)[:, list(self.columns)])

    def is_stationary(self) -> bool:
        """As that inside."""
        return bool(self.kernel.is_stationary())
