"""Betaflight Blackbox logs: a known flight written in the firmware's units, axes and encodings
comes back as it was; damage is told; of several flights one is read."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_rigs import blackbox_rig as rig
from log_rigs.blackbox_rig import (
    BOOT_US,
    Part,
    blackbox,
    float_bits,
    flown_main,
    mode_event,
    resume_event,
)
from numpy.typing import ArrayLike
from sample_logs import flown_table

from twin.errors import LogError
from twin.logs import Flight, read_flight
from twin.logs.betaflight import header as encodings
from twin.logs.betaflight.frames import read_frames
from twin.logs.betaflight.header import flights, read_header
from twin.logs.stamps import filter_delay_us

FIX = (50, 12, 1000, -2000, 4321, 100, 900, 150, -20, 5)
"""us after the frame, satellites, 1e-7 degrees from home, dm, cm/s, 0.1 degrees, cm/s."""
HOME = (473_977_420, 85_455_940)


def _read(tmp_path: Path, *parts: Part) -> Flight:
    path = tmp_path / "LOG00001.BFL"
    path.write_bytes(blackbox(*parts))
    return read_flight(path)


def _told(flight: Flight, words: str) -> list[Any]:
    return [f for f in flight.findings if re.search(words, f.message)]


# -- encodings ------------------------------------------------------------------------------

WORD = st.integers(-(2**31), 2**31 - 1)
SHORT = st.one_of(st.integers(-9, 9), st.integers(-130, 130), st.integers(-(2**15), 2**15 - 1))


@given(value=WORD)
def test_an_integer_of_seven_bits_a_byte_comes_back(value: int) -> None:
    blob = rig.svb(value)
    assert encodings.signed_vb(blob + b"\xff", 0) == (value, len(blob))
    blob = rig.uvb(value)
    assert encodings.unsigned_vb(blob, 0) == (value % 2**32, len(blob))


@given(values=st.lists(st.one_of(SHORT, WORD), min_size=3, max_size=3))
def test_three_in_a_group_come_back(values: list[int]) -> None:
    blob = rig.tag2_3s32(values)
    assert encodings.tag2_3s32(blob, 0) == (values, len(blob))


@given(values=st.lists(SHORT, min_size=4, max_size=4))
def test_four_in_a_group_come_back(values: list[int]) -> None:
    blob = rig.tag8_4s16(values)
    assert encodings.tag8_4s16(blob, 0) == (values, len(blob))


@given(values=st.lists(st.one_of(st.just(0), WORD), min_size=1, max_size=8))
def test_up_to_eight_in_a_group_come_back(values: list[int]) -> None:
    blob = rig.tag8_8svb(values)
    assert encodings.tag8_8svb(blob, 0, len(values)) == (values, len(blob))


def test_groups_of_the_documentation() -> None:
    """By hand: 4 and 16 bits share a byte; in data version 1 they do not."""
    assert encodings.tag8_4s16(bytes((0b00_00_11_01, 0x51, 0x23, 0x40)), 0) == (
        [5, 0x1234, 0, 0],
        4,
    )
    assert encodings.tag8_4s16_v1(bytes((0b11_10_01_01, 0xF5, 0x80, 0x34, 0x12)), 0)[0] == [
        5,
        -1,
        -128,
        0x1234,
    ]
    assert encodings.tag2_3s32(bytes((0b00_01_10_11,)), 0) == ([1, -2, -1], 1)
    assert encodings.neg_14bit(rig.uvb(0x3FFF), 0) == (1, 2)


@pytest.mark.parametrize("step", ["1", "2", "8", "1/2", "1/4"])
def test_every_field_comes_back_to_the_last_bit(step: str) -> None:
    """With I frames alone, P frames of each loop and of some, and frames of other kinds between."""
    table = flown_table()[:700]
    main = flown_main(table) | {f"servo[{k}]": 1500 + k * np.sin(table["time"]) for k in range(8)}
    part = Part(
        main,
        {"P interval": step},
        slow=[(1, (1, 2, 1, 0, 1)), (300, (3, 0, 0, 1, 1))],
        gps=[(0, HOME, FIX), (200, None, FIX)],
        events=[(300, mode_event(3, 1))],
        first=64,
    )
    blob = blackbox(part)
    header = read_header(blob)
    recording = read_frames(header, blob[header.size :])
    for name, values in main.items():
        at = recording.main.names.index(name)
        meant = np.round(np.asarray(values, dtype=np.float64))
        np.testing.assert_array_equal(recording.main.values[:, at], meant, err_msg=name)
    assert recording.slow.values.tolist() == [[1, 2, 1, 0, 1], [3, 0, 0, 1, 1]]
    assert recording.gps.values[0, 2] == HOME[0] + FIX[2]
    assert [e.kind for e in recording.events] == [30, 255]
    damage = recording.damage
    assert damage.ended and not (damage.lost or damage.rejected or damage.missing or damage.cut)


def test_times_go_on_where_the_counter_of_the_firmware_begins_anew(tmp_path: Path) -> None:
    main = flown_main(flown_table()[:500]) | {"time": 2**32 - 2_000_000 + 10_000.0 * np.arange(500)}
    flight = _read(tmp_path, Part(main))
    t, _ = flight.signal(["gyro_x"])
    np.testing.assert_allclose(t, 0.01 * np.arange(500), atol=1e-6)


# -- the flight table -----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("fine", [False, True])
def test_a_flight_comes_back_in_si_ned_and_frd(fine: bool, tmp_path: Path) -> None:
    meant = flown_table()
    high = {"blackbox_high_resolution": str(int(fine))}
    flight = _read(tmp_path, Part(flown_main(meant, fine), high))
    delay_s = {"acc": 1e-6 * filter_delay_us(25.0), "gyro": 0.0}
    assert flight.filter_delays_s == {"acc": delay_s["acc"]}
    for group, within in (("acc", 0.5 * 9.81 / 2048), ("gyro", np.deg2rad(0.05 if fine else 0.5))):
        columns = [f"{group}_{a}" for a in "xyz"]
        t, values = flight.signal(columns)
        meant_t = meant["time"].to_numpy() - delay_s[group]
        kept = meant_t >= 0.0
        np.testing.assert_allclose(t, meant_t[kept], atol=1e-6)
        np.testing.assert_allclose(values, meant.loc[kept, columns], atol=1.01 * within)
    _, q = flight.signal(["q_w", "q_x", "q_y", "q_z"])
    sign = np.sign(np.sum(q * meant[["q_w", "q_x", "q_y", "q_z"]].to_numpy(), axis=1))
    np.testing.assert_allclose(q * sign[:, None], meant[["q_w", "q_x", "q_y", "q_z"]], atol=5e-5)
    _, commands = flight.signal([f"cmd_{i}" for i in range(1, 5)])
    np.testing.assert_allclose(commands, meant[[f"cmd_{i}" for i in range(1, 5)]], atol=0.51 / 1999)
    t, rotors = flight.signal(["rotor_3"])
    erpm = np.round(720 + 5 * np.sin(t))
    np.testing.assert_allclose(rotors[:, 0], erpm * 100 / 7 * 2 * np.pi / 60)
    t, baro = flight.signal(["baro_pa"])
    np.testing.assert_allclose(baro[:, 0], np.interp(t, meant["time"], meant["baro_pa"]), atol=0.07)
    t, volts = flight.signal(["vbat_v"])
    np.testing.assert_allclose(volts[:, 0], 0.01 * np.round(1630 - 2 * t), atol=1e-9)
    _, amperes = flight.signal(["ibat_a"])
    assert np.ptp(amperes) == pytest.approx(0.2, abs=0.01)
    assert amperes.mean() == pytest.approx(12.5, abs=0.1)
    assert [f for f in flight.findings if f.severity != "info"] == []


@pytest.mark.slow
def test_gyroscope_and_attitude_agree(tmp_path: Path) -> None:
    """Signs of all three axes at once: the integrated rates are the attitude's, so that no doubt of
    frames is raised; turned about, it is."""
    table = flown_table()
    assert not _told(
        _read(tmp_path, Part(flown_main(table, True), {"blackbox_high_resolution": "1"})),
        "axes|frame|attitude",
    )
    main = flown_main(table) | {"gyroADC[2]": -np.asarray(flown_main(table)["gyroADC[2]"])}
    flight = _read(tmp_path, Part(main))
    assert [f for f in flight.findings if f.severity == "error"]


def test_the_unfiltered_gyroscope_comes_first(tmp_path: Path) -> None:
    main = flown_main(flown_table()[:600])
    main |= {f"gyroUnfilt[{k}]": 2 * np.asarray(main[f"gyroADC[{k}]"]) for k in range(3)}
    flight = _read(tmp_path, Part(main))
    assert flight.facts["gyro from"] == "gyroUnfilt, before the filters"
    assert flight.airframe is not None and "low-pass 500 Hz" in flight.airframe.filters
    assert flight.airframe.gyro_cutoff_hz is None


@pytest.mark.slow
def test_the_scale_of_the_gyroscope_is_that_of_the_head(tmp_path: Path) -> None:
    main = flown_main(flown_table()[:600])
    one = _read(tmp_path, Part(main)).signal(["gyro_x"])[1]
    two = _read(tmp_path, Part(main, {"gyro_scale": float_bits(2.0)})).signal(["gyro_x"])[1]
    np.testing.assert_allclose(two, 2 * one)
    flight = _read(tmp_path, Part(main, {"gyro_scale": "many"}))
    assert _told(flight, "gyro_scale 'many', no number") and not flight.has("gyro_x")


@pytest.mark.parametrize(
    ("settings", "raw", "command"),
    [
        ({}, (48, 158, 1047.5, 2047), (0.0, 110 / 1999, 0.5, 1.0)),
        ({}, (0, 47, 48, 2047), (0.0, 0.0, 0.0, 1.0)),
        (
            {"motor_pwm_protocol": "1", "motorOutput": "1070,2000", "maxthrottle": "2000"},
            (1000, 1070, 1500, 2000),
            (0.0, 0.07, 0.5, 1.0),
        ),
        (
            {"motor_pwm_protocol": "", "motorOutput": "1070,1900", "maxthrottle": "1900"},
            (1000, 1090, 1450, 1900),
            (0.0, 0.1, 0.5, 1.0),
        ),
    ],
)
def test_motor_outputs_become_commands(
    settings: dict[str, str], raw: tuple[float, ...], command: tuple[float, ...], tmp_path: Path
) -> None:
    main = flown_main(flown_table()[:300])
    main |= {f"motor[{k}]": np.full(300, value) for k, value in enumerate(raw)}
    _, given = _read(tmp_path, Part(main, settings)).signal([f"cmd_{i}" for i in range(1, 5)])
    np.testing.assert_allclose(given[0], command, atol=0.51 / 900)


@pytest.mark.slow
def test_the_sense_of_the_rotors_is_seen_in_the_motors(tmp_path: Path) -> None:
    main = flown_main(flown_table())
    flight = _read(tmp_path, Part(main))
    assert flight.airframe is not None and flight.airframe.layout is not None
    layout = flight.airframe.layout
    assert layout.direction.tolist() == [1.0, -1.0, -1.0, 1.0]
    assert np.sign(layout.position[:, :2]).tolist() == [[-1, 1], [1, 1], [-1, -1], [1, -1]]
    assert flight.facts["propellers"].startswith("not reversed")
    turned = main | {"axisI[2]": -np.asarray(main["axisI[2]"])}
    out = _read(tmp_path, Part(turned))
    assert out.facts["propellers"].startswith("reversed")
    assert out.airframe is not None and out.airframe.layout is not None
    assert out.airframe.layout.direction.tolist() == [-1.0, 1.0, 1.0, -1.0]
    without = {n: v for n, v in main.items() if not n.startswith("axis")}
    assert _told(_read(tmp_path, Part(without)), "does not give yaw_motors_reversed")
    wrong = main | {"axisI[0]": -np.asarray(main["axisI[0]"])}
    other = _read(tmp_path, Part(wrong))
    assert _told(other, "do not follow the controllers as in QUADX")
    assert other.airframe is not None and other.airframe.layout is None


@pytest.mark.slow
def test_rotors_that_are_silent_are_left_out(tmp_path: Path) -> None:
    main = flown_main(flown_table()[:400])
    speeds = np.asarray(main["eRPM[1]"]).copy()
    speeds[:20] = 0.0
    flight = _read(tmp_path, Part(main | {"eRPM[1]": speeds}))
    assert _told(flight, "with a command reports no speed")[0].count == 20
    assert len(flight.signal(["rotor_1"])[0]) == 380
    gone = _read(tmp_path, Part(main | {"eRPM[1]": 0.0 * speeds}))
    assert _told(gone, "reports no speed in 100 %") and not gone.has("rotor_1")
    older = {n.replace("eRPM", "eRPM(/100)"): v for n, v in main.items()}
    assert _read(tmp_path, Part(older)).has("rotor_4")
    assert _told(_read(tmp_path, Part(main, {"motor_poles": ""})), "motor_poles ''")


@pytest.mark.slow
def test_satellites_give_a_course(tmp_path: Path) -> None:
    fixes = [
        (k, HOME if k == 0 else None, (50, 12, k, 2 * k, 4321 + k // 10, 0, 0, 150, -20, 5))
        for k in range(0, 600, 20)
    ]
    flight = _read(tmp_path, Part(flown_main(flown_table()[:600]), gps=fixes))
    t, pos = flight.signal(["pos_x", "pos_y", "pos_z"])
    np.testing.assert_allclose(t, 0.01 * np.arange(0, 600, 20) + 5e-5, atol=1e-6)
    north = np.deg2rad(1e-7 * 580) * 6_371_000
    east = np.deg2rad(1e-7 * 1160) * 6_371_000 * np.cos(np.deg2rad(47.397742))
    np.testing.assert_allclose(pos[-1], (north, east, -5.8), atol=1e-3)
    _, vel = flight.signal(["vel_x", "vel_y", "vel_z"])
    np.testing.assert_allclose(vel[0], (1.5, -0.2, 0.05))
    place = flight.airframe and flight.airframe.place
    assert place and np.rad2deg(place.value.latitude_rad) == pytest.approx(47.397742)
    assert place.value.year == pytest.approx(2025 + 5 / 12, abs=1e-3)
    assert flight.indoors is False
    few = [(k, home, (fix[0], 3, *fix[2:])) for k, home, fix in fixes]
    poor = _read(tmp_path, Part(flown_main(flown_table()[:600]), gps=few))
    assert _told(poor, "fixes left out")[0].count == 30 and not poor.has("pos_x")


@pytest.mark.slow
def test_what_the_autopilot_says(tmp_path: Path) -> None:
    part = Part(
        flown_main(flown_table()),
        slow=[(1, (1, 0, 0, 1, 1)), (1000, (1, 0, 1, 0, 0)), (1200, (1, 0, 0, 1, 1))],
        events=[(500, mode_event(3, 1)), (2000, mode_event(1, 3)), (2990, b"\x0f\x05")],
    )
    told = _read(tmp_path, part).autopilot
    assert told is not None
    assert [(m.name, round(m.start_s, 2)) for m in told.modes[:2]] == [
        ("ACRO", 0.0),
        ("ANGLE", 4.99),
    ]
    (failsafe,) = told.failsafes
    assert failsafe.name == "signal of the receiver lost"
    assert failsafe.start_s == pytest.approx(9.99)
    assert told.armed[0].end_s == pytest.approx(29.99)
    assert [m.text for m in told.messages] == ["disarmed: crash protection"] and told.messages[
        0
    ].grave
    assert {f.source: f.frequency_hz for f in told.filters} == {
        "gyro_lpf2_static_hz": 500.0,
        "rpm_filter_min_hz": 100.0,
        "acc_lpf_hz": 25.0,
    }
    setpoint = told.setpoint(("gyro_x", "gyro_y", "gyro_z"))
    assert setpoint is not None
    np.testing.assert_allclose(
        setpoint.values, flown_table()[["gyro_x", "gyro_y", "gyro_z"]], atol=np.deg2rad(0.51)
    )


# -- damage ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_of_several_flights_the_longest_is_read(tmp_path: Path) -> None:
    short, long = flown_main(flown_table()[:300]), flown_main(flown_table()[:900])
    flight = _read(tmp_path, Part(short), Part(long), Part(short, ended=False))
    assert len(flight.signal(["gyro_x"])[0]) == 900
    assert flight.facts["flight in the file"] == "2 of 3"
    assert _told(flight, "holds 3 flights; the longest is read, number 2")[0].count == 2
    blob = blackbox(Part(short), Part(long))
    assert len(flights(blob)) == 2
    unread = blob.replace(b"H Field P encoding:9,0", b"H Field P encoding:99,0")
    (tmp_path / "x").write_bytes(unread)
    flight = read_flight(tmp_path / "x")
    assert _told(flight, "encoding 99 is not known")


@pytest.mark.slow
def test_a_flipped_byte_and_a_cut_are_told(tmp_path: Path) -> None:
    whole = blackbox(Part(flown_main(flown_table())))
    path = tmp_path / "a.bbl"
    path.write_bytes(whole[: len(whole) * 2 // 3])
    flight = read_flight(path)
    assert _told(flight, "does not end as Betaflight ends a log")
    assert 0.6 < flight.table["time"].iloc[-1] / 30.0 < 0.7
    middle = len(whole) // 2
    path.write_bytes(whole[:middle] + b"\x05" * 40 + whole[middle + 40 :])
    flight = read_flight(path)
    assert _told(flight, "of which nothing can be made") or _told(flight, "were lost")
    assert _told(flight, "frames not used, the whole frame that they build on was lost")
    t, rates = flight.signal(["gyro_x"])
    assert 2960 < len(t) < 3000 and np.abs(rates).max() < 3.0


def _frames(first: int, end: int, ended: bool = False) -> bytes:
    """Frames of the known flight from one on, without the head."""
    main = flown_main(flown_table()[first:end])
    blob = blackbox(Part(main, ended=ended, first=first))
    return blob[read_header(blob).size :]


@pytest.mark.slow
def test_missing_and_doubled_frames_are_told(tmp_path: Path) -> None:
    """At whole frames, where no byte is wrong: by the numbers of the loops."""
    begin = blackbox(Part(flown_main(flown_table()[:640]), ended=False))
    path = tmp_path / "a.bbl"
    path.write_bytes(begin + _frames(800, 960, True))
    flight = read_flight(path)
    assert next((f.message, f.count) for f in flight.findings if f.severity != "info") == (
        "frames missing, by their numbers",
        160,
    )
    assert _told(flight, "gaps, the longest of 1.61 s after 6.39 s")
    assert len(flight.signal(["gyro_x"])[0]) == 800
    path.write_bytes(begin + _frames(608, 640) + _frames(640, 960, True))
    flight = read_flight(path)
    assert _told(flight, "whose time or number jumps or runs backward")[0].count == 1
    assert _told(flight, "whole frame that they build on was lost")[0].count == 31
    assert len(flight.signal(["gyro_x"])[0]) == 960


def test_a_jump_of_the_clock_is_followed_where_it_lasts(tmp_path: Path) -> None:
    """One I frame of another time is not used; from a second that goes on from it, all are."""
    main = {n: np.asarray(v) for n, v in flown_main(flown_table()[:960]).items()}
    main["time"] = np.where(np.arange(960) < 640, main["time"], main["time"] + 30e6)
    flight = _read(tmp_path, Part(main))
    assert _told(flight, "whose time or number jumps")[0].count == 1
    assert len(flight.signal(["gyro_x"])[0]) == 960 - 32
    assert _told(flight, "gaps, the longest of 30.3 s")


@pytest.mark.slow
def test_a_pause_that_the_pilot_made_is_a_pause(tmp_path: Path) -> None:
    table = flown_table()
    main = {n: np.asarray(v) for n, v in flown_main(table).items()}
    main["time"] = np.where(np.arange(3000) < 1600, main["time"], main["time"] + 15e6)
    loop = resume_event(1600, BOOT_US + 31_000_000)
    flight = _read(tmp_path, Part(main, events=[(1600, loop)]))
    assert _told(flight, "gaps, the longest of 15 s .*paused by a switch 1 times")
    assert len(flight.signal(["gyro_x"])[0]) == 3000


def test_filling_of_a_flash_chip_is_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.bbl"
    path.write_bytes(blackbox(Part(flown_main(flown_table()[:300]))) + 5000 * b"\xff")
    assert not [f for f in read_flight(path).findings if f.severity != "info"]
    path.write_bytes(blackbox(Part(flown_main(flown_table()[:300]))) + b"more")
    assert _told(read_flight(path), "bytes behind the end")[0].count == 4


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"Firmware revision": "INAV 7.1.0 (abc) MATEKF405"}, "a Blackbox log of INAV"),
        ({"I interval": "0"}, "I interval 0"),
        ({"P interval": "often"}, "P interval 'often'"),
    ],
)
def test_what_is_not_known_is_refused(settings: dict[str, str], told: str, tmp_path: Path) -> None:
    main = flown_main(flown_table()[:100])
    path = tmp_path / "a.bbl"
    blob = blackbox(Part(main))
    for name, value in settings.items():
        line = f"H {name}:{rig.SETTINGS[name]}\n".encode()
        assert line in blob
        blob = blob.replace(line, f"H {name}:{value}\n".encode())
    path.write_bytes(blob)
    with pytest.raises(LogError, match=r"a\.bbl: ") as error:
        read_flight(path)
    assert told in str(error.value)


def test_nothing_of_the_motion_is_an_error(tmp_path: Path) -> None:
    main: dict[str, ArrayLike] = {"time": 1e4 * np.arange(50), "vbatLatest": np.full(50, 1600)}
    with pytest.raises(LogError, match="Enable the fields GYRO, ACC and MOTOR"):
        _read(tmp_path, Part(main))


SMALL = blackbox(
    Part(flown_main(flown_table()[:80]), slow=[(3, (1, 0, 0, 1, 1))], gps=[(9, HOME, FIX)])
)


@pytest.mark.slow
@settings(max_examples=150)
@given(data=st.data())
def test_changed_bytes_raise_nothing_but_a_log_error(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    blob = bytearray(SMALL)
    for _ in range(data.draw(st.integers(1, 6))):
        blob[data.draw(st.integers(18, len(blob) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("changed") / "a.bbl"
    path.write_bytes(blob)
    try:
        flight = read_flight(path)
    except LogError as error:
        assert len(str(error)) > 20
    else:
        assert np.all(np.diff(flight.table["time"]) > 0)
