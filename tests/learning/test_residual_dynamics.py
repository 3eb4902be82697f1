"""Physics and network: what each kind promises, whatever the network says."""

from __future__ import annotations

import pytest
import torch
from learning.residual_problems import ROBOT, features, physics, samples
from torch import nn

from torchrbd import ResidualDynamics
from torchrbd.errors import InputError, OptionError
from torchrbd.learning import PhysicsMetric, physics_columns
from torchrbd.learning.corrections import KINDS
from torchrbd.learning.region import EDGE

N = ROBOT.n_dof


def model_of(kind: str = "free", seed: int = 0, **options) -> ResidualDynamics:
    """Return a model in float64 whose network says something, calibrated to samples about zero."""
    torch.manual_seed(seed)
    model = ResidualDynamics(physics(), kind=kind, **options)
    for p in model.correction.network.parameters():
        nn.init.normal_(p, std=0.5)
    x = features(200)
    model.calibrate(samples(model.physics, torch.ones(200, N, dtype=x.dtype), x))
    return model.double()


OPTIONS = [("free", {}), ("dissipative", {}), ("lagrangian", {}), ("lagrangian", {"kinetic": True})]


@pytest.mark.parametrize(("kind", "options"), OPTIONS)
def test_torques_add_and_batches_are_loops(kind: str, options: dict) -> None:
    model, x = model_of(kind, **options), features(6, 1)
    q, qd, qdd = x.unflatten(-1, (3, N)).unbind(-2)
    tau = model(q, qd, qdd)
    assert model.network_torque(x).abs().amin() > 0
    torch.testing.assert_close(tau, model.physics(q, qd, qdd) + model.network_torque(x))
    torch.testing.assert_close(tau, torch.stack([model(*one) for one in zip(q, qd, qdd, strict=True)]))
    torch.testing.assert_close(tau, torch.func.vmap(model)(q, qd, qdd))
    shaped = model(*(s.reshape(2, 3, N) for s in (q, qd, qdd)))
    torch.testing.assert_close(tau.reshape(2, 3, N), shaped)


@pytest.mark.parametrize(("kind", "options"), OPTIONS)
def test_torques_are_differentiable_in_states_and_weights(kind: str, options: dict) -> None:
    model = model_of(kind, **options)
    assert torch.autograd.gradcheck(model.network_torque, features(2, 1).requires_grad_())
    loss = model.network_torque(features(3, 1)).square().sum()
    loss.backward()
    last = list(model.correction.network.parameters())[-2]
    assert last.grad is not None
    step = 1e-6 * torch.randn_like(last)
    with torch.no_grad():
        before = last.clone()
        sides = []
        for sign in (1.0, -1.0):
            last.copy_(before + sign * step)
            sides.append(model.network_torque(features(3, 1)).square().sum())
    torch.testing.assert_close((last.grad * step).sum(), 0.5 * (sides[0] - sides[1]), rtol=1e-5, atol=1e-12)


def test_without_a_word_from_the_network_it_is_the_physics() -> None:
    model, x = ResidualDynamics(physics()), features(5)
    states = x.unflatten(-1, (3, N)).unbind(-2)
    torch.testing.assert_close(model(*states), model.physics(*states), rtol=0, atol=0)


def test_a_resisting_network_never_pushes() -> None:
    model, x = model_of("dissipative"), features(500, 2)
    power = model.network_torque(x) * x[:, N : 2 * N]
    assert power.amin() >= 0
    assert power.amax() > 0
    free = model_of("free")
    assert (free.network_torque(x) * x[:, N : 2 * N]).amin() < 0


def test_a_potential_does_no_work_around_a_loop() -> None:
    phase = torch.linspace(0, 2 * torch.pi, 401, dtype=torch.float64)[:-1]
    q = torch.stack((0.6 * phase.cos(), 0.5 * phase.sin()), 1)
    step = torch.stack((-0.6 * phase.sin(), 0.5 * phase.cos()), 1) * 2 * torch.pi / 400
    x = torch.cat((q, torch.zeros(400, 2 * N, dtype=q.dtype)), 1)
    work = {kind: (model_of(kind, fade=False).network_torque(x) * step).sum(1) for kind in ("lagrangian", "free")}
    assert work["lagrangian"].abs().amax() > 1e-3
    assert work["lagrangian"].sum().abs() < 1e-10
    assert work["free"].sum().abs() > 1e-3


