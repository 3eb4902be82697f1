"""The URDF of another variant of the robot: links of other lengths, which no inertial parameters can absorb.

The distance of each joint from its parent link is scaled. Bodies are re-fitted (``geometry.py``), with friction, a
spring and a rotor at every joint, which absorb lengths in part. As many lengths as possible go back to the URDF's
without a loss of odds above the bound. The others are judged on time left out of the fit, like every writing. They also
have to beat joints that are turned, as by wrong zeros or a tilted base.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchrbd.effects import effect
from torchrbd.inference.suspicions.explained import Explained
from torchrbd.inference.suspicions.geometry import Moved, move_joints
from torchrbd.inference.suspicions.results import Meaning, Suspicion
from torchrbd.inference.suspicions.samples import ROTORS, SPRINGS, Samples
from torchrbd.inference.suspicions.writing import Writing
from torchrbd.robot import RobotModel, joint_origins

# Lengths of variants are some tenths of each other's apart; none is a third or three times.
_WIDTH, _WITHIN = 0.3, (-2.0 / 3.0, 2.0)
_ABSORBING = (SPRINGS, ROTORS)
# Joints are turned by hundredths of a rad; zeros may be off by more.
_TURN_WIDTH, _TURNS_WITHIN = 0.05, (-0.5, 0.5)


def another_variant(samples: Samples, now: Writing, bound: float) -> Suspicion | None:
    """Return the suspicion that links have other lengths than the URDF's.

    Args:
        samples: of the table.
        now: how it is read, as it stands.
        bound: log odds from which on something is suspected.
    """
    joints = _lengths(samples.robot)
    while joints:
        moves = torch.zeros(len(joints), samples.robot.n_dof, 6, dtype=torch.float64)
        moves[range(len(joints)), joints, :3] = joint_origins(samples.robot)[joints]
        found = move_joints(samples, now, moves, _WIDTH, _WITHIN, _ABSORBING)
        kept = [joint for joint, stays in zip(joints, _needed(samples, found, bound), strict=True) if stays]
        if kept == joints:
            return _judged(samples, now, found, joints, bound)
        joints = kept
    return None


def _lengths(robot: RobotModel) -> list[int]:
    """Return the joints whose distance from their parent link some torque can feel."""
    return [
        site.joint
        for site in effect("geometry_error").sites(robot)
        if site.joint is not None and bool(joint_origins(robot)[site.joint].any())
    ]


def _needed(samples: Samples, found: Moved, bound: float) -> list[bool]:
    """Say which lengths stay when as many as can without a loss of odds above the bound are the URDF's: (K,).

    That which is needed least goes first. Sizes that stay follow: with those of Z at zero, s changes by
    -C_Z C_ZZ^-1 s_Z, C the covariance.
    """
    covariance, dropped = torch.linalg.inv(found.precision), list[int]()
    while len(dropped) < len(found.size):
        lost = {k: _lost(samples, found, covariance, [*dropped, k]) for k in range(len(found.size)) if k not in dropped}
        least = min(lost, key=lambda k: lost[k])
        if lost[least] > bound:
            break
        dropped.append(least)
    return [k not in dropped for k in range(len(found.size))]


def _lost(samples: Samples, found: Moved, covariance: Tensor, zero: list[int]) -> float:
    """Return sum_j N/2 log(e_j / e_j0), by which the torques are less likely with some sizes at zero."""
    change = covariance[:, zero] @ torch.linalg.solve(covariance[zero][:, zero], found.size[zero])
    left, lost = found.squares(torch.zeros_like(change)), found.squares(change)
    weight, tau = found.weight, samples.tau
    mean = (weight * tau).sum(1) / weight.sum(1).clamp_min(1e-300)
    most = (weight * (tau - mean.unsqueeze(1)).square()).sum(1)
    used = samples.judged & (left > 0)
    return samples.nats * float((torch.minimum(lost, most) / torch.minimum(left, most))[used].log().sum())


def _judged(samples: Samples, now: Writing, found: Moved, joints: list[int], bound: float) -> Suspicion | None:
    """Return the suspicion if the lengths explain time left out of the fit far better than all else does."""
    base, tried = (
        samples.explained(now, further_effects=_ABSORBING, robot=robot, noise=noise)
        for robot, noise in zip((None, found.robot), found.noise, strict=True)
    )
    odds = samples.odds(base, tried)
    if odds <= bound:
        return None
    turned = move_joints(samples, now, _turns(samples.robot.n_dof), _TURN_WIDTH, _TURNS_WITHIN, _ABSORBING)
    rival = samples.explained(now, further_effects=_ABSORBING, robot=turned.robot, noise=turned.noise[1])
    if samples.odds(rival, tried) <= bound:
        return None
    return _suspicion(samples, base, found, tried, joints, odds)


def _turns(n_dof: int) -> Tensor:
    """Return a turn of every joint about each of three axes, (3 n_dof, n_dof, 6)."""
    moves = torch.zeros(n_dof, 3, n_dof, 6, dtype=torch.float64)
    for joint in range(n_dof):
        moves[joint, :, joint, 3:] = torch.eye(3)
    return moves.flatten(0, 1)


def _suspicion(
    samples: Samples, base: Explained, found: Moved, tried: Explained, joints: list[int], odds: float
) -> Suspicion:
    robot = samples.robot
    times = float((base.known / tried.known)[samples.judged].log().mean().exp())
    parents = {joint.name: joint.parent for joint in robot.description.joints}
    names = tuple(robot.joint_names[j] for j in joints)
    given = dict(zip(names, joint_origins(robot)[joints].norm(dim=1).tolist(), strict=True))
    sizes = {name: (1.0 + s) * given[name] for name, s in zip(names, found.size.tolist(), strict=True)}
    return Suspicion(
        "variant",
        names,
        odds,
        times,
        Meaning("variant", names),
        sizes=sizes | {f"{name}, URDF": length for name, length in given.items()},
        names={name: parents[name] for name in names},
        settles=False,
    )
