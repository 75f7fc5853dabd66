"""How old what a viewer sees is, and what the twin publishes, while an aircraft flies beside it."""

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from twin.logs import write_flight
from twin.vehicle_file import load_vehicle
from twin.why.watch import WINDOW_S

from .runs import free_address, long_flight

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "rigs"))

from page_rigs.browser import View, browser

_COMMAND = (sys.executable, "-c", "from uavtwin.cli.main import main; main()")
_SETTLED_S = WINDOW_S + 5.0
"""After the start, for both to be at their pace, and alarms to have as much flight as they hold."""


def ages(seconds: float, alarms: bool, vehicle_name: str = "copter_default") -> dict[str, Any]:
    """Fly so long beside a viewer; `live` has one core, sender and browser have the others.

    Args:
        seconds: Of the flight.
        alarms: Whether it is looked at.
        vehicle_name: Which.

    Returns:
        Ages of what the page shows, ms: of 50 and of 99 in 100 of its pictures, each as old as it
        became until the next; and those of what is published. `busy` is the processor that `live`,
        with the processes that it started, took for a second of flight, what it did late included.
    """
    vehicle, listens = load_vehicle(vehicle_name), free_address()
    core, *others = sorted(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "flight.parquet")
        write_flight(long_flight(vehicle, seconds).between(0.0, seconds), path)
        address = f"127.0.0.1:{_free_tcp_port()}"
        options = ("--serve", address, "--publish", f"udpout:{free_address()}", "--json")
        live = subprocess.Popen(
            [
                *(*_COMMAND, "live", "--vehicle", vehicle_name, "--listen", f"udpin:{listens}"),
                *(*options, "--until-silent", "3", "--alarms" if alarms else "--no-alarms"),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        stdout = live.stdout
        assert stdout is not None
        os.sched_setaffinity(live.pid, {core})
        os.sched_setaffinity(0, set(others) or {core})
        try:
            _wait_for(address)
            with browser(Path(folder)) as opened:
                opened.visit(f"http://{address}/", View(1300, dark=False))
                sender = subprocess.Popen([*_COMMAND, "replay", path, "--to", f"udpout:{listens}"])
                time.sleep(_SETTLED_S)
                opened.run("window.live.clearAges()")
                began_cpu = _processor_s(live)
                sender.wait()
                shown = np.array(opened.run("window.live.ages()"), dtype=np.float64)
                said = stdout.read()
            usage = os.wait4(live.pid, 0)[2]
        finally:
            os.sched_setaffinity(0, {core, *others})
            live.kill()
    status = json.loads(said)
    return {
        "seconds": seconds,
        "alarms_kept": alarms,
        "busy": (usage.ru_utime + usage.ru_stime - began_cpu) / (seconds - _SETTLED_S),
        "pictures": len(shown),
        "shown_p50_ms": float(np.percentile(shown[:, 1], 50)),
        "shown_p99_ms": float(np.percentile(shown[:, 1], 99)),
        "published_p99_ms": 1e3 * status["published_age_p99_s"],
        "lost": status["link"]["lost"],
        "late": status["link"]["late"],
    }


def _processor_s(process: "subprocess.Popen[str]") -> float:
    """What a process and those that it started have had so far."""
    own = psutil.Process(process.pid)
    times = [p.cpu_times() for p in (own, *own.children(recursive=True))]
    return float(sum(t.user + t.system for t in times))


def _free_tcp_port() -> int:
    with socket.socket() as any_port:
        any_port.bind(("127.0.0.1", 0))
        return int(any_port.getsockname()[1])


def _wait_for(address: str) -> None:
    host, _, port = address.partition(":")
    for _ in range(900):
        try:
            socket.create_connection((host, int(port)), timeout=1.0).close()
        except OSError:
            time.sleep(0.1)
        else:
            return
    raise TimeoutError(f"{address}: nobody serves a page")
