"""The module in torch's own transforms: torch.func, autocast, inference mode, compile, export, ONNX."""

from __future__ import annotations

import copy
import io
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from model.arms import arm, states, term
from torch import Tensor

from torchrbd.errors import InputError
from torchrbd.model import RigidBodyDynamics


@pytest.fixture
def model() -> RigidBodyDynamics:
    # Terms that see the load: the rigid body is computed within them too.
    loaded = [term("load_dependent_friction", 1, 0.1), term("torque_scale", 2, 0.05)]
    return RigidBodyDynamics(arm().robot, terms=[*arm().terms, *loaded])


def single(x: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    return tuple(v.float() for v in x)


def test_vmap_is_the_batch(model: RigidBodyDynamics) -> None:
    q, qd, qdd = states(model.robot, 6)
    torch.testing.assert_close(torch.vmap(model)(q, qd, qdd), model(q, qd, qdd), rtol=1e-12, atol=1e-12)
    smooth = arm()
    tau = smooth(q, qd, qdd)
    found = torch.vmap(smooth.forward_dynamics)(q, qd, tau)
    torch.testing.assert_close(found, smooth.forward_dynamics(q, qd, tau), rtol=1e-12, atol=1e-12)


def test_an_ensemble_is_stacked(model: RigidBodyDynamics) -> None:
    robots = [copy.deepcopy(model) for _ in range(3)]
    with torch.no_grad():
        for robot in robots:
            for p in robot.parameters():
                p.add_(0.1 * torch.randn_like(p))
    parameters, buffers = torch.func.stack_module_state(robots)  # type: ignore[arg-type]
    x = states(model.robot, 5)

    def torque(parameters: dict[str, Tensor], buffers: dict[str, Tensor]) -> Tensor:
        return torch.func.functional_call(model, (parameters, buffers), x)

    found = torch.vmap(torque)(parameters, buffers)
    for one, robot in zip(found, robots, strict=True):
        torch.testing.assert_close(one, robot(*x), rtol=1e-12, atol=1e-12)


# torch.func's forward mode compiles its own rules so.
@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")
def test_jacobians_and_hessians(model: RigidBodyDynamics) -> None:
    """By state: the closed form of the rigid body's; and twice, as of gradients of gradients."""
    q, qd, qdd = (v[0] for v in states(model.robot, 1))
    bare = RigidBodyDynamics(model.robot)
    jacobians = torch.func.jacrev(bare, argnums=(0, 1, 2))(q, qd, qdd)
    torch.testing.assert_close(torch.stack(jacobians), model.robot.torque_slopes(q, qd, qdd), rtol=1e-10, atol=1e-10)
    hessian = torch.func.hessian(lambda qd: model(q, qd, qdd)[1])(qd)
    step = 1e-5 * torch.eye(len(qd), dtype=qd.dtype)
    slope = torch.func.jacrev(lambda qd: model(q, qd, qdd)[1])
    numeric = torch.stack([(slope(qd + h) - slope(qd - h)) / 2e-5 for h in step])
    torch.testing.assert_close(hessian, numeric, rtol=1e-5, atol=1e-6)


def test_full_precision_under_autocast(model: RigidBodyDynamics) -> None:
    x, model = single(states(model.robot, 5)), model.float()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(model(*x), model(*x).float())
        tau = model(*x)
        found = model.forward_dynamics(x[0], x[1], tau)
        model(*x).sum().backward()
    assert torch.equal(tau, model(*x))
    assert torch.equal(found, model.forward_dynamics(x[0], x[1], tau))
    assert model.raw_inertia.grad is not None


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_training_after_inference_mode(model: RigidBodyDynamics, dtype: torch.dtype) -> None:
    """Constants that a first call under inference mode makes are not kept."""
    x = tuple(v.to(dtype) for v in states(model.robot, 5))
    bare = RigidBodyDynamics(model.robot)
    with torch.inference_mode():
        bare(*x)
    bare(*x).sum().backward()
    assert bare.raw_inertia.grad is not None


def test_training_after_export(model: RigidBodyDynamics) -> None:
    """Constants that tracing makes are not kept, in a type that no call had before."""
    x, fresh = single(states(model.robot, 4)), RigidBodyDynamics(arm().robot).float()
    torch.export.export(fresh, x)
    tau = fresh(*x)
    assert type(tau) is Tensor
    tau.sum().backward()


def test_states_by_weights_only(model: RigidBodyDynamics) -> None:
    file = io.BytesIO()
    torch.save(model.state_dict(), file)
    file.seek(0)
    fresh = copy.deepcopy(model)
    with torch.no_grad():
        fresh.raw_inertia.add_(1.0)
    fresh.load_state_dict(torch.load(file, weights_only=True))
    x = states(model.robot, 3)
    assert torch.equal(fresh(*x), model(*x))


def test_traced_in_one_graph(model: RigidBodyDynamics) -> None:
    torch.compiler.reset()
    x = states(model.robot, 3)
    compiled = torch.compile(model, fullgraph=True, backend="aot_eager")
    torch.testing.assert_close(compiled(*x), model(*x), rtol=1e-12, atol=1e-12)
    q, qd, tau = x
    accelerated = torch.compile(model.forward_dynamics, fullgraph=True, backend="eager")
    torch.testing.assert_close(accelerated(q, qd, tau), model.forward_dynamics(q, qd, tau), rtol=1e-12, atol=1e-12)


# torch's inductor uses names of torch that are to go.
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
@pytest.mark.slow
def test_compiled_by_inductor(model: RigidBodyDynamics) -> None:
    torch.compiler.reset()
    x = states(model.robot, 65536)
    compiled = torch.compile(model, fullgraph=True)
    torch.testing.assert_close(compiled(*x), model(*x), rtol=1e-10, atol=1e-10)


def exported(model: RigidBodyDynamics) -> torch.export.ExportedProgram:
    """Return a model in single precision for any batch."""
    batch = torch.export.Dim("batch", min=2)
    shapes = ({0: batch}, {0: batch}, {0: batch})
    return torch.export.export(model.float(), single(states(model.robot, 4)), dynamic_shapes=shapes)


def test_exported_for_any_batch(model: RigidBodyDynamics) -> None:
    program, x = exported(model), single(states(model.robot, 77, seed=3))
    torch.testing.assert_close(program.module()(*x), model(*x).detach(), rtol=1e-5, atol=1e-5)


@pytest.mark.slow
# torch's exporter of ONNX asks its own trees so.
@pytest.mark.filterwarnings("ignore:.isinstance.treespec, LeafSpec.. is deprecated")
def test_onnx_for_any_batch(model: RigidBodyDynamics, tmp_path: Path) -> None:
    program, x = exported(model), single(states(model.robot, 77, seed=3))
    expected = model(*x).detach()
    names, file = ["q", "qd", "qdd"], tmp_path / "model.onnx"
    torch.onnx.export(program, (), file, input_names=names, output_names=["tau"], verbose=False)
    session = onnxruntime.InferenceSession(file)
    (tau,) = session.run(None, {name: v.numpy() for name, v in zip(names, x, strict=True)})
    assert np.abs(tau - expected.numpy()).max() < 1e-5 * expected.abs().max()


def test_wrong_width_is_told(model: RigidBodyDynamics) -> None:
    x = torch.zeros(5)
    q, qd, tau = (v[0] for v in states(model.robot, 1))
    for call in (
        lambda: model(x, x, x),
        lambda: model.forward_dynamics(q, x, tau),
        lambda: model.step(x, qd, tau, 0.1),
    ):
        with pytest.raises(InputError, match=r"shape \(5,\), expected \(\.\.\., \d\): robot 'random9' has joints"):
            call()
