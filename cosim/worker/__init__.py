"""Systems in a process of their own, so that an FMU's fault is an error and no end."""

from .master import WorkerMaster

__all__ = ["WorkerMaster"]
