"""Curves: what is believed of their values, and that values and coefficients are the same curve."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from effects.sites import ROBOT, signals

from torchrbd.effects import JointScale, Site
from torchrbd.effects.smooth_torque import SMOOTH, SmoothTorque

OVER_STATE = [e for e in SMOOTH if e.signal != "t" and not e.times_own]
ENDS = {"low": -1.0, "high": 1.0}


@pytest.mark.parametrize("effect", OVER_STATE, ids=lambda e: e.id)
def test_values_are_the_more_alike_the_closer_their_knots_are(effect: SmoothTorque) -> None:
    """The covariance of an Ornstein-Uhlenbeck process, by scipy's distances."""
    from scipy.spatial.distance import cdist

    x = np.linspace(-1.0, 1.0, effect.knots)[:, None]
    root = effect.at_knots(torch.eye(effect.knots, dtype=torch.float64)).numpy()
    np.testing.assert_allclose(root @ root.T, np.exp(-cdist(x, x)), atol=1e-12)


@pytest.mark.parametrize("effect", SMOOTH, ids=lambda e: e.id)
def test_parameters_are_the_values_at_the_knots(effect: SmoothTorque) -> None:
    ends = ENDS | ({"own_low": -1.0, "own_high": 1.0} if effect.times_own else {})
    w = torch.linspace(-1.0, 2.0, effect.knots, dtype=torch.float64)
    parameters = {name: float(v) for name, v in effect.parameters(w, ends).items()}
    back, shape = effect.coefficients(parameters)
    assert shape == ends
    np.testing.assert_allclose(back, w.numpy(), atol=1e-12)


def test_the_torque_is_that_of_the_curve() -> None:
    (effect,) = (e for e in OVER_STATE if e.id == "smooth_torque_over_q")
    y = np.random.default_rng(0).standard_normal(effect.knots)
    w, _ = effect.coefficients({f"value_{k + 1}": float(v) for k, v in enumerate(y)} | ENDS)
    q = torch.linspace(-1.3, 1.3, 41, dtype=torch.float64).expand(ROBOT.n_dof, -1)
    zero = torch.zeros_like(q)
    features = torch.stack([*effect.features(signals(q, zero, zero), Site(0), ENDS).values()])
    torque = torch.tensor(w, dtype=torch.float64) @ features
    expected = np.interp(q[0].numpy(), np.linspace(-1.0, 1.0, effect.knots), y)
    np.testing.assert_allclose(torque.numpy(), expected, atol=1e-12)
    curve = effect.curve(torch.tensor(w, dtype=torch.float64), ENDS, JointScale(3.0, 0.02))
    assert curve is not None
    np.testing.assert_allclose(curve.y.numpy(), np.interp(curve.x.numpy(), np.linspace(-1, 1, effect.knots), y))
