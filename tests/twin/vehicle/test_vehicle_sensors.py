"""Sensors and site of a vehicle file."""

from importlib import resources

import numpy as np
import pytest

from twin.errors import ModelError
from twin.vehicle import Vehicle
from twin.vehicle.earth import world_field
from twin.vehicle.vehicle import EARTH_FIELD_N_T, Sensors
from twin.vehicle_file import load_vehicle, parse_vehicle

BASE = (resources.files("twin.vehicle") / "built_in" / "feisi_x150.toml").read_text("utf-8")


def vehicle(**sections: str) -> Vehicle:
    """The Feisi X150 with more sections: `key = value unit` pairs, separated by semicolons."""
    text = BASE
    for section, entries in sections.items():
        text += f"\n[{section}]\n"
        for entry in entries.split(";"):
            key, value, unit = entry.split()
            text += f'{key} = {{ value = {value}, unit = "{unit}", source = "made up" }}\n'
    return parse_vehicle(text, "test.toml")


def test_without_a_word_sensors_are_ideal_and_the_site_is_a_standard_one() -> None:
    assert load_vehicle("feisi_x150").sensors == Sensors()
    sources = load_vehicle("feisi_x150").sources
    assert sources["imu.accel_noise"] == "default: no noise"
    assert sources["site.pressure"] == "default: 101325 Pa"
    assert Sensors().field_n_t == EARTH_FIELD_N_T


def test_numbers_arrive_in_si() -> None:
    s = vehicle(
        imu="accel_noise 30 mm/s^2; gyro_walk 0.1 deg/s",
        magnetometer="noise 0.5 uT; field [20,1,45] uT",
        barometer="noise 0.02 hPa; walk 1 Pa",
        position="period 50 ms; noise [1,1,2] cm; attitude_noise 1 deg",
        site="pressure 950 hPa; temperature 280 K",
    ).sensors
    assert (s.accel_noise_m_s2, s.gyro_walk_rad_s) == pytest.approx((0.03, np.radians(0.1)))
    assert (s.mag_noise_t, s.baro_noise_pa, s.baro_walk_pa) == pytest.approx((5e-7, 2.0, 1.0))
    assert s.field_n_t == pytest.approx((2e-5, 1e-6, 4.5e-5))
    assert (s.pressure_pa, s.temperature_k) == (95e3, 280.0)
    assert s.position == {
        "period_s": pytest.approx(0.05),
        "noise_m": pytest.approx((0.01, 0.01, 0.02)),
        "attitude_noise_rad": pytest.approx(np.radians(1)),
    }


def test_the_field_of_a_place() -> None:
    found = vehicle(site="latitude 47.4 deg; longitude 8.5 deg; height 500 m; year 2023.5 1")
    expected = world_field(np.radians(47.4), np.radians(8.5), 500.0, 2023.5)
    assert found.sensors.field_n_t == pytest.approx(expected)
    assert found.sources["magnetometer.field"] == "World Magnetic Model at the site"
    near = vehicle(site="latitude 47.4 deg; longitude 8.5 deg").sensors.field_n_t
    assert near == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("sections", "text"),
    [
        ({"site": "latitude 47 deg"}, "without longitude"),
        ({"site": "latitude 120 deg; longitude 8 deg"}, "beyond a pole"),
        ({"site": "latitude 47 deg; longitude 8 deg; year 1950 1"}, "site.year.*1950"),
        ({"site": "temperature 20 degC"}, "not a unit of the kind"),
        ({"site": "temperature 20 K"}, "must be from 180 to 340 K"),
        ({"site": "latitude 47 deg; longitude 8 deg", "magnetometer": "field [2,0,4] T"}, "no use"),
        ({"barometer": "noise -1 Pa"}, "zero or positive"),
        ({"position": "period 0 s"}, "positive"),
    ],
)
def test_refusals(sections: dict[str, str], text: str) -> None:
    with pytest.raises(ModelError, match=text):
        vehicle(**sections)
