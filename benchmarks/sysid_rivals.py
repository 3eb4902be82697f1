"""Head to head with MuJoCo's system identification, on robots that recorded set-points and no torque.

    TORCHRBD_DATA=/path/to/recordings python benchmarks/sysid_rivals.py

Both get the same recordings of a Unitree Z1 and a Go2, the same gains and the same free parameters: armature, viscous
and Coulomb friction of each joint; inertias are the URDF's (``trust``). mujoco.sysid fits rolled-out motions by
nonlinear least squares, torchrbd torques by regression. The held-out motion of both is replayed in one simulator,
torchrbd's, and the processor time of both is measured in one run. In the last row of torchrbd inertias and offsets are
free, too.

Needs ``pip install 'mujoco[sysid]'``.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping
from pathlib import Path

import closed_loop
import mujoco
import numpy as np
import results_file
from mujoco import sysid

import torchrbd
from torchrbd.model import RigidBodyDynamics
from torchrbd.recordings import Recording, open_recording, read_mapping

# Attribute of MuJoCo's joint, the effect, first value and upper bound; the lower one is zero.
FREE = {
    "armature": ("rotor_inertia", 0.02, 1.0),
    "damping": ("viscous_friction", 0.5, 20.0),
    "frictionloss": ("coulomb_friction", 0.5, 20.0),
}
STEP_S, START_S = 0.005, 0.5
# Its simulation holds a set-point for a step: the best of these delays is its.
DELAYS_S = (0.0, 0.0025, 0.005)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=["go2", "z1"])
    data, rows = Path(os.environ["TORCHRBD_DATA"]), {}
    for robot in parser.parse_args().robots:
        rows |= {f"{robot}: {name}": row for name, row in compared(data / robot).items()}
        print(*rows.items(), sep="\n")
    results_file.update("sysid_rivals", "python benchmarks/sysid_rivals.py", rows)


def compared(folder: Path) -> dict[str, dict[str, object]]:
    """Return held-out errors and processor time of each by name."""
    mapping = closed_loop.CONFIGS / f"mapping_unitree_{folder.name}.yaml"
    urdf = RigidBodyDynamics.from_urdf(folder / "robot.xml")
    closed_loop.COUNTED[folder.name] = ""
    rows = {}
    same = {"trust": urdf.robot.body_names, "exclude": ["torque_offset"]}
    for name, options in (("torchrbd, same parameters", same), ("torchrbd", {})):
        began = time.process_time()
        options = options | {"holdout": folder / "test.csv", "mapping": mapping}
        found = torchrbd.identify(folder / "robot.xml", folder / "train.csv", **options)
        rows[name] = {"processor_s": round(time.process_time() - began)}
        rows[name] |= closed_loop.replayed(found.model, folder, mapping)
    opened = open_recording(folder / "train.csv", urdf.robot.joint_names, mapping=read_mapping(mapping))
    began = time.process_time()
    values = fitted(urdf, opened)
    seconds, model = round(time.process_time() - began), closed_loop.published(urdf, values)
    own = [closed_loop.replayed(model, folder, closed_loop.with_delay(mapping, d)) | {"delay_s": d} for d in DELAYS_S]
    rows["mujoco.sysid"] = {"processor_s": seconds} | min(own, key=lambda row: float(str(row["rms_mrad"])))
    rows["mujoco.sysid"] |= {"values": {name: [round(x, 4) for x in each] for name, each in values.items()}}
    return rows


def fitted(urdf: RigidBodyDynamics, recording: Recording) -> Mapping[str, tuple[float, ...]]:
    """Return what mujoco.sysid fits, by effect, a value a joint."""
    names = urdf.robot.joint_names
    spec = mujoco.MjSpec.from_string(torchrbd.to_mjcf(RigidBodyDynamics(urdf.robot, drives=recording.drives)).decode())
    spec.option.timestep = STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for name in names:
        spec.add_sensor(
            name=f"{name}_q", type=mujoco.mjtSensor.mjSENS_JOINTPOS, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name
        )
    chunks = list(recording.chunks())
    t, q, wanted = (np.concatenate([getattr(c, key) for c in chunks]) for key in ("t", "q", "q_ref"))
    speed = np.gradient(q, t, axis=0)
    keep = t >= START_S
    model = spec.compile()
    joints = [names.index(model.joint(k).name) for k in np.argsort(model.jnt_qposadr)]
    order = [names.index(model.actuator(k).name) for k in range(model.nu)]
    state = sysid.create_initial_state(model, q[keep][0][joints], speed[keep][0][joints])
    controls = sysid.TimeSeries.compute_all_control_mapping(model)
    control = sysid.TimeSeries(t[keep] - t[keep][0], wanted[keep][:, order], controls)
    measured = sysid.TimeSeries(t[keep] - t[keep][0], q[keep], sysid.TimeSeries.compute_all_sensor_mapping(model))
    sequences = [sysid.ModelSequences("robot", spec, "train", state, control, measured)]
    free = sysid.ParameterDict()
    for attribute, (_, first, most) in FREE.items():
        for name in names:
            free.add(sysid.Parameter(f"{name}_{attribute}", first, 0.0, most, modifier=_setter(name, attribute)))
    found, _ = sysid.optimize(free, sysid.build_residual_fn(models_sequences=sequences), verbose=False)
    return {
        effect: tuple(float(found[f"{name}_{attribute}"].value[0]) for name in names)
        for attribute, (effect, _, _) in FREE.items()
    }


def _setter(joint: str, attribute: str):
    """Return what writes a parameter into a joint."""

    def write(spec, parameter) -> None:
        value = float(parameter.value[0])
        current = getattr(spec.joint(joint), attribute)
        if np.ndim(current):
            current[0] = value
        else:
            setattr(spec.joint(joint), attribute, value)

    return write


if __name__ == "__main__":
    main()
