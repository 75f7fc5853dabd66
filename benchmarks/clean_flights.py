"""False names in clean flights: `python -m benchmarks.clean_flights [--data DATA] [--journal J]`.

Simulated flights in which nothing fails and much happens (`Planted` of size 1: wind, turbulence,
gusts, landings, throttle punches), and recorded ones in which nothing is known to happen; `why` is
asked with all of its finders, as on the command line. What counts:

- a name of a gust, or of a force, is not false within a second of the onset of a planted gust, or
  where the simulated air changes more than at 99 % of the instants of that flight;
- a name of cut commands is not false where the mission stops the motors in the air: it goes by
  time, and an aircraft that comes late is still above its landing place;
- a name after which the simulated aircraft, in which nothing fails, loses control is false all the
  same; the loss itself is counted beside it, since then the flight was not a clean one;
- every other event that is said is false, of instruments and estimates too, unless it is marked as
  a consequence.

In recorded flights nobody knows the air, and estimators reset: their events are listed. Beside it
stands the trivial rule: when the outputs part by 150 us after six seconds of flight, the highest is
the failed rotor. A journal keeps each answer, so that a run goes on where it ended.
"""

import argparse
import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import process_time

import numpy as np
from msgspec import Struct, json
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from twin.errors import TwinError
from twin.flight.closed_loop import SETPOINTS, STEP_S
from twin.logs import Flight, read_flight
from twin.logs.columns import POS
from twin.why.causes import AIR, CUT
from twin.why.diagnose import diagnose
from twin.why.records import Event

from .sudden_faults.answers import trivial_rule
from .sudden_faults.built_in import Planted

FIRST = 2000
"""First seed that is scored: those below chose levels of `twin.why`."""
RATES_HZ = (50.0, 10.0)
"""Rates at which simulated commands are logged, three flights each in turn."""
NEAR_S, SELDOM = 1.0, 0.99
"""Within so much of an instant the velocity of the air changes; a gust is a true one if it changes
by more than at this share of the instants: each changes by 1 m/s in such turbulence."""
CUT_S, ABOVE_M = 0.2, 0.5
"""Within so much of an instant the mission stops the motors, and above what height that is a cut in
the air."""
INDEX = Path(__file__).parent / "labelled" / "index.csv"
"""Of recorded flights."""
SETS = ("clean", "px4_negatives")
"""Of it, those in which nothing is known to happen, or whose authors withdrew what they claimed."""
SIMULATED = "simulated, lively"
"""Name of the simulated set."""


class Answer(Struct, frozen=True, kw_only=True):
    """What was said of one flight.

    Attributes:
        flight: Its name.
        set: Of which set.
        airborne_s: Time in the air.
        false: Events that are not there, as "cause at time".
        true: Gusts and cuts that are.
        lost: Whether control was lost.
        trivial: Rotor that the trivial rule names; null: it is silent.
        processor_s: Of the answer, reading not included.
    """

    flight: str
    set: str
    airborne_s: float
    false: tuple[str, ...]
    true: tuple[str, ...]
    lost: bool
    trivial: int | None
    processor_s: float

    @classmethod
    def of(cls, flight: Flight, name: str, of_set: str, planted: Planted | None = None) -> "Answer":
        """Ask of a flight; `planted` knows the air of a simulated one."""
        began = process_time()
        found = diagnose(flight)
        spent = process_time() - began
        false: list[str] = []
        true: list[str] = []
        for event in (e for e in found.events if not e.consequence):
            when = "all the time" if event.onset_s is None else f"{event.onset_s:.2f} s"
            there = planted is not None and is_there(event, planted, flight)
            (true if there else false).append(f"{event.cause} {when}")
        rule = trivial_rule(flight) if flight.has("cmd_1") else None
        return cls(
            flight=name,
            set=of_set,
            airborne_s=found.airborne_s,
            false=tuple(false),
            true=tuple(true),
            lost=found.loss_of_control_s is not None,
            trivial=None if rule is None else rule.rotor,
            processor_s=spent,
        )


