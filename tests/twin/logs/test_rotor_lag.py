"""Rotor speeds whose stamps are late: planted delays come back, speeds that are in time stay."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from places import DATA, needs
from scipy.signal import lfilter

from twin.logs import Flight, StoredFlight, open_flight, read_flight
from twin.logs.columns import ACC, GYRO, motor_columns
from twin.logs.rotor_lag import (
    LEAST_R2,
    LONGEST_DEAD_TIME_S,
    align_speed_stamps,
    as_stamped,
    speed_lag,
)
from twin.logs.table import write_flight
from twin.residuals.teacher_forced import choose_drive, drive_warnings, driven_by
from twin.vehicle_file import load_vehicle
from uavtwin.wording import drive_sentence

Array = NDArray[np.float64]
PLANT_HZ = 1000.0
CONSTANT_S = 0.06
ROLL, PITCH = np.array([-1.0, 1.0, 1.0, -1.0]), np.array([1.0, -1.0, 1.0, -1.0])
"""Of a quadrotor in X, motors as PX4 and ArduPilot number them."""


def lagged(values: Array, constant_s: float) -> Array:
    """A first-order lag, started at rest on the first value; shape (n, k)."""
    keep = np.exp(-1 / PLANT_HZ / constant_s)
    rest = values[0]
    return np.asarray(lfilter([1 - keep], [1, -keep], values - rest, axis=0) + rest)


def made(
    delay_s: float = 0.0,
    *,
    speed_hz: float = 50.0,
    command_hz: float = 50.0,
    rpm_step: float = 10.0,
    act_s: float = 0.0,
    duration_s: float = 40.0,
    lost: float = 0.05,
    seed: int = 0,
) -> Flight:
    """A flight whose motors follow random commands and turn the body.

    Args:
        delay_s: By how much the stamps of the speeds are late.
        speed_hz: Rate of the speeds, whose intervals jitter by a fifth.
        command_hz: Rate of the commands.
        rpm_step: Least count of the speeds, RPM.
        act_s: By how much the motors get their commands late.
        duration_s: Length.
        lost: Share of the reports of speeds that are lost.
        seed: Of all that is random.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration_s, 1 / PLANT_HZ)
    stir = lagged(lagged(rng.normal(size=(len(t), 4)), 0.1), 0.1)
    command = 0.5 + 0.08 * stir / stir.std()
    late = round(act_s * PLANT_HZ)
    arriving = np.vstack([np.repeat(command[:1], late, axis=0), command[: len(t) - late]])
    speed = 700.0 * np.sqrt(np.clip(lagged(arriving, CONSTANT_S), 0.05, 1.0))
    push = 1e-5 * speed**2
    wind = lagged(rng.normal(size=(len(t), 3)), 0.5)
    wind *= 0.3 / wind.std()
    turning = np.column_stack([push @ ROLL, push @ PITCH]) * 4.0 + wind[:, :2]
    rates = np.cumsum(turning, axis=0) / PLANT_HZ
    down = -push.sum(axis=1) / 1.2 + wind[:, 2]

    def sampled(hz: float, jitter: float = 0.0) -> NDArray[np.intp]:
        """Places of samples in the plant's time."""
        steps = np.full(round(duration_s * hz) - 1, 1 / hz) * (
            1 + jitter * rng.uniform(-1, 1, round(duration_s * hz) - 1)
        )
        return np.unique(np.minimum((np.cumsum(steps) * PLANT_HZ).astype(np.intp), len(t) - 1))

    step = rpm_step * 2 * np.pi / 60
    at = sampled(speed_hz, 0.2)
    at = at[rng.random(len(at)) >= lost]
    reported = np.round(speed[at] / step) * step
    imu, sent = sampled(200.0), sampled(command_hz)
    parts = [
        pd.DataFrame(reported, columns=motor_columns("rotor", 4)).assign(time=t[at] + delay_s),
        pd.DataFrame(command[sent], columns=motor_columns("cmd", 4)).assign(time=t[sent]),
        pd.DataFrame(
            {
                "time": t[imu],
                "gyro_x": rates[imu, 0] + rng.normal(0, 0.004, len(imu)),
                "gyro_y": rates[imu, 1] + rng.normal(0, 0.004, len(imu)),
                "gyro_z": rng.normal(0, 0.004, len(imu)),
                "acc_x": rng.normal(0, 0.08, len(imu)),
                "acc_y": rng.normal(0, 0.08, len(imu)),
                "acc_z": down[imu] + rng.normal(0, 0.08, len(imu)),
            }
        ),
    ]
    table = parts[0]
    for part in parts[1:]:
        table = table.assign(time=table["time"].round(6)).merge(
            part.assign(time=part["time"].round(6)), on="time", how="outer"
        )
    table = table.sort_values("time", ignore_index=True)
    table["time"] -= table["time"].iloc[0]
    return Flight("made", table.assign(phase="hover"))


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [0.0, 0.02, 0.05, 0.1, 0.2])
@pytest.mark.parametrize(("speed_hz", "command_hz"), [(10.0, 10.0), (30.0, 25.0), (200.0, 100.0)])
def test_a_planted_delay_is_measured(delay_s: float, speed_hz: float, command_hz: float) -> None:
    """RPM in steps of 50."""
    lag = speed_lag(made(delay_s, speed_hz=speed_hz, rpm_step=50.0, command_hz=command_hz))
    assert lag is not None and lag.r2 > 0.8
    assert lag.delay_s == pytest.approx(delay_s, abs=2.0 * lag.delay_sd_s)
    assert lag.delay_sd_s < 0.012
    assert lag.time_constant_s == pytest.approx(CONSTANT_S, abs=0.02)
    assert lag.motion_s is not None
    assert lag.motion_s == pytest.approx(delay_s, abs=max(3.0 * lag.motion_sd_s, 0.01))


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [0.0, 0.02])
@pytest.mark.parametrize("seed", range(2))
def test_speeds_in_time_stay(delay_s: float, seed: int) -> None:
    flight = made(delay_s, seed=seed)
    read = align_speed_stamps(flight)
    pd.testing.assert_frame_equal(read.table, flight.table)
    assert read.findings == () and "rotor lag" in read.facts


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("speed_hz", [10.0, 100.0])
def test_late_stamps_are_set_earlier(delay_s: float, speed_hz: float) -> None:
    flight = made(delay_s, speed_hz=speed_hz)
    read = align_speed_stamps(flight)
    (finding,) = read.findings
    assert finding.severity == "warning" and finding.where == "rotor"
    assert "clock_offset.rotor_s" in finding.message
    before, values = flight.signal(motor_columns("rotor", 4))
    after, moved = read.signal(motor_columns("rotor", 4))
    shift = before[len(before) - len(after) :] - after
    assert np.ptp(shift) < 2e-6
    assert shift[0] == pytest.approx(delay_s, abs=0.015)
    np.testing.assert_array_equal(moved, values[len(values) - len(after) :])
    for columns in (("gyro_x",), motor_columns("cmd", 4)):  # all else is as it was
        for one, other in zip(flight.signal(columns), read.signal(columns), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-6)
    assert (read.table["phase"] == "hover").all()
    assert np.all(np.diff(read.time_s) > 0.0)
    assert align_speed_stamps(read).findings == read.findings  # once is enough


