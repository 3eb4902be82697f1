"""Noise variances as the user states them: given, learned, or learned between bounds."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from torchrbd.errors import OptionError
from torchrbd.regression.moments import as_float64
from torchrbd.regression.noisy_input.elbo import NoisePrior, Priors
from torchrbd.regression.noisy_input.updates import Bounds, NoiseBounds

# Proper, but broad against every scale of normalised data.
_RELEVANCE = 1e-6
_NOISE_SHAPE = 1.0
_OUTPUT_SHARE = 0.1
# Noise below this part of a column's mean square counts as none.
_LEAST_NOISE = 1e-8


@dataclass(frozen=True)
class NoiseRange:
    """A noise variance that is learned between bounds, each a number or one per input; equal bounds mean given.

    Where ``high`` is below an input's mean square, that input cannot be judged irrelevant: noise alone would not
    explain it.
    """

    low: Tensor | ArrayLike = 0.0
    high: Tensor | ArrayLike = torch.inf


def as_range(noise: Tensor | ArrayLike | NoiseRange | None) -> NoiseRange:
    """Read None as learned freely, a value as given."""
    if noise is None:
        return NoiseRange()
    return noise if isinstance(noise, NoiseRange) else NoiseRange(noise, noise)


def noise_bounds(ranges: tuple[NoiseRange, NoiseRange, NoiseRange], x_scale: Tensor, y_scale: Tensor) -> NoiseBounds:
    """Return the bounds for columns of mean square 1.

    Args:
        ranges: of the input, hidden and output noise, in the user's units.
        x_scale: root mean square of the inputs (d,).
        y_scale: root mean square of the output ().

    Raises:
        OptionError: for a wrong shape, a negative variance, or bounds in the wrong order.
    """
    of_input, of_hidden, of_output = ranges
    merged = bool((as_float64(of_hidden.high, "hidden_noise") == 0.0).all())
    return NoiseBounds(
        _bounds(of_input, "input_noise", x_scale.square()),
        None if merged else _bounds(of_hidden, "hidden_noise", y_scale.square().expand_as(x_scale)),
        _bounds(of_output, "output_noise", y_scale.square()),
    )


def _bounds(noise: NoiseRange, name: str, unit: Tensor) -> Bounds:
    """Return the bounds as parts of ``unit``, in its shape."""
    ends = []
    for end in (noise.low, noise.high):
        end = as_float64(end, name)
        if end.ndim and end.shape != unit.shape:
            got, expected = tuple(end.shape), tuple(unit.shape)
            raise OptionError(f"{name} has shape {got}, expected a number or {expected}: one variance per input")
        ends.append((end / unit).clamp_min(_LEAST_NOISE).expand_as(unit))
        if not bool((end >= 0.0).all()):
            raise OptionError(f"{name} is a variance and cannot be negative or NaN")
    if not bool((ends[0] <= ends[1]).all()):
        raise OptionError(f"{name}: low must not exceed high")
    if not bool(ends[0].isfinite().all()):
        raise OptionError(f"{name}: low must be finite")
    return Bounds(*ends)


def priors_of(bounds: NoiseBounds, noise_share: float) -> Priors:
    """Return the priors; a noise that is given everywhere has none."""

    def prior(of: Bounds | None, mode: float) -> NoisePrior | None:
        learned = of is not None and bool((of.low < of.high).any())
        return NoisePrior(_NOISE_SHAPE, mode * (_NOISE_SHAPE + 1.0)) if learned else None

    of_hidden = prior(bounds.hidden, _OUTPUT_SHARE / max(bounds.input.low.numel(), 1))
    of_input, of_output = prior(bounds.input, noise_share), prior(bounds.output, _OUTPUT_SHARE)
    return Priors(_RELEVANCE, _RELEVANCE, of_input, of_hidden, of_output)
