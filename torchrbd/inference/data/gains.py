"""Unknown gains: the stiffness of position drives and the torque constants of motors.

A joint has recorded x, a position error or a current, and its torque is k x. What sets the scale is the torque u of the
URDF's bodies and of known loads. Friction, an offset and the inertia of the rotor, columns F, are unknown:

    x = g u + F f + noise,   g = 1 / k,   g_hat = u~'x / u~'u~,   u~ = u - F (F'F)^-1 F'u

The scatter of blocks of time gives the standard error s of g_hat, neighbours being correlated. The bodies are uncertain
too, pi ~ N(pi_0, S S') as in the URDF's prior, which changes g_hat by g e, e = |S'Y'u~| / u~'u~. On a grid of log k,

    p(log k | x) ~ N(g_hat; 1 / k, s^2 + (e / k)^2) N(log k; log c, (log 10)^2)

with a centre c that matters only where the data show nothing. Viscous friction is not negative, and the damping kd of a
drive, where it is given, is a part of the coefficient f_v of the velocity: P(f_v > kd / k) is a factor, too. So is what
the URDF says of the effort: limits are often wrong by a factor, rarely by ten, so that the probability of a torque k x
of e times the limit, root mean square, falls as e^-3.

Source: Frisch and Waugh, "Partial time regressions as compared with individual trends", Econometrica 1933 (u~); Newey
    and West, "A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance matrix",
    Econometrica 1987 (s).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy

import torch
from torch import Tensor

from torchrbd.dataset.columns import Columns
from torchrbd.dataset.reading import Progress, Reading
from torchrbd.dataset.scales import covered_scales
from torchrbd.effects import Site, effect
from torchrbd.effects.registry import OF_DRIVES, PLAIN
from torchrbd.inference.data.holdout import held_out_blocks
from torchrbd.inference.data.payload import payload_parameters
from torchrbd.inference.settings import Settings
from torchrbd.likelihood.urdf_prior import data_prior
from torchrbd.recordings import Filtering, Gain, Recording, choose_cutoff, survey
from torchrbd.robot import RobotModel

# Centres of the priors, whose standard deviation is a factor of ten.
_CENTRES, _DECADE = {"kp": 30.0, "torque_constant": 0.1}, math.log(10.0)
# Range of gains in standard deviations of the prior, number of points, and what is improbable [nats].
_REACH, _POINTS, _IMPROBABLE = 5.0, 4001, 20.0
# Part of the squared torque of the bodies that friction does not explain, below which the data show nothing.
_LEAST = 1e-9
LIMIT_POWER = 3.0
"""Power by which values beyond a limit of the URDF are less probable."""

Density = Callable[[Tensor], Tensor]
"""Log of a probability density, of slopes 1 / k."""


def with_estimated_gains(
    robot: RobotModel, recordings: Sequence[Recording], fitted: int, settings: Settings, progress: Progress
) -> tuple[tuple[Recording, ...], tuple[Gain, ...]]:
    """Return recordings whose torques have known factors, and those that were estimated.

    Args:
        robot: the robot.
        recordings: those to fit, then those held out.
        fitted: how many are to be fitted.
        settings: the user's choices.
        progress: called with the stage and the part of it that is done.

    Raises:
        RecordingError: too little is left to fit.
    """
    unknown = {recording.name: recording.unknown_gains for recording in recordings}
    if not any(unknown.values()):
        return tuple(recordings), ()
    progress("estimating gains", 0.0)
    own = tuple(recording.in_own_units for recording in recordings)
    surveys = tuple(map(survey, own))
    filtering = Filtering(choose_cutoff(surveys) if settings.cutoff_hz is None else settings.cutoff_hz)
    bare = _without_known_parts(robot)
    reading = Reading(bare, own, surveys, filtering, settings.used_joints(robot), {})
    columns = Columns(bare, list(map(effect, (*PLAIN, OF_DRIVES))), covered_scales(surveys, filtering))
    statistics = reading.statistics(columns, progress)
    held_out, _ = held_out_blocks(statistics.blocks, own[fitted:], reading, settings)
    training, n = statistics.select(~held_out), robot.n_params
    prior = data_prior(training, settings.held_bodies(robot), settings.kappa)
    loads = payload_parameters(robot, [r.name for r in own], settings.payload)
    bodies = torch.stack([robot.pi + loads.get(block.recording, 0.0) for block in training.blocks])
    found = list[Gain]()
    for j, joint in enumerate(robot.joint_names):
        here = torch.tensor([joint in unknown[block.recording] for block in training.blocks])
        if here.any():
            own_bodies = columns.inertial[j]
            (viscous,) = columns.of(columns.candidate(effect(PLAIN[0]), Site(j), {}))
            place = columns.of_joint[j].tolist().index(viscous) - len(own_bodies)
            drives = [r.drives.of[joint] for r in recordings if joint in r.drives.unknown]
            density = _log_probability(
                training.moments[j][here],
                bodies[here][:, own_bodies],
                prior.scale[own_bodies][:, :n],
                (place, drives[0].kd if drives else 0.0),
                float(robot.effort[j]) or math.inf,
                float(training.torque[here, j, 0].sum()),
            )
            kind = "kp" if drives else "torque_constant"
            found.append(Gain(joint, kind, *_quantiles(density, _CENTRES[kind])))
    known = {gain.joint: gain.value for gain in found}
    return tuple(recording.with_gains(known) for recording in recordings), tuple(found)


def _without_known_parts(robot: RobotModel) -> RobotModel:
    """Return a robot without the rotors and springs of its description: their torque has another unit than x."""
    other = copy(robot)
    other.armature, other.stiffness = torch.zeros_like(robot.armature), torch.zeros_like(robot.stiffness)
    return other


def _combine(moments: Tensor, bodies: Tensor) -> tuple[Tensor, Tensor]:
    """Return moments (B, q, q) of columns u, F, x, and which of the joint's columns (p + 1, q) these are in each block.

    Args:
        moments: (B, p + 1, p + 1) of the columns of bodies, then F, and of x.
        bodies: (B, b) inertial parameters in each block, known loads included.
    """
    blocks, size, b = len(moments), moments.shape[1], bodies.shape[1]
    take = torch.zeros(blocks, size, size - b + 1, dtype=moments.dtype)
    take[:, :b, 0] = bodies
    take[:, torch.arange(b, size), torch.arange(1, size - b + 1)] = 1.0
    return take.mT @ moments @ take, take


def _partial(moments: Tensor, k: int) -> tuple[float, float, Tensor]:
    """Return the coefficient of column k of x, its standard error, and the weights (q,) that give it.

    Args:
        moments: (B, q, q) of columns, the last one x.
        k: the column.
    """
    blocks, whole = len(moments), moments.sum(0)
    others = torch.tensor([i for i in range(len(whole) - 1) if i != k and float(whole[i, i]) > 0.0], dtype=torch.long)
    size = whole.diagonal().clamp_min(torch.finfo(whole.dtype).tiny).rsqrt()
    scaled = size.unsqueeze(1) * whole * size
    inverse = torch.linalg.pinv(scaled[others][:, others], hermitian=True, rtol=_LEAST)
    own, rest = torch.zeros_like(size), torch.zeros_like(size)
    own[k], rest[-1] = 1.0, 1.0
    own[others] = -size[others] / size[k] * (inverse @ scaled[others, k])
    square = float(own @ whole @ own)
    if square <= _LEAST * float(whole[k, k]):
        return 0.0, math.inf, own
    found = float(own @ whole[:, -1]) / square
    rest[k] = -found
    rest[others] -= size[others] * (inverse @ (size[others] * (whole[others] @ rest)))
    score = torch.einsum("a,bac,c->b", own, moments, rest)
    spread = score.square().sum() + 2.0 * (score[1:] * score[:-1]).sum().clamp_min(0.0)
    return found, math.sqrt(float(spread) * blocks / max(blocks - 1, 1)) / square, own / square


def _log_probability(
    moments: Tensor, bodies: Tensor, scale: Tensor, damping: tuple[int, float], effort: float, count: float
) -> Density:
    """Return log p(k | x) without its prior, as a function of slopes 1 / k.

    Args:
        moments, bodies: see ``_combine``.
        scale: (b, r) root of the prior covariance of the bodies.
        damping: among F, the column of viscous friction; and kd of the drive, which is a part of it.
        effort: the URDF's limit [N m, N].
        count: weight of all samples.
    """
    least = math.sqrt(float(moments[:, -1, -1].sum()) / max(count, 1.0)) / effort
    G, take = _combine(moments, bodies)
    g, error, weights = _partial(G, 0)
    viscous, viscous_error, _ = _partial(G, 1 + damping[0])
    moved = float((scale.mT @ (moments @ take @ weights).sum(0)[: len(scale)]).norm())

    def density(slope: Tensor) -> Tensor:
        found = -LIMIT_POWER * (least / slope).clamp_min(1.0).log()
        if math.isfinite(error):
            variance = error**2 + (slope * moved).square()
            found = found - 0.5 * (g - slope).square() / variance - 0.5 * variance.log()
        if damping[1] and math.isfinite(viscous_error):
            found = found + torch.special.log_ndtr((viscous - damping[1] * slope) / max(viscous_error, _LEAST))
        return found

    return density


def _quantiles(density: Density, centre: float) -> tuple[float, float, float]:
    """Return median and 95 % interval of k, see the module."""
    middle = math.log(centre)
    first, last = middle - _REACH * _DECADE, middle + _REACH * _DECADE
    # The second grid covers what the first one shows to be probable.
    for _ in range(2):
        log_k = torch.linspace(first, last, _POINTS, dtype=torch.float64)
        log_p = density((-log_k).exp()) - 0.5 * ((log_k - middle) / _DECADE).square()
        likely = torch.nonzero(log_p > log_p.max() - _IMPROBABLE).flatten()
        first, last = (float(log_k[int(k.clamp(0, _POINTS - 1))]) for k in (likely[0] - 1, likely[-1] + 1))
    below = (log_p - log_p.max()).exp().cumsum(0)
    low, value, high = (float(log_k[(below < part * below[-1]).sum()].exp()) for part in (0.025, 0.5, 0.975))
    return value, low, high
