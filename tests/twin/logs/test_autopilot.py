"""What an autopilot says of its flight: as pyulog decodes the same log, as planted, and kept."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import DATA, needs
from pyulog import ULog
from sample_logs import MOVING_S, flight_table, moving_topics, ulog

from twin.logs import Flight, open_flight, read_flight, write_flight
from twin.logs.autopilot import (
    LONGEST,
    MOST_EVENTS,
    MOST_MESSAGES,
    MOST_SAMPLES,
    Autopilot,
    Filter,
    Interval,
    Message,
    Mode,
    Parameter,
    Setpoint,
    as_text,
    modes_of,
    setpoint_of,
    stretches_of,
)
from twin.logs.columns import GYRO, POS, QUAT, VEL

FOLDER = DATA / "rflysimdt"
HOSTILE = "</script><b>&\x00\x1b[31m \ud800"


def told(flight: Flight) -> Autopilot:
    assert flight.autopilot is not None
    return flight.autopilot


def same(one: Autopilot, other: Autopilot) -> None:
    """All of it, to the last bit."""
    assert replace(one, setpoints=()) == replace(other, setpoints=())
    assert [s.columns for s in one.setpoints] == [s.columns for s in other.setpoints]
    for a, b in zip(one.setpoints, other.setpoints, strict=True):
        assert a.every == b.every
        assert np.array_equal(a.t_s, b.t_s) and np.array_equal(a.values, b.values, equal_nan=True)


def planted(tmp_path: Path, **how: object) -> Autopilot:
    """A log of eight seconds: manual, armed, on a mission, failsafe, return, landed."""
    n = len(MOVING_S[::250])
    seconds = np.round(MOVING_S[::250])
    status = {
        "t": MOVING_S[::250] - 0.5,
        "nav_state": np.array([0, 0, 3, 3, 5, 99, 99, 99], dtype=np.uint8)[:n],
        "arming_state": np.array([1, 2, 2, 2, 2, 2, 1, 1], dtype=np.uint8)[:n],
        "failsafe": np.array([0, 0, 0, 0, 1, 1, 0, 0], dtype=bool)[:n],
    }
    t = MOVING_S[::25]
    f4 = np.float32
    local = {"t": t, **{k: np.full(len(t), i, f4) for i, k in enumerate(("x", "y", "z"))}}
    local |= {
        "vx": np.full(len(t), np.nan, f4),
        "vy": np.sin(t).astype(f4),
        "vz": np.cos(t).astype(f4),
    }
    turn = np.stack([np.cos(t / 2), np.sin(t / 2), 0 * t, 0 * t], axis=1).astype(f4)
    turn[3] = 0
    rates = {"t": t, "roll": np.full(len(t), 0.25, f4), "pitch": 0 * t.astype(f4)}
    topics = moving_topics() | {
        "vehicle_status": status,
        "vehicle_local_position_setpoint": local,
        "vehicle_attitude_setpoint": {"t": t, "q_d": turn},
        "vehicle_rates_setpoint": rates | {"yaw": 0 * t.astype(f4)},
    }
    assert len(seconds) == 8
    path = tmp_path / "planted.ulg"
    path.write_bytes(ulog(topics, **how))  # type: ignore[arg-type]
    return told(read_flight(path))


def test_modes_arming_and_failsafes_as_planted(tmp_path: Path) -> None:
    found = planted(tmp_path)
    modes = [(m.name, round(m.start_s, 3)) for m in found.modes]
    assert modes == [
        ("Manual", 0.0),
        ("Mission", 1.504),
        ("Return", 3.504),
        ("nav_state 99", 4.504),
    ]
    assert [(s.name, round(s.start_s, 3), round(s.end_s, 3)) for s in found.armed] == [
        ("armed", 0.504, 5.504)
    ]
    assert [(s.name, round(s.start_s, 3), round(s.end_s, 3)) for s in found.failsafes] == [
        ("failsafe", 3.504, 5.504)
    ]


def test_setpoints_as_planted(tmp_path: Path) -> None:
    found = planted(tmp_path)
    t = MOVING_S[::25]
    position, velocity, attitude, rates = (found.setpoint(c) for c in (POS, VEL, QUAT, GYRO))
    assert position and velocity and attitude and rates
    assert np.allclose(position.t_s, t, atol=1e-6)
    assert np.array_equal(position.values, np.tile([0.0, 1.0, 2.0], (len(t), 1)))
    assert np.isnan(velocity.values[:, 0]).all()
    assert np.allclose(velocity.values[:, 1:], np.column_stack([np.sin(t), np.cos(t)]), atol=1e-6)
    assert (
        np.isnan(attitude.values[3]).all() and np.isfinite(np.delete(attitude.values, 3, 0)).all()
    )
    assert np.allclose(
        attitude.values[4], [math.cos(t[4] / 2), math.sin(t[4] / 2), 0, 0], atol=1e-6
    )
    assert np.array_equal(rates.values, np.tile([0.25, 0.0, 0.0], (len(t), 1)))


def test_the_velocity_of_the_mission_comes_before_that_of_the_position_loop(tmp_path: Path) -> None:
    t = MOVING_S[::25]
    for fields in (("vx", "vy", "vz"), ("velocity[0]", "velocity[1]", "velocity[2]")):
        asked = {f: np.full(len(t), k, np.float32) for k, f in enumerate(fields)}
        if "[" in fields[0]:
            asked = {"velocity": np.tile(np.arange(3, dtype=np.float32), (len(t), 1))}
        path = tmp_path / f"{fields[0]}.ulg"
        local = {f"v{a}": np.full(len(t), 9, np.float32) for a in "xyz"}
        topics = moving_topics() | {
            "trajectory_setpoint": {"t": t, **asked},
            "vehicle_local_position_setpoint": {"t": t, **local},
        }
        path.write_bytes(ulog(topics))
        velocity = told(read_flight(path)).setpoint(VEL)
        assert velocity is not None
        assert np.array_equal(velocity.values, np.tile([0.0, 1.0, 2.0], (len(t), 1)))


def test_messages_parameters_and_filters_as_planted(tmp_path: Path) -> None:
    """Defaults of the airframe go before those of the firmware; one that is kept is not listed."""
    found = planted(
        tmp_path,
        params={"A": 1.5, "B": 2, "C": 3, "IMU_GYRO_CUTOFF": 40.0, "IMU_GYRO_NF0_FRQ": 80.0},
        defaults={"A": (1, 1.0), "B": (3, 2), "C": (1, 4), "UNKNOWN": (1, 1.0)},
        said=[(2.0, "4", "low\nbattery <b>"), (-0.5, "6", "armed"), (3.0, "9", "what")],
    )
    assert found.parameters == (Parameter("A", 1.5, 1.0), Parameter("C", 3.0, 4.0))
    assert found.messages == (
        Message(-0.5, "info", "armed"),
        Message(2.0, "warning", "low battery <b>"),
        Message(3.0, "", "what"),
    )
    assert [m.grave for m in found.messages] == [False, True, False]
    assert found.filters == (
        Filter("gyro", "low-pass", 40.0, "IMU_GYRO_CUTOFF"),
        Filter("gyro", "notch", 80.0, "IMU_GYRO_NF0_FRQ"),
    )


def test_a_log_that_tells_nothing_of_its_autopilot(tmp_path: Path) -> None:
    path = tmp_path / "still.ulg"
    path.write_bytes(ulog(moving_topics()))
    assert told(read_flight(path)) == Autopilot()


@pytest.mark.slow
def test_what_the_autopilot_says_changes_neither_signals_nor_findings(tmp_path: Path) -> None:
    """Setpoints and states that stop amid the flight, in no order, are no doubt of its signals."""
    path = tmp_path / "log.ulg"
    path.write_bytes(ulog(moving_topics()))
    plain = read_flight(path)
    t = np.array([3.0, 1.0, 2.0, 2.0])
    status = {"t": t, "nav_state": np.array([2, 3, 4, 4], dtype=np.uint8)}
    path.write_bytes(ulog(moving_topics() | {"vehicle_status": status}))
    more = read_flight(path)
    assert (more.fingerprint, more.findings, more.facts) == (
        *(plain.fingerprint, plain.findings, plain.facts),
    )
    assert told(more).modes


@needs(FOLDER.is_dir(), "no rflysimdt: set UAVTWIN_DATA")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["real_1", "sim_1"])
def test_recorded_logs_as_pyulog_decodes_them(name: str, tmp_path: Path) -> None:
    """Decoded again sample by sample; then through a flight table."""
    path = FOLDER / f"{name}.ulg"
    flight = read_flight(path)
    found, log = told(flight), ULog(str(path))
    end_s, start = flight.time_s[-1], log.start_timestamp
    data = {d.name: d.data for d in log.data_list if d.multi_id == 0}
    names = {0: "Manual", 2: "Position", 4: "Hold", 14: "Offboard", 18: "Land"}

    def seconds(stamp: int) -> float:
        return float(int(stamp) - start) * 1e-6

    status = data["vehicle_status"]
    modes: list[tuple[str, float]] = []
    for stamp, state in zip(status["timestamp"], status["nav_state"], strict=True):
        if not modes or modes[-1][0] != names[int(state)]:
            modes.append((names[int(state)], max(seconds(stamp), 0.0)))
    assert [m.name for m in found.modes] == [name for name, _ in modes]
    assert [m.start_s for m in found.modes] == pytest.approx([t for _, t in modes])
    armed = [
        seconds(s)
        for s, a in zip(status["timestamp"], status["arming_state"], strict=True)
        if a == 2
    ]
    (one,) = found.armed
    assert one.start_s == pytest.approx(armed[0]) and armed[-1] < one.end_s <= end_s
    assert found.failsafes == () and not status["failsafe"].any()
    assert [m.text for m in found.messages] == [m.message for m in log.logged_messages]
    assert [m.level.upper() for m in found.messages] == [
        m.log_level_str() for m in log.logged_messages
    ]
    assert [m.t_s for m in found.messages] == pytest.approx(
        [seconds(m.timestamp) for m in log.logged_messages]
    )
    now = log.initial_parameters | {n: v for _, n, v in log.changed_parameters}
    defaults = log.get_default_parameters(0) | log.get_default_parameters(1)
    assert {p.name: (p.value, p.default) for p in found.parameters} == {
        n: (float(now[n]), float(d)) for n, d in defaults.items() if now[n] != d
    }
    for columns, topic, fields in (
        (POS, "vehicle_local_position_setpoint", ("x", "y", "z")),
        (VEL, "trajectory_setpoint", ("vx", "vy", "vz")),
        (QUAT, "vehicle_attitude_setpoint", tuple(f"q_d[{k}]" for k in range(4))),
        (GYRO, "vehicle_rates_setpoint", ("roll", "pitch", "yaw")),
    ):
        values = np.column_stack([data[topic][f].astype(np.float64) for f in fields])
        rows = np.flatnonzero(np.isfinite(values).any(axis=1))
        rows = np.arange(rows[0], rows[-1] + 1)
        kept = found.setpoint(columns)
        assert kept is not None and kept.every == 1
        assert np.array_equal(kept.values, values[rows], equal_nan=True)
        stamps = data[topic]["timestamp"][rows].astype(np.int64)
        assert np.allclose(kept.t_s, (stamps - start) * 1e-6, atol=1e-9)
    table = tmp_path / "flight.parquet"
    write_flight(flight, table)
    for again in (read_flight(table), open_flight(table)):
        assert again.autopilot is not None
        same(again.autopilot, found)
    assert read_flight(table).fingerprint == flight.fingerprint


def test_a_flight_table_left_in_its_file_keeps_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = np.arange(5.0)
    setpoint = Setpoint(POS, t, np.where(np.eye(5, 3) > 0, np.nan, 1.0))
    said = Autopilot(
        (Mode("Hold", 0.0),),
        (Interval("armed", 0.0, 1.0),),
        messages=(Message(-1.0, "error", as_text(HOSTILE)),),
        setpoints=(setpoint,),
        parameters=(Parameter(HOSTILE[:15], 1.0, 2.0),),
    )
    path = tmp_path / "kept.parquet"
    write_flight(Flight("kept", flight_table(), autopilot=said), path)
    monkeypatch.setattr("twin.logs.table.HELD_CELLS", 10)
    stored = open_flight(path)
    assert not isinstance(stored, Flight)
    for flight in (stored, stored.between(0.0, 1.0), read_flight(path)):
        assert flight.autopilot is not None
        same(flight.autopilot, said)


def test_texts_are_one_line_of_bounded_length() -> None:
    assert as_text(" a\n b\tc ") == "a b c"
    assert len(as_text("x" * 10_000)) == LONGEST
    assert as_text("\ud800").encode("utf-8") == b"?"


def test_states_that_change_forever_are_bounded() -> None:
    t = np.arange(5000.0)
    assert len(modes_of(t, [str(k) for k in range(5000)], 1e9)) == MOST_EVENTS
    assert len(stretches_of(t, np.arange(5000) % 2 == 0, "x", 1e9)) == MOST_EVENTS


def test_a_mode_of_before_the_record_holds_at_its_start() -> None:
    found = modes_of(np.array([-9.0, -2.0, 3.0, 4.0, 99.0]), ["a", "b", "b", "c", "d"], 10.0)
    assert found == (Mode("b", 0.0), Mode("c", 4.0))


def test_stretches_end_with_the_record() -> None:
    t = np.array([-1.0, 1.0, 2.0, 3.0])
    found = stretches_of(t, np.array([True, False, False, True]), "x", 5.0)
    assert found == (Interval("x", 0.0, 1.0), Interval("x", 3.0, 5.0))


def test_a_long_setpoint_is_thinned_evenly_and_says_so() -> None:
    t = np.arange(2.5 * MOST_SAMPLES) * 0.02 - 1.0
    values = np.tile(t[:, None], 3)
    values[::7] = np.inf
    values[1::7] = 1e9
    kept = setpoint_of(POS, t, values)
    assert kept is not None and kept.every == 3
    assert kept.t_s[0] >= 0.0 and np.allclose(np.diff(kept.t_s), 0.06)
    known = np.isfinite(kept.values[:, 0])
    assert np.array_equal(kept.values[known, 0], kept.t_s[known]) and not known.all()
    assert setpoint_of(POS, t, np.full((len(t), 3), np.nan)) is None


def test_messages_of_a_talkative_log_are_bounded(tmp_path: Path) -> None:
    said = [(0.001 * k, "6", f"again {k}") for k in range(MOST_MESSAGES + 50)]
    found = planted(tmp_path, said=said)
    assert [m.text for m in found.messages] == [text for _, _, text in said[:MOST_MESSAGES]]
