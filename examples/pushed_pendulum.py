"""Why a pendulum's mass is not found: it is pushed. Least squares beside a robust regression, of each recording.

    TORCHRBD_DATA=/path/to/recordings python examples/pushed_pendulum.py

    tau = J qdd + m g l sin q + d qd + c tanh(qd / 0.3) + o,   all below 4 Hz

by least squares, and with Cauchy's loss (scipy), to which a torque of 12 N m for 0.2 s that no motor made is a few of
many rows. ``real_recordings.py`` says where the recordings come from.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt

BAND_HZ, ENDS_S, ROWS_HZ = 4.0, 0.3, 16.0
# Rounds in which the scale of the errors is their median.
_ROUNDS = 5


def rows(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return columns (M, 5) and torque (M,) [N m] below the band, as many rows as are independent, twice."""
    table = np.genfromtxt(file, delimiter=",", names=True)
    t, q, tau = (table[name] for name in ("t", "q_theta", "tau_theta"))
    rate = 1.0 / np.median(np.diff(t))
    low_pass = butter(4, BAND_HZ, fs=rate, output="sos")
    smooth, turned, measured = (sosfiltfilt(low_pass, x) for x in (q, np.sin(q), tau))
    qd = np.gradient(smooth, t)
    columns = np.stack((np.gradient(qd, t), turned, qd, np.tanh(qd / 0.3), np.ones_like(t)), axis=1)
    kept = np.flatnonzero((t > t[0] + ENDS_S) & (t < t[-1] - ENDS_S))[:: max(1, round(rate / ROWS_HZ))]
    return columns[kept], measured[kept]


def main() -> int:
    """Print inertia, gravity moment and the largest torque that nothing explains, recording by recording."""
    data = os.environ.get("TORCHRBD_DATA")
    if not data:
        print("TORCHRBD_DATA names no folder of real recordings; see examples/real_recordings.py for their sources")
        return 2
    print("| recording | least squares: J, m g l | robust: J, m g l, d, c | largest error [N m] |")
    print("| --- | --- | --- | --- |")
    for file in sorted((Path(data) / "dfki_pendulum").glob("*.csv")):
        X, y = rows(file)
        plain = robust = np.linalg.lstsq(X, y, rcond=None)[0]
        for _ in range(_ROUNDS):
            scale = float(np.median(np.abs(y - X @ robust)))
            robust = least_squares(lambda w, X=X, y=y: X @ w - y, robust, loss="cauchy", f_scale=scale).x
        error = float(np.abs(y - X @ robust).max())
        told = f"{robust[0]:.3f}, {robust[1]:.2f}, {robust[2]:.3f}, {robust[3]:.2f}"
        print(f"| {file.stem} | {plain[0]:.3f}, {plain[1]:.2f} | {told} | {error:.1f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
