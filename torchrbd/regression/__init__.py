"""Plain linear regressions y = x'b on second moments: the classical ones and those that know about noise in the inputs.

None fits an intercept: centre inputs and output, or add a column of ones. X and y are tensors or numpy arrays; all
computation is in float64.
"""

from torchrbd.regression.base import Regression
from torchrbd.regression.choice import BestRegression, Choice, choose
from torchrbd.regression.classical import OrdinaryLeastSquares, Stepwise, TotalLeastSquares, TruncatedSVD
from torchrbd.regression.cross_validated import Lasso, PartialLeastSquares, PrincipalComponents, Ridge
from torchrbd.regression.errors_in_variables import EIVARD
from torchrbd.regression.factor_regression import FactorRegression
from torchrbd.regression.moments import Moments
from torchrbd.regression.noisy_input import NoiseRange, NoisyInputRegression

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
]
