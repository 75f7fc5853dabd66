"""A fleet of made flights, and the real logs: `python -m benchmarks.fleet --flights 200 --out OUT`.

Flies what is not there yet, adds logs that are damaged and one that is there twice, looks at all of
them with `uavtwin fleet`, which is killed some times on the way, and says what was found of what is
planted, and what a log costs. `--data`: recorded flights are looked at as well, each aircraft
against its own vehicle file.
"""

import argparse
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from uavtwin.fleets.dataset import JOURNAL
from uavtwin.fleets.fleet import found_logs
from uavtwin.fleets.log_analysis import aircraft_name, file_stem
from uavtwin.flights import open_alike
from uavtwin.vehicles import Vehicle

from ..real_flights.scenarios import SCENARIOS
from ..watched import children_s, watched
from .flights import PLANTED, VEHICLE, write_fleet


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
    begun = children_s()
    made = write_fleet(
        logs, given.flights, given.aircraft, seconds=given.seconds, workers=given.workers
    )
    flying_s = children_s() - begun
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
    return watched(["fleet", *arguments], out, out / JOURNAL, kills, (2, 20))


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
