"""What separates rivals: expected log Bayes factors against simulated recordings, and motions that raise them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from excitation.arms import arm_urdf, pinocchio_torque
from scipy.linalg import cho_factor, cho_solve
from shortened import fit_alone

import torchrbd
from torchrbd.diagnosis import Alternative, Diagnosis, Quantity
from torchrbd.effects import Site, effect, known_effects
from torchrbd.excitation.conditioning import Conditioning
from torchrbd.excitation.fourier import Basis, FourierMotion
from torchrbd.excitation.limits import limits_of
from torchrbd.excitation.rivals import NOTHING, Known, Question, Rival, known_from
from torchrbd.excitation.separating import Separating
from torchrbd.recordings import Recording
from torchrbd.report.files import write_files

URDF = arm_urdf()
SPRING = {"stiffness": 6.0, "rest_position": 0.2}
STOP = {"stiffness": 9.0, "contact_position": 0.3, "side": 1.0}
CUTOFF_HZ, NOISE = 2.0, np.array([0.3, 0.2, 0.3])


def rival(name: str, parameters: dict[str, float], joint: int = 1) -> Rival:
    w, shape = effect(name).coefficients(parameters)
    return Rival(
        f"{name} at joint{joint + 1}", effect(name), Site(joint), shape, torch.tensor(w, dtype=torch.float64), 0.5
    )


def known(*rivals: Rival) -> Known:
    model = torchrbd.RigidBodyDynamics.from_urdf(URDF).requires_grad_(False)
    return Known(model, (Question(rivals),), torch.from_numpy(NOISE), CUTOFF_HZ, ())


SPRINGS = known(rival("joint_spring", SPRING), rival("one_sided_spring", STOP))


def separating(about: Known, t: torch.Tensor, *, periodic: bool = False) -> Separating:
    limits = limits_of(about.model.robot)
    return Separating(about, limits, Conditioning(about.model.robot, limits), t, 1, periodic=periodic)


def narrow(t: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A motion in which joint2 stays where both springs push alike."""
    free = 0.5 * torch.randn(3, 5, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    free[1] *= 0.6
    free[:, 0] = torch.tensor([0.0, 0.8, -0.5], dtype=torch.float64)
    return FourierMotion(Basis(float(len(t) * (t[1] - t[0])), 3), free).states(t)


def simulated(one: Separating, states: tuple[torch.Tensor, ...], true: int, draws: int) -> np.ndarray:
    """Return log Bayes factors (draws,) of the true one of two springs against the other, from dense covariances."""
    question = one.known.questions[0]
    q, qd, qdd = (x.numpy() for x in states)
    torque = SPRING["stiffness"] * (q[:, 1] - SPRING["rest_position"])
    if true == 1:
        torque = STOP["stiffness"] * np.maximum(q[:, 1] - STOP["contact_position"], 0.0)
    tau = pinocchio_torque(URDF, q, qd, qdd)
    tau[:, 1] += torque
    width = one._rest_width.numpy()
    tau += np.array([0.4, 0.5, 0.2]) * (np.tanh(qd / width) - np.sign(qd))
    white = (tau / NOISE).T.ravel() + np.random.default_rng(true).standard_normal((draws, tau.size))
    signals = one._signals(*states)
    Z = one._nuisances(question, signals, *states).numpy()
    logs = []
    for candidate in question.rivals:
        columns, std = one._columns(candidate, signals)
        X = np.concatenate((Z, std.numpy()[:, None] * columns.numpy()))
        factor = cho_factor(np.eye(tau.size) + X.T @ X, lower=True)
        quadratic = (white * cho_solve(factor, white.T).T).sum(1)
        logs.append(-0.5 * quadratic - np.log(factor[0].diagonal()).sum())
    return logs[true] - logs[1 - true]


@pytest.mark.parametrize("true", [0, 1])
def test_expected_log_bayes_factors_are_those_of_simulated_recordings(true: int) -> None:
    """Torques are Pinocchio's and a spring's; evidence is that of the joint normal distribution of all samples."""
    t = torch.arange(60, dtype=torch.float64) / (2.0 * CUTOFF_HZ)
    one, states = separating(SPRINGS, t), narrow(t)
    L = one.log_bayes_factors(SPRINGS.questions[0], *states)
    drawn = simulated(one, states, true, 400)
    assert abs(drawn.mean() - float(L[true, 1 - true])) < 4.0 * drawn.std() / 20.0
    assert L.diagonal().abs().max() == 0.0


@pytest.mark.slow
def test_the_designed_motion_separates_more_than_the_first_one_in_simulation() -> None:
    t = torch.arange(60, dtype=torch.float64) / (2.0 * CUTOFF_HZ)
    one = separating(SPRINGS, t)
    result = design(SPRINGS)
    before, after = (
        [simulated(one, states, k, 50).mean() for k in (0, 1)] for states in (narrow(t), result.motion.states(t))
    )
    assert min(after) > min(before) + 20.0
    (told,) = result.separations
    assert told.log_bayes_factor > 20.0
    assert told.probability == 0.5
    assert told.probability_after > 0.999


def design(about: Known, **options: object) -> torchrbd.Excitation:
    """Design with what is known, as if it had been read."""
    from torchrbd.excitation import design as room

    original, room.known_from = room.known_from, lambda _: about
    try:
        return torchrbd.excite(URDF, "unused", starts=1, periods=1, harmonics=3, frequency_hz=1.0 / 15.0, **options)  # type: ignore[arg-type]
    finally:
        room.known_from = original


@pytest.mark.slow
def test_it_separates_more_than_the_motion_of_the_best_condition() -> None:
    """Friction that is told at slow motion only: a motion that tells parameters well is fast."""
    stribeck = {"coulomb": 0.5, "static": 1.0, "stribeck_speed": 0.3}
    about = known(rival("stribeck_friction", stribeck), Rival(NOTHING, None, Site(), {}, torch.zeros(0).double(), 0.5))
    t = torch.arange(300, dtype=torch.float64) / 20.0
    one, question = separating(about, t, periodic=True), about.questions[0]
    plain = torchrbd.excite(URDF, starts=1, harmonics=3, frequency_hz=1.0 / 15.0).motion.states(t)
    apart = design(about).motion.states(t)
    assert float(one.log_bayes_factors(question, *apart)[0, 1]) > 1.2 * float(
        one.log_bayes_factors(question, *plain)[0, 1]
    )


def test_slopes_of_the_criterion_are_right() -> None:
    t = torch.arange(24, dtype=torch.float64) / 4.0
    one = separating(SPRINGS, t, periodic=True)
    q, qd, qdd = narrow(t)
    # Away from rest, where friction has no slope.
    inputs = [x.clone().requires_grad_() for x in (q, qd + 0.01, qdd)]
    value = one.objective(*inputs)
    slopes = torch.autograd.grad(value, inputs)
    for k, slope in enumerate(slopes):
        step = torch.randn(24, 3, generator=torch.Generator().manual_seed(k), dtype=torch.float64)
        ends = []
        for h in (1e-5, -1e-5):
            moved = [x.detach() + h * step * (i == k) for i, x in enumerate(inputs)]
            ends.append(float(one.objective(*moved)))
        assert float((slope * step).sum()) == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4, abs=1e-6)


