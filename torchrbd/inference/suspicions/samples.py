"""The samples of a table, and how well baseline models explain what its columns would mean.

Two models are tried. The first has the shape alone, joint by joint, with the URDF's torque s_j and friction's features
F_j,

    tau_j = g_j s_j + F_j w_j,   g_j >= 0

It costs one recursion over the samples and selects the writings for the second: the rigid body re-fitted with the
URDF's inertials as its prior, always physical, and friction that may differ by direction. Long recordings are
represented by samples that are spread over all of them. The second model is judged on four parts of the time, each left
out of the fit in turn, so that a short recording can be judged too.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchrbd.dataset.block_statistics import Block, BlockStatistics, nearest_block
from torchrbd.dataset.columns import Candidate, Columns
from torchrbd.dataset.scales import covered_scales
from torchrbd.dataset.spreading import Density
from torchrbd.effects import effect
from torchrbd.inference.physical.fitting import FittedModel, fit_model, squares_relative_to_constant, term_candidates
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.suspicions.explained import NOTHING, Explained, Shape
from torchrbd.inference.suspicions.writing import Writing
from torchrbd.likelihood.urdf_prior import Prior, data_prior
from torchrbd.nuisance.joint_friction import FRICTION_EFFECTS
from torchrbd.parameters import PARAMETERS_PER_BODY
from torchrbd.recordings import States
from torchrbd.robot import RobotModel, pseudo_inertia

SPRINGS, ROTORS = "joint_spring", "rotor_inertia"
"""What every joint may have besides baseline friction."""
_DENSITY = Density(most_states=30_000, least_rate_hz=60.0, rate_cycles=10.0)
# Parts of the time that are left out of the fit in turn.
_MOST_PARTS = 4
# What a model lacks it lacks in all blocks: more blocks of the same do not add evidence.
_MOST_BLOCKS = 8


class Samples:
    """Band-limited samples of all recordings.

    Args:
        prepared: the data.

    Attributes:
        robot: as the URDF gives it.
        judged: (n_dof,) bool, joints whose torque varies in two parts of the time or more.
        blocks: of time, whose errors are independent.
        kappa: weight of the URDF's inertials.
        recording, t: (M,) the number of each sample's recording, and its time there [s].
        tau: (n_dof, M) torques, known ones subtracted.
        weight: (n_dof, M) number of independent samples that each represents.
        tiles: the states at the samples, motion of a finer clock.
    """

    def __init__(self, prepared: Prepared) -> None:
        reading = prepared.reading
        self.robot, self.kappa = reading.robot, prepared.prior.kappa
        self._trusted = {name for b, name in enumerate(self.robot.body_names) if b not in prepared.prior.bodies}
        effects = [effect(name) for name in (*FRICTION_EFFECTS, SPRINGS, ROTORS)]
        self._columns = Columns(self.robot, effects, covered_scales(reading.surveys, reading.filtering))
        ordinary = {label for c in self._terms() for label in c.labels}
        self._plain = [torch.tensor([label in ordinary for label in own]) for own in self._columns.labels]
        self.blocks = len(prepared.statistics)
        self._parts = min(self.blocks, _MOST_PARTS)
        self.tiles: list[States] = []
        parts: list[tuple[Tensor, ...]] = []
        features: list[list[Tensor]] = []
        for k, states in _DENSITY.tiles(reading):
            thin = _DENSITY.thinned(states, reading.filtering.cutoff_hz)
            self.tiles.append(thin)
            measured = reading.measured(k).unsqueeze(1)
            weight = reading.filtering.effective_rate * states.dt_out * self._columns.weight(thin) * measured
            block = nearest_block(prepared.statistics.blocks, states.recording, states.t_out)
            where = torch.stack((torch.full_like(states.t_out, k), states.t_out, block * self._parts // self.blocks))
            parts.append((states.decimate_torque(torch.nan_to_num(states.tau)), weight, where))
            features.append([thin.decimate(f) for f in self._columns.features(thin)])
        self.tau, self.weight, where = (torch.cat(x, 1) for x in zip(*parts, strict=True))
        self.recording, self.t, part = where
        self._in_part = part == torch.arange(self._parts).unsqueeze(1)
        self._features = [torch.cat(x, 1) for x in zip(*features, strict=True)]
        self._design: tuple[object, list[Tensor]] = None, []
        self.judged = torch.stack([self._varies(part) for part in self._in_part]).sum(0) > 1

    @property
    def nats(self) -> float:
        """N/2, how much the log of an error counts; N is the number of blocks, but no more than 8."""
        return 0.5 * min(self.blocks, _MOST_BLOCKS)

    def odds(self, before: Explained, after: Explained) -> float:
        """Return sum_j N/2 log(e_before / e_after)."""
        return self.nats * float((before.known / after.known)[self.judged].log().sum())

    def _varies(self, part: Tensor) -> Tensor:
        """Return the joints whose torque varies in a part of the samples, (n_dof,) bool."""
        tau = torch.where(self.weight[:, part] > 0, self.tau[:, part], torch.nan)
        return torch.tensor([bool(len(t := row[~row.isnan()]) > 1 and t.max() > t.min()) for row in tau])

    def shape(self, writing: Writing) -> Shape:
        """Try the shape alone on all samples, for the torque in every joint's column."""
        gravity, parts = torch.tensor(writing.gravity, dtype=torch.float64), []
        for s in self.tiles:
            q, qd, qdd = (x.T for x in writing.moved(s.q, s.qd, s.qdd))
            parts.append(s.decimate(self.robot.inverse_dynamics(q, qd, qdd, gravity=gravity).T))
        modelled, n = torch.cat(parts, 1), self.robot.n_dof
        left, share, gain = torch.zeros(3, n, n, dtype=torch.float64)
        left += 1.0
        seen = torch.nonzero(self.judged).flatten()
        w, tau = self.weight[seen].sqrt(), self.tau[seen] * self.weight[seen].sqrt()
        torque = tau.square().sum(1)
        for j, place in enumerate(writing.q_order):
            # Given friction's features (J, M, 3), weighed as the torques of the joints (J, M) that this may be.
            F, _ = torch.linalg.qr(self._features[place][self._plain[place]].T * w.unsqueeze(-1))
            s = modelled[j] * w
            power, (s, t) = s.square().sum(1), (_residual_of(F, x) for x in (s, tau))
            left[j, seen], own, both = t.square().sum(1) / torque, s.square().sum(1), (s * t).sum(1)
            seen_well = own > NOTHING * power
            gain[j, seen] = torch.where(seen_well, both / own, 0.0)
            share[j, seen] = torch.where(seen_well, gain[j, seen] * both.abs() / torque, 0.0)
        return Shape(left, share, gain)

    def explained(
        self,
        writing: Writing,
        *,
        tightness: float = 1.0,
        further_effects: Sequence[str] = (),
        unread: Sequence[int] = (),
        robot: RobotModel | None = None,
        noise: Tensor | None = None,
    ) -> Explained:
        """Re-fit the baseline model to a writing, without each part of the time in turn, and judge it there.

        Args:
            writing: what the columns are to mean.
            tightness: factor on the user's weight of the URDF's inertials.
            further_effects: effects that every joint has as well, of ``SPRINGS`` and ``ROTORS``.
            unread: joints whose torque is taken for that of something else: a constant explains it as well.
            robot: one of other geometry; the URDF's if None.
            noise: (n_dof,) variances of the torques, if they are known.
        """
        whole, terms = self._statistics(writing, unread, robot=robot), self._terms(further_effects)
        squares, divergence = torch.zeros(2, self.robot.n_dof, dtype=torch.float64), 0.0
        for left_out in torch.eye(self._parts, dtype=torch.bool):
            fitted = whole.select(~left_out)
            prior = data_prior(fitted, self._trusted, tightness * self.kappa)
            x = fit_model(fitted, prior, terms, noise).x
            squares += torch.stack(squares_relative_to_constant(fitted, whole.select(left_out), x))
            divergence += _divergence(prior, x) / self._parts
        error = torch.where(self.judged, squares[0] / squares[1], torch.nan)
        error[list(unread)] = 1.0
        return Explained(error, divergence)

    def predicted(self, writing: Writing, without: Tensor) -> Tensor:
        """Return what the re-fitted model predicts of each part of the time, fitted to the others, (n_dof, M).

        Args:
            writing: what the columns are to mean.
            without: (n_dof, M) bool, torques that are left out of the fits.
        """
        whole, found = self._statistics(writing, without=without), torch.zeros_like(self.tau)
        for part, left_out in zip(self._in_part, torch.eye(self._parts, dtype=torch.bool), strict=True):
            fitted = whole.select(~left_out)
            x = fit_model(fitted, data_prior(fitted, self._trusted, self.kappa), self._terms()).x
            found[:, part] = self._torque(writing, x, part)
        return found

    def fitted(
        self, writing: Writing, robot: RobotModel, further_effects: Sequence[str], noise: Tensor | None = None
    ) -> tuple[FittedModel, Tensor]:
        """Re-fit the baseline model of a robot to all samples; return it and the residual torque, (n_dof, M).

        Args:
            writing, robot, further_effects, noise: as of ``explained``.
        """
        whole = self._statistics(writing, robot=robot)
        prior = data_prior(whole, self._trusted, self.kappa)
        model = fit_model(whole, prior, self._terms(further_effects), noise)
        return model, writing.torque(self.tau) - self._torque(writing, model.x, slice(None), robot)

    def _terms(self, further_effects: Sequence[str] = ()) -> tuple[Candidate, ...]:
        return term_candidates(self._columns, (*FRICTION_EFFECTS, *further_effects))

    def _torque(self, writing: Writing, x: Tensor, part: Tensor | slice, robot: RobotModel | None = None) -> Tensor:
        rows = zip(self.rows(writing, robot), self._columns.of_joint, strict=True)
        return torch.stack([x[own] @ row[:, part] for row, own in rows])

    def _statistics(
        self,
        writing: Writing,
        unread: Sequence[int] = (),
        without: Tensor | None = None,
        robot: RobotModel | None = None,
    ) -> BlockStatistics:
        """Return the moments of the parts of the time, one block each."""
        tau, weight = writing.torque(self.tau), self.weight[list(writing.tau_order)]
        weight[list(unread)] = 0.0
        weight = weight if without is None else weight.masked_fill(without, 0.0)
        moments = []
        for row, t, w in zip(self.rows(writing, robot), tau, weight, strict=True):
            a = torch.cat((row, t.unsqueeze(0)))
            moments.append(torch.stack([(a[:, part] * w[part]) @ a[:, part].T for part in self._in_part]))
        powers = torch.stack((weight, weight * tau, weight * tau.square()), -1)
        blocks = tuple(Block(f"part {k}", 0.0, 0.0) for k in range(self._parts))
        torque = torch.stack([powers[:, part].sum(1) for part in self._in_part])
        return BlockStatistics(self._columns, blocks, tuple(moments), torque)

    def rows(self, writing: Writing, robot: RobotModel | None = None) -> list[Tensor]:
        """Return the regressor and friction's features of each joint, (p_j, M); the last ones are remembered."""
        robot = robot or self.robot
        if self._design[0] != (writing.motion, robot):
            gravity = torch.tensor(writing.gravity, dtype=torch.float64)
            parts: list[list[Tensor]] = [[] for _ in self._features]
            for s in self.tiles:
                Y = robot.regressor_batch_last(*writing.moved(s.q, s.qd, s.qdd), gravity)
                for own, columns, Y_j in zip(parts, self._columns.inertial, Y, strict=True):
                    own.append(s.decimate(Y_j[columns]))
            # Friction's features span the same whatever the unit and the sign of the motion.
            rows = [
                torch.cat((torch.cat(own, 1), self._features[place]))
                for own, place in zip(parts, writing.q_order, strict=True)
            ]
            self._design = (writing.motion, robot), rows
        return self._design[1]


def _residual_of(F: Tensor, x: Tensor) -> Tensor:
    """Return the residual of x (J, M) given orthonormal columns F (J, M, K)."""
    return x - (F @ (F.mT @ x.unsqueeze(-1)))[..., 0]


def _divergence(prior: Prior, x: Tensor) -> float:
    """Return sum_b tr(J0^-1 J) - logdet(J0^-1 J) - 4 of the bodies that are fitted."""
    ratio = prior.inverse_inertia @ pseudo_inertia(x[prior.inertial].reshape(-1, PARAMETERS_PER_BODY))
    trace = ratio.diagonal(dim1=-2, dim2=-1).sum(-1)
    return float((trace - torch.linalg.slogdet(ratio)[1] - 4.0).sum())
