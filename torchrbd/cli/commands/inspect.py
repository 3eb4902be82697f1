"""``torchrbd inspect``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from torchrbd.cli.parameters import Recording, examples, file, value

_ROBOT = "URDF or MJCF file: its joints and limits are used. Default: the joints that the columns name"
AFTER = examples(
    "torchrbd inspect monday.csv",
    "torchrbd inspect monday.csv arm.urdf -o mapping.yaml",
)


def inspect(
    recording: Recording,
    robot: Annotated[
        Path | None,
        file("ROBOT", _ROBOT),
    ] = None,
    /,
    *,
    mapping: Annotated[Path | None, value("YAML", "column names and units as far as they are known")] = None,
    output: Annotated[Path | None, value("YAML", "mapping to write: what was found and guessed", short="o")] = None,
) -> None:
    """Report what a recording holds and what looks wrong; write a mapping to edit."""
    from torchrbd.cli.inspecting import inspect as work

    work(recording, robot, mapping, output)