def test_a_lagrangian_changes_energy_by_its_power_alone() -> None:
    """d/dt (T + V) = tau . qd along a motion; by differences of T + V from the network's own words."""
    model = model_of("lagrangian", kinetic=True, fade=False)
    said, scale = model.correction._said, model.correction.scale[0]

    def state(t: float) -> tuple[torch.Tensor, ...]:
        a = torch.tensor([1.0, 1.7], dtype=torch.float64)
        return (a * t).sin(), a * (a * t).cos(), -a * a * (a * t).sin()

    def energy(t: float) -> torch.Tensor:
        q, qd, _ = state(t)
        out = said(q)
        low = torch.zeros(N, N, dtype=q.dtype)
        low[tuple(torch.tril_indices(N, N))] = out[1:]
        return scale * (out[0] + 0.5 * (low.T @ qd).square().sum())

    for t in (0.3, 1.1):
        power = (model.network_torque(torch.cat(state(t))) * state(t)[1]).sum()
        slope = (energy(t + 1e-5) - energy(t - 1e-5)) / 2e-5
        torch.testing.assert_close(power, slope, rtol=1e-7, atol=1e-8)


def test_far_from_the_data_it_is_the_physics() -> None:
    model, x = model_of(), features(50, 3)
    assert model.inside(x).double().mean() > 0.9
    far = x + torch.tensor([0.0, 0.0, 40.0, 0.0, 0.0, 0.0])
    assert not model.inside(far).any()
    assert model.network_torque(far).abs().amax() == 0
    assert ResidualDynamics.network_torque(model_of(fade=False), far).abs().amin() > 0
    way = torch.linspace(0, 40, 300, dtype=x.dtype).unsqueeze(1) * (far[:1] - x[:1]) / 40 + x[:1]
    fade, distance = model.region.fade(model.encoder(way)), model.distance(way)
    assert fade[distance <= 1.0].amin() == 1
    assert fade[distance >= EDGE].amax() == 0
    assert (fade[distance.argsort()].diff() <= 1e-9).all()


def test_distance_is_that_of_the_nearest_point() -> None:
    model, x = model_of(), features(20, 4)
    z, centres = model.encoder(x), model.region.centres
    naive = torch.stack([min((one - c).norm() for c in centres) for one in z]) / model.region.reach
    torch.testing.assert_close(model.distance(x), naive, rtol=1e-6, atol=1e-6)


def test_uncertainty_grows_away_from_the_data() -> None:
    model, x = model_of(), features(1, 3)
    model.left_std.fill_(0.1)
    away = torch.tensor([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], dtype=x.dtype)
    std = torch.cat([model.std(x * 0 + k * away) for k in (0.0, 10.0, 20.0, 40.0)])
    torch.testing.assert_close(std[0], torch.full((N,), 0.1, dtype=x.dtype))
    assert (std.diff(dim=0) > 0).all()
    beyond = model.distance(x * 0 + 40.0 * away)[0] - 1.0
    torch.testing.assert_close(std[-1], (0.01 + beyond**2 * model.missing_std**2).sqrt())


def test_inputs_are_normalised_by_the_data() -> None:
    model = model_of()
    z = model.encoder(features(200))
    torch.testing.assert_close(z.mean(0), torch.zeros(z.shape[1], dtype=z.dtype), atol=1e-9, rtol=0)
    torch.testing.assert_close(z.std(0, correction=0), torch.ones(z.shape[1], dtype=z.dtype))
    turned = features(5, 1)
    turned[:, 0] += 2 * torch.pi
    torch.testing.assert_close(model.network_torque(turned), model.network_torque(features(5, 1)))


def test_columns_are_slopes_of_the_torque() -> None:
    model, x = physics((*FRICTION_AND_LOAD,)), features(7)
    states = x.unflatten(-1, (3, N)).unbind(-2)
    columns = physics_columns(model, *states)
    torch.testing.assert_close(columns[..., : ROBOT.n_params], ROBOT.regressor(*states))
    own = [term.coefficients for term in model.terms]
    for k, w in enumerate(own):
        with torch.no_grad():
            before = model(*states)
            w += 1e-6
            slope = (model(*states) - before) / 1e-6
            w -= 1e-6
        torch.testing.assert_close(columns[..., ROBOT.n_params + k], slope, rtol=1e-5, atol=1e-6)


