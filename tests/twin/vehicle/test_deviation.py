# ruff: noqa: E501 (an entry of a vehicle file stays on one line)
"""How well a file knows its numbers: `sd` read, refused and written; words of the sources."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.effects import EFFECTS, prior_of
from twin.errors import ModelError
from twin.vehicle import Deviation, Vehicle, relative_deviation
from twin.vehicle.vehicle import WORDS, share_by_word
from twin.vehicle_file import builtin_vehicles, load_vehicle, parse_vehicle, vehicle_text
from twin.vehicle_file.write import update_text

FILE = """\
[body]
mass = { value = 500, unit = "g", sd = 5, source = "scale" }  # with battery
inertia = { value = [1e-3, 1.1e-3, 1.8e-3], unit = "kg*m^2", sd = "5 %", source = "swung" }
drag_linear = { value = [1, 1, 2], unit = "1/s", sd = [0.1, 0.1, 0.2], source = "fit" }

[rotors]
# front right, rear left, front left, rear right
position = { value = [[0.3, 0.4, 0], [-0.3, -0.4, 0], [0.3, -0.4, 0], [-0.3, 0.4, 0]], unit = "m", sd = 0.01, source = "ruler" }
direction = { value = ["ccw", "ccw", "cw", "cw"], source = "seen" }
thrust_from_speed = { value = 1e-6, unit = "N*s^2/rad^2", sd = 1e-7, source = "stand" }
torque_from_speed = { coefficients = [0, 0, 2e-8], unit = "N*m", of = "rad/s", sd = "12.5%", source = "stand" }
speed_from_command = { coefficients = [0, 3000], unit = "rad/s", source = "measured" }
lag = { value = [30, 50], unit = "ms", sd = [3, 5], source = "stand" }
reaction_inertia = { value = 0, unit = "kg*m^2", sd = 1e-6, source = "weighed" }

[imu]
position = { value = [0, 0, 0], unit = "cm", source = "estimated" }

