# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Before and after service
#
# The elbow of an arm rubs. A technician exchanges its gear. What changed, and how certain is that? Record the same kind
# of motion before and after, diagnose both, and compare.
#
# On the command line: `torchrbd compare before/ after/ -o changes`, with the folders of two diagnoses.

# %%
import numpy as np
import torch

import torchrbd

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


# %% [markdown]
# The arm has viscous and Coulomb friction at the elbow. Service lowers Coulomb friction from 2.0 to 0.8 N m. All else
# stays.

# %%
EFFECTS = ["viscous_friction@elbow", "coulomb_friction@elbow"]


def arm(coulomb):
    """Return the arm with friction at the elbow [N m]."""
    model = torchrbd.RigidBodyDynamics.from_urdf(URDF, effects=EFFECTS)
    viscous_term, coulomb_term = model.terms
    with torch.no_grad():
        viscous_term.coefficients[:] = 0.6  # N m s/rad
        coulomb_term.coefficients[:] = coulomb
    return model


before = torchrbd.diagnose(URDF, record(arm(2.0), "before", seed=1))
after = torchrbd.diagnose(URDF, record(arm(0.8), "after", seed=2))
for name, diagnosis in (("before", before), ("after", after)):
    print(name, "|", diagnosis.statement)

# %% [markdown]
# Each change has a probability: that the parameter differs by more than the two recordings can explain by chance.

# %%
comparison = torchrbd.compare(before, after)
print(comparison.statement)
for change in comparison.changes:
    print(f"{change.verdict:>10}  {change.effect}  {change.joints}  probability {change.probability:.3f}")

# %%
(friction,) = (change for change in comparison.changes if change.effect == "coulomb_friction")
assert friction.verdict == "changed"
assert friction.joints == ("elbow",)
coulomb = friction.parameters["coulomb"]
assert abs(coulomb.before.value - 2.0) < 0.1
assert abs(coulomb.after.value - 0.8) < 0.1
assert not any(c.verdict == "changed" and c.effect != "coulomb_friction" for c in comparison.changes)
