"""Loads in stretches of time that touch: one of the same load, two of others."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from robot.random_robots import random_urdf
from simulated import Motion, record

from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.search.joining import with_joined
from torchrbd.diagnosis.search.options import BACKGROUND
from torchrbd.diagnosis.search.select import Search
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.likelihood.columns import Candidate
from torchrbd.physics import Site, Window, effect
from torchrbd.physics.smooth_torque import HUM
from torchrbd.robot import RobotModel

URDF, BODY, FILE = random_urdf(5, 3, kinds=("revolute",), branching=0.0, massless=0.0), 2, "a.csv"
FROM, CHANGES, TO = 4.0, 7.0, 14.0
LIGHT, HEAVY = (torch.tensor([m, 0.1 * m, 0, 0.1 * m, 0, 0, 0, 0, 0, 0], dtype=torch.float64) for m in (0.3, 0.6))


def searched(first: torch.Tensor, second: torch.Tensor, *, hum: float = 0.0) -> tuple[Search, Fit]:
    """Return a search where a link carries a load from ``FROM`` on, another after ``CHANGES``, until ``TO``.

    All joints hum at 5 Hz, ``hum`` [N m] high.
    """
    robot = RobotModel.from_urdf(URDF)

    def carried(motion: Motion) -> np.ndarray:
        t = motion.t[:, None]
        Y = robot.regressor(*(torch.from_numpy(x) for x in (motion.q, motion.qd, motion.qdd)))
        own = Y[..., 10 * BODY : 10 * BODY + 10]
        return (
            (own @ first).numpy() * ((t >= FROM) & (t < CHANGES))
            + (own @ second).numpy() * ((t >= CHANGES) & (t < TO))
            + 0.2 * motion.qd
            + hum * np.sin(2 * np.pi * 5.0 * t)
        )

    recording = record(URDF, 7, duration_s=20.0, rate_hz=125.0, extra=carried, name=FILE)
    prepared = prepare(robot, [recording], Settings.from_mapping({}, "test"), ())
    samples = read_samples(prepared, prepared.fit().pi)
    search = Search(samples, [effect(name) for name in (*BACKGROUND, "payload")], prepared.prior)
    return search, search.start


def load(fit: Fit, start_s: float, end_s: float) -> Candidate:
    site = Site(body=BODY, window=Window(FILE, start_s, end_s))
    return fit.rows.samples.columns.candidate(effect("payload"), site, {})


@pytest.mark.parametrize(
    ("second", "gap", "joined"), [(LIGHT, 0.0, True), (LIGHT, 0.1, True), (HEAVY, 0.0, False), (LIGHT, 2.0, False)]
)
def test_two_stretches_are_one_if_one_load_does_as_well(second: torch.Tensor, gap: float, joined: bool) -> None:
    search, fit = searched(LIGHT, second)
    pair = load(fit, FROM, CHANGES), load(fit, CHANGES + gap, TO)
    fit = fitted(fit.rows.samples, search.prior, (*fit.terms, *pair), fit.rows.noise)
    timed = [c for c in with_joined(search, fit) if c.effect.id == "payload"]
    assert timed == ([load(fit, FROM, TO)] if joined else [*pair])


def test_what_is_no_load_is_never_joined() -> None:
    """Hums and functions of time have a stretch too: the whole of their recording."""
    search, fit = searched(LIGHT, LIGHT, hum=0.5)
    whole = Site(0, window=Window(FILE))
    hums = [fit.rows.samples.columns.candidate(HUM, whole, {"frequency": f}) for f in (5.0, 7.0)]
    friction = [c for c in fit.terms if c.site.window is None]
    fit = fitted(fit.rows.samples, search.prior, (*friction, *hums, load(fit, FROM, TO)), fit.rows.noise)
    assert with_joined(search, fit) is fit.terms