def is_there(event: Event, planted: Planted, flight: Flight) -> bool:
    """Whether a simulated flight has what an event says."""
    if event.onset_s is None:
        return False
    if event.cause in AIR:
        return bool(sets_in(planted, [event.onset_s])[0])
    if event.cause != CUT:
        return False
    t_s, position = flight.signal(POS)
    armed = planted.planned().setpoints[:, SETPOINTS.index("armed")] > 0
    first = max(int((event.onset_s - CUT_S) / STEP_S), 0)
    stopped = armed[first] and not armed[first : int((event.onset_s + CUT_S) / STEP_S) + 1].all()
    return bool(stopped and -np.interp(event.onset_s, t_s, position[:, 2]) > ABOVE_M)


def sets_in(planted: Planted, t_s: Sequence[float]) -> NDArray[np.bool_]:
    """Whether a gust sets in within `NEAR_S` of each instant: a planted one, or a rare change."""
    plan, t = planted.planned(), np.asarray(t_s)
    wind = np.column_stack([plan.courses[f"wind_{axis}"] for axis in "xyz"])
    over = 2 * int(NEAR_S / STEP_S) + 1
    reach = maximum_filter1d(wind, over, axis=0) - minimum_filter1d(wind, over, axis=0)
    change = np.linalg.norm(reach, axis=1)
    rare = change[np.minimum((t / STEP_S).astype(int), len(wind) - 1)] > np.quantile(change, SELDOM)
    near = np.abs(t[:, None] - np.array(plan.gusts_s)) <= NEAR_S
    return np.asarray(rare | near.any(axis=1))


def simulated(seeds: Sequence[int], known: Sequence[str]) -> Iterator[Answer]:
    """Answers to the simulated flights that are not known yet."""
    for seed in seeds:
        planted = Planted("", 1.0, seed, RATES_HZ[seed // 3 % 2])
        if (name := f"{SIMULATED} {seed}") not in known:
            yield Answer.of(planted.flown()[0], name, SIMULATED, planted)


def recorded(data: Path, known: Sequence[str]) -> Iterator[Answer]:
    """Answers to the recorded flights that are there, and not known yet."""
    for row in csv.DictReader(INDEX.open(encoding="utf-8")):
        path = data / row["file"]
        if row["set"] not in SETS or not path.is_file() or row["file"] in known:
            continue
        try:
            yield Answer.of(read_flight(path), row["file"], row["set"])
        except TwinError as error:
            print(f"{row['file']}: {error}")


def page(answers: Sequence[Answer]) -> str:
    """The table, and what was said."""
    return "\n".join(_lines(answers))


def _lines(answers: Sequence[Answer]) -> Iterator[str]:
    head = ("set", "flights", "hours", "false names", "names that were there", "control lost")
    yield "| " + " | ".join((*head, "trivial rule names a rotor", "processor for 60 s")) + " |"
    yield "|---" * (len(head) + 2) + "|"
    for name in dict.fromkeys(a.set for a in answers):
        own = [a for a in answers if a.set == name]
        flown_s = sum(a.airborne_s for a in own)
        cells = (
            name,
            len(own),
            f"{flown_s / 3600:.2f}",
            sum(len(a.false) for a in own),
            sum(len(a.true) for a in own),
            sum(a.lost for a in own),
            sum(a.trivial is not None for a in own),
            f"{60 * sum(a.processor_s for a in own) / max(flown_s, 1.0):.1f} s",
        )
        yield "| " + " | ".join(map(str, cells)) + " |"
    for a in answers:
        if a.false or a.true or a.lost:
            lost = "; control is lost" if a.lost else ""
            there = f"; there: {', '.join(a.true)}" if a.true else ""
            yield f"\n{a.flight}: {', '.join(a.false) or 'nothing false'}{there}{lost}"


def main() -> None:
    """Fly, ask and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the recorded flights")
    parser.add_argument("--seeds", type=int, default=75, help="simulated flights, of 140 s each")
    parser.add_argument("--first", type=int, default=FIRST)
    parser.add_argument("--journal", type=Path)
    given = parser.parse_args()
    journal = given.journal
    lines = journal.read_text("utf-8").splitlines() if journal and journal.exists() else []
    answers = [json.decode(line, type=Answer) for line in lines]
    known = [a.flight for a in answers]
    todo = [simulated(range(given.first, given.first + given.seeds), known)]
    if given.data is not None:
        todo.append(recorded(given.data, known))
    for answer in (a for some in todo for a in some):
        answers.append(answer)
        if journal is not None:
            with journal.open("ab") as file:
                file.write(json.encode(answer) + b"\n")
    print(page(answers))


if __name__ == "__main__":
    main()
