"""Flights from files, by name or by pattern."""

import glob
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from twin.errors import LogError, TwinError
from twin.logs import AnyFlight, Finding, Flight, StoredFlight, open_flight, read_flight

_F = TypeVar("_F", bound=AnyFlight)
AS_LOGGED = (
    "logged commands, though they could be rebuilt at full rate: those of {} could not, and "
    "flights of one aircraft are treated alike"
)
"""Finding on a flight whose commands are not rebuilt because those of another one cannot be."""
_SHOWN = 6
"""Largest number of names of a folder in a message."""


def read_flights(
    *patterns: str | Path, rebuild_commands: bool | None = None, trust_vehicle: bool = False
) -> list[Flight]:
    """Read flight logs and flight tables.

    Args:
        patterns: Files, or patterns such as `logs/fit_*.ulg` and `logs/**/*.parquet`.
        rebuild_commands: Whether commands are rebuilt, as in `read_flight`.
        trust_vehicle: Whether the rotors stated in the logs are ignored, so that no vehicle
            contradicts them.

    Returns:
        Flights in the order of the patterns, those of one pattern by name with numbers in numeric
        order (`fit_2` before `fit_10`); a file that matches two patterns occurs once.

    Raises:
        LogError: A pattern has no match, or a file cannot be used.
    """
    if not patterns:
        raise LogError("read_flights: no file and no pattern given, e.g. 'logs/fit_*.ulg'.")
    paths = [path for pattern in patterns for path in _matching(pattern)]
    once = {path.resolve(): path for path in reversed(paths)}
    files = list(dict.fromkeys(once[p.resolve()] for p in paths))
    return read_alike(files, rebuild_commands, trust_vehicle)


def read_alike(
    paths: Sequence[Path], rebuild_commands: bool | None = None, trust_vehicle: bool = False
) -> list[Flight]:
    """Read flights that are compared with one vehicle.

    Commands of one aircraft are read by the same method; flights with equal file names are named by
    the shortest distinct ends of their paths; a finding reports flights of another aircraft.

    Args:
        paths: Files.
        rebuild_commands: Whether commands are rebuilt, as in `read_flight`. None: where the
            commands of one flight cannot be rebuilt, or differ from those flown, no flight of the
            aircraft is rebuilt.
        trust_vehicle: Whether rotors in logs are ignored, as in `read_flights`.

    Raises:
        LogError: A file cannot be used, or two have the same flight.
    """
    flights = [read_flight(path, rebuild_commands=rebuild_commands) for path in paths]
    return _alike(paths, flights, rebuild_commands, trust_vehicle)


def open_alike(
    paths: Sequence[Path], rebuild_commands: bool | None = None, trust_vehicle: bool = False
) -> list[AnyFlight]:
    """Read flights as `read_alike` does, leaving long flight tables in their files."""
    flights = [open_flight(path, rebuild_commands=rebuild_commands) for path in paths]
    return _alike(paths, flights, rebuild_commands, trust_vehicle)


def _alike(
    paths: Sequence[Path], flights: Sequence[_F], rebuild: bool | None, trust_vehicle: bool
) -> list[_F]:
    """Flights that were read one by one, named and treated as in `read_alike`."""
    _check_distinct(paths, flights)
    several = _commands_alike(paths, flights) if rebuild is None else flights
    names = _distinct_names(paths, several)
    if trust_vehicle:
        several = [_without_rotors(f) for f in several]
    reported = [(n, reported_aircraft(f)) for n, f in zip(names, several, strict=True)]
    return [
        replace(f, name=n, findings=(*f.findings, *_strangers(own, reported)))
        for f, (n, own) in zip(several, reported, strict=True)
    ]


def _without_rotors(flight: _F) -> _F:
    """The flight without the rotors stated in its log."""
    if flight.airframe is None:
        return flight
    return replace(flight, airframe=replace(flight.airframe, rotors=None, layout=None))


def _commands_alike(paths: Sequence[Path], flights: Sequence[_F]) -> Sequence[_F]:
    """The flights, all with logged commands if those of one cannot be rebuilt."""
    refused = [f for f in flights if "commands_not_rebuilt" in f.facts]
    found = list(flights)
    for k, flight in enumerate(flights):
        others = [f.name for f in refused if reported_aircraft(f) == reported_aircraft(flight)]
        if others and "commands_match" in flight.facts:
            logged = read_flight(paths[k], rebuild_commands=False)
            assert isinstance(logged, type(flight))  # a log of an autopilot is read whole
            reported = AS_LOGGED.format(", ".join(others))
            finding = Finding("info", "cmd", reported)
            found[k] = replace(logged, findings=(*logged.findings, finding))
    return found


def reported_aircraft(flight: AnyFlight) -> tuple[str, ...]:
    """Aircraft, airframe and hardware reported in a flight's log."""
    return tuple(flight.facts.get(fact, "") for fact in ("aircraft", "airframe", "hardware"))


