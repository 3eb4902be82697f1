"""Effects of one joint: textbook values, limits, what physics forbids, grids of shapes, what is alike."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest
import torch
from physics.sites import ROBOT, SCALE, signals, states
from robot.random_robots import random_urdf
from scipy.integrate import trapezoid
from torch import Tensor
from torch.autograd import gradcheck

from torchrbd.errors import InputError
from torchrbd.physics import Effect, JointScale, Shape, Signals, Site, Term
from torchrbd.physics import effect as effect_of
from torchrbd.physics.cable_drag import CableDrag
from torchrbd.physics.counterbalance import Counterbalance
from torchrbd.physics.joint_coupling import JointCoupling
from torchrbd.physics.joint_elasticity import JointElasticity
from torchrbd.physics.load_dependent_friction import LoadDependentFriction
from torchrbd.physics.one_sided_spring import OneSidedSpring
from torchrbd.physics.position_dependent_friction import PositionDependentFriction
from torchrbd.physics.power_law_friction import PowerLawFriction
from torchrbd.physics.presliding_hysteresis import PreslidingHysteresis
from torchrbd.physics.quadratic_drag import QuadraticDrag
from torchrbd.physics.speed_dependent_loss import SpeedDependentLoss
from torchrbd.physics.thermal_viscosity import ThermalViscosity
from torchrbd.physics.time_varying_friction import TimeVaryingFriction
from torchrbd.physics.torque_ripple import TorqueRipple
from torchrbd.physics.torque_saturation import TorqueSaturation
from torchrbd.physics.torque_scale import TorqueScale
from torchrbd.physics.velocity_coupling import VelocityCoupling
from torchrbd.robot import RobotModel

Values = np.ndarray
SHARP = 1e-4
"""Rest width [rad/s] at which the sign of the velocities below is +-1."""
Q, QD = np.array([-1.2, -0.3, 0.2, 0.9, 1.4]), np.array([0.7, -1.1, 2.0, -0.4, 1.5])


def term(effect: Effect, site: Site, parameters: dict[str, float]) -> Term:
    w, shape = effect.coefficients(parameters)
    return Term(effect, site, torch.tensor(w, dtype=torch.float64), shape)


def torque(effect: Effect, q: Values = Q, qd: Values = QD, **parameters: float) -> Values:
    """Return the torque of an effect at joint 0, whose position and velocity are given; time runs in steps of 10 ms."""
    x = (torch.tensor(v, dtype=torch.float64).expand(ROBOT.n_dof, -1) for v in (q, qd, 0.0 * qd))
    return term(effect, Site(0), parameters)(signals(*x, rest_width=SHARP)).detach().numpy()


def loaded(seed: int = 3, n: int = 200) -> tuple[Signals, Values]:
    """Return signals of a robot in motion, and its torque by Pinocchio (n_dof, n)."""
    x = states(n, seed=seed)
    model = pinocchio.buildModelFromXML(ROBOT.urdf)
    data, order = model.createData(), [model.getJointId(name) - 1 for name in ROBOT.joint_names]
    tau = np.zeros((ROBOT.n_dof, n))
    for k in range(n):
        state = np.zeros((3, model.nv))
        state[:, order] = np.stack([v[:, k].numpy() for v in x])
        tau[:, k] = pinocchio.rnea(model, data, *state)[order]
    return signals(*x, rest_width=SHARP), tau


class TestFriction:
    def test_quadratic_drag(self) -> None:
        np.testing.assert_allclose(torque(QuadraticDrag(), drag=0.3), 0.3 * QD**2 * np.sign(QD), rtol=1e-12)

    @pytest.mark.parametrize("exponent", [0.5, 1.3, 1.9])
    def test_power_law(self, exponent: float) -> None:
        found = torque(PowerLawFriction(), friction=0.3, exponent=exponent)
        np.testing.assert_allclose(found, 0.3 * np.abs(QD) ** exponent * np.sign(QD), rtol=1e-6)

    def test_power_law_lies_between_its_neighbours(self) -> None:
        ends = (0.3 * np.sign(QD), 0.3 * QD, 0.3 * QD * np.abs(QD))
        for exponent, end in zip((0.0, 1.0, 2.0), ends, strict=True):
            np.testing.assert_allclose(torque(PowerLawFriction(), friction=0.3, exponent=exponent), end, rtol=1e-6)

    def test_power_law_has_a_slope_at_rest(self) -> None:
        qd = torch.zeros(ROBOT.n_dof, 4, dtype=torch.float64, requires_grad=True)
        at = signals(torch.zeros_like(qd), qd, torch.zeros_like(qd))
        term(PowerLawFriction(), Site(0), {"friction": 1.0, "exponent": 0.5})(at).sum().backward()
        assert qd.grad is not None
        assert torch.isfinite(qd.grad).all()
        assert (qd.grad[0] > 0).all()

    def test_position_dependent(self) -> None:
        given = {"centre": 0.2, "width": 0.7, "coulomb": 0.5, "coulomb_at_centre": 2.0}
        found = torque(PositionDependentFriction(), **given)
        np.testing.assert_allclose(found, np.sign(QD) * (0.5 + 1.5 * np.exp(-(((Q - 0.2) / 0.7) ** 2))), rtol=1e-12)
        assert found[2] == pytest.approx(2.0)
        far = torque(PositionDependentFriction(), **{**given, "width": 0.01})
        np.testing.assert_allclose(np.delete(far, 2), 0.5 * np.sign(np.delete(QD, 2)), rtol=1e-12)

    def test_cable_drag(self) -> None:
        q = np.linspace(-3, 3, 601)
        found = torque(CableDrag(), q, np.full(601, -0.5), start=-1.0, end=1.0, resistance=2.0)
        np.testing.assert_allclose(found[np.abs(q) < 0.5], -2.0, rtol=0.01)
        np.testing.assert_allclose(found[np.abs(q) > 1.5], 0.0, atol=0.02)
        np.testing.assert_allclose(found[np.abs(np.abs(q) - 1.0) < 1e-9], -1.0, rtol=1e-6)
        assert trapezoid(found, q) == pytest.approx(-2.0 * 2.0, rel=1e-6)

    def test_time_varying(self) -> None:
        qd = np.where(np.arange(400) % 2, 1.0, -1.0)
        given = {"coulomb_end": 1.0, "coulomb_start": 3.0, "time_constant": 0.25}
        found, t = torque(TimeVaryingFriction(), 0 * qd, qd, **given), 0.01 * np.arange(400)
        np.testing.assert_allclose(found, qd * (1.0 + 2.0 * np.exp(-t / 0.25)), rtol=1e-12)
        assert found[0] == pytest.approx(-3.0)
        assert found[-1] == pytest.approx(1.0, rel=1e-6)

    def test_time_varying_needs_time(self) -> None:
        with pytest.raises(InputError, match="depends on time needs t"):
            term(TimeVaryingFriction(), Site(0), dict.fromkeys(TimeVaryingFriction.units, 1.0))(
                signals(*torch.zeros(3, ROBOT.n_dof, dtype=torch.float64))
            )

    def test_thermal(self) -> None:
        expected = 0.02 * (40.0 - (30.0 + 5.0 * Q)) * QD
        np.testing.assert_allclose(torque(ThermalViscosity(), viscous_per_kelvin=0.02), expected, rtol=1e-12)

    def test_thermal_is_zero_where_no_temperature_is_recorded(self) -> None:
        x = torch.ones(ROBOT.n_dof, dtype=torch.float64)
        assert not term(ThermalViscosity(), Site(0), {"viscous_per_kelvin": 1.0})(signals(x, x, x)).any()

    @pytest.mark.parametrize("rate", [0.02, 0.05])
    def test_thermal_and_viscous_friction_follow_the_exponential_law(self, rate: float) -> None:
        t = np.linspace(0, 1, 4000)
        warm, qd = 25.0 + 20.0 * t, np.sin(300 * t) * (1 + 0.3 * np.sin(17 * t))
        x = torch.tensor(qd).expand(ROBOT.n_dof, -1)
        temperature = torch.tensor(warm).expand(ROBOT.n_dof, -1)
        at = Signals(ROBOT, x, x, x, torch.full((ROBOT.n_dof,), SHARP), temperature=temperature)
        (thermal,) = ThermalViscosity().features(at, Site(0), {}).values()
        tau = np.exp(-rate * (warm - 40.0)) * qd
        assert np.linalg.norm(rest(tau, np.stack([qd, thermal.numpy()], -1))) < 0.04 * np.linalg.norm(tau)


class TestSprings:
    @pytest.mark.parametrize("side", [1.0, -1.0])
    def test_one_sided(self, side: float) -> None:
        found = torque(OneSidedSpring(), contact_position=0.2, side=side, stiffness=3.0)
        pushed = Q > 0.2 if side > 0 else Q < 0.2
        np.testing.assert_allclose(found, np.where(pushed, 3.0 * (Q - 0.2), 0.0), atol=1e-12)
        assert (found * (Q - 0.2) >= 0).all()

    def test_both_sides_are_a_joint_spring(self) -> None:
        both = sum(torque(OneSidedSpring(), contact_position=0.2, side=s, stiffness=3.0) for s in (1.0, -1.0))
        np.testing.assert_allclose(both, 3.0 * (Q - 0.2), rtol=1e-12)

    @pytest.mark.parametrize(("k", "rest_length", "force"), [(800.0, 0.3, 0.0), (0.0, 0.0, -150.0), (500.0, 0.4, 60.0)])
    def test_counterbalance_is_the_slope_of_the_energy_in_the_cylinder(
        self, k: float, rest_length: float, force: float
    ) -> None:
        a, b, centre = 0.15, 0.5, 0.4
        q = torch.tensor(Q, requires_grad=True)
        pin = a * torch.stack((torch.cos(q - centre), torch.sin(q - centre)))
        length = torch.linalg.norm(pin - torch.tensor([[b], [0.0]], dtype=torch.float64), dim=0)
        (force * length + 0.5 * k * (length - rest_length) ** 2).sum().backward()
        found = torque(
            Counterbalance(),
            spring_torque=k * a * b,
            force_torque=(force - k * rest_length) * a,
            dead_centre=centre,
            crank_ratio=a / b,
        )
        assert q.grad is not None
        np.testing.assert_allclose(found, q.grad.numpy(), rtol=1e-9)

    def test_counterbalance_without_harmonics_is_gravity(self) -> None:
        """A spring of zero free length balances a weight in all positions."""
        weight = {"spring_torque": 12.0, "force_torque": 0.0, "dead_centre": np.pi, "crank_ratio": 0.5}
        np.testing.assert_allclose(torque(Counterbalance(), **weight), -12.0 * np.sin(Q), rtol=1e-9)

    def test_counterbalance_sits_at_revolute_joints(self) -> None:
        robot = RobotModel.from_urdf(random_urdf(2, 6))
        sites = [site.joint for site in Counterbalance().sites(robot)]
        assert 0 < len(sites) < robot.n_dof
        assert sites == [j for j in range(robot.n_dof) if not robot.prismatic[j]]

    def test_ripple(self) -> None:
        found = torque(TorqueRipple(), amplitude=0.4, phase=-2.5, order=17.5)
        np.testing.assert_allclose(found, 0.4 * np.sin(17.5 * Q - 2.5), rtol=1e-12)

    def test_ripple_has_a_positive_amplitude_and_a_phase_within_a_turn(self) -> None:
        for w in ([0.3, 0.4], [-0.3, 0.4], [-0.3, -0.4]):
            found = TorqueRipple().parameters(torch.tensor(w, dtype=torch.float64), {"order": 3.0})
            amplitude, phase = float(found["amplitude"]), float(found["phase"])
            assert amplitude == pytest.approx(0.5)
            np.testing.assert_allclose(amplitude * np.exp(1j * phase), complex(*w), rtol=1e-12)


class TestLoad:
    """The load is what Pinocchio says of the URDF's rigid body."""

    def test_values(self) -> None:
        at, load = loaded()
        qd = at.qd.numpy()
        for j in range(ROBOT.n_dof):
            for effect, given, expected in (
                (LoadDependentFriction(), {"load_friction": 0.1}, 0.1 * np.abs(load[j]) * np.sign(qd[j])),
                (SpeedDependentLoss(), {"loss": 0.1}, 0.1 * np.abs(load[j]) * qd[j]),
                (TorqueScale(), {"gain": 1.2}, 0.2 * load[j]),
            ):
                np.testing.assert_allclose(term(effect, Site(j), given)(at).detach(), expected, rtol=1e-9, atol=1e-9)

    def test_slope_minus_one_clips_the_torque(self) -> None:
        at, load = loaded()
        limit = 0.5 * float(np.abs(load[1]).max())
        added = term(TorqueSaturation(), Site(1), {"limit": limit, "slope": -1.0})(at).detach().numpy()
        np.testing.assert_allclose(load[1] + added, np.clip(load[1], -limit, limit), rtol=1e-9, atol=1e-9)
        assert (added != 0).any()

    def test_no_saturation_below_the_limit(self) -> None:
        at, load = loaded()
        limit = 1.01 * float(np.abs(load[1]).max())
        assert not term(TorqueSaturation(), Site(1), {"limit": limit, "slope": 0.5})(at).detach().any()

    def test_gear_efficiency_is_load_friction_and_a_gain(self) -> None:
        """Supply load / eta to drive, eta load when driven: the mean loss is friction, half their difference a gain."""
        at, load = loaded()
        eta, qd = 0.8, at.qd[1].numpy()
        extra = np.where(load[1] * qd > 0, load[1] / eta, eta * load[1]) - load[1]
        drive, driven = 1 / eta - 1, 1 - eta
        friction = term(LoadDependentFriction(), Site(1), {"load_friction": (drive + driven) / 2})(at)
        gain = term(TorqueScale(), Site(1), {"gain": 1 + (drive - driven) / 2})(at)
        np.testing.assert_allclose((friction + gain).detach().numpy(), extra, atol=1e-9 * np.abs(load[1]).max())

    def test_one_gain_of_all_joints_is_a_gain_of_inertias_and_that_of_one_joint_is_not(self) -> None:
        at = signals(*states(300, seed=4))
        Y = ROBOT.regressor(*(x.T for x in (at.q, at.qd, at.qdd))).numpy()
        gains = [TorqueScale().features(at, Site(j), {})["load"].numpy() for j in range(ROBOT.n_dof)]
        alone = [np.where(np.arange(ROBOT.n_dof) == j, load[:, None], 0.0) for j, load in enumerate(gains)]
        left = [
            np.linalg.norm(rest(tau.ravel(), Y.reshape(-1, Y.shape[-1]))) / np.linalg.norm(tau)
            for tau in (np.stack(gains, -1), *alone)
        ]
        assert left[0] < 1e-9
        assert min(left[1:]) > 1e-3

    @pytest.mark.parametrize(
        ("effect", "given"),
        [
            (LoadDependentFriction(), {"load_friction": 0.1}),
            (SpeedDependentLoss(), {"loss": 0.1}),
            (TorqueScale(), {"gain": 1.2}),
            (TorqueSaturation(), {"limit": 0.5, "slope": 0.3}),
        ],
    )
    def test_gradients_reach_the_inertial_parameters(self, effect: Effect, given: dict[str, float]) -> None:
        x, there = states(5), term(effect, Site(1), given)

        def added(pi: Tensor) -> Tensor:
            return there(Signals(ROBOT, *x, torch.full((ROBOT.n_dof,), 0.02), pi))

        assert added(ROBOT.pi).abs().max() > 0
        assert gradcheck(added, ROBOT.pi.clone().requires_grad_())


