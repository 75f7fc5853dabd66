"""Rotor speeds of ESC telemetry, frames and thrust curve: planted answers and what must hold."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_rigs.dataflash_rig import dataflash
from sample_logs import FLOWN_PARAMS, flown_messages, flown_table

from twin.logs import Flight, read_flight
from twin.logs.airframe import Cells
from twin.logs.ardupilot.airframe import _CIRCLES, _PLACES, CLASSES, TYPES, geometry
from twin.logs.ardupilot.dataflash import instances_of
from twin.vehicle.layouts import frame

RPM = 30.0 / np.pi
SLOW = flown_table()["time"].to_numpy()[::4]


def speed(motor: int, t: Any) -> Any:
    """Planted speed of a motor, rad/s: as its command, with a share of its own."""
    return 300.0 + 40.0 * np.sin(t + motor) + 5.0 * motor


def reports(motor: int, seed: int = 0) -> Any:
    """Times of a controller's reports: 15 a second, irregular."""
    return (np.arange(440) + np.random.default_rng([seed, motor]).uniform(0.0, 1.0, 440)) / 15.0


def telemetry(motors: Any = (1, 2, 3, 4), first: int = 0, **changed: Any) -> list[dict[str, Any]]:
    found = []
    for k, motor in enumerate(motors):
        t = reports(motor)
        found.append({"t": t, "Instance": first + k, "RPM": RPM * speed(motor, t)})
    return found


def flight(tmp_path: Path, esc: Any, **params: float) -> Flight:
    messages: dict[str, Any] = dict(flown_messages())
    messages["RCOU"] = {
        "t": SLOW,
        **{f"C{k}": 1500.0 + 50.0 * np.sin(SLOW + k) for k in range(1, 5)},
    }
    path = tmp_path / "log.bin"
    path.write_bytes(dataflash(messages | {"ESC": esc}, FLOWN_PARAMS | params))
    return read_flight(path)


def doubt(found: Flight) -> str:
    return "; ".join(
        f.message for f in found.findings if f.where == "rotor" and f.severity != "info"
    )


@pytest.mark.slow
def test_speeds_of_controllers_that_report_in_their_own_time(tmp_path: Path) -> None:
    """Linear between reports: off by at most a^2 / 8 of the second derivative, 40 rad/s^3."""
    found = flight(tmp_path, telemetry())
    t, values = found.signal(["rotor_1", "rotor_2", "rotor_3", "rotor_4"])
    planted = np.column_stack([speed(k, t) for k in (1, 2, 3, 4)])
    assert len(t) > 430
    assert np.abs(values - planted).max() < 40.0 * 0.25**2 / 8.0 + 0.01
    assert "rotor speeds" in found.facts


@pytest.mark.slow
def test_reports_that_lack_are_not_bridged(tmp_path: Path) -> None:
    esc = telemetry()
    kept = (esc[2]["t"] < 10.0) | (esc[2]["t"] > 12.0)
    esc[2] = {k: v[kept] if k != "Instance" else v for k, v in esc[2].items()}
    found = flight(tmp_path, esc)
    t, _ = found.signal(["rotor_1", "rotor_3"])
    assert not ((t > 10.3) & (t < 11.7)).any()
    assert "reports nothing for over 0.25 s" in doubt(found)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda e: e[:3], "instances 0, 1, 2"),
        (lambda e: [*e[:3], e[3] | {"RPM": 0.0 * e[3]["RPM"]}], "motor 4 has a speed in"),
        (lambda e: [*e[:3], e[3] | {"RPM": 3e3 + 0.0 * e[3]["RPM"]}], "never changes"),
        (lambda e: [*e[:3], e[3] | {k: e[3][k][::6] for k in ("t", "RPM")}], "is reported in"),
        (
            lambda e: [e[0] | {"Instance": 1}, e[1] | {"Instance": 0}, *e[2:]],
            "rotor_1 follows cmd_2, rotor_2 follows cmd_1",
        ),
    ],
)
def test_speeds_that_are_not_good_are_left_out(tmp_path: Path, change: Any, why: str) -> None:
    found = flight(tmp_path, change(telemetry()))
    assert why in doubt(found)
    assert not found.has("rotor_1")


