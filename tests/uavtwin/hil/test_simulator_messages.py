"""Units and bits of the messages between PX4 and a simulator, by numbers worked out by hand."""

import math

import pytest

from twin.logs.mavlink.encode import (
    BARO_BITS,
    IMU_BITS,
    MAG_BITS,
    Controls,
    SensorReadings,
    controls_of,
    hil_controls,
    hil_gps,
    hil_sensor,
    hil_state,
    pressure_altitude_m,
)
from twin.logs.mavlink.frames import Message, parser

PLACE = (math.radians(48.0), math.radians(-11.5), 500.25)


def wired(message: Message) -> Message:
    """As it is after the wire."""
    (read,) = parser().parse_buffer(message.pack(parser(1, 1)))
    return read


def test_sensors_are_in_gauss_and_hectopascal() -> None:
    sensed = SensorReadings(
        (0.1, -0.2, -9.8), (0.01, 0.02, 0.03), (2e-5, 0.0, 4e-5), 95000.0, 288.15
    )
    m = wired(hil_sensor(1_234_000, sensed, IMU_BITS | MAG_BITS | BARO_BITS))
    assert m.time_usec == 1_234_000 and m.id == 0
    assert (m.xacc, m.yacc, m.zacc) == pytest.approx((0.1, -0.2, -9.8), rel=1e-7)
    assert (m.xmag, m.ymag, m.zmag) == pytest.approx((0.2, 0.0, 0.4), rel=1e-6)
    assert m.abs_pressure == pytest.approx(950.0) and m.diff_pressure == 0.0
    assert m.temperature == pytest.approx(15.0, abs=1e-4)
    assert m.pressure_alt == pytest.approx(540.3, abs=0.5)  # table of ICAO Doc 7488: 950 hPa


def test_what_is_new_is_what_px4_asks_for() -> None:
    """PX4's masks of accelerometer, gyroscope, magnetometer and barometer."""
    assert (IMU_BITS, MAG_BITS, BARO_BITS) == (0b111 | 0b111000, 0b111000000, 0b1101000000000)


@pytest.mark.parametrize(
    ("pressure_pa", "height_m"), [(101325.0, 0.0), (89874.6, 1000.0), (54019.9, 5000.0)]
)
def test_pressure_altitude_against_the_tables(pressure_pa: float, height_m: float) -> None:
    assert pressure_altitude_m(pressure_pa) == pytest.approx(height_m, abs=1.0)


def test_the_receiver_tells_degrees_millimetres_centimetres() -> None:
    m = wired(hil_gps(5, PLACE, (3.0, -4.0, 0.126), 0.75))
    assert (m.lat, m.lon, m.alt) == (480_000_000, -115_000_000, 500_250)
    assert (m.vn, m.ve, m.vd, m.vel) == (300, -400, 13, 500)
    assert m.cog == round(100 * (360 - math.degrees(math.atan2(4.0, 3.0))))
    assert (m.eph, m.epv, m.fix_type) == (75, 75, 3)


def test_the_true_motion() -> None:
    q = (0.5, 0.5, -0.5, 0.5)
    m = wired(hil_state(9, q, (0.1, 0.2, 0.3), PLACE, (1.0, 2.0, -3.0), (0, 0, -9.80665), 12.5))
    assert tuple(m.attitude_quaternion) == q
    assert (m.rollspeed, m.pitchspeed, m.yawspeed) == pytest.approx((0.1, 0.2, 0.3), rel=1e-7)
    assert (m.lat, m.lon, m.alt) == (480_000_000, -115_000_000, 500_250)
    assert (m.vx, m.vy, m.vz, m.true_airspeed) == (100, 200, -300, 1250)
    assert (m.xacc, m.yacc, m.zacc) == (0, 0, -1000)


def test_too_much_for_its_field_is_the_most_it_holds() -> None:
    m = wired(hil_state(9, (1, 0, 0, 0), (0, 0, 0), PLACE, (400.0, 0, 0), (0, 0, 1e6), 1e6))
    assert (m.vx, m.zacc, m.true_airspeed) == (32767, 32767, 65534)


def test_controls_are_armed_by_mode_and_in_lockstep_by_flags() -> None:
    for armed in (False, True):
        for lockstep in (False, True):
            sent = Controls(77, (0.25, 0.5, 0.75, 1.0), armed, lockstep)
            read = controls_of(wired(hil_controls(sent)))
            assert read.values == (*sent.values, *[0.0] * 12)
            assert (read.t_us, read.armed, read.lockstep) == (77, armed, lockstep)