class TestPairsOfJoints:
    def test_all_ordered_pairs(self) -> None:
        for effect in (JointCoupling(), VelocityCoupling()):
            pairs = [(s.joint, s.other) for s in effect.sites(ROBOT)]
            assert sorted(pairs) == [(i, j) for i in range(ROBOT.n_dof) for j in range(ROBOT.n_dof) if i != j]

    def test_a_spring_between_two_joints_couples_both_alike(self) -> None:
        """Energy 1/2 k (q_1 + q_2 - c)^2: at joint 1 a spring of its own, and k q_2 - k c."""
        k, c, x = 3.0, 0.4, states(30)
        q = x[0].clone().requires_grad_()
        (0.5 * k * (q[0] + q[1] - c) ** 2).sum().backward()
        assert q.grad is not None
        for joint, other in ((0, 1), (1, 0)):
            given = {"stiffness": k, "offset": -k * c}
            added = term(JointCoupling(), Site(joint, other=other), given)(signals(*x)).detach()
            np.testing.assert_allclose(added + k * x[0][joint], q.grad[joint], rtol=1e-9, atol=1e-12)

    def test_a_differential_wrist_couples_velocities(self) -> None:
        """Motors at q_0 + q_1 and q_0 - q_1 with viscous friction d_a, d_b: B' diag(d) B qd."""
        x, d = states(30), np.array([0.7, 0.2])
        B = np.array([[1.0, 1.0], [1.0, -1.0]])
        expected = B.T @ np.diag(d) @ B @ x[1][:2].numpy()
        for joint, other in ((0, 1), (1, 0)):
            added = term(VelocityCoupling(), Site(joint, other=other), {"viscous": d[0] - d[1]})(signals(*x)).detach()
            np.testing.assert_allclose(added + d.sum() * x[1][joint], expected[joint], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("effect", "good", "bad"),
    [
        (QuadraticDrag(), {"drag": 1.0}, {"drag": -0.1}),
        (PowerLawFriction(), {"friction": 1.0, "exponent": 0.5}, {"friction": -0.1}),
        (PowerLawFriction(), {"friction": 1.0, "exponent": 0.5}, {"exponent": -0.5}),
        (PowerLawFriction(), {"friction": 1.0, "exponent": 1.5}, {"exponent": 2.5}),
        (LoadDependentFriction(), {"load_friction": 0.1}, {"load_friction": -0.1}),
        (SpeedDependentLoss(), {"loss": 0.1}, {"loss": -0.1}),
        (TorqueScale(), {"gain": 0.9}, {"gain": -1.0}),
        (TorqueSaturation(), {"limit": 3.0, "slope": -1.0}, {"slope": -1.5}),
        (TorqueSaturation(), {"limit": 3.0, "slope": 0.5}, {"limit": -3.0}),
        (TimeVaryingFriction(), {"coulomb_end": 1, "coulomb_start": 0.5, "time_constant": 9}, {"coulomb_start": -0.1}),
        (TimeVaryingFriction(), {"coulomb_end": 1, "coulomb_start": 3.0, "time_constant": 9}, {"time_constant": -9}),
        (ThermalViscosity(), {"viscous_per_kelvin": 0.1}, {"viscous_per_kelvin": -0.1}),
        (
            PositionDependentFriction(),
            {"centre": 0, "width": 0.2, "coulomb": 0, "coulomb_at_centre": 1},
            {"coulomb": -1},
        ),
        (
            PositionDependentFriction(),
            {"centre": 0, "width": 0.2, "coulomb": 2, "coulomb_at_centre": 1},
            {"centre": 2.0},
        ),
        (
            PositionDependentFriction(),
            {"centre": 0, "width": 0.2, "coulomb": 2, "coulomb_at_centre": 1},
            {"width": -0.2},
        ),
        (CableDrag(), {"start": -1.0, "end": 0.5, "resistance": 1.0}, {"resistance": -1.0}),
        (CableDrag(), {"start": -1.0, "end": 0.5, "resistance": 1.0}, {"end": -1.2}),
        (CableDrag(), {"start": -1.0, "end": 2.5, "resistance": 1.0}, {"start": 1.8}),
        (OneSidedSpring(), {"contact_position": 0.0, "side": -1.0, "stiffness": 2.0}, {"stiffness": -2.0}),
        (OneSidedSpring(), {"contact_position": 0.0, "side": 1.0, "stiffness": 2.0}, {"contact_position": 1.6}),
        (TorqueRipple(), {"amplitude": 1.0, "phase": 0.0, "order": 2.0}, {"order": 1.0}),
        (
            Counterbalance(),
            {"spring_torque": 1.0, "force_torque": -3.0, "dead_centre": 0.0, "crank_ratio": 0.5},
            {"spring_torque": -1.0},
        ),
        (
            Counterbalance(),
            {"spring_torque": 0.0, "force_torque": 3.0, "dead_centre": 0.0, "crank_ratio": 0.5},
            {"crank_ratio": 1.2},
        ),
    ],
)
def test_what_physics_forbids(effect: Effect, good: dict[str, float], bad: dict[str, float]) -> None:
    assert effect.plausible(good, SCALE)
    assert not effect.plausible({**good, **bad}, SCALE)


