"""Flights from files, by name or by pattern."""

import glob
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from twin.errors import LogError, TwinError
from twin.logs import Finding, Flight, read_flight

_SHOWN = 6
"""Names of a folder that a message lists."""


def read_flights(*patterns: str | Path, rebuild_commands: bool | None = None) -> list[Flight]:
    """Read flight logs and flight tables.

    Args:
        patterns: Files, or patterns such as `logs/fit_*.ulg` and `logs/**/*.parquet`.
        rebuild_commands: As for `read_flight`.

    Returns:
        Flights in the order of the patterns, those of one pattern by name with numbers counted
        (`fit_2` before `fit_10`); a file that two patterns match comes once.

    Raises:
        LogError: Nothing matches a pattern, or a file cannot be used.
    """
    if not patterns:
        raise LogError("read_flights: no file and no pattern given, e.g. 'logs/fit_*.ulg'.")
    paths = [path for pattern in patterns for path in _matching(pattern)]
    once = {path.resolve(): path for path in reversed(paths)}
    return read_alike(list(dict.fromkeys(once[p.resolve()] for p in paths)), rebuild_commands)


def read_alike(paths: Sequence[Path], rebuild_commands: bool | None = None) -> list[Flight]:
    """Read flights that are compared with one vehicle.

    Commands of one aircraft are read in the same way; flights of one file name are named by as much
    of their paths as tells them apart; where another aircraft is among them, a finding says so.

    Args:
        paths: Files.
        rebuild_commands: As for `read_flight`. None: where the commands of one flight cannot be
            rebuilt, or are not those that were flown, those of none of the same aircraft are.

    Raises:
        LogError: A file cannot be used, or two hold the same flight.
    """
    flights = [read_flight(path, rebuild_commands=rebuild_commands) for path in paths]
    _check_distinct(paths, flights)
    if rebuild_commands is None:
        flights = _commands_alike(paths, flights)
    names = _distinct_names(paths, flights)
    told = [(n, f, _aircraft(f)) for n, f in zip(names, flights, strict=True)]
    return [
        replace(f, name=n, findings=(*f.findings, *_strangers(n, own, told))) for n, f, own in told
    ]


def _commands_alike(paths: Sequence[Path], flights: Sequence[Flight]) -> list[Flight]:
    """The flights, with the commands as logged where those of another cannot be rebuilt."""
    refused = [f for f in flights if "commands_not_rebuilt" in f.facts]
    found = []
    for path, flight in zip(paths, flights, strict=True):
        others = [f.name for f in refused if _aircraft(f) == _aircraft(flight)]
        again = others and "commands_match" in flight.facts
        found.append(_as_logged(path, others) if again else flight)
    return found


def _aircraft(flight: Flight) -> tuple[str, ...]:
    """What its log tells of the aircraft."""
    return tuple(flight.facts.get(fact, "") for fact in ("aircraft", "airframe", "hardware"))


def _strangers(
    name: str, own: tuple[str, ...], told: Sequence[tuple[str, Flight, tuple[str, ...]]]
) -> Iterator[Finding]:
    """A finding where a flight is of another aircraft than the first whose log says which."""
    known = [(other, aircraft) for other, _, aircraft in told if any(aircraft)]
    if not any(own) or own == known[0][1]:
        return
    text, first = (", ".join(x for x in aircraft if x) for aircraft in (own, known[0][1]))
    message = f"another aircraft ({text}) than {known[0][0]} ({first}); one vehicle is held to both"
    yield Finding("error", "aircraft", message)


def _check_distinct(paths: Sequence[Path], flights: Sequence[Flight]) -> None:
    """Refuse the same flight twice: it would count as two.

    Raises:
        LogError: It is there.
    """
    seen: dict[str, Path] = {}
    for path, flight in zip(paths, flights, strict=True):
        first = seen.setdefault(flight.fingerprint, path)
        if first is not path:
            same = first.resolve() == path.resolve()
            text = "is given twice" if same else f"holds the same flight as {first}"
            raise LogError(f"{path}: {text}, which would count as two. Give it once.")


