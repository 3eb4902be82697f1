"""Why a pendulum's mass is not found: it is pushed. Least squares beside a robust regression, of each recording.

    TORCHRBD_DATA=/path/to/recordings python examples/pushed_pendulum.py

    tau = J qdd + m g l sin q + d qd + c tanh(qd / 0.3) + o,   all below 4 Hz

by least squares, and with Cauchy's loss (scipy), to which a torque of 12 N m for 0.2 s that no motor made is a few of
many rows. Below 10 Hz the same is solved for qdd, beside what an error a sin 12 q + b cos 12 q of the position makes of
it: the motor turns six times as fast. ``real_recordings.py`` says where the recordings come from.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from real_recordings import data_folder
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt

BAND_HZ, WIDE_HZ, ENDS_S, ROWS_PER_HZ, TWICE_A_TURN = 4.0, 10.0, 0.3, 4.0, 12.0
# Rounds in which the scale of the errors is their median.
_ROUNDS = 5


class Filtered:
    """A recording below a frequency [Hz], and its rows that are independent, twice."""

    def __init__(self, file: Path, band_hz: float) -> None:
        table = np.genfromtxt(file, delimiter=",", names=True)
        self.t, self.position, torque = (table[name] for name in ("t", "q_theta", "tau_theta"))
        rate = 1.0 / np.median(np.diff(self.t))
        self._low_pass = butter(4, band_hz, fs=rate, output="sos")
        inside = (self.t > self.t[0] + ENDS_S) & (self.t < self.t[-1] - ENDS_S)
        self.rows = np.flatnonzero(inside)[:: max(1, round(rate / (ROWS_PER_HZ * band_hz)))]
        self.tau, self.qdd = self.filtered(torque), self.twice(self.position)
        qd = np.gradient(self.filtered(self.position), self.t)
        gravity = self.filtered(np.sin(self.position))
        self.others = np.stack((gravity, qd, np.tanh(qd / 0.3), np.ones_like(qd)), axis=1)

    def filtered(self, x: np.ndarray) -> np.ndarray:
        """Return a signal below the frequency."""
        return sosfiltfilt(self._low_pass, x)

    def twice(self, x: np.ndarray) -> np.ndarray:
        """Return its second derivative."""
        return np.gradient(np.gradient(self.filtered(x), self.t), self.t)

    def regressed(self, y: np.ndarray, *columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return coefficients by least squares and robust ones, and the largest error that these leave."""
        X, y = np.column_stack(columns)[self.rows], y[self.rows]
        plain = robust = np.linalg.lstsq(X, y, rcond=None)[0]
        for _ in range(_ROUNDS):
            scale = float(np.median(np.abs(y - X @ robust)))
            robust = least_squares(lambda w: X @ w - y, robust, loss="cauchy", f_scale=scale, x_scale="jac").x
        return plain, robust, float(np.abs(y - X @ robust).max())


def main() -> int:
    """Print what both tell of each recording."""
    folder = data_folder()
    if folder is None:
        print("Set TORCHRBD_DATA to the folder of the recordings; see real_recordings.py for their sources.")
        return 2
    print("| recording | least squares: J, m g l | robust: J, m g l, d, c | largest error [N m] | a, b [mrad] |")
    print("| --- | --- | --- | --- | --- |")
    for file in sorted((folder / "dfki_pendulum").glob("*.csv")):
        one, wide = Filtered(file, BAND_HZ), Filtered(file, WIDE_HZ)
        plain, robust, error = one.regressed(one.tau, one.qdd, one.others)
        waves = (wide.twice(f(TWICE_A_TURN * wide.position)) for f in (np.sin, np.cos))
        a, b = 1e3 * wide.regressed(wide.qdd, *waves, wide.tau, wide.others)[1][:2]
        told = f"{robust[0]:.3f}, {robust[1]:.2f}, {robust[2]:.3f}, {robust[3]:.2f}"
        print(f"| {file.stem} | {plain[0]:.3f}, {plain[1]:.2f} | {told} | {error:.1f} | {a:.1f}, {b:.1f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
