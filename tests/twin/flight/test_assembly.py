"""The whole twin as parts and connections: who feeds whom, start values, what is refused."""

from dataclasses import replace
from functools import cache
from typing import cast, get_args

import pytest
from rig import BUILTIN

from twin.component import ComponentBuilder
from twin.effects import EFFECTS
from twin.effects.definition import RECORD
from twin.errors import ModelError
from twin.flight.assembly import (
    CONTROLLERS,
    Assembly,
    connected_by_name,
    driven_twin,
    flying_twin,
    wind_starts,
)
from twin.flight.mission import mission_names
from twin.physics.rotors import Drive
from twin.physics.sensors.position import PRESETS, Kind
from twin.vehicle_file import load_vehicle


@cache
def twin() -> Assembly:
    return flying_twin(load_vehicle("crazyflie"), "tour")


@pytest.mark.slow
@pytest.mark.parametrize("control", CONTROLLERS)
@pytest.mark.parametrize("vehicle", BUILTIN)
def test_every_input_has_a_source_of_its_name_and_unit(vehicle: str, control: str) -> None:
    parts = flying_twin(load_vehicle(vehicle), "tour", control, ["battery_sag"])
    variables = {f"{k}.{v.name}": v for k, part in parts.parts.items() for v in part.variables}
    fed = {target for _, target in parts.connections}
    for source, target in parts.connections:
        assert source.split(".")[1] == target.split(".")[1]
        assert variables[source].unit == variables[target].unit
    free = {k for k, v in variables.items() if v.causality == "input"} - fed
    # Without a battery nobody gives its voltage, and nobody draws its current.
    lone = () if "battery" in parts.parts else ("airframe.vbat_v", "magnetometer.ibat_a")
    outside = {f"airframe.{kind}_{a}" for kind in ("force", "moment") for a in "xyz"}
    assert free == (set(lone) & variables.keys()) | outside


@pytest.mark.parametrize("drive", ["command", "rotor_speed"])
def test_a_driven_twin_wants_rotors_voltage_and_motion(drive: Drive) -> None:
    parts = driven_twin(load_vehicle("copter_default"), drive, ["battery_sag"])
    assert {"airframe", "imu", "position", "environment"} <= set(parts.parts)
    assert not {"mission", "controller", "battery"} & set(parts.parts)
    fed = {target for _, target in parts.connections}
    free = {f"airframe.{n}" for n in parts.parts["airframe"].input_names} - fed
    stem = "cmd" if drive == "command" else "rotor"
    assert {f"airframe.{stem}_4", "airframe.vbat_v", "airframe.restart.q_w"} <= free
    assert "airframe.density" not in free


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", BUILTIN)
def test_no_input_that_nothing_depends_on(vehicle: str) -> None:
    """An aircraft without a battery has no input for its voltage or current, whoever drives it,
    unless an effect of its own depends on them."""
    model = load_vehicle(vehicle)
    drives = [d for d in ("command", "rotor_speed") if d == model.drive or model.rotors.from_speed]
    for twin in (flying_twin(model), *(driven_twin(model, cast(Drive, d)) for d in drives)):
        for part in twin.parts.values():
            functions = [(part.outputs, 1), (part.derivatives, 1), (part.initial, 0)]
            if part.sampling is not None:
                functions += [(part.sampling.update, 1), (part.sampling.signals, 1)]
            used = set()
            for f, argument in functions:
                rows, columns = f.jac_sparsity(0, argument).get_triplet()
                used |= {
                    k
                    for i, k in zip(rows, columns, strict=True)
                    if f is not part.outputs or part.output_names[i] != "voltage"
                }
            assert {part.input_names[k] for k in used} == set(part.input_names), part.name
        battery = model.battery is not None
        assert ("magnetometer.ibat_a" in inputs_of(twin)) == battery
        assert ("airframe.vbat_v" in inputs_of(twin)) == model.states_voltage
    sagging = replace(load_vehicle("copter_default"), effects={"battery_sag": {"slope": 1.0}})
    assert "airframe.vbat_v" in inputs_of(flying_twin(sagging))


def inputs_of(twin: Assembly) -> set[str]:
    return {f"{key}.{name}" for key, part in twin.parts.items() for name in part.input_names}


