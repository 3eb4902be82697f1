"""Results as files: URDF, safetensors, JSON."""

from torchrbd.export.json_files import write_changes, write_diagnosis, write_parameters
from torchrbd.export.urdf import to_urdf
from torchrbd.model import load_model, save_model

__all__ = ["load_model", "save_model", "to_urdf", "write_changes", "write_diagnosis", "write_parameters"]
