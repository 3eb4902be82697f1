"""How each inertial parameter is identified: by data or prior, and which motion would add most information.

    share = var(pi_k | data) / var(pi_k),   floor = var(pi_k | base parameters) / var(pi_k)

The variances belong to the curvature at the fit, with and without that of the data. The floor is what remains of a
parameter's variance after every possible motion. Of the part that motion can identify, this data leaves open

    unidentified = (share - floor) / (1 - floor)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from torchrbd.display import Remark, Stated
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.posterior.experiments import KINDS, Motion, described, information
from torchrbd.likelihood.urdf_prior import Prior, local_coordinates
from torchrbd.parameters import PARAMETERS_PER_BODY, BaseParameters, base_parameters

Status = Literal["identified", "combination", "unexcited", "not identifiable", "held"]

# Not identified: this data leaves open more than this part of what motion can identify.
_UNIDENTIFIED = 0.5
# A simpler motion is suggested if it leaves at most this much more than the best, or so little that it does not matter.
_AS_GOOD, _ENOUGH = 1.3, 0.15
# A motion that leaves more than this of what was untold is not worth its while.
_USELESS = 0.7
_NEIGHBOURS = 6
_LEAST = 1e-13


@dataclass(frozen=True)
class Identifiability(Stated):
    """What is known of one inertial parameter.

    Attributes:
        name, owner: of the parameter and its body.
        prior_share: share of information from the prior: 0 (the data alone) to 1 (the URDF alone).
        least_share: the same after every possible motion; above 0 where only combinations are identifiable.
        status: "identified" alone, in a "combination" with others, "unexcited" (other motions would identify it), "not
            identifiable" with the base fixed, or "held" as the URDF has it.
        combinations: its identifiable combinations, shortest first.
        motion: what to record to identify it, if "unexcited"; None where no short motion would at the present noise.
        suggested: the same with names and sizes.
        prior_share_after: predicted, with ten seconds of that motion added.
    """

    name: str
    owner: str
    prior_share: float
    least_share: float
    status: Status
    combinations: tuple[Remark, ...]
    motion: Motion | None
    suggested: Remark | None
    prior_share_after: float


def identifiability(prior: Prior, model: FittedModel, rate_hz: float) -> tuple[Identifiability, ...]:
    """Judge every inertial parameter.

    Args:
        prior: of the fit.
        model: the fit.
        rate_hz: independent samples a second of a recording, twice its cut-off.
    """
    robot, base = model.columns.robot, base_parameters(model.columns.robot)
    state = _State.of(prior, model, base)
    fitted = {k: row for row, k in enumerate(prior.inertial.tolist())}
    suggested = _suggestions(model, state, rate_hz)
    found = []
    for k, name in enumerate(robot.parameter_names):
        share, least = 1.0, 1.0
        status: Status = "held"
        combinations = tuple(sorted(base.combinations_with(k), key=lambda one: len(one.values["expression"])))
        row = fitted.get(k, -1)
        if row >= 0 and k in base.invisible:
            status = "not identifiable"
        elif row >= 0:
            share, least = float(state.share[row]), float(state.floor[row])
            status = "unexcited" if row in suggested else "combination" if combinations else "identified"
        motion, after = suggested[row] if status == "unexcited" else (None, share)
        advice = None if motion is None else described(robot, motion)
        owner = robot.body_names[k // PARAMETERS_PER_BODY]
        found.append(Identifiability(name, owner, share, least, status, combinations, motion, advice, after))
    return tuple(found)


@dataclass(frozen=True)
class _State:
    """The posterior in coordinates y with x = T y, in which the prior's curvature at the fit is 1.

    ``precision`` (n_free, n_free) in y; ``believed``, ``share`` and ``floor`` (n_inertial,) are prior variance and
    shares of it.
    """

    T: Tensor
    precision: Tensor
    believed: Tensor
    share: Tensor
    floor: Tensor

    @classmethod
    def of(cls, prior: Prior, model: FittedModel, base: BaseParameters) -> _State:
        n = len(prior.inertial)
        # Terms whose feature never occurs have no scale, and no variance.
        terms = prior.scale.diagonal()[model.free[n:]]
        T = torch.block_diag(local_coordinates(prior, model.x), torch.diag(torch.where(terms > 0, terms, 1.0)))
        inverse = torch.linalg.inv(T)
        values, axes = torch.linalg.eigh(inverse @ model.laplace @ inverse.T)
        values = values.clamp(_LEAST, 1.0)
        believed = T[:n].square().sum(1)
        K = base.combination[:, prior.inertial] @ T[:n, :n]
        _, s, Vh = torch.linalg.svd(K / K.norm(dim=1, keepdim=True).clamp_min(1e-300), full_matrices=False)
        identified = Vh[s > 1e-9 * s.max()] if len(s) else Vh
        floor = 1.0 - (T[:n, :n] @ identified.T).square().sum(1) / believed
        share = ((T @ axes)[:n].square() * values).sum(1) / believed
        return cls(T, (axes / values) @ axes.T, believed, share.clamp(0.0, 1.0), floor.clamp(0.0, 1.0))

    def share_after(self, H: Tensor) -> Tensor:
        """Return the shares (n_inertial,) with information H in y added."""
        # Friction of a joint that rested has a scale beyond all others: seen in coordinates of its own size.
        precision = self.precision + H
        size = precision.diagonal().rsqrt()
        scaled, X = size[:, None] * precision * size, size[:, None] * self.T[: len(self.believed)].T
        root, failed = torch.linalg.cholesky_ex(scaled)
        if not int(failed):
            return torch.linalg.solve_triangular(root, X, upper=False).square().sum(0) / self.believed
        values, axes = torch.linalg.eigh(scaled)
        return ((axes.T @ X).square() / values.clamp_min(_LEAST)[:, None]).sum(0) / self.believed

    def unidentified(self, share: Tensor) -> Tensor:
        return ((share - self.floor) / (1.0 - self.floor).clamp_min(1e-12)).clamp(0.0, 1.0)


def _suggestions(model: FittedModel, state: _State, rate_hz: float) -> dict[int, tuple[Motion | None, float]]:
    """Return per untold parameter (its row) the simplest motion that is about as good as the best, and its share."""
    before = state.unidentified(state.share)
    rows = torch.nonzero((before > _UNIDENTIFIED) & (state.floor < 1.0 - 1e-6)).flatten().tolist()
    n_dof = model.columns.robot.n_dof if rows else 0
    after: dict[Motion, Tensor] = {}

    def unidentified(motion: Motion) -> Tensor:
        if motion not in after:
            after[motion] = state.share_after(information(model, motion, state.T, rate_hz))
        return state.unidentified(after[motion])

    motions = [Motion(kind, j, tuple(k for k in range(n_dof) if k != j)) for kind in KINDS for j in range(n_dof)]
    motions.append(Motion("all", None, ()))
    left = torch.stack([unidentified(m) for m in motions]) if rows else torch.zeros(1, 0)
    found: dict[int, tuple[Motion | None, float]] = {}
    for row in rows:
        least = float(left[:, row].min())
        if least > _USELESS * float(before[row]):
            found[row] = (None, float(state.share[row]))
            continue
        # Motions are ordered by simplicity; of the simplest kind, the joint with most information is taken.
        good = [i for i in range(len(motions)) if float(left[i, row]) <= max(_AS_GOOD * least, _ENOUGH)]
        kind = motions[good[0]].kind
        best = motions[min((i for i in good if motions[i].kind == kind), key=lambda i: float(left[i, row]))]
        limit = max(_AS_GOOD * float(unidentified(best)[row]), _ENOUGH)
        best = next((m for m in _with_fewer_postures(best) if float(unidentified(m)[row]) <= limit), best)
        found[row] = (best, float(after[best][row]))
    return found


def _with_fewer_postures(motion: Motion) -> list[Motion]:
    """Return the motion with all other joints still, and with one near one in several postures."""
    joint = motion.joint
    if joint is None:
        return []
    near = sorted(motion.varied, key=lambda k: abs(k - joint))[:_NEIGHBOURS]
    return [Motion(motion.kind, joint, varied) for varied in ((), *((k,) for k in near))]
