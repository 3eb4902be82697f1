"""``torchrbd simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from torchrbd.cli.parameters import Cutoff, Gravity, MappingFile, Quiet, Recording, examples, file, flag, value

AFTER = "\n\n".join(
    (
        examples(
            "torchrbd simulate out monday.csv -o simulated.parquet",
            "torchrbd simulate arm.urdf monday.csv --from 12 --seconds 5 -o simulated.csv",
            "torchrbd simulate out monday.csv --commands --mapping drives.yaml -o a.csv",
        ),
        "Under a recorded torque nothing keeps the motion near the recorded one, so\n"
        "that errors grow with time. Under set-points (--commands) the drives do.\n"
        "Joints without a recorded torque move as recorded. Joint limits and contacts\n"
        "are left out.",
    )
)


def simulate(
    model: Annotated[
        Path,
        file("MODEL", "ROBOT.urdf (or MJCF), model.safetensors, or the folder that 'identify' or 'diagnose' wrote"),
    ],
    recording: Recording,
    /,
    *,
    output: Annotated[
        Path,
        value(
            "FILE",
            ".parquet, .csv or .npz with t, q_<joint>, qd_<joint>, tau_<joint>, which the other commands read",
            short="o",
        ),
    ],
    start: Annotated[float, value("S", "seconds of the recording", name="from", default=0)] = 0.0,
    seconds: Annotated[float | None, value("S", "how long", default="to the end, or to the next gap")] = None,
    rate: Annotated[float | None, value("HZ", "samples a second", default="the recording's")] = None,
    commands: Annotated[
        bool,
        flag("let drives follow the recorded set-points in place of a torque; --mapping has their gains"),
    ] = False,
    mapping: MappingFile = None,
    cutoff_hz: Cutoff = None,
    gravity: Gravity = None,
    quiet: Quiet = False,
) -> None:
    """Roll a model forward from a recorded state under the recorded torque or set-points; write the motion."""
    from torchrbd.cli.simulating import simulate_recording

    simulate_recording(
        model, recording, output, start=start, seconds=seconds, rate_hz=rate, commands=commands, mapping=mapping,
        cutoff_hz=cutoff_hz, gravity=gravity, quiet=quiet,
    )  # fmt: skip
