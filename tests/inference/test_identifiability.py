"""What data, prior and further motions tell of each parameter; suggested motions are made by Pinocchio and fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from inference.problems import columns_of, prior_of, random_moments, urdf_of
from simulated import Motion as Made
from simulated import inverse_dynamics, joint_names, multisine

from torchrbd.dataset.block_statistics import assemble
from torchrbd.inference.physical.fitting import FittedModel, fit_model
from torchrbd.inference.posterior.experiments import Motion, described, extent, information, states
from torchrbd.inference.posterior.identifiability import Identifiability, _State, identifiability
from torchrbd.inference.preparation import Prepared, prepare
from torchrbd.inference.settings import Settings
from torchrbd.likelihood.urdf_prior import divergence_hessian
from torchrbd.parameters import base_parameters
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel, pseudo_inertia

RATE_HZ = 10.0
NOISE = 0.02


def random_case(seed: int, n_joints: int, weight: float, samples: int = 40, **options):
    columns = columns_of(RobotModel.from_urdf(urdf_of(seed, n_joints, fixed=0.0)), ())
    prior, statistics = prior_of(columns, **options), random_moments(columns, seed, samples, columns.reference())
    noise = torch.full((n_joints,), 1.0 / weight if weight else torch.inf, dtype=torch.float64)
    return prior, statistics, fit_model(statistics, prior, (), noise)


@pytest.mark.parametrize(("seed", "weight"), [(0, 1e-3), (1, 0.1), (2, 30.0)])
def test_shares_are_those_of_dense_matrices(seed: int, weight: float) -> None:
    prior, statistics, model = random_case(seed, 3, weight)
    H, _ = assemble(model.columns, statistics.total(), 1.0 / model.noise_variance)
    inverse = np.linalg.inv(pseudo_inertia(model.x[:30].reshape(-1, 10)).numpy())
    M = torch.block_diag(*divergence_hessian(torch.from_numpy(inverse))).numpy() * prior.kappa
    d = np.sqrt(np.diag(M))
    believed = np.diag(np.linalg.inv(M / d / d[:, None]))
    share = np.diag(np.linalg.inv((H[:30, :30].numpy() + M) / d / d[:, None])) / believed
    invisible = base_parameters(model.columns.robot).invisible
    for k, found in enumerate(identifiability(prior, model, RATE_HZ)):
        assert found.prior_share == pytest.approx(1.0 if k in invisible else share[k], rel=1e-5, abs=1e-7)


def test_without_data_the_prior_has_all() -> None:
    prior, _, model = random_case(3, 3, 0.0)
    for found in identifiability(prior, model, RATE_HZ):
        assert found.prior_share == pytest.approx(1.0, abs=1e-9)
        assert found.status in ("not identifiable", "unexcited")
        # Without torque sensors no motion tells anything.
        assert found.motion is None


def test_with_much_data_only_structure_is_left() -> None:
    prior, _, model = random_case(4, 3, 1e6, samples=500)
    robot = model.columns.robot
    base = base_parameters(robot)
    # Prior variance that remains when all base parameters are known, by conditioning a Gaussian.
    inverse = torch.linalg.inv(pseudo_inertia(model.x[:30].reshape(-1, 10)))
    P = torch.linalg.inv(torch.block_diag(*divergence_hessian(inverse))).numpy()
    K = base.combination.numpy()
    K = K / np.sqrt(np.diag(K @ P @ K.T))[:, None]
    left = np.diag(P - P @ K.T @ np.linalg.solve(K @ P @ K.T, K @ P)) / np.diag(P)
    for k, found in enumerate(identifiability(prior, model, RATE_HZ)):
        if k in base.invisible:
            assert found.status == "not identifiable"
            assert found.prior_share == 1.0
            assert found.statement == f"no motion of this robot with its base fixed identifies {found.name}"
        else:
            assert found.status == ("identified" if k in base.alone else "combination")
            assert found.prior_share == pytest.approx(left[k], abs=2e-3)
            assert found.least_share == pytest.approx(left[k], abs=1e-6)
            assert all(found.name in one.values["expression"] for one in found.combinations)
            assert bool(found.combinations) == (k not in base.alone)


def test_held_bodies_are_held() -> None:
    columns = columns_of(RobotModel.from_urdf(urdf_of(5, 3, fixed=0.0)), ())
    prior = prior_of(columns, held=(columns.robot.body_names[0],))
    model = fit_model(random_moments(columns, 0, 40), prior, (), torch.ones(3, dtype=torch.float64))
    found = identifiability(prior, model, RATE_HZ)
    assert {p.status for p in found[:10]} == {"held"}
    assert "held" not in {p.status for p in found[10:]}


def test_information_is_that_of_its_rows() -> None:
    _, _, model = random_case(6, 3, 2.0)
    motion = Motion("accelerate", 1, (0,))
    q, qd, qdd = states(model.columns.robot, motion)
    assert (q[:, 2] == q[0, 2]).all()
    assert torch.count_nonzero(qd) == 0
    assert torch.equal(torch.nonzero(qdd.abs().sum(0)).flatten(), torch.tensor([1]))
    expected = torch.zeros(30, 30, dtype=torch.float64)
    for at in zip(q, qd, qdd, strict=True):
        Y = model.columns.robot.regressor(*at)
        expected += 10.0 * RATE_HZ / len(q) * 2.0 * Y.T @ Y
    found = information(model, motion, torch.eye(30, dtype=torch.float64), RATE_HZ)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9 * float(expected.max()))


def test_motions_keep_inside_the_limits() -> None:
    robot = RobotModel.from_urdf(urdf_of(7, 4))
    for lower, upper in ((-0.2, 0.1), (0.5, 0.9), (-3.0, -2.0), (-torch.inf, torch.inf), (0.3, torch.inf)):
        robot.lower.fill_(lower)
        robot.upper.fill_(upper)
        robot.velocity.fill_(0.4)
        for kind in ("slow", "accelerate", "fast"):
            q, qd, _ = states(robot, Motion(kind, 2, (0, 1, 3)))
            assert (q[:, :] >= lower).all()
            assert (q <= upper).all()
            assert (q.amax(0) > q.amin(0)).all()
            assert qd.abs().max() <= 0.2
        assert all(np.isfinite(extent(robot, j)).all() for j in range(4))


def test_words() -> None:
    robot = RobotModel.from_urdf(urdf_of(7, 4))
    a, b, *_ = robot.joint_names
    assert str(described(robot, Motion("slow", 0, ()))) == f"move {a} slowly through its range"
    assert str(described(robot, Motion("accelerate", 0, (1,)))).endswith(f"/s^2) in several postures of {b}")
    assert str(described(robot, Motion("fast", 1, (0, 2, 3)))).endswith("in several postures of the other joints")
    assert str(described(robot, Motion("all", None, ()))) == "move all joints at once, at changing speed"


def recorded(urdf: str, motion: Made, name: str, scale: np.ndarray, seed: int) -> Recording:
    tau = inverse_dynamics(urdf, motion)
    rng = np.random.default_rng(seed)
    noisy = tau + NOISE * scale * rng.standard_normal(tau.shape)
    return Recording.from_arrays(
        name, joint_names(urdf), motion.t, motion.q + 1e-6 * rng.standard_normal(tau.shape), noisy
    )


def sines(t: np.ndarray, centre: float, *parts: tuple[float, float, float]) -> np.ndarray:
    """Return q, qd, qdd (3, N) of a sum of sines (amplitude, frequency in Hz, phase)."""
    found = np.zeros((3, len(t)))
    found[0] = centre
    for amplitude, hz, phase in parts:
        w = 2 * np.pi * hz
        angle = w * t + phase
        found += amplitude * np.stack((np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))
    return found


def made(robot: RobotModel, motion: Motion, seed: int) -> Made:
    """Make a suggested motion as a person would: ten seconds, and what the filters need at both ends."""
    t = np.arange(0.0, 12.0, 0.005)
    rng = np.random.default_rng(seed)
    x = np.zeros((3, len(t), robot.n_dof))
    for j in range(robot.n_dof):
        speed, acceleration, low, high = extent(robot, j)
        half, middle = (high - low) / 2, (high + low) / 2
        slow = (0.8 * half, 0.12 * rng.uniform(0.8, 1.2), rng.uniform(0, 6))
        parts: Sequence[tuple[float, float, float]] = ()
        if j in motion.varied:
            parts = (slow,)
        elif j == motion.joint and motion.kind == "fast":
            hz = speed / (2 * np.pi * 0.8 * half)
            parts = ((0.8 * half, min(hz, 1.0), rng.uniform(0, 6)),)
        elif j == motion.joint or motion.joint is None:
            shake = (acceleration / (2 * np.pi * 0.7) ** 2, 0.7 * rng.uniform(0.9, 1.1), rng.uniform(0, 6))
            parts = (slow,) if motion.kind == "slow" else (slow, shake)
        x[:, :, j] = sines(t, middle if parts else float(np.clip(0.0, low, high)), *parts)
    return Made(t, *x)


def badly_recorded(seed: int, n_joints: int, still: tuple[int, ...]) -> tuple[str, np.ndarray, Recording]:
    """Record a robot whose joints ``still`` hardly move; torque noise is that of good motion."""
    urdf = urdf_of(seed, n_joints, branching=0.0)
    good = multisine(n_joints, seed, duration_s=20.0)
    scale = inverse_dynamics(urdf, good).std(0)
    factor = np.ones(n_joints)
    factor[list(still)] = 1e-3
    motion = Made(good.t, good.q * factor, good.qd * factor, good.qdd * factor)
    return urdf, scale, recorded(urdf, motion, "first", scale, seed)


def fitted(urdf: str, recordings: list[Recording]) -> tuple[Prepared, FittedModel]:
    prepared = prepare(RobotModel.from_urdf(urdf), recordings, Settings(cutoff_hz=5.0), ())
    return prepared, fit_model(prepared.training, prepared.prior)


def promises(seed: int, n_joints: int, still: tuple[int, ...]) -> list[tuple[Identifiability, Identifiability]]:
    """Make every suggested motion; return what was suggested with the same parameter afterwards."""
    urdf, scale, first = badly_recorded(seed, n_joints, still)
    prepared, model = fitted(urdf, [first])
    rate = prepared.filtering.effective_rate
    suggested: dict[Motion, list[Identifiability]] = {}
    for p in identifiability(prepared.prior, model, rate):
        if p.motion is not None:
            assert p.status == "unexcited"
            suggested.setdefault(p.motion, []).append(p)
    pairs = []
    for k, (motion, parameters) in enumerate(suggested.items()):
        second = recorded(urdf, made(prepared.robot, motion, 70 + k), "second", scale, 90 + k)
        longer, better = fitted(urdf, [first, second])
        after = {p.name: p for p in identifiability(longer.prior, better, rate)}
        pairs += [(p, after[p.name]) for p in parameters]
    return pairs


def test_suggested_motions_do_what_is_promised() -> None:
    """The prior's share falls below half where that was promised with a margin, and elsewhere about as far as told."""
    cases = [(11, 3, (1, 2)), (12, 4, (2,)), (41, 5, (0, 2, 3)), (42, 4, (1, 3)), (43, 4, (0, 1)), (44, 5, (1, 4))]
    pairs = [pair for case in cases for pair in promises(*case)]
    clear = [(p, after) for p, after in pairs if p.prior_share_after < 0.3]
    assert len(clear) >= 5
    for p, after in clear:
        assert after.prior_share < 0.5, p.statement
        assert after.status != "unexcited", p.statement
    for p, after in pairs:
        assert after.prior_share < 0.5 * (p.prior_share + p.prior_share_after) + 0.1, p.statement


def test_noise_too_great_for_any_short_motion_is_said() -> None:
    prior, _, model = random_case(8, 3, 1e-2)
    loud = replace(model, noise_variance=1e6 * model.noise_variance)
    for p in identifiability(prior, loud, RATE_HZ):
        assert p.motion is None
        if p.status == "unexcited":
            assert "At this noise no 10 s of motion would" in p.statement
            assert p.prior_share_after == p.prior_share


def test_a_scale_beyond_all_others_upsets_no_share() -> None:
    """Friction of a joint that rested, in motion."""
    direction = torch.tensor([3.1e10, -0.7e10, 1.3e20], dtype=torch.float64)
    eye, one = torch.eye(3, dtype=torch.float64), torch.ones(2, dtype=torch.float64)
    for sign in (1.0, -1.0):
        # A product of long sums is symmetric and definite but for rounding.
        H = torch.outer(direction, direction) * (1.0 + sign * 1e-15 * eye)
        share = _State(eye, eye, one, one, torch.zeros_like(one)).share_after(H)
        assert bool(((share >= 0) & (share <= 1.0 + 1e-6)).all())
