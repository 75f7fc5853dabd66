"""Cuts of all commands in the air, and what rotor speeds say of a loss of thrust."""

import numpy as np
import pandas as pd
import pytest
from why_rig import ONSET_S, Table, sound

from twin.logs import Flight
from twin.why.cut import cut
from twin.why.flight import FlightFrame
from twin.why.speeds import speed_of

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