def test_what_is_equal_on_every_motion_stays_open_and_is_told() -> None:
    """A power law with the exponent two is quadratic drag."""
    drag, power = (
        rival("quadratic_drag", {"drag": 2.0}),
        rival("power_law_friction", {"friction": 2.0, "exponent": 2.0}),
    )
    result = design(known(drag, power))
    assert abs(result.separations[0].log_bayes_factor) < 3.0
    (note,) = map(str, result.notes)
    assert note.startswith("quadratic_drag at joint2 and power_law_friction at joint2 may stay open")


def test_motion_beyond_the_cut_off_tells_nothing() -> None:
    """Ripple whose torque is faster than the band that is compared."""
    ripple = rival("torque_ripple", {"amplitude": 1.0, "phase": 0.3, "order": 60.0})
    about = known(ripple, Rival(NOTHING, None, Site(), {}, torch.zeros(0).double(), 0.5))
    t = torch.arange(600, dtype=torch.float64) / 60.0
    free = torch.zeros(3, 3, dtype=torch.float64)
    free[:, 1] = 1.5
    states = FourierMotion(Basis(10.0, 2), free).states(t)
    wide = replace(about, cutoff_hz=25.0)
    seen, unseen = (
        float(separating(one, t, periodic=True).log_bayes_factors(one.questions[0], *states)[0, 1])
        for one in (wide, about)
    )
    assert seen > 10.0 * unseen


