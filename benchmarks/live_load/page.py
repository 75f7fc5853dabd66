"""The page of what was measured."""

from collections.abc import Callable
from typing import Any

Rows = dict[str, dict[str, Any]]
_BEHIND_S = 1.0
"""Chosen by what is normal: 0.25 s, and a block of residuals is computed each second."""


def page(rows: Rows) -> str:
    """Markdown of all results.

    Args:
        rows: By name of the measurement.
    """
    return f"""# What a live flight bears

Written by `python -m benchmarks.live_load --out OUT --page docs/results/live_load.md`, after the
same without `--page`. The machine has two cores, and other computations ran beside (the load
average before each run is in the tables): shares of processor are of `live` alone; what was
late may have been late for that. Measured on {_dates(rows)}.

## How old it is

From when a message of the aircraft came, by the kernel's stamp: to when a viewer's page, in a
Chromium on another core, showed what came after it; and to when the twin's own messages had left.
`live` has one core. Its share, and that of the processes that it started, is taken from when on
alarms have as much flight as they ever look at, 75 s after the start, with the page open and the
twin published. The goal is 35 %.

| alarms | share | pictures | shown, 50 % | shown, 99 % | published, 99 % | lost | late | load |
|---|---|---|---|---|---|---|---|---|
{_ages(rows)}

## Several aircraft in one process

Each with a 200 Hz IMU, in real time, over the loopback, with its twin and its residuals; with and
without alarms.

- *Wall*: in which 25 s of flight were sent; where that is more than a few seconds longer, the
  sender did not get the processor that it needed, and what is behind says little.
- *Per second*: processor per second of flight of one aircraft, from its twelfth second on: the
  start, equations that are built, is in the share of a core, and not in this.
- *Behind*: how much of the flight the slowest twin had not seen when the last message had been
  sent; rows wait 0.15 s for others (`--hold`) and 0.1 s for the next batch.

| aircraft | alarms | wall | share of a core | per second | lost | late | behind | load |
|---|---|---|---|---|---|---|---|---|
{_many(rows)}

All of a process's Python shares one core, CasADi's own loops do not: aircraft that need more than
that together fall behind, beside other computations sooner. What comes meanwhile waits in the
kernel and is not lost, up to 8 MB each. The goal, ten aircraft in one process with alarms, none
late, none behind by more than {_BEHIND_S:g} s: {_goal(rows.get("many_10_alarms"))}

## Memory over a long flight

{_growth(rows.get("growth"))}

## During a flood

`pytest tests/uavtwin/live/test_under_load.py`: 1 MB/s of random bytes, of another aircraft's
messages, of frames with a wrong checksum, beside an aircraft that is sent as fast as it is taken:
no message lost, no sample late, residuals the same to 1e-6. Taking a flood apart costs some 0.3 s
of processor per MB. An aircraft of MAVLink 1 is read from HIGHRES_IMU, ATTITUDE_QUATERNION,
LOCAL_POSITION_NED and SERVO_OUTPUT_RAW: ODOMETRY and ACTUATOR_OUTPUT_STATUS have numbers that
MAVLink 1 cannot tell.

## Ground stations of others

`pytest tests/uavtwin/live/test_ground_stations.py`, after `make ground-stations`. Tried: MAVSDK
4.1.0, which is a native library and has no server of its own any more, and MAVProxy 1.8.75, on
Linux. Both go online on the twin's system; MAVSDK's attitude, position and velocity, acceleration
and body rates are what was sent, in float32, 50 times a second; so is MAVProxy's telemetry log.
QGroundControl was not tried.
"""


def _dates(rows: Rows) -> str:
    """Days on which rows were measured: the law of the alarms changes."""
    return ", ".join(sorted({r["measured"] for r in rows.values()})) or "no day"


def _ages(rows: Rows) -> str:
    return _table(
        rows,
        "ages_",
        lambda r: (
            f"{_alarms(r)} | {100 * r['busy']:.0f} % | {r['pictures']} | "
            f"{r['shown_p50_ms']:.0f} ms | {r['shown_p99_ms']:.0f} ms | "
            f"{r['published_p99_ms']:.0f} ms | {r['lost']} | {r['late']}"
        ),
    )


def _many(rows: Rows) -> str:
    return _table(
        rows,
        "many_",
        lambda r: (
            f"{r['aircraft']} | {_alarms(r)} | {r['wall_s']:.0f} s | "
            f"{100 * r['cpu_share']:.0f} % | {_per_second(r)} | {r['lost']} | "
            f"{r['late']} | {r['most_behind_s']:.2f} s"
        ),
    )


def _table(rows: Rows, kind: str, cells: Callable[[dict[str, Any]], str]) -> str:
    """A line for each measurement of a kind, the load before it last."""
    found = [r for name, r in rows.items() if name.startswith(kind)]
    return "\n".join(f"| {cells(r)} | {r['load_before']:.1f} |" for r in found)


def _alarms(r: dict[str, Any]) -> str:
    return "yes" if r["alarms_kept"] else "no"


def _per_second(r: dict[str, Any]) -> str:
    found = r["cpu_per_second"]
    return "-" if found is None else f"{found:.3f} s"


def _goal(r: dict[str, Any] | None) -> str:
    if r is None:
        return "not measured."
    reached = not (r["lost"] or r["late"]) and r["most_behind_s"] < _BEHIND_S
    return "reached." if reached else "not reached. Start a process for each few."


def _growth(r: dict[str, Any] | None) -> str:
    if r is None:
        return "Not measured."
    least, most = r["rss_of_the_second_half_mib"]
    return (
        f"{r['flight_s'] / 60:.1f} minutes of flight, recorded, with alarms, sent {r['speed']:g} "
        f"times as fast as they were flown (in {r['wall_s'] / 60:.1f} minutes; load "
        f"{r['load_before']:.1f} before): {r['lost']} messages lost, {r['late']} samples late, the "
        f"twin {r['behind_s']:.1f} s of flight behind when the last had been sent, "
        f"{r['rows_recorded']} of {r['rows_sent']} rows recorded, {r['alarms']} alarms. "
        f"Resident memory {r['rss_after_a_minute_mib']:.1f} MiB after a minute of flight, "
        f"{r['rss_at_the_end_mib']:.1f} MiB at its end, between {r['rss_least_mib']:.1f} and "
        f"{r['rss_most_mib']:.1f} MiB in between; in the second half of it between "
        f"{least:.1f} and {most:.1f} MiB."
    )
