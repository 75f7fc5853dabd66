"""Crazyflie uSD logs: a known flight written in the firmware's units and axes comes back as it was;
damage is told; a second decoder reads the same."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_rigs.crazyflie_rig import decoded, flown_kinds, usd_log
from numpy.typing import ArrayLike
from places import DATA, needs
from sample_logs import flown_table

from twin.errors import LogError
from twin.frames import from_euler
from twin.logs import Flight, read_flight
from twin.logs.crazyflie import read_content
from twin.logs.stamps import filter_delay_us

RECORDED = DATA / "crazyflie_motor_delay" / "log10.parquet"
DELAY_S = {"acc": 1e-6 * filter_delay_us(30.0), "gyro": 1e-6 * filter_delay_us(80.0)}


def _read(tmp_path: Path, blob: bytes) -> Flight:
    path = tmp_path / "log00"
    path.write_bytes(blob)
    return read_flight(path)


@pytest.mark.slow
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize(("small", "angles"), [(False, False), (True, True)])
def test_a_flight_comes_back_in_si_ned_and_frd(
    version: int, small: bool, angles: bool, tmp_path: Path
) -> None:
    flight, meant = (
        _read(tmp_path, usd_log(flown_kinds(flown_table(), small, angles), version)),
        flown_table(),
    )
    assert flight.filter_delays_s == DELAY_S
    for group, within in (("acc", 1e-5), ("gyro", 1e-5), ("pos", 6e-4), ("vel", 6e-4)):
        columns = [f"{group}_{a}" for a in "xyz"]
        t, values = flight.signal(columns)
        meant_t = meant["time"].to_numpy() - DELAY_S.get(group, 0.0)
        kept = meant_t >= 0.0
        np.testing.assert_allclose(t, meant_t[kept], atol=6e-4 if version == 1 else 1e-6)
        np.testing.assert_allclose(values, meant.loc[kept, columns], atol=within)
    _, q = flight.signal(["q_w", "q_x", "q_y", "q_z"])
    sign = np.sign(np.sum(q * meant[["q_w", "q_x", "q_y", "q_z"]].to_numpy(), axis=1))
    np.testing.assert_allclose(q * sign[:, None], meant[["q_w", "q_x", "q_y", "q_z"]], atol=1e-6)
    _, commands = flight.signal([f"cmd_{i}" for i in range(1, 5)])
    np.testing.assert_allclose(commands, meant[[f"cmd_{i}" for i in range(1, 5)]], atol=1e-5)
    _, rotors = flight.signal(["rotor_4"])
    np.testing.assert_allclose(rotors, 15004 * 2 * np.pi / 60)
    _, rest = flight.signal(["baro_pa", "vbat_v"])
    np.testing.assert_allclose(rest[:, 0], meant["baro_pa"], atol=0.01)
    np.testing.assert_allclose(rest[:, 1], 3.9)
    phase = flight.table["phase"]
    assert set(phase[flight.table["time"] < 1.9]) == {"ground"}
    assert "ground" not in set(phase[(flight.table["time"] > 2.1) & (flight.table["time"] < 27.9)])
    assert [f for f in flight.findings if f.severity == "error"] == []
    assert flight.facts["format"] == f"Crazyflie uSD log, version {version}"


def test_the_attitude_says_where_the_nose_points(tmp_path: Path) -> None:
    """Nose up, and to the left, in the firmware's words: pitch + and yaw +."""
    t = 0.01 * np.arange(50)
    log = {"a": {"t": ("d", t), **{f"stabilizer.{n}": ("f", 0 * t) for n in ("roll",)}}}
    log["a"] |= {"stabilizer.pitch": ("f", 0 * t + 10.0), "stabilizer.yaw": ("f", 0 * t + 90.0)}
    _, q = _read(tmp_path, usd_log(log)).signal(["q_w", "q_x", "q_y", "q_z"])
    np.testing.assert_allclose(q[0], from_euler(0.0, np.deg2rad(10.0), -np.pi / 2), atol=1e-7)


