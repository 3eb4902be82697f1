"""The vision head example: the URDF and MuJoCo agree, the controllers do what they say, and failures are told."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no type stubs)

import mujoco
import numpy as np
import pytest
import torch
from scipy.integrate import cumulative_trapezoid
from vision_head import __main__ as command
from vision_head import tables
from vision_head.control import CONTROLLERS, KD, KP, Body, Target, computed_torque, follow, gaze, operational_space
from vision_head.experiment import TRUTH, Conditions, Results, run
from vision_head.methods import DEFAULT, Case, methods
from vision_head.motion import DT, REACH, gaze_shifts, multisine
from vision_head.robot import EFFECTS, URDF, Noise, Observer, RealHead, perturbed, record

from torchrbd import OptionError, RobotModel
from torchrbd.parameters import is_physical

SILENT = Noise(0.0, 0.0)


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """The controllers' tensors are small: threads only wait for each other, for long where cores are busy."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_urdf(URDF)


@pytest.fixture(scope="module")
def head(robot) -> RealHead:
    return RealHead(robot, perturbed(robot, np.random.default_rng(3)))


def states(n: int, seed: int = 0) -> list[torch.Tensor]:
    q, qd, qdd = torch.randn(3, n, 7, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return [0.2 * q, 2 * qd, 20 * qdd]  # far from the joints' stops, which MuJoCo would add


def test_urdf_is_a_neck_and_two_eyes(robot):
    eyes = [f"{side}_eye_{axis}" for side in ("left", "right") for axis in ("pan", "tilt")]
    assert list(robot.joint_names) == ["neck_pitch", "neck_roll", "neck_pan", *eyes]
    assert bool(is_physical(robot.pi.reshape(-1, 10)).all())
    assert set(robot.leaves) == {"left_eye", "right_eye"}


def test_real_robots_are_physical_and_about_30_percent_off(robot):
    drawn = torch.stack([perturbed(robot, np.random.default_rng(seed)) for seed in range(50)]).reshape(50, 7, 10)
    assert bool(is_physical(drawn).all())
    mass = drawn[..., 0] / robot.pi.reshape(7, 10)[:, 0]
    assert 0.2 < float(mass.std()) < 0.4


def test_mujoco_and_our_inverse_dynamics_agree(robot, head):
    data, body = mujoco.MjData(head.mujoco), Body(robot, head.pi.unsqueeze(0))
    for q, qd, qdd in zip(*states(20), strict=True):
        data.qpos[head.order], data.qvel[head.order], data.qacc[head.order] = q, qd, qdd
        mujoco.mj_inverse(head.mujoco, data)
        ours = body.torque(q[None], qd[None], qdd[None])[0]
        np.testing.assert_allclose(data.qfrc_inverse[head.order], ours, rtol=1e-8, atol=1e-8)


def test_gaze_points_are_where_mujoco_has_them(robot, head):
    data = mujoco.MjData(head.mujoco)
    q, qd, _ = states(5)
    x, _, _ = gaze(robot, q, qd)
    for k in range(5):
        data.qpos[head.order] = q[k]
        mujoco.mj_kinematics(head.mujoco, data)
        points = [data.body(e).xpos + 0.5 * data.body(e).xmat.reshape(3, 3)[:, 0] for e in ("left_eye", "right_eye")]
        np.testing.assert_allclose(x[k], np.concatenate([p[1:] for p in points]), atol=1e-10)


def test_gaze_jacobian_and_drift_are_derivatives(robot):
    q, qd, _ = states(4)
    _, J, drift = gaze(robot, q, qd)
    expected = torch.autograd.functional.jacobian(lambda q: gaze(robot, q, qd)[0], q)
    torch.testing.assert_close(J, torch.stack([expected[k, :, k] for k in range(4)]))
    rate = torch.autograd.functional.jvp(lambda q: (gaze(robot, q, qd)[1] @ qd[..., None])[..., 0], q, qd)[1]
    torch.testing.assert_close(drift, rate, rtol=1e-5, atol=1e-7)


def test_mass_and_bias_are_those_of_each_robot(robot):
    pis = torch.stack([perturbed(robot, np.random.default_rng(seed)) for seed in range(4)])
    q, qd, _ = states(4)
    M, h = Body(robot, pis).mass_and_bias(q, qd)
    for k, pi in enumerate(pis):
        torch.testing.assert_close(M[k], robot.mass_matrix(q[k], pi), rtol=1e-9, atol=1e-12)
        still = robot.inverse_dynamics(q[k], qd[k], torch.zeros(7, dtype=torch.float64), pi)
        torch.testing.assert_close(h[k], still + robot.damping * qd[k])


def test_operational_space_law_is_khatibs(robot, head):
    q, qd, qdd = states(3)
    e, ed = 0.02 * torch.randn(2, 3, 7, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    body = Body(robot, head.pi.repeat(3, 1))
    got = operational_space(body, Target(q, qd, qdd), e, ed)
    now, now_d = q - e, qd - ed
    x, J, drift = (v.numpy() for v in gaze(robot, now, now_d))
    x_d, J_d, drift_d = (v.numpy() for v in gaze(robot, q, qd))
    for k in range(3):
        M = robot.mass_matrix(now[k], head.pi).numpy()
        h = body.mass_and_bias(now, now_d)[1][k].numpy()
        L = np.linalg.inv(J[k] @ np.linalg.inv(M) @ J[k].T)
        a_x = J_d[k] @ qdd[k].numpy() + drift_d[k] + KP * (x_d - x)[k]
        a_x += KD * (J_d[k] @ qd[k].numpy() - J[k] @ now_d[k].numpy())
        a_0 = (qdd + KD * ed + KP * e)[k].numpy()
        null = np.eye(7) - J[k].T @ L @ J[k] @ np.linalg.inv(M)
        np.testing.assert_allclose(got.tau[k], J[k].T @ L @ (a_x - drift[k]) + null @ M @ a_0 + h, atol=1e-9)


@pytest.mark.parametrize("motion", [lambda rng: multisine(rng, 2.0, 1.5, 3.0), lambda rng: gaze_shifts(rng, 2.0)])
def test_motions_are_smooth_and_within_reach(motion):
    m = motion(np.random.default_rng(0))
    assert np.abs(m.q / REACH).max() <= 1.0
    for signal, rate in ((m.q, m.qd), (m.qd, m.qdd)):
        travelled = cumulative_trapezoid(rate, dx=DT, axis=0, initial=0)
        np.testing.assert_allclose(signal - signal[0], travelled, atol=1e-3 * np.abs(signal).max())


def test_observer_follows_a_ramp_without_lag():
    t = np.arange(0.0, 1.0, DT)
    observer = Observer(np.zeros((1, 1)))
    for now in t[1:]:
        observer.update(np.full((1, 1), 0.3 * now))
    np.testing.assert_allclose([observer.error.item(), observer.rate.item()], [0.3 * t[-1], 0.3], rtol=1e-6)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_true_parameters_track_noiselessly(head, name):
    rng = np.random.default_rng(5)
    references = [multisine(rng, 0.8, 1.5, 3.0), gaze_shifts(rng, 0.8)]
    with torch.no_grad():
        tracking = follow(head, CONTROLLERS[name], head.pi[None], references, 0.0, seed=0)
    # what is left comes from holding the torque for 2 ms
    assert tracking.failures == ("",)
    assert tracking.errors[0, 0] < 1e-3
    assert tracking.errors[0, 1] < 1e-2


def test_failures_are_told_and_disturb_nobody(robot, head):
    hollow = head.pi.clone()
    hollow[60:] *= -1.0  # an eye of negative mass
    light = 0.2 * head.pi
    references = [multisine(np.random.default_rng(6), 0.6, 1.5, 3.0)]
    with torch.no_grad():
        together = follow(head, computed_torque, torch.stack((head.pi, hollow, light)), references, 1e-3, seed=1)
        alone = follow(head, computed_torque, head.pi[None], references, 1e-3, seed=1)
        fed = follow(head, CONTROLLERS["inverse dynamics"], hollow[None], references, 1e-3, seed=1)
    assert together.failures == ("", "mass matrix not positive definite", "lost the motion")
    assert np.isnan(together.errors[1:]).all()
    np.testing.assert_allclose(together.errors[0], alone.errors[0], rtol=1e-9)
    assert "mass matrix" not in fed.failures[0], "feedforward needs no mass matrix"


def test_recordings_hold_the_physics_of_the_real_robot(robot):
    rng = np.random.default_rng(7)
    pi, reference = perturbed(robot, rng), multisine(rng, 4.0, 0.8, 2.0)

    def missing(*effects: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        (chunk,) = record(RealHead(robot, pi, effects), reference, rng, SILENT).chunks()
        qd, qdd = np.gradient(chunk.q, DT, axis=0), np.diff(chunk.q, 2, axis=0) / DT**2
        q, qd = chunk.q[1:-1], qd[1:-1]
        model = Body(robot, pi[None]).torque(*(torch.from_numpy(x)[None] for x in (q, qd, qdd)))[0].numpy()
        return chunk.tau[1:-1] - model, chunk.tau[1:-1], q

    left, tau, _ = missing()
    assert ((left**2).mean(0) < 1e-5 * (tau**2).mean(0)).all()
    stiffness = np.array(EFFECTS["cables"][1])
    left, tau, q = missing("cables")
    np.testing.assert_allclose(left[:, 3:], (stiffness * q)[:, 3:], atol=1e-2 * np.abs(tau[:, 3:]).max())
    left, tau, _ = missing("friction")
    assert ((left**2).mean(0) > 1e-3 * (tau**2).mean(0)).all()


def test_sensor_noise_is_as_asked(robot, head):
    reference = multisine(np.random.default_rng(8), 4.0, 0.4, 2.0)
    (chunk,) = record(head, reference, np.random.default_rng(9), Noise(1e-3, 0.05)).chunks()
    # white noise dominates third differences; their gain is 1 + 9 + 9 + 1
    np.testing.assert_allclose(np.diff(chunk.q, 3, axis=0).std(0) / np.sqrt(20), 1e-3, rtol=0.1)
    assert chunk.q_ref is not None
    np.testing.assert_array_equal(chunk.q_ref, reference.q[1:])


def failing(case: Case) -> torch.Tensor:
    raise OptionError("no such thing")


@pytest.mark.usefixtures("fit_alone")
def test_small_run_from_end_to_end(capsys):
    chosen = {name: methods()[name] for name in ("URDF as given", "wls", DEFAULT)} | {"broken": failing}
    results = run(chosen, Conditions(recorded_s=12.0, controlled_s=0.3), range(1000, 1001))
    assert results.names == (TRUTH, *chosen)
    for controller in CONTROLLERS:
        assert results.failures[controller][0].tolist()[0] == ""
        assert results.failures[controller][0, -1] == "no estimate: no such thing"
        assert np.isfinite(results.errors[controller][0, [0, 2]]).all()
        assert (results.excess(controller)[1] > results.excess(controller)[2]).all(), "wls is better than the URDF"
    stored = tables.stored([(Conditions(), results)])
    assert set(stored) == {f"{name}_0.4_hz" for name in ("summary", *(c.replace(" ", "_") for c in CONTROLLERS))}
    assert any("no estimate: no such thing" in row[-1] for row in stored["computed_torque_0.4_hz"]["rows"])


def made_up(default: list[float], classical: list[float]) -> Results:
    errors = np.stack([np.ones(3), 1 + np.array(default), 1 + np.array(classical)], 1)
    table = np.repeat(errors[..., None], 3, axis=2)
    return Results((TRUTH, DEFAULT, "wls"), {"c": table}, {"c": np.where(np.isnan(errors), "unwell", "")})


def test_excess_is_a_paired_median_and_failures_count_as_infinite():
    results = made_up([0.1, 0.2, 0.3], [1.0, np.nan, 0.5])
    np.testing.assert_allclose(results.excess("c"), [[0.0] * 3, [0.2] * 3, [1.0] * 3])
    np.testing.assert_allclose(results.ratio("c"), 0.2)
    assert "Largest of the nine ratios: 0.20, at most" in tables.verdict(results)
    assert "failed in 0 of 3" in tables.verdict(results)
    assert made_up([-0.2] * 3, [-0.1] * 3).ratio("c")[0] == 0.0
    assert made_up([0.0] * 3, [-0.1] * 3).ratio("c")[0] == np.inf
    assert np.isinf(made_up([0.1, np.nan, np.nan], [1.0, 1.0, 1.0]).excess("c")[1]).all()
    assert "above" in tables.verdict(made_up([0.1, np.nan, np.nan], [1.0, 1.0, 1.0]))


@pytest.mark.parametrize("arguments", [["--methods", "wsl"], ["--effects", "ghosts"], ["--methods", "wls"]])
def test_wrong_options_are_refused(arguments, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["vision_head", *arguments])
    with pytest.raises(SystemExit) as exit_:
        command.main()
    assert exit_.value.code == 2
    assert "known:" in capsys.readouterr().err or arguments == ["--methods", "wls"]
