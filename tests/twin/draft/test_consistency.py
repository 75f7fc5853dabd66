"""Vehicle files whose rotors are not those that the log states are refused; all others are not."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from places import DATA, needs

from twin.draft.consistency import check_airframe, consistency
from twin.errors import ModelError
from twin.logs import Flight, read_flight
from twin.logs.airframe import Airframe, Cells, SourcedValue
from twin.logs.ardupilot.airframe import CLASSES, TYPES, geometry
from twin.residuals.teacher_forced import choose_drive, drive_warnings
from twin.vehicle import Battery, Vehicle
from twin.vehicle.layouts import CCW, CW, FRAMES, Layout, frame
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly

Array = NDArray[np.float64]
BASE = replace(load_vehicle("copter_default"), file="mine.toml")
ARM_M = 0.23


def of(position: Array, direction: Array) -> Vehicle:
    """An aircraft with these rotors, the farthest at `ARM_M`."""
    scale = ARM_M / np.linalg.norm(position[:, :2], axis=1).max()
    rotors = replace(BASE.rotors, position_m=position * scale, direction=direction)
    return replace(BASE, rotors=rotors)


def stated(layout: Layout | None, **facts: object) -> Flight:
    """A flight whose log states these rotors."""
    n = 4 if layout is None else layout.count
    table = pd.DataFrame({"time": np.arange(3) * 0.01, "acc_z": -9.8, "phase": "hover"})
    table = table.assign(**{f"cmd_{k}": 0.5 for k in range(1, n + 1)})
    return Flight("flight", table, airframe=Airframe(layout=layout, **facts))  # type: ignore[arg-type]


def px4(name: str) -> Layout:
    """The same rotors as PX4 1.13 and later have them, by parameter."""
    return replace(
        frame(name),
        place_keys="CA_ROTOR{}_PX, _PY of the log",
        sense_keys="CA_ROTOR{}_KM of the log",
    )


ARDUPILOT = [
    (number, kind) for number in CLASSES for kind in TYPES if geometry(number, kind) is not None
]


@pytest.mark.parametrize("name", FRAMES)
def test_the_rotors_of_the_log_are_accepted(name: str) -> None:
    """A centre of mass off by a tenth, coordinates off by as much, and another size."""
    layout = frame(name)
    rng = np.random.default_rng(0)
    for _ in range(20):
        shape = rng.uniform(0.9, 1.1, layout.position.shape)
        position = layout.position * shape + rng.uniform(-0.1, 0.1, 3)
        check_airframe(stated(layout), of(position, layout.direction))


@pytest.mark.parametrize(("number", "kind"), ARDUPILOT)
def test_frames_of_ardupilot_are_those_of_their_number(number: int, kind: int) -> None:
    told = geometry(number, kind)
    assert told is not None
    layout = Layout(
        np.column_stack([told.direction, np.zeros(told.count)]),
        np.where(told.turn > 0.0, CCW, CW),
        metric=False,
        sd=0.05,
        source=f"FRAME_CLASS {number} and FRAME_TYPE {kind} of the log",
    )
    check_airframe(stated(layout), of(layout.position, layout.direction))
    with pytest.raises(ModelError, match=r"rotors\.direction of mine\.toml .*FRAME_CLASS"):
        check_airframe(stated(layout), of(layout.position, -layout.direction))


@pytest.mark.parametrize("name", FRAMES)
def test_turned_senses_name_both_fields(name: str) -> None:
    layout = px4(name)
    for wrong in (range(layout.count), [0], [layout.count - 1], [1, 2]):
        direction = layout.direction.copy()
        direction[list(wrong)] *= -1
        with pytest.raises(ModelError) as error:
            check_airframe(stated(layout), of(layout.position, direction))
        first = wrong[0]
        text, says = str(error.value), "cw" if direction[first] > 0 else "ccw"
        assert f"rotors.direction of mine.toml says {says} for rotor {first + 1} (" in text
        assert f"CA_ROTOR{first}_KM of the log says {'ccw' if says == 'cw' else 'cw'}" in text
        assert text.startswith("flight: ") and "--trust-vehicle" in text
        assert "rotors.position" not in text


@pytest.mark.slow
@given(st.sampled_from(list(FRAMES)), st.randoms(use_true_random=False))
def test_rows_in_another_order_are_told(name: str, random: object) -> None:
    """Rows of both keys, or of the positions alone."""
    layout = px4(name)
    order = list(range(layout.count))
    random.shuffle(order)  # type: ignore[attr-defined]
    for direction in (layout.direction, layout.direction[order]):
        vehicle = of(layout.position[order], direction)
        if order == sorted(order):
            check_airframe(stated(layout), vehicle)
            continue
        with pytest.raises(ModelError, match=r"the rows of rotors\.position of mine\.toml") as e:
            check_airframe(stated(layout), vehicle)
        rows = ", ".join(str(order.index(k) + 1) for k in range(layout.count))
        assert f"motors 1 to {layout.count} of the log are its rows {rows}" in str(e.value)
        assert "CA_ROTOR" in str(e.value)


@pytest.mark.parametrize("name", FRAMES)
@pytest.mark.parametrize("axis", [0, 1])
def test_mirrored_places_are_told(name: str, axis: int) -> None:
    layout = px4(name)
    position = layout.position.copy()
    position[:, axis] *= -1
    with pytest.raises(ModelError, match=r"rotors\.position of mine\.toml"):
        check_airframe(stated(layout), of(position, layout.direction))


@pytest.mark.parametrize("name", [n for n in FRAMES if n != "wide"])
def test_a_frame_turned_by_half_a_pitch_is_another(name: str) -> None:
    """A plus is no X, of four, six and eight rotors."""
    layout = px4(name)
    half = np.pi / layout.count
    turn = np.array([[np.cos(half), -np.sin(half), 0], [np.sin(half), np.cos(half), 0], [0, 0, 1]])
    with pytest.raises(ModelError, match=r"rotors\.position of mine\.toml has rotor"):
        check_airframe(stated(layout), of(layout.position @ turn.T, layout.direction))


def test_betaflights_order_is_not_px4s() -> None:
    with pytest.raises(ModelError, match="another order"):
        own = frame("betaflight x")
        check_airframe(stated(px4("x")), of(own.position, own.direction))


def test_rotors_of_another_number_are_refused() -> None:
    layout = px4("hex x")
    with pytest.raises(ModelError, match=r"has 4 rotors, the log has 6"):
        check_airframe(stated(layout), of(frame("x").position, frame("x").direction))
    told = stated(None, rotors=SourcedValue(6, "CA_ROTOR_COUNT of the log"))
    bare = replace(told, table=told.table[["time", "acc_z", "phase"]])
    with pytest.raises(ModelError, match=r"the log has 6 \(CA_ROTOR_COUNT of the log\)"):
        check_airframe(bare, BASE)
    check_airframe(told, BASE)  # its four outputs say more than a parameter


def test_what_a_log_does_not_know_is_no_contradiction() -> None:
    layout = frame("x")
    turned, moved = of(layout.position, -layout.direction), of(layout.position[::-1], BASE_SENSES)
    for silent in (Flight("flight", stated(None).table), stated(None)):
        assert consistency(silent, turned) == consistency(silent, moved)
        assert (
            consistency(silent, turned).error == "" == " ".join(consistency(silent, moved).warnings)
        )
    check_airframe(stated(replace(layout, senses_known=False)), turned)
    check_airframe(stated(replace(layout, places_known=False)), moved)


BASE_SENSES = frame("x").direction[::-1]


def test_each_verb_asks_before_it_computes() -> None:
    """What drives a twin is asked by all of them."""
    layout = px4("x")
    with pytest.raises(ModelError, match="CA_ROTOR0_KM"):
        choose_drive(stated(layout), of(layout.position, -layout.direction))


def flown(layout: Layout) -> Flight:
    """A minute in which random commands turn an aircraft with these rotors; its log states others:
    all turned and in another order."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 60.0, 0.01)
    command = 0.5 + 0.05 * rng.normal(size=(len(t), 4))
    x, y = layout.position[:, 0], layout.position[:, 1]
    late = np.vstack([np.repeat(command[:1], 3, axis=0), command[:-3]])
    rates = np.cumsum(late @ np.column_stack([-y, x, -layout.direction]), axis=0) * 0.1
    table = pd.DataFrame({"time": t, "phase": "hover"})
    table[[f"cmd_{k}" for k in range(1, 5)]] = command
    table[["gyro_x", "gyro_y", "gyro_z"]] = rates
    other = replace(layout, position=layout.position[[1, 2, 3, 0]], direction=-layout.direction)
    return Flight("flight", table, airframe=Airframe(layout=other))


