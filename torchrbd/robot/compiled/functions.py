"""The kernels as functions of autograd, and of torch.func.

    y = f(x), x_bar = f'(x)' y_bar:  kernels.   The derivatives of x_bar:  torch's own operations.

Functions for torch.func cost some 40 us a call more than the kernel, functions for autograd alone 5 us; hence both.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torchrbd.robot.compiled.kernel import Kernel
from torchrbd.robot.compiled.tables import Tables


def _has_memory(x: Tensor) -> bool:
    """Return whether a tensor is a real one; with is_grads_batched it is a batch without memory of its own."""
    try:
        x.data_ptr()
    except RuntimeError:
        return False
    return True


class Value(torch.autograd.Function):
    """A kernel's value, of `(kernel, tables, *arguments)`."""

    @staticmethod
    def forward(ctx: Any, kernel: Kernel, tables: Tables, *arguments: Tensor) -> Tensor:
        ctx.kernel, ctx.tables = kernel, tables
        ctx.save_for_backward(*arguments)
        return kernel.value(tables, *arguments)

    @staticmethod
    def backward(ctx: Any, weight: Tensor) -> tuple[Tensor | None, ...]:
        wanted = ctx.needs_input_grad[2:]
        if torch._C._are_functorch_transforms_active():
            found = TransformedAdjoint.apply(ctx.kernel, ctx.tables, *ctx.saved_tensors, weight)
        elif not _has_memory(weight):
            found = ctx.kernel.plain_adjoint(ctx.tables, *ctx.saved_tensors, weight)
        elif torch.is_grad_enabled():
            found = Adjoint.apply(ctx.kernel, ctx.tables, *ctx.saved_tensors, weight.resolve_neg())
        else:
            found = ctx.kernel.adjoint(ctx.tables, *ctx.saved_tensors, weight.resolve_neg(), wanted)
        return None, None, *(x if w else None for x, w in zip(found, wanted, strict=True))


class Adjoint(torch.autograd.Function):
    """A kernel's derivatives, of `(kernel, tables, *arguments, weight)`."""

    @staticmethod
    def forward(ctx: Any, kernel: Kernel, tables: Tables, *arguments: Tensor) -> tuple[Tensor, ...]:
        ctx.kernel, ctx.tables = kernel, tables
        ctx.save_for_backward(*arguments)
        return kernel.adjoint(tables, *arguments)  # type: ignore[return-value]

    @staticmethod
    def backward(ctx: Any, *weights: Tensor) -> tuple[Tensor | None, ...]:
        return None, None, *ctx.kernel.plain_adjoint_adjoint(ctx.tables, ctx.saved_tensors, weights)


# Function.apply first does work for torch.func, which takes a third of a call.
differentiable_value = super(torch.autograd.Function, Value).apply  # pyright: ignore[reportAttributeAccessIssue]


class TransformedValue(torch.autograd.Function):
    """A kernel's value, of `(kernel, tables, *arguments)`, in all transforms of torch.func except forward mode."""

    @staticmethod
    def forward(kernel: Kernel, tables: Tables, *arguments: Tensor) -> Tensor:  # type: ignore[override]
        return kernel.value(tables, *arguments)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: object) -> None:
        ctx.kernel, ctx.tables, *arguments = inputs
        ctx.save_for_backward(*arguments)

    @staticmethod
    def backward(ctx: Any, weight: Tensor) -> tuple[Tensor | None, ...]:
        return None, None, *TransformedAdjoint.apply(ctx.kernel, ctx.tables, *ctx.saved_tensors, weight)

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[Any, ...], kernel: Kernel, tables: Tables, *arguments: Tensor
    ) -> tuple[Any, Any]:
        def call(*x: Tensor) -> Tensor:
            return TransformedValue.apply(kernel, tables, *x)

        return kernel.batched(call, info, in_dims[2:], *arguments)


class TransformedAdjoint(torch.autograd.Function):
    """A kernel's derivatives, of `(kernel, tables, *arguments, weight)`, in the same transforms."""

    @staticmethod
    def forward(kernel: Kernel, tables: Tables, *arguments: Tensor) -> tuple[Tensor, ...]:  # type: ignore[override]
        return kernel.adjoint(tables, *arguments)  # type: ignore[return-value]

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: object) -> None:
        ctx.kernel, ctx.tables, *arguments = inputs
        ctx.save_for_backward(*arguments)

    @staticmethod
    def backward(ctx: Any, *weights: Tensor) -> tuple[Tensor | None, ...]:
        return None, None, *ctx.kernel.plain_adjoint_adjoint(ctx.tables, ctx.saved_tensors, weights)

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[Any, ...], kernel: Kernel, tables: Tables, *arguments: Tensor
    ) -> tuple[Any, Any]:
        def call(*x: Tensor) -> tuple[Tensor, ...]:
            return TransformedAdjoint.apply(kernel, tables, *x)

        return kernel.batched(call, info, in_dims[2:], *arguments)
