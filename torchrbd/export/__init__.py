"""Results as files: URDF, safetensors, JSON."""

from torchrbd.export.json_files import write_changes, write_diagnosis, write_parameters
from torchrbd.export.model_file import load_model, save_model
from torchrbd.export.urdf import to_urdf

__all__ = ["load_model", "save_model", "to_urdf", "write_changes", "write_diagnosis", "write_parameters"]
