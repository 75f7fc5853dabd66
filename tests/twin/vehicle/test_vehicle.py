# ruff: noqa: E501 (an entry of a vehicle file stays on one line)
"""Vehicle files: what they say, how they are converted, and what is refused with which words."""

import re
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike
from rig import BUILTIN, Rig

from twin.errors import ModelError
from twin.physics.airframe import airframe
from twin.vehicle import GRAVITY_M_S2
from twin.vehicle_file import builtin_vehicles, load_vehicle, parse_vehicle
from twin.vehicle_file.fields import FIELDS

FULL = """\
name = "full"
description = "every kind of entry"

[body]
mass = { value = 0.5, unit = "kg", source = "scale" }
inertia = { value = [1e-3, 1.1e-3, 1.8e-3], unit = "kg*m^2", source = "CAD" }
drag_linear = { value = [0.2, 0.2, 0.3], unit = "1/s", source = "fit" }
drag_quadratic = { value = [0.01, 0.01, 0.02], unit = "N*s^2/m^2", source = "made up" }
leg_height = { value = 50, unit = "mm", source = "ruler" }

[rotors]
position = { value = [[0.1, 0.1, 0], [-0.1, -0.1, 0], [0.1, -0.1, 0], [-0.1, 0.1, 0]], unit = "m", source = "CAD" }
direction = { value = ["ccw", "ccw", "cw", "cw"], source = "seen" }
command_range = { value = [1000, 2000], source = "PWM" }
thrust_from_command = { coefficients = [-2.0, 0.001, 1.0e-6], unit = "N", source = "bench" }
torque_per_thrust = { value = 0.015, unit = "m", source = "bench" }
lag = { value = [0.03, 0.05], unit = "s", source = "bench" }
reference_voltage = { value = 11.1, unit = "V", source = "bench" }

[imu]
position = { value = [1, 2, 3], unit = "cm", source = "CAD" }
accel_cutoff = { value = 80, unit = "Hz", source = "parameter" }

[battery]
full_voltage = { value = 12.6, unit = "V", source = "cells" }
empty_voltage = { value = 9.9, unit = "V", source = "cells" }
capacity = { value = 1.5, unit = "A*hour", source = "label" }
resistance = { value = 40, unit = "mohm", source = "bench" }
hover_current = { value = 8, unit = "A", source = "bench" }
"""
SPEED = """\
[body]
mass = { value = 0.5, unit = "kg", source = "s" }
inertia = { value = [1e-3, 1.1e-3, 1.8e-3], unit = "kg*m^2", source = "s" }
[rotors]
position = { value = [[0.1, 0.1, 0], [-0.1, -0.1, 0], [0.1, -0.1, 0], [-0.1, 0.1, 0]], unit = "m", source = "s" }
direction = { value = ["ccw", "ccw", "cw", "cw"], source = "s" }
THRUST
TORQUE
"""
K_THRUST = 'thrust_from_speed = { value = 1e-6, unit = "N*s^2/rad^2", source = "s" }'
K_TORQUE = 'torque_from_speed = { value = 2e-8, unit = "N*m*s^2/rad^2", source = "s" }'


def by_speed(thrust: str = K_THRUST, torque: str = K_TORQUE) -> str:
    return SPEED.replace("THRUST", thrust).replace("TORQUE", torque)


def entry(text: str, key: str, new: str) -> str:
    """The text with one line `key = {...}` replaced."""
    changed, n = re.subn(rf"^{key} = .*$", lambda _: new, text, flags=re.MULTILINE)
    assert n >= 1, key
    return changed


# -- what is in the files -----------------------------------------------------------------


@pytest.mark.parametrize("name", BUILTIN)
def test_builtin_vehicles_load_and_every_number_has_a_source(name: str) -> None:
    assert name in builtin_vehicles()
    vehicle = load_vehicle(name)
    assert vehicle.name == name
    assert vehicle.description
    assert vehicle.doubts == ()
    assert all(source.strip() for source in vehicle.sources.values())
    silent = {
        "rotors.thrust_from_command",
        "rotors.thrust_from_speed",
        "rotors.torque_from_speed",
        "rotors.torque_from_command",
        "rotors.speed_from_command",
        "rotors.torque_per_thrust",
        "rotors.command_range",
    }
    silent |= {k for k in FIELDS if k.startswith("battery.") and vehicle.battery is None}
    assert set(FIELDS) - silent <= set(vehicle.sources)


def test_values_are_converted_to_si() -> None:
    v = parse_vehicle(FULL, "full.toml")
    assert v.leg_height_m == pytest.approx(0.05, rel=1e-15)
    np.testing.assert_allclose(v.drag_linear_n_s_m, [0.1, 0.1, 0.15])  # 1/s times 0.5 kg
    np.testing.assert_allclose(v.imu_position_m, [0.01, 0.02, 0.03])
    assert (v.accel_cutoff_hz, v.gyro_cutoff_hz) == (80.0, None)
    assert v.battery is not None
    assert (v.battery.capacity_a_s, v.battery.resistance_ohm) == pytest.approx((5400.0, 0.04))
    np.testing.assert_array_equal(v.rotors.direction, [-1, -1, 1, 1])
    assert (v.rotors.lag_up_s, v.rotors.lag_down_s) == (0.03, 0.05)
    assert v.sources["body.mass"] == "scale"
    assert v.sources["imu.gyro_cutoff"] == "default: no low-pass"


