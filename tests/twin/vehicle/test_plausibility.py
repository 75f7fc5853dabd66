# ruff: noqa: E501 (an entry of a vehicle file stays on one line)
"""What a colleague asks: of an odd vehicle each question, of a sound one none."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rig import BUILTIN, X, plain

from twin.vehicle import Deviation, Vehicle
from twin.vehicle import plausibility as ask
from twin.vehicle.plausibility import Question, questions
from twin.vehicle_file import load_vehicle, parse_vehicle

Asking = Callable[[Vehicle], Iterator[Question]]
Change = Callable[[Vehicle], Vehicle]


def sound() -> Vehicle:
    """Of which there is nothing to ask: 1.2 kg, an arm of 0.23 m, hubs 3 cm above the middle."""
    base = plain()
    return replace(
        base,
        inertia_kg_m2=np.diag([0.017, 0.018, 0.031]),
        rotors=replace(base.rotors, position_m=0.1626 * X + np.array([0, 0, -0.03])),
        sources={"body.mass": "weighed", "rotors.position": "measured", "rotors.lag": "default: x"},
    )


def rotors(**changes: object) -> Change:
    return lambda v: replace(v, rotors=replace(v.rotors, **changes))  # type: ignore[arg-type]


def inertia(*moments: float) -> Change:
    return lambda v: replace(v, inertia_kg_m2=np.diag(moments))


def at(a_m: float, name: str = "quad", source: str = "ruler") -> Change:
    return lambda v: replace(
        v,
        name=name,
        rotors=replace(v.rotors, position_m=a_m * X),
        sources={**v.sources, "rotors.position": source},
    )


ODD: dict[str, tuple[Asking, Change, str]] = {
    "Izz forgotten": (ask.flatness, inertia(0.02, 0.02, 0.02), "Izz is 0.50 of Ixx + Iyy"),
    "ten times too heavy to turn": (ask.gyration, inertia(0.17, 0.18, 0.31), "1.64 about x"),
    "ten times too light to turn": (ask.gyration, inertia(0.0017, 0.0018, 0.0031), "0.52 to 0.86"),
    "arm for a coordinate, with its mass": (ask.gyration, at(0.23), "0.37 about x"),
    "arm for a coordinate": (ask.arm, at(0.23), "each coordinate is 0.1626 m"),
    "frame size for twice a coordinate": (
        ask.arm,
        at(0.1251, name="X250"),
        "For 250 mm across write 0.08839 m for 0.1251 m",
    ),
    "coordinate of a coordinate": (ask.arm, at(0.0625, name="X250"), "write 0.08839 m for 0.0625"),
    "strong": (ask.hover_command, rotors(thrust_n=(0.0, 30.0)), "0.10 in hover"),
    "weak": (ask.hover_command, rotors(thrust_n=(0.0, 3.2)), "0.92 in hover"),
    "grams for newtons": (ask.thrust_to_weight, rotors(thrust_n=(0.0, 784.0)), "266.49 times"),
    "no reserve": (ask.thrust_to_weight, rotors(thrust_n=(0.0, 3.2)), "1.09 times the weight"),
    "torque of a large propeller": (
        ask.reaction_torque,
        rotors(torque_n_m=(0.0, 0.5)),
        "over the arm of 0.23 m that is 0.27",
    ),
    "no torque": (ask.reaction_torque, rotors(torque_n_m=(0.0, 0.0)), "that is 0.00"),
    "no lag": (ask.missing_lag, rotors(lag_up_s=0.0, lag_down_s=0.0), "15 to 75 ms"),
    "flat": (ask.hub_height, at(0.1626), "z = 0 m for all rotors"),
    "unknown": (
        ask.unknown_deviations,
        lambda v: replace(v, sources={"body.mass": "a paper", "rotors.direction": "a paper"}),
        "not known of 1 entries",
    ),
}


def test_a_sound_vehicle_is_asked_nothing() -> None:
    assert questions(sound()) == ()


@pytest.mark.parametrize("case", ODD)
def test_an_odd_one_is_asked(case: str) -> None:
    asking, change, says = ODD[case]
    (question,) = asking(change(sound()))
    assert says in str(question)
    assert question in questions(change(sound()))
    for part in (question.key, question.value, question.why, question.way_out):
        assert part.strip()
    assert str(question).startswith(f"{question.key} = {question.value}: ")


def test_every_question_has_an_odd_vehicle() -> None:
    asked = {asking for asking, _, _ in ODD.values()}
    own = {getattr(ask, n) for n in dir(ask) if getattr(ask, n).__class__ is type(sound)}
    own = {f for f in own if f.__module__ == ask.__name__ and not f.__name__.startswith("_")}
    assert own - {questions} == asked


@pytest.mark.parametrize(
    ("name", "source"),
    [("quad", "ruler; diagonal 650 mm"), ("X650", "ruler"), ("quad", "arm at 45 degrees")],
)
def test_an_answer_in_the_file_ends_the_question(name: str, source: str) -> None:
    assert list(ask.arm(at(0.23, name, source)(sound()))) == []


def test_rotors_that_are_no_square_are_not_asked_for_the_arm() -> None:
    plus = np.array([[0.23, 0, 0], [0, -0.23, 0], [-0.23, 0, 0], [0, 0.23, 0]])
    for places in (plus, 0.2 * X * [1, 1.3, 1]):
        assert list(ask.arm(rotors(position_m=places)(sound()))) == []


def test_of_a_vehicle_driven_by_speeds_no_command_is_asked() -> None:
    speed = rotors(
        from_speed=True,
        speed_rad_s=None,
        thrust_n=(0.0, 0.0, 1e-5),
        torque_n_m=(0.0, 0.0, 2e-7),
        lag_up_s=0.0,
        lag_down_s=0.0,
    )(sound())
    assert speed.drive == "rotor_speed"
    assert questions(speed) == ()


def test_speed_of_a_command_is_followed_to_the_thrust() -> None:
    by_speed = rotors(
        from_speed=True,
        speed_rad_s=(0.0, 5000.0),
        thrust_n=(0.0, 0.0, 1e-5),
        torque_n_m=(0.0, 0.0, 2e-7),
    )(sound())
    (question,) = ask.hover_command(by_speed)
    assert question.key == "rotors.speed_from_command"
    assert question.value.startswith(f"{np.sqrt(1.2 * 9.80665 / 4 / 1e-5) / 5000:.2f} in hover")


def test_a_lag_by_an_effect_is_a_lag() -> None:
    quick = rotors(lag_up_s=0.0, lag_down_s=0.0)(sound())
    assert list(ask.missing_lag(quick.with_effects({"motor_lag": {"tau_s": 0.03}}))) == []


def test_many_unknown_entries_are_cut_short() -> None:
    stated = {"rotors.lag": Deviation(0.1)}
    keys = ["body.mass", "body.inertia", "body.leg_height", "a.b", "c.d", "e.f", "rotors.lag"]
    odd = replace(sound(), sources=dict.fromkeys(keys, "a paper"), deviations=stated)
    (question,) = ask.unknown_deviations(odd)
    assert question.value == "not known of 6 entries"
    assert "e.f" not in question.why
    assert all(word in question.way_out for word in ("made up (30 %)", "weighed (1 %)"))


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("copter_default", ["rotors.position", "sd"]),
        ("crazyflie", ["rotors.position", "sd"]),
        # Torque of another propeller; by the flights it is half of it (docs/results/real_flights.md).
        ("feisi_x150", ["rotors.torque_per_thrust", "rotors.lag", "rotors.position", "sd"]),
    ],
)
def test_of_the_built_in_vehicles(name: str, keys: list[str]) -> None:
    assert name in BUILTIN
    assert [q.key for q in questions(load_vehicle(name))] == keys


def test_a_flat_plate_is_possible_and_more_is_not() -> None:
    text = """
