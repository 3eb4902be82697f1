"""Proof: does a term predict time that its fit has not seen, more surely than chance would, and enough to be named?

Blocks of the fitted time are left out in turn, eight folds of neighbours. Two fits predict a block b: one without the
term, one with it. Their predictions differ by the torque f_b; e_b is the residual of one of them. In units of the noise
s_j of the fits with the term, the residual along that torque is

    c_b = sum_j f_bj' e_bj / s_j^2 / |f_b|,   |f_b|^2 = sum_j |f_bj|^2 / s_j^2

If the term is there, c_b is noise with it; if it is not, c_b is noise without it. The scale of that noise is unknown:
laws are a little wrong on every machine, and noise is correlated. With the scale integrated out over Jeffreys' prior, N
blocks say

    log B = N/2 log( sum_b c_b^2 (without) / sum_b c_b^2 (with) )

A term is one of n that the search might have chosen as well: n is the number of shapes on its grid, times that of
windows between blocks, or of sets of recordings, where it acts for a time or in some. So log n is subtracted.

The evidence that a search has from single rows counts no more than this: the probability of a finding uses the smaller
one. Smooth curves have no name. They are judged by elpd, with the squared errors E_bj and its standard error,

    elpd = sum_b d_b,   d_b = sum_j (E_bj(without) - E_bj(with)) / (2 s_j^2),   se = std(d_b) sqrt(N)

Terms that are less likely than not then, or negligible (see ``Elpd``), are left out of the model one at a time, the
least useful first: each that remains is needed given the others. Held-out recordings have no part in this.

Source: Zellner, "An Introduction to Bayesian Inference in Econometrics" (1971), ch. 10 (two hypotheses, one unknown
    scale); Vehtari, Gelman, Gabry, "Practical Bayesian model evaluation using leave-one-out cross-validation",
    Statistics and Computing 2017 (paired differences); Kruschke, "Rejecting or Accepting Parameter Values in Bayesian
    Estimation", AMPPS 2018 (region of practical equivalence).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis.curve_hypotheses import has_friction
from torchrbd.diagnosis.final_model import FinalModel, with_curves
from torchrbd.diagnosis.friction import OFFSET
from torchrbd.diagnosis.left_out import count_choices, log_evidence
from torchrbd.diagnosis.refitted_models import RefittedModels, acts_in
from torchrbd.diagnosis.results import Elpd
from torchrbd.inference.physical.fitting import FittedModel
from torchrbd.inference.physical.leave_out import FOLDS, contiguous_folds, left_out_fits
from torchrbd.inference.preparation import Prepared

# Below so many blocks nothing can be left out.
_LEAST_BLOCKS = 2


LeftOut = tuple[Tensor, Tensor]
"""Blocks that are left out together, (B,) bool, and the coefficients (n,) of the fit without them."""


class Proof:
    """What terms of a model are worth on left-out blocks, and how much torque they carry while they act.

    Args:
        extended: the model.
    """

    def __init__(self, extended: FinalModel) -> None:
        self.fits, self._model, self._prepared = RefittedModels(extended), extended.model, extended.prepared
        self._curves = [term for term in extended.terms if has_friction(term)]
        self._brief = [term for term in extended.terms if term.site.window is not None]
        self._blocks, self._fits = self._prepared.judging_fitted, dict[tuple[object, ...], list[LeftOut]]()
        self._recordings = [block.recording for block in self._blocks.blocks]

    def elpd(self, term: Candidate, gone: Sequence[Candidate] = ()) -> Elpd:
        """Return what a term is worth in the model without those that are gone; a law with a level, over an offset.

        A joint keeps its offset in the baseline where that is no finding.
        """
        gone = [c for c in gone if c.effect is not OFFSET]
        inside, fold = self._folds(term)
        if len(fold[inside].unique()) < _LEAST_BLOCKS:
            return Elpd(0.0, 0.0, 0.0, 0.0, 0.0)
        without, model = (self._left_out(g, term, fold) for g in ([*gone, term], gone))
        before, after = (self._error(each).numpy() for each in (without, model))
        between = self._between(without, model).numpy()
        samples, judged = self._blocks.torque[..., 0].numpy(), (fold >= 0).numpy()
        carried, own = self._carried(term, gone, inside), inside.numpy()
        there = elpd_of(before[own], after[own], between[own], samples[own], carried, term.place)
        every = elpd_of(before[judged], after[judged], between[judged], samples[judged], carried, term.place)
        price = math.log(count_choices(term, self._model.columns, self._recordings))
        return replace(every, share=there.share, log_evidence=every.log_evidence - price)

    def _carried(self, term: Candidate, gone: Sequence[Candidate], inside: Tensor) -> float:
        """Return the torque of a term over that of its joint while it acts, RMS, at the joint where that is largest."""
        model = self._model if has_friction(term) else self.fits.given_shapes(gone)
        x, without = model.x, model.x.index_fill(0, torch.tensor(model.columns.of(term)), 0.0)
        blocks = self._blocks.select(inside)
        power = blocks.added(x, without)[1].sum(0)
        torque = blocks.torque[..., 2].sum(0)
        return math.sqrt(float((power / torque.clamp_min(1e-300))[torque > 0].max().clamp_min(0.0)))

    def _folds(self, term: Candidate) -> tuple[Tensor, Tensor]:
        """Return in which blocks a term acts, (B,) bool, and their folds, (B,), below zero where none is left out.

        What acts for a time is only there to be fitted: each of its blocks is left out by itself. What acts in some
        recordings must not make others worse: each other recording is left out as a whole, so that nothing is known of
        what acts there for a time. Where other terms are judged, blocks of what acts for a time are spread over the
        folds, so that a part of them is always fitted.
        """
        inside = self._acting(term)
        n, fold = int(inside.sum()), torch.full((len(inside),), -1)
        fold[inside] = contiguous_folds(n, n if term.site.window is not None else FOLDS)
        if term.site.window is None:
            for brief in self._brief:
                own = inside & self._acting(brief)
                fold[own] = torch.arange(int(own.sum())) % FOLDS
        if not term.site.always:
            here = {name for name, own in zip(self._recordings, inside.tolist(), strict=True) if own}
            for k, other in enumerate(dict.fromkeys(name for name in self._recordings if name not in here)):
                fold[torch.tensor([name == other for name in self._recordings])] = n + k
        return inside, fold

    def _acting(self, term: Candidate) -> Tensor:
        return torch.tensor([acts_in(block, term.site) for block in self._blocks.blocks])

    def _left_out(self, gone: Sequence[Candidate], term: Candidate, fold: Tensor) -> list[LeftOut]:
        """Return the blocks of each fold, (B,) bool, and the coefficients (n,) of the fit without them.

        Curves that could be a proxy for friction are in the model where one of them is judged: they are fitted to what
        all else leaves.
        """
        curves = [c for c in self._curves if c not in gone] if has_friction(term) else []
        key = frozenset(gone), frozenset(curves), term.site.window, term.site.recordings
        if key not in self._fits:
            prepared, model = self._prepared, self.fits.given_shapes(gone)
            fitted, each = torch.nonzero(~prepared.held_out)[:, 0], list[LeftOut]()
            for out, x in left_out_fits(model, prepared, fold):
                if curves:
                    rest = replace(prepared, held_out=prepared.held_out.index_fill(0, fitted[out], True))
                    x = with_curves(rest, replace(model, x=x, scatter=None), curves).x
                each.append((out, x))
            self._fits[key] = each
        return self._fits[key]

    def _error(self, fits: Sequence[LeftOut]) -> Tensor:
        """Return the squared errors (B, n_dof) of blocks by fits without their folds."""
        errors = torch.zeros(self._blocks.torque.shape[:2], dtype=torch.float64)
        for out, x in fits:
            errors[out] = self._blocks.select(out).squared_error(x)
        return errors

    def _between(self, fits: Sequence[LeftOut], others: Sequence[LeftOut]) -> Tensor:
        """Return the squares (B, n_dof) of the torque by which two models' predictions of left-out blocks differ."""
        squares = torch.zeros(self._blocks.torque.shape[:2], dtype=torch.float64)
        for (out, x), (_, other) in zip(fits, others, strict=True):
            squares[out] = self._blocks.select(out).added(x, other)[1].clamp_min(0.0)
        return squares


