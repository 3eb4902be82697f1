"""The one contract of all plain regressions: fit on data or on their moments, then predict."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from numpy.typing import ArrayLike
from torch import Tensor
from typing_extensions import Self

from torchrbd.errors import InputError
from torchrbd.regression.moments import Moments, as_float64

NOT_FITTED = "the regression has no data yet: call fit(X, y) first"


class Regression(ABC):
    """A linear regression y = x'b. No intercept is fitted: centre the data, or add a column of ones.

    Class attributes:
        name: as tables and options call it.
    """

    name: ClassVar[str]
    _b: Tensor | None = None
    _noisy_b: Tensor | None = None

    def fit(self, X: Tensor | ArrayLike | Moments, y: Tensor | ArrayLike | None = None) -> Self:
        """Fit to moments, or to inputs X (N, d) and outputs y (N,), tensors or numpy arrays.

        Raises:
            InputError: for shapes that do not fit, no rows, or values that are not finite.
            OptionError: for an option that does not fit the data, such as noise of another number of inputs.
        """
        self._b = self._coefficients(Moments.of(X, y))
        return self

    def predict(self, X: Tensor | ArrayLike) -> Tensor:
        """Return X b (N,) for noiseless inputs X (N, d), in the dtype of X if that is a tensor of floats.

        Raises:
            InputError: before a fit, or for another number of inputs.
        """
        b = self.coefficients
        X = X if isinstance(X, Tensor) and X.is_floating_point() else as_float64(X, "X")
        if X.dim() == 0 or X.shape[-1] != len(b):
            raise InputError(f"X: expected (N, {len(b)}), as many inputs as were fitted, got {tuple(X.shape)}")
        return X @ b.to(X)

    @property
    def coefficients(self) -> Tensor:
        """b (d,), for noiseless inputs; InputError before a fit."""
        if self._b is None:
            raise InputError(NOT_FITTED)
        return self._b

    @property
    def noisy_coefficients(self) -> Tensor:
        """Coefficients (d,) that predict y from inputs as noisy as the training ones; b itself unless they differ."""
        return self.coefficients if self._noisy_b is None else self._noisy_b

    @abstractmethod
    def _coefficients(self, moments: Moments) -> Tensor:
        """Return b (d,); may set ``_noisy_b``."""
