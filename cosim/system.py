"""A system: FMUs by name, scalar connections between them, start values."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path

from twin.errors import FmuError
from twin.representation import ShortRepr

from .interface import Interface

_TAKES = {
    "Real": ("Real", "Integer", "Boolean", "Enumeration"),
    "Integer": ("Integer", "Boolean", "Enumeration"),
    "Boolean": ("Boolean",),
    "Enumeration": ("Enumeration",),
}
"""Kind of an input -> kinds of outputs that it accepts, an enumeration's by their codes."""


@dataclass(frozen=True, slots=True)
class Connection:
    """Connection of `source` to `target`, both "slave.variable"."""

    source: str
    target: str


@dataclass(frozen=True)
class System(ShortRepr):
    """System of FMUs for the master.

    Attributes:
        fmus: Name of each slave -> its FMU.
        connections: Output to input; an input has at most one source.
        starts: Start values, "slave.variable" -> value.
        periods: Decimation of slaves, in base steps; 1 for slaves not named.
        start_time_s: Default start time.
        stop_time_s: Default stop time; None: none.
        step_s: Default base step; None: none.
        foreign: Whether its FMUs are of other origin, so that `uavtwin simulate` runs them in a
            separate process.
        folder: Object that keeps the files of an unpacked archive while the system is in use.
    """

    fmus: Mapping[str, Path]
    connections: tuple[Connection, ...] = ()
    starts: Mapping[str, float] = field(default_factory=dict)
    periods: Mapping[str, int] = field(default_factory=dict)
    start_time_s: float = 0.0
    stop_time_s: float | None = None
    step_s: float | None = None
    foreign: bool = field(default=False, compare=False)
    folder: object = field(default=None, repr=False, compare=False)

    def split(self, name: str) -> tuple[str, str]:
        """Slave and variable of "slave.variable".

        Raises:
            FmuError: There is no such slave.
        """
        slave, _, variable = name.partition(".")
        if slave not in self.fmus or not variable:
            near = get_close_matches(slave, self.fmus, n=1, cutoff=0.5)
            hint = f" Did you mean {near[0]!r}?" if near and near[0] != slave else ""
            raise FmuError(
                f"{name!r}: there is no slave {slave!r}; the system has {', '.join(self.fmus)}."
                f"{hint} Names are slave.variable."
            )
        return slave, variable

    def check(self, interfaces: Mapping[str, Interface]) -> None:
        """Check names, connections, start values and periods against the FMUs.

        Args:
            interfaces: Interface of every slave.

        Raises:
            FmuError: A name, connection, value or period does not fit.
        """
        for name in self.starts:
            slave, variable = self.split(name)
            interfaces[slave].scalar(variable)
        for name, period in self.periods.items():
            if name not in self.fmus or period < 1:
                raise FmuError(f"period of {name!r} = {period}: needs a slave and an integer >= 1.")
        taken: set[str] = set()
        for c in self.connections:
            self._check_connection(c, interfaces)
            if c.target in taken:
                raise FmuError(f"{c.target} has two sources; an input takes one.")
            taken.add(c.target)

    def _check_connection(self, c: Connection, interfaces: Mapping[str, Interface]) -> None:
        (a, x), (b, y) = self.split(c.source), self.split(c.target)
        source, target = interfaces[a].scalar(x), interfaces[b].scalar(y)
        if source.causality != "output" or target.causality != "input":
            raise FmuError(
                f"{c.source} ({source.causality}) -> {c.target} ({target.causality}): "
                f"a connection goes from an output to an input."
            )
        if source.unit and target.unit and source.unit != target.unit:
            raise FmuError(
                f"{c.source} [{source.unit}] -> {c.target} [{target.unit}]: units differ."
            )
        if str(source.kind) not in _TAKES[str(target.kind)]:
            raise FmuError(
                f"{c.source} ({source.type}) -> {c.target} ({target.type}): values would be "
                f"rounded or mean something else. Put a converting FMU between them."
            )
        if target.kind == "Enumeration" and source.items and target.items:
            strange = [
                f"{code} {item}" for item, code in source.items if (item, code) not in target.items
            ]
            if strange:
                raise FmuError(
                    f"{c.source} -> {c.target}: {', '.join(strange)} is no value of the "
                    f"enumeration there. Put a converting FMU between them."
                )


def connect(source: str, target: str, names: Iterable[str]) -> tuple[Connection, ...]:
    """Connections between variables of the same name on two slaves."""
    return tuple(Connection(f"{source}.{n}", f"{target}.{n}") for n in names)
