"""What a search has looked for and not found: how large it would be, and how large it could have been unseen.

Beside the final fit, a candidate with fresh columns C in prior coordinates has the coefficients of ``Fit.addition``,

    w = S^-1 C'e,   cov w = W,   cov x = H^-1 + B W B',   cov(x, w) = -B W,   B = H^-1 X'C

W is S^-1, or wider where coefficients scatter more from block to block, and x those that the fit has already (a
Stribeck friction's part in motion is Coulomb friction). The std of a physical parameter follows by the delta method.
"Not found" is no proof of absence; a value of 0.02 with a std of 0.05 is one.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from torchrbd.diagnosis.curves import driven_by
from torchrbd.diagnosis.explain import places
from torchrbd.diagnosis.results import Limit
from torchrbd.diagnosis.rows.regression import Fit
from torchrbd.diagnosis.search.options import BACKGROUND
from torchrbd.diagnosis.search.select import Search
from torchrbd.diagnosis.search.steps import LEAST_SHARE
from torchrbd.likelihood.columns import Candidate

# A parameter is told by the data, and not by the prior, if the data leave less than this part of the prior's variance.
MOST_OF_PRIOR = 0.25
DIGITS = 4


def limits(search: Search, fit: Fit) -> tuple[Limit, ...]:
    """Return what the data say of each effect at each place that is not in a fit, in its best shape.

    Effects that act for a time only are left out, and what the model or the prior imitates.
    """
    found = {(c.effect.id, c.site) for c in fit.terms}
    absent = [s.candidate for s in search.grid.screened(fit)]
    absent = [c for c in absent if (c.effect.id, c.site) not in found and c.site.always]
    told = (_limit(fit, c) for c in absent)
    return tuple(sorted(filter(None, told), key=lambda one: (one.joints, one.links, one.effect)))


def _limit(fit: Fit, candidate: Candidate) -> Limit | None:
    """Return the first parameter that fresh columns tell, None if there is none."""
    robot = fit.rows.samples.columns.robot
    z, covariance, width, fresh = _coefficients(fit, candidate)
    if not fresh.any():
        return None
    w, covariance, shape = torch.from_numpy(z * width), covariance * np.outer(width, width), candidate.shape
    without = candidate.effect.parameters(w * torch.from_numpy(~fresh), shape)
    for name, value in candidate.effect.parameters(w.requires_grad_(True), shape).items():
        slope = _slope(value, w)
        if not slope[fresh].any():
            continue
        none, variance = float(without[name]) + _urdf(fit, candidate), float(slope @ covariance @ slope)
        # Without data a coefficient has the prior's variance, one in its own coordinates. What has no finite value
        # where nothing is missing (a stiffness) has no limit either.
        prior = float(((slope * width)[fresh] ** 2).sum())
        if not (math.isfinite(none) and 0.0 < variance < MOST_OF_PRIOR * prior):
            return None
        joints, links = places(robot, candidate.site)
        prismatic = candidate.site.joint is not None and bool(robot.prismatic[candidate.site.joint])
        return Limit(
            effect=candidate.effect.id,
            joints=joints,
            links=links,
            depends_on=driven_by(candidate, robot),
            parameter=name,
            value=_rounded(float(value.detach()) + _urdf(fit, candidate)),
            std=_rounded(variance**0.5),
            none=_rounded(none),
            unit=candidate.effect.unit(name, prismatic=prismatic),
            shape={key: _rounded(float(v)) for key, v in shape.items()},
        )
    return None


def _slope(value: torch.Tensor, w: torch.Tensor) -> np.ndarray:
    """Return dvalue/dw (K,)."""
    found = torch.autograd.grad(value, w, retain_graph=True, allow_unused=True)[0] if value.requires_grad else None
    return np.zeros(len(w)) if found is None else found.numpy()


def _coefficients(fit: Fit, candidate: Candidate) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a candidate's coefficients (K,) beside a fit, their covariance, prior widths, and which of them are fresh.

    None is fresh if the model imitates the candidate.
    """
    rows = fit.rows
    known = fit.numbers
    own = [known.get((candidate.place, label), -1) for label in candidate.labels]
    fresh = np.array([k < 0 for k in own])
    C = rows.columns(candidate)[1][:, fresh]
    none = np.zeros(len(own))
    if not C.any(0).all() or not np.isfinite(C).all() or fit.share_left(C) <= LEAST_SHARE:
        return none, np.diag(none), none, none > 0
    B = fit.posterior.solve(fit.X.T @ C)
    (_, w), inverse = fit.addition(C), np.linalg.inv(fit.precision(C))
    inverse = inverse * _wider(fit, C - fit.X @ B, w, inverse)
    # How (x, w) moves with w, at the candidate's coefficients.
    T = np.zeros((len(own), len(w)))
    T[fresh], T[~fresh] = np.eye(len(w)), -B[old := [k for k in own if k >= 0]]
    z, covariance = T @ w, T @ inverse @ T.T
    z[~fresh] += fit.x[old]
    covariance[np.ix_(~fresh, ~fresh)] += fit.posterior.covariance(old)
    return z, covariance, rows.widths_of(candidate), fresh


def _wider(fit: Fit, P: np.ndarray, w: np.ndarray, inverse: np.ndarray) -> float:
    """Return how much wider (1 or more) coefficients w (K,) of columns scatter from block to block than they should.

    P (N, K) are the columns less what the model imitates. Noise that forgets itself slowly, and physics left out, make
    the curvature's standard deviation too small.
    """
    scores = P * (fit.e - P @ w)[:, None]
    by_block = np.stack([np.bincount(fit.rows.block, column) for column in scores.T], axis=1)
    by_block -= by_block.mean(0)
    scatter = inverse @ (by_block.T @ by_block) @ inverse
    return max(1.0, float((scatter.diagonal() / inverse.diagonal()).max()))


def _urdf(fit: Fit, candidate: Candidate) -> float:
    """Return what the URDF has of plain friction, which findings count too."""
    return fit.rows.samples.columns.urdf_value(candidate) if candidate.effect.id in BACKGROUND else 0.0


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
