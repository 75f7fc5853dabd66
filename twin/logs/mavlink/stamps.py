"""Which time stamps belong to the clock of the aircraft.

A stamp is held against the newest one: from 1 s before it to 60 s after it belongs to the same
clock. Others are strays: damaged, or of another clock. Strays that agree with each other and
outnumber the rest are the clock after a restart.
"""

from enum import Enum

LATEST_US = 2**53
"""Year 2255 in us since 1970: no clock of an aircraft, since boot or since 1970, is beyond it."""
_BACK_US, _AHEAD_US = 1_000_000, 60_000_000
_RESTART = 20
"""Lead of strays that agree with each other over stamps of the clock that is a restart."""
_CONFIRMED = 5
"""Stamps of one clock after which it is taken for that of the aircraft."""
_CONTRADICTED = 3
"""The same lead while the clock is not confirmed: the first stamps were strays."""


class Stamp(Enum):
    """What a stamp is."""

    FINE = "of the clock"
    STRAY = "far from the clock"
    RESTART = "of a clock that began anew"
    MISLED = "of the clock; those before were strays"
    IMPOSSIBLE = "no time"


class StampGate:
    """Sorts stamps of one aircraft, in the order in which they came.

    Attributes:
        newest_us: The newest time of the clock, us; None: no stamp came.
        lead: By how many the strays that agree with each other outnumber stamps of the clock.
    """

    def __init__(self) -> None:
        self.newest_us: int | None = None
        self.lead = 0
        self._candidate_us = 0
        self._count = 0

    def near(self, t_us: int) -> bool:
        """Whether a time, us, is of the clock; nothing is while no stamp has come."""
        return self.newest_us is not None and _follows(t_us, self.newest_us)

    def add(self, t_us: int) -> Stamp:
        """Take a stamp, us."""
        if not 0 <= t_us < LATEST_US:
            return Stamp.IMPOSSIBLE
        if self.newest_us is None or self.near(t_us):
            self.newest_us = t_us if self.newest_us is None else max(t_us, self.newest_us)
            self.lead = max(self.lead - 1, 0)
            self._count += 1
            return Stamp.FINE
        agrees = self.lead > 0 and _follows(t_us, self._candidate_us)
        self._candidate_us = max(t_us, self._candidate_us) if agrees else t_us
        self.lead = self.lead + 1 if agrees else 1
        misled = self._count < _CONFIRMED
        if self.lead < (_CONTRADICTED if misled else _RESTART):
            return Stamp.STRAY
        self.newest_us, self._count, self.lead = self._candidate_us, self.lead, 0
        return Stamp.MISLED if misled else Stamp.RESTART


def _follows(t_us: int, newest_us: int) -> bool:
    return -_BACK_US <= t_us - newest_us <= _AHEAD_US