[effects.rotor_drag]
k_xy_1_s = { value = 30, unit = "1/minute", sd = 3, source = "flown" }
"""


def entry(key: str, new: str) -> str:
    changed, n = re.subn(rf"^{key} = .*$", lambda _: new, FILE, flags=re.MULTILINE)
    assert n == 1, key
    return changed


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return parse_vehicle(FILE, "mine.toml")


# -- sd -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "share", "numbers"),
    [
        ("body.mass", 0.01, [0.005]),
        ("body.inertia", 0.05, None),
        ("body.drag_linear", 0.1, [0.05, 0.05, 0.1]),  # per kilogram, of half a kilogram
        ("rotors.position", 0.02, [0.01]),  # of the arm, 0.5 m
        ("rotors.thrust_from_speed", 0.1, None),  # one number k stands for the whole map
        ("rotors.torque_from_speed", 0.125, None),
        ("rotors.lag", 0.1, [0.003, 0.005]),
        ("rotors.reaction_inertia", math.inf, [1e-6]),
        ("effects.rotor_drag.k_xy_1_s", 0.1, [0.05]),
    ],
)
def test_what_is_stated_is_read_in_si_units(
    vehicle: Vehicle, key: str, share: float, numbers: list[float] | None
) -> None:
    found = vehicle.deviations[key]
    assert found.share == pytest.approx(share)
    assert found.numbers == (None if numbers is None else pytest.approx(numbers))


def test_nothing_else_is_stated(vehicle: Vehicle) -> None:
    assert len(vehicle.deviations) == FILE.count("sd =")
    for name in builtin_vehicles():
        assert set(load_vehicle(name).deviations) <= set(load_vehicle(name).sources)


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("body.mass", (0.01, True)),
        ("rotors.thrust", (0.1, True)),
        ("rotors.torque", (0.125, True)),
        ("rotors.lag", (0.1, True)),
        ("rotors.position", (0.02, True)),
        ("imu.position", (0.2, False)),
        ("rotors.speed_from_command", (0.03, False)),
        ("rotors.direction", None),  # words that say nothing of it
        ("rotors.spin_inertia", None),  # a default
        ("effects.rotor_drag.k_xy_1_s", (0.1, True)),
        ("effects.rotor_drag.k_z_1_s", None),
    ],
)
def test_relative_deviation(
    vehicle: Vehicle, key: str, expected: tuple[float, bool] | None
) -> None:
    found = relative_deviation(vehicle, key)
    assert (found is None) == (expected is None)
    if found and expected:
        assert found.sd == pytest.approx(expected[0])
        assert found.stated == expected[1]


def test_whatever_an_effect_corrects_can_be_asked_for(vehicle: Vehicle) -> None:
    """A name that no file has would always be unknown, in silence."""
    torque = 'torque_per_thrust = { value = 0.01, unit = "m", sd = "30 %", source = "x" }'
    by_ratio = parse_vehicle(entry("torque_from_speed", torque), "mine.toml")
    assert relative_deviation(by_ratio, "rotors.torque") == (0.3, True)
    sources = dict.fromkeys([*vehicle.sources, "rotors.spin_inertia"], "measured")
    known = replace(vehicle, sources=sources, deviations={})
    for key in {p.corrects for p in map(prior_of, EFFECTS.values())} - {None}:
        assert key is not None
        assert relative_deviation(known, key) == (0.03, False), key


def test_numbers_of_each_moment_weigh_as_the_moments() -> None:
    line = 'inertia = {{ value = [1, 2, 2{}], unit = "g*m^2", sd = {}, source = "x" }}'
    for more, sd in (("", "[0.1, 0.2, 0.2]"), (", 0, 0, 0.5", "[0.1, 0.2, 0.2]")):
        found = parse_vehicle(entry("inertia", line.format(more, sd)), "mine.toml")
        assert found.deviations["body.inertia"].share == pytest.approx(0.1)
    six = entry("inertia", line.format(", 0, 0, 0.5", "[0.1, 0.2, 0.2, 9, 9, 9]"))
    assert parse_vehicle(six, "mine.toml").deviations["body.inertia"].share == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("sd", "says"),
    [
        ("-5", r"body\.mass: sd = -5 must be positive; leave it out"),
        ("0", "must be positive"),
        ("nan", r"body\.mass: sd = nan must be finite"),
        ("inf", "must be finite"),
        ("true", r"body\.mass: sd = True must be numbers"),
        ("[5, 5]", r"sd = \[5, 5\] must be one number, for all of the value, or one for each"),
        ("[]", "must be one number, for all"),
        ("{}", "must be numbers"),
        ('"5 g"', r"sd = '5 g' must be a positive number without quotes, in the unit"),
        ('"five %"', r"or a share of the value as in sd = \"5 %\""),
        ('"-5 %"', "must be a positive number"),
        ('"0 %"', "must be a positive number"),
        ('"nan %"', "must be a positive number"),
        ('"1e999 %"', "must be a positive number"),
        ('"1e-999 %"', "must be a positive number"),
        ('"\\u0665 %"', "must be a positive number"),
        ('"%"', "must be a positive number"),
    ],
)
def test_a_bad_sd_is_refused(sd: str, says: str) -> None:
    line = f'mass = {{ value = 500, unit = "g", sd = {sd}, source = "scale" }}'
    with pytest.raises(ModelError, match=says) as error:
        parse_vehicle(entry("mass", line), "mine.toml")
    assert str(error.value).startswith("mine.toml: body.mass")
    line = f'k_xy_1_s = {{ value = 0.5, unit = "1/s", sd = {sd}, source = "flown" }}'
    with pytest.raises(ModelError, match=r"effects\.rotor_drag\.k_xy_1_s: sd = "):
        parse_vehicle(entry("k_xy_1_s", line), "mine.toml")


@pytest.mark.parametrize(
    ("key", "line", "says"),
    [
        (
            "direction",
            'direction = { value = ["cw", "cw", "ccw", "ccw"], sd = 1, source = "x" }',
            "rotors.direction takes no sd",
        ),
        (
            "torque_from_speed",
            'torque_from_speed = { coefficients = [0, 2e-5], unit = "N*m", of = "rad/s", sd = [1, 1], source = "x" }',
            r"sd = \[1, 1\] must be a share of the whole map",
        ),
        (
            "lag",
            'lag = { value = 0.05, unit = "s", sd = [1, 1], source = "x" }',
            "must be one number",
        ),
        (
            "mass",
            'mass = { value = 0.5, unit = "kg", sdd = 1, source = "x" }',
            r"unknown part of body\.mass: 'sdd'. Did you mean 'sd'",
        ),
    ],
)
def test_an_sd_that_does_not_fit_its_value_is_refused(key: str, line: str, says: str) -> None:
    with pytest.raises(ModelError, match=says):
        parse_vehicle(entry(key, line), "mine.toml")


# -- written --------------------------------------------------------------------------------


def test_what_is_stated_survives(vehicle: Vehicle) -> None:
    assert update_text(vehicle, FILE, "mine.toml") == FILE
    anew = parse_vehicle(update_text(vehicle), "mine.toml")  # without a text to start from
    zero = {"rotors.reaction_inertia"}  # what does nothing is left out of a new text
    assert anew.deviations == {k: d for k, d in vehicle.deviations.items() if k not in zero}


def test_a_new_number_takes_the_old_sd_with_it(vehicle: Vehicle) -> None:
    """Unless its source or its sd is new as well; the drag is per kilogram, and stays known."""
    lighter = parse_vehicle(update_text(vehicle.with_mass(0.4), FILE), "mine.toml")
    assert relative_deviation(lighter, "body.mass") is None
    assert set(vehicle.deviations) - set(lighter.deviations) == {"body.mass"}
    assert lighter.deviations["body.drag_linear"] == vehicle.deviations["body.drag_linear"]
    weighed = replace(
        vehicle.with_mass(0.4), sources={**vehicle.sources, "body.mass": "weighed again"}
    )
    again = parse_vehicle(update_text(weighed, FILE), "mine.toml")
    assert again.deviations["body.mass"].numbers == (0.005,)
    assert "# with battery" in update_text(weighed, FILE)


def test_an_sd_alone_is_written(vehicle: Vehicle) -> None:
    stated = {**vehicle.deviations, "body.mass": Deviation(0.02)}
    del stated["rotors.lag"]
    text = update_text(replace(vehicle, deviations=stated), FILE)
    again = parse_vehicle(text, "mine.toml")
    assert again.deviations == stated
    assert again.sources == vehicle.sources
    assert 'sd = "2 %", source = "scale"}  # with battery' in text


def test_an_effect_is_written_with_its_sd() -> None:
    name = "crazyflie"
    stated = {"effects.mass_offset.mass_kg": Deviation.of([0.001], [0.003])}
    loaded = replace(
        load_vehicle(name).with_effects({"mass_offset": {"mass_kg": 0.003}}), deviations=stated
    )
    again = parse_vehicle(update_text(loaded, vehicle_text(name)[0]), "mine.toml")
    assert again.deviations == stated
    known = relative_deviation(again, "effects.mass_offset.mass_kg")
    assert known is not None
    assert known.sd == pytest.approx(1 / 3)
    assert known.stated


@pytest.mark.slow
@given(share=st.floats(1e-9, 1e3))
def test_any_share_survives(share: float) -> None:
    base = load_vehicle("copter_default")
    stated = {"body.inertia": Deviation(share)}
    text = update_text(replace(base, deviations=stated), vehicle_text("copter_default")[0])
    assert parse_vehicle(text, "mine.toml").deviations["body.inertia"] == Deviation(share)


@pytest.mark.slow
@given(numbers=st.lists(st.floats(1e-6, 1e3), min_size=3, max_size=3))
def test_any_numbers_survive(numbers: list[float]) -> None:
    base = load_vehicle("copter_default")
    arm = base.arm_m
    stated = {"imu.position": Deviation.of(numbers, [arm])}
    found = parse_vehicle(update_text(replace(base, deviations=stated)), "mine.toml")
    assert found.deviations["imu.position"] == Deviation.of(numbers, [found.arm_m])
    rms = float(np.sqrt(np.mean(np.square(numbers))))
    assert found.deviations["imu.position"].share == pytest.approx(rms / arm)


# -- words ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "share"),
    [
        ("Weighed on a kitchen scale", 0.01),
        ("measured with a ruler", 0.03),
        ("bench, MEASURED twice", 0.03),
        ("identified on the real flights", 0.05),
        ("from CAD", 0.10),
        ("CAD, 3 May", 0.10),
        ("estimate: scaled from a sister frame", 0.20),
        ("a guess", 0.20),
        ("made up: legs of a 450 class frame", 0.30),
        ("made-up", 0.30),
        ("estimated from measured motors", 0.20),  # the most doubtful word counts
        ("weighed; inertia not measured", 0.01),
        ("not measured", None),
        ("not yet measured", None),
        ("never measured, no CAD", None),
        ("unmeasured, un-measured", None),
        ("not made up but measured", 0.03),
        ("academic paper", None),
        ("overestimated", None),
        ("set in Python; before: weighed", None),
        ("weighed; before: made up", 0.01),
        ("CopterSim default model parameters", None),
        ("", None),
    ],
)
def test_words_of_a_source(source: str, share: float | None) -> None:
    assert share_by_word(source) == share


@given(text=st.text(), word=st.sampled_from([(w, r.share) for r in WORDS for w in r.words]))
@settings(max_examples=50)
def test_a_word_counts_whatever_follows(text: str, word: tuple[str, float]) -> None:
    """Or one of more doubt, which the text may hold."""
    found = share_by_word(f"{word[0].upper()}, {text}")
    assert found is not None
    assert found >= word[1]


def test_words_are_in_the_order_of_doubt() -> None:
    shares = [row.share for row in WORDS]
    assert shares == sorted(shares, reverse=True)
    every = [word for row in WORDS for word in row.words]
    assert len(every) == len(set(every))
    assert all(share_by_word(w) == row.share for row in WORDS for w in row.words)
