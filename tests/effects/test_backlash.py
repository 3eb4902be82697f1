"""A play of a gear: flights between its sides against exact solutions, friction that holds, gradients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from effects.sites import ROBOT, signals, states
from torch import Tensor
from torch.autograd import forward_ad, gradcheck

from torchrbd._runtime.compiling import library
from torchrbd.effects import Site
from torchrbd.effects.backlash import COMPILED, Backlash, deviation


def free(load: Tensor, inertia: Tensor, dt: float, play: float) -> Tensor:
    """Return the deviation of a link without friction."""
    still = torch.zeros_like(load)
    return deviation(load, alone(inertia), (still, still, still), load.new_zeros(3), dt, play)[0]


def alone(inertia: Tensor) -> Tensor:
    """Return the slopes of a load that inertia alone makes."""
    return torch.stack((0.0 * inertia, 0.0 * inertia, inertia))


class TestBacklashFlight:
    def test_takes_the_time_that_the_load_gives(self) -> None:
        """A load -r t from its zero on pushes by r t / M: a play b takes (6 M b / r)^(1/3)."""
        t = torch.arange(-200, 400, dtype=torch.float64) * 1e-3
        x = free(-5.0 * t, torch.full_like(t, 0.4), 1e-3, 0.01)
        flight = (6 * 0.4 * 0.01 / 5.0) ** (1 / 3)
        np.testing.assert_allclose(x[t < 0].numpy(), -0.005)
        flying = (t > 2e-3) & (t < flight - 1e-3)
        np.testing.assert_allclose(x[flying].numpy(), -0.005 + 5.0 / (6 * 0.4) * t[flying].numpy() ** 3, atol=3e-5)
        np.testing.assert_allclose(x[t > flight + 2e-3].numpy(), 0.005)

    def test_a_link_that_hangs_swings_in_its_play(self) -> None:
        """M x" + A x = r t from x = -b/2 on: x + b/2 = r/A (t - sin(w t) / w), w^2 = A/M."""
        M, A, r, play, dt = 0.06, 2.4, 3.0, 0.03, 1e-3
        t = dt * torch.arange(-200, 400, dtype=torch.float64)
        slopes = torch.stack((torch.full_like(t, A), 0.0 * t, torch.full_like(t, M)))
        still = torch.zeros_like(t)
        x = deviation(0.5 * A * play - r * t, slopes, (still, still, still), still.new_zeros(3), dt, play)[0]
        w = (A / M) ** 0.5
        expected = (-0.5 * play + r / A * (t - torch.sin(w * t) / w)).clamp_max(0.5 * play)
        np.testing.assert_allclose(x[t < 0].numpy(), -0.5 * play)
        np.testing.assert_allclose(x[t > 2 * dt].numpy(), expected[t > 2 * dt].numpy(), atol=6e-5)

    def test_stays_within_the_play_and_turns_with_the_load(self) -> None:
        at = signals(*states(300))
        x = free(at.load[1], torch.ones(300, dtype=torch.float64), 0.01, 0.02)
        assert x.abs().max() <= 0.01
        mirrored = free(-at.load[1], torch.ones(300, dtype=torch.float64), 0.01, 0.02)
        torch.testing.assert_close(mirrored, -x)

    def test_friction_holds_the_link_while_the_motor_crosses_the_play(self) -> None:
        """Nothing but friction: when the motor turns back, the link rests until the motor has gone through the play."""
        t = 1e-3 * torch.arange(3000, dtype=torch.float64)
        q, qd, qdd = 0.1 * torch.sin(4 * t), 0.4 * torch.cos(4 * t), -1.6 * torch.sin(4 * t)
        inertia, play = torch.full_like(t, 1e-3), 0.02
        friction = torch.tensor([0.05, 0.5, 0.0])
        x, more = deviation(1e-3 * qdd, alone(inertia), (qd, qdd, qd.sign()), friction, 1e-3, play)
        back = int(torch.nonzero(qd < 0)[0])
        met = back + int(torch.nonzero(q[back:] < q[back] - play)[0])
        np.testing.assert_allclose(x[:back].numpy(), -play / 2)
        resting = slice(back + 2, met - 2)
        np.testing.assert_allclose(x[resting].numpy(), (-play / 2 + q[back] - q[resting]).numpy(), atol=1e-4)
        np.testing.assert_allclose(x[met + 2 : met + 200].numpy(), play / 2)
        # The link rests, and the motor turns on without its friction.
        np.testing.assert_allclose(more[resting].numpy(), 0.5, atol=0.02)
        assert not more[:back].any()

    def test_friction_is_little_by_little_none(self) -> None:
        at, width = signals(*states(300)), torch.ones(300, dtype=torch.float64)
        motion = at.qd[1], at.qdd[1], at.joint(1).direction()
        some = deviation(at.load[1], alone(width), motion, torch.full((3,), 1e-9), 0.01, 0.02)[0]
        torch.testing.assert_close(some, free(at.load[1], width, 0.01, 0.02), atol=1e-6, rtol=0.0)

    def test_gradients_in_flight(self) -> None:
        """The link flies where its load changes sign: there it moves by load, inertia and friction."""
        t = 0.01 * torch.arange(60, dtype=torch.float64)
        load, inertia = torch.cos(8 * t) - 0.1, 0.5 + 0.1 * torch.sin(5 * t)
        motion = 0.3 + 0.1 * t, torch.full_like(t, 0.1), torch.ones_like(t)
        friction = torch.tensor([0.2, 0.3, -0.1], dtype=t.dtype)

        def x(*given: Tensor) -> tuple[Tensor, Tensor]:
            slopes = torch.stack((2.0 + given[1], 0.3 * given[1], given[1]))
            return deviation(given[0], slopes, motion, given[2], 0.01, 0.02)

        given = tuple(v.requires_grad_() for v in (load, inertia, friction))
        assert gradcheck(x, given)
        by_friction = torch.autograd.grad(torch.stack(x(*given)).sum(), given[2])[0]
        assert by_friction.abs().min() > 0


