"""What uncertain states take from the information that torques hold of x.

    S = H - L,   L = E'H_c^-1 E

with H = Y'WY as if the states were known, and L what their own freedom to move explains as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchrbd.likelihood.equations import Equations
from torchrbd.likelihood.urdf_prior import Prior


@dataclass(frozen=True)
class UncertainStates:
    """The last linearisation of the smoother.

    Attributes:
        gram: H (n, n) there.
        lost: L (n, n) there.
        used: (n_dof,) share of the torque samples that the states have used up.
        torque_variance: (n_dof,) noise there.
    """

    gram: Tensor
    lost: Tensor
    used: Tensor
    torque_variance: Tensor

    def discount(self, prior: Prior, known: Equations) -> Equations:
        """Return the normal equations of torques whose states are uncertain from those for known states.

        In prior coordinates, a fit to the states as they are has z^ = (H + 1)^-1 h; it stays where it is, but is known
        less well:  h' = h - L' z^. The share lost in each direction is kept where H has changed since the states were
        estimated:  L' = C' C^-1 L C^-T C'^T,  C C^T = H + 1.
        """
        S = prior.scale
        before, now = Equations(S.T @ self.gram @ S, known.h).posterior(), known.posterior()
        half = torch.from_numpy(now.root.matrix @ before.half(S.T.numpy()))
        lost = half @ self.lost @ half.T
        return Equations(known.H - lost, known.h - lost @ torch.from_numpy(now.z))
