"""`[calibration]` of a vehicle file: what flights told, written, read back and refused."""

import re
from dataclasses import replace

import numpy as np
import pytest

from twin.effects import EFFECTS
from twin.errors import ModelError
from twin.vehicle import Calibration, Vehicle
from twin.vehicle_file import load_vehicle, parse_vehicle, vehicle_text
from twin.vehicle_file.calibration import same_calibration
from twin.vehicle_file.write import update_text

TEXT, _ = vehicle_text("copter_default")
CHANGES = {name: e.change for name, e in EFFECTS.items() if e.change is not None}
COMMENT = "# put on by hand"
NUMBERS = ("thrust_scale.scale", "mass_offset.mass_kg", "clock_offset.pose_s")
SD = np.array([0.0123456789, 3.3e-3, 1 / 3 * 1e-3])
CORRELATION = np.array([[1.0, 0.987654321, -0.1], [0.987654321, 1.0, 0.0], [-0.1, 0.0, 1.0]])
REPORTED = Calibration(
    ("monday 1", 'a "quoted" one'),
    NUMBERS,
    CORRELATION * np.outer(SD, SD),
    {"cog_offset.x_m": 4e-4, "clock_offset.pose_s": 1 / 7 * 1e-3},
    {"gyro_rate_x": 1.2, "acc_x": 0.01},
    {"clock_offset.pose_s": 0.02},
    {"acc_z": -0.03},
    {"acc_z": 0.15},
    {"acc_x": 0.25, "gyro_rate_x": 1 / 3},
)
SECTION = """
[calibration]
flights = ["one"]
numbers = ["thrust_scale.scale", "mass_offset.mass_kg"]
sd = [0.01, 0.02]
correlation = [[1.0], [0.5, 1.0]]
days = { "cog_offset.x_m" = 0.0004 }
constants = { gyro_rate_x = 1.2 }
"""


def calibrated() -> Vehicle:
    return replace(load_vehicle("copter_default"), calibration=REPORTED)


def test_what_is_written_is_read_back() -> None:
    text = update_text(calibrated(), TEXT.replace("[body]", f"[body]  {COMMENT}"))
    assert COMMENT in text
    found = parse_vehicle(text, "mine.toml").calibration
    assert found is not None
    assert (found.flights, found.numbers) == (REPORTED.flights, REPORTED.numbers)
    assert found.covariance == pytest.approx(REPORTED.covariance, rel=1e-9, abs=1e-15)
    for part in ("days", "constants", "records", "means", "scatter", "left"):
        assert getattr(found, part) == pytest.approx(getattr(REPORTED, part), rel=1e-9)
    again = update_text(parse_vehicle(text, "mine.toml"), text)
    assert again == text


def test_a_person_can_read_it() -> None:
    text = update_text(calibrated(), TEXT)
    section = text.partition("[calibration]")[2]
    assert '    "thrust_scale.scale",\n' in section
    assert "    [0.987654321, 1.0],\n" in section
    assert '"clock_offset.pose_s" = 0.02' in section.partition("[calibration.records]")[2]
    assert "[effects.clock_offset]" not in text


def test_it_is_replaced_and_taken_out() -> None:
    text = update_text(calibrated(), TEXT)
    other = replace(REPORTED, flights=("tuesday",))
    new = update_text(replace(calibrated(), calibration=other), text)
    assert new.count("[calibration]") == 1
    assert same_calibration(parse_vehicle(new, "mine.toml").calibration, other)
    bare = update_text(replace(calibrated(), calibration=None), new)
    assert parse_vehicle(bare, "mine.toml").calibration is None
    assert bare.strip() == TEXT.strip()


def test_an_effect_beside_it_stays() -> None:
    entry = 'k_xy_1_s = { value = 0.3, unit = "1/s", sd = 0.05, source = "flown" }'
    text = f"{TEXT}\n[effects.rotor_drag]\n{entry}\n"
    vehicle = replace(parse_vehicle(text, "mine.toml"), calibration=REPORTED)
    new = parse_vehicle(update_text(vehicle, text), "mine.toml")
    assert new.effects == vehicle.effects
    assert new.deviations["effects.rotor_drag.k_xy_1_s"].numbers == (0.05,)
    off = update_text(replace(vehicle, effects={}), update_text(vehicle, text))
    assert same_calibration(parse_vehicle(off, "mine.toml").calibration, REPORTED)


