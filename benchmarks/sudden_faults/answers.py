"""What `why` says of a flight with a planted fault, and the tables of `docs/results/why.md`."""

from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import numpy as np
from msgspec import Struct

from twin.logs import Flight
from twin.logs.columns import motor_columns
from twin.why.diagnose import diagnose
from twin.why.rules import RuleReading, parted
from twin.why.speeds import CHECKS

from .flights import Flown, Key
from .kinds import KINDS, NOTHING, Kind

CLOSE, SURE = 0.25, 0.9
"""What counts as the right size, and as sure."""


class Answer(Struct, frozen=True, kw_only=True):
    """What was said of one flight.

    Attributes:
        plant: Which simulator flew it.
        planted: Kind, size, seed, and rate of the commands, Hz.
        begins_s: Onset of its fault; null: it has none.
        rotors: Of the fault.
        cause: The first that is named; "": none.
        named: Its rotors.
        onset_s: Its onset.
        size: As it is said, with its interval.
        probability: Of the cause.
        speed: What the speed of the rotor says: "motor", "propeller", or "".
        trivial: Rotor that the trivial rule names; null: it is silent.
        processor_s: Of the finders.
        flown_s: How long the flight is.
    """

    plant: str
    planted: tuple[str, float, int, float]
    begins_s: float | None
    rotors: tuple[int, ...]
    cause: str = ""
    named: tuple[int, ...] = ()
    onset_s: float | None = None
    size: tuple[float, float, float] | None = None
    probability: float = 0.0
    speed: Literal["motor", "propeller", ""] = ""
    trivial: int | None = None
    processor_s: float = 0.0
    flown_s: float = 0.0

    @classmethod
    def of(cls, key: Key, flown: Flown, clock: Callable[[], float]) -> "Answer":
        """Ask of a flight."""
        began = clock()
        found = diagnose(flown.flight)
        spent, read = clock() - began, trivial_rule(flown.flight)
        events = [e for e in found.events if not e.consequence and e.onset_s is not None]
        said: dict[str, object] = {}
        if events:
            first = events[0]
            size, check = first.severity, first.bench_check
            speeds = (k for k, v in CHECKS.items() if v and v.split(": ", 1)[1] in check)
            said = {
                "cause": first.cause,
                "named": first.rotor or (),
                "onset_s": first.onset_s,
                "size": None if size is None else (size.low, size.value, size.high),
                "probability": first.probability,
                "speed": next(speeds, ""),
            }
        return cls(
            plant=key.plant,
            planted=(key.kind, key.size, key.seed, key.rate_hz),
            begins_s=flown.begins_s if np.isfinite(flown.begins_s) else None,
            rotors=flown.rotors,
            trivial=None if read is None else read.rotor,
            processor_s=spent,
            flown_s=float(flown.flight.time_s[-1] - flown.flight.time_s[0]),
            **said,  # type: ignore[arg-type]
        )

    @property
    def kind(self) -> Kind:
        """Of its fault."""
        return KINDS[self.planted[0]] if self.planted[0] else NOTHING

    @property
    def right(self) -> bool:
        """Whether the first cause is that of the fault."""
        return self.cause == self.kind.cause != ""

    @property
    def true_size(self) -> float:
        """The number that should be said."""
        return self.planted[1] * (self.kind.quantity or 0.0)

    @property
    def close(self) -> bool:
        """Whether it is said within `CLOSE`."""
        return self.size is not None and abs(self.size[1] / self.true_size - 1) <= CLOSE

    @property
    def wrong(self) -> bool:
        """Whether something else is named, or other rotors."""
        return bool(self.cause) and not (self.right and set(self.named) == set(self.rotors))


def trivial_rule(flight: Flight) -> RuleReading | None:
    """What the commands, or the speeds over the largest, say by `parted`."""
    stem = "cmd" if flight.has("cmd_1") else "rotor"
    count = sum(flight.has(f"{stem}_{i}") for i in range(1, 13))
    t, c = flight.signal(motor_columns(stem, count))
    return parted(t, c / max(float(np.percentile(c, 99.5)), 1.0))


def by_kind(answers: Sequence[Answer]) -> str:
    """A row for each kind and size."""
    return "\n".join(_table(answers, "planted", lambda a: _words(*a.planted[:2])))


def by_plant(answers: Sequence[Answer]) -> str:
    """A row for each plant and rate of the commands."""
    return "\n".join(_table(answers, "plant", lambda a: f"{a.plant}, {a.planted[3]:g} Hz"))


def _words(kind: str, size: float) -> str:
    if not kind:
        return "nothing"
    return f"{kind} {size:g}" + (f" {KINDS[kind].unit}" if KINDS[kind].unit != "1" else "")


HEADER = (
    "flights",
    "cause",
    "rotors",
    "size within 25 %",
    "interval holds it",
    "onset, median",
    "another name",
    "of it sure",
    "trivial: rotor",
)
"""Of both tables; counts, of those flights of which there is something to say."""


def _table(answers: Sequence[Answer], head: str, group: Callable[[Answer], str]) -> Iterator[str]:
    yield "| " + " | ".join((head, *HEADER)) + " |"
    yield "|---" * (len(HEADER) + 1) + "|"
    groups: dict[str, list[Answer]] = {}
    for a in answers:
        groups.setdefault(group(a), []).append(a)
    for name, mine in (*groups.items(), ("all", list(answers))):
        yield "| " + " | ".join((name, *_cells(mine))) + " |"


def _cells(mine: Sequence[Answer]) -> tuple[str, ...]:
    faulty = [a for a in mine if a.kind.cause]
    of_rotors = [a for a in faulty if a.rotors]
    right = [a for a in faulty if a.right]
    sized = [a for a in right if a.kind.quantity is not None and a.size is not None]
    held = [a for a in sized if a.size and a.size[0] <= a.true_size <= a.size[2]]
    late = [abs((a.onset_s or 0.0) - (a.begins_s or 0.0)) for a in right]
    rule = [a for a in of_rotors if a.trivial in a.rotors]
    false = [a for a in mine if a.trivial is not None and not a.rotors]
    return (
        f"{len(mine)}",
        _of(len(right), faulty),
        _of(sum(set(a.named) == set(a.rotors) for a in of_rotors if a.right), of_rotors),
        _of(sum(a.close for a in sized), sized),
        _of(len(held), sized),
        f"{np.median(late):.2f} s" if late else "",
        f"{sum(a.wrong for a in mine)}",
        f"{sum(a.wrong and a.probability >= SURE for a in mine)}",
        _of(len(rule), of_rotors) or f"{len(false)} false",
    )


def _of(count: int, among: Sequence[Answer]) -> str:
    return f"{count} of {len(among)}" if among else ""
