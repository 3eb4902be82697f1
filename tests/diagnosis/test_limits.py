"""How large what was not found could be: against fits that have it, and against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from robot.random_robots import random_urdf
from simulated import Motion, joint_names, record

from torchrbd.diagnosis.limits import limits
from torchrbd.diagnosis.results import Limit
from torchrbd.diagnosis.rows.regression import Fit, fitted
from torchrbd.diagnosis.rows.samples import read_samples
from torchrbd.diagnosis.rows.white_rows import Colour, Rows
from torchrbd.diagnosis.search.options import BACKGROUND
from torchrbd.diagnosis.search.select import Search
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.physics import effect
from torchrbd.robot import RobotModel

EFFECTS = (
    *BACKGROUND,
    "stribeck_friction",
    "joint_spring",
    "quadratic_drag",
    "torque_scale",
    "joint_coupling",
    "payload",
)


def begun(stiffness: float = 0.0, noise: Colour | None = None) -> tuple[Search, Fit]:
    """Return a search of an arm with friction everywhere and a spring at joint2, and a fit with friction alone."""
    urdf = random_urdf(12, 3, kinds=("revolute",), branching=0.0, massless=0.0)
    at = joint_names(urdf).index("joint2")

    def extra(motion: Motion) -> np.ndarray:
        tau = 0.6 * np.sign(motion.qd) + 0.4 * motion.qd
        tau[:, at] += stiffness * motion.q[:, at]
        return tau

    recording = record(urdf, 12, duration_s=20.0, rate_hz=125.0, extra=extra)
    prepared = prepare(RobotModel.from_urdf(urdf), [recording], Settings.from_mapping({}, "test"), ())
    search = Search(read_samples(prepared, prepared.fit().pi), [effect(name) for name in EFFECTS], prepared.prior)
    terms = [c for c in search.background if c.effect.id != "torque_offset"]
    samples = search.start.rows.samples
    fit = fitted(samples, prepared.prior, terms, search.start.rows.noise)
    return search, fit if noise is None else Fit(Rows(samples, prepared.prior, noise), terms)


@pytest.fixture(scope="module")
def spun() -> tuple[Search, Fit]:
    return begun()


@pytest.fixture(scope="module")
def found(spun: tuple[Search, Fit]) -> dict[tuple[str, tuple[str, ...], tuple[str, ...]], Limit]:
    return {(x.effect, x.joints, x.depends_on): x for x in limits(*spun)}


def test_what_is_in_the_model_or_acts_for_a_time_has_no_limit(found) -> None:
    assert {name for name, *_ in found} == set(EFFECTS) - {"viscous_friction", "coulomb_friction", "payload"}


def test_value_and_std_are_those_of_a_fit_that_has_the_effect(spun: tuple[Search, Fit], found) -> None:
    search, fit = spun
    robot = fit.rows.samples.columns.robot
    for one in search.grid.screened(fit):
        c = one.candidate
        joint = robot.joint_names[c.joint] if c.site.joint is not None else ""
        if c.effect.id not in ("joint_spring", "stribeck_friction", "torque_offset"):
            continue
        limit = found[c.effect.id, (joint,), ()]
        whole = Fit(fit.rows, (*fit.terms, c))
        w = dict(zip(c.labels, whole.coefficients(c), strict=True))
        names = {"joint_spring": list(w)[:1], "stribeck_friction": list(w), "torque_offset": list(w)}[c.effect.id]
        first, width = fit.rows.X.shape[1], fit.rows.widths(c.place, fit.rows.samples.features(c))
        index = [first + whole.places.index((c.place, label)) for label in names]
        covariance = np.linalg.inv(whole.X.T @ whole.X + np.eye(whole.X.shape[1]))[np.ix_(index, index)]
        scale = np.array([width[c.labels.index(label)] for label in names])
        std = float(scale @ covariance @ scale) ** 0.5
        assert limit.value == pytest.approx(sum(w[label] for label in names), rel=1e-3, abs=1e-3 * std)
        # Blocks may scatter more than white noise would.
        assert 0.999 * std < limit.std < 3.0 * std


def test_the_truth_is_within_the_std(found) -> None:
    off = [(x.value - x.none) / x.std for (name, *_), x in found.items() if name != "stribeck_friction"]
    assert len(off) >= 15
    assert max(map(abs, off)) < 4.5
    assert np.sqrt(np.mean(np.square(off))) < 2.0


def test_none_is_what_the_parameter_is_without_the_effect(spun: tuple[Search, Fit], found) -> None:
    _, fit = spun
    plain = {c.joint: float(fit.coefficients(c)[0]) for c in fit.terms if c.effect.id == "coulomb_friction"}
    for joint, coulomb in plain.items():
        name = (f"joint{joint + 1}",)
        assert found["torque_scale", name, ()].none == 1.0
        limit = found["stribeck_friction", name, ()]
        assert limit.parameter == "static"
        assert limit.none == pytest.approx(coulomb, abs=4 * limit.std)


def test_a_spring_of_twelve_std_stands_out(spun: tuple[Search, Fit], found) -> None:
    """The std says how much data with this noise can hide."""
    limit = found["joint_spring", ("joint2",), ()]
    sprung = begun(12.0 * limit.std, spun[1].rows.noise)
    told = next(x for x in limits(*sprung) if (x.effect, x.joints) == ("joint_spring", ("joint2",)))
    assert told.value == pytest.approx(12.0 * limit.std, abs=4.0 * told.std)
    assert told.value > 6.0 * told.std