CURVES = {
    "viscous_friction": ("qd", {"viscous": 0.7}, lambda x: 0.7 * x),
    "quadratic_drag": ("qd", {"drag": 0.7}, lambda x: 0.7 * x * np.abs(x)),
    "rotor_inertia": ("qdd", {"rotor_inertia": 0.3}, lambda x: 0.3 * x),
    "joint_spring": ("q", {"stiffness": 3.0, "rest_position": 0.2}, lambda x: 3.0 * (x - 0.2)),
    "torque_ripple": ("q", {"amplitude": 0.4, "phase": 0.1, "order": 9.0}, lambda x: 0.4 * np.sin(9 * x + 0.1)),
    "load_dependent_friction": ("load", {"load_friction": 0.1}, lambda x: 0.1 * np.abs(x)),
    "torque_scale": ("load", {"gain": 1.2}, lambda x: 0.2 * x),
    "torque_saturation": ("load", {"limit": 2.0, "slope": -1.0}, lambda x: np.clip(x, -2, 2) - x),
    "speed_dependent_loss": ("qd", {"loss": 0.1}, lambda x: 0.1 * SCALE.load_max * x),
    "thermal_viscosity": ("temperature", {"viscous_per_kelvin": 0.1}, lambda x: -0.1 * (x - 40) * SCALE.speed_max),
    "time_varying_friction": (
        "t",
        {"coulomb_end": 1.0, "coulomb_start": 3.0, "time_constant": 5.0},
        lambda x: 1 + 2 * np.exp(-x / 5),
    ),
    "joint_coupling": ("q_other", {"stiffness": -3.0, "offset": 0.2}, lambda x: -3.0 * x + 0.2),
    "velocity_coupling": ("qd_other", {"viscous": -3.0}, lambda x: -3.0 * x),
}