@pytest.mark.parametrize(
    ("key", "line", "attribute", "si"),
    [
        ("mass", 'mass = { value = 500, unit = "g", source = "s" }', "mass_kg", 0.5),
        ("mass", 'mass = { value = 1.1023113109, unit = "pound", source = "s" }', "mass_kg", 0.5),
        (
            "inertia",
            'inertia = { value = [10, 11, 18], unit = "kg*cm^2", source = "s" }',
            "inertia_kg_m2",
            np.diag([1e-3, 1.1e-3, 1.8e-3]),
        ),
        (
            "drag_linear",
            'drag_linear = { value = [1, 1, 2], unit = "N*s/m", source = "s" }',
            "drag_linear_n_s_m",
            [1, 1, 2],
        ),
        (
            "drag_linear",
            'drag_linear = { value = [1, 1, 2], unit = "kg/s", source = "s" }',
            "drag_linear_n_s_m",
            [1, 1, 2],
        ),
        (
            "drag_linear",
            'drag_linear = { value = [60, 60, 60], unit = "1/minute", source = "s" }',
            "drag_linear_n_s_m",
            [0.5, 0.5, 0.5],
        ),
    ],
)
def test_units(key: str, line: str, attribute: str, si: ArrayLike) -> None:
    vehicle = parse_vehicle(entry(FULL, key, line), "v.toml")
    np.testing.assert_allclose(getattr(vehicle, attribute), np.asarray(si), rtol=1e-9)


@pytest.mark.parametrize(
    "unit", ["kg**9**9**9", "((kg**99)**99)**99", "9**99*kg", "kg*m^999999999", "kg" + "*m" * 40]
)
def test_units_that_would_take_for_ever_are_refused(unit: str) -> None:
    begun = time.process_time()
    with pytest.raises(ModelError, match="write names of units with"):
        line = f'mass = {{ value = 1.0, unit = "{unit}", source = "s" }}'
        parse_vehicle(entry(FULL, "mass", line), "v.toml")
    assert time.process_time() - begun < 20.0  # half a second for the first unit


@pytest.mark.parametrize("value", ["[" * 5000, "{a=" * 5000, "9" * 5000])
def test_what_the_parser_cannot_hold_is_refused(value: str) -> None:
    with pytest.raises(ModelError, match=r"v\.toml: not valid TOML"):
        parse_vehicle(f"{FULL}\ndeep = {value}\n", "v.toml")


@pytest.mark.parametrize("part", ["a.", "'a b' . ", '"\\"". '])
def test_keys_of_many_parts_are_refused(part: str) -> None:
    """The parser would take a gigabyte for 20,000."""
    with pytest.raises(ModelError, match=r"v\.toml: a key has .* parts, at most"):
        parse_vehicle(f"{FULL}\n{part * 20_000}a = 1\n", "v.toml")


@pytest.mark.slow
def test_unknown_keys_without_end_are_counted() -> None:
    keys = "".join(f"key_{k} = 1\n" for k in range(30_000))
    begun = time.process_time()
    with pytest.raises(ModelError) as refused:
        parse_vehicle(f"site = 3\n{FULL}{keys}", "v.toml")
    assert time.process_time() - begun < 5.0
    text = str(refused.value)
    assert "[site] must be a table of keys" in text
    assert f"and {30_000 - 50} more names that are not known" in text
    assert len(text) < 50_000


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "v.toml"
    path.write_text(FULL + "#" * 2**20, "utf-8")
    with pytest.raises(ModelError, match=r"v\.toml: .* bytes, a vehicle file has at most"):
        load_vehicle(path)


@pytest.mark.parametrize(
    "thrust",
    [
        'value = 1e-6, unit = "N*s^2/rad^2"',
        'value = 1e-3, unit = "mN*s^2/rad^2"',
        f'value = {1e-6 * (2 * np.pi / 60) ** 2!r}, unit = "N/rpm^2"',
        f'value = {1e-6 / GRAVITY_M_S2 * 1e3 * (2 * np.pi / 60) ** 2!r}, unit = "gram_force/rpm^2"',
        'coefficients = [0, 0, 1e-6], unit = "N", of = "rad/s"',
        f'coefficients = [0, 0, {1e-6 * (2 * np.pi / 60) ** 2!r}], unit = "N", of = "rpm"',
        f'coefficients = [0, 0, {1e-6 * (2 * np.pi) ** 2!r}], unit = "N", of = "turn/s"',
    ],
)
def test_thrust_constant_in_any_notation(thrust: str) -> None:
    line = f'thrust_from_speed = {{ {thrust}, source = "s" }}'
    vehicle = parse_vehicle(by_speed(line), "v.toml")
    assert (vehicle.name, vehicle.drive) == ("v", "rotor_speed")
    np.testing.assert_allclose(vehicle.rotors.thrust_n, [0, 0, 1e-6], rtol=1e-12)


