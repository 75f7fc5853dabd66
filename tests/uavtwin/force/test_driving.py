"""A flight as inputs of a driven twin."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rig import plain

from cosim.interface import read_interface
from learning.force.windows import true_motion
from twin.logs import Flight
from twin.residuals.aligned import AlignedFlight, align_flight
from twin.residuals.measured import Signal
from twin.residuals.teacher_forced import GRID_S, RIGID
from twin.vehicle_file import load_vehicle
from uavtwin.compensators.in_use import UsedFlight
from uavtwin.demo.flights import fly
from uavtwin.exports.parts import twin
from uavtwin.exports.write import export
from uavtwin.force.open_loop import Replay, driving_inputs

LEGS = (("ground", 0.5, (0.0, 0.0, 0.0)), ("takeoff", 2.0, (0.5, 0.0, -1.0)))
DELAYED = plain().with_effects({"command_delay": {"delay_s": 0.02}})


@pytest.fixture(scope="module")
def flown() -> tuple[Flight, AlignedFlight]:
    flight = fly(plain(), plain(), 3, waypoints=LEGS)
    return flight, align_flight(flight, DELAYED)


def test_commands_are_those_of_the_log(flown: tuple[Flight, AlignedFlight]) -> None:
    """The airframe delays them itself: late ones would be late twice."""
    flight, aligned = flown
    table = driving_inputs(flight, DELAYED, aligned, np.zeros(0, dtype=np.intp))
    t = aligned.inputs.t_s
    for n in range(1, 5):
        there = Signal(*flight.signal([f"cmd_{n}"])).held(t)[:, 0]
        np.testing.assert_array_equal(table[f"airframe.cmd_{n}"], there)
    late = aligned.inputs.u[:, aligned.airframe.input_names.index("cmd_1")]
    assert np.abs(table["airframe.cmd_1"] - late).max() > 0.01
    np.testing.assert_allclose(np.diff(table["time"]), GRID_S)
    assert not table["airframe.restart"].any()


def test_a_step_is_given_the_motion_at_its_end(flown: tuple[Flight, AlignedFlight]) -> None:
    flight, aligned = flown
    rows = np.array([700, 701, 900])
    table = driving_inputs(flight, DELAYED, aligned, rows)
    np.testing.assert_array_equal(np.flatnonzero(table["airframe.restart"]) + 1, rows)
    for i, name in enumerate(RIGID):
        there = true_motion(DELAYED, aligned)[rows, i]
        np.testing.assert_array_equal(table[f"airframe.restart.{name}"][rows - 1], there)


def test_the_age_of_a_pose_is_taken_out_on_the_grid_of_the_twin(
    flown: tuple[Flight, AlignedFlight],
) -> None:
    """50 ms are fifty steps of the twin, whatever grid the residuals are on."""
    _, aligned = flown
    late = plain().with_effects({"position_delay": {"delay_s": 0.05}})
    names = [s.name for s in aligned.airframe.states]
    now, prompt = true_motion(late, aligned), aligned.states
    for name in ("pos_x", "pos_z"):
        there, logged = now[:, RIGID.index(name)], prompt[:, names.index(name)]
        np.testing.assert_allclose(there[600:-100], logged[650:-50], atol=2e-4)
        assert np.abs(there[600:-100] - logged[600:-100]).max() > 0.01


def test_unknown_motion_is_never_given(flown: tuple[Flight, AlignedFlight]) -> None:
    flight, aligned = flown
    states = aligned.states.copy()
    states[800:810, 3] = np.nan
    every = np.arange(1, len(states))
    table = driving_inputs(flight, DELAYED, replace(aligned, states=states), every)
    off = np.flatnonzero(~table["airframe.restart"]) + 1
    assert set(range(800, 810)) <= set(off.tolist())
    assert 790 not in off
    assert all(np.isfinite(table[name]).all() for name in table.dtype.names or ())


@pytest.mark.slow
def test_rotor_speeds_come_with_their_rates() -> None:
    """Where the twin asks for them."""
    spun = load_vehicle("copter_default")
    flight = fly(spun, spun, 3, waypoints=LEGS)
    if not flight.has("rotor_1"):
        speed_rad_s = 800.0 * flight.table["cmd_1"].to_numpy(dtype=np.float64)
        speeds = {f"rotor_{n}": speed_rad_s for n in range(1, 5)}
        flight = replace(flight, table=flight.table.assign(**speeds))
    aligned = align_flight(flight, spun, effects=["rotor_inertia_torque"])
    table = driving_inputs(flight, spun, aligned, np.zeros(0, dtype=np.intp))
    assert "airframe.rotor_4" in (table.dtype.names or ())
    assert np.abs(table["airframe.spin_rate_4"]).max() > 0


@pytest.mark.slow
def test_a_twin_takes_the_voltage_of_a_log_where_it_has_that_input(tmp_path: Path) -> None:
    """The thrust of one vehicle depends on it, that of the other does not."""
    fixed = plain()
    sags = plain(rotors=replace(fixed.rotors, reference_voltage_v=15.0))
    legs = (*LEGS, ("forward", 2.0, (0.5, 0.0, -1.0)))
    flight = fly(fixed, fixed, 3, waypoints=legs)
    volts = np.linspace(16.0, 14.0, len(flight.table))
    flight = replace(flight, table=flight.table.assign(vbat_v=volts))
    for vehicle, asks in ((fixed, False), (sags, True)):
        fmu = export(twin(vehicle, drive="command"), tmp_path / f"{asks}.fmu").paths[0]
        assert ("airframe.vbat_v" in read_interface(fmu).ports) == asks
        assert np.isfinite(Replay(flight, vehicle, (0.1,)).through(fmu).off).all()
        used = UsedFlight(flight, vehicle).through(fmu, ["airframe.pos_x"])
        assert any(one.flown.any() for one in used)
