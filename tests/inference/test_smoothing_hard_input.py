"""Recordings on which smoothing states and parameters together might break, or do worse than filtering them."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from inference.problems import urdf_of
from robot.random_robots import random_urdf
from shortened import slow_but
from simulated import Motion, inverse_dynamics, joint_names, multisine, record, with_wrong_inertials

import torchrbd
from torchrbd.errors import InputError
from torchrbd.inference.identification import Identification
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.smoothing.stretch import Stretch, stretches
from torchrbd.parameters import is_physical
from torchrbd.recordings import Chunk, Filtering, Recording
from torchrbd.robot import RobotModel

pytestmark = pytest.mark.usefixtures("fit_alone")

URDF = urdf_of(15, 3)
GIVEN = with_wrong_inertials(URDF, 16)
JOINTS = joint_names(URDF)
LOUD = 3e-3
# Held-out error may be that much above filtering's: both have mostly torque noise in common.
_NO_WORSE = 1.2


def loud(seed: int = 101, *, urdf: str = URDF, **options) -> Recording:
    settings = {"duration_s": 24.0, "rate_hz": 200.0, "encoder_noise": LOUD, **options}
    return record(urdf, seed, **settings)


def rows(recording: Recording) -> Chunk:
    (chunk,) = recording.chunks(10**7)
    return chunk


def changed(recording: Recording, change: Callable[[Chunk], None], keep: np.ndarray | None = None) -> Recording:
    """Return a recording whose rows are changed in place; of these only some are kept."""
    chunk = rows(recording)
    change(chunk)
    keep = np.ones(len(chunk.t), dtype=bool) if keep is None else keep
    return Recording.from_arrays(recording.name, recording.joints, chunk.t[keep], chunk.q[keep], chunk.tau[keep])


def both(urdf: str, recordings: list[Recording], **options) -> tuple[Identification, Identification]:
    """Return what filtering finds and what smoothing finds."""
    options = {"effects": []} | options
    filtered, smoothed = (
        torchrbd.identify(urdf, recordings, estimator=name, **options) for name in ("physical", "smoother")
    )
    assert (filtered.states, smoothed.states) == ("filtered", "smoothed")
    return filtered, smoothed


def check(found: Identification) -> None:
    """Assert that a result is finite and physical."""
    pi = torch.tensor([p.value for p in found.parameters if p.status != "term"], dtype=torch.float64).reshape(-1, 10)
    heavy = found.robot.pi.reshape(-1, 10)[:, 0] > 0
    assert is_physical(pi[heavy], tolerance=0.0).all()
    numbers = [v for p in found.parameters for v in (p.value, p.std, p.prior_share)]
    numbers += [v for fit in found.fits.values() for v in (*fit.nmse.values(), *fit.rmse.values())]
    numbers += [v for n in found.noise.values() for v in (n.position, n.from_position, n.torque)]
    assert np.isfinite(numbers).all()
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-9 * np.abs(found.covariance).max()


def held_out_error(found: Identification) -> float:
    return list(found.fits.values())[-1].mean_nmse


def true_error(found: Identification, urdf: str = URDF, seed: int = 900) -> float:
    """Return the mean nMSE of torques on states without noise, against Pinocchio's."""
    motion = multisine(len(joint_names(urdf)), seed, duration_s=20.0, rate_hz=50.0)
    order = [joint_names(urdf).index(name) for name in found.robot.joint_names]
    pi = torch.tensor([p.value for p in found.parameters if p.status != "term"], dtype=torch.float64)
    q, qd, qdd = (torch.from_numpy(x[:, order].copy()) for x in (motion.q, motion.qd, motion.qdd))
    told, tau = found.robot.inverse_dynamics(q, qd, qdd, pi).numpy(), inverse_dynamics(urdf, motion)[:, order]
    return float(np.mean(np.mean((told - tau) ** 2, axis=0) / tau.var(axis=0)))


def gaps(count: int) -> np.ndarray:
    """Say which of ``count`` rows stay; some pieces are too short for the filters."""
    keep = np.ones(count, dtype=bool)
    for start, end in ((1000, 1200), (1210, 1300), (1340, 1500), (2900, 2960), (3100, 3160)):
        keep[start:end] = False
    return keep


def quantised(chunk: Chunk) -> None:
    chunk.q[:] = 1e-3 * np.round(chunk.q / 1e-3)


def missing_cells(chunk: Chunk) -> None:
    chunk.q[np.random.default_rng(0).random(chunk.q.shape) < 2e-3] = np.nan


def one_loud_joint(chunk: Chunk) -> None:
    chunk.q[:, 1] += 1e-2 * np.random.default_rng(0).standard_normal(len(chunk.q))


def without_torque(chunk: Chunk) -> None:
    chunk.tau[:, 1] = np.nan


