"""Fitting: block statistics, estimators, smoothing, physically valid parameters with uncertainties."""

from torchrbd.inference.base_regression import BaseEstimate, BaseRegression
from torchrbd.inference.comparison import EstimatorComparison, compare_estimators
from torchrbd.inference.identification import Identification
from torchrbd.inference.identify import identify
from torchrbd.inference.many import Outcome, identify_many
from torchrbd.inference.replay import Replay, replay
from torchrbd.inference.results import ParameterEstimate, TorqueSeries
from torchrbd.inference.settings import Settings
from torchrbd.inference.statistics.folder import merge_statistics, write_statistics
from torchrbd.inference.torque_error import Fit
from torchrbd.options import Payload

__all__ = [
    "BaseEstimate",
    "BaseRegression",
    "EstimatorComparison",
    "Fit",
    "Identification",
    "Outcome",
    "ParameterEstimate",
    "Payload",
    "Replay",
    "Settings",
    "TorqueSeries",
    "compare_estimators",
    "identify",
    "identify_many",
    "merge_statistics",
    "replay",
    "write_statistics",
]
