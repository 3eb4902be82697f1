"""The one contract of all plain regressions: fit on data or on their moments, then predict."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from torch import Tensor
from typing_extensions import Self

from torchrbd.inference.regression.moments import Moments


class Regression(ABC):
    """A linear regression y = x'b without intercept.

    Class attributes:
        name: as tables and options call it.

    Attributes:
        coefficients: b (d,), once fitted.
    """

    name: ClassVar[str]
    coefficients: Tensor
    _noisy_coefficients: Tensor | None = None

    def fit(self, X: Tensor | Moments, y: Tensor | None = None) -> Self:
        """Fit to moments, or to inputs X (N, d) and outputs y (N,)."""
        moments = X if isinstance(X, Moments) else Moments.from_data(X, _given(y))
        self.coefficients = self._coefficients(moments)
        return self

    def predict(self, X: Tensor) -> Tensor:
        """Return X b (N,) for noiseless inputs X (N, d)."""
        return X @ self.coefficients.to(X)

    @property
    def noisy_coefficients(self) -> Tensor:
        """Coefficients (d,) that predict y from inputs as noisy as the training ones; b itself unless told apart."""
        return self.coefficients if self._noisy_coefficients is None else self._noisy_coefficients

    @abstractmethod
    def _coefficients(self, moments: Moments) -> Tensor:
        """Return b (d,)."""


def _given(y: Tensor | None) -> Tensor:
    if y is None:
        raise TypeError("fit(X, y): y is missing")
    return y
