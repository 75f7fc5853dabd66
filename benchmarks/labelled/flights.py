"""The labelled flights: an index of where each comes from, and a reader that refuses other bytes.

No flight is part of this repository. `index.csv` has a row per file: its place in the folder of the
data, set, repository, commit and path of its origin, sha256, licence, label, rotors from 1, onset
in s from the start of the log, and normal flights of the same aircraft. A set is added by its rows.
"""

import csv
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from twin.errors import TwinError
from twin.logs import Flight, read_flight

INDEX = Path(__file__).parent / "index.csv"
"""A row per flight."""
CLASSES = {
    "payload_cg": {"payload_cg", "mass_offset", "cog_offset", "inertia_error", "mass_change"},
    "propeller": {"propeller", "rotor_efficiency_loss", "vibration"},
    "slung_load": {"slung_load"},
    "wind": {"wind", "steady_wind", "gust"},
    "rotor_failure": {"rotor_failure"},
}
"""Causes that count as a label; all others are of none, and no false name on a normal flight."""
NORMAL = "none"
"""Label of a flight in which nothing of these is to be found."""


@dataclass(frozen=True, slots=True)
class Labelled:
    """A flight whose defect is known.

    Attributes:
        file: Place in the folder of the data.
        set: Which it belongs to.
        repository: Of its origin.
        commit: Of the repository.
        path: In it.
        sha256: Of the file.
        licence: As the origin states it.
        label: A class, or `NORMAL`.
        rotors: Numbers from 1; empty: of none.
        onset_s: From the start of the log; None: all the time.
        references: Normal flights of the same aircraft.
    """

    file: str
    set: str
    repository: str
    commit: str
    path: str
    sha256: str
    licence: str
    label: str
    rotors: frozenset[int]
    onset_s: float | None
    references: tuple[str, ...]

    @property
    def name(self) -> str:
        """For tables."""
        return Path(self.file).stem


def labelled(index: Path = INDEX) -> list[Labelled]:
    """All rows of an index."""
    with index.open(encoding="utf-8", newline="") as file:
        return [_row(r) for r in csv.DictReader(file)]


def _row(r: dict[str, str]) -> Labelled:
    names = ("file", "set", "repository", "commit", "path", "sha256", "licence", "label")
    return Labelled(
        **{k: r[k] for k in names},
        rotors=frozenset(map(int, r["rotors"].split())),
        onset_s=float(r["onset_s"]) if r["onset_s"] else None,
        references=tuple(r["references"].split()),
    )


def opened(flights: list[Labelled], data: Path) -> Iterator[tuple[Labelled, Flight]]:
    """Each flight that is in the folder of the data, as read.

    Raises:
        TwinError: A file has other bytes than those that were labelled.
    """
    for each in flights:
        file = data / each.file
        if file.is_file():
            check(each, file)
            yield each, read_flight(file)


def check(each: Labelled, file: Path) -> None:
    """Refuse a file that is not the labelled one.

    Raises:
        TwinError: It is not.
    """
    found = hashlib.sha256(file.read_bytes()).hexdigest()
    if found != each.sha256:
        raise TwinError(
            f"{file}: sha256 {found[:12]}..., the labelled file has {each.sha256[:12]}...; fetch "
            f"{each.path} of {each.repository} at {each.commit or 'its origin'}."
        )


def class_of(cause: str) -> str:
    """Class of a cause; "other" where it is none of them."""
    return next((c for c, names in CLASSES.items() if cause in names), "other")
