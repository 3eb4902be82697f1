"""Friction at one joint: textbook values, limits, what is alike."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from effects.joint_torques import QD, SHARP, Q, rest, term, torque
from effects.sites import ROBOT, signals
from scipy.integrate import trapezoid

from torchrbd.effects import Signals, Site
from torchrbd.effects.coulomb_friction import AsymmetricCoulombFriction, CoulombFriction
from torchrbd.effects.position_dependent_friction import PositionDependentFriction
from torchrbd.effects.power_law_friction import PowerLawFriction
from torchrbd.effects.quadratic_drag import QuadraticDrag
from torchrbd.effects.signals import JointState
from torchrbd.effects.thermal_viscosity import ThermalViscosity
from torchrbd.effects.time_varying_friction import TimeVaryingFriction
from torchrbd.errors import InputError


class TestFriction:
    def test_friction_of_two_directions_is_what_resists_and_what_pushes(self) -> None:
        found = torque(AsymmetricCoulombFriction(), coulomb_plus=2.0, coulomb_minus=0.5)
        np.testing.assert_allclose(found, np.where(QD > 0, 2.0, -0.5), rtol=1e-12)
        q = torch.from_numpy(np.stack([Q] * ROBOT.n_dof))
        at = signals(q, torch.from_numpy(np.stack([QD] * ROBOT.n_dof)), torch.zeros_like(q))
        both = AsymmetricCoulombFriction().features(at, Site(0), {})
        assert tuple(both) == ("sign(qd)", "|sign(qd)|")
        resists, pushes = both.values()
        torch.testing.assert_close(resists, CoulombFriction().features(at, Site(0), {})["sign(qd)"])
        torch.testing.assert_close(pushes, resists.abs())

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

    @pytest.mark.parametrize("exponent", [0.5, 1.5])
    def test_power_law_has_a_slope_at_rest(self, exponent: float) -> None:
        qd = torch.zeros(ROBOT.n_dof, 4, dtype=torch.float64, requires_grad=True)
        at = signals(torch.zeros_like(qd), qd, torch.zeros_like(qd))
        term(PowerLawFriction(), Site(0), {"friction": 1.0, "exponent": exponent})(at).sum().backward()
        assert qd.grad is not None
        assert torch.isfinite(qd.grad).all()
        assert ((qd.grad[0] > 0) == (exponent < 1)).all()

    def test_power_law_above_one_is_what_it_is_however_soft_signs_are(self) -> None:
        at = JointState(*(torch.from_numpy(x) for x in (Q, QD, QD)), rest_width=0.2)
        (found,) = PowerLawFriction().joint_features(at, {"exponent": 1.5}).values()
        np.testing.assert_allclose(found, np.abs(QD) ** 1.5 * np.sign(QD), rtol=1e-12)

    def test_position_dependent(self) -> None:
        given = {"centre": 0.2, "width": 0.7, "profile": 0.0, "coulomb": 0.5, "coulomb_at_centre": 2.0}
        found = torque(PositionDependentFriction(), **given)
        np.testing.assert_allclose(found, np.sign(QD) * (0.5 + 1.5 * np.exp(-(((Q - 0.2) / 0.7) ** 2))), rtol=1e-12)
        assert found[2] == pytest.approx(2.0)
        far = torque(PositionDependentFriction(), **{**given, "width": 0.01})
        np.testing.assert_allclose(np.delete(far, 2), 0.5 * np.sign(np.delete(QD, 2)), rtol=1e-12)

    def test_a_cable_rubs_within_a_range(self) -> None:
        q = np.linspace(-3, 3, 601)
        given = {"centre": 0.5, "width": 1.0, "profile": 1.0, "coulomb": 0.3, "coulomb_at_centre": 2.0}
        found = torque(PositionDependentFriction(), q, np.full(601, -0.5), **given)
        np.testing.assert_allclose(found[np.abs(q - 0.5) < 0.5], -2.0, rtol=0.01)
        np.testing.assert_allclose(found[np.abs(q - 0.5) > 1.5], -0.3, atol=0.02)
        np.testing.assert_allclose(found[np.abs(np.abs(q - 0.5) - 1.0) < 1e-9], -1.15, rtol=1e-6)
        assert trapezoid(found, q) == pytest.approx(-0.3 * 6.0 - 1.7 * 2.0, rel=1e-6)

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
