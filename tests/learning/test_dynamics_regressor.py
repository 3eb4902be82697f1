"""The regressor is a scikit-learn estimator, its answer a physical robot."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest
import torch
from inference.problems import urdf_of
from robot.random_robots import random_urdf
from simulated import inverse_dynamics, multisine, with_wrong_inertials
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning, NotFittedError
from sklearn.model_selection import GridSearchCV, KFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from sklearn.utils.estimator_checks import parametrize_with_checks

import torchrbd
from torchrbd import DynamicsRegressor
from torchrbd.dataset.columns import Columns
from torchrbd.dataset.given_states import given_statistics
from torchrbd.effects import JointScale, effect
from torchrbd.errors import InputError, OptionError
from torchrbd.inference.physical.fitting import fit_model
from torchrbd.parameters import is_physical
from torchrbd.robot import RobotModel

ONE_JOINT = random_urdf(1, 1, kinds=("revolute",), fixed=0.0)
URDF = urdf_of(4, 3)
GIVEN = with_wrong_inertials(URDF, 1)
VISCOUS, COULOMB = np.array([0.5, 1.0, 2.0]), np.array([2.0, 1.0, 0.5])

WIDTH = "its X has as many columns as it likes, a robot's has 3 a joint"
NOT_FOR_ROBOTS = dict.fromkeys(
    (
        "check_dtype_object",
        "check_estimators_dtypes",
        "check_estimators_fit_returns_self",
        "check_estimators_overwrite_params",
        "check_all_zero_sample_weights_error",
        "check_fit_check_is_fitted",
        "check_fit_idempotent",
        "check_n_features_in",
        "check_n_features_in_after_fitting",
        "check_positive_only_tag_during_fit",
        "check_readonly_memmap_input",
        "check_regressor_data_not_an_array",
        "check_regressor_multioutput",
        "check_regressors_int",
        "check_regressors_no_decision_function",
        "check_regressors_train",
        "check_sample_weight_equivalence_on_dense_data",
        "check_sample_weights_not_an_array",
        "check_sample_weights_not_overwritten",
        "check_sample_weights_pandas_series",
        "check_sample_weights_shape",
    ),
    WIDTH,
)


@parametrize_with_checks([DynamicsRegressor(ONE_JOINT)], expected_failed_checks=lambda _: NOT_FOR_ROBOTS)
def test_scikit_learns_checks(estimator, check) -> None:
    check(estimator)


@dataclass(frozen=True)
class Samples:
    X: np.ndarray
    y: np.ndarray


def samples(seed: int, count: int = 400, noise: float = 0.01, friction: float = 1.0) -> Samples:
    """Return exact states of a motion and Pinocchio's torques, with friction and noise."""
    motion = multisine(3, seed, duration_s=count / 20, rate_hz=20.0)
    tau = inverse_dynamics(URDF, motion) + friction * (VISCOUS * motion.qd + COULOMB * np.sign(motion.qd))
    rng = np.random.default_rng(seed)
    tau += noise * tau.std(0) * rng.standard_normal(tau.shape)
    return Samples(np.hstack((motion.q, motion.qd, motion.qdd)), tau)


@pytest.fixture(scope="module")
def data() -> Samples:
    return samples(0)


@pytest.fixture(scope="module")
def fitted(data: Samples) -> DynamicsRegressor:
    return DynamicsRegressor(GIVEN).fit(data.X, data.y)


def test_torques_of_another_motion_are_predicted_and_friction_is_found(
    data: Samples, fitted: DynamicsRegressor
) -> None:
    new = samples(1, noise=0.0)
    assert fitted.score(new.X, new.y) > 0.9995
    assert DynamicsRegressor(GIVEN, friction=False).fit(new.X, new.y).score(new.X, new.y) < 0.99
    found = {(t.effect.id, t.site.joint): t.coefficients.detach().numpy() for t in fitted.model_.terms}
    for j in range(3):
        near = 6.0 * fitted.noise_std_[j] / len(data.X) ** 0.5
        assert found["viscous_friction", j][0] == pytest.approx(VISCOUS[j], abs=near)
        assert found["asymmetric_coulomb_friction", j][0] == pytest.approx(COULOMB[j], abs=near)
    assert is_physical(fitted.model_.pi.detach().reshape(-1, 10)).all()


def test_many_samples_tell_what_least_squares_does(data: Samples, fitted: DynamicsRegressor) -> None:
    """Where the data tell enough, the prior does not matter: predictions are those of least squares."""
    robot, X = RobotModel.from_urdf(GIVEN), torch.from_numpy(data.X)
    Y = robot.regressor(*X.reshape(-1, 3, 3).transpose(0, 1)).numpy()
    rest = 1e-3 * np.abs(data.X[:, 3:6]).max(0)
    qd = data.X[:, 3:6]
    signs = np.tanh(qd / rest)
    parts = [np.einsum("nj,jk->njk", part, np.eye(3)) for part in (qd, signs, np.abs(signs))]
    noise = fitted.noise_std_[None, :, None]
    A = (np.concatenate((Y, *parts), 2) / noise).reshape(len(X) * 3, -1)
    x = np.linalg.lstsq(A, (data.y / noise[..., 0]).ravel(), rcond=1e-10)[0]
    expected = (A @ x).reshape(-1, 3) * noise[..., 0]
    assert np.abs(fitted.predict(data.X) - expected).max() < 0.005 * data.y.std()
    np.testing.assert_allclose(fitted.noise_std_, 0.01 * data.y.std(0), rtol=0.15)


