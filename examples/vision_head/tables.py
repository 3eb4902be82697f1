"""The experiment's figures for a terminal and for ``docs/vision_head.md``."""

from __future__ import annotations

from collections import Counter

import numpy as np
from rich.table import Table

from .control import LOST
from .experiment import MEASURES, TRUTH, Conditions, Results
from .methods import CLASSICAL, DEFAULT
from .motion import EYE_HZ, NECK_HZ, RECORDED_EYE_HZ

LIMIT = 0.8


def heading(conditions: Conditions) -> str:
    """Say in what the conditions differ from those of other runs."""
    effects = " and ".join(conditions.effects) or "no"
    return f"Recorded with a neck of up to {conditions.neck_hz:g} Hz, {effects} concealed effects"


def rows(results: Results, controller: str) -> list[tuple[str, ...]]:
    """Return one row per method: error mean and spread over seeds per measure, median excess per measure, failures."""
    excess, found = results.excess(controller), []
    for m, name in enumerate(results.names):
        errors, why = results.errors[controller][:, m], [w for w in results.failures[controller][:, m] if w]
        cells = [name]
        for k in range(len(MEASURES)):
            own = errors[~np.isnan(errors[:, k]), k]
            cells.append(f"{own.mean():.2g} ± {own.std():.1g}" if len(own) else "failure")
        cells += ["" if name == TRUTH else _number(value) for value in excess[m]]
        reasons = "; ".join(f"{n} {w}" for w, n in Counter(why).most_common())
        found.append((*cells, f"{len(why)} of {len(errors)}" + (f" ({reasons})" if why else "")))
    return found


def columns() -> list[str]:
    """Return the headings of ``rows``."""
    return [
        "parameters",
        *(f"{name} [{unit}]" for name, unit in MEASURES.items()),
        *(f"excess {name}" for name in MEASURES),
        "failures",
    ]


def ratios(results: Results) -> list[tuple[str, str, str, str, str]]:
    """Return per controller and measure the best classical method and the default's excess in parts of its."""
    found = []
    for controller in results.errors:
        own = results.excess(controller)[results.names.index(DEFAULT)]
        names, best = results.best_classical(controller)
        for k, (measure, unit) in enumerate(MEASURES.items()):
            ratio = results.ratio(controller)[k]
            found.append(
                (controller, f"{measure} [{unit}]", f"{_number(best[k])} ({names[k]})", _number(own[k]), f"{ratio:.2f}")
            )
    return found


RATIO_COLUMNS = ["controller", "measure", "best classical method's excess", f"{DEFAULT}'s excess", "ratio"]


def verdict(results: Results) -> str:
    """Say whether the default keeps the limit, and whether it ever failed."""
    worst = max(float(results.ratio(controller).max()) for controller in results.errors)
    m = results.names.index(DEFAULT)
    failures = sum(bool(why) for table in results.failures.values() for why in table[:, m])
    n_runs = sum(len(table) for table in results.failures.values())
    kept = "at most" if worst <= LIMIT else "above"
    return (
        f"Largest of the nine ratios: {worst:.2f}, {kept} the {LIMIT} that is asked for. "
        f"{DEFAULT} failed in {failures} of {n_runs} runs."
    )


def rich_table(title: str, heads: list[str], body: list[tuple[str, ...]]) -> Table:
    """Return a table for the terminal."""
    table = Table(*heads, title=title)
    for row in body:
        table.add_row(*row)
    return table


def page(command: str, runs: list[tuple[Conditions, Results]]) -> str:
    """Return ``docs/vision_head.md``."""
    conditions, results = runs[0]
    n_seeds = len(next(iter(results.errors.values())))
    introduction = _INTRODUCTION.format(
        command=command,
        seeds=n_seeds,
        encoder=conditions.noise.encoder,
        torque=100 * conditions.noise.torque,
        control=conditions.control_noise,
        recorded=conditions.recorded_s,
        controlled=conditions.controlled_s,
        eye=RECORDED_EYE_HZ,
        neck_test=NECK_HZ,
        eye_test=EYE_HZ,
        lost=LOST,
        classical=", ".join(CLASSICAL),
        default=DEFAULT,
    )
    parts = [introduction.rstrip()]
    for own, found in runs:
        parts += [f"## {heading(own)}", verdict(found), _markdown(RATIO_COLUMNS, ratios(found))]
        for controller in found.errors:
            parts += [f"### {controller.capitalize()}", _markdown(columns(), rows(found, controller))]
    return "\n\n".join(parts) + "\n"


def _markdown(heads: list[str], body: list[tuple[str, ...]]) -> str:
    lines = [heads, ["---"] * len(heads), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _number(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "failure"


_INTRODUCTION = """# The vision head: parameters put to use

The experiment of Ting, Mistry, Peters, Schaal, Nakanishi, "A Bayesian Approach to Nonlinear Parameter Identification
for Rigid Body Dynamics" (RSS 2006), rebuilt: a head with seven joints, a neck of three and two eyes of two each, is
identified with every method, and three controllers then use the parameters on motions that were not recorded.

```
{command}
```

- **Robot.** MuJoCo moves it (`examples/vision_head/robot.py`). On each of {seeds} seeds its inertials are drawn around
  those of `head.urdf`, about 30 % off and physical. The methods get the URDF; its kinematics and viscous friction are
  right.
- **Recording.** {recorded:g} s at 500 Hz under a PD controller of low gain: encoder positions with {encoder:g} rad of
  white noise, motor torques with {torque:g} % of each joint's RMS, and the set-points. No velocity is measured. The
  eyes move at up to {eye:g} Hz, the neck calmly, as heads do: one cut-off has to suit all joints, so that what is
  differentiated from the neck's positions is noisy against its motion.
- **Methods.** The classical ones see the same filtered moments and are used as they come out, without regard to what is
  physical: {classical}.
  "{default}" is `torchrbd.identify` without any option.
- **Control.** Two motions of {controlled:g} s, a sum of sines (neck up to {neck_test:g} Hz, eyes up to {eye_test:g} Hz)
  and gaze shifts, with {control:g} rad of encoder noise: noise adds as much to the error of every method and hides what
  the parameters cause. Gains were fixed before any method was compared (`examples/vision_head/control.py`). The URDF's
  friction is compensated for all alike, concealed effects for none.
- **Figures.** RMS over both motions, all joints and time; mean and standard deviation over the seeds without failure.
  A failure is a mass matrix that is not positive definite (where the controller uses one), an error above {lost:g} rad,
  or no estimate. *Excess* is the error beyond that of the same controller with the true parameters, paired by seed,
  median over the seeds; a failure counts as infinite. The best classical method is chosen on the outcome, for each
  controller and measure anew.
"""
