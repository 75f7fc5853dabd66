"""Long live flights and several aircraft at once: memory, processor, whether the twin keeps up.

The flight is as long as wanted: squares of the demonstration, again and again, nothing wrong.
"""

import multiprocessing
import socket
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil

from twin.logs import Flight, write_flight
from twin.logs.read import read_flight
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from twin.why.watch import Watch
from uavtwin.demo.in_flight import damaged_flight
from uavtwin.live.replay import Replay
from uavtwin.live.session import LiveOptions, LiveSession
from uavtwin.live.status import LiveStatus
from uavtwin.sockets import Address


def free_address() -> Address:
    """One of the loopback."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_port:
        any_port.bind(("127.0.0.1", 0))
        return Address("127.0.0.1", any_port.getsockname()[1])


_ONCE_S, _FIRST_S, _SQUARE_S = 50.0, 8.0, 14.0
"""Of the flight that is simulated; where its squares begin; how long one is, with its hover."""


def long_flight(vehicle: Vehicle, seconds: float) -> Flight:
    """Take-off, then squares; from one to the next the state jumps by what the controller leaves.

    Args:
        vehicle: That flies.
        seconds: How long, at least.
    """
    once = damaged_flight(vehicle, begins_s=_ONCE_S + 60.0, loss=0.0, seconds=_ONCE_S).table
    t = once["time"].to_numpy()
    whole = _SQUARE_S * np.floor((t[-1] - _FIRST_S) / _SQUARE_S)
    squares = once[(t >= _FIRST_S) & (t < _FIRST_S + whole - 1e-9)]
    parts = [once[t < _FIRST_S]]
    for k in range(int(np.ceil((seconds - _FIRST_S) / whole))):
        parts.append(squares.assign(time=squares["time"] + k * whole))
    return Flight("long", pd.concat(parts, ignore_index=True))


_EVERY_S = 2.0
"""Between two readings of the memory, s. Made up."""
MIB = 2.0**20
"""Bytes."""


def growth(seconds: float, speed: float, vehicle_name: str = "copter_default") -> dict[str, Any]:
    """Fly so long, recorded, with alarms, and watch the memory of this process.

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
        session = LiveSession(vehicle, options, lambda: Watch(vehicle))
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


SETTLED_S = 12.0
"""Of flight, after which the start is over: equations are there, the quiet start is learned."""


def aircraft_at_once(
    count: int, seconds: float, alarms: bool, vehicle_name: str = "copter_default"
) -> dict[str, Any]:
    """Hear so many in real time; what they cost, and whether any was behind.

    Args:
        count: How many.
        seconds: So long.
        alarms: Whether each is looked at.
        vehicle_name: Which.

    Returns:
        Among others `cpu_per_second`, processor per second of flight of one aircraft after the
        start; None: it was not over.
    """
    vehicle = load_vehicle(vehicle_name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "flight.parquet")
        write_flight(long_flight(vehicle, seconds).between(0.0, seconds), path)
        watch = (lambda: Watch(vehicle)) if alarms else (lambda: None)
        where = [free_address() for _ in range(count)]
        sessions = [LiveSession(vehicle, LiveOptions(a, system=1), watch) for a in where]
        status: dict[int, LiveStatus] = {}
        over = threading.Event()

        def listen(k: int) -> None:
            status[k] = sessions[k].run(over.is_set)

        threads = [threading.Thread(target=listen, args=(k,)) for k in range(count)]
        context = multiprocessing.get_context("spawn")
        ready = context.Event()
        sender = context.Process(target=_play_to_all, args=(path, where, ready), daemon=True)
        sender.start()
        ready.wait()
        began, began_cpu = time.monotonic(), time.process_time()
        for thread in threads:
            thread.start()
        while sender.is_alive() and min(s.worker.flight_s for s in sessions) < SETTLED_S:
            time.sleep(0.05)
        settled, settled_cpu = [s.worker.flight_s for s in sessions], time.process_time()
        sender.join()
        wall_s, cpu_s = time.monotonic() - began, time.process_time() - began_cpu
        flown_s = sum(s.worker.flight_s - t for s, t in zip(sessions, settled, strict=True))
        steady_s = time.process_time() - settled_cpu
        behind_s = [seconds - s.worker.flight_s for s in sessions]
        over.set()
        for thread in threads:
            thread.join()
    return {
        "aircraft": count,
        "alarms_kept": alarms,
        "seconds": seconds,
        "wall_s": wall_s,
        "cpu_share": cpu_s / wall_s,
        "cpu_per_second": steady_s / flown_s if flown_s > 1.0 else None,
        "lost": sum(t.link.lost for t in status.values()),
        "late": sum(t.link.late for t in status.values()),
        "most_behind_s": max(behind_s),
        "alarms": sum(len(t.alarms) for t in status.values()),
    }


def _play_to_all(path: Path, where: list[Address], ready: Any) -> None:
    """All of them at once, from threads of one process."""
    flight = read_flight(path)
    senders = [Replay(to, 1.0) for to in where]
    threads = [threading.Thread(target=s.play, args=(flight,)) for s in senders]
    ready.set()
    time.sleep(0.5)
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for sender in senders:
        sender.close()
