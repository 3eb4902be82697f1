"""Torque that is later, or earlier, than the motion in all joints alike: the offset of the clocks, as a finding.

Every model has that offset, so that the search for effects never meets it. What it is worth is seen by predicting the
recorded torque without it: the model's own torque, at the time of the motion.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from torchrbd.diagnosis.calibration import calibrated
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.final_model import FinalModel
from torchrbd.diagnosis.posterior import excess_evidence, prior_log_odds, probabilities
from torchrbd.diagnosis.proof import elpd_of_rows
from torchrbd.diagnosis.ranked import Ranked, Ranking
from torchrbd.diagnosis.results import Alternative, Elpd, Finding, Law, Quantity, Where
from torchrbd.effects import effect
from torchrbd.inference.identification import Identification
from torchrbd.inference.preparation import Prepared
from torchrbd.inference.series import torque_series
from torchrbd.likelihood.clocks import of_one_machine


def clock_offset(ranked: Ranking, extended: FinalModel, identification: Identification) -> Finding | None:
    """Return the offset of the clocks as a finding, if the search makes it likelier than not.

    Args:
        ranked: whose clocks were learnt.
        extended: the model, read with them.
        identification: with its torques and errors.
    """
    robot, found = extended.prepared.robot, [h for h in ranked.first if _is_offset(h)]
    logs = [calibrated(h.log_evidence) + prior_log_odds(effect(h.effect), robot) for h in found]
    if not found or probabilities(logs).sum() <= DECISIONS.likely:
        return None
    before, after, carried, worth = _worth(extended, identification)
    excess = excess_evidence(max(h.log_evidence for h in found), worth.log_evidence)
    sure = probabilities([one - excess for one in logs])
    order = np.argsort(-sure, kind="stable")
    best, *others = (found[k] for k in order)
    late, std = _offset(ranked, extended.prepared)
    values = {"delay": late, "time_constant": -late}
    own = effect(best.effect)
    (name,) = best.parameters
    return Finding(
        effect=best.effect,
        joints=(),
        links=(),
        probability=min(float(sure[order[0]]), DECISIONS.largest_probability),
        log_evidence_gain=best.log_evidence,
        parameters={name: Quantity(values[name], std, own.unit(name, prismatic=False))},
        where=Where(None),
        indistinguishable_from=tuple(
            Alternative(h.effect, (), (), (), {n: values[n] for n in h.parameters}, float(sure[k] / sure.sum()))
            for k, h in zip(order[1:], others, strict=True)
        ),
        nmse_before=before,
        nmse_after=after,
        family=own.family,
        family_probability=min(float(sure.sum()), DECISIONS.largest_probability),
        class_probability=min(float(sure.sum()), DECISIONS.largest_probability),
        laws=tuple(Law(found[k].effect, float(sure[k] / sure.sum())) for k in order),
        torque_rms=carried,
        elpd=worth,
    )


def _offset(ranked: Ranking, prepared: Prepared) -> tuple[float, float]:
    """Return by how much later the torque is read, and its standard deviation [s], the same for all recordings."""
    known = {name: late for name, late in (prepared.late or {}).items() if name in prepared.fitted}
    return of_one_machine(known or ranked.delay_s, [""])[""]


def _is_offset(h: Ranked) -> bool:
    return not h.joints and h.window is None and effect(h.effect).shifts_clocks


def _worth(
    extended: FinalModel, identification: Identification
) -> tuple[dict[str, float], dict[str, float], dict[str, float], Elpd]:
    """Return by joint the held-out nmse without the offset and with it, the RMS of what it moves [N m or N], and what
    the offset is worth on fitted time: it is one number, of all joints."""
    prepared, model, series = extended.prepared, copy(identification.model), identification.series
    model.conditions = {name: one.without_clock() for name, one in model.conditions.items()}
    without = torque_series(prepared.reading, {"extended": model}, prepared.kept_back)
    before, after = without.fit("extended").nmse, identification.fits["extended"].nmse
    moved, carried = series.predicted["extended"] - without.predicted["extended"], dict[str, float]()
    for j, joint in enumerate(without.joints):
        seen = np.isfinite(without.measured[:, j])
        carried[joint] = float(np.sqrt(np.mean(moved[seen, j] ** 2))) if seen.any() else 0.0
    errors = (without.residual("extended"), series.residual("extended"))
    rms = np.sqrt(np.mean(np.where(np.isfinite(series.measured), series.measured, 0.0) ** 2, 0))
    share = max(carried[joint] / max(float(size), 1e-300) for joint, size in zip(without.joints, rms, strict=True))
    worth = elpd_of_rows(*errors, series.recording, series.t, ~series.held_out, share)
    return before, {joint: after[joint] for joint in before}, carried, worth
