"""Fitting: block statistics, physically valid estimates with uncertainties, and the result of an identification."""

from torchrbd.inference.identify import identify
from torchrbd.inference.payload import Payload
from torchrbd.inference.results import Fit, Identification, ParameterEstimate, TorqueSeries
from torchrbd.inference.settings import Settings

__all__ = ["Fit", "Identification", "ParameterEstimate", "Payload", "Settings", "TorqueSeries", "identify"]
