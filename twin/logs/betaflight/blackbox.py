"""Betaflight Blackbox log -> Flight."""

from pathlib import Path

import pandas as pd

from ..airframe import Airframe, Place, Told
from ..assemble import Rows, lay_out
from ..columns import MIN_MOTORS
from ..flight import Flight
from ..formats import ReadOptions
from .log import BlackboxLog, open_blackbox
from .motors import Motors, add_motors, layout_of
from .satellites import add_satellites, site_of
from .signals import accel_cutoff_hz, add_signals, gyro_field
from .told import filters_of, from_betaflight

_ADVICE = "Enable the fields GYRO, ACC and MOTOR of Blackbox (blackbox_disable_*) and fly again."
_SHOWN = 60


def read_blackbox(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a Blackbox log of Betaflight; of several flights in a file the longest.

    Args:
        path: File name.
        blob: Content of the file.
        options: Of no concern: the commands are those that are logged.

    Raises:
        LogError: Nothing in it can be used.
    """
    log, which = open_blackbox(path, blob)
    facts = {"firmware": log.firmware[:_SHOWN] or "Betaflight", **_facts(log)}
    if which:
        facts["flight in the file"] = which
    rows = Rows()
    facts |= add_signals(log, rows)
    motors = add_motors(log, rows)
    origin = add_satellites(log, rows)
    table, t_us = lay_out(log, path, rows, _ADVICE)
    table["phase"] = pd.Series("", index=table.index, dtype=object)
    airframe, more = _airframe(log, motors, origin)
    facts |= more | rows.coverage(t_us)
    autopilot = from_betaflight(log, float(table["time"].iloc[-1]))
    if autopilot.modes:
        facts["modes"] = ", ".join(f"{m.name} from {m.start_s:.1f} s" for m in autopilot.modes[:8])
    site = site_of(origin)
    return Flight(path.stem, table, tuple(log.findings), facts, path, site, airframe, autopilot)


def _facts(log: BlackboxLog) -> dict[str, str]:
    named = {
        "hardware": "Board information",
        "vehicle": "Craft name",
        "begun": "Log start datetime",
    }
    said = {fact: log.header.settings.get(name, "")[:_SHOWN] for fact, name in named.items()}
    return {fact: text for fact, text in said.items() if text and not text.startswith("0000")}


def _airframe(
    log: BlackboxLog, motors: Motors, origin: Told[Place] | None
) -> tuple[Airframe, dict[str, str]]:
    """What the log says of the aircraft, and facts on the mixer."""
    layout, facts = layout_of(log, motors)
    cutoff_hz, pulse = accel_cutoff_hz(log), motors.pulse_us
    on_gyro = [f for f in filters_of(log) if f.sensor == "gyro"]
    words = ", ".join(f"{f.kind} {f.frequency_hz:g} Hz ({f.source})" for f in on_gyro)
    low = [f for f in on_gyro if f.kind == "low-pass"]
    filtered = gyro_field(log) == "gyroADC"
    airframe = Airframe(
        rotors=Told(motors.count, "motor outputs of the log")
        if motors.count >= MIN_MOTORS
        else None,
        layout=layout,
        pulse_us=Told(pulse, "mincommand and maxthrottle of the log") if pulse else None,
        accel_cutoff_hz=Told(cutoff_hz, "acc_lpf_hz of the log") if cutoff_hz >= 1.0 else None,
        gyro_cutoff_hz=Told(low[0].frequency_hz, f"{low[0].source} of the log")
        if filtered and low
        else None,
        place=origin,
        origin=origin,
        filters="" if filtered else words,
    )
    return airframe, facts
