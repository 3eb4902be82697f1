"""Against MuJoCo, which compiles the same URDF text: random trees, joints mapped by name."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from robot.random_robots import random_states, random_urdf

from torchrbd.robot import RobotModel

mujoco = pytest.importorskip("mujoco")


def compile_urdf(urdf: str) -> mujoco.MjModel:
    """Keep links as they are: no balanced inertias, nothing discarded, free of joint limits."""
    options = '<mujoco><compiler balanceinertia="false" discardvisual="false" fusestatic="false"/></mujoco>'
    model = mujoco.MjModel.from_xml_string(urdf.split("?>\n")[1].replace("</robot>", f"{options}</robot>"))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    return model


@pytest.mark.parametrize("seed", range(50))
def test_random_tree(seed: int) -> None:
    urdf = random_urdf(seed, 1 + seed % 10, massless=0.0)
    robot = RobotModel.from_urdf(urdf)
    model = compile_urdf(urdf)
    data = mujoco.MjData(model)
    assert model.nv == robot.n_dof
    order = [model.joint(name).dofadr[0] for name in robot.joint_names]
    q, qd, qdd = random_states(seed, robot.n_dof)
    data.qpos[order], data.qvel[order], data.qacc[order] = q, qd, qdd
    mujoco.mj_inverse(model, data)
    states = [torch.from_numpy(x) for x in (q, qd, qdd)]
    tau = robot.inverse_dynamics(*states).numpy()
    np.testing.assert_allclose(tau, data.qfrc_inverse[order], rtol=0, atol=1e-10 * np.abs(tau).max())
    full = np.zeros((model.nv, model.nv))
    for row, unit in zip(full, np.eye(model.nv), strict=True):  # symmetric: its rows are its columns
        mujoco.mj_mulM(model, data, row, unit)
    M = robot.mass_matrix(states[0]).numpy()
    np.testing.assert_allclose(M, full[np.ix_(order, order)], rtol=0, atol=1e-10 * np.abs(M).max())
