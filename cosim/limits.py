"""Resource limits of a worker process, and the description of its end."""

import contextlib
import signal
from dataclasses import asdict, dataclass
from math import isfinite

from twin.errors import FmuError, TwinError


def check_limits(error: type[TwinError], **limits: float) -> None:
    """Raise the error if a limit is not positive."""
    for name, value in limits.items():
        if not (isfinite(value) and value > 0):
            raise error(f"limit {name} = {value:g}: needs a positive number.")


def exit_text(code: int) -> str:
    """Text on the end of a process, by its return code."""
    if code < 0:
        with contextlib.suppress(ValueError):  # a signal without a name
            return f"signal {signal.Signals(-code).name}"
    return f"exit code {code}"


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a worker process.

    Attributes:
        call_s: Time limit of one call into an FMU, including loading and freeing.
        whole_s: Time limit of loading, and of initialisation and run together; a run in real time
            may take the simulated time in addition.
        memory_gib: Memory limit of the process.
    """

    call_s: float = 60.0
    whole_s: float = 3600.0
    memory_gib: float = 4.0

    def __post_init__(self) -> None:
        check_limits(FmuError, **asdict(self))

    @property
    def memory_bytes(self) -> int:
        """The memory in bytes."""
        return round(self.memory_gib * 2**30)
