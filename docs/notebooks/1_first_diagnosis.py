# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # First diagnosis on an arm
#
# An arm with six joints has a URDF and two recordings: joint positions and motor torques. Predicted and measured
# torque differ. Which physics does the URDF leave out?
#
# The case comes with the package. It was recorded in MuJoCo, so the answer is known: it is revealed at the end.
#
# On the command line all of this is `torchrbd demo`, or, for files of your own:
#
# ```
# torchrbd diagnose robot.urdf monday.csv --holdout tuesday.csv -o out
# ```

# %%
import json
from pathlib import Path

import torch

import torchrbd

folder = Path(torchrbd.__file__).with_name("demo")
robot, training, holdout = folder / "arm.urdf", folder / "fit.parquet", folder / "holdout.parquet"

# %% [markdown]
# One call fits the rigid body, searches for missing physics, and checks the result on the held-out recording.

# %%
diagnosis = torchrbd.diagnose(robot, training, holdout=holdout)
print(diagnosis.verdict)
print(diagnosis.statement)

# %% [markdown]
# Each finding is one named effect at one place, with parameters in SI units and a probability.

# %%
for finding in diagnosis.findings:
    print(finding.effect, finding.joints, f"probability {finding.probability:.3f}")
    for name, quantity in finding.parameters.items():
        print(f"  {name} = {quantity.value:.3f} +- {quantity.std:.3f} {quantity.unit}")

# %% [markdown]
# How well is torque predicted? NMSE is the mean squared error divided by the variance of the measured torque, on the
# held-out recording.

# %%
for model, fit in diagnosis.identification.fits.items():
    print(f"{model:>10}", {joint: f"{nmse:.1e}" for joint, nmse in fit.nmse.items()})

# %% [markdown]
# The result is a model: a `torch.nn.Module`, differentiable in states and parameters.

# %%
model = diagnosis.identification.model
q, qd, qdd = torch.zeros(3, 5, model.robot.n_dof, dtype=torch.float64)
qd[:, 2] = torch.linspace(-1.0, 1.0, 5)
t = 0.01 * torch.arange(5, dtype=torch.float64)  # effects with memory need the times too
tau = model(q, qd, qdd, t=t)
print(tau[:, 2])  # torque of joint3 at five velocities: it jumps at zero

# %% [markdown]
# ## The answer

# %%
truth = json.loads((folder / "truth.json").read_text())
print(truth["effect"], "at", truth["joint"], ":", truth["value"], truth["unit"])

# %%
first = diagnosis.findings[0]
assert diagnosis.verdict == "missing_physics"
assert (first.effect, first.joints) == (truth["effect"], (truth["joint"],))
assert abs(first.parameters["coulomb"].value - truth["value"]) < 0.1 * truth["value"]
fits = diagnosis.identification.fits
assert fits["extended"].nmse[truth["joint"]] < 0.1 * fits["urdf"].nmse[truth["joint"]]