def wild_torques(chunk: Chunk) -> None:
    chunk.tau[np.random.default_rng(0).random(chunk.tau.shape) < 1e-3] *= 20


def as_it_is(chunk: Chunk) -> None:
    del chunk


_CASES = {
    "gaps": lambda: [changed(loud(), as_it_is, gaps(4800))],
    "two rates": lambda: [loud(), loud(102, name="slow", rate_hz=90.0, duration_s=13.0)],
    "slow one first": lambda: [loud(102, name="slow", rate_hz=90.0, duration_s=13.0), loud()],
    "quantised": lambda: [changed(loud(encoder_noise=0.0), quantised)],
    "missing cells": lambda: [changed(loud(), missing_cells)],
    "one joint 100 times as loud": lambda: [changed(loud(encoder_noise=1e-4), one_loud_joint)],
    "joint without torque": lambda: [changed(loud(), without_torque)],
    "torque outliers": lambda: [changed(loud(), wild_torques)],
}


@pytest.mark.parametrize("case", slow_but(("gaps", "two rates", "missing cells"), _CASES))
def test_odd_recordings_are_smoothed_no_worse_than_filtered(case: str) -> None:
    filtered, smoothed = both(GIVEN, _CASES[case]())
    check(smoothed)
    assert held_out_error(smoothed) < _NO_WORSE * held_out_error(filtered)


_OPTIONS: dict[str, dict] = {
    "some joints": {"joints": JOINTS[:2]},
    "part of the time": {"time": (2.0, 20.0), "cutoff_hz": 4.0},
    "half held out": {"holdout_fraction": 0.5, "cutoff_hz": 4.0},
    "noise told a tenth": {"encoder_noise": 0.1 * LOUD},
    "noise told tenfold": {"encoder_noise": 10 * LOUD},
    "noise told absurdly low": {"encoder_noise": 1e-12},
    "noise told absurdly high": {"encoder_noise": 1.0},
    "effects along": {"effects": ["viscous_friction", "coulomb_friction", "rotor_inertia"]},
    "trusted link": {"trust": ["link1"]},
}


@pytest.mark.parametrize("case", slow_but(("half held out", "effects along", "trusted link"), _OPTIONS))
def test_options_are_kept_when_smoothing(case: str) -> None:
    filtered, smoothed = both(GIVEN if case != "trusted link" else URDF, [loud()], **_OPTIONS[case])
    check(smoothed)
    assert held_out_error(smoothed) < _NO_WORSE * held_out_error(filtered)
    for noise in smoothed.noise.values():
        assert noise.position == pytest.approx(LOUD, rel=0.1)


@pytest.mark.parametrize("kinds", slow_but(("revolute prismatic",), ("prismatic", "continuous", "revolute prismatic")))
@pytest.mark.parametrize("n_joints", slow_but((5,), (1, 5)))
def test_robots_of_all_kinds(kinds: str, n_joints: int) -> None:
    urdf = random_urdf(17, n_joints, kinds=tuple(kinds.split()), massless=0.0)
    robot = RobotModel.from_urdf(urdf)
    motion = multisine(n_joints, 18, duration_s=20.0)
    motion = Motion(motion.t, motion.q + 1.5 * motion.t[:, None] * (kinds == "continuous"), motion.qd, motion.qdd)
    qd = motion.qd + 1.5 * (kinds == "continuous")
    tau = robot.inverse_dynamics(*map(torch.from_numpy, (motion.q, qd, motion.qdd))).numpy()
    rng = np.random.default_rng(19)
    tau = tau + 0.02 * tau.std(axis=0) * rng.standard_normal(tau.shape)
    q = motion.q + LOUD * rng.standard_normal(tau.shape)
    filtered, smoothed = both(
        with_wrong_inertials(urdf, 20), [Recording.from_arrays("odd", robot.joint_names, motion.t, q, tau)]
    )
    check(smoothed)
    assert held_out_error(smoothed) < _NO_WORSE * held_out_error(filtered)


_WRONG = ("five times too heavy", "torque of another robot", "torque reversed", "torque noise")


@pytest.mark.parametrize("wrong", slow_but(("torque reversed",), _WRONG))
def test_far_off_robots_stay_physical(wrong: str) -> None:
    recording, given = loud(), GIVEN
    if wrong == "five times too heavy":
        given = re.sub(r'(mass value|i[xyz][xyz])="([^"]+)"', lambda m: f'{m[1]}="{5 * float(m[2])!r}"', GIVEN)
    other = rows(loud(103, urdf=urdf_of(16, 3))).tau
    size = rows(recording).tau.std()

    def change(chunk: Chunk) -> None:
        if wrong == "torque of another robot":
            chunk.tau[:] = other
        elif wrong == "torque reversed":
            chunk.tau[:] = -chunk.tau
        elif wrong == "torque noise":
            chunk.tau[:] = size * np.random.default_rng(2).standard_normal(chunk.tau.shape)

    check(torchrbd.identify(given, changed(recording, change), estimator="smoother"))


