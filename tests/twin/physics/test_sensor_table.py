"""The table of sensors agrees with components, flight table, effects and vehicle file."""

from dataclasses import fields, replace
from pathlib import Path

import pytest

import twin.physics.sensors as physics_sensors
from twin.effects import EFFECTS
from twin.effects.definition import RECORD
from twin.errors import ModelError
from twin.logs.columns import COLUMNS
from twin.physics.sensors.table import BODY, SENSORS, Sensor, sensor_of
from twin.vehicle.vehicle import Sensors
from twin.vehicle_file import load_vehicle
from twin.vehicle_file.fields import FIELDS

VEHICLE = load_vehicle("copter_default")
every_sensor = pytest.mark.parametrize("row", SENSORS, ids=lambda s: s.name)


def test_every_module_of_a_sensor_has_a_row() -> None:
    folder = Path(physics_sensors.__file__).parent
    modules = {p.stem for p in folder.glob("[a-z]*.py")} - {"common", "position", "table"}
    missing = sorted(modules - {s.component for s in SENSORS})
    assert not missing, f"no row in twin/physics/sensors/table.py: {missing}"


@pytest.mark.parametrize("part", [f.name for f in fields(Sensor)])
def test_a_sensor_without_a_part_does_not_import(part: str) -> None:
    whole = {f.name: getattr(SENSORS[0], f.name) for f in fields(Sensor)}
    with pytest.raises(TypeError, match=part):
        Sensor(**{k: v for k, v in whole.items() if k != part})


def test_a_sensor_whose_parts_do_not_fit_does_not_import() -> None:
    with pytest.raises(ModelError, match="3 columns, 1 meanings"):
        replace(SENSORS[0], meanings=("one",))
    with pytest.raises(ModelError, match=r"no number of twin/vehicle/vehicle\.py: 'imu\.hum'"):
        replace(SENSORS[0], noise_key="imu.hum")


@every_sensor
def test_what_has_a_range_is_below_its_limit(row: Sensor) -> None:
    assert row.usual is None or 0 < row.usual.low < row.usual.high < row.limit


@every_sensor
def test_what_is_missed_in_live_flight_has_a_message(row: Sensor) -> None:
    assert row.messages or not row.without


def test_every_number_of_a_sensor_is_a_key_of_the_vehicle_file() -> None:
    keys = {f.metadata["key"] for f in fields(Sensors) if f.metadata}
    assert not keys - {*FIELDS}, f"not in twin/vehicle_file/fields.py: {sorted(keys - {*FIELDS})}"


def test_every_key_of_a_sensor_is_read() -> None:
    """The keys that a file may give and nobody reads would be silent."""
    sections = {s.component for s in SENSORS}
    given = {k for k in FIELDS if k.partition(".")[0] in sections and k.endswith(("noise", "walk"))}
    missing = sorted(given - {f.metadata["key"] for f in fields(Sensors) if f.metadata})
    assert not missing, f"no number of twin/vehicle/vehicle.py: {missing}"


def test_every_effect_stands_in_a_component_that_exists() -> None:
    known = {"airframe", "environment", "position", RECORD} | {s.component for s in SENSORS}
    assert {e.component for e in EFFECTS.values()} <= known


@every_sensor
def test_columns_are_outputs_of_the_component(row: Sensor) -> None:
    made = row.make(VEHICLE, EFFECTS)
    assert made.name == row.component
    outputs = {v.name: v.unit for v in made.output_variables}
    wanted = dict.fromkeys(row.columns, row.plain_unit.replace("^", ""))
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
    motion = ("pos_", "vel_", "q_", "roll_", "pitch_", "yaw_", "acc_ned_")
    power = ("cmd_", "rotor_", "vbat_", "ibat_")
    others = {c.name for c in COLUMNS if c.name.startswith((*motion, *power))} | {"time", "phase"}
    assert {c.name for c in COLUMNS} - others == {c for s in SENSORS for c in s.columns}
