"""What earns a name? Scores of hypotheses that a search adopts or likes, true and false.

    python -m benchmarks.concealed generate --set development --tiers raw --count 48 --seed 6401 -o RAW
    python -m benchmarks.concealed generate --set development --tiers field null --count 12 --seed 6402 -o FIELD
    TORCHRBD_DATA=/path/to/recordings python benchmarks/earning_a_name.py RAW FIELD --every 3 -j 2

Writes ``benchmarks/results/earning_a_name.json``. Of each recording the adopted hypotheses and the ten likeliest others
are scored by

- *evidence*: log odds of the search; and the same, with no more evidence than left-out blocks give (see ``proof``);
- *elpd* of left-out blocks, over its standard error: in the search's rows with the noise learnt with all terms, with
  the noise learnt from smooth curves, and by least squares in the band of the motion;
- *equivalence*: the smaller of share of error over 5 % and torque over 0.1 %.

Simulated hypotheses are true or false. Of real robots only adopted ones count: they are useful if held-out data is
predicted worse by 5 % or more, at a joint, without them.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.progress import track

import torchrbd
from torchrbd.diagnosis.curve_hypotheses import is_curve
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.evidence import ModelEvidence
from torchrbd.diagnosis.explain import places
from torchrbd.diagnosis.final_model import FinalModel, fit_final_model
from torchrbd.diagnosis.outcome import Term
from torchrbd.diagnosis.posterior import limit_evidence, log_odds
from torchrbd.diagnosis.proof import Proof
from torchrbd.effects.registry import effect
from torchrbd.inference.physical.fitting import judge
from torchrbd.likelihood.likelihood import Likelihood

sys.path.insert(0, str(Path(__file__).parent.parent))

import against_least_squares as real
import results_file

from benchmarks.concealed.matching import judge as matched
from benchmarks.concealed.matching import relation
from benchmarks.concealed.run import recordings
from benchmarks.concealed.workers import workers

LEADING, ALIKE = 10, 3.0
USEFUL = 0.05
RULES: Mapping[str, Callable[[Mapping[str, float]], bool]] = {
    "evidence": lambda s: s["evidence"] > 0,
    "elpd > se, noise of the final model": lambda s: s["elpd_final"] > 1,
    "elpd > se, noise of smooth curves": lambda s: s["elpd_saturated"] > 1,
    "elpd > se, least squares in the band": lambda s: s["elpd"] > 1,
    "elpd > 2 se, least squares in the band": lambda s: s["elpd"] > 2,
    "equivalence": lambda s: s["equivalence"] > 1,
    "elpd > se and equivalence": lambda s: s["elpd"] > 1 and s["equivalence"] > 1,
    "evidence of left-out blocks": lambda s: s["left_out"] > 0,
    "evidence of left-out blocks and equivalence": lambda s: s["left_out"] > 0 and s["equivalence"] > 1,
}


@dataclass
class Scored:
    """One hypothesis: what it says, whether it was adopted, its scores, and the held-out error that it removes."""

    effect: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    adopted: bool
    alike: list[dict[str, Any]]
    scores: dict[str, float]
    useful: bool


def block_densities(fit: Likelihood, gone: Sequence[int] | np.ndarray = ()) -> np.ndarray:
    """Return the log density of each block of rows given all others (B,), without some coefficients.

    log p(y_b | y_-b) = log p(y) - log p(y_-b), with the posterior that lacks the rows of the block.
    """
    g = fit.gaussian.among(np.setdiff1d(np.arange(len(fit.gaussian.z)), gone))
    of_joint = {j: fit.machine.rows.block[index] for j, index in enumerate(fit.index) if len(index)}
    found = []
    for block in np.unique(np.concatenate(list(of_joint.values()))):
        H, h, power = np.zeros_like(g.H), np.zeros_like(g.h), 0.0
        for j, of in of_joint.items():
            b, rows = g.blocks[j], np.flatnonzero(of == block)
            X, y = b.of_rows(rows), b.y[rows]
            H[np.ix_(b.own, b.own)] += X @ X.T
            h[b.own] += X @ y
            power += float(y @ y)
        rest = g.without(H, h)
        found.append(0.5 * float(g.h @ g.z - rest.h @ rest.z - power) - (g.root.log_det - rest.root.log_det))
    return np.array(found)


def over_se(d: np.ndarray) -> float:
    """Return a sum over its standard error."""
    return float(d.sum() / max(d.std(ddof=1) * math.sqrt(len(d)), 1e-300)) if len(d) > 1 else 0.0


def scored(model: FinalModel) -> list[Scored]:
    """Return the scores of the hypotheses that a search adopted, and of the likeliest others."""
    found, robot, may = model.found, model.prepared.robot, model.may
    others = [h for h in found.last if not is_curve(h.candidate)][:LEADING]
    fit, rows = found.fit, found.rows
    wide = fit.extended([*fit.extra, *(h.extra(fit, rows) for h in others)])
    both = replace(found, fit=wide, terms=(*found.terms, *(Term(h, ()) for h in others)))
    full = fit_final_model(model.prepared, both, may, lambda *_: None)
    proof, n = Proof(full), len(found.terms)
    evidence = ModelEvidence(rows, [effect(e) for e in may], found.discrepancy)
    chosen = [t.own for t in found.terms if not is_curve(t.own.candidate)]
    saturated, whole = block_densities(evidence.fit(chosen)), block_densities(fit)
    result = []
    for k, (term, c) in enumerate(zip(both.terms, full.terms, strict=True)):
        h = term.own
        if is_curve(h.candidate):
            continue
        gone = [one for one in full.terms[n:] if one is not c]
        if k < n:
            final = whole - block_densities(fit, fit.further(k))
            curves = saturated - block_densities(evidence.fit([one for one in chosen if one is not h]))
        else:
            one = fit.extended([*fit.extra, h.extra(fit, rows)])
            final = block_densities(one) - block_densities(one, one.further(n))
            curves = block_densities(evidence.fit([*chosen, h])) - saturated
        elpd = proof.elpd(c, gone)
        odds, estimate = log_odds(h, rows), proof.fits.given_shapes(gone)
        with_it, without = (
            judge(full.prepared.judging, m.x).nmse for m in (estimate, proof.fits.given_shapes([*gone, c]))
        )
        result.append(
            Scored(
                h.candidate.effect.id,
                *places(robot, h.candidate),
                adopted=k < n,
                alike=[
                    dict(
                        zip(
                            ("effect", "joints", "links"),
                            (r.candidate.effect.id, *places(robot, r.candidate)),
                            strict=True,
                        )
                    )
                    for r in term.rivals
                    if log_odds(r, rows) > odds - ALIKE
                ],
                scores={
                    "evidence": odds,
                    "left_out": log_odds(limit_evidence(h, (), elpd)[0], rows),
                    "elpd_final": over_se(final),
                    "elpd_saturated": over_se(curves),
                    "elpd": elpd.value / elpd.se if elpd.se else 0.0,
                    "equivalence": min(elpd.share / DECISIONS.least_error, elpd.torque_share / DECISIONS.least_torque),
                },
                useful=any(with_it[j] < (1.0 - USEFUL) * without[j] for j in with_it),
            )
        )
    return result


def hypotheses(robot: Path, fitted: Sequence[Path], **options: Any) -> list[Scored]:
    """Diagnose, and return the scores of hypotheses before anything is decided."""
    module, kept = import_module("torchrbd.diagnosis.diagnose"), list[list[Scored]]()
    decide = module.explain

    def watched(model: FinalModel) -> Any:
        kept.append(scored(model))
        return decide(model)

    module.explain = watched
    try:
        torchrbd.diagnose(robot, list(fitted), **options)
    finally:
        module.explain = decide
    return kept[0] if kept else []


def labelled(found: Sequence[Scored], truth: Mapping[str, Any]) -> list[tuple[Scored, bool]]:
    """Return hypotheses with whether each names a concealed effect; what is true of the machine anyway is left out."""
    joints, adopted = truth["robot"]["joints"], [one for one in found if one.adopted]

    def said(one: Scored) -> dict[str, Any]:
        p = 1.0 / (1.0 + math.exp(-min(max(one.scores["evidence"], -500.0), 500.0)))
        return {**vars(one), "probability": p, "indistinguishable_from": one.alike}

    judged = matched([said(one) for one in adopted], truth)
    named = {one.effect for one in judged}
    result = [
        (one, j.effect is not None)
        for one, j in zip(adopted, judged, strict=True)
        if j.kind not in ("background", "companion")
    ]
    for one in found:
        missing = [e for k, e in enumerate(truth["effects"]) if k not in named and relation(said(one), e, joints)]
        usual = any(
            relation(said(one), e, joints) for kind in ("background", "companions") for e in truth.get(kind, ())
        )
        if not one.adopted and (missing or not usual):
            result.append((one, bool(missing)))
    return result


def area(true: Sequence[float], false: Sequence[float]) -> float:
    """Return the area under the curve of true over false positives: the chance that a true one has the larger score."""
    p, n = np.array(true)[:, None], np.array(false)
    return float(np.mean((p > n) + 0.5 * (p == n)))


def counted(simulated: Sequence[tuple[Scored, bool]], machines: Sequence[Scored]) -> dict[str, Any]:
    """Return per rule how many adopted hypotheses it keeps, and per score the area under the curve of all."""
    adopted = [(one, true) for one, true in simulated if one.adopted]
    useful, useless = ([one for one in machines if one.useful is wanted] for wanted in (True, False))
    rules = {
        name: {
            "true": sum(keeps(one.scores) for one, true in adopted if true),
            "false": sum(keeps(one.scores) for one, true in adopted if not true),
            "useful": sum(keeps(one.scores) for one in useful),
            "useless": sum(keeps(one.scores) for one in useless),
        }
        for name, keeps in RULES.items()
    }
    scores = {
        name: area(
            [o.scores[name] for o, true in simulated if true], [o.scores[name] for o, true in simulated if not true]
        )
        for name in (simulated[0][0].scores if simulated else ())
    }
    of = {"true": sum(t for _, t in adopted), "false": sum(not t for _, t in adopted)}
    return {"of": {**of, "useful": len(useful), "useless": len(useless)}, "rules": rules, "area": scores}


def of_case(case: Path) -> list[Scored]:
    """Return the scores of the hypotheses of a simulated case."""
    fit, holdout = recordings(case)
    return hypotheses(case / "robot.urdf", fit, holdout=holdout)


def of_machine(name: str) -> list[Scored]:
    """Return the scores of what is adopted on a real data set."""
    folder, chosen = Path(os.environ["TORCHRBD_DATA"]) / name, real.SETS[name]
    fit, holdout = real.recordings_of(name, folder)
    found = hypotheses(folder / chosen.urdf, fit, holdout=holdout, cutoff_hz=chosen.cutoff_hz)
    return [one for one in found if one.adopted]


def main(arguments: Sequence[str] | None = None) -> None:
    """Score all cases and real sets, and write the result file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path, help="of concealed cases: RAW, FIELD")
    parser.add_argument("--real", nargs="*", default=list(real.SETS), help="real sets")
    parser.add_argument("--every", type=int, default=1, help="take every so manyth case")
    parser.add_argument("-j", "--jobs", type=int, default=1, help="processes")
    asked = parser.parse_args(arguments)
    cases = [case for folder in asked.folders for case in sorted((folder / "cases").iterdir())[:: asked.every]]
    with workers(asked.jobs, partial(torch.set_num_threads, 1)) as pool:
        slow = [pool.submit(of_machine, name) for name in asked.real]
        quick = [pool.submit(of_case, case) for case in cases]
        for _ in track(as_completed([*slow, *quick]), total=len(cases) + len(asked.real)):
            pass
    simulated = list[tuple[Scored, bool]]()
    for case, one in zip(cases, quick, strict=True):
        truth = json.loads((case.parents[1] / "truth" / f"{case.name}.json").read_text())
        simulated += labelled(one.result(), truth)
    machines = [h for one in slow for h in one.result()]
    entry = {"cases": len(cases), "real": asked.real, **counted(simulated, machines)}
    command = f"python benchmarks/earning_a_name.py RAW FIELD --every {asked.every} (see there for RAW and FIELD)"
    results_file.update("earning_a_name", command, {"all": entry})


if __name__ == "__main__":
    main()
