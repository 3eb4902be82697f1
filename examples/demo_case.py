"""Record the bundled demo case: a MuJoCo robot with an effect that its URDF does not hold.

The recorded robot is the arm of ``torchrbd/demo/arm.urdf`` with link inertials off by up to 10 % and one concealed
effect at one joint. A computed-torque controller moves it along smooth trajectories that never repeat. What an engineer
would get is written: ``fit.parquet`` and ``holdout.parquet`` with time, encoder positions and motor torques.
``truth.json`` holds what was concealed; only tests read it. Needs MuJoCo: ``pip install torchrbd[examples]``.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no type stubs)

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

DEMO = Path(__file__).resolve().parents[1] / "torchrbd" / "demo"
DURATIONS = {"fit": 40.0, "holdout": 20.0}  # s
STEP = 0.0005  # s; the controller runs at every step
LOG_EVERY = 8  # steps: 250 Hz
ENCODER_LSB = 2 * np.pi / 2**17  # rad
TORQUE_DECIMALS = 3  # 1 mN m
TORQUE_NOISE = 0.01  # of each joint's torque RMS
KP, KD = 2500.0, 100.0  # 1/s^2, 1/s: critically damped tracking error, stiff enough that friction hardly makes it stick
EFFECTS = {  # effect -> MuJoCo's array of it, and its unit
    "coulomb_friction": ("dof_frictionloss", "N m"),
    "viscous_friction": ("dof_damping", "N m s/rad"),
    "rotor_inertia": ("dof_armature", "kg m^2"),
    "joint_spring": ("jnt_stiffness", "N m/rad"),
}


@dataclass(frozen=True)
class Trajectory:
    """A sum of sines per joint: ``q(t) = centre + sum_k amplitude_k sin(omega_k t + phase_k)``; arrays are (n, k)."""

    centre: np.ndarray
    amplitude: np.ndarray
    omega: np.ndarray
    phase: np.ndarray

    def __call__(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return q, qd and qdd at time ``t`` [s], (n,) each."""
        angle = self.omega * t + self.phase
        sin, cos = self.amplitude * np.sin(angle), self.amplitude * np.cos(angle)
        return self.centre + sin.sum(1), (self.omega * cos).sum(1), -(self.omega**2 * sin).sum(1)


def draw_trajectory(rng: np.random.Generator, n: int, n_sines: int = 6) -> Trajectory:
    """Draw frequencies from 0.06 to 0.6 Hz without a common period; high ones are small, so speeds stay within limits.

    The bounds on each joint's excursion keep the wrist above the floor and the joints inside their limits.
    """
    excursion = np.resize([2.0, 1.3, 1.9, 2.4, 1.9, 2.4], n)  # rad
    omega = 2 * np.pi * np.geomspace(0.06, 0.6, n_sines) * rng.uniform(0.85, 1.15, (n, n_sines))
    amplitude = rng.uniform(0.5, 1.0, (n, n_sines)) / np.sqrt(omega)
    amplitude *= (excursion / amplitude.sum(1))[:, None]
    centre = np.resize([0.0, 0.1, 0.4, 0.0, 0.2, 0.0], n)  # rad; bent, so that gravity loads the elbow
    return Trajectory(centre, amplitude, omega, rng.uniform(0, 2 * np.pi, (n, n_sines)))


def load(urdf: Path) -> mujoco.MjModel:
    """Read a URDF as a MuJoCo model that adds no physics of its own but the time step."""
    model = mujoco.MjModel.from_xml_path(str(urdf))
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # As hard as the step allows: friction is then c sign(qd) except within a few mrad/s of a reversal.
    model.dof_solref[:] = [2 * STEP, 1.0]
    model.dof_solimp[:] = [0.999, 0.999, 0.001, 0.5, 2.0]
    return model


def conceal(model: mujoco.MjModel, rng: np.random.Generator, effect: str, joint: str, value: float) -> None:
    """Change the robot behind the URDF's back: inertials by up to 10 %, each still a possible body, and one effect."""
    scale = rng.uniform(0.9, 1.1, model.nbody)
    model.body_mass *= scale
    # One factor for all three principal moments keeps a body that can exist.
    model.body_inertia *= (scale * rng.uniform(0.95, 1.05, model.nbody))[:, None]
    model.body_ipos += 0.1 * np.linalg.norm(model.body_ipos, axis=1)[:, None] * rng.uniform(-1.0, 1.0, (model.nbody, 3))
    getattr(model, EFFECTS[effect][0])[model.joint(joint).id] = value
    mujoco.mj_setConst(model, mujoco.MjData(model))


