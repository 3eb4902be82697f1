"""The paper's noisy-input regression."""

from torchrbd.regression.noisy_input.model import NoiseRange, NoisyInputRegression

__all__ = ["NoiseRange", "NoisyInputRegression"]
