"""Errors of a twin on flights of other days: accuracy.json, next to the vehicle file of `explain`,
and the bands of an exported twin.
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
"""Name of the file in the folder of `explain`."""
PLAIN, OBSERVED = "plain", "observer"
"""Twins that are compared: unchanged, and with their disturbance observer on."""
_MOST_BYTES = 2**24  # of a file that is read


class BandsRecord(Record, frozen=True, kw_only=True):
    """Bands of one twin.

    Attributes:
        horizons_s: Times without given motion at which it was compared, s.
        limits: Largest values during the flights, by name: airspeed (m/s), rates (rad/s), thrust
            and ground (1).
        calm: Share of the envelope up to which the regime is calm.
        bands: 95 % bands by quantity and regime, at each of `horizons_s`.
        windows: Number of windows without given motion, by flight.
        missing: Quantities without a band, and their regimes without a separate one, with the
            reason.
    """

    horizons_s: tuple[float, ...]
    limits: dict[str, float]
    calm: float
    bands: dict[str, dict[str, tuple[float, ...]]]
    windows: dict[str, int]
    missing: dict[str, str]


class AccuracyRecord(Record, frozen=True, kw_only=True):
    """Errors of a driven twin on flights that took no part in its fit.

    Attributes:
        vehicle: Name of the vehicle.
        vehicle_sha256: Hash of the vehicle file.
        drive: Input of the twin: command or rotor_speed.
        twins: Bands by twin: plain, and with its observer on.
        missing: Twins without bands, and flights that could not be compared, with the reason.
    """

    digits = 6

    vehicle: str
    vehicle_sha256: str
    drive: str
    twins: dict[str, BandsRecord]
    missing: dict[str, str]

    def bands(self, twin: str) -> Bands:
        """Bands of a twin that has some.

        Raises:
            ModelError: They are invalid.
        """
        found = self.twins[twin]
        rows = {q: [by[r] for r in REGIMES] for q, by in found.bands.items()}
        limits = [found.limits[name] for name, *_ in SEEN]
        return Bands(found.horizons_s, limits, found.calm, rows)


def record_of(bands: Bands, windows: dict[str, int], missing: dict[str, str]) -> BandsRecord:
    """Record of bands."""
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
    """Hash of the file of a vehicle."""
    return hashlib.sha256(checked_vehicle(vehicle, "accuracy").toml().encode()).hexdigest()


def read_accuracy(folder: Path, vehicle: Vehicle) -> AccuracyRecord:
    """Record in a folder of `explain`; an empty one with the reason where there is none.

    Raises:
        TwinError: It cannot be read, or belongs to other numbers.
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
    """The component with the accuracy bands of a twin, and the factor for its card.

    Args:
        found: Errors on flights that took no part in the fit.
        vehicle: Vehicle of the twin.
        drive: Input of the twin.
        observer: Whether its observer is on.
        changes: Further differences from the compared twins.
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
