"""A flight as an aircraft would send it: MAVLink messages and when."""

from collections.abc import Iterator

import numpy as np

from twin.errors import LogError
from twin.logs import Flight
from twin.logs.columns import MAX_MOTORS, POS, QUAT, VEL
from twin.logs.mavlink.encode import attitude, heartbeat, landed, local_position, messages_of
from twin.logs.mavlink.frames import Message

BOOT_US = 10_000_000
"""Time on the aircraft's clock at time 0 of the flight, us."""
_SCREEN_US = 100_000
"""Between two messages for the screens of ground stations."""
_BEAT_US = 1_000_000


def motors_of(flight: Flight) -> int:
    """How many motors a flight tells of, 0: of none."""
    stems = ("cmd", "rotor")
    return max(
        (i for i in range(1, MAX_MOTORS + 1) for s in stems if flight.has(f"{s}_{i}")), default=0
    )


def played(flight: Flight) -> Iterator[tuple[int, list[Message]]]:
    """Messages in order of time, each batch with its time on the aircraft's clock, us.

    Raises:
        LogError: The flight begins before time 0.
    """
    table, motors = flight.table, motors_of(flight)
    names = [str(c) for c in table if c not in ("time", "phase")]
    t_us = BOOT_US + np.round(1e6 * flight.time_s).astype(np.int64)
    if t_us[0] < 0:
        raise LogError(f"{flight.name}: begins at {flight.time_s[0]:g} s; a boot is at -10 s.")
    values = table[names].to_numpy(dtype=np.float64)
    codes, phases = flight.phase_codes
    known = np.isfinite(values)
    beat_us = screen_us = landed_us = -_BEAT_US
    sent_code = -1
    pose: dict[str, float] = {}
    for k, t in enumerate(t_us.tolist()):
        row = {names[i]: float(values[k, i]) for i in np.flatnonzero(known[k])}
        found: list[Message] = []
        if t - beat_us >= _BEAT_US:
            found.append(heartbeat(motors or None))
            beat_us = t
        found += messages_of(t, row, motors)
        if any(phases) and (codes[k] != sent_code or t - landed_us >= _BEAT_US):
            found.append(landed(str(phases[codes[k]])))
            sent_code, landed_us = int(codes[k]), t
        pose |= {c: row[c] for c in (*POS, *VEL, *QUAT) if c in row}
        if t - screen_us >= _SCREEN_US and (screen := _screen(t, pose)):
            found += screen
            screen_us = t
        if found:
            yield t, found


def _screen(t_us: int, pose: dict[str, float]) -> list[Message]:
    """What a ground station shows: the last known pose."""
    found = []
    if set(QUAT) <= set(pose):
        found.append(attitude(t_us, [pose[c] for c in QUAT], (0.0, 0.0, 0.0)))
    if {*POS, *VEL} <= set(pose):
        found.append(local_position(t_us, [pose[c] for c in POS], [pose[c] for c in VEL]))
    return found