def simulate(robot: mujoco.MjModel, urdf: mujoco.MjModel, move: Trajectory, seconds: float) -> dict[str, np.ndarray]:
    """Move ``robot`` by computed torque ``tau = ID_urdf(q, qd, qdd_ref + KP e + KD de/dt)`` along ``move``.

    Returns:
        t (N,) [s] and q, qd, qdd, tau (N, n): the exact states and the motors' torques at the logging rate.
    """
    data, control = mujoco.MjData(robot), mujoco.MjData(urdf)
    data.qpos, data.qvel, _ = move(0.0)
    log: dict[str, list[np.ndarray]] = {"q": [], "qd": [], "qdd": [], "tau": []}
    steps = round(seconds / STEP)
    for k in range(steps):
        q, qd, qdd = move(k * STEP)
        control.qpos, control.qvel = data.qpos, data.qvel
        control.qacc = qdd + KP * (q - data.qpos) + KD * (qd - data.qvel)
        mujoco.mj_inverse(urdf, control)
        data.qfrc_applied = control.qfrc_inverse
        state = {"q": data.qpos.copy(), "qd": data.qvel.copy()}
        mujoco.mj_step(robot, data)
        if k % LOG_EVERY == 0:
            for key, x in (state | {"qdd": data.qacc, "tau": data.qfrc_applied}).items():
                log[key].append(x.copy())
    return {"t": np.arange(0, steps, LOG_EVERY) * STEP} | {key: np.array(rows) for key, rows in log.items()}


def measure(exact: dict[str, np.ndarray], joints: list[str], rng: np.random.Generator) -> pa.Table:
    """Return what sensors make of it: ``t``, encoder ``q_<joint>``, noisy quantised ``tau_<joint>``."""
    tau = exact["tau"] + TORQUE_NOISE * np.sqrt((exact["tau"] ** 2).mean(0)) * rng.standard_normal(exact["tau"].shape)
    columns = {"t": exact["t"]}
    for i, joint in enumerate(joints):
        columns[f"q_{joint}"] = np.round(exact["q"][:, i] / ENCODER_LSB) * ENCODER_LSB
        columns[f"tau_{joint}"] = np.round(tau[:, i], TORQUE_DECIMALS)
    return pa.table(columns)


def inertials(model: mujoco.MjModel) -> dict[str, list[float]]:
    """Return pi = [m, mcx, mcy, mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] about the body origin, per moving body."""
    found = {}
    for i in range(1, model.nbody):
        m, c, rotation = model.body_mass[i], model.body_ipos[i], np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[i])
        r = rotation.reshape(3, 3)
        about_origin = (r * model.body_inertia[i]) @ r.T + m * (c @ c * np.eye(3) - np.outer(c, c))
        found[model.body(i).name] = [m, *(m * c), *about_origin[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]
    return found


def record(out: Path, seed: int, effect: str, joint: str, value: float) -> None:
    """Write ``fit.parquet``, ``holdout.parquet`` and ``truth.json`` to ``out``."""
    rng = np.random.default_rng(seed)
    urdf, robot = load(DEMO / "arm.urdf"), load(DEMO / "arm.urdf")
    conceal(robot, rng, effect, joint, value)
    joints = [robot.joint(i).name for i in range(robot.njnt)]
    out.mkdir(parents=True, exist_ok=True)
    for name, seconds in DURATIONS.items():
        exact = simulate(robot, urdf, draw_trajectory(rng, robot.nv), seconds)
        table = measure(exact, joints, rng)
        pq.write_table(table, out / f"{name}.parquet", compression="zstd", compression_level=19)
    truth = {"effect": effect, "joint": joint, "value": value, "unit": EFFECTS[effect][1]}
    (out / "truth.json").write_text(json.dumps(truth | {"inertials": inertials(robot)}, indent=1) + "\n")


def main() -> None:
    """Parse the command line and record."""
    parser = argparse.ArgumentParser(description="Record the demo case in MuJoCo.")
    parser.add_argument("--out", type=Path, default=DEMO, help="folder to write to (default: the package's demo data)")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--effect", choices=EFFECTS, default="coulomb_friction")
    parser.add_argument("--joint", choices=[f"joint{i}" for i in range(1, 7)], default="joint3")
    parser.add_argument("--value", type=float, default=2.4, help="of the effect, SI unit")
    args = parser.parse_args()
    record(args.out, args.seed, args.effect, args.joint, args.value)


if __name__ == "__main__":
    main()
