"""Rotors: lag, voltage, saturation and maps against their formulas."""

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval
from rig import BUILTIN, Rig, in_air, plain, with_rotors

from twin.physics.rotors import per_power
from twin.vehicle_file import load_vehicle

LAGGED = with_rotors(plain(), lag_up_s=0.03, lag_down_s=0.08)
VOLTAGE = with_rotors(plain(), reference_voltage_v=15.2, voltage_exponent=1.7)


def test_lag_is_first_order_with_one_constant_up_and_one_down() -> None:
    rig = in_air(LAGGED)
    start = np.array([0.2, 0.9, 0.5, 0.0])
    target = np.array([0.7, 0.3, 0.5, 1.0])
    x = rig.state({f"effort_{i + 1}": value for i, value in enumerate(start)})
    states = rig.fly(x, rig.commands(target), 0.4)
    effort = rig.get(states, *[f"effort_{i}" for i in range(1, 5)])
    tau = np.where(target > start, 0.03, 0.08)
    t = 1e-3 * np.arange(len(states))[:, None]
    exact = target + (start - target) * np.exp(-t / tau)
    # RK4 on a decay: (h / tau)^4 / 120 of the travelled way.
    np.testing.assert_allclose(effort, exact, atol=1e-8)


def test_lag_of_the_rotor_speed_is_in_the_speed_not_in_the_thrust() -> None:
    """Half way to a doubled speed the thrust is (1.5 / 1)^2, not the mean of 1 and 4."""
    vehicle = load_vehicle("copter_default")
    rig = in_air(vehicle)
    low, high = 400.0, 800.0
    assert vehicle.rotors.speed_rad_s is not None
    command = (high - vehicle.rotors.speed_rad_s[0]) / vehicle.rotors.speed_rad_s[1]
    x = rig.state({f"rotor_{i}": low for i in range(1, 5)})
    half_time = vehicle.rotors.lag_up_s * np.log(2)
    end = rig.fly(x, rig.commands(command), half_time, half_time / 50)[-1]
    assert rig.get(end, "rotor_1")[0] == pytest.approx(600.0, rel=1e-6)
    thrust = rig.outputs(end, rig.commands(command))["thrust_1"]
    assert thrust == pytest.approx(1.105e-5 * 600.0**2, rel=1e-6)


def settled_thrust(rig: Rig, command: float, **inputs: float) -> float:
    """Thrust of a rotor once it has followed the command."""
    u = rig.commands(command, **inputs)
    end = rig.fly(rig.state(), u, 2.0, 2e-3)[-1]
    return rig.outputs(end, u)["thrust_1"]


@pytest.mark.parametrize("command", [-0.3, 0.0, 0.4, 1.0, 1.5])
def test_command_saturates_at_0_and_1(command: float) -> None:
    expected = 8.0 * min(max(command, 0.0), 1.0)
    assert settled_thrust(in_air(LAGGED), command) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("voltage", [12.0, 15.2, 16.8, 0.0, -1.0])
def test_voltage_multiplies_the_command(voltage: float) -> None:
    scale = (max(voltage, 0.0) / 15.2) ** 1.7
    thrust = settled_thrust(in_air(VOLTAGE), 0.6, vbat_v=voltage)
    assert thrust == pytest.approx(8.0 * 0.6 * scale, abs=1e-9)
    # A fresh battery gives more than full command at the reference voltage.
    full = settled_thrust(in_air(VOLTAGE), 1.0, vbat_v=voltage)
    assert full == pytest.approx(8.0 * scale, abs=1e-9)


def test_without_reference_voltage_there_is_no_voltage_input() -> None:
    assert "vbat_v" not in in_air(plain()).component.input_names
    assert "vbat_v" in in_air(VOLTAGE).component.input_names


@pytest.mark.parametrize("seed", range(5))
def test_maps_are_the_polynomials_of_the_file(seed: int) -> None:
    rng = np.random.default_rng(seed)
    thrust = rng.uniform(0, 5, rng.integers(2, 7))
    thrust[:2] = 0.3 * thrust[0], 4.0 + thrust[1]  # enough to hover, and to come down
    torque, level = rng.uniform(0, 1, rng.integers(1, 5)), rng.uniform()
    rig = in_air(
        with_rotors(plain(), thrust_n=tuple(thrust), torque_n_m=tuple(torque), lag_up_s=0.0)
    )
    u = rig.commands([level, 0.0, 0.0, 0.0])
    rates, off = rig.rates(rig.state(), u), rig.rates(rig.state(), rig.commands(0.0))
    thrust_1 = rig.outputs(rig.state(), u)["thrust_1"]
    assert thrust_1 == pytest.approx(polyval(level, thrust), rel=1e-12)
    yaw = (polyval(level, torque) - torque[0]) / 0.036
    assert rates["omega_z"] - off["omega_z"] == pytest.approx(yaw, rel=1e-9, abs=1e-10)


def test_measured_rotor_speed_drives_as_the_command_does_at_steady_state() -> None:
    vehicle = load_vehicle("copter_default")
    by_command, by_speed = in_air(vehicle, "command"), in_air(vehicle, "rotor_speed")
    commands = np.array([0.5, 0.55, 0.6, 0.52])
    assert vehicle.rotors.speed_rad_s is not None
    speeds = polyval(commands, vehicle.rotors.speed_rad_s)
    motion = {"vel_x": 2.0, "omega_x": 1.0, "omega_z": -2.0}
    states = {f"rotor_{i + 1}": s for i, s in enumerate(speeds)}
    a = by_command.outputs(by_command.state({**motion, **states}), by_command.commands(commands))
    b = by_speed.outputs(by_speed.state(motion), by_speed.commands(speeds))
    assert {n: a[n] for n in b} == pytest.approx(b, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("vehicle", BUILTIN)
def test_a_rotor_at_rest_does_not_push_down(vehicle: str) -> None:
    """The fits of crazyflie and feisi_x150 are negative at command zero."""
    rig = in_air(load_vehicle(vehicle))
    for command in (0.0, 0.005):
        assert settled_thrust(rig, command) >= 0.0
    x = rig.state({n: 0.0 for n in rig.names if n.startswith(("rotor_", "effort_"))})
    y = rig.outputs(x, rig.commands(0.0))
    assert (y["specific_force_z"], y["angular_acceleration_z"]) == pytest.approx((0.0, 0.0))


def test_speed_map_is_never_negative() -> None:
    """-141 + 1148 cmd is negative below 0.12: the motor stands still there."""
    rig = in_air(load_vehicle("copter_default"))
    end = rig.fly(rig.state(), rig.commands(0.05), 2.0)[-1]
    assert 0.0 <= rig.get(end, "rotor_1")[0] < 1e-6


@pytest.mark.parametrize(
    ("unit", "argument", "power", "expected"),
    [
        ("N", "rad/s", 0, "N"),
        ("N", "rad/s", 1, "N.s/rad"),
        ("N.m", "rad/s", 2, "N.m.s2/rad2"),
        ("N", "1", 3, "N"),
        ("rad/s", "1", 2, "rad/s"),
    ],
)
def test_units_of_the_coefficients(unit: str, argument: str, power: int, expected: str) -> None:
    assert per_power(unit, argument, power) == expected
