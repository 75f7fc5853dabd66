"""Effects of time: readings that come late."""

from dataclasses import replace

import casadi as ca

from .definition import Block, Effect, EffectParameter, Period
from .seen import Shift
from .sensor_stages import Latency
from .stages import Motors

COMMAND_PERIOD_S = 1e-3
"""How often the motor commands are taken for their delay."""
SAMPLING_S = 0.005
"""A smaller delay is none to speak of: the sampling of a log at 200 Hz may feign it."""
POSE_SAMPLING_S = 0.0125
"""The same for a pose at 80 Hz."""
COMMAND_SAMPLES = 251
"""Commands remembered: a quarter of a second."""


def _later(t: Latency, p: Block) -> Latency:
    return Latency(late=p.enabled, delay_s=t.delay_s + p["delay_s"])


def _commands_later(d: Motors, p: Block) -> Motors:
    """What is taken at a sample instant was there since the one before: that long it is late."""
    delay = p["delay_s"] - COMMAND_PERIOD_S
    delay = ca.fmax(delay, 0.0)
    late = []
    for i, command in enumerate(d.command, start=1):
        held = p.memory(f"cmd_{i}", "1", f"command {i} as it arrives", command)
        p.update(f"cmd_{i}", p.delayed(f"cmd_{i}", command, delay, COMMAND_SAMPLES))
        late.append(held)
    return replace(d, command=late)


IMU_DELAY = Effect(
    "imu_delay",
    "readings of the IMU are older than their time stamps say",
    "imu",
    Latency,
    (EffectParameter("delay_s", "s", "age of a reading", 0.02, (0, 0.2), trifle=SAMPLING_S),),
    ("acc", "gyro"),
    "definition; samples between two instants on a straight line",
    _later,
    seen_as=Shift({"delay_s": ("acc", "gyro")}),
)

POSITION_DELAY = Effect(
    "position_delay",
    "position and velocity are older than the model has them",
    "position",
    Latency,
    (
        EffectParameter(
            "delay_s", "s", "age on top of the model's", 0.1, (0, 0.5), trifle=POSE_SAMPLING_S
        ),
    ),
    ("pos", "acc"),
    "definition; 0.11 s is PX4's assumption for a GNSS receiver (EKF2_GPS_DELAY)",
    _later,
    seen_as=Shift({"delay_s": ("pos", "vel"), "attitude_s": ("q",)}),
    # Attitude may come from where position does, or not.
    of_logs=(
        EffectParameter(
            "attitude_s", "s", "age of the attitude", 0.1, (0, 0.5), trifle=POSE_SAMPLING_S
        ),
    ),
)

COMMAND_DELAY = Effect(
    "command_delay",
    "motors get their commands later than the log says",
    "airframe",
    Motors,
    (
        EffectParameter(
            "delay_s", "s", "age of a command when it arrives", 0.02, (0, 0.2), trifle=SAMPLING_S
        ),
    ),
    ("acc", "gyro", "cmd"),
    "definition; at least 1 ms, the sample period, once it is on",
    _commands_later,
    seen_as=Shift({"delay_s": ("cmd",)}, acts=True),
    period=Period(COMMAND_PERIOD_S, "Time between two looks at the commands, for command_delay"),
)

EFFECTS = (IMU_DELAY, POSITION_DELAY, COMMAND_DELAY)
