"""What changed between two diagnoses."""

from __future__ import annotations

import math

from torchrbd.comparison.results import Change, Comparison, Difference, Load
from torchrbd.diagnosis.results import Alternative, Quantity
from torchrbd.report.text.names import named, signal_words, when
from torchrbd.report.text.numbers import MINUS, as_many_as_fit, capital, joined, measure, number, with_unit

_MOST_NAMED = 5
_LEAST_CERTAIN, _MOST_CERTAIN = 0.01, 0.99
_WORDS = 8
_NOT_COMPARED = {
    "window": "It acts in a window of time that the other diagnosis has not seen.",
    "no limit": "The other diagnosis does not say which size it could have detected.",
    "other shape": "The other diagnosis has a detection limit for another shape of it only.",
}


def certainty(probability: float) -> str:
    """Return a probability in two digits; none is ever quite certain."""
    if math.isnan(probability):
        return "–"
    if probability > _MOST_CERTAIN:
        return f"> {_MOST_CERTAIN:g}"
    return f"< {_LEAST_CERTAIN:g}" if probability < _LEAST_CERTAIN else f"{probability:.2f}"


def signed(d: Difference) -> str:
    """Return a difference with its 95 % interval, "+0.70 ± 0.10"."""
    words = measure(d.difference, 1.96 * d.std)
    bare = words.removeprefix("(")
    return words if bare.startswith((MINUS, "–")) else words.removesuffix(bare) + f"+{bare}"


def comparison_statement(result: Comparison) -> str:
    """Say in a few sentences what changed."""
    changes = result.changes
    changed = [c for c in changes if c.verdict == "changed"]
    open_ones = sum(c.verdict == "open" for c in changes)
    same = sum(c.verdict == "unchanged" for c in changes)
    if not changes:
        return "Neither diagnosis has anything to compare."
    words = [change_statement(c) for c in changed[:_MOST_NAMED]] or ["No change is certain."]
    if len(changed) > _MOST_NAMED:
        words.append(f"{len(changed) - _MOST_NAMED} more changes are certain.")
    if same:
        words.append(f"{same} of {len(changes)} are unchanged.")
    if open_ones:
        words.append(f"{open_ones} of {len(changes)} are undecided with this data.")
    return " ".join(words)


def change_statement(change: Change) -> str:
    """Say what became of one thing that either diagnosis has."""
    if change.kind == "inertia":
        return _inertia(change)
    if change.kind == "unexplained":
        return _unexplained(change)
    if change.rivals:
        others = as_many_as_fit([named(a) for a in change.rivals], _WORDS)
        return (
            f"{_subject(change)} was found only {change.found}. The other diagnosis has {others}, "
            "which may be another name for it. No change is certain."
        )
    if change.reason:
        return f"{_subject(change)} was found only {change.found}. {_NOT_COMPARED[change.reason]}"
    return _of_both(change) if change.found == "both" else _of_one(change)


def _of_both(change: Change) -> str:
    known = {name: d for name, d in change.parameters.items() if not math.isnan(d.probability)}
    subject = _subject(change)
    if not known:
        return f"{subject} is in both diagnoses. The uncertainty of its parameters is unknown."
    if change.verdict == "changed":
        most = {name: d for name, d in known.items() if d.probability > 0.5}
        words = as_many_as_fit([f"{_name(name, change)}{_moved(d)}" for name, d in most.items()], 2 * _WORDS)
        return f"{subject} {words}; probability {certainty(change.probability)}."
    words = as_many_as_fit([_pair(name, d, change) for name, d in known.items()], 2 * _WORDS)
    if change.verdict == "unchanged":
        return f"{subject} is unchanged: {words}."
    return f"{subject}: {words}. A change is possible (probability {certainty(change.probability)})."


def _of_one(change: Change) -> str:
    """Say what the other data say of an effect that one alone has."""
    ((name, d),) = change.parameters.items()
    label, subject = name.replace("_", " "), _subject(change)
    before, after = (with_unit(measure(q.value, 1.96 * q.std), _unit(d)) for q in (_given(d.before), _given(d.after)))
    order = f"{label} was {before}, is {after}"
    if change.verdict == "changed":
        news = "new" if change.found == "after" else "gone"
        return f"{subject} is {news}: {order}; probability {certainty(change.probability)}."
    if change.verdict == "unchanged":
        return f"{subject} was found only {change.found}, but the other data allows the same size: {order}."
    return (
        f"{subject} was found only {change.found}: {order}. "
        f"The other data could not detect it; a change has probability {certainty(change.probability)}."
    )


def _unexplained(change: Change) -> str:
    on = f" that depends on {joined(map(signal_words, change.depends_on))}" if change.depends_on else ""
    where = f"An unexplained residual at {joined(change.joints)}{on}"
    if change.found == "both":
        return f"{where} is in both diagnoses. Whether it changed is unknown."
    return f"{where} was found only {change.found}. The other diagnosis does not exclude it."


def _inertia(change: Change) -> str:
    parameters = change.parameters
    if change.verdict == "unchanged":
        return f"Inertial parameters are unchanged, in all {len(parameters)} combinations that both data sets identify."
    if change.verdict == "open":
        most = max(parameters, key=lambda name: parameters[name].probability)
        size = with_unit(signed(parameters[most]), _unit(parameters[most]))
        return (
            f"Inertial parameters may have changed (probability {certainty(change.probability)}). "
            f"Most likely is {most}, by {size}."
        )
    count = sum(d.probability > 0.5 for d in parameters.values())
    words = f"Inertial parameters changed in {count} of {len(parameters)} combinations that both data sets identify"
    load = f", {as_if(change.load)}" if change.load is not None else ""
    return f"{words}{load}; probability {certainty(change.probability)}."


def as_if(load: Load) -> str:
    """Return "as if link2 or link3 had 0.50 ± 0.04 kg less"."""
    mass = with_unit(measure(abs(load.mass), 1.96 * load.std), "kg")
    return f"as if {joined(load.links, 'or')} had {mass} {'more' if load.mass > 0 else 'less'}"


def _subject(change: Change) -> str:
    """Return "Coulomb friction of joint2", with the time where it acts for a time only."""
    inside = when(change.where)
    place = joined((*change.joints, *change.links))
    words = named(_item(change)) + (f" of {place}" if place else " of the whole robot")
    return capital(words) + (f" ({inside})" if inside else "")


def _item(change: Change) -> Alternative:
    return Alternative(change.effect, change.joints, change.links, change.depends_on)


def _name(parameter: str, change: Change) -> str:
    """Return "static " where the effect's name does not say which parameter is meant."""
    words = parameter.replace("_", " ")
    return "" if len(change.parameters) == 1 or words in named(_item(change)).lower() else f"{words} "


def _moved(d: Difference) -> str:
    before, after = _given(d.before), _given(d.after)
    verb = "grew" if abs(after.value) > abs(before.value) else "fell"
    if before.value * after.value < 0:
        verb = "went"
    return f"{verb} from {number(before.value)} to {with_unit(number(after.value), _unit(d))} ({signed(d)})"


def _pair(name: str, d: Difference, change: Change) -> str:
    before, after = _given(d.before), _given(d.after)
    values = with_unit(f"{number(before.value)} and {number(after.value)}", _unit(d))
    return f"{_name(name, change)}{values} ({signed(d)})"


def _given(q: Quantity | None) -> Quantity:
    assert q is not None, "both diagnoses know this parameter"
    return q


def _unit(d: Difference) -> str:
    return (d.after or d.before or Quantity(0.0, 0.0, "")).unit
