"""Search with noise that is learnt once from a saturated model, in place of noise that is learnt per hypothesis.

    python benchmarks/saturated_noise.py -o FOLDER CASE... [--kinds all pruned kept] [--present]
    python benchmarks/saturated_noise.py --collect FOLDER...      # into benchmarks/results/saturated_noise.json

CASE is a golden case ("field 3", "null 0", "real ur10") or "raw 17", a development case of the raw tier. There is one
JSON file for each case; cases that are there are not run again.

An effect that is left out colours the noise that is learnt without it. The saturated model is the machine with smooth
curves of each joint over its own q, qd, qdd and load; their amplitudes are learnt by MacKay's fixed point of the
marginal likelihood. Its noise, with the scatter of blocks as dispersion, is held for all hypotheses:

- "all" keeps all curves for learning, and searches without any;
- "pruned" drops curves whose odds, with the prior of a curve, are against them, and learns again;
- "kept" leaves the pruned curves in the model as well: a law has to explain more than they do. Amplitudes are learnt
  anew with each leading law (Kennedy and O'Hagan, "Bayesian calibration of computer models", J. R. Stat. Soc. B 2001,
  has such a discrepancy).

The search adds the likeliest hypothesis, swaps and drops; nothing but coefficients and amplitudes is learnt in it.
"""

from __future__ import annotations

import argparse
import inspect
import json
import sys
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent.parent / "examples"))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from golden.cases import CASES, TIERS, Asked

import torchrbd
from benchmarks import results_file
from benchmarks.concealed.cases import make_case
from torchrbd._runtime.threads import single_threaded
from torchrbd.dataset.band import band_hz
from torchrbd.dataset.columns import Candidate
from torchrbd.dataset.rows import Rows, not_held_out
from torchrbd.diagnosis.hypotheses import Hypothesis, again, carried, hypothesis_of
from torchrbd.diagnosis.posterior import log_odds
from torchrbd.diagnosis.ranked import Ranked
from torchrbd.diagnosis.residual import curves_at
from torchrbd.diagnosis.screening import lasting, refined, screened
from torchrbd.diagnosis.sharpening import at_summit
from torchrbd.effects import Effect, Site
from torchrbd.effects.registry import known_effects
from torchrbd.effects.smooth_torque import SmoothTorque
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.preparation import read
from torchrbd.likelihood.clocks import in_band
from torchrbd.likelihood.extra import Extra
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.options import given

RAW_SEED = 0
# Hypotheses whose shapes are refined at each step, and rivals of a term; terms; sweeps of swaps; steps of amplitudes.
NEAR, RIVALS, MOST, SWEEPS, STEPS = 6, 3, 16, 2, 20
# Whether curves are pruned, and stay in the model.
KINDS = {"all": (False, False), "pruned": (True, False), "kept": (True, True)}


def asked(name: str, into: Path) -> tuple[Asked, list[dict[str, Any]]]:
    """Return what a case is and which effects it conceals."""
    tier, _, index = name.partition(" ")
    if tier not in (*TIERS, "raw"):
        return CASES[name].make(into), []
    case = make_case("development", tier, int(index), RAW_SEED)
    effects = [{k: e[k] for k in ("effect", "joints", "links")} for e in case.truth["effects"]]
    if tier != "raw":
        return CASES[name].make(into), effects
    (into / "robot.urdf").write_text(case.urdf)
    for file, table in case.recordings.items():
        pq.write_table(table, into / file)
    held = [into / file for file in case.recordings if "holdout" in file]
    fitted = [into / file for file in case.recordings if "holdout" not in file]
    return Asked(into / "robot.urdf", fitted, {"holdout": held} if held else {}), effects


def own_curves(base: Likelihood, rows: Rows) -> list[Hypothesis]:
    """Return curves of each joint over its own position, velocity, acceleration and load."""

    def is_own(c: Candidate) -> bool:
        effect = c.effect
        assert isinstance(effect, SmoothTorque)
        return c.site.other is None and effect.signal != "t" and not effect.times_own

    return [h for h in curves_at(base, rows, range(rows.n_dof)) if is_own(h.candidate)]


