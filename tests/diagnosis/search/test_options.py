"""How candidates are judged: with the noise they leave, in the proportions that are believed, where they may be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from robot.random_robots import random_urdf
from simulated import Motion, record

from torchrbd.diagnosis.rows.gain import Gain, gain
from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.search.grid import Grid, freedom, fresh_columns
from torchrbd.diagnosis.search.options import (
    BACKGROUND,
    LEAST_GAIN,
    LEAST_GAIN_AT_TIMES,
    LEAST_NAMED_GAIN,
    Option,
    coefficients,
    judged,
    plausible,
    takes,
)
from torchrbd.diagnosis.search.recordings import explained, screened_by_recordings
from torchrbd.diagnosis.search.unnamed import smooth_candidates
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.physics import Site, Window, effect, effects
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

URDF = random_urdf(5, 3, kinds=("revolute",), branching=0.0, massless=0.0)
WHOLE = Window("b.csv")


def friction(motion: Motion) -> np.ndarray:
    return 0.5 * np.sign(motion.qd) + 0.3 * motion.qd


def with_spring(motion: Motion) -> np.ndarray:
    torque = friction(motion)
    torque[:, 1] += 0.4 * motion.q[:, 1]
    return torque


def fit_of(*extras: Callable[[Motion], np.ndarray]) -> Fit:
    """Return the fit of rigid body, friction and offsets to recordings with these torques."""
    sources: list[Recording] = [
        record(URDF, 7 + k, duration_s=20.0, rate_hz=125.0, extra=extra, torque_noise=0.02, name=f"{'abc'[k]}.csv")
        for k, extra in enumerate(extras)
    ]
    prepared = prepare(RobotModel.from_urdf(URDF), sources, Settings.from_mapping({}, "test"), ())
    samples = read_samples(prepared, prepared.fit().pi)
    terms = [samples.columns.candidate(effect(name), Site(j), {}) for j in range(3) for name in BACKGROUND]
    return fitted(samples, prepared.prior, terms)


@pytest.fixture(scope="module")
def sprung() -> Fit:
    return fit_of(with_spring, with_spring)


@pytest.fixture(scope="module")
def partly() -> Fit:
    return fit_of(friction, with_spring)


def test_what_colours_the_noise_gains_more_with_the_noise_that_it_leaves(sprung: Fit) -> None:
    spring = sprung.rows.samples.columns.candidate(effect("joint_spring"), Site(1), {})
    hidden = gain(sprung.errors, sprung.errors_with(fresh_columns(sprung, spring)), sprung.rows.counts)
    beside = Fit(sprung.rows, (*sprung.terms, spring)).renoised()
    assert judged(sprung, spring).worth.total > 1.2 * hidden.total > 0
    assert abs(beside.rows.noise[0][1].sum()) < abs(sprung.rows.noise[0][1].sum())


def test_what_explains_nothing_gains_nothing(sprung: Fit) -> None:
    for name, shape in (("rotor_inertia", {}), ("quadratic_drag", {})):
        candidate = sprung.rows.samples.columns.candidate(effect(name), Site(2), shape)
        assert judged(sprung, candidate).worth.total < 6.0


def test_a_mass_and_its_moments_keep_their_proportions(sprung: Fit) -> None:
    rows = sprung.rows
    payload = rows.samples.columns.candidate(effect("payload"), Site(body=2, window=WHOLE), {})
    widths, std = rows.widths_of(payload), np.array(payload.effect.prior.std)
    moves = rows.samples.features(payload).any((1, 2))
    np.testing.assert_allclose(widths[moves] / std[moves], (widths[moves] / std[moves])[0])
    alone = rows.widths(None, rows.samples.features(payload))
    assert (widths <= alone * (1 + 1e-12)).all()
    free = 0.5 * payload.effect.complexity * np.log(rows.counts.max())
    first = rows.samples.columns.candidate(effect("payload"), Site(body=0, window=WHOLE), {})
    assert 0 < freedom(sprung, first) < freedom(sprung, payload) <= free * (1 + 1e-9)
    (screened,) = Grid(rows.samples, [payload]).screened(sprung)
    C = rows.columns(payload)[1]
    assert screened.gain == pytest.approx(sprung.addition(C)[0], rel=1e-6)


def test_friction_within_chance_of_none_is_none(sprung: Fit) -> None:
    here = {c.effect.id: c for c in sprung.terms if c.site.joint == 0}
    assert plausible(sprung, here["coulomb_friction"])
    assert not plausible(sprung, here["torque_offset"])


def test_what_is_in_one_recording_explains_what_is_left_there(partly: Fit) -> None:
    columns = partly.rows.samples.columns
    there, elsewhere = (
        columns.candidate(effect("joint_spring"), Site(joint, recordings=("b.csv",)), {}) for joint in (1, 0)
    )
    assert explained(partly, there) > 0.25 > explained(partly, elsewhere)
    grid = Grid(partly.rows.samples, [c for e in effects().values() for c in _at(partly, e.id)])
    found = screened_by_recordings(grid, partly)
    assert found[0].candidate.effect.id == "joint_spring"
    assert all(one.candidate.effect.comes_and_goes for one in found)


def _at(fit: Fit, name: str):
    columns = fit.rows.samples.columns
    for site in effect(name).sites(columns.robot):
        for shape in effect(name).shapes(columns.scale(site)):
            yield columns.candidate(effect(name), site, shape)


def test_friction_at_some_positions_only_may_be_a_little_below_zero_elsewhere() -> None:
    def bump(motion: Motion) -> np.ndarray:
        q, qd = motion.q[:, 1], motion.qd[:, 1]
        return (np.sign(qd) * np.exp(-(((q - 0.2) / 0.3) ** 2)))[:, None] * (np.arange(3) == 1)

    def below(motion: Motion) -> np.ndarray:
        return bump(motion) - 0.3 * np.sign(motion.qd)

    for fit, possible in ((fit_of(bump), True), (fit_of(below), False)):
        columns = fit.rows.samples.columns
        friction = columns.candidate(effect("position_dependent_friction"), Site(1), {"centre": 0.2, "width": 0.3})
        elsewhere, more_at_centre = coefficients(fit, friction)
        assert elsewhere < 0 < more_at_centre
        assert plausible(fit, friction) == possible


def test_a_name_needs_more_than_plain_friction_and_more_at_times(partly: Fit) -> None:
    columns = partly.rows.samples.columns
    worth = Gain(total=35.0, std=5.0, repeated=25.0)

    def taken(total: float, name: str, site: Site) -> bool:
        candidate = columns.candidate(effect(name), site, {})
        return takes(Option(candidate, partly.errors, replace(worth, total=total)))

    in_one = Site(1, recordings=("b.csv",))
    for name, site, least in (
        ("coulomb_friction", Site(1), LEAST_GAIN),
        ("joint_spring", Site(1), LEAST_NAMED_GAIN),
        ("coulomb_friction", in_one, LEAST_GAIN_AT_TIMES),
        ("joint_spring", in_one, LEAST_GAIN_AT_TIMES),
        ("payload", Site(body=1, window=WHOLE), LEAST_GAIN_AT_TIMES),
    ):
        assert taken(least + 1.0, name, site)
        assert not taken(least - 1.0, name, site)
    (smooth, *_) = smooth_candidates(partly.rows.samples, [True] * 3)
    assert takes(Option(smooth, partly.errors, replace(worth, total=LEAST_GAIN + 1.0)))
    assert LEAST_GAIN < LEAST_NAMED_GAIN < LEAST_GAIN_AT_TIMES


@pytest.mark.parametrize(("body", "possible"), [(1, True), (2, False)])
def test_a_load_whose_mass_is_hardly_felt_may_seem_to_weigh_less_than_nothing(body: int, possible: bool) -> None:
    robot = RobotModel.from_urdf(URDF)
    lifted = torch.tensor([-0.3, 0.02, 0.01, 0.04, 0.01, 0, 0.01, 0, 0, 0.005], dtype=torch.float64)

    def loaded(motion: Motion) -> np.ndarray:
        Y = robot.regressor(*(torch.from_numpy(x) for x in (motion.q, motion.qd, motion.qdd)))
        return friction(motion) + (Y[..., 10 * body : 10 * body + 10] @ lifted).numpy()

    fit = fit_of(friction, loaded)
    load = fit.rows.samples.columns.candidate(effect("payload"), Site(body=body, window=WHOLE), {})
    assert coefficients(fit, load)[0] < 0
    assert plausible(fit, load) == possible
