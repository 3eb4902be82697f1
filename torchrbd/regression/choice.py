"""Choose between regressions by their error on left-out blocks, without the part of known input noise: the default."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from torchrbd.errors import OptionError
from torchrbd.regression.base import Regression
from torchrbd.regression.classical import OrdinaryLeastSquares, Stepwise
from torchrbd.regression.errors_in_variables import best_guess, noise_covariance
from torchrbd.regression.factor_model import choose_rank
from torchrbd.regression.factor_regression import FactorRegression
from torchrbd.regression.moments import Moments


@dataclass(frozen=True)
class Choice:
    """What was chosen: ``best``, fitted to all blocks, and ``errors`` (B, K), of each candidate on each block."""

    best: Regression
    errors: Tensor


def choose(
    candidates: Sequence[Regression],
    moments: Moments,
    input_noise: Tensor | ArrayLike | None = None,
    *,
    caution: float = 1.0,
) -> Choice:
    """Choose between candidates by their errors on each block when fitted to all others.

    The last candidate is the one to fall back on. Those count whose error is lower than its by more than ``caution``
    standard errors; of them the first within one standard error of the best is chosen. Standard errors are those of
    paired differences over blocks.

    Where Psi is known, b is judged by its error on the best guesses K x of the noiseless inputs, K from the blocks that
    b has seen (see EIVARD):

        b'K C_f K'b - 2 b'K c_f = (b - b0)'S C^-1 S (b - b0) + constant, on average, with b0 the true coefficients

    It weighs directions by what the noise leaves of them. The corrected error b'(C_f - Psi) b - 2 b'c_f weighs them by
    S, as the error at noiseless inputs does, but scatters more: b'Psi b is only cancelled on average.

    Args:
        candidates: regressions by preference, not changed.
        moments: two or more blocks.
        input_noise: Psi, if known: candidates are judged by their prediction from noiseless inputs. None: by their
            prediction from inputs as noisy as the training ones.
        caution: standard errors.
    """
    blocks = len(moments.count)
    if blocks < 2:
        raise OptionError(f"choosing by left-out blocks needs 2 or more blocks of moments, got {blocks}")
    Psi = None if input_noise is None else noise_covariance(input_noise, moments.d)
    errors = torch.empty(blocks, len(candidates), dtype=torch.float64)
    for left_out in range(blocks):
        keep = torch.arange(blocks) != left_out
        seen = moments.select(keep)
        K = None if Psi is None else best_guess(seen, Psi)
        for k, candidate in enumerate(candidates):
            fitted = copy.copy(candidate).fit(seen)
            b = fitted.noisy_coefficients if K is None else K.T @ fitted.coefficients
            errors[left_out, k] = moments.select(~keep).error(b)
    share = moments.count / moments.n
    best = len(candidates) - 1
    better = [k for k in range(best) if _standard_errors_above(errors[:, best], errors[:, k], share) > caution]
    if better:
        least = min(better, key=lambda k: float(share @ errors[:, k]))
        best = next(k for k in better if _standard_errors_above(errors[:, k], errors[:, least], share) < 1.0)
    return Choice(copy.copy(candidates[best]).fit(moments), errors)


def _standard_errors_above(a: Tensor, b: Tensor, share: Tensor) -> float:
    """Return by how many standard errors the mean of a is above that of b."""
    difference = a - b
    mean = share @ difference
    deviation = (share.square() @ (difference - mean).square() * len(a) / (len(a) - 1)).sqrt()
    return float(mean / deviation.clamp_min(1e-300))


class BestRegression(Regression):
    """The default: the best of several regressions by the error on left-out blocks, see ``choose``.

    Psi known: FactorRegression with stepwise selection, and with ARD, stepwise selection and least squares. EIVARD is
    not among them: FactorRegression with ARD was better on most designs tried, though not on all.

    Psi unknown: FactorRegression, which finds Psi where inputs have much in common, stepwise selection and least
    squares, judged by their prediction from noisy inputs. Two models that predict equally well from noisy inputs can
    differ at noiseless ones, and no data can show which is right (see FactorRegression). Therefore least squares stays
    unless another one is better by two standard errors. Where noise is known, give it.

    Args:
        input_noise: Psi, one variance for all inputs, variances (d,) or a covariance (d, d); None when unknown.

    Attributes:
        choice: the candidate chosen, fitted, and the errors of all.
    """

    name = "best"
    choice: Choice

    def __init__(self, input_noise: Tensor | ArrayLike | None = None) -> None:
        self.input_noise = input_noise

    def _coefficients(self, moments: Moments) -> Tensor:
        known = self.input_noise
        Psi = noise_covariance(moments.xx.new_zeros(moments.d) if known is None else known, moments.d)
        rank = choose_rank(moments, Psi)
        candidates = [FactorRegression(known, rank), Stepwise(), OrdinaryLeastSquares()]
        if known is not None:
            candidates.insert(1, FactorRegression(known, rank, "ard"))
        self.choice = choose(candidates, moments, known, caution=2.0 if known is None else 1.0)
        self._noisy_b = self.choice.best.noisy_coefficients
        return self.choice.best.coefficients
