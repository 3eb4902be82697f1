"""Kernels: functions of states and of parameters that samples share, their derivatives, and the same in plain torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchrbd.robot import eager
from torchrbd.robot.compiled import calls
from torchrbd.robot.compiled.tables import Tables, geometry_of

SHARED = ("pi", "gravity")
"""Arguments that all samples share, unless each has its own."""


@dataclass(frozen=True, eq=False)
class Kernel:
    """A compiled function of tensors.

    Attributes:
        name: its operator's.
        arguments: names of its tensors: states, then the shared ones.
        states: number of states.
        value: (tables, *arguments) -> result.
        adjoint: (tables, *arguments, weight, wanted) -> derivatives of `(weight * result).sum()` by the arguments.
        plain: (tables, *arguments) -> result, in torch's own operations.
    """

    name: str
    arguments: tuple[str, ...]
    states: int
    value: Callable[..., Tensor]
    adjoint: Callable[..., tuple[Tensor | None, ...]]
    plain: Callable[..., Tensor]

    def plain_adjoint(self, tables: Tables, *arguments: Tensor) -> tuple[Tensor, ...]:
        """Return the result of `adjoint`, of (*arguments, weight), differentiable any number of times."""
        *x, weight = arguments

        def value(*x: Tensor) -> Tensor:
            if all(y.ndim == 1 for y, name in zip(x, self.arguments, strict=True) if name in SHARED):
                return self.plain(tables, *x)
            flat = [y.reshape(-1, y.shape[-1]) for y in x]
            found = torch.vmap(lambda *x: self.plain(tables, *x))(*flat)
            return found.reshape(*x[0].shape[:-1], *found.shape[1:])

        return torch.func.vjp(value, *x)[1](weight)

    def plain_adjoint_adjoint(self, tables: Tables, arguments: Any, weights: Any) -> tuple[Tensor, ...]:
        """Return the derivatives of `sum(weights . adjoint)` by (*arguments, weight)."""
        with torch.enable_grad():
            return torch.func.vjp(lambda *x: self.plain_adjoint(tables, *x), *arguments)[1](tuple(weights))

    def batched(
        self, call: Callable[..., Any], info: Any, in_dims: tuple[int | None, ...], *x: Tensor
    ) -> tuple[Any, Any]:
        """Return the value of a call with one more batch dimension, and that dimension's position: a batching rule.

        Each sample then has its own pi and gravity where these differ. So it has in derivatives, whose sums are over
        the samples of each batch, not over all.

        Args:
            call: of tensors as x, each with the batch dimension first or not at all.
            info: with the `batch_size`.
            in_dims: of x.
            x: arguments, and the weight of a derivative.
        """
        shared, is_adjoint = range(self.states, len(self.arguments)), len(x) > len(self.arguments)
        batch = _with_batch(x[0], in_dims[0], info.batch_size).shape[:-1]
        single = [k for k in shared if x[k].ndim - (in_dims[k] is not None) == 1]
        apart = is_adjoint or len(single) < len(shared) or any(in_dims[k] is not None for k in shared)
        given = []
        for k, (y, dim) in enumerate(zip(x, in_dims, strict=True)):
            if k in shared and not apart:
                given.append(y)
                continue
            y = _with_batch(y, dim, info.batch_size)
            given.append(y.reshape(len(y), *[1] * (len(batch) - 1), -1).expand(*batch, -1) if k in single else y)
        found = call(*given)
        if not is_adjoint:
            return found, 0
        inner = tuple(range(1, len(batch)))
        return tuple(y.sum(inner) if k in single and inner else y for k, y in enumerate(found)), (0,) * len(found)


def _with_batch(x: Tensor, dim: int | None, size: int) -> Tensor:
    return x.expand(size, *x.shape) if dim is None else x.movedim(dim, 0)


def _kernel(name: str, *arguments: str) -> Kernel:
    def plain(tables: Tables, *x: Tensor) -> Tensor:
        return getattr(eager, name)(geometry_of(tables), *x)

    states = sum(x not in SHARED for x in arguments)
    return Kernel(name, arguments, states, getattr(calls, name), getattr(calls, f"{name}_adjoint"), plain)


INVERSE_DYNAMICS = _kernel("inverse_dynamics", "q", "qd", "qdd", "pi", "gravity")
REGRESSOR = _kernel("regressor", "q", "qd", "qdd", "gravity")
MASS_MATRIX = _kernel("mass_matrix", "q", "pi")


def log_cholesky_kernel(plain: Callable[[Tensor], Tensor]) -> Kernel:
    """Return the kernel from log-Cholesky coordinates to inertial parameters, both (*batch, 10); call with `NO_ROBOT`.

    Args:
        plain: the same in torch's own operations.
    """
    functions = calls.log_cholesky, calls.log_cholesky_adjoint
    return Kernel("log_cholesky", ("theta",), 1, *functions, lambda _, theta: plain(theta))