def test_few_samples_do_no_harm() -> None:
    few, new = samples(2, count=8, friction=0.0), samples(3, noise=0.0, friction=0.0)
    given = DynamicsRegressor(GIVEN, kappa=1e9, friction=False).fit(few.X, few.y)
    np.testing.assert_allclose(given.model_.pi.detach(), given.robot_.pi, rtol=1e-4, atol=1e-5)
    found = DynamicsRegressor(GIVEN, friction=False).fit(few.X, few.y)
    assert 1.0 - found.score(new.X, new.y) < 0.3 * (1.0 - given.score(new.X, new.y))


def test_friction_of_the_urdf_stays_unless_it_is_fitted(data: Samples) -> None:
    urdf = ONE_JOINT.replace("</joint>", '<dynamics damping="0.7" friction="0.3"/></joint>')
    X, model = data.X[:, [0, 3, 6]], torchrbd.RigidBodyDynamics.from_urdf(urdf)
    with torch.no_grad():
        y = model(*torch.from_numpy(X).T.unsqueeze(-1)).numpy()[:, 0]
    for friction in (False, True):
        found = DynamicsRegressor(urdf, friction=friction).fit(X, y).model_
        values = [term.coefficients.detach().numpy()[0] for term in found.terms]
        assert values[:2] == pytest.approx([0.7, 0.3], rel=1e-2 if friction else 1e-9)


def test_trusted_links_and_gravity_are_those_told(data: Samples) -> None:
    found = DynamicsRegressor(GIVEN, trust=["link2"], gravity=(0.0, 0.0, -1.6)).fit(data.X, data.y)
    own = slice(10, 20)
    assert found.robot_.body_names[1] == "link2"
    np.testing.assert_allclose(found.model_.pi.detach()[own], found.robot_.pi[own], rtol=1e-9)
    assert not np.allclose(found.model_.pi.detach()[:10], found.robot_.pi[:10], rtol=1e-3)
    assert found.robot_.gravity.tolist() == [0.0, 0.0, -1.6]
    robot = RobotModel.from_urdf(GIVEN)
    assert DynamicsRegressor(robot).fit(data.X, data.y).robot_ is robot


def test_weights_are_repetitions(data: Samples) -> None:
    rng = np.random.default_rng(1)
    weight = rng.integers(0, 4, len(data.X))
    one = DynamicsRegressor(GIVEN).fit(data.X, data.y, sample_weight=pd.Series(weight))
    other = DynamicsRegressor(GIVEN).fit(np.repeat(data.X, weight, 0), np.repeat(data.y, weight, 0))
    np.testing.assert_allclose(one.predict(data.X), other.predict(data.X), rtol=1e-6, atol=1e-6)
    assert not np.allclose(one.predict(data.X), DynamicsRegressor(GIVEN).fit(data.X, data.y).predict(data.X), 1e-6)


