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
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field

from torchrbd.errors import OptionError
from torchrbd.estimators import WITH_INTERVALS
from torchrbd.inference.options_file import read_options
from torchrbd.inference.settings import Settings
from torchrbd.recordings.checked_yaml import Keys, Loc, checked, read_yaml, wrong
from torchrbd.recordings.strict_yaml import line_of

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


def _file(value: Any) -> str:
    if not isinstance(value, str):
        raise wrong(f"expected the name of a file, got {value!r:.50}")
    return value


def _files(value: Any) -> list[str]:
    return [_file(one) for one in (value if isinstance(value, list) else [value])]


def _name(value: Any) -> str:
    if not _NAME.fullmatch(str(value)):
        raise wrong("the name is that of its folder of results; use letters, digits, '-', '_' and '.'")
    return str(value)


def _robots(value: Any) -> Any:
    if not isinstance(value, list) or not value:
        raise wrong("expected a list of robots, each with name, urdf and recordings")
    return value


def _options(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise wrong(f"expected 'option: value', e.g. {{cutoff: 5}}; got {value!r:.50}")
    for key in ("holdout", "simulated", "mapping"):
        if key in value:
            raise wrong(f"'{key}' names files, which belong to a robot; leave it out", key)
    return value


Options = Annotated[dict[str, Any], BeforeValidator(_options)]


class RobotInFile(Keys):
    """One robot."""

    missing: ClassVar[dict[str, str]] = {key: f"'{key}' is missing" for key in ("name", "urdf", "recordings")}
    name: Annotated[str, BeforeValidator(_name)] = Field(description="of the robot and of its folder of results")
    urdf: Annotated[str, BeforeValidator(_file)] = Field(description="file of the robot: URDF or MJCF")
    recordings: Annotated[list[str] | str, BeforeValidator(_files)] = Field(description="file, or list of files")
    mapping: Annotated[str, BeforeValidator(_file)] | None = Field(
        None, description="YAML file with column names and units of these recordings"
    )
    options: Options | None = Field(
        None, description="options of 'torchrbd identify' for this robot; they win over those of all"
    )


class RobotsFile(Keys):
    """The robots of a fleet."""

    missing: ClassVar[dict[str, str]] = {
        "robots": "expected 'robots:' and a list of robots, each with name, urdf and recordings"
    }
    options: Options | None = Field(None, description="options of 'torchrbd identify' for all robots")
    robots: Annotated[list[RobotInFile], BeforeValidator(_robots)] = Field(description="the robots")


def read_robots(path: Path) -> tuple[RobotEntry, ...]:
    """Read a file of robots.

    Raises:
        OptionError: it cannot be read, or says something else; the message has the line, the robot and the key.
    """
    content = read_yaml(path, "cannot be read ({reason}); give a file that lists robots", OptionError, largest=_LARGEST)
    found = checked(RobotsFile, content, path, OptionError, lambda loc: _place(content, loc))
    shared = {} if found.options is None else read_options(content["options"], str(path))
    entries = tuple(_entry(one, k, shared, content, path) for k, one in enumerate(found.robots))
    seen: set[str] = set()
    for k, one in enumerate(entries):
        if one.name.casefold() in seen:
            line = line_of(content, ("robots", k, "name"))
            raise OptionError(
                f"{path}: line {line}: two robots are called '{one.name}'; results are named after them, rename one"
            )
        seen.add(one.name.casefold())
    return entries


def _place(content: Any, loc: Loc) -> str:
    """Return words for where something is: the robot by number and name, then the key."""
    if len(loc) < 2 or loc[0] != "robots":
        return ".".join(map(str, loc))
    robot = content["robots"][loc[1]]
    named = isinstance(robot, dict) and robot.get("name")
    words = f"robot {loc[1] + 1}" + (f", '{named}'" if named else "")
    key = ".".join(map(str, loc[2:]))
    return words if key in ("", "name") else f"{words}: {key}"


def _entry(one: RobotInFile, k: int, shared: Mapping[str, Any], content: Any, path: Path) -> RobotEntry:
    place, folder = f"{path}: {_place(content, ('robots', k))}", path.absolute().parent
    options = dict(shared)
    if one.options is not None:
        options |= read_options(content["robots"][k]["options"], place)
    if one.mapping is not None:
        options["mapping"] = folder / one.mapping
    estimator = Settings.from_mapping(options, place).estimator
    if estimator not in WITH_INTERVALS:
        raise OptionError(
            f"{place}: estimator '{estimator}' has no intervals, which a comparison of robots needs; take one of "
            f"{', '.join(WITH_INTERVALS)}"
        )
    return RobotEntry(one.name, folder / one.urdf, tuple(folder / file for file in one.recordings), options)
