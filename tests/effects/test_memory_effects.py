"""Effects with memory: against exact solutions, scipy's integrator and two-mass simulations of a pendulum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from effects.sites import ROBOT, SCALE, signals, states
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, firwin, lfilter
from shortened import slow_but
from torch import Tensor
from torch.autograd import gradcheck

from torchrbd.effects import Effect, Shape, Signals, Site
from torchrbd.effects.actuator_lag import ActuatorLag, acting
from torchrbd.effects.backlash import Backlash
from torchrbd.effects.band_limits import UNLIMITED_HZ, below, flat_below
from torchrbd.effects.joint_elasticity import JointElasticity
from torchrbd.effects.presliding_hysteresis import PreslidingHysteresis
from torchrbd.effects.recurrence import recurrence
from torchrbd.effects.time_delay import TimeDelay
from torchrbd.errors import InputError
from torchrbd.robot import RobotModel

MASS, LENGTH, INERTIA = 3.0, 0.3, 0.35  # about the axis
PENDULUM = RobotModel.from_urdf(
    f'<robot name="pendulum"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 -{LENGTH}"/>'
    f'<mass value="{MASS}"/><inertia ixx=".08" iyy="{INERTIA - MASS * LENGTH**2!r}" izz=".08" ixy="0" ixz="0" iyz="0"/>'
    '</inertial></link><joint name="j" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>'
    "</joint></robot>"
)
Motion = Callable[..., np.ndarray]


def motion(seed: int, fastest_hz: float) -> Motion:
    """Return a sum of sines as f(t, k), its k-th derivative at times t; about 1 rad/s RMS."""
    rng = np.random.default_rng(seed)
    omega, phase = 2 * np.pi * rng.uniform(0.1, fastest_hz, 6), rng.uniform(0, 2 * np.pi, 6)
    speed = rng.uniform(0.3, 0.9, 6)

    def at(t: np.ndarray | float, k: int = 0) -> np.ndarray:
        angle = omega * np.asarray(t)[..., None] + phase + k * np.pi / 2
        return (speed * omega ** (k - 1) * np.sin(angle)).sum(-1)

    return at


def two_masses(moved: Motion, t: np.ndarray, play: float, stiffness: float, damping: float) -> np.ndarray:
    """Return the torque (N,) between a motor that moves as told and a pendulum behind play and a damped spring."""

    def between(gap: np.ndarray, rate: np.ndarray) -> np.ndarray:
        side = np.sign(gap)
        pressed = side * (np.abs(gap) - play / 2) * stiffness + damping * rate
        return np.where((np.abs(gap) > play / 2) & (pressed * side > 0), pressed, 0.0)

    def rhs(time: float, state: np.ndarray) -> list[float]:
        torque = between(moved(time) - state[0], moved(time, 1) - state[1])
        return [state[1], float(torque - MASS * 9.81 * LENGTH * np.sin(state[0])) / INERTIA]

    load = INERTIA * moved(0.0, 2) + MASS * 9.81 * LENGTH * np.sin(moved(0.0))
    start = [float(moved(0.0) - load / stiffness - np.sign(load) * play / 2), float(moved(0.0, 1))]
    found = solve_ivp(rhs, (t[0], t[-1]), start, "LSODA", t_eval=t, max_step=4e-3, rtol=1e-7, atol=1e-9)
    return between(moved(t) - found.y[0], moved(t, 1) - found.y[1])


def pendulum_signals(moved: Motion, t: np.ndarray) -> Signals:
    q, qd, qdd = (torch.from_numpy(moved(t, k))[None] for k in range(3))
    return Signals(PENDULUM, q, qd, qdd, torch.tensor([1e-3], dtype=torch.float64), t=torch.from_numpy(t))


def band_limited(x: np.ndarray | torch.Tensor, rate_hz: float, cutoff_hz: float = 5.0) -> np.ndarray:
    kernel = firwin(int(3.6 * rate_hz / cutoff_hz) | 1, cutoff_hz, fs=rate_hz)
    return np.convolve(np.asarray(x), kernel, "valid")


def fitted(feature: np.ndarray, torque: np.ndarray) -> tuple[float, float]:
    """Return the coefficient and the share of the torque's power that it explains."""
    w = feature @ torque / (feature @ feature)
    return float(w), 1 - float(((torque - w * feature) ** 2).sum() / (torque**2).sum())


