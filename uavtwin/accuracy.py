"""Error bands of a driven twin on flights that took no part in its fit: 95 % bands by conformal
prediction.

Each flight is replayed through the FMU itself (`force.open_loop`), in windows without given motion.
Windows of one flight are similar, those of another day less so: flights are exchangeable. In a cell
(quantity, regime, time without given motion) each flight has the same weight, however many windows
it has, and so has the next flight, which is unknown: it is represented by another copy of the worst
one. The band is the 95 % quantile of that mixture. It never decreases with time: where it would,
the band of the earlier time is used.

Source: Lee, Barber & Willett, Distribution-free inference with hierarchical data, 2023, after Dunn,
Wasserman & Ramdas, Distribution-free prediction sets for two-layer hierarchical models, J. American
Statistical Association 118, 2023. There the error of the next flight is infinite, for which fewer
than 19 flights give no finite band; the worst one in its place was chosen among three laws (the
largest of the flights' own bounds; without the next flight) by 35 real flights of CrazyPAD, none of
which scores bands: with 2 to 20 flights it covers 93.6 to 95.5 % of the others' windows, with
observer.
"""

import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.errors import TwinError
from twin.explain.explanation import Explanation
from twin.flight.assembly import driven_twin
from twin.formatting import counted, joined
from twin.logs import AnyFlight
from twin.physics.accuracy import OF_THE_DAY, REGIMES, SEEN, Bands, accuracy
from twin.physics.rotors import Drive
from twin.physics.sensors.table import SENSORS, Sensor
from twin.representation import ShortRepr
from twin.residuals.measured import Signal
from twin.residuals.teacher_forced import choose_drive
from twin.vehicle import Vehicle

from .explanation import explained_vehicle
from .exports.bands import FILE, OBSERVED, PLAIN, AccuracyRecord, BandsRecord, digest, record_of
from .exports.parts import OBSERVER, Twin
from .exports.write import export
from .force.open_loop import HORIZONS_S, QUANTITIES, Replay
from .output import OptionalSteps, write_json

Array = NDArray[np.float64]
Progress = Callable[[float], None]
EVERY_S = 0.25
"""Time between the starts of two windows without given motion, s."""
LEVEL = 0.95
FEWEST = ceil(LEVEL / (1 - LEVEL) - 1e-9)
"""Fewest windows of a flight: with fewer the largest error is no bound of this level."""
FLIGHTS = 2
"""Fewest flights for a band: one does not show the variation between flights."""
HALF = 0.5
"""Least share of windows in which the twin of a flight must be inside the envelope. Made up."""
STARTS = {PLAIN: 0.0, OBSERVED: 1.0}
"""Start value of the observer's switch, by twin."""
WORDS = {PLAIN: "the twin without an observer", OBSERVED: "the twin with one"}
"""Printed names of the twins."""


@dataclass(frozen=True, slots=True)
class Windows(ShortRepr):
    """Errors of a twin in one flight, for w windows without given motion, at each of h times.

    Attributes:
        name: Name of the flight.
        left: Values of `SEEN` at the start of each window, for the aircraft's motion, shape (w, 4).
        seen: Values of `SEEN` at the horizons, for the twin's motion, shape (w, h, 4).
        off: Length of the error vector by quantity, NaN without a reading, shape (w, h) each;
            for the sensor `OF_THE_DAY` minus its median over the flight at the start of windows.
    """

    name: str
    left: Array
    seen: Array
    off: Mapping[str, Array]


def replayed(flight: AnyFlight, vehicle: Vehicle, fmu: Path, twin: str = PLAIN) -> Windows:
    """Windows of a flight, replayed through an FMU that outputs its own motion.

    Raises:
        TwinError: The flight cannot be replayed.
    """
    sensors = [s for s in SENSORS if flight.has(*s.columns)]
    outputs = [f"accuracy.seen.{name}" for name, *_ in SEEN]
    outputs += [f"{s.component}.{c}" for s in sensors for c in s.columns]
    replay = Replay(flight, vehicle, every_s=EVERY_S)
    found = replay.through(fmu, {OBSERVER: STARTS[twin]}, outputs)
    off = {q: np.linalg.norm(found.off[:, :, i], axis=-1) for i, (q, _) in enumerate(QUANTITIES)}
    times = replay.start_s + found.t_s[:, None] + np.array((0.0, *HORIZONS_S))
    shown, place = np.concatenate([found.begin[:, None], found.watched], axis=1), len(SEEN)
    for sensor in sensors:
        end = place + len(sensor.columns)
        misread = _misread(flight, sensor, times, shown[..., place:end])
        if sensor.name == OF_THE_DAY and np.isfinite(misread[:, 0]).any():
            misread -= np.nanmedian(misread[:, 0], axis=0)
        off[sensor.name] = np.linalg.norm(misread[:, 1:], axis=-1)
        place = end
    return Windows(flight.name, found.begin[:, : len(SEEN)], found.watched[..., : len(SEEN)], off)


