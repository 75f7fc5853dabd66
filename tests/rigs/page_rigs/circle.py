"""A made-up flight in a circle, and a twin that drifts off it: what pages of gaps are drawn of."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from twin.logs import Flight
from twin.logs.autopilot import (
    LEVELS,
    Autopilot,
    Filter,
    Interval,
    Message,
    Mode,
    Parameter,
    Setpoint,
)
from twin.logs.columns import GYRO, POS, QUAT, VEL
from twin.residuals.gap import Channel, FlightGap

Array = NDArray[np.float64]
HOSTILE = "</script><img src=https://example.invalid/x onerror=alert(1)><b>&'\""


def recorded(seconds: float = 20.0) -> Flight:
    """A flight in a circle, with everything that the top of a page shows."""
    t = np.arange(0, seconds, 0.02)
    table: dict[str, Array] = {"time": t}
    circle = (2 * np.sin(0.5 * t), 2 * np.cos(0.5 * t), -1 - 0.05 * t)
    table |= dict(zip(POS, circle, strict=True))
    table |= dict(zip(QUAT, (np.cos(0.1 * t), 0 * t, 0 * t, np.sin(0.1 * t)), strict=True))
    table |= {f"cmd_{i}": 0.5 + 0.02 * i + 0.05 * np.sin(t + i) for i in range(1, 5)}
    table |= {f"rotor_{i}": 500 + 10 * np.sin(t + i) for i in range(1, 5)}
    shaken = np.sin(2 * np.pi * (12 + 0.3 * t) * t)
    table |= {name: k + 0.2 * shaken for k, name in enumerate(GYRO)}
    table |= {"vbat_v": 16.4 - 0.02 * t, "ibat_a": 9 + 0 * t}
    return Flight("circle", pd.DataFrame(table), autopilot=_said(t))


def _said(t: Array) -> Autopilot:
    """Much of everything, some of it made to break a page."""
    texts = (HOSTILE, "EKF yaw aligned", "a very long text " * 17)
    messages = [Message(0.4 * k, LEVELS[k % 9], texts[k % 3]) for k in range(-2, 60)]
    turn = np.column_stack([np.cos(0.1 * t), 0 * t, 0 * t, np.sin(0.1 * t)])
    return Autopilot(
        tuple(Mode(name, 2.0 * k) for k, name in enumerate(("Hold", HOSTILE, "Land", "x" * 90))),
        (Interval("armed", 0.5, 19.0),),
        (Interval("battery failsafe", 12.0, 20.0), Interval(HOSTILE, 1.0, 1.01)),
        tuple(messages),
        (
            Setpoint(POS, t[::5], np.where(np.arange(3) == 1, np.nan, np.sin(t[::5, None]))),
            Setpoint(VEL, t[::5], np.cos(t[::5, None] + np.arange(3))),
            Setpoint(QUAT, t[::5], turn[::5]),
            Setpoint(GYRO, t[::5], 0.1 * turn[::5, :3]),
        ),
        tuple(Parameter(f"NAME_{k}_{HOSTILE[:9]}", k / 7, -1e-9 * k) for k in range(400)),
        tuple(
            Filter("gyro", "tracking notch", 8.0 * k, f"INS_HNTCH_FREQ{HOSTILE[:9]}")
            for k in range(1, 7)
        ),
    )


def gap_of(flight: Flight, seed: int = 0) -> FlightGap:
    """Residuals of it: vibration, and a twin that drifts off."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, 20, 0.01)
    phase = np.where(t < 3, "takeoff", "hover").astype(np.str_)
    every = slice(50, None, 50)
    channels = []
    for k, axis in enumerate("xyz"):
        slow = np.sin(0.5 * t + k)
        shaken = slow + 0.4 * rng.standard_normal(len(t))
        channels.append(Channel(f"acc_{axis}", "m/s2", 0.0, t, shaken, 0.8 * slow, phase))
        way = flight.table[f"pos_{axis}"].to_numpy()[: len(t) // 2].repeat(2)[every]
        end = Channel(f"pos_{axis}", "m", 0.5, t[every], way, way + 0.1, phase[every])
        channels.append(end)
    spans = (("takeoff", 0.0, 3.0), ("hover", 3.0, 19.0), ("land", 19.0, 20.0))
    return FlightGap("circle", "made_up", tuple(channels), spans, ("beware",), {"rate": "100 Hz"})


def much_of(seed: int, seconds: float = 100.0) -> FlightGap:
    """As many channels as a log gives, twice as dense, with a gap in the record."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds, 0.01)
    t = t[(t < 0.5 * seconds) | (t > 0.55 * seconds)]
    ends = np.arange(0.5, seconds, 0.5)
    channels = []
    for axis in "xyz":
        for name, unit, t_s, horizon_s in (
            ("acc", "m/s2", t, 0.0),
            ("gyro_rate", "rad/s2", t, 0.0),
            ("pos", "m", ends, 0.5),
            ("vel", "m/s", ends, 0.5),
            ("att", "rad", ends, 0.5),
            ("gyro", "rad/s", ends, 0.5),
        ):
            slow = np.sin(0.5 * t_s + seed) + 0.3 * rng.standard_normal(len(t_s))
            left = 0.02 * (1 + seed) * np.cos(0.3 * t_s) + 0.1 * rng.standard_normal(len(t_s))
            phase = np.where(t_s < 5, "takeoff", "hover").astype(np.str_)
            channels.append(
                Channel(f"{name}_{axis}", unit, horizon_s, t_s, slow, slow - left, phase)
            )
    spans = tuple((f"part {k}", 5.0 * k, 5.0 * k + 5.0) for k in range(int(seconds / 5)))
    return FlightGap(f"flight {seed}", "made_up", tuple(channels), spans, (), {"rate": "100 Hz"})
