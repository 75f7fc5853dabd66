"""FMUs: from components and recorded flights to archives that any FMI tool can run.

Names are loaded on first use: running FMUs needs neither CasADi nor pandas.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .builder import build
    from .compensator import compensator_model
    from .fusing import fuse
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

_HOME = {
    "FmuModel": "model",
    "build": "builder",
    "compensator_model": "compensator",
    "component_model": "model",
    "fuse": "fusing",
    "replay_model": "replay",
}
"""Module of each name; no module has the name of an object, since its import would replace the
object."""

if not TYPE_CHECKING:  # a type checker then refuses unknown names

    def __getattr__(name: str) -> object:
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        found = getattr(import_module(f".{_HOME[name]}", __name__), name)
        globals()[name] = found
        return found
