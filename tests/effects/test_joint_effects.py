"""Springs, ripple and couplings, what physics forbids of any effect at a joint, and the curves that draw it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from effects.joint_torques import Q, term, torque
from effects.sites import ROBOT, SCALE, signals, states
from robot.random_robots import random_urdf

from torchrbd.effects import Effect, JointScale, Site
from torchrbd.effects import effect as effect_of
from torchrbd.effects.counterbalance import Counterbalance
from torchrbd.effects.joint_coupling import JointCoupling
from torchrbd.effects.joint_spring import JointSpring
from torchrbd.effects.load_dependent_friction import LoadDependentFriction
from torchrbd.effects.one_sided_spring import OneSidedSpring
from torchrbd.effects.position_dependent_friction import PositionDependentFriction
from torchrbd.effects.power_law_friction import PowerLawFriction
from torchrbd.effects.presliding_hysteresis import PreslidingHysteresis
from torchrbd.effects.quadratic_drag import QuadraticDrag
from torchrbd.effects.speed_dependent_loss import SpeedDependentLoss
from torchrbd.effects.thermal_viscosity import ThermalViscosity
from torchrbd.effects.time_varying_friction import TimeVaryingFriction
from torchrbd.effects.torque_dead_zone import TorqueDeadZone
from torchrbd.effects.torque_ripple import TorqueRipple
from torchrbd.effects.torque_saturation import TorqueSaturation
from torchrbd.effects.torque_scale import TorqueScale
from torchrbd.effects.velocity_coupling import VelocityCoupling
from torchrbd.robot import RobotModel


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


def test_a_spring_rests_within_the_range_of_its_joint() -> None:
    """Limits are the range where they are known, else three times what was covered; what was covered is in it."""

    def may_rest(at: float, **limits: float) -> bool:
        scale = JointScale(1.0, 0.01, -1.0, 0.5, **limits)
        return JointSpring().plausible({"stiffness": 2.0, "rest_position": at}, scale)

    assert [may_rest(at, lower=-3.0, upper=0.7) for at in (-3.1, -2.9, 0.6, 0.8)] == [False, True, True, False]
    assert [may_rest(at) for at in (-2.6, -2.4, 1.9, 2.1)] == [False, True, True, False]
    assert [may_rest(at, lower=0.0, upper=0.1) for at in (-1.1, -0.9, 0.4, 0.6)] == [False, True, True, False]


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
        (TorqueDeadZone(), {"half_width": 0.5}, {"half_width": -0.5}),
        (TimeVaryingFriction(), {"coulomb_end": 1, "coulomb_start": 0.5, "time_constant": 9}, {"coulomb_start": -0.1}),
        (TimeVaryingFriction(), {"coulomb_end": 1, "coulomb_start": 3.0, "time_constant": 9}, {"time_constant": -9}),
        (ThermalViscosity(), {"viscous_per_kelvin": 0.1}, {"viscous_per_kelvin": -0.1}),
        (
            PositionDependentFriction(),
            {"centre": 0, "width": 0.2, "profile": 0, "coulomb": 0, "coulomb_at_centre": 1},
            {"coulomb": -1},
        ),
        (
            PositionDependentFriction(),
            {"centre": 0, "width": 0.2, "profile": 0, "coulomb": 2, "coulomb_at_centre": 1},
            {"centre": 2.0},
        ),
        (
            PositionDependentFriction(),
            {"centre": 0, "width": 0.2, "profile": 0, "coulomb": 2, "coulomb_at_centre": 1},
            {"width": -0.2},
        ),
        (JointSpring(), {"stiffness": 2.0, "rest_position": 3.0}, {"stiffness": -2.0}),
        (JointSpring(), {"stiffness": 2.0, "rest_position": 3.0}, {"rest_position": 70.0}),
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
    "torque_dead_zone": ("load", {"half_width": 0.4}, lambda x: 0.4 * np.sign(x)),
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
