"""What a flight table in Parquet says besides its columns, as JSON in the metadata of the file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from ..airframe import Airframe
from ..autopilot import Autopilot, check_autopilot
from ..flight import Finding, Flight, Settled, Site

_KEY = b"uavtwin"
_MOST_ROTORS = 64


@dataclass(frozen=True, slots=True)
class Notes:
    """What a writer noted, with the meaning of the fields of `Flight`."""

    facts: dict[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    site: Site | None = None
    airframe: Airframe | None = None
    autopilot: Autopilot | None = None
    settled: Settled | None = None

    @classmethod
    def of(cls, flight: Flight) -> "Notes":
        """Those of a flight."""
        return cls(
            flight.facts,
            flight.findings,
            flight.site,
            flight.airframe,
            flight.autopilot,
            flight.settled,
        )

    def metadata(self) -> dict[bytes, bytes]:
        """As metadata of a Parquet file."""
        return {_KEY: msgspec.json.encode(self, enc_hook=_listed)}


def read_notes(metadata: Mapping[bytes, bytes] | None) -> Notes:
    """The notes in the metadata of a Parquet file, all of them or none.

    Returns:
        Of a file without notes: none; of one whose notes cannot be read: a finding that says so.
    """
    noted = (metadata or {}).get(_KEY)
    if noted is None:
        return Notes()
    try:
        found = msgspec.json.decode(noted, type=Notes, dec_hook=_array)
        _check(found)
    except (ValueError, TypeError, RecursionError) as error:
        reason = f" ({error})" if isinstance(error, msgspec.ValidationError) else ""
        text = f"what the writer noted cannot be read{reason}"
        return Notes(findings=(Finding("warning", "file", text),))
    return found


def _check(notes: Notes) -> None:
    """Refuse what has the right types and no meaning.

    Raises:
        ValueError: It is such.
    """
    if notes.autopilot is not None:
        check_autopilot(notes.autopilot)
    settled = notes.settled
    if settled is not None and not all(0.0 < r < 1e6 for r in settled.rates_hz.values()):
        raise ValueError("a rate that is none")
    layout = None if notes.airframe is None else notes.airframe.layout
    if any(f.count < 1 for f in notes.findings):
        raise ValueError("a finding is counted less than once")
    if layout is not None:
        if layout.direction.ndim != 1 or not 0 < layout.count <= _MOST_ROTORS:
            raise ValueError("a layout without rotors, or with too many")
        if layout.position.shape != (layout.count, 3):
            raise ValueError("a layout whose rotors have not three coordinates each")
        if not (np.abs(layout.direction) == 1).all() or not layout.arm > 0:
            raise ValueError("a layout whose rotors do not turn, or lie in one place")


def _listed(value: Any) -> Any:
    """What JSON has no word for."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be noted")


def _array(kind: type, value: Any) -> Any:
    """An array of numbers."""
    return np.asarray(value, dtype=np.float64)
