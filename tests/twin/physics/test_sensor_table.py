"""The table of sensors agrees with components, flight table, effects and vehicle file."""

import pytest

from twin.effects import EFFECTS
from twin.logs.columns import COLUMNS
from twin.physics.sensors.table import BODY, SENSORS, Sensor, sensor_of
from twin.vehicle.file import load_vehicle

VEHICLE = load_vehicle("copter_default")
every_sensor = pytest.mark.parametrize("row", SENSORS, ids=lambda s: s.name)


def plain(unit: str) -> str:
    """m/s² as m/s^2."""
    return unit.replace("²", "^2")


@every_sensor
def test_columns_are_those_of_the_flight_table(row: Sensor) -> None:
    known = {c.name: c.unit for c in COLUMNS}
    assert {c: known.get(c) for c in row.columns} == dict.fromkeys(row.columns, plain(row.unit))


@every_sensor
def test_columns_are_outputs_of_the_component(row: Sensor) -> None:
    made = row.make(VEHICLE, EFFECTS)
    assert made.name == row.component
    outputs = {v.name: v.unit for v in made.output_variables}
    wanted = dict.fromkeys(row.columns, plain(row.unit).replace("^", ""))
    assert {c: outputs.get(c) for c in row.columns} == wanted


def test_every_output_of_a_component_is_a_column_of_one_row() -> None:
    for row in SENSORS:
        for name in row.make(VEHICLE, EFFECTS).output_names:
            assert sum(name in other.columns for other in SENSORS) == 1


@every_sensor
def test_what_is_needed_is_an_input(row: Sensor) -> None:
    inputs = row.make(VEHICLE, EFFECTS).input_names
    for stem in row.needs:
        assert any(n.startswith(f"{stem}_") for n in inputs)
    assert (row.group == BODY) == ("specific_force_x" in inputs)


@every_sensor
def test_sizes_and_channels_are_one_per_column(row: Sensor) -> None:
    sizes = row.size(VEHICLE)
    assert len(sizes) == len(row.columns) == len(row.channels)
    assert min(sizes) > 0
    assert all(sensor_of(c) is row for c in (*row.columns, *row.channels))


def test_every_effect_of_a_sensor_needs_its_readings() -> None:
    for effect in EFFECTS.values():
        signals = [s.signal for s in SENSORS if s.component == effect.component]
        if signals:
            assert set(signals) & set(effect.needs), effect.name


def test_every_measured_column_of_the_flight_table_has_a_sensor() -> None:
    motion = ("pos_", "vel_", "q_")
    power = ("cmd_", "rotor_", "vbat_", "ibat_")
    others = {c.name for c in COLUMNS if c.name.startswith((*motion, *power))} | {"time", "phase"}
    assert {c.name for c in COLUMNS} - others == {c for s in SENSORS for c in s.columns}
