"""Pulse widths that a PX4 log holds for its motors, and what they mean."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..flight import Array
from .log import Px4Log, Topic

_SIM_PWM_US = (1000.0, 2000.0)


@dataclass(frozen=True, slots=True)
class MotorCommands:
    """Commands 0..1 of all motors.

    Attributes:
        t_us: Times, us since the start of the log, shape (n,).
        cmd: Shape (n, motors).
        facts: What to print about them.
    """

    t_us: NDArray[np.int64]
    cmd: Array
    facts: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Outputs:
    """Logged pulse widths of the motors and the range that stands for 0..1, us."""

    topic: Topic
    pwm_us: Array
    low_us: Array
    high_us: Array

    @property
    def cmd(self) -> Array:
        """Commands, not clipped, shape (n, motors)."""
        return (self.pwm_us - self.low_us) / (self.high_us - self.low_us)


def motor_count(log: Px4Log) -> int | None:
    """Number of motors as the parameters tell it."""
    rotors = log.params.get("CA_ROTOR_COUNT", 0)
    if rotors >= 3:
        return int(rotors)
    return {2: 4, 13: 6, 14: 8, 15: 3}.get(int(log.params.get("MAV_TYPE", 2)))


def logged_outputs(log: Px4Log) -> Outputs | None:
    """Pulse widths of the motors, from the instance of `actuator_outputs` that moves most."""
    n = motor_count(log)
    found: list[tuple[float, int, Topic]] = []
    for instance in log.instances("actuator_outputs"):
        topic = log.topic("actuator_outputs", instance, *(f"output[{k}]" for k in range(n or 4)))
        if topic is not None:
            found.append((float(np.ptp(topic.array("output", n or 4))), -instance, topic))
    if not found:
        return None
    if "MAV_TYPE" not in log.params and "CA_ROTOR_COUNT" not in log.params:
        log.note("warning", "cmd", "the log does not tell the number of motors; 4 taken")
    span, instance, topic = max(found, key=lambda f: f[:2])
    if n is None or span == 0.0:
        why = "MAV_TYPE is no multirotor with 3, 4, 6 or 8 motors" if span else "they never change"
        log.note("warning", "cmd", f"actuator_outputs not used: {why}")
        return None
    if len(found) > 1:
        log.note("info", "cmd", f"actuator_outputs instance {-instance} drives the motors")
    channels = _channels(log, n)
    names = [f"output[{k}]" for k in channels]
    if not topic.has(*names):
        log.note("warning", "cmd", "actuator_outputs not used: it lacks channels of the motors")
        return None
    low, high = _pwm_range(log, channels)
    if np.any(high - low < 1.0):
        log.note("warning", "cmd", f"actuator_outputs not used: PWM range {low[0]:g}..{high[0]:g}")
        return None
    outputs = Outputs(topic, topic.columns(names), low, high)
    if np.nanmax(outputs.cmd) <= 0.0 or np.nanmedian(outputs.cmd) > 1.05:
        log.note(
            "warning",
            "cmd",
            f"actuator_outputs not used: {np.nanmin(outputs.pwm_us):.0f}.."
            f"{np.nanmax(outputs.pwm_us):.0f} does not fit the range {low[0]:.0f}..{high[0]:.0f}",
        )
        return None
    return outputs


def _channels(log: Px4Log, n: int) -> list[int]:
    """Output channel of each motor, from 0; PWM_MAIN_FUNCk = 101.. tells it since PX4 1.13."""
    functions = {log.params.get(f"PWM_MAIN_FUNC{k + 1}"): k for k in range(16)}
    return [functions.get(101.0 + motor, motor) for motor in range(n)]


def _pwm_range(log: Px4Log, channels: list[int]) -> tuple[Array, Array]:
    """Pulse widths for command 0 and 1 of each motor, us."""
    ends = []
    for kind, fallback in zip(("MIN", "MAX"), _SIM_PWM_US, strict=True):
        common = log.params.get(f"PWM_MAIN_{kind}", log.params.get(f"PWM_{kind}", 0.0))
        each = [
            max(log.params.get(f"PWM_MAIN_{kind}{k + 1}", -1.0), 0.0) or common or fallback
            for k in channels
        ]
        ends.append(np.array(each))
    if not any(k.startswith("PWM_") and k.endswith("MAX") for k in log.params):
        log.note("info", "cmd", "no PWM range among the parameters; 1000..2000 us taken")
    return ends[0], ends[1]
