"""Robots whose torque is that of position drives: friction, rotors and the delay of their set-points."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from likelihood.arms import Torque, arm_urdf, driven_columns, wrong_robot
from simulated import Motion, inverse_dynamics, joint_names

import torchrbd
from torchrbd.cli import main

pytestmark = pytest.mark.usefixtures("fit_alone")

URDF = arm_urdf(0, 2)
VISCOUS, COULOMB, ROTOR, WIDTH = np.array([0.4, 0.2]), np.array([1.0, 0.3]), np.array([0.2, 0.05]), 0.02
KP, KD = np.array([60.0, 25.0]), np.array([2.0, 0.8])
MASS, CENTRE = 4.0, (0.05, 0.2, 0.1)
OPTIONS = {"duration_s": 20.0, "rate_hz": 200.0}


def friction_and_rotors(m) -> np.ndarray:
    return VISCOUS * m.qd + COULOMB * np.tanh(m.qd / WIDTH) + ROTOR * m.qdd


def load(m: Motion) -> np.ndarray:
    """Return the torque of a point mass on the last link, by Pinocchio."""
    model = pin.buildModelFromXML(URDF)
    model.inertias[2] = model.inertias[2] + pin.Inertia(MASS, np.array(CENTRE), np.zeros((3, 3)))
    data = model.createData()
    loaded = np.stack([pin.rnea(model, data, *row).copy() for row in zip(m.q, m.qd, m.qdd, strict=True)])
    return loaded - inverse_dynamics(URDF, m)


def case(folder: Path, delay_s: float, extra: Torque = friction_and_rotors, **drives: Mapping[str, float]) -> Path:
    """Write robot.urdf, map.yaml, fit.csv and test.csv; the URDF's inertias are wrong by a tenth."""
    names = joint_names(URDF)
    for name, seed in (("fit.csv", 2), ("test.csv", 5)):
        columns = driven_columns(URDF, seed, extra, KP, KD, delay_s=delay_s, **OPTIONS)
        pd.DataFrame(columns).to_csv(folder / name, index=False)
    given = {n: {"kp": p, "kd": d} | drives.get(n, {}) for n, p, d in zip(names, KP, KD, strict=True)}
    lines = [f"  {n}: {{drive: {{{', '.join(f'{k}: {v}' for k, v in keys.items())}}}}}" for n, keys in given.items()]
    (folder / "map.yaml").write_text("\n".join([f"set_point_delay: {delay_s}", "joints:", *lines]))
    return folder


@pytest.mark.parametrize("delay_s", [0.0, 0.012])
def test_friction_rotors_and_delay_are_identified_without_a_torque(tmp_path, delay_s):
    folder = case(tmp_path, delay_s)
    robot = wrong_robot(URDF, 1)
    found = torchrbd.identify(robot, folder / "fit.csv", holdout=folder / "test.csv", mapping=folder / "map.yaml")
    assert max(found.fits["extended"].nmse.values()) < 1e-3
    values = {p.name: p for p in found.parameters}
    for k, joint in enumerate(joint_names(URDF)):
        for name, truth in (
            (f"viscous_friction_{joint}.viscous", VISCOUS[k]),
            (f"coulomb_friction_{joint}.coulomb", COULOMB[k]),
        ):
            assert values[name].value == pytest.approx(truth, abs=max(4 * values[name].std, 0.02))
    # At the first joint a rotor and the inertia of the link are one.
    last = values[f"rotor_inertia_{joint_names(URDF)[1]}.rotor_inertia"]
    assert last.value == pytest.approx(ROTOR[1], abs=4 * last.std)


def test_a_saved_model_predicts_the_torque_that_was_reported(tmp_path):
    folder = case(tmp_path, 0.012)
    robot = wrong_robot(URDF, 1)
    found = torchrbd.identify(robot, folder / "fit.csv", holdout=folder / "test.csv", mapping=folder / "map.yaml")
    found.model.save(folder / "model.safetensors")
    again = torchrbd.replay(folder / "model.safetensors", folder / "test.csv", mapping=folder / "map.yaml")
    assert again.nmse == pytest.approx(found.fits["extended"].nmse, rel=1e-6)


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory):
    folder = case(tmp_path_factory.mktemp("driven"), 0.012)
    robot = wrong_robot(URDF, 1)
    return torchrbd.diagnose(robot, folder / "fit.csv", holdout=folder / "test.csv", mapping=folder / "map.yaml")


