"""The raw, unconstrained variational parameters of the noisy-input model."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torchrbd.regression.noisy_input.elbo import Posterior, Priors
from torchrbd.regression.noisy_input.updates import Bounds, NoiseBounds


class Variational(nn.Module):
    """Hold a posterior as parameters: means as they are, variances, rates and noise as logarithms.

    Attributes:
        x_mean, z_mean: (d,).
        log_x_var, log_z_var, log_rate: (d,).
        log_input_noise: (d,).
        log_hidden_noise: (d,), or None in the merged form.
        log_output_noise: ().
    """

    def __init__(self, s: Posterior, priors: Priors, bounds: NoiseBounds) -> None:
        super().__init__()
        self._bounds = bounds
        self.x_mean, self.z_mean = nn.Parameter(s.x_mean.clone()), nn.Parameter(s.z_mean.clone())
        self.log_x_var, self.log_z_var = nn.Parameter(s.x_var.log()), nn.Parameter(s.z_var.log())
        self.log_rate = nn.Parameter(s.rate.log())
        self.log_input_noise = nn.Parameter(s.input_noise.log(), requires_grad=priors.input is not None)
        self.log_output_noise = nn.Parameter(s.output_noise.log(), requires_grad=priors.output is not None)
        self.log_hidden_noise: nn.Parameter | None = None
        if s.hidden_noise is not None:
            self.log_hidden_noise = nn.Parameter(s.hidden_noise.log(), requires_grad=priors.hidden is not None)

    def forward(self) -> Posterior:
        """Return the posterior, its noise variances within their bounds."""
        hidden = None
        if self.log_hidden_noise is not None and self._bounds.hidden is not None:
            hidden = self._bounds.hidden.clamp(self.log_hidden_noise.exp())
        return Posterior(
            self.x_mean,
            self.log_x_var.exp(),
            self.z_mean,
            self.log_z_var.exp(),
            self.log_rate.exp(),
            self._bounds.input.clamp(self.log_input_noise.exp()),
            hidden,
            self._bounds.output.clamp(self.log_output_noise.exp()),
        )

    @torch.no_grad()
    def store(self, s: Posterior) -> None:
        """Make s the present values."""
        self.x_mean.copy_(s.x_mean)
        self.z_mean.copy_(s.z_mean)
        self.log_x_var.copy_(s.x_var.log())
        self.log_z_var.copy_(s.z_var.log())
        self.log_rate.copy_(s.rate.log())
        self.log_input_noise.copy_(s.input_noise.log())
        self.log_output_noise.copy_(s.output_noise.log())
        if self.log_hidden_noise is not None and s.hidden_noise is not None:
            self.log_hidden_noise.copy_(s.hidden_noise.log())

    def learned(self, n: float) -> list[tuple[nn.Parameter, Tensor, Bounds | None]]:
        """Return what has a gradient, each with its natural unit and the bounds of its exponential.

        The unit is one over the square root of the curvature that N = ``n`` rows give.
        """
        one = torch.ones_like(self.x_mean)
        entries: list[tuple[nn.Parameter | None, Tensor, Bounds | None]] = [
            (self.x_mean, (0.5 * self.log_x_var).exp(), None),
            (self.z_mean, (0.5 * self.log_z_var).exp(), None),
            (self.log_x_var, one, None),
            (self.log_z_var, one, None),
            (self.log_rate, one, None),
            (self.log_input_noise, one * (2.0 / n) ** 0.5, self._bounds.input),
            (self.log_hidden_noise, one * (2.0 / n) ** 0.5, self._bounds.hidden),
            (self.log_output_noise, one.new_tensor((2.0 / n) ** 0.5), self._bounds.output),
        ]
        return [(p, unit.detach(), bounds) for p, unit, bounds in entries if p is not None and p.requires_grad]
