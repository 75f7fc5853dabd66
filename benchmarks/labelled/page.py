"""The generated part of `docs/results/labelled_flights.md`, and the flights in a file beside it."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from .flights import NORMAL
from .instruments import Outcome, table
from .score import Said, Score, is_right, score

BEGIN, END = "<!-- benchmarks.labelled: begin -->", "<!-- benchmarks.labelled: end -->"
"""Marks of the generated part of a page."""
HEADING = "### "
"""Of a set."""
ABOUT = {
    "rflymad_sil": "Rotor 1 stops in flight, in the simulator of RflyMAD (PX4 in the loop; outputs "
    "logged at 10 Hz). Its thresholds of the body were chosen here: it shows what can be said, not "
    "how well it is said elsewhere.",
    "px4_negatives": "Real logs whose file names were labels until PX4 withdrew them. Nothing of "
    "the classes is to be found. They were looked at while the residuals of instruments were made.",
    "clean": "Normal flights: RflySimDT (real and simulated), Nanobench, Quiver PT1. The residuals "
    "of instruments were looked at on them; estimators are reset in two of Quiver's by the "
    "autopilot's own words.",
    "simulated": "Simulated flights of the built-in vehicles in closed loop, in wind with "
    "turbulence, without a fault, three minutes each; these seeds chose nothing.",
    "crazypad": "Cut propellers and loads of a Crazyflie, against three normal flights. They chose "
    "the numbers of `twin.explain.balance`, as the first part of this page says.",
}
"""What a set is, and what it chose."""
INSTRUMENTS = (
    "Faults that begin in simulated flights in closed loop, of seeds that chose nothing; small, "
    "medium and large as in [live alarms](live_alarms.md). The rule of one line names the "
    "instrument whose mean moves most from the first ten seconds to the last; it names one in "
    "every flight, sound ones included. Small faults are below what the logs show."
)
"""Above the table of faults of instruments."""


def tables(said: Mapping[str, Sequence[Said]], outcomes: Sequence[Outcome] = ()) -> str:
    """A table per set; one of simulated faults of instruments."""
    sets = list(dict.fromkeys(s.flight.set for rows in said.values() for s in rows))
    lines = [line for name in sets for line in _set(name, said)]
    if outcomes:
        lines += [f"{HEADING}Instruments\n\n{INSTRUMENTS}\n", *table(outcomes), ""]
    return "\n".join(lines)


def _set(name: str, said: Mapping[str, Sequence[Said]]) -> Iterator[str]:
    yield f"{HEADING}{name}\n"
    yield f"{ABOUT.get(name, '')}\n"
    yield (
        "| method | asked | answered | right | rotors exact | onset, median error s | false names "
        "| per h | other events | sure and wrong | Brier | calibration error |"
    )
    yield "|" + "---|" * 12
    for method, rows in said.items():
        yield _row(method, score([s for s in rows if s.flight.set == name]))
    yield ""


def _row(method: str, s: Score) -> str:
    exact, of = s.rotors
    cells = [
        method,
        f"{s.asked} of {s.flights}",
        f"{s.answered}",
        f"{s.right}",
        f"{exact} of {of}" if of else "-",
        _number(s.onset_s),
        f"{s.false} in {s.hours:.2f} h" if s.hours else "-",
        f"{s.false / s.hours:.1f}" if s.hours else "-",
        f"{s.others}" if s.hours else "-",
        f"{s.wrong_and_sure}" if s.brier is not None else "-",
        _number(s.brier),
        _number(s.calibration),
    ]
    return f"| {' | '.join(cells)} |"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def flight_rows(said: Mapping[str, Sequence[Said]]) -> Iterator[dict[str, str]]:
    """Answers flight by flight, but of simulated ones; what is right has a star on both sides."""
    for answers in zip(*said.values(), strict=True):
        flight = answers[0].flight
        if flight.set != "simulated":
            label = _said(flight.label, flight.rotors, flight.onset_s)
            given = dict(zip(said, map(_answer, answers), strict=True))
            yield {"set": flight.set, "flight": flight.name, "label": label, **given}


def _said(label: str, rotors: frozenset[int], onset_s: float | None) -> str:
    which = "".join(f" {r}" for r in sorted(rotors))
    when = f", {onset_s:.2f} s" if onset_s is not None else ""
    return f"{label.replace('_', ' ')}{which}{when}"


def _answer(said: Said) -> str:
    answer = said.answer
    if answer is None:
        return "-"
    if not answer.label:
        return "cannot tell"
    text = _said(answer.label, answer.rotors, answer.onset_s)
    if answer.or_else and answer.or_else != answer.label:
        text += f" or {answer.or_else.replace('_', ' ')}"
    if answer.probability is not None:
        text += f" ({answer.probability:.2f})"
    if answer.others and answer.label == NORMAL:
        text += f", {answer.others} of no class"
    return f"*{text}*" if is_right(said) else text


def write_flights(file: Path, rows: Sequence[Mapping[str, str]]) -> None:
    """Replace the rows of these sets in a CSV file; those of other sets stay."""
    kept: list[Mapping[str, str]] = []
    if file.is_file():
        with file.open(encoding="utf-8", newline="") as old:
            kept = [r for r in csv.DictReader(old) if r["set"] not in {n["set"] for n in rows}]
    with file.open("w", encoding="utf-8", newline="") as new:
        writer = csv.DictWriter(new, [*rows[0]], lineterminator="\n")
        writer.writeheader()
        writer.writerows([*kept, *rows])


def write_between(page: Path, text: str) -> None:
    """Put the sections of a text between the marks of a page; those of other sets stay.

    Raises:
        ValueError: The page has no marks.
    """
    before, begin, rest = page.read_text("utf-8").partition(BEGIN)
    rest, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{page}: has no {BEGIN} with {END} behind it")
    merged = "\n".join((_sections(rest) | _sections(text)).values())
    page.write_text(f"{before}{begin}\n{merged}\n{end}{after}", encoding="utf-8")


def _sections(text: str) -> dict[str, str]:
    """Sections of a text by their headings, in order."""
    parts = text.split(HEADING)[1:]
    return {p.partition("\n")[0]: f"{HEADING}{p.rstrip()}\n" for p in parts}
