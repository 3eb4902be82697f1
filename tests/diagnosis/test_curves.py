"""Curves of findings: the function the effect has, a band that draws of the coefficients fill."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch
from effects.sites import ROBOT, SCALE, signals, site_of, states

from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis.curves import driven_by, fitted_curve
from torchrbd.effects import Site, effect, known_effects
from torchrbd.report.cards import _sense


def model(w: torch.Tensor, covariance: torch.Tensor) -> Any:
    columns = SimpleNamespace(robot=ROBOT, scale=lambda site: replace(SCALE, q_low=SCALE.q_low - (site.joint or 0)))
    return cast(Any, SimpleNamespace(columns=columns, coefficients=lambda _: (w, covariance)))


def term(identifier: str, site: Site, which: int = 0) -> Candidate:
    e = effect(identifier)
    return Candidate(e, site, e.shapes(SCALE)[which], ())


def test_band_is_the_scatter_of_draws() -> None:
    spring = term("joint_spring", Site(1))
    w, root = torch.tensor([2.0, -1.0]).double(), torch.tensor([[0.3, 0.0], [0.1, 0.2]]).double()
    curve = fitted_curve(model(w, root @ root.T), spring)
    assert curve is not None
    assert curve.signal == f"q_{ROBOT.joint_names[1]}"
    draws = w + torch.randn(20000, 2, generator=torch.Generator().manual_seed(1)).double() @ root.T
    x = torch.tensor([curve.at[0], curve.at[-1]]).double()
    scatter = (draws[:, :1] * x + draws[:, 1:]).std(0)
    np.testing.assert_allclose([curve.std[0], curve.std[-1]], scatter, rtol=0.03)
    np.testing.assert_allclose([curve.torque[0], curve.torque[-1]], w[0] * x + w[1], rtol=1e-5)


def test_a_coupling_runs_over_the_other_joint() -> None:
    site = Site(0, other=2)
    curve = fitted_curve(model(torch.tensor([1.0]).double(), torch.eye(1).double()), term("velocity_coupling", site))
    assert curve is not None
    other = ROBOT.joint_names[2]
    assert (curve.signal, driven_by(term("velocity_coupling", site), ROBOT)) == (f"qd_{other}", (f"qd_{other}",))
    position = fitted_curve(model(torch.ones(2).double(), torch.eye(2).double()), term("joint_coupling", site))
    assert position is not None
    assert (position.signal, position.at[0]) == (f"q_{other}", SCALE.q_low - 2)
    assert driven_by(term("joint_spring", Site(0)), ROBOT) == ()


def test_few_points_keep_a_step() -> None:
    curve = fitted_curve(model(torch.tensor([1.0]).double(), torch.eye(1).double()), term("coulomb_friction", Site(0)))
    assert curve is not None
    assert len(curve.at) < 300
    assert max(np.diff(curve.torque)) < 0.3
    assert np.all(np.diff(curve.at) > 0)


def test_what_acts_on_the_whole_robot_has_no_curve() -> None:
    assert fitted_curve(model(torch.ones(2).double(), torch.eye(2).double()), term("base_tilt", Site())) is None


@pytest.mark.parametrize("identifier", known_effects())
def test_data_is_drawn_only_where_the_curve_is_the_whole_torque(identifier: str) -> None:
    """A curve that is laid over data must be the term's torque at every sample, against the motion or not."""
    e = effect(identifier)
    site = site_of(e)
    if site.joint is None:
        return
    one = Candidate(e, site, (shapes := e.shapes(SCALE))[len(shapes) // 2], ())
    q, qd, qdd = states(400)
    phi = torch.stack(list(e.features(signals(q, qd, qdd), site, one.shape).values()))
    w = torch.linspace(1.0, 2.0, len(phi)).double()
    curve = fitted_curve(model(w, torch.eye(len(phi)).double()), one)
    sense = None if curve is None else _sense(identifier, curve)
    if curve is None or sense is None or not (np.diff(curve.at) >= 0).all():
        return
    key, at = curve.signal.partition("_")[0], site.joint if site.other is None else site.other
    values = {"q": q[at], "qd": qd[at], "qdd": qdd[at], "t": 0.01 * torch.arange(400).double()}
    if key not in values:
        return
    x, torque = values[key].numpy(), np.tensordot(w.numpy(), phi.numpy(), 1)
    torque = torque if torque.ndim == 1 else torque[site.joint]
    sign = np.sign(qd[site.joint].numpy()) if sense == "against the motion" else np.ones(400)
    inside = (x > curve.at[0]) & (x < curve.at[-1]) & (np.abs(qd[site.joint].numpy()) > 4 * SCALE.rest_width)
    assert inside.sum() > 20
    drawn = np.interp(x, curve.at, curve.torque) * sign
    np.testing.assert_allclose(drawn[inside], torque[inside], atol=0.03 * np.ptp(torque) + 1e-6)
