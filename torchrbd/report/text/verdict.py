"""The verdict: its badge, its headline, and what else there is to say of a result as a whole."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import astuple

from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.results import Finding, Ratio, Where
from torchrbd.effects.registry import PLAIN, effect
from torchrbd.inference.identification import Identification
from torchrbd.report.text.findings import NOT_CONFIRMED
from torchrbd.report.text.names import all_or_some, alternatives, at, named, placed, when, with_article, words_of
from torchrbd.report.text.numbers import as_many_as_fit, joined, number, percent, ratio_with_interval, sentence
from torchrbd.report.text.suspicions import tested_words

VERDICTS = {
    "consistent": "✓ URDF consistent",
    "parameters": "≠ Parameters differ",
    "missing_physics": "! Missing physics",
    "unexplained": "? Unexplained",
    "identified": "✓ Identified",
    "doubtful": "! Identified, with doubts",
    "worse": "✗ Worse than the URDF",
    "suspect": "✗ Suspect input",
}
"""What a verdict is called, after a sign that needs no colour."""
CHECK_INPUT = "Check the input: the recordings do not fit this robot as they are read."
# Joints that one line names.
_MOST_NAMED = 3
# Words of the headline, and of it for what the model lacks, and has wrong where both are to be said.
MOST_WORDS, _WORDS, _WORDS_OF_FIRST = 25, 20, 10
_WRONG = "wrong "
_PARENTHESIS = re.compile(r" \([^)]*\)")
# Said together where they are found at the same joints.
_JOINED = tuple(words_of(identifier) for identifier in PLAIN if effect(identifier).dissipative)


def model_words(result: Identification | Diagnosis) -> str:
    """Return what the recordings are compared with."""
    return "simulation" if isinstance(result, Diagnosis) and result.simulated else "URDF"


def badge(result: Identification | Diagnosis) -> str:
    """Return what a result's verdict is called."""
    words = VERDICTS[result.verdict].replace("URDF", model_words(result))
    return words if result.finished else f"{words} (unfinished)"


def headline(result: Identification | Diagnosis) -> tuple[str, str]:
    """Return the result in one sentence, and what else is to say of it."""
    if isinstance(result, Diagnosis):
        return _head(result), " ".join(filter(None, _more(result)))
    mean = {name: fit.mean_nmse for name, fit in result.fits.items()}
    last = list(mean)[-1]
    before, after = mean["urdf"], mean[last]
    if worst := _worst(result, after):
        return worst
    subject = "The extended model" if last == "extended" else "Re-fitting"
    rest = f"The re-fitted rigid body alone has {number(mean['rigid_body'])}." if last == "extended" else ""
    verb = "lowers" if after < before else "raises" if result.verdict == "worse" else "does not lower"
    name = result.robot.name
    return f"{subject} {verb} the mean NMSE of {name} on held-out data: {number(before)} → {number(after)}.", rest


