"""Estimates of inertial parameters, one by one and in identifiable combinations."""

from __future__ import annotations

import numpy as np
import torch

from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.posterior.identifiability import identifiability
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.results import BaseParameterEstimate, ParameterEstimate
from torchrbd.likelihood.urdf_prior import local_covariance
from torchrbd.parameters import PARAMETERS_PER_BODY, UNITS, BaseParameters


def base_estimates(prepared: Prepared, model: FittedModel, base: BaseParameters) -> tuple[BaseParameterEstimate, ...]:
    """Return beta = K pi with the covariance K cov(pi) K'."""
    K, n = base.combination, prepared.robot.n_params
    variance, laplace = ((K @ model.inertial_covariance(c) @ K.T).diagonal() for c in (model.covariance, model.laplace))
    fitted = K[:, prepared.prior.inertial]
    believed = (fitted @ local_covariance(prepared.prior, model.x) @ fitted.T).diagonal()
    share = torch.where(believed > 0, (laplace / believed.clamp_min(1e-300)).clamp(0.0, 1.0), torch.ones_like(believed))
    urdf, value = K @ prepared.prior.reference[:n], K @ model.pi
    rows = zip(base.independent, base.expressions, urdf, value, variance.sqrt(), share, strict=True)
    return tuple(
        BaseParameterEstimate(expression, UNITS[k % PARAMETERS_PER_BODY], *map(float, numbers))
        for k, expression, *numbers in rows
    )


def inertial_estimates(prepared: Prepared, model: FittedModel) -> list[ParameterEstimate]:
    """Return every inertial parameter with its uncertainty and its status."""
    std = model.inertial_covariance(model.covariance).diagonal().sqrt()
    known = identifiability(prepared.prior, model, prepared.filtering.effective_rate)
    return [
        ParameterEstimate(
            name=one.name,
            owner=one.owner,
            unit=UNITS[k % PARAMETERS_PER_BODY],
            urdf=float(prepared.prior.reference[k]),
            value=float(model.x[k]),
            std=float(std[k]),
            prior_share=one.prior_share,
            status=one.status,
            suggested=one.suggested,
        )
        for k, one in enumerate(known)
    ]


def values_alone(prepared: Prepared, model: FittedModel, base: BaseParameters) -> list[ParameterEstimate]:
    """Return the parameters of an estimator without uncertainties."""
    robot, fitted = prepared.robot, set(prepared.prior.inertial.tolist())
    found = []
    for k, name in enumerate(robot.parameter_names):
        status = "held" if k not in fitted else "not identifiable" if k in base.invisible else "not judged"
        std, share = (0.0, 1.0) if status == "held" else (np.nan, np.nan)
        owner, unit = robot.body_names[k // PARAMETERS_PER_BODY], UNITS[k % PARAMETERS_PER_BODY]
        urdf, value = float(prepared.prior.reference[k]), float(model.x[k])
        found.append(ParameterEstimate(name, owner, unit, urdf, value, std, share, status))
    return found
