"""What a worker process may use."""

from dataclasses import dataclass
from math import isfinite

from twin.errors import FmuError


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a worker process.

    Attributes:
        call_s: Time that one call into an FMU may take, loading and ending included.
        whole_s: Time that loading may take, and that initialising and running may take together;
            a run by the clock may take as long as the clock in addition.
        memory_gib: Memory that the process may ask for.
    """

    call_s: float = 60.0
    whole_s: float = 3600.0
    memory_gib: float = 4.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise FmuError(f"limit {name} = {value:g}: needs a positive number.")

    @property
    def memory_bytes(self) -> int:
        """The memory in bytes."""
        return round(self.memory_gib * 2**30)
