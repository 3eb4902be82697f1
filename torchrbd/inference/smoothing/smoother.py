"""States and parameters together: what a recording says of x when its positions are noisy too.

    q_m = B c + e_q,   tau_f = F [Y(s(c)) x] + e_tau,   e_q ~ N(0, sigma_q^2),  e_tau ~ N(0, sigma_tau^2) per joint

c are the spline coefficients of the trajectory, F the torque filter. The posterior of c is q(c) = N(m, H^-1), x is a
point, and the torque is linear around m:

    ELBO = - 1/2 sum_j [(|r_j|^2 + T_j) / sigma_j^2 + N_j log 2 pi sigma_j^2]
           - 1/2 sum_i [(|q_m - B m|_i^2 + Q_i) / sigma_qi^2 + N_q log 2 pi sigma_qi^2]
           - prior(x) + 1/2 log det (2 pi e H^-1)

T_j and Q_i are the variances of torques and positions under q(c). Any optimiser may climb it; Gauss-Newton on the
profile of x (``information.py``) is the fast one, with the noise from

    sigma_j^2 = |r_j|^2 / (N_j - T_j / sigma_j^2 - p N_j / N),   p = tr(V S) parameters

Source: the model is that of Ting, Mistry, Peters, Schaal, Nakanishi, "A Bayesian Approach to Nonlinear Parameter
Identification for Rigid Body Dynamics", RSS 2006, with the noise of all inputs tied together by the trajectory instead
of one latent factor an input; noise update: MacKay, "Bayesian Interpolation", Neural Computation 1992, eq. (4.7).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from torchrbd._runtime.deadline import is_over
from torchrbd.dataset.columns import Columns
from torchrbd.inference.smoothing.information import Information, distance, eliminate
from torchrbd.inference.smoothing.linearisation import residual
from torchrbd.inference.smoothing.stretch import Stretch
from torchrbd.likelihood.equations import Equations
from torchrbd.likelihood.physical_fit import PhysicalFit, physical_fit
from torchrbd.likelihood.urdf_prior import Prior
from torchrbd.parameters import PARAMETERS_PER_BODY, from_log_cholesky, to_log_cholesky
from torchrbd.robot import pseudo_inertia

# A position that never changes shows no noise; no encoder is better than this [rad, m].
_LEAST_ENCODER_STD = 1e-7
_MOST_ITERATIONS, _SETTLED, _LEAST_FREEDOM, _HALVINGS = 12, 0.05, 0.02, 4


class StateSmoother(nn.Module):
    """Trajectories, parameters and noise of a set of stretches.

    Args:
        columns: layout of x.
        prior: of the inertial parameters.
        stretches: the data.
        terms: indices of the columns of x that are free besides the inertial ones.
        x: (n_columns,) where to start.
        torque_std: (n_dof,) torque noise to start from; inf for a joint without torque.
        encoder_std: (n_dof,) position noise to start from.

    Attributes:
        trajectories: per stretch the coefficients m (K, n).
        raw_inertia: (n_fitted, 10) log-Cholesky coordinates of the fitted bodies.
        weights: coefficients of the free terms.
        log_torque_std, log_encoder_std: (n_dof,).
        information: what the stretches say at the last linearisation.
    """

    fixed: Tensor

    def __init__(
        self,
        columns: Columns,
        prior: Prior,
        stretches: Sequence[Stretch],
        terms: Tensor,
        x: Tensor,
        torque_std: Tensor,
        encoder_std: Tensor,
    ) -> None:
        super().__init__()
        self.columns, self.prior, self.stretches, self.terms = columns, prior, tuple(stretches), terms
        self.trajectories = nn.ParameterList([s.encoder.clone() for s in self.stretches])
        self.raw_inertia = nn.Parameter(torch.zeros(len(prior.bodies), PARAMETERS_PER_BODY, dtype=torch.float64))
        self.weights = nn.Parameter(torch.zeros(len(terms), dtype=torch.float64))
        self.register_buffer("fixed", x.clone())
        self._set_x(x)
        silent = torch.stack([s.counts.sum(0) for s in self.stretches]).sum(0) == 0
        self.log_torque_std = nn.Parameter(torch.where(silent, torch.ones_like(torque_std), torque_std).log())
        self.log_encoder_std = nn.Parameter(encoder_std.clamp_min(_LEAST_ENCODER_STD).log())
        self.information: Information | None = None

    @property
    def x(self) -> Tensor:
        """Coefficients (n_columns,), differentiable in ``raw_inertia`` and ``weights``."""
        inertial = from_log_cholesky(self.raw_inertia).flatten()
        return self.fixed.index_put((self.prior.inertial,), inertial).index_put((self.terms,), self.weights)

    def _set_x(self, x: Tensor) -> None:
        bodies = x[self.prior.inertial].reshape(-1, PARAMETERS_PER_BODY)
        self.raw_inertia.data = to_log_cholesky(bodies)
        self.weights.data = x[self.terms].clone()

    @property
    def free(self) -> Tensor:
        """Indices of the columns of x that are fitted."""
        return torch.cat((self.prior.inertial, self.terms))

    def refresh(self, wanted: Tensor | None = None) -> Information:
        """Linearise anew, which makes q(c) optimal for the present means and noise; return the information on x.

        Args:
            wanted: columns of x that ``Information`` is about; the free ones by default.
        """
        return self._eliminate(self.free if wanted is None else wanted, lambda *_: None)

    @torch.no_grad()
    def _eliminate(self, wanted: Tensor, advance: Callable[[Stretch, Tensor, Tensor], None]) -> Information:
        torque, encoder, x = (2 * self.log_torque_std).exp(), (2 * self.log_encoder_std).exp(), self.x.detach()
        found: Information | None = None
        for stretch, c in zip(self.stretches, self.trajectories, strict=True):
            with torch.enable_grad():
                one, step = eliminate(self.columns, stretch, c.detach(), x, torque, encoder, wanted)
            advance(stretch, c, step)
            found = one if found is None else found + one
        assert found is not None
        self.information = found
        return found

    def squares(self) -> tuple[Tensor, Tensor]:
        """Return the squared residuals of torques and positions, (n_dof,) each; differentiable."""
        x, pairs = self.x, list(zip(self.stretches, self.trajectories, strict=True))
        torques = [(s.counts * residual(self.columns, s, c, x).square()).sum(0) for s, c in pairs]
        return torch.stack(torques).sum(0), torch.stack([distance(s, c) for s, c in pairs]).sum(0)

    def elbo(self) -> Tensor:
        """Return the bound at the means and noise as they are, with the covariance of the last ``refresh``."""
        at = self.information or self.refresh()
        torque, encoder = (2 * self.log_torque_std).exp(), (2 * self.log_encoder_std).exp()
        square, misfit = self.squares()
        torques = (square + at.spread) / torque + at.count * (2 * math.pi * torque).log()
        positions = (misfit + at.wander) / encoder + at.samples * (2 * math.pi * encoder).log()
        dimension = sum(c.numel() for c in self.trajectories)
        entropy = at.entropy + 0.5 * dimension * (1 + math.log(2 * math.pi))
        return -0.5 * torques.sum() - 0.5 * positions.sum() - self._divergence() + entropy

    def _divergence(self) -> Tensor:
        """Return kappa sum [tr(J0^-1 J) - logdet J] and 1/2 |z|^2 of the terms."""
        J = pseudo_inertia(self.x[self.prior.inertial].reshape(-1, PARAMETERS_PER_BODY))
        bodies = (self.prior.inverse_inertia * J).sum() - torch.linalg.slogdet(J).logabsdet.sum()
        width = self.prior.scale.diagonal()[self.terms]
        away = torch.where(
            width > 0, (self.weights - self.prior.mean[self.terms]) / width, torch.zeros_like(self.weights)
        )
        return self.prior.kappa * bodies + 0.5 * away.square().sum()

    def fit(self, progress: Callable[[float], None] = lambda _: None) -> PhysicalFit:
        """Climb by Gauss-Newton until neither parameters nor noise change; return the fit of x at the end."""
        for iteration in range(_MOST_ITERATIONS):
            progress(iteration / _MOST_ITERATIONS)
            before = self.x.detach()
            found = self._eliminate(self.free, self._advance)
            fit = self._fit_x(found)
            self._set_x(fit.x)
            noise_change = self._update_noise(found, fit)
            moved = (fit.x - before)[self.free]
            if float(moved @ (found.gram - found.lost) @ moved) < _SETTLED * len(moved) and noise_change < _SETTLED:
                break
            if is_over():
                break
        return fit

    @torch.no_grad()
    def _advance(self, stretch: Stretch, c: Tensor, step: Tensor) -> None:
        """Move a trajectory, less far if the torques are too curved for the whole step."""
        torque, encoder, x = (2 * self.log_torque_std).exp(), (2 * self.log_encoder_std).exp(), self.x

        def loss(c: Tensor) -> float:
            r = residual(self.columns, stretch, c, x)
            return float((stretch.counts * r.square() / torque).sum() + (distance(stretch, c) / encoder).sum())

        before, part = loss(c), 1.0
        for _ in range(_HALVINGS):
            if loss(c + part * step) <= before:
                c += part * step
                return
            part *= 0.5

    def _fit_x(self, found: Information) -> PhysicalFit:
        free, S = self.free, self.prior.scale
        curvature = torch.zeros_like(S)
        curvature[free.unsqueeze(1), free] = found.gram - found.lost
        away = self.x.detach() - self.prior.mean
        h = curvature @ away
        h[free] += found.slope
        return physical_fit(self.prior, Equations(S.T @ curvature @ S, S.T @ h), self.terms)

    @torch.no_grad()
    def _update_noise(self, found: Information, fit: PhysicalFit) -> float:
        """Set the noise to what the residuals say; return the largest relative change."""
        torque = (2 * self.log_torque_std).exp()
        S = self.prior.scale[self.free][:, self.free]
        covariance = S @ torch.linalg.inv(fit.precision) @ S.T
        parameters = (covariance * (found.gram - found.lost)).sum() * found.count / found.count.sum()
        # after the step: the residuals before it lag behind, and the noise would swing
        square, misfit = self.squares()
        freedom = found.count - found.spread / torque - parameters
        variance = square / torch.maximum(freedom, _LEAST_FREEDOM * found.count).clamp_min(1e-300)
        variance = torch.where(found.count > 0, variance.clamp_min(1e-300), torch.ones_like(variance))
        encoder = (misfit / (found.samples - found.wander / (2 * self.log_encoder_std).exp())).clamp_min(
            _LEAST_ENCODER_STD**2
        )
        change = max(
            float((0.5 * variance.log() - self.log_torque_std).abs().max()),
            float((0.5 * encoder.log() - self.log_encoder_std).abs().max()),
        )
        self.log_torque_std.data = 0.5 * variance.log()
        self.log_encoder_std.data = 0.5 * encoder.log()
        return change
