"""Try what else a table may mean, and report what explains the recordings far better.

A writing h of the table is likelier than another, 0, by

    log odds = sum_j N/2 log(e_j0 / e_jh) + 3 sum_j log(l_j0 / l_jh)

- e: squared error of the re-fitted baseline model on time that is left out of the fit, or that of a constant where it
  is less. A writing therefore has to beat a constant too, and its rivals (``rivals.py``).
- N: number of blocks, but no more than 8: what a model lacks it lacks in all of them.
- l: max(1, how many times a joint goes beyond the URDF's limits of position and of speed), or the clock beyond those of
  robots, 5 Hz to 20 kHz. Limits are often wrong by a factor, rarely by ten: the probability to be x times beyond falls
  as x^-3.

Torques in another unit show in the bodies, whose divergence D from the URDF (``urdf_prior``) they all raise,

    log odds = kappa D_0 - 10 kappa D_h - 5 per gain + sum_j N/2 log(e_j0 / e_jh)

both fitted at ten times the weight of the URDF: the divergence must fall to a tenth. A gain costs its choice among many
decades. That a joint's torque has the shape of the URDF's at all must have the same odds.

A table is suspected at odds above 1000, whatever the hypothesis: that is how rare wrong tables are among those that
look otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchrbd.inference.data.gains import LIMIT_POWER
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.suspicions.clipping import clipped_torques
from torchrbd.inference.suspicions.correcting import suspicion, too_fast
from torchrbd.inference.suspicions.explained import Explained
from torchrbd.inference.suspicions.hypotheses import TESTED, Hypothesis, gains, hypotheses
from torchrbd.inference.suspicions.results import NO_SUSPICIONS, Suspicion, Suspicions
from torchrbd.inference.suspicions.rivals import rivals
from torchrbd.inference.suspicions.samples import Samples
from torchrbd.inference.suspicions.set_points import set_point_suspicions
from torchrbd.inference.suspicions.variant import another_variant
from torchrbd.inference.suspicions.writing import Writing
from torchrbd.recordings import Survey
from torchrbd.robot import RobotModel

BOUND = math.log(1000.0)
"""Log odds from which on something is suspected."""
_TIGHT, _GAIN_COST = 10.0, 5.0
# A speed beyond the limit that no reading mends; peaks over the RMS that motions have.
_FAR, _PEAK = 30.0, 5.0
# Clocks of robots.
_LEAST_RATE_HZ, _MOST_RATE_HZ = 5.0, 2e4
# Joints at which single columns are doubted; hypotheses that are re-fitted; suspicions that are reported.
_MOST_JOINTS, _MOST_FITTED, _MOST_FOUND = 6, 8, 4


@dataclass(frozen=True)
class _Tried:
    """A hypothesis and what the recordings say of it."""

    hypothesis: Hypothesis
    explained: Explained
    log_odds: float
    ratio: Tensor


def suspicions(prepared: Prepared) -> Suspicions:
    """Return what is suspected of the recordings; nothing where a simulation replaces the URDF."""
    if prepared.reading.simulated:
        return NO_SUSPICIONS
    samples = Samples(prepared)
    # Torques of drives that follow other set-points say nothing else.
    if followed := set_point_suspicions(prepared, samples.nats, BOUND):
        return Suspicions(tuple(followed), TESTED)
    if not bool(samples.judged.any()):
        return NO_SUSPICIONS
    robot, surveys = prepared.robot, prepared.reading.surveys
    now = Writing.as_it_stands(robot.n_dof, robot.gravity.tolist())
    base = samples.explained(now)
    found: list[Suspicion] = []
    while len(found) < _MOST_FOUND:
        likely = [one for one in _tried(samples, prepared, now, base) if _is_likely(one, samples, now)]
        best, alike = (likely or [None])[0], [one for one in likely[1:] if one.log_odds > likely[0].log_odds - BOUND]
        if best is None or (best.hypothesis.is_swap and any(_swaps_others(one, best) for one in alike)):
            break
        found.append(suspicion(best.hypothesis, [o.hypothesis for o in alike], best.log_odds, best.ratio, prepared))
        now, base = best.hypothesis.writing, best.explained
    if not found:
        found += clipped_torques(prepared, samples, now, BOUND)
        found += filter(None, [another_variant(samples, now, BOUND)])
    gained = _other_unit(samples, now)
    if gained is not None:
        found.append(suspicion(gained.hypothesis, (), gained.log_odds, None, prepared))
    times = _speed(surveys, now) / robot.velocity.numpy()
    far = {name: float(x) for name, x in zip(robot.joint_names, times, strict=True) if np.isfinite(x) and x > _FAR}
    if far:
        found.append(too_fast(far))
    return Suspicions(tuple(found), TESTED)


def _is_likely(one: _Tried, samples: Samples, now: Writing) -> bool:
    """Say whether a hypothesis is far likelier than the table as it stands, and than its rivals."""
    if one.log_odds <= BOUND:
        return False
    against = (samples.odds(rival, held) for rival, held in rivals(one.hypothesis, one.explained, samples, now))
    return all(odds > BOUND for odds in against)


def _swaps_others(one: _Tried, best: _Tried) -> bool:
    return one.hypothesis.is_swap and one.hypothesis.joints != best.hypothesis.joints


def _other_unit(samples: Samples, now: Writing) -> _Tried | None:
    """Return torques in another unit, if that explains why the bodies are far from the URDF's."""
    shape, signs = samples.shape(now), [math.copysign(1.0, x) for x in now.tau_scale]
    alike = samples.judged & (samples.nats * shape.likeness(now).log() > BOUND)
    gain_of_joint = [
        sign * float(shape.gain[j, i]) if bool(alike[j]) else 0.0
        for j, (i, sign) in enumerate(zip(now.tau_order, signs, strict=True))
    ]
    base = samples.explained(now, tightness=_TIGHT)
    best = None
    for h in gains(now, gain_of_joint):
        one = samples.explained(h.writing, tightness=_TIGHT)
        cost = _GAIN_COST * (1 if h.unit == "all" else len(h.joints))
        bodies = samples.kappa * (base.divergence - _TIGHT * one.divergence)
        odds = bodies - cost + samples.odds(base, one)
        if odds > max(BOUND, best.log_odds if best else 0.0):
            best = _Tried(h, one, odds, base.known / one.known)
    return best


