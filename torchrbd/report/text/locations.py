"""Where a model and the robot differ."""

from __future__ import annotations

from torchrbd.diagnosis.results import Location
from torchrbd.report.text.names import signal_words
from torchrbd.report.text.numbers import as_many_as_fit, joined, number, with_unit

_WHAT = {
    "level": "a torque",
    "friction": "friction",
    "delay": "delayed torque",
    "payload": "a load",
    "force": "a force",
}
# Standard deviation up to which a point of attack is worth its numbers [m].
_POINT_STD_M = 0.3
_WORDS = 8


def excerpt_words(recording: str, begin_s: float, end_s: float) -> str:
    """Say what part of a recording is shown."""
    return f"{recording}, {begin_s:.1f} to {end_s:.1f} s, where the residual is largest"


def location_statement(one: Location) -> str:
    """Say what differs, where, when and how much."""
    return " ".join(filter(None, (_size(one), _dependence(one), _time(one))))


def _size(one: Location) -> str:
    what = _WHAT[one.form]
    if one.links and one.attack is not None:
        size = sum(f * f for f in one.attack.force) ** 0.5
        words = f"{what.capitalize()} of {number(size)} N on {joined(one.links)} would explain the residual at "
        words += f"{as_many_as_fit(one.joints, _WORDS)}."
        if max(one.attack.point_std) < _POINT_STD_M:
            words += f" It attacks at ({', '.join(number(x) for x in one.attack.point)}) m of the link's frame."
        return words
    if one.unit == "N" and one.form == "level":
        what = "a force"
    rms = one.torque_rms.get(one.joints[0], float("nan"))
    return f"{what.capitalize()} of {with_unit(number(rms), one.unit)} RMS is unexplained at {one.joints[0]}."


def _dependence(one: Location) -> str:
    if one.course == "slow":
        return "It changes slowly with time."
    if one.depends_on and one.depends_on != ("t",):
        inside = joined(f"between {number(r.low)} and {number(r.high)}" for r in one.where.region or ())
        return f"It depends on {joined(map(signal_words, one.depends_on))}{', ' if inside else ''}{inside}."
    return ""


def _time(one: Location) -> str:
    spans = [f"{low:.1f} to {high:.1f} s" for low, high in one.where.time_s or ()]
    words = f" from {as_many_as_fit(spans, 2 * _WORDS)}" if spans else ""
    if one.where.recordings:
        words += f" in {as_many_as_fit(one.where.recordings, _WORDS)}"
    return f"It acts{words}." if words else ""
