"""What is reported of a term's parameters: those that the data tell."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from likelihood.arms import recorded
from likelihood.fits import OPTIONS, URDF

from torchrbd.effects import effect
from torchrbd.inference.identify import identify
from torchrbd.inference.physical import terms
from torchrbd.inference.physical.fitting import term_candidates
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.shapes.refine import fit_with_shapes, refined
from torchrbd.robot import RobotModel


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


def test_coulomb_friction_of_several_laws_is_better_known_than_their_parts() -> None:
    """A joint whose friction builds up quickly: how much of it does, the data hardly say, but they know the sum."""
    recording = recorded(URDF, 2, lambda m: 0.8 * np.tanh(m.qd / 0.01) + 0.1 * m.qd, **OPTIONS)
    ids = ("coulomb_friction", "presliding_hysteresis", "viscous_friction")
    settings = Settings(effects=ids, joints=("joint1",))
    prepared = prepare(RobotModel.from_urdf(URDF), [recording], settings, settings.chosen_effects())
    candidates = [c for c in term_candidates(prepared.columns, ids) if c.site.joint == 0]
    prepared, fitted = refined(prepared, candidates, lambda *_: None)
    model = fit_with_shapes(prepared, fitted)
    dry = [c for c in fitted if c.effect.dry]
    assert len(dry) == 2
    each = [terms.term_parameters(model, c)["coulomb"] for c in dry]
    value, std = terms.coulomb_in_motion(model, dry)
    assert value == pytest.approx(sum(own for own, _ in each), rel=1e-9)
    assert value == pytest.approx(0.8, rel=0.02)
    assert std < min(own for _, own in each)
    for c, own in zip(dry, each, strict=True):
        assert terms.coulomb_in_motion(model, [c])[0] == pytest.approx(own[0], rel=1e-9)
