"""Algorithms of one communication step.

Algorithms:
    jacobi        All slaves step from the values at the start of the step; outputs are read when
                  all have stepped. The same as libcosim to the last bit (whose steps, counted in
                  nanoseconds, differ from ours in the last bit).
    settled       Jacobi, and at each communication point the outputs that directly depend on
                  inputs are brought up to date in the order of the dependencies, so that a
                  sensor shows the present and not the previous instant; algebraic loops are
                  solved. Without loops the same as ecos to the last bit.
    gauss_seidel  Slaves step one after another in the order of the dependencies, each with the
                  newest outputs of those before it; a loop is solved as soon as all its slaves
                  have stepped.

An algebraic loop between slaves has the values v of its outputs on both sides: v = g(v), where g
sets the connected inputs of all slaves in the loop and reads their outputs. It is solved by
Newton's method: each iteration solves (1 - dg/dv) step = g(v) - v with the directional derivatives
of the FMUs; a step that does not reduce g(v) - v is halved.

Sources: FMI 3.0.1 specification, sec. 4 and 2.4.9; FMI 2.0.4, sec. 4.2.4; Gomes et al.,
Co-simulation: a survey, ACM Computing Surveys 51 (2018), sec. 4; Deuflhard, Newton Methods for
Nonlinear Problems, ch. 3.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from fmus.order import Loop, Visit, slave_of, visits
from twin.errors import FmuError

from .calls import SharedTrace
from .compiled import CompiledSteps, Verb, library
from .interface import Port
from .slave import Slave, jacobian
from .system import System


class Bus:
    """All connected or recorded outputs in one array, all connected inputs in another.

    Each slave's outputs and inputs are views of the two, so that one gather serves all slaves.

    Attributes:
        values: Values of the outputs, shape (n,).
        position: "slave.output" -> index in `values`.
        source: "slave.input" -> its source output.
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
        """Indices of outputs in `values`."""
        return np.array([self.position[n] for n in names], dtype=np.intp)

    def check(self, time_s: float) -> None:
        """Refuse values that are not finite: only they differ from 0 after multiplication by 0.
        Callers mute `invalid`.

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

    def compiled(
        self, take_steps: Any, plan: Sequence[tuple[Verb, Slave]], trace: SharedTrace | None
    ) -> CompiledSteps:
        """Steps in C of a plan."""
        return CompiledSteps(take_steps, plan, self.values, self._part, trace)

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
        """Send present values to slaves and read the resulting outputs."""
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
        """Output -> the outputs on which it directly depends, through connected inputs.

        Args:
            initial: Whether at the end of initialisation; else while stepping.
            slaves: Slaves with the outputs; None: all.
        """
        return {
            f"{s.name}.{output}": {
                self.source[f"{s.name}.{u}"] for u in inputs if f"{s.name}.{u}" in self.source
            }
            for s in self.slaves.values()
            if slaves is None or s.name in slaves
            for output, inputs in s.interface.dependencies(initial).items()
        }


def batches(
    order: Iterable[Visit], dependencies: Mapping[str, Set[str]]
) -> list[tuple[str, ...] | Loop]:
    """Successive independent slaves in one batch."""
    sources_of: dict[str, set[str]] = {}
    for output, sources in dependencies.items():
        sources_of.setdefault(slave_of(output), set()).update(map(slave_of, sources))
    result: list[tuple[str, ...] | Loop] = []
    for visit in order:
        last = result[-1] if result else None
        if isinstance(visit, Loop):
            result.append(visit)
        elif isinstance(last, tuple) and visit not in last and not sources_of[visit] & {*last}:
            result[-1] = (*last, visit)
        else:
            result.append((visit,))
    return result


def stepping_order(order: Iterable[Visit], slaves: Iterable[str]) -> list[Visit]:
    """Every slave once, by its last visit, and every loop as soon as its last member has stepped.

    Slaves that are never visited, those without outputs, come last.
    """
    order = list(order)
    last = {
        s: i
        for i, v in enumerate(order)
        for s in ([v] if isinstance(v, str) else map(slave_of, v.outputs))
    }
    sequence = sorted(slaves, key=lambda s: last.get(s, len(order)))
    result: list[Visit] = list(sequence)
    for loop in (v for v in order if isinstance(v, Loop)):
        end = 1 + max(result.index(slave_of(o)) for o in loop.outputs)
        while end < len(result) and isinstance(result[end], Loop):
            end += 1  # loops with the same last member remain in order
        result.insert(end, loop)
    return result


Array = NDArray[np.float64]
TOLERANCE = 1e-12
"""Relative residual at which the iterations end."""
ROUNDING = 1e-9
"""Residual that is accepted where no step reduces it further."""
SMALLEST = 1e-300
"""Lower bound of the scale of a residual."""
MAX_ITERATIONS = 30
"""Largest number of Newton iterations. Made up."""
MAX_HALVINGS = 20
"""Largest number of halvings of one step. Made up."""


@dataclass(frozen=True, slots=True)
class _Block:
    """Part of dg/dv from one slave.

    Attributes:
        rows: Indices of its outputs in the loop.
        takes: Loop value of each of its inputs, shape (inputs, loop), 0 or 1.
        slope: Derivatives of outputs with respect to inputs.
    """

    rows: list[int]
    takes: Array
    slope: Callable[[], Array]


class LoopSolver:
    """Solver for one loop on the bus, starting from the values there."""

    def __init__(self, bus: Bus, loop: Loop) -> None:
        self._bus, self._loop = bus, loop
        self._at = bus.positions(loop.outputs)
        self._members = list(dict.fromkeys(map(slave_of, loop.outputs)))
        self._blocks = [self._block(name) for name in self._members]
        self._slope = np.zeros((len(self._at), len(self._at)))
        self._regular = False

    def _block(self, name: str) -> _Block:
        loop, bus, s = self._loop.outputs, self._bus, self._bus.slaves[name]
        rows = [i for i, o in enumerate(loop) if slave_of(o) == name]
        inputs = [u for u in s.bound_inputs if bus.source[f"{name}.{u}"] in loop]
        takes = np.array([[bus.source[f"{name}.{u}"] == o for o in loop] for u in inputs])
        outputs = [bus.system.split(loop[i])[1] for i in rows]
        return _Block(rows, takes.astype(np.float64), jacobian(s, outputs, inputs))

    def solve(self, time_s: float) -> None:
        """Solve the loop; the solution is on the bus and in the slaves.

        Raises:
            FmuError: Newton's method did not converge.
        """
        v = self._bus.values[self._at]
        residual, size = self._residual(v), np.abs(v)
        for _ in range(MAX_ITERATIONS):
            size = np.maximum(size, np.abs(v + residual))
            scale = size + np.abs(self._slope) @ size + SMALLEST
            if self._regular and np.all(np.abs(residual) <= TOLERANCE * scale):
                return
            step = self._newton_step(residual, time_s)
            if not residual.any():
                return
            v, better = self._descend(v, residual, step, scale)
            if better is None:
                if np.all(np.abs(self._residual(v)) <= ROUNDING * scale):
                    return
                break
            residual = better
        raise self._error(time_s, residual, "Newton's method does not converge")

    def _newton_step(self, residual: Array, time_s: float) -> Array:
        """The full step from the present inputs."""
        for block in self._blocks:
            self._slope[block.rows] = block.slope() @ block.takes
        try:
            step = np.linalg.solve(np.eye(len(residual)) - self._slope, residual)
        except np.linalg.LinAlgError:
            raise self._error(time_s, residual, "it has no unique solution") from None
        self._regular = True
        return step.astype(np.float64, copy=False)

    def _descend(
        self, v: Array, residual: Array, step: Array, scale: Array
    ) -> tuple[Array, Array | None]:
        """The first of step, step / 2, step / 4, ... that reduces the residual; None: none."""
        worst = np.max(np.abs(residual) / scale)
        for _ in range(MAX_HALVINGS):
            after = self._residual(v + step)
            if np.max(np.abs(after) / scale) < worst:
                return v + step, after
            step = step / 2
        return v, None

    def _residual(self, v: Array) -> Array:
        """Residual g(v) - v; leaves v in the inputs and g(v) on the bus."""
        bus = self._bus
        bus.values[self._at] = v
        for name in self._members:
            bus.write(name)
        for name in self._members:
            bus.slaves[name].read_outputs()
        return bus.values[self._at] - v

    def _error(self, time_s: float, residual: Array, what: str) -> FmuError:
        worst = int(np.argmax(np.abs(residual)))
        return FmuError(
            f"Algebraic loop {' -> '.join(self._loop.outputs)} at {time_s:g} s: {what}; residual "
            f"{residual[worst]:.3g} at {self._loop.outputs[worst]}. Put a state or a delay "
            f"between two of them, or start nearer to the solution."
        )


Algorithm = Literal["jacobi", "settled", "gauss_seidel"]
Settle = Callable[[float], None]


class Stepping:
    """The algorithms for one bus.

    Attributes:
        count: Number of base steps since the start.
        one_rate: Whether every slave steps in every base step.
        compiled: Steps in C of an algorithm with a trace; None where there are none.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._slaves = list(bus.slaves.values())
        self._period = {s.name: bus.system.periods.get(s.name, 1) for s in self._slaves}
        self._all = frozenset(self._period)
        self._direct = {slave_of(o) for o, sources in bus.dependencies().items() if sources}
        self._indirect = [s for s in self._slaves if s.name not in self._direct]
        self.one_rate = all(k == 1 for k in self._period.values())
        self.count = 0
        self.compiled = cache(self._make_compiled)
        self._solver = cache(lambda loop: LoopSolver(bus, loop))
        self._settling = cache(self._make_settling)
        self._sequence = cache(self._make_sequence)

    def algorithm(self, name: str) -> Callable[[float, float], None]:
        """A function that steps all slaves from a time over a step, by name."""
        known = {"jacobi": self._jacobi, "settled": self._settled, "gauss_seidel": self._seidel}
        if name not in known:
            raise FmuError(f"algorithm {name!r}: choose {', '.join(get_args(Algorithm))}.")
        return known[name]

    def _make_compiled(self, name: str, trace: SharedTrace | None) -> CompiledSteps | None:
        """The same in C; None where this needs more than a list of calls, or without a compiler."""
        plan, take_steps = self._plan(name) if self.one_rate else None, library()
        if plan is None or take_steps is None:
            return None
        return self._bus.compiled(take_steps, plan, trace)

    def _plan(self, name: str) -> list[tuple[Verb, Slave]] | None:
        """What a step does with which slave; None where it solves a loop."""
        if name == "gauss_seidel":
            sequence = self._sequence(self._all)
            if any(loop is not None for _, loop in sequence):
                return None
            verbs: tuple[Verb, ...] = ("set", "step", "get")
            return [(verb, self._bus.slaves[s]) for s, _ in sequence for verb in verbs]
        plan: list[tuple[Verb, Slave]] = [("set", s) for s in self._slaves]
        plan += [("step", s) for s in self._slaves]
        plan += [("get", s) for s in (self._slaves if name == "jacobi" else self._indirect)]
        if name == "settled":
            dependencies = self._bus.dependencies(slaves=self._direct)
            for batch in batches(visits(dependencies), dependencies):
                if isinstance(batch, Loop):
                    return None
                slaves = [self._bus.slaves[s] for s in batch]
                plan += [(verb, s) for verb in ("set", "get") for s in slaves]
        return plan

    def settle(self, time_s: float, initial: bool = False) -> None:
        """Update all outputs without stepping, loops included.

        Args:
            time_s: Time for messages.
            initial: Whether during initialisation.
        """
        for settle in self._settles(self._bus.dependencies(initial)):
            settle(time_s)

    def _jacobi(self, time_s: float, h: float) -> None:
        self._advance(time_s, h, self._slaves)

    def _settled(self, time_s: float, h: float) -> None:
        due = self._due()
        self._advance(time_s, h, self._indirect)  # the others are read when they are settled
        for settle in self._settling(due):
            settle(time_s + h)

    def _advance(self, time_s: float, h: float, read: Sequence[Slave]) -> None:
        """Step all slaves with the values on the bus, then read some outputs."""
        if self.one_rate:
            self._bus.write_all()
            for s in self._slaves:
                s.step(time_s, h)
        else:
            due = self._due()
            for name, k in self._period.items():
                if self.count % k == 0:
                    self._bus.write(name)
            for s in self._slaves:
                if s.name in due:
                    k = self._period[s.name]
                    s.step(time_s - (k - 1) * h, k * h)
            read = [s for s in read if s.name in due]
        for s in read:
            s.read_outputs()
        self.count += 1

    def _seidel(self, time_s: float, h: float) -> None:
        for name, loop in self._sequence(self._due()):
            if loop is not None:
                loop(time_s + h)
                continue
            k, s = self._period[name], self._bus.slaves[name]
            self._bus.write(name)
            s.step(time_s - (k - 1) * h, k * h)
            s.read_outputs()
        self.count += 1

    def _due(self) -> frozenset[str]:
        """Slaves whose period ends with the present step."""
        if self.one_rate:
            return self._all
        return frozenset(s for s, k in self._period.items() if (self.count + 1) % k == 0)

    def _make_settling(self, due: frozenset[str]) -> list[Settle]:
        return self._settles(self._bus.dependencies(slaves=due & self._direct))

    def _settles(self, dependencies: dict[str, set[str]]) -> list[Settle]:
        return [
            self._solver(v).solve if isinstance(v, Loop) else self._refresh(v)
            for v in batches(visits(dependencies), dependencies)
        ]

    def _refresh(self, names: tuple[str, ...]) -> Settle:
        slaves = [self._bus.slaves[n] for n in names]
        return lambda _: self._bus.refresh(slaves)

    def _make_sequence(self, due: frozenset[str]) -> list[tuple[str, Settle | None]]:
        order = visits(self._bus.dependencies(slaves=due))
        return [
            ("", self._solver(v).solve) if isinstance(v, Loop) else (v, None)
            for v in stepping_order(order, [s for s in self._period if s in due])
        ]
