"""Hyperparameters of a likelihood."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from torch import Tensor

from torchrbd.likelihood.noise import Noise


@dataclass(frozen=True)
class Hyper:
    """What is learnt in addition to the linear coefficients.

    Attributes:
        kappa: inverse square of the error of the URDF's inertial parameters.
        encoder_share: (n,) share of each joint's noise that comes from encoders, on average over the rows.
        rest_width: (n,) speeds over which friction changes its sign [rad/s, m/s].
        drift: (n,) standard deviation of the slowest cosine [N m or N].
        hold: (n,) root mean square of the friction that holds a joint at rest [N m or N].
        noise: of each joint.
        dispersion: (n,) scatter of blocks divided by that of white rows.
        bodies: (P,) coordinates of the inertial parameters around which their prior is expanded, for a kappa of one.
        resists: (3, K) sites that keep ``Machine.positive`` non-negative, see ``nonnegative``.
        pi: (n_params,) inertial parameters for the load.
        friction: (n, 3) in addition to the load, see ``Signals``.
        white: whether rows count as independent, as in least squares.
    """

    kappa: float
    encoder_share: np.ndarray
    rest_width: np.ndarray
    drift: np.ndarray
    hold: np.ndarray
    noise: tuple[Noise, ...]
    dispersion: np.ndarray
    bodies: np.ndarray
    resists: np.ndarray
    pi: Tensor
    friction: Tensor
    white: bool = False

    @property
    def held(self) -> np.ndarray:
        """Prior size of the friction that holds a joint at rest (n,): at least that in motion [N m or N]."""
        return np.maximum(self.hold, self.friction[:, 1].numpy())

    def with_(self, **changes: object) -> Hyper:
        """Return a copy with some values changed."""
        return replace(self, **changes)  # type: ignore[arg-type]
