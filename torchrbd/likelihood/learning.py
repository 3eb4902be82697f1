"""Learn the hyperparameters of a likelihood: noise, widths, drift, dispersion and the URDF's error."""

from __future__ import annotations

import numpy as np
import torch

from torchrbd.likelihood.hyper import Hyper
from torchrbd.likelihood.likelihood import Likelihood
from torchrbd.likelihood.machine import Machine
from torchrbd.likelihood.noise import Noise

# Initial values as fractions of a joint's torque.
_FIRST_NOISE, _FIRST_DRIFT, _FIRST_HOLD = 0.05, 0.01, 0.3
_ROUNDS = 3


def learn(machine: Machine) -> Likelihood:
    """Learn noise, widths, drift, dispersion and the URDF's error from the data, with the machine as the model.

    The first fit is least squares: with coefficients that are far off, slow errors would be taken for slow noise, which
    then keeps the coefficients there. The widths of friction's sign change are learnt while all rows have equal weight.
    Later, the rows that show them, at reversals, have less weight the worse they are explained. The widths are learnt
    again given the friction that was found at rests.

    Args:
        machine: rigid body and baseline terms.
    """
    rows, rms = machine.rows, np.maximum(machine.torque_rms, 1e-300)
    one = np.ones(rows.tau.shape[1])
    hyper = Hyper(
        kappa=3.0,
        encoder_share=np.zeros(rows.n_dof),
        rest_width=np.array([s.rest_width for s in rows.columns.scales]),
        drift=_FIRST_DRIFT * rms,
        hold=_FIRST_HOLD * rms,
        noise=tuple(Noise(i, np.zeros(0), _FIRST_NOISE * r, one) for i, r in zip(machine.index, rms, strict=True)),
        dispersion=np.ones(rows.n_dof),
        bodies=np.zeros(len(machine.bodies.index)),
        resists=np.zeros((3, len(machine.positive))),
        pi=rows.columns.robot.pi,
        friction=torch.zeros(rows.n_dof, 3, dtype=torch.float64),
        white=True,
    )
    # Columns are large: no variable keeps a likelihood while the next one makes its own.
    first = Likelihood(machine, hyper).renoised()
    hyper = first.rewidened().renoised().around_its_fit(alone=True)
    del first
    for _ in range(_ROUNDS):
        hyper = _around(machine, hyper).with_(white=False).renoised().around_its_fit(alone=True)
    last = _around(machine, hyper).rewidened()
    hyper = last.with_heavy_tails().recalibrated().around_its_fit(alone=True)
    del last
    return _around(machine, hyper).renoised(dispersed=True)


def _around(machine: Machine, hyper: Hyper) -> Likelihood:
    """Return the likelihood with load from the fit, and rows weighted anew."""
    return Likelihood(machine, hyper, along=machine.along(hyper)).reweighed()
