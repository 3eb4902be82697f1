"""How far models stray: of identified robots, where the truth is known, and of made-up windows."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from report.fabricated import identification
from report.rendered import Text, render
from robot.random_robots import random_urdf
from simulated import joint_names, record, with_wrong_inertials

import torchrbd
from torchrbd.dataset.block_statistics import Block
from torchrbd.simulation import MotionError, Spread
from torchrbd.simulation.windows import driving, starts

URDF = random_urdf(21, 2, kinds=("revolute", "prismatic"), branching=0.0, massless=0.0)
FRICTION = np.array([1.5, 2.5])


def rubbed(motion) -> np.ndarray:
    return FRICTION * np.tanh(motion.qd / 1e-3)


@pytest.fixture(scope="module")
def found() -> torchrbd.Identification:
    given = record(URDF, 21, extra=rubbed, torque_noise=0.005, duration_s=40.0)
    return torchrbd.identify(with_wrong_inertials(URDF, 3).encode(), given)


def test_the_better_model_strays_less(found: torchrbd.Identification) -> None:
    """An arm with friction that its URDF lacks: the extended model is nearer than all else at both joints."""
    assert [one.window_s for one in found.simulation] == [0.2, 0.5, 1.0]
    for one in found.simulation:
        assert one.held_out
        assert list(one.errors) == ["urdf", "rigid_body", "extended", "constant_velocity"]
        for joint in found.robot.joint_names:
            medians = {name: spreads[joint].median for name, spreads in one.errors.items()}
            assert medians["extended"] < 0.2 * min(v for name, v in medians.items() if name != "extended")
            for spreads in one.errors.values():
                assert 0 < spreads[joint].low < spreads[joint].median < spreads[joint].high
    short, _, long = (one.errors["extended"] for one in found.simulation)
    assert all(short[joint].median < long[joint].median for joint in found.robot.joint_names)


def test_parameters_json_has_it(found: torchrbd.Identification, tmp_path: Path) -> None:
    from torchrbd.export import write_parameters

    lost = replace(found.simulation[0].errors["urdf"][found.robot.joint_names[0]], high=math.inf)
    errors = {**found.simulation[0].errors, "urdf": {found.robot.joint_names[0]: lost}}
    given = replace(found, simulation=(replace(found.simulation[0], errors=errors), *found.simulation[1:]))
    write_parameters(given, tmp_path / "parameters.json")
    told = json.loads((tmp_path / "parameters.json").read_text())["simulation"]
    first, second = found.robot.joint_names
    sliding = dict(zip(found.robot.joint_names, found.robot.prismatic.tolist(), strict=True))
    assert told[0]["unit"] == {first: "m" if sliding[first] else "rad", second: "m" if sliding[second] else "rad"}
    assert told[0]["errors"]["urdf"][first]["high"] is None
    assert told[2]["errors"]["extended"][first]["median"] == found.simulation[2].errors["extended"][first].median
    assert told[1]["windows"] == {name: found.simulation[1].windows[name] for name in (first, second)}


def test_a_joint_without_torque_moves_as_recorded() -> None:
    given = record(URDF, 22, extra=rubbed, torque_noise=0.005, duration_s=40.0)
    chunk = next(iter(given.chunks(10**6)))
    tau = chunk.tau.copy()
    tau[:, 0] = np.nan
    half = torchrbd.Recording.from_arrays("half", joint_names(URDF), chunk.t, chunk.q, tau)
    found = torchrbd.identify(URDF.encode(), half)
    assert list(found.simulation[0].windows) == joint_names(URDF)[1:]
    spreads = found.simulation[1].errors
    last = joint_names(URDF)[1]
    assert spreads["extended"][last].median < 0.2 * spreads["urdf"][last].median


def test_a_known_load_moves_with_the_robot() -> None:
    """A load like the robot itself, told: it is in the mass that the torque moves, and so the error stays small."""
    robot = torchrbd.RobotModel.from_urdf(URDF.encode())
    link = robot.body_names[-1]
    given = record(URDF, 23, name="loaded", torque_noise=0.002, duration_s=40.0)
    chunk = next(iter(given.chunks(10**6)))
    states = [torch.from_numpy(x) for x in (chunk.q,)]
    motion = torch.gradient(states[0], spacing=float(chunk.t[1] - chunk.t[0]), dim=0)[0]
    again = torch.gradient(motion, spacing=float(chunk.t[1] - chunk.t[0]), dim=0)[0]
    load = torch.zeros_like(robot.pi).reshape(-1, 10)
    load[-1, 0] = 20.0
    extra = robot.inverse_dynamics(states[0], motion, again, load.flatten()).numpy()
    carried = torchrbd.Recording.from_arrays("loaded", joint_names(URDF), chunk.t, chunk.q, chunk.tau + extra)
    found = torchrbd.identify(URDF.encode(), carried, payload=[f"loaded=20,0,0,0@{link}"])
    for joint in robot.joint_names:
        errors = found.simulation[1].errors
        assert errors["urdf"][joint].median < 0.05 * errors["constant_velocity"][joint].median


def test_windows_follow_on_each_other_in_runs() -> None:
    blocks = [Block("a", 0.0, 0.99), Block("a", 1.0, 2.0), Block("a", 5.0, 5.7), Block("b", 0.3, 1.4)]
    assert starts(blocks, 1.0, 9) == [("a", 0.0), ("a", 1.0), ("b", 0.3)]
    assert starts(blocks, 0.5, 9)[3:] == [("a", 1.5), ("a", 5.0), ("b", 0.3), ("b", 0.8)]
    assert starts(blocks, 0.5, 3) == [("a", 0.0), ("a", 1.5), ("b", 0.8)]
    assert starts(blocks, 3.0, 9) == []


def test_torques_keep_their_impulse_and_positions_their_course() -> None:
    t = np.arange(0.0, 1.0, 0.02)
    x = {"q": np.sin(3 * t)[:, None], "qd": 3 * np.cos(3 * t)[:, None], "tau": np.cos(20 * t)[:, None]}
    at = 0.1 + 5e-3 * np.arange(101)
    found = driving(t, x, at)
    np.testing.assert_allclose(found["q"][:, 0], np.sin(3 * at), atol=1e-7)
    fine = np.linspace(at[0], at[-1], 100_001)
    impulse = np.trapezoid(np.interp(fine, t, x["tau"][:, 0]), fine)
    assert float(found["tau"].sum()) * 5e-3 == pytest.approx(impulse, abs=1e-8)


@pytest.mark.usefixtures("without_joint_figures")
def test_the_report_marks_what_is_no_better_than_coasting(tmp_path: Path) -> None:
    names = ("joint1", "slide")

    def at(median: float) -> Spread:
        return Spread(median, 0.5 * median, 2.0 * median)

    errors = {
        "urdf": {"joint1": at(0.02), "slide": Spread(math.inf, 0.5, math.inf)},
        "rigid_body": {"joint1": at(0.0031), "slide": at(0.09)},
        "constant_velocity": {"joint1": at(0.04), "slide": at(0.03)},
    }
    motion = MotionError(0.5, False, {"joint1": 12, "slide": 12}, errors)
    page = render(replace(identification(names), simulation=(motion,)), tmp_path)
    text = " ".join(Text(page).words)
    assert "Motion error: simulation from recorded states under recorded torque" in text
    assert "joint1 20 10–40 3.1 1.6–6.2 40 20–80 mrad" in text
    assert "slide ∞ 500–∞ 90 45–180 30 15–60 mm" in text
    assert "over 12 windows of 0.5 s of held-out data (*: of all data" in text
    assert page.count('class=" worse"') == 1
    assert "Motion" not in " ".join(Text(render(identification(names), tmp_path)).words)