@pytest.mark.slow
def test_the_verbs_that_fit_say_what_was_done() -> None:
    """`explain` and `calibrate` print these; `gap` prints all warnings of the readers."""
    vehicle = load_vehicle("copter_default")
    late, in_time = (align_speed_stamps(made(s, duration_s=20.0)) for s in (0.1, 0.0))
    (text,) = drive_warnings(late, vehicle)
    assert text.startswith("made: rotor: time stamps were late and are set ")
    assert drive_warnings(in_time, vehicle) == []


@pytest.mark.slow
def test_late_commands_are_not_late_speeds() -> None:
    """Where the motion comes with the speeds, the stamps stay and the commands are named."""
    flight = made(act_s=0.15)
    read = align_speed_stamps(flight)
    pd.testing.assert_frame_equal(read.table, flight.table)
    (finding,) = read.findings
    assert "command_delay" in finding.message and "earlier" not in finding.message


@pytest.mark.slow
def test_speeds_that_do_not_follow_say_nothing() -> None:
    flight = made(0.2)
    rng = np.random.default_rng(1)
    speeds = list(motor_columns("rotor", 4))
    known = flight.table[speeds].notna().all(axis=1)
    table = flight.table.copy()
    table.loc[known, speeds] = 400 + 20 * rng.normal(size=(known.sum(), 4))
    alone = replace(flight, table=table)
    assert speed_lag(alone) is None
    assert align_speed_stamps(alone) is alone


@pytest.mark.parametrize("part", ["motors stand", "commands stand still", "short", "holes"])
def test_what_does_not_show_a_lag_is_left_alone(part: str) -> None:
    flight = made(0.2, duration_s=20.0)
    table, t_s = flight.table.copy(), flight.time_s
    speeds, commands = motor_columns("rotor", 4), motor_columns("cmd", 4)
    if part == "motors stand":
        table.loc[table["cmd_1"].notna(), [*commands]] = 0.0
    elif part == "commands stand still":
        table.loc[table["cmd_1"].notna(), [*commands]] = 0.5
    elif part == "short":
        table = table[t_s < 6.0]
    else:
        table.loc[(t_s % 2.0) < 1.5, [*speeds]] = np.nan
    assert speed_lag(replace(flight, table=table.reset_index(drop=True))) is None


@pytest.mark.parametrize("column", ["cmd_1", "rotor_1"])
def test_without_commands_or_speeds_nothing_is_said(column: str) -> None:
    flight = made(0.2, duration_s=10.0)
    bare = replace(flight, table=flight.table.drop(columns=[column]))
    assert speed_lag(bare) is None


@pytest.mark.slow
def test_a_table_left_in_its_file_is_set_earlier_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twin.logs.table.HELD_CELLS", 0)
    path = tmp_path / "made.parquet"
    write_flight(made(0.1, speed_hz=100.0), path)
    read = open_flight(path)
    assert isinstance(read, StoredFlight)
    assert any("time stamps were late" in f.message for f in read.findings)
    lag = speed_lag(read)
    assert lag is not None and abs(lag.delay_s) < 0.01