@pytest.mark.parametrize("seconds", [0.5, 2.0, 5.0, 9.0])
def test_short_recordings_are_told_or_fitted(seconds: float) -> None:
    try:
        found = torchrbd.identify(GIVEN, loud(duration_s=seconds), estimator="smoother", cutoff_hz=5.0)
    except InputError:
        assert seconds < 8.0
    else:
        check(found)


@pytest.mark.parametrize("outputs", slow_but((301,), range(299, 303)))
def test_last_stretch_of_a_segment_may_be_tiny(outputs: int) -> None:
    """A stretch holds 300 torque samples; what is left over can be one or two."""
    whole = loud(104, duration_s=40.0)
    filtering, dt = Filtering(5.0), 1 / 200
    count = 2 * filtering.reach(dt) + (outputs - 1) * filtering.stride(dt) + 1
    keep = np.arange(8000) < count
    found = torchrbd.identify(GIVEN, changed(whole, as_it_is, keep), estimator="smoother", cutoff_hz=5.0)
    assert len(found.series.t) == outputs
    check(found)


def test_noise_free_recording_is_not_smoothed_and_exact() -> None:
    recording = loud(encoder_noise=0.0, torque_noise=0.0)
    check(torchrbd.identify(GIVEN, recording, estimator="smoother"))
    found = torchrbd.identify(GIVEN, recording)
    assert found.states == "filtered"
    assert held_out_error(found) < 1e-9


def test_a_clock_too_slow_is_told() -> None:
    slow = loud(105, name="slow", rate_hz=14.0, duration_s=30.0)
    found = torchrbd.identify(GIVEN, [loud(), slow], estimator="smoother", cutoff_hz=3.0)
    assert found.states == "filtered"
    assert any("slow" in note and "not smoothed" in note for note in found.notes)


def still(noise: float, step: float = 0.0) -> Recording:
    """Record a robot whose second joint is locked; noise and quantisation step of its own encoder."""
    motion = multisine(3, 106, duration_s=24.0)
    for signal, value in ((motion.q, 0.3), (motion.qd, 0.0), (motion.qdd, 0.0)):
        signal[:, 1] = value
    rng = np.random.default_rng(107)
    tau = inverse_dynamics(URDF, motion)
    tau = tau + 0.02 * tau.std(axis=0) * rng.standard_normal(tau.shape)
    q = motion.q + np.array([LOUD, noise, LOUD]) * rng.standard_normal(tau.shape)
    if step:
        q[:, 1] = step * np.round(q[:, 1] / step)
    return Recording.from_arrays("still", JOINTS, motion.t, q, tau)


def test_a_joint_that_stands_still() -> None:
    check(torchrbd.identify(GIVEN, still(LOUD), estimator="smoother"))


@pytest.mark.parametrize("estimator", slow_but(("auto",), ("auto", "smoother")))
@pytest.mark.parametrize(("noise", "step"), [(0.0, 0.0), (LOUD, 0.1)], ids=["set-point recorded", "coarse encoder"])
def test_a_joint_whose_position_never_changes(estimator: str, noise: float, step: float) -> None:
    check(torchrbd.identify(GIVEN, still(noise, step), estimator=estimator))


def saved(recording: Recording, path: Path, count: int | None = None) -> str:
    held = rows(recording)
    t, q, tau = (x[:count] for x in (held.t, held.q, held.tau))
    np.savez(path, t=t, q=q, tau=tau, joints=np.array(JOINTS))
    return str(path)


def test_a_joint_measured_in_one_of_two_recordings() -> None:
    second = loud(108, name="second", rate_hz=90.0, duration_s=13.0)
    filtered, smoothed = both(GIVEN, [changed(loud(), without_torque), second], cutoff_hz=3.0)
    check(smoothed)
    assert held_out_error(smoothed) < _NO_WORSE * held_out_error(filtered)


@pytest.mark.parametrize("estimator", ["physical", "smoother"])
def test_a_single_held_out_sample_has_no_variance_to_compare_with(estimator: str, tmp_path: Path) -> None:
    filtering = Filtering(4.0)
    held = saved(loud(109), tmp_path / "held.npz", 2 * filtering.reach(1 / 200) + 1)
    with contextlib.suppress(InputError):
        found = torchrbd.identify(GIVEN, loud(), estimator=estimator, cutoff_hz=4.0, holdout=[held])
        assert max(found.fits["urdf"].nmse.values(), default=0.0) < 100.0


