"""What one recording left open, does the motion that is designed for it settle?

    python benchmarks/next_recording.py [--only NAME...] [--periods 2] [--speed 1] [--seed 0]

An arm of three joints, its torques Pinocchio's, has friction that its URDF lacks, and one concealed effect at joint2.
It is recorded on a small motion: 14 to 15 s, torque noise of 5 to 6 %. Cases were chosen, out of some 60 with fifteen
effects, for what that recording leaves open. ``torchrbd excite`` designs a motion from the first diagnosis, and for
comparison one without it; the same robot, with new noise, is recorded on both. Prints what each diagnosis says of the
effect that is there.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

import torchrbd
from torchrbd.diagnosis import Diagnosis
from torchrbd.effects.registry import PLAIN
from torchrbd.excitation.conditioning import Conditioning
from torchrbd.excitation.rivals import known_from
from torchrbd.excitation.separating import Separating
from torchrbd.recordings import Recording

JOINTS = ("joint1", "joint2", "joint3")
_LINKS = (
    # origin, axis, centre of mass, mass, inertia (xx, yy, zz), range, speed, torque
    ("0 0 0.1", "0 0 1", "0 0 0.1", 6.0, (0.05, 0.05, 0.03), 2.5, 2.0, 80.0),
    ("0 0 0.2", "0 1 0", "0 0 0.2", 5.0, (0.09, 0.09, 0.01), 2.2, 2.0, 80.0),
    ("0 0 0.45", "0 1 0", "0.02 0 0.18", 3.0, (0.05, 0.05, 0.006), 2.4, 2.5, 40.0),
)
VISCOUS, COULOMB = np.array([1.0, 1.5, 0.8]), np.array([1.2, 1.5, 0.6])
_RATE_HZ, _CENTRES, _REST, _ENCODER_STEP = 125.0, (0.0, 0.6, -0.5), 1e-3, 2 * np.pi / 2**17

Law = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Torque (N,) of q, qd, qdd of joint2 and of what it takes without the effect."""


@dataclass(frozen=True)
class Case:
    """A concealed effect and the first motion: sines of these sizes [rad] and frequencies [Hz]."""

    effect: str
    words: str
    law: Law
    size: tuple[float, float, float]
    frequencies_hz: tuple[float, ...]
    noise: float
    seconds: float
    motion_seed: int


_NARROW, _SLOW = ((0.3, 0.15, 0.3), (0.3, 0.6)), ((0.6, 0.4, 0.1), (0.15, 0.3))
CASES = {
    "gain": Case("torque_scale", "gain 1.15", lambda q, v, a, tau: 0.15 * tau, *_NARROW, 0.05, 14.0, 1),
    "stop": Case(
        "one_sided_spring",
        "soft stop from 0.3 rad, 15 N m/rad",
        lambda q, v, a, tau: 15.0 * np.maximum(0.0, q - 0.3),
        (0.3, 0.12, 0.3),
        (0.3, 0.6),
        0.06,
        15.0,
        1,
    ),
    "loss": Case(
        "speed_dependent_loss", "loss 0.1 s/rad", lambda q, v, a, tau: 0.1 * abs(tau) * v, *_SLOW, 0.05, 14.0, 3
    ),
    "rotor": Case("rotor_inertia", "rotor inertia 0.6 kg m^2", lambda q, v, a, tau: 0.6 * a, *_SLOW, 0.05, 14.0, 3),
    "drag": Case(
        "quadratic_drag", "drag 5 N m s^2/rad^2", lambda q, v, a, tau: 5.0 * v * abs(v), *_SLOW, 0.05, 14.0, 3
    ),
}


def arm() -> str:
    """Return the URDF: no friction in it."""
    tags = ['<link name="base"/>']
    for k, (origin, axis, centre, mass, (xx, yy, zz), reach, speed, torque) in enumerate(_LINKS, 1):
        parent = "base" if k == 1 else f"link{k - 1}"
        tags.append(
            f'<link name="link{k}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>'
            f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint{k}" type="revolute"><parent link="{parent}"/><child link="link{k}"/>'
            f'<origin xyz="{origin}"/><axis xyz="{axis}"/>'
            f'<limit lower="{-reach}" upper="{reach}" velocity="{speed}" effort="{torque}"/></joint>'
        )
    return f'<robot name="arm">{"".join(tags)}</robot>'


