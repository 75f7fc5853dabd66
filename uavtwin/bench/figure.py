"""One figure of `uavtwin bench`."""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Row:
    """One measured figure; no value where it was skipped, `what` then says why."""

    what: str
    value: float | None
    unit: str
    goal: str

    def as_json(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)
