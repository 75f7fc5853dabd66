"""A fleet of made flights, and the real logs: `python -m benchmarks.fleet --flights 200 --out OUT`.

Flies what is not there yet, adds logs that are damaged and one that is there twice, looks at all of
them with `uavtwin fleet`, which is killed some times on the way, and says what was found of what is
planted, and what a log costs. `--data`: recorded flights are looked at as well, each aircraft
against its own vehicle file.
"""

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from uavtwin.fleets.aircraft import aircraft_name, file_stem
from uavtwin.fleets.dataset import JOURNAL
from uavtwin.fleets.logs import found_logs
from uavtwin.flights import open_alike
from uavtwin.vehicles import Vehicle

from ..real_flights.scenarios import SCENARIOS
from .flights import PLANTED, VEHICLE, write_fleet

COMMAND = (sys.executable, "-c", "from uavtwin.cli.main import main; main()", "fleet")


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of flights and results")
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--aircraft", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=18.0, help="of a flight, about")
    parser.add_argument("--verbs", default="check,gap,explain")
    parser.add_argument("--each", default="flight", choices=("flight", "aircraft"))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--kills", type=int, default=3)
    parser.add_argument("--data", type=Path, help="recorded flights")
    given = parser.parse_args()
    logs = given.out / "logs"
    begun = time.process_time()
    made = write_fleet(logs, given.flights, given.aircraft, seconds=given.seconds)
    flying_s = time.process_time() - begun
    spoil(logs, made)
    options = ["--verbs", given.verbs, "--each", given.each, "--workers", str(given.workers)]
    out = given.out / "fleet"
    shutil.rmtree(out, ignore_errors=True)
    cost = looked([str(logs), "--vehicle", VEHICLE, "--out", str(out), *options], out, given.kills)
    found = {"flying_cpu_s": flying_s, **cost, **scored(out, len(found_logs([logs])))}
    if given.data:
        found["real"] = real(given.data, given.out, options)
    (given.out / "benchmark.json").write_text(json.dumps(found, indent=2), "utf-8")
    print(json.dumps(found, indent=2))
    return 0


def spoil(folder: Path, made: Sequence[Path]) -> None:
    """Logs that are cut off, empty, no log at all, and there twice."""
    bad = folder / "bad"
    bad.mkdir(exist_ok=True)
    whole = made[0].read_bytes()
    (bad / "cut.parquet").write_bytes(whole[: len(whole) // 2])
    (bad / "empty.ulg").write_bytes(b"")
    (bad / "text.csv").write_text("what,is,this\n1,2,3\n", "utf-8")
    (bad / "twice.parquet").write_bytes(made[1].read_bytes())


def looked(arguments: Sequence[str], out: Path, kills: int) -> dict[str, Any]:
    """What the command costs, killed some times at random moments."""
    rng, killed, peak = random.Random(1), 0, 0
    begun, before = time.monotonic(), _children_s()
    while True:
        lines = _lines(out / JOURNAL)
        wanted = lines + rng.randint(2, 20) if killed < kills else None
        process = subprocess.Popen(
            [*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        while process.poll() is None:
            peak = max(peak, _peak_bytes(process.pid))
            if wanted is not None and _lines(out / JOURNAL) >= wanted:
                os.kill(process.pid, signal.SIGKILL)
                killed += 1
                break
            time.sleep(0.05)
        code = process.wait()
        if code >= 0:
            break
    return {
        "exit_code": code,
        "killed": killed,
        "wall_s": time.monotonic() - begun,
        "cpu_s_without_what_was_killed": _children_s() - before,
        "parent_peak_mib": peak / 2**20,
        "dataset_bytes": {p.name: p.stat().st_size for p in sorted(out.glob("*.*"))},
    }


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _lines(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


def _peak_bytes(pid: int) -> int:
    """Largest memory that a process has had, of Linux."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0
    held = [line.split()[1] for line in text.splitlines() if line.startswith("VmHWM")]
    return 1024 * int(held[0]) if held else 0


def scored(out: Path, logs: int) -> dict[str, Any]:
    """Of what is planted, what is told; and what else is."""
    flights = pd.read_parquet(out / "flights.parquet")
    told = json.loads((out / "fleet.json").read_text("utf-8"))
    every = {
        (kind, row["aircraft"].partition(",")[0], row["number"])
        for kind in ("differences", "drifts")
        for row in told[kind]
    }
    planted = {name: (kind, name, number) for name, (kind, number) in PLANTED.items()}
    others = [e for e in every if e[1] not in PLANTED]
    return {
        "logs": logs,
        "rows": len(flights),
        "rows_once": bool(flights["log"].is_unique),
        "statuses": told["statuses"],
        "found": {name: wanted in every for name, wanted in planted.items()},
        "told": len(every),
        "told_of_aircraft_without_a_plant": sorted(map(list, others)),
        "tests": told["tests"],
    }


def real(data: Path, folder: Path, options: Sequence[str]) -> dict[str, Any]:
    """The recorded flights, each aircraft against the vehicle of its scenario."""
    own, out = folder / "real_vehicles", folder / "real"
    own.mkdir(exist_ok=True)
    for scenario in (s for s in SCENARIOS if s.change is None):
        vehicle = scenario.read_vehicle()
        for file in scenario.flights:
            path = data / file
            if path.suffix.lower() not in (".ulg", ".bin") or not path.is_file():
                continue
            (flight,) = open_alike([path])
            stem = file_stem(aircraft_name(flight))
            Vehicle.of(vehicle).save(own / f"{stem}.toml")
    shutil.rmtree(out, ignore_errors=True)
    cost = looked([str(data), "--per-aircraft", str(own), "--out", str(out), *options], out, 0)
    told = json.loads((out / "fleet.json").read_text("utf-8"))
    kept = ("logs", "statuses", "aircraft", "cannot", "differences", "drifts")
    return cost | {k: told[k] for k in kept}


if __name__ == "__main__":
    raise SystemExit(main())
