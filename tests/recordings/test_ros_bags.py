"""Joint states come out of bags as they were written, by the library that writes bags."""

import sys
from pathlib import Path

import numpy as np
import pytest
from recordings.motion import JOINTS, motion, torque
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from torchrbd.errors import RecordingError
from torchrbd.recordings import Mapping, open_recording, survey

CLOCK = np.arange(0, 3, 0.01)
SINCE_1970 = 1_700_000_000
Q, QD, _ = motion(CLOCK)
TAU = torque(CLOCK)


def states(order=(1, 0), prefix=""):
    """Yield times [ns], joints' names, positions, velocities and efforts, joints in an order of their own."""
    for k, t in enumerate(CLOCK):
        names = [prefix + JOINTS[i] for i in order]
        yield round(t * 1e9), names, *(x[k, list(order)] for x in (Q, QD, TAU))


def add(bag, store, topic, messages, ros2=True, stamped=True):
    """Write joint states to a bag, each recorded 3 ms after it was measured."""
    kinds = store.types
    state, header, time = (
        kinds[name] for name in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    connection = bag.add_connection(topic, state.__msgtype__, typestore=store)
    for k, (ns, names, *arrays) in enumerate(messages):
        at = time(SINCE_1970 + ns // 10**9, ns % 10**9) if stamped else time(0, 0)
        fields = (at, "base") if ros2 else (k, at, "base")
        message = state(header(*fields), names, *map(np.asarray, arrays))
        raw = (store.serialize_cdr if ros2 else store.serialize_ros1)(message, state.__msgtype__)
        bag.write(connection, SINCE_1970 * 10**9 + ns + 3_000_000, raw)


def ros2_bag(path, topics, plugin=rosbag2.StoragePlugin.MCAP, stamped=True):
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as bag:
        for topic, messages in topics.items():
            add(bag, get_typestore(Stores.ROS2_HUMBLE), topic, messages, stamped=stamped)
    return path


def read(path, **options):
    chunks = list(open_recording(path, JOINTS, **options).chunks(100))
    return tuple(np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in ("t", "q", "qd", "tau"))


def is_the_motion(path, **options):
    for got, expected in zip(read(path, **options), (CLOCK, Q, QD, TAU), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-9)


@pytest.mark.parametrize("plugin", rosbag2.StoragePlugin)
def test_ros2_bags(tmp_path, plugin):
    path = ros2_bag(tmp_path / "bag", {"/joint_states": states()}, plugin)
    is_the_motion(path)
    is_the_motion(next(file for file in path.iterdir() if file.suffix != ".yaml"))
    assert survey(open_recording(path, JOINTS)).rate_hz == pytest.approx(100)


def test_squeezed_bags(tmp_path):
    for mode in (rosbag2.CompressionMode.FILE, rosbag2.CompressionMode.MESSAGE):
        bag = rosbag2.Writer(tmp_path / mode.name, version=8)
        bag.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
        with bag:
            add(bag, get_typestore(Stores.ROS2_JAZZY), "/joint_states", states())
        is_the_motion(tmp_path / mode.name)


def test_ros1_bags(tmp_path):
    with rosbag1.Writer(tmp_path / "r.bag") as bag:
        add(bag, get_typestore(Stores.ROS1_NOETIC), "/joint_states", states(), ros2=False)
    is_the_motion(tmp_path / "r.bag")


def test_messages_without_stamps_have_the_times_at_which_they_were_recorded(tmp_path):
    is_the_motion(ros2_bag(tmp_path / "bag", {"/joint_states": states()}, stamped=False))


def test_other_joints_on_the_topic_are_left_aside(tmp_path):
    both = [one for pair in zip(states(), states(prefix="gripper_"), strict=True) for one in pair]
    is_the_motion(ros2_bag(tmp_path / "bag", {"/joint_states": both}))


def test_one_of_several_topics_is_named_by_the_mapping(tmp_path):
    path = ros2_bag(tmp_path / "bag", {"/left/joint_states": states(), "/right/joint_states": states(prefix="r_")})
    with pytest.raises(RecordingError, match=r"2 topics of joint states: /left/joint_states \(300 messages\)"):
        open_recording(path, JOINTS)
    with pytest.raises(RecordingError, match="did you mean '/left/joint_states'"):
        open_recording(path, JOINTS, mapping=Mapping(topic="/left/joint_state"))
    is_the_motion(path, mapping=Mapping(topic="/left/joint_states"))


def test_efforts_that_nobody_measured(tmp_path):
    silent = ((ns, names, q, qd, []) for ns, names, q, qd, _ in states())
    with pytest.raises(RecordingError, match="no joint has a torque; expected at least one of tau_a"):
        open_recording(ros2_bag(tmp_path / "bag", {"/joint_states": silent}), JOINTS)


def test_arrays_of_another_length_than_the_names(tmp_path):
    long = ((ns, names, q, qd, [0.0] * (2 + (k == 7))) for k, (ns, names, q, qd, _) in enumerate(states()))
    path = ros2_bag(tmp_path / "bag", {"/joint_states": long})
    with pytest.raises(RecordingError, match="'/joint_states', message 8: 3 values of effort for 2 joint names"):
        read(path)


def test_bags_that_cannot_be_read(tmp_path):
    path = ros2_bag(tmp_path / "bag", {"/joint_states": states()}, rosbag2.StoragePlugin.MCAP)
    file = next(path.glob("*.mcap"))
    content = file.read_bytes()
    for part in (content[: len(content) // 2], content[:20], b"no bag at all, and long enough to be one" * 20):
        file.write_bytes(part)
        with pytest.raises(RecordingError, match=r"not a readable bag: .*'ros2 bag reindex bag'"):
            open_recording(path, JOINTS)
        with pytest.raises(RecordingError, match="not a readable bag"):
            open_recording(file, JOINTS)
    file.write_bytes(bytes(x ^ 0xFF if 2000 < k < 2100 else x for k, x in enumerate(content)))
    with pytest.raises(RecordingError, match="not a readable bag"):
        read(path)
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: [1")
    with pytest.raises(RecordingError, match="not a readable bag: Could not load YAML"):
        open_recording(path, JOINTS)
    (path / "metadata.yaml").unlink()
    with pytest.raises(RecordingError, match="'ros2 bag reindex bag' writes it, or give"):
        open_recording(path, JOINTS)
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\nnothing")
    with pytest.raises(RecordingError, match="'rosbag reindex'"):
        open_recording(tmp_path / "old.bag", JOINTS)
    (tmp_path / "folder").mkdir()
    with pytest.raises(RecordingError, match="a folder, and neither a ROS 2 bag"):
        open_recording(tmp_path / "folder", JOINTS)


def test_other_messages_alone(tmp_path):
    store, path = get_typestore(Stores.ROS2_HUMBLE), tmp_path / "bag"
    with rosbag2.Writer(path, version=9) as bag:
        bag.add_connection("/clock", "builtin_interfaces/msg/Time", typestore=store)
    with pytest.raises(RecordingError, match=r"its topics are /clock \(builtin_interfaces/msg/Time\)"):
        open_recording(path, JOINTS)


def test_the_library_is_asked_for_only_when_it_is_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = ros2_bag(tmp_path / "bag", {"/joint_states": states()})
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(RecordingError, match="pip install rosbags"):
        open_recording(path, JOINTS)