def test_order_of_samples_does_not_matter_and_data_stay_as_they_are(data: Samples, fitted: DynamicsRegressor) -> None:
    order = np.random.default_rng(0).permutation(len(data.X))
    X, y = data.X[order], data.y[order]
    X.setflags(write=False)
    y.setflags(write=False)
    found = DynamicsRegressor(GIVEN)
    assert found.fit(X.tolist(), y.astype(object)) is found
    first = found.predict(data.X)
    np.testing.assert_allclose(first, fitted.predict(data.X), rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(found.fit(X, y).predict(data.X), first)
    single = DynamicsRegressor(GIVEN).fit(data.X.astype(np.float32), data.y.astype(np.float32))
    np.testing.assert_allclose(single.predict(data.X), first, atol=1e-3 * data.y.std())


def test_it_is_cloned_pickled_searched_and_piped(data: Samples, fitted: DynamicsRegressor) -> None:
    robot = RobotModel.from_urdf(GIVEN)
    copied = clone(DynamicsRegressor(robot, kappa=7.0, trust=("link2",)))
    assert copied.get_params() | {"urdf": None} == {
        "urdf": None, "friction": True, "kappa": 7.0, "gravity": None, "trust": ("link2",)
    }  # fmt: skip
    again = pickle.loads(pickle.dumps(fitted))
    np.testing.assert_array_equal(again.predict(data.X), fitted.predict(data.X))
    degrees = FunctionTransformer(np.radians)
    piped = make_pipeline(degrees, DynamicsRegressor(robot)).fit(np.degrees(data.X), data.y)
    np.testing.assert_allclose(piped.predict(np.degrees(data.X)), fitted.predict(data.X), rtol=1e-6, atol=1e-6)
    scores = cross_val_score(DynamicsRegressor(GIVEN), data.X, data.y, cv=KFold(3))
    assert scores.min() > 0.999
    search = GridSearchCV(DynamicsRegressor(GIVEN), {"kappa": [1.0, 1e9], "friction": [False, True]}, cv=2)
    search.fit(data.X, data.y)
    assert search.best_params_ == {"kappa": 1.0, "friction": True}
    assert search.best_estimator_.set_params(kappa=2.0).kappa == 2.0


def test_named_columns_must_be_in_the_robots_order(data: Samples, fitted: DynamicsRegressor) -> None:
    names = [f"{signal}_joint{k}" for signal in ("q", "qd", "qdd") for k in (1, 2, 3)]
    table = pd.DataFrame(data.X, columns=names)
    found = DynamicsRegressor(GIVEN).fit(table, pd.DataFrame(data.y))
    assert found.feature_names_in_.tolist() == names
    np.testing.assert_array_equal(found.predict(table), fitted.predict(data.X))
    with pytest.raises(InputError, match="columns in another order than the robot; expected q_joint1, q_joint2"):
        DynamicsRegressor(GIVEN).fit(table[names[::-1]], data.y)
    with pytest.raises(ValueError, match="feature names"):
        found.predict(table[names[::-1]])


def test_joints_without_torque_are_left_out(data: Samples) -> None:
    y = data.y.copy()
    y[:, 1] = 0.0
    with pytest.warns(UserWarning, match="y: the torque of joint2 never changes and is not used") as told:
        found = DynamicsRegressor(GIVEN).fit(data.X, y)
    assert told[0].filename == __file__
    assert np.isnan(found.noise_std_).tolist() == [False, True, False]
    assert found.score(data.X, np.where([True, False, True], data.y, found.predict(data.X))) > 0.999
    with pytest.raises(InputError, match="y: the torque of joint1, joint2, joint3 never changes"):
        DynamicsRegressor(GIVEN).fit(data.X, 0.0 * y + 1.0)


def test_a_fit_that_stopped_early_says_so(data: Samples, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "torchrbd.learning.dynamics_regressor.fit_model", lambda *args: replace(fit_model(*args), converged=False)
    )
    with pytest.warns(ConvergenceWarning, match="the fit stopped early.*check units and signs") as told:
        DynamicsRegressor(GIVEN).fit(data.X, data.y)
    assert told[0].filename == __file__


@pytest.mark.parametrize(
    ("options", "change", "error", "message"),
    [
        ({}, lambda X, y: (X[:, :-1], y), InputError, r"X has 8 feature\(s\), but robot 'random4' has 3 joints"),
        ({}, lambda X, y: (X, y[:, :2]), InputError, r"y has shape \(400, 2\); expected \(400, 3\)"),
        ({}, lambda X, y: (X, y[:, 0]), InputError, r"y has shape \(400,\); expected \(400, 3\)"),
        ({}, lambda X, y: (X, np.where(y > 1, np.nan, y)), ValueError, "NaN"),
        ({}, lambda X, y: (X, y, -np.ones(len(X))), InputError, "sample_weight: none may be below zero"),
        ({}, lambda X, y: (X, y, np.zeros(len(X))), ValueError, "(?i)weight.*zero"),
        ({}, lambda X, y: (X, y, np.ones(3)), ValueError, "sample_weight.shape"),
        ({"kappa": 0.0}, lambda X, y: (X, y), OptionError, "kappa is 0; expected a number above 0"),
        ({"trust": ["hand"]}, lambda X, y: (X, y), OptionError, "has no moving link 'hand'"),
    ],
)
def test_unusable_input_is_refused(data: Samples, options, change, error, message) -> None:
    with pytest.raises(error, match=message):
        DynamicsRegressor(GIVEN, **options).fit(*change(data.X, data.y))
    with pytest.raises(NotFittedError):
        DynamicsRegressor(GIVEN, **options).predict(data.X)


def test_statistics_are_sums_over_samples() -> None:
    robot = RobotModel.from_urdf(URDF)
    columns = Columns(robot, [effect("asymmetric_coulomb_friction")], [JointScale(3.0, 0.1)] * 3)
    draw = torch.Generator().manual_seed(0)
    states, tau = torch.randn(3, 3, 70, generator=draw).double(), torch.randn(3, 70, generator=draw).double()
    weight = torch.rand(3, 70, generator=draw).double()
    found = given_statistics(columns, states, tau, weight)
    assert len(found) == 64
    Y = robot.regressor(*states.mT)
    for j in range(3):
        total = 0.0
        for k in range(70):
            qd = states[1, j, k]
            extra = {"qd": qd, "sign(qd)": torch.tanh(qd / 0.1), "|sign(qd)|": torch.tanh(qd / 0.1).abs()}
            features = torch.stack([extra[label] for label in columns.labels[j]])
            a = torch.cat((Y[k, j, columns.inertial[j]], features, tau[j, k].reshape(1)))
            total = total + weight[j, k] * torch.outer(a, a)
        torch.testing.assert_close(found.total()[j], total)
        sums = torch.stack((weight[j].sum(), (weight[j] * tau[j]).sum(), (weight[j] * tau[j] ** 2).sum()))
        torch.testing.assert_close(found.torque.sum(0)[j], sums)