FRICTION_AND_LOAD = ("viscous_friction", "coulomb_friction", "load_dependent_friction")


def test_the_metric_knows_what_physics_could_say() -> None:
    model, x = physics(), features(100)
    columns = physics_columns(model, *x.unflatten(-1, (3, N)).unbind(-2))
    weight = torch.tensor([1.0, 25.0], dtype=x.dtype).expand(100, N)
    metric = PhysicsMetric.of(x, columns, weight)
    physical = columns @ torch.randn(columns.shape[-1], dtype=x.dtype, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(metric.share(physical), torch.ones((), dtype=x.dtype))
    A = (columns * weight.sqrt().unsqueeze(-1)).flatten(0, 1)
    any_torque = torch.randn(100, N, dtype=x.dtype, generator=torch.Generator().manual_seed(1))
    y = (any_torque * weight.sqrt()).flatten()
    said = A @ torch.linalg.lstsq(A, y, driver="gelsd", rcond=1e-10).solution
    torch.testing.assert_close(metric.said(any_torque), said.square().mean())
    rest = ((y - said).reshape(100, N)) / weight.sqrt()
    assert metric.share(rest) < 1e-12


def test_the_state_of_calibrated_models_can_be_loaded() -> None:
    model, other = model_of(), ResidualDynamics(physics()).double()
    other.load_state_dict(model.state_dict())
    torch.testing.assert_close(other.network_torque(features(5)), model.network_torque(features(5)))


def test_precision_follows_the_states_and_the_physics_stays_exact() -> None:
    model, x = model_of().float(), features(4, 1)
    single = model.network_torque(x.float())
    assert single.dtype == torch.float32
    torch.testing.assert_close(single.double(), model.network_torque(x), rtol=1e-4, atol=1e-4)
    with torch.autocast("cpu", torch.bfloat16):
        torch.testing.assert_close(model.distance(x.float()).double(), model.distance(x), rtol=1e-4, atol=1e-4)


def test_what_the_user_gave_is_left_alone() -> None:
    given = physics()
    model = ResidualDynamics(given, mode="frozen")
    assert all(p.requires_grad for p in given.parameters())
    assert not any(p.requires_grad for p in model.physics.parameters())
    assert all(p.requires_grad for p in ResidualDynamics(given, mode="joint").parameters())


def test_history_must_be_there() -> None:
    model = ResidualDynamics(physics(), history=3)
    states = features(4).unflatten(-1, (3, N)).unbind(-2)
    history = torch.randn(4, 3, 2, N, dtype=torch.float64)
    assert model(*states, history).shape == (4, N)
    torch.testing.assert_close(model.features(*states, history)[:, 3 * N :], history.flatten(1))
    with pytest.raises(InputError, match=r"history is none; expected \(\.\.\., 3, 2, 2\)"):
        model(*states)
    with pytest.raises(InputError, match="expected none"):
        ResidualDynamics(physics())(*states, history)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"mode": "thawed"}, OptionError, "mode is 'thawed'; expected one of frozen, joint, alternating"),
        ({"kind": "magic"}, OptionError, f"expected one of {', '.join(KINDS)}"),
        ({"kinetic": True}, OptionError, "kinetic belongs to the kind 'lagrangian'"),
        ({"history": -1}, OptionError, "history is -1"),
        ({"network": nn.Linear(3, 2)}, InputError, r"does not take an input of shape \(2, 8\)"),
        ({"network": nn.Linear(8, 3)}, InputError, r"gives \(2, 3\) for an input of shape \(2, 8\); expected \(2, 2\)"),
        ({"network": nn.Linear(8, 1), "kind": "lagrangian"}, InputError, r"does not take an input of shape \(2, 4\)"),
    ],
)
def test_what_does_not_fit_is_refused(arguments: dict, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        ResidualDynamics(physics(), **arguments)


def test_other_physics_and_features_are_refused() -> None:
    with pytest.raises(InputError, match=r"expected a torchrbd\.RigidBodyDynamics"):
        ResidualDynamics(nn.Linear(6, 2))  # type: ignore[arg-type]
    model, x = model_of(), features(10)
    with pytest.raises(InputError, match=r"expected \(\.\.\., 6\)"):
        model.network_torque(x[:, :5])
    with pytest.raises(InputError, match="another physics leaves"):
        model.shares(samples(physics(()), x[:, :N], x))
