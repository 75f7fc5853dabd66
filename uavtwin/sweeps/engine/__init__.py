"""Where runs are flown: processes of this machine, or a cluster; the outcomes are the same."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

from ..flying import Flown
from ..plan import Job, Stand


class Engine(Protocol):
    """Flies jobs in any order."""

    def fly(self, jobs: Iterable[Job], stands: Sequence[Stand]) -> Iterator[Flown]:
        """Outcomes as they come; jobs are taken when there is room for them."""
