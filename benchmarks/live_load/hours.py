"""Memory of a live flight that goes on and on, and whether it keeps up."""

import multiprocessing
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from twin.explain.running.evidence import RunningEvidence
from twin.logs import Flight, write_flight
from twin.logs.read import read_flight
from twin.vehicle.file import load_vehicle
from uavtwin.live.address import Address
from uavtwin.live.replay import Replay
from uavtwin.live.session import LiveOptions, LiveSession

from .flights import long_flight
from .ports import free_address

_EVERY_S = 2.0
MIB = 2.0**20


def growth(seconds: float, speed: float, vehicle_name: str = "copter_default") -> dict[str, Any]:
    """Fly so long, recorded, with evidence, and watch the memory of this process.

    Args:
        seconds: Of flight, at least.
        speed: Times real time.
        vehicle_name: Who flies.
    """
    vehicle = load_vehicle(vehicle_name)
    with tempfile.TemporaryDirectory() as folder:
        flight = long_flight(vehicle, seconds)
        write_flight(flight, Path(folder, "long.parquet"))
        times_s = flight.time_s
        del flight
        options = LiveOptions(free_address(), record=Path(folder, "rec"), until_silent_s=20.0)
        session = LiveSession(vehicle, options, lambda: RunningEvidence(vehicle))
        context = multiprocessing.get_context("spawn")
        arguments = (Path(folder, "long.parquet"), options.listen, speed)
        sender = context.Process(target=_play, args=arguments, daemon=True)
        memory: list[tuple[float, float]] = []
        over = threading.Event()
        watching = threading.Thread(target=_watch, args=(session, memory, over))
        began = time.monotonic()
        sender.start()
        watching.start()
        # The end of a recording is written anew as Parquet: that is not the growth in flight.
        status = session.run(lambda: not sender.is_alive())
        over.set()
        watching.join()
        sender.join()
        wall_s = time.monotonic() - began
        recorded = len(read_flight(Path(folder, "rec", "flight.parquet")).table)
    sent = int((times_s <= status.flight_s + 1e-9).sum())  # the sender may have been ended early
    flown = np.array([m for m in memory if 60.0 < m[0] < status.flight_s - 2.0])
    later = flown[flown[:, 0] > 0.5 * status.flight_s, 1]
    return {
        "speed": speed,
        "flight_s": status.flight_s,
        "behind_s": float(times_s[-1]) - status.flight_s,
        "rss_of_the_second_half_mib": [float(later.min()), float(later.max())],
        "wall_s": wall_s,
        "rows_sent": sent,
        "rows_recorded": recorded,
        "lost": status.link.lost,
        "late": status.link.late,
        "alarms": len(status.alarms),
        "rss_after_a_minute_mib": float(flown[0, 1]),
        "rss_at_the_end_mib": float(flown[-1, 1]),
        "rss_least_mib": float(flown[:, 1].min()),
        "rss_most_mib": float(flown[:, 1].max()),
        "memory": memory,
    }


def _watch(session: LiveSession, memory: list[tuple[float, float]], over: threading.Event) -> None:
    """Time of the flight and resident memory, MiB, every two seconds."""
    this = psutil.Process()
    while not over.wait(_EVERY_S):
        memory.append((session.worker.flight_s, this.memory_info().rss / MIB))


def _play(path: Path, to: Address, speed: float) -> None:
    flight: Flight = read_flight(path)
    aircraft = Replay(to, speed)
    aircraft.play(flight)
    aircraft.close()
