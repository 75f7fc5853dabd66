"""A system: FMUs by name, scalar connections between them, start values."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from twin.errors import FmuError


@dataclass(frozen=True, slots=True)
class Connection:
    """`source` and `target` are "slave.variable"."""

    source: str
    target: str


@dataclass(frozen=True)
class System:
    """What the master runs.

    Attributes:
        fmus: Name of each slave -> its FMU.
        connections: Output to input; an input has at most one source.
        starts: Start values, "slave.variable" -> value.
        periods: Slaves that step only every so many base steps; 1 where not named.
    """

    fmus: Mapping[str, Path]
    connections: tuple[Connection, ...] = ()
    starts: Mapping[str, float] = field(default_factory=dict)
    periods: Mapping[str, int] = field(default_factory=dict)

    def split(self, name: str) -> tuple[str, str]:
        """Slave and variable of "slave.variable".

        Raises:
            FmuError: No such slave.
        """
        slave, _, variable = name.partition(".")
        if slave not in self.fmus or not variable:
            raise FmuError(
                f"{name!r}: there is no slave {slave!r}; the system has {', '.join(self.fmus)}. "
                f"Names are slave.variable."
            )
        return slave, variable


def connect(source: str, target: str, names: Iterable[str]) -> tuple[Connection, ...]:
    """Connections between variables of the same name on two slaves."""
    return tuple(Connection(f"{source}.{n}", f"{target}.{n}") for n in names)
