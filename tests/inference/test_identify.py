"""From a simulated recording to an identified robot."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from inference.problems import urdf_of
from shortened import fit_alone, slow_but
from simulated import Motion, joint_names, record, with_wrong_inertials

from torchrbd.effects import effect
from torchrbd.errors import InputError, OptionError, RecordingError
from torchrbd.inference.identification import Identification
from torchrbd.inference.identify import identify
from torchrbd.inference.physical.fitting import judge, predict
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.parameters import base_parameters, is_physical
from torchrbd.recordings import Recording
from torchrbd.robot import RobotModel

pytestmark = pytest.mark.usefixtures("fit_alone")

URDF = urdf_of(4, 4)
WRONG = with_wrong_inertials(URDF, 1)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return record(URDF, 4)


@pytest.fixture(scope="module")
def found(recording: Recording) -> Identification:
    with fit_alone():
        return identify(WRONG, recording, effects=[])


def saved(recording: Recording, path: Path, *, torque_scale: float = 1.0) -> Path:
    (chunk,) = recording.chunks(10**7)
    tau = torque_scale * chunk.tau
    np.savez(path, t=chunk.t, q=chunk.q, tau=tau, joints=np.array(recording.joints))
    return path


def values(found: Identification) -> np.ndarray:
    return np.array([p.value for p in found.parameters if p.status != "term"])


def test_error_falls_to_the_noise(found: Identification) -> None:
    for joint in found.robot.joint_names:
        urdf, fitted = found.fits["urdf"].nmse[joint], found.fits["rigid_body"].nmse[joint]
        assert fitted < 0.2 * urdf
        assert found.fits["rigid_body"].rmse[joint] == pytest.approx(found.noise[joint].torque, rel=0.5)
    assert found.fits["rigid_body"].mean_nmse < 2e-4
    assert is_physical(torch.from_numpy(values(found)).reshape(-1, 10)).all()


def test_fits_are_those_of_the_held_out_torques(found: Identification) -> None:
    """The figures from block statistics are the figures from the series."""
    series = found.series
    assert 0.15 < series.held_out.mean() < 0.35
    for name, fit in found.fits.items():
        residual = series.residual(name)[series.held_out]
        measured = series.measured[series.held_out]
        for j, joint in enumerate(series.joints):
            assert fit.rmse[joint] == pytest.approx(np.sqrt(np.mean(residual[:, j] ** 2)), rel=1e-5)
            assert fit.nmse[joint] == pytest.approx(np.mean(residual[:, j] ** 2) / measured[:, j].var(), rel=1e-5)


def test_module_is_what_was_fitted(found: Identification) -> None:
    np.testing.assert_allclose(found.model.pi.detach().numpy(), values(found), rtol=1e-7, atol=1e-9)
    names = [p.name for p in found.parameters]
    assert names == list(found.robot.parameter_names)
    assert {p.owner for p in found.parameters} == set(found.robot.body_names)
    np.testing.assert_allclose([p.urdf for p in found.parameters], found.robot.pi.numpy())


def test_status_follows_from_the_robot(found: Identification) -> None:
    base = base_parameters(found.robot)
    for k, p in enumerate(found.parameters):
        expected = "identified" if k in base.alone else "not identifiable" if k in base.invisible else "combination"
        assert p.status == expected
        assert p.std > 0
        assert 0 <= p.prior_share <= 1
    assert found.combinations == base.combinations()


def test_what_no_motion_tells_is_told_by_the_urdf_alone(found: Identification) -> None:
    assert all(p.prior_share > 0.99 for p in found.parameters if p.status == "not identifiable")


def test_base_parameters_are_as_sure_as_they_claim() -> None:
    """(K pi - K pi_true) / std has an RMS near one, over several robots."""
    z = []
    for seed in range(4):
        urdf = urdf_of(seed, 4)
        robot = RobotModel.from_urdf(with_wrong_inertials(urdf, seed))
        prepared = prepare(robot, [record(urdf, seed, torque_noise=0.05, duration_s=60.0)], Settings(), ())
        model = prepared.fit()
        K = base_parameters(robot).combination
        inertial = prepared.prior.inertial
        covariance = K[:, inertial] @ model.covariance[: len(inertial), : len(inertial)] @ K[:, inertial].T
        z.append(K @ (model.pi - RobotModel.from_urdf(urdf).pi) / covariance.diagonal().sqrt())
    errors = torch.cat(z)
    assert 0.3 < float(errors.square().mean().sqrt()) < 2.0
    assert float((errors.abs() < 1.96).double().mean()) > 0.8


def test_base_parameters_come_with_their_matrix_and_covariance(found: Identification) -> None:
    assert found.covariance is not None
    assert found.base_covariance is not None
    K, cov = found.base_combination, found.base_covariance
    np.testing.assert_allclose(K @ values(found), [b.value for b in found.base], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(K @ [p.urdf for p in found.parameters], [b.urdf for b in found.base], atol=1e-12)
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), [b.std for b in found.base], rtol=1e-8)
    np.testing.assert_allclose(cov, K @ found.covariance @ K.T, rtol=1e-8, atol=1e-14 * np.abs(cov).max())


def test_an_estimator_without_intervals_borrows_none(recording: Recording, found: Identification) -> None:
    """Nothing of the default fit's errors is left, and its noise is that of its own torque."""
    ols = identify(WRONG, recording, estimator="ols", trust=["link2"], effects=["viscous_friction"])
    assert (ols.covariance, ols.base_covariance, ols.posterior) == (None, None, None)
    assert found.covariance is not None
    for p in ols.parameters:
        if p.owner == "link2":
            assert (p.value, p.std, p.status, p.prior_share) == (p.urdf, 0.0, "held", 1.0)
        else:
            assert np.isnan(p.std)
            assert p.status in ("term", "not judged", "not identifiable")
            assert np.isnan(p.prior_share)
            assert p.suggestion == ""
    assert all(np.isnan(b.std) and np.isnan(b.prior_share) for b in ols.base)
    residual = ols.series.residual("extended")[~ols.series.held_out]
    for j, joint in enumerate(ols.series.joints):
        assert ols.noise[joint].torque == pytest.approx(np.sqrt(np.mean(residual[:, j] ** 2)), rel=1e-3)
    (told,) = (note for note in ols.notes if "without intervals" in note)
    assert "those of 'ols'" in told