def test_a_flight_that_turned_as_the_vehicle_file_says_is_compared() -> None:
    """The parameters of its log were never set: a warning."""
    layout = frame("x")
    flight, vehicle = flown(layout), of(layout.position, layout.direction)
    check_airframe(flight, vehicle)
    (warning,) = consistency(flight, vehicle).warnings
    assert "turned as the vehicle file says" in warning and "rotors.position" in warning
    stated_by_log = of(flight.airframe.layout.position, -layout.direction)  # type: ignore[union-attr]
    assert consistency(flight, stated_by_log).warnings == ()  # no contradiction, nothing to settle
    with pytest.raises(ModelError):
        check_airframe(flight, of(layout.position, -layout.direction))


@pytest.mark.parametrize(("cells", "says"), [(3, True), (4, False), (6, True)])
def test_another_battery_is_a_warning(cells: int, says: bool) -> None:
    """The file has 4 cells."""
    told = SourcedValue(Cells(cells, 4.2, 3.5), f"BAT1_N_CELLS {cells} of the log")
    flight = stated(None, cells=told)
    own = replace(BASE, battery=Battery(16.8, 14.0, 1e4, 0.02, 10.0))
    found = consistency(flight, own)
    assert found.error == ""
    texts = [w for w in found.warnings if "battery.full_voltage of mine.toml is 16.8 V" in w]
    assert bool(texts) == says and all(f"BAT1_N_CELLS {cells}" in t for t in texts)


