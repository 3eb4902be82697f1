"""False alarms: of how many fleets of equal robots one is told to differ.

    OMP_NUM_THREADS=1 python benchmarks/fleet_alarms.py [--fleets 300] [--robots 6 8 12 30] [--scatter 0 0.1]

Robots of three joints as they would be identified, with errors of 1 % of a parameter's size, give or take a half to
double; with a scatter, true parameters differ by so much from robot to robot. Intervals are those at 95 % of a
proportion (Wilson). Needs the test extra.
"""

from __future__ import annotations

import argparse
import time

import import_paths  # noqa: F401
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest
from simulated_fleet import fleet

from torchrbd.fleet.sisters import LEVEL, deviations


def alarms(n: int, scatter: float, fleets: int) -> int:
    """Return in how many fleets of n robots one is told to differ."""
    return sum(any(deviations(fleet(n, seed, scatter)).values()) for seed in range(fleets))


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--fleets", type=int, default=300, metavar="N", help="of each kind; seeds 0 to N - 1")
    options.add_argument("--robots", type=int, nargs="+", default=[6, 8, 12, 30], metavar="N")
    options.add_argument("--scatter", type=float, nargs="+", default=[0.0, 0.1], metavar="PART")
    given = options.parse_args()
    start, table = time.perf_counter(), Table("robots", "scatter", "fleets with an alarm", "%", "95 %")
    for scatter in given.scatter:
        for n in given.robots:
            found = alarms(n, scatter, given.fleets)
            low, high = binomtest(found, given.fleets).proportion_ci(method="wilson")
            table.add_row(
                f"{n}", f"{scatter:g}", f"{found} of {given.fleets}", f"{100 * found / given.fleets:.1f}",
                f"{100 * low:.1f} to {100 * high:.1f}",
            )  # fmt: skip
    console = Console()
    console.print(table)
    console.print(f"set to {100 * LEVEL:g} %; {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
