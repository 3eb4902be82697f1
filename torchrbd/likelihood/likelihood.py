"""The likelihood of a machine's torques: posterior, hyperparameters, and the log evidence of additional columns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import torch

from torchrbd.likelihood.block import Block
from torchrbd.likelihood.design import Bare, Design
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.gaussian import Gaussian, Quadratic, nonnegative
from torchrbd.likelihood.hyper import Hyper
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.noise import Noise, learnt, tailed
from torchrbd.likelihood.physical import expanded, most_probable
from torchrbd.likelihood.widths import DryFriction, likeliest_widths
from torchrbd.nuisance.component import Along
from torchrbd.nuisance.directions import STICKS

KAPPAS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
_LEAST_SIZE, _LEAST_NOISE = 1e-4, 1e-6
_SHARES, _DOUBTS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0), (0.0, 0.1, 0.3, 1.0)
# Hyperparameters that do not change the columns, or only their sizes.
_NOT_OF_COLUMNS = {"noise", "dispersion", "bodies", "resists", "encoder_share"}
_OF_SIZES = {"kappa", "drift", "hold"}
# Least fraction of the rows that counts as degrees of freedom.
_LEAST_FREEDOM = 0.1


class Likelihood:
    """A machine with learnt noise, and additional columns.

    Args:
        machine: rigid body and baseline terms.
        hyper: what is learnt.
        extra: additional columns.
        along: see ``Machine.along``.
        designs: per joint, the columns of a model with the same machine columns, to reuse.
        blocks: per joint, the whitened rows of these columns, if that model has the same noise.

    Attributes:
        index: per joint, the rows (m,) that are whitened.
    """

    def __init__(
        self,
        machine: Machine,
        hyper: Hyper,
        extra: Sequence[Extra] = (),
        along: Along | None = None,
        designs: Sequence[Design | None] | None = None,
        blocks: Sequence[Block | None] | None = None,
    ) -> None:
        self.machine, self.hyper, self.extra, self._along = machine, hyper, tuple(extra), along
        n, none = machine.n, [None] * machine.rows.n_dof
        self._first = n + np.cumsum([0, *(e.n for e in self.extra)])
        self._designs = [self._design(j, one) for j, one in enumerate(designs or none)]
        self.index = machine.index
        self._known = list(zip(designs or none, blocks or none, strict=True))
        self._residuals = dict[int, np.ndarray]()

    @cached_property
    def _bodies(self) -> Quadratic:
        """Log prior density of the bodies' coordinates, expanded."""
        return expanded(np.sqrt(self.hyper.kappa) * self.hyper.bodies, self.hyper.kappa)

    @cached_property
    def blocks(self) -> list[Block]:
        """Per joint, the whitened rows."""
        known, self._known = self._known, []
        return [self._block(j, *one) for j, one in enumerate(known)]

    @cached_property
    def gaussian(self) -> Gaussian:
        """The posterior."""
        sites = np.zeros((3, int(self._first[-1])))
        sites[:, self.machine.positive] = self.hyper.resists
        return Gaussian(self.blocks, sites.shape[1], self._bodies, sites, self._local)

    def _design(self, joint: int, known: Design | None) -> Design:
        extras = [(int(k), e) for k, e in zip(self._first, self.extra, strict=False) if joint in e.joints]
        if known is not None and known.has(extras):
            return known
        if known is not None and (same := known.places(extras, joint)) is not None:
            return known.some(extras, *same)
        target, parts = self.machine.target[joint], (joint, self.hyper, self._along)
        one = Design.of(known.bare if known else Bare.of(*self.machine.design(*parts), target), extras, joint)
        return one.sized(self._sizes(joint, one, self.hyper))

    def _sizes(self, joint: int, design: Design, hyper: Hyper) -> np.ndarray:
        """Return the factors of a joint's columns that give prior coordinates: additional ones first."""
        further = [e.sizes(joint, e.at(joint)) for _, e in design.extras]
        return np.concatenate((*further, self.machine.sizes(joint, design.bare.own, hyper)))

    def _block(self, joint: int, known: Design | None, block: Block | None) -> Block:
        one = self._designs[joint]
        if block is not None and known is not None:
            if one is known:
                return block
            if one.bare is known.bare and (same := known.places(one.extras, joint)) is not None:
                return block.some(*same)
        return one.white(self.hyper.noise[joint], None if block is None else block.bare)

    @property
    def _local(self) -> list[np.ndarray]:
        """Indices of the coefficients that only one joint has, joint by joint."""
        found = [[own] for own in self.machine.local]
        for k, e in enumerate(self.extra):
            if e.place is not None:
                found[e.place].append(self.further(k))
        return [np.concatenate(own) for own in found]

    @property
    def log_evidence(self) -> float:
        """Log marginal likelihood of all rows, to the power of one over their joint's dispersion."""
        each = zip(self.hyper.noise, self.hyper.dispersion, strict=True)
        return self.gaussian.log_evidence - float(sum(n.surprise / d for n, d in each))

    @property
    def pi(self) -> torch.Tensor:
        """Inertial parameters (n_params,), posterior mean."""
        return self.machine.bodies.pi(self.gaussian.z, self.hyper.kappa)

    @cached_property
    def friction(self) -> np.ndarray:
        """Viscous and both Coulomb coefficients of each joint, (n, 3)."""
        return self.machine.friction.of(self.gaussian.z, self.hyper)

    @property
    def delay_s(self) -> np.ndarray:
        """Delay of each recording's torque relative to its motion [s]."""
        return -self.machine.clocks.std * self.gaussian.z[self.machine.clocks.index]

    def further(self, k: int) -> np.ndarray:
        """Return the indices of the k-th additional columns' coefficients, (K,)."""
        return np.arange(self._first[k], self._first[k + 1])

    def coefficients(self, k: int) -> np.ndarray:
        """Return the coefficients (K,) of the k-th additional columns in their own units."""
        return self.gaussian.z[self.further(k)] * self.extra[k].std

    def coefficients_covariance(self, k: int) -> np.ndarray:
        """Return their posterior covariance (K, K)."""
        at, std = self.further(k), self.extra[k].std
        return self.gaussian.covariance(at) * np.outer(std, std)

    def evidence_for(self, k: int) -> float:
        """Return the log evidence for the k-th additional columns, given the present hyperparameters."""
        return self.gaussian.against(self.further(k))

    def residual(self, joint: int) -> np.ndarray:
        """Return the residual of a joint's torque, (M,) [N m or N]; empty where it is not measured."""
        if joint not in self._residuals:
            one = self._designs[joint]
            left = one.target - one.explained(self.gaussian.z[one.own])
            self._residuals[joint] = np.where(self.machine.rows.measured[joint], left, 0.0)
        return self._residuals[joint]

    def part(self, joint: int, coefficients: np.ndarray) -> np.ndarray:
        """Return the torque of some coefficients, by their indices, at a joint, (M,) [N m or N]."""
        one = self._designs[joint]
        return one.explained(np.where(np.isin(one.own, coefficients), self.gaussian.z[one.own], 0.0))

    def columns(self, joint: int) -> np.ndarray:
        """Return the columns of a joint before whitening, (P_j, M), in prior coordinates."""
        return self._designs[joint].A

    def explained(self, joint: int, z: np.ndarray) -> np.ndarray:
        """Return the torque of coefficients z (..., P_j) of a joint's columns, (..., M)."""
        return self._designs[joint].explained(z)

    def own(self, joint: int) -> np.ndarray:
        """Return the coefficients (P_j,) of a joint's columns."""
        return self._designs[joint].own

    def precision_and_score(self, place: int | None, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return precision (K, K) and score (K,) of additional features given the fit.

        Args:
            place: joint of the features; None for all joints.
            features: (K, M), or (K, n, M) for all joints.
        """
        S, r = self.precisions_and_scores(place, features[None])
        return S[0], r[0]

    def precisions_and_scores(self, place: int | None, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the same of alternatives, (G, K, K) and (G, K), of features (G, K, M), or (G, K, n, M)."""
        each = dict(enumerate(np.moveaxis(features, 2, 0))) if place is None else {place: features}
        felt = {j: self.hyper.noise[j].white(F) for j, F in each.items() if len(self.index[j]) and F.any()}
        G, K = features.shape[:2]
        return self.gaussian.precisions_and_scores(felt) if felt else (np.zeros((G, K, K)), np.zeros((G, K)))

    def dispersion(self, joint: int) -> float:
        """Return the scatter of a joint's scores over blocks of time, divided by that of white rows."""
        return self.gaussian.dispersion(joint, self.machine.rows.block[self.index[joint]])

    def renoised(self, joints: Sequence[int] | None = None, *, dispersed: bool = False) -> Likelihood:
        """Return the same model with the noise, its drift and, if asked, its dispersion learnt from the residual.

        The friction that holds a joint at rest is learnt too.

        Args:
            joints: where; everywhere if not given.
            dispersed: whether rows are weighted by the scatter of their blocks.
        """
        noise, drift = list(self.hyper.noise), self.hyper.drift.copy()
        joints, dispersion = self._seen(joints), self.hyper.dispersion.copy()
        if dispersed:
            dispersion[joints] = np.maximum([self.dispersion(j) for j in joints], 1.0)
        for j in joints:
            noise[j] = self._noise(j, dispersion[j], self.hyper.noise[j].spread)
            drift[j] = self._expected(drift[j], self.machine.drift.wandering(j), j)
        return self.with_(noise=tuple(noise), drift=drift, dispersion=dispersion)._reheld(joints).levelled(joints)

    def _reheld(self, joints: Sequence[int]) -> Likelihood:
        """Return the same model with the friction at rest set to its expected size at some joints."""
        hold = self.hyper.held.copy()
        for j in joints:
            hold[j] = self._expected(hold[j], self.machine.rests.holding(j), j)
        return self if np.array_equal(hold, self.hyper.hold) else self.with_(hold=hold)

    def _expected(self, size: float, coefficients: np.ndarray, joint: int) -> float:
        """Return the expected size [N m or N] of coefficients, given the fit with a prior of another size."""
        return max(size * self.gaussian.rms(coefficients), _LEAST_SIZE * self.machine.torque_rms[joint])

    def levelled(self, joints: Sequence[int] | None = None) -> Likelihood:
        """Return the same model with the most probable noise levels and tails; the noise's colour does not change.

            sigma^2 <- sigma^2 sum w e^2 / (m - gamma)

        Source: MacKay, "Bayesian Interpolation", Neural Computation 1992, eq. 4.9; gamma are degrees of freedom used.

        Args:
            joints: where; everywhere if not given.
        """
        return self._levelled({j: self.hyper.noise[j].tail is None for j in self._seen(joints)})

    def with_heavy_tails(self, joints: Sequence[int] | None = None) -> Likelihood:
        """Return the same model with heavy tails at the joints, of some or all, where these raise the evidence."""
        fit = self
        for j in self._seen(joints):
            heavy = fit._levelled({j: False})
            if heavy.hyper.noise[j].tail is not fit.hyper.noise[j].tail:
                rivals = fit._levelled({j: True}), heavy.levelled([j])
                fit = max(rivals, key=lambda one: one.log_evidence)
        return fit

    def _levelled(self, normal: Mapping[int, bool]) -> Likelihood:
        """Return the same model with other noise levels at some joints, and normal noise where ``normal`` is true."""
        noise = list(self.hyper.noise)
        for j, plain in normal.items():
            n, index = noise[j], self.index[j]
            free = max(1.0 - self.gaussian.used(j) / len(index), _LEAST_FREEDOM)
            own = self.gaussian.left(j) * n.scatter[index] / n.spread[index]
            size, tail = tailed(own, index, self.machine.rows.block, normal=plain)
            noise[j] = replace(n, sigma=n.sigma * size * math.sqrt(self.hyper.dispersion[j] / free), tail=tail)
        return self._resized(noise, self.hyper.dispersion)

    def _seen(self, joints: Sequence[int] | None) -> list[int]:
        return [j for j, index in enumerate(self.index) if len(index) and (joints is None or j in joints)]

    def dispersed(self, dispersion: np.ndarray) -> Likelihood:
        """Return the same model with another dispersion (n,)."""
        parts = np.sqrt(dispersion / self.hyper.dispersion)
        noise = [replace(n, sigma=n.sigma * float(part)) for n, part in zip(self.hyper.noise, parts, strict=True)]
        return self._resized(noise, dispersion)

    def _resized(self, noise: Sequence[Noise], dispersion: np.ndarray) -> Likelihood:
        """Return the same model with other noise levels, tails and dispersion (n,)."""
        least = _LEAST_NOISE * self.machine.torque_rms
        noise = [replace(n, sigma=max(n.sigma, float(least[j]))) for j, n in enumerate(noise)]
        each = zip(self.blocks, noise, self.hyper.noise, strict=True)
        blocks = [b.louder(new.sigma / old.sigma) if new.tail is old.tail else None for b, new, old in each]
        hyper = self.hyper.with_(noise=tuple(noise), dispersion=dispersion)
        return Likelihood(self.machine, hyper, self.extra, self._along, self._designs, blocks)

    def rewidened(self, also: DryFriction = lambda _: {}) -> Likelihood:
        """Return the same model with the most probable widths of friction's sign change.

        All rows have equal weight here: the rows that show the widths, at reversals, would otherwise have less weight
        the worse they are explained.

        Args:
            also: additional columns that are friction, too.
        """
        joints, widths = self._seen(None), np.array(self.hyper.rest_width)
        one, noise = np.ones(len(self.machine.rows.t)), list(self.hyper.noise)
        for j in joints:
            noise[j] = replace(noise[j], spread=one, tail=None)
        plain, coulomb = self.with_(noise=tuple(noise)).gaussian, self.hyper.friction[:, 1].numpy()
        move = [j for j in joints if self.machine.directions.moving[j]]
        for j, width in likeliest_widths(self.machine, plain, noise, coulomb, move, also, self.further).items():
            widths[j] = width
        return self.with_(rest_width=widths)

    @property
    def least_squares(self) -> Likelihood:
        """The same model with each joint's rows independent: the best prediction, however wrong a law is.

        Noise is learnt from its residual, as in two-step generalised least squares (Greene, "Econometric Analysis").
        Learnt from the residual of whitened rows, it would fail for a wrong law: the law would be fitted to fast
        motion, its slow error would count as slow noise, and slow motion would get even less weight.
        """
        return self._independent if any(len(n.predictor) for n in self.hyper.noise) else self

    @cached_property
    def _independent(self) -> Likelihood:
        noise = tuple(replace(n, predictor=np.zeros(0), sigma=n.std) for n in self.hyper.noise)
        blocks = [one.independent(n) for one, n in zip(self._designs, noise, strict=True)]
        return Likelihood(self.machine, self.hyper.with_(noise=noise), self.extra, self._along, self._designs, blocks)

    def _noise(self, joint: int, dispersion: float, spread: np.ndarray) -> Noise:
        """Return the noise of a joint's residual, given the relative noise ``spread`` (M,) of its rows."""
        fit, index, run = self.least_squares, self.index[joint], self.machine.rows.run
        used, white = fit.gaussian.used(joint), self.hyper.white
        tail = self.hyper.noise[joint].tail
        found = learnt(fit.residual(joint), index, spread, run, used, dispersion, tail=tail, white=white)
        return replace(found, sigma=max(found.sigma, _LEAST_NOISE * self.machine.torque_rms[joint]))

    def reweighed(self) -> Likelihood:
        """Return the same model with the most probable weights of its rows.

        The encoders' share of a joint's noise, and the error of the velocity that hides friction's direction, are the
        most probable ones among some values each.
        """
        share, noise = self.hyper.encoder_share.copy(), list(self.hyper.noise)
        for j, index in enumerate(self.index):
            if not len(index):
                continue
            d = float(self.hyper.dispersion[j])
            held = float(self.hyper.held[j]) / (noise[j].std / np.sqrt(d))
            ways = [(x * held, stick) for x in _DOUBTS for stick in STICKS]
            found = [(way, self._noise(j, d, self.machine.noise.spread(j, share[j], *way))) for way in ways]
            way, _ = min(found, key=lambda one: one[1].surprise)
            parts = [(part, self._noise(j, d, self.machine.noise.spread(j, part, *way))) for part in _SHARES]
            share[j], noise[j] = min(parts, key=lambda one: one[1].surprise)
        return self.with_(encoder_share=share, noise=tuple(noise))

    def recalibrated(self) -> Likelihood:
        """Return the same model with the most probable error of the URDF's inertial parameters."""
        return max((self.with_(kappa=k)._physical() for k in KAPPAS), key=lambda one: one.log_evidence)

    def _physical(self) -> Likelihood:
        """Return the same model with the prior of its bodies expanded at the most probable physical bodies."""
        prior = self._bodies
        precision, shift = self.gaussian.first(len(prior.shift))
        z = most_probable(precision - prior.precision, shift - prior.shift, self.hyper.kappa)
        return self.with_(bodies=z / np.sqrt(self.hyper.kappa))

    def _resisting(self) -> Likelihood:
        """Return the same model with the prior of friction, and of rotors, truncated where it would be negative."""
        at = self.machine.positive
        free = self.with_(resists=np.zeros_like(self.hyper.resists)).gaussian
        return self.with_(resists=np.asarray(nonnegative(free.z[at], free.covariance(at))))

    def plausible(self) -> Likelihood:
        """Return the same model with physical bodies and non-negative friction."""
        return self._physical()._resisting()

    def relinearised(self) -> Likelihood:
        """Return the same model with physical bodies, and with load from its fit."""
        hyper = self.around_its_fit()
        return Likelihood(self.machine, hyper, self.extra, self.machine.along(hyper))

    def around_its_fit(self, *, alone: bool = False) -> Hyper:
        """Return the hyperparameters with physical bodies and the load of the fit.

        Args:
            alone: whether to take friction from the fit too. The prior of friction at rests and reversals is as large
                as that friction: additional friction laws, which take a part of it, must not make it smaller.
        """
        fit = self.plausible()
        hyper = fit.hyper.with_(pi=fit.pi)
        if not alone:
            return hyper
        viscous, plus, minus = torch.from_numpy(fit.friction).unbind(1)
        return hyper.with_(friction=torch.stack((viscous, 0.5 * (plus + minus), 0.5 * (plus - minus)), 1))

    @cached_property
    def refit(self) -> Likelihood:
        """The same model with noise and bodies learnt again, given its columns and widths."""
        return self.renoised().relinearised().renoised(dispersed=True)

    def rescaled(self, ratios: Mapping[int, float]) -> Likelihood:
        """Return the same model with other prior sizes of additional columns, times ``ratios`` by their number.

        Whitened rows and their products are the same but for factors.
        """
        by = np.ones(len(self.gaussian.z))
        for k, ratio in ratios.items():
            by[self.further(k)] = ratio
        extra = tuple(replace(e, std=e.std * ratios[k]) if k in ratios else e for k, e in enumerate(self.extra))
        new = dict(zip(self._first.tolist(), extra, strict=False))
        designs = [
            replace(d, extras=[(at, new[at]) for at, _ in d.extras]).sized(d.size * by[d.own]) for d in self._designs
        ]
        blocks = [b.sized(by[b.own]) for b in self.blocks]
        return Likelihood(self.machine, self.hyper, extra, self._along, designs, blocks)

    def of_machine(self, machine: Machine) -> Likelihood:
        """Return the same model of another machine with the same components."""
        return Likelihood(machine, self.hyper, self.extra, self._along)

    def extended(self, extra: Sequence[Extra]) -> Likelihood:
        """Return the same model with other additional columns."""
        return Likelihood(self.machine, self.hyper, extra, self._along, self._designs, self.blocks)

    @cached_property
    def bare(self) -> Likelihood:
        """The machine alone, with the same hyperparameters, but friction may have any sign."""
        hyper = self.hyper.with_(resists=np.zeros_like(self.hyper.resists))
        return Likelihood(self.machine, hyper, (), self._along, self._designs, self.blocks)

    def with_(self, **changes: object) -> Likelihood:
        """Return the same model with some hyperparameters changed, see ``Hyper``."""
        hyper = self.hyper.with_(**changes)
        if hyper.white == self.hyper.white:
            changes.pop("white", None)
        same = np.full(self.machine.rows.n_dof, changes.keys() <= _NOT_OF_COLUMNS | _OF_SIZES | {"rest_width"})
        same &= hyper.rest_width == self.hyper.rest_width
        alike = [one is other for one, other in zip(hyper.noise, self.hyper.noise, strict=True)]
        designs = [one if kept else None for one, kept in zip(self._designs, same, strict=True)]
        blocks = [one if kept else None for one, kept in zip(self.blocks, same & alike, strict=True)]
        if changes.keys() & _OF_SIZES:
            for j, (design, block) in enumerate(zip(designs, blocks, strict=True)):
                size = None if design is None else self._sizes(j, design, hyper)
                designs[j] = None if design is None or size is None else design.sized(size)
                if design is not None and block is not None and size is not None:
                    blocks[j] = block.sized(np.divide(size, design.size, out=np.ones_like(size), where=design.size > 0))
        return Likelihood(self.machine, hyper, self.extra, self._along, designs, blocks)