def elpd_of(
    before: np.ndarray,
    after: np.ndarray,
    between: np.ndarray,
    samples: np.ndarray,
    torque_share: float,
    place: int | None = None,
) -> Elpd:
    """Return what left-out blocks say for a model against another one.

    Args:
        before, after: (B, n_dof) squared errors of the other model and of this one, [(N m)^2] or [N^2].
        between: (B, n_dof) squared differences of their predictions.
        samples: (B, n_dof) numbers of independent samples.
        torque_share: part of the torque that the difference carries.
        place: the joint whose share of error counts. Default: all.
    """
    variance = after.sum(0) / np.maximum(samples.sum(0), 1e-300)
    seen = (samples.sum(0) > 0) & (variance > 0)
    d = ((before - after)[:, seen] / (2.0 * variance[seen])).sum(1)
    own = seen if place is None else seen & (np.arange(len(seen)) == place)
    shares = 1.0 - after[:, own].sum(0) / np.maximum(before[:, own].sum(0), 1e-300)
    se = float(np.std(d, ddof=1)) * math.sqrt(len(d))
    evidence = log_evidence(d, (between[:, seen] / variance[seen]).sum(1))
    return Elpd(float(d.sum()), se, evidence, float(shares.max(initial=-math.inf)), torque_share)


