"""A flight gone through in blocks of rows gives what it gives in one piece, to the bit."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from twin.logs import Flight, StoredFlight, open_flight, read_flight, write_flight
from twin.logs import table as table_module
from twin.residuals.aligned import Alignment, align_flight
from twin.residuals.channels import GRID_HZ
from twin.residuals.flight_gap import flight_gap
from twin.residuals.short_horizon import window_starts
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

SHORT: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 1.5, (0.0, 0.0, -1.0)),
    ("forward", 2.0, (2.0, 1.0, -1.0)),
    ("land", 1.5, (2.0, 1.0, 0.0)),
)
LOADED = {"slung_load": {"mass_kg": 0.1, "length_m": 0.8}, "command_delay": {"delay_s": 0.013}}


@cache
def flight() -> Flight:
    vehicle = load_vehicle("copter_default")
    return fly(vehicle, vehicle, 0, "short", SHORT)


@cache
def vehicle(loaded: bool) -> Vehicle:
    made = load_vehicle("copter_default")
    return made.with_effects(LOADED) if loaded else made


def test_readings_corrected_for_a_low_pass_are_compared_without_it() -> None:
    filtered = replace(vehicle(False), accel_cutoff_hz=30.0, gyro_cutoff_hz=80.0)
    for early in ({}, {"gyro": 0.0028}, {"acc": 0.0075}, {"acc": 0.0075, "gyro": 0.0028}):
        stepped = Alignment(replace(flight(), filter_delays_s=early), filtered).imu.states
        passed = {s.name.split("_")[0] for s in stepped if "_lp_" in s.name}
        assert passed == {"acc", "gyro"} - {*early}


@pytest.mark.slow
@pytest.mark.parametrize("loaded", [False, True])
def test_blocks_are_parts_of_the_whole(loaded: bool) -> None:
    """Rotor states, what hangs on a rope and what comes late go on from one to the next."""
    grid_s = 1 / GRID_HZ
    whole = align_flight(flight(), vehicle(loaded), grid_s)
    alignment = Alignment(flight(), vehicle(loaded), grid_s)
    edges = [0, 1, 2, 100, 437, 438, 900, alignment.rows]
    blocks = list(alignment.blocks(edges))
    hidden = [s.name for s in whole.airframe.states if s.name.startswith("slung_load")]
    assert bool(hidden) == loaded
    for name in ("t_s", "u", "rotor_states"):
        parts = np.concatenate([getattr(b.inputs, name) for b in blocks])
        np.testing.assert_array_equal(parts, getattr(whole.inputs, name), err_msg=name)
    np.testing.assert_array_equal(np.vstack([b.states for b in blocks]), whole.states)
    np.testing.assert_array_equal(alignment.airborne(blocks), whole.airborne)


def test_spans_of_phases_are_those_of_the_grid() -> None:
    alignment = Alignment(flight(), vehicle(False))
    phases = alignment.phases(0, alignment.rows)
    at_s = alignment.times(0, alignment.rows)
    names = [name for name, _, _ in alignment.spans()]
    assert names == [leg[0] for leg in SHORT]
    for name, start_s, end_s in alignment.spans():
        assert set(phases[(at_s >= start_s) & (at_s < end_s)]) == {name}


@pytest.mark.slow
@pytest.mark.parametrize("block_rows", [311, 1700])
def test_the_gap_is_the_same_in_blocks_and_from_a_file(
    block_rows: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table_module, "HELD_CELLS", 0)
    path = tmp_path / "short.parquet"
    write_flight(flight(), path)
    stored = open_flight(path)
    assert isinstance(stored, StoredFlight)
    once = flight_gap(read_flight(path), vehicle(False), 0.1)
    again = flight_gap(stored, vehicle(False), 0.1, block_rows=block_rows)
    assert len(once.channels) == len(again.channels) == 18
    assert (once.phases, once.warnings, once.facts) == (again.phases, again.warnings, again.facts)
    for one, other in zip(once.channels, again.channels, strict=True):
        for what in ("t_s", "measured", "simulated", "phase"):
            np.testing.assert_array_equal(getattr(one, what), getattr(other, what), one.name)


def plainly(known: NDArray[np.bool_], steps: int) -> list[int]:
    """The same as a walk from row to row."""
    starts, k = [], 0
    while k + steps < len(known):
        if known[k : k + steps + 1].all():
            starts.append(k)
            k += steps
        else:
            k += 1
    return starts


@given(st.lists(st.booleans(), max_size=60), st.integers(1, 9))
def test_windows_follow_each_other(known: list[bool], steps: int) -> None:
    rows = np.array(known, dtype=np.bool_)
    assert window_starts(rows, steps).tolist() == plainly(rows, steps)
