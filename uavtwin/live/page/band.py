"""Where residuals of a flight are expected: where they were in its first seconds.

What begins in mid-flight is seen against what the twin missed before.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.residuals.gap import Channel

LEARNT_S = 20.0
"""Of samples in the air, from which the band is learnt; it stays then."""
COVERED = 0.95
_FEWEST = 20
Key = tuple[str, float]


@dataclass(slots=True)
class ExpectedBands:
    """Bands of the channels of one flight, by name and horizon."""

    bands: dict[Key, tuple[float, float]] = field(default_factory=dict)
    _parts: dict[Key, list[NDArray[np.float64]]] = field(default_factory=dict)
    _first_s: dict[Key, float] = field(default_factory=dict)

    def add(self, channels: Sequence[Channel]) -> None:
        """Take new residuals, until enough is known."""
        for channel in channels:
            key = channel.name, channel.horizon_s
            if key in self.bands or not len(channel.t_s):
                continue
            residual = channel.residual
            parts = self._parts.setdefault(key, [])
            parts.append(residual[np.isfinite(residual)])
            began_s = self._first_s.setdefault(key, float(channel.t_s[0]))
            if channel.t_s[-1] - began_s < LEARNT_S or sum(map(len, parts)) < _FEWEST:
                continue
            tail = 50 * (1 - COVERED)
            low, high = np.percentile(np.concatenate(parts), [tail, 100 - tail])
            if math.isfinite(low):
                self.bands[key] = float(low), float(high)
            del self._parts[key]
