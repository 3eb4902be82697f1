"""A robot is identified from tables and arrays as it is from opened recordings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from inference.problems import urdf_of
from simulated import record, with_wrong_inertials

import torchrbd
from torchrbd.errors import OptionError, RecordingError
from torchrbd.inference.data.opening import open_all, open_simulated
from torchrbd.inference.settings import Settings
from torchrbd.recordings import Recording, listed_sources
from torchrbd.robot import RobotModel

pytestmark = pytest.mark.usefixtures("fit_alone")

URDF = urdf_of(2, 4)
GIVEN = with_wrong_inertials(URDF, 1)
MOTION = {"duration_s": 12.0, "rate_hz": 125.0}
FIRST, SECOND = (record(URDF, seed, name=f"seed {seed}", **MOTION) for seed in (1, 2))
ROBOT = RobotModel.from_urdf(GIVEN)


def arrays(recording: Recording) -> dict[str, Any]:
    (chunk,) = recording.chunks(10**7)
    return {"t": chunk.t, "q": chunk.q, "tau": chunk.tau, "joints": recording.joints}


def table(recording: Recording) -> pd.DataFrame:
    data = arrays(recording)
    columns = {f"{key}_{j}": data[key][:, k] for key in ("q", "tau") for k, j in enumerate(recording.joints)}
    return pd.DataFrame({"t": data["t"], **columns})


def test_an_identification_from_memory_is_that_from_recordings() -> None:
    one = torchrbd.identify(GIVEN, [FIRST], holdout=SECOND, effects=[])
    other = torchrbd.identify(GIVEN, table(FIRST), holdout=arrays(SECOND), effects=[])
    assert (other.recordings, other.held_out) == (("recording 1",), "held-out recording 1")
    assert other.fits == one.fits
    assert other.parameters == one.parameters


def test_a_ranking_does_not_look_at_data_that_are_held_out() -> None:
    loud = table(SECOND)
    loud.iloc[:, -1] *= 100.0
    some = {"effects": ["rotor_inertia"]}
    one, other = (
        torchrbd.rank_hypotheses(GIVEN, FIRST, **some),
        torchrbd.rank_hypotheses(GIVEN, table(FIRST), holdout=[loud], **some),
    )
    assert [h.log_evidence for h in other.first] == [h.log_evidence for h in one.first]


def test_payloads_name_data_by_their_place() -> None:
    given = torchrbd.identify(GIVEN, [arrays(FIRST), table(SECOND)], effects=[], payload="recording 2=0.5,0,0,0.1")
    assert given.recordings == ("recording 1", "recording 2")
    with pytest.raises(OptionError, match="payload for 'recording 3', which is no recording here"):
        torchrbd.identify(GIVEN, [arrays(FIRST)], effects=[], payload="recording 3=0.5,0,0,0.1")


def test_data_are_given_once() -> None:
    data = table(FIRST)
    both = Settings.from_mapping({"holdout": data}, "test")
    with pytest.raises(OptionError, match="held-out recording 1 is both fitted and held out"):
        open_all(ROBOT, [data], both)
    with pytest.raises(RecordingError, match="recording 1 and recording 3 are the same"):
        open_all(ROBOT, [data, FIRST, data], Settings())
    assert len(open_all(ROBOT, [data, data.copy()], Settings())) == 2


def test_a_simulation_may_lie_in_memory() -> None:
    settings = Settings.from_mapping({"simulated": [table(FIRST)]}, "test")
    (one,) = open_simulated(ROBOT, settings, [FIRST])
    np.testing.assert_array_equal(next(one.chunks()).q, next(FIRST.chunks()).q)
    assert one.name == "simulated recording 1"


def test_unusable_data_are_named() -> None:
    data = table(FIRST)
    data.loc[7, "t"] = -1.0
    with pytest.raises(RecordingError, match=r"^recording 2: data row 8: time goes backwards"):
        torchrbd.identify(GIVEN, [FIRST, data])
    with pytest.raises(RecordingError, match=r"^held-out recording 1: missing columns: t, q_"):
        torchrbd.identify(GIVEN, FIRST, holdout={"time": [0.0]})
    with pytest.raises(RecordingError, match=r"^recording 1 is of type ndarray; expected a file"):
        torchrbd.diagnose(GIVEN, [np.zeros((3, 3))])
    assert listed_sources([]) == []
    with pytest.raises(OptionError, match="no recording to fit"):
        torchrbd.identify(GIVEN, [])
