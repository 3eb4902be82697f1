"""Make recordings of known motion."""

import numpy as np

from torchrbd.recordings import Recording

JOINTS = ("a", "b")


def motion(t):
    """Return q, qd, qdd (N, 2) of a smooth motion at times t."""
    w = 2 * np.pi * np.array([0.3, 0.7])
    phase = np.outer(t, w) + np.array([0.2, 1.1])
    size = np.array([0.8, -0.5])
    return size * np.sin(phase), size * w * np.cos(phase), -size * w**2 * np.sin(phase)


def torque(t):
    """Return tau (N, 2): what a unit inertia and a spring would need."""
    q, _, qdd = motion(t)
    return qdd + 3 * q


def clean_recording(t, name="clean", noise=0.0, **changes):
    """Return a recording of the motion at times t."""
    q = motion(t)[0]
    rng = np.random.default_rng(3)
    arrays = {"q": q + noise * rng.normal(size=q.shape), "tau": torque(t)} | changes
    return Recording.from_arrays(name, JOINTS, t, **arrays)
