"""``torchrbd excite``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from torchrbd.cli.parameters import Gravity, Quiet, examples, file, value, values

AFTER = examples(
    "torchrbd excite arm.urdf -o motion.csv",
    "torchrbd excite arm.urdf -d out -o motion.csv --speed 0.5 --box z=0.05:",
)


def excite(
    robot: Annotated[Path, file("ROBOT", "the robot, with the limits that hold")],
    /,
    *,
    output: Annotated[Path, value("CSV", "t, q_, qd_, qdd_ of each joint; and a YAML file next to it", short="o")],
    diagnosis: Annotated[
        Path | None,
        value(
            "DIR",
            "folder that 'diagnose -o' wrote: separate what it could not (default: identify the parameters)",
            short="d",
        ),
    ] = None,
    frequency_hz: Annotated[
        float, value("HZ", "one over a period", name="frequency", group="Motion", default=0.1)
    ] = 0.1,
    harmonics: Annotated[int, value("N", "of the frequency in the motion", group="Motion", default=5)] = 5,
    periods: Annotated[int, value("N", "to record", group="Motion", default=3)] = 3,
    rate_hz: Annotated[float, value("HZ", "of the samples", name="rate", group="Motion", default=100)] = 100.0,
    joints: Annotated[list[str] | None, values("JOINT", "that move (default: all)", group="Motion")] = None,
    starts: Annotated[int, value("N", "of the optimiser", group="Motion", default=4)] = 4,
    seed: Annotated[int, value("N", "of these starts", group="Motion", default=0)] = 0,
    gravity: Gravity = None,
    quiet: Quiet = False,
    speed: Annotated[float, value("X", "share of the speed limits to use", group="Limits", default=1)] = 1.0,
    margin: Annotated[float, value("X", "part of every limit left free", group="Limits", default=0.1)] = 0.1,
    ranges: Annotated[
        list[str] | None,
        values("JOINT=LOW:HIGH", "in place of the URDF's; LOW = HIGH holds it", name="range", group="Limits"),
    ] = None,
    velocities: Annotated[
        list[str] | None, values("JOINT=V", "in place of the URDF's", name="velocity", group="Limits")
    ] = None,
    efforts: Annotated[
        list[str] | None, values("JOINT=TAU", "in place of the URDF's", name="effort", group="Limits")
    ] = None,
    box: Annotated[
        list[str] | None,
        values(
            "AXIS=LOW:HIGH",
            "where the origins of all links stay [m], base's axes, e.g. z=0.05: x=-0.5:0.7",
            group="Limits",
        ),
    ] = None,
) -> None:
    """Design the motion to record next: within limits, from rest to rest."""
    from torchrbd.cli.exciting import design

    named = {"ranges": ranges or [], "velocities": velocities or [], "efforts": efforts or [], "box": box or []}
    series = {"frequency_hz": frequency_hz, "harmonics": harmonics, "periods": periods, "joints": joints}
    search = {"starts": starts, "seed": seed, "gravity": gravity, "speed": speed, "margin": margin}
    design(robot, diagnosis, output, rate_hz, named, {**series, **search}, quiet)
