"""Effects that depend on the load: textbook values, what is alike, gradients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from effects.joint_torques import loaded, rest, term
from effects.sites import ROBOT, signals, states
from torch import Tensor
from torch.autograd import gradcheck

from torchrbd.effects import Effect, Signals, Site
from torchrbd.effects.load_dependent_friction import LoadDependentFriction
from torchrbd.effects.speed_dependent_loss import SpeedDependentLoss
from torchrbd.effects.torque_dead_zone import TorqueDeadZone, crossing
from torchrbd.effects.torque_saturation import TorqueSaturation
from torchrbd.effects.torque_scale import TorqueScale


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

    def test_the_command_of_a_dead_zone_is_what_the_zone_makes_the_load_of(self) -> None:
        at, load = loaded()
        w = 0.3 * float(np.abs(load[1]).max())
        command = load[1] + term(TorqueDeadZone(), Site(1), {"half_width": w})(at).detach().numpy()
        np.testing.assert_allclose(command - np.clip(command, -w, w), load[1], rtol=1e-9, atol=1e-9)

    def test_a_command_passes_through_its_zone_in_a_straight_line(self) -> None:
        """It leaves -0.5 at 1 + 5/9 and reaches 0.5 at 3 + 4/9, where the line through the samples is there."""
        x = torch.tensor([-2.0, -1.0, -0.1, 0.1, 1.0, 2.0, 0.4, 2.0, 0.2], dtype=torch.float64)
        expected = [-1.0, -1.0, -9.0 / 17.0, 9.0 / 17.0, 1.0, 1.0, 1.0, 1.0, 1.0]
        np.testing.assert_allclose(crossing(x, 0.5), expected, rtol=1e-12)
        np.testing.assert_allclose(crossing(-x.expand(2, -1), 0.5), [[-v for v in expected]] * 2, rtol=1e-12)
        np.testing.assert_array_equal(crossing(x, 0.0), torch.sign(x))

    def test_where_samples_are_no_sequence_the_sign_is_that_of_the_load(self) -> None:
        at, load = loaded()
        at = replace(at, t=None)
        (phi,) = TorqueDeadZone().features(at, Site(1), {"indistinct": 0.5 * float(np.abs(load[1]).max())}).values()
        np.testing.assert_array_equal(phi, np.sign(load[1]))

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
