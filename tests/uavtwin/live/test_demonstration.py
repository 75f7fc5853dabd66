"""`uavtwin live --demo`: one command from nothing to a named alarm."""

import json
import re
import socket
import subprocess
import sys
import threading
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pandas as pd
import pytest
from cli_rig import run

from twin.logs import Flight
from twin.logs.table import write_flight
from twin.vehicle_file import load_vehicle
from uavtwin.demo.in_flight import BEGINS_S, LOSS, ROTOR, damaged_flight, sent_meanwhile, waypoints
from uavtwin.serve.store import Store
from uavtwin.sockets import Address


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as any_port:
        any_port.bind(("127.0.0.1", 0))
        return int(any_port.getsockname()[1])


@pytest.mark.slow
def test_a_newcomer_sees_an_alarm_three_seconds_after_the_damage(tmp_path: Path) -> None:
    """Sent over the loopback, heard, shown on the page, named; ended by the command itself, and
    the recording joins the flights of the site."""
    page = free_port(socket.SOCK_STREAM)
    demo = subprocess.Popen(
        [
            *(sys.executable, "-c", "from uavtwin.cli.main import main; main()", "live", "--demo"),
            *("--listen", f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}"),
            *("--serve", f"127.0.0.1:{page}", "--duration", str(BEGINS_S + 20), "--json"),
            *("--store", str(tmp_path / "store"), "--out", str(tmp_path / "flown")),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert demo.stderr is not None
        for line in demo.stderr:
            if line.startswith("ALARM"):
                break
        for path, title in (("", b"<title>Flights"), ("live", b"<title>Live")):
            with urlopen(f"http://127.0.0.1:{page}/{path}", timeout=60) as answer:
                assert title in answer.read()
        out, err = demo.communicate(timeout=300)
    finally:
        demo.kill()
    assert demo.returncode == 0
    assert [f.name for f in Store(tmp_path / "store").flights()[0]] == ["flown_flight.parquet"]
    lost = re.search(rf"Rotor {ROTOR} loses ([0-9.]+) % of its thrust", line)
    assert lost is not None and float(lost[1]) == pytest.approx(100 * LOSS, abs=5.0), line
    status = json.loads(out)
    (alarm,) = status["alarms"]
    assert alarm["onset_s"] == pytest.approx(BEGINS_S, abs=0.1)
    assert BEGINS_S < alarm["raised_s"] < BEGINS_S + 3
    assert status["link"]["lost"] == 0 and not status["missing"]
    assert f"in this flight rotor {ROTOR} lost 20 % of its thrust at 20 s" in err


@pytest.mark.slow
def test_a_log_is_replayed_by_the_same_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No second program has to send it; `live` ends when the log has ended."""
    log = tmp_path / "flight.parquet"
    flight = damaged_flight(load_vehicle("crazyflie"), 60.0, 0.0, 4.0)
    write_flight(flight, log)
    listen = f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    given = ("live", "--vehicle", "crazyflie", "--replay", log, "--listen", listen)
    code, out, err = run(capsys, *given, "--json")
    assert code == 0, err
    status = json.loads(out)
    assert status["flight_s"] == pytest.approx(flight.time_s[-1] - flight.time_s[0], abs=0.1)
    assert status["alarms"] == []
    code, _, err = run(capsys, *given, "--demo")
    assert code == 2
    assert "Choose one" in err


@pytest.mark.slow
def test_before_it_begins_the_rotor_is_whole() -> None:
    """The same flight up to then, whatever begins; and from then on that rotor works harder."""
    vehicle = load_vehicle("crazyflie")
    whole, damaged = (damaged_flight(vehicle, 12.0, loss, 16.0) for loss in (0.0, 0.1))
    drives = [c for c in whole.table if c.startswith(("cmd_", "rotor_"))]
    before = whole.table["time"] < 12.0
    np.testing.assert_array_equal(whole.table[drives][before], damaged.table[drives][before])
    late = whole.table["time"] > 13.0
    more = damaged.table[drives][late].mean() / whole.table[drives][late].mean()
    assert more.iloc[ROTOR - 1] == max(more) > 1.02


def test_small_aircraft_fly_small_squares() -> None:
    far = {
        name: max(abs(x) for _, _, (x, _, _) in waypoints(load_vehicle(name)))
        for name in ("crazyflie", "copter_default")
    }
    assert far == {"crazyflie": 1.5, "copter_default": 5.0}


def test_the_aircraft_of_a_demonstration_ends_at_once() -> None:
    """Whoever listened has gone; the sender's thread is over before the block is."""
    table = level_flight()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(60.0)
        with sent_meanwhile(table, Address("127.0.0.1", listener.getsockname()[1])):
            assert listener.recv(1000)
            assert "demo aircraft" in {t.name for t in threading.enumerate()}
        assert "demo aircraft" not in {t.name for t in threading.enumerate()}


def level_flight() -> Flight:
    """Ten minutes in which nothing is told but the attitude."""
    t = np.arange(0.0, 600.0, 0.1)
    level = {"q_w": 1.0, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0}
    return Flight("level", pd.DataFrame({"time": t, **level}))


def test_a_live_flight_wants_a_vehicle(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("UAVTWIN_VEHICLE", raising=False)
    code, _, err = run(capsys, "live")
    assert code == 2 and "or --demo" in err