def _misread(flight: AnyFlight, sensor: Sensor, times: Array, shown: Array) -> Array:
    """Difference between the readings of a twin's sensor and those of the aircraft, shape as
    `shown`."""
    read = Signal(*flight.signal(list(sensor.columns))).at(times.ravel())
    return np.asarray(shown - read.reshape(shown.shape))


def bound(flights: Iterable[Array]) -> float | None:
    """Band of `LEVEL` by the values of each flight; None where these are too few."""
    known = [np.sort(values) for values in flights if len(values) >= FEWEST]
    if len(known) < FLIGHTS:
        return None
    known.append(max(known, key=lambda values: float(np.quantile(values, LEVEL))))
    share = np.concatenate([np.full(len(v), 1 / len(v) / len(known)) for v in known])
    values = np.concatenate(known)
    order = np.argsort(values, kind="stable")
    rank = np.searchsorted(np.cumsum(share[order]), LEVEL - 1e-9)
    return float(values[order][min(int(rank), len(values) - 1)])


def _too_few(flights: Sequence[object]) -> str:
    """Reason why flights have no bands; "": there are enough of them."""
    if len(flights) >= FLIGHTS:
        return ""
    there = f"{counted(flights, 'flight')} held out could be compared"
    return f"{there}, {FLIGHTS} are needed: give --holdout for each; the demo has one"


def _envelope(flight: Windows, limits: Array) -> Array:
    """Largest share of a limit that the twin had reached, shape (w, h); infinite at times by which
    it had left the envelope more often than not: the remaining windows are a selection."""
    used = np.asarray((flight.seen / limits).max(axis=2))
    used[:, (used <= 1).mean(axis=0) < HALF] = np.inf
    return used


def bands_of(flights: Sequence[Windows]) -> tuple[Bands, dict[str, str]]:
    """Bands of a twin, with the reason where quantities, or their regimes, have no separate one.

    Raises:
        TwinError: The flights are too few.
    """
    if few := _too_few(flights):
        raise TwinError(few)
    limits = np.maximum(np.max([f.left.max(axis=0) for f in flights], axis=0), 1e-9)
    used = [_envelope(f, limits) for f in flights]
    middles = [float(np.median(u[u <= 1])) for u in used if (u <= 1).any()]
    calm = float(np.median(middles)) if middles else 1.0
    regimes = [[u <= calm, (u > calm) & (u <= 1)] for u in used]

    def rows(quantity: str) -> tuple[list[list[float]], list[list[bool]]]:
        """Band by regime and time, as far as available; and whether it covers both regimes."""
        found: list[list[float]] = [[], []]
        shared: list[list[bool]] = [[], []]
        for h in range(len(HORIZONS_S)):
            cells = [
                [
                    _known(f, quantity, h, in_it[r])
                    for f, in_it in zip(flights, regimes, strict=True)
                ]
                for r in range(len(REGIMES))
            ]
            both = bound([np.concatenate(pair) for pair in zip(*cells, strict=True)])
            if both is None:
                break
            for row, of_both, cell in zip(found, shared, cells, strict=True):
                own = bound(cell)
                row.append(max([both if own is None else own, *row[-1:]]))
                of_both.append(own is None)
        return found, shared

    every = {q: rows(q) for q in (*(q for q, _ in QUANTITIES), *(s.name for s in SENSORS))}
    h = min(len(every[q][0][0]) for q, _ in QUANTITIES)
    if not h:
        raise TwinError(
            f"in fewer than {FLIGHTS} flights the twin was inside the envelope {FEWEST} times, and "
            f"more often than not, after {HORIZONS_S[0]:g} s alone"
        )
    cut, missing = {}, {}
    for quantity, (bands, shared) in every.items():
        if len(bands[0]) < h:
            missing[quantity] = f"fewer than {FLIGHTS} flights have {FEWEST} readings to compare"
            continue
        cut[quantity] = [r[:h] for r in bands]
        for regime, of_both in zip(REGIMES, shared, strict=True):
            times = [f"{t:g} s" for t, s in zip(HORIZONS_S[:h], of_both[:h], strict=True) if s]
            if times:
                missing[f"{quantity}, {regime}"] = (
                    f"at {joined(times)} the band of both regimes stands in: fewer than {FLIGHTS} "
                    f"flights have {FEWEST} readings of it"
                )
    return Bands(HORIZONS_S[:h], limits.tolist(), calm, cut), missing