def _distinct_names(paths: Sequence[Path], flights: Sequence[Flight]) -> list[str]:
    """Names of flights; those of one name by the shortest ends of their paths that differ."""
    found = []
    for path, flight in zip(paths, flights, strict=True):
        alike = [p for p, f in zip(paths, flights, strict=True) if f.name == flight.name]
        folders = [p.resolve().parts[-2::-1] for p in alike]
        own = path.resolve().parts[-2::-1]
        count = next(
            (k for k in range(len(own) + 1) if [f[:k] for f in folders].count(own[:k]) == 1), 0
        )
        found.append("/".join([*reversed(own[:count]), flight.name]))
    return found


def _as_logged(path: Path, others: Sequence[str]) -> Flight:
    """A flight whose commands could be rebuilt, but are those that are logged."""
    flight = read_flight(path, rebuild_commands=False)
    told = Finding(
        "info",
        "cmd",
        f"logged commands, though they could be rebuilt at full rate: those of "
        f"{', '.join(others)} could not, and flights of one aircraft are treated alike",
    )
    return replace(flight, findings=(*flight.findings, told))


def _matching(pattern: str | Path) -> list[Path]:
    """Files of a pattern, or the one file."""
    text = str(pattern)
    if not glob.has_magic(text) or Path(text).is_file():
        if not Path(text).exists():
            raise LogError(f"{text}: there is no such file. {_instead(Path(text))}")
        return [Path(text)]
    found = [Path(p) for p in glob.glob(text, recursive=True)]
    files = sorted((p for p in found if p.is_file()), key=_counted)
    if not files:
        raise LogError(f"{text}: no flight matches this pattern. {_instead(Path(text))}")
    return files


def _counted(path: Path) -> list[tuple[int, str]]:
    """Sort key in which 2 comes before 10."""
    parts = re.findall(r"\d+|\D+", str(path))
    return [(int(p), "") if p.isdigit() else (-1, p) for p in parts]


def _instead(path: Path) -> str:
    """What is there instead of a file or pattern."""
    folder = path.parent
    while glob.has_magic(str(folder)):
        folder = folder.parent
    if not folder.is_dir():
        return f"There is no folder {folder}."
    where = f"The folder {folder.resolve()}"
    names = sorted(p.name for p in folder.iterdir() if p.is_file() and p.name[0] != ".")
    if not names:
        return f"{where} holds no files."
    near = get_close_matches(path.name, names, n=1)
    if near:
        return f"Did you mean {near[0]!r}?"
    more = f" and {len(names) - _SHOWN} more" * (len(names) > _SHOWN)
    return f"{where} holds {', '.join(names[:_SHOWN])}{more}."


def checked_flights(given: Any, verb: str) -> tuple[Flight, ...]:
    """One flight or several that were handed to a function.

    Raises:
        TwinError: Something else was handed.
    """
    flights = (given,) if isinstance(given, Flight | str | Path) else given
    if not isinstance(flights, Iterable):
        raise TwinError(f"{verb}: a {type(given).__name__} is no flight. {_HOW}")
    flights = tuple(flights)
    for flight in flights:
        if isinstance(flight, str | Path):
            raise TwinError(f"{verb}: '{flight}' is the name of a file, not a flight. {_HOW}")
        if not isinstance(flight, Flight):
            raise TwinError(f"{verb}: a {type(flight).__name__} is no flight. {_HOW}")
    return flights


def check_names(flights: Iterable[Flight]) -> None:
    """Refuse two flights of one name, which no table could tell apart.

    Raises:
        TwinError: There are.
    """
    seen: set[str] = set()
    for flight in flights:
        if flight.name in seen:
            raise TwinError(
                f"{flight.source or flight.name}: two flights are named {flight.name}; rename one "
                f"of them."
            )
        seen.add(flight.name)


_HOW = "Read it first: read_flight(FILE), or read_flights(PATTERN) for several."
