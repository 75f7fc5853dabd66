"""A rotor that loses thrust in flight, sent as MAVLink by one process and named by another."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.sudden_faults.built_in import Planted
from twin.logs import write_flight
from uavtwin.vehicles import Vehicle

LATEST_S = 3.0
"""After it began; the goal of the median."""
UAVTWIN = (sys.executable, "-c", "from uavtwin.cli.main import main; main()")
ADDRESS = "127.0.0.1:14781"


@pytest.mark.long
def test_a_rotor_that_gets_weak_is_named_within_seconds(tmp_path: Path) -> None:
    planted = Planted("rotor_failure", 0.3, 3)
    flight, begins_s, rotor = planted.flown()
    write_flight(flight, tmp_path / "flight.parquet")
    Vehicle.of(planted.vehicle).save(tmp_path / "vehicle.toml")
    listening = subprocess.Popen(
        [
            *(*UAVTWIN, "live", "--vehicle", tmp_path / "vehicle.toml", "--out", tmp_path / "r"),
            *("--listen", f"udpin:{ADDRESS}", "--until-silent", "5", "--json"),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert listening.stderr is not None
        assert "listening" in listening.stderr.readline()
        subprocess.run(
            [
                *(*UAVTWIN, "replay", tmp_path / "flight.parquet", "--to", f"udpout:{ADDRESS}"),
                *("--speed", "max"),
            ],
            check=True,
            capture_output=True,
            timeout=900,
        )
        out, _ = listening.communicate(timeout=900)
    finally:
        listening.kill()
    (alarm,) = json.loads(out)["alarms"]
    assert alarm["cause"] == "rotor_failure" and alarm["rotor"] == [rotor]
    assert begins_s < alarm["raised_s"] < begins_s + LATEST_S
    assert alarm["onset_s"] == pytest.approx(begins_s, abs=0.1)
    line, *_ = (tmp_path / "r" / "alarms.jsonl").read_text("utf-8").splitlines()
    assert json.loads(line)["cause"] == alarm["cause"]