@pytest.mark.slow
def test_pulses_of_oneshot125_are_an_eighth(tmp_path: Path) -> None:
    """Until Copter 3.5 as they were sent, 125 to 250 us; the same commands come out."""
    messages: dict[str, Any] = dict(flown_messages())
    wide = {f"C{k}": 1500.0 + 50.0 * np.sin(SLOW + k) for k in range(1, 5)}
    read = []
    for factor, kind in ((1.0, 0), (0.125, 2), (1.0, 2)):
        messages["RCOU"] = {"t": SLOW, **{k: np.round(factor * v) for k, v in wide.items()}}
        path = tmp_path / f"{factor}_{kind}.bin"
        ends = {"MOT_PWM_TYPE": kind, "MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0}
        path.write_bytes(dataflash(messages, FLOWN_PARAMS | ends))
        read.append(read_flight(path).signal(["cmd_1", "cmd_2", "cmd_3", "cmd_4"])[1])
    np.testing.assert_allclose(read[1], read[0], atol=0.005)  # whole us, eight of the others
    np.testing.assert_array_equal(read[2], read[0])


def test_instances_of_esc() -> None:
    """An output counted from 0, or the place among the outputs of motors."""
    assert instances_of((1, 2, 3, 4), [0, 1, 2, 3]) == [0, 1, 2, 3]
    assert instances_of((4, 3, 2, 1), [0, 1, 2, 3]) == [3, 2, 1, 0]
    assert instances_of((9, 10, 12, 11), [8, 9, 10, 11]) == [8, 9, 11, 10]
    assert instances_of((9, 10, 12, 11), [0, 1, 2, 3]) == [0, 1, 3, 2]
    assert instances_of((9, 10, 12, 11), [0, 1]) == []


FRAMES = sorted({*_CIRCLES, *_PLACES})
NUMBERS = {(k, t): (c, n) for c, k in CLASSES.items() for n, t in {**TYPES, -1: ""}.items()}


@pytest.mark.parametrize("frame", FRAMES, ids="-".join)
def test_a_frame_can_fly(frame: tuple[str, str]) -> None:
    """As many rotors of either sense, the centre amid them, thrust and three moments are free."""
    found = geometry(*NUMBERS[frame])
    assert found is not None
    x, y = found.direction.T
    assert found.count == {"quad": 4, "hexa": 6, "octa": 8, "octaquad": 8, "y6": 6}.get(
        frame[0], 12
    )
    assert found.turn.sum() == 0.0
    assert np.abs(y.sum()) < 1e-5 and np.hypot(x, y).max() == pytest.approx(1.0, abs=1e-5)
    effect = np.vstack([-y, x, found.turn, np.ones(found.count)])
    assert np.linalg.svd(effect, compute_uv=False)[-1] > 0.3
    hover = np.linalg.pinv(effect) @ (0.0, 0.0, 0.0, 1.0)
    assert (hover > 0.0).all()  # no rotor has to pull down
    mirrored = np.abs(found.direction[:, None] - found.direction * (1.0, -1.0)).sum(axis=2) < 1e-5
    assert mirrored.any(axis=1).all() or frame[1] == "v"  # left as right
    coaxial = frame[0] in ("octaquad", "y6", "dodecahexa")
    assert sum(found.below) == (found.count // 2 if coaxial else 0)


@pytest.mark.parametrize(
    ("numbers", "name"),
    [
        ((1, 1), "x"),
        ((1, 0), "+"),
        ((1, 3), "h"),
        ((2, 1), "hex x"),
        ((2, 0), "hex +"),
        ((3, 1), "octo x"),
        ((3, 0), "octo +"),
    ],
)
def test_frames_are_those_of_px4(numbers: tuple[int, int], name: str) -> None:
    """Two tables by two sources; the order of quad X is front right, rear left, front left, rear
    right."""
    found, told = geometry(*numbers), frame(name, "here")
    assert found is not None
    np.testing.assert_allclose(found.direction, told.position[:, :2] / told.arm, atol=1e-5)
    np.testing.assert_array_equal(found.turn, -told.direction)


def test_frames_that_are_not_known() -> None:
    assert geometry(7, 1) is None and geometry(1, 16) is None and geometry(0, 0) is None
    y6, plain = geometry(5, 1), geometry(5, 0)
    assert y6 is not None and plain is not None and y6.frame == plain.frame == "y6"


def test_the_aircraft_of_a_log(tmp_path: Path) -> None:
    path = tmp_path / "log.bin"
    params = FLOWN_PARAMS | {
        **{"MOT_SPIN_ARM": 0.1, "MOT_SPIN_MIN": 0.12, "MOT_SPIN_MAX": 0.92, "MOT_THST_EXPO": 0.7},
        **{"MOT_BAT_VOLT_MIN": 13.2, "MOT_BAT_VOLT_MAX": 16.8, "MOT_THST_HOVER": 0.3},
        **{"INS_GYRO_FILTER": 40.0, "SCHED_LOOP_RATE": 400.0},
    }
    head = {"t": [0.0, 0.0], "Message": ["ArduCopter V4.5.7 (2a3dc4b7)", "CubeOrange 0034 31 3035"]}
    board = {"t": [0.0], "Message": ["CubeOrange 00340022 31305110 33353838"]}
    messages: dict[str, Any] = {**flown_messages(), "MSG": [head, board]}
    path.write_bytes(dataflash(messages, params))
    flight = read_flight(path)
    assert flight.facts["firmware"] == "ArduCopter V4.5.7 (2a3dc4b7)"
    assert flight.facts["hardware"] == "CubeOrange 00340022 31305110 33353838"
    assert flight.facts["airframe"] == "quad x"
    found = flight.airframe
    assert found is not None and found.rotors is not None and found.rotors.value == 4
    assert found.layout is not None and found.layout.direction.tolist() == [-1, -1, 1, 1]
    assert found.pulse_us is not None and found.pulse_us.value == (1000.0, 2000.0)
    assert found.cells is not None and found.cells.value == Cells(4, 4.2, 3.3)
    assert found.gyro_cutoff_hz is not None and found.gyro_cutoff_hz.value == 40.0
    assert found.accel_cutoff_hz is None and found.place is None
    assert found.thrust is not None
    ends = found.thrust.value.thrust(np.array([0.0, 0.12, 0.52, 0.92, 1.0]))
    np.testing.assert_allclose(ends, [0.0, 0.0, 0.3 * 0.5 + 0.7 * 0.25, 1.0, 1.0], atol=1e-12)
