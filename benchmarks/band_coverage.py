"""Coverage of the bands of driven twins on recorded flights: each flight in turn is judged by an
FMU whose bands the others have taught.

    python -m benchmarks.band_coverage --vehicle explained.toml day_1.ulg day_2.ulg day_3.ulg

The flights must not have taught the vehicle file. Where too few are left for that, others teach
the bands, each by the twin of a vehicle file that was explained without it (jackknife+):

    python -m benchmarks.band_coverage --vehicle of_1_and_2.toml --by day_1.ulg=of_2.toml \\
        --by day_2.ulg=of_1.toml day_3.ulg

Counted are the times alone at which the FMU says `valid`. No number of `uavtwin.accuracy` may be
chosen by what this prints of a published set.

Source of the second: Barber, Candes, Ramdas & Tibshirani, Predictive inference with the
jackknife+, Annals of Statistics 49, 2021.
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from twin.errors import TwinError
from twin.flight.assembly import driven_twin
from twin.logs import AnyFlight
from twin.physics.accuracy import Bands, accuracy
from twin.physics.rotors import Drive
from twin.residuals.teacher_forced import choose_drive
from uavtwin.accuracy import EVERY_S, STARTS, Windows, bands_of, replayed
from uavtwin.exports.parts import OBSERVER, Twin
from uavtwin.exports.write import export
from uavtwin.flights import open_alike
from uavtwin.force.open_loop import HORIZONS_S, Replay
from uavtwin.vehicles import Vehicle, load_vehicle

_Seen = dict[str, list[Windows]]
"""Windows of flights by twin."""


def judged(
    flight: AnyFlight, vehicle: Vehicle, fmu: Path, bands: Bands, own: Windows, twin: str
) -> list[dict[str, object]]:
    """A row per output and time alone: how many windows are valid, and how many of them held."""
    watch = ("accuracy.valid", *(f"accuracy.error_95.{q}" for q in bands.bands))
    replay = Replay(flight, vehicle, every_s=EVERY_S)
    shown = replay.through(fmu, {OBSERVER: STARTS[twin]}, watch).watched
    rows: list[dict[str, object]] = []
    for i, quantity in enumerate(bands.bands):
        if quantity not in own.off:
            continue
        off, band = own.off[quantity], shown[..., 1 + i]
        for h, horizon_s in enumerate(HORIZONS_S):
            counts = (shown[:, h, 0] > 0.5) & np.isfinite(off[:, h])
            held = off[counts, h] <= band[counts, h]
            where = {"twin": twin, "flight": flight.name, "output": quantity, "alone_s": horizon_s}
            rows.append({**where, "place": i, "n": int(counts.sum()), "held": int(held.sum())})
    return rows


def replays(vehicle: Vehicle, flights: Sequence[AnyFlight], drive: Drive, folder: Path) -> _Seen:
    """What the twins of a vehicle are off in flights."""
    fmu = _fmu(vehicle, drive, folder / "seen.fmu", None)
    return {twin: [replayed(f, vehicle, fmu, twin) for f in flights] for twin in STARTS}


def _fmu(vehicle: Vehicle, drive: Drive, path: Path, known: Bands | None) -> Path:
    """The driven twin, which shows what it goes through, or its bands."""
    assembly = driven_twin(vehicle, drive, accuracy=accuracy(vehicle, known))
    export(Twin(vehicle.name, assembly), path)
    return path


def measure(
    vehicle: Vehicle,
    flights: Sequence[AnyFlight],
    folder: Path,
    by: Sequence[tuple[AnyFlight, Vehicle]] = (),
) -> pd.DataFrame:
    """Rows of `judged` of all flights and twins; a flight without bands has none.

    Args:
        vehicle: Whose twins.
        flights: To judge, each by bands of the others.
        folder: For FMUs.
        by: Flights that teach the bands of all instead, each with the vehicle of its twin.
    """
    drive = choose_drive(flights[0], vehicle)
    own = replays(vehicle, flights, drive, folder)
    taught = [replays(other, [flight], drive, folder) for flight, other in by]
    rows = []
    for twin in STARTS:
        for k, flight in enumerate(flights):
            others = [w for i, w in enumerate(own[twin]) if i != k]
            try:
                bands, _ = bands_of([t[twin][0] for t in taught] or others)
            except TwinError as error:
                print(f"{twin}, {flight.name}: no bands: {error}")
                continue
            fmu = _fmu(vehicle, drive, folder / "judged.fmu", bands)
            rows += judged(flight, vehicle, fmu, bands, own[twin][k], twin)
    return pd.DataFrame(rows)


def main() -> None:
    """Print the coverage by output, and by time alone and flight."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flights", type=Path, nargs="+")
    parser.add_argument("--vehicle", required=True)
    parser.add_argument("--by", action="append", default=[], metavar="FLIGHT=VEHICLE")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        teachers = [text.split("=", 1) for text in given.by]
        paths = [*given.flights, *(Path(log) for log, _ in teachers)]
        flights, n = open_alike(paths, None, False), len(given.flights)
        others = [load_vehicle(file) for _, file in teachers]
        taught = list(zip(flights[n:], others, strict=True))
        found = measure(load_vehicle(given.vehicle), flights[:n], Path(folder), taught)
    if found.empty:
        return
    for (twin, flight), n in found.groupby(["twin", "flight"], sort=False)["n"].sum().items():
        if not n:
            print(f"{twin}, {flight}: nowhere valid")
    found = found[found["n"] > 0]
    for by in ([], ["alone_s"], ["flight"]):
        table = found.groupby(["twin", "place", "output", *by], sort=False)[["held", "n"]].sum()
        print(table.assign(coverage=table["held"] / table["n"]).to_string(), "\n")


if __name__ == "__main__":
    main()