def test_a_second_decoder_reads_the_same(tmp_path: Path) -> None:
    blob = usd_log(flown_kinds(flown_table()))
    meant = decoded(blob)
    for events in read_content(tmp_path / "log00", blob).events:
        other = meant[events.kind.name]
        np.testing.assert_array_equal(events.t_us, other["t_us"])
        for name in events.kind.variables:
            np.testing.assert_array_equal(events.values((name,))[:, 0], other[name])


@pytest.mark.slow
def test_what_was_cut_is_told(tmp_path: Path) -> None:
    whole = usd_log(flown_kinds(flown_table()))
    found = {f.message for f in _read(tmp_path, whole[: len(whole) // 2]).findings}
    assert any("of which nothing can be made: the log was cut or damaged" in m for m in found)
    unsealed = _read(tmp_path, usd_log(flown_kinds(flown_table()), sealed=False)).findings
    assert any("its checksum is not that of its content" in f.message for f in unsealed)
    turned = bytearray(whole)
    turned[len(whole) // 2] ^= 0x10
    flight = _read(tmp_path, bytes(turned))
    assert any(f.severity == "error" and f.where == "log" for f in flight.findings)


@pytest.mark.parametrize(
    ("blob", "told"),
    [
        (b"\xbc\x02\x00\x01", "head of the Crazyflie log cannot be read"),
        (b"\xbc\x02\x00\x01\x00\x07\x00name", "a name without an end"),
        (b"\xbc\x02\x00\x01\x00\x07\x00n\0\x01\x00acc.x(s)\0", "of no known type"),
        (b"\xbc\x02\x00\x01\x00\x07\x00n\0\x02\x00a.x(f)\0a.x(f)\0", "head of the Crazyflie log"),
        (b"\xbc\x02\x00\x02\x00" + 2 * b"\x07\x00n\0\x00\x00", "two kinds of number 7"),
        (b"\xbc\x02\x00\x01\x00\x07\x00n\0\xff\xff", "more than 10000 variables"),
        (b"\xbc\x02\x00\x00\x00", "without a single event"),
        (usd_log({"a": {"t": ("d", [0.0, 0.1]), "range.zrange": ("H", [1, 2])}}), "range.zrange"),
    ],
)
def test_what_is_no_flight_is_refused(blob: bytes, told: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"log00: ") as error:
        _read(tmp_path, blob)
    assert told in str(error.value)


@pytest.mark.slow
@settings(max_examples=150)
@given(data=st.data())
def test_changed_bytes_raise_nothing_but_a_log_error(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    t = 0.01 * np.arange(40)
    fixed: dict[str, tuple[str, ArrayLike]] = {"t": ("d", t), "acc.x": ("f", 0 * t)}
    blob = bytearray(usd_log({"f": fixed | {"acc.y": ("e", 0 * t), "acc.z": ("d", 1 + 0 * t)}}))
    for _ in range(data.draw(st.integers(1, 6))):
        blob[data.draw(st.integers(3, len(blob) - 1))] = data.draw(st.integers(0, 255))
    try:
        flight = _read(tmp_path_factory.mktemp("changed"), bytes(blob))
    except LogError as error:
        assert len(str(error)) > 20
    else:
        assert flight.findings


@needs(RECORDED.is_file(), f"{RECORDED.name} is not here")
def test_a_recorded_flight_hovers_in_si(tmp_path: Path) -> None:
    """1 kHz of a real Crazyflie, written as its card had it: at rest it weighs one g."""
    told = pd.read_parquet(RECORDED)[:6000]
    fixed: dict[str, tuple[str, ArrayLike]] = {"t": ("d", told["t"] - told["t"].iloc[0])}
    fixed |= {f"acc.{a}": ("f", told[f"acc_{a}_g"]) for a in "xyz"}
    fixed |= {f"gyro.{a}": ("f", told[f"gyro_{a}_dps"]) for a in "xyz"}
    fixed |= {f"motor.m{i}": ("H", told[f"motor_{i}"]) for i in range(1, 5)}
    flight = _read(tmp_path, usd_log({"fixedFrequency": fixed}, version=1))
    still = told["motor_1"].to_numpy() == 0
    _, acc = flight.signal(["acc_x", "acc_y", "acc_z"])
    assert np.median(acc[: still.argmin() or len(acc), 2]) == pytest.approx(-9.81, abs=0.2)