@pytest.mark.parametrize("name", sorted(known_effects()))
def test_every_effect_can_be_a_rival(name: str) -> None:
    """Its parameters bring it back, and its torque on a motion has slopes."""
    one = effect(name)
    robot = torchrbd.RobotModel.from_urdf(URDF)
    if not (sites := [s for s in one.sites(robot) if s.always]):
        pytest.skip("acts for a time only")
    from torchrbd.model.starting import _count, _scale

    shape = one.shapes(_scale(robot, 1))[0]
    w = 0.5 + torch.rand(_count(one, robot, sites[-1], shape), generator=torch.Generator().manual_seed(1)).double()
    values = {key: float(v) for key, v in one.parameters(w, shape).items()}
    back, shape = one.coefficients(values)
    again = Rival(name, one, sites[-1], shape, torch.tensor(back, dtype=torch.float64), 0.5)
    about = known(again, rival("joint_spring", SPRING))
    t = torch.arange(60, dtype=torch.float64) / 6.0
    states = [x.clone().requires_grad_() for x in narrow(t)]
    value = separating(about, t, periodic=True).objective(*states)
    assert all(bool(slope.isfinite().all()) for slope in torch.autograd.grad(value, states))


@pytest.fixture(scope="module")
def diagnosis() -> Diagnosis:
    """A diagnosis of the arm with friction that its URDF lacks and a constant torque of 0.4 N m at joint2."""
    t = torch.arange(0.0, 16.0, 0.01, dtype=torch.float64)
    basis = Basis(16.0, 8)
    free = 0.4 * torch.randn(3, basis.n, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    q, qd, qdd = (x.numpy() for x in FourierMotion(basis, free).states(t))
    tau = pinocchio_torque(URDF, q, qd, qdd) + np.array([0.0, 0.4, 0.0])
    tau += 0.03 * tau.std(0) * np.random.default_rng(0).standard_normal(tau.shape)
    recording = Recording.from_arrays("first", ["joint1", "joint2", "joint3"], t.numpy(), q, tau)
    with fit_alone():
        return torchrbd.diagnose(arm_urdf(friction=False), [recording])


@pytest.mark.slow
def test_alternatives_come_with_their_parameters(diagnosis: Diagnosis) -> None:
    found = [a for f in diagnosis.findings for a in f.indistinguishable_from]
    offset = next(a for a in found if a.effect == "torque_offset" and a.joints == ("joint2",))
    assert offset.parameters["offset"] == pytest.approx(0.4, abs=0.1)
    for one in found:
        assert 0.0 < one.probability <= 1.0
        assert effect(one.effect).coefficients(one.parameters)


def open_diagnosis(diagnosis: Diagnosis) -> Diagnosis:
    """Let a spring and a soft stop be what cannot be told apart."""
    alike = Alternative("one_sided_spring", ("joint2",), (), (), STOP, 0.3)
    values = {
        name: replace(next(iter(diagnosis.findings[0].parameters.values())), value=v) for name, v in SPRING.items()
    }
    one = replace(diagnosis.findings[0], effect="joint_spring", joints=("joint2",), parameters=values)
    return replace(diagnosis, findings=(replace(one, indistinguishable_from=(alike,)),))


def test_a_folder_tells_what_the_object_tells(diagnosis: Diagnosis, tmp_path: Path) -> None:
    result = open_diagnosis(diagnosis)
    write_files(result, tmp_path)
    first = known_from(result)
    for source in (tmp_path, tmp_path / "diagnosis.json"):
        again = known_from(source)
        torch.testing.assert_close(again.noise_std, first.noise_std)
        assert again.cutoff_hz == first.cutoff_hz
        (asked,), (wanted,) = again.questions, first.questions
        assert [r.words for r in asked.rivals] == [r.words for r in wanted.rivals]
        assert [r.probability for r in asked.rivals] == pytest.approx([0.7, 0.3])
        for one, other in zip(asked.rivals, wanted.rivals, strict=True):
            torch.testing.assert_close(one.coefficients, other.coefficients)
    told = torchrbd.excite(URDF, tmp_path, harmonics=2, starts=1).separations
    assert [(one.one, one.other) for one in told] == [
        ("joint spring at joint2", "one-sided spring (soft stop, taut cable) at joint2")
    ]
    assert told[0].log_bayes_factor > 10.0


def test_a_diagnosis_that_leaves_nothing_open_says_so(diagnosis: Diagnosis) -> None:
    sure = replace(diagnosis, findings=())
    (note,) = map(str, torchrbd.excite(URDF, sure, harmonics=2, starts=1).notes)
    assert note == "the diagnosis leaves nothing open that a motion could decide; this one identifies the parameters"


def test_rivals_without_parameters_are_told(diagnosis: Diagnosis) -> None:
    result = open_diagnosis(diagnosis)
    old = replace(result.findings[0], indistinguishable_from=(Alternative("backlash", ("joint2",)),))
    about = known_from(replace(result, findings=(old,)))
    assert about.questions == ()
    assert "joint spring at joint2: the diagnosis does not say what parameters its rivals would have" in str(
        about.notes[0]
    )


def test_what_is_no_question(diagnosis: Diagnosis) -> None:
    """Friction that every model has, and rivals whose numbers are not known."""
    result = open_diagnosis(diagnosis)
    friction = replace(diagnosis.findings[0], indistinguishable_from=(), probability=0.6, family_probability=0.6)
    assert friction.effect in ("viscous_friction", "coulomb_friction")
    unknown = replace(result.findings[0].indistinguishable_from[0], parameters=dict.fromkeys(STOP, float("nan")))
    spring = replace(result.findings[0], indistinguishable_from=(unknown,))
    assert known_from(replace(result, findings=(friction, spring))).questions == ()


def test_what_may_not_be_there_is_told_from_nothing(diagnosis: Diagnosis) -> None:
    (one,) = open_diagnosis(diagnosis).findings
    doubtful = replace(one, indistinguishable_from=(), probability=0.8, family_probability=0.9)
    (question,) = known_from(replace(diagnosis, findings=(doubtful,))).questions
    assert [rival.words for rival in question.rivals] == ["joint spring at joint2", NOTHING]
    assert [rival.probability for rival in question.rivals] == pytest.approx([0.9, 0.1])


def test_late_torque_of_all_joints_is_a_question_if_it_may_be_a_lag(diagnosis: Diagnosis) -> None:
    """The offset of the clocks has no step of its own: a delay of all joints is a pure one."""
    lag = Alternative("actuator_lag", parameters={"time_constant": 0.004}, probability=0.5)
    delay = {"delay": Quantity(-0.004, 1e-4, "s")}
    late = replace(diagnosis.findings[0], effect="time_delay", joints=(), parameters=delay, probability=0.5)
    late = replace(late, family_probability=0.999, indistinguishable_from=(lag,))
    (question,) = known_from(replace(diagnosis, findings=(late,))).questions
    assert [rival.words for rival in question.rivals] == ["time delay of the torque", "actuator lag"]
    assert question.rivals[0].shape["step"] == -0.004
    torchrbd.excite(URDF, replace(diagnosis, findings=(late,)), harmonics=2, starts=1)


def test_input_that_cannot_be_used_is_refused(diagnosis: Diagnosis, tmp_path: Path) -> None:
    with pytest.raises(torchrbd.InputError, match=re.escape("give the URDF that was diagnosed")):
        torchrbd.excite(URDF.replace("joint3", "elbow"), diagnosis)
    with pytest.raises(torchrbd.OptionError, match="gravity is known"):
        torchrbd.excite(URDF, diagnosis, gravity=(0.0, 0.0, 0.0))
    with pytest.raises(torchrbd.InputError, match="its input is suspect, so that nothing can be compared"):
        torchrbd.excite(URDF, replace(diagnosis, verdict="suspect"))
    with pytest.raises(torchrbd.InputError, match="cannot be read"):
        torchrbd.excite(URDF, tmp_path)
    elsewhere = replace(open_diagnosis(diagnosis).findings[0], joints=("joint9",))
    with pytest.raises(torchrbd.InputError, match="finding 'joint_spring' cannot be read"):
        torchrbd.excite(URDF, replace(diagnosis, findings=(elsewhere,)))
    write_files(diagnosis, tmp_path)
    (tmp_path / "parameters.json").write_text("{}")
    with pytest.raises(torchrbd.InputError, match=r"parameters.json"):
        torchrbd.excite(URDF, tmp_path)
