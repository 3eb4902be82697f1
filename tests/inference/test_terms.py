"""What is reported of a term's parameters: those that the data tell."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from likelihood.arms import recorded
from likelihood.fits import OPTIONS, URDF

from torchrbd.effects import effect
from torchrbd.inference.identify import identify
from torchrbd.inference.physical import terms


@pytest.mark.parametrize("load", [1.0, 40.0])
def test_what_the_data_leave_open_is_not_a_number(monkeypatch: pytest.MonkeyPatch, load: float) -> None:
    """A payload on a joint's own axis: of its mass nothing is told, of its inertia about the axis all."""
    payload = effect("payload")
    found = {name: (0.01 * load, 0.02 * load) for name in payload.units}
    found |= {"mass": (-0.3, 500.0 * load), "x": (5e9, 2e23), "y": (math.nan, math.nan), "Izz": (0.06 * load, 1e-4)}
    monkeypatch.setattr(terms, "term_parameters", lambda *_: found)
    told = terms.estimated_parameters(None, SimpleNamespace(effect=payload))  # pyright: ignore[reportArgumentType]
    open_ones = [name for name, (value, _) in told.items() if math.isnan(value)]
    assert open_ones == ["mass", "x", "y"]
    assert all(told[name] == found[name] for name in told if name not in open_ones)


def test_of_one_coefficient_everything_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"offset": (0.01, 7.0)}
    monkeypatch.setattr(terms, "term_parameters", lambda *_: found)
    offset = SimpleNamespace(effect=effect("encoder_offset"))
    assert terms.estimated_parameters(None, offset) == found  # pyright: ignore[reportArgumentType]


def test_coefficients_have_the_signs_that_physics_gives_them() -> None:
    """A motor that helped acceleration would be a rotor of negative inertia."""
    helping = recorded(URDF, 2, lambda m: -0.02 * m.qdd, **OPTIONS)
    effects = ["viscous_friction", "coulomb_friction", "rotor_inertia"]
    model = identify(URDF.encode(), helping, effects=effects).model
    found = [float(t.coefficients.detach()[0]) for t in model.terms if t.effect.id == "rotor_inertia"]
    assert len(found) == 2
    assert min(found) >= 0.0