def test_friction_is_fitted_beside_the_inertia() -> None:
    viscous, coulomb = np.array([2.0, 1.0, 0.5, 0.2]), np.array([1.0, 2.0, 0.3, 0.4])

    def friction(m: Motion) -> np.ndarray:
        return viscous * m.qd + coulomb * np.tanh(m.qd / 0.01)

    found = identify(WRONG, record(URDF, 4, extra=friction), effects=["viscous_friction", "coulomb_friction"])
    assert set(found.fits) == {"urdf", "baseline", "rigid_body", "extended"}
    assert found.fits["extended"].mean_nmse < 0.2 * found.fits["rigid_body"].mean_nmse
    terms = {(p.name, p.owner): p for p in found.parameters if p.status == "term"}
    for k, joint in enumerate(joint_names(URDF)):
        for name, truth in (("viscous", viscous[k]), ("coulomb", coulomb[k])):
            p = terms[f"{name}_friction_{joint}.{name}", joint]
            assert abs(p.value - truth) < 4 * p.std + 0.02 * truth
            assert p.std < 0.2 * truth
    assert len(found.model.terms) == 8


def test_module_series_and_statistics_agree_on_terms_that_share_columns(recording: Recording) -> None:
    robot = RobotModel.from_urdf(WRONG)
    robot.damping[0], robot.friction[1] = 0.3, 0.5
    shared = [effect(name) for name in ("joint_spring", "torque_offset", "coulomb_friction", "stribeck_friction")]
    prepared = prepare(robot, [recording], Settings(), shared)
    columns = prepared.columns
    terms = tuple(c for c in columns.candidates if c.joint == 1 or c.effect.id == "torque_offset")
    model = prepared.fit(terms)
    states = next(prepared.tiles(0))
    from_columns = predict(columns, model.x, states)
    from_module = model.module()(states.q.T, states.qd.T, states.qdd.T).T
    torch.testing.assert_close(from_module, from_columns, rtol=1e-6, atol=1e-6 * float(from_columns.abs().max()))
    error = states.decimate(states.tau) - states.decimate(from_columns)
    total = prepared.statistics.squared_error(model.x).sum(0) / prepared.statistics.torque[..., 0].sum(0)
    torch.testing.assert_close(error.square().mean(1), total, rtol=0.2, atol=0)
    assert judge(prepared.judging, model.x).rmse