def test_noise_of_a_held_out_recording_does_not_choose_the_estimator(tmp_path: Path) -> None:
    path = saved(loud(109, encoder_noise=3e-2), tmp_path / "held.npz")
    quiet = loud(110, encoder_noise=1e-5)
    alone = torchrbd.identify(GIVEN, quiet, cutoff_hz=3.0)
    beside = torchrbd.identify(GIVEN, quiet, cutoff_hz=3.0, holdout=[path])
    assert (alone.states, beside.states) == ("filtered", "filtered")


@pytest.mark.parametrize("seed", slow_but((111,), (111, 112)))
def test_measured_velocities_are_not_thrown_away(seed: int) -> None:
    """Good velocities beside loud positions are worth more than smoothing without them."""
    motion, recording = multisine(3, seed, duration_s=30.0), rows(loud(seed, duration_s=30.0, encoder_noise=2e-2))
    qd = motion.qd + 1e-4 * np.random.default_rng(seed).standard_normal(motion.qd.shape)
    measured = Recording.from_arrays("qd", JOINTS, recording.t, recording.q, recording.tau, qd)
    filtered, chosen = (torchrbd.identify(GIVEN, measured, estimator=name) for name in ("physical", "auto"))
    assert true_error(chosen) < 2 * true_error(filtered)
    assert not any("not used" in note for note in chosen.notes)


def ratio_of_true_errors(seeds: range, **options) -> float:
    """Return the geometric mean over recordings of smoothing's error as part of filtering's."""
    errors = [[true_error(f) for f in both(GIVEN, [loud(seed, **options)])] for seed in seeds]
    return float(np.exp(np.mean([np.log(smoothed / filtered) for filtered, smoothed in errors])))


@pytest.mark.parametrize("rate_hz", slow_but((13.0,), (10.0, 13.0, 20.0, 40.0)))
def test_slow_clocks(rate_hz: float) -> None:
    """Where there are few samples to a knot, fast motion must not be forced on wide ones: states stay filtered."""
    recording = loud(120, rate_hz=rate_hz, duration_s=60.0)
    result = torchrbd.identify(GIVEN, recording, estimator="smoother")
    assert result.states == "filtered"
    assert any("not smoothed" in note for note in result.notes)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [LOUD, 1e-2, 2e-2])
def test_very_loud_encoders(noise: float) -> None:
    """Noise pulls the chosen cut-off into the motion's band, and there is little to gain: so nothing may be lost.

    A recording's own ratio scatters by a factor of 2, the mean of 12 by a quarter.
    """
    assert ratio_of_true_errors(range(130, 142), encoder_noise=noise, duration_s=60.0) < 1.25


def test_massless_links_are_smoothed() -> None:
    urdf = random_urdf(10, 5, kinds=("revolute",), massless=0.5)
    assert (RobotModel.from_urdf(urdf).pi.reshape(-1, 10)[:, 0] == 0).any()
    check(torchrbd.identify(with_wrong_inertials(urdf, 22), loud(urdf=urdf), estimator="smoother"))


def held_bytes(pieces: tuple[Stretch, ...]) -> int:
    tensors = [t for s in pieces for t in (s.tau, s.counts, s.bands, s.encoder, s.misfit)]
    return sum(t.numel() * t.element_size() for t in tensors)


def test_long_recordings_do_not_fill_the_memory() -> None:
    """What is kept grows with the recording: a million samples must fit in half a gigabyte."""
    count = 10_000
    recording = loud(113, rate_hz=50.0, duration_s=count / 50)
    prepared = prepare(RobotModel.from_urdf(GIVEN), [recording], Settings(cutoff_hz=4.0, estimator="physical"), ())
    everything = torch.ones(3, dtype=torch.bool)
    pieces = stretches(
        recording,
        prepared.reading.surveys[0],
        prepared.filtering,
        prepared.tiles(0),
        lambda t: everything.expand(len(t), 3),
    )
    assert held_bytes(pieces) / count * 1e6 < 0.5e9


@pytest.mark.slow
def test_thirty_joints() -> None:
    urdf = urdf_of(23, 30, branching=0.5)
    filtered, smoothed = both(with_wrong_inertials(urdf, 24), [loud(114, urdf=urdf)])
    check(smoothed)
    assert held_out_error(smoothed) < _NO_WORSE * held_out_error(filtered)


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["auto", "smoother"])
def test_diagnosis_of_smoothed_states(estimator: str) -> None:
    friction = lambda motion: np.array([0.0, 3.0, 0.0]) * np.tanh(motion.qd / 0.02)  # noqa: E731
    concealed = torchrbd.diagnose(GIVEN, loud(115, duration_s=60.0, extra=friction), estimator=estimator)
    assert [(f.effect, f.joints) for f in concealed.findings] == [("coulomb_friction", (JOINTS[1],))]
    nothing = torchrbd.diagnose(GIVEN, loud(116, duration_s=60.0), estimator=estimator)
    assert not nothing.findings
