"""A designed motion as files: samples for a controller, and the series that they are taken from."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from torchrbd._runtime.outputs import check_file, write_whole
from torchrbd.errors import OptionError
from torchrbd.excitation import Excitation
from torchrbd.excitation.limits import AXES

_FASTEST_HZ, _MOST_SAMPLES = 1e5, 1e7


def check_rate(rate_hz: float) -> None:
    """See that samples can be taken at a rate.

    Raises:
        OptionError: they cannot.
    """
    if not (math.isfinite(rate_hz) and 0.0 < rate_hz <= _FASTEST_HZ):
        raise OptionError(f"rate is {rate_hz:g} Hz; expected a positive number, at most {_FASTEST_HZ:g}")


def check_samples(period_s: float, harmonics: int, periods: int, rate_hz: float) -> None:
    """Check that samples at a rate represent a motion, and that a file can hold them.

    Raises:
        OptionError: they do not, or it cannot.
    """
    least, count = 2.0 * harmonics / period_s, periods * period_s * rate_hz
    if not rate_hz > least:
        raise OptionError(
            f"rate is {rate_hz:g} Hz; expected more than {least:g} Hz, twice the highest frequency of the motion"
        )
    if count > _MOST_SAMPLES:
        raise OptionError(
            f"{periods} periods of {period_s:g} s at {rate_hz:g} Hz are {count:.3g} samples; expected at most "
            f"{_MOST_SAMPLES:g}: fewer periods, or a lower rate"
        )


def motion_csv(result: Excitation, rate_hz: float) -> bytes:
    """Return a motion as CSV: t [s], then q_, qd_ and qdd_ of each joint [rad or m, per s, per s^2]."""
    check_rate(rate_hz)
    check_samples(result.motion.period_s, result.motion.basis.harmonics, result.periods, rate_hz)
    t, *states = result.states(rate_hz)
    names = [f"{signal}_{joint}" for signal in ("q", "qd", "qdd") for joint in result.robot.joint_names]
    header = ",".join(_quoted(name) for name in ("t", *names))
    text = io.StringIO()
    np.savetxt(text, np.column_stack((t, *states)), delimiter=",", header=header, comments="", fmt="%.9g")
    return text.getvalue().encode()


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if any(mark in name for mark in ',"\n') else name


def motion_yaml(result: Excitation, options: Mapping[str, Any]) -> bytes:
    """Return the series of a motion and the figures that it reaches, as YAML.

    Args:
        result: the motion.
        options: that it was designed with, for the record.
    """
    motion = result.motion
    series = {
        joint: {"centre": centre, "sine": a, "cosine": b}
        for joint, centre, a, b in zip(
            result.robot.joint_names,
            motion.centre.tolist(),
            motion.sine.tolist(),
            motion.cosine.tolist(),
            strict=True,
        )
    }
    box = {axis: [_number(end) for end in ends] for axis, ends in zip(AXES, result.limits.box.tolist(), strict=True)}
    content = {
        "robot": result.robot.name,
        "motion": "q(t) = centre + sum over l of sine[l] sin(l w t) + cosine[l] cos(l w t), w = 2 pi / period_s",
        "period_s": motion.period_s,
        "periods": result.periods,
        "joints": series,
        "condition_number": asdict(result.condition),
        "used": [{name: _number(value) for name, value in asdict(one).items()} for one in result.uses],
        "box": {axis: ends for axis, ends in box.items() if ends != [None, None]},
        "clearance": _number(result.clearance),
        "margin": result.limits.margin,
        "separations": [asdict(one) for one in result.separations],
        "notes": [str(note) for note in result.notes],
        "options": {name: _plain(value) for name, value in options.items()},
    }
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None).encode()


def _number(value: Any) -> Any:
    """Return what YAML has a word for that other readers share: nothing for what is not finite."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, Path):
        return str(value)
    return (
        [_plain(one) for one in value] if isinstance(value, Sequence) and not isinstance(value, str) else _number(value)
    )


def series_of(file: Path) -> Path:
    """Return where the series of a motion is written, given the file of its samples."""
    return file.with_suffix(".yaml")


def write_motion(result: Excitation, file: Path, rate_hz: float, options: Mapping[str, Any]) -> Path:
    """Write a motion as CSV, and its series into a second file; return the path of that."""
    samples, series = motion_csv(result, rate_hz), series_of(file)
    for path in (file, series):
        check_file(path)
    write_whole(series, motion_yaml(result, options))
    write_whole(file, samples)
    return series
