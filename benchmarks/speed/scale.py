"""Time and memory of the verbs that read logs, against length of flight.

A built-in flight is flown again and again until it is long enough; each verb then runs in a process
of its own on each length, and the slopes of a straight line over the lengths are given.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from twin.errors import TwinError
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import IMU_S, fly, hide

from .verb import VERBS

ROOT = Path(__file__).parents[2]
"""Of the checkout."""
VEHICLE = "copter_default"
"""Built-in vehicle whose flight is repeated."""
SEED = 4  # rotor drag is hidden
ROWS_OF_GROUP = 1 << 20
"""As pyarrow and pandas write them."""
SHORTEST_MIN, LONGEST_MIN = 0.05, 160.0
"""Shortest and longest flight that may be asked for, min."""
MOST_HZ = 1000.0
"""Highest rate of the flight table, rows per second."""


@dataclass(frozen=True, slots=True)
class Took:
    """What a verb took on a flight of one length.

    Attributes:
        verb: Of `verb.VERBS`.
        minutes: Of flight.
        seconds: By the clock.
        processor_s: Of all cores.
        peak_mb: Resident memory at most, the interpreter and its packages included.
    """

    verb: str
    minutes: float
    seconds: float
    processor_s: float
    peak_mb: float


@dataclass(frozen=True, slots=True)
class Slope:
    """How a verb grows with the flight, by a straight line over the lengths.

    Attributes:
        verb: Of `verb.VERBS`.
        processor_s_per_min: Per minute of flight.
        mb_per_min: Per minute of flight.
    """

    verb: str
    processor_s_per_min: float
    mb_per_min: float


@dataclass(frozen=True, slots=True)
class Scale:
    """What was measured.

    Attributes:
        rate_hz: Rows of the flight table per second.
        runs: Verb by verb, the shortest flight first.
        slopes: Of each verb; none of a single length.
    """

    rate_hz: float
    runs: tuple[Took, ...]
    slopes: tuple[Slope, ...]


def run_scale(
    minutes: Sequence[float],
    rate_hz: float = 1000.0,
    verbs: Sequence[str] = VERBS,
    progress: Callable[[float], None] = lambda _: None,
) -> Scale:
    """Measure.

    Args:
        minutes: Lengths of the flights.
        rate_hz: Rows per second: commands and IMU in each, pose at most 100 times per second.
        verbs: Of `verb.VERBS`.
        progress: Called with the share done.

    Raises:
        TwinError: A length or the rate is out of bounds, or a verb failed.
    """
    lengths = sorted(set(minutes))
    if not lengths or not SHORTEST_MIN <= lengths[0] <= lengths[-1] <= LONGEST_MIN:
        raise TwinError(f"--minutes: give lengths of {SHORTEST_MIN:g} to {LONGEST_MIN:g} min.")
    if not 1 / IMU_S <= rate_hz <= MOST_HZ or MOST_HZ % rate_hz:
        raise TwinError(
            f"--rate {rate_hz:g}: give 200, 250, 500 or 1000 rows per second, as {MOST_HZ:g} is "
            f"what is simulated."
        )
    runs = []
    work, done = len(verbs) * sum(lengths), 0.0
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as folder:
        table = short_flight(rate_hz)
        for length in lengths:
            file = Path(folder) / f"flight_{length:g}_min.parquet"
            write_long(table, rate_hz, length, file)
            for verb in verbs:
                runs.append(took(verb, length, file))
                done += length
                progress(done / work)
            file.unlink()
    runs.sort(key=lambda t: (verbs.index(t.verb), t.minutes))
    slopes = [slope([t for t in runs if t.verb == verb]) for verb in verbs]
    return Scale(rate_hz, tuple(runs), tuple(slopes) if len(lengths) > 1 else ())


def short_flight(rate_hz: float) -> pd.DataFrame:
    """The table of the built-in flight that is flown again and again; it ends where it began."""
    vehicle = load_vehicle(VEHICLE)
    return fly(vehicle, hide(vehicle, SEED).plant, SEED, imu_s=1 / rate_hz).table


def write_long(table: pd.DataFrame, rate_hz: float, minutes: float, file: Path) -> None:
    """Write a flight over and over, on one clock, until it is long enough."""
    rows = round(minutes * 60 * rate_hz)
    schema = pa.Schema.from_pandas(table, preserve_index=False).remove_metadata()
    with pq.ParquetWriter(file, schema) as writer:
        for part in _again(table, rate_hz, rows):
            writer.write_table(pa.Table.from_pandas(part, schema, preserve_index=False))


def _again(table: pd.DataFrame, rate_hz: float, rows: int) -> Iterator[pd.DataFrame]:
    """So many rows of a flight that is flown again and again, a row group at a time."""
    for first in range(0, rows, ROWS_OF_GROUP):
        here = np.arange(first, min(first + ROWS_OF_GROUP, rows))
        yield table.iloc[here % len(table)].assign(time=here / rate_hz)


def took(verb: str, minutes: float, file: Path) -> Took:
    """Run a verb on a file in a process of its own.

    Raises:
        TwinError: It failed.
    """
    command = [sys.executable, "-m", "benchmarks.speed.verb", verb, str(file), VEHICLE]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if result.returncode not in (0, 1):  # 1: it has found something
        last = result.stderr.strip().splitlines()[-1:]
        raise TwinError(f"{verb} of {minutes:g} min: {''.join(last) or result.returncode}")
    return Took(verb, minutes, **json.loads(result.stdout.splitlines()[-1]))


def slope(runs: Sequence[Took]) -> Slope:
    """Least-squares line over the runs of one verb; not a number for a single length."""
    minutes = np.array([t.minutes for t in runs])
    about = minutes - minutes.mean()
    spread = float(about @ about)

    def per_minute(values: Sequence[float]) -> float:
        return float(about @ np.asarray(values)) / spread if spread else float("nan")

    return Slope(
        runs[0].verb,
        per_minute([t.processor_s for t in runs]),
        per_minute([t.peak_mb for t in runs]),
    )
