"""The YAML file that lists the robots of a fleet.

    options: {cutoff: 5}                 # of all; those of 'torchrbd identify'
    robots:
      - name: cell-1
        urdf: arm.urdf
        recordings: [cell-1/monday.parquet, cell-1/tuesday.parquet]
      - name: cell-2
        urdf: arm.urdf
        recordings: cell-2/monday.parquet
        mapping: driver.yaml             # optional
        options: {encoder-noise: 1e-4}   # optional: these win over those of all

Files are sought from the YAML file's folder, wherever the work is done.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from torchrbd.errors import OptionError, closest
from torchrbd.estimators import WITH_INTERVALS
from torchrbd.inference.settings import Settings
from torchrbd.recordings.strict_yaml import strict_yaml

_TOP, _OF_ROBOT, _NEEDED = ("options", "robots"), ("name", "urdf", "recordings", "mapping", "options"), 3
# A robot takes some hundred letters.
_LARGEST = 1 << 26
# What is a folder's name everywhere.
_NAME = re.compile(r"[\w][\w .+-]*(?<![ .])")


@dataclass(frozen=True)
class RobotEntry:
    """One robot of a fleet: its name, its URDF, its recordings, and options of ``identify``."""

    name: str
    urdf: Path
    recordings: tuple[Path, ...]
    options: Mapping[str, Any]


def read_robots(path: Path) -> tuple[RobotEntry, ...]:
    """Read a file of robots.

    Raises:
        OptionError: it cannot be read, or says something else; the message has the robot and the key.
    """
    try:
        content = strict_yaml(path.read_text(encoding="utf-8"), largest=_LARGEST)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise OptionError(f"{path}: is not YAML in UTF-8 ({' '.join(str(error).split())})") from None
    except OSError as error:
        raise OptionError(f"{path}: cannot be read ({error.strerror}); give a file that lists robots") from None
    _check_keys(content, _TOP, str(path))
    robots = content.get("robots")
    if not isinstance(robots, list) or not robots:
        raise OptionError(f"{path}: expected 'robots:' and a list of robots, each with name, urdf and recordings")
    shared = _options(content.get("options"), str(path))
    found = tuple(_entry(one, k, shared, path) for k, one in enumerate(robots, start=1))
    seen: set[str] = set()
    for one in found:
        if one.name.casefold() in seen:
            raise OptionError(f"{path}: two robots are called '{one.name}'; results are named after them, rename one")
        seen.add(one.name.casefold())
    return found


def _entry(content: Any, number: int, shared: Mapping[str, Any], path: Path) -> RobotEntry:
    place = f"{path}: robot {number}"
    _check_keys(content, _OF_ROBOT, place)
    for key in _OF_ROBOT[:_NEEDED]:
        if content.get(key) in (None, "", []):
            raise OptionError(f"{place}: '{key}' is missing")
    name = str(content["name"])
    place = f"{place}, '{name}'"
    if not _NAME.fullmatch(name):
        raise OptionError(f"{place}: the name is that of its folder of results; use letters, digits, '-', '_' and '.'")
    given = content["recordings"]
    files = [_file(one, "recordings", place, path) for one in (given if isinstance(given, list) else [given])]
    options = {**shared, **_options(content.get("options"), place)}
    if content.get("mapping") is not None:
        options["mapping"] = _file(content["mapping"], "mapping", place, path)
    estimator = Settings.from_mapping(options, place).estimator
    if estimator not in WITH_INTERVALS:
        raise OptionError(
            f"{place}: estimator '{estimator}' tells no intervals, which a comparison of robots needs; take one of "
            f"{', '.join(WITH_INTERVALS)}"
        )
    return RobotEntry(name, _file(content["urdf"], "urdf", place, path), tuple(files), options)


def _file(value: Any, key: str, place: str, path: Path) -> Path:
    if not isinstance(value, str):
        raise OptionError(f"{place}: {key}: expected the name of a file, got {value!r:.50}")
    return path.absolute().parent / value


def _options(content: Any, place: str) -> dict[str, Any]:
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise OptionError(f"{place}: options: expected 'option: value', e.g. {{cutoff: 5}}")
    options = {str(key).replace("-", "_"): value for key, value in content.items()}
    if "cutoff" in options:
        options["cutoff_hz"] = options.pop("cutoff")
    for key in ("holdout", "simulated", "mapping"):
        if key in options:
            raise OptionError(f"{place}: options: '{key}' names files, which belong to a robot; leave it out")
    Settings.from_mapping(options, place)
    return options


def _check_keys(content: Any, known: tuple[str, ...], place: str) -> None:
    if not isinstance(content, dict):
        raise OptionError(f"{place}: expected keys {', '.join(known)}; got {content!r:.50}")
    for key in content:
        if key not in known:
            hint = closest(str(key), known) or f"known: {', '.join(known)}"
            raise OptionError(f"{place}: unknown key '{key}'; {hint}")
