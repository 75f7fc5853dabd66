"""Messages as pymavlink packs them against the decoder, and the encoder against both."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.frames import from_euler, to_body
from twin.logs.columns import ACC, GYRO, MAG, POS, QUAT, VEL, motor_columns
from twin.logs.mavlink.decoder import GROUPS, LANDED, MavlinkDecoder, Sample, Sources
from twin.logs.mavlink.encode import (
    attitude,
    heartbeat,
    landed,
    local_position,
    messages_of,
)
from twin.logs.mavlink.frames import AUTOPILOT, Message, dialect, parser

FLOAT32 = 2.0**-24
T_US = st.integers(0, 2**52)


def over_the_wire(message: Message, system: int = 1) -> Message:
    """Packed by one side and parsed by the other."""
    (received,) = parser().parse_buffer(message.pack(parser(system, AUTOPILOT)))
    return received


def decoded(*messages: Message, motors: int | None = 4) -> list[Sample]:
    decoder = MavlinkDecoder(motors)
    return [s for m in messages for s in decoder.samples(over_the_wire(m))]


def numbers(limit: float, count: int) -> st.SearchStrategy[tuple[float, ...]]:
    one = st.floats(-limit, limit, allow_subnormal=False, width=64)
    return st.tuples(*[one] * count)


@pytest.mark.slow
@given(
    t_us=T_US,
    acc=numbers(200, 3),
    gyro=numbers(50, 3),
    mag=numbers(1e-3, 3),
    baro=st.floats(1e3, 1.1e5),
    pos=numbers(1e4, 3),
    vel=numbers(100, 3),
    angles=numbers(3, 3),
    cmd=st.tuples(*[st.floats(0, 1)] * 4),
    rotor=st.tuples(*[st.floats(0, 5000)] * 4),
    left_out=st.sets(st.sampled_from(["acc", "gyro", "mag", "baro", "pos", "vel", "q", "cmd"])),
)
def test_what_is_encoded_is_decoded(
    t_us: int,
    acc: tuple[float, ...],
    gyro: tuple[float, ...],
    mag: tuple[float, ...],
    baro: float,
    pos: tuple[float, ...],
    vel: tuple[float, ...],
    angles: tuple[float, float, float],
    cmd: tuple[float, ...],
    rotor: tuple[float, ...],
    left_out: set[str],
) -> None:
    """Every signal comes back at its microsecond, within float32; what is not there does not."""
    q = tuple(float(v) for v in from_euler(*angles))
    groups = {"acc": acc, "gyro": gyro, "mag": mag, "baro": (baro,), "pos": pos, "vel": vel}
    groups |= {"q": q, "cmd": cmd, "rotor": rotor}
    for group in left_out:
        groups.pop(group)
    columns = GROUPS | {stem: motor_columns(stem, 4) for stem in ("cmd", "rotor")}
    row = {c: v for g, values in groups.items() for c, v in zip(columns[g], values, strict=True)}
    found = decoded(*messages_of(t_us, row, 4))
    assert {s.group for s in found} == set(groups) and len(found) == len(groups)
    for sample in found:
        assert sample.t_us == t_us
        size = np.abs(groups[sample.group])
        tolerance = 3 * FLOAT32 * size + 1e-37
        assert np.all(np.abs(np.subtract(sample.values, groups[sample.group])) <= tolerance)


@given(volts=st.floats(0.001, 600.0), amperes=st.floats(-300.0, 300.0))
def test_battery_within_its_steps(volts: float, amperes: float) -> None:
    """1 mV and 10 mA, at the newest time that was told; a cell of the message holds 65 V."""
    row = {"acc_x": 0.0, "acc_y": 0.0, "acc_z": 0.0, "vbat_v": volts, "ibat_a": amperes}
    found = {s.group: s for s in decoded(*messages_of(77, row, 4))}
    assert abs(found["vbat_v"].values[0] - volts) <= 0.5001e-3 and found["vbat_v"].t_us == 77
    assert abs(found["ibat_a"].values[0] - amperes) <= 1.0001e-2


@given(angles=numbers(1.4, 3), velocity=numbers(30, 3))
def test_velocity_along_the_body_is_turned(
    angles: tuple[float, float, float], velocity: tuple[float, float, float]
) -> None:
    """PX4 sends the velocity of ODOMETRY in body axes."""
    q = [float(v) for v in from_euler(*angles)]
    along_body = [float(v) for v in to_body(q, velocity)]
    message = dialect.MAVLink_odometry_message(
        5, 1, dialect.MAV_FRAME_BODY_FRD, 0, 0, 0, q, *along_body, 0, 0, 0, [0] * 21, [0] * 21, 0, 8
    )
    found = {s.group: s.values for s in decoded(message)}
    np.testing.assert_allclose(found["vel"], velocity, atol=1e-5)


def test_units_of_the_older_imu_messages() -> None:
    scaled = dialect.MAVLink_scaled_imu_message(20, 0, 0, -1000, 0, 0, 500, 250, 0, 400)
    found = {s.group: s for s in decoded(scaled)}
    assert found["acc"].values == pytest.approx((0, 0, -9.80665)) and found["acc"].t_us == 20_000
    assert found["gyro"].values == pytest.approx((0, 0, 0.5))
    assert found["mag"].values == pytest.approx((2.5e-5, 0, 4e-5))
    raw = dialect.MAVLink_raw_imu_message(20, 0, 0, -1000, 0, 0, 0, 0, 0, 0)
    assert not decoded(raw)  # in whose units?
    ardupilot = dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    assert [s.values[2] for s in decoded(ardupilot, raw)] == pytest.approx([-9.80665, 0.0])


def test_pulses_become_commands() -> None:
    """1000 to 2000 us, or what parameters say; port 1 is no motor."""
    imu = messages_of(10**7, dict.fromkeys(ACC, 0.0), 4)[0]
    servo = dialect.MAVLink_servo_output_raw_message(10_020_000, 0, 1000, 1500, 2000, 900, *[0] * 4)
    (cmd,) = (s for s in decoded(imu, servo) if s.group == "cmd")
    assert cmd.values == pytest.approx((0, 0.5, 1, 0)) and cmd.t_us == 10_020_000
    low = dialect.MAVLink_param_value_message(b"MOT_PWM_MIN", 1100, 9, 1, 0)
    high = dialect.MAVLink_param_value_message(b"MOT_PWM_MAX", 1900, 9, 1, 0)
    (cmd,) = (s for s in decoded(imu, low, high, servo) if s.group == "cmd")
    assert cmd.values == pytest.approx((0, 0.5, 1, 0))
    aux = dialect.MAVLink_servo_output_raw_message(10_020_000, 1, *[1500] * 8)
    assert not [s for s in decoded(imu, aux) if s.group == "cmd"]


def test_outputs_of_ardupilot_by_their_function() -> None:
    functions = [
        dialect.MAVLink_param_value_message(f"SERVO{k}_FUNCTION".encode(), 32 + motor, 4, 1, 0)
        for k, motor in ((5, 1), (6, 2), (7, 3), (8, 4))
    ]
    ardupilot = dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    servo = dialect.MAVLink_servo_output_raw_message(1, 0, 1, 1, 1, 1, 1100, 1200, 1300, 1400)
    (cmd,) = (s for s in decoded(ardupilot, *functions, servo) if s.group == "cmd")
    assert cmd.values == pytest.approx((0.1, 0.2, 0.3, 0.4))


def functions_of(name: str, values: Sequence[float], kind: int = 4) -> list[Any]:
    """Parameters of outputs 1, 2, ... with these functions."""
    return [
        dialect.MAVLink_param_value_message(name.format(k).encode(), value, kind, 1, 0)
        for k, value in enumerate(values, start=1)
    ]


def test_motors_9_to_12_of_ardupilot_have_functions_of_their_own() -> None:
    """82 to 85; the outputs behind the eighth are an extension of the message."""
    functions = functions_of("SERVO{}_FUNCTION", [85, 84, 83, 82, *range(33, 41)])
    dodeca = dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_DODECAROTOR, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3
    )
    pulses = [1900, 1800, 1700, 1600, *range(1100, 1500, 50)]
    servo = dialect.MAVLink_servo_output_raw_message(1, 0, *pulses, *[0] * 4)
    found = decoded(dodeca, *functions, servo, motors=None)
    (cmd,) = (s for s in found if s.group == "cmd")
    behind = (0.6, 0.7, 0.8, 0.9)
    assert cmd.values == pytest.approx((*np.arange(0.1, 0.5, 0.05), *behind))


def test_outputs_of_px4_by_their_function() -> None:
    ints = np.array([103, 101, 104, 102, 402], dtype=np.int32).view(np.float32)
    functions = functions_of("PWM_MAIN_FUNC{}", [float(v) for v in ints], 6)
    px4 = dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
    servo = dialect.MAVLink_servo_output_raw_message(1, 0, 1300, 1100, 1400, 1200, 1900, 0, 0, 0)
    (cmd,) = (s for s in decoded(px4, *functions, servo) if s.group == "cmd")
    assert cmd.values == pytest.approx((0.1, 0.2, 0.3, 0.4))
    (guessed,) = (s for s in decoded(px4, *functions[:3], servo) if s.group == "cmd")
    assert guessed.values == pytest.approx((0.3, 0.1, 0.4, 0.2))


def test_integers_of_px4_are_sent_as_their_bytes() -> None:
    px4 = dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
    value = float(np.array([1075], dtype=np.int32).view(np.float32)[0])
    decoder = MavlinkDecoder()
    for m in (px4, dialect.MAVLink_param_value_message(b"PWM_MIN", value, 6, 1, 0)):
        decoder.samples(over_the_wire(m))
    assert decoder.parameters == {"PWM_MIN": 1075.0} and decoder.autopilot == "PX4"


def test_a_time_of_32_bits_goes_on_after_71_minutes() -> None:
    base = 3 * 2**32 - 1000
    imu = messages_of(base, dict.fromkeys(ACC, 0.0), 4)[0]
    servos = [
        dialect.MAVLink_servo_output_raw_message((base + k) % 2**32, 0, *[1500] * 8)
        for k in (-500, 500, 1500)
    ]
    found = [s.t_us for s in decoded(imu, *servos) if s.group == "cmd"]
    assert found == [base - 500, base + 500, base + 1500]


def test_rotor_speeds_of_speed_controllers() -> None:
    """Of six motors a sample is there when both messages have come."""
    imu = messages_of(9, dict.fromkeys(ACC, 0.0), 6)[0]
    zero = [0] * 4
    first = dialect.MAVLink_esc_telemetry_1_to_4_message(zero, zero, zero, zero, [60] * 4, zero)
    second = dialect.MAVLink_esc_telemetry_5_to_8_message(
        zero, zero, zero, zero, [120, 120, 0, 0], zero
    )
    assert not [s for s in decoded(imu, first, motors=6) if s.group == "rotor"]
    (rotor,) = (s for s in decoded(imu, first, second, motors=6) if s.group == "rotor")
    assert rotor.values == pytest.approx([2 * math.pi] * 4 + [4 * math.pi] * 2)


@pytest.mark.parametrize("motors", [3, 4, 6, 8, 12])
def test_the_heartbeat_says_how_many_motors(motors: int) -> None:
    cmd = {c: 0.25 for c in motor_columns("cmd", motors)}
    found = decoded(heartbeat(motors), *messages_of(1, cmd, motors), motors=None)
    assert found[0].values == (0.25,) * motors


def test_a_ground_station_is_no_aircraft() -> None:
    decoder = MavlinkDecoder()
    decoder.samples(over_the_wire(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
    assert decoder.motors is None and decoder.autopilot == ""


@pytest.mark.parametrize(
    ("group", "row"),
    [
        ("acc", {"acc_x": math.inf, "acc_y": 0.0, "acc_z": 0.0}),
        ("gyro", dict(zip(GYRO, (200.0, 0.0, 0.0), strict=True))),
        ("q", dict(zip(QUAT, (0.5, 0.0, 0.0, 0.0), strict=True))),
        ("baro", {"baro_pa": -5.0}),
    ],
)
def test_what_cannot_be_is_left_out_and_counted(group: str, row: Mapping[str, float]) -> None:
    decoder = MavlinkDecoder(4)
    for message in messages_of(1, row, 4):
        assert not decoder.samples(over_the_wire(message))
    assert [g for g, _ in decoder.dropped] == [group]


def test_messages_of_ground_stations_screens() -> None:
    """Milliseconds, and the same values."""
    pose = local_position(1_234_567, (1, 2, -3), (0.1, 0.2, 0.3))
    turn = attitude(1_234_567, (1, 0, 0, 0), (0, 0, 0))
    found = decoded(pose, turn)
    assert {s.t_us for s in found} == {1_234_000}
    assert {s.group for s in found} == {"pos", "vel", "q"}
    assert not set(MAG) & set(POS) & set(VEL)


def test_landed_states() -> None:
    imu = messages_of(3, dict.fromkeys(ACC, 0.0), 4)[0]
    told = [decoded(imu, landed(p))[-1] for p in ("ground", "hover", "takeoff", "land")]
    assert [(s.group, s.values[0]) for s in told] == [(LANDED, k) for k in (1.0, 2.0, 3.0, 4.0)]


def test_the_better_of_two_sources() -> None:
    for by_odometry, better in ((90, "ODOMETRY"), (10, "ATTITUDE")):
        sources = Sources()
        for kind in 100 * ["ATTITUDE"] + by_odometry * ["ODOMETRY"]:
            sources.add(Sample("q", kind, 0, (1.0, 0.0, 0.0, 0.0)))
        sources.choose()
        assert sources.chosen == {"q": better}
