"""What an alarm says."""

from collections.abc import Mapping
from dataclasses import dataclass

from ...representation import short_repr


@dataclass(frozen=True, slots=True)
class EstimatedChange:
    """One number of an alarm.

    Attributes:
        name: Within the effect.
        value: Change since the alarm's beginning.
        sd: Standard deviation.
        unit: SI unit.
    """

    name: str
    value: float
    sd: float
    unit: str

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} {self.value:+.3g} ± {self.sd:.2g}{unit}"


@dataclass(frozen=True, slots=True)
class Alarm:
    """Something that has begun in flight.

    Attributes:
        effect: Identifier of the effect library.
        numbers: By how much.
        since_s: When it began, on the clock of the flight.
        raised_s: When the alarm was raised.
        probability: Of this effect, against every other and against nothing.
        nothing: Probability that nothing has begun.
        others: Other effects that it may be as well, and the probability of each.
        closed_s: When it ended; None: it goes on.
    """

    effect: str
    numbers: tuple[EstimatedChange, ...]
    since_s: float
    raised_s: float
    probability: float
    nothing: float
    others: Mapping[str, float]
    closed_s: float | None = None

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is known after a second of flight.

    Attributes:
        t_s: Up to when, on the clock of the flight.
        learning: Whether noise and standing offset are still being learned.
        flying: Whether the aircraft is in the air.
        alarms: Those that are open.
        opened: Those raised since the verdict before.
        closed: Those closed since the verdict before.
        nothing: Probability that nothing has begun beyond what is alarmed for good.
        effects: Probability of each effect that some number of it has jumped.
    """

    t_s: float
    learning: bool
    flying: bool
    alarms: tuple[Alarm, ...]
    opened: tuple[Alarm, ...]
    closed: tuple[Alarm, ...]
    nothing: float
    effects: Mapping[str, float]

    __repr__ = short_repr
