# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # The posterior in a training pipeline
#
# `torchrbd.identify` returns a model that is a `torch.nn.Module`. This notebook uses it in three ways: with its
# uncertainty, in a training loop of your own, and with a neural network for the rest.

# %%
import numpy as np
import torch

import torchrbd

torch.manual_seed(0)

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
# The real arm has heavier links than its URDF, Coulomb friction at both joints, and at the elbow a torque that no
# simple law describes.

# %%
FRICTION = ["coulomb_friction"]
real = torchrbd.RigidBodyDynamics.from_urdf(URDF.replace(b'"4"/>', b'"4.6"/>'), effects=FRICTION)
with torch.no_grad():
    for term, coulomb in zip(real.terms, (1.5, 0.7), strict=True):
        term.coefficients[:] = coulomb  # N m


def real_torque(q, qd, qdd):
    """Return the torque of the real arm."""
    tau = real(q, qd, qdd)
    strange = 0.8 * torch.sin(2.0 * q[:, 0]) * torch.exp(-(q[:, 1] ** 2))  # N m
    return tau + torch.stack([torch.zeros_like(strange), strange], dim=-1)


recording = record(real_torque, "real", seconds=40.0)
identified = torchrbd.identify(URDF, recording)
print(identified)

# %% [markdown]
# ## How sure is the model?
#
# `BayesianDynamics` predicts torque with an interval, and draws robots that agree with the data. Simulate a policy on
# such robots rather than on one: this is domain randomisation with a reason.

# %%
posterior = torchrbd.BayesianDynamics.from_diagnosis(identified)
q, qd, qdd = torch.randn(3, 100, 2, dtype=torch.float64)
low, high = posterior.predict(q, qd, qdd).interval(0.95)
print("mean width of the 95 % interval [N m]:", (high - low).mean(0))

robots = posterior.sample_robots(32)
torques = robots(*(x.expand(32, -1, -1) for x in (q, qd, qdd)))
print("standard deviation over 32 robots [N m]:", torques.std(0).mean(0))

# %% [markdown]
# ## A training loop of your own
#
# The physical parameters may be trained with whatever else is in the loss. They stay physical whatever the optimiser
# does. `parameter_groups` gives each group a learning rate by its effect on torque, so that Adam converges.

# %%
data = torchrbd.residual_dataset(identified, recording, split="train")
q, qd, qdd = data.features.chunk(3, dim=-1)
tau = data.measured
model = torchrbd.RigidBodyDynamics.from_urdf(URDF, effects=FRICTION)
adam = torch.optim.Adam(torchrbd.parameter_groups(model, q, qd, qdd, tau, lr=3e-3))
losses = []
for _ in range(150):
    adam.zero_grad()
    loss = ((model(q, qd, qdd) - tau).square() / tau.var(0)).mean()
    loss.backward()
    adam.step()
    losses.append(loss.item())
print(f"nmse {losses[0]:.4f} with the URDF, {losses[-1]:.4f} after training")

# %% [markdown]
# ## A network for the rest
#
# `ResidualDynamics` adds a network to the model. It is penalised for torque that physics can explain, and it is zero
# far from its data: there the model is physics alone.

# %%
train, validation, test = (
    torchrbd.residual_dataset(identified, recording, split=part) for part in ("train", "validation", "test")
)
both = torchrbd.ResidualDynamics(identified.model)
torchrbd.fit_residual(both, train, validation=validation, epochs=60, lr=3e-3, progress=False)
shares = both.shares(test)
alone, with_network = float(shares.alone_inside[1]), float(shares.left_inside[1])
print(f"error at the elbow: {alone:.3f} N m with physics, {with_network:.3f} N m with the network too")

# %%
assert ((high - low) > 0).all()
assert losses[-1] < 0.3 * losses[0]
assert with_network < 0.8 * alone
