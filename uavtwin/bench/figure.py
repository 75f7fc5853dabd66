"""One figure of `uavtwin bench`."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """One measured figure.

    Attributes:
        what: Was measured; where it was skipped, why.
        value: In its unit; None: skipped.
        unit: Of it.
        goal: That it is held against.
    """

    what: str
    value: float | None
    unit: str
    goal: str