class TestRecurrence:
    def test_is_the_loop(self) -> None:
        rng = np.random.default_rng(0)
        first, decay, drive = rng.normal(size=3), rng.uniform(0, 1, (3, 36)), rng.normal(size=(3, 36))
        expected = [first]
        for k in range(36):
            expected.append(decay[:, k] * expected[-1] + drive[:, k])
        found = recurrence(*map(torch.from_numpy, (first, decay, drive)))
        np.testing.assert_allclose(found.numpy(), np.stack(expected, 1), rtol=1e-12)

    def test_gradients(self) -> None:
        torch.manual_seed(0)
        x = torch.randn(2, 7, dtype=torch.float64), torch.rand(7, dtype=torch.float64)
        first, decay, drive = (
            v.requires_grad_() for v in (x[0][:, 0].clone(), x[1].expand(2, 7).clone(), x[0].clone())
        )
        assert gradcheck(recurrence, (first, decay, drive))


def dahl(q: np.ndarray, qd: np.ndarray, t: np.ndarray, distance: float) -> np.ndarray:
    width = torch.full((1,), 1e-6, dtype=torch.float64)
    x = [torch.from_numpy(v)[None] for v in (q, qd, np.zeros_like(q))]
    effect = PreslidingHysteresis()
    (z,) = effect.features(
        Signals(PENDULUM, *x, width, t=torch.from_numpy(t)), Site(0), {"distance": distance}
    ).values()
    return z.numpy()


class TestPreslidingHysteresis:
    def test_is_the_solution_of_dahls_equation(self) -> None:
        t, q = np.arange(0, 6, 0.005), motion(4, 1.0)

        def rhs(time: float, z: np.ndarray) -> np.ndarray:
            return q(time, 1) / 0.05 * (1 - z * np.sign(q(time, 1)))

        z = dahl(q(t), q(t, 1), t, 0.05)
        exact = solve_ivp(rhs, (0, t[-1]), [z[0]], t_eval=t, max_step=2e-3, rtol=1e-8, atol=1e-10).y[0]
        assert np.abs(z - exact).max() < 2e-3  # the samples miss the very point of reversal

    @pytest.mark.parametrize("distance", [0.02, 0.3])
    def test_turning_points_are_all_it_knows_of_the_past(self, distance: float) -> None:
        t, q = np.arange(0, 8, 0.005), motion(9, 1.0)
        z, at = dahl(q(t), q(t, 1), t, distance), t >= 5
        way = np.sign(np.diff(q(t[~at])))
        turned = q(t[~at])[np.concatenate(([True], way[1:] != way[:-1], [True]))]
        assert len(turned) > 4
        now = replace(pendulum_signals(q, t[at]), turned=(torch.from_numpy(turned),))
        (found,) = PreslidingHysteresis().features(now, Site(0), {"distance": distance}).values()
        np.testing.assert_allclose(found, z[at], atol=1e-9)

    def test_depends_on_the_way_and_not_on_the_speed(self) -> None:
        t, q = np.arange(0, 4, 0.01), motion(5, 1.0)
        np.testing.assert_allclose(dahl(q(t), q(t, 1), 3 * t, 0.1), dahl(q(t), q(t, 1) / 3, t, 0.1), atol=1e-12)

    def test_is_coulomb_friction_where_the_distance_is_short_and_a_spring_where_it_is_long(self) -> None:
        t = np.arange(0, 2, 0.01)
        q = 0.4 * np.cos(np.pi * t)
        qd = -0.4 * np.pi * np.sin(np.pi * t)
        z = dahl(q, qd, t, 1e-5)
        np.testing.assert_allclose(z[5:96], -1.0, atol=1e-6)
        np.testing.assert_allclose(z[105:], 1.0, atol=1e-6)
        long = dahl(q, qd, t, 1e4) - dahl(q, qd, t, 1e4)[0]
        np.testing.assert_allclose(long, (q - q[0]) / 1e4, rtol=1e-3, atol=1e-7)

    def test_a_closed_loop_takes_work(self) -> None:
        t = np.arange(0, 4, 0.005)
        q, qd = 0.3 * np.sin(np.pi * t), 0.3 * np.pi * np.cos(np.pi * t)
        for distance in (0.01, 0.1, 1.0):
            z = dahl(q, qd, t, distance)[-401:]
            assert np.trapezoid(z, q[-401:]) > 0

    def test_neighbours_on_the_grid_are_alike(self) -> None:
        t, q = np.arange(0, 20, 0.01), motion(6, 0.8)
        at = pendulum_signals(q, t)
        grid = [shape["distance"] for shape in PreslidingHysteresis().shapes(SCALE)]
        assert len(grid) >= 4
        assert grid == sorted(grid)
        span = float(at.q.max() - at.q.min()) / (SCALE.q_high - SCALE.q_low)
        for low, high in pairwise(grid):
            between = dahl(q(t), q(t, 1), t, span * (low * high) ** 0.5)
            losses = [1 - fitted(dahl(q(t), q(t, 1), t, span * d), between)[1] for d in (low, high)]
            assert min(losses) < 0.1

    def test_a_joint_that_stands_still_has_no_shapes(self) -> None:
        assert PreslidingHysteresis().shapes(type(SCALE)(1e-3, 1e-4, 0.3, 0.3)) == ()


