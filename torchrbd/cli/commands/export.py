"""``torchrbd export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from torchrbd.cli.parameters import Cutoff, MappingFile, examples, file, value, values

AFTER = examples(
    "torchrbd export out --to urdf",
    "torchrbd export out --to mjcf -o arm.xml --check monday.csv",
    "torchrbd export out --to mjcf --samples 50 -o robots",
    "torchrbd export out --to isaaclab -o actuators.py",
)


def export(
    model: Annotated[Path, file("MODEL", "model.safetensors, or the folder that 'identify' or 'diagnose' wrote")],
    /,
    *,
    to: Annotated[
        Literal["urdf", "mjcf", "isaaclab"], value("FORMAT", "mjcf is MuJoCo's own, isaaclab a configuration of drives")
    ],
    output: Annotated[
        Path | None,
        value(
            "FILE", "file to write, with --samples a folder", short="o", default="model.urdf, .xml, .py next to MODEL"
        ),
    ] = None,
    samples: Annotated[
        int | None, value("N", "write N robots drawn from the posterior, for domain randomization", default="the mean")
    ] = None,
    seed: Annotated[int, value("N", "of the samples", default="0")] = 0,
    check: Annotated[
        list[Path] | None,
        values("RECORDING", "compare torques of the file in MuJoCo and of the model on these recordings"),
    ] = None,
    mapping: MappingFile = None,
    cutoff_hz: Cutoff = None,
) -> None:
    """Write a fitted model as a file for a simulator, and report what that file cannot hold."""
    from torchrbd.cli.exporting import export as work

    work(model, to, output, check or [], mapping, cutoff_hz, samples, seed)
