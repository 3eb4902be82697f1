"""What a likelihood learns beside its linear coefficients."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from torch import Tensor

from torchrbd.likelihood.noise import Noise


@dataclass(frozen=True)
class Hyper:
    """What is learnt beside the linear coefficients.

    Attributes:
        kappa: inverse square of how far the URDF's inertial parameters err.
        encoder_share: (n,) part of each joint's noise that encoders make, on average over the rows.
        rest_width: (n,) speeds over which friction changes its sign [rad/s, m/s].
        drift: (n,) standard deviation of the slowest cosine [N m or N].
        hold: (n,) root mean square of what friction holds at rest [N m or N].
        noise: of each joint.
        dispersion: (n,) scatter of blocks over that of white rows.
        bodies: (P,) coordinates of the inertial parameters around which their prior is expanded, for a kappa of one.
        resists: (3, n, 3) sites that keep ordinary friction from pushing, see ``nonnegative``.
        pi: (n_params,) inertial parameters that make the load.
        friction: (n, 3) beside it, see ``Signals``.
        white: whether rows are taken to be independent, as least squares does.
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
        """How large what friction holds at rest is believed to be (n,): as it is in motion, or larger [N m or N]."""
        return np.maximum(self.hold, self.friction[:, 1].numpy())

    def with_(self, **changes: object) -> Hyper:
        """Return the same with some values changed."""
        return replace(self, **changes)  # type: ignore[arg-type]