def elpd_of_rows(
    before: np.ndarray,
    after: np.ndarray,
    recording: np.ndarray,
    t: np.ndarray,
    counted: np.ndarray,
    torque_share: float,
) -> Elpd:
    """Return the same of torque residuals (M, n_dof) at times t (M,) of recordings, in blocks of a second."""
    block = np.unique(np.stack((recording, np.floor(t)), 1)[counted], axis=0, return_inverse=True)[1].ravel()
    seen = np.isfinite(before[counted])

    def sums(of_rows: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(block, column) for column in np.where(seen, of_rows[counted], 0.0).T], 1)

    errors, between = (sums(before**2), sums(after**2)), sums((before - after) ** 2)
    return elpd_of(*errors, between, sums(np.ones(before.shape)), torque_share)


def predicts_nothing(prepared: Prepared, model: FittedModel) -> bool:
    """Say whether left-out blocks are predicted no better than by a constant, in the mean over the joints."""
    blocks = prepared.judging_fitted
    errors = torch.zeros(len(blocks.moments), dtype=torch.float64)
    for out, x in left_out_fits(model, prepared, contiguous_folds(len(blocks), FOLDS)):
        errors += blocks.select(out).squared_error(x).sum(0)
    constant = blocks.torque_variance() * blocks.torque[..., 0].sum(0)
    seen = constant > 0
    return bool(seen.any()) and float((errors[seen] / constant[seen]).mean()) > 1.0


def backward_elimination(
    proof: Proof, terms: Sequence[Candidate], needed: Callable[[Candidate, Elpd], bool]
) -> dict[Candidate, Elpd]:
    """Return the terms that a model does not need, in the order in which they were left out, and their worth then.

    While some are not needed, only these are judged again after each step; in the end all that remain are.
    """
    gone, judged = dict[Candidate, Elpd](), [*terms]
    while True:
        each = {term: proof.elpd(term, [*gone]) for term in judged}
        needless = [term for term, elpd in each.items() if not needed(term, elpd)]
        if needless:
            first = min(needless, key=lambda term: each[term].value)
            gone[first] = each[first]
            judged = [term for term in needless if term is not first]
        elif len(judged) + len(gone) == len(terms):
            return gone
        else:
            judged = [term for term in terms if term not in gone]
