"""How far a twin was off on flights of other days: accuracy.json, beside the vehicle file of
`explain`, and the bands that an exported twin looks up.
"""

import hashlib
from collections.abc import Iterable
from pathlib import Path

import msgspec
import numpy as np

from twin.component import Component
from twin.errors import TwinError
from twin.physics.accuracy import REGIMES, SEEN, Bands, accuracy, nowhere_valid
from twin.vehicle import Vehicle

from ..record import Record
from ..vehicles import checked_vehicle
from .credibility import FactorRecord

FILE = "accuracy.json"
"""Its name in the folder of `explain`."""
PLAIN, OBSERVED = "plain", "observer"
"""Twins that are compared: as they are, and with their disturbance observer on."""
_MOST_BYTES = 2**24  # of a file that is read


class BandsRecord(Record, frozen=True, kw_only=True):
    """Bands of one twin.

    Attributes:
        horizons_s: Times alone at which it was compared, s.
        limits: What the aircraft went through at most, by name: airspeed (m/s), rates (rad/s),
            thrust and ground (1).
        calm: Share of the envelope up to which the regime is calm.
        bands: 95 % bands by quantity and regime, at each of `horizons_s`.
        windows: How often the twin was left alone, by flight.
        missing: Quantities without a band, and regimes of them without one of their own, and why.
    """

    horizons_s: tuple[float, ...]
    limits: dict[str, float]
    calm: float
    bands: dict[str, dict[str, tuple[float, ...]]]
    windows: dict[str, int]
    missing: dict[str, str]


class AccuracyRecord(Record, frozen=True, kw_only=True):
    """How far a driven twin was off on flights that took no part in its fit.

    Attributes:
        vehicle: Name.
        vehicle_sha256: Of the vehicle file.
        drive: What drove it: command or rotor_speed.
        twins: Bands by twin: plain, and with its observer on.
        missing: Twins without bands, and flights that could not be compared, and why.
    """

    digits = 6

    vehicle: str
    vehicle_sha256: str
    drive: str
    twins: dict[str, BandsRecord]
    missing: dict[str, str]

    def bands(self, twin: str) -> Bands:
        """Of a twin that has some.

        Raises:
            ModelError: They are none.
        """
        found = self.twins[twin]
        rows = {q: [by[r] for r in REGIMES] for q, by in found.bands.items()}
        limits = [found.limits[name] for name, *_ in SEEN]
        return Bands(found.horizons_s, limits, found.calm, rows)


def record_of(bands: Bands, windows: dict[str, int], missing: dict[str, str]) -> BandsRecord:
    """Bands as they are written."""
    return BandsRecord(
        horizons_s=tuple(bands.horizons_s),
        limits=dict(zip((name for name, *_ in SEEN), bands.limits, strict=True)),
        calm=bands.calm,
        bands={
            q: {r: tuple(np.asarray(x).tolist()) for r, x in zip(REGIMES, rows, strict=True)}
            for q, rows in bands.bands.items()
        },
        windows=windows,
        missing=missing,
    )


def digest(vehicle: Vehicle) -> str:
    """Of the file that a vehicle makes."""
    return hashlib.sha256(checked_vehicle(vehicle, "accuracy").toml().encode()).hexdigest()


def read_accuracy(folder: Path, vehicle: Vehicle) -> AccuracyRecord:
    """What `explain` has left in a folder; where it left nothing, it says so.

    Raises:
        TwinError: It cannot be read, or it is of other numbers.
    """
    path, own = folder / FILE, digest(vehicle)
    if not path.is_file():
        why = f"no {FILE}: explain writes it of whole flights held out, unless it builds no FMUs"
        return AccuracyRecord(
            vehicle=vehicle.name,
            vehicle_sha256=own,
            drive="",
            twins={},
            missing=dict.fromkeys((PLAIN, OBSERVED), why),
        )
    try:
        with path.open("rb") as file:
            found = msgspec.json.decode(file.read(_MOST_BYTES), type=AccuracyRecord)
        for twin in found.twins:
            found.bands(twin)
    except (OSError, KeyError, msgspec.DecodeError, TwinError) as error:
        why = f"has no {error}" if isinstance(error, KeyError) else str(error).rstrip(".")
        raise TwinError(f"{path}: {why}. explain writes it; run it again.") from None
    if found.vehicle_sha256 != own:
        raise TwinError(
            f"{path}: is of other numbers than {folder / 'vehicle.toml'}; run explain again."
        )
    return found


def accuracy_part(
    found: AccuracyRecord, vehicle: Vehicle, drive: str, observer: bool, changes: Iterable[str]
) -> tuple[Component, FactorRecord]:
    """The part of a twin that says how far it may be off, and the same for its card.

    Args:
        found: Of flights that took no part in the fit.
        vehicle: Of the twin.
        drive: What drives it.
        observer: Whether its observer is on.
        changes: In what else it is another twin than the compared ones.
    """
    twin = OBSERVED if observer else PLAIN
    why = ", ".join(changes)
    if not why and twin not in found.twins:
        why = found.missing.get(twin, "it was not compared")
    if not why and drive != found.drive:
        why = f"it was compared driven by {found.drive}, not by {drive}"
    if why:
        return nowhere_valid(vehicle), FactorRecord(level=0, because=f"bands of outputs: {why}")
    own = found.twins[twin]
    because = (
        f"95 % bands of {', '.join(own.bands)} up to {own.horizons_s[-1]:g} s; held out: "
        f"{', '.join(own.windows)}"
    )
    because += "".join(f"; {what}: {why}" for what, why in own.missing.items())
    return accuracy(vehicle, found.bands(twin)), FactorRecord(level=2, because=because)