def _tried(samples: Samples, prepared: Prepared, now: Writing, base: Explained) -> list[_Tried]:
    """Return the hypotheses that explain the shape of the torques better than now, re-fitted, the likeliest first."""
    robot = samples.robot
    surveys, converted = prepared.reading.surveys, _converted(prepared)
    shape, beyond = samples.shape(now), _beyond(robot, surveys, now)
    own = shape.error(now)
    worst = [j for j in torch.argsort(own, descending=True).tolist() if samples.judged[j]][:_MOST_JOINTS]
    shapes = {now.motion: shape}
    promising: list[tuple[float, Hypothesis]] = []
    for h in hypotheses(robot, now, sorted(worst), converted):
        if h.writing.motion not in shapes:
            shapes[h.writing.motion] = samples.shape(h.writing)
        ratio = own / shapes[h.writing.motion].error(h.writing)
        limits = LIMIT_POWER * (beyond - _beyond(robot, surveys, h.writing))
        odds = samples.nats * float(ratio[samples.judged].log().sum()) + limits
        if odds > 0:
            promising.append((odds, h))
    found = []
    for _, h in sorted(promising, key=lambda pair: -pair[0])[:_MOST_FITTED]:
        explained = samples.explained(h.writing)
        limits = LIMIT_POWER * (beyond - _beyond(robot, surveys, h.writing))
        odds = samples.odds(base, explained) + limits
        found.append(_Tried(h, explained, odds, base.known / explained.known))
    return sorted(found, key=lambda one: -one.log_odds)


def _converted(prepared: Prepared) -> set[str]:
    """Return the signals whose unit a mapping converts, of "t" and "q"."""
    sources = [(s, r.source(s, j)) for r in prepared.recordings for j in r.joints for s in ("t", "q")]
    return {signal for signal, source in sources if source is not None and abs(source.scale) != 1.0}


def _beyond(robot: RobotModel, surveys: Sequence[Survey], writing: Writing) -> float:
    """Return the sum of log l: how far the recordings go beyond the URDF's limits of position and speed."""
    low, high = np.min([s.q_min for s in surveys], axis=0), np.max([s.q_max for s in surveys], axis=0)
    order, scale = list(writing.q_order), np.abs(writing.q_scale)
    span, speed = scale * (high - low)[order], _speed(surveys, writing)
    limits = (robot.upper - robot.lower).numpy(), robot.velocity.numpy()
    rates = [s.rate_hz / writing.time for s in surveys]
    found = sum(
        max(0.0, math.log(_LEAST_RATE_HZ / rate), math.log(rate / _MOST_RATE_HZ)) for rate in [float(np.median(rates))]
    )
    for reached, limit in zip((span, speed), limits, strict=True):
        stated = np.isfinite(limit) & (limit > 0)
        found += float(np.log(np.maximum(1.0, reached[stated] / limit[stated])).sum())
    return found


def _speed(surveys: Sequence[Survey], writing: Writing) -> np.ndarray:
    """Return the speeds that joints reach (n_dof,) [rad/s, m/s]; by their RMS where single samples are bad."""
    fast = [np.minimum(s.velocity_max, _PEAK * s.velocity_rms) for s in surveys]
    reached = np.max(fast, axis=0)[list(writing.q_order)]
    return np.abs(writing.q_scale) * reached / writing.time