def test_commands_drive_where_a_link_has_delayed_the_speeds() -> None:
    """It smooths them, too; a vehicle that is driven by speeds alone has nothing else."""
    vehicle = load_vehicle("copter_default")
    assert vehicle.rotors.from_speed and vehicle.drive == "command"
    late, right = (align_speed_stamps(made(d, duration_s=20.0)) for d in (0.2, 0.0))
    assert choose_drive(late, vehicle) == "command"
    assert choose_drive(right, vehicle) == "rotor_speed"
    no_map = replace(vehicle, rotors=replace(vehicle.rotors, speed_rad_s=()))
    assert choose_drive(late, no_map) == "rotor_speed"


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_that_speeds_came_late_is_known_of_a_copy(tmp_path: Path, suffix: str) -> None:
    """Parquet notes it; CSV keeps the stamps, so that they are found late again."""
    flight = made(0.2, duration_s=20.0)
    read = align_speed_stamps(flight)
    read = replace(read, table=read.table[["time", *read.table.columns.drop("time")]])
    assert read.speeds_late_s == pytest.approx(0.2, abs=0.03)
    write_flight(read, tmp_path / f"copy.{suffix}")
    copy = read_flight(tmp_path / f"copy.{suffix}")
    assert copy.speeds_late_s == pytest.approx(read.speeds_late_s, abs=2e-3)
    assert choose_drive(copy, load_vehicle("copter_default")) == "command"
    speeds = list(motor_columns("rotor", 4))
    known = as_stamped(read).table.dropna(subset=speeds)
    was = flight.table.dropna(subset=speeds)
    was = was[was["time"] >= known["time"].iloc[0] - 1e-6]
    np.testing.assert_allclose(known["time"], was["time"], atol=2e-6)
    np.testing.assert_array_equal(known[speeds], was[speeds])


def test_readings_return_to_their_stamps_in_csv(tmp_path: Path) -> None:
    """Those of a low-pass that the vehicle has; of each sensor its own."""
    t_s = np.round(np.arange(400) * 0.004, 6)
    readings = np.random.default_rng(0).normal(size=(400, 6))
    delays_s = {"acc": 0.007503, "gyro": 0.002251}
    stamped = pd.DataFrame(readings, columns=[*ACC, *GYRO])
    stamped.insert(0, "time", np.round(t_s + 0.1, 6))
    parts = [pd.DataFrame({"time": t_s, "baro_pa": 101325.0})]
    for columns, delay_s in zip((ACC, GYRO), delays_s.values(), strict=True):
        part = stamped[["time", *columns]]
        parts.append(part.assign(time=np.round(part["time"] - delay_s, 6)))
    table = pd.concat(parts).groupby("time", as_index=False).first()
    flight = Flight("corrected", table, filter_delays_s=delays_s)
    write_flight(flight, tmp_path / "copy.csv")
    copy = read_flight(tmp_path / "copy.csv")
    assert copy.filter_delays_s == {} and len(copy.table) == 425  # 400 of baro_pa, 25 after them
    found_s, values = copy.signal([*ACC, *GYRO])
    np.testing.assert_allclose(found_s, stamped["time"], atol=2e-6)
    np.testing.assert_array_equal(values, readings)
    _, pressure = copy.signal(["baro_pa"])
    assert len(pressure) == 400


def test_what_drives_the_twin_is_said_with_its_reason() -> None:
    vehicle = load_vehicle("copter_default")
    late, right = (align_speed_stamps(made(d, duration_s=20.0)) for d in (0.2, 0.0))
    of_commands = replace(right, table=right.table.drop(columns=["rotor_1"]))
    said = {
        "late": driven_by(late, vehicle),
        "right": driven_by(right, vehicle),
        "none": driven_by(of_commands, vehicle),
    }
    assert said == {
        "late": "motor commands: a link has delayed the rotor speeds",
        "right": "measured rotor speeds",
        "none": "motor commands",
    }
    assert drive_sentence({}) == "" == drive_sentence({"a": said["none"], "b": ""})
    assert drive_sentence({"a": said["right"], "b": said["right"]}) == (
        "The twin is driven by measured rotor speeds."
    )
    assert drive_sentence(said).startswith("Twins are driven differently: that of late by motor")


QUIVER = DATA / "quiver_pt1"


@pytest.mark.slow
@needs(QUIVER.is_dir(), "no recorded flights")
@pytest.mark.parametrize("number", [80, 81, 83, 87, 92])
def test_telemetry_of_a_recorded_aircraft_is_late(number: int) -> None:
    """0.13 to 0.16 s behind the commands beside a motor lag of 0.1 s; the body turns before."""
    read = read_flight(QUIVER / f"pt1_000000{number}.BIN")
    assert any("time stamps were late" in f.message for f in read.findings)
    again = speed_lag(read)
    assert again is not None and again.r2 > LEAST_R2
    assert abs(again.delay_s) < LONGEST_DEAD_TIME_S
    assert 0.08 < again.time_constant_s < 0.16