@pytest.mark.parametrize("name", CURVES)
def test_curves(name: str) -> None:
    signal, given, function = CURVES[name]
    w, shape = effect_of(name).coefficients(given)
    curve = effect_of(name).curve(torch.tensor(w, dtype=torch.float64), shape, SCALE)
    assert curve is not None
    assert curve.signal == signal
    np.testing.assert_allclose(curve.y, function(curve.x.numpy()), atol=1e-9)


def test_curves_over_signals_of_unknown_range_are_not_drawn() -> None:
    bare, w = JointScale(1.0, 0.01), torch.ones(1, dtype=torch.float64)
    for effect in (TorqueScale(), SpeedDependentLoss(), LoadDependentFriction(), ThermalViscosity()):
        assert effect.curve(w, {}, bare) is None


def test_curve_of_presliding_is_a_closed_loop_of_both_directions() -> None:
    curve = PreslidingHysteresis().curve(torch.tensor([2.0], dtype=torch.float64), {"distance": 0.01}, SCALE)
    assert curve is not None
    assert float(curve.y.max()) == pytest.approx(2.0, rel=0.01)
    assert float(curve.y.min()) == pytest.approx(-2.0, rel=0.01)
    assert abs(float(curve.x[-1] - curve.x[0])) < 1e-3
    assert abs(float(curve.y[-1] - curve.y[0])) < 0.05


