"""Regression on inputs with noise of known covariance, from second moments: EIV-ARD."""

from __future__ import annotations

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from torchrbd.errors import OptionError
from torchrbd.regression.ard import ard
from torchrbd.regression.base import Regression
from torchrbd.regression.classical import nonzero_root
from torchrbd.regression.moments import Moments, as_float64


class EIVARD(Regression):
    """Automatic relevance determination on the best linear guess of the noiseless inputs.

        S = PSD(C - Psi),   K = S C^-1,   G = K C K',   g = K c,   then ARD on (N G, N g, y'y)

    The inputs are seen as x = t + e, with e of covariance Psi and independent of t, and y = t'b + noise. Then
    C = S + Psi and c = S b with S the covariance of t. Of all linear functions of x, K x with
    K = E[t x'] E[x x']^-1 = S C^-1 is nearest to t, and what it leaves, t - K x, is uncorrelated with x. So
    y = (K x)'b + (t - K x)'b + noise is a regression on K x whose error is uncorrelated with its inputs: least squares
    on it is consistent where S has full rank, while least squares on x itself tends to K'b. Where S lacks rank, every b
    with the right S b predicts alike and the prior chooses.

    Args:
        input_noise: Psi, one variance for all inputs, variances (d,) or a covariance (d, d).

    Attributes:
        covariance: posterior covariance of b (d, d), zero for the columns that ARD has removed. It counts rows as
            independent and Psi as exact.
        noise: variance of y given noisy x.
    """

    name = "eiv-ard"
    covariance: Tensor
    noise: float

    def __init__(self, input_noise: Tensor | ArrayLike) -> None:
        self.input_noise = input_noise

    def _coefficients(self, moments: Moments) -> Tensor:
        K = best_guess(moments, noise_covariance(self.input_noise, moments.d))
        guessed = moments.transform(K)
        fit = ard(guessed.xx, guessed.xy, float(guessed.yy), guessed.n)
        self.covariance, self.noise = fit.covariance, fit.noise
        self._noisy_b = K.T @ fit.mean
        return fit.mean


def best_guess(moments: Moments, Psi: Tensor) -> Tensor:
    """Return K (d, d), which makes K x the best linear guess of the noiseless inputs; see EIVARD.

        K = S (S + Psi)^+,   S = PSD(C - Psi)

    Sampling error can give C - Psi negative eigenvalues. PSD sets them to zero, in columns of unit mean square.
    """
    scale = nonzero_root(moments.xx.diagonal())
    outer = scale.unsqueeze(1) * scale
    value, vector = torch.linalg.eigh((moments.xx - Psi) / outer)
    S = (vector * value.clamp_min(0.0)) @ vector.T
    return S @ torch.linalg.pinv(S + Psi / outer, rtol=1e-12, hermitian=True) * (scale.unsqueeze(1) / scale)


def noise_covariance(input_noise: Tensor | ArrayLike, d: int) -> Tensor:
    """Return input noise as a covariance (d, d).

    Args:
        input_noise: one variance for all inputs, variances (d,) or a covariance (d, d).
        d: number of inputs.

    Raises:
        OptionError: another shape, values that are not finite, or no covariance.
        InputError: no numbers.
    """
    Psi = as_float64(input_noise, "input_noise")
    if Psi.dim() == 0:
        Psi = Psi.expand(d)
    if Psi.shape not in ((d,), (d, d)):
        raise OptionError(
            f"input_noise: expected a variance, variances ({d},) or a covariance ({d}, {d}), "
            f"got shape {tuple(Psi.shape)}"
        )
    if not bool(Psi.isfinite().all()):
        raise OptionError("input_noise: expected finite variances, got nan or inf; use 0 for an input without noise")
    if Psi.dim() == 1:
        Psi = torch.diag(Psi)
    largest = float(Psi.diagonal().abs().max())
    asymmetric = float((Psi - Psi.T).abs().max()) > 1e-9 * largest
    if asymmetric or float(torch.linalg.eigvalsh(Psi)[0]) < -1e-9 * largest:
        raise OptionError("input_noise: expected variances of at least 0, or a symmetric positive semidefinite matrix")
    return Psi
