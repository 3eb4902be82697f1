"""Plain linear regressions on second moments: the classical ones and those that know about noise in the inputs."""

from torchrbd.inference.regression.base import Regression
from torchrbd.inference.regression.choice import BestRegression, Choice, choose, corrected_error
from torchrbd.inference.regression.classical import OrdinaryLeastSquares, Stepwise, TotalLeastSquares, TruncatedSVD
from torchrbd.inference.regression.cross_validated import Lasso, PartialLeastSquares, PrincipalComponents, Ridge
from torchrbd.inference.regression.errors_in_variables import EIVARD
from torchrbd.inference.regression.factor_regression import FactorRegression
from torchrbd.inference.regression.moments import Moments
from torchrbd.inference.regression.noisy_input import NoiseRange, NoisyInputRegression

__all__ = [
    "EIVARD",
    "BestRegression",
    "Choice",
    "FactorRegression",
    "Lasso",
    "Moments",
    "NoiseRange",
    "NoisyInputRegression",
    "OrdinaryLeastSquares",
    "PartialLeastSquares",
    "PrincipalComponents",
    "Regression",
    "Ridge",
    "Stepwise",
    "TotalLeastSquares",
    "TruncatedSVD",
    "choose",
    "corrected_error",
]
