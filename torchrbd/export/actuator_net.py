"""A network of an actuator as TorchScript, as Isaac Lab's ActuatorNetMLPCfg loads it.

At each step Isaac Lab gives one row per joint of each environment, in float32: position errors (target less position)
and velocities, each at the steps back that ``input_idx`` names, scaled and one after the other,

    (num_envs * num_joints, 2 n_history) -> (num_envs * num_joints, 1) or (num_envs * num_joints,)

and takes ``torque_scale`` times the output for the torque. A step back of 0 is the present one.

Source: isaaclab.actuators, ActuatorNetMLP and its configuration (network_file, pos_scale, vel_scale, torque_scale,
    input_order, input_idx).
"""

from __future__ import annotations

import copy
import warnings
from pathlib import Path

import torch
from torch import nn

from torchrbd._runtime.outputs import write_whole
from torchrbd.errors import InputError, OptionError

# Rows to try with: of several environments, so that a network that mixes rows is seen.
_ROWS = 6


def to_actuator_net(network: nn.Module, path: str | Path, *, n_history: int) -> None:
    """Write a network as TorchScript, for ``ActuatorNetMLPCfg(network_file=path, ...)``.

    What is written is a copy in float32, in evaluation mode and without gradients. Its rows are joints: what it says
    of one must not depend on the others.

    Args:
        network: (rows, 2 n_history) to (rows, 1) or (rows,): errors and velocities in the configuration's
            ``input_order``, times ``pos_scale`` and ``vel_scale``, to torque over ``torque_scale``.
        path: of the file, usually .pt.
        n_history: how many steps ``input_idx`` names, e.g. 3 for (0, 1, 2).

    Raises:
        OptionError: there is no step in the history.
        InputError: the network does not take such rows, gives another shape, mixes them, or cannot be scripted.
    """
    if n_history < 1:
        raise OptionError(f"n_history is {n_history}; expected 1 or more: the present step counts")
    own = copy.deepcopy(network).float().eval().requires_grad_(False)
    name, rows = type(network).__name__, torch.linspace(-1.0, 1.0, _ROWS * 2 * n_history).reshape(_ROWS, -1)
    shape = f"({_ROWS}, {2 * n_history})"
    with torch.no_grad():
        try:
            whole = own(rows)
        except (RuntimeError, TypeError) as error:
            raise InputError(f"{name}: does not take an input of shape {shape}: {error}") from None
        if not isinstance(whole, torch.Tensor) or whole.shape not in ((_ROWS, 1), (_ROWS,)):
            got = tuple(whole.shape) if isinstance(whole, torch.Tensor) else type(whole).__name__
            raise InputError(f"{name}: gives {got} for an input of shape {shape}; expected ({_ROWS}, 1) or ({_ROWS},)")
        if not torch.allclose(own(rows[:1]), whole[:1], rtol=1e-4, atol=1e-6):
            raise InputError(f"{name}: what it gives for a row depends on the other rows, which are other joints")
    with warnings.catch_warnings():
        # PyTorch would like torch.export, which Isaac Lab does not read.
        warnings.filterwarnings("ignore", ".*torch.jit", DeprecationWarning)
        try:
            scripted = torch.jit.script(own)
        except (RuntimeError, OSError) as error:
            raise InputError(f"{name}: cannot be written as TorchScript: {error}") from None
        write_whole(path, scripted.save_to_buffer())
