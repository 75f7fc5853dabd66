"""What one communication step does.

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

Source: FMI 3.0.1 specification, sec. 4 and 2.4.9; Gomes et al., Co-simulation: a survey, ACM
Computing Surveys 51 (2018), sec. 4.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Literal, get_args

from fmus.order import Loop, slave_of, visits
from twin.errors import FmuError

from .bus import Bus
from .loops import LoopSolver
from .order import batches, stepping_order
from .slave.slave import Slave

Algorithm = Literal["jacobi", "settled", "gauss_seidel"]
Settle = Callable[[float], None]


class Stepping:
    """The algorithms over one bus.

    Attributes:
        count: Base steps since the start.
        one_rate: Whether every slave steps every time.
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
        self._solver = cache(lambda loop: LoopSolver(bus, loop))
        self._settling = cache(self._make_settling)
        self._sequence = cache(self._make_sequence)

    def algorithm(self, name: str) -> Callable[[float, float], None]:
        """A function that steps everything from a time over a step, by name."""
        known = {"jacobi": self._jacobi, "settled": self._settled, "gauss_seidel": self._seidel}
        if name not in known:
            raise FmuError(f"algorithm {name!r}: choose {', '.join(get_args(Algorithm))}.")
        return known[name]

    def settle(self, time_s: float, initial: bool = False) -> None:
        """Bring all outputs up to date without stepping, loops included.

        Args:
            time_s: For messages.
            initial: During initialisation.
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
        """Step everything from what is on the bus, then read some of it."""
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
        """Slaves whose period ends with the step under way."""
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
