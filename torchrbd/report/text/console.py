"""What the command line says around its tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torchrbd.excitation.conditioning import ConditionNumbers
from torchrbd.report.text.numbers import number
from torchrbd.simulation import ClosedLoop

PHYSICAL = (
    "physical? says whether every link has a mass and an inertia that a real body can have. If not, the nearest "
    "physical parameters are used; 'identify --estimator' writes these. * is within 1 % of the least error."
)
"""Of a comparison of estimators."""
FAVOURED = (
    "All are judged on torques predicted from filtered, noisy positions. This favours estimates that the noise "
    "biases: 'smoother' may be better than it looks here."
)
"""Of a comparison of estimators where position noise matters."""
LACKING = "What the file lacks, or has otherwise:"
"""Before what an exported file does not hold."""
MAPPING_HINT = "'-o mapping.yaml' writes a mapping with what the names of the columns suggest"
"""After a problem that a mapping may solve."""
AS_RECORDED = "moved as recorded: no torque"
"""Of a joint that is not simulated."""


def measure_words(held_out: str, cutoff_hz: float) -> str:
    """Say what errors are of, before a table of them."""
    return (
        f"NMSE on held-out data ({held_out}), torque and features band-limited at {cutoff_hz:.3g} Hz; 0 is perfect, 1 "
        "is no better than a constant:"
    )


def closed_loop_words(loop: ClosedLoop) -> str:
    """Say what is simulated under set-points, and what the errors are of."""
    where = "held-out data" if loop.held_out else "all data, as nothing is held out"
    return (
        f"Simulation under the recorded set-points, {loop.seconds:.3g} s of {where}: root mean square distance from "
        "the recorded positions. The tracking error is that of the robot, set-point minus position."
    )


def combinations_words(count: int, condition: float) -> str:
    """Say how many combinations of parameters data identifies, and how unequally."""
    return (
        f"The data identifies {count} combinations of parameters. The noise of the worst is {condition:.3g} times that "
        "of the best (condition number)."
    )


def estimator_words(name: str, note: str, *, failed: bool) -> str:
    """Say what is to be known of an estimator."""
    return f"{name} is left out: {note}" if failed else f"{name}: {note}"


def check_words(samples: int, cutoff_hz: float) -> str:
    """Say what is compared, before a table of how far an exported file and its model are apart."""
    return (
        f"The file in MuJoCo against the model, RMS torque over {samples} states, motion band-limited at "
        f"{cutoff_hz:.3g} Hz:"
    )


def simulated_words(start_s: float, end_s: float) -> str:
    """Say what was simulated, before a table of distances."""
    return (
        f"Simulated from {start_s:.4g} to {end_s:.4g} s of the recording; root mean square distance from the recorded "
        "position:"
    )


def motion_words(periods: int, period_s: float, rate_hz: float) -> str:
    """Say how long a designed motion is."""
    return f"{periods} times {period_s:.4g} s, {rate_hz:g} samples a second, from rest to rest"


def condition_words(found: ConditionNumbers) -> str:
    """Say the condition numbers of a designed motion."""
    one = found.base_parameters == 1
    parameters = "one base parameter" if one else f"{found.base_parameters} base parameters"
    return (
        f"condition number of the regressor of {parameters}: {number(found.scaled)} (columns scaled to unit RMS), "
        f"{number(found.unscaled)} (SI units), {number(found.with_friction)} with friction (scaled)"
    )


def clearance_words(clearance: float) -> str:
    """Say how far links keep from the ends of their box."""
    return f"links' origins keep {1e3 * clearance:.3g} mm from the ends of the box"


def ends_words(start: Mapping[str, float]) -> str:
    """Say where a designed motion begins and ends."""
    return f"begins and ends at {', '.join(f'{joint} {x:.4g}' for joint, x in start.items())}"


def wrote(what: object, where: Path | str = "") -> str:
    """Say what was written."""
    return f"wrote {what} to {where}" if where else f"wrote {what}"


def wrote_fleet(output: Path) -> str:
    """Say what was written of a fleet."""
    return f"{wrote('fleet.json and fleet.html', output)}, and what was identified to {output}/<robot>"


def not_begun(count: int, of: int) -> str:
    """Say how many recordings an early end has left."""
    return f"unfinished: {count} of {of} recordings were not begun; identify them in another call"


def wrote_statistics(files: int, output: Path, merged: Path | None) -> str:
    """Say what was written of the moments of recordings."""
    written = "1 statistics file" if files == 1 else f"{files} statistics files"
    return wrote(written, output) + (f", and their sum to {merged}" if merged else "")


def wrote_sum(output: Path, recordings: int, hours: float, blocks: int) -> str:
    """Say what a sum of moments holds."""
    return f"{wrote(output)}: {recordings} recordings, {hours:.3g} hours, in {blocks} blocks"


def more_words(count: int, file: str) -> str:
    """Say how many further rows a table would have, and where they are."""
    return f"{count} more in {file}"