class TestTimeDelay:
    STEP_S = 0.02

    def shifted_load(self, moved: Motion, t: np.ndarray, delay: float) -> np.ndarray:
        return PENDULUM.inverse_dynamics(*(torch.from_numpy(moved(t - delay, k))[:, None] for k in range(3)))[
            :, 0
        ].numpy()

    @pytest.mark.parametrize("delay", [0.0237, -0.011, 0.0005])
    def test_is_the_load_of_another_time(self, delay: float) -> None:
        t, q = np.arange(0, 8, 0.008), motion(1, 1.2)
        (w,), shape = TimeDelay().coefficients({"delay": delay, "step": delay})
        phi = TimeDelay().features(pendulum_signals(q, t), Site(0), shape)
        added = w * next(iter(phi.values()))[0].numpy()
        exact = self.shifted_load(q, t, delay) - self.shifted_load(q, t, 0.0)
        inner = slice(10, -10)
        assert np.abs(added - exact)[inner].max() < 2e-3 * np.abs(exact).max()

    @pytest.mark.parametrize("bandwidth", [3.0, 48.0])
    def test_the_step_that_follows_is_the_delay(self, bandwidth: float) -> None:
        t, q = np.arange(0, 8, 0.008), motion(2, 0.8)
        exact = self.shifted_load(q, t, self.STEP_S) - self.shifted_load(q, t, 0.0)
        shape: Shape = {"step": 1e-3, "bandwidth": bandwidth}
        for _ in range(3):
            (phi,) = TimeDelay().features(pendulum_signals(q, t), Site(0), shape).values()
            w, _ = fitted(phi[0, 10:-10].numpy(), exact[10:-10])
            shape = TimeDelay().agreeing(torch.tensor([w]), shape)
        assert shape["step"] == pytest.approx(self.STEP_S, rel=0.02)
        assert shape["bandwidth"] == bandwidth
        assert TimeDelay().coefficients({"delay": w, **shape}) == ((w,), shape)

    def test_of_one_joint_and_of_all(self) -> None:
        at, (_, shape) = signals(*states(60)), TimeDelay().coefficients({"delay": 0.02})
        *joints, everywhere = TimeDelay().sites(ROBOT)
        parts = [next(iter(TimeDelay().features(at, site, shape).values())) for site in joints]
        (whole,) = TimeDelay().features(at, everywhere, shape).values()
        torch.testing.assert_close(sum(parts), whole)
        assert all((part.abs().sum(-1) > 0).tolist() == [k == j for k in range(3)] for j, part in enumerate(parts))
        assert TimeDelay().sites(PENDULUM) == (Site(0),)

    def test_no_delay_at_all_has_a_step(self) -> None:
        at = signals(*states(60))
        shape = TimeDelay().agreeing(torch.zeros(1), {"step": 0.02, "bandwidth": 6.0})
        # Midway between a step before and one behind there is none.
        for one in (shape, TimeDelay().coefficients({"delay": 0.0})[1], {"step": 0.0, "bandwidth": 6.0}):
            (phi,) = TimeDelay().features(at, Site(0), one).values()
            assert torch.isfinite(phi).all()

    def test_plausible_is_a_delay_near_its_step_or_of_first_order(self) -> None:
        assert TimeDelay().plausible({"delay": -0.008, "step": 0.001}, SCALE)
        assert TimeDelay().plausible({"delay": -0.008, "step": -0.01}, SCALE)
        assert not TimeDelay().plausible({"delay": 0.008, "step": -0.01}, SCALE)
        assert not TimeDelay().plausible({"delay": 0.001, "step": 0.045}, SCALE)
        assert not TimeDelay().plausible({"delay": 0.2, "step": 0.045}, SCALE)


