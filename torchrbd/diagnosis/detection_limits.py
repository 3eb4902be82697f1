"""Detection limits: how large an effect that was not found could be, given the findings.

"Not found" alone proves nothing; a value of 0.02 with a std of 0.05 shows that the effect is small.
"""

from __future__ import annotations

import math

import torch

from torchrbd.diagnosis.curve_hypotheses import is_curve
from torchrbd.diagnosis.curves import driven_by
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.explain import places
from torchrbd.diagnosis.hypotheses import SHARED, Hypothesis, prior_std, whole
from torchrbd.diagnosis.outcome import SearchOutcome
from torchrbd.diagnosis.results import DetectionLimit

_DIGITS = 4


def detection_limits(found: SearchOutcome) -> tuple[DetectionLimit, ...]:
    """Return an estimate for each effect at each place that is not in the model, in its best shape.

    Effects that act for a time only are left out, and parameters that the data does not identify.
    """
    absent = [h for h in found.last if h.candidate.site.always and not is_curve(h.candidate)]
    each = (_limit(found, h) for h in absent)
    return tuple(sorted(filter(None, each), key=lambda one: (one.joints, one.links, one.effect)))


def _limit(found: SearchOutcome, h: Hypothesis) -> DetectionLimit | None:
    """Return the first parameter that moves with the coefficients; its std by the delta method."""
    c, robot = h.candidate, found.rows.columns.robot
    prior = torch.from_numpy(prior_std(found.fit, found.rows, c)[0])
    own = found.fit.friction
    w, std = torch.from_numpy(whole(c, h.coefficients, own)).requires_grad_(True), torch.from_numpy(h.std)
    fresh = torch.tensor([c.site.joint is None or label not in SHARED for label in c.labels])
    absent = c.effect.parameters(torch.from_numpy(whole(c, 0.0 * h.coefficients, own)), c.shape)
    for name, value in c.effect.parameters(w, c.shape).items():
        if not value.requires_grad:
            continue
        (slope,) = torch.autograd.grad(value, w, retain_graph=True)
        # A column that baseline friction has as well gives no limit of this effect.
        slope = slope * fresh
        variance, before = float((slope * std).square().sum()), float((slope * prior).square().sum())
        none = float(absent[name])
        if not bool(slope.any()):
            continue
        if not (math.isfinite(none) and 0.0 < variance < DECISIONS.identified_variance * before):
            return None
        joints, links = places(robot, c)
        prismatic = c.site.joint is not None and bool(robot.prismatic[c.site.joint])
        return DetectionLimit(
            effect=c.effect.id,
            joints=joints,
            links=links,
            depends_on=driven_by(c, robot),
            parameter=name,
            value=_rounded(float(value.detach())),
            std=_rounded(variance**0.5),
            none=_rounded(none),
            unit=c.effect.unit(name, prismatic=prismatic),
            shape={key: _rounded(float(v)) for key, v in c.shape.items()},
        )
    return None


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
