"""Several aircraft at once, each with its twin, in one process."""

import multiprocessing
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from twin.explain.running.evidence import RunningEvidence
from twin.logs import write_flight
from twin.logs.read import read_flight
from twin.vehicle.file import load_vehicle
from uavtwin.live.address import Address
from uavtwin.live.replay import Replay
from uavtwin.live.session import LiveOptions, LiveSession
from uavtwin.live.status import LiveStatus

from .flights import long_flight
from .ports import free_address

SETTLED_S = 12.0
"""Of flight, after which the start is over: equations are there, the quiet start is learned."""


def aircraft_at_once(
    count: int, seconds: float, alarms: bool, vehicle_name: str = "copter_default"
) -> dict[str, Any]:
    """Hear so many in real time; what they cost, and whether any was behind.

    Args:
        count: How many.
        seconds: So long.
        alarms: Whether evidence is kept of each.
        vehicle_name: Which.

    Returns:
        Among others `cpu_per_second`, processor per second of flight of one aircraft after the
        start; None: it was not over.
    """
    vehicle = load_vehicle(vehicle_name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "flight.parquet")
        write_flight(long_flight(vehicle, seconds).between(0.0, seconds), path)
        evidence = (lambda: RunningEvidence(vehicle)) if alarms else (lambda: None)
        where = [free_address() for _ in range(count)]
        sessions = [LiveSession(vehicle, LiveOptions(a, system=1), evidence) for a in where]
        status: dict[int, LiveStatus] = {}
        over = threading.Event()

        def listen(k: int) -> None:
            status[k] = sessions[k].run(over.is_set)

        threads = [threading.Thread(target=listen, args=(k,)) for k in range(count)]
        context = multiprocessing.get_context("spawn")
        ready = context.Event()
        sender = context.Process(target=_play, args=(path, where, ready), daemon=True)
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


def _play(path: Path, where: list[Address], ready: Any) -> None:
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
