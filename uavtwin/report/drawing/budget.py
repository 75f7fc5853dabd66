"""What a page may weigh, and how finely its figures are drawn so that it does not weigh more."""

from collections.abc import Callable
from dataclasses import dataclass

PAGE_BYTES = 1_500_000
FINEST, COARSEST = 700, 60
"""Most and fewest columns of pixels of a series that is as wide as the page."""
MOST_PARTS = 6
"""Flights whose figures are on a page at most: of more, all would be drawn too coarsely."""


@dataclass(frozen=True, slots=True)
class Budget:
    """How finely the figures of a page are drawn: one for all that it shows.

    Attributes:
        columns: Of pixels, of a series that is as wide as the page.
        parts: How many of the page's parts, flights say, are drawn at all.
    """

    columns: int = FINEST
    parts: int = 1

    @property
    def spectrum(self) -> int:
        """Columns of pixels of a spectrum, a third of the page wide."""
        return max(45, min(90, self.columns // 2))

    @property
    def track(self) -> int:
        """Points of a track."""
        return max(120, min(500, self.columns))

    @property
    def cells(self) -> int:
        """Columns of a spectrogram."""
        return max(COARSEST, min(180, self.columns))


def fitted(draw: Callable[[Budget], str], parts: int = 1) -> str:
    """A page drawn as finely as `PAGE_BYTES` allow.

    It is drawn at its finest; where that is too much, at its coarsest, with fewer parts where even
    that is too much, and last in between. A page whose only part is too large as coarse as can be
    is returned nonetheless.

    Args:
        draw: Text of the page.
        parts: That there are; at most `MOST_PARTS` are drawn.
    """
    parts = min(parts, MOST_PARTS)
    finest = draw(Budget(FINEST, parts))
    if _bytes(finest) <= PAGE_BYTES:
        return finest
    coarsest = draw(Budget(COARSEST, parts))
    if _bytes(coarsest) > PAGE_BYTES:
        while _bytes(coarsest) > PAGE_BYTES and parts > 1:
            parts -= 1
            coarsest = draw(Budget(COARSEST, parts))
        return coarsest
    share = (PAGE_BYTES - _bytes(coarsest)) / (_bytes(finest) - _bytes(coarsest))
    # bytes grow with the logarithm of the columns, about: more and more series are drawn whole
    between = draw(Budget(int(COARSEST * (FINEST / COARSEST) ** share), parts))
    return between if _bytes(between) <= PAGE_BYTES else coarsest


def _bytes(page: str) -> int:
    return len(page.encode("utf-8"))
