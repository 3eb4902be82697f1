"""Results as files: URDF, MJCF, TorchScript, safetensors, JSON."""

from torchrbd.export.actuator_net import to_actuator_net
from torchrbd.export.json_files import write_changes, write_diagnosis, write_parameters
from torchrbd.export.mjcf import to_mjcf
from torchrbd.export.simulators import not_exported
from torchrbd.export.urdf import to_urdf
from torchrbd.model import load_model, save_model

__all__ = [
    "load_model",
    "not_exported",
    "save_model",
    "to_actuator_net",
    "to_mjcf",
    "to_urdf",
    "write_changes",
    "write_diagnosis",
    "write_parameters",
]