[body]
mass = {{ value = 1.2, unit = "kg", source = "s" }}
inertia = {{ value = [0.0123, 0.0124, {}], unit = "kg*m^2", source = "s" }}
[rotors]
position = {{ value = [[0.2, 0, 0], [0, -0.2, 0], [-0.2, 0, 0], [0, 0.2, 0]], unit = "m", source = "s" }}
direction = {{ value = ["cw", "ccw", "cw", "ccw"], source = "s" }}
thrust_from_speed = {{ value = 1.6e-5, unit = "N*s^2/rad^2", source = "s" }}
torque_from_speed = {{ value = 2.2e-7, unit = "N*m*s^2/rad^2", source = "s" }}
"""
    flat = parse_vehicle(text.format(0.0123 + 0.0124), "flat.toml")
    assert flat.doubts == ()
    assert list(ask.flatness(flat)) == []
    (doubt,) = parse_vehicle(text.format(0.0248), "more.toml").doubts
    assert "0.0123 and 0.0124 kg*m^2 add up to less than the third, 0.0248" in doubt


@pytest.mark.slow
@given(
    size=st.floats(0.3, 3.0),
    mass=st.floats(0.5, 2.0),
)
def test_a_scaled_copy_is_as_sound(size: float, mass: float) -> None:
    """Lengths, mass and thrust scaled together leave every ratio where it was."""
    base = sound()
    scaled = replace(
        base,
        mass_kg=mass * base.mass_kg,
        inertia_kg_m2=mass * size**2 * base.inertia_kg_m2,
        rotors=replace(
            base.rotors,
            position_m=size * base.rotors.position_m,
            thrust_n=tuple(mass * c for c in base.rotors.thrust_n),
            torque_n_m=tuple(mass * size * c for c in base.rotors.torque_n_m),
        ),
    )
    assert {q.key for q in questions(scaled)} <= {"rotors.position"}  # a round coordinate