def test_inline_tables_are_read_as_well() -> None:
    found = parse_vehicle(TEXT + SECTION, "mine.toml").calibration
    assert found is not None
    assert found.covariance == pytest.approx(np.array([[1e-4, 1e-4], [1e-4, 4e-4]]))
    assert (found.days, found.constants) == ({"cog_offset.x_m": 0.0004}, {"gyro_rate_x": 1.2})


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("thrust_scale.scale", "thrust_scale.scal", "no number 'thrust_scale.scal'. Did you mean"),
        ("cog_offset.x_m", "cog_ofset.x_m", "calibration.days: there is no number 'cog_ofset.x_m'"),
        ("mass_offset.mass_kg", "thrust_scale.scale", "numbers holds 'thrust_scale.scale' twice"),
        ("sd = [0.01, 0.02]", "sd = [0.01]", "calibration.sd must hold 2 numbers"),
        ("0.01,", "-0.01,", "sd of thrust_scale.scale = -0.01 must be positive"),
        ("0.01,", "nan,", "calibration.sd must hold 2 numbers"),
        ("0.0004", "nan", "calibration.days.cog_offset.x_m = nan must be a number"),
        ("1.2", "-1.2", "calibration.constants.gyro_rate_x = -1.2 must not be negative"),
        ("[0.5, 1.0]", "[0.5]", "correlation, row 2 must hold 2 numbers"),
        ("[0.5, 1.0]", "[nan, 1.0]", "correlation, row 2 must hold 2 numbers"),
        ("[0.5, 1.0]", "[0.5, 2.0]", "row 2 must end in 1, not 2"),
        ("[0.5, 1.0]", "[-1.5, 1.0]", "row 2 holds -1.5; a correlation lies between -1 and 1"),
        ("[[1.0], [0.5, 1.0]]", "[[1.0]]", "calibration.correlation must hold 2 rows"),
        ("flights =", "flight =", "there is no key 'flight'. Did you mean 'flights'"),
        ('["one"]', '"one"', "calibration.flights must be a list of names"),
    ],
)
def test_what_is_wrong_is_refused_with_the_way_out(old: str, new: str, says: str) -> None:
    assert SECTION.count(old) == 1
    with pytest.raises(ModelError, match=re.escape(says)) as refusal:
        parse_vehicle(TEXT + SECTION.replace(old, new), "mine.toml")
    assert str(refusal.value).startswith("mine.toml: ")
    assert re.search(r"uavtwin calibrate|Did you mean", str(refusal.value))


def test_three_numbers_that_cannot_go_together_are_refused() -> None:
    three = (
        SECTION.replace('"mass_offset.mass_kg"', '"mass_offset.mass_kg", "accel_bias.x_m_s2"')
        .replace("0.02]", "0.02, 0.03]")
        .replace("[0.5, 1.0]]", "[0.9, 1.0], [0.9, -0.9, 1.0]]")
    )
    with pytest.raises(ModelError, match=r"smallest eigenvalue is -0\.8"):
        parse_vehicle(TEXT + three, "mine.toml")


@pytest.mark.parametrize("effect", ["clock_offset", "pose_smoothing"])
def test_what_is_of_a_record_has_no_section(effect: str) -> None:
    assert not EFFECTS[effect].of_vehicle
    with pytest.raises(ModelError, match=rf"\[effects.{effect}\] is of a record, not of the"):
        parse_vehicle(f"{TEXT}\n[effects.{effect}]\n", "mine.toml")


@pytest.mark.parametrize("effect", CHANGES)
def test_every_number_that_may_change_has_a_size(effect: str) -> None:
    for p in (*EFFECTS[effect].parameters, *EFFECTS[effect].of_logs):
        for indoors in (True, False):
            assert CHANGES[effect].of(p.name, indoors).sd > 0
