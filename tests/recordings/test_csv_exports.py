"""CSV files as spreadsheets, PlotJuggler and ROS write them; what is ambiguous is refused, never misread."""

import numpy as np
import pytest
from recordings.motion import JOINTS, motion, torque

from torchrbd.errors import RecordingError
from torchrbd.recordings import Mapping, open_recording, survey

CLOCK = np.arange(0, 2, 0.01)
Q, QD, _ = motion(CLOCK)
TAU = torque(CLOCK)
HEADER = "t,q_a,q_b,tau_a,tau_b"
SEMI = HEADER.replace(",", ";")


def is_the_motion(path, atol=1e-9, **options):
    chunks = list(open_recording(path, JOINTS, **options).chunks(64))
    for name, expected in (("t", CLOCK), ("q", Q), ("tau", TAU)):
        np.testing.assert_allclose(np.concatenate([getattr(chunk, name) for chunk in chunks]), expected, atol=atol)


def spreadsheet(separator, decimal, quote="", head=""):
    """Return the motion as a spreadsheet writes it."""
    rows = np.column_stack([CLOCK, Q, TAU])
    lines = (separator.join(quote + f"{x:.12f}".replace(".", decimal) + quote for x in row) for row in rows)
    return head + separator.join(["t", "q_a", "q_b", "tau_a", "tau_b"]) + "\n" + "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("separator", "decimal", "quote", "head"),
    [
        (";", ",", "", ""),
        (";", ".", "", ""),
        (";", ",", "", "sep=;\n"),
        (";", ",", "", "# Messung; Montag, 3. Mai\n"),
        ("\t", ",", "", ""),
        (" ", ",", "", ""),
        (",", ",", '"', ""),
    ],
)
def test_spreadsheets(tmp_path, separator, decimal, quote, head):
    (tmp_path / "r.csv").write_text(spreadsheet(separator, decimal, quote, head), newline="")
    is_the_motion(tmp_path / "r.csv")


def test_names_in_a_comment_above_decimal_commas(tmp_path):
    (tmp_path / "r.csv").write_text("# " + spreadsheet(";", ","))
    is_the_motion(tmp_path / "r.csv")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{HEADER}\n0,1,1,5,2,5,3,5,4,5\n", "decimal commas are to be in quotes, or their cells separated"),
        (f"{SEMI}\n0,1;1.5;2,5;3;4\n", "'q_a', data row 1: .* got '1.5'; a decimal point, where the .* commas"),
        (f"{SEMI}\n" + "0.2;1.5;2.5;3;4\n" * 5000 + "0.3;1,5;2;3;4\n", "row 5001: .* '1,5'; a decimal comma, where"),
        (f"{SEMI}\n0,1;1.234,5;2;3;4\n", "'q_a', data row 1: expected a number, got '1.234,5'"),
    ],
)
def test_mixed_decimals_are_refused(tmp_path, text, words):
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(RecordingError, match=words):
        list(open_recording(tmp_path / "r.csv", JOINTS).chunks())


def test_utf16(tmp_path):
    (tmp_path / "r.csv").write_text(spreadsheet("\t", ","), encoding="utf-16")
    with pytest.raises(RecordingError, match="is written in UTF-16; save it as CSV in UTF-8"):
        open_recording(tmp_path / "r.csv", JOINTS)


def plotjuggler(topics, others=1):
    """Return what PlotJuggler exports, in the form that its plugin for CSV gives it (StatePublisherCSV, version 3).

    Series in the order of their names; a row for each moment at which any has a sample, empty cells for the others;
    times with 6 decimals, values with 9, no line's end lacking. Written after its source: the tool is not run here.
    """
    fields = {"effort": TAU, "position": Q, "velocity": QD}
    series = {f"{topic}/{j}/{f}": x[:, i] for topic in topics for i, j in enumerate(JOINTS) for f, x in fields.items()}
    series |= {f"{topic}/header/stamp": 1.7e9 + CLOCK for topic in topics}
    names = sorted([*series, "/odometry/twist/linear/x"])
    lines = [",".join(["__time", *names])]
    for k, t in enumerate(CLOCK):
        cells = ["" if name not in series else f"{series[name][k]:.9f}" for name in names]
        lines.append(",".join([f"{1.7e9 + t:.6f}", *cells]))
        speed = ["0.500000000" if name not in series else "" for name in names]
        lines += [",".join([f"{1.7e9 + t + 0.006:.6f}", *speed])] * others
    return "\n".join(lines) + "\n"