def first_motion(case: Case) -> tuple[np.ndarray, ...]:
    """Return t (N,) and q, qd, qdd (N, 3)."""
    rng, t = np.random.default_rng(case.motion_seed), np.arange(0.0, case.seconds, 1.0 / _RATE_HZ)
    states = np.zeros((3, len(t), len(JOINTS)))
    for j in range(len(JOINTS)):
        for frequency in case.frequencies_hz:
            w = 2 * np.pi * frequency * rng.uniform(0.9, 1.1)
            angle, size = w * t + rng.uniform(0, 2 * np.pi), case.size[j] / len(case.frequencies_hz) ** 0.5
            states[:, :, j] += size * np.stack((np.sin(angle), w * np.cos(angle), -w * w * np.sin(angle)))
        states[0, :, j] += _CENTRES[j]
    return t, *states


def recorded(case: Case, name: str, states: tuple[np.ndarray, ...], seed: int) -> Recording:
    """Record the arm with friction and the concealed effect on a motion."""
    t, q, qd, qdd = states
    model = pin.buildModelFromXML(arm())
    data = model.createData()
    tau = np.stack([pin.rnea(model, data, *row).copy() for row in zip(q, qd, qdd, strict=True)])
    tau += VISCOUS * qd + COULOMB * np.tanh(qd / _REST)
    tau[:, 1] += case.law(q[:, 1], qd[:, 1], qdd[:, 1], tau[:, 1])
    noise = case.noise * np.sqrt((tau**2).mean(0)) * np.random.default_rng(seed).standard_normal(tau.shape)
    return Recording.from_arrays(name, list(JOINTS), t, np.round(q / _ENCODER_STEP) * _ENCODER_STEP, tau + noise)


def told(diagnosis: Diagnosis, effect: str) -> str:
    """Return what explains the same as an effect at joint2, with probabilities; else what is found there."""
    for finding in diagnosis.findings:
        rest = 1.0 - sum(a.probability for a in finding.indistinguishable_from)
        shares = {finding.effect: rest, **{a.effect: a.probability for a in finding.indistinguishable_from}}
        if finding.joints == ("joint2",) and effect in shares:
            scale = finding.probability / rest
            every = {name: scale * share for name, share in shares.items()}
            every["none"] = max(1.0 - sum(every.values()), 0.0)
            return ", ".join(f"{name} {p:.2f}" for name, p in every.items() if p > 0.005)
    found = (f.effect for f in diagnosis.findings if f.joints == ("joint2",))
    return "instead: " + ", ".join(name for name in found if name not in PLAIN)


def expected(before: Diagnosis, motion: torchrbd.Excitation) -> str:
    """Return the expected log Bayes factors of a motion between the rivals that a diagnosis has left [nats]."""
    known, (t, q, qd, qdd) = known_from(before), motion.states(_RATE_HZ)
    one = Separating(known, motion.limits, Conditioning(motion.robot, motion.limits), t, 1, periodic=False)
    return ", ".join(f"{pair.log_bayes_factor:.3g}" for pair in one.separations(q, qd, qdd)) or "nothing open"


def main() -> None:
    """Run the cases and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), help="cases (default: all)")
    parser.add_argument("--periods", type=int, default=2, help="of the designed motions, 10 s each (default: 2)")
    parser.add_argument("--speed", type=float, default=1.0, help="share of the speed limits to use (default: 1)")
    parser.add_argument("--seed", type=int, default=0, help="of the noise (default: 0)")
    options = parser.parse_args()
    print(
        "| concealed at joint2 | diagnosed from | expected log Bayes factors | what explains it, with probabilities |"
    )
    print("| --- | --- | --- | --- |")
    for name in options.only:
        case, seed = CASES[name], 10 * options.seed
        first = recorded(case, "first", first_motion(case), seed + 2)
        before = torchrbd.diagnose(arm(), [first])
        print(f"| {case.words} | first recording | | {told(before, case.effect)} |")
        shared = {"periods": options.periods, "speed": options.speed}
        for words, diagnosis in (("motion that separates", before), ("motion for the parameters", None)):
            motion = torchrbd.excite(arm(), diagnosis, **shared)
            second = recorded(case, "second", tuple(x.numpy() for x in motion.states(_RATE_HZ)), seed + 3)
            for extra, used in (("", [second]), (", and first", [first, second])):
                said = told(torchrbd.diagnose(arm(), used), case.effect)
                nats = "" if extra else expected(before, motion)
                print(f"| | {words}{extra} | {nats} | {said} |", flush=True)


if __name__ == "__main__":
    main()
