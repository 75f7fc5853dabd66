"""Numbers and clauses as a pilot reads them."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.effects import EFFECTS
from twin.explain.inference.detection import Detectable
from twin.formatting import quantity, readable
from uavtwin.headline import varied, wind
from uavtwin.wording import blind, clause, said, said_numbers, undetectable, undetermined

UNITS = sorted(
    {p.unit for e in EFFECTS.values() for p in (*e.parameters, *e.of_logs)} | {"Pa", "N"}
)
UNREADABLE = re.compile(
    r"\d(?:\.\d+)?e[-\u2212]\d+ *(?:T|N|m|s|rad|Pa|V|kg|N\.m|N\.m\.s|m/s2?|m/s²)(?![\w/])"
)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (3.15e-5, "T", "31.5 µT"),
        (1500.0, "Pa", "15 hPa"),
        (-0.032, "rad", "\N{MINUS SIGN}1.83°"),
        (0.01, "rad/s", "0.573 °/s"),
        (0.0022, "m", "2.2 mm"),
        (1.2, "m", "1.2 m"),
        (0.0046, "s", "4.6 ms"),
        (0.09, "kg", "90 g"),
        (0.3, "kg", "0.3 kg"),
        (7.7e-5, "N.m.s", "77 µN.m.s"),
        (2.7e-20, "N.m.s", "0 nN.m.s"),
        (0.3, "1/s", "0.3 1/s"),
        (0.5, "1", "0.5"),
    ],
)
def test_quantities_have_units_that_a_pilot_reads(value: float, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


@given(st.sampled_from(UNITS), st.floats(1e-12, 1e4))
def test_no_quantity_is_a_power_of_ten_of_a_unit(unit: str, value: float) -> None:
    assert not UNREADABLE.search(quantity(value, unit))


@given(st.sampled_from(UNITS), st.floats(1e-6, 1e3), st.floats(-1, 1))
def test_values_of_one_row_share_their_unit(unit: str, value: float, part: float) -> None:
    (whole, share), name = readable(unit, value, part * value)
    assert share == pytest.approx(part * whole, abs=1e-3 * abs(whole) + 1e-3)
    assert readable(unit, value)[1] == name


def test_drag_is_told_in_one_unit() -> None:
    """Of discs that tilt back, too: 0.02 rad in a metre per second are 0.02 g of drag."""
    assert clause("rotor_drag", {"k_xy_1_s": 0.196}, since=False) == "0.196 (m/s²)/(m/s) horizontal"
    flapping = {"k_rad_s_m": 0.02, "height_m": 0.03}
    assert clause("blade_flapping", flapping, since=False) == "0.196 (m/s²)/(m/s) horizontal"


def test_only_numbers_that_a_clause_gives_are_listed() -> None:
    shift = {"x_m": -0.02, "y_m": 0.001, "z_m": 0.0}
    assert said_numbers("cog_offset", shift) == {"x_m": -0.02}
    text = clause("cog_offset", shift, since=False)
    assert text == "its centre of mass is 20 mm further back than in the model"
    turned = {"yaw_rad": 0.1, "pose_rad": -0.2}
    assert said_numbers("heading_offset", turned) == {"pose_rad": -0.2}
    assert (
        clause("heading_offset", turned, since=False) == "its heading is off by \N{MINUS SIGN}11.5°"
    )
    drag = {"k_xy_1_s": 0.4, "k_z_1_s": 0.0, "height_m": 0.05}
    assert said_numbers("rotor_drag", drag) == {"k_xy_1_s": 0.4}
    assert clause("rotor_drag", {"height_m": 0.05}, since=False) == ""


def test_numbers_without_a_clause_are_all_said() -> None:
    iron = {"x_t": -8e-5, "y_t": -1e-6, "z_t": 4e-5}
    assert {*said_numbers("mag_hard_iron", iron)} == {"x_t", "z_t"}
    text = said("mag_hard_iron", iron, since=False)
    assert text == "mag hard iron (x_t \N{MINUS SIGN}80 µT, z_t 40 µT)"
    assert said("rotor_drag", {"height_m": 0.02}, since=True) == "rotor drag (height_m 20 mm)"


def test_what_is_not_determined_has_a_sentence_without_a_number() -> None:
    assert undetermined([], []) == ""
    one = " Gyro bias may be zero: these flights do not determine it."
    assert undetermined(["gyro_bias"], []) == one
    both = undetermined(["gyro_bias", "thrust_scale"], ["motor_lag"])
    assert both == (
        " Gyro bias and thrust scale may be zero: these flights do not determine them."
        " These flights do not determine how large motor lag is."
    )
    assert not re.search(r"\d", both)


def test_nothing_says_how_blind_it_is() -> None:
    seen = {
        "cog_offset": Detectable("cog_offset.x_m", 0.003, "m"),
        "rotor_efficiency_loss": Detectable("rotor_efficiency_loss.loss_2", 0.15, "1"),
        "mass_offset": Detectable("mass_offset.mass_kg", None, "kg"),
        "pose_smoothing": Detectable("pose_smoothing.attitude_s2", 1e-3, "s2"),
    }
    assert blind(seen, since=False) == (
        " A loss below 15 % of the thrust of one rotor or a centre of mass that is off by less "
        "than 3 mm would not show in these flights."
    )
    assert "that has changed by less than 3 mm" in blind(seen, since=True)
    assert blind({}, since=False) == ""
    assert blind({}, since=True, axes="xz") == (
        " These flights do not tell how the aircraft answers in roll and yaw: nothing asks for it."
    )


def test_what_flights_would_not_show_at_its_usual_size_is_said_beside_a_name() -> None:
    seen = {
        "motor_lag": Detectable("motor_lag.tau_s", 0.12, "s"),
        "thrust_scale": Detectable("thrust_scale.scale", 0.05, "1"),
        "mass_offset": Detectable("mass_offset.mass_kg", None, "kg"),
    }
    usual = {"motor_lag.tau_s": 0.04, "thrust_scale.scale": 0.3, "mass_offset.mass_kg": 0.1}
    assert undetectable(seen, usual) == (
        " Mass offset of any size or a motor lag that is off by less than 0.12 s would not show in "
        "these flights."
    )
    assert undetectable({"motor_lag": seen["motor_lag"]}, {"motor_lag.tau_s": 0.2}) == ""


def test_what_differs_between_flights_has_a_sentence() -> None:
    usual = {"heading_offset.yaw_rad": 0.15, "baro_bias.pa": 20.0, "clock_offset.pose_s": 0.02}
    usual |= {"cog_offset.x_m": 0.01, "heading_offset.pose_rad": 0.1}
    day = {
        "one": {"heading_offset.yaw_rad": (0.62, 0.1), "clock_offset.pose_s": (1.0, 0.1)},
        "two": {"heading_offset.yaw_rad": (-0.5, 0.05), "cog_offset.x_m": (0.025, 0.001)},
        "three": {"heading_offset.yaw_rad": (0.2, 0.05), "heading_offset.pose_rad": (1.0, 0.1)},
    }
    assert varied(day, usual, ()) == (
        " Between these flights differs heading offset (+35.5° in one and \N{MINUS SIGN}28.6° in "
        "two)."
    )
    assert varied(day, usual, ["heading_offset"]) == varied({"one": day["one"]}, usual, ()) == ""
    weather = {"three": {"baro_bias.pa": (658.0, 4.0)}}
    assert "differs baro bias (+6.58 hPa in three) and heading" in varied(day | weather, usual, ())


def test_the_strongest_wind_of_the_days_has_a_sentence() -> None:
    still = {"cog_offset.x_m": (-0.005, 0.002)}
    breeze = {"steady_wind.north_m_s": (1.0, 0.1), **still}
    strong = {"steady_wind.north_m_s": (-3.0, 0.3), "steady_wind.east_m_s": (4.0, 0.1)}
    assert wind({}) == wind({"one": still}) == ""
    text = wind({"one": still, "two": breeze, "three": strong})
    assert text == " The wind in three was 5 m/s (± 0.39 m/s)."