def test_rotors_of_drives_are_estimated_with_friction(diagnosis):
    found = {(f.effect, f.joints[0]): f for f in diagnosis.findings if f.joints}
    last = joint_names(URDF)[1]
    rotor = found["rotor_inertia", last].parameters["rotor_inertia"]
    assert rotor.value == pytest.approx(ROTOR[1], abs=4 * rotor.std)
    assert {e for e, _ in found} <= {"viscous_friction", "coulomb_friction", "rotor_inertia"}
    assert not diagnosis.unexplained


def unknown(folder: Path, kd: bool = True) -> Path:
    """Write a mapping that leaves the stiffness of both drives open."""
    keys = [f"kp: estimate{f', kd: {d}' if kd else ''}" for d in KD]
    lines = [f"  {name}: {{drive: {{{own}}}}}" for name, own in zip(joint_names(URDF), keys, strict=True)]
    file = folder / f"open{'-kd' if kd else ''}.yaml"
    file.write_text("\n".join(["joints:", *lines]))
    return file


def gains_of(folder: Path, robot: torchrbd.RobotModel | str, **options: object) -> dict[str, torchrbd.recordings.Gain]:
    options = {"mapping": unknown(folder), "holdout": folder / "test.csv"} | options
    return {gain.joint: gain for gain in torchrbd.identify(robot, folder / "fit.csv", **options).gains}


def test_unknown_gains_are_estimated(tmp_path):
    """Bodies of the URDF set the scale: if they are right and certain, so are the gains."""
    folder, names = case(tmp_path, 0.0), joint_names(URDF)
    found = gains_of(folder, URDF)
    sure = gains_of(folder, URDF, trust=torchrbd.RobotModel.from_urdf(URDF).body_names)
    for joint, truth in zip(names, KP, strict=True):
        assert found[joint].kind == "kp"
        assert found[joint].low < truth < found[joint].high
        assert sure[joint].value == pytest.approx(truth, rel=0.01)
        assert 1.0 < sure[joint].high / sure[joint].low < 1.1 < found[joint].high / found[joint].low


def test_gains_of_wrong_bodies_lie_within_their_intervals(tmp_path):
    folder = case(tmp_path, 0.0)
    for seed in range(1, 4):
        found = gains_of(folder, wrong_robot(URDF, seed), mapping=unknown(folder, kd=False))
        for joint, truth in zip(joint_names(URDF), KP, strict=True):
            assert found[joint].low < truth < found[joint].high


def test_a_drive_with_damping_is_at_least_as_stiff_as_its_damping_asks(tmp_path):
    """All friction in proportion to speed is at least kd."""
    folder = case(tmp_path, 0.0)
    free, damped = (gains_of(folder, URDF, mapping=unknown(folder, kd=kd)) for kd in (False, True))
    for joint in joint_names(URDF):
        assert damped[joint].low > free[joint].low


def test_a_known_load_makes_the_gains_more_certain(tmp_path):
    folder = case(tmp_path, 0.0)
    columns = driven_columns(URDF, 7, lambda m: friction_and_rotors(m) + load(m), KP, KD, **OPTIONS)
    pd.DataFrame(columns).to_csv(folder / "load.csv", index=False)
    recordings = [folder / "fit.csv", folder / "load.csv"]
    options = {"mapping": unknown(folder, kd=False), "holdout": folder / "test.csv"}
    told = torchrbd.identify(URDF, recordings, payload=f"load.csv={MASS},{','.join(map(str, CENTRE))}", **options).gains
    alone = gains_of(folder, URDF, mapping=options["mapping"])
    for gain, truth in zip(told, KP, strict=True):
        assert gain.low < truth < gain.high
        assert gain.high / gain.low < alone[gain.joint].high / alone[gain.joint].low


def test_torque_constants_are_estimated_from_currents(tmp_path):
    folder, names, constants = case(tmp_path, 0.0), joint_names(URDF), (0.08, 0.2)
    for file in ("fit.csv", "test.csv"):
        table = pd.read_csv(folder / file)
        for name, kp, kd, constant in zip(names, KP, KD, constants, strict=True):
            error = table.pop(f"q_ref_{name}") - table[f"q_{name}"]
            table[f"i_{name}"] = (kp * error - kd * table[f"qd_{name}"]) / (constant * 50.0)
        table.to_csv(folder / file, index=False)
    signal = "{current: 'i_{joint}', torque_constant: estimate, gear_ratio: 50}"
    (folder / "amps.yaml").write_text(f"joints:\n  '*': {{tau: {signal}}}")
    found = gains_of(folder, URDF, mapping=folder / "amps.yaml", trust=torchrbd.RobotModel.from_urdf(URDF).body_names)
    for name, truth in zip(names, constants, strict=True):
        assert found[name].kind == "torque_constant"
        assert found[name].value == pytest.approx(truth, rel=0.05)


