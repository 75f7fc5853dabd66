"""A 1 kHz Crazyflie log of Eschmann et al. (arXiv 2404.07837) becomes a flight table.

You will see the windows that are kept, and how far specific force lags the motor commands
(about 70 ms: the motor lag that the paper is about):
    python examples/crazyflie_motor_delay_to_flight_table.py log10.parquet thrust.parquet
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from twin.logs import Flight, write_flight

G_M_S2 = 9.80665
HALF_TURN = (1.0, -1.0, -1.0)  # forward-left-up -> forward-right-down
WINDOWS_S = {  # usable flight on the original clock; crashes and idling lie outside
    "log10": ((35, 65),),
    "log15": ((55, 90),),
    "log16": ((32, 38), (45, 49)),
}


def convert(raw: pd.DataFrame, name: str) -> Flight:
    """Columns of the log to a flight: FRD, SI; the rows of the usable windows."""
    keep = np.any([(raw.t >= a) & (raw.t < b) for a, b in WINDOWS_S[name]], axis=0)
    raw = raw[keep].reset_index(drop=True)
    table = pd.DataFrame({"time": raw.t - raw.t.iloc[0]})
    for i in range(1, 5):
        table[f"cmd_{i}"] = raw[f"motor_{i}"] / 65535
    for axis, sign in zip("xyz", HALF_TURN, strict=True):
        table[f"acc_{axis}"] = sign * raw[f"acc_{axis}_g"] * G_M_S2
        table[f"gyro_{axis}"] = sign * np.deg2rad(raw[f"gyro_{axis}_dps"])
    table["phase"] = "tour"
    kept = ", ".join(f"{a}-{b} s" for a, b in WINDOWS_S[name])
    return Flight(name, table, facts={"vehicle": "Crazyflie 2.x, 27 g", "kept windows": kept})


def lag_s(table: pd.DataFrame) -> float:
    """Delay of specific force behind the squared commands at their best correlation, s."""
    t_s = np.arange(0.0, table.time.iloc[-1], 0.001)
    thrust = np.interp(t_s, table.time, (table.filter(regex="cmd_") ** 2).sum(axis=1))
    force = np.interp(t_s, table.time, -table.acc_z)
    delays = np.arange(0, 200)  # ms
    fit = [np.corrcoef(thrust[: len(t_s) - d], force[d:])[0, 1] for d in delays]
    return float(delays[int(np.argmax(fit))]) / 1000


def main(source: Path, out: Path) -> None:
    """Convert one file and say what is in it."""
    flight = convert(pd.read_parquet(source).astype(np.float64), source.stem)
    write_flight(flight, out)
    print(f"{flight.name}: {len(flight.table)} samples, kept {flight.facts['kept windows']}")
    print(f"specific force follows the commands by {1000 * lag_s(flight.table):.0f} ms")


if __name__ == "__main__":
    print(__doc__) if len(sys.argv) != 3 else main(Path(sys.argv[1]), Path(sys.argv[2]))
