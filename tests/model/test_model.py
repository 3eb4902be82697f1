"""The one model: rigid body and terms, differentiable, physical whatever training does to it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from model.arms import URDF, arm, states, term, terms
from robot.random_robots import random_urdf
from torch import Tensor
from torch.autograd import gradcheck

from torchrbd.effects import Signals, Site, Term, effect, known_effects
from torchrbd.errors import InputError, OptionError, PhysicalError
from torchrbd.export import load_model, save_model
from torchrbd.model import REST_WIDTH, RigidBodyDynamics
from torchrbd.parameters import is_physical
from torchrbd.robot import RobotModel, pseudo_inertia

MASSLESS = random_urdf(5, 6, massless=1.0, branching=0.0, fixed=0.0)


@pytest.fixture
def model() -> RigidBodyDynamics:
    return arm()


def test_torque_is_the_rigid_bodys_plus_the_terms(model: RigidBodyDynamics) -> None:
    robot = model.robot
    q, qd, qdd = states(robot, 20)
    expected = robot.inverse_dynamics(q, qd, qdd)
    at = Signals(robot, q.T, qd.T, qdd.T, model.rest_width)
    for t in terms():
        expected[:, t.site.joint] += t(at).detach()
    torch.testing.assert_close(model(q, qd, qdd), expected, rtol=1e-11, atol=1e-11)
    torch.testing.assert_close(model.pi, robot.pi, rtol=1e-12, atol=1e-12)


def test_friction_of_all_joints_at_once_is_that_of_its_terms() -> None:
    """States and coefficients: values and first and second derivatives, in both precisions."""
    own = [term("viscous_friction", 0, 0.7), term("viscous_friction", 2, 0.2), term("torque_offset", 1, -0.6)]
    own += [term("coulomb_friction", 2, 0.4), term("asymmetric_coulomb_friction", 1, 0.9, 0.2), *own[:1]]
    robot = RobotModel.from_urdf(URDF)
    model = RigidBodyDynamics(robot, terms=[*own, term("joint_spring", 2, 3.0, -1.0)])
    q, qd, qdd = states(robot, 4)
    qd = (1e-3 * qd).requires_grad_()
    alone = Signals(robot, q.T, qd.T, qdd.T, model.rest_width)
    torques = torch.zeros(4, robot.n_dof, dtype=torch.float64)
    for one in model.terms:
        torques = torques.index_add(1, torch.tensor([one.site.joint]), one(alone).unsqueeze(1))
    found = model.term_torque(q, qd, qdd)
    torch.testing.assert_close(found, torques, rtol=1e-13, atol=1e-13)
    of = (qd, *(one.coefficients for one in model.terms))
    slopes, expected = (torch.autograd.grad(x.square().sum(), of, create_graph=True) for x in (found, torques))
    twice, numbers = (torch.autograd.grad(sum(s.square().sum() for s in x), of) for x in (slopes, expected))
    for x, y in zip((*slopes, *twice), (*expected, *numbers), strict=True):
        torch.testing.assert_close(x, y, rtol=1e-11, atol=1e-11)
    single = model.float().term_torque(q.float(), qd.float(), qdd.float())
    assert single.dtype is torch.float32
    torch.testing.assert_close(single.double(), found, rtol=1e-4, atol=1e-4)
    assert not any("placing" in name for name in model.state_dict())


def test_other_parameters_can_be_given() -> None:
    robot, other = RobotModel.from_urdf(URDF), RobotModel.from_urdf(URDF)
    pi = 1.3 * robot.pi
    x = states(robot, 5)
    torch.testing.assert_close(RigidBodyDynamics(robot, pi)(*x), other.inverse_dynamics(*x, pi=pi))


def test_batched_is_looped(model: RigidBodyDynamics) -> None:
    x = states(model.robot, 2, 3)
    tau = model(*x)
    for k in range(2):
        for j in range(3):
            torch.testing.assert_close(tau[k, j], model(*(v[k, j] for v in x)), rtol=1e-12, atol=1e-12)
    assert model(*states(model.robot, 0)).shape == (0, model.robot.n_dof)
    with torch.no_grad():
        torch.testing.assert_close(model(*x), tau, rtol=1e-12, atol=1e-12)


def test_states_broadcast_as_in_the_robot(model: RigidBodyDynamics) -> None:
    q, qd, qdd = states(model.robot, 4)
    full = q[0].expand_as(q)
    torch.testing.assert_close(model(q[0], qd, qdd), model(full, qd, qdd))
    some = RigidBodyDynamics(model.robot, terms=[term("viscous_friction", 0, 0.7)])
    torch.testing.assert_close(some(q[0], qd, qdd), some(full, qd, qdd))


def test_gradients_through_states_and_parameters(model: RigidBodyDynamics) -> None:
    q, qd, qdd = states(model.robot, 2, grad=True)
    names = [name for name, _ in model.named_parameters()]
    values = tuple(p.detach().clone().requires_grad_() for p in model.parameters())
    assert "raw_inertia" in names
    assert len(names) == 1 + len(terms())

    def torque(q: Tensor, qd: Tensor, qdd: Tensor, *values: Tensor) -> Tensor:
        return torch.func.functional_call(model, dict(zip(names, values, strict=True)), (q, qd, qdd))

    assert gradcheck(torque, (q, qd, qdd, *values))
    assert gradcheck(model.forward_dynamics, (q, qd, qdd))


def test_forward_dynamics_inverts_inverse_dynamics(model: RigidBodyDynamics) -> None:
    q, qd, qdd = states(model.robot, 2, 5)
    torch.testing.assert_close(model.forward_dynamics(q, qd, model(q, qd, qdd)), qdd, rtol=1e-9, atol=1e-9)
    bare = RigidBodyDynamics(model.robot)
    tau = model.robot.inverse_dynamics(q, qd, qdd)
    torch.testing.assert_close(bare.forward_dynamics(q, qd, tau), qdd, rtol=1e-9, atol=1e-9)


def test_forward_dynamics_at_a_time(model: RigidBodyDynamics) -> None:
    """Friction that changes with time: for a sequence, sample by sample, and with one time for all states."""
    q, qd, qdd = states(model.robot, 2, 5)
    t = torch.linspace(0.0, 8.0, 5, dtype=torch.float64)
    w, shape = effect("time_varying_friction").coefficients(
        {"coulomb_end": 1.0, "coulomb_start": 4.0, "time_constant": 3.0}
    )
    warming = Term(effect("time_varying_friction"), Site(1), torch.tensor(w, dtype=torch.float64), shape)
    timed = RigidBodyDynamics(model.robot, terms=[*model.terms, warming])
    tau = timed(q, qd, qdd, t)
    found = timed.forward_dynamics(q, qd, tau, t)
    torch.testing.assert_close(found, qdd, rtol=1e-9, atol=1e-9)
    for k in range(5):
        alone = timed.forward_dynamics(q[:, k], qd[:, k], tau[:, k], t[k])
        torch.testing.assert_close(alone, qdd[:, k], rtol=1e-9, atol=1e-9)
    single = timed.forward_dynamics(q[0, 2], qd[0, 2], tau[0, 2], t[2])
    torch.testing.assert_close(single, qdd[0, 2], rtol=1e-9, atol=1e-9)
    with pytest.raises(InputError, match="depends on time needs t"):
        timed.forward_dynamics(q, qd, tau)
    w, shape = effect("presliding_hysteresis").coefficients({"coulomb": 1.0, "distance": 0.1})
    bristles = Term(effect("presliding_hysteresis"), Site(1), torch.tensor(w, dtype=torch.float64), shape)
    with pytest.raises(InputError, match="it has no forward dynamics"):
        RigidBodyDynamics(model.robot, terms=[bristles]).forward_dynamics(q, qd, tau, t)


def test_forward_dynamics_takes_temperatures(model: RigidBodyDynamics) -> None:
    q, qd, qdd = states(model.robot, 2, 5)
    warm = 40.0 + 10.0 * torch.rand(2, 5, model.robot.n_dof, dtype=torch.float64)
    thermal = Term(effect("thermal_viscosity"), Site(1), torch.tensor([0.3], dtype=torch.float64), {})
    lubricated = RigidBodyDynamics(model.robot, terms=[*model.terms, thermal])
    tau = lubricated(q, qd, qdd, temperature=warm)
    found = lubricated.forward_dynamics(q, qd, tau, temperature=warm)
    torch.testing.assert_close(found, qdd, rtol=1e-9, atol=1e-9)
    assert not torch.allclose(lubricated.forward_dynamics(q, qd, tau), qdd)


def test_massless_bodies_are_held_constant() -> None:
    robot = RobotModel.from_urdf(MASSLESS)
    model = RigidBodyDynamics(robot)
    massless = robot.pi.reshape(-1, 10)[:, 0] == 0
    assert massless.sum() == 5
    assert model.raw_inertia.shape == (1, 10)
    with torch.no_grad():
        model.raw_inertia.add_(0.3)
    pi = model.pi.detach().reshape(-1, 10)
    assert torch.equal(pi[massless], torch.zeros(5, 10, dtype=torch.float64))
    assert not torch.allclose(pi[~massless], robot.pi.reshape(-1, 10)[~massless])


def test_a_moving_body_without_mass_is_told_and_rotor_inertia_helps() -> None:
    robot = RobotModel.from_urdf(MASSLESS)
    q, qd, qdd = states(robot, 3)
    zero = RigidBodyDynamics(robot, torch.zeros_like(robot.pi))
    with pytest.raises(PhysicalError, match=r"'random5': the mass matrix is not positive definite.*rotor inertia"):
        zero.forward_dynamics(q, qd, qdd)
    geared = RigidBodyDynamics(robot, terms=[term("rotor_inertia", j, 0.1) for j in range(robot.n_dof)])
    torch.testing.assert_close(geared.forward_dynamics(q, qd, geared(q, qd, qdd)), qdd, rtol=1e-8, atol=1e-8)


def test_training_keeps_every_body_physical_and_learns(model: RigidBodyDynamics) -> None:
    q, qd, qdd = states(model.robot, 64)
    target = -model.robot.inverse_dynamics(q, qd, qdd)  # no robot has these torques
    optimiser = torch.optim.Adam(model.parameters(), lr=0.3)
    losses = []
    for _ in range(25):
        optimiser.zero_grad()
        loss = (model(q, qd, qdd) - target).square().mean()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
        assert is_physical(model.pi.detach().reshape(-1, 10), tolerance=0.0).all()
    assert losses[-1] < 0.8 * losses[0]


def test_effects_on_torques_see_the_friction_of_other_terms(model: RigidBodyDynamics, tmp_path: Path) -> None:
    """A late torque: that of the model without delay, shifted; so too from a file, and differentiable."""
    robot, whole, t = model.robot, 3, 0.01 * torch.arange(40, dtype=torch.float64)
    x = [v.cumsum(0) * 0.05 for v in states(robot, 40)]
    friction = [term("viscous_friction", 0, 0.7), term("asymmetric_coulomb_friction", 1, 1.5, 0.5)]
    friction += [term("torque_offset", 1, -0.5), term("coulomb_friction", 2, 1.5)]
    w, shape = effect("time_delay").coefficients({"delay": whole * 0.01, "step": whole * 0.01})
    late = Term(effect("time_delay"), Site(), torch.tensor(w, dtype=torch.float64), shape)
    width = torch.full((robot.n_dof,), 0.3, dtype=torch.float64)
    delayed = RigidBodyDynamics(robot, terms=[late, *friction], rest_width=width)
    at_once = RigidBodyDynamics(robot, terms=friction, rest_width=width)
    # Of uneven friction a constant is late, which is none: only its mean counts.
    even = RigidBodyDynamics(robot, terms=[*friction[::3], term("coulomb_friction", 1, 1.5)], rest_width=width)
    change = (even(*x)[:-whole] - even(*x)[whole:]).detach()
    torch.testing.assert_close((delayed(*x, t=t) - at_once(*x))[whole:], change, rtol=1e-9, atol=1e-9)
    save_model(delayed, tmp_path / "model.safetensors")
    torch.testing.assert_close(load_model(tmp_path / "model.safetensors")(*x, t=t), delayed(*x, t=t))
    names = [name for name, _ in delayed.named_parameters() if name != "raw_inertia"]
    values = tuple(delayed.get_parameter(name).detach().clone().requires_grad_() for name in names)

    def torque(*values: Tensor) -> Tensor:
        return torch.func.functional_call(delayed, dict(zip(names, values, strict=True)), tuple(x), {"t": t})

    assert gradcheck(torque, values)


def test_state_dict_round_trip(model: RigidBodyDynamics) -> None:
    with torch.no_grad():
        for p in model.parameters():
            p.mul_(1.1)
    fresh = RigidBodyDynamics(RobotModel.from_urdf(URDF), terms=terms())
    fresh.load_state_dict(model.state_dict())
    x = states(model.robot, 5)
    assert torch.equal(fresh(*x), model(*x))


def test_single_precision(model: RigidBodyDynamics) -> None:
    x = states(model.robot, 6)
    exact = model(*x)
    rough = model(*(v.float() for v in x))
    assert rough.dtype == torch.float32
    converted = model.float()(*(v.float() for v in x))
    for tau in (rough, converted):
        assert (tau - exact).abs().max() < 1e-5 * exact.abs().max()


def test_urdf_friction_becomes_terms() -> None:
    parts = random_urdf(2, 2, kinds=("revolute",)).split("</joint>")
    where = next(k for k, part in enumerate(parts) if 'name="joint2"' in part)
    parts[where] += '<dynamics damping="0.5" friction="1.5"/>'
    robot = RobotModel.from_urdf("</joint>".join(parts))
    j = robot.joint_names.index("joint2")
    model = RigidBodyDynamics.from_urdf("</joint>".join(parts))
    assert [(t.effect.id, t.site.joint) for t in model.terms] == [("viscous_friction", j), ("coulomb_friction", j)]
    q, qd, qdd = states(robot, 8)
    added = model(q, qd, qdd) - robot.inverse_dynamics(q, qd, qdd)
    torch.testing.assert_close(added[:, j], 0.5 * qd[:, j] + 1.5 * torch.tanh(qd[:, j] / REST_WIDTH))
    assert added[:, 1 - j].abs().max() < 1e-12


def test_terms_to_train_begin_at_nothing() -> None:
    """Named effects at all their places, or at one; what acts for a time only, or nowhere, is answered."""
    named = ["viscous_friction", "stribeck_friction@joint2", "payload"]
    with pytest.raises(OptionError, match="'payload' acts for a time only"):
        RigidBodyDynamics.from_urdf(URDF, effects=named)
    with pytest.raises(OptionError, match="'stribeck_friction' has no place 'joint77'"):
        RigidBodyDynamics.from_urdf(URDF, effects=["stribeck_friction@joint77"])
    robot = RobotModel.from_urdf(URDF)
    model = RigidBodyDynamics.from_urdf(URDF, effects=["viscous_friction", f"stribeck_friction@{robot.joint_names[1]}"])
    assert [t.effect.id for t in model.terms] == ["viscous_friction"] * robot.n_dof + ["stribeck_friction"]
    q, qd, qdd = states(robot, 40)
    torch.testing.assert_close(model(q, qd, qdd), robot.inverse_dynamics(q, qd, qdd))
    (model(q, qd, qdd) - robot.inverse_dynamics(q, qd, qdd) - 0.3 * qd).square().sum().backward()
    assert all(t.coefficients.grad is not None and t.coefficients.grad.abs().max() > 0 for t in model.terms)


@pytest.mark.parametrize("name", sorted(known_effects()))
def test_every_effect_begins_or_says_why(name: str) -> None:
    """At all its places, so that the model runs; or a message."""
    if name in ("payload", "external_wrench"):
        with pytest.raises(OptionError, match="acts for a time only"):
            RigidBodyDynamics.from_urdf(URDF, effects=[name])
        return
    if name == "coupled_motor":
        with pytest.raises(OptionError, match="'coupled_motor' has no place on robot"):
            RigidBodyDynamics.from_urdf(URDF, effects=[name])
        return
    model = RigidBodyDynamics.from_urdf(URDF, effects=[name])
    t = 0.01 * torch.arange(9, dtype=torch.float64)
    x = states(model.robot, 9)
    assert model.terms
    torch.testing.assert_close(model(*x, t=t), model.robot.inverse_dynamics(*x))


def test_parts_of_the_torque_add_up(model: RigidBodyDynamics) -> None:
    """M(q) qdd + b(q, qd) is the torque of laws that are linear in acceleration; gravity is the body's at rest."""
    q, qd, qdd = states(model.robot, 7)
    product = (model.mass_matrix(q) @ qdd.unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(product + model.bias_forces(q, qd), model.inverse_dynamics(q, qd, qdd))
    still = torch.zeros_like(q)
    torch.testing.assert_close(model.gravity(q), model.robot.inverse_dynamics(q, still, still))


def test_from_results(model: RigidBodyDynamics, tmp_path: Path) -> None:
    model.save(tmp_path / "model.safetensors")
    x = states(model.robot, 3)
    for source in (tmp_path, str(tmp_path / "model.safetensors")):
        assert torch.equal(RigidBodyDynamics.from_diagnosis(source)(*x), model(*x))
    assert RigidBodyDynamics.from_diagnosis(SimpleNamespace(identification=SimpleNamespace(model=model))) is model
    with pytest.raises(InputError, match="a Diagnosis, an Identification or a folder of results, got int"):
        RigidBodyDynamics.from_diagnosis(3)
    with pytest.raises(InputError, match=r"nothing.*cannot be read as a model"):
        RigidBodyDynamics.load(tmp_path / "nothing")


def test_files_are_as_open_as_others(model: RigidBodyDynamics, tmp_path: Path) -> None:
    model.save(tmp_path / "model.safetensors")
    (tmp_path / "other").write_text("")
    assert (tmp_path / "model.safetensors").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_huge_steps_leave_a_physical_robot(model: RigidBodyDynamics) -> None:
    """Of an optimiser that has gone wild: masses and inertias of physical bodies, finite torques."""
    torch.manual_seed(0)
    for size in (1.0, 5.0, 20.0):
        with torch.no_grad():
            model.raw_inertia.copy_(size * torch.randn_like(model.raw_inertia))
        bodies = model.pi.detach().reshape(-1, 10)[model.physical]
        assert (bodies[:, 0] > 0).all()
        # Rounding at such sizes is all that is allowed to show.
        least = torch.linalg.eigvalsh(pseudo_inertia(bodies))
        assert (least[:, 0] >= -1e-12 * least[:, -1]).all()
        assert model(*states(model.robot, 4)).isfinite().all()