def test_a_link_without_inertia_crosses_its_play_at_once() -> None:
    """A fit that is not physical may say so of a link."""
    load = torch.sin(torch.linspace(0.0, 200.0, 40000, dtype=torch.float64))
    for inertia in (torch.zeros_like(load), -torch.ones_like(load), torch.linspace(-1.0, 1.0, 40000).double()):
        x = free(load, inertia, 0.01, 0.02)
        assert torch.isfinite(x).all()
        assert x.abs().max() <= 0.01


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")
def test_forward_derivatives_are_those_backwards() -> None:
    t = 0.01 * torch.arange(60, dtype=torch.float64)
    load, change, still = torch.cos(8 * t) - 0.1, torch.sin(t), torch.zeros_like(t)

    def x(load: Tensor) -> Tensor:
        return free(load, still + 0.5, 0.01, 0.02)

    with forward_ad.dual_level():
        found = forward_ad.unpack_dual(x(forward_ad.make_dual(load, change))).tangent
    expected = torch.autograd.functional.jacobian(x, load) @ change
    assert expected.abs().max() > 1e-3
    torch.testing.assert_close(found, expected)


@pytest.mark.skipif(library(COMPILED) is None, reason="no C compiler")
@pytest.mark.parametrize("play", [1e-3, 0.02, 0.3])
@pytest.mark.parametrize("coulomb", [0.0, 0.1, 2.0])
def test_compiled_as_with_derivatives(play: float, coulomb: float) -> None:
    """Links that hang, fly, swing and stick: the same to rounding, whatever has derivatives."""
    rng = np.random.default_rng(5)
    t = 2e-3 * torch.arange(3000, dtype=torch.float64)
    rate, phase, size = (torch.from_numpy(rng.uniform(*x, (4, 2, 3, 1))) for x in ((1, 20), (0, 6), (0.1, 1)))
    load, qd, A, B = (size * torch.sin(rate * t + phase)).sum(-2)
    qdd, M = torch.gradient(qd, spacing=2e-3, dim=-1)[0], 0.05 + 0.02 * torch.cos(t).expand(2, -1)
    slopes, friction = torch.stack((A, 0.02 * B, M)), torch.tensor([0.05, coulomb, -0.02]).double()
    given = slopes, (qd, qdd, torch.tanh(qd / 0.05)), friction, 2e-3, play
    found, derived = deviation(load, *given), deviation(load.clone().requires_grad_(), *given)
    for one, same, size in zip(found, derived, (play, 1.0), strict=True):
        torch.testing.assert_close(one, same.detach(), rtol=0, atol=1e-10 * size)
    assert ((found[0].abs() < 0.49 * play).double().mean(-1) > 0.02).all()


@pytest.mark.parametrize(("shape", "told"), [(0.0, 0.0), (0.5, 0.5), (1.0, 1.0), (-0.5, 0.0), (1.2, 1.0)])
def test_a_play_has_a_part_of_the_friction(shape: float, told: float) -> None:
    """What is told is what the torque is made of; no part is less than nothing, or more than all."""
    play, (q, qd, qdd) = Backlash(), states(200)
    x = replace(signals(q, qd, qdd), friction=torch.tensor([[0.1, 0.5, 0.0]]).double().expand(ROBOT.n_dof, 3))
    given = {"flight": 0.01, "link_friction": shape}
    found = play.parameters(torch.tensor([0.01]).double(), given)
    assert float(found["link_friction"]) == told
    made, meant, motors = (
        torch.stack(list(play.features(x, Site(1), {"flight": 0.01, "link_friction": s}).values()))
        for s in (shape, told, 0.0)
    )
    torch.testing.assert_close(made, meant, rtol=0, atol=0)
    assert torch.equal(made, motors) is (told == 0.0)