def test_the_acting_torque_is_the_recorded_command_filtered() -> None:
    t, q, lag = np.arange(0, 6, 0.002), motion(3, 1.0), 0.04
    at = pendulum_signals(q, t)
    (phi,) = ActuatorLag().features(at, Site(0), {"bandwidth": 1e4}).values()
    load = at.load[0].numpy()
    command = load + lag * phi[0].numpy()
    b, a, _ = cont2discrete(([1.0], [lag, 1.0]), 0.002, "foh")
    acting = lfilter(b.ravel(), a, command)
    late = t > 0.5  # a filter that starts at rest has come in by then
    assert np.abs(acting - load)[late].max() < 1e-3 * np.abs(load).max()
    assert not ActuatorLag().plausible({"time_constant": -0.02}, SCALE)


def test_what_an_actuator_supplies_is_its_command_filtered() -> None:
    t, q, lag = np.arange(0, 6, 0.002), motion(3, 1.0), 0.04
    command = torch.from_numpy(np.stack((q(t) + lag * q(t, 1), 1.0 + 2.0 * (t + lag))))
    supplied = acting(command, lag / 0.002).numpy()
    inner = slice(10, None)
    np.testing.assert_allclose(supplied[0, inner], q(t)[inner], atol=2e-3 * np.abs(q(t)).max())
    np.testing.assert_allclose(supplied[1], 1.0 + 2.0 * t, rtol=1e-9)


@pytest.mark.parametrize("hz", [1.5, 12.0, UNLIMITED_HZ])
@pytest.mark.parametrize(
    ("seen", "response", "cut_off"),
    [(below, lambda f: np.exp(-0.5 * f**2), 1e-9), (flat_below, lambda f: 1.0 / (1.0 + f**8), 3e-6)],
)
def test_below_a_bandwidth(
    seen: Callable[..., Tensor], response: Callable[[float], float], cut_off: float, hz: float
) -> None:
    """A sine keeps what the response says of it, a straight line all, to its ends, but for what lasts too long."""
    t = torch.arange(0, 16, 0.004, dtype=torch.float64)
    line, wave = 3.0 - 0.7 * t, torch.sin(2 * torch.pi * 2.5 * t + 0.3)
    found = seen(torch.stack((line, wave)), 0.004, hz)
    torch.testing.assert_close(found[0], line, rtol=1e-9, atol=cut_off)
    inner = slice(1000, -1000)
    torch.testing.assert_close(found[1][inner], wave[inner] * response(2.5 / hz), rtol=1e-6, atol=cut_off)


