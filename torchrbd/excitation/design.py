"""Design the motion to record next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from torchrbd._runtime.threads import single_threaded
from torchrbd.dataset.reading import Progress
from torchrbd.diagnosis import Diagnosis
from torchrbd.display import Remark
from torchrbd.errors import InputError, OptionError
from torchrbd.excitation.conditioning import Conditioning
from torchrbd.excitation.constraints import Constraints
from torchrbd.excitation.fourier import Basis
from torchrbd.excitation.limits import Range, limits_of
from torchrbd.excitation.optimising import FINE_SAMPLES, SAMPLES, Problem, optimised, sampled
from torchrbd.excitation.results import Excitation, Separation, clearance, joint_uses
from torchrbd.excitation.rivals import Known, known_from
from torchrbd.excitation.separating import Separating
from torchrbd.model import RigidBodyDynamics
from torchrbd.model.starting import described_terms
from torchrbd.robot import RobotModel

# Samples a period at most, where what separates lies at high frequencies.
_MOST_SAMPLES = 600
_LEAST_HARMONICS, _MOST_HARMONICS = 2, 100
# Rivals whose expected log Bayes factor is less than this stay open [nats].
_SEPARATE = 3.0


@single_threaded()
def excite(
    robot: RobotModel | str | Path | bytes,
    diagnosis: Diagnosis | str | Path | None = None,
    *,
    frequency_hz: float = 0.1,
    harmonics: int = 5,
    periods: int = 3,
    joints: Sequence[str] | None = None,
    ranges: Mapping[str, Range] | None = None,
    velocities: Mapping[str, float] | None = None,
    efforts: Mapping[str, float] | None = None,
    box: Mapping[str, Range] | None = None,
    margin: float = 0.1,
    speed: float = 1.0,
    starts: int = 4,
    seed: int = 0,
    gravity: Sequence[float] | None = None,
    progress: Progress = lambda *_: None,
) -> Excitation:
    """Design a motion that identifies a robot's parameters, or decides what a diagnosis has left open.

    The motion is a Fourier series for every joint, from rest to rest. It keeps range, speed and torque of every joint,
    and a box for the links. Without a diagnosis, it has the least condition numbers of the regressor that were found.
    With one, it has the largest expected log Bayes factors between each finding and the effects that cannot be
    distinguished from it. Links may still touch each other or obstacles: the URDF's shapes are not used.

    Args:
        robot: a robot or its URDF.
        diagnosis: what was found so far: the object, its folder or its diagnosis.json. Torques are those of its model.
        frequency_hz: of a period's repetition.
        harmonics: so many times this is the highest frequency.
        periods: to record.
        joints: those that move; all by default. The others stand still at zero, or as near as they can.
        ranges, velocities, efforts: limits by joint in place of the URDF's, see ``limits_of``.
        box: "x", "y" or "z" and between what the origins of links stay, in the base's axes [m].
        margin: part of every range, speed and torque that is left free.
        speed: share of the speeds to use.
        starts: how many times the optimiser is started.
        seed: of these starts.
        gravity: (3,) in the base's axes [m/s^2]; that of the diagnosis with one.
        progress: called with the stage and the part of it that is done.

    Raises:
        InputError: a robot, diagnosis or option that cannot be used, or limits that no motion was found to keep.
    """
    _check_series(frequency_hz, harmonics, periods, starts, seed)
    known = None if diagnosis is None else known_from(diagnosis)
    robot = _read(robot, known, gravity)
    limits = limits_of(
        robot,
        joints=joints,
        ranges=ranges,
        velocities=velocities,
        efforts=efforts,
        box=box,
        margin=margin,
        speed=speed,
    )
    model = RigidBodyDynamics(robot, terms=described_terms(robot)) if known is None else known.model
    model.requires_grad_(False)
    constraints = Constraints(robot, limits, lambda t, q, qd, qdd: model(q, qd, qdd, t=t))
    conditioning, basis = Conditioning(model.robot, limits), Basis(1.0 / frequency_hz, harmonics)
    separating, t, stage = None, sampled(basis, SAMPLES * harmonics), "designing a motion"
    if known is not None and known.questions:
        t = sampled(basis, _samples(basis, known.cutoff_hz))
        separating = Separating(known, limits, conditioning, t, periods)
        stage = "designing a motion that separates rivals"
    objective = conditioning.objective if separating is None else separating.objective
    problem = Problem(basis, objective, constraints, t)
    motion = optimised(problem, starts, seed, lambda part: progress(stage, part))
    fine = sampled(basis, FINE_SAMPLES * harmonics)
    separations = () if separating is None else separating.separations(*motion.states(t))
    return Excitation(
        robot=robot,
        motion=motion,
        periods=periods,
        limits=limits,
        condition=conditioning.numbers(*motion.states(fine)),
        uses=joint_uses(constraints, motion, fine),
        clearance=clearance(constraints, motion.states(fine)[0]),
        separations=separations,
        notes=() if known is None else (*known.notes, *_notes(separations)),
    )


def _check_series(frequency_hz: float, harmonics: int, periods: int, starts: int, seed: int) -> None:
    if not (math.isfinite(frequency_hz) and frequency_hz > 0.0):
        raise OptionError(f"frequency is {frequency_hz:g} Hz; expected a positive number, e.g. 0.1")
    for name, value, least in (
        ("harmonics", harmonics, _LEAST_HARMONICS),
        ("periods", periods, 1),
        ("starts", starts, 1),
    ):
        if value < least:
            raise OptionError(f"{name} is {value}; expected at least {least}")
    if harmonics > _MOST_HARMONICS:
        raise OptionError(f"harmonics is {harmonics}; expected at most {_MOST_HARMONICS}")
    if seed < 0:
        raise OptionError(f"seed is {seed}; expected a whole number that is not negative")


def _read(robot: RobotModel | str | Path | bytes, known: Known | None, gravity: Sequence[float] | None) -> RobotModel:
    """Return the robot, under the gravity of the diagnosis if there is one.

    Raises:
        OptionError: gravity is given twice.
        InputError: robot and diagnosis have other joints.
    """
    if gravity is not None and (known is not None or isinstance(robot, RobotModel)):
        raise OptionError("gravity is known from the robot or the diagnosis; leave it out")
    if not isinstance(robot, RobotModel):
        own = gravity if known is None else known.model.robot.gravity
        robot = RobotModel.from_urdf(robot, gravity=own)
    if known is not None and robot.joint_names != known.model.robot.joint_names:
        raise InputError(
            f"robot '{robot.name}' has joints {', '.join(robot.joint_names)}, the diagnosis is of "
            f"{', '.join(known.model.robot.joint_names)}; give the URDF that was diagnosed"
        )
    return robot


def _samples(basis: Basis, cutoff_hz: float) -> int:
    """Return how many samples a period needs for torques below a cut-off."""
    return max(SAMPLES * basis.harmonics, min(math.ceil(4.0 * cutoff_hz * basis.period_s), _MOST_SAMPLES))


def _notes(separations: Sequence[Separation]) -> list[Remark]:
    """Remark on what stays open, or that nothing is open."""
    if not separations:
        return [Remark("nothing open")]
    return [
        Remark("rivals stay open", {"one": one.one, "other": one.other, "log_bayes_factor": one.log_bayes_factor})
        for one in separations
        if one.log_bayes_factor < _SEPARATE
    ]
