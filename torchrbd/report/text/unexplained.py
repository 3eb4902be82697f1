"""Residuals that no known effect explains."""

from __future__ import annotations

from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.results import Unexplained
from torchrbd.report.text.names import signal_words
from torchrbd.report.text.numbers import as_many_as_fit, joined, number, percent, with_unit

_NOTHING_ELSE = "No known effect and no function of one signal explains it."
_RECORDING_WORDS = 6


def unexplained_statement(one: Unexplained) -> str:
    """Say how large a residual is and what it depends on, and the held-out error of its joint."""
    error = _error(one)
    if one.kind in ("error", "larger error"):
        return f"{error} {_NOTHING_ELSE}{_of_all_states(one)}"
    return f"{_residual(one)} {error}".rstrip()


def _of_all_states(one: Unexplained) -> str:
    share = one.sizes.get("states")
    return "" if share is None else f" A random forest of all states predicts {percent(share)} of it on left-out data."


def _error(one: Unexplained) -> str:
    where, sizes, found = joined(one.joints), one.sizes, []
    if (nmse := sizes.get("nmse")) is not None:
        share = f"{number(nmse)} ({percent(nmse)} of the torque variance)"
        found.append(f"The NMSE of {where} on held-out data is {share}, with correlated errors.")
    if (ratio := sizes.get("ratio")) is not None:
        found.append(f"The error of {where} on held-out data is {number(ratio)} times that of the fitted data.")
    return " ".join(found)


def _residual(one: Unexplained) -> str:
    where, sizes = joined(one.joints), one.sizes
    if one.kind == "drift":
        torque = with_unit(number(sizes["torque_rms"]), one.unit)
        return f"A torque of {torque} RMS at {where} changes slowly with time. No known effect explains it."
    if one.kind == "tone":
        low, high = (number(sizes[key]) for key in ("low", "high"))
        size = with_unit(low if low == high else f"{low} to {high}", one.unit)
        tone = f"A vibration of {sizes['frequency']:.2f} Hz at {where}"
        return f"{tone} is unexplained{_inside(one)}; its amplitude is {size}."
    return _curve(one)


def _curve(one: Unexplained) -> str:
    where = joined(one.joints)
    torque = with_unit(number(one.sizes["torque_rms"]), one.unit) + " RMS" if "torque_rms" in one.sizes else ""
    size = f"A torque of {torque}" if torque else "A torque"
    share = f" It is {percent(one.share)} of the residual of left-out data." if one.share >= DECISIONS.no_change else ""
    words = f"{size} at {where} is unexplained{_inside(one)}.{share}"
    if one.depends_on:
        words += f" It depends on {joined(map(signal_words, one.depends_on))}"
        region = next((r for r in one.where.region or () if r.signal == one.depends_on[0]), None)
        if region is not None:
            words += f", mostly between {number(region.low)} and {number(region.high)}"
        words += "."
    return words


def _inside(one: Unexplained) -> str:
    return f" in {as_many_as_fit(one.where.recordings, _RECORDING_WORDS)}" if one.where.recordings else ""
