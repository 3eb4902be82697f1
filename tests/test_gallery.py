"""The gallery of effects: residuals are those of least squares, and every registered effect has a page."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from torchrbd.effects import Effect, effect, known_effects
from torchrbd.effects.stribeck_friction import StribeckFriction


@pytest.fixture(scope="module")
def gallery() -> ModuleType:
    spec = importlib.util.spec_from_file_location("gallery", Path(__file__).parent.parent / "docs" / "gallery.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["gallery"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def motion(gallery: ModuleType) -> Any:
    return gallery.Motion()


def test_the_residual_is_that_of_weighted_least_squares(gallery: ModuleType, motion: Any) -> None:
    one = gallery.example(motion, effect("stribeck_friction"))
    signals, rms = motion.signals, motion.rms.numpy()
    Y, qd, n = signals.regressor.numpy(), signals.qd.numpy(), len(rms)
    rows, target = [], []
    for j in range(n):
        own = np.zeros((Y.shape[0], 3 * n))
        own[:, 3 * j : 3 * j + 3] = np.stack([qd[j], np.tanh(qd[j] / 0.02), np.ones(len(qd[j]))], 1)
        rows.append(np.hstack([Y[:, j], own]) / rms[j])
        target.append(one.torque[j].numpy() / rms[j])
    X, y = np.vstack(rows), np.concatenate(target)
    expected = (y - X @ np.linalg.lstsq(X, y, rcond=1e-9)[0]).reshape(n, -1) * rms[:, None]
    np.testing.assert_allclose(one.residual, expected, atol=1e-6 * float(one.torque.abs().max()))


def test_an_effect_that_contains_another_one_explains_it(gallery: ModuleType, motion: Any) -> None:
    names = "coulomb_friction", "stribeck_friction", "joint_spring"
    one = gallery.example(motion, effect("coulomb_friction"))
    (rivals,) = gallery.confusions(motion, [one], {name: effect(name) for name in names})
    assert [rival.effect.id for rival in rivals] == ["stribeck_friction", "joint_spring"]
    assert rivals[0].share < 1e-6
    assert rivals[1].share > 0.5


@pytest.mark.parametrize("one", known_effects().values(), ids=known_effects())
def test_every_effect_has_plausible_numbers(gallery: ModuleType, motion: Any, one: Effect) -> None:
    shown = gallery.example(motion, one)
    values = {name: float(x) for name, x in one.parameters(shown.w, shown.shape).items()}
    assert one.plausible(values, motion.scale)
    assert shown.torque.abs().max() > 0


def test_a_new_effect_has_a_page(gallery: ModuleType) -> None:
    class Another(StribeckFriction):
        """tau += something of this test."""

        id = "another"
        words = "friction of this test"

    files = gallery.pages({"another": Another()})
    assert set(files) == {"effects/index.md", "effects/another.md", "effects/another.svg", "effects/another_small.svg"}
    assert "Friction of this test" in files["effects/index.md"]
    assert Another.shown_by in files["effects/another.md"]
    assert gallery.navigation({"another": Another()}) == ["effects/index.md", {"Friction": ["effects/another.md"]}]
