"""The one model: fitted, extended, exported, simulated, trained."""

from torchrbd.model.rigid_body_dynamics import RigidBodyDynamics
from torchrbd.model.starting import REST_WIDTH, urdf_friction

load_model, save_model = RigidBodyDynamics.load, RigidBodyDynamics.save

__all__ = ["REST_WIDTH", "RigidBodyDynamics", "load_model", "save_model", "urdf_friction"]
