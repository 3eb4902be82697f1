"""Is log evidence what it says? Where nothing is left out, evidence above x must be as rare as e^-x.

    python benchmarks/null_evidence.py -o null_evidence.json [--count 200] [--seconds 30] [--rate 125] [--seed 0] [-j 2]
    python benchmarks/null_evidence.py --only 35 39 [--seconds 30] [--rate 125] [--seed 0]
    python benchmarks/null_evidence.py --plot docs/images/null_evidence.png FILE...

Robots with ordinary friction, inertials off by 20 %, coloured torque noise, drift and 15-bit encoders move along
set-points that never repeat, without any other effect; torques are Pinocchio's. Of a likelihood ratio B that is right,
P(B > k) <= 1 / k under the hypothesis that it argues against (Markov): of all hypotheses that were ranked, a part of
e^-x at most may have a log evidence above x. Prints that part beside e^-x.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from rich.progress import track

sys.path.insert(0, str(Path(__file__).parent.parent))

from benchmarks.concealed.raw.arms import draw_arm, with_wrong_inertials
from benchmarks.concealed.raw.cases import draw_friction
from benchmarks.concealed.raw.motion import draw_way
from benchmarks.concealed.raw.sensing import RATE_HZ, Sensors, recording
from benchmarks.concealed.workers import workers

LEVELS = (0, 1, 2, 3, 4, 5, 6, 8, 10)
# A run-in and a run-out that differentiated set-points would begin and end with a jerk in.
_EDGE_S = 1.0


def ranked(seed: int, index: int, seconds: float, rate_hz: float) -> dict[str, Any]:
    """Simulate one recording, rank all hypotheses, and return those with evidence and how many were considered."""
    from torchrbd.diagnosis.ranking import rank_hypotheses

    rng = np.random.default_rng([seed, index, int(rate_hz)])
    robot = draw_arm(rng, "development")
    way = draw_way(rng, robot, seconds + 2 * _EDGE_S, rate_hz)
    inside = (way.t >= _EDGE_S) & (way.t < seconds + _EDGE_S)
    way = replace(way, **{name: getattr(way, name)[inside] for name in ("t", "q", "v", "a")})
    friction = draw_friction(rng, robot, way.q, way.v, way.a)
    tau = robot.torque(way.q, way.v, way.a) + friction.torque(way.v)
    sensors = Sensors.draw(rng, tau)
    sensors = replace(sensors, colour_s=sensors.colour_s * rate_hz / RATE_HZ)
    table = recording(robot.joints, way.t - way.t[0], way.q, sensors.torque(rng, way.t, tau))
    with TemporaryDirectory() as folder:
        urdf, file = Path(folder) / "robot.urdf", Path(folder) / "null.parquet"
        urdf.write_text(with_wrong_inertials(rng, robot, 0.2).urdf)
        pq.write_table(table, file)
        found = rank_hypotheses(urdf, file)
    first = [(h.effect, [*h.joints, *h.links], h.log_evidence) for h in found.first]
    return {"robot": robot.name, "considered": found.considered, "first": first, "adopted": len(found.adopted)}


def shares(nulls: list[dict[str, Any]]) -> dict[float, float]:
    """Return which part of all hypotheses has a log evidence above each level."""
    tried = sum(n["considered"] for n in nulls)
    every = np.array([e for n in nulls for *_, e in n["first"]])
    return {x: float((every > x).sum()) / tried for x in LEVELS}


def report(content: dict[str, Any]) -> None:
    """Print the table of one run."""
    nulls = content["nulls"]
    tops = sorted((n["first"][0][2] for n in nulls), reverse=True)
    print(f"{len(nulls)} nulls of {content['seconds']:g} s at {content['rate_hz']:g} Hz, ", end="")
    print(f"{sum(n['considered'] for n in nulls)} hypotheses; greatest {', '.join(f'{t:.1f}' for t in tops[:5])}")
    print(f"recordings with an adopted effect: {sum(n['adopted'] > 0 for n in nulls)}")
    print("| x | part above x | e^-x | ratio |\n| --- | --- | --- | --- |")
    for x, part in shares(nulls).items():
        print(f"| {x} | {part:.2e} | {np.exp(-x):.2e} | {part / np.exp(-x):.2f} |")


def plot(files: list[Path], out: Path) -> None:
    """Draw the part of hypotheses above each log evidence beside the bound."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    x = np.linspace(0, 12, 200)
    for file in files:
        content = json.loads(file.read_text())
        every = np.array([e for n in content["nulls"] for *_, e in n["first"]])
        tried = sum(n["considered"] for n in content["nulls"])
        above = [(every > level).sum() / tried for level in x]
        axes.semilogy(x, above, label=f"{content['seconds']:g} s at {content['rate_hz']:g} Hz")
    axes.semilogy(x, np.exp(-x), "k--", label="bound, exp(-x)")
    axes.semilogy(x, 3 * np.exp(-x), "k:", label="three times that")
    axes.set(xlabel="log evidence x [nats]", ylabel="part of hypotheses above x", ylim=(1e-6, 1))
    axes.legend()
    figure.savefig(out, dpi=120)


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="of earlier runs, to plot")
    parser.add_argument("-o", "--output", type=Path, help="file to write")
    parser.add_argument("--plot", type=Path, help="picture to write")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--only", type=int, nargs="+", metavar="INDEX", help="of nulls, instead of the first so many")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--rate", type=float, default=125.0, help="[Hz]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-j", "--jobs", type=int, default=1, help="processes")
    args = parser.parse_args()
    if args.plot:
        plot(args.files, args.plot)
        return
    with workers(args.jobs) as pool:
        jobs = [pool.submit(ranked, args.seed, k, args.seconds, args.rate) for k in args.only or range(args.count)]
        nulls = [job.result() for job in track(jobs, "nulls")]
    content = {"seconds": args.seconds, "rate_hz": args.rate, "seed": args.seed, "nulls": nulls}
    if args.output:
        args.output.write_text(json.dumps(content, indent=1))
    report(content)


if __name__ == "__main__":
    main()
