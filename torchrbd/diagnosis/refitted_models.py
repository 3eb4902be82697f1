"""The final model fitted again without some of its terms: what held-out data says of each."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import torch

from torchrbd.dataset.block_statistics import Block
from torchrbd.dataset.columns import Candidate
from torchrbd.diagnosis.final_model import FinalModel
from torchrbd.diagnosis.friction import OFFSET
from torchrbd.diagnosis.held_out_checks import held_out_ratio
from torchrbd.diagnosis.results import OWN_TIME, Finding, Ratio
from torchrbd.effects import Site
from torchrbd.inference.physical.fitting import FittedModel, judge, nmse_weights


class RefittedModels:
    """The model as it is first fitted, without some of its terms, each fitted once."""

    def __init__(self, extended: FinalModel) -> None:
        self.prepared, self.first, self._offsets = extended.prepared, extended.first, extended.offsets_without
        self._friction, self._noise = len(extended.friction), extended.model.noise_variance
        self._fitted = dict[frozenset[Candidate], FittedModel]()

    def without(self, gone: Collection[Candidate]) -> FittedModel:
        """Return the model without some terms, and without those that need them.

        Laws that refine baseline friction go with it; curves that could be a proxy for it are not in this model. A law
        with a level leaves an offset.
        """
        return self.given_shapes(gone) if gone else self.first

    def given_shapes(self, gone: Collection[Candidate]) -> FittedModel:
        """Return the same, its coefficients alone fitted again: shapes, and their uncertainty, do not count."""
        key = frozenset(gone)
        if key not in self._fitted:
            self._fitted[key] = self.prepared.fit(self._rest(key), self._noise)
        return self._fitted[key]

    def _rest(self, gone: Collection[Candidate]) -> list[Candidate]:
        terms, columns = self.first.proper_terms, self.first.columns
        shared = {k for c in terms[: self._friction] if c in gone for k in columns.of(c)}
        kept = [c for c in terms if c not in gone and not shared & set(columns.of(c))]
        return [*kept, *self._offsets([c for c in gone if c.effect is not OFFSET], kept)]

    def error_without(self, gone: Sequence[Candidate]) -> Mapping[str, float]:
        """Return held-out nmse by joint without some terms."""
        return judge(self.prepared.judging, self.without(gone).x).nmse

    def judged(self, term: Candidate, one: Finding) -> Finding:
        """Return a finding with the held-out nmse by joint without its term and with it, where the term acts."""
        before, after = self.error_without([term]), self.error_without([])
        touched = [
            name for name in (one.joints if term.place is not None else after) if name in before and name in after
        ]
        return replace(one, nmse_before={j: before[j] for j in touched}, nmse_after={j: after[j] for j in touched})

    def held_out_sees(self, term: Candidate) -> bool:
        """Say whether a term acts always, or in blocks that are held out."""
        blocks, held_out = self.prepared.statistics.blocks, self.prepared.held_out.tolist()
        return term.site.always or any(out and acts_in(b, term.site) for b, out in zip(blocks, held_out, strict=True))

    def in_its_time(self, term: Candidate, one: Finding) -> Finding:
        """Return a finding with NMSE on the blocks in which it acts; each half is predicted by a fit to the other half.

        Neither fit uses its own half; both use all other blocks. A single block gives no NMSE.
        """
        statistics, held_out = self.prepared.unweighted, self.prepared.held_out
        inside = torch.tensor([acts_in(block, term.site) for block in statistics.blocks])
        own = torch.nonzero(inside)[:, 0]
        if len(own) < 2:
            return replace(one, nmse_before={}, nmse_after={}, judged_on="")
        error = torch.zeros(2, len(statistics.moments), dtype=torch.float64)
        for half in (own[::2], own[1::2]):
            left_out = torch.zeros_like(held_out).index_fill(0, half, True)
            prepared, judged = replace(self.prepared, held_out=held_out | left_out), statistics.select(left_out)
            for k, terms in enumerate((self._rest([term]), self.first.proper_terms)):
                error[k] += judged.squared_error(prepared.fit(terms, self._noise).x).sum(0)
        joints = None if term.place is None else [term.place]
        weights, names = nmse_weights(statistics.select(inside), joints), self.prepared.robot.joint_names
        counted = [(j, name) for j, name in enumerate(names) if weights[j] > 0]
        before, after = ({name: float(each[j] * weights[j]) for j, name in counted} for each in error)
        return replace(one, nmse_before=before, nmse_after=after, judged_on=OWN_TIME)

    def held_out_ratio(self, term: Candidate, finding: Finding) -> Ratio | None:
        """Return the ratio of a term's torque on held-out data to that fitted."""
        names = self.prepared.robot.joint_names
        joints = None if term.place is None else [names.index(name) for name in finding.joints]
        return held_out_ratio(self.prepared.judging, self.without([]), self.without([term]).x, joints)


def acts_in(block: Block, site: Site) -> bool:
    """Say whether something at a site acts in a block, or a part of it."""
    w = site.window
    if w is not None:
        return block.recording == w.recording and block.start_s < w.end_s and block.end_s > w.start_s
    return site.recordings is None or block.recording in site.recordings