def _worst(result: Identification, after: float) -> tuple[str, str] | None:
    """Return what comes before any praise of a lower error; None where there is nothing.

    Args:
        result: an identification.
        after: mean NMSE of its last model on held-out data.
    """
    if any(one.settles for one in result.suspicions.found):
        return CHECK_INPUT, " ".join(sentence(one.statement) for one in result.suspicions.found if one.settles)
    nmse = f"a mean NMSE of {number(after)} on held-out data"
    if result.verdict == "suspect" or after >= 1.0:
        return f"The fitted model of {result.robot.name} predicts torque no better than a constant.", f"It has {nmse}."
    if absurd := result.fits["urdf"].absurd:
        where = as_many_as_fit(list(absurd), _WORDS // 2)
        return (
            f"Check the units: the URDF's torque is more than ten times off at {where}.",
            f"The fitted model has {nmse}.",
        )
    return None


def diagnosis_statement(result: Diagnosis) -> str:
    """Say the verdict in a few sentences, the headline first."""
    return " ".join(filter(None, headline(result)))


def _head(result: Diagnosis) -> str:
    """Return the headline, at most 25 words."""
    model = model_words(result)
    if result.verdict == "suspect":
        return _suspect_head(result)
    if result.verdict == "consistent":
        return f"The {model} as given explains the recordings."
    if result.verdict == "parameters":
        return f"A rigid body explains the recordings, with other inertial parameters than the {model}'s."
    if result.verdict == "unexplained":
        joints = at([j for u in result.unexplained for j in u.joints], (), _judged(result))
        return f"No known effect explains the residual{joints}."
    likely = [f for f in result.findings if f.probability > DECISIONS.likely]
    if likely:
        return f"The {model} {_missing(likely, _judged(result))}."
    return f"The {model} lacks an effect: {as_many_as_fit([_either(f) for f in result.findings], _WORDS)}."


def _more(result: Diagnosis) -> Iterable[str]:
    """Yield the sentences behind the headline."""
    fits, model = result.identification.fits, model_words(result)
    if not result.finished:
        yield "Unfinished: the search was ended early, and more effects may be missing."
    if result.verdict == "suspect":
        yield from _suspect_reasons(result)
        return
    mean = {name: number(fit.mean_nmse) for name, fit in fits.items()}
    if result.verdict == "consistent":
        yield "This data shows no missing effect."
    elif result.verdict == "parameters":
        yield f"Re-fitting changes the mean NMSE on held-out data from {mean['urdf']} to {mean['rigid_body']}."
    else:
        yield (
            f"The mean NMSE on held-out data is {mean['urdf']} with the {model}, {mean['baseline']} with least squares "
            f"and friction, and {mean['extended']} with the extended model."
        )
    yield from _doubts(result)


def _doubts(result: Diagnosis) -> Iterable[str]:
    """Yield what held-out data says of the findings, and what they do not explain."""
    everywhere = _judged(result)
    if result.findings and result.held_out_ratio is not None:
        ratio = ratio_with_interval(*astuple(result.held_out_ratio), of="the fitted torque")
        yield f"On held-out data the torque of the findings is {ratio}."
    count = sum(not f.held_out for f in result.findings)
    if count:
        yield f"{NOT_CONFIRMED}: {count} of {len(result.findings)} findings."
    joints = [j for u in result.unexplained for j in u.joints]
    if joints and result.verdict != "unexplained":
        yield f"A residual at {all_or_some(joints, everywhere)} is unexplained."
    if result.next_effect is not None:
        terms = result.next_effect.terms
        only = f" in {result.next_effect.recording}" if result.next_effect.recording else ""
        yield (
            f"The search ended after {terms} term{'' if terms == 1 else 's'}; the next likely effect is "
            f"{with_article(placed(result.next_effect))}{only}."
        )
    yield from _held_out_errors(result)


def _held_out_errors(result: Diagnosis) -> Iterable[str]:
    """Yield where held-out errors are larger than the baseline's, or findings smaller than fitted."""
    worse_than = {
        words: {p.joint: p.over[model] for p in result.held_out_checks if p.over[model].exceeds_one}
        for model, words in (("baseline", "least squares with friction"), ("urdf", f"the {model_words(result)}"))
    }
    for words, worse in worse_than.items():
        if not worse:
            continue
        sizes = [f"{j} ({number(r.value)} times, {number(r.low)} to {number(r.high)})" for j, r in worse.items()]
        yield (
            f"On held-out data the extended model's squared error exceeds that of {words} at "
            f"{as_many_as_fit(sizes, _MOST_NAMED)}."
        )
    ratio = result.held_out_ratio
    if not any(worse_than.values()) and result.findings and ratio is not None and ratio.high < 1.0:
        yield (
            "The findings are smaller on held-out data than fitted: the robot or its motion differed, or a finding is "
            "a proxy."
        )


def _judged(result: Diagnosis) -> list[str]:
    """Return the joints whose torque is judged."""
    return [j for j, nmse in result.identification.fits["urdf"].nmse.items() if math.isfinite(nmse)]


def _missing(findings: Sequence[Finding], everywhere: Sequence[str]) -> str:
    """Return "lacks ..." and "has the wrong ...", first what removes most held-out error, in as much detail as fits."""
    for with_times in (True, False):
        groups = {
            verb: _groups([f for f in findings if _is_wrong(f) == wrong], everywhere, with_times=with_times)
            for verb, wrong in (("lacks", False), ("has the wrong", True))
        }
        parts = sorted(((verb, those) for verb, those in groups.items() if those), key=lambda part: -part[1][0][0])
        budget, said = _WORDS if len(parts) == 1 else _WORDS_OF_FIRST, list[str]()
        for verb, those in parts:
            words = as_many_as_fit([text for _, text in those], budget, rest="more effects")
            said.append(f"{verb} {words}")
            budget = _WORDS - 2 - len(words.split())
        text = ", and ".join(said)
        if len(text.split()) <= MOST_WORDS - 2:
            return text
    return said[0]


def _either(finding: Finding) -> str:
    """Return a finding that is no likelier than not with its first rival: "a joint spring or backlash at joint2"."""
    either = joined(map(with_article, (*alternatives(finding)[:1], named(finding))), "or")
    return either + (at(finding.joints, finding.links) or " on the whole robot")


def _is_wrong(finding: Finding) -> bool:
    return words_of(finding.effect).startswith(_WRONG) or any(q.urdf for q in finding.parameters.values())


def _groups(findings: Sequence[Finding], everywhere: Sequence[str], *, with_times: bool) -> list[tuple[float, str]]:
    """Return what effects remove of the held-out error, with their names and places, the largest first.

    E.g. "joint spring at joint3", "viscous and Coulomb friction at all joints": one entry for an effect at many joints.
    """
    sites: dict[tuple[str, str, tuple[str, ...]], list[Finding]] = {}
    for f in findings:
        name = _PARENTHESIS.sub("", named(f))
        words = name.removeprefix(_WRONG) if _is_wrong(f) else with_article(name)
        sites.setdefault((words, _inside(f.where) if with_times else "", f.links), []).append(f)
    places: dict[tuple[str, str], list[tuple[str, float]]] = {}
    for (words, inside, links), those in sites.items():
        joints = dict.fromkeys(j for f in those for j in f.joints)
        alone, removed = "" if words in _JOINED else words, math.fsum(f.error_removed for f in those)
        places.setdefault((_short_at([*joints], links, everywhere) + inside, alone), []).append((words, removed))
    found = [
        (math.fsum(removed for _, removed in those), _shortened([words for words, _ in those]) + where)
        for (where, _), those in places.items()
    ]
    return sorted(found, key=lambda pair: -pair[0])


def _short_at(joints: Sequence[str], links: Sequence[str], everywhere: Sequence[str]) -> str:
    """Return places for the headline: of many joints that are not all, their number."""
    words = at(joints, links, everywhere)
    short = len(joints) <= _MOST_NAMED or ("all joints" in words and " and " not in words)
    return words if short else f" at {len(joints)} joints"


def _inside(where: Where) -> str:
    """Return recordings and times for the headline: of many, their number."""
    names = where.recordings
    if names is None:
        return ""
    if len(names) > 1 or len(where.time_s or ()) > 1:
        return f" (in {names[0]})" if len(names) == 1 else f" (in {len(names)} recordings)"
    return f" ({when(Where(names, where.time_s))})"


def _shortened(words: Sequence[str]) -> str:
    """Return "viscous and Coulomb friction" for "viscous friction" and "Coulomb friction"."""
    ordered = sorted(words, key=lambda w: _JOINED.index(w) if w in _JOINED else 0)
    return ordered[0] if len(ordered) == 1 else joined(w.removesuffix(" friction") for w in ordered) + " friction"


def _suspect_head(result: Diagnosis) -> str:
    if any(one.settles for one in result.identification.suspicions.found):
        return CHECK_INPUT
    return "No model predicts held-out torque better than a constant."


def _suspect_reasons(result: Diagnosis) -> Iterable[str]:
    """Yield why the input is suspect, and what was tested."""
    suspected = result.identification.suspicions
    found = [one for one in suspected.found if one.settles]
    yield from (sentence(one.statement) for one in found)
    if found:
        yield "No findings are reported until this is corrected."
    else:
        yield "The columns, units or robot may be wrong, or the robot moves too little."
    if suspected.tested:
        yield f"Tested: {joined(tested_words(suspected.tested))}."


def suspicion_comments(result: Identification) -> list[str]:
    """Return what a reader of the identified URDF has to know first, if the input is suspected."""
    return [
        f"the recordings are suspect, and these numbers with them: {one.statement}"
        for one in result.suspicions.found
        if one.spoils
    ]


def part_left(ratio: Ratio) -> str:
    """Return an error relative to another one, with its interval: "31 % (25 to 40)"."""
    value, low, high = (percent(x) for x in (ratio.value, ratio.low, ratio.high))
    return f"{value} ({low.removesuffix(' %')} to {high.removesuffix(' %')})"


def worth(result: Diagnosis) -> str:
    """Say in one line how large the extended model's error is relative to the baseline's, where surely smaller."""
    checks = result.held_out_checks if result.findings else ()
    if not checks:
        return ""
    less = sorted(((p.over["baseline"], p.joint) for p in checks), key=lambda pair: pair[0].value)
    less = [(ratio, joint) for ratio, joint in less if ratio.high < 1.0]
    if not less:
        return "The extended model does not predict any joint significantly better than least squares with friction."
    if len(less) <= _MOST_NAMED:
        words = joined(f"{part_left(ratio)} at {joint}" for ratio, joint in less)
    else:
        (best, first), (worst, last) = less[0], less[-1]
        words = (
            f"{part_left(best)} at {first} to {part_left(worst)} at {last}; less at {len(less)} of {len(checks)} joints"
        )
    return f"Squared error on held-out data relative to least squares with friction, with 95 % intervals: {words}."
