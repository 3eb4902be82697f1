"""Training: what the network learns and leaves to the physics, and that it can stop, go on and be shared out."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from learning.residual_problems import ROBOT, features, physics, recording, samples
from safetensors import safe_open
from safetensors.torch import load_file
from torch import Tensor, nn

from torchrbd import ResidualDynamics, fit_residual, residual_dataset
from torchrbd.errors import InputError, OptionError
from torchrbd.learning import ResidualDataset
from torchrbd.learning.fit_residual import _Objective

N = ROBOT.n_dof


def product(x: Tensor) -> Tensor:
    """Return a torque sin(q_1) qd_2 at the first joint, which no rigid body and no friction has."""
    tau = torch.zeros(len(x), N, dtype=x.dtype)
    tau[:, 0] = x[:, 0].sin() * x[:, N + 1]
    return tau


def made(torque, seed: int = 0, count: int = 256) -> ResidualDataset:
    x = features(count, seed, torch.float32)
    return samples(physics(), torque(x), x)


def fresh(seed: int = 0, **options) -> ResidualDynamics:
    torch.manual_seed(seed)
    return ResidualDynamics(physics(), **options)


def test_the_network_learns_what_the_physics_leaves() -> None:
    data, new = made(product), made(product, 1)
    model = fresh()
    training = fit_residual(model, data, validation=made(product, 2), epochs=40, batch_size=64, lr=5e-3)
    assert training.validation[training.best_epoch] == min(training.validation)
    assert len(training.loss) == len(training.validation) - 1 == 40
    there = model.inside(new.features)
    assert model.left(new)[there].square().mean() < 0.25 * new.residual[there].square().mean()
    shares = model.shares(new)
    assert shares.left_inside[0] < 0.5 * shares.alone_inside[0]
    assert shares.outside == pytest.approx(float((~there).double().mean()))
    torch.testing.assert_close(model.left_std[0], shares.left_inside[0], rtol=0.4, atol=0)


def test_the_network_does_not_take_the_physics_over() -> None:
    """A residual that a rigid body and friction can say is left to them where that is asked for."""
    truth = physics()
    with torch.no_grad():
        truth.raw_inertia += 0.1 * torch.randn(truth.raw_inertia.shape, generator=torch.Generator().manual_seed(0))
        for term in truth.terms:
            term.coefficients += 0.3
    given = physics()

    def missing(x: Tensor) -> Tensor:
        states = x.unflatten(-1, (3, N)).unbind(-2)
        with torch.no_grad():
            return truth(*states) - given(*states) + 2.0 * product(x)

    data, found = made(missing), {}
    weigh = data.residual.std()
    data = samples(data.physics, data.residual / weigh, data.features)
    for orthogonality in (0.0, 100.0):
        model = fresh()
        fit_residual(model, data, epochs=40, batch_size=64, lr=5e-3, orthogonality=orthogonality)
        found[orthogonality] = model.shares(data).overlap
    assert found[0.0] > 0.3
    assert found[100.0] < 0.1 * found[0.0]


def test_the_penalty_is_in_the_loss() -> None:
    data, model = made(product), fresh()
    for p in model.correction.network.parameters():
        nn.init.normal_(p, std=0.3)
    model.calibrate(data)
    losses = [_Objective(model, data, weight, 0.0)(*data[:]) for weight in (0.0, 3.0)]
    said = data.metric.said(model.network_torque(data.features))
    torch.testing.assert_close(losses[1] - losses[0], 3.0 * said)
    torch.testing.assert_close(losses[0], (data.residual - model.network_torque(data.features)).square().mean())


@pytest.mark.parametrize("mode", ["frozen", "joint", "alternating"])
def test_who_learns_is_what_the_mode_says(mode: str) -> None:
    data, model = made(product), fresh(mode=mode)
    before = {name: p.detach().clone() for name, p in model.named_parameters()}
    moved = []
    for epochs in (1, 2):
        fit_residual(model, data, epochs=epochs - len(moved), batch_size=64)
        now = dict(model.named_parameters())
        moved.append({part for part in ("physics", "correction") for name in now if name.startswith(part) and
                      not torch.equal(before[name], now[name])})  # fmt: skip
    assert (
        moved[0] == {"frozen": {"correction"}, "joint": {"physics", "correction"}, "alternating": {"correction"}}[mode]
    )
    both = fresh(mode=mode)
    fit_residual(both, data, epochs=2, batch_size=64)
    assert (not torch.equal(both.physics.raw_inertia, data.physics.raw_inertia)) == (mode != "frozen")


def test_physics_that_learns_finds_what_is_its_own() -> None:
    truth, given = physics(), physics()
    with torch.no_grad():
        truth.terms[0].coefficients += 0.4

    def missing(x: Tensor) -> Tensor:
        states = x.unflatten(-1, (3, N)).unbind(-2)
        with torch.no_grad():
            return truth(*states) - given(*states)

    model = fresh(mode="joint")
    data = made(missing)
    fit_residual(model, data, epochs=40, batch_size=32, lr=2e-2, orthogonality=100.0, anchor=0.0)
    with torch.no_grad():
        rest = data.residual - model.change(data.features, data.physics)
    assert rest.square().mean() < 0.1 * data.residual.square().mean()
    assert data.metric.said(model.network_torque(data.features)) < 0.01 * data.residual.square().mean()


def test_noise_is_not_learned() -> None:
    def noise(x: Tensor) -> Tensor:
        return torch.randn(len(x), N, generator=torch.Generator().manual_seed(int(1e6 * x[0, 0].abs())))

    new, found = made(noise, 2), []
    for validation in (made(noise, 1), None):
        model = fresh()
        fit_residual(model, made(noise), validation=validation, epochs=30, batch_size=64, lr=5e-3)
        found.append(float(model.left(new).square().mean() / new.residual.square().mean()))
    assert found[0] < 1.02
    assert found[1] > 1.1


def test_outside_it_is_no_worse_than_the_physics_on_a_recording() -> None:
    model = physics()
    train, validation = (residual_dataset(model, recording(), split=part) for part in ("train", "validation"))
    fast = recording(30.0, 5, "fast", pace=2.0)
    net = fresh()
    fit_residual(net, train.select(train.t < 15.0), validation=validation, epochs=30, lr=3e-3)
    shares = net.shares(residual_dataset(model, fast, cutoff_hz=train.cutoff_hz))
    assert 0.02 < shares.outside < 1
    assert (shares.network_outside == 0).all()
    torch.testing.assert_close(shares.left_outside, shares.alone_outside, rtol=0, atol=0)


def test_a_training_goes_on_where_it_stopped(tmp_path: Path) -> None:
    data, validation = made(product), made(product, 1)
    network = lambda: nn.Sequential(nn.Linear(8, 16), nn.Dropout(0.2), nn.Tanh(), nn.Linear(16, 2))  # noqa: E731
    options = {"validation": validation, "batch_size": 64, "lr": 1e-2, "seed": 3}

    def model() -> ResidualDynamics:
        torch.manual_seed(0)
        return ResidualDynamics(physics(), network(), mode="alternating")

    straight, stopped = model(), model()
    once = fit_residual(straight, data, epochs=6, **options)
    fit_residual(stopped, data, epochs=3, checkpoint=tmp_path / "c", **options)
    later = model()
    twice = fit_residual(later, data, epochs=6, checkpoint=tmp_path / "c", **options)
    assert once == twice
    for a, b in zip(straight.state_dict().values(), later.state_dict().values(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)
    again = model()
    assert fit_residual(again, data, epochs=6, checkpoint=tmp_path / "c", **options) == once
    torch.testing.assert_close(again.left(data), later.left(data), rtol=0, atol=0)
    assert {path.name for path in tmp_path.iterdir()} == {"c"}
    with safe_open(tmp_path / "c", framework="pt") as file:
        assert json.loads(file.metadata()["progress"])["loss"] == once.loss
    assert len(load_file(tmp_path / "c")) > 10


def test_a_checkpoint_of_another_kind_is_refused(tmp_path: Path) -> None:
    data = made(product)
    fit_residual(fresh(), data, epochs=1, checkpoint=tmp_path / "c")
    with pytest.raises(InputError, match="is of another model; delete it"):
        fit_residual(fresh(kind="lagrangian"), data, epochs=2, checkpoint=tmp_path / "c")
    (tmp_path / "d").write_bytes(b"nothing")
    with pytest.raises(InputError, match="cannot be read as a checkpoint"):
        fit_residual(fresh(), data, epochs=2, checkpoint=tmp_path / "d")


def test_half_precision_learns_nearly_the_same() -> None:
    data, left = made(product), []
    for amp in (False, True):
        model = fresh()
        fit_residual(model, data, epochs=15, batch_size=64, lr=5e-3, amp=amp)
        assert all(p.dtype == torch.float32 for p in model.correction.network.parameters())
        left.append(float(model.left(data).square().mean()))
    assert left[0] < 0.5 * float(data.residual.square().mean())
    assert left[1] == pytest.approx(left[0], rel=0.15)
    assert left[1] != left[0]


@pytest.mark.parametrize(
    ("options", "words"),
    [({"epochs": -1}, "epochs is -1"), ({"batch_size": 0}, "batch_size is 0"), ({"lr": -1.0}, "lr is -1.0")],
)
def test_numbers_out_of_range_are_refused(options: dict, words: str) -> None:
    with pytest.raises(OptionError, match=words):
        fit_residual(fresh(), made(product), **options)


def test_other_data_are_refused() -> None:
    data = made(product)
    with pytest.raises(InputError, match=r"the data have 0 step\(s\) of history, the model 2"):
        fit_residual(fresh(history=2), data)
    with pytest.raises(InputError, match="have no samples"):
        fit_residual(fresh(), data.select(torch.zeros(len(data), dtype=torch.bool)))


SHARED = """
import sys
import torch, torch.distributed as dist
from learning.test_fit_residual import fresh, made, product
from torchrbd import fit_residual
torch.set_num_threads(1)
rank, size, meet, out = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], sys.argv[4]
if size > 1:
    dist.init_process_group("gloo", init_method=f"file://{meet}", rank=rank, world_size=size)