def test_trusted_links_are_held(recording: Recording) -> None:
    found = identify(WRONG, recording, trust=["link2"])
    for p in found.parameters:
        if p.owner == "link2":
            assert (p.value, p.std, p.status, p.prior_share) == (p.urdf, 0.0, "held", 1.0)
        else:
            assert p.status != "held"


def test_only_the_chosen_joints_count(recording: Recording) -> None:
    found = identify(WRONG, recording, joints=["joint3"])
    assert set(found.fits["urdf"].nmse) == set(found.noise) == {"joint3"}
    seen = ~np.isnan(found.series.measured).all(0)
    assert [j for j, s in zip(found.series.joints, seen, strict=True) if s] == ["joint3"]


def test_time_window(recording: Recording, tmp_path: Path) -> None:
    path = saved(recording, tmp_path / "a.npz")
    whole, part = identify(WRONG, path), identify(WRONG, path, time="5:25")
    assert 5.0 <= part.series.t.min() < part.series.t.max() <= 25.0
    assert whole.series.t.max() > 28.0
    with pytest.raises(RecordingError, match=r"a\.npz"):
        identify(WRONG, path, time="500:600")


def test_time_window_of_an_opened_recording(recording: Recording) -> None:
    with contextlib.suppress(InputError):
        assert identify(WRONG, recording, time=(5.0, 25.0)).series.t.max() <= 25.0


def test_held_out_recordings_are_judged_and_not_fitted(recording: Recording, tmp_path: Path) -> None:
    other = replace(record(URDF, 5, duration_s=15.0), name="other")
    first = saved(recording, tmp_path / "first.npz")
    options = {"cutoff_hz": 5.0}
    one = identify(WRONG, first, holdout=saved(other, tmp_path / "held.npz"), **options)
    two = identify(WRONG, first, holdout=saved(other, tmp_path / "spoilt.npz", torque_scale=3.0), **options)
    assert one.recordings == ("first.npz",)
    assert "held.npz" in one.held_out
    assert (one.series.held_out == (one.series.recording == 1)).all()
    np.testing.assert_allclose(values(one), values(two), rtol=1e-12)
    assert one.fits["rigid_body"].mean_nmse < 1e-3 < 0.1 < two.fits["rigid_body"].mean_nmse
    with pytest.raises(OptionError, match=r"first.npz is both fitted and held out"):
        identify(WRONG, first, holdout=first)


def loaded(urdf: str, link: str) -> str:
    """Fix a point mass of 1.5 kg to a link."""
    load = (
        '<link name="load"><inertial><origin xyz="0.1 -0.05 0.2"/><mass value="1.5"/>'
        '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>'
        f'<joint name="grip" type="fixed"><parent link="{link}"/><child link="load"/></joint>'
    )
    return urdf.replace("</robot>", load + "</robot>")


@pytest.mark.parametrize("kind", slow_but(("tool",), ("body", "tool")))
def test_a_known_payload_is_a_link_with_that_mass(kind: str) -> None:
    urdf = urdf_of(4, 4, fixed=1.0)
    robot = RobotModel.from_urdf(urdf)
    body = robot.body_names[-1]
    link = body if kind == "body" else robot.folded[body][1].name
    recording = record(loaded(urdf, link), 6, name="load.csv")
    rigid: dict = {"effects": []}
    given = identify(urdf, recording, payload=f"load.csv=1.5,0.1,-0.05,0.2@{link}", **rigid)
    merged, ignored = identify(loaded(urdf, link), recording, **rigid), identify(urdf, recording, **rigid)
    for joint in robot.joint_names:
        assert given.fits["urdf"].rmse[joint] == pytest.approx(merged.fits["urdf"].rmse[joint], rel=1e-3)
    assert given.fits["urdf"].mean_nmse < 0.01 * ignored.fits["urdf"].mean_nmse
    assert np.abs(values(given) - robot.pi.numpy()).max() < 0.2


