"""The paper's factor model of noisy inputs: its evidence lower bound from second moments, with q(Z, T) eliminated.

For a row (x, y), with m over the d inputs:

    y = sum_m z_m + e_y,   x_m = w_xm t_m + e_xm,   z_m = w_zm t_m + e_zm,   t_m ~ N(0, 1)
    w_xm, w_zm ~ N(0, 1/alpha_m),   alpha_m ~ Gamma(a, b)

With q(w_xm) = N(u_m, U_m), q(w_zm) = N(v_m, V_m), the best q(z, t) of a row is Gaussian. Integrating t, then z, whose
precision is then diagonal plus rank one, leaves per row

    log N(y; c'x, S) - 1/2 sum_m [log(2 pi psi_xm h_m) + x_m^2 (1 + U_m/psi_xm + V_m/psi_zm) / (psi_xm h_m)]
    h_m = 1 + (u_m^2 + U_m)/psi_xm + V_m/psi_zm        precision of t_m given x_m
    c_m = v_m p_m,   p_m = u_m / (psi_xm h_m)            t_m given x_m has mean p_m x_m
    S   = psi_y + sum_m (psi_zm + v_m^2/h_m)

so that the sum over rows needs X'X, X'y, y'y only. In the merged form psi_z = 0 and V_m/psi_y takes the place of
V_m/psi_zm.

Source: Ting, Mistry, Peters, Schaal, Nakanishi (RSS 2006), section III. The paper alternates between q(Z, T) and the
rest; here q(Z, T) is always at its optimum, and every prior is proper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from scipy import special
from torch import Tensor


@dataclass(frozen=True)
class Evidence:
    """Moments over ``n`` = N rows whose columns have mean square 1: ``xx`` (d, d), ``xy`` (d,), ``yy`` ()."""

    xx: Tensor
    xy: Tensor
    yy: Tensor
    n: float


@dataclass(frozen=True)
class NoisePrior:
    """Inverse-gamma prior of a noise variance that is learned.

    log p(psi) = shape log(scale) - lgamma(shape) - (shape + 1) log(psi) - scale / psi
    """

    shape: float
    scale: float

    def log_density(self, psi: Tensor) -> Tensor:
        """Return the sum of log p over the entries of psi."""
        constant = self.shape * math.log(self.scale) - math.lgamma(self.shape)
        return (constant - (self.shape + 1.0) * psi.log() - self.scale / psi).sum()


@dataclass(frozen=True)
class Priors:
    """``shape``, ``rate``: of the Gamma prior of alpha. The noise priors are None where the noise is given."""

    shape: float
    rate: float
    input: NoisePrior | None
    hidden: NoisePrior | None
    output: NoisePrior | None


@dataclass(frozen=True)
class Posterior:
    """Variational parameters, each (d,), and noise variances, for columns of mean square 1.

    ``x_mean``, ``x_var``: of q(w_x); ``z_mean``, ``z_var``: of q(w_z); ``rate``: of q(alpha), whose shape is a + 1;
    ``input_noise`` (d,), ``hidden_noise`` (d,) or None in the merged form, ``output_noise`` ().
    """

    x_mean: Tensor
    x_var: Tensor
    z_mean: Tensor
    z_var: Tensor
    rate: Tensor
    input_noise: Tensor
    hidden_noise: Tensor | None
    output_noise: Tensor


@dataclass(frozen=True)
class Collapsed:
    """The remaining parts of q(Z, T). With r = y - c'x, the mean of t is p x + q r.

    ``h``, ``p``, ``q``, ``c`` (d,); ``S`` (); ``xr`` (d,) and ``rr`` (): mean of x r and of r^2.
    """

    h: Tensor
    p: Tensor
    q: Tensor
    c: Tensor
    S: Tensor
    xr: Tensor
    rr: Tensor


def collapse(evidence: Evidence, s: Posterior) -> Collapsed:
    """Eliminate q(Z, T): one product with X'X."""
    behind_z = s.output_noise if s.hidden_noise is None else s.hidden_noise
    h = 1.0 + (s.x_mean.square() + s.x_var) / s.input_noise + s.z_var / behind_z
    p = s.x_mean / (s.input_noise * h)
    c = s.z_mean * p
    S = s.output_noise + (s.z_mean.square() / h).sum()
    if s.hidden_noise is not None:
        S = S + s.hidden_noise.sum()
    xr = evidence.xy - evidence.xx @ c
    rr = evidence.yy - c @ evidence.xy - c @ xr
    return Collapsed(h, p, s.z_mean / (h * S), c, S, xr, rr)


def elbo(evidence: Evidence, priors: Priors, s: Posterior, at: Collapsed | None = None) -> Tensor:
    """Return the evidence lower bound, plus the log prior of the noise variances that are learned [nat]."""
    at = collapse(evidence, s) if at is None else at
    return evidence.n * _mean_log_likelihood(evidence, s, at) - _weights_divergence(priors, s) + _log_prior(priors, s)


def _mean_log_likelihood(evidence: Evidence, s: Posterior, at: Collapsed) -> Tensor:
    of_y = torch.log(2.0 * math.pi * at.S) + at.rr / at.S
    behind_z = s.output_noise if s.hidden_noise is None else s.hidden_noise
    # Same as 1/psi_x - u^2/(psi_x^2 h), without the cancellation at small psi_x.
    precision = (1.0 + s.x_var / s.input_noise + s.z_var / behind_z) / (s.input_noise * at.h)
    of_x = torch.log(2.0 * math.pi * s.input_noise * at.h) + evidence.xx.diagonal() * precision
    return -0.5 * (of_y + of_x.sum())


def _weights_divergence(priors: Priors, s: Posterior) -> Tensor:
    """Return KL[q(w_x) q(w_z) q(alpha) || p(w_x, w_z, alpha)]."""
    shape = priors.shape + 1.0
    digamma = float(special.digamma(shape))
    mean, mean_log = shape / s.rate, digamma - s.rate.log()
    square = s.x_mean.square() + s.x_var + s.z_mean.square() + s.z_var
    of_w = 0.5 * (mean * square - s.x_var.log() - s.z_var.log()) - mean_log - 1.0
    constant = digamma - math.lgamma(shape) + math.lgamma(priors.shape) - priors.shape * math.log(priors.rate) - shape
    of_alpha = constant + priors.shape * s.rate.log() + priors.rate * mean
    return (of_w + of_alpha).sum()


def _log_prior(priors: Priors, s: Posterior) -> Tensor:
    total = s.x_mean.new_zeros(())
    if priors.input is not None:
        total = total + priors.input.log_density(s.input_noise)
    if priors.hidden is not None and s.hidden_noise is not None:
        total = total + priors.hidden.log_density(s.hidden_noise)
    if priors.output is not None:
        total = total + priors.output.log_density(s.output_noise)
    return total
