# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Your own effect in 30 lines
#
# torchrbd looks for the effects in its registry. Your robot may have another one, such as a fan or a fluid whose
# resistance grows with the cube of speed. Register it: the search, the report and the export then know it.

# %%
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch

import torchrbd
from torchrbd.effects import JointEffect, JointScale, JointState, Shape

# %% [markdown]
# ## The effect
#
# An effect is linear in its coefficients. It states the torque that it adds, its parameters with their units, and
# which values physics allows.


# %%
class CubicDrag(JointEffect):
    """tau += k qd^3 with k >= 0."""

    id = "cubic_drag"
    family = "friction"
    words = "cubic drag"
    equation = "k qd^3"
    shown_by = "Constant speeds up to the largest: torque grows with the cube of speed."
    units: ClassVar = {"drag": "{tau} s^3/{q}^3"}
    dissipative = True

    def joint_features(self, state: JointState, shape: Shape) -> dict[str, torch.Tensor]:
        return {"qd^3": state.qd**3}

    def parameters(self, coefficients: torch.Tensor, shape: Shape) -> dict[str, torch.Tensor]:
        return {"drag": coefficients[0]}

    def coefficients(self, parameters: Mapping[str, float]) -> tuple[tuple[float, ...], Shape]:
        return (parameters["drag"],), {}

    def plausible(self, parameters: Mapping[str, float], scale: JointScale) -> bool:
        return parameters["drag"] >= 0


torchrbd.register(CubicDrag())

# %% [markdown]
# ## A robot that has it
#
# An arm with two joints. The recorded torque is that of its rigid body, and of cubic drag at the elbow.

# %%
URDF = b"""
<robot name="two_joint_arm">
  <link name="base"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper_arm"/><axis xyz="0 1 0"/>
    <limit lower="-2.5" upper="2.5" velocity="4" effort="90"/>
  </joint>
  <link name="upper_arm"><inertial><origin xyz="0 0 0.2"/><mass value="4"/>
    <inertia ixx="0.06" iyy="0.06" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="elbow" type="revolute">
    <parent link="upper_arm"/><child link="forearm"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-2.5" upper="2.5" velocity="5" effort="40"/>
  </joint>
  <link name="forearm"><inertial><origin xyz="0 0 0.15"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>
"""


def record(robot_torque, name, seconds=20.0, rate=200.0, seed=0):
    """Return a recording of smooth random motion; 1 % of noise on torque, encoders of 17 bits."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / rate)
    omega = 2 * np.pi * rng.uniform(0.1, 1.2, (6, 2))
    phase = rng.uniform(0, 2 * np.pi, (6, 2))
    size = rng.uniform(0.5, 1.0, (6, 2)) / omega
    angle = omega * t[:, None, None] + phase
    q = (size * np.sin(angle)).sum(1)
    qd = (size * omega * np.cos(angle)).sum(1)
    qdd = -(size * omega**2 * np.sin(angle)).sum(1)
    tau = robot_torque(*(torch.from_numpy(x) for x in (q, qd, qdd))).detach().numpy()
    tau = tau + 0.01 * tau.std(0) * rng.standard_normal(tau.shape)
    step = 2 * np.pi / 2**17
    return torchrbd.Recording.from_arrays(name, ("shoulder", "elbow"), t, np.round(q / step) * step, tau)


model = torchrbd.RigidBodyDynamics.from_urdf(URDF)
TRUE_DRAG = 0.5  # N m s^3/rad^3


def real_torque(q, qd, qdd):
    """Return the torque of the real arm."""
    tau = model(q, qd, qdd)
    return tau + torch.stack([torch.zeros_like(qd[:, 0]), TRUE_DRAG * qd[:, 1] ** 3], dim=-1)


recording = record(real_torque, "real")

# %% [markdown]
# ## The diagnosis

# %%
diagnosis = torchrbd.diagnose(URDF, recording)
print(diagnosis.statement)
for finding in diagnosis.findings:
    print(finding.effect, finding.joints, finding.parameters)

# %%
first = diagnosis.findings[0]
assert (first.effect, first.joints) == ("cubic_drag", ("elbow",))
drag = first.parameters["drag"]
assert drag.unit == "N m s^3/rad^3"
assert abs(drag.value - TRUE_DRAG) < 0.05 * TRUE_DRAG

# %% [markdown]
# To keep an effect for good, put its class into one file of `torchrbd/effects/`, and one line into the registry. The
# contract test then checks it, and the gallery of effects gets its page.
