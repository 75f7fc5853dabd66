"""Residual flights of the simulated aircraft, kept on disk alongside the flights.

    DIR/residuals/NAME/FLIGHT-RESTART-KEY.parquet

KEY is a hash of flight, vehicle file, rate, restart and the sources that make residuals, those of
`twin` but for `twin.explain` among them: when one changes, the file is made again, and the old one
removed.
"""

import hashlib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

import twin
from learning import preset
from learning.data import channels, flights
from learning.data.flights import (
    DEFAULT_HORIZON_S,
    DEFAULT_RATE_HZ,
    ResidualFlight,
    read_residuals,
    residual_flight,
    write_residuals,
)
from twin.logs import read_flight
from twin.vehicle_file import load_vehicle

from .simulated import VEHICLE, Individual


def residuals(
    out: Path,
    wanted: Sequence[Individual],
    use: str,
    jobs: int = 1,
    rate_hz: float = DEFAULT_RATE_HZ,
    restart_s: float = DEFAULT_HORIZON_S,
) -> dict[str, list[ResidualFlight]]:
    """Residual flights of aircraft that have been produced, by the name of the aircraft.

    Args:
        out: Folder of `simulated.produce`.
        wanted: Aircraft.
        use: "train" or "test".
        jobs: Processes.
        rate_hz: Of the grid.
        restart_s: From the restart to the reading.
    """
    files = [(i.name, f, i.folder(out) / VEHICLE) for i in wanted for f in i.files(out, use)]
    caches = [out / "residuals" / name for name, _, _ in files]
    arguments = (
        [f for _, f, _ in files],
        [v for _, _, v in files],
        caches,
        repeat(rate_hz),
        repeat(restart_s),
        repeat(_state()),
    )
    if jobs == 1:
        made = list(map(_residual, *arguments))
    else:
        with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
            made = list(pool.map(_residual, *arguments))
    found: dict[str, list[ResidualFlight]] = {i.name: [] for i in wanted}
    for (name, _, _), flight in zip(files, made, strict=True):
        found[name].append(flight)
    return found


def _residual(
    path: Path, vehicle: Path, cache: Path, rate_hz: float, restart_s: float, state: str
) -> ResidualFlight:
    digest = hashlib.sha256(f"{state} {rate_hz:.17g} {restart_s:.17g}".encode())
    for file in (path, vehicle):
        digest.update(file.read_bytes())
    name = f"{path.stem}-{1e3 * restart_s:g}ms"
    stored = cache / f"{name}-{digest.hexdigest()[:16]}.parquet"
    if not stored.is_file():
        flight = residual_flight(read_flight(path), load_vehicle(str(vehicle)), rate_hz, restart_s)
        cache.mkdir(parents=True, exist_ok=True)
        for old in cache.glob(f"{name}-*"):
            old.unlink()
        partial = stored.with_suffix(".partial")
        write_residuals([flight], partial)
        partial.replace(stored)
    return read_residuals(stored)[0]


def source_files() -> list[Path]:
    """The sources that make a residual flight, and those that keep it."""
    root = Path(next(iter(twin.__path__)))
    files = [f for f in sorted(root.rglob("*.py")) if f.relative_to(root).parts[0] != "explain"]
    return files + [Path(str(m.__file__)) for m in (preset, channels, flights)]


def _state() -> str:
    """Hash of the sources: their names and what stands in them."""
    digest = hashlib.sha256()
    for file in source_files():
        content = file.read_bytes()
        digest.update(f"{file.name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()
