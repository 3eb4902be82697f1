"""Robots without torque: the held-out motion of a model whose drives follow the recorded set-points.

    TORCHRBD_DATA=/path/to/recordings python benchmarks/closed_loop.py

A Unitree Z1 and a Go2 recorded positions and set-points under known gains. Models are identified from ``train.csv``.
The published fits of the same recordings are replayed in the same simulator, with the delay that suits them best of 0
and 5 ms: MuJoCo's system identification has none, PACE's is 5 ms. Nothing of ``test.csv`` is fitted.

Published: armature, viscous and Coulomb friction of the joints, from
https://github.com/iit-DLSLab/simple-robot-identification-isaaclab. Those of the Go2 are of its front left leg: they are
given to all legs, and only that leg counts.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import results_file
import torch

import torchrbd
from torchrbd.effects import Site, Term, effect
from torchrbd.model import RigidBodyDynamics

CONFIGS = Path(__file__).parents[1] / "configs"
START_S = 0.5
PUBLISHED = {
    ("z1", "MuJoCo sysid"): {
        "rotor_inertia": (0.151, 0.057, 0.198, 0.010, 0.087, 0.138, 0.045),
        "viscous_friction": (4.68, 7.00, 3.49, 5.00, 4.46, 4.29, 2.38),
        "coulomb_friction": (2.16, 4.49, 2.70, 2.73, 2.67, 2.11, 5.98),
    },
    ("go2", "MuJoCo sysid"): {
        "rotor_inertia": (0.0010, 0.0197, 0.0356) * 4,
        "viscous_friction": (0.153, 0.241, 0.145) * 4,
        "coulomb_friction": (0.288, 0.174, 1.015) * 4,
    },
    ("go2", "PACE"): {
        "rotor_inertia": (0.0152, 0.0229, 0.0435) * 4,
        "viscous_friction": (0.212, 0.238, 0.235) * 4,
        "coulomb_friction": (0.293, 0.216, 0.908) * 4,
    },
}
DELAYS_S = (0.0, 0.005)
COUNTED = {"z1": "", "go2": "FL_"}
# Of friction's sign change in the published fits, which have none [rad/s].
WIDTH = 0.005


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=["z1", "go2"])
    data = Path(os.environ["TORCHRBD_DATA"])
    rows = {}
    for robot in parser.parse_args().robots:
        rows |= {f"{robot}: {name}": row for name, row in compared(data / robot).items()}
        print(*rows.items(), sep="\n")
    results_file.update("closed_loop", "python benchmarks/closed_loop.py", rows)


def compared(folder: Path) -> dict[str, dict[str, object]]:
    """Return the errors of the identified and of the published models by name."""
    mapping = CONFIGS / f"mapping_unitree_{folder.name}.yaml"
    began = time.process_time()
    found = torchrbd.identify(folder / "robot.xml", folder / "train.csv", holdout=folder / "test.csv", mapping=mapping)
    seconds = time.process_time() - began
    rows: dict[str, dict[str, object]] = {"torchrbd identify": replayed(found.model, folder, mapping)}
    rows["torchrbd identify"] |= {"processor_s": round(seconds), "nmse": round(found.fits["extended"].mean_nmse, 4)}
    rows["URDF"] = replayed(RigidBodyDynamics.from_urdf(folder / "robot.xml"), folder, mapping)
    for (robot, name), values in PUBLISHED.items():
        if robot == folder.name:
            model = published(found.model, values)
            own = [replayed(model, folder, with_delay(mapping, d)) | {"delay_s": d} for d in DELAYS_S]
            rows[name] = min(own, key=lambda row: float(str(row["rms_mrad"])))
    return rows


def published(like: RigidBodyDynamics, values: dict[str, tuple[float, ...]]) -> RigidBodyDynamics:
    """Return the URDF's rigid body with published joint parameters."""
    terms = [
        Term(effect(name), Site(j), torch.tensor([x], dtype=torch.float64), {})
        for name, sizes in values.items()
        for j, x in enumerate(sizes)
    ]
    width = torch.full((like.robot.n_dof,), WIDTH, dtype=torch.float64)
    return RigidBodyDynamics(like.robot, terms=terms, rest_width=width)


def with_delay(mapping: Path, delay_s: float) -> str:
    """Return the text of a mapping with a delay of the set-points."""
    return f"set_point_delay: {delay_s}\n{mapping.read_text()}"


def replayed(model: RigidBodyDynamics, folder: Path, mapping: Path | str) -> dict[str, object]:
    """Return the error of the held-out motion: mean over the joints, and of each [mrad]."""
    with TemporaryDirectory() as place:
        if isinstance(mapping, str):
            (Path(place) / "map.yaml").write_text(mapping)
            mapping = Path(place) / "map.yaml"
        moved = torchrbd.simulate(model, folder / "test.csv", start=START_S, commands=True, mapping=mapping)
    own = [joint for joint in moved.joints if joint.startswith(COUNTED[folder.name])]
    errors = {joint: round(1e3 * moved.distance[joint], 2) for joint in own}
    tracking = [moved.tracking[joint][0] for joint in own]
    return {
        "rms_mrad": round(float(np.mean(list(errors.values()))), 2),
        "joints_mrad": errors,
        "tracking_mrad": round(1e3 * float(np.mean(tracking)), 1),
    }


if __name__ == "__main__":
    main()
