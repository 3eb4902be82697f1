"""The benchmark of the prior of curves."""

from __future__ import annotations

import curve_prior
import numpy as np
import torch
from likelihood.fits import at_joint, fitted

from torchrbd.effects.smooth_torque import SMOOTH


def test_values_are_independent_only_inside() -> None:
    before = [effect.root.clone() for effect in SMOOTH]
    with curve_prior.independent_values():
        assert all(torch.equal(e.root, torch.eye(e.knots, dtype=torch.float64)) for e in SMOOTH)
    assert all(torch.equal(e.root, root) for e, root in zip(SMOOTH, before, strict=True))


def test_a_slow_function_is_more_probable_if_values_are_alike() -> None:
    base = fitted(at_joint(0, lambda m: 1.5 * np.sin(2.0 * m.q[:, 0])))
    alike, count = curve_prior.evidence(base)
    with curve_prior.independent_values():
        independent, same = curve_prior.evidence(base)
    assert count == same
    assert alike > independent + 5.0
