"""One flight, written with the definitions of each release: the same flight table comes out.

Definitions are those of LogStructure.h and Log.cpp of the releases.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_rigs.dataflash_rig import KINDS, Kind, dataflash
from sample_logs import FLOWN_PARAMS, flown_messages, flown_table

from twin.errors import LogError
from twin.frames import to_euler
from twin.logs import Flight, read_flight

TABLE = flown_table()
SLOW = TABLE.iloc[::4]
T = SLOW["time"].to_numpy()
VOLTS, AMPS = 16.4 - 0.02 * T, 12.0 + np.sin(T)
OLD_PARAMS = {
    **{"FRAME": 1.0, "RC3_MIN": 1000.0, "RC3_MAX": 2000.0},
    **{"MOT_THST_EXPO": 0.5, "MOT_THST_MAX": 0.9, "THR_MIN": 100.0},
    **{"MOT_THST_BAT_MAX": 16.8, "MOT_THST_BAT_MIN": 13.2},
}
WEEK, OF_WEEK_MS = 1871, 603_890_000
_BASE = {n: KINDS[n] for n in ("FMT", "UNIT", "FMTU", "MULT")}


@dataclass(frozen=True)
class Release:
    """Messages of a release, and what is particular about them."""

    kinds: Mapping[str, Kind]
    outputs: str = "C"
    params: Mapping[str, float] = field(default_factory=lambda: OLD_PARAMS)
    units: bool = False
    frame: str = "quad x"


def _kinds(clock: str, letter: str, /, **definitions: str) -> dict[str, Kind]:
    """Definitions `letters columns` of messages, `@` standing for the clock."""
    found = {}
    for name, given in definitions.items():
        letters, columns = given.split()
        found[name] = Kind(letters.replace("@", letter), columns.replace("@", clock))
    return {**_BASE, **found}


_CHANNELS = {n: ",".join(f"{{}}{k}" for k in range(1, n + 1)) for n in (4, 8, 12, 14)}
_IMU = "@ffffff @,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
_OLD_GPS = "BIHBcLLeeEefI Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"
_ATT = "@ccccCC @,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"
_NTUN = "@ffffffffff @,DPosX,DPosY,PosX,PosY,DVelX,DVelY,VelX,VelY,DAccX,DAccY"
_CTUN = "@hhhffecchh @,ThrIn,AngBst,ThrOut,DAlt,Alt,BarAlt,DSAlt,SAlt,DCRt,CRt"
_UNSTAMPED = {"PARM": "Nf Name,Value", "MSG": "Z Message", "EV": "B Id", "MODE": "Mh Mode,ThrCrs"}
_STAMPED = {"PARM": "@Nf @,Name,Value", "MSG": "@Z @,Message", "EV": "@B @,Id"}
_NEW_GPS = "@BIHBcLLeEefB @,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,U"
_MAG = "@hhhhhhhhh @,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOfsX,MOfsY,MOfsZ"
_IMU_33 = "@ffffffIIfBB @,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,ErrG,ErrA,Temp,GyHlt,AcHlt"
_IMU_36 = "@ffffffIIfBBHH @,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"
_ATT_SOLO = "@ccccCCCC @,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw"
_EKF1 = "@ccCffffffccc @,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD,GX,GY,GZ"
_NKF1 = "@ccCfffffffccc @,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ"
_CURR_SOLO = "@hhhHfh @,Throttle,Volt,Curr,Vcc,CurrTot,Volt2"
_CURR_31 = "@hIhhhf @,ThrOut,ThrInt,Volt,Curr,Vcc,CurrTot"
_BATTERY_35 = "@fffffcf @,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res"
_NKQ1 = "@ffff @,Q1,Q2,Q3,Q4"
_BARO_32 = "@ffcf @,Alt,Press,Temp,CRt"
_NEW = {"GPS": _NEW_GPS, "MAG": _MAG, "BARO": _BARO_32, **_STAMPED}
RELEASES = {
    "Copter 3.1": Release(
        _kinds(
            "TimeMS",
            "I",
            **_UNSTAMPED,
            IMU=_IMU,
            ATT=_ATT,
            NTUN=_NTUN,
            CTUN=_CTUN,
            GPS=_OLD_GPS,
            MAG=_MAG,
            BARO="@ffc @,Alt,Press,Temp",
            CURR=_CURR_31,
            RCOU="@hhhhhhhh @," + _CHANNELS[8].format(*["Chan"] * 8),
        ),
        "Chan",
    ),
    "Copter 3.2": Release(
        _kinds(
            "TimeMS",
            "I",
            **_UNSTAMPED,
            IMU=_IMU,
            ATT=_ATT,
            EKF1=_EKF1,
            GPS=_OLD_GPS,
            MAG=_MAG,
            BARO=_BARO_32,
            CURR=_CURR_31,
            RCOU="@hhhhhhhh @," + _CHANNELS[8].format(*["Ch"] * 8),
        ),
        "Ch",
    ),
    "Solo": Release(
        _kinds(
            "TimeMS",
            "I",
            PARM="Nf Name,Value",
            MSG="Z Message",
            EV="@B @,Id",
            IMU="@ffffffIIf @,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,ErrG,ErrA,Temp",
            ATT=_ATT_SOLO,
            EKF1=_EKF1,
            GPS=_OLD_GPS,
            MAG=_MAG,
            BARO=_BARO_32,
            CURR=_CURR_SOLO,
            RCOU="@hhhh @," + _CHANNELS[4].format(*["Ch"] * 4),
            **{f"ESC{k}": "@cccc @,RPM,Volt,Curr,Temp" for k in range(1, 5)},
        ),
        "Ch",
    ),
    "Copter 3.3": Release(
        _kinds(
            "TimeUS",
            "Q",
            **_NEW,
            IMU=_IMU_33,
            ATT=_ATT_SOLO,
            EKF1=_EKF1,
            CURR=_CURR_SOLO,
            RCOU="@hhhhhhhhhhhh @," + _CHANNELS[12].format(*["Ch"] * 12),
        ),
        "Ch",
    ),
    "Copter 3.4": Release(
        _kinds(
            "TimeUS",
            "Q",
            **_NEW,
            IMU=_IMU_33,
            ATT=_ATT_SOLO,
            NKF1=_NKF1,
            CURR=_CURR_SOLO,
            RCOU="@HHHHHHHHHHHH @," + _CHANNELS[12].format(*["C"] * 12),
        ),
        params=OLD_PARAMS | {"AHRS_EKF_TYPE": 2.0},
    ),
    "Copter 3.5": Release(
        _kinds(
            "TimeUS",
            "Q",
            **_NEW,
            IMU=_IMU_33,
            ATT=_ATT_SOLO,
            NKF1=_NKF1,
            NKQ1=_NKQ1,
            CURR=_BATTERY_35,
            RCOU="@HHHHHHHHHHHHHH @," + _CHANNELS[14].format(*["C"] * 14),
        ),
        params=FLOWN_PARAMS | {"AHRS_EKF_TYPE": 2.0},
    ),
    "Copter 3.6": Release(
        _kinds(
            "TimeUS",
            "Q",
            **_NEW,
            IMU=_IMU_36,
            ATT=_ATT_SOLO,
            NKF1="@ccCfffffffccce @,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH",
            NKQ1=_NKQ1,
            BAT=_BATTERY_35,
            RCOU="@HHHHHHHHHHHHHH @," + _CHANNELS[14].format(*["C"] * 14),
        ),
        params=FLOWN_PARAMS | {"AHRS_EKF_TYPE": 2.0},
    ),
    "Copter 4.0": Release(
        _kinds(
            "TimeUS",
            "Q",
            **_NEW,
            IMU=_IMU_36,
            ATT="@ccccCCCCB @,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF",
            NKF1="@BccCfffffffccce @,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH",
            BAT="@Bfffffcf @,Instance,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res",
            RCOU="@HHHHHHHHHHHHHH @," + _CHANNELS[14].format(*["C"] * 14),
            **{f"ESC{k}": "@eCCcH @,RPM,Volt,Curr,Temp,CTot" for k in range(1, 5)},
        ),
        params=FLOWN_PARAMS | {"AHRS_EKF_TYPE": 2.0},
    ),
    "Copter 4.1 to 4.5": Release(KINDS, params=FLOWN_PARAMS, units=True),
    "Copter 4.6": Release(
        KINDS | {"ATT": Kind("Qfff", "TimeUS,Roll,Pitch,Yaw", "sddh", "F000")},
        params=FLOWN_PARAMS,
        units=True,
    ),
}


def flown(release: Release) -> dict[str, Any]:
    """Messages of the flight as the release writes them, numbers as they are meant."""
    base, kinds = flown_messages(), release.kinds
    course = {k: v for k, v in base["XKF1"].items() if k != "t"}
    q = SLOW[["q_w", "q_x", "q_y", "q_z"]].to_numpy().T
    roll, pitch, yaw = np.degrees(np.asarray(to_euler(q)))
    signed = kinds["ATT"].letters == "Qccc"
    angles = {"Roll": roll, "Pitch": pitch, "Yaw": yaw if signed else yaw % 360.0}
    outputs = {
        k.replace("C", release.outputs): v for k, v in base["RCOU"].items() if k.startswith("C")
    }
    raw = 100.0 if "h" in kinds.get("CURR", Kind("", "")).letters[:4] else 1.0
    battery = {"t": T, "Volt": raw * VOLTS, "Curr": raw * AMPS}
    place = {"t": T, "Status": 3, "Lat": -35.3623, "Lng": 149.1658, "Alt": 590.0}
    old_week = {"TimeMS": OF_WEEK_MS + 1000.0 * T, "Week": WEEK}
    new_week = {"GMS": OF_WEEK_MS + 1000.0 * T, "GWk": WEEK}
    esc = {
        f"ESC{k}": {"t": T, "RPM": _rpm(k) * (1e-3 if kinds["ESC1"].letters == "Icccc" else 1.0)}
        for k in range(1, 5)
        if f"ESC{k}" in kinds
    }
    every: dict[str, Any] = {
        **{n: base[n] for n in ("IMU", "BARO", "XKQ", "XKF1")},
        "RCOU": {"t": T, **outputs},
        "ATT": {"t": T, **angles},
        **{n: {"t": T, **angles, **course} for n in ("EKF1", "NKF1")},
        "NKQ1": base["XKQ"],
        "NTUN": {
            "t": T,
            **{f"Pos{a}": 100.0 * SLOW[f"pos_{a.lower()}"] for a in "XY"},
            **{f"Vel{a}": 100.0 * SLOW[f"vel_{a.lower()}"] for a in "XY"},
        },
        "CTUN": {"t": T, "Alt": -SLOW["pos_z"], "CRt": -100.0 * SLOW["vel_z"]},
        "MAG": {"t": T, "MagX": 220, "MagY": -20, "MagZ": 430},
        "CURR": battery,
        "BAT": {"t": T, "Volt": VOLTS, "Curr": AMPS},
        "GPS": place | (old_week if kinds is not KINDS and "Week" in kinds["GPS"].names else {}),
        "MSG": {"t": [0.0, 0.0], "Message": ["APM:Copter V3.3 (00000000)", "Frame: QUAD"]},
        "EV": {"t": [0.0], "Id": [10]},
        "MODE": {"t": [0.0], "Mode": [5]},
        **esc,
    }
    if "GWk" in kinds["GPS"].names:
        every["GPS"] |= new_week
    modern = kinds["ATT"].letters in ("Qccc", "Qfff")
    left_out = {"NKF1"} | ({"MODE"} if modern else {"XKQ", "XKF1"})
    return {n: m for n, m in every.items() if n in kinds and (n not in left_out or n == "NKF1")}


def _rpm(motor: int) -> Any:
    """Speed of a motor, a whole number of tens of rpm, as old logs have it."""
    return np.round(600.0 * np.sqrt(SLOW[f"cmd_{motor}"].to_numpy())) * 10.0


def read(tmp_path: Path, blob: bytes) -> Flight:
    path = tmp_path / "log.bin"
    path.write_bytes(blob)
    return read_flight(path)


def written(release: Release, text: bool, **others: Any) -> bytes:
    return dataflash(
        flown(release) | others,
        dict(release.params),
        text=text,
        units=release.units,
        kinds=release.kinds,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "text"),
    [*((n, False) for n in RELEASES), ("Copter 3.1", True), ("Solo", True), ("Copter 3.3", True)],
)
def test_the_same_flight_comes_out_of_every_release(tmp_path: Path, name: str, text: bool) -> None:
    release = RELEASES[name]
    found = read(tmp_path, written(release, text))
    assert [f.message for f in found.findings if f.severity == "error"] == [
        "it ends with the motors running: cut short?"
    ]
    assert found.facts["airframe"] == "quad x"
    assert found.airframe is not None and found.airframe.layout is not None
    assert found.airframe.rotors is not None and found.airframe.rotors.value == 4
    assert found.airframe.place is not None
    assert found.airframe.place.value.year == pytest.approx(2015.887, abs=1e-3)  # 21 November
    clock_s = 1.1e-3 if "TimeMS" in release.kinds["IMU"].names else 1.1e-6
    sizes = {"acc": 1e-5, "gyro": 1e-6, "vel": 0.006, "pos": 1e-4, "cmd": 6e-4, "baro": 0.01}
    for group, atol in sizes.items():
        columns = [c for c in map(str, TABLE) if c.startswith(f"{group}_")]
        t_s, values = found.signal(columns)
        row = np.round(t_s / 0.01).astype(int)
        np.testing.assert_allclose(t_s, 0.01 * row, atol=clock_s)
        np.testing.assert_allclose(values, TABLE[columns].to_numpy()[row], atol=atol)
        assert len(t_s) > 700, group
    t_s, q = found.signal(["q_w", "q_x", "q_y", "q_z"])
    true = TABLE[["q_w", "q_x", "q_y", "q_z"]].to_numpy()[np.round(t_s / 0.01).astype(int)]
    assert np.abs(np.einsum("ij,ij->i", q, true)).min() > 1.0 - 1e-7  # 0.01 deg of a letter c
    for column, truth, atol in (("vbat_v", VOLTS, 0.0051), ("ibat_a", AMPS, 0.0051)):
        t_s, values = found.signal([column])
        np.testing.assert_allclose(values[:, 0], np.interp(t_s, T, truth), atol=atol + 0.001)
    _, mag = found.signal(["mag_x", "mag_y", "mag_z"])
    np.testing.assert_allclose(mag, np.tile([2.2e-5, -2e-6, 4.3e-5], (len(mag), 1)), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n, r in RELEASES.items() if "ESC1" in r.kinds])
def test_speeds_of_both_letters_are_rpm(tmp_path: Path, name: str) -> None:
    """`c` holds thousands of rpm after the divisor of the letter, `e` rpm."""
    found = read(tmp_path, written(RELEASES[name], text=False))
    t_s, rotors = found.signal([f"rotor_{k}" for k in range(1, 5)])
    for k in range(4):
        truth = np.interp(t_s, T, _rpm(k + 1)) * 2.0 * np.pi / 60.0
        np.testing.assert_allclose(rotors[:, k], truth, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frame", "form", "motors", "layout"),
    [
        ("QUAD", 0, 4, "quad plus"),
        ("HEXA", 1, 6, "hexa x"),
        ("OCTA_QUAD", 1, 8, "octaquad x"),
        ("Y6", 10, 6, "y6 y6b"),
        ("TRI", 1, 3, "tri x"),
    ],
)
def test_frame_and_message_name_the_motors(
    tmp_path: Path, frame: str, form: int, motors: int, layout: str
) -> None:
    """Up to Copter 3.4 the motors are the first outputs, of a tricopter 1, 2 and 4."""
    release = RELEASES["Copter 3.3"]
    each = {f"Ch{k}": 1000.0 + 50.0 * k + 10.0 * np.sin(T) for k in range(1, 13)}
    message = {"t": [0.0], "Message": [f"Frame: {frame}"]}
    params = OLD_PARAMS | {"FRAME": float(form)}
    blob = dataflash(
        flown(release) | {"RCOU": {"t": T, **each}, "MSG": message},
        params,
        units=False,
        kinds=release.kinds,
    )
    found = read(tmp_path, blob)
    assert found.facts["airframe"] == layout
    commands = [c for c in map(str, found.table) if c.startswith("cmd_")]
    outputs = [1, 2, 4] if frame == "TRI" else list(range(1, motors + 1))
    np.testing.assert_allclose(
        found.table[commands].dropna().mean(), [0.05 * k for k in outputs], atol=2e-3
    )
    assert found.airframe is not None and found.airframe.rotors is not None
    assert found.airframe.rotors.value == motors
    assert f"Frame: {frame}" in found.airframe.rotors.source


@pytest.mark.parametrize("frame", ["HELI", "SINGLE", "COAX"])
def test_an_old_frame_that_is_no_multirotor_is_named(tmp_path: Path, frame: str) -> None:
    message = {"t": [0.0], "Message": [f"Frame: {frame}"]}
    found = read(tmp_path, written(RELEASES["Copter 3.3"], False, MSG=message))
    assert found.airframe is not None and "copter" in found.airframe.no_multirotor
    assert "cmd_1" not in found.table


def test_a_frame_that_is_nowhere_is_not_guessed(tmp_path: Path) -> None:
    message = {"t": [0.0], "Message": ["APM:Copter V3.3 (00000000)"]}
    found = read(tmp_path, written(RELEASES["Copter 3.3"], False, MSG=message))
    assert "cmd_1" not in found.table
    assert any("names no frame of known motors" in f.message for f in found.findings)


@pytest.mark.slow
def test_thrust_and_battery_by_their_old_names(tmp_path: Path) -> None:
    """THR_MIN 100 of 1000, and 0.9 of what is left above it."""
    found = read(tmp_path, written(RELEASES["Copter 3.3"], text=False)).airframe
    assert found is not None and found.thrust is not None and found.cells is not None
    curve = found.thrust.value
    assert (curve.factor, curve.start, curve.full) == pytest.approx((0.5, 0.1, 0.91))
    assert found.cells.value.count == 4 and found.cells.value.empty_v == pytest.approx(3.3)


@pytest.mark.slow
def test_modes_and_events_without_a_time_have_that_of_their_neighbours(tmp_path: Path) -> None:
    release = RELEASES["Copter 3.2"]
    modes = {"t": [0.0, 12.3], "Mode": [5, 6]}
    found = read(tmp_path, written(release, False, MODE=modes))
    assert found.facts["modes"].startswith("Loiter from 0.0 s, RTL from 12.3 s")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["APM:Plane V3.2", "ArduPlane V4.5", "APM:Rover v2.5"])
def test_firmware_of_other_vehicles_is_named(tmp_path: Path, name: str) -> None:
    message = {"t": [0.0], "Message": [name]}
    found = read(tmp_path, written(RELEASES["Copter 3.3"], False, MSG=message)).airframe
    assert found is not None and found.no_multirotor


def test_a_log_of_px4s_first_logger_is_named(tmp_path: Path) -> None:
    """PX4 up to 1.5 (sdlog2, `.px4log`) wrote other messages in the same container."""
    kinds = {
        "FMT": KINDS["FMT"],
        "PARM": Kind("Nf", "Name,Value"),
        "TIME": Kind("Q", "StartTime"),
        "ATT": Kind("ffffffffff", "qw,qx,qy,qz,Roll,Pitch,Yaw,RollRate,PitchRate,YawRate"),
        "VER": Kind("NZ", "Arch,FwGit"),
    }
    blob = dataflash(
        {"TIME": {"t": T, "StartTime": 1e6 * T}, "ATT": {"t": T, "qw": 1.0}},
        {"SYS_AUTOSTART": 4001.0},
        units=False,
        kinds=kinds,
    )
    with pytest.raises(LogError, match=r"PX4.*sdlog2.*px4log"):
        read(tmp_path, blob)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Solo", "Copter 4.0"])
def test_a_controller_that_reads_half_a_volt_less_is_told(tmp_path: Path, name: str) -> None:
    release = RELEASES[name]
    messages = flown(release)
    for k in range(1, 5):
        messages[f"ESC{k}"] |= {"Volt": VOLTS - (0.5 if k == 3 else 0.0)}
    blob = dataflash(messages, dict(release.params), units=False, kinds=release.kinds)
    told = [f.message for f in read(tmp_path, blob).findings if f.where == "vbat_v"]
    assert len(told) == 1 and "motor 3 reads 15.6" in told[0] and "0.50 V below" in told[0]


@pytest.mark.slow
@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("name", ["MSG", "MODE", "EV", "PARM"])
def test_messages_without_a_time_may_lack_their_columns(
    tmp_path: Path, name: str, text: bool
) -> None:
    """A damaged definition names other columns."""
    blob = written(RELEASES["Copter 3.2"], text)
    for column in (b"Message", b"Mode", b"Id", b"Name,Value"):
        if column.startswith({"MSG": b"Me", "MODE": b"Mo", "EV": b"Id", "PARM": b"Na"}[name][:2]):
            blob = blob.replace(column, b"X" + column[1:])
    assert len(read(tmp_path, blob).table) > 2900


def test_a_low_pass_within_the_sensor_is_told(tmp_path: Path) -> None:
    """Up to Copter 3.2; its delay is not in the log."""
    release = RELEASES["Copter 3.2"]
    params = {**release.params, "INS_MPU6K_FILTER": 20.0}
    blob = dataflash(flown(release), params, units=False, kinds=release.kinds)
    told = [f.where for f in read(tmp_path, blob).findings if "INS_MPU6K_FILTER" in f.message]
    assert told == ["gyro", "acc"]
