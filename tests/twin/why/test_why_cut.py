"""Cuts of all commands in the air, and what rotor speeds say of a loss of thrust."""

import numpy as np
import pandas as pd
import pytest
from why_rig import ONSET_S, G, Table, sound

from twin.logs import Flight
from twin.logs.autopilot import Autopilot, Message
from twin.logs.columns import ACC, POS
from twin.why.cut import cut
from twin.why.diagnose import diagnose
from twin.why.flight import FlightFrame
from twin.why.speeds import speed_of
from twin.why.timeline import timeline

COMMANDS = [f"cmd_{i}" for i in range(1, 5)]


def frame(table: Table) -> FlightFrame:
    return FlightFrame.of(Flight("f", pd.DataFrame(table)))


def dropped(seconds: float, *, falls: bool) -> Table:
    """Commands at zero for a while; the body falls, or carries its weight."""
    table = sound()
    t = table["time"]
    off = (t >= ONSET_S) & (t < ONSET_S + seconds)
    for name in COMMANDS:
        table[name] = np.where(off, 0.0, table[name])
    if falls:
        for axis in "xyz":
            table[f"acc_{axis}"] = np.where(off, 0.05, table[f"acc_{axis}"])
    return table


@pytest.mark.parametrize("seconds", [0.3, 0.8, 3.0])
def test_a_cut_is_named_with_its_instant_and_length(seconds: float) -> None:
    (event,) = cut(frame(dropped(seconds, falls=True))).events
    assert event.cause == "command_cut"
    assert event.onset_s == pytest.approx(ONSET_S, abs=0.02)
    assert event.severity is not None
    assert event.severity.low <= seconds <= event.severity.high


def test_motors_that_stop_on_the_ground_are_no_cut() -> None:
    assert not cut(frame(dropped(3.0, falls=False))).events
    assert not cut(frame(sound())).events


def raised_to(height_m: float, off_s: float) -> Table:
    """Level flight at a height after a take-off at 2 s; motors off from `off_s` on."""
    table = sound()
    t, zero = table["time"], np.zeros(len(table["time"]))
    height = height_m * np.clip((t - 2.0) / 2, 0, 1)
    table |= dict(zip(ACC, (zero, zero, zero - G), strict=True))
    table |= dict(zip(POS, (zero, zero, -height), strict=True))
    flies = (t > 2.0) & (t < off_s)
    return table | {name: np.where(flies, 0.5, 0.0) for name in COMMANDS}


def test_motors_that_stop_after_a_touch_down_are_no_cut() -> None:
    """It touches the ground, rebounds by 5 cm and lies still."""
    table, down_s, off_s = raised_to(1.0, 25.4), 25.0, 25.4
    t = table["time"]
    table["pos_z"] = -np.interp(t, (2, 4, 23, down_s), (0.0, 1.0, 1.0, 0.0))
    force = np.where((t >= down_s) & (t < down_s + 0.02), 25.0, G)
    force = np.where((t >= off_s) & (t < off_s + 0.12), 1.0, force)
    force = np.where((t >= off_s + 0.12) & (t < off_s + 0.14), 45.0, force)
    table["acc_z"] = -np.where((t >= off_s + 0.16) & (t < off_s + 0.28), 1.0, force)
    assert not cut(frame(table)).events


def test_the_height_rules_a_cut_out_where_the_fall_is_short() -> None:
    """Motors that stop 0.2 m above the place where it then stands."""
    table, off_s = raised_to(5.0, 26.0), 26.0
    t = table["time"]
    table["pos_z"] = -np.interp(t, (2, 4, 18, 25, 26, 26.2), (0.0, 5.0, 5.0, 0.2, 0.2, 0.0))
    table["acc_z"] = np.where((t >= off_s) & (t < off_s + 0.2), -0.05, table["acc_z"])
    assert not cut(frame(table)).events


def test_a_cut_lasts_until_the_aircraft_hits_the_ground() -> None:
    """From 12 m; the estimate of the height drifts away after the blow, commands stay at idle."""
    off_s, lasts_s = 25.0, 1.5
    table = raised_to(12.0, off_s)
    t = table["time"]
    fallen = np.clip(t - off_s, 0, lasts_s) ** 2 * G / 2
    table["pos_z"] = -12.0 * np.clip((t - 2.0) / 2, 0, 1) + fallen
    table["pos_z"] += np.clip(t - off_s - lasts_s, 0, None) * 8.0
    falls, hits = (t >= off_s) & (t < off_s + lasts_s), np.abs(t - off_s - lasts_s) < 0.03
    table["acc_z"] = np.where(hits, -90.0, np.where(falls, -1.0, table["acc_z"]))
    said = Message(off_s - 0.1, "info", "[commander] Landing detected")
    flight = Flight("f", pd.DataFrame(table), autopilot=Autopilot(messages=(said,)))
    found = diagnose(flight, finders=(cut, timeline))
    (event,) = found.events
    assert event.severity is not None
    assert event.severity.value == pytest.approx(lasts_s, abs=0.1)
    assert "land detector" in event.bench_check
    assert found.crash_s == pytest.approx(off_s + lasts_s, abs=0.1)
    assert not [i for i in found.timeline if i.kind == "landing"]
    assert [i.text for i in found.timeline if i.kind == "message"] == [f'"{said.text}"']


@pytest.mark.parametrize(("share", "tells"), [(1.0, "motor"), (0.0, "propeller")])
def test_the_speed_tells_motor_from_propeller(share: float, tells: str) -> None:
    """A rotor loses 40 % of its thrust: with its speed, or at the speed that was asked for."""
    table, rng = sound(), np.random.default_rng(2)
    t, lost = table["time"], 0.4
    for i, name in enumerate(COMMANDS):
        table[name] = 0.5 + 0.03 * np.sin(0.7 * t + i) + 0.002 * rng.standard_normal(len(t))
        speed = 900.0 * table[name] + 100.0 + rng.standard_normal(len(t))
        failed = (t >= ONSET_S) & (i == 2)
        table[f"rotor_{i + 1}"] = speed * np.where(failed, np.sqrt(1 - share * lost), 1.0)
    found = speed_of(frame(table), 3, ONSET_S, lost)
    assert found is not None and found.tells == tells
    assert found.lost == pytest.approx(share * (1 - np.sqrt(1 - lost)), abs=3 * found.sd)
    assert speed_of(frame(sound()), 3, ONSET_S, lost) is None
