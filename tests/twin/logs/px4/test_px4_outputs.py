"""Which output of a PX4 log drives which motor, from logs made from nothing: the commands that were
put in come out, whatever driver, order, range or unit they were logged in."""

from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sample_logs import MOVING_S, moving_topics, ulog

from twin.logs import Flight
from twin.logs.columns import motor_columns
from twin.logs.formats import ReadOptions
from twin.logs.px4.ulog import read_ulog

T_S = MOVING_S[::4]
Array = NDArray[np.float64]


def commanded(n: int) -> Array:
    """Commands that differ from motor to motor, all off for the first tenth, shape (samples, n)."""
    own = np.arange(1, n + 1)
    cmd = 0.45 + 0.03 * own / n + 0.1 * np.sin(np.outer(T_S, 2.0 + own))
    cmd[: len(T_S) // 10] = 0.0
    return np.asarray(cmd)


def outputs(values: Array, noutputs: int = 8) -> dict[str, Any]:
    """A message of actuator_outputs; channels behind the values are dead."""
    filled = np.zeros((len(T_S), 16), dtype=np.float32)
    filled[:, : values.shape[1]] = values
    return {"t": T_S, "noutputs": np.full(len(T_S), noutputs, dtype=np.uint32), "output": filled}


def read(params: dict[str, float], *instances: Array, **more: Any) -> Flight:
    """A log with these instances of actuator_outputs and without actuator_motors."""
    topics = moving_topics()
    del topics["actuator_motors"]
    for k, values in enumerate(instances):
        topics[f"actuator_outputs:{k}" if k else "actuator_outputs"] = outputs(values)
    topics |= more
    return read_ulog(Path("made.ulg"), ulog(topics, params), ReadOptions(False))


def messages(flight: Flight, where: str, *severities: str) -> str:
    """Findings at a place, those of some severities."""
    wanted = severities or ("info", "warning", "error")
    return " | ".join(
        f.message for f in flight.findings if f.where == where and f.severity in wanted
    )


def assert_commands(flight: Flight, expected: Array, tolerance: float = 2e-3) -> None:
    """Same commands in the same order."""
    n = expected.shape[1]
    assert f"cmd_{n}" in flight.table, messages(flight, "cmd")
    assert f"cmd_{n + 1}" not in flight.table
    cmd = flight.signal(motor_columns("cmd", n))[1]
    np.testing.assert_allclose(cmd, expected, atol=tolerance)


def pulses(cmd: Array, low: float = 1000.0, high: float = 2000.0) -> Array:
    return np.asarray(np.round(low + cmd * (high - low)))


def functions(driver: str, motors: dict[int, int]) -> dict[str, float]:
    """FUNC parameters: motor by number of the output."""
    told: dict[str, float] = {f"{driver}_FUNC{k}": 0 for k in range(1, 9)}
    return told | {f"{driver}_FUNC{k}": 100 + m for k, m in motors.items()}


@pytest.mark.parametrize("order", list(permutations(range(4)))[::5])
def test_functions_say_the_motor_of_an_output(order: tuple[int, ...]) -> None:
    cmd = commanded(4)
    told = functions("PWM_MAIN", {k + 1: m + 1 for k, m in enumerate(order)})
    flight = read({"CA_ROTOR_COUNT": 4, **told}, pulses(cmd[:, order]))
    assert_commands(flight, cmd)
    assert "PWM_MAIN_FUNC1" in flight.facts["motors"]


def test_each_output_has_its_own_range_and_may_be_reversed() -> None:
    cmd = commanded(4)
    lows, highs = (1000, 1050, 1100, 1075), (1900, 1950, 2000, 1940)
    ranges = {f"PWM_AUX_MIN{k + 1}": low for k, low in enumerate(lows)}
    ranges |= {f"PWM_AUX_MAX{k + 1}": high for k, high in enumerate(highs)}
    values = np.column_stack(
        [pulses(cmd[:, k], *ends) for k, ends in enumerate(zip(lows, highs, strict=True))]
    )
    values[:, 2] = pulses(1.0 - cmd[:, 2], lows[2], highs[2])
    told = functions("PWM_AUX", {1: 1, 2: 2, 3: 3, 4: 4}) | {"PWM_AUX_REV": 0b0100}
    assert_commands(read({"CA_ROTOR_COUNT": 4, **told, **ranges}, values), cmd)


def test_motors_on_the_auxiliary_outputs_beside_dead_main_ones() -> None:
    """IO processor in instance 0 without a motor, its channels at the disarmed value."""
    cmd = commanded(4)
    told = functions("PWM_MAIN", {}) | functions("PWM_AUX", {1: 1, 2: 2, 3: 3, 4: 4})
    flight = read({"CA_ROTOR_COUNT": 4, **told}, np.full((len(T_S), 8), 1000.0), pulses(cmd))
    assert_commands(flight, cmd)
    assert messages(flight, "cmd", "warning").count("actuator_outputs") == 0


@pytest.mark.parametrize("n", [6, 8])
def test_motors_spread_over_two_drivers(n: int) -> None:
    cmd = commanded(n)
    main = functions("PWM_MAIN", {1: 2, 2: 1, 3: 4, 4: 3})
    aux = functions("PWM_AUX", {k: 4 + k for k in range(1, n - 3)})
    flight = read(
        {"CA_ROTOR_COUNT": n, **main, **aux},
        pulses(cmd[:, [1, 0, 3, 2]]),
        pulses(cmd[:, 4:]),
    )
    assert_commands(flight, cmd)


@pytest.mark.parametrize("frequency", [-3, -5])
def test_dshot_values_have_the_range_of_the_driver(frequency: int) -> None:
    cmd = commanded(4)
    low = int(0.08 * 1999)
    values = np.where(cmd > 0.0, np.floor(low + cmd * (1999 - low)), 0.0)
    told = functions("PWM_MAIN", {1: 2, 2: 4, 3: 1, 4: 3}) | {
        f"PWM_MAIN_MIN{k}": 1100 for k in "1234"
    }
    params = {"CA_ROTOR_COUNT": 4, **told, "DSHOT_MIN": 0.08, "PWM_MAIN_TIM0": frequency}
    flight = read(params, values[:, [1, 3, 0, 2]])
    assert_commands(flight, cmd)
    assert "DShot (PWM_MAIN_FUNC3, DSHOT_MIN 0.08" in flight.facts["motors"]
    assert flight.airframe is not None and flight.airframe.pulse_us is None


def test_dshot_before_functions_is_by_its_configuration() -> None:
    cmd = commanded(4)
    values = np.where(cmd > 0.0, np.floor(109 + cmd * 1890), 0.0)
    assert_commands(read({"MAV_TYPE": 2, "DSHOT_CONFIG": 600}, values), cmd)


def test_motors_that_turn_both_ways_are_refused() -> None:
    told = functions("PWM_MAIN", {k: k for k in (1, 2, 3, 4)}) | {"DSHOT_3D_ENABLE": 1}
    flight = read({"CA_ROTOR_COUNT": 4, **told}, 300 + 500 * commanded(4))
    assert "cmd_1" not in flight.table
    assert "DSHOT_3D_ENABLE" in messages(flight, "cmd", "warning")


def test_can_values_have_the_range_of_the_bus() -> None:
    """Beside pulses of servos that move more than the motors do."""
    cmd = commanded(4)
    sweep = 1500 + 450 * np.sin(np.outer(T_S, (0.3, 0.4, 0.5, 0.6)))
    raw = np.where(cmd > 0.0, np.round(1 + cmd * 8190), 0.0)
    told = functions("UAVCAN_EC", {1: 1, 2: 2, 3: 3, 4: 4}) | functions("PWM_MAIN", {})
    told |= {f"PWM_MAIN_FUNC{k}": 200 + k for k in (1, 2, 3, 4)}
    assert_commands(read({"CA_ROTOR_COUNT": 4, **told}, sweep, raw), cmd)
    old: dict[str, float] = {"MAV_TYPE": 2, "UAVCAN_ENABLE": 3}
    assert_commands(read(old, np.zeros((len(T_S), 8)), np.round(cmd * 8191)), cmd)


def test_a_camera_that_moves_more_is_no_motor() -> None:
    cmd = commanded(4)
    tilt = np.full((len(T_S), 4), 1500.0)
    tilt[:, 0] += 440 * np.sin(0.3 * T_S)
    flight = read({"MAV_TYPE": 2}, pulses(cmd), tilt)
    assert_commands(flight, cmd)
    assert "instance 0 drives the motors" in messages(flight, "cmd", "info")


def test_what_the_log_does_not_say_is_a_finding() -> None:
    """Before functions, two instances whose channels all move."""
    cmd = commanded(4)
    sweep = 1500 + 450 * np.sin(np.outer(T_S, (0.3, 0.4, 0.5, 0.6)))
    flight = read({"MAV_TYPE": 2}, pulses(cmd), sweep)
    assert_commands(flight, cmd)
    assert "no parameter PWM_MAIN_FUNCn says which" in messages(flight, "cmd", "warning")


def test_two_drivers_that_fit_alike_are_a_finding() -> None:
    cmd = commanded(4)
    told = functions("PWM_MAIN", {k: k for k in (1, 2, 3, 4)})
    flight = read({"CA_ROTOR_COUNT": 4, **told}, pulses(cmd), pulses(cmd[:, ::-1]))
    assert_commands(flight, cmd)
    assert "does not name the driver of an instance" in messages(flight, "cmd", "warning")
    flight = read({"CA_ROTOR_COUNT": 4, **told}, pulses(cmd), pulses(cmd))
    assert "does not name" not in messages(flight, "cmd")


def test_a_motor_without_an_output_is_named() -> None:
    told = functions("PWM_MAIN", {1: 1, 2: 2, 4: 4})
    flight = read({"CA_ROTOR_COUNT": 4, **told}, pulses(commanded(4)))
    assert "cmd_1" not in flight.table
    assert "no output has the function of motor 3 of 4" in messages(flight, "cmd", "warning")


def test_betaflights_order_of_outputs() -> None:
    """MOT_ORDERING 1: outputs 1 to 4 drive motors 4, 1, 2, 3 (MixingOutput::reorderOutputs)."""
    cmd = commanded(4)
    flight = read({"MAV_TYPE": 2, "MOT_ORDERING": 1}, pulses(cmd[:, [3, 0, 1, 2]]))
    assert_commands(flight, cmd)


def test_a_driver_of_unknown_range_is_refused() -> None:
    told = functions("VOXL_ESC", {k: k for k in (1, 2, 3, 4)})
    values = 100 + 700 * commanded(4)
    flight = read({"CA_ROTOR_COUNT": 4, **told}, values)
    assert "cmd_1" not in flight.table
    assert "the range of VOXL_ESC is not known" in messages(flight, "cmd", "warning")
    ends = {f"VOXL_ESC_{e}{k}": v for e, v in (("MIN", 100), ("MAX", 800)) for k in range(1, 5)}
    assert_commands(read({"CA_ROTOR_COUNT": 4, **told, **ends}, values), commanded(4))


def test_thrust_of_the_allocation_is_made_the_command_of_the_drivers() -> None:
    """The thrust curve f u^2 + (1 - f) u of the command that comes out is the thrust that went in;
    the number of motors is that of the parameters, whatever the array holds behind them."""
    thrust = commanded(4)
    control = np.zeros((len(T_S), 12), dtype=np.float32)
    control[:, :4] = thrust
    topics = moving_topics()
    topics["actuator_motors"] = {"t": T_S, "control": control}
    for factor in (0.0, 0.3, 1.0):
        params = {"CA_ROTOR_COUNT": 4, "THR_MDL_FAC": factor}
        flight = read_ulog(Path("made.ulg"), ulog(topics, params), ReadOptions(False))
        cmd = flight.signal(motor_columns("cmd", 4))[1]
        np.testing.assert_allclose(factor * cmd**2 + (1 - factor) * cmd, thrust, atol=1e-6)


# -- speeds of the controllers ----------------------------------------------------------------


def speeds(motors: tuple[int, ...], **fields: Any) -> dict[str, Any]:
    """esc_status whose slot k holds 1000 rpm times the motor, and a wave."""
    n = len(T_S)
    told: dict[str, Any] = {"t": T_S, "esc_connectiontype": np.full(n, 5, dtype=np.uint8)}
    for k in range(8):
        motor = motors[k] if k < len(motors) else 0
        rpm = 1000.0 * motor + 50 * np.sin(T_S) if motor else np.zeros(n)
        told[f"esc[{k}].esc_rpm"] = rpm.astype(np.int32)
        if "function" not in fields:
            told[f"esc[{k}].actuator_function"] = np.full(n, 100 + motor, dtype=np.uint8)
    told |= {k: np.full(n, v, dtype=np.uint8) for k, v in fields.items() if k != "function"}
    return told


def middle_rpm(flight: Flight, n: int) -> list[float]:
    rotors = flight.signal(motor_columns("rotor", n))[1]
    return [round(float(v), -2) for v in np.median(rotors, axis=0) * 60 / (2 * np.pi)]


@pytest.mark.parametrize("motors", [(3, 1, 4, 2), (2, 4, 1, 3), (1, 2, 3, 4)])
def test_speeds_belong_to_the_motor_of_their_function(motors: tuple[int, ...]) -> None:
    told = functions("PWM_MAIN", {k: k for k in (1, 2, 3, 4)})
    flight = read({"CA_ROTOR_COUNT": 4, **told}, pulses(commanded(4)), esc_status=speeds(motors))
    assert middle_rpm(flight, 4) == [1000, 2000, 3000, 4000]
    assert f"motor 3 in slot {motors.index(3) + 1}" in flight.facts["rotor speeds"]


def test_fewer_controllers_than_motors_are_left_out_by_name() -> None:
    told = functions("PWM_MAIN", {k: k for k in (1, 2, 3, 4)})
    params = {"CA_ROTOR_COUNT": 4, **told}
    flight = read(params, pulses(commanded(4)), esc_status=speeds((4, 2, 1)))
    assert "rotor_1" not in flight.table
    assert "no speed of motor 3 of 4" in messages(flight, "rotor", "warning")
    assert_commands(flight, commanded(4))


def test_an_octocopter_reports_in_two_instances() -> None:
    told = functions("PWM_MAIN", {k: k for k in range(1, 9)})
    flight = read(
        {"CA_ROTOR_COUNT": 8, **told},
        pulses(commanded(8)),
        **{"esc_status": speeds((8, 6, 4, 2)), "esc_status:1": speeds((1, 3, 5, 7))},
    )
    assert middle_rpm(flight, 8) == [1000.0 * k for k in range(1, 9)]


def test_a_can_controllers_slot_is_its_index_on_the_bus() -> None:
    raw = np.round(1 + commanded(4) * 8190)[:, [2, 0, 3, 1]]
    told = functions("UAVCAN_EC", {1: 3, 2: 1, 3: 4, 4: 2})
    status = speeds((3, 1, 4, 2), function=False, esc_connectiontype=4)
    flight = read({"CA_ROTOR_COUNT": 4, **told}, raw, esc_status=status)
    assert_commands(flight, commanded(4))
    assert middle_rpm(flight, 4) == [1000, 2000, 3000, 4000]


def test_slots_that_nothing_names_are_a_finding() -> None:
    told = functions("PWM_MAIN", {k: k for k in (1, 2, 3, 4)})
    status = speeds((1, 2, 3, 4), function=False)
    flight = read({"CA_ROTOR_COUNT": 4, **told}, pulses(commanded(4)), esc_status=status)
    assert middle_rpm(flight, 4) == [1000, 2000, 3000, 4000]
    assert "actuator_function is missing or 0" in messages(flight, "rotor", "warning")


# -- battery ----------------------------------------------------------------------------------


def battery(volts: float, connected: int, sag: float = 0.5, number: int = 1) -> dict[str, Any]:
    t = T_S[::4]
    return {
        "t": t,
        "connected": np.full(len(t), connected, dtype=np.uint8),
        "voltage_v": (volts - sag * np.linspace(0, 1, len(t))).astype(np.float32),
        "id": np.full(len(t), number, dtype=np.uint8),
    }


@pytest.mark.parametrize(
    ("first", "second", "chosen"),
    [
        (battery(0.0, 0, 0.0), battery(16.0, 1, number=2), 1),
        (battery(12.3, 0), battery(16.0, 1, number=2), 1),
        (battery(5.0, 1, 0.0), battery(16.0, 1, number=2), 1),  # supply of a companion computer
        (battery(16.0, 1), battery(0.0, 0, 0.0, 2), 0),
    ],
)
def test_the_battery_is_the_instance_that_is_connected_and_sags(
    first: dict[str, Any], second: dict[str, Any], chosen: int
) -> None:
    flight = read({"MAV_TYPE": 2}, battery_status=first, **{"battery_status:1": second})
    assert flight.table["vbat_v"].max() == pytest.approx(16.0)
    assert flight.facts["battery"].startswith(f"battery_status {chosen}")


def test_the_filtered_voltage_serves_where_there_is_no_other() -> None:
    topic = battery(16.0, 1)
    topic["voltage_filtered_v"] = topic["voltage_v"]
    topic["voltage_v"] = np.zeros_like(topic["voltage_v"])
    assert read({"MAV_TYPE": 2}, battery_status=topic).table["vbat_v"].max() == pytest.approx(16.0)


def test_two_batteries_at_once_are_a_finding() -> None:
    pair = {"battery_status": battery(16.0, 1), "battery_status:1": battery(15.9, 1, number=2)}
    flight = read({"MAV_TYPE": 2}, **pair)
    assert "0, 1 are all connected" in messages(flight, "vbat_v", "warning")


def test_a_controller_that_reads_a_lower_voltage_is_named_by_its_motor() -> None:
    """The slots are those of motors 3, 1, 4, 2; that of motor 4 reads half a volt less."""
    motors = (3, 1, 4, 2)
    status = speeds(motors)
    for k, motor in enumerate(motors):
        volts = 16.0 - (0.5 if motor == 4 else 0.0)
        status[f"esc[{k}].esc_voltage"] = np.full(len(T_S), volts, dtype=np.float32)
    flight = read({"CA_ROTOR_COUNT": 4}, pulses(commanded(4)), esc_status=status)
    told = [f.message for f in flight.findings if "speed controller of motor" in f.message]
    assert len(told) == 1 and "motor 4 reads 15.50 V, 0.50 V below" in told[0]