SHAPED = (
    PowerLawFriction(),
    TimeVaryingFriction(),
    PositionDependentFriction(),
    CableDrag(),
    OneSidedSpring(),
    TorqueRipple(),
    Counterbalance(),
    TorqueSaturation(),
)


def rest(tau: Values, X: Values) -> Values:
    """Return what least squares with columns X (N, K) leaves of tau (N,)."""
    U, S, _ = np.linalg.svd(X, full_matrices=False)
    U = U[:, S / S[0] > 1e-10]
    return tau - U @ (U.T @ tau)


def matrix(effect: Effect, at: Signals, shape: Shape) -> Values:
    return torch.stack([*effect.features(at, Site(1), shape).values()], -1).numpy()


def motion(seed: int, n: int = 900) -> tuple[Signals, JointScale]:
    """Return a minute of motion that never repeats, and what it covers at joint 1, about 3 rad."""
    rng, t = np.random.default_rng(seed), np.linspace(0, 60, n)
    shape = (ROBOT.n_dof, 6, 1)
    omega, phase = 2 * np.pi * rng.uniform(0.05, 0.4, shape), rng.uniform(0, 6, shape)
    size = rng.uniform(0.3, 1.0, shape) / omega**0.5
    x = [(size * omega**k * np.sin(omega * t + phase + k * np.pi / 2)).sum(1) for k in range(3)]
    q, qd, qdd = (torch.from_numpy(v * (3.0 / np.ptp(x[0], axis=1))[:, None]) for v in x)
    fastest = float(qd[1].abs().max())
    width = torch.full((ROBOT.n_dof,), 2e-3 * fastest, dtype=torch.float64)
    at = Signals(ROBOT, q, qd, qdd, width, t=torch.from_numpy(t))
    load = float(at.load[1].abs().max())
    return at, JointScale(fastest, 2e-3 * fastest, float(q[1].min()), float(q[1].max()), load, float(t[-1]))


