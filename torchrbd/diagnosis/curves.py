"""The function that shows a fitted term best, with its standard deviation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis.results import Curve
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.robot import RobotModel

# Between two points that are kept of a curve: along it, in parts of its width and height.
_STEP = 0.008
# A function acts where it is above this part of its largest departure from its middle.
_ACTS = 0.5


def driven_by(term: Candidate, robot: RobotModel) -> tuple[str, ...]:
    """Return the signals of another joint that a term at one joint depends on, e.g. "q_joint2"."""
    if term.site.other is None or term.effect.whole_robot:
        return ()
    return (f"{term.effect.other_signal}_{robot.joint_names[term.site.other]}",)


def fitted_curve(model: FittedModel, term: Candidate) -> Curve | None:
    """Return a term as a function of one signal, y = J w with the standard deviation sqrt(diag(J cov(w) J')).

    The coefficients enter linearly; the shape is taken as known. None if the torque is not a function of one signal of
    one joint.
    """
    site, columns = term.site, model.columns
    if site.joint is None:
        return None
    driver = site.joint if site.other is None else site.other
    scale = columns.scale(replace(site, joint=driver))
    w, covariance = model.coefficients(term)
    curve = term.effect.curve(w, term.shape, scale)
    if curve is None or (site.window is not None and curve.signal != "t"):
        return None
    units = (term.effect.curve(e, term.shape, scale) for e in torch.eye(len(w), dtype=w.dtype))
    J = torch.stack([unit.y for unit in units if unit is not None], dim=1)
    std = (J @ covariance * J).sum(1).clamp_min(0.0).sqrt()
    x, y = curve.x.numpy(), curve.y.detach().numpy()
    kept = _evenly(x, y)
    names = columns.robot.joint_names
    key, _, other = curve.signal.partition("_")
    signal = {"t": "t", "load": f"tau_{names[site.joint]}"}.get(key, f"{key}_{names[driver if other else site.joint]}")
    return Curve(signal, *(tuple(float(f"{v:.6g}") for v in values[kept]) for values in (x, y, std.numpy())))


def _evenly(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return indices of points that lie evenly along a curve, so that steps and narrow peaks keep theirs."""
    length = np.zeros(len(x))
    for v in (x, y):
        length[1:] += np.abs(np.diff(v)) / (np.ptp(v) or 1.0)
    length = np.cumsum(length)
    along = np.arange(0.0, length[-1], _STEP)
    return np.unique(np.append(np.searchsorted(length, along), len(x) - 1))


def loudest_part(at: np.ndarray, torque: np.ndarray) -> tuple[float, float]:
    """Return the interval around the largest departure from the median in which a curve stays above half of that."""
    size = np.abs(torque - np.median(torque))
    low = high = int(size.argmax())
    while low > 0 and size[low - 1] > _ACTS * size.max():
        low -= 1
    while high < len(size) - 1 and size[high + 1] > _ACTS * size.max():
        high += 1
    return float(at[low]), float(at[high])
