"""The torque that an actuator supplies, and effects on all of it, against direct simulations of a pendulum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from effects.sites import ROBOT, SCALE, signals, site_of, states
from effects.test_memory_effects import PENDULUM, motion, pendulum_signals
from scipy.signal import cont2discrete, lfilter
from torch.autograd import gradcheck

from torchrbd.effects import Signals, Site, Term, effect, known_effects
from torchrbd.effects.plain_friction import plain_friction

VISCOUS, COULOMB, OFFSET, WIDTH = 1.5, 3.0, 0.7, 0.05
FRICTION = torch.tensor([[0.3, 1.0, -0.4], [0.0, 2.0, 0.1], [0.7, 0.0, 0.0]], dtype=torch.float64)


def term(name: str, joint: int, *w: float, **shape: float) -> Term:
    return Term(effect(name), Site(joint), torch.tensor(w, dtype=torch.float64), shape)


def parts(*terms: Term) -> torch.Tensor:
    return plain_friction(ROBOT.n_dof, ((t.effect, t.site.joint, t.coefficients) for t in terms))


@pytest.mark.parametrize("name", [name for name, e in known_effects().items() if e.baseline])
def test_is_the_torque_of_the_terms_that_count(name: str) -> None:
    """Away from rest and where what an effect has beside Coulomb friction has died away."""
    far = {"stribeck_speed": 0.1, "time_constant": 1e-3, "centre": 50.0, "width": 0.1, "profile": 0.0}
    shape = {k: far[k] for k in effect(name).shapes(SCALE)[0]}
    one = term(name, 1, *(0.8, 0.3)[: len(effect(name).baseline)], **shape)
    q, qd, qdd = states(200)
    at = replace(signals(q, qd, qdd), friction=parts(one).detach())
    moving = (qd[1].abs() > 1.0) & (torch.arange(200) > 5)
    assert moving.any()
    torch.testing.assert_close(one(at)[moving], at.friction_torque[1][moving])
    assert not at.friction_torque[[0, 2]].any()


def test_terms_add_up_and_others_do_not_count() -> None:
    found = parts(
        term("viscous_friction", 0, 0.5),
        term("coulomb_friction", 0, 2.0),
        term("asymmetric_coulomb_friction", 0, 1.0, 0.5),
        term("torque_offset", 0, -0.25),
        term("rotor_inertia", 1, 9.0),
        term("joint_spring", 1, 9.0, 9.0),
        term("load_dependent_friction", 2, 0.3),
    )
    expected = [[0.5, 3.0, 0.25], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64))
    assert not plain_friction(2, ()).any()


def test_supplied_is_load_and_friction_at_every_joint() -> None:
    at = replace(signals(*states(3, 20)), friction=FRICTION)
    sign = torch.tanh(at.qd / 0.02)
    viscous, coulomb, offset = FRICTION.T[..., None, None]
    torch.testing.assert_close(at.supplied, at.load + viscous * at.qd + coulomb * sign + offset)
    for joint in range(ROBOT.n_dof):
        torch.testing.assert_close(at.joint(joint, load=True).supplied, at.supplied[joint])
        assert at.joint(joint).friction is None
    bare = signals(*states(3, 20))
    assert torch.equal(bare.supplied, bare.load)
    assert torch.equal(bare.joint(1, load=True).supplied, bare.load[1])


@pytest.mark.parametrize("name", known_effects())
def test_effects_that_see_friction_say_so(name: str) -> None:
    one, at = effect(name), signals(*states(40))
    site, shape = site_of(one), dict(one.shapes(SCALE)[-1])
    if "limit" in shape:
        shape["limit"] = 0.5 * float(at.load[site.joint].abs().max())
    before = one.features(at, site, shape).values()
    after = one.features(replace(at, friction=FRICTION), site, shape).values()
    seen = not all(torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert seen == one.sees_friction
    assert not seen or one.uses_load


@pytest.mark.parametrize("name", [name for name, one in known_effects().items() if one.sees_friction])
def test_gradients_by_friction_and_states(name: str) -> None:
    one, x = effect(name), tuple(v.requires_grad_() for v in states(6))
    site, shape = site_of(one), {k: 0.8 if k == "limit" else 0.013 for k in one.shapes(SCALE)[0]}

    def phi(friction: torch.Tensor, *x: torch.Tensor) -> torch.Tensor:
        (found,) = one.features(replace(signals(*x, rest_width=1.0), friction=friction), site, shape).values()
        return found

    assert gradcheck(phi, (FRICTION.clone().requires_grad_(), *x))


def with_friction(t: np.ndarray, late: float = 0.0) -> tuple[Signals, np.ndarray]:
    """Return signals of a pendulum, and the torque (N,) that its motion took so much earlier, friction included."""
    moved = motion(3, 1.0)
    at = pendulum_signals(moved, t)
    width = torch.tensor([WIDTH], dtype=torch.float64)
    at = replace(at, rest_width=width, friction=torch.tensor([[VISCOUS, COULOMB, OFFSET]], dtype=torch.float64))
    then = [torch.from_numpy(moved(t - late, k))[:, None] for k in range(3)]
    rigid, qd = PENDULUM.inverse_dynamics(*then)[:, 0].numpy(), moved(t - late, 1)
    return at, rigid + VISCOUS * qd + COULOMB * np.tanh(qd / WIDTH) + OFFSET


@pytest.mark.parametrize("delay", [0.0237, -0.011])
def test_a_delayed_torque_is_that_of_another_time_with_its_friction(delay: float) -> None:
    t = np.arange(0, 8, 0.002)
    at, late = with_friction(t, delay)
    (w,), shape = effect("time_delay").coefficients({"delay": delay, "step": delay})
    (phi,) = effect("time_delay").features(at, Site(0), shape).values()
    now = with_friction(t)[1]
    inner = slice(20, -20)
    assert np.abs(now - late)[inner].max() > COULOMB
    assert np.abs(now + w * phi[0].numpy() - late)[inner].max() < 0.01 * COULOMB


def test_a_lagging_actuators_command_has_friction_in_it() -> None:
    t, lag = np.arange(0, 6, 0.001), 0.02
    at, acting = with_friction(t)
    (phi,) = effect("actuator_lag").features(at, Site(0), {"bandwidth": 1e4}).values()
    command = acting + lag * phi[0].numpy()
    b, a, _ = cont2discrete(([1.0], [lag, 1.0]), 0.001, "foh")
    found = lfilter(b.ravel(), a, command)
    late = t > 0.5  # a filter that starts at rest has come in by then
    assert np.abs(found - acting)[late].max() < 0.01 * COULOMB


@pytest.mark.parametrize("slope", [-1.0, 0.8])
def test_a_torque_saturates_with_its_friction(slope: float) -> None:
    t = np.arange(0, 6, 0.01)
    at, tau = with_friction(t)
    limit = 0.6 * np.abs(tau).max()
    (phi,) = effect("torque_saturation").features(at, Site(0), {"limit": limit}).values()
    beyond = np.abs(tau) > limit
    expected = np.where(beyond, tau + slope * np.sign(tau) * (np.abs(tau) - limit), tau)
    assert beyond.any()
    np.testing.assert_allclose(tau + slope * phi.numpy(), expected, atol=1e-9)


def test_a_gain_of_friction_is_friction_again() -> None:
    """The gain comes out right, and friction as recorded: larger by it."""
    t, gain = np.arange(0, 8, 0.01), 1.25
    at, acting = with_friction(t)
    (load,) = effect("torque_scale").features(at, Site(0), {}).values()
    names = "viscous_friction", "coulomb_friction", "torque_offset"
    columns = [next(iter(effect(name).features(at, Site(0), {}).values())) for name in names]
    w, *_ = np.linalg.lstsq(torch.stack([load, *columns], -1).numpy(), gain * acting - load.numpy(), rcond=None)
    found = effect("torque_scale").parameters(torch.from_numpy(w[:1]), {})
    assert float(found["gain"]) == pytest.approx(gain, rel=1e-9)
    np.testing.assert_allclose(w[1:], gain * np.array([VISCOUS, COULOMB, OFFSET]), rtol=1e-9)
