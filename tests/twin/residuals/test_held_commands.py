"""Held commands act when the controller gave them, however seldom a log samples them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from twin.flight.closed_loop import STEP_S
from twin.logs import Flight
from twin.logs.columns import motor_columns
from twin.physics.airframe import airframe
from twin.residuals.teacher_forced import InputSignals
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

Array = NDArray[np.float64]
VEHICLE = load_vehicle("copter_default")
COMMANDS = list(motor_columns("cmd", VEHICLE.rotors.count))
WAY: Waypoints = (("ground", 0.5, (0.0, 0.0, 0.0)), ("takeoff", 2.0, (1.0, 0.5, -1.0)))
SLOW = butter(2, 8.0, fs=1 / STEP_S, output="sos")


@cache
def flight() -> Flight:
    """With every command that the controller gave."""
    return fly(VEHICLE, VEHICLE, 0, "every command", WAY, STEP_S)


@pytest.mark.parametrize("delay_s", [0.0, 0.013])
@pytest.mark.parametrize("grid_s", [STEP_S, 5 * STEP_S])
@pytest.mark.parametrize("rate_hz", [20, 50, 100, 200, 250, 1000])
def test_commands_are_as_late_as_the_vehicle_says(
    rate_hz: int, grid_s: float, delay_s: float
) -> None:
    """Each input acts for a step of the grid."""
    table = flight().table
    rows = table.iloc[:: round(1 / (rate_hz * STEP_S))].reset_index(drop=True)
    late = {"command_delay": {"delay_s": delay_s}} if delay_s else {}
    body, vehicle = airframe(VEHICLE), VEHICLE.with_effects(late)
    signals = InputSignals(replace(flight(), table=rows), vehicle, body, grid_s)
    every = round(grid_s / STEP_S)
    t_s = table["time"].to_numpy()[::every]
    taken = signals.at(t_s)[:, [body.input_names.index(c) for c in COMMANDS]]
    acting = np.repeat(taken, every, axis=0)[: len(table)]
    assert lateness_s(table[COMMANDS].to_numpy(), acting) == pytest.approx(delay_s, abs=2e-4)


def lateness_s(given: Array, taken: Array) -> float:
    """By least squares, of signals on the steps of a flight, below 8 Hz."""
    given, taken = (sosfiltfilt(SLOW, v, axis=0)[600:-150] for v in (given, taken))
    steps = np.arange(-40, 41)
    inner = slice(40, -40)
    off = [np.sum((np.roll(given, k, axis=0) - taken)[inner] ** 2) for k in steps]
    low = int(np.argmin(off))
    a, b, _ = np.polyfit(steps[low - 1 : low + 2], off[low - 1 : low + 2], 2)
    return float(STEP_S * -b / (2 * a))
