"""The rivals with a hyperparameter, chosen by cross-validation over blocks of moments: ridge, LASSO, PLS, PCR.

scikit-learn takes half a second to import, for which only the two that use it are to wait.
"""

from __future__ import annotations

import warnings
from abc import abstractmethod

import numpy as np
import torch
from torch import Tensor

from torchrbd.errors import OptionError
from torchrbd.regression.base import Regression
from torchrbd.regression.classical import ROUNDING, normalised
from torchrbd.regression.moments import Moments

_MOST_COMPONENTS = 100


class PathRegression(Regression):
    """A regression with one hyperparameter from a fixed grid.

    Args:
        at: place on the grid; None chooses the place with the least mean squared error on left-out blocks.

    Attributes:
        chosen: place on the grid, once fitted.
    """

    chosen: int

    def __init__(self, at: int | None = None) -> None:
        if at is not None and at < 0:
            raise OptionError(f"at: expected a place on the grid, 0 or more, got {at}")
        self.at = at

    def _coefficients(self, moments: Moments) -> Tensor:
        path = self._path(moments)
        self.chosen = self._best(moments, path.shape[1]) if self.at is None else min(self.at, path.shape[1] - 1)
        return path[:, self.chosen]

    def _best(self, moments: Moments, length: int) -> int:
        if len(moments.count) < 2:
            raise OptionError(f"{self.name}: cross-validation needs 2 or more blocks of moments, got 1; give `at`")
        error = torch.zeros(length, dtype=torch.float64)
        for left_out in range(len(moments.count)):
            keep = torch.arange(len(moments.count)) != left_out
            path = self._path(moments.select(keep))
            # A fold may lack rank: its path is then shorter, and its last place is the whole of what it can fit.
            path = torch.cat((path, path[:, -1:].expand(-1, max(0, length - path.shape[1]))), 1)[:, :length]
            error += moments.select(~keep).error(path) * moments.count[left_out]
        return int(error.argmin())

    def _path(self, moments: Moments) -> Tensor:
        """Return b (d, K) for all places on the grid."""
        C, c, scale = normalised(moments)
        return self._normalised_path(C, c, moments) / scale.unsqueeze(1)

    @abstractmethod
    def _normalised_path(self, C: Tensor, c: Tensor, moments: Moments) -> Tensor:
        """Return b (d, K) in columns of unit mean square, from the simplest model to the richest."""


class Ridge(PathRegression):
    """Ridge regression on normalised columns: b = (C + lambda)^-1 c, lambda from 1e3 down to 1e-8."""

    name = "ridge"

    def _normalised_path(self, C: Tensor, c: Tensor, moments: Moments) -> Tensor:
        value, vector = torch.linalg.eigh(C)
        penalty = torch.logspace(3.0, -8.0, 56, dtype=torch.float64)
        return vector @ ((vector.T @ c).unsqueeze(1) / (value.clamp_min(0.0).unsqueeze(1) + penalty))


class Lasso(PathRegression):
    """LASSO on normalised columns, 100 penalties down to 1e-3 of the one that leaves no column; by scikit-learn."""

    name = "lasso"

    def _normalised_path(self, C: Tensor, c: Tensor, moments: Moments) -> Tensor:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.linear_model import lasso_path

        X, y = _rows(C, c, moments)
        penalty = max(float(c.abs().max()), 1e-300) * np.logspace(0.0, -3.0, 100)
        with warnings.catch_warnings():
            # Collinear columns converge slowly; cross-validation judges what came of it.
            warnings.simplefilter("ignore", ConvergenceWarning)
            gram = len(X) * C.numpy()
            path = lasso_path(X, y, alphas=penalty, precompute=gram, max_iter=2000, tol=1e-6)[1]  # pyright: ignore[reportArgumentType]
        return torch.as_tensor(path, dtype=torch.float64)


class PrincipalComponents(PathRegression):
    """Principal component regression on normalised columns, with 1 up to as many components as X has rank."""

    name = "pcr"

    def _normalised_path(self, C: Tensor, c: Tensor, moments: Moments) -> Tensor:
        value, vector = torch.linalg.eigh(C)
        value, vector = value.flip(0), vector.flip(1)
        rank = max(1, int((value > ROUNDING**2 * value[0]).sum()))
        share = vector[:, :rank] * ((vector[:, :rank].T @ c) / value[:rank].clamp_min(1e-300))
        return share.cumsum(1)


class PartialLeastSquares(PathRegression):
    """Partial least squares on normalised columns, with 1 up to 100 components; by scikit-learn."""

    name = "pls"

    def _normalised_path(self, C: Tensor, c: Tensor, moments: Moments) -> Tensor:
        from sklearn.cross_decomposition import PLSRegression

        X, y = _rows(C, c, moments)
        value = torch.linalg.eigvalsh(C)
        rank = max(1, int((value > ROUNDING**2 * value[-1]).sum()))
        model = PLSRegression(n_components=min(rank, _MOST_COMPONENTS), scale=False)
        with warnings.catch_warnings():
            # "y residual is constant": the components so far explain y; the rest of the path repeats itself.
            warnings.simplefilter("ignore", UserWarning)
            model.fit(X, y)
        # The first k components of one fit are the fit with k components.
        path = np.cumsum(model.x_rotations_ * model.y_loadings_[0], axis=1)
        return torch.as_tensor(path, dtype=torch.float64)


def _rows(C: Tensor, c: Tensor, moments: Moments) -> tuple[np.ndarray, np.ndarray]:
    """Return rows X, y of zero mean with X'X / N = C, X'y / N = c and y'y / N as given, whatever their number N."""
    A = torch.cat((torch.cat((C, c.unsqueeze(1)), 1), torch.cat((c, moments.yy.reshape(1))).unsqueeze(0)))
    value, vector = torch.linalg.eigh(A)
    root = (vector * value.clamp_min(0.0).sqrt()).T
    rows = (len(root) ** 0.5 * torch.cat((root, -root))).numpy()
    return rows[:, :-1].copy(), rows[:, -1].copy()