def drawn(effect: Effect, scale: JointScale, rng: np.random.Generator) -> dict[str, float]:
    """Draw parameters whose shapes lie anywhere in what the grid is made for."""
    span, low, load = scale.q_high - scale.q_low, scale.q_low, scale.load_max
    assert load is not None
    part = float(np.exp(rng.uniform(np.log(0.12), np.log(0.6))))
    match effect.id:
        case "power_law_friction":
            return {"friction": 1.0, "exponent": rng.choice([rng.uniform(0.25, 0.85), rng.uniform(1.15, 1.8)])}
        case "time_varying_friction":
            return {"coulomb_end": 1.0, "coulomb_start": 2.0, "time_constant": scale.duration_s * 0.02 ** rng.uniform()}
        case "position_dependent_friction":
            centre = rng.uniform(low, low + span)
            return {"centre": centre, "width": 0.6 * part * span, "coulomb": 1.0, "coulomb_at_centre": 2.0}
        case "cable_drag":
            start = low + rng.uniform(0, 1 - part) * span
            return {"start": start, "end": start + part * span, "resistance": 1.0}
        case "one_sided_spring":
            side = rng.choice([-1.0, 1.0])
            contact = scale.q_high - part * span if side > 0 else low + part * span
            return {"contact_position": contact, "side": side, "stiffness": 1.0}
        case "torque_ripple":
            return {"amplitude": 1.0, "phase": rng.uniform(-3, 3), "order": rng.uniform(3, 40)}
        case "counterbalance":
            spring, force, centre = rng.uniform(0, 2), rng.uniform(-2, 2), rng.uniform(-np.pi, np.pi)
            ratio = rng.uniform(0.2, 0.85)
            return {"spring_torque": spring, "force_torque": force, "dead_centre": centre, "crank_ratio": ratio}
        case _:
            return {"limit": rng.uniform(0.4, 0.9) * load, "slope": 1.0}


