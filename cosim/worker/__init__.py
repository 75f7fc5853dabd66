"""Systems in a process of their own, so that an FMU's fault is an error and no end."""

from .limits import Limits
from .master import WorkerMaster

__all__ = ["Limits", "WorkerMaster"]
