"""Coverage of the bands of driven twins on recorded flights: each flight in turn is judged by an
FMU whose bands the others have taught.

    python -m benchmarks.band_coverage --vehicle explained.toml day_1.ulg day_2.ulg day_3.ulg

The flights must not have taught the vehicle file. Counted are the times alone at which the FMU says
`valid`. No number of `uavtwin.accuracy` may be chosen by what this prints of a published set.
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
from twin.residuals.teacher_forced import choose_drive
from uavtwin.accuracy import EVERY_S, STARTS, Windows, bands_of, replayed
from uavtwin.exports.parts import OBSERVER, Twin
from uavtwin.exports.write import export
from uavtwin.flights import open_alike
from uavtwin.force.open_loop import HORIZONS_S, Replay
from uavtwin.vehicles import Vehicle, load_vehicle


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


def measure(vehicle: Vehicle, flights: Sequence[AnyFlight], folder: Path) -> pd.DataFrame:
    """Rows of `judged` of all flights and twins; a flight without bands has none."""
    drive = choose_drive(flights[0], vehicle)

    def fmu(name: str, known: Bands | None) -> Path:
        """The driven twin, which shows what it goes through, or its bands."""
        assembly = driven_twin(vehicle, drive, accuracy=accuracy(vehicle, known))
        export(Twin(vehicle.name, assembly), folder / f"{name}.fmu")
        return folder / f"{name}.fmu"

    seen, rows = fmu("seen", None), []
    for twin in STARTS:
        windows = [replayed(f, vehicle, seen, twin) for f in flights]
        for k, flight in enumerate(flights):
            try:
                bands, _ = bands_of([w for i, w in enumerate(windows) if i != k])
            except TwinError as error:
                print(f"{twin}, {flight.name}: no bands: {error}")
                continue
            rows += judged(flight, vehicle, fmu("judged", bands), bands, windows[k], twin)
    return pd.DataFrame(rows)


def main() -> None:
    """Print the coverage by output, and by time alone and flight."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flights", type=Path, nargs="+")
    parser.add_argument("--vehicle", required=True)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        flights = open_alike(given.flights, None, False)
        found = measure(load_vehicle(given.vehicle), flights, Path(folder))
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
