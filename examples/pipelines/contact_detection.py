"""Contact: what a measured torque has beyond the model's, where it is out of the band that the posterior gives.

The arm is identified from its recording; then somebody leans on it while the held-out recording runs, with a torque of
3 N m at joint2 for a second. ``BayesianDynamics.tau_ext`` says when: its band knows how noisy torques are, and how well
the parameters are known at each state.

    python examples/pipelines/contact_detection.py
"""

from __future__ import annotations

import torch
from torch_loop import DEMO, SLOW, recorded

import torchrbd

PUSH, JOINT = 3.0, 1  # N m
PROBABILITY = 0.9999


def main() -> tuple[float, float]:
    """Return which part of the contact is seen, and which part of the rest is taken for contact."""
    identified = torchrbd.identify(DEMO / "arm.urdf", DEMO / "fit.parquet")
    bayes = torchrbd.BayesianDynamics.from_diagnosis(identified)
    q, qd, qdd, tau = recorded(identified.robot, "holdout")
    # Around a reversal the filter smears what dry friction does.
    moving = qd[:, JOINT].abs() > SLOW
    contact = torch.zeros(len(q), dtype=torch.bool)
    contact[len(q) // 2 :][:25] = True
    tau[contact, JOINT] += PUSH
    with torch.no_grad():
        found = bayes.tau_ext(q, qd, qdd, tau, probability=PROBABILITY)
    touched = found.touched[:, JOINT]
    seen = touched[contact & moving].double().mean().item()
    false = touched[~contact & moving].double().mean().item()
    print(f"contact of {PUSH:g} N m, noise of {found.std[:, JOINT].mean():.2f} N m: {100 * seen:.0f} % of it seen")
    print(f"taken for contact elsewhere: {100 * false:.2f} % of the samples")
    return seen, false


if __name__ == "__main__":
    main()