model = fresh(mode="joint")
training = fit_residual(model, made(product), epochs=3, batch_size=64, lr=5e-3, checkpoint=f"{out}/c{size}")
torch.save((model.state_dict(), training.loss), f"{out}/{size}_{rank}")
if size > 1:
    dist.destroy_process_group()
"""


@pytest.mark.slow
def test_two_processes_learn_what_one_does(tmp_path: Path) -> None:
    path = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2]), str(Path(__file__).parents[2] / "examples")]
    start = f"import sys; sys.path[:0] = {path}\n{SHARED}"
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", start, str(rank), str(size), str(tmp_path / "meet"), str(tmp_path)],
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank, size in ((0, 1), (0, 2), (1, 2))
    ]
    for run in runs:
        _, words = run.communicate(timeout=120)
        assert run.returncode == 0, words
    alone, *both = (torch.load(tmp_path / name, weights_only=True) for name in ("1_0", "2_0", "2_1"))
    for state, loss in both:
        assert loss == pytest.approx(alone[1], rel=1e-5)
        for name, x in state.items():
            torch.testing.assert_close(x, alone[0][name], rtol=1e-4, atol=1e-5)
    for name, x in both[0][0].items():
        torch.testing.assert_close(x, both[1][0][name], rtol=0, atol=0)
