# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # What to record next
#
# A first recording is short and slow. It cannot separate all parameters. `torchrbd excite` designs the motion that
# separates them best, within the limits of the robot.
#
# On the command line: `torchrbd excite robot.urdf -o motion.csv`; with `-d out`, for what the diagnosis in `out` could
# not separate.

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


# %% [markdown]
# The real arm has viscous friction, and a heavier forearm than its URDF says.

# %%
real = torchrbd.RigidBodyDynamics.from_urdf(URDF.replace(b'"2"/>', b'"2.4"/>'), effects=["viscous_friction"])
with torch.no_grad():
    for term in real.terms:
        term.coefficients[:] = 0.8  # N m s/rad


def measured(name, t, q, qd, qdd, seed=0):
    """Return what sensors record of a motion: 0.1 N m of noise on torque, encoders of 17 bits."""
    rng = np.random.default_rng(seed)
    tau = real(*(torch.as_tensor(x) for x in (q, qd, qdd))).detach().numpy()
    tau = tau + 0.1 * rng.standard_normal(tau.shape)
    step = 2 * np.pi / 2**17
    return torchrbd.Recording.from_arrays(name, ("shoulder", "elbow"), t, np.round(np.asarray(q) / step) * step, tau)


# %% [markdown]
# ## The first recording: 30 seconds, two slow sines

# %%
t = np.arange(0.0, 30.0, 0.01)
omega, size = 2 * np.pi * np.array([0.1, 0.17]), np.array([0.3, 0.3])
angle = omega * t[:, None]
q, qd, qdd = size * np.sin(angle), size * omega * np.cos(angle), -size * omega**2 * np.sin(angle)
first = measured("first", t, q, qd, qdd)
before = torchrbd.identify(URDF, first)


def print_base(identified):
    """Print base parameters with their standard deviations."""
    for one in identified.base:
        print(f"  {one.expression:<40} {one.value:8.3f} +- {one.std:.1e} {one.unit}")


print_base(before)

# %% [markdown]
# ## The motion to record
#
# A Fourier series for each joint, from rest to rest, that keeps ranges, speeds and torques of the URDF. A condition
# number near 1 means that each parameter moves the torque in its own way.

# %%
plan = torchrbd.excite(URDF, frequency_hz=0.2, harmonics=4, periods=6, starts=2)
print(plan)

# %% [markdown]
# `plan.states()` are the set-points for the controller; on the command line, `motion.csv` has them. Here the package
# plays the robot.

# %%
second = measured("second", *plan.states(100.0), seed=1)
after = torchrbd.identify(URDF, [first, second])
print_base(after)

# %% [markdown]
# ## What did it bring?
#
# `std` is the standard deviation of a base parameter. `prior_share` says how much of the value comes from the URDF
# rather than from the data: 0 is all data, 1 is all URDF.

# %%
for old, new in zip(before.base, after.base, strict=True):
    print(f"{old.expression:<40} std / {old.std / new.std:5.1f}   prior {old.prior_share:.2f} -> {new.prior_share:.2f}")

# %%
ratios = [old.std / new.std for old, new in zip(before.base, after.base, strict=True)]
assert plan.condition.scaled < 10
assert min(ratios) > 1
assert float(np.median(ratios)) > 3
