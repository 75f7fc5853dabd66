"""What is planted in a DataFlash log is what its flight has, in SI, and is told where it is odd."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from log_rigs.dataflash_rig import KINDS, Kind, dataflash
from sample_logs import FLOWN_PARAMS, flown_messages, flown_table

from twin.errors import LogError
from twin.logs import Flight, read_flight, write_flight

T = flown_table()["time"].to_numpy()
SLOW = T[::4]


def flight(tmp_path: Path, messages: Mapping[str, Any], **how: Any) -> Flight:
    path = tmp_path / "log.bin"
    path.write_bytes(dataflash(messages, **({"params": FLOWN_PARAMS} | how)))
    return read_flight(path)


def flown(**others: Any) -> dict[str, Any]:
    """The flown flight with other messages; None leaves one out."""
    return {k: v for k, v in (flown_messages() | others).items() if v is not None}


def said(found: Flight, where: str, *severities: str) -> str:
    return "; ".join(
        f.message for f in found.findings if f.where == where and f.severity in severities
    )


def compare(found: Flight, start_s: float = 0.0) -> None:
    """Every signal is that of the flown table at the same times; units as in the definition."""
    table = flown_table()
    for group, atol in (("acc", 1e-5), ("gyro", 1e-6), ("q", 1e-6), ("vel", 1e-6), ("pos", 1e-6)):
        columns = [c for c in table if str(c).startswith(f"{group}_")]
        t, values = found.signal([str(c) for c in columns])
        row = np.round((t + start_s) / 0.01).astype(int)
        np.testing.assert_allclose(t + start_s, 0.01 * row, atol=1e-9)
        np.testing.assert_allclose(values, table[columns].to_numpy()[row], atol=atol)
        assert len(t) > 650


@pytest.mark.slow
@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("units", [False, True])
def test_the_flown_flight_comes_back(tmp_path: Path, text: bool, units: bool) -> None:
    """Binary and text, with and without FMTU; nothing is doubted."""
    found = flight(tmp_path, flown(), text=text, units=units)
    compare(found)
    table = flown_table()
    t, cmd = found.signal(["cmd_1", "cmd_2", "cmd_3", "cmd_4"])
    row = np.round(t / 0.01).astype(int)
    told = table[["cmd_1", "cmd_2", "cmd_3", "cmd_4"]].to_numpy()[row]
    np.testing.assert_allclose(cmd, told, atol=5.1e-4)  # a whole us of 1000
    _, pressure = found.signal(["baro_pa"])
    np.testing.assert_allclose(pressure[:, 0], table["baro_pa"].to_numpy()[row], atol=0.01)
    errors = [f for f in found.findings if f.severity == "error"]
    assert [f.message for f in errors] == ["it ends with the motors running: cut short?"]
    assert found.facts["airframe"] == "quad x"
    assert found.facts["attitude from"].startswith("XKQ, core 0")


@pytest.mark.slow
def test_sensors_are_those_of_the_core_in_charge(tmp_path: Path) -> None:
    """Core 1 takes the second sensor of EK3_IMU_MASK, which is 2; compass 1, barometer 1."""
    base = flown_messages()
    still = {k: 0.0 * np.asarray(v) for k, v in base["IMU"].items() if k != "t"}
    found = flight(
        tmp_path,
        flown(
            IMU=[{"t": T, "I": 0, **still}, {"t": T, "I": 1, **still}, {**base["IMU"], "I": 2}],
            XKQ=[{"t": SLOW, "C": 0, "Q1": 1.0}, {**base["XKQ"], "C": 1}],
            XKF1=[{"t": SLOW, "C": 0}, {**base["XKF1"], "C": 1}],
            XKF4=[{"t": SLOW, "C": 0, "PI": 1}, {"t": SLOW, "C": 1, "PI": 1}],
            XKFS=[
                {"t": SLOW, "C": 0},
                {"t": SLOW, "C": 1, "MI": (SLOW > 9.0).astype(int), "BI": 1},
            ],
            MAG=[
                {"t": SLOW, "I": 0, "MagX": 1},
                {"t": SLOW, "I": 1, "MagX": 220, "MagY": -20, "MagZ": 430},
            ],
            BARO=[{"t": SLOW, "I": 0, "Press": 9e4}, {**base["BARO"], "I": 1}],
        ),
        params=FLOWN_PARAMS | {"EK3_IMU_MASK": 5.0},
    )
    compare(found)
    assert found.facts["gyro from"].startswith("IMU 2 of 3")
    _, mag = found.signal(["mag_x", "mag_y", "mag_z"])
    np.testing.assert_allclose(mag, np.tile([2.2e-5, -2e-6, 4.3e-5], (len(mag), 1)), rtol=1e-9)
    assert "compass that the EKF uses changes at 9.0 s; here number 1" in said(
        found, "mag", "warning"
    )
    _, pressure = found.signal(["baro_pa"])
    assert pressure.min() > 1e5


def test_a_change_of_core_is_told(tmp_path: Path) -> None:
    base = flown_messages()
    both = [{**base["XKF1"], "C": k} for k in (0, 1)]
    quaternions = [{**base["XKQ"], "C": k} for k in (0, 1)]
    charge = {"t": SLOW, "C": 0, "PI": (SLOW > 20.0).astype(int)}
    found = flight(tmp_path, flown(XKF1=both, XKQ=quaternions, XKF4=charge))
    assert "in charge changes at 20.0 s; here number 0 is used" in said(found, "q", "warning")


@pytest.mark.slow
def test_the_delay_of_the_filters_is_taken_off(tmp_path: Path) -> None:
    """Second-order Butterworth, sqrt(2) / (2 pi f): 11.254 ms at 20 Hz, 22.508 ms at 10 Hz."""
    params = FLOWN_PARAMS | {"INS_GYRO_FILTER": 20.0, "INS_ACCEL_FILTER": 10.0}
    plain, shifted = (flight(tmp_path, flown(), params=p) for p in (FLOWN_PARAMS, params))
    for column, delay_s, early in (("gyro_x", 0.011254, 2), ("acc_x", 0.022508, 3)):
        t, values = plain.signal([column])
        t_shifted, same = shifted.signal([column])
        np.testing.assert_allclose(t_shifted, t[early:] - delay_s, atol=1.1e-6)
        np.testing.assert_array_equal(same, values[early:])
        where = column[:-2]
        assert f"{1e3 * delay_s:.1f} ms before" in said(shifted, where, "info")
        assert "before" not in said(plain, where, "info")
        assert shifted.filter_delays_s[where] == pytest.approx(delay_s, abs=1e-6)
    assert plain.filter_delays_s == {}
    write_flight(shifted, tmp_path / "noted.parquet")
    assert read_flight(tmp_path / "noted.parquet").filter_delays_s == shifted.filter_delays_s


def pulses(on: np.ndarray[Any, Any], t: np.ndarray[Any, Any]) -> dict[str, Any]:
    widths = np.where(on, 1500.0 + 20.0 * np.sin(t), 1000.0)
    return {"t": t, **{f"C{k}": widths for k in range(1, 5)}}


def test_the_longest_armed_stretch_is_used(tmp_path: Path) -> None:
    """Motors run from 2 to 5 s, and from 100 to 128 s: the second is the flight."""
    base = flown_messages()
    t = np.arange(0.0, 130.0, 0.1)
    on = ((t >= 1.95) & (t < 5.0)) | ((t >= 99.95) & (t < 128.0))
    late = {n: {**m, "t": np.asarray(m["t"]) + 99.0} for n, m in base.items()}
    found = flight(tmp_path, late | {"RCOU": pulses(on, t)})
    assert "2 stretches over a minute apart" in said(found, "log", "warning")
    assert "motors stopped are not used" in said(found, "log", "info")
    assert not said(found, "log", "error")
    assert found.table["time"].iloc[0] == 0.0
    assert found.table["time"].iloc[-1] == pytest.approx(27.9, abs=0.11)
    compare(found, 1.0)  # 100 s of the log are 1 s of the flown flight
    assert "104." not in found.facts["motors run"] and "from 0.0 s" in found.facts["motors run"]


def test_without_outputs_the_events_tell(tmp_path: Path) -> None:
    """Armed when the log begins; disarmed at 25 s."""
    found = flight(tmp_path, flown(RCOU=None, EV={"t": [25.0], "Id": [11]}))
    assert found.table["time"].iloc[-1] == pytest.approx(25.0)
    assert "no motor commands" in said(found, "cmd", "warning")
    whole = flight(tmp_path, flown(RCOU=None))
    assert len(whole.table) == 3000
    assert "all of it is used" in said(whole, "log", "info")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("functions", "outputs"),
    [
        ({5: 33, 6: 34, 7: 35, 8: 36}, (5, 6, 7, 8)),
        ({1: 36, 2: 35, 3: 34, 4: 33}, (4, 3, 2, 1)),
        ({1: 33, 2: 34, 3: 35, 4: 36, 5: 33}, (1, 2, 3, 4)),  # motor 1 twice: the first counts
        ({2: 33, 3: 34, 4: 36, 5: 39}, (2, 3, 4)),  # a tricopter with its tail servo
        ({}, (1, 2, 3, 4)),  # before SERVOn_FUNCTION of motors: as many as the frame has
    ],
)
def test_motors_are_on_the_outputs_of_their_functions(
    tmp_path: Path, functions: dict[int, int], outputs: tuple[int, ...]
) -> None:
    params = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0, "MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0}
    params |= {f"SERVO{n}_FUNCTION": float(f) for n, f in functions.items()}
    each = {f"C{n}": 1000.0 + 100.0 * n + 0.0 * SLOW for n in range(1, 9)}
    found = flight(tmp_path, flown(RCOU={"t": SLOW, **each}), params=params)
    commands = [c for c in found.table if str(c).startswith("cmd_")]
    cmd = found.table[commands].dropna().iloc[0]
    np.testing.assert_allclose(cmd, [0.1 * n for n in outputs])


@pytest.mark.parametrize(
    ("params", "low", "high"),
    [
        ({"MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}, 1100.0, 1900.0),
        ({"MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0, "MOT_PWM_TYPE": 6.0}, 1000.0, 2000.0),
        ({"MOT_PWM_MIN": 0.0, "RC3_MIN": 1050.0, "RC3_MAX": 1950.0}, 1050.0, 1950.0),
        ({"RCMAP_THROTTLE": 1.0, "RC1_MIN": 1050.0, "RC1_MAX": 1950.0}, 1050.0, 1950.0),
        ({}, 1000.0, 2000.0),
    ],
)
def test_the_range_of_pulse_widths(
    tmp_path: Path, params: dict[str, float], low: float, high: float
) -> None:
    given = {k: v for k, v in FLOWN_PARAMS.items() if "PWM" not in k} | params
    each = {f"C{n}": 1500.0 + 10.0 * n + 0.0 * SLOW for n in range(1, 5)}
    found = flight(tmp_path, flown(RCOU={"t": SLOW, **each}), params=given)
    assert found.table["cmd_2"].dropna().iloc[0] == pytest.approx((1520.0 - low) / (high - low))


def test_pulses_that_are_none_are_zero_and_counted(tmp_path: Path) -> None:
    each = {f"C{n}": np.where(SLOW < 10.0, 0.0, 1500.0) for n in range(1, 5)}
    each["C1"] = np.full(len(SLOW), 1500.0)
    found = flight(tmp_path, flown(RCOU={"t": SLOW, **each}))
    assert found.table["cmd_2"].min() == 0.0
    counted = [f for f in found.findings if f.where == "cmd" and "set to its end" in f.message]
    assert counted[0].count == 3 * int((SLOW < 10.0).sum())


def test_a_stretch_of_the_yaw_trim(tmp_path: Path) -> None:
    """Motors 3 and 4 turn clockwise in quad X; they get 0.06 more."""
    each = {f"C{n}": 1500.0 + (60.0 if n > 2 else 0.0) + 0.0 * SLOW for n in range(1, 5)}
    events = {"t": [1.0, 28.0], "Id": [28, 18]}
    found = flight(tmp_path, flown(RCOU={"t": SLOW, **each}, EV=events))
    assert found.facts["yaw trim"].startswith("clockwise rotors get 0.060 more")
    assert found.facts["yaw trim"].endswith("11.3% of the mean command")


@pytest.mark.slow
def test_attitude_from_angles_where_there_is_no_quaternion(tmp_path: Path) -> None:
    """ATT has hundredths of a degree."""
    roll, pitch, yaw = 0.1 * np.sin(1.3 * T), 0.12 * np.sin(0.9 * T), 0.4 * np.sin(0.4 * T)
    angles = {"Roll": np.degrees(roll), "Pitch": np.degrees(pitch), "Yaw": np.degrees(yaw)}
    found = flight(tmp_path, flown(XKQ=None, ATT={"t": T, **angles}))
    _, q = found.signal(["q_w", "q_x", "q_y", "q_z"])
    told = flown_table()[["q_w", "q_x", "q_y", "q_z"]].to_numpy()
    np.testing.assert_allclose(q, told[: len(q)], atol=2e-4)
    faster = flight(tmp_path, flown(ATT={"t": T, **angles}))  # XKQ at 25 Hz, ATT at 100
    assert faster.facts["attitude from"] == "ATT, 100 Hz"


@pytest.mark.slow
def test_position_of_the_controller_and_of_satellites(tmp_path: Path) -> None:
    base: Any = flown_messages()["XKF1"]
    axes = {f"PSC{a}": {"t": SLOW, f"P{a}": base[f"P{a}"], f"V{a}": base[f"V{a}"]} for a in "NED"}
    compare(flight(tmp_path, flown(XKF1=None, **axes)))
    metre = np.degrees(1.0 / 6_371_000.0)
    globe = {"Lat": 47.0 + metre * base["PN"], "Alt": 400.0 - base["PD"]}
    globe["Lng"] = 8.0 + metre / np.cos(np.radians(47.0)) * base["PE"]
    found = flight(tmp_path, flown(XKF1=None, POS={"t": SLOW, **globe}))
    _, pos = found.signal(["pos_x", "pos_y", "pos_z"])
    told = np.column_stack([base[f"P{a}"] for a in "NED"])
    np.testing.assert_allclose(pos - pos[0], (told - told[0])[: len(pos)], atol=0.02)
    assert not found.has("vel_x")


@pytest.mark.slow
def test_a_log_before_units_and_instances(tmp_path: Path) -> None:
    """ArduPilot 3.6: IMU2, NKF1, NKQ1, CURR, Chan1; mGauss and degrees by documentation."""
    base: Any = flown_messages()
    kinds = {
        **{k: v for k, v in KINDS.items() if k in ("FMT", "PARM", "EV")},
        "IMU": Kind("Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        "IMU2": Kind("Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        "NKF1": Kind("Qffffff", "TimeUS,VN,VE,VD,PN,PE,PD"),
        "NKQ1": Kind("Qffff", "TimeUS,Q1,Q2,Q3,Q4"),
        "RCOU": Kind("QHHHH", "TimeUS,Chan1,Chan2,Chan3,Chan4"),
        "MAG": Kind("Qhhh", "TimeUS,MagX,MagY,MagZ"),
        "CURR": Kind("Qff", "TimeUS,Volt,Curr"),
        "BARO": Kind("Qf", "TimeUS,Press"),
    }
    old = {
        "IMU": base["IMU"],
        "IMU2": {"t": T, "AccZ": -9.8 + 0.0 * T},
        "NKF1": base["XKF1"],
        "NKQ1": base["XKQ"],
        "RCOU": {k.replace("C", "Chan"): v for k, v in base["RCOU"].items()},
        "MAG": {"t": SLOW, "MagX": 220 + 0.0 * SLOW},
        "CURR": {"t": SLOW, "Volt": 12.0 + 0.0 * SLOW, "Curr": 10.0 + np.sin(SLOW)},
        "BARO": base["BARO"],
    }
    found = flight(tmp_path, old, units=False, kinds=kinds)
    compare(found)
    assert found.facts["gyro from"].startswith("IMU 0 of 2")
    assert found.table["mag_x"].median() == pytest.approx(2.2e-5)
    assert found.has("cmd_4", "ibat_a", "vbat_v", "baro_pa")


@pytest.mark.slow
def test_a_unit_that_contradicts_is_an_error(tmp_path: Path) -> None:
    kinds = KINDS | {"BARO": Kind("QBff", "TimeUS,I,Alt,Press", "s#mv", "F-00")}
    found = flight(tmp_path, flown(), kinds=kinds)
    assert "BARO.Press is in V; taken as Pa" in said(found, "baro", "error")
    degrees = KINDS | {"IMU": Kind(KINDS["IMU"].letters, KINDS["IMU"].columns, "s#kkkooo")}
    imu: Any = dict(flown_messages()["IMU"])
    imu |= {k: np.degrees(v) for k, v in imu.items() if k.startswith("Gyr")}
    compare(flight(tmp_path, flown(IMU=imu), kinds=degrees))


@pytest.mark.slow
def test_current_is_taken_where_it_is_one(tmp_path: Path) -> None:
    volts, amps = 16.0 - 0.01 * SLOW, 20.0 + np.sin(SLOW)
    holes = np.where(np.arange(len(SLOW)) % 10 == 0, np.nan, amps)
    battery = {"t": SLOW, "Volt": volts, "Curr": holes}
    found = flight(tmp_path, flown(BAT=battery))
    assert found.table["ibat_a"].count() == int(np.isfinite(holes).sum())
    assert "hold no current" in said(found, "ibat_a", "warning")
    for current, why in ((0.0 * SLOW, "never positive"), (7.0 + 0.0 * SLOW, "throughout")):
        without = flight(tmp_path, flown(BAT=battery | {"Curr": current}))
        assert why in said(without, "ibat_a", "warning") and not without.has("ibat_a")
    none = flight(tmp_path, flown(BAT={"t": SLOW, "Volt": 0.0 * SLOW}))
    assert "exceeds 1 V" in said(none, "vbat_v", "warning")


def test_what_happens_is_told(tmp_path: Path) -> None:
    events = {"t": [0.5, 5.0, 6.0, 9.0, 28.0], "Id": [10, 28, 62, 60, 18]}
    found = flight(
        tmp_path,
        flown(
            EV=events,
            MODE={"t": [0.0, 10.0, 20.0], "Mode": [0, 16, 77], "ModeNum": [0, 16, 77]},
            ERR={"t": [12.0, 13.0], "Subsys": [6, 6], "ECode": [1, 0]},
            DSF={"t": [1.0, 29.0], "Dp": [3, 20]},
            VIBE={"t": [1.0, 29.0], "IMU": [0, 0], "Clip": [0, 5]},
            MOTB={"t": SLOW, "FailFlags": np.where(SLOW > 15.0, 3, 2)},
        ),
    )
    assert found.facts["modes"] == "Stabilize from 0.0 s, PosHold from 10.0 s, mode 77 from 20.0 s"
    assert "reset its yaw at 6.00 s" in said(found, "q", "warning")
    assert "reset its height at 9.00 s" in said(found, "pos", "warning")
    assert found.autopilot is not None
    assert {(r.of, round(r.t_s, 2)) for r in found.autopilot.resets} == {
        ("yaw", 6.0),
        ("height", 9.0),
    }
    assert said(found, "log", "warning").startswith("battery failsafe error, code 1, at 12.00 s")
    assert "could not be logged" in said(found, "log", "warning")
    assert "at its limit" in said(found, "acc", "warning")
    assert "failed (thrust boost) from 15.04 s" in said(found, "cmd", "warning")
    phase = found.table.set_index("time")["phase"]
    assert (phase[:4.9] == "ground").all() and (phase[28.1:] == "ground").all()
    assert set(phase[6.0:27.0]) <= {"hover", "forward", "takeoff", "land"}


@pytest.mark.slow
def test_another_vehicle_is_an_error(tmp_path: Path) -> None:
    plane = {"MSG": {"t": [0.0], "Message": ["ArduPlane V4.5.7 (abc)"]}}
    found = flight(tmp_path, flown(**plane))
    assert "no multirotor" in said(found, "log", "error")
    quadplane = flight(tmp_path, flown(**plane), params=FLOWN_PARAMS | {"Q_ENABLE": 1.0})
    assert "no multirotor" not in said(quadplane, "log", "error")


def test_a_helicopter_has_no_motor_commands(tmp_path: Path) -> None:
    found = flight(tmp_path, flown(), params=FLOWN_PARAMS | {"FRAME_CLASS": 6.0})
    assert "a helicopter: this is no multirotor" in said(found, "log", "error")
    assert not found.has("cmd_1")


def test_body_rates_of_the_controller_where_there_is_no_imu(tmp_path: Path) -> None:
    table = flown_table()
    rates = {k: np.degrees(table[f"gyro_{a}"]) for k, a in zip("RPY", "xyz", strict=True)}
    found = flight(tmp_path, flown(IMU=None, RATE={"t": T, **rates}))
    _, gyro = found.signal(["gyro_x", "gyro_y", "gyro_z"])
    np.testing.assert_allclose(gyro, table[["gyro_x", "gyro_y", "gyro_z"]][: len(gyro)], atol=1e-6)
    assert "no IMU" in said(found, "acc", "warning")


@pytest.mark.slow
def test_a_site_is_outdoors_where_satellites_are(tmp_path: Path) -> None:
    fix = {"t": SLOW, "GWk": 2356, "GMS": 3 * 86_400_000, "Lat": 47.5, "Lng": 8.5, "Alt": 410.0}
    found = flight(tmp_path, flown(GPS=fix | {"Status": 3}))
    assert found.indoors is False
    assert found.facts["place"] == "47.5000 N, 8.5000 E, 410 m, 2025-03-04"
    assert flight(tmp_path, flown(GPS=fix | {"Status": 1})).indoors is None


@pytest.mark.parametrize("messages", [{}, {"MSG": {"t": [0.0], "Message": ["hello"]}}])
def test_a_log_without_motion_is_refused(tmp_path: Path, messages: dict[str, Any]) -> None:
    with pytest.raises(LogError, match=r"ArduPilot DataFlash log of .*LOG_BITMASK"):
        flight(tmp_path, messages)
    with pytest.raises(LogError, match="no sample of acceleration"):
        flight(tmp_path, {"BAT": {"t": SLOW, "Volt": 12.0 + 0.0 * SLOW}})


@pytest.mark.slow
def test_stamps_of_another_clock_are_dropped_and_told(tmp_path: Path) -> None:
    """Of XKQ alone; from the middle on in milliseconds."""
    base: Any = flown_messages()
    found = flight(tmp_path, flown(XKQ=base["XKQ"] | {"t": SLOW}))
    blob = dataflash(flown_messages(), FLOWN_PARAMS)
    number = 1 + list(KINDS).index("XKQ")
    out, at = bytearray(blob), blob.index(b"\xa3\x95" + bytes([number]), len(blob) // 2)
    while at >= 0:
        stamp = int.from_bytes(out[at + 3 : at + 11], "little")
        out[at + 3 : at + 11] = (stamp + 3_600_000_000).to_bytes(8, "little")
        at = blob.find(b"\xa3\x95" + bytes([number]), at + 1)
    path = tmp_path / "other.bin"
    path.write_bytes(bytes(out))
    odd = read_flight(path)
    assert "stamped over 10 s from what stands next to" in said(odd, "XKQ", "error")
    pd.testing.assert_series_equal(odd.table["acc_x"], found.table["acc_x"], check_index=False)
    assert odd.table["q_w"].count() == pytest.approx(len(SLOW) / 2, abs=12)
