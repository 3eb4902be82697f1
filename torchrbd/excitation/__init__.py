"""Excitation: the motion to record next, within the limits of the machine."""

from torchrbd.excitation.conditioning import ConditionNumbers
from torchrbd.excitation.design import excite
from torchrbd.excitation.fourier import Basis, FourierMotion
from torchrbd.excitation.limits import Limits
from torchrbd.excitation.results import Excitation, JointUse, Separation

__all__ = ["Basis", "ConditionNumbers", "Excitation", "FourierMotion", "JointUse", "Limits", "Separation", "excite"]
