"""The values that connected slaves exchange, and the visits that bring them up to date."""

from collections.abc import Mapping, Sequence, Set
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from twin.errors import FmuError

from .slave.interface import Port
from .slave.slave import Slave
from .system import System


class Bus:
    """All outputs in use in one array, all connected inputs in another.

    Each slave's outputs and inputs are views of the two, so that one gather serves all slaves.

    Attributes:
        values: Outputs in use, shape (n,).
        position: "slave.output" -> where it is in `values`.
        source: "slave.input" -> the output that it takes.
    """

    def __init__(
        self, system: System, slaves: Mapping[str, Slave], record: Sequence[str] | None
    ) -> None:
        self.system, self.slaves = system, slaves
        self.source = {c.target: c.source for c in system.connections}
        if record is None:
            record = [f"{s.name}.{v}" for s in slaves.values() for v in s.interface.names("output")]
        self.recorded = tuple(record)
        wanted = dict.fromkeys([*record, *self.source.values()])
        outputs = {name: [v for s, v in map(system.split, wanted) if s == name] for name in slaves}
        inputs = {
            name: [v for s, v in map(system.split, self.source) if s == name] for name in slaves
        }
        names = [f"{s}.{v}" for s, variables in outputs.items() for v in variables]
        self.position = {name: i for i, name in enumerate(names)}
        self.values = np.zeros(len(names))
        fed = [f"{s}.{v}" for s, variables in inputs.items() for v in variables]
        self._gather = self.positions([self.source[name] for name in fed])
        self._inputs = np.zeros(len(fed))
        self._zeros = np.zeros(len(names))
        self._part: dict[str, NDArray[np.intp]] = {}
        sent = received = 0
        for name, s in slaves.items():
            m, n = len(inputs[name]), len(outputs[name])
            part = slice(sent, sent + m)
            s.bind(
                inputs[name],
                outputs[name],
                self._inputs[part],
                self.values[received : received + n],
            )
            self._part[name] = self._gather[part]
            sent, received = sent + m, received + n
        self._receivers = [s for s in slaves.values() if len(s.inputs)]
        self.columns = self.positions(record)

    def port(self, name: str) -> Port:
        """The variable "slave.variable"."""
        slave, variable = self.system.split(name)
        return self.slaves[slave].interface.port(variable)

    def positions(self, names: Sequence[str]) -> NDArray[np.intp]:
        """Where outputs are in `values`."""
        return np.array([self.position[n] for n in names], dtype=np.intp)

    def check(self, time_s: float) -> None:
        """Refuse what is no finite number: times 0, that alone is not 0. Callers mute `invalid`.

        Raises:
            FmuError: An output is NaN or infinite.
        """
        if not isfinite(self.values.dot(self._zeros)):
            at = int(np.argmin(np.isfinite(self.values)))
            slave, variable = self.system.split([*self.position][at])
            raise FmuError(
                f"{slave} ({self.slaves[slave].path.name}): {variable} = {self.values[at]:g} at "
                f"{time_s:g} s; outputs are finite numbers. Choose a shorter step, or ask who "
                f"made the FMU."
            )

    def write_all(self) -> None:
        """Send present values to the inputs of all slaves."""
        self._write(self._receivers)

    def write(self, slave: str) -> None:
        """Send present values to the inputs of one slave."""
        s = self.slaves[slave]
        if len(s.inputs):
            self.values.take(self._part[slave], None, s.inputs, "clip")
            s.write_inputs()

    def refresh(self, slaves: Sequence[Slave]) -> None:
        """Send present values to slaves and read what their outputs make of them."""
        self._write(slaves)
        for s in slaves:
            s.read_outputs()

    def _write(self, slaves: Sequence[Slave]) -> None:
        self.values.take(self._gather, None, self._inputs, "clip")
        for s in slaves:
            s.write_inputs()

    def dependencies(
        self, initial: bool = False, slaves: Set[str] | None = None
    ) -> dict[str, set[str]]:
        """Output -> the outputs that it directly depends on, through connected inputs.

        Args:
            initial: At the end of initialisation; else while stepping.
            slaves: Whose outputs; None: of all.
        """
        return {
            f"{s.name}.{output}": {
                self.source[f"{s.name}.{u}"] for u in inputs if f"{s.name}.{u}" in self.source
            }
            for s in self.slaves.values()
            if slaves is None or s.name in slaves
            for output, inputs in s.interface.dependencies(initial).items()
        }
