"""What happened besides, on one time axis."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from twin.logs import Flight
from twin.logs.autopilot import Autopilot, Interval, Message, Mode
from twin.logs.columns import ACC, POS, QUAT
from twin.why.diagnose import diagnose
from twin.why.flight import FlightFrame
from twin.why.records import TimelineItem
from twin.why.timeline import timeline


def flown(lands: bool = True) -> Flight:
    """From the ground to 10 m and, by choice, back."""
    t = np.arange(0.0, 40.0, 0.02)
    height = 10.0 * np.clip((t - 4) / 4, 0, 1)
    if lands:
        height = np.minimum(height, 10.0 * np.clip((34 - t) / 4, 0, 1))
    flies = (t > 4) & ((t < 35) if lands else True)
    table = {"time": t} | {f"cmd_{i}": np.where(flies, 0.5, 0.0) for i in range(1, 5)}
    table |= {POS[0]: 0 * t, POS[1]: 0 * t, POS[2]: -height, "vbat_v": np.full(len(t), 16.0)}
    table |= dict(zip(ACC, np.tile([0.1, 0.0, -9.81], (len(t), 1)).T, strict=True))
    table |= dict(zip(QUAT, np.tile([1.0, 0, 0, 0], (len(t), 1)).T, strict=True))
    return Flight("flown", pd.DataFrame(table))


def items(flight: Flight) -> list[TimelineItem]:
    return list(timeline(FlightFrame.of(flight)).timeline)


def of_kind(flight: Flight, kind: str) -> list[TimelineItem]:
    return [i for i in items(flight) if i.kind == kind]


def test_takeoff_and_landing() -> None:
    (up,), (down,) = (of_kind(flown(), k) for k in ("takeoff", "landing"))
    assert up.t_s == pytest.approx(4.6, abs=0.5)
    assert down.t_s == pytest.approx(33.4, abs=0.5)


def test_a_record_that_ends_in_the_air_says_so_and_a_brown_out_needs_the_voltage() -> None:
    flight = flown(lands=False)
    assert "ends in the air" in items(flight)[-1].text
    assert "brown-out" not in items(flight)[-1].text
    table = flight.table.copy()
    table.loc[table.time > 39.8, "vbat_v"] = 6.0
    assert "6 V, a brown-out" in items(replace(flight, table=table))[-1].text


def test_a_motor_at_its_stop_is_told_once_with_begin_and_end() -> None:
    flight = flown()
    table = flight.table.copy()
    at_stop = (table.time > 20) & (table.time < 21) | (table.time > 21.2) & (table.time < 22)
    table.loc[at_stop, "cmd_3"] = 1.0
    table.loc[(table.time > 25) & (table.time < 25.1), "cmd_2"] = 1.0  # a kick
    (item,) = of_kind(replace(flight, table=table), "actuator_limit")
    assert item.text == "motor 3 at its upper stop"
    assert (item.t_s, item.end_s) == pytest.approx((20.0, 22.0), abs=0.05)


def test_a_shock_is_told_and_thrust_is_none() -> None:
    flight = flown()
    table = flight.table.copy()
    table.loc[(table.time > 18) & (table.time < 18.1), "acc_x"] = 80.0
    punch = (table.time > 26) & (table.time < 28)
    table.loc[punch, [f"cmd_{i}" for i in range(1, 5)]] = 1.0
    table.loc[punch, "acc_z"] = -32.0
    (item,) = of_kind(replace(flight, table=table), "contact")
    assert item.t_s == pytest.approx(18.0, abs=0.1)


def test_shocks_in_a_row_are_one_contact_with_begin_and_end() -> None:
    """Nine shocks a second for a second, and one more by itself."""
    flight = flown()
    table = flight.table.copy()
    rattles = (table.time > 17) & (table.time < 18) & (table.time * 9 % 1 < 0.4)
    table.loc[rattles | (table.time > 29) & (table.time < 29.1), ACC[2]] = -80.0
    first, second = of_kind(replace(flight, table=table), "contact")
    assert first.t_s == pytest.approx(17.0, abs=0.15)
    assert first.end_s == pytest.approx(18.0, abs=0.15)
    assert "9 shocks" in first.text and second.text == "shock of 80 m/s²"
    assert second.end_s is None


def test_the_hardest_shock_has_its_own_time() -> None:
    flight = flown()
    table = flight.table.copy()
    for begin_s, size in ((17.0, -60.0), (23.5, -80.0)):
        table.loc[(table.time > begin_s) & (table.time < begin_s + 0.1), ACC[2]] = size
    (item,) = of_kind(replace(flight, table=table), "contact")
    text, _, at = item.text.partition(" at ")
    assert text == "2 shocks, the hardest of 80 m/s²" and item.t_s == pytest.approx(17.0, abs=0.1)
    assert float(at.removesuffix(" s")) == pytest.approx(23.5, abs=0.12)


def test_a_shock_at_the_end_of_a_flight_is_a_touchdown() -> None:
    flight = flown()
    (part,) = FlightFrame.of(flight).airborne
    end_s = FlightFrame.of(flight).t_s[part.end - 1]
    table = flight.table.copy()
    table.loc[(table.time > end_s - 0.4) & (table.time < end_s - 0.3), ACC[2]] = -80.0
    (item,) = of_kind(replace(flight, table=table), "contact")
    assert item.text == "touchdown of 80 m/s²"


def test_the_autopilot_is_quoted_while_it_flies() -> None:
    said = Autopilot(
        modes=(Mode("Hold", 0.0), Mode("Land", 28.0)),
        armed=(Interval("armed", 2.0, 20.0),),
        failsafes=(Interval("battery failsafe", 27.0, 36.0),),
        messages=(
            Message(1.0, "error", "before"),
            Message(15.0, "info", "talk"),
            Message(16.0, "warning", "compass off"),
            Message(17.0, "warning", "compass off"),
            Message(18.0, "", "EKF reset"),
        ),
    )
    flight = replace(flown(), autopilot=said)
    assert [i.text for i in of_kind(flight, "message")] == ['"compass off"', '"EKF reset"']
    assert [i.text for i in of_kind(flight, "mode")] == ["mode Hold", "mode Land"]
    assert of_kind(flight, "failsafe")[0].end_s == 36.0
    assert "motors are disarmed in the air" in [i.text for i in of_kind(flight, "note")]


def test_silence_of_the_logger_is_told() -> None:
    flight = flown()
    table = flight.table[(flight.table.time < 15) | (flight.table.time > 17.5)]
    notes = of_kind(replace(flight, table=table.reset_index(drop=True)), "note")
    assert [n.text for n in notes] == ["nothing is logged for 2.54 s"]


def test_all_of_it_is_in_order_of_time() -> None:
    times = [i.t_s for i in diagnose(flown()).timeline]
    assert times == sorted(times) and len(times) >= 2
