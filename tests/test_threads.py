"""Work on small matrices is done on one thread; what was set before is set again afterwards."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
import torch
from inference.problems import urdf_of
from simulated import record
from threadpoolctl import threadpool_info, threadpool_limits

import torchrbd
from torchrbd._runtime.threads import single_threaded
from torchrbd.recordings import Recording

pytestmark = pytest.mark.usefixtures("fit_alone")

URDF = urdf_of(2, 2)


def numbers() -> tuple[int, list[int]]:
    """Return the threads of torch, and those of every BLAS and OpenMP in this process."""
    return torch.get_num_threads(), [pool["num_threads"] for pool in threadpool_info()]


@pytest.fixture
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    with threadpool_limits(2):
        torch.set_num_threads(2)
        yield
        torch.set_num_threads(before)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return record(URDF, 1, duration_s=15.0)


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize(
    ("work", "options"),
    [
        (torchrbd.identify, {}),
        (torchrbd.compare_estimators, {"estimators": ["physical", "wls"]}),
        (torchrbd.diagnose, {"effects": ["viscous_friction"]}),
    ],
    ids=lambda given: getattr(given, "__name__", ""),
)
def test_work_runs_on_one_thread(work: Callable[..., object], options: dict[str, object], recording: Recording) -> None:
    before, seen = numbers(), []
    work(URDF.encode(), recording, cutoff_hz=5.0, progress=lambda *_: seen.append(numbers()), **options)
    assert seen
    assert all(torch_threads == 1 and set(pools) == {1} for torch_threads, pools in seen)
    assert numbers()[0] == before[0] == 2
    # Libraries that the work itself has loaded come last.
    assert numbers()[1][: len(before[1])] == before[1]


@pytest.mark.usefixtures("two_threads")
def test_an_error_leaves_the_threads_as_they_were(recording: Recording) -> None:
    before = numbers()

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        torchrbd.identify(URDF.encode(), recording, progress=stop)
    with pytest.raises(torchrbd.OptionError):
        torchrbd.diagnose(URDF.encode(), recording, estimator="nonsense")
    assert numbers() == before


@pytest.mark.usefixtures("two_threads")
def test_drawing_robots_runs_on_one_thread(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    posterior = torchrbd.identify(URDF.encode(), recording, cutoff_hz=5.0).posterior
    seen = []
    sample = torchrbd.inference.posterior.posterior.sample_robots
    told = lambda *given, **more: (seen.append(numbers()[0]), sample(*given, **more))[1]  # noqa: E731
    monkeypatch.setattr("torchrbd.inference.posterior.posterior.sample_robots", told)
    posterior.robots(3)
    assert seen == [1]
    assert torch.get_num_threads() == 2


@pytest.mark.usefixtures("two_threads")
def test_one_inside_another_changes_nothing() -> None:
    before = numbers()
    with single_threaded():
        with single_threaded():
            pass
        assert numbers()[0] == 1
    assert numbers() == before
