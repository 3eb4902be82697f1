"""Regression on what inputs have in common, and on what single inputs have of their own."""

from __future__ import annotations

import math
from typing import Literal

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from torchrbd.regression.ard import ard
from torchrbd.regression.base import Regression
from torchrbd.regression.classical import Stepwise
from torchrbd.regression.errors_in_variables import noise_covariance
from torchrbd.regression.factor_model import LEAST_OWN, FactorModel, choose_rank, fit_factors
from torchrbd.regression.moments import Moments

# An input that shares less than the first with all others gives no hint of its noise; the second bounds b.
_LEAST_COMMUNALITY, _SIGNAL_SHARE = 0.2, 0.1


class FactorRegression(Regression):
    """Least squares on the factors of the noiseless inputs, with a selection of what single inputs have of their own.

        t = L f + u,   x = t + e,   y = gamma'f + delta'u + noise,   f ~ N(0, 1),   u ~ N(0, D),   e ~ N(0, Psi)
        gamma, delta: regression on the guesses E[f | x] and E[u | x]
        b = S^-1 (L gamma + D delta),   S = L L' + D

    so that b't is the best linear guess of gamma'f + delta'u from noiseless inputs t. E[f | x] and E[u | x] are linear
    in x; EIVARD says why regression on such guesses is consistent. S has far fewer free parameters than in EIVARD, and
    is right only where the inputs follow a factor model: ``choose`` finds out on left-out blocks.

    Psi known: D is what the factor model finds above Psi. What is within sampling error of 0, at most
    (1 + sqrt(2 log d)) standard deviations U_i sqrt(2 / N) of the variance U_i that is not common, takes no part in the
    regression (delta_i = 0).

    Psi unknown: the factor model gives U = D + Psi only. All of it takes part in the regression. Then, of an input that
    shares at least a fifth of its variance with others, U_i is taken for noise unless delta_i was selected; of any
    other input nothing is.

    In S, at least a tenth of U_i counts as the input's own in either case. Else noiseless inputs would have to lie
    exactly where weak factors put them, and b would have no bound.

    No method finds the noise of an input that is independent of all others: say x_i = t_i + e_i, Gaussian, of variance
    V, and y = b_i t_i + rest. All that is observed of it is V and cov(x_i, y) = b_i (V - psi_i). For each psi_i below
    V, as long as the noise of y can make up for it, there is a b_i that gives the same distribution of all data. So the
    likelihood is flat in psi_i: noise only rescales b_i.

    Args:
        input_noise: Psi, one variance for all inputs, variances (d,) or a covariance (d, d); None when unknown.
        rank: number of factors; None chooses it by the likelihood of left-out blocks.
        own_parts: "stepwise" for few, "ard" for many or weak ones; "ard" then shrinks the factors' weights too.

    Attributes:
        model: factor model, its rank as given or chosen, ``own`` and ``noise`` as used in S.
    """

    name = "factor"
    model: FactorModel

    def __init__(
        self,
        input_noise: Tensor | ArrayLike | None = None,
        rank: int | None = None,
        own_parts: Literal["stepwise", "ard"] = "stepwise",
    ) -> None:
        self.input_noise, self.rank, self.own_parts = input_noise, rank, own_parts

    def _coefficients(self, moments: Moments) -> Tensor:
        d, known = moments.d, self.input_noise is not None
        Psi = noise_covariance(moments.xx.new_zeros(d) if self.input_noise is None else self.input_noise, d)
        rank = choose_rank(moments, Psi) if self.rank is None else self.rank
        found = fit_factors(moments.xx, rank, Psi)
        own = _significant(found, moments.n) if known else found.own.clone()
        part = torch.nonzero(own > 0.0).squeeze(1)
        W = torch.linalg.solve(found.covariance, torch.cat((found.loadings, torch.diag(own)[:, part]), 1))
        guessed = moments.transform(W.T)
        if self.own_parts == "stepwise":
            weights = Stepwise(always=rank).fit(guessed).coefficients
        else:
            weights = ard(guessed.xx, guessed.xy, float(guessed.yy), guessed.n).mean
        gamma, delta = weights[:rank], own.new_zeros(d).index_copy(0, part, weights[rank:])
        if not known:
            own = torch.where((delta != 0.0) | (found.communality < _LEAST_COMMUNALITY), own, 0.0)
        used = torch.maximum(own, _SIGNAL_SHARE * found.rest.diagonal())
        self._noisy_b = W @ weights
        self.model = FactorModel(found.loadings, used, found.rest - torch.diag(used))
        S = torch.linalg.cholesky(found.loadings @ found.loadings.T + torch.diag(used))
        return torch.cholesky_solve((found.loadings @ gamma + own * delta).unsqueeze(1), S).squeeze(1)


def _significant(model: FactorModel, n: float) -> Tensor:
    """Return D with what is within sampling error of 0 set to 0."""
    deviations = 1.0 + math.sqrt(2.0 * math.log(max(len(model.own), 2)))
    error = deviations * math.sqrt(2.0 / n) * model.rest.diagonal()
    # An input without noise that others explain keeps the least that the factor model allows.
    error = torch.maximum(error, 2.0 * LEAST_OWN * model.covariance.diagonal())
    return torch.where(model.own > error, model.own, 0.0)
