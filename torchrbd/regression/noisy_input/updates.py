"""Closed-form coordinate updates of the noisy-input model: each raises its evidence lower bound.

One sweep puts q(Z, T) at its optimum (one product with X'X), then q(w_x), q(w_z), the noise variances and q(alpha) at
theirs, each given the others:

    U = 1 / (E[t't]/psi_x + E[alpha]),   u = U E[x't]/psi_x
    V = 1 / (E[t't]/psi_z + E[alpha]),   v = V E[z't]/psi_z
    b_alpha = b + (u^2 + U + v^2 + V) / 2
    psi = (E|residual|^2 / 2 + scale) / (N/2 + shape + 1), clamped

In the merged form v is one vector: the mean of a Gaussian with precision E[T'T]/psi_y + diag(E[alpha]). Some steps of
conjugate gradients, each one more product with X'X, approach it; each lowers the quadratic, so the bound still rises.

Source: Ting et al. (RSS 2006), section III, eqs. for the EM updates; here with proper priors on the noise variances.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.regression.noisy_input.elbo import Collapsed, Evidence, NoisePrior, Posterior, Priors

_CG_STEPS = 4


@dataclass(frozen=True)
class Bounds:
    """Least and largest value of each noise variance: ``low``, ``high`` (d,) or (); equal where the noise is given."""

    low: Tensor
    high: Tensor

    def clamp(self, psi: Tensor) -> Tensor:
        """Return psi within the bounds."""
        return torch.minimum(torch.maximum(psi, self.low), self.high)


@dataclass(frozen=True)
class NoiseBounds:
    """Bounds of the three noise variances, columns of mean square 1; ``hidden`` is None in the merged form."""

    input: Bounds
    hidden: Bounds | None
    output: Bounds


def sweep(evidence: Evidence, priors: Priors, bounds: NoiseBounds, s: Posterior, at: Collapsed) -> Posterior:
    """Return the posterior after one round of updates.

    Args:
        evidence: moments of the rows.
        priors: prior distributions.
        bounds: of the noise variances.
        s: the posterior before.
        at: ``collapse(evidence, s)``.
    """
    n, alpha = evidence.n, (priors.shape + 1.0) / s.rate
    power = evidence.xx.diagonal()
    u = s.z_mean / at.h
    # E[x t], E[t^2] per row; var(t) = diag(1/h) - u u'/S.
    xt = at.p * power + at.q * at.xr
    tt = at.p * (at.p * power + 2.0 * at.q * at.xr) + at.q.square() * at.rr + 1.0 / at.h - u.square() / at.S
    x_var = 1.0 / (n * tt / s.input_noise + alpha)
    x_mean = x_var * n * xt / s.input_noise
    left = power - 2.0 * x_mean * xt + (x_mean.square() + x_var) * tt
    input_noise = _noise(left, n, priors.input, bounds.input, s.input_noise)
    update = _merged if s.hidden_noise is None else _separate
    z_mean, z_var, hidden_noise, output_noise = update(evidence, priors, bounds, s, at, tt)
    rate = priors.rate + 0.5 * (x_mean.square() + x_var + z_mean.square() + z_var)
    return Posterior(x_mean, x_var, z_mean, z_var, rate, input_noise, hidden_noise, output_noise)


def _separate(
    evidence: Evidence, priors: Priors, bounds: NoiseBounds, s: Posterior, at: Collapsed, tt: Tensor
) -> tuple[Tensor, Tensor, Tensor | None, Tensor]:
    """Update q(w_z) and the noise behind it; every input on its own."""
    assert s.hidden_noise is not None
    n, alpha = evidence.n, (priors.shape + 1.0) / s.rate
    u = s.z_mean / at.h
    spread = s.hidden_noise + s.z_mean.square() / at.h
    gain = spread / at.S
    zt = at.c * at.p * evidence.xx.diagonal() + (at.c * at.q + gain * at.p) * at.xr + gain * at.q * at.rr + u - gain * u
    zz = at.c.square() * evidence.xx.diagonal() + gain * (2.0 * at.c * at.xr + gain * at.rr) + spread * (1.0 - gain)
    z_var = 1.0 / (n * tt / s.hidden_noise + alpha)
    z_mean = z_var * n * zt / s.hidden_noise
    left = zz - 2.0 * z_mean * zt + (z_mean.square() + z_var) * tt
    hidden_noise = _noise(left, n, priors.hidden, bounds.hidden, s.hidden_noise)
    share = s.output_noise / at.S
    output_left = share.square() * at.rr + share * spread.sum()
    return z_mean, z_var, hidden_noise, _noise(output_left, n, priors.output, bounds.output, s.output_noise)


def _merged(
    evidence: Evidence, priors: Priors, bounds: NoiseBounds, s: Posterior, at: Collapsed, tt: Tensor
) -> tuple[Tensor, Tensor, Tensor | None, Tensor]:
    """Update q(w_z) and psi_y where z_m = w_zm t_m has no noise of its own."""
    n, alpha = evidence.n, (priors.shape + 1.0) / s.rate
    u, pe = s.z_mean / at.h, at.p * at.xr
    yr = evidence.yy - at.c @ evidence.xy
    yt = at.p * evidence.xy + at.q * yr

    def times_tt(v: Tensor) -> Tensor:
        """E[t t'] v."""
        along = at.q @ v
        product = at.p * (evidence.xx @ (at.p * v)) + pe * along + at.q * (pe @ v + at.rr * along)
        return product + v / at.h - u * (u @ v) / at.S

    precision = n * tt / s.output_noise + alpha
    z_var = 1.0 / precision
    z_mean = _conjugate_gradients(
        lambda v: n * times_tt(v) / s.output_noise + alpha * v, n * yt / s.output_noise, s.z_mean, precision
    )
    left = evidence.yy - 2.0 * z_mean @ yt + z_mean @ times_tt(z_mean) + z_var @ tt
    return z_mean, z_var, None, _noise(left, n, priors.output, bounds.output, s.output_noise)


def _conjugate_gradients(times: Callable[[Tensor], Tensor], b: Tensor, x: Tensor, diagonal: Tensor) -> Tensor:
    """Take a few steps from x towards A^-1 b, preconditioned by the diagonal of A."""
    residual = b - times(x)
    scaled = residual / diagonal
    direction, square = scaled, residual @ scaled
    # Below rounding a step could raise the quadratic.
    least = 1e-28 * (b @ (b / diagonal))
    for _ in range(_CG_STEPS):
        if square <= least:
            break
        product = times(direction)
        step = square / (direction @ product)
        x, residual = x + step * direction, residual - step * product
        scaled = residual / diagonal
        before, square = square, residual @ scaled
        direction = scaled + (square / before) * direction
    return x


def _noise(left: Tensor, n: float, prior: NoisePrior | None, bounds: Bounds | None, given: Tensor) -> Tensor:
    """Return the noise variance that the mean squared residual ``left`` and the prior call for."""
    if prior is None or bounds is None:
        return given
    best = (0.5 * n * left + prior.scale) / (0.5 * n + prior.shape + 1.0)
    return bounds.clamp(best)
