"""What a radio link does to datagrams: some are lost, all are late, not all alike."""

import heapq
from dataclasses import dataclass, field

import numpy as np

from twin.errors import TwinError


@dataclass(frozen=True, slots=True)
class Faults:
    """Faults of a link, drawn from a seed.

    Attributes:
        loss: Share of datagrams that are lost, 0..1.
        jitter_s: Each is late by up to so much, all delays alike probable, s.
        drift: By how much the aircraft's clock is faster than the listener's: 2e-5 is 20 ppm.
        seed: Of what is drawn.
    """

    loss: float = 0.0
    jitter_s: float = 0.0
    drift: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.loss < 1.0:
            raise TwinError(f"loss {self.loss:g}: a share of 0 to below 1, 0.05 for 5 %.")
        if not 0.0 <= self.jitter_s <= 10.0:
            raise TwinError(f"jitter {self.jitter_s:g} s: 0 to 10 s.")
        if not abs(self.drift) <= 1e-2:
            raise TwinError(f"drift {1e6 * self.drift:g} ppm: at most 10000 ppm.")


@dataclass(slots=True)
class Link:
    """A link with faults: datagrams in, datagrams out when they are due.

    Attributes:
        faults: What it does.
        lost: How many were lost.
    """

    faults: Faults
    lost: int = 0
    _rng: np.random.Generator = field(init=False)
    _on_the_way: list[tuple[float, int, bytes]] = field(default_factory=list)
    _count: int = 0

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.faults.seed)

    def send(self, at_s: float, datagram: bytes) -> None:
        """Take a datagram at a time, s."""
        self._count += 1
        if self.faults.loss and self._rng.random() < self.faults.loss:
            self.lost += 1
            return
        late_s = self._rng.random() * self.faults.jitter_s if self.faults.jitter_s else 0.0
        heapq.heappush(self._on_the_way, (at_s + late_s, self._count, datagram))

    def due(self, now_s: float) -> list[bytes]:
        """Datagrams that arrive by now, in the order in which they do."""
        found = []
        while self._on_the_way and self._on_the_way[0][0] <= now_s:
            found.append(heapq.heappop(self._on_the_way)[2])
        return found

    @property
    def next_s(self) -> float:
        """When the next one arrives; infinite where none is on the way."""
        return self._on_the_way[0][0] if self._on_the_way else np.inf
