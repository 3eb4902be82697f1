"""Rows of a recording, in SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Chunk:
    """Consecutive rows of a recording.

    Attributes:
        t: (N,) seconds since the recording's first row.
        q: (N, n) [rad or m].
        tau: (N, n) [N m or N]; NaN if a joint's torque is not in the file.
        qd: (N, n) [rad/s or m/s], or None; NaN for joints without.
        qdd: (N, n) [rad/s^2 or m/s^2], or None.
        q_ref: (N, n) set-point [rad or m], or None; NaN for joints without.
        q_link: (N, n) position behind the gear [rad or m], or None; NaN for joints without such an encoder.
        temperature: (N, n) of the joints [deg C], or None; NaN where there is no reading.
    """

    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    qd: np.ndarray | None = None
    qdd: np.ndarray | None = None
    q_ref: np.ndarray | None = None
    q_link: np.ndarray | None = None
    temperature: np.ndarray | None = None
