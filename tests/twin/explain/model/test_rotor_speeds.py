"""Flights that hold rotor speeds, motor commands or both: what drives the model decides what a
search can show."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from rig import fitted
from search_rigs.hypotheses import against, fit_set
from search_rigs.library import library

from twin.effects import EFFECTS
from twin.explain.explanation import explain
from twin.explain.model.model import candidates, model_of
from twin.flight.closed_loop import STEP_S
from twin.flight.simulate_flight import Stream, simulate_flight
from twin.logs import Flight
from twin.logs.columns import motor_columns
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo import flights as demo

VEHICLE = load_vehicle("copter_default")
WAYPOINTS: demo.Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -2.0)),
    ("tour", 2.0, (3.0, 0.0, -2.0)),
    ("tour", 2.0, (3.0, 3.0, -3.0)),
    ("tour", 2.0, (0.0, 0.0, -2.0)),
)
COMMANDS, SPEEDS = motor_columns("cmd", 4), motor_columns("rotor", 4)
OF_COMMANDS = {"motor_lag", "command_delay"}
FEW = (
    *sorted(OF_COMMANDS),
    "rotor_drag",
    "steady_wind",
    "mass_offset",
    "accel_bias",
    "accel_scale",
)
"""Candidates of the whole search."""


def flown(plant: Vehicle, turned_rad: float = 0.0) -> Flight:
    """A flight with commands and rotor speeds, the nose to and fro."""
    setpoints, phases = demo.setpoints_along(plant, WAYPOINTS)
    since = np.clip(STEP_S * np.arange(len(setpoints)) - 2.5, 0.0, None)
    setpoints[:, 9] = turned_rad * np.sin(2 * np.pi * 0.4 * since) ** 2
    recorder = demo.recorder_of(plant, 3, demo.IMU_S)
    streams = (*recorder.streams, Stream(SPEEDS, demo.IMU_S))
    return simulate_flight(setpoints, phases, VEHICLE, plant, replace(recorder, streams=streams))


def without(flight: Flight, columns: Sequence[str]) -> Flight:
    return replace(flight, table=flight.table.drop(columns=list(columns)))


@pytest.fixture(scope="module")
def lagging() -> Flight:
    return flown(VEHICLE.with_effects({"motor_lag": {"tau_s": 0.05}}))


@pytest.fixture(scope="module")
def dragged() -> Flight:
    return flown(VEHICLE.with_effects({"rotor_drag": {"k_xy_1_s": 0.5, "k_z_1_s": 0.0}}))


KINDS = {"rotor speeds": COMMANDS, "commands": SPEEDS, "both": ()}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_an_effect_is_named_whatever_drives_the_model(kind: str, dragged: Flight) -> None:
    flight = without(dragged, KINDS[kind])
    with library(FEW):
        found = explain([flight], [], VEHICLE, missions=[])
    assert found.verdict == "named", (found.reasons, found.warnings)
    assert found.naming is not None
    assert found.naming.named == ("rotor_drag",)
    assert found.values["rotor_drag.k_xy_1_s"] == pytest.approx(0.5, rel=0.15)
    hidden = [w for w in found.warnings if "not visible" in w]
    if kind == "commands":
        assert not hidden
    else:
        assert len(hidden) == 1 and all(e in hidden[0] for e in OF_COMMANDS)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_nothing_between_command_and_rotor_is_visible_where_rotor_speeds_drive(
    kind: str, dragged: Flight
) -> None:
    flight = without(dragged, KINDS[kind])
    model = model_of([flight], VEHICLE, candidates([flight]))
    assert OF_COMMANDS.isdisjoint(model.effects) == (kind != "commands")
    assert {*model.unobservable} == (set() if kind == "commands" else OF_COMMANDS)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_lag_is_told_from_commands_alone(kind: str, lagging: Flight) -> None:
    flight = without(lagging, KINDS[kind])
    problem = against(flight, VEHICLE)
    if kind == "commands":
        fitted = fit_set(problem, ["motor_lag"])
        assert fitted.gain > 50
        assert fitted.values["motor_lag.tau_s"] == pytest.approx(0.05, rel=0.15)
    else:  # measured speeds have the lag in them already: there is nothing to explain
        assert fit_set(problem, ["rotor_drag"]).gain < 10


@pytest.mark.slow
def test_late_stamps_of_the_speeds_are_estimated(dragged: Flight) -> None:
    """20 ms, which a motor may have, so that no reader takes them off; against the same flight as
    it is."""
    flight, name = without(dragged, COMMANDS), "clock_offset.rotor_s"
    table = flight.table.copy()
    for column in SPEEDS:
        known = table[column].notna()
        t_s = table.loc[known, "time"]
        table.loc[known, column] = np.interp(t_s - 0.02, t_s, table.loc[known, column])
    before, after = (
        fitted(model_of([f], VEHICLE, [EFFECTS["clock_offset"]]), [name])[name]
        for f in (flight, replace(flight, table=table))
    )
    assert before == pytest.approx(0.0, abs=0.006)
    assert after - before == pytest.approx(0.02, abs=0.004)


@pytest.mark.slow
def test_flights_of_two_kinds_show_what_both_can_show(dragged: Flight) -> None:
    flights = [without(dragged, SPEEDS), replace(without(dragged, COMMANDS), name="other")]
    model = model_of(flights, VEHICLE, candidates(flights))
    assert {*model.unobservable} == OF_COMMANDS
    assert OF_COMMANDS.isdisjoint(model.effects)
    assert "rotor_drag" in model.effects


@pytest.mark.slow
def test_the_torque_of_rotors_that_speed_up_is_seen_in_measured_speeds() -> None:
    truth = {"momentum_n_m_s": EFFECTS["rotor_inertia_torque"].starts(VEHICLE)["momentum_n_m_s"]}
    flight = flown(VEHICLE.with_effects({"rotor_inertia_torque": truth}), turned_rad=0.8)
    flight = without(flight, COMMANDS)
    problem = against(flight, VEHICLE, "rotor_inertia_torque")
    found = fit_set(problem, ["rotor_inertia_torque"])
    name = "rotor_inertia_torque.momentum_n_m_s"
    assert found.gain > 20
    assert found.values[name] == pytest.approx(truth["momentum_n_m_s"], rel=0.2)
    assert np.all(np.isfinite(found.half_widths))
