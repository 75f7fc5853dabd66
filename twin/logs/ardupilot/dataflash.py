"""ArduPilot DataFlash -> Flight."""

from pathlib import Path

import pandas as pd

from ..assemble import Rows, lay_out
from ..columns import motor_columns
from ..flight import Flight
from ..formats import ReadOptions
from ..phases import label_phases
from .airframe import from_ardupilot_airframe
from .arming import use_the_flight
from .autopilot import from_ardupilot_autopilot
from .estimator import primary
from .geometry import NO_MULTIROTOR, frame_name, geometry
from .identity import OTHERS, board, firmware, frame_of
from .log import ArduPilotLog, open_ardupilot
from .motion import add_motion
from .outputs import from_ardupilot_commands
from .phases import from_ardupilot_phases, modes, note_failures
from .rotors import add_rotors
from .signals import add, add_barometer, add_battery, add_compass, add_imu
from .site import fix, from_ardupilot_site
from .trim import yaw_trim


def read_dataflash(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read an ArduPilot DataFlash log, binary or text.

    Args:
        path: File name.
        blob: Content of the file.
        options: Of no concern: the commands are those that are logged.

    Raises:
        LogError: Nothing in it can be used.
    """
    log = open_ardupilot(path, blob)
    facts = _facts(log) | use_the_flight(log)
    rows = Rows()
    used = primary(log)
    facts |= add_imu(log, rows, used)
    add_compass(log, rows, used)
    add_barometer(log, rows, used)
    facts |= add_motion(log, rows, used)
    commands = from_ardupilot_commands(log)
    add_battery(log, rows, commands)
    facts |= add_rotors(log, rows, commands)
    if commands is not None:
        n = commands.cmd.shape[1]
        add(log, rows, "cmd", motor_columns("cmd", n), commands.t_us, commands.cmd)
        facts |= commands.facts
    note_failures(log)
    advice = "Log the default messages (LOG_BITMASK) and fly again."
    table, t_us = lay_out(log, path, rows, advice)
    phase = label_phases(table["time"].to_numpy(), from_ardupilot_phases(log, used))
    table["phase"] = pd.Series(phase, dtype=object)
    built = frame_of(log)
    rotors = geometry(built.kind, built.form)
    if rotors is not None and (trim := yaw_trim(table, rotors)):
        facts["yaw trim"] = str(trim)
    if told := modes(log):
        facts["modes"] = told
    if where := fix(log):
        facts["place"] = str(where)
    facts |= rows.coverage(t_us)
    site, frame = from_ardupilot_site(log), from_ardupilot_airframe(log)
    autopilot = from_ardupilot_autopilot(log, float(table["time"].iloc[-1]))
    return Flight(path.stem, table, tuple(log.findings), facts, path, site, frame, autopilot)


def _facts(log: ArduPilotLog) -> dict[str, str]:
    """What the log says about the vehicle."""
    told = firmware(log)
    facts = {"firmware": told or "ArduPilot"}
    if other := OTHERS.match(told):
        message = f"a log of {other.group()}: this is no multirotor, unless it is a quadplane"
        log.note("error" if log.params.get("Q_ENABLE", 0.0) < 1.0 else "info", "log", message)
    if hardware := board(log):
        facts["hardware"] = hardware
    frame = frame_of(log)
    if name := NO_MULTIROTOR.get(frame.kind):
        log.note("error", "log", f"FRAME_CLASS {frame.kind}, a {name}: this is no multirotor")
    if frame.kind:
        facts["airframe"] = frame_name(frame.kind, frame.form)
    return facts
