"""A flight as MCAP: pose with Foxglove's schemas, every column of the flight table to plot.

Times are those of the table, from the start of the record: flights keep no clock of GNSS.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.logs import Finding, Flight
from twin.logs.airframe import origin_of
from twin.logs.columns import ACC, ACC_NED, COLUMNS, GYRO, MAG, POS, QUAT, VEL, motor_number

from .foxglove import (
    FOXGLOVE,
    LOCATION,
    LOG,
    LONGEST_STEP_S,
    LocationTopics,
    PoseTopics,
    log_message,
)
from .mcap_file import McapFile, PlotTopics, check_times, mcap_file
from .table import nanoseconds

Array = NDArray[np.float64]
TOPICS: Mapping[str, tuple[str, ...]] = {
    "/imu": (*ACC, *GYRO),
    "/magnetometer": MAG,
    "/barometer": ("baro_pa",),
    "/position": POS,
    "/velocity": VEL,
    "/attitude": QUAT,
    "/acceleration": ACC_NED,
    "/motors": ("cmd_{i}", "rotor_{i}"),
    "/battery": ("vbat_v", "ibat_a"),
}
"""Columns of the flight table by topic; fields of the messages are called as the columns."""
_BLOCK_ROWS = 1 << 12


def write_flight_mcap(flight: Flight, path: Path) -> None:
    """Write a flight; the same flight gives the same bytes.

    Facts of the log go into a record of metadata, phases and findings into `/log`.

    Args:
        flight: Its table.
        path: An existing one is replaced.

    Raises:
        TwinError: The package `mcap` is not installed, or a time is negative.
    """
    t_ns = nanoseconds(flight.time_s)
    check_times(flight.name, int(t_ns[0]))
    topics = plot_topics([c for c in flight.columns if flight.has(c)])
    columns = {c: flight.columns[c] for fields in topics.values() for c in fields}
    position = flight.signal(POS) if flight.has(*POS, *QUAT) else None
    codes, phases = flight.phase_codes
    told = ""
    with mcap_file(path) as file:
        plots = PlotTopics(file, topics)
        file.topic(LOG, FOXGLOVE[LOG])
        pose = None if position is None else PoseTopics(file)
        placed = {LOCATION: POS} if flight.has(*POS) else {}
        places = LocationTopics(file, origin_of(flight.airframe), placed)
        file.note("flight", {"name": flight.name, **flight.facts})
        file.note("units", {c: unit for f in topics.values() for c, (_, unit) in f.items()})
        _write_findings(file, int(t_ns[0]), flight.name, flight.findings)
        if pose is not None:
            pose.begin(int(t_ns[0]))
        for start in range(0, len(t_ns), _BLOCK_ROWS):
            rows = slice(start, start + _BLOCK_ROWS)
            block = {c: v[rows] for c, v in columns.items()}
            poses = {} if position is None else _poses(flight.time_s[rows], block, *position)
            of_rows = places.rows(block, len(t_ns[rows]))
            each = zip(t_ns[rows].tolist(), phases[codes[rows]], plots.rows(block), strict=True)
            for row, (t, phase, messages) in enumerate(each):
                places.write(t, of_rows[row])
                if phase != told:
                    text = f"phase: {phase or 'unknown'}"
                    file.write(LOG, t, log_message(t, "info", text, flight.name))
                    told = phase
                if pose is not None and row in poses:
                    pose.write(t, *poses[row])
                for topic, message in messages:
                    file.write(topic, t, message)


def plot_topics(columns: list[str]) -> dict[str, dict[str, tuple[str, str]]]:
    """Topics of those columns that a flight has: by column, its field and its unit."""
    units = {c.name: c.unit for c in COLUMNS}
    found: dict[str, dict[str, tuple[str, str]]] = {}
    for topic, names in TOPICS.items():
        for name in names:
            for column in columns:
                stem = column if motor_number(column) is None else column.split("_")[0] + "_{i}"
                if stem == name:
                    found.setdefault(topic, {})[column] = column, units[name]
    return found


def _poses(
    t_s: Array, block: Mapping[str, Array], pos_t_s: Array, positions: Array
) -> dict[int, tuple[list[float], list[float]]]:
    """Position and attitude by row, where there is a sample of the attitude; the position there is
    on a straight line between its samples."""
    q = np.column_stack([block[c] for c in QUAT])  # (n, 4)
    after = np.searchsorted(pos_t_s, t_s, side="left").clip(0, len(pos_t_s) - 1)
    before = np.where(pos_t_s[after] == t_s, after, np.maximum(after - 1, 0))
    near = (pos_t_s[after] >= t_s) & (pos_t_s[before] <= t_s)
    near &= pos_t_s[after] - pos_t_s[before] <= LONGEST_STEP_S
    there = np.column_stack([np.interp(t_s, pos_t_s, p) for p in positions.T])  # (n, 3)
    rows = np.flatnonzero(near & np.isfinite(q).all(axis=1))
    return {int(k): (there[k].tolist(), q[k].tolist()) for k in rows}


def _write_findings(file: McapFile, t_ns: int, name: str, findings: tuple[Finding, ...]) -> None:
    """What the reader counted or doubts, at the first instant."""
    for f in findings:
        count = f" ({f.count})" if f.count > 1 else ""
        text = f"{f.where}: {f.message}{count}"
        file.write(LOG, t_ns, log_message(t_ns, f.severity, text, name))
