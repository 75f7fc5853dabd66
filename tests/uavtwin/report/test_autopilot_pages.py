"""What an autopilot says, on a page: planted vibration where it is, setpoints the short way round,
texts of a log that stay texts, and the page of a converted log that of the log."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from places import DATA, needs

from twin.frames import from_euler
from twin.logs import Flight, open_flight, read_flight, write_flight
from twin.logs.autopilot import Autopilot, Filter, Interval, Message, Mode, Parameter, Setpoint
from twin.logs.columns import ACC, GYRO, QUAT
from twin.residuals.gap import FlightGap
from uavtwin.report.autopilot import (
    COLUMNS,
    MOST_MESSAGES,
    MOST_PARAMETERS,
    PLACES,
    ROWS,
    autopilot_content,
    autopilot_view,
    spectrogram,
    strip,
)
from uavtwin.report.drawing import Budget
from uavtwin.report.gap import gap_page
from uavtwin.report.overview import overview

HOSTILE = "</script><script>alert('x')</script><b>&"
T = np.arange(0.0, 40.0, 0.005)
REAL = DATA / "rflysimdt" / "real_1.ulg"


def flight(signals: dict[str, np.ndarray], said: Autopilot | None = None) -> Flight:
    return Flight("made", pd.DataFrame({"time": T} | signals), autopilot=said)


def gyro(values: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(GYRO, (values, 0 * T, 0 * T), strict=True))


def test_a_planted_tone_is_where_it_climbs() -> None:
    """A chirp of 20 to 60 Hz: the strongest frequency of each column is that of its middle."""
    phase = 2 * np.pi * (20 * T + 0.5 * T**2)
    shown = spectrogram(flight(gyro(0.3 * np.sin(phase))))
    assert shown is not None and shown.sensor == "gyro"
    assert shown.rate_hz == pytest.approx(200.0) and shown.power_db.shape[1] <= COLUMNS
    rows, columns = shown.power_db.shape
    assert rows <= ROWS
    middles = T[0] + (np.arange(columns) + 0.5) / columns * (T[-1] - T[0])
    found = (np.argmax(shown.power_db, axis=0) + 0.5) / rows * shown.top_hz
    inside = (middles > 1.0) & (middles < 39.0)
    assert np.abs(found - (20 + middles))[inside].max() < 2.0


def test_power_is_that_of_the_noise() -> None:
    """White noise of three axes: density 3 sigma^2 / (rate / 2), the largest of neighbours."""
    rng = np.random.default_rng(0)
    noise = {name: 0.2 * rng.standard_normal(len(T)) for name in GYRO}
    shown = spectrogram(flight(noise))
    assert shown is not None
    expected_db = 10 * np.log10(3 * 0.2**2 / 100.0)
    assert np.median(shown.power_db) == pytest.approx(expected_db, abs=2.5)


def test_where_samples_are_missing_nothing_is_drawn() -> None:
    values = np.sin(20 * T)
    values[(T > 10) & (T < 20)] = np.nan
    table = pd.DataFrame({"time": T} | gyro(values)).dropna()
    shown = spectrogram(Flight("gap", table.reset_index(drop=True)))
    assert shown is not None
    middles = (np.arange(shown.power_db.shape[1]) + 0.5) / shown.power_db.shape[1] * T[-1]
    blank = np.asarray(np.isnan(shown.power_db).all(axis=0))
    assert blank[(middles > 11) & (middles < 19)].all()
    assert not blank[(middles < 9) | (middles > 21)].any()


def test_the_faster_sensor_is_shown_and_none_of_slow_or_short_ones() -> None:
    slow = {name: np.where(np.arange(len(T)) % 8 == 0, 0.1, np.nan) for name in GYRO}
    fast = {name: np.sin(50 * T) for name in ACC}
    shown = spectrogram(flight(slow | fast))
    assert shown is not None and shown.sensor == "acc"
    few = {name: np.where(np.arange(len(T)) % 40 == 0, 0.1, np.nan) for name in GYRO}
    assert spectrogram(flight(few)) is None
    assert spectrogram(flight(gyro(0 * T)).between(0.0, 5.0)) is None
    assert spectrogram(flight({"pos_x": T})) is None


def test_yaw_of_setpoint_and_flight_the_short_way_round() -> None:
    """Both turn through south; the setpoint leads by 10 degrees."""
    yaw = 2.0 + 0.1 * T
    turned = dict(zip(QUAT, np.asarray(from_euler(0 * T, 0 * T, yaw)), strict=True))
    ahead = np.asarray(from_euler(0 * T, 0.2 + 0 * T, yaw + np.radians(10.0))).T
    view = autopilot_view(
        flight(turned, Autopilot(setpoints=(Setpoint(QUAT, T[::4], ahead[::4]),)))
    )
    (attitude,) = view.followed
    (_, flown, _), (_, _, pitch), (name, _, asked) = (
        attitude.axes[0],
        attitude.axes[1],
        attitude.axes[2],
    )
    assert name == "yaw" and np.allclose(flown[1], 0.0)
    assert np.allclose(pitch[1], np.degrees(0.2))
    assert np.allclose(asked[1], np.degrees(2.0 + 0.1 * asked[0]) + 10.0)


def test_marks_that_lie_together_are_one() -> None:
    said = Autopilot(
        modes=(Mode("Hold", 0.0), Mode("Land", 30.0)),
        armed=(Interval("armed", 1.0, 40.0),),
        failsafes=(Interval("failsafe", 5.0, 40.0),),
        messages=(
            Message(-5.0, "error", "before"),
            *(Message(10.0 + 0.01 * k, "info", f"<i>{k}") for k in range(8)),
            Message(10.08, "warning", "grave & last"),
            *(Message(0.01 * k, "", "x") for k in range(4000)),
        ),
    )
    shown = strip("flight", said, 40.0)
    assert shown is not None
    content = json.loads(shown.json)
    assert content["modes"] == [["Hold", 0.0, 30.0], ["Land", 30.0, 40.0]]
    assert content["failsafes"] == [["failsafe", 5.0, 40.0]]
    kinds = [kind for _, kind, _ in content["marks"]]
    assert kinds.count("grave") == kinds.count("armed") == 1 and "disarmed" not in kinds
    assert len(content["marks"]) <= PLACES + 2
    (grave,) = [m for m in content["marks"] if m[1] == "grave"]
    assert grave[0] == 10.08 and "warning: grave &amp; last" in grave[2]
    assert "<i>" not in grave[2] and "&lt;i&gt;0" in grave[2] and "more" in grave[2]
    assert "before" not in str(content)
    assert strip("flight", Autopilot(), 40.0) is None and strip("flight", None, 40.0) is None


def test_texts_of_a_log_stay_texts() -> None:
    said = Autopilot(
        (Mode(HOSTILE, 0.0),),
        (Interval(HOSTILE, 0.0, 20.0),),
        (Interval(HOSTILE, 1.0, 2.0),),
        tuple(Message(0.001 * k, "error" if k == 900 else "", HOSTILE) for k in range(1000)),
        parameters=tuple(Parameter(f"{HOSTILE}{k}", 0.1, 1e9) for k in range(700)),
        filters=(Filter("gyro", "notch", 30.0, HOSTILE),),
    )
    made = flight(gyro(np.sin(60 * T)) | {"rotor_1": 200 + T, "rotor_2": 210 + T}, said)
    text = gap_page([FlightGap("made", "none", (), (), (), {})], [overview(made)])
    assert "alert(" in text
    assert "<script>alert" not in text and "<b>&'" not in text
    shown = autopilot_content("f", autopilot_view(made), (), Budget(100))
    assert len(shown["messages"]) == MOST_MESSAGES and shown["messages_count"] == 1000
    assert any(m.grave for m in shown["messages"])
    assert len(shown["parameters"]) == MOST_PARAMETERS
    assert f"{700 - MOST_PARAMETERS} more in the log" in text
    assert "0.1</td><td>1e+09<" in text
    figure = json.loads(shown["spectrogram"].json)
    names = [trace["name"] for trace in figure["data"]]
    assert names == ["rotor 1", "rotor 2", f"notch 30 Hz ({HOSTILE})"]


def test_a_flight_that_tells_nothing_has_no_card() -> None:
    still = overview(flight({"pos_x": T, "pos_y": T, "pos_z": T}))
    text = gap_page([FlightGap("made", "none", (), (), (), {})], [still])
    for words in ("What the autopilot said", "Setpoint and flight", "Vibration", 'data-strip="'):
        assert words not in text


@pytest.mark.slow
@needs(REAL.is_file(), "no rflysimdt: set UAVTWIN_DATA")
def test_the_page_of_a_converted_log_is_that_of_the_log(tmp_path: Path) -> None:
    log, path = read_flight(REAL), tmp_path / "real_1.parquet"
    write_flight(log, path)
    gap = [FlightGap("real_1", "none", (), (), (), {})]
    of_log, of_table = (gap_page(gap, [overview(each)]) for each in (log, open_flight(path)))
    assert of_log == of_table
    for words in ("Takeoff detected", "gps low on stack", "IMU_GYRO_CUTOFF", "Offboard"):
        assert words in of_log
    write_flight(replace(log, autopilot=None), path)
    silent = gap_page(gap, [overview(read_flight(path))])
    assert "Offboard" not in silent, "else this test cannot fail"