def amplified(fit: Likelihood, first: int) -> Likelihood:
    """Return a fit whose additional columns, from the first on, have the amplitudes of greatest evidence.

        a^2 <- a^2 sum z^2 / (K - sum var z)

    Source: MacKay, "Bayesian Interpolation", Neural Computation 1992, eq. 4.8; where a step lowers the evidence, one of
    expectation-maximisation is taken instead.
    """
    for _ in range(STEPS):
        at = [fit.further(k) for k in range(first, len(fit.extra))]
        mean, var = [fit.gaussian.z[k] for k in at], [fit.gaussian.covariance(k).diagonal() for k in at]
        fixed = [np.sqrt((z @ z) / max(len(z) - v.sum(), 1e-6)) for z, v in zip(mean, var, strict=True)]
        then = fit.rescaled({first + k: float(np.clip(r, 0.1, 10.0)) for k, r in enumerate(fixed)})
        if then.log_evidence < fit.log_evidence:
            then = fit.rescaled({first + k: fit.gaussian.rms(one) for k, one in enumerate(at)})
        if then.log_evidence - fit.log_evidence < 0.1:
            break
        fit = then
    return fit


def saturated(base: Likelihood, rows: Rows, *, prune: bool) -> tuple[Likelihood, list[str]]:
    """Return the machine with curves whose amplitudes, and the noise, are learnt, and these curves."""
    curves = own_curves(base, rows)
    plain = base.with_(noise=tuple(replace(n, tail=None) for n in base.hyper.noise), dispersion=np.ones(rows.n_dof))
    fit = plain.extended([h.extra(base, rows) for h in curves]).renoised()
    while True:
        for _ in range(STEPS):
            before = fit.log_evidence
            fit = amplified(fit, 0).renoised()
            if abs(fit.log_evidence - before) < 0.1:
                break
        odds = [log_odds(replace(h, log_evidence=fit.evidence_for(k)), rows) for k, h in enumerate(curves)]
        needless = sorted((k for k, x in enumerate(odds) if x <= 0), key=lambda k: odds[k])
        if not prune or not needless:
            break
        # The worst half of those that are not needed: the noise that is learnt without them may need the others.
        drop = set(needless[: max(1, len(needless) // 2)])
        curves = [h for k, h in enumerate(curves) if k not in drop]
        fit = fit.extended([e for k, e in enumerate(fit.extra) if k not in drop]).renoised()
    return fit.with_heavy_tails.renoised(dispersed=True), [words(h, rows) for h in curves]


def words(h: Hypothesis, rows: Rows) -> str:
    """Return effect, place and window."""
    site, robot = h.candidate.site, rows.columns.robot
    window = site.window
    parts = (
        h.candidate.effect.id,
        None if site.joint is None else robot.joint_names[site.joint],
        None if site.other is None else robot.joint_names[site.other],
        None if site.body is None else robot.body_names[site.body],
        None if window is None else f"[{window.recording} {window.start_s:.1f}:{window.end_s:.1f}]",
    )
    return " ".join(filter(None, parts))


class Search:
    """A greedy search with swaps, in which nothing but linear coefficients is learnt."""

    def __init__(
        self, base: Likelihood, rows: Rows, effects: Sequence[Effect], noise: Likelihood, curves: Sequence[Extra] = ()
    ) -> None:
        self.rows, self.effects, self.curves = rows, effects, tuple(curves)
        self.base = base.with_(noise=noise.hyper.noise, dispersion=noise.hyper.dispersion)
        self.log: list[Any] = []

    def fit(self, chosen: Sequence[Hypothesis]) -> Likelihood:
        own = [h.extra(self.base, self.rows) for h in chosen]
        fit = self.base.extended([*own, *self.curves])
        if self.curves:
            fit = amplified(fit, len(own))
        return fit.plausible() if chosen else fit

    def worth(self, fit: Likelihood, chosen: Sequence[Hypothesis], h: Hypothesis) -> Hypothesis:
        """Return a hypothesis with its evidence, the amplitudes of curves being learnt with it and without it."""
        if not self.curves:
            return h
        gain = self.fit([*chosen, h]).log_evidence - fit.log_evidence
        return replace(h, log_evidence=gain + h.paid)

    def odds(self, h: Hypothesis) -> float:
        return log_odds(h, self.rows)

    def leading(self, fit: Likelihood, chosen: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return what is likeliest given a fit, with refined shapes, then all others.

        Curves explain much of what a law does. So laws are compared without curves, too, to see which are to be tried.
        """
        names = {h.name for h in chosen if h.candidate.site.window is None}
        return self.tried(fit, chosen, NEAR, lambda one: screened(one, self.rows, self.effects), names)

    def tried(
        self,
        fit: Likelihood,
        chosen: Sequence[Hypothesis],
        near: int,
        every: Callable[[Likelihood], list[Hypothesis]],
        names: Collection[tuple[str, Site]],
    ) -> list[Hypothesis]:
        found = self.ordered(h for h in every(fit) if h.name not in names)
        best = {(h.name, h.candidate.site.window): self.shaped(fit, h) for h in found[:near]}
        if self.curves:
            plain = self.base.extended(fit.extra[: len(chosen)])
            for h in self.ordered(h for h in every(plain) if h.name not in names)[:near]:
                one = again(fit, self.rows, self.shaped(plain, h))
                if one is not None:
                    best.setdefault((one.name, one.candidate.site.window), one)
        return self.ordered(self.worth(fit, chosen, h) for h in best.values()) + found[near:]

    def ordered(self, found: Iterable[Hypothesis]) -> list[Hypothesis]:
        return sorted(found, key=lambda h: -self.odds(h))

    def shaped(self, fit: Likelihood, h: Hypothesis) -> Hypothesis:
        one = refined(fit, self.rows, h)
        if one.candidate.site.window is not None:
            return one
        best = at_summit(fit, self.rows, one)
        now = hypothesis_of(fit, self.rows, best.candidate)
        if now is None:
            return one
        better = replace(now, log_evidence=now.log_evidence + one.paid, tried=one.tried, paid=one.paid)
        return better if better.log_evidence > one.log_evidence else one

    def given_others(self, fit: Likelihood, chosen: Sequence[Hypothesis]) -> list[Hypothesis]:
        if not self.curves:
            return [replace(h, log_evidence=fit.evidence_for(k) + h.paid) for k, h in enumerate(chosen)]
        rest = [self.fit([*chosen[:k], *chosen[k + 1 :]]).log_evidence for k in range(len(chosen))]
        return [replace(h, log_evidence=fit.log_evidence - r + h.paid) for h, r in zip(chosen, rest, strict=True)]

    def without_needless(self, chosen: list[Hypothesis]) -> list[Hypothesis]:
        while chosen:
            now = self.given_others(self.fit(chosen), chosen)
            k = min(range(len(now)), key=lambda i: self.odds(now[i]))
            if self.odds(now[k]) > 0:
                break
            self.log.append(["drop", words(chosen[k], self.rows), round(now[k].log_evidence, 1)])
            chosen = [*chosen[:k], *chosen[k + 1 :]]
        return chosen

    def run(self) -> tuple[list[Hypothesis], list[Hypothesis], list[Hypothesis]]:
        """Return the terms, and what led first and last: add while something is likelier than not, then swap."""
        chosen, first, last = self.added([])
        for _ in range(SWEEPS):
            before = [h.candidate for h in chosen]
            chosen = self.without_needless(self.swapped(chosen))
            if [h.candidate for h in chosen] == before:
                break
            chosen, _, last = self.added(chosen)
        return chosen, first, last

    def added(self, chosen: list[Hypothesis]) -> tuple[list[Hypothesis], list[Hypothesis], list[Hypothesis]]:
        first, dropped = None, set[str]()
        while True:
            lead = [h for h in self.leading(self.fit(chosen), chosen) if words(h, self.rows) not in dropped]
            first = lead if first is None else first
            if not lead or self.odds(lead[0]) <= 0 or len(chosen) == MOST:
                return chosen, first, lead
            self.log.append(["add", words(lead[0], self.rows), round(lead[0].log_evidence, 1)])
            before = [*chosen, lead[0]]
            chosen = self.without_needless(before)
            dropped |= {words(h, self.rows) for h in before if h.candidate not in {c.candidate for c in chosen}}

    def rivals(self, fit: Likelihood, h: Hypothesis, rest: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return what may be in the place of a term: at its joint or on the whole robot, for its time if it has one."""
        place, windowed = h.candidate.place, h.candidate.site.window is not None

        def every(one: Likelihood) -> list[Hypothesis]:
            if windowed:
                return screened(one, self.rows, self.effects)
            return [x for x in lasting(one, self.rows, self.effects) if place in (None, x.candidate.place)]

        names = {one.name for one in rest if one.candidate.site.window is None} | {h.name}
        return self.tried(fit, rest, RIVALS, every, names)[: 2 * RIVALS]

    def swapped(self, chosen: list[Hypothesis]) -> list[Hypothesis]:
        for k in range(len(chosen)):
            rest = [*chosen[:k], *chosen[k + 1 :]]
            fit = self.fit(rest)
            own = again(fit, self.rows, chosen[k])
            own = chosen[k] if own is None else self.shaped(fit, own)
            own = self.worth(fit, rest, own)
            best = max((own, *self.rivals(fit, chosen[k], rest)), key=self.odds)
            if best.name != own.name:
                gain = best.log_evidence - own.log_evidence
                self.log.append(["swap", words(own, self.rows), words(best, self.rows), round(gain, 1)])
            chosen = [*chosen[:k], best, *chosen[k + 1 :]]
        return chosen

    def shares(self, fit: Likelihood, chosen: Sequence[Hypothesis]) -> list[float]:
        """Return the largest part of a joint's torque [rms] that each term carries."""
        rms = np.maximum(fit.machine.torque_rms, 1e-300)
        return [
            max(float(np.sqrt(np.mean(fit.part(j, fit.further(k)) ** 2))) / rms[j] for j in fit.extra[k].joints)
            for k in range(len(chosen))
        ]


def evidence(found: Sequence[Hypothesis], rows: Rows, most: int = 10) -> list[list[Any]]:
    return [[words(h, rows), round(h.log_evidence, 1), round(log_odds(h, rows), 1)] for h in found[:most]]


@single_threaded()
def one(name: str, kinds: Sequence[str], present: bool) -> dict[str, Any]:
    """Return what searches say of a case: the present one if asked for, then others by their kinds."""
    with TemporaryDirectory() as folder:
        case, truth = asked(name, Path(folder))
        options = {k: v for k, v in case.options.items() if k not in ("simulated", "effects")}
        start = time.process_time()
        base = baseline(case, options)
        middle = time.process_time()
        ranked = torchrbd.rank_hypotheses(case.robot, case.recordings, **options) if present else None
        end = time.process_time()
    rows = carried(base)
    first = {"cpu_s": end - middle - (middle - start), "adopted": listed(ranked.adopted)} if ranked else {}
    return {
        "case": name,
        "truth": truth,
        "base_cpu_s": middle - start,
        **({"present": first} if ranked else {}),
        **{kind: variant(base, rows, *KINDS[kind]) for kind in kinds},
    }


def baseline(case: Asked, options: dict[str, Any]) -> Likelihood:
    """Return the learnt machine, from which searches start."""
    arguments = inspect.signature(torchrbd.rank_hypotheses).parameters
    values = {name: p.default for name, p in arguments.items() if p.default is not p.empty} | options
    robot, sources, settings = read_arguments(case.robot, case.recordings, given(values), "rank_hypotheses")
    reading, _ = read(robot, sources, settings, lambda *_: None)
    held = {recording.name for recording in reading.recordings[len(sources) :]}

    def kept_back(name: str, t: torch.Tensor) -> torch.Tensor:
        return torch.full((len(t),), name in held)

    band = band_hz([reading.surveys[k] for k in not_held_out(reading, kept_back)])
    return in_band(reading, band, kept_back, frozenset(settings.held_bodies(robot))).fit


def listed(found: Sequence[Ranked]) -> list[list[Any]]:
    return [[h.effect, *h.joints, *h.links, h.other, h.window, round(h.log_evidence, 1)] for h in found]


def variant(base: Likelihood, rows: Rows, prune: bool, keep: bool) -> dict[str, Any]:
    """Return what a search with the noise of a saturated model says."""
    effects = tuple(known_effects().values())
    begin = time.process_time()
    rich, curves = saturated(base, rows, prune=prune)
    middle = time.process_time()
    search = Search(base, rows, effects, rich, rich.extra if keep else ())
    chosen, first, last = search.run()
    fit = search.fit(chosen)
    end = time.process_time()
    seen = [j for j in range(rows.n_dof) if rows.seen[j]]
    scatter = np.ones(rows.n_dof)
    scatter[seen] = [max(fit.dispersion(j), 1.0) for j in seen]
    tempered = Search(base, rows, effects, rich, search.curves)
    tempered.base = tempered.base.dispersed(np.maximum(scatter, search.base.hyper.dispersion))
    kept = tempered.without_needless(list(chosen))
    return {
        "cpu_s": {"learning": middle - begin, "search": end - middle},
        "noise_std": [[n.std, m.std] for n, m in zip(base.hyper.noise, rich.hyper.noise, strict=True)],
        "dispersion": [n.tolist() for n in (base.hyper.dispersion, rich.hyper.dispersion, scatter)],
        "curves": curves,
        "first": evidence(first, rows),
        "terms": evidence(search.given_others(fit, chosen), rows, MOST),
        "shares": [round(s, 4) for s in search.shares(fit, chosen)],
        "tempered": evidence(tempered.given_others(tempered.fit(kept), kept), rows, MOST),
        "left": evidence(last, rows, 4),
        "log": search.log,
    }


def collected(folders: Sequence[Path]) -> Path:
    """Write what was found of all cases in some folders into the result file, and return it."""
    found: dict[str, dict[str, Any]] = {}
    for file in (file for folder in folders for file in sorted(folder.glob("*.json"))):
        one = json.loads(file.read_text())
        case = found.setdefault(
            one["case"], {"truth": [" ".join((t["effect"], *t["joints"], *t["links"])) for t in one["truth"]]}
        )
        for kind in (kind for kind in KINDS if kind in one):
            each = zip(one[kind]["terms"], one[kind]["shares"], strict=True)
            case[kind] = {
                "cpu_s": round(sum(one[kind]["cpu_s"].values()), 1),
                "curves": len(one[kind]["curves"]),
                "terms": [
                    f"{name}: {nats} nats, odds {odds}, {share:.1%} of the torque" for (name, nats, odds), share in each
                ],
                "next": one[kind]["left"][:1],
            }
    return results_file.update("saturated_noise", "python benchmarks/saturated_noise.py", found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--collect", type=Path, nargs="+", help="folders")
    parser.add_argument("--present", action="store_true")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS))
    parser.add_argument("cases", nargs="*")
    options = parser.parse_args()
    if options.collect:
        print(collected(options.collect))
    for name in options.cases:
        file = options.output / f"{name.replace(' ', '_')}.json"
        if file.exists():
            continue
        result = one(name, options.kinds, options.present)
        file.write_text(json.dumps(result, indent=1))
        print(name, result["truth"], round(result["base_cpu_s"], 1), flush=True)
        if options.present:
            print("   present", result["present"], flush=True)
        for kind in options.kinds:
            found = result[kind]
            print("  ", kind, len(found["curves"]), {k: round(v, 1) for k, v in found["cpu_s"].items()})
            for term, share in zip(found["terms"], found["shares"], strict=True):
                print("     ", *term, share, flush=True)
            print("      left", found["left"][:3], flush=True)


if __name__ == "__main__":
    main()