@pytest.mark.parametrize("effect", SHAPED, ids=lambda e: e.id)
class TestGrids:
    def test_some_shape_on_the_grid_shows_most_of_any_other(self, effect: Effect) -> None:
        """Of what viscous and Coulomb friction leave, a quarter of the power is lost at most, for nearly all truths."""
        rng, caught = np.random.default_rng(77), []
        for seed in (101, 102):
            at, scale = motion(seed)
            friction = np.stack([at.qd[1].numpy(), at.joint(1).direction().numpy()], -1)
            grid = [np.hstack([friction, matrix(effect, at, shape)]) for shape in effect.shapes(scale)]
            bases = [np.linalg.svd(X, full_matrices=False)[:2] for X in grid]
            for _ in range(40):
                w, shape = effect.coefficients(drawn(effect, scale, rng))
                tau = rest(matrix(effect, at, shape) @ np.array(w), friction)
                seen = max(np.linalg.norm(U[:, S / S[0] > 1e-10].T @ tau) for U, S in bases)
                caught.append(seen / np.linalg.norm(tau))
        assert np.quantile(caught, 0.1) > 0.75**0.5
        assert min(caught) > 0.75

    def test_shapes_are_distinct_and_few(self, effect: Effect) -> None:
        shapes = effect.shapes(SCALE)
        assert 2 <= len(shapes) <= 128
        assert len({tuple(shape.items()) for shape in shapes}) == len(shapes)
        at, _ = motion(103)
        labels = [tuple(effect.features(at, Site(1), shape)) for shape in shapes]
        assert len(set(labels)) == len(shapes)

    def test_shapes_are_plausible(self, effect: Effect) -> None:
        for shape in effect.shapes(SCALE):
            w = torch.ones(len(effect.units) - len(shape), dtype=torch.float64)
            found = effect.parameters(w, shape)
            assert effect.plausible({name: float(v) for name, v in found.items()}, SCALE)


