"""A vehicle written as a file is the vehicle that is read back, and the text keeps what is ours."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.effects import EFFECTS
from twin.errors import ModelError
from twin.vehicle import Advance, Battery, RotorAir, Rotors, RunUp, Vehicle
from twin.vehicle_file import builtin_vehicles, load_vehicle, parse_vehicle, vehicle_text
from twin.vehicle_file.fields import FIELDS
from twin.vehicle_file.read import POSITION
from twin.vehicle_file.write import TIED, update_text, values_by_key

TEXTS = {name: vehicle_text(name)[0] for name in builtin_vehicles()}
Change = Callable[[Vehicle], Vehicle]


def known_by_speed(vehicle: Vehicle) -> Rotors:
    """Rotors that carry the vehicle and have a speed at each command."""
    full_rad_s, most_n = 1000.0, 2.5 * vehicle.hover_thrust_n
    return replace(
        vehicle.rotors,
        from_speed=True,
        speed_rad_s=(0.0, full_rad_s),
        thrust_n=(0.0, 0.0, most_n / full_rad_s**2),
        torque_n_m=(0.0, 0.0, 0.01 * most_n / full_rad_s**2),
    )


CHANGES: dict[str, Change] = {
    "mass": lambda v: v.with_mass(0.9 * v.mass_kg),
    "name": lambda v: replace(v, name="mine", description="of my own"),
    "inertia": lambda v: replace(v, inertia_kg_m2=1.1 * v.inertia_kg_m2 + 1e-7),
    "thrust": lambda v: replace(
        v, rotors=replace(v.rotors, thrust_n=tuple(1.1 * c for c in v.rotors.thrust_n))
    ),
    "arm": lambda v: replace(v, rotors=replace(v.rotors, position_m=1.2 * v.rotors.position_m)),
    "lag": lambda v: replace(v, rotors=replace(v.rotors, lag_up_s=0.02, lag_down_s=0.05)),
    "no lag": lambda v: replace(v, rotors=replace(v.rotors, lag_up_s=0.0, lag_down_s=0.0)),
    "drag": lambda v: replace(
        v,
        drag_parasitic_n_s2_m2=np.array([0.1, 0.2, 0.3]),
        drag_angular_n_m_s2=np.array([1e-4, 1e-4, 2e-4]),
        gravity_m_s2=9.81,
    ),
    "air at the rotors": lambda v: replace(
        v, rotors=replace(known_by_speed(v), air=RotorAir(1e-5, 2e-5, 3e-4, 1e-7, 2e-7))
    ),
    "advance": lambda v: replace(
        v,
        rotors=replace(
            known_by_speed(v),
            advance=Advance(0.2, ((0.0, 1.0), (0.5, 0.6)), ((0.0, 1.0), (0.5, 0.8))),
        ),
    ),
    "run up": lambda v: replace(
        v,
        rotors=replace(
            known_by_speed(v),
            lag_up_s=0.0,
            lag_down_s=0.0,
            run_up=(RunUp(20.0, 0.01), RunUp(10.0, 0.02)),
            reaction_inertia_kg_m2=1e-6,
        ),
    ),
    "filters": lambda v: replace(v, accel_cutoff_hz=30.0, gyro_cutoff_hz=None),
    "sensors": lambda v: replace(
        v,
        sensors=replace(
            v.sensors,
            mag_noise_t=1e-7,
            field_n_t=(2e-5, 0.0, 4e-5),
            position={"noise_m": (0.1, 0.1, 0.3), "delay_s": 0.12},
        ),
    ),
    "battery": lambda v: replace(v, battery=Battery(12.6, 10.5, 9000.0, 0.02, 12.0)),
    "no battery": lambda v: replace(v, battery=None),
    "effect": lambda v: v.with_effects({"rotor_drag": EFFECTS["rotor_drag"].starts(v)}),
}
"""What a user may change in Python."""


def assert_same(a: Vehicle, b: Vehicle) -> None:
    """All numbers, to the last bit."""
    for x, y in ((a, b), (a.rotors, b.rotors)):
        for name in x.__dataclass_fields__:
            if name in ("sources", "deviations", "doubts", "rotors", "file"):
                continue
            u, v = getattr(x, name), getattr(y, name)
            assert np.array_equal(u, v) if isinstance(u, np.ndarray) else u == v, name


@pytest.mark.parametrize("name", builtin_vehicles())
def test_nothing_changed_nothing_written(name: str) -> None:
    assert update_text(load_vehicle(name), TEXTS[name]) == TEXTS[name]


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", builtin_vehicles())
def test_a_changed_vehicle_is_read_back(name: str, change: str) -> None:
    vehicle = CHANGES[change](load_vehicle(name))
    text = update_text(vehicle, TEXTS[name])
    assert_same(parse_vehicle(text, "new.toml"), vehicle)
    comments = [line for line in TEXTS[name].splitlines() if line.startswith("#")]
    assert [line for line in text.splitlines() if line.startswith("#")] == comments
    assert_same(
        parse_vehicle(update_text(vehicle), "new.toml"), vehicle
    )  # without a text to start from


@pytest.mark.parametrize("name", builtin_vehicles())
def test_an_effect_is_taken_out_again(name: str) -> None:
    vehicle = load_vehicle(name)
    with_effect = update_text(CHANGES["effect"](vehicle), TEXTS[name])
    assert "[effects.rotor_drag]" in with_effect
    assert update_text(vehicle, with_effect).strip() == TEXTS[name].strip()


def test_the_pedigree_goes_with_the_number() -> None:
    """A new number says that it is new and what it replaces; others keep their source."""
    before = load_vehicle("crazyflie")
    after = parse_vehicle(update_text(CHANGES["mass"](before), TEXTS["crazyflie"]), "new.toml")
    assert after.sources["body.mass"] == f"set in Python; before: {before.sources['body.mass']}"
    assert {k: s for k, s in after.sources.items() if k != "body.mass"} == {
        k: s for k, s in before.sources.items() if k != "body.mass"
    }
    weighed = replace(
        before.with_mass(0.031), sources={**before.sources, "body.mass": "scale, 3 May"}
    )
    again = parse_vehicle(update_text(weighed, TEXTS["crazyflie"]), "new.toml")
    assert again.sources["body.mass"] == "scale, 3 May"


def test_what_depends_on_the_mass_stays_where_it_was() -> None:
    """Drag of this file is per kilogram; the vehicle's is in N s/m and does not change."""
    before = load_vehicle("feisi_x150")
    text = update_text(before.with_mass(0.2), TEXTS["feisi_x150"])
    after = parse_vehicle(text, "new.toml")
    assert after.mass_kg == 0.2
    assert np.array_equal(after.drag_linear_n_s_m, before.drag_linear_n_s_m)


