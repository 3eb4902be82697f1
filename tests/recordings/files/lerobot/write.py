"""Write the LeRobot data set beside this file, with lerobot itself: ``pip install lerobot==0.4.4; python write.py``.

Two episodes of 30 frames at 20 Hz of two joints, without pictures. The tables of the episodes' statistics, which are
larger than all else and tell nothing of joints, are left out of the repository.
"""

import shutil
from pathlib import Path

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

JOINTS, FPS, LENGTHS = ("a", "b"), 20, (30, 30)


def motion(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and efforts at a time [s]."""
    phase = np.array([2.0, 5.0]) * t + np.array([0.2, 1.1])
    return np.sin(phase).astype("f4"), (3.0 * np.cos(phase)).astype("f4")


def main() -> None:
    """Write."""
    of_motors = {"dtype": "float32", "shape": (2,), "names": [f"{joint}.pos" for joint in JOINTS]}
    of_efforts = {"dtype": "float32", "shape": (2,), "names": [f"{joint}.effort" for joint in JOINTS]}
    features = {"observation.state": of_motors, "observation.effort": of_efforts}
    root = Path(__file__).parent / "set"
    written = LeRobotDataset.create("torchrbd/test", FPS, features, root=root, robot_type="two", use_videos=False)
    for length in LENGTHS:
        for k in range(length):
            q, tau = motion(k / FPS)
            written.add_frame({"observation.state": q, "observation.effort": tau, "task": "move"})
        written.save_episode()
    written.finalize()
    shutil.rmtree(root / "meta/episodes")
    (root / "meta/stats.json").unlink()


if __name__ == "__main__":
    main()
