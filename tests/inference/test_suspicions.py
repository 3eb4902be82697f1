"""Tables that do not mean what they say are suspected of what is wrong with them, and no others are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import real_recordings as real
import torch
import yaml
from robot.random_robots import random_urdf
from shortened import slow_but
from simulated import joint_names, record, with_wrong_inertials

import torchrbd
from torchrbd.inference.identify import read_arguments
from torchrbd.inference.preparation import prepare
from torchrbd.inference.suspicions import Suspicions, suspicions
from torchrbd.recordings import Recording, read_mapping

Arrays = dict[str, np.ndarray]
URDF = random_urdf(21, 3, kinds=("revolute",), branching=0.0, massless=0.0)
NAMES = joint_names(URDF)
DEMO = Path(torchrbd.__file__).parent / "demo"
DATA = real.data_folder()
needs_data = pytest.mark.skipif(DATA is None, reason="TORCHRBD_DATA names no folder of real recordings")


@cache
def arrays() -> Arrays:
    """A recording with friction that the URDF lacks."""
    recording = record(URDF, 21, extra=lambda motion: 0.7 * np.sign(motion.qd), duration_s=20.0)
    chunk = next(iter(recording.chunks(10**6)))
    return {"t": chunk.t, "q": chunk.q, "tau": chunk.tau}


def suspected(robot, recordings, **options) -> Suspicions:
    robot, sources, settings = read_arguments(robot, recordings, options, "test")
    return suspicions(prepare(robot, sources, settings, ()))


def of(changed: Arrays, urdf: str = URDF) -> Suspicions:
    """Suspect a recording with some arrays changed, of a URDF whose inertials are wrong."""
    given = Recording.from_arrays("day", NAMES, **{**arrays(), **changed})
    return suspected(with_wrong_inertials(urdf, 21, 0.2), given, cutoff_hz=4.0)


def times(signal: str, factor: float, *joints: int) -> Arrays:
    found = arrays()[signal].copy()
    found[:, list(joints)] *= factor
    return {signal: found}


def exchanged(*signals: str) -> Arrays:
    return {s: arrays()[s][:, [0, 2, 1]] for s in signals}


WRONG: Mapping[str, tuple[Callable[[], Arrays], str, tuple[str, ...], str]] = {
    "degrees": (lambda: times("q", 180 / np.pi, 0, 1, 2), "degrees", (), '{q: {column: "q_{joint}", unit: deg}}'),
    "degrees of one": (lambda: times("q", 180 / np.pi, 1), "degrees", ("joint2",), "unit: deg"),
    "torque": (lambda: times("tau", -1, 0, 1, 2), "torque sign", (), '"*": {tau: {column: "tau_{joint}", sign: -1}}'),
    "torque of one": (lambda: times("tau", -1, 2), "torque sign", ("joint3",), "{column: tau_joint3, sign: -1}"),
    "torques": (lambda: exchanged("tau"), "swapped torques", ("joint2", "joint3"), "joint2: {tau: tau_joint3}"),
    "positions": (lambda: exchanged("q"), "swapped positions", ("joint2", "joint3"), "joint3: {q: q_joint2}"),
    "joints": (lambda: exchanged("q", "tau"), "swapped joints", ("joint2", "joint3"), "{tau: tau_joint3, q: q_joint3}"),
    "currents": (lambda: times("tau", 0.07, 0, 1, 2), "torque gain", tuple(NAMES), "torque_constant"),
    "mN m": (lambda: times("tau", 1000.0, 0, 1, 2), "torque gain", tuple(NAMES), "unit: mN m"),
    "own currents": (
        lambda: {"tau": arrays()["tau"] * np.array([0.01, 0.05, 0.2])}, "torque gain", tuple(NAMES), "torque_constant"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", slow_but(("degrees", "torque of one", "joints", "currents"), WRONG))
def test_what_is_wrong_is_suspected(name: str) -> None:
    change, kind, joints, remedy = WRONG[name]
    found = of(change())
    (one,) = found.found
    assert (one.kind, one.joints) == (kind, joints)
    assert remedy in one.remedy
    assert found.settles


@pytest.mark.parametrize("constants", slow_but([((20.0, 20.0, 20.0),)], [((20.0, 20.0, 20.0),), ((8.0, 40.0, 5.0),)]))
@pytest.mark.parametrize(
    "now", ["", 'joints: {"*": {tau: {current: "tau_{joint}", torque_constant: 1, gear_ratio: 2}}}']
)
def test_constants_of_currents_are_proposed(constants: tuple[float, ...], now: str, tmp_path: Path) -> None:
    """The motor's constants are not known: the URDF's masses tell them well enough to begin with."""
    current = arrays()["tau"] / np.array(constants)
    (tmp_path / "now.yaml").write_text(now or "{}")
    given = {"mapping": tmp_path / "now.yaml", "cutoff_hz": 4.0}
    urdf, file = with_wrong_inertials(URDF, 21, 0.2), tmp_path / "day.csv"
    columns = table({**arrays(), "tau": current})
    np.savetxt(file, np.column_stack([*columns.values()]), "%.12g", ",", header=",".join(columns), comments="")
    found = suspected(urdf, file, **given).found
    assert found[-1].kind == "torque gain"
    said = found[-1].remedy
    proposed = yaml.safe_load(said.split("'")[1])["joints"]
    (tmp_path / "then.yaml").write_text(said.split("'")[1])
    mapping = read_mapping(tmp_path / "then.yaml")
    for j, (name, constant) in enumerate(zip(NAMES, constants, strict=True)):
        assert mapping.source(name, j, "tau").scale == pytest.approx(constant, rel=0.5)
        assert mapping.source(name, j, "tau").column == f"tau_{name}"
    assert ("*" in proposed) == (len(set(constants)) == 1)
    assert "N m/A" in said
    assert "torque_constant and gear_ratio of the data sheet" in said
    given["mapping"] = tmp_path / "then.yaml"
    assert suspected(urdf, file, **given).found == ()


@pytest.mark.parametrize(("unit", "factor"), slow_but([("us", 1e6)], [("ms", 1e3), ("us", 1e6), ("ns", 1e9)]))
def test_time_in_another_unit(unit: str, factor: float) -> None:
    given = Recording.from_arrays("day", NAMES, **{**arrays(), "t": factor * arrays()["t"]})
    (one,) = suspected(URDF, given).found
    assert one.kind == "time unit"
    assert f"time: {{column: t, unit: {unit}}}" in one.remedy


@pytest.mark.slow
def test_two_mistakes_are_told_one_after_the_other() -> None:
    found = of({**times("q", 180 / np.pi, 0, 1, 2), **times("tau", -1, 2)}).found
    assert {one.kind for one in found} == {"degrees", "torque sign"}


@pytest.mark.slow
def test_gravity_upside_down() -> None:
    given = Recording.from_arrays("day", NAMES, **arrays())
    (one,) = suspected(URDF, given, gravity=[0.0, 0.0, 9.81]).found
    assert one.kind == "gravity"
    assert "--gravity 0 0 -9.81" in one.remedy


def test_a_mapping_that_converts_without_need(tmp_path: Path) -> None:
    """Positions in rad that are read as degrees."""
    (tmp_path / "map.yaml").write_text('joints: {"*": {q: {column: "q_{joint}", unit: deg}}}')
    given = torchrbd.open_recording(table(arrays()), NAMES, mapping=read_mapping(tmp_path / "map.yaml"), name="day")
    (one,) = suspected(URDF, given).found
    assert one.kind == "radians"
    assert "unit: rad" in one.remedy


def table(of: Arrays) -> Arrays:
    return {"t": of["t"]} | {f"{s}_{n}": of[s][:, k] for s in ("q", "tau") for k, n in enumerate(NAMES)}


@pytest.mark.parametrize(
    ("now", "entry"),
    [
        ("", "{column: tau_joint3, sign: -1}"),
        ("{joints: {joint3: {tau: {column: tau_joint3, sign: -1}}}}", "{column: tau_joint3, sign: 1}"),
        (
            "{joints: {joint3: {tau: {current: tau_joint3, torque_constant: 0.25, offset: 0.5}}}}",
            "{column: tau_joint3, scale: -0.25, offset: -0.5}",
        ),
    ],
    ids=["none", "a sign", "a current"],
)
def test_the_remedy_mends(tmp_path: Path, now: str, entry: str) -> None:
    """What a mapping converts already stays converted."""
    read = arrays()["tau"][:, 2]
    column = {"": -read, "sign": read, "current": -(read + 0.5) / 0.25}[
        next((k for k in ("sign", "current") if k in now), "")
    ]
    flipped = {**table(arrays()), "tau_joint3": column}
    (tmp_path / "now.yaml").write_text(now or "{}")
    (one,) = suspected(URDF, flipped, mapping=tmp_path / "now.yaml").found
    assert one.statement.startswith("tau_joint3 fits ")
    assert entry in one.remedy
    (tmp_path / "map.yaml").write_text(one.remedy.split("'")[1])
    assert suspected(URDF, flipped, mapping=tmp_path / "map.yaml").found == ()


def test_alternatives_that_the_motion_does_not_tell_apart_are_named() -> None:
    """A slide without gravity: a flipped torque is a flipped position."""
    urdf = random_urdf(5, 1, kinds=("prismatic",), branching=0.0, massless=0.0)
    chunk = next(iter(record(urdf, 5, duration_s=20.0, gravity=(0.0, 0.0, 0.0)).chunks(10**6)))
    given = Recording.from_arrays("day", joint_names(urdf), chunk.t, chunk.q, -chunk.tau)
    (one,) = suspected(urdf, given, gravity=[0.0, 0.0, 0.0]).found
    assert one.kind == "torque sign"
    assert [(other.kind, other.joints) for other in one.alternatives] == [("position sign", ("joint1",))]


def test_joints_that_cannot_be_told_apart_are_not_suspected_of_being_swapped() -> None:
    """Three slides with one axis and one mass, exchanged: nobody can tell."""
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="l{k}">{body}</link>' for k in range(3))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="base"/><child link="l{k}"/><axis xyz="0 0 1"/>'
        '<limit lower="-9" upper="9" effort="99" velocity="9"/></joint>'
        for k in range(3)
    )
    urdf = f'<robot name="twins"><link name="base"/>{links}{joints}</robot>'
    chunk = next(iter(record(urdf, 1, duration_s=20.0).chunks(10**6)))
    both = {"q": chunk.q[:, [1, 0, 2]], "tau": chunk.tau[:, [1, 0, 2]]}
    assert suspected(urdf, Recording.from_arrays("day", joint_names(urdf), chunk.t, **both)).found == ()


def test_a_speed_that_no_reading_mends() -> None:
    """The URDF allows a hundredth of what the robot does."""
    slow = URDF.replace('velocity="5', 'velocity="0.005')
    assert slow != URDF
    given = Recording.from_arrays("day", NAMES, **arrays())
    found = suspected(slow, given).found
    assert [one.kind for one in found] == ["speed"]
    assert "joint1" in found[0].statement


@pytest.mark.parametrize("seed", slow_but((100,), (7, 31, 100)))
def test_right_tables_are_not_suspected(seed: int) -> None:
    urdf = random_urdf(seed, 3 + seed % 4, kinds=("revolute", "prismatic"), branching=0.2, massless=0.0)
    extra = lambda motion: 2.0 * np.sign(motion.qd) + 3.0 * (motion.q - 0.4)  # noqa: E731
    recording = record(urdf, seed, extra=extra, duration_s=20.0)
    for given in (urdf, with_wrong_inertials(urdf, seed, 0.4)):
        assert suspected(given, recording).found == ()


@pytest.mark.slow
def test_springs_are_not_another_gravity() -> None:
    """Springs at slides are imitated by joints that gravity turns, if it is along another axis."""
    urdf = random_urdf(304, 7, kinds=("revolute", "prismatic"), branching=0.2, massless=0.0)
    recording = record(urdf, 4, extra=lambda motion: 2.0 * np.sign(motion.qd) + 3.0 * (motion.q - 0.4), duration_s=20.0)
    assert suspected(urdf, recording).found == ()


@pytest.mark.slow
@pytest.mark.parametrize("samples", [1, -2])
def test_torques_of_another_sample(samples: int, tmp_path: Path) -> None:
    """They are said, leave no doubt, and the mapping that is told reads them with their motion."""
    late = {**table(arrays()), **{f"tau_{n}": np.roll(arrays()["tau"][:, k], samples) for k, n in enumerate(NAMES)}}
    late = {name: column[5:-5] for name, column in late.items()}
    found = torchrbd.identify(URDF, late)
    (one,) = found.suspicions.found
    way = "1 sample later" if samples == 1 else "2 samples earlier"
    assert one.statement.startswith(f"the torques are {way} than the motion (")
    assert not one.settles
    assert found.doubts == ()
    assert one.words in found.notes
    (tmp_path / "map.yaml").write_text(one.remedy.split("'")[1])
    mended = torchrbd.identify(URDF, late, mapping=tmp_path / "map.yaml")
    assert mended.suspicions.found == ()
    assert "late torque" in mended.suspicions.tested


def test_a_torque_that_is_cut_off() -> None:
    tau = arrays()["tau"].copy()
    limit = 0.6 * np.abs(tau[:, 1]).max()
    tau[:, 1] = np.clip(tau[:, 1], -limit, limit)
    urdf = with_wrong_inertials(URDF, 21, 0.2)
    given = torchrbd.identify(urdf, Recording.from_arrays("day", NAMES, **{**arrays(), "tau": tau}), cutoff_hz=4.0)
    (one,) = given.suspicions.found
    assert (one.kind, one.joints, one.settles) == ("clipped torque", ("joint2",), False)
    assert f"tau_joint2 is cut off at {limit:.4g} N m" in one.statement or f"{-limit:.4g} N m" in one.statement
    assert given.verdict == "doubtful"
    assert one.words in given.doubts
    emptied = tau.copy()
    emptied[np.abs(tau[:, 1]) >= limit * (1 - 1e-9), 1] = np.nan
    assert (
        suspected(urdf, Recording.from_arrays("day", NAMES, **{**arrays(), "tau": emptied}), cutoff_hz=4.0).found == ()
    )


@pytest.mark.slow
def test_an_actuator_at_its_limit_is_not_cut_off() -> None:
    """Its torque is what moves the arm, also where it is no more than the limit."""
    robot, dt = torchrbd.RobotModel.from_urdf(URDF), 1e-3
    holding = robot.inverse_dynamics(*torch.zeros(3, 3, dtype=torch.float64)).abs()
    limit, rows = 1.2 * holding + 2.0, []
    q, qd = torch.zeros(2, 3, dtype=torch.float64)
    for k in range(25_000):
        wanted = torch.tensor([np.sin(0.9 * k * dt), np.cos(0.6 * k * dt), np.sin(1.3 * k * dt)])
        tau = (60.0 * (wanted - q) - 4.0 * qd).clamp(-limit, limit)
        rows.append(torch.cat((q, tau)))
        qd = qd + dt * robot.forward_dynamics(q, qd, tau)
        q = q + dt * qd
    table = torch.stack(rows)[::5].numpy()
    tau = table[:, 3:]
    assert (np.abs(tau) >= limit.numpy()).mean(axis=0).max() > 0.05
    q = table[:, :3] + 1e-5 * np.random.default_rng(0).standard_normal((len(table), 3))
    assert suspected(URDF, Recording.from_arrays("day", NAMES, 5 * dt * np.arange(len(table)), q, tau)).found == ()


def test_the_demo_is_not_suspected() -> None:
    found = suspected(DEMO / "arm.urdf", DEMO / "fit.parquet", holdout=DEMO / "holdout.parquet")
    assert found.found == ()


def real_cases() -> list[tuple[str, list[str], dict]]:
    """The jobs that the README and the examples do with real recordings."""
    cases: list[tuple[str, list[str], dict]] = [
        ("kuka_kr300", ["A.csv", "B.csv"], {"holdout": ["C.csv"]}),
        ("kuka_kr300", ["A.csv"], {}),
        ("emps", ["train.csv"], {"holdout": ["pulses.csv"], "cutoff_hz": 20.0}),
        ("panda", ["exciting_traj.csv"], {}),
        ("dfki_pendulum", ["fft_swing_100s.csv", "energy_shaping.csv", "sac.csv"], {}),
    ]
    return cases


@needs_data
@pytest.mark.parametrize(("folder", "files", "options"), slow_but(real_cases()[2:3], real_cases()))
def test_real_recordings_are_not_suspected(folder: str, files: list[str], options: dict) -> None:
    assert DATA is not None
    at = DATA / folder
    held = {"holdout": [at / f for f in options["holdout"]]} if "holdout" in options else {}
    found = suspected(at / "robot.urdf", [at / f for f in files], **{**options, **held})
    assert found.found == ()


@needs_data
@pytest.mark.parametrize(("one", "other"), [("A1", "A2"), ("A3", "A5"), ("A4", "A6")])
@pytest.mark.slow
def test_exchanged_torques_of_one_short_real_recording(one: str, other: str, tmp_path: Path) -> None:
    """Ten seconds, and as a mapping does it."""
    assert DATA is not None
    at = DATA / "kuka_kr300"
    entries = f"{one}: {{tau: tau_{other}}}, {other}: {{tau: tau_{one}}}"
    (tmp_path / "map.yaml").write_text(f"joints: {{{entries}}}")
    (found,) = suspected(at / "robot.urdf", at / "A.csv", mapping=tmp_path / "map.yaml").found
    assert (found.kind, found.joints) == ("swapped torques", (one, other))
    assert f"{one}: {{tau: tau_{one}}}" in found.remedy


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize("name", ["C_20220914_172144_acrobot_lqr.csv", "C_20220914_184506_acrobot_tvlqr.csv"])
def test_a_joint_that_is_not_driven_is_not_suspected(name: str) -> None:
    """Its torque is none, and of no other joint or unit."""
    assert DATA is not None
    at = DATA / "dfki_double_pendulum"
    assert suspected(at / "robot_C.urdf", at / name).found == ()


@needs_data
@pytest.mark.parametrize(
    ("design", "of_design"), slow_but([("C", "A")], [("A", "A"), ("A", "C"), ("C", "A"), ("C", "C")])
)
def test_double_pendulums_are_not_suspected(design: str, of_design: str) -> None:
    assert DATA is not None
    at = DATA / "dfki_double_pendulum"
    files = [f for f in sorted(at.glob(f"{of_design}_*.csv")) if f.stat().st_size > 300_000][:5]
    found = suspected(at / f"robot_{design}.urdf", files[:-1], holdout=files[-1:], cutoff_hz=8.0)
    assert found.found == ()


@needs_data
@pytest.mark.slow
def test_real_recordings_that_are_spoilt_are_suspected() -> None:
    assert DATA is not None
    at = DATA / "kuka_kr300"
    names = [f"A{k}" for k in range(1, 7)]

    def spoilt(name: str, change: Callable[[Arrays], Arrays]) -> Recording:
        chunk = next(iter(torchrbd.open_recording(at / name, names).chunks(10**6)))
        plain = {"t": chunk.t, "q": chunk.q, "tau": chunk.tau}
        return Recording.from_arrays(name, names, **{**plain, **change(plain)})

    for change, kind in (
        (lambda a: {"q": np.rad2deg(a["q"])}, "degrees"),
        (lambda a: {"tau": -a["tau"]}, "torque sign"),
        (lambda a: {"tau": a["tau"][:, [5, 1, 2, 3, 4, 0]]}, "swapped torques"),
    ):
        day, night = spoilt("A.csv", change), spoilt("C.csv", change)
        assert [one.kind for one in suspected(at / "robot.urdf", day, holdout=night).found] == [kind]
