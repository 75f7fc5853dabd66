"""Effects of time: late readings, clock offsets, a smoothed pose."""

from dataclasses import replace

import casadi as ca

from .definition import Average, Block, Effect, Period, Shift, effect_of_records
from .parameters import COMMON, LAST, RARE, EffectParameter, Normal, Prior
from .stages import Latency, Motors
from .wording import FLY_FOR_INERTIA, Wording, delay_clause

COMMAND_PERIOD_S = 1e-3
"""Sample period of the motor commands for their delay."""
SAMPLING_S = 0.005
"""Smallest relevant delay: sampling of a log at 200 Hz may imitate a smaller one."""
POSE_SAMPLING_S = 0.0125
"""Smallest relevant delay of a pose at 80 Hz."""
COMMAND_SAMPLES = 251
"""Number of stored commands: a quarter of a second."""


CLOCK_S = 0.25
"""Largest clock offset; larger ones are corrected before a log is read."""


def _later(t: Latency, p: Block) -> Latency:
    return Latency(late=p.enabled, delay_s=t.delay_s + p["delay_s"])


def _commands_later(d: Motors, p: Block) -> Motors:
    """A command sampled at an instant was constant since the previous one: that is its delay."""
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
    observable_as=Shift({"delay_s": ("acc", "gyro")}),
    prior=Prior(COMMON, "filters, bus", {"": Normal(0.0, 0.008)}),
    change=Prior(RARE, "another filter", {"": Normal(0.0, 0.02)}),
    wording=Wording(delay_clause("its IMU reads")),
    advice=None,
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
    observable_as=Shift({"delay_s": ("pos", "vel"), "attitude_s": ("q",)}),
    # Attitude may have the same source as position, or not.
    of_logs=(
        EffectParameter(
            "attitude_s", "s", "age of the attitude", 0.1, (0, 0.5), trifle=POSE_SAMPLING_S
        ),
    ),
    prior=Prior(COMMON, "motion capture 36 to 100 ms, GNSS 100 to 200 ms", {"": Normal(0.0, 0.05)}),
    change=Prior(RARE, "another receiver", {"": Normal(0.0, 0.05)}),
    wording=Wording(delay_clause("its position arrives"), largest_alone=True),
    advice=None,
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
    observable_as=Shift({"delay_s": ("cmd",)}, acts=True),
    period=Period(COMMAND_PERIOD_S, "Time between two looks at the commands, for command_delay"),
    prior=Prior(
        COMMON,
        "a loop and a frame of PWM; 10 to 30 ms where commands come by radio",
        {"": Normal(0.004, 0.012)},
        start=True,
    ),
    change=Prior(RARE, "another firmware", {"": Normal(0.0, 0.02)}),
    wording=Wording(delay_clause("its motors get their commands")),
    advice={"": FLY_FOR_INERTIA},
)

_CLOCKS = (
    ("pose_s", "position and velocity", ("pos", "vel"), POSE_SAMPLING_S),
    ("attitude_s", "attitude", ("q",), POSE_SAMPLING_S),
    ("accelerometer_s", "accelerometer", ("acc",), SAMPLING_S),
    ("command_s", "motor commands", ("cmd",), SAMPLING_S),
    ("rotor_s", "rotor speeds", ("rotor",), SAMPLING_S),
)

CLOCK_OFFSET = effect_of_records(
    "clock_offset",
    "the time stamps of a record are apart: some of its signals are older or younger than the "
    "gyroscope's of the same stamp",
    tuple(
        EffectParameter(
            name,
            "s",
            f"age over that of the gyroscope, {what}",
            0.02,
            (-CLOCK_S, CLOCK_S),
            trifle=trifle,
        )
        for name, what, _, trifle in _CLOCKS
    ),
    ("gyro",),  # any other signal that a flight lacks has no clock there
    "definition: the same added to every clock changes nothing, so one of them is the reference",
    Shift({name: signals for name, _, signals, _ in _CLOCKS}),
    prior=Prior(
        LAST,
        "records put together from several clocks, each flight by itself; what an aircraft logs "
        "on board has one",
        {
            "": Normal(0.0, 0.03),
            "pose_s": Normal(0.0, 0.03, 0.02),
            "attitude_s": Normal(0.0, 0.03, 0.02),
        },
    ),
    change=None,
    wording=None,
    advice=None,
)

POSE_SMOOTHING = effect_of_records(
    "pose_smoothing",
    "the logged pose is smoother than the motion: averaged over time by an estimator or a motion "
    "capture, as far ahead as back",
    tuple(
        EffectParameter(
            name, "s2", f"{what}: square of the standard width of the average", 4e-4, (0, 0.01)
        )
        for name, what in (("attitude_s2", "attitude"), ("position_s2", "position and velocity"))
    ),
    ("q", "gyro"),
    "forces less their average by a normal distribution with variance q; rotations x - (q/2) x'', "
    "to second order: Taylor's theorem, exact for motion that is slow over its width",
    Average({"attitude_s2": ("q",), "position_s2": ("pos", "vel")}),
    prior=Prior(
        COMMON,
        "motion capture and smoothers average over some frames: 30 ms",
        {"": Normal(0.0, 9e-4)},
        start=True,
    ),
    change=None,
    wording=None,
    advice=None,
)

EFFECTS = (IMU_DELAY, POSITION_DELAY, COMMAND_DELAY, CLOCK_OFFSET, POSE_SMOOTHING)
"""Effects of this module, in the order of the documentation."""
