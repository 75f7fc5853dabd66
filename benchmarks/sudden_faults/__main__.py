"""Fly, ask and print; see the package."""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import process_time

from msgspec import json

from . import __doc__ as about
from .answers import Answer, by_kind, by_plant
from .flights import PLANTS, Key, flown
from .kinds import KINDS

RATES_HZ = (200.0, 10.0)
"""Of the logged commands: every sample of the controller, and as PX4 logs them by default."""
SCORED = 1000
"""First seed that is scored."""


def main() -> None:
    """Fly, ask and print."""
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=2, help="of each row and plant")
    parser.add_argument("--first", type=int, default=SCORED)
    parser.add_argument("--plant", nargs="+", choices=PLANTS, default=list(PLANTS))
    parser.add_argument("--kind", nargs="+", choices=(*KINDS, ""), default=[*KINDS, ""])
    parser.add_argument("--rate", nargs="+", type=float, default=[RATES_HZ[0]], help="Hz")
    parser.add_argument("--journal", type=Path)
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.seeds)
    keys = [
        Key(plant, kind, size, seed, rate)
        for plant in given.plant
        for rate in given.rate
        for kind in given.kind
        for size in (KINDS[kind].sizes if kind else (0.0,))
        for seed in seeds
    ]
    answers = list(answered(keys, given.journal))
    print(by_kind(answers), by_plant(answers), sep="\n\n")
    spent, time_s = (sum(getattr(a, n) for a in answers) for n in ("processor_s", "flown_s"))
    print(f"\n{time_s / 3600:.2f} h flown; processor for 60 s of them: {60 * spent / time_s:.1f} s")


def answered(keys: Sequence[Key], journal: Path | None) -> Iterator[Answer]:
    """Answers to all flights, those of the journal first."""
    lines = journal.read_bytes().splitlines() if journal and journal.exists() else []
    known = {_key(a): a for a in (json.decode(x, type=Answer) for x in lines)}
    open_keys = [k for k in keys if k not in known]
    yield from (known[k] for k in keys if k in known)
    for done, (key, flight) in enumerate(flown(open_keys), 1):
        answer = Answer.of(key, flight, process_time)
        print(f"{done} of {len(open_keys)}: {key} {answer.cause or '-'}", flush=True)
        if journal is not None:
            with journal.open("ab") as file:
                file.write(json.encode(answer) + b"\n")
        yield answer


def _key(answer: Answer) -> Key:
    return Key(answer.plant, *answer.planted)


if __name__ == "__main__":
    main()