@pytest.mark.slow
def test_the_position_sensor_is_that_of_the_kind() -> None:
    """A motion capture system measures the attitude as well."""
    model, seen = load_vehicle("crazyflie"), {}
    for kind in get_args(Kind):
        for twin in (
            flying_twin(model, position=kind),
            driven_twin(model, "command", position=kind),
        ):
            seen[kind] = "meas_q_w" in twin.parts["position"].output_names
            assert seen[kind] == (PRESETS[kind].attitude_noise_rad is not None)
    assert seen == {"gnss": False, "mocap": True}


@pytest.mark.slow
def test_a_battery_is_a_part_where_the_vehicle_has_one() -> None:
    assert "battery" in twin().parts
    bare = flying_twin(replace(load_vehicle("crazyflie"), battery=None), effects=())
    assert "battery" not in bare.parts


def test_all_effects_are_built_in_and_off() -> None:
    parts = twin().parts
    for name, effect in EFFECTS.items():
        if effect.component == RECORD:
            continue  # of a log: no aircraft has it
        (switch,) = (v for v in parts[effect.component].parameters if v.name == f"{name}.enabled")
        assert switch.start == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", mission_names())
def test_missions_say_how_long_they_take(name: str) -> None:
    assert flying_twin(load_vehicle("crazyflie"), name, effects=()).duration_s > 5.0


def start(assembly: Assembly, name: str) -> float:
    part, _, variable = name.partition(".")
    (found,) = (v for v in assembly.parts[part].variables if v.name == variable)
    return found.start


def test_seed_wind_and_starts_reach_their_parts() -> None:
    before = twin()
    after = before.with_starts(
        wind_starts((1.0, 2.0, -0.5), gusts=True)
        | before.seed_starts(7)
        | {"airframe.mass": 0.03, "airframe.cmd_1": 0.5}
    )
    seeded = [k for k, p in before.parts.items() if any(v.name == "seed" for v in p.parameters)]
    assert {"environment", "imu", "magnetometer", "barometer", "position"} <= set(seeded)
    assert all(start(after, f"{part}.seed") == 7 for part in seeded)
    assert [start(after, f"environment.wind.{a}") for a in "xyz"] == [1.0, 2.0, -0.5]
    assert start(after, "environment.gust.enabled") == 1
    assert (start(after, "airframe.mass"), start(after, "airframe.cmd_1")) == (0.03, 0.5)
    assert start(before, "imu.seed") == 0  # the first one is as it was


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("airfame.mass", 1.0, "there is no part 'airfame'. Did you mean 'airframe'?"),
        ("mass", 1.0, "there is no part 'mass'"),
        ("airframe", 1.0, "there is no part 'airframe'"),
        ("airframe.mas", 1.0, "there is no parameter or input 'mas'. Did you mean 'mass'?"),
        ("airframe.mass", -1.0, "mass = -1 kg is outside its range"),
        ("airframe.pos_x", 0.0, "there is no parameter or input 'pos_x'"),
    ],
)
def test_wrong_start_values_are_refused(name: str, value: float, text: str) -> None:
    with pytest.raises(ModelError) as refused:
        twin().with_starts({name: value})
    assert text in str(refused.value)


def test_wrong_names_are_refused() -> None:
    vehicle = load_vehicle("crazyflie")
    with pytest.raises(ModelError, match=r"no controller 'lqg'. Did you mean 'lqr'\?"):
        flying_twin(vehicle, control="lqg")
    with pytest.raises(ModelError, match="tuor"):
        flying_twin(vehicle, "tuor")


def test_two_sources_of_a_name_are_refused() -> None:
    def part(*outputs: str, takes: str | None = None) -> ComponentBuilder:
        m = ComponentBuilder("part", "Gives a constant")
        for name in outputs:
            m.output(name, "1", "A constant", 1.0)
        if takes is not None:
            m.output("rest", "1", "What comes in", m.input(takes, "1", "What comes in"))
        return m

    a, b, c = part("x", "y"), part("x"), part(takes="y")
    assert connected_by_name({"a": a.build(), "b": b.build(), "c": c.build()}) == (("a.y", "c.y"),)
    with pytest.raises(ModelError, match="a and b both give x"):
        connected_by_name(
            {"a": part("x").build(), "b": part("x").build(), "c": part(takes="x").build()}
        )
