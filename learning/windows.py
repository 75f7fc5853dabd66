"""Training samples: what is held back for validation, and random windows of the rest."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .compensator import network_inputs
from .flights import ResidualFlight
from .preset import Preset
from .sequences import SpanSequence

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MANY_FLIGHTS = 4
"""From here on whole flights are held back for validation."""
SHORTEST_STRETCH = 20
"""Samples of a phase, below which nothing of it is held back."""


def validation_rows(flights: Sequence[ResidualFlight], share: float, seed: int) -> list[BoolArray]:
    """Samples held back for validation, per flight, shape (n,).

    With four flights or more whole flights, drawn by the seed; with fewer the end of each phase,
    so that every phase is looked at.
    """
    if len(flights) >= MANY_FLIGHTS:
        count = max(1, round(share * len(flights)))
        drawn = np.random.default_rng(seed).permutation(len(flights))[:count]
        return [np.full(len(f.t_s), i in drawn) for i, f in enumerate(flights)]
    held_back = []
    for flight in flights:
        rows = np.zeros(len(flight.t_s), dtype=np.bool_)
        for a, b in flight.spans:
            edges = np.flatnonzero(np.diff(flight.phase[a:b])) + a + 1
            for start, end in zip([a, *edges], [*edges, b], strict=True):
                if end - start >= SHORTEST_STRETCH:
                    rows[end - round(share * (end - start)) : end] = True
        held_back.append(rows)
    return held_back


@dataclass(frozen=True, slots=True)
class Window:
    """Samples for one step of the optimiser, shapes (batch, time, ...).

    Attributes:
        begins: The state is zero before it; else it follows on the window before.
        known: (batch, time, 15).
        features: (batch, time, features).
        phase: One-hot, (batch, time, phases).
        target: (batch, time, 15).
        scored: 1 where the target counts, (batch, time, 15).
    """

    begins: bool
    known: Tensor
    features: Tensor
    phase: Tensor
    target: Tensor
    scored: Tensor


class TrainingSamples:
    """All spans one behind the other, float32, with a row of zeros at the end as padding.

    Args:
        spans: Of all training flights.
        left: Per span what the network shall give, shape (n, 15).
        train: Per span the samples that count, shape (n, 15).
        offset_left: What an offset of 1 in the residual adds to `left`, shape (15,).
    """

    def __init__(
        self,
        spans: Sequence[SpanSequence],
        left: Sequence[Array],
        train: Sequence[BoolArray],
        offset_left: Array,
    ) -> None:
        inputs = [network_inputs(span) for span in spans]
        self.known, self.features, self.phase = (_padded([i[k] for i in inputs]) for k in range(3))
        self.target = _padded([torch.from_numpy(a.astype(np.float32)) for a in left])
        self.scored = _padded([torch.from_numpy(a.astype(np.float32)) for a in train])
        self.offset_left = torch.from_numpy(offset_left.astype(np.float32))
        ends = np.cumsum([len(span.d) for span in spans])
        self.bounds = [(int(e) - len(s.d), int(e)) for s, e in zip(spans, ends, strict=True)]

    def windows(self, preset: Preset, seed: int, epoch: int) -> Iterator[Window]:
        """The windows of one epoch, in random order: the same for the same seed and epoch."""
        rng = np.random.default_rng([seed, epoch])
        segments = self._segments(preset, rng)
        segments = [segments[i] for i in rng.permutation(len(segments))]
        for k in range(0, len(segments), preset.batch):
            chosen = segments[k : k + preset.batch]
            count = -(-max(b - a for a, b in chosen) // preset.window)
            index = np.full((len(chosen), count * preset.window), len(self.known) - 1)
            for row, (a, b) in zip(index, chosen, strict=True):
                row[: b - a] = np.arange(a, b)
            draws = rng.normal(0.0, preset.augment, (2, len(chosen), 1, self.known.shape[-1]))
            amplitude, offset = torch.from_numpy(draws.astype(np.float32))
            for w in range(count):
                rows = torch.from_numpy(index[:, w * preset.window : (w + 1) * preset.window])
                yield Window(
                    begins=w == 0,
                    known=self.known[rows] * (1 + amplitude) + offset,
                    features=self.features[rows],
                    phase=self.phase[rows],
                    target=self.target[rows] * (1 + amplitude) + offset * self.offset_left,
                    scored=self.scored[rows],
                )

    def _segments(self, preset: Preset, rng: np.random.Generator) -> list[tuple[int, int]]:
        """Rows [a, b) over which the state is carried on; only those with a sample that counts."""
        length = preset.carry * preset.window
        stride = preset.stride or length
        segments = []
        for a, b in self.bounds:
            first = a - int(rng.integers(stride)) if b - a > length else a
            starts = range(first, b, stride)
            segments += [(max(s, a), min(s + length, b)) for s in starts]
        return [(a, b) for a, b in segments if b > a and bool(self.scored[a:b].any())]


def _padded(parts: Sequence[Tensor]) -> Tensor:
    joined = torch.cat(list(parts))
    return torch.cat([joined, torch.zeros_like(joined[:1])])