@pytest.mark.parametrize(("low", "high"), [(1100, 1950), (0, 65535), (2000, 1000), (-1, 1)])
def test_command_range_composes_with_the_polynomial(low: float, high: float) -> None:
    """A map fitted in raw commands is the same map of 0..1."""
    plain = np.array([0.3, 1.5, 2.5])
    raw = np.polynomial.Polynomial(plain)(
        np.polynomial.Polynomial([-low / (high - low), 1 / (high - low)])
    ).coef
    text = entry(
        FULL, "command_range", f'command_range = {{ value = [{low}, {high}], source = "s" }}'
    )
    text = entry(
        text,
        "thrust_from_command",
        f'thrust_from_command = {{ coefficients = {raw.tolist()}, unit = "N", source = "s" }}',
    )
    vehicle = parse_vehicle(text, "v.toml")
    np.testing.assert_allclose(vehicle.rotors.thrust_n, plain, rtol=1e-9)
    np.testing.assert_allclose(vehicle.rotors.torque_n_m, 0.015 * plain, rtol=1e-9)


def test_speed_from_command_is_of_the_raw_command_too() -> None:
    text = by_speed() + (
        'command_range = { value = [1000, 2000], source = "s" }\n'
        'speed_from_command = { coefficients = [-2000, 2], unit = "rad/s", source = "s" }\n'
    )
    vehicle = parse_vehicle(text, "v.toml")
    assert vehicle.drive == "command"
    assert vehicle.rotors.speed_rad_s == pytest.approx((0.0, 2000.0), abs=1e-9)
    rpm = text.replace("[-2000, 2]", f"{[-2000 * 30 / np.pi, 2 * 30 / np.pi]}")
    rpm = rpm.replace('unit = "rad/s"', 'unit = "rpm"')
    again = parse_vehicle(rpm, "v.toml").rotors.speed_rad_s
    assert again == pytest.approx((0.0, 2000.0), abs=1e-9)


def test_products_of_inertia_are_matrix_elements() -> None:
    line = 'inertia = { value = [1e-3, 1.1e-3, 1.8e-3, 1e-5, -2e-5, 3e-5], unit = "kg*m^2", source = "s" }'
    J = parse_vehicle(entry(FULL, "inertia", line), "v.toml").inertia_kg_m2
    np.testing.assert_array_equal(J, J.T)
    assert (J[0, 1], J[0, 2], J[1, 2]) == (1e-5, -2e-5, 3e-5)


def test_an_impossible_body_is_doubted_not_refused() -> None:
    line = 'inertia = { value = [1e-3, 1e-3, 3e-3], unit = "kg*m^2", source = "s" }'
    vehicle = parse_vehicle(entry(FULL, "inertia", line), "v.toml")
    assert "no real body" in vehicle.doubts[0]
    assert parse_vehicle(FULL, "v.toml").doubts == ()


def test_entries_of_no_effect_are_doubted() -> None:
    exponent = 'voltage_exponent = { value = 2, unit = "1", source = "s" }'
    vehicle = parse_vehicle(entry(FULL, "reference_voltage", exponent), "v.toml")
    assert "counts only with rotors.reference_voltage" in vehicle.doubts[0]
    text = by_speed() + 'command_range = { value = [0, 2], source = "s" }\n'
    assert "command_range counts only" in parse_vehicle(text, "v.toml").doubts[0]


def test_a_vehicle_known_by_rotor_speed_cannot_be_driven_by_commands() -> None:
    vehicle = parse_vehicle(by_speed(), "v.toml")
    assert airframe(vehicle).input_names[0] == "rotor_1"
    with pytest.raises(ModelError, match=r"drive v: .* Give rotors\.speed_from_command"):
        airframe(vehicle, "command")


# -- what is refused ----------------------------------------------------------------------