def test_plotjuggler(tmp_path):
    (tmp_path / "r.csv").write_text(plotjuggler(["/joint_states"]))
    is_the_motion(tmp_path / "r.csv", atol=1e-6)
    found = survey(open_recording(tmp_path / "r.csv", JOINTS))
    assert (found.rate_hz, found.incomplete, found.duplicates) == (pytest.approx(100, rel=1e-4), 0, 0)
    (note,) = map(str, found.notes)
    assert note == "columns not used: /joint_states/header/stamp, /odometry/twist/linear/x"


def test_plotjuggler_with_two_topics(tmp_path):
    (tmp_path / "r.csv").write_text(plotjuggler(["/left/joint_states", "/right/joint_states"]))
    with pytest.raises(RecordingError, match=r"2 topics of joint states: /left/joint_states \(2 joints\), /right"):
        open_recording(tmp_path / "r.csv", JOINTS)
    is_the_motion(tmp_path / "r.csv", atol=1e-6, mapping=Mapping(topic="/right/joint_states"))


def echo(names=("b", "a"), arrays=(Q, QD, TAU)):
    """Return what 'ros2 topic echo --csv /joint_states' prints, as ``rosidl_runtime_py.message_to_csv`` has it.

    Fields in the order of the message, arrays element by element, an empty array (None) or text as nothing between two
    commas; numbers as Python's ``str`` has them. Written after its source: ROS is not run here.
    """
    order = [JOINTS.index(name) for name in names]
    lines = []
    for k, t in enumerate(CLOCK):
        ns = 990_000_000 + round(t * 1e9)
        fields = [",".join(str(float(x[k, i])) for i in order) if x is not None else "" for x in arrays]
        lines.append(",".join([str(1_700_000_000 + ns // 10**9), str(ns % 10**9), "", *names, *fields]))
    return "\n".join(lines) + "\n"


def test_echo(tmp_path):
    (tmp_path / "r.csv").write_text(echo())
    is_the_motion(tmp_path / "r.csv")
    assert open_recording(tmp_path / "r.csv", JOINTS).has_velocity


def test_echo_without_velocities(tmp_path):
    (tmp_path / "r.csv").write_text(echo(arrays=(Q, None, TAU)))
    is_the_motion(tmp_path / "r.csv")
    assert not open_recording(tmp_path / "r.csv", JOINTS).has_velocity


def test_echo_of_one_joint_without_velocities(tmp_path):
    (tmp_path / "r.csv").write_text(echo(("b",), (Q, None, TAU)))
    recording = open_recording(tmp_path / "r.csv", ["b"])
    assert not recording.has_velocity
    np.testing.assert_array_equal(np.concatenate([chunk.tau for chunk in recording.chunks()]), TAU[:, 1:])


def test_echo_without_efforts(tmp_path):
    (tmp_path / "r.csv").write_text(echo(arrays=(Q, QD, None)))
    with pytest.raises(
        RecordingError,
        match=r"no joint has a torque; .*: t, q_b, q_a, qd_b, qd_a; no column looks like",
    ):
        open_recording(tmp_path / "r.csv", JOINTS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (echo(arrays=(Q, TAU)), "two arrays for 2 joints; whether the latter is velocity or effort is unknown"),
        (echo(arrays=(Q, QD, TAU, TAU)), "8 numbers for 2 joint names in row 1; its columns are header.stamp.sec"),
        (echo() + echo(("a", "b")), "data row 201 is of joint 'a' where row 1 is of 'b'"),
        (echo() + "1700000003,5,,b", "data row 201 has 4 cells"),
    ],
)
def test_echo_that_cannot_be_read(tmp_path, text, words):
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(RecordingError, match=words):
        list(open_recording(tmp_path / "r.csv", JOINTS).chunks())
