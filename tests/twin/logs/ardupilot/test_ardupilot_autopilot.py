"""What ArduPilot says of its flight: as pymavlink decodes the same log, and as planted."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_rigs.dataflash_rig import KINDS, Kind, dataflash
from places import DATA, needs, needs_package
from sample_logs import FLOWN_PARAMS, flown_messages

from twin.frames import from_euler
from twin.logs import read_flight
from twin.logs.autopilot import Autopilot, Filter, Setpoint
from twin.logs.columns import GYRO, POS, QUAT, VEL

FOLDER = DATA / "quiver_pt1"
REPORTED = KINDS | {
    "ATT": Kind("Qcccccc", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw", "sddddhh", "FBBBBBB"),
    "RATE": Kind("Qffffff", "TimeUS,RDes,R,PDes,P,YDes,Y", "skkkkkk", "F------"),
    **{
        f"PSC{a}": Kind("Qfffff", f"TimeUS,TP{a},P{a},DV{a},TV{a},V{a}", "smmnnn", "F00000")
        for a in "NED"
    },
}
T = np.arange(0.0, 28.0, 0.1)


def planted(tmp_path: Path, params: dict[str, float] | None = None, **more: Any) -> Autopilot:
    """The flown flight, with what `more` says of its autopilot."""
    path = tmp_path / "log.bin"
    path.write_bytes(
        dataflash(flown_messages() | more, FLOWN_PARAMS | (params or {}), kinds=REPORTED)
    )
    flight = read_flight(path)
    assert flight.autopilot is not None
    return flight.autopilot


def test_modes_failsafes_and_messages_as_planted(tmp_path: Path) -> None:
    """A failsafe ends with code 0 or with the record; what does not last is a message."""
    found = planted(
        tmp_path,
        MODE={"t": [1.0, 4.0, 9.0], "Mode": [0, 5, 77], "ModeNum": [0, 5, 77]},
        ERR={"t": [5.0, 6.0, 7.0, 8.0], "Subsys": [5, 10, 5, 6], "ECode": [1, 4, 0, 1]},
        MSG=[{"t": 2.0, "Message": "</script> <b>"}],
    )
    begin = found.modes[1].start_s
    assert [m.name for m in found.modes] == ["Stabilize", "Loiter", "mode 77"]
    assert [m.start_s - begin for m in found.modes[1:]] == pytest.approx([0.0, 5.0])
    radio, battery = found.failsafes
    assert (radio.name, battery.name) == ("radio failsafe", "battery failsafe")
    assert [radio.start_s - begin, radio.end_s - begin] == pytest.approx([1.0, 3.0])
    assert battery.start_s - begin == pytest.approx(4.0)
    assert battery.end_s > 25.0
    assert [(m.level, m.text) for m in found.messages] == [
        ("", "</script> <b>"),
        ("error", "flight mode, code 4"),
    ]


def test_setpoints_as_planted(tmp_path: Path) -> None:
    """In SI; nothing is asked for of north and east while their controller rests."""
    rest = T[(T > 10.0) & (T < 20.0)]
    along = {f"TP{a}": k + np.sin(T) for k, a in enumerate("NED")}
    found = planted(
        tmp_path,
        ATT={"t": T, "DesRoll": 10 + 0 * T, "DesPitch": -5 + 0 * T, "DesYaw": 90 + 0 * T},
        RATE={"t": T, "RDes": 90 + 0 * T},
        PSCN={"t": rest, "TPN": np.sin(rest), "DVN": 2 + 0 * rest, "TVN": 3 + 0 * rest},
        PSCE={"t": rest + 1e-4, "TPE": 1 + np.sin(rest)},
        PSCD={"t": T, "TPD": along["TPD"], "DVD": 0.5 + 0 * T},
    )
    position, velocity, attitude, rates = (found.setpoint(c) for c in (POS, VEL, QUAT, GYRO))
    assert position and velocity and attitude and rates
    shift = float(T[-1] - position.t_s[-1])
    t = position.t_s + shift
    flown = (t > 10.05) & (t < 19.95)
    assert np.allclose(position.values[flown], np.sin(t[flown])[:, None] + [0, 1, 2], atol=1e-5)
    away = (t < 9.7) | (t > 20.3)
    assert np.isnan(position.values[away, :2]).all()
    assert np.isfinite(position.values[:, 2]).all()
    assert np.allclose(velocity.values[:, 2], 0.5)
    assert np.allclose(
        velocity.values[flown, 0], 2.0
    )  # desired, before what the position loop adds
    expected = np.asarray(from_euler(*np.radians([10.0, -5.0, 90.0])))
    assert np.allclose(attitude.values, expected, atol=1e-6)
    assert np.allclose(rates.values, [np.pi / 2, 0.0, 0.0], atol=1e-6)


def test_filters_by_their_parameters(tmp_path: Path) -> None:
    found = planted(
        tmp_path,
        {
            **{"INS_GYRO_FILTER": 20.0, "INS_ACCEL_FILTER": 0.0, "INS_HNTC2_ENABLE": 0.0},
            **{"INS_HNTCH_ENABLE": 1.0, "INS_HNTCH_FREQ": 70.0, "INS_HNTCH_HMNCS": 5.0},
            **{"INS_HNTCH_MODE": 3.0, "INS_NOTCH_ENABLE": 1.0, "INS_NOTCH_FREQ": 50.0},
        },
    )
    assert found.filters == (
        Filter("gyro", "low-pass", 20.0, "INS_GYRO_FILTER"),
        Filter("gyro", "notch", 50.0, "INS_NOTCH_FREQ"),
        Filter("gyro", "tracking notch", 70.0, "INS_HNTCH_FREQ"),
        Filter("gyro", "tracking notch", 210.0, "INS_HNTCH_FREQ"),
    )


@needs(FOLDER.is_dir(), "no quiver_pt1: set UAVTWIN_DATA")
@needs_package("pymavlink")
@pytest.mark.slow
@pytest.mark.parametrize("number", ["80", "83"])
def test_recorded_logs_as_pymavlink_decodes_them(number: str) -> None:
    from pymavlink import DFReader

    path = FOLDER / f"pt1_000000{number}.BIN"
    flight = read_flight(path)
    found = flight.autopilot
    assert found is not None
    start_s = float(flight.facts["clock"].split()[4])
    said: dict[str, list[dict[str, Any]]] = defaultdict(list)
    reader = DFReader.DFReader_binary(str(path), zero_time_base=True)
    while message := reader.recv_match(type=["MODE", "ERR", "MSG", "PARM", "ATT", "RATE", "ARM"]):
        said[message.get_type()].append(message.to_dict())
    reader.close()
    end_s = flight.time_s[-1]

    def t(message: dict[str, Any]) -> float:
        return float(message["TimeUS"] * 1e-6 - start_s)

    names = {2: "AltHold", 16: "PosHold"}
    assert [m.name for m in found.modes] == [names[m["ModeNum"]] for m in said["MODE"]]
    starts = [max(t(m), 0.0) for m in said["MODE"]]
    assert [m.start_s for m in found.modes] == pytest.approx(starts, abs=1e-5)
    (armed,) = found.armed
    (disarmed,) = [t(m) for m in said["ARM"] if not m["ArmState"]]
    assert armed.start_s == 0.0 and armed.end_s == pytest.approx(min(disarmed, end_s), abs=1e-3)
    batteries = [t(m) for m in said["ERR"] if m["Subsys"] == 6 and m["ECode"] == 1]
    assert [s.start_s for s in found.failsafes] == pytest.approx(batteries)
    assert [s.end_s for s in found.failsafes] == [end_s] * len(batteries)
    texts = [m for m in found.messages if not m.level]
    assert [m.text for m in texts] == [" ".join(m["Message"].split()) for m in said["MSG"]]
    assert [m.t_s for m in texts] == pytest.approx([t(m) for m in said["MSG"]], abs=1e-5)
    values = {m["Name"]: m["Value"] for m in said["PARM"]}
    differ = {
        m["Name"]: m["Default"]
        for m in said["PARM"]
        if np.isfinite(m["Default"]) and m["Default"] != values[m["Name"]]
    }
    assert {p.name for p in found.parameters} == set(differ)
    for each in found.parameters:
        assert (each.value, each.default) == pytest.approx((values[each.name], differ[each.name]))
    _same(found.setpoint(GYRO), said["RATE"], t, _rates, end_s)
    _same(found.setpoint(QUAT), said["ATT"], t, _attitude, end_s)
    assert found.setpoint(POS) and found.setpoint(VEL)


def _rates(message: dict[str, Any]) -> list[float]:
    return [float(np.radians(message[k])) for k in ("RDes", "PDes", "YDes")]


def _attitude(message: dict[str, Any]) -> list[float]:
    """The product of three turns about one axis each."""
    half = [np.radians(message[k]) / 2 for k in ("DesRoll", "DesPitch", "DesYaw")]
    (a, b, c), (s, u, v) = np.cos(half), np.sin(half)
    return [
        *(a * b * c + s * u * v, s * b * c - a * u * v),
        *(a * u * c + s * b * v, a * b * v - s * u * c),
    ]


def _same(kept: Setpoint | None, messages: Any, t: Any, values: Any, end_s: float) -> None:
    assert kept is not None and kept.every == 1
    inside = [m for m in messages if 0.0 <= t(m) <= end_s]
    assert np.allclose(kept.t_s, [t(m) for m in inside], atol=1e-5)
    assert np.allclose(kept.values, [values(m) for m in inside], atol=1e-6)
