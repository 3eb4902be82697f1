"""Baseline friction of all joints at once: a few operations for any number of such terms.

    tau = d qd + c s + a |s| + o,   s = tanh(qd / rest_width)

d, c, a and o (n_dof,) are the sums of the terms' coefficients at each joint. Evaluated one by one, each term takes some
ten torch operations. For one sample that is a millisecond for two terms at each of seven joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchrbd.effects import Term
from torchrbd.effects.base import DIRECTION, LEVEL, SPEED, UNEVENNESS

# Labels of the columns that d, c, a and o multiply, in their order.
_COLUMNS = (SPEED, DIRECTION, UNEVENNESS, LEVEL)


def is_plain(term: Term) -> bool:
    """Return whether a term is baseline friction, at all times and in all recordings."""
    return term.effect.is_baseline and term.site.always


def _parts(term: Term) -> list[int]:
    """Return which of d, c, a and o a term's coefficients add to."""
    return [_COLUMNS.index(label) for label in term.effect.plain_columns]


def placing(n_dof: int, terms: Sequence[Term]) -> Tensor:
    """Return the matrix (4, n_dof, K) from the coefficients of baseline terms to d, c, a and o."""
    at: list[tuple[int, int]] = []
    for term in terms:
        assert term.site.joint is not None
        at += [(part, term.site.joint) for part in _parts(term)]
    matrix = torch.zeros(4, n_dof, len(at), dtype=torch.float64)
    for k, (part, joint) in enumerate(at):
        matrix[part, joint, k] = 1.0
    return matrix


def plain_torque(terms: Sequence[Term], matrix: Tensor, qd: Tensor, rest_width: Tensor) -> Tensor:
    """Return the torque of baseline terms, differentiable in states and coefficients.

    Args:
        terms, matrix: as for ``placing``.
        qd: (*batch, n_dof) [rad/s, m/s].
        rest_width: (n_dof,) [rad/s, m/s].

    Returns:
        (*batch, n_dof) [N m] or [N].
    """
    if not terms:
        return torch.zeros_like(qd)
    w = torch.cat([term.coefficients for term in terms]).to(qd.dtype)
    viscous, coulomb, uneven, offset = (matrix.to(qd) @ w).unbind(0)
    has = {part for term in terms for part in _parts(term)}
    torque = viscous * qd
    if has & {1, 2}:
        direction = torch.tanh(qd / rest_width.to(qd.dtype))
        torque = torque + coulomb * direction
        if 2 in has:
            torque = torque + uneven * direction.abs()
    return torque + offset if 3 in has else torque