def _strangers(
    own: tuple[str, ...], reported: Sequence[tuple[str, tuple[str, ...]]]
) -> Iterator[Finding]:
    """Finding on a flight of another aircraft than the first one with an identifier."""
    known = [(name, aircraft) for name, aircraft in reported if any(aircraft)]
    if not any(own) or own == known[0][1]:
        return
    text, first = (", ".join(x for x in aircraft if x) for aircraft in (own, known[0][1]))
    message = f"another aircraft ({text}) than {known[0][0]} ({first}); one vehicle is held to both"
    yield Finding("error", "aircraft", message)


def _check_distinct(paths: Sequence[Path], flights: Sequence[AnyFlight]) -> None:
    """Refuse a duplicate flight, which would count twice.

    Raises:
        LogError: There is one.
    """
    seen: dict[str, Path] = {}
    for path, flight in zip(paths, flights, strict=True):
        first = seen.setdefault(flight.fingerprint, path)
        if first is not path:
            same = first.resolve() == path.resolve()
            text = "is given twice" if same else f"holds the same flight as {first}"
            raise LogError(f"{path}: {text}, which would count as two. Give it once.")


def _distinct_names(paths: Sequence[Path], flights: Sequence[AnyFlight]) -> list[str]:
    """Names of flights; equal ones replaced by the shortest distinct ends of their paths."""
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


def _matching(pattern: str | Path) -> list[Path]:
    """Files of a pattern, or the one file."""
    text = str(pattern)
    if not glob.has_magic(text) or Path(text).is_file():
        if not Path(text).exists():
            raise LogError(f"{text}: there is no such file. {what_is_there(Path(text))}")
        return [Path(text)]
    found = [Path(p) for p in glob.glob(text, recursive=True)]
    files = sorted((p for p in found if p.is_file()), key=counted_key)
    if not files:
        raise LogError(f"{text}: no flight matches this pattern. {what_is_there(Path(text))}")
    return files


def counted_key(path: str | Path) -> list[tuple[int, str]]:
    """Sort key with numbers in numeric order."""
    parts = re.findall(r"\d+|\D+", str(path))
    return [(int(p), "") if p.isdigit() else (-1, p) for p in parts]


def what_is_there(path: Path) -> str:
    """Text on similar files where a file or pattern has no match."""
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
    """One or several flights given to a function that needs them in memory.

    Raises:
        TwinError: The argument is something else.
    """
    flights = tuple(f for f in opened_flights(given, verb) if isinstance(f, Flight))
    for flight in (f for f in opened_flights(given, verb) if not isinstance(f, Flight)):
        raise TwinError(
            f"{verb}: {flight.name} stays in its file, {verb} needs it whole: "
            f"read_flight(FILE), of a part of the log where it does not fit into memory."
        )
    return flights


def opened_flights(given: Any, verb: str) -> tuple[AnyFlight, ...]:
    """One or several flights given to a function, in memory or in their files.

    Raises:
        TwinError: The argument is something else.
    """
    flights = (given,) if isinstance(given, Flight | StoredFlight | str | Path) else given
    if not isinstance(flights, Iterable):
        raise TwinError(f"{verb}: a {type(given).__name__} is no flight. {_HOW}")
    flights = tuple(flights)
    for flight in flights:
        if isinstance(flight, str | Path):
            raise TwinError(f"{verb}: '{flight}' is the name of a file, not a flight. {_HOW}")
        if not isinstance(flight, Flight | StoredFlight):
            raise TwinError(f"{verb}: a {type(flight).__name__} is no flight. {_HOW}")
    return flights


def check_names(flights: Iterable[Flight]) -> None:
    """Refuse two flights of one name, which tables cannot distinguish.

    Raises:
        TwinError: There are two.
    """
    seen: set[str] = set()
    for flight in flights:
        if flight.name in seen:
            raise TwinError(
                f"{flight.source or flight.name}: two flights are named {flight.name}; rename one "
                f"of them."
            )
        seen.add(flight.name)


def check_untaught(flights: Iterable[Flight], model: Path, taught: Mapping[str, str]) -> None:
    """Refuse flights on which a model was trained, under any name.

    Args:
        flights: Flights for the evaluation.
        model: Folder of the model.
        taught: Names of its flights by their fingerprints.

    Raises:
        TwinError: There is one.
    """
    for flight in flights:
        if (name := taught.get(flight.fingerprint)) is not None:
            raise TwinError(
                f"{flight.source or flight.name}: {model} was trained on this flight, named "
                f"{name} then. Evaluate on others."
            )


_HOW = "Read it first: read_flight(FILE), or read_flights(PATTERN) for several."
"""Remedy for an argument that is no flight."""
