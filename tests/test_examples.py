"""The examples of pipelines do what they say: each returns a number that shows it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch

pytestmark = pytest.mark.usefixtures("fit_alone")

FOLDER = Path(__file__).parent.parent / "examples" / "pipelines"
TRUTH = 2.4  # N m at joint3 of the bundled arm


@pytest.fixture(autouse=True)
def one_thread(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The tensors are small: threads only wait for each other, for long where cores are busy."""
    monkeypatch.syspath_prepend(FOLDER)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def example(name: str, library: str | None = None) -> ModuleType:
    """Import an example as Python does that runs it; skip where a library that it needs is not installed."""
    if library is not None:
        pytest.importorskip(library, reason=f"{library} is not installed: pip install torchrbd[examples]")
    return import_module(name)


def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return capsys.readouterr().out.splitlines()


def friction_in(line: str) -> float:
    (found,) = re.findall(r"Coulomb friction at joint3: (\S+) N m, 2.4 in truth", line)
    return float(found)


def test_each_example_has_its_test() -> None:
    tested = {"torch_loop", "ensemble", "computed_torque", "contact_detection", "gymnasium_env", "lightning_fit"}
    tested |= {"residual_network", "actuator_network"}
    assert {path.stem for path in FOLDER.glob("*.py")} == tested


def test_a_torch_loop_learns_inertia_and_friction(capsys: pytest.CaptureFixture[str]) -> None:
    """The error is that of a fit without friction, 0.025 of the URDF's, only if friction is not learnt."""
    assert example("torch_loop").main() < 0.005
    error, friction = lines(capsys)
    assert error.startswith("held-out nmse: 0.09")
    assert friction_in(friction) == pytest.approx(TRUTH, rel=0.03)


def test_robots_of_an_ensemble_agree_on_what_the_recording_tells(capsys: pytest.CaptureFixture[str]) -> None:
    left, friction, spread = example("ensemble").main()
    assert left < 0.005
    assert friction == pytest.approx(TRUTH, rel=0.03)
    assert 1e-4 < spread < 0.1
    assert len(lines(capsys)) == 2


def test_friction_in_the_controller_tracks_better(capsys: pytest.CaptureFixture[str]) -> None:
    assert example("computed_torque").main() < 0.2
    assert len(lines(capsys)) == 2


def test_contact_is_seen_and_nothing_else(capsys: pytest.CaptureFixture[str]) -> None:
    seen, false = example("contact_detection").main()
    assert seen > 0.95
    assert false < 0.02
    assert len(lines(capsys)) == 2


@pytest.mark.slow
def test_a_network_learns_what_physics_lacks(capsys: pytest.CaptureFixture[str]) -> None:
    assert example("residual_network").main() < 0.8
    assert len(lines(capsys)) == 2


@pytest.mark.filterwarnings("ignore:.*torch.jit.load:DeprecationWarning")  # what Isaac Lab calls
def test_a_drive_is_learnt_for_mujoco(capsys: pytest.CaptureFixture[str]) -> None:
    assert example("actuator_network", "mujoco").main() < 0.3
    assert len(lines(capsys)) == 2


def test_arms_drawn_at_random_are_controlled(capsys: pytest.CaptureFixture[str]) -> None:
    gym = example("gymnasium_env", "gymnasium")
    assert gym.main(1) < 0.1
    assert len(lines(capsys)) == 1


def test_the_environment_keeps_gymnasiums_contract() -> None:
    gym = example("gymnasium_env", "gymnasium")
    checker: Any = import_module("gymnasium.utils.env_checker")
    environment = gym.Reach()
    checker.check_env(environment, skip_render_check=True)
    masses = set()
    for seed in (0, 1, 0):
        environment.reset(seed=seed)
        masses.add(environment.model.pi.detach().sum().item())
    assert len(masses) == 2, "another robot for another seed, the same for the same"


# Of Lightning's own: a name of torch's that is to go, and advice on workers for its loaders.
@pytest.mark.filterwarnings(
    "ignore:.*LeafSpec.*", "ignore:.*does not have many workers.*", "ignore:.*log_every_n_steps.*"
)
def test_lightning_trains_the_same(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: Any) -> None:
    fit = example("lightning_fit", "lightning")
    monkeypatch.chdir(tmp_path)
    assert fit.main() < 0.005
    assert friction_in(lines(capsys)[1]) == pytest.approx(TRUTH, rel=0.03)
    assert list(tmp_path.iterdir()) == []