def test_what_a_file_cannot_hold_is_refused() -> None:
    vehicle = load_vehicle("crazyflie")
    odd = replace(vehicle, rotors=replace(vehicle.rotors, lag_up_s=0.0, lag_down_s=0.1))
    with pytest.raises(ModelError, match=r"cannot hold its rotors\.lag_down_s"):
        update_text(odd, TEXTS["crazyflie"])
    with pytest.raises(ModelError, match=r"body\.mass = -1\.0 must be positive"):
        update_text(vehicle.with_mass(-1.0), TEXTS["crazyflie"])


@pytest.mark.slow
@given(
    mass=st.floats(0.01, 0.04),
    drag=st.lists(st.floats(0, 10), min_size=3, max_size=3),
    scale=st.floats(0.9, 1.5),
)
@settings(max_examples=25)
def test_any_numbers_survive(mass: float, drag: list[float], scale: float) -> None:
    base = load_vehicle("crazyflie")
    rotors = replace(
        base.rotors,
        thrust_n=tuple(2 * scale * c for c in base.rotors.thrust_n),
        torque_n_m=tuple(scale * c for c in base.rotors.torque_n_m),
    )
    vehicle = replace(base, mass_kg=mass, drag_linear_n_s_m=np.array(drag), rotors=rotors)
    for text in (TEXTS["crazyflie"], ""):
        assert_same(parse_vehicle(update_text(vehicle, text), "new.toml"), vehicle)


def test_every_key_of_a_file_is_written() -> None:
    """Or is the same said in another way, that goes when what is written takes its place."""
    rich = load_vehicle("copter_default")
    for change in ("lag", "battery", "drag", "air at the rotors", "advance"):
        rich = CHANGES[change](rich)
    rates = CHANGES["run up"](rich)
    air = CHANGES["air at the rotors"](rich).rotors.air
    rotors = replace(rich.rotors, air=air, reference_voltage_v=11.1, voltage_exponent=2.0)
    errors = dict.fromkeys(POSITION.values(), 0.1)
    rich = replace(
        rich,
        rotors=rotors,
        accel_cutoff_hz=30.0,
        gyro_cutoff_hz=80.0,
        sensors=replace(rich.sensors, position=errors),
    )
    by_command = replace(rich, rotors=replace(rotors, from_speed=False))
    written = {k for v in (rich, by_command, rates) for k in values_by_key(v)}
    otherwise = {key for keys in TIED.values() for key in keys}
    assert set(FIELDS) - written - otherwise == set()
