"""A Crazyflie flight of NanoBench (arXiv 2603.09908) becomes a flight table, with phases.
You will see specific force against gravity (-9.81) as a check of the axes:
    python examples/nanobench_to_flight_table.py B2_circle_slow_rep2.parquet circle.parquet
Vicon has z up and the body is forward-left-up; Vicon's x is called north, so both change by half
a turn about x. The clocks of IMU and Vicon stay as recorded: apart by -76 to 14 ms, changing.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from twin.logs import Flight, write_flight
from twin.logs.autopilot import Autopilot, setpoint_of

G_M_S2 = 9.80665
HALF_TURN = (1.0, -1.0, -1.0)  # forward-left-up -> forward-right-down


def phases(t_s: np.ndarray, height_m: np.ndarray, climb_m_s: np.ndarray) -> np.ndarray:
    """Phase of each sample: a climb until it first levels off, a tour, the last descent."""
    off, touch = t_s[np.flatnonzero(height_m > 0.05)[[0, -1]]]
    level = t_s[(t_s > off) & (height_m > 0.3) & (climb_m_s < 0.1)][0]
    down = t_s[height_m > 0.9 * np.interp(touch - 5.0, t_s, height_m)][-1]
    spans = [(t_s < off) | (t_s > touch), t_s < level, t_s < down]
    return np.select(spans, ["ground", "takeoff", "tour"], "land")


def convert(raw: pd.DataFrame, name: str) -> Flight:
    """NanoBench columns to a flight: NED, FRD, SI, `[w, x, y, z]`."""
    table = pd.DataFrame({"time": raw.t - raw.t.iloc[0], "q_w": raw.qw, "vbat_v": raw.vbat})
    for i in range(1, 5):  # after battery compensation: the duty cycle the motor gets
        table[f"cmd_{i}"] = raw[f"pwm_{i}"] / 65535
    for axis, sign in zip("xyz", HALF_TURN, strict=True):
        table[f"acc_{axis}"] = sign * raw[f"acc_{axis}_g"] * G_M_S2
        table[f"gyro_{axis}"] = sign * raw[f"gyro_{axis}"]  # rad/s in the file
        for ours, theirs in (("pos", "p"), ("vel", "v"), ("q", "q")):
            table[f"{ours}_{axis}"] = sign * raw[f"{theirs}{axis}"]
    quat = ["q_w", "q_x", "q_y", "q_z"]  # five decimals in the file, so to unit norm again
    table[quat] /= np.linalg.norm(table[quat], axis=1)[:, None]
    state = (table.time, raw.pz - raw.pz.iloc[:50].median(), raw.vz)
    table["phase"] = phases(*(x.to_numpy() for x in state))
    places = raw[["sp_x", "sp_y", "sp_z"]].to_numpy() * HALF_TURN
    setpoint = setpoint_of(("pos_x", "pos_y", "pos_z"), table.time.to_numpy(), places)
    mission = Autopilot(setpoints=(setpoint,) if setpoint else ())
    return Flight(name, table, facts={"vehicle": "NanoBench CF_01"}, autopilot=mission)


def main(source: Path, out: Path) -> None:
    """Convert one file and say what is in it."""
    flight = convert(pd.read_parquet(source).astype(np.float64), source.stem)
    write_flight(flight, out)
    for phase, rows in flight.table.groupby("phase", sort=False):
        print(f"{phase:8} {len(rows):5} samples, specific force z {rows.acc_z.mean():7.3f} m/s2")


if __name__ == "__main__":
    print(__doc__) if len(sys.argv) != 3 else main(Path(sys.argv[1]), Path(sys.argv[2]))