@pytest.mark.parametrize(
    "effect", [PositionDependentFriction(), CableDrag(), OneSidedSpring(), TorqueRipple()], ids=lambda e: e.id
)
def test_a_joint_that_stands_still_has_no_shapes(effect: Effect) -> None:
    assert effect.shapes(JointScale(1e-3, 1e-4, 0.3, 0.3)) == ()


def test_saturation_is_sought_below_the_largest_load() -> None:
    known, unknown = JointScale(1.0, 0.01, load_max=40.0), JointScale(1.0, 0.01)
    limits = [shape["limit"] for shape in TorqueSaturation().shapes(known)]
    np.testing.assert_allclose(limits, 40.0 * np.linspace(0.35, 0.88, 4))
    assert not TorqueSaturation().plausible({"limit": 41.0, "slope": 1.0}, known)
    assert TorqueSaturation().plausible({"limit": 41.0, "slope": 1.0}, unknown)
    # The estimate of a reading that is clipped, with its error.
    assert TorqueSaturation().plausible({"limit": 20.0, "slope": -1.02}, known)
    assert TorqueSaturation().shapes(JointScale(1.0, 0.01, load_max=0.0)) == ()


def test_time_constants_go_with_the_recordings_length() -> None:
    short, long = (
        [shape["time_constant"] for shape in TimeVaryingFriction().shapes(JointScale(1.0, 0.01, duration_s=d))]
        for d in (30.0, 600.0)
    )
    assert max(short) == 30.0
    np.testing.assert_allclose(long, 20 * np.array(short))
    given = {"coulomb_end": 1.0, "coulomb_start": 2.0, "time_constant": 500.0}
    assert not TimeVaryingFriction().plausible(given, JointScale(1.0, 0.01, duration_s=30.0))
    assert TimeVaryingFriction().plausible(given, JointScale(1.0, 0.01, duration_s=600.0))


def test_a_spring_that_yields_further_than_it_can_tell_is_not_plausible() -> None:
    scale = JointScale(1.0, 0.01, load_max=40.0)
    assert JointElasticity().plausible({"stiffness": 1000.0, "bandwidth": 6.0}, scale)
    assert not JointElasticity().plausible({"stiffness": 100.0, "bandwidth": 6.0}, scale)


def test_centres_of_a_counterbalance_cover_the_turn_and_are_closer_in_the_range_of_motion() -> None:
    for low, high in ((-0.1, 2.0), (-3.0, 3.0), (-4.0, 5.0), (0.2, 0.2)):
        shapes = Counterbalance().shapes(JointScale(1.0, 0.01, low, high))
        for ratio in {shape["crank_ratio"] for shape in shapes}:
            own = np.sort([s["dead_centre"] for s in shapes if s["crank_ratio"] == ratio])
            gaps = np.diff(own, append=own[0] + 2 * np.pi)
            assert 0.05 < gaps.min() <= gaps.max() < 0.45
    closest = np.diff(np.sort([s["dead_centre"] for s in Counterbalance().shapes(SCALE) if s["crank_ratio"] > 0.6]))
    assert closest.min() < 0.7 * closest.max()


def test_ripple_has_whole_orders_on_its_grid() -> None:
    orders = [shape["order"] for shape in TorqueRipple().shapes(JointScale(1.0, 0.01, -3.0, 3.0))]
    assert orders[:3] == [2.0, 3.0, 4.0]
    assert {30.0, 50.0, 100.0, 200.0} <= set(orders)
    narrow = [shape["order"] for shape in TorqueRipple().shapes(JointScale(1.0, 0.01, 0.0, 0.3))]
    assert min(narrow) * 0.3 >= 2 * np.pi
    assert narrow[1] - narrow[0] == pytest.approx(np.pi / 0.3)
