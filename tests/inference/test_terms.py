"""What is reported of a term's parameters: those that the data tell."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from torchrbd.inference.physical import terms
from torchrbd.physics import effect


@pytest.mark.parametrize("load", [1.0, 40.0])
def test_what_the_data_leave_open_is_not_a_number(monkeypatch: pytest.MonkeyPatch, load: float) -> None:
    """A payload on a joint's own axis: of its mass nothing is told, of its inertia about the axis all."""
    payload = effect("payload")
    found = {name: (0.01 * load, 0.02 * load) for name in payload.units}
    found |= {"mass": (-0.3, 500.0 * load), "x": (5e9, 2e23), "y": (math.nan, math.nan), "Izz": (0.06 * load, 1e-4)}
    monkeypatch.setattr(terms, "term_parameters", lambda *_: found)
    told = terms.told_parameters(None, SimpleNamespace(effect=payload))  # pyright: ignore[reportArgumentType]
    open_ones = [name for name, (value, _) in told.items() if math.isnan(value)]
    assert open_ones == ["mass", "x", "y"]
    assert all(told[name] == found[name] for name in told if name not in open_ones)


def test_of_one_coefficient_everything_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"offset": (0.01, 7.0)}
    monkeypatch.setattr(terms, "term_parameters", lambda *_: found)
    offset = SimpleNamespace(effect=effect("encoder_offset"))
    assert terms.told_parameters(None, offset) == found  # pyright: ignore[reportArgumentType]
