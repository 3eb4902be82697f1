"""The posterior of an identification, for those who want more of it than means and intervals."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torchrbd._runtime.threads import single_threaded
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.posterior.predictive import PredictiveVariance, predictive_variance
from torchrbd.inference.posterior.sampling import sample_robots
from torchrbd.likelihood.urdf_prior import Prior


@dataclass(frozen=True)
class Posterior:
    """A fit and the prior it started from."""

    prior: Prior
    model: FittedModel

    @single_threaded()
    def robots(self, n_samples: int, seed: int = 0) -> Tensor:
        """Draw inertial parameters (n_samples, n_params) as probable as prior and data say; all of them are physical.

        Their mean is not the fit, which is the mode: see ``sampling.py``.
        """
        samples = sample_robots(self.prior, self.model, n_samples, seed=seed)
        return samples.x[:, : self.model.columns.robot.n_params]

    def torque_variance(self, q: Tensor, qd: Tensor, qdd: Tensor) -> PredictiveVariance:
        """Return the variance of predicted torques at states (*batch, n_dof)."""
        return predictive_variance(self.model, q, qd, qdd)