class TestTwoMasses:
    def explained(self, effect: Effect, shape: Shape, moved: Motion, t: np.ndarray, torque: np.ndarray):
        at = pendulum_signals(moved, t)
        (phi,) = effect.features(at, Site(0), shape).values()
        rate = 1 / (t[1] - t[0])
        left = band_limited(torque - at.load[0].numpy(), rate)
        cut = slice(int(0.3 * rate), -int(0.3 * rate))
        return fitted(band_limited(phi[0], rate)[cut], left[cut])

    def test_spring_between_motor_and_link(self) -> None:
        t, q, errors = np.arange(0, 8, 0.005), motion(11, 0.6), []
        shape = {"bandwidth": 48.0, "compliance": 0.0, "link_friction": 0.0}
        for stiffness in (600.0, 1200.0):
            torque = two_masses(q, t, 0.0, stiffness, damping=0.03 * 2 * (stiffness * INERTIA) ** 0.5)
            w, share = self.explained(JointElasticity(), shape, q, t, torque)
            errors.append(abs(1 / w / stiffness - 1))
            assert share > 0.97
        assert errors[0] < 0.1
        assert errors[1] < 0.7 * errors[0]  # first order in 1/k

    def test_spring_of_a_link_that_swings_at_half_its_resonance(self) -> None:
        """tau = load / (1 - r) with r = M omega^2 / k = 1/4, as a series: to third order 1 + r + r^2 + r^3."""
        t, omega, r = np.arange(0, 4, 0.002), 4 * np.pi, 0.25
        at = pendulum_signals(lambda t, k: 1e-3 * omega**k * np.sin(omega * t + k * np.pi / 2), t)
        compliance = float(r * at.q.abs().max() / at.load.abs().max())
        wound = at.load[0] / (1 - r)
        errors = []
        for known in (0.0, compliance):
            shape = {"bandwidth": 1e4, "compliance": known, "link_friction": 0.0}
            (phi,) = JointElasticity().features(at, Site(0), shape).values()
            errors.append(float((at.load + compliance * phi - wound)[0, 100:-100].abs().max() / wound.abs().max()))
        assert errors[0] == pytest.approx(r**2, rel=0.05)
        assert errors[1] == pytest.approx(r**4, rel=0.2)

    def test_friction_of_the_link_winds_the_spring(self) -> None:
        """tau = Z q / (1 + Z / k) for small motions, Z = M s^2 + d s + m g l: d delays what accelerates the link."""
        t, s, viscous, stiffness = np.arange(0, 4, 0.002), 4j * np.pi, 2.0, 3000.0
        moved = pendulum_signals(lambda t, k: (1e-3 * s**k * np.exp(s * t)).imag, t)
        at = replace(moved, friction=torch.tensor([[viscous, 0.0, 0.0]], dtype=torch.float64))
        Z = INERTIA * s**2 + viscous * s + MASS * 9.81 * LENGTH
        more, errors = (-1e-3 * Z**2 / (Z + stiffness) * np.exp(s * t)).imag, []
        for link in (0.0, 1.0):
            shape = {"bandwidth": 1e4, "compliance": 1 / stiffness, "link_friction": link}
            (phi,) = JointElasticity().features(at, Site(0), shape).values()
            errors.append(float(np.abs(phi[0].numpy() / stiffness - more)[100:-100].max() / np.abs(more).max()))
        assert errors[1] < 1e-3 < 0.5 < errors[0]

    def test_model_files_that_know_no_friction_of_a_link(self) -> None:
        moved, one = pendulum_signals(motion(11, 0.6), np.arange(0, 4, 0.01)), torch.ones(1, dtype=torch.float64)
        of_motor = {"bandwidth": 6.0, "compliance": 0.0, "link_friction": 0.0}
        older = {name: of_motor[name] for name in ("bandwidth", "compliance")}
        (phi,), (same,) = (JointElasticity().features(moved, Site(0), s).values() for s in (of_motor, older))
        torch.testing.assert_close(phi, same, rtol=0.0, atol=0.0)
        assert JointElasticity().parameters(one, older)["link_friction"] == 0.0

    @pytest.mark.parametrize("seed", slow_but((12,), (12, 13)))
    def test_play_between_motor_and_link(self, seed: int) -> None:
        t, q, play = np.arange(0, 6, 0.001), motion(seed, 0.6), 0.004
        torque = two_masses(q, t, play, 5e4, damping=80.0)
        w, share = self.explained(Backlash(), {"flight": play, "link_friction": 0.0}, q, t, torque)
        assert share > 0.85
        assert w == pytest.approx(play, rel=0.2)
        # without the flight, sides change at once: that explains nothing
        at = pendulum_signals(q, t)
        at_once = at.deviating(0, -torch.sign(at.load[0]) / 2)
        left = band_limited(torque - at.load[0].numpy(), 1000.0)
        assert fitted(band_limited(at_once[0], 1000.0), left)[1] < 0.3


@pytest.mark.parametrize(
    "effect", [PreslidingHysteresis(), Backlash(), JointElasticity(), TimeDelay(), ActuatorLag()], ids=lambda e: e.id
)
def test_memory_needs_a_sequence(effect: Effect) -> None:
    q, qd, qdd = (torch.zeros(3, dtype=torch.float64) for _ in range(3))
    with pytest.raises(InputError, match="needs a sequence: give t"):
        effect.features(signals(q, qd, qdd), Site(1), effect.shapes(SCALE)[0])


def test_what_is_not_plausible() -> None:
    assert not PreslidingHysteresis().plausible({"coulomb": -1.0, "distance": 0.1}, SCALE)
    assert not JointElasticity().plausible({"stiffness": -100.0, "bandwidth": 6.0}, SCALE)
    assert Backlash().plausible({"backlash": 0.003, "flight": 0.002, "link_friction": 1.0}, SCALE)
    assert not Backlash().plausible({"backlash": -0.003, "flight": 0.002, "link_friction": 1.0}, SCALE)
    assert not Backlash().plausible({"backlash": 0.0003, "flight": 0.02, "link_friction": 1.0}, SCALE)
