"""The co-simulation master: steps FMUs together with fixed communication steps.

Algorithms:
    jacobi        All slaves step from the values at the start of the step; outputs are read when
                  all have stepped. The same as libcosim to the last bit (whose steps, counted in
                  nanoseconds, differ from ours in the last bit).
    settled       Jacobi, and at each communication point the outputs that directly depend on
                  inputs are brought up to date in the order of the dependencies, so that a
                  sensor shows the present and not the previous instant. The same as ecos to the
                  last bit.
    gauss_seidel  Slaves step one after another in the order of the dependencies, each with the
                  newest outputs of those before it.

Source: FMI 3.0.1 specification, sec. 4 and 2.4.9; Gomes et al., Co-simulation: a survey, ACM
Computing Surveys 51 (2018), sec. 4.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from twin.errors import FmuError

from .slave import Slave, dependencies
from .system import Connection, System

Algorithm = Literal["jacobi", "settled", "gauss_seidel"]


@dataclass(frozen=True, slots=True)
class Recording:
    """Values at the communication points.

    Attributes:
        names: "slave.variable" of each column.
        time_s: Shape (n,).
        values: Shape (n, len(names)).
    """

    names: tuple[str, ...]
    time_s: NDArray[np.float64]
    values: NDArray[np.float64]

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """One column by name."""
        return self.values[:, self.names.index(name)]

    def frame(self) -> pd.DataFrame:
        """As a table with `time` first."""
        table = pd.DataFrame(self.values, columns=list(self.names))
        table.insert(0, "time", self.time_s)
        return table

    def write(self, path: Path) -> None:
        """Write Parquet or CSV, chosen by the suffix; CSV keeps every bit (shortest repr)."""
        if path.suffix == ".parquet":
            self.frame().to_parquet(path, index=False)
        elif path.suffix == ".csv":
            self.frame().to_csv(path, index=False)
        else:
            raise FmuError(f"{path.name}: recordings are written as .parquet or .csv.")


class Master:
    """Loads a system once and runs it as often as wanted; a context manager."""

    def __init__(self, system: System, record: Sequence[str] | None = None) -> None:
        """Load the FMUs.

        Args:
            system: What to run.
            record: "slave.variable" outputs to record; None: all outputs.

        Raises:
            FmuError: A file, a name, a unit or a connection is wrong.
        """
        self.system = system
        self.slaves: list[Slave] = []
        self._ready = False
        try:
            self._load(record)
        except BaseException:
            self.close()
            raise

    def _load(self, record: Sequence[str] | None) -> None:
        system = self.system
        incoming: dict[str, list[tuple[str, str]]] = {name: [] for name in system.fmus}
        for connection in system.connections:
            slave, variable = system.split(connection.target)
            system.split(connection.source)
            if any(variable == v for v, _ in incoming[slave]):
                raise FmuError(f"{connection.target} has two sources; an input takes one.")
            incoming[slave].append((variable, connection.source))
        self._starts: dict[str, dict[str, float]] = {name: {} for name in system.fmus}
        for name, value in system.starts.items():
            slave, variable = system.split(name)
            self._starts[slave][variable] = value
        for name, path in system.fmus.items():
            self.slaves.append(Slave(name, path))
        self._by_name = {s.name: s for s in self.slaves}
        self._check(system.connections)
        self._bind(incoming, record)
        self._order, self._direct = self._dependency_order()
        last = {i: visit for visit, i in enumerate(self._order)}
        self._sequence = sorted(last, key=last.__getitem__)
        self._periods = [system.periods.get(s.name, 1) for s in self.slaves]
        for name, period in system.periods.items():
            if name not in self._by_name or period < 1:
                raise FmuError(f"period of {name!r} = {period}: needs a slave and an integer >= 1.")
        self._all = list(range(len(self.slaves)))
        self._one_rate = all(k == 1 for k in self._periods)
        self._writes = [partial(self._write, i) for i in self._all if len(self.slaves[i].inputs)]

    def _bind(
        self, incoming: Mapping[str, list[tuple[str, str]]], record: Sequence[str] | None
    ) -> None:
        """One bus holds all outputs in use: each slave's outputs are a view of it, its inputs a
        gather from it."""
        sources = [c.source for c in self.system.connections]
        if record is None:
            record = [f"{s.name}.{v}" for s in self.slaves for v in s.output_names()]
        wanted = dict.fromkeys([*record, *sources])
        names = [n for s in self.slaves for n in wanted if self.system.split(n)[0] == s.name]
        offset = {name: i for i, name in enumerate(names)}
        self._bus = np.zeros(len(names))
        self._gather = []
        first = 0
        for s in self.slaves:
            own = [self.system.split(n)[1] for n in names if self.system.split(n)[0] == s.name]
            s.bind([v for v, _ in incoming[s.name]], own, self._bus[first : first + len(own)])
            first += len(own)
            gather = [offset[source] for _, source in incoming[s.name]]
            self._gather.append(np.array(gather, dtype=np.intp))
        self.record_names = tuple(record)
        self._columns = np.array([offset[n] for n in record], dtype=np.intp)

    def _check(self, connections: Sequence[Connection]) -> None:
        for c in connections:
            (a, x), (b, y) = self.system.split(c.source), self.system.split(c.target)
            source, target = self._by_name[a].port(x), self._by_name[b].port(y)
            if source.causality != "output" or target.causality != "input":
                raise FmuError(
                    f"{c.source} ({source.causality}) -> {c.target} ({target.causality}): "
                    f"a connection goes from an output to an input."
                )
            if source.unit and target.unit and source.unit != target.unit:
                raise FmuError(
                    f"{c.source} [{source.unit}] -> {c.target} [{target.unit}]: units differ."
                )

    def _dependency_order(self) -> tuple[list[int], list[bool]]:
        """Visits of slaves after which every output that directly depends on an input is right.

        A slave comes twice where some of its outputs are needed before its inputs are known: an
        airframe gives its position to a controller whose command enters its acceleration.

        Returns:
            Indices of slaves, and whether each has direct feed-through from another.

        Raises:
            FmuError: An output depends on itself.
        """
        source = {c.target: c.source for c in self.system.connections}
        felt: dict[str, set[str]] = {}
        own: list[list[str]] = []
        for s in self.slaves:
            own.append([])
            for output, inputs in dependencies(s.description).items():
                targets = [f"{s.name}.{u}" for u in inputs]
                felt[f"{s.name}.{output}"] = {source[t] for t in targets if t in source}
                own[-1].append(f"{s.name}.{output}")
        try:
            TopologicalSorter(felt).prepare()
        except CycleError as error:
            raise FmuError(
                f"Algebraic loop: {' -> '.join(error.args[1])}, each directly depending on the one "
                f"before it. Put a state or a delay between two of them."
            ) from None
        direct = [any(felt[o] for o in outputs) for outputs in own]
        order: list[int] = []
        done = set().union(*felt.values()) - felt.keys()  # not in the FMU's ModelStructure
        remaining = dict(enumerate(own))
        while remaining:
            ready = {i: [o for o in r if felt[o] <= done] for i, r in remaining.items()}
            whole = [i for i, r in ready.items() if len(r) == len(remaining[i])]
            i = whole[0] if whole else next(i for i, r in ready.items() if r)
            order.append(i)
            done.update(ready[i])
            remaining[i] = [o for o in remaining[i] if o not in done]
            if not remaining[i]:
                del remaining[i]
        return order, direct

    # -- running --------------------------------------------------------------------------

    def initialize(
        self, start_time_s: float = 0.0, starts: Mapping[str, float] | None = None
    ) -> None:
        """Reset, set start values and initialise all slaves at a time.

        Args:
            start_time_s: Time of the first communication point.
            starts: Start values on top of the system's, "slave.variable" -> value.
        """
        values = {name: dict(v) for name, v in self._starts.items()}
        for name, value in (starts or {}).items():
            slave, variable = self.system.split(name)
            values[slave][variable] = value
        for s in self.slaves:
            s.reset()
            s.initialize(start_time_s, values[s.name])
        for _ in range(2):  # inputs may enter initial states, whose order is not known
            self._settle(range(len(self.slaves)))
        for s in self.slaves:
            s.finish_initialization()
        self._settle(range(len(self.slaves)))
        self.time_s = start_time_s
        self._start_s, self._count = start_time_s, 0
        self._ready = True

    def run(
        self,
        stop_time_s: float,
        step_s: float,
        algorithm: Algorithm = "jacobi",
        every: int = 1,
        progress: Callable[[float], None] | None = None,
    ) -> Recording:
        """Step until a time; the first row is the present.

        Args:
            stop_time_s: Time of the last communication point.
            step_s: Base communication step.
            algorithm: See the module.
            every: Record every so many steps.
            progress: Called now and then with the time reached.

        Raises:
            FmuError: The step is not positive, the time is past, or a slave failed.
        """
        if not step_s > 0 or not np.isfinite(step_s):
            raise FmuError(f"communication step {step_s:g} s must be positive, e.g. 0.001.")
        if not np.isfinite(stop_time_s):
            raise FmuError(f"stop time {stop_time_s:g} s must be a finite number.")
        if every < 1:
            raise FmuError(f"every = {every}: record every so many steps, at least 1.")
        if not self._ready:
            raise FmuError("the system is not initialised: call initialize() before run().")
        steps = round((stop_time_s - self.time_s) / step_s)
        if steps < 0 or abs(self.time_s + steps * step_s - stop_time_s) > 1e-6 * step_s * max(
            1, steps
        ):
            raise FmuError(
                f"from {self.time_s:g} s to {stop_time_s:g} s is not a whole number of steps of "
                f"{step_s:g} s."
            )
        rows = steps // every + 1
        time, values = np.empty(rows), np.empty((rows, len(self.record_names)))
        advance = {
            "jacobi": self._jacobi,
            "settled": self._settled,
            "gauss_seidel": self._gauss_seidel,
        }
        if algorithm not in advance:
            raise FmuError(f"algorithm {algorithm!r}: choose {', '.join(advance)}.")
        step, bus, columns = advance[algorithm], self._bus, self._columns
        everything = np.array_equal(columns, np.arange(len(bus)))
        time[0], values[0] = self.time_s, bus[columns]
        first, origin = self._count, self.time_s
        for k in range(1, steps + 1):
            step(step_s)
            self.time_s = origin + k * step_s
            self._count = first + k
            if k % every == 0:
                time[k // every] = self.time_s
                values[k // every] = bus if everything else bus[columns]
            if progress is not None and k % 1000 == 0:
                progress(self.time_s)
        return Recording(self.record_names, time, values)

    def _jacobi(self, h: float) -> None:
        if self._one_rate:
            for write in self._writes:
                write()
            for s in self.slaves:
                s.step(self.time_s, h)
            for s in self.slaves:
                s.read_outputs()
            return
        due = self._due()
        for i in range(len(self.slaves)):
            if self._count % self._periods[i] == 0:
                self._write(i)
        for i in due:
            k = self._periods[i]
            self.slaves[i].step(self.time_s - (k - 1) * h, k * h)
        for i in due:
            self._read(i)

    def _settled(self, h: float) -> None:
        self._jacobi(h)
        self._settle([i for i in self._due() if self._direct[i]])

    def _gauss_seidel(self, h: float) -> None:
        due = set(self._due())
        for i in self._sequence:
            if i not in due:
                continue
            k = self._periods[i]
            self._write(i)
            self.slaves[i].step(self.time_s - (k - 1) * h, k * h)
            self._read(i)

    def _due(self) -> list[int]:
        """Slaves whose period ends with the step under way."""
        if self._one_rate:
            return self._all
        return [i for i, k in enumerate(self._periods) if (self._count + 1) % k == 0]

    def _settle(self, which: Sequence[int] | range) -> None:
        """Set inputs and read outputs without stepping, in the order of the dependencies."""
        chosen = set(which)
        for i in self._order:
            if i in chosen:
                self._write(i)
                self._read(i)

    def _write(self, i: int) -> None:
        s = self.slaves[i]
        if len(s.inputs):
            self._bus.take(self._gather[i], None, s.inputs, "clip")
            s.write_inputs()

    def _read(self, i: int) -> None:
        self.slaves[i].read_outputs()

    # -- end ------------------------------------------------------------------------------

    def close(self) -> None:
        """Free all slaves."""
        for s in self.slaves:
            s.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
