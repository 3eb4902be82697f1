"""How the time of a diagnosis grows with the length, the joints and the number of its recordings.

    OMP_NUM_THREADS=1 python benchmarks/growth.py [--picture growth.svg]
    OMP_NUM_THREADS=1 python benchmarks/growth.py --one 60 7 1 --rate 500
    OMP_NUM_THREADS=1 python benchmarks/growth.py --one 50 6 4 --many

Serial arms with friction at all joints and a spring at the second that their URDF lacks; noise of 2 % on the torques,
125 Hz. One of the three is changed at a time. Each case runs in a process of its own; processor seconds of
``diagnose`` alone, without imports. Prints a table with the exponents of growth and draws it, or one case alone: its
seconds, those of ``identify`` on the same recordings, the most memory [GB], and what is found. With ``--many``, fifteen
terms take the place of the spring, and of several recordings the last has a load.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
from memory import arm, smooth_motion

RATE_HZ = 125.0
LENGTHS, JOINTS, RECORDINGS = (15, 30, 60), (3, 5, 7), (1, 2, 4)
USUAL = {"seconds": 30, "joints": 5, "recordings": 1}
SERIES = {"seconds": LENGTHS, "joints": JOINTS, "recordings": RECORDINGS}
WORDS = {"seconds": "length [s]", "joints": "joints", "recordings": "recordings, each as long"}
SPRING = 0.3
"""Of the torque's scatter at its joint in the first recording, for the scatter of its position there."""
MANY = (
    (0, 0.25, lambda q, qd, qdd: np.tanh(qd / 0.01) * np.exp(-((qd / 0.3) ** 2))),
    (0, 0.2, lambda q, qd, qdd: np.ones_like(q)),
    (1, 0.25, lambda q, qd, qdd: q / q.std()),
    (1, 0.25, lambda q, qd, qdd: np.sin(15 * q)),
    (1, 0.15, lambda q, qd, qdd: np.tanh(qd / 0.01) * np.abs(np.cos(q))),
    (2, 0.25, lambda q, qd, qdd: np.sin(12 * q)),
    (2, 0.25, lambda q, qd, qdd: np.tanh(qd / 0.01) * np.exp(-((qd / 0.3) ** 2))),
    (2, 0.15, lambda q, qd, qdd: np.maximum(q - np.median(q), 0) / q.std()),
    (3, 0.25, lambda q, qd, qdd: qdd / qdd.std()),
    (3, 0.25, lambda q, qd, qdd: q / q.std()),
    (3, 0.1, lambda q, qd, qdd: np.abs(qd) * qd / qd.std() ** 2),
    (4, 0.12, lambda q, qd, qdd: np.abs(qd) * qd / qd.std() ** 2),
    (4, 0.25, lambda q, qd, qdd: np.ones_like(q)),
    (5, 0.25, lambda q, qd, qdd: np.sin(9 * q)),
    (5, 0.25, lambda q, qd, qdd: qdd / qdd.std()),
)
"""Joint, size as a part of the torque's scatter there, and course of each of fifteen terms."""
LOAD_KG = 0.5


def recorded(urdf: str, seconds: float, count: int, rate_hz: float, many: bool = False) -> list[dict[str, np.ndarray]]:
    """Return smooth random motions with noise, and torques of the robot, of friction and of what its URDF lacks."""
    import torch

    from torchrbd import RobotModel

    robot, t = RobotModel.from_urdf(urdf), np.arange(int(seconds * rate_hz)) / rate_hz
    loaded = robot.pi.clone()
    loaded.view(-1, 10)[-1, 0] += LOAD_KG
    found, scatter, stiffness = [], np.zeros(0), 0.0
    for k in range(count):
        rng = np.random.default_rng(k)
        q, qd, qdd = smooth_motion(rng, robot.n_dof)(t)
        pi = loaded if many and 0 < k == count - 1 else robot.pi
        tau = robot.inverse_dynamics(*map(torch.from_numpy, (q, qd, qdd)), pi).numpy()
        if not found:
            scatter, stiffness = tau.std(0), SPRING * tau[:, 1].std() / q[:, 1].std()
        tau = tau + scatter * (0.05 * qd + 0.1 * np.tanh(qd / 0.01) + 0.02 * rng.standard_normal(tau.shape))
        if many:
            for j, size, course in MANY:
                tau[:, j] += size * scatter[j] * course(q[:, j], qd[:, j], qdd[:, j])
        else:
            tau[:, 1] += stiffness * q[:, 1]
        found.append({"t": t, "q": q + 1e-5 * rng.standard_normal(q.shape), "tau": tau})
    return found


