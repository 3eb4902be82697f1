"""How well ordinary models explain what the columns of a table would mean."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torchrbd.inference.suspicions.writing import Writing

NOTHING = 1e-9
"""A part of a torque's power that is none."""


@dataclass(frozen=True)
class Explained:
    """How well a re-fitted ordinary model explains a writing.

    Attributes:
        error: (n_dof,) squared error on time left out of the fit over that of a constant, the mean of what was fitted;
            NaN for a joint that is not judged.
        divergence: D of the bodies from the URDF's, see ``urdf_prior``, the mean over the fits.
    """

    error: Tensor
    divergence: float

    @property
    def known(self) -> Tensor:
        """The error of the better of the model and the constant, (n_dof,)."""
        return self.error.clamp(NOTHING, 1.0)


@dataclass(frozen=True)
class Shape:
    """What the URDF's torque of joint j explains of the torque in joint i's column, (n_dof, n_dof) each.

    Attributes:
        left: part of the torque's power that friction leaves.
        share: part that the URDF's torque explains of it, negative where it does with the opposite sign.
        gain: g, of either sign.
    """

    left: Tensor
    share: Tensor
    gain: Tensor

    def error(self, writing: Writing) -> Tensor:
        """Return the part of each torque that is left by a gain that is not negative, (n_dof,)."""
        j, i = range(len(self.left)), list(writing.tau_order)
        share = self.share[j, i] * self.share.new_tensor(writing.tau_scale).sign()
        return (self.left[j, i] - share.clamp_min(0.0)).clamp_min(NOTHING)

    def likeness(self, writing: Writing) -> Tensor:
        """Return by which factor the URDF's torque lowers the squared error that friction leaves, (n_dof,)."""
        return self.left[range(len(self.left)), list(writing.tau_order)].clamp_min(NOTHING) / self.error(writing)