@pytest.mark.slow
def test_a_robot_on_a_wall_falls_along_the_wall() -> None:
    down = (0.0, 9.81, 0.0)
    recording = record(URDF, 4, gravity=down)
    on_the_wall, on_the_floor = identify(URDF, recording, gravity=down), identify(URDF, recording)
    assert on_the_wall.fits["urdf"].mean_nmse < 1e-3 < 0.1 < on_the_floor.fits["urdf"].mean_nmse
    assert any("gravity is (0, 9.81, 0) m/s^2" in note for note in on_the_wall.notes)
    assert not any("gravity" in note for note in on_the_floor.notes)
    assert on_the_wall.model.robot.gravity.tolist() == list(down)


def test_options_that_do_not_fit_are_told(recording: Recording) -> None:
    cases = {
        r"payload for 'x.csv', which is no recording here; there are: simulated": {"payload": "x.csv=1,0,0,0"},
        r"payload on 'hand', which is no moving link of robot 'random4'": {"payload": "simulated=1,0,0,0@hand"},
        r"cut-off 1000 Hz is too high for a recording at 200 Hz": {"cutoff_hz": 1000.0},
        r"cutoff is -1 Hz; expected at least 0.001 Hz": {"cutoff_hz": -1.0},
        r"held.csv: no such file": {"holdout": "held.csv"},
        r"gravity is 'down'; expected three numbers": {"gravity": "down"},
        r"gravity is .*; expected three numbers": {"gravity": (0.0, 9.81)},
        r"gravity is .*; expected three finite numbers": {"gravity": (0.0, np.nan, 0.0)},
    }
    for message, options in cases.items():
        with pytest.raises(InputError, match=message):
            identify(WRONG, recording, **options)
    with pytest.raises(InputError, match="a RobotModel has its own gravity; give it"):
        identify(RobotModel.from_urdf(WRONG), recording, gravity=(0.0, 9.81, 0.0))
    with pytest.raises(InputError, match="no recording to fit"):
        identify(WRONG, [])
    with pytest.raises(InputError, match="two recordings are called 'simulated'"):
        identify(WRONG, [recording, recording])
    with pytest.raises(InputError, match=r"\d blocks of .* are left to fit; at least 6 are needed"):
        identify(WRONG, record(URDF, 4, duration_s=5.0))


def test_friction_that_the_urdf_lacks_is_fitted_unless_told_otherwise(recording: Recording) -> None:
    friction, rigid = identify(URDF, recording), identify(URDF, recording, effects=[])
    named = {p.name.split("_joint")[0] for p in friction.parameters if p.status == "term"}
    assert named == {"viscous_friction", "coulomb_friction", "torque_offset"}
    assert "extended" in friction.fits
    assert set(rigid.fits) == {"urdf", "baseline", "rigid_body"}
    one = identify(URDF, recording, exclude=["coulomb_friction", "torque_offset"])
    assert {p.name.split("_joint")[0] for p in one.parameters if p.status == "term"} == {"viscous_friction"}


def test_a_known_payload_tells_the_gain_of_a_torque_sensor() -> None:
    """Masses known to a third do not tell a gain; a load that is known, in one of two recordings, does."""
    urdf = urdf_of(4, 4, fixed=1.0)
    robot = RobotModel.from_urdf(urdf)
    link = robot.body_names[-1]
    joint, gain = 1, 0.8
    both = []
    for name, real in (("empty.csv", urdf), ("load.csv", loaded(urdf, link))):
        (chunk,) = record(real, 6, name=name).chunks(10**7)
        tau = chunk.tau.copy()
        tau[:, joint] *= gain
        both.append(Recording.from_arrays(name, robot.joint_names, chunk.t, chunk.q, tau))
    wrong = with_wrong_inertials(urdf, 2, size=0.3)
    at = f"torque_scale@{robot.joint_names[joint]}"
    found = identify(wrong, both, payload=f"load.csv=1.5,0.1,-0.05,0.2@{link}", effects=[at])
    (term,) = (t for t in found.model.terms if t.effect.id == "torque_scale")
    assert term.parameters_by_name()["gain"] == pytest.approx(gain, abs=0.01)