def test_another_size_or_filter_is_a_warning() -> None:
    layout = replace(frame("x"), metric=True)  # an arm of 1 m
    flight = stated(layout, gyro_cutoff_hz=SourcedValue(20.0, "INS_GYRO_FILTER of the log"))
    found = consistency(flight, replace(of(layout.position, layout.direction), gyro_cutoff_hz=80.0))
    assert found.error == ""
    assert [w.partition(" ")[0] for w in found.warnings] == ["the", "imu.gyro_cutoff"]


LOGS = [
    ("rflysimdt/real_1.ulg", "feisi_x150"),
    ("rflysimdt/sim_1.ulg", "copter_default"),
    ("px4_negatives/ekf_failure.ulg", ""),
    ("quiver_pt1/pt1_00000092.BIN", ""),
    ("nanobench/tables/B2_circle_slow_rep2.parquet", "crazyflie"),
    ("crazypad/tables_pitch_rebuilt/flight_002.parquet", "crazyflie"),
]


@pytest.mark.slow
@needs(DATA.is_dir(), "no recorded flights")
@pytest.mark.parametrize(("file", "name"), LOGS)
def test_recorded_flights_agree_with_their_vehicles(file: str, name: str) -> None:
    """Built-in vehicles, and rotors as the log states them."""
    flight = read_flight(DATA / file)
    if name:
        assert consistency(flight, load_vehicle(name)).error == ""
    if flight.airframe is not None and (layout := flight.airframe.layout) is not None:
        assert consistency(flight, of(layout.position, layout.direction)).error == ""
        assert consistency(flight, of(layout.position, -layout.direction)).error != ""


@pytest.mark.slow
def test_a_flight_whose_log_states_no_rotors_is_asked_how_it_turned() -> None:
    """Of a table the commands and the motion alone say which rotor is which."""
    vehicle = load_vehicle("copter_default")
    flight = fly(vehicle, vehicle, seed=2)
    assert flight.airframe is None
    assert not consistency(flight, vehicle).warnings
    rotors = vehicle.rotors
    order = [1, 0, 2, 3]
    moved = replace(rotors, position_m=rotors.position_m[order], direction=rotors.direction[order])
    wrong = replace(vehicle, rotors=moved, file="mine.toml")
    (warning,) = consistency(flight, wrong).warnings
    assert "turns as if cmd_1 drove rotor 2, cmd_2 drove rotor 1" in warning
    assert "Its rotors are those of mine.toml" in warning
    assert consistency(flight, wrong).error == ""
    assert any("as if cmd_1 drove rotor 2" in text for text in drive_warnings(flight, wrong))


def test_what_was_said_of_a_flight_goes_with_it() -> None:
    flight, vehicle = stated(None), load_vehicle("copter_default")
    there = weakref.ref(flight)
    assert consistency(flight, vehicle) is consistency(flight, load_vehicle("copter_default"))
    del flight
    gc.collect()
    assert there() is None