def test_other_commands_ask_for_the_gain(tmp_path):
    folder = case(tmp_path, 0.0)
    robot = wrong_robot(URDF, 1)
    found = torchrbd.identify(robot, folder / "fit.csv", holdout=folder / "test.csv", mapping=unknown(folder))
    assert any("estimated gains" in note for note in found.notes)
    found.model.save(folder / "model.safetensors")
    with pytest.raises(torchrbd.errors.RecordingError, match=r"leaves the gain of .* write the number"):
        torchrbd.replay(folder / "model.safetensors", folder / "test.csv", mapping=unknown(folder))


def test_damping_cannot_be_estimated(tmp_path):
    folder = case(tmp_path, 0.0)
    (folder / "kd.yaml").write_text("joints:\n  '*': {drive: {kp: estimate, kd: estimate}}")
    with pytest.raises(torchrbd.errors.RecordingError, match=r"line 2.*kd.*cannot be distinguished from viscous"):
        torchrbd.identify(URDF, folder / "fit.csv", mapping=folder / "kd.yaml")


def test_robots_are_drawn_for_simulators(tmp_path, capsys):
    """Each of them is physical, and takes set-points; together they scatter as the intervals say."""
    folder = case(tmp_path, 0.0)
    (folder / "robot.urdf").write_text(URDF)
    run = ["identify", str(folder / "robot.urdf"), str(folder / "fit.csv"), "--mapping", str(folder / "map.yaml")]
    assert main([*run, "-o", str(folder / "out")]) == 0
    drawn = ["export", str(folder / "out"), "--to", "mjcf", "--samples", "40", "--seed", "3", "-o", str(folder / "all")]
    assert main(drawn) == 0
    files = sorted((folder / "all").glob("robot_*.xml"))
    assert len(files) == 40
    machines = [mujoco.MjModel.from_xml_path(str(file)) for file in files]
    bodies = torchrbd.RobotModel.from_urdf(URDF).body_names
    for machine in machines:
        assert machine.actuator_gainprm[:, 0].tolist() == KP.tolist()
        assert all(machine.body(name).mass > 0 for name in bodies)
    found = torchrbd.Identification.load(folder / "out")
    last = joint_names(URDF)[1]
    (rotor,) = (p for p in found.parameters if p.name == f"rotor_inertia_{last}.rotor_inertia")
    armature = np.array([m.dof_armature[1] for m in machines])
    assert armature.mean() == pytest.approx(rotor.value, abs=rotor.std)
    assert armature.std() == pytest.approx(rotor.std, rel=0.4)
    assert main([*drawn[:-2], "-o", str(folder / "again")]) == 0
    assert [f.read_bytes() for f in files] == [f.read_bytes() for f in sorted((folder / "again").glob("*.xml"))]
    capsys.readouterr()
    assert main(["export", str(folder / "out"), "--to", "mjcf", "--samples", "0", "-o", str(folder / "none")]) == 2
    assert "--samples: expected 1 to 10000, got 0" in capsys.readouterr().err
    assert main([*drawn[:-1], str(folder / "map.yaml")]) == 2
    assert "is a file; with --samples name a folder" in " ".join(capsys.readouterr().err.split())


def test_torques_far_beyond_the_urdfs_limit_are_improbable(tmp_path):
    folder, mapping = case(tmp_path, 0.0), unknown(tmp_path, kd=False)
    weak, strong = torchrbd.RobotModel.from_urdf(URDF), torchrbd.RobotModel.from_urdf(URDF)
    for robot, limit in ((weak, 5.0), (strong, 1e6)):
        robot.effort.fill_(limit)
    less, more = (gains_of(folder, robot, mapping=mapping) for robot in (weak, strong))
    for joint in joint_names(URDF):
        assert less[joint].high <= more[joint].high
    assert less[joint_names(URDF)[0]].high < 0.98 * more[joint_names(URDF)[0]].high
