"""Training samples: validation split, and random windows of the rest."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..data.channels import N_PHASES
from ..data.flights import ResidualFlight
from ..data.scaling import in_spans
from ..data.sequences import SpanSequence
from ..model.compensator import network_inputs

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MANY_FLIGHTS = 4
"""Number of flights from which on whole flights are used for validation, under any protocol."""
SHORTEST_STRETCH = 20
"""Least number of samples of a phase's stretch of which a part is used for validation."""


def validation_rows(
    flights: Sequence[ResidualFlight], share: float, seed: int, least: int = MANY_FLIGHTS
) -> list[BoolArray]:
    """Validation samples of each flight, shape (n,).

    With `least` flights or more, some whole flights are used, since a network fits one flight
    quickly; but none that is the only one with a phase. For phases then without validation data,
    and for all phases with fewer flights, the end of each stretch is used.
    """
    chosen: set[int] = set()
    if len(flights) >= least:
        chosen = _whole_flights(flights, max(1, round(share * len(flights))), seed)
    covered = np.zeros(N_PHASES, dtype=np.bool_)
    for i in chosen:
        covered |= _phases(flights[i])
    return [
        in_spans(f) if i in chosen else _ends(f, share, ~covered) for i, f in enumerate(flights)
    ]


def _whole_flights(flights: Sequence[ResidualFlight], count: int, seed: int) -> set[int]:
    """At most so many flights in random order, whose phases all occur in another flight as well."""
    left = np.sum([_phases(f) for f in flights], axis=0)
    chosen: set[int] = set()
    for i in np.random.default_rng(seed).permutation(len(flights)):
        phases = _phases(flights[i])
        if len(chosen) < count and np.all(left[phases] > 1):
            chosen.add(int(i))
            left = left - phases
    return chosen


def _phases(flight: ResidualFlight) -> BoolArray:
    """Whether a flight contains each phase for long enough, shape (phases,)."""
    count = np.bincount(flight.phase[in_spans(flight)], minlength=N_PHASES)
    return np.asarray(count >= SHORTEST_STRETCH)


def _ends(flight: ResidualFlight, share: float, wanted: BoolArray) -> BoolArray:
    """The last share of each stretch of the wanted phases, shape (n,)."""
    rows = np.zeros(len(flight.t_s), dtype=np.bool_)
    for a, b in flight.spans:
        edges = np.flatnonzero(np.diff(flight.phase[a:b])) + a + 1
        for start, end in zip([a, *edges], [*edges, b], strict=True):
            if wanted[flight.phase[start]] and end - start >= SHORTEST_STRETCH:
                rows[end - round(share * (end - start)) : end] = True
    return rows


@dataclass(frozen=True, slots=True)
class Window:
    """Samples of one optimiser step, shapes (batch, time, ...).

    Attributes:
        begins: Whether the state before it is zero; otherwise it continues the window before.
        known: Standardised residuals, (batch, time, 15).
        features: Standardised features, (batch, time, features).
        phase: One-hot phase, (batch, time, phases).
        target: Target of the network, (batch, time, 15).
        scored: 1 where the target counts, (batch, time, 15).
    """

    begins: bool
    known: Tensor
    features: Tensor
    phase: Tensor
    target: Tensor
    scored: Tensor

    def at(self, device: torch.device) -> "Window":
        """The window on a device."""
        names = ("known", "features", "phase", "target", "scored")
        return replace(self, **{name: getattr(self, name).to(device) for name in names})


class TrainingSamples:
    """All spans concatenated, float32, with a row of zeros at the end as padding.

    Args:
        spans: Spans of all training flights.
        left: Target of the network in each span, shape (n, 15).
        train: Samples that count in each span, shape (n, 15).
    """

    def __init__(
        self,
        spans: Sequence[SpanSequence],
        left: Sequence[Array],
        train: Sequence[BoolArray],
    ) -> None:
        inputs = [network_inputs(span) for span in spans]
        self.known, self.features, self.phase = (_padded([i[k] for i in inputs]) for k in range(3))
        self.target = _padded([torch.from_numpy(a.astype(np.float32)) for a in left])
        self.scored = _padded([torch.from_numpy(a.astype(np.float32)) for a in train])
        ends = np.cumsum([len(span.d) for span in spans])
        self.bounds = [(int(e) - len(s.d), int(e)) for s, e in zip(spans, ends, strict=True)]

    def windows(
        self,
        batch: int,
        window: int,
        seed: int,
        epoch: int,
        stride: int | None = None,
        carry: int = 1,
        augment: float = 0.0,
    ) -> Iterator[Window]:
        """Windows of one epoch in random order, reproducible by seed and epoch.

        Args:
            batch: Number of windows per step.
            window: Number of samples per window.
            seed: Random seed of the order and of the augmentation.
            epoch: Number of the epoch.
            stride: Stride of the windows, as the next two in `learning.preset.Preset`.
            carry: Number of windows over which the state is carried.
            augment: Spread of the augmentation.
        """
        rng = np.random.default_rng([seed, epoch])
        segments = self._segments(carry * window, stride, rng)
        segments = [segments[i] for i in rng.permutation(len(segments))]
        for k in range(0, len(segments), batch):
            chosen = segments[k : k + batch]
            count = -(-max(b - a for a, b in chosen) // window)
            index = np.full((len(chosen), count * window), len(self.known) - 1)
            for row, (a, b) in zip(index, chosen, strict=True):
                row[: b - a] = np.arange(a, b)
            draws = rng.normal(0.0, augment, (2, len(chosen), 1, self.known.shape[-1]))
            amplitude, offset = torch.from_numpy(draws.astype(np.float32))
            for w in range(count):
                rows = torch.from_numpy(index[:, w * window : (w + 1) * window])
                yield Window(
                    begins=w == 0,
                    known=self.known[rows] * (1 + amplitude) + offset,
                    features=self.features[rows],
                    phase=self.phase[rows],
                    target=self.target[rows] * (1 + amplitude) + offset,
                    scored=self.scored[rows],
                )

    def _segments(
        self, length: int, stride: int | None, rng: np.random.Generator
    ) -> list[tuple[int, int]]:
        """Rows [a, b) over which the state is carried; only those with a sample that counts."""
        stride = stride or length
        segments = []
        for a, b in self.bounds:
            first = a - int(rng.integers(stride)) if b - a > length else a
            starts = range(first, b, stride)
            segments += [(max(s, a), min(s + length, b)) for s in starts]
        return [(a, b) for a, b in segments if b > a and bool(self.scored[a:b].any())]


def _padded(parts: Sequence[Tensor]) -> Tensor:
    joined = torch.cat(list(parts))
    return torch.cat([joined, torch.zeros_like(joined[:1])])
