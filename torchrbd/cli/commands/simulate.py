"""``torchrbd simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from torchrbd.cli.parameters import Cutoff, Gravity, MappingFile, Quiet, Recording, examples, file, value

AFTER = "\n\n".join(
    (
        examples(
            "torchrbd simulate out monday.csv -o simulated.parquet",
            "torchrbd simulate arm.urdf monday.csv --from 12 --seconds 5 -o simulated.csv",
        ),
        "Nothing keeps the motion near the recorded one, so that errors grow with\n"
        "time. Joints without a recorded torque move as recorded. Joint limits and\n"
        "contacts are left out.",
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
    mapping: MappingFile = None,
    cutoff_hz: Cutoff = None,
    gravity: Gravity = None,
    quiet: Quiet = False,
) -> None:
    """Roll a model forward from a recorded state under the recorded torque; write the motion."""
    from torchrbd.cli.simulating import simulate_recording

    simulate_recording(
        model, recording, output, start=start, seconds=seconds, rate_hz=rate, mapping=mapping, cutoff_hz=cutoff_hz,
        gravity=gravity, quiet=quiet,
    )  # fmt: skip
