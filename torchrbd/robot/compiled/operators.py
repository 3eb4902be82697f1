"""The kernels as torch operators, "torchrbd::inverse_dynamics" and so on, for compiled graphs.

Their arguments are the kernel's, then the robot's tables. They have derivatives, fake tensors and batching rules.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torchrbd.robot.compiled.kernel import INVERSE_DYNAMICS, MASS_MATRIX, REGRESSOR, Kernel
from torchrbd.robot.compiled.tables import Tables

NAMESPACE = "torchrbd"


def _register(kernel: Kernel, fake: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Register a kernel and its derivatives; return the operator of (*arguments, structure, constants).

    Args:
        fake: the result's shape and strides, given (arguments, constants).
    """
    tensors, tables = ", ".join(f"Tensor {x}" for x in kernel.arguments), "Tensor structure, Tensor constants"
    of, of_adjoint = f"{NAMESPACE}::{kernel.name}", f"{NAMESPACE}::{kernel.name}_adjoint"
    results = ", ".join(["Tensor"] * len(kernel.arguments))
    torch.library.define(of, f"({tensors}, {tables}) -> Tensor")
    torch.library.define(of_adjoint, f"({tensors}, Tensor weight, {tables}) -> ({results})")
    defined = getattr(torch.ops, NAMESPACE)
    value, adjoint = getattr(defined, kernel.name).default, getattr(defined, f"{kernel.name}_adjoint").default

    def differentiate(ctx: Any, weight: Tensor) -> tuple[Tensor | None, ...]:
        return *adjoint(*ctx.saved_tensors, weight, *ctx.tables), None, None

    def differentiate_adjoint(ctx: Any, *weights: Tensor) -> tuple[Tensor | None, ...]:
        return *kernel.plain_adjoint_adjoint(Tables(*ctx.tables), ctx.saved_tensors, weights), None, None

    torch.library.impl(of, "cpu", lambda *x: kernel.value(Tables(*x[-2:]), *_plain(x[:-2])))
    torch.library.impl(of_adjoint, "cpu", lambda *x: kernel.adjoint(Tables(*x[-2:]), *_plain(x[:-2])))
    torch.library.register_fake(of, lambda *x: fake(x[:-2], x[-1]))
    torch.library.register_fake(of_adjoint, lambda *x: tuple(y.new_empty(y.shape) for y in x[: len(kernel.arguments)]))
    torch.library.register_autograd(of, differentiate, setup_context=_keep)
    torch.library.register_autograd(of_adjoint, differentiate_adjoint, setup_context=_keep)
    torch.library.register_vmap(of, _batching(kernel, value))
    torch.library.register_vmap(of_adjoint, _batching(kernel, adjoint))
    return value


def _keep(ctx: Any, inputs: tuple[Tensor, ...], output: object) -> None:
    ctx.save_for_backward(*inputs[:-2])
    ctx.tables = inputs[-2:]


def _plain(x: tuple[Tensor, ...]) -> list[Tensor]:
    """Return arguments for which results have the strides that the graph assumes."""
    return [y.resolve_neg().contiguous() for y in x]


def _batching(kernel: Kernel, operator: Callable[..., Any]) -> Callable[..., Any]:
    def rule(info: Any, in_dims: tuple[int | None, ...], *x: Tensor) -> tuple[Any, Any]:
        return kernel.batched(lambda *y: operator(*y, *x[-2:]), info, in_dims[:-2], *x[:-2])

    return rule


def _regressor(x: tuple[Tensor, ...], constants: Tensor) -> Tensor:
    q = x[0]
    n_params, batch = constants.numel() // 35 * 10, q.shape[:-1]
    Y = q.new_empty((q.shape[-1], n_params, q.numel() // q.shape[-1])).movedim(-1, 0)
    return Y.unflatten(0, batch) if batch else Y[0]


OPERATORS = {
    "inverse_dynamics": _register(INVERSE_DYNAMICS, lambda x, _: x[0].new_empty(x[0].shape)),
    "regressor": _register(REGRESSOR, _regressor),
    "mass_matrix": _register(MASS_MATRIX, lambda x, _: x[0].new_empty((*x[0].shape, x[0].shape[-1]))),
}