I3 = 'inertia = { value = VALUE, unit = "kg*m^2", source = "s" }'
BAD: dict[str, tuple[str, str, str]] = {
    # case: (key of the replaced line, new line, text of the error)
    "misspelt key": (
        "mass",
        'maas = { value = 1, unit = "kg", source = "s" }',
        r"unknown key in \[body\]: 'maas'\. Did you mean 'mass'",
    ),
    "missing key": ("mass", "", r"body\.mass is missing: Take-off mass"),
    "no braces": ("mass", "mass = 0.5", r'body\.mass = 0\.5 needs unit and source.*unit = "kg"'),
    "no unit": ("mass", 'mass = { value = 0.5, source = "s" }', r'body\.mass has no unit.*"kg"'),
    "no source": ("mass", 'mass = { value = 0.5, unit = "kg" }', r"body\.mass has no source"),
    "blank source": ("mass", 'mass = { value = 1, unit = "kg", source = " " }', "mass has no sou"),
    "no value": ("mass", 'mass = { unit = "kg", source = "s" }', r"body\.mass = .* needs"),
    "coefficients": (
        "mass",
        'mass = { coefficients = [1], unit = "kg", source = "s" }',
        r"body\.mass has no value",
    ),
    "misspelt part": (
        "mass",
        'mass = { value = 1, unti = "kg", source = "s" }',
        r"unknown part of body\.mass: 'unti'\. Did you mean 'unit'",
    ),
    "unit of another kind": (
        "mass",
        'mass = { value = 0.5, unit = "N", source = "s" }',
        r'body\.mass has unit "N", which is not a unit of the kind "kg"',
    ),
    "not a unit": (
        "mass",
        'mass = { value = 0.5, unit = "kilo", source = "s" }',
        r"body\.mass has unit 'kilo', which is not a unit",
    ),
    "unit with a number": (
        "mass",
        'mass = { value = 0.5, unit = "2 kg", source = "s" }',
        r"body\.mass has unit '2 kg', which is not a unit",
    ),
    "unit as a number": ("mass", 'mass = { value = 0.5, unit = 1, source = "s" }', "has no unit"),
    "negative": (
        "mass",
        'mass = { value = -0.5, unit = "kg", source = "s" }',
        r"body\.mass = -0\.5 must be positive",
    ),
    "zero": ("mass", 'mass = { value = 0, unit = "kg", source = "s" }', "must be positive"),
    "NaN": ("mass", 'mass = { value = nan, unit = "kg", source = "s" }', "mass = nan must be fin"),
    "infinite": ("mass", 'mass = { value = inf, unit = "kg", source = "s" }', "must be finite"),
    "overflowing": (
        "inertia",
        I3.replace("VALUE", "[1e308, 1e308, 1e308]"),
        "must be finite, below",
    ),
    "huge integer": (
        "mass",
        f'mass = {{ value = {"9" * 400}, unit = "kg", source = "s" }}',
        r"body\.mass = 9+\.\.\.9+ must be numbers",
    ),
    "text": (
        "mass",
        'mass = { value = "0.5", unit = "kg", source = "s" }',
        r"body\.mass = '0\.5' must be numbers",
    ),
    "boolean": (
        "mass",
        'mass = { value = true, unit = "kg", source = "s" }',
        r"body\.mass = True must be numbers",
    ),
    "boolean in a list": (
        "inertia",
        I3.replace("VALUE", "[1e-3, true, 1e-3]"),
        r"body\.inertia = .* must be numbers",
    ),
    "text in a list": (
        "inertia",
        I3.replace("VALUE", '["1e-3", "1e-3", "1e-3"]'),
        r"body\.inertia = .* must be numbers",
    ),
    "date": ("mass", 'mass = { value = 2026-01-01, unit = "kg", source = "s" }', "must be numbers"),
    "list for a number": (
        "mass",
        'mass = { value = [0.5], unit = "kg", source = "s" }',
        r"body\.mass = \[0\.5\] must be one number",
    ),
    "inertia too short": (
        "inertia",
        I3.replace("VALUE", "[1e-3, 1e-3]"),
        r"must be \[Ixx, Iyy, Izz\] or",
    ),
    "inertia as a matrix": (
        "inertia",
        I3.replace("VALUE", "[[1,0,0],[0,1,0],[0,0,1]]"),
        r"must be \[Ixx",
    ),
    "ragged": ("inertia", I3.replace("VALUE", "[[1, 2], 3]"), "must be numbers"),
    "not positive definite": (
        "inertia",
        I3.replace("VALUE", "[1e-3, 1e-3, 2e-3, 2e-3, 0, 0]"),
        r"body\.inertia = .* is not positive definite",
    ),
    "negative moment": ("inertia", I3.replace("VALUE", "[-1e-3, 1e-3, 2e-3]"), "not positive def"),
    "drag too short": (
        "drag_linear",
        'drag_linear = { value = [1, 1], unit = "1/s", source = "s" }',
        r"body\.drag_linear = \[1, 1\] must be a list of 3",
    ),
    "negative drag": (
        "drag_linear",
        'drag_linear = { value = [1, -1, 1], unit = "1/s", source = "s" }',
        r"drag_linear = .* must be zero or positive",
    ),
    "drag per what": (
        "drag_linear",
        'drag_linear = { value = [1, 1, 1], unit = "m", source = "s" }',
        r'body\.drag_linear has unit "m"',
    ),
    "two columns": (
        "position",
        'position = { value = [[1, 1], [1, 1], [1, 1]], unit = "m", source = "s" }',
        r"rotors\.position must be 3 to 12 rows",
    ),
    "two rotors": (
        "position",
        'position = { value = [[1, 1, 0], [1, 1, 0]], unit = "m", source = "s" }',
        r"3 to 12 rows",
    ),
    "direction in other words": (
        "direction",
        'direction = { value = ["CW", "ccw", "cw", "cw"], source = "s" }',
        r'rotors\.direction = .*must be a list of "cw" and "ccw"',
    ),
    "direction as signs": (
        "direction",
        'direction = { value = [1, -1, 1, -1], source = "s" }',
        '"cw" and',
    ),
    "three directions": (
        "direction",
        'direction = { value = ["cw", "ccw", "cw"], source = "s" }',
        r"rotors\.direction has 3 entries, rotors\.position 4",
    ),
    "no thrust map": ("thrust_from_command", "", r"thrust needs exactly one of .*none is given"),
    "no torque map": ("torque_per_thrust", "", r"reaction torque needs exactly one of"),
    "two thrust maps": (
        "reference_voltage",
        K_THRUST,
        r"thrust_from_speed and .*_command are given",
    ),
    "two torque maps": (
        "reference_voltage",
        'torque_from_command = { coefficients = [1], unit = "N*m", source = "s" }',
        r"reaction torque needs exactly one",
    ),
    "one value of the command": (
        "thrust_from_command",
        'thrust_from_command = { value = 3, unit = "N", source = "s" }',
        r"thrust_from_command needs coefficients",
    ),
    "value and coefficients": (
        "thrust_from_command",
        'thrust_from_command = { value = 3, coefficients = [1], unit = "N", source = "s" }',
        r"thrust_from_command has value and coefficients",
    ),
    "no coefficients": (
        "thrust_from_command",
        'thrust_from_command = { coefficients = [], unit = "N", source = "s" }',
        "1 to 8",
    ),
    "of a command": (
        "thrust_from_command",
        'thrust_from_command = { coefficients = [1], unit = "N", of = "us", source = "s" }',
        r"'of' has no place here",
    ),
    "speed of no use": (
        "reference_voltage",
        'speed_from_command = { coefficients = [1], unit = "rad/s", source = "s" }',
        r"speed_from_command is of no use",
    ),
    "spin without speed": (
        "reference_voltage",
        'spin_inertia = { value = 1e-6, unit = "kg*m^2", source = "s" }',
        r"spin_inertia needs the rotor speed",
    ),
    "drag of rotors without speed": (
        "reference_voltage",
        'drag = { value = 1e-4, unit = "kg/rad", source = "s" }',
        r"rotors\.drag needs the rotor speed",
    ),
    "table without speed": (
        "reference_voltage",
        'thrust_by_advance = { value = [[0, 1], [1, 0]], unit = "1", source = "s" }',
        r"thrust_by_advance needs the rotor speed",
    ),
    "table without diameter": (
        "reference_voltage",
        'thrust_by_advance = { value = [[0, 1], [1, 0]], unit = "1", source = "s" }',
        r"thrust_by_advance needs rotors\.diameter",
    ),
    "table that falls": (
        "reference_voltage",
        'thrust_by_advance = { value = [[0, 1], [0, 0]], unit = "1", source = "s" }',
        r"J must rise from row to row",
    ),
    "table of three columns": (
        "reference_voltage",
        'torque_by_advance = { value = [[0, 1, 2], [1, 0, 2]], unit = "1", source = "s" }',
        r"rows of \[J, factor\]; it has shape \(2, 3\)",
    ),
    "lag and rates": (
        "reference_voltage",
        'rate_up = { coefficients = [7, 0], unit = "1/s", of = "rpm", source = "s" }',
        r"rotors\.lag and rotors\.rate_up say the same thing",
    ),
    "one rate": (
        "lag",
        'rate_up = { coefficients = [7, 0], unit = "1/s", of = "rpm", source = "s" }',
        r"rate_up and rotors\.rate_down belong together",
    ),
    "rate of nothing": (
        "lag",
        'rate_up = { coefficients = [0, 0], unit = "1/s", of = "rpm", source = "s" }',
        r"must be two numbers \[a, b\], one above zero",
    ),
    "rate without coefficients": (
        "lag",
        'rate_up = { value = 7, unit = "1/s", source = "s" }',
        r"rate_up needs coefficients = \[a, b\]",
    ),
    "rate of no speed": (
        "lag",
        'rate_up = { coefficients = [7, 0], unit = "1/s", source = "s" }',
        r'rate_up needs of = "rad/s"',
    ),
    "drag that pushes": (
        "drag_quadratic",
        'drag_parasitic = { value = [1, -1, 1], unit = "N*s^2/m^2", source = "s" }',
        r"body\.drag_parasitic = .* must be zero or positive",
    ),
    "no gravity": (
        "full_voltage",
        '[site]\ngravity = { value = 0, unit = "m/s^2", source = "s" }',
        r"site\.gravity = .* must be positive",
    ),
    "range of one": (
        "command_range",
        'command_range = { value = [0, 0], source = "s" }',
        r"rotors\.command_range = \[0, 0\] must be two different",
    ),
    "three lags": (
        "lag",
        'lag = { value = [1, 2, 3], unit = "s", source = "s" }',
        r"rotors\.lag = ",
    ),
    "lag too short": ("lag", 'lag = { value = 0.5, unit = "ms", source = "s" }', "at least 1 ms"),
    "cannot hover": (
        "mass",
        'mass = { value = 2.5, unit = "kg", source = "s" }',
        r"cannot hover: 4 rotors give at most 16 N, the weight is 24\.52 N",
    ),
    "battery upside down": (
        "empty_voltage",
        'empty_voltage = { value = 13, unit = "V", source = "s" }',
        r"battery\.empty_voltage = 13 V must be below",
    ),
    "half a battery": ("capacity", "", r"\[battery\] is given without capacity"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_said(case: str) -> None:
    key, line, expected = BAD[case]
    with pytest.raises(ModelError, match=expected) as error:
        parse_vehicle(entry(FULL, key, line), "mine.toml")
    assert str(error.value).startswith("mine.toml: ")
    assert len(str(error.value)) < 600


AIR = """\
drag = { value = 0.119, unit = "g/rad", source = "s" }
inflow = { value = 2.32e-4, unit = "N*s^2/(m*rad)", source = "s" }
lift = { value = 1e-3, unit = "N/(m/s)^2", source = "s" }
flapping_moment = { value = -1e-6, unit = "N*m/((rad/s)*(m/s))", source = "s" }
rolling_moment = { value = 2e-6, unit = "kg*m/rad", source = "s" }
reaction_inertia = { value = 20, unit = "mg*m^2", source = "s" }
diameter = { value = 10, unit = "inch", source = "s" }
thrust_by_advance = { value = [[0, 1], [50, 0]], unit = "percent", source = "s" }
speed_from_command = { coefficients = [0, 2000], unit = "rad/s", source = "s" }
rate_up = { coefficients = [7, 2e-4], unit = "1/s", of = "rpm", source = "s" }
rate_down = { coefficients = [0, 3e-4], unit = "1/s", of = "rad/s", source = "s" }
"""


def test_loads_of_the_air_on_rotors_are_converted_to_si() -> None:
    v = parse_vehicle(by_speed() + AIR.replace("[0, 1], [50, 0]", "[0, 100], [50, 0]"), "air.toml")
    air, advance, run_up = v.rotors.air, v.rotors.advance, v.rotors.run_up
    assert air.drag_kg_rad == pytest.approx(1.19e-4)
    assert (air.inflow_kg_rad, air.lift_kg_m) == pytest.approx((2.32e-4, 1e-3))
    assert (air.flapping_kg_m_rad, air.rolling_kg_m_rad) == pytest.approx((-1e-6, 2e-6))
    assert v.rotors.reaction_inertia_kg_m2 == pytest.approx(2e-5)
    assert advance is not None
    assert advance.diameter_m == pytest.approx(0.254)
    np.testing.assert_allclose(np.array(advance.thrust), np.array([[0, 1], [0.5, 0]]))
    assert advance.torque == ()
    assert run_up is not None
    up, down = run_up
    # dw = b (u^2 - w^2) in rpm/s is (2 pi / 60) b (60 / 2 pi)^2 of the squares in rad/s.
    assert (up.linear_1_s, up.quadratic_1_rad) == pytest.approx((7.0, 2e-4 * 60 / (2 * np.pi)))
    assert (down.linear_1_s, down.quadratic_1_rad) == (0.0, 3e-4)
    assert v.doubts == ()


def test_what_looks_odd_about_rotors_is_a_doubt() -> None:
    table = 'thrust_by_advance = { value = [[0, 0.9], [1, 0]], unit = "1", source = "s" }\n'
    diameter = 'diameter = { value = 0.2, unit = "m", source = "s" }\n'
    reaction = 'reaction_inertia = { value = 1e-5, unit = "kg*m^2", source = "s" }\n'
    speed = 'speed_from_command = { coefficients = [0, 5000], unit = "rad/s", source = "s" }\n'
    for text, says in (
        (table + diameter, "thrust_by_advance is 0.9 at rest"),
        (diameter, "diameter counts only with"),
        (reaction + speed, "counts only with measured rotor speeds"),
    ):
        (doubt,) = parse_vehicle(by_speed() + text, "odd.toml").doubts
        assert says in doubt
    assert parse_vehicle(by_speed() + reaction, "fine.toml").doubts == ()


def test_all_mistakes_are_said_at_once() -> None:
    text = FULL.replace('"kg", source = "scale"', '"m", source = "scale"')
    text = text.replace("value = 40,", "value = -40,").replace("lag =", "lagg =")
    text = re.sub("^capacity.*\n", "", text, flags=re.MULTILINE)
    text = text.replace('["ccw", "ccw", "cw", "cw"]', '["ccw", "cw"]')
    with pytest.raises(ModelError) as error:
        parse_vehicle(text, "mine.toml")
    first, *lines = str(error.value).splitlines()
    assert first == "mine.toml: 5 mistakes:"
    starts = ("unknown key", "body.mass", "battery.resistance", "rotors.direction", "[battery]")
    assert [line.startswith(f"  {start}") for line, start in zip(lines, starts, strict=True)] == [
        True
    ] * 5


def test_a_torque_map_of_the_other_argument_is_of_no_use() -> None:
    text = by_speed() + 'torque_from_command = { coefficients = [1], unit = "N*m", source = "s" }\n'
    with pytest.raises(
        ModelError, match=r"torque_from_command is of no use with thrust_from_speed"
    ):
        parse_vehicle(text, "mine.toml")


@pytest.mark.parametrize("name", ["full_voltage", "empty_voltage", "hover_current"])
def test_a_battery_is_whole_or_none(name: str) -> None:
    head, battery = FULL.split("[battery]\n")
    assert parse_vehicle(head + "[battery]\n", "v.toml").battery is None
    line = next(row for row in battery.splitlines() if row.startswith(name))
    with pytest.raises(ModelError, match=r"\[battery\] is given without .*all of them or none"):
        parse_vehicle(f"{head}[battery]\n{line}\n", "v.toml")


def test_misspelt_section_is_said() -> None:
    with pytest.raises(ModelError, match=r"unknown section: 'rotor'\. Did you mean 'rotors'"):
        parse_vehicle(FULL.replace("[rotors]", "[rotor]"), "mine.toml")
    with pytest.raises(ModelError, match=r"\[battery\] must be a table"):
        parse_vehicle(FULL.replace("[battery]", "[[battery]]"), "mine.toml")


@pytest.mark.parametrize(
    ("thrust", "torque", "expected"),
    [
        (
            'thrust_from_speed = { coefficients = [0, 1], unit = "N", source = "s" }',
            K_TORQUE,
            r'thrust_from_speed needs of = "rad/s"',
        ),
        (
            'thrust_from_speed = { coefficients = [0, 1], unit = "N", of = "Hz*m", source = "s" }',
            K_TORQUE,
            r'thrust_from_speed: of = "Hz\*m" is not a rotor speed',
        ),
        (
            'thrust_from_speed = { coefficients = [0, 1], unit = "N", of = "tacho", source = "s" }',
            K_TORQUE,
            r"thrust_from_speed has unit 'tacho', which is not a unit",
        ),
        (
            'thrust_from_speed = { value = [1, 2], unit = "N*s^2", source = "s" }',
            K_TORQUE,
            r"a single value k means k \* speed\^2",
        ),
        (
            'thrust_from_speed = { value = -1e-6, unit = "N*s^2", source = "s" }',
            K_TORQUE,
            r"thrust_from_speed = -1e-06 must be positive",
        ),
        ('thrust_from_speed = { value = 1e-6, unit = "N", source = "s" }', K_TORQUE, 'unit "N"'),
        (K_THRUST, "", r"reaction torque needs exactly one of"),
        (K_THRUST, K_TORQUE + "\nbattery = 3", r"unknown key in \[rotors\]: 'battery'"),
    ],
)
def test_what_is_wrong_with_maps_of_the_speed_is_said(
    thrust: str, torque: str, expected: str
) -> None:
    with pytest.raises(ModelError, match=expected) as error:
        parse_vehicle(by_speed(thrust, torque), "mine.toml")
    assert str(error.value).startswith("mine.toml: ")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"[body\nmass = 1", r"mine\.toml: not valid TOML: .*line 1"),
        (b"\xff\xfe[body]", r"mine\.toml: cannot be read as text"),
        (b"", r"(?s)mine\.toml: 5 mistakes:.*  body\.mass is missing"),
        (b"\x00", r"mine\.toml: not valid TOML"),
        (FULL.encode() + b"[body]\n", r"not valid TOML"),
    ],
)
def test_files_that_are_no_vehicle(tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(content)
    with pytest.raises(ModelError, match=expected):
        load_vehicle(path)


def test_missing_file_suggests_a_builtin_vehicle(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"crazyfly: .*Did you mean 'crazyflie'.*feisi_x150"):
        load_vehicle("crazyfly")
    for gone in (tmp_path / "no.toml", tmp_path, ""):
        with pytest.raises(ModelError, match="neither a vehicle file nor a built-in"):
            load_vehicle(gone)


LINES = FULL.splitlines()
WEIRD = (
    "nan",
    "-inf",
    "1e999",
    "0",
    "-1",
    "true",
    '"x"',
    "[]",
    "[[]]",
    "{}",
    "[1, [2]]",
    "07:32:00",
    "1979-05-27",
    "9" * 400,
    '["cw"]',
    "[1e308, 1e308, 1e308]",
    '"\\u0000"',
    "1e-320",
)


def survives(text: str) -> None:
    """It loads, and then flies or says why not; or it is refused in words that name the file."""
    try:
        vehicle = parse_vehicle(text, "mine.toml")
    except ModelError as error:
        assert str(error).startswith("mine.toml: ")
        return
    assert np.isfinite(vehicle.mass_kg)
    try:
        airframe(vehicle)
    except ModelError:
        return


@pytest.mark.slow
@given(
    edits=st.lists(
        st.tuples(
            st.integers(0, len(LINES) - 1),
            st.sampled_from(["delete", "twice", "swap", "cut"]),
            st.integers(0, 120),
        ),
        min_size=1,
        max_size=3,
    )
)
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
def test_lines_deleted_doubled_moved_or_cut(edits: list[tuple[int, str, int]]) -> None:
    lines = list(LINES)
    for row, edit, at in edits:
        row %= len(lines)
        if edit == "delete":
            del lines[row]
        elif edit == "twice":
            lines.insert(row, lines[row])
        elif edit == "swap":
            other = at % len(lines)
            lines[row], lines[other] = lines[other], lines[row]
        else:
            lines[row] = lines[row][:at]
    survives("\n".join(lines))


@pytest.mark.slow
@given(
    at=st.integers(0, len(FULL) - 1),
    new=st.text(max_size=3) | st.sampled_from(list("0123456789.,-[]{}\"'=#\n")),
    drop=st.integers(0, 3),
)
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
def test_characters_replaced(at: int, new: str, drop: int) -> None:
    survives(FULL[:at] + new + FULL[at + drop :])


@pytest.mark.slow
@given(data=st.data())
@settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
def test_values_replaced_by_odd_ones(data: st.DataObject) -> None:
    spots = list(
        re.finditer(r'(?:value|coefficients|unit|source) = (\[.*\]|"[^"]*"|[^,]+?)(?=, | })', FULL)
    )
    spot = data.draw(st.sampled_from(spots))
    survives(FULL[: spot.start(1)] + data.draw(st.sampled_from(WEIRD)) + FULL[spot.end(1) :])


@given(blob=st.binary(max_size=60))
@settings(max_examples=60, deadline=None)
def test_any_bytes(tmp_path_factory: pytest.TempPathFactory, blob: bytes) -> None:
    path = tmp_path_factory.mktemp("bytes") / "mine.toml"
    path.write_bytes(blob)
    with pytest.raises(ModelError, match=r"^mine\.toml: "):
        load_vehicle(path)


# -- two aircraft from their papers, as a user would write them ----------------------------

HUMMINGBIRD = """\
name = "hummingbird"
description = "AscTec Hummingbird, plus configuration"
[body]
mass = { value = 0.716, unit = "kg", source = "RotorS, hummingbird.xacro; Furrer et al. 2016" }
inertia = { value = [0.007, 0.007, 0.012], unit = "kg*m^2", source = "RotorS" }
[rotors]
# RotorS counts front, left, back, right, in axes with y to the left: y changes sign here.
position = { value = [[0.17, 0, 0], [0, -0.17, 0], [-0.17, 0, 0], [0, 0.17, 0]], unit = "m", source = "RotorS, arm_length" }
direction = { value = ["cw", "ccw", "cw", "ccw"], source = "RotorS" }
thrust_from_speed = { value = 8.54858e-6, unit = "N*s^2/rad^2", source = "RotorS, motor_constant" }
torque_per_thrust = { value = 0.016, unit = "m", source = "RotorS, moment_constant" }
"""
FOERSTER = """\
name = "crazyflie_foerster"
description = "Crazyflie 2.0 as identified by Foerster 2015, ETH Zurich"
[body]
mass = { value = 28, unit = "g", source = "Foerster 2015" }
# The thesis has y left and z up: Ixy and Ixz change sign in FRD, Iyz does not.
inertia = { value = [16.571710e-6, 16.655602e-6, 29.261652e-6, -0.830806e-6, -0.718277e-6, 1.800197e-6], unit = "kg*m^2", source = "Foerster 2015" }
[rotors]
position = { value = [[32.5, 32.5, 0], [-32.5, 32.5, 0], [-32.5, -32.5, 0], [32.5, -32.5, 0]], unit = "mm", source = "46 mm arm at 45 degrees" }
direction = { value = ["ccw", "cw", "ccw", "cw"], source = "Foerster 2015" }
command_range = { value = [0, 65535], source = "16 bit command" }
thrust_from_command = { coefficients = [5.484560e-4, 1.032633e-6, 2.130295e-11], unit = "N", source = "Foerster 2015" }
# torque = 0.005964552 m * thrust + 1.563383e-5 N m, multiplied out by hand.
torque_from_command = { coefficients = [1.8905128e-5, 6.1591931e-9, 1.2706255e-13], unit = "N*m", source = "Foerster 2015" }
"""


def test_hummingbird_of_the_rotors_simulator() -> None:
    vehicle = parse_vehicle(HUMMINGBIRD, "hummingbird.toml")
    rig = Rig(airframe(vehicle))
    hover = np.sqrt(0.716 * GRAVITY_M_S2 / 4 / 8.54858e-6)
    np.testing.assert_allclose(rig.inputs()[:4], hover, rtol=1e-9)  # 453 rad/s
    assert vehicle.doubts == ()


def test_crazyflie_of_foerster() -> None:
    vehicle = parse_vehicle(FOERSTER, "foerster.toml")
    rig = Rig(airframe(vehicle))
    hover = rig.inputs()[:4] * 65535
    thrust = polyval(hover, [5.484560e-4, 1.032633e-6, 2.130295e-11])
    assert thrust.sum() == pytest.approx(0.028 * GRAVITY_M_S2, rel=1e-9)
    assert 36000 < hover.mean() < 39000
    torque = polyval(0.6, vehicle.rotors.torque_n_m)
    exact = 0.005964552 * polyval(0.6, vehicle.rotors.thrust_n) + 1.563383e-5
    assert torque == pytest.approx(exact, rel=1e-6)
