"""The result of Hausman's test, see ``misspecification``."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Misfit:
    """The difference between two estimates that agree if the model is right.

    Attributes:
        statistic: d'V^+ d.
        dof: its degrees of freedom; 0 if both estimates count as equal.
        p_value: probability of such a difference under a right model.
    """

    statistic: float
    dof: int
    p_value: float