def spent(seconds: float, joints: int, recordings: int, rate_hz: float = RATE_HZ, many: bool = False) -> list[str]:
    """Return the processor seconds of a diagnosis and of an identification, the memory [GB], and what is found."""
    import time

    from torchrbd import diagnose, identify

    text = arm(joints)
    urdf, data = text.encode(), recorded(text, seconds, recordings, rate_hz, many)
    begin = time.process_time()
    identify(urdf, data)
    between = time.process_time()
    found = diagnose(urdf, data)
    end, most = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    told = {f.effect for f in found.findings}
    words = f"{found.verdict}, {len(found.findings)} findings{', the spring' * ('joint_spring' in told)}"
    return [f"{end - between:.1f}", f"{between - begin:.1f}", f"{most:.2f}", words]


def exponent(sizes: tuple[int, ...], seconds: list[float]) -> float:
    """Return by what power of the size the time grows."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def plot(taken: dict[str, list[float]], out: Path) -> None:
    """Draw the times over what is changed, with straight lines through the usual case."""
    import matplotlib.pyplot as plt

    plt.rcParams["svg.hashsalt"] = "torchrbd"
    figure, axes = plt.subplots(1, 3, figsize=(9, 3), sharey=True, layout="constrained")
    for one, (name, sizes) in zip(axes, SERIES.items(), strict=True):
        usual = taken[name][sizes.index(USUAL[name])]
        one.plot(sizes, taken[name], "o-", label=f"power {exponent(sizes, taken[name]):.2f}")
        one.plot((0, sizes[-1]), (0, usual * sizes[-1] / USUAL[name]), "k:", label="in proportion")
        one.set(xlabel=WORDS[name], xlim=(0, None), ylim=(0, None))
        one.legend()
    axes[0].set_ylabel("processor seconds")
    figure.savefig(out, metadata={"Date": None})


def main() -> None:
    """Run each case in its process, print the table and draw it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path, help="file to draw into, .svg or .png")
    parser.add_argument("--one", type=int, nargs=3, metavar=tuple(USUAL), help="one case alone")
    parser.add_argument("--rate", type=float, default=RATE_HZ, help="of that one [Hz]")
    parser.add_argument("--many", action="store_true", help="that one with fifteen terms; needs six joints or more")
    options = parser.parse_args()
    if options.one:
        print(*spent(*options.one, options.rate, options.many), sep="\t")
        return
    known: dict[tuple[int, ...], float] = {}
    taken: dict[str, list[float]] = {}
    for name, sizes in SERIES.items():
        for size in sizes:
            case = tuple((USUAL | {name: size}).values())
            if case not in known:
                command = [sys.executable, __file__, "--one", *map(str, case)]
                told = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip("\n")
                seconds, *_, found = told.splitlines()[-1].split("\t")
                known[case] = float(seconds)
                print(f"{dict(zip(USUAL, case, strict=True))}: {known[case]:.1f} s, {found}", flush=True)
            taken.setdefault(name, []).append(known[case])
    print("| | | | | grows as the power |\n| --- | --- | --- | --- | --- |")
    for name, sizes in SERIES.items():
        cells = " | ".join(f"{size}: {s:.1f} s" for size, s in zip(sizes, taken[name], strict=True))
        print(f"| {WORDS[name]} | {cells} | {exponent(sizes, taken[name]):.2f} |")
    if options.picture:
        plot(taken, options.picture)


if __name__ == "__main__":
    main()
