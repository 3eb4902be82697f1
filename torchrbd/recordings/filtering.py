"""Differentiation and low-pass filtering with symmetric filters whose effect on noise is known exactly."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from scipy.linalg import solve_toeplitz

from torchrbd.errors import OptionError
from torchrbd.recordings.low_pass import LowPass

# Half-lengths of the windowed sincs times the width of their transition band: Blackman (75 dB) and Kaiser (60 dB).
_BLACKMAN_REACH = 2.75
_KAISER_REACH = 1.815
_KAISER_BETA = 5.653
_OVERSAMPLING = 2.5
# Wiener filter: its half-length [s], which resolves frequencies some Hz apart; oversampling of its spectrum; least
# density as a fraction of the largest.
_WIENER_REACH_S, _OVERSAMPLED, _LEAST_DENSITY = 0.8, 8, 1e-9


@dataclass(frozen=True)
class Filtering:
    """The one cut-off of a data set, and the two filters that follow from it.

    *State filter* (cut-off `state_cutoff_hz`): low-passes q and differentiates it; flat up to `cutoff_hz`. *Feature
    filter* (cut-off `cutoff_hz`, half amplitude there): low-passes the torque and every feature alike, so that both
    sides of `tau = Y pi` pass the same filter. Features also pass the filter that torques had passed when they were
    recorded. All are symmetric: exactly zero phase.

    Attributes:
        cutoff_hz: half-amplitude frequency of the feature filter [Hz].
        state_cutoff_hz: half-amplitude frequency of the state filter [Hz]; twice `cutoff_hz` unless given.
        of_motion: whether the state filter is also a Wiener filter: joint by joint, it removes the noise's share of
            each frequency. States are then expected values of the motion. Their errors are not correlated with them, so
            they do not bias a regression (regression calibration).
        low_pass: what recorded torques had passed before; None if nothing.
    """

    cutoff_hz: float
    state_cutoff_hz: float = 0.0
    of_motion: bool = False
    low_pass: LowPass | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.cutoff_hz) and self.cutoff_hz > 0):
            raise OptionError(f"cut-off {self.cutoff_hz:g} Hz: expected a number above zero")
        if not self.state_cutoff_hz:
            object.__setattr__(self, "state_cutoff_hz", 2 * self.cutoff_hz)
        if self.state_cutoff_hz < self.cutoff_hz:
            raise OptionError(
                f"state cut-off {self.state_cutoff_hz} Hz lies below the cut-off {self.cutoff_hz} Hz: "
                f"the filtered states would lack motion that the torque still shows"
            )

    @property
    def effective_rate(self) -> float:
        """Return the number of independent samples per second in the band, `2 cutoff_hz`."""
        return 2 * self.cutoff_hz

    def state_kernels(self, dt: float) -> torch.Tensor:
        """Return the kernels (3, 2 S + 1) that convolved with q give q, qd and qdd, at the sampling interval dt [s]."""
        # on a slow clock, the upper half of the transition band does not fit below the Nyquist frequency
        return torch.from_numpy(_state_kernels(min(self.state_cutoff_hz * dt, 1 / 3), dt))

    def motion_kernels(self, dt: float, share: np.ndarray, density: np.ndarray, hz: np.ndarray) -> torch.Tensor:
        """Return the state kernels of each joint, (n, 3, 2 S + 1).

        Args:
            dt: sampling interval [s].
            share: (n, F) share of the positions' power that is motion, at frequencies ``hz`` (F,) [Hz].
            density: (n, F) power density of the measured acceleration there, in any unit.
        """
        kernels = self.state_kernels(dt)
        if not self.of_motion:
            return kernels.expand(len(share), *kernels.shape)
        half = self._motion_reach(dt)
        wiener = [_wiener_kernel(one, own, hz, dt, half) for one, own in zip(share, density, strict=True)]
        return torch.from_numpy(np.stack([[np.convolve(w, k) for k in kernels.numpy()] for w in wiener]))

    def feature_kernel(self, dt: float) -> torch.Tensor:
        """Return the kernel (2 F + 1,) that features pass, at the sampling interval dt [s].

        Raises: OptionError if the cut-off is too high for the clock.
        """
        kernel = self._shared_kernel(dt)
        return torch.from_numpy(kernel if self.low_pass is None else np.convolve(kernel, self.low_pass.kernel(dt)))

    def torque_kernel(self, dt: float) -> torch.Tensor:
        """Return the kernel of torques, as long as that of features: without what they passed before.

        Raises: OptionError if the cut-off is too high for the clock.
        """
        kernel = self._shared_kernel(dt)
        more = 0 if self.low_pass is None else len(self.low_pass.kernel(dt)) // 2
        return torch.from_numpy(np.pad(kernel, more))

    def _shared_kernel(self, dt: float) -> np.ndarray:
        """Return the low-pass that torque and features share, (2 K + 1,)."""
        if self.cutoff_hz * dt > 1 / 3:
            raise OptionError(
                f"cut-off {self.cutoff_hz:g} Hz is too high for a recording at {1 / dt:.4g} Hz; "
                f"at most {1 / (3 * dt):.3g} Hz"
            )
        return _feature_kernel(self.cutoff_hz * dt)

    def feature_kernel_at(self, dt: float, step: float, multiple: int) -> torch.Tensor:
        """Return the feature kernel of a clock dt [s], sampled every `step` [s]: (2 K + 1,), `multiple` divides K.

        It filters signals with coarser samples, without aliasing into the band.
        """
        reach = (len(self._shared_kernel(dt)) // 2) * dt
        half = math.ceil(reach / step - 1e-9)
        t = step * np.arange(-half, half + 1)
        window = np.i0(_KAISER_BETA * np.sqrt(np.maximum(0.0, 1 - (t / reach) ** 2))) * (
            np.abs(t) <= reach * (1 + 1e-9)
        )
        kernel = np.sinc(2 * self.cutoff_hz * t) * window
        kernel /= kernel.sum()
        if self.low_pass is not None:
            kernel = np.convolve(kernel, self.low_pass.kernel(step))
        return torch.from_numpy(np.pad(kernel, -(len(kernel) // 2) % multiple))

    def stride(self, dt: float) -> int:
        """Return the number of clock samples between two outputs: about 2.5 outputs per cut-off period."""
        return max(1, math.floor((1 + 1e-6) / (_OVERSAMPLING * self.cutoff_hz * dt)))

    def reach(self, dt: float) -> int:
        """Return the number of samples at each end of a segment that have no output: the filters do not fit there."""
        return (self.state_kernels(dt).shape[1] + self.feature_kernel(dt).shape[0]) // 2 - 1 + self._motion_reach(dt)

    def _motion_reach(self, dt: float) -> int:
        return math.ceil(_WIENER_REACH_S / dt) if self.of_motion else 0

    def state_noise(self, q_noise_std: np.ndarray, dt: float, qd_noise_std: np.ndarray | None = None) -> torch.Tensor:
        """Propagate white encoder noise through the state filter.

        `cov (q, qd, qdd) = q_noise_std^2 K K^T` with K the three kernels. If a joint's measured velocity is used
        (`qd_noise_std` is not NaN), q has its own noise and (qd, qdd) that of the velocity sensor.

        Args:
            q_noise_std: (n,) [rad or m]. dt: [s]. qd_noise_std: (n,) [rad/s or m/s].

        Returns: (n, 3, 3), in units of q, qd, qdd.
        """
        kernels = self.state_kernels(dt)
        gram = kernels @ kernels.T
        cov = torch.as_tensor(q_noise_std, dtype=torch.float64).square()[:, None, None] * gram
        if qd_noise_std is not None:
            measured = torch.zeros(3, 3, dtype=torch.float64)
            qd_var = torch.as_tensor(qd_noise_std, dtype=torch.float64).square()
            for joint in torch.nonzero(~qd_var.isnan()).flatten().tolist():
                measured[1:, 1:] = qd_var[joint] * gram[:2, :2]
                measured[0, 0] = cov[joint, 0, 0]
                cov[joint] = measured
        return cov


@lru_cache(maxsize=64)
def _feature_kernel(cutoff: float) -> np.ndarray:
    """Make a Kaiser-windowed sinc of gain one; `cutoff` in cycles per sample, transition from half to 1.5 times it."""
    half = math.ceil(_KAISER_REACH / cutoff)
    n = np.arange(-half, half + 1)
    kernel = np.sinc(2 * cutoff * n) * np.kaiser(2 * half + 1, _KAISER_BETA)
    return kernel / kernel.sum()


@lru_cache(maxsize=64)
def _state_kernels(cutoff: float, dt: float) -> np.ndarray:
    """Make a Blackman-windowed sinc, of response H, and its derivatives, of i w H and (i w)^2 H.

    `cutoff` in cycles per sample; the transition goes from half to 1.5 times it.

    The derivatives are computed in the frequency domain, on a grid dense enough for the kernels of the sampled sinc's
    trigonometric interpolant. All kernels are then multiplied by even polynomials close to one, which set their
    moments: cubics and their derivatives pass exactly, and the gain is flat at zero frequency up to fourth order.
    """
    half = math.ceil(_BLACKMAN_REACH / cutoff)
    n = np.arange(-half, half + 1)
    x = n / half
    size = 16 * half
    response = np.fft.rfft(np.sinc(2 * cutoff * n) * np.blackman(2 * half + 3)[1:-1], size)
    omega = 2 * math.pi * np.fft.rfftfreq(size)
    # advance by `half`, to truncate the derivative of a kernel that is centred on zero
    centred = response * np.exp(1j * omega * half)
    kernels = [np.roll(np.fft.irfft((1j * omega) ** k * centred, size), half)[: 2 * half + 1] for k in range(3)]
    position = _set_moments(kernels[0], x, {0: 1.0, 2: 0.0})
    velocity = _set_moments(kernels[1], x, {1: -1.0 / half, 3: 0.0})
    acceleration = _set_moments(kernels[2], x, {0: 0.0, 2: 2.0 / half**2, 4: 0.0})
    return np.stack([position, velocity / dt, acceleration / dt**2])


def _wiener_kernel(share: np.ndarray, density: np.ndarray, hz: np.ndarray, dt: float, half: int) -> np.ndarray:
    """Return the kernel (2 half + 1,) with the least acceleration error: Wiener-Hopf equations of that length.

    Its errors are not correlated with its inputs. Levels, ramps and parabolas pass exactly.

    Source: Levinson, "The Wiener RMS Error Criterion in Filter Design and Prediction", J. Math. and Phys. 1946.
    """
    size = 2 * _OVERSAMPLED * half
    f = np.fft.rfftfreq(size, dt)
    # The density of a locked joint is zero.
    density = density / max(float(density.max()), 1e-300)
    measured, motion = np.interp(f, hz, density) + _LEAST_DENSITY, np.interp(f, hz, share * density)
    lags = np.fft.irfft(motion, size)[: half + 1]
    wanted = np.concatenate((lags[:0:-1], lags))
    slow = np.linspace(-1.0, 1.0, 2 * half + 1)[:, None] ** [0, 2]
    free, *turn = solve_toeplitz(np.fft.irfft(measured, size)[: 2 * half + 1], np.column_stack((wanted, slow))).T
    turned = np.array(turn)
    kernel = free + np.linalg.solve(turned @ slow, [1.0, 0.0] - free @ slow) @ turned
    return 0.5 * (kernel + kernel[::-1])


def _set_moments(kernel: np.ndarray, x: np.ndarray, moments: dict[int, float]) -> np.ndarray:
    """Multiply the kernel by an even polynomial in x, so that `sum x^k kernel = moments[k]`."""
    basis = [kernel * x ** (2 * power) for power in range(len(moments))]
    system = np.array([[np.sum(x**order * term) for term in basis] for order in moments])
    kernel = np.linalg.solve(system, np.array(list(moments.values()))) @ np.stack(basis)
    even = 1 if 0 in moments else -1
    return (kernel + even * kernel[::-1]) / 2
