"""Instrumental variables: the regressor at the set-points, which carries no encoder noise."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import filtered_rows
from torchrbd.display import Remark
from torchrbd.errors import OptionError
from torchrbd.inference.estimators.problem import LinearProblem

# Of the largest singular value: what is below it is rounding.
_SINGULAR = 1e-13


def instrumental_variables(problem: LinearProblem) -> tuple[Tensor, Remark | None]:
    """Fit with the set-points' regressor Z as instruments for the measured one.

        sum_j w_j Z_j' Y_j x = sum_j w_j Z_j' tau_j,   Z = Y(q_ref, qd_ref, qdd_ref)

    Noise of encoder and torque sensor is not correlated with Z, so that x is consistent; its spread grows as the robot
    follows its set-points less closely. Needs one more pass over the recordings. Joints are weighted as in weighted
    least squares.

    Returns:
        x (n,), and what a user should know.

    Raises:
        OptionError: a fitted recording has no set-points; it is named.

    Source: Janot, Vandanjon, Gautier, "A generic instrumental variable approach for industrial robot identification",
    IEEE T-CST 2014, eq. (14), there with instruments from a simulation of the controlled robot.
    """
    lacking = [r.name for r in problem.prepared.recordings if r.name in problem.prepared.fitted and not r.has_reference]
    if lacking:
        raise OptionError(
            f"estimator 'iv' needs the set-points of every joint, columns q_ref_<joint>; there are none in "
            f"{', '.join(lacking)}: record them or use another estimator"
        )
    columns = problem.training.columns
    _, variance = problem.weighted()
    G, g = torch.zeros(columns.n, columns.n, dtype=torch.float64), torch.zeros(columns.n, dtype=torch.float64)
    length_sq = torch.zeros(columns.n, dtype=torch.float64)
    for states, fitted, measured in problem.samples():
        assert states.reference is not None
        rows, _ = filtered_rows(columns, states)
        wanted = dict(zip(("q", "qd", "qdd"), states.reference, strict=True))
        instruments, _ = filtered_rows(columns, replace(states, **wanted))
        weight = problem.prepared.filtering.effective_rate * states.dt_out
        for joint in torch.nonzero(measured).flatten().tolist():
            own, w = columns.of_joint[joint], weight / variance[joint]
            a, Z = rows[joint][:, fitted], instruments[joint][:-1, fitted]
            G[own.unsqueeze(1), own] += w * Z @ a[:-1].T
            g[own] += w * Z @ a[-1]
            length_sq[own] += w * a[:-1].square().sum(1)
    b = problem.chosen
    inverse, rank = _pseudo_inverse(G[b][:, b], length_sq[b].sqrt())
    x = problem.reference + problem.lift @ (inverse @ (g - G @ problem.reference)[b])
    return x, None if rank == len(b) else Remark("identified by set-points", {"identified": rank, "of": len(b)})


def _pseudo_inverse(A: Tensor, length: Tensor) -> tuple[Tensor, int]:
    """Return the inverse of normal equations A (d, d), and their rank: directions lost in rounding are left out.

    Args:
        A: not necessarily symmetric (instruments).
        length: (d,) of the columns, to balance A.
    """
    scale = length.unsqueeze(1) * length
    U, s, Vh = torch.linalg.svd(A / scale)
    rank = int((s > _SINGULAR * s[:1]).sum())
    return (Vh[:rank].T / s[:rank]) @ U[:, :rank].T / scale, rank