def _known(flight: Windows, quantity: str, horizon: int, where: NDArray[np.bool_]) -> Array:
    """Errors of a quantity at a horizon in a regime."""
    if quantity not in flight.off:
        return np.zeros(0)
    values = flight.off[quantity][where[:, horizon], horizon]
    return np.asarray(values[np.isfinite(values)])


def measured_accuracy(
    vehicle: Vehicle, flights: Sequence[AnyFlight], progress: Progress = lambda _: None
) -> AccuracyRecord:
    """Bands of the driven twins of a vehicle.

    Args:
        vehicle: Vehicle file of the twins.
        flights: Flights that took no part in the fit of the vehicle.
        progress: Called with the share done.

    Raises:
        TwinError: There is no compiler.
    """
    drive = choose_drive(flights[0], vehicle)
    few = _too_few(flights)
    missing = dict.fromkeys(STARTS, few) if few else {}
    windows: dict[str, list[Windows]] = {}
    if not few:
        windows, missing = _replayed(vehicle, drive, flights, progress)
    twins: dict[str, BandsRecord] = {}
    for twin, own in windows.items():
        try:
            bands, without = bands_of(own)
        except TwinError as error:
            missing[twin] = str(error)
            continue
        twins[twin] = record_of(bands, {f.name: len(f.left) for f in own}, without)
    return AccuracyRecord(
        vehicle=vehicle.name,
        vehicle_sha256=digest(vehicle),
        drive=drive,
        twins=twins,
        missing=missing,
    )


def _replayed(
    vehicle: Vehicle, drive: Drive, flights: Sequence[AnyFlight], progress: Progress
) -> tuple[dict[str, list[Windows]], dict[str, str]]:
    """Windows of all flights by twin, and flights that could not be replayed, with the reason."""
    windows: dict[str, list[Windows]] = {twin: [] for twin in STARTS}
    missing: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        fmu = Path(folder, "twin.fmu")
        export(Twin(vehicle.name, driven_twin(vehicle, drive, accuracy=accuracy(vehicle))), fmu)
        for i, flight in enumerate(flights):
            try:
                found = {twin: replayed(flight, vehicle, fmu, twin) for twin in STARTS}
            except TwinError as error:
                missing[flight.name] = str(error)
                continue
            for twin, own in found.items():
                windows[twin].append(own)
            progress((i + 1) / len(flights))
    return windows, missing


def write_accuracy(
    found: Explanation,
    held_out: Sequence[AnyFlight],
    folder: Path,
    steps: OptionalSteps,
    progress: Progress = lambda _: None,
    tell: Callable[[str], None] = lambda _: None,
) -> list[str]:
    """Write the bands of the explained vehicle from whole held-out flights; returns names of files.

    Args:
        found: Result of `explain`; nothing is written where nothing is named.
        held_out: Flights; nothing is written without.
        folder: Folder of the results.
        steps: Runs this as an optional step: the compiler may fail, the disk may be full.
        progress: Called with the share done.
        tell: Called with the reason where twins have no bands.
    """
    if found.added is None or not held_out:
        return []

    def write(place: Path) -> AccuracyRecord:
        """Measure and write."""
        measured = measured_accuracy(explained_vehicle(found), held_out, progress)
        write_json(place / FILE, measured.json())
        return measured

    measured = steps.run("bands of accuracy", folder, write)
    if measured is None:
        return []
    if without := [twin for twin in STARTS if twin not in measured.twins]:
        why = dict.fromkeys(measured.missing.values())
        tell(f"{FILE}: no bands of {joined([WORDS[t] for t in without])}: {'; '.join(why)}")
    return [FILE]
