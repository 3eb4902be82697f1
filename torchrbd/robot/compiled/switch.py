"""Dispatch of a call: a kernel as it is, with derivatives, as an operator in a graph, or torch's own operations."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import torch
from torch import Tensor
from torch._C._functorch import TransformType, get_interpreter_stack

from torchrbd._runtime.compiling import is_transformed, is_watched, library
from torchrbd.robot.compiled.calls import KERNELS, physical_torque, torque_slopes
from torchrbd.robot.compiled.functions import TransformedValue, differentiable_value
from torchrbd.robot.compiled.kernel import INVERSE_DYNAMICS, Kernel
from torchrbd.robot.compiled.operators import OPERATORS
from torchrbd.robot.compiled.tables import Tables

_ORDINARY = (Tensor, torch.nn.Parameter)
_EXACT = torch.float64
_BATCHES, _FORWARD = TransformType.Vmap, TransformType.Jvp
_refused = 0
_Function = TypeVar("_Function", bound=Callable[..., object])


def _constant_in_graphs(function: _Function) -> _Function:
    """Mark a function whose result is a constant in graphs, as torch.compiler.assume_constant_result does.

    That function imports the compiler, which takes longer than all other imports.
    """
    function._dynamo_marked_constant = True  # type: ignore[attr-defined]
    return function


@contextmanager
def only_eager() -> Iterator[None]:
    """Use torch's own operations inside the context, in all threads: for comparisons."""
    global _refused
    _refused += 1
    try:
        yield
    finally:
        _refused -= 1


@_constant_in_graphs
def is_available() -> bool:
    """Return whether there are compiled kernels; builds them if needed."""
    return library(KERNELS) is not None


def call(kernel: Kernel, tables: Tables, *arguments: Tensor) -> Tensor | None:
    """Return a kernel's value, differentiable, or None where torch's own operations must be used.

    They must be used if nothing is compiled, on other devices, in dtypes other than float32 and float64, for tensor
    subclasses, while a model is exported or traced, and in forward-mode differentiation. float32 is computed in
    float64.

    Args:
        arguments: the kernel's; the result has q's dtype, and batches broadcast.
    """
    if torch.compiler.is_compiling():
        return _in_graph(kernel, tables, arguments)
    if not _is_plainly_run():
        return None
    if torch._C._are_functorch_transforms_active():
        return _transformed(kernel, tables, arguments)
    ordinary, exact, tracked = _seen(kernel, arguments)
    if not ordinary:
        return None
    dtype = arguments[0].dtype
    if not exact:
        if not _fits(kernel, arguments):
            return None
        arguments = _exact(kernel, arguments)
    found = differentiable_value(kernel, tables, *arguments) if tracked else kernel.value(tables, *arguments)
    return found if exact else found.to(dtype)


def call_physical_torque(tables: Tables, *arguments: Tensor) -> Tensor | None:
    """Return the torques for log-Cholesky coordinates, of q, qd, qdd, theta (n_bodies, 10) and gravity.

    One call instead of two: calls dominate the time of a single sample. None where a derivative is needed, for dtypes
    other than float64, and in transforms and graphs.
    """
    if not _is_run_as_it_is() or arguments[3].shape != (tables.constants.numel() // 35, 10):
        return None
    ordinary, exact, tracked = _seen(INVERSE_DYNAMICS, arguments)
    return physical_torque(tables, *arguments) if ordinary and exact and not tracked else None


def call_torque_slopes(tables: Tables, *arguments: Tensor) -> Tensor | None:
    """Return the derivatives of the inverse dynamics with respect to q, qd, qdd, (*batch, 3, n_dof, n_dof), as `call`.

    None where second derivatives are needed too, and in transforms and graphs.
    """
    if not _is_run_as_it_is():
        return None
    if not _fits(INVERSE_DYNAMICS, arguments) or any(x.is_neg() for x in arguments):
        return None
    if torch.is_grad_enabled() and any(x.requires_grad for x in arguments):
        return None
    return torque_slopes(tables, *_exact(INVERSE_DYNAMICS, arguments)).to(arguments[0].dtype)


def _seen(kernel: Kernel, arguments: tuple[Tensor, ...]) -> tuple[bool, bool, bool]:
    """Return whether tensors are plain ones on the CPU, are float64 with states of one shape, and need derivatives.

    All in one loop, since such checks dominate the time of a single sample. If the first is False, the others have no
    meaning.
    """
    shape, exact, tracked = arguments[0].shape, True, False
    for k, x in enumerate(arguments):
        if type(x) not in _ORDINARY or not x.is_cpu or x.is_neg():
            return False, False, False
        exact = exact and x.dtype is _EXACT and (k >= kernel.states or x.shape == shape)
        tracked = tracked or x.requires_grad
    return True, exact, tracked and torch.is_grad_enabled()


def _is_run_as_it_is() -> bool:
    """Return whether kernels may be called directly: no graph is made and no transform is active."""
    return not (_refused or is_transformed() or not is_available())


def _is_plainly_run() -> bool:
    """Return whether kernels may be used: no graph is made and no forward-mode differentiation is active."""
    return not (_refused or is_watched() or not is_available())


def _in_graph(kernel: Kernel, tables: Tables, arguments: tuple[Tensor, ...]) -> Tensor | None:
    if kernel.name not in OPERATORS or _refused or _exporting() or not _fits(kernel, arguments) or not is_available():
        return None
    # Operators have no derivatives for torch.func.
    if not _nothing_but_batches():
        return None
    return OPERATORS[kernel.name](*_exact(kernel, arguments), *tables).to(arguments[0].dtype)


def _transformed(kernel: Kernel, tables: Tables, arguments: tuple[Tensor, ...]) -> Tensor | None:
    if _FORWARD in _levels() or not _fits(kernel, arguments) or any(x.is_neg() for x in arguments):
        return None
    return TransformedValue.apply(kernel, tables, *_exact(kernel, arguments)).to(arguments[0].dtype)


def _fits(kernel: Kernel, arguments: tuple[Tensor, ...]) -> bool:
    dtype = arguments[0].dtype
    return (
        (dtype is _EXACT or dtype is torch.float32)
        and all(type(x) in _ORDINARY and x.is_cpu for x in arguments)
        and all(x.dtype is dtype for x in arguments[1 : kernel.states])
    )


def _exact(kernel: Kernel, arguments: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """Return arguments in float64, with states of one shape."""
    states = torch.broadcast_tensors(*arguments[: kernel.states])
    return tuple(x.to(_EXACT) for x in (*states, *arguments[kernel.states :]))


def _exporting() -> bool:
    """Return whether a graph is exported; before torch 2.7 this is unknown, so every graph counts as exported."""
    is_exporting = getattr(torch.compiler, "is_exporting", None)
    return is_exporting is None or is_exporting()


@_constant_in_graphs
def _nothing_but_batches() -> bool:
    return _levels() <= {_BATCHES}


def _levels() -> set[TransformType]:
    """Return the kinds of torch.func transforms that are active."""
    if not torch._C._are_functorch_transforms_active():
        return set()
    return {level.key() for level in get_interpreter_stack() or ()}
