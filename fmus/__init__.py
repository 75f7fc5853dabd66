"""FMUs: from components and recorded flights to archives that any FMI tool runs."""

from .builder import build
from .compensator import compensator_model
from .fuse import fuse
from .model import FmuModel, component_model
from .replay import replay_model

__all__ = [
    "FmuModel",
    "build",
    "compensator_model",
    "component_model",
    "fuse",
    "replay_model",
]
