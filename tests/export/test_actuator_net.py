"""A network as TorchScript, fed as Isaac Lab feeds it: histories of errors and velocities, a row per joint."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

import torchrbd
from torchrbd.errors import InputError, OptionError

ENVS, JOINTS, BACK = 3, 4, (0, 2, 5)
POS_SCALE, VEL_SCALE, TORQUE_SCALE = 2.0, 0.5, 30.0


class Learned(nn.Module):
    """Errors and velocities of three steps to a torque."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(2 * len(BACK), 8), nn.Softsign(), nn.Dropout(0.5), nn.Linear(8, 1))

    def forward(self, x: Tensor) -> Tensor:
        return self.layers(x).squeeze(-1)


def in_the_simulator(file: Path, errors: Tensor, speeds: Tensor) -> Tensor:
    """Return torques (ENVS, JOINTS) of histories (ENVS, steps, JOINTS), the present step first."""
    network = torch.jit.load(file, map_location="cpu")
    rows = [
        torch.stack([history[:, k] for k in BACK], -1).reshape(ENVS * JOINTS, len(BACK)) for history in (errors, speeds)
    ]
    return network(torch.cat((POS_SCALE * rows[0], VEL_SCALE * rows[1]), 1)).view(ENVS, JOINTS) * TORQUE_SCALE


@pytest.mark.filterwarnings("ignore:.*torch.jit.load:DeprecationWarning")  # what the simulator calls
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_file_gives_the_networks_torque(dtype: torch.dtype, tmp_path: Path) -> None:
    torch.manual_seed(0)
    network, file = Learned().to(dtype), tmp_path / "actuator.pt"
    torchrbd.to_actuator_net(network, file, n_history=len(BACK))
    assert network.training
    errors, speeds = torch.randn(2, ENVS, max(BACK) + 1, JOINTS)
    found = in_the_simulator(file, errors, speeds)
    assert not found.requires_grad
    for env in range(ENVS):
        for joint in range(JOINTS):
            seen = [POS_SCALE * errors[env, k, joint] for k in BACK] + [VEL_SCALE * speeds[env, k, joint] for k in BACK]
            tau = TORQUE_SCALE * network.eval()(torch.stack(seen)[None].to(dtype)).detach()
            assert float(found[env, joint]) == pytest.approx(float(tau), rel=1e-4, abs=1e-4)


class Mixed(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return x[:, :1] - x.mean()


class Unscriptable(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return torch.stack([*(row.sum() for row in x)])


@pytest.mark.parametrize(
    ("network", "words"),
    [
        (nn.Linear(5, 1), r"Linear: does not take an input of shape \(6, 6\)"),
        (nn.Linear(6, 2), r"Linear: gives \(6, 2\) for an input of shape \(6, 6\); expected \(6, 1\) or \(6,\)"),
        (nn.LSTM(6, 1), r"LSTM: gives tuple for an input"),
        (Mixed(), "Mixed: what it gives for a row depends on the other rows"),
        (Unscriptable(), "Unscriptable: cannot be written as TorchScript"),
    ],
)
def test_what_the_simulator_could_not_use_is_refused(network: nn.Module, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words):
        torchrbd.to_actuator_net(network, tmp_path / "a.pt", n_history=3)
    assert not (tmp_path / "a.pt").exists()


def test_a_history_has_a_step(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="n_history is 0; expected 1 or more"):
        torchrbd.to_actuator_net(Learned(), tmp_path / "a.pt", n_history=0)
