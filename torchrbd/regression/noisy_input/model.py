"""NoisyInputRegression: the factor model of Ting et al. as a module, fitted from second moments."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn
from typing_extensions import Self

from torchrbd.errors import InputError, OptionError
from torchrbd.regression.base import NOT_FITTED, Regression
from torchrbd.regression.moments import Moments
from torchrbd.regression.noisy_input.ascent import climb_by_coordinates, climb_by_gradient
from torchrbd.regression.noisy_input.elbo import Evidence, Posterior, collapse, elbo
from torchrbd.regression.noisy_input.noise import NoiseRange, as_range, noise_bounds, priors_of
from torchrbd.regression.noisy_input.start import start
from torchrbd.regression.noisy_input.updates import sweep
from torchrbd.regression.noisy_input.variational import Variational

_CLEAR_OF_ZERO = 2.0
# Above .169 a noise prior of shape 1 is too weak to hold rho against the prior of the weights.
_MOST_SHARE = 0.15


class NoisyInputRegression(nn.Module, Regression):
    """Regress on noisy inputs by the factor model of Ting et al., with automatic relevance determination.

        y = sum_m z_m + e_y,   x_m = w_xm t_m + e_xm,   z_m = w_zm t_m + e_zm,   b_m = w_zm / w_xm

    No intercept is fitted: centre the data. Each noise variance can be given (a number or one per input), learned
    between bounds (``NoiseRange``) or learned freely (None). Learned ones have a proper inverse-gamma prior of shape 1
    in units of the column's mean square: mode ``noise_share`` for an input, 0.1 for the output and 0.1/d for the hidden
    noise. They are maximised, not integrated.

    What the data cannot identify. An input has two moments that matter, x_m^2 and x_m y, and three unknowns. The
    likelihood of (x, y) is the same for every rho_m = w_xm^2 / (w_xm^2 + psi_xm) as long as output noise is left:
    sum_m b_m^2 rho_m psi_xm below the residual variance of least squares. So:

    - Predictions for queries as noisy as the data (``noisy_coefficients``) tend to least squares, whatever the noise.
    - b is that divided by rho, and rho comes from ``input_noise`` or else from the prior. Without knowledge of the
      noise the answer is a convention: ``noise_share``, small, so that b stays near least squares on the inputs kept.
    - The factors t_m are independent. Dividing by rho is right for independent inputs, and wrong for redundant ones,
      where several noisy copies already average their noise out: there, given noise makes b too large.
    - Relevance: one precision rules w_x and w_z, so an input can be dead (b = 0) only if its noise may explain all
      of it. With ``input_noise`` given none is; with ``NoiseRange(low=known)`` noise is at least the known.
    - Started elsewhere, the iterations can pass a better b on their way up: the bound is not the noiseless error.
      The start is therefore the bound's own stationary point to leading order, from which they move little.

    Args:
        input_noise: psi_x (d,) or a number [unit of x, squared], a range, or None.
        output_noise: psi_y [unit of y, squared], a range, or None.
        hidden_noise: psi_z (d,) or a number [unit of y, squared], a range, or None. 0 merges it into psi_y, and
            w_z is then one vector rather than d unrelated weights.
        noise_share: mode of the prior of a learned psi_x, as a part of the column's mean square.
        iterations: at most.
        tolerance: stop when an iteration raises the bound by less [nat].

    Attributes:
        history: bound at the start and after each iteration [nat], for columns of mean square 1.
        converged: whether ``tolerance`` was reached.

    ``state_dict`` holds the data's moments with the parameters, so that ``load_state_dict`` of a new regression with
    the same options needs no data; it leaves ``history`` out.

    Source: Ting, Mistry, Peters, Schaal, Nakanishi, "A Bayesian approach to nonlinear parameter identification for
    rigid body dynamics" (RSS 2006), section III. Deviations: proper noise priors, q(Z, T) eliminated, psi_z merged
    unless asked for, and a start that elects the relevant inputs by the bound (``start``).
    """

    name: ClassVar[str] = "noisy-input"
    q: Variational
    moments: Tensor
    rows: Tensor
    x_scale: Tensor
    y_scale: Tensor

    def __init__(
        self,
        input_noise: Tensor | ArrayLike | NoiseRange | None = None,
        output_noise: Tensor | ArrayLike | NoiseRange | None = None,
        hidden_noise: Tensor | ArrayLike | NoiseRange | None = 0.0,
        *,
        noise_share: float = 0.03,
        iterations: int = 1000,
        tolerance: float = 1e-4,
    ) -> None:
        super().__init__()
        if not 0.0 < noise_share <= _MOST_SHARE:
            raise OptionError(
                f"noise_share must be above 0 and at most {_MOST_SHARE}, got {noise_share}; "
                "give larger noise as input_noise or as NoiseRange(low=...)"
            )
        self._ranges = as_range(input_noise), as_range(hidden_noise), as_range(output_noise)
        self._noise_share, self._iterations, self._tolerance = noise_share, iterations, tolerance
        self._evidence: Evidence | None = None

    def fit(
        self,
        X: Tensor | ArrayLike | Moments,
        y: Tensor | ArrayLike | None = None,
        *,
        method: Literal["coordinate", "autograd"] = "coordinate",
    ) -> Self:
        """Fit to moments, or to inputs X (N, d) and outputs y (N,), tensors or numpy arrays.

        Args:
            X: inputs or moments.
            y: outputs, unless moments are given.
            method: "coordinate", the closed-form updates; "autograd", L-BFGS on the gradient of ``elbo``.

        Raises:
            InputError: for values that are not finite.
            OptionError: for a noise of the wrong shape or sign.
        """
        if method not in ("coordinate", "autograd"):
            raise OptionError(f"method is 'coordinate' or 'autograd'; got {method!r}")
        self.start(X, y)
        limits = {"iterations": self._iterations, "tolerance": self._tolerance}
        if method == "coordinate":
            ascent = climb_by_coordinates(self._data, self._priors, self._bounds, self.q, **limits)
        else:
            ascent = climb_by_gradient(self._data, self._priors, self.q, **limits)
        self.history, self.converged = ascent.history, ascent.converged
        return self

    def _coefficients(self, moments: Moments) -> Tensor:
        return self.fit(moments).coefficients

    def start(self, X: Tensor | ArrayLike | Moments, y: Tensor | ArrayLike | None = None) -> Self:
        """Take the data and go to the documented start: least squares where the data has information, priors elsewhere.

        From there ``update``, or any optimizer on ``elbo``, goes on.
        """
        moments = Moments.of(X, y)
        if not bool(torch.isfinite(moments.blocks).all()) or moments.n <= 0.0:
            raise InputError("moments must be finite and of at least one row: remove rows with missing values")
        self.register_buffer("moments", moments.total)
        self.register_buffer("rows", moments.count.sum())
        x_scale, y_scale = _scale(moments.xx.diagonal()), _scale(moments.yy)
        self.register_buffer("x_scale", x_scale)
        self.register_buffer("y_scale", y_scale)
        xx = moments.xx / torch.outer(x_scale, x_scale)
        self._evidence = Evidence(xx, moments.xy / (x_scale * y_scale), moments.yy / y_scale**2, moments.n)
        self._bounds = noise_bounds(self._ranges, x_scale, y_scale)
        self._priors = priors_of(self._bounds, self._noise_share)
        self.q = Variational(start(self._evidence, self._priors, self._bounds), self._priors, self._bounds)
        return self

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *args: Any) -> None:
        # Parameters have the shapes of the data, which the state holds.
        if f"{prefix}moments" in state_dict:
            self.start(Moments(state_dict[f"{prefix}moments"].unsqueeze(0), state_dict[f"{prefix}rows"].reshape(1)))
        super()._load_from_state_dict(state_dict, prefix, *args)

    def elbo(self) -> Tensor:
        """Return the evidence lower bound at the present parameters, for columns of mean square 1 [nat].

        Differentiable in every parameter of the module. Learned noise adds its log prior density.
        """
        return elbo(self._data, self._priors, self.q())

    @torch.no_grad()
    def update(self) -> None:
        """Do one round of closed-form coordinate updates."""
        s = self.posterior
        self.q.store(sweep(self._data, self._priors, self._bounds, s, collapse(self._data, s)))

    @property
    def posterior(self) -> Posterior:
        """Variational parameters and noise variances, for columns of mean square 1."""
        if self._evidence is None:
            raise InputError(NOT_FITTED)
        return self.q()

    @property
    def coefficients(self) -> Tensor:
        """b (d,) for noiseless queries: E[w_z] / E[w_x], exactly 0 for dead inputs.

        Dead is an input whose mean of w_x is within two of its standard deviations from 0.
        """
        return self._ratio().detach()

    @property
    def noisy_coefficients(self) -> Tensor:
        """c (d,) for queries as noisy as the data: E[y | x] = c'x."""
        return self._noisy().detach()

    @property
    def input_noise(self) -> Tensor:
        """psi_x (d,) [unit of x, squared], as given or learned. It is the whole mean square of a dead input."""
        return (self.posterior.input_noise * self.x_scale**2).detach()

    @property
    def output_noise(self) -> Tensor:
        """psi_y plus the sum of psi_z () [unit of y, squared]; the data identifies only the sum."""
        s = self.posterior
        total = s.output_noise if s.hidden_noise is None else s.output_noise + s.hidden_noise.sum()
        return (total * self.y_scale**2).detach()

    def forward(self, X: Tensor, *, noisy: bool = False) -> Tensor:
        """Return the prediction (N,) for X (N, d), differentiable; ``noisy``: X has the noise of the data."""
        return X @ (self._noisy() if noisy else self._ratio()).to(X)

    def _ratio(self) -> Tensor:
        s = self.posterior
        alive = s.x_mean.square() > _CLEAR_OF_ZERO**2 * s.x_var
        b = torch.where(alive, s.z_mean / torch.where(alive, s.x_mean, 1.0), 0.0)
        return b * self.y_scale / self.x_scale

    def _noisy(self) -> Tensor:
        return collapse(self._data, self.posterior).c * self.y_scale / self.x_scale

    @property
    def _data(self) -> Evidence:
        if self._evidence is None:
            raise InputError(NOT_FITTED)
        return self._evidence


def _scale(mean_square: Tensor) -> Tensor:
    """Return the root mean square; 1 for a column of zeros."""
    return torch.where(mean_square > 0.0, mean_square.sqrt(), 1.0)
