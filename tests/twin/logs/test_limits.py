"""A reading that no sensor gives is named with the unit in which one would, and never changed."""

import numpy as np
import pytest

from twin.logs.columns import READINGS, beyond_message, other_unit
from twin.logs.doubts import doubts


@pytest.mark.parametrize(
    ("signal", "reading", "text"),
    [
        ("vbat_v", 1640.0, "in hundredths of a volt it would be 16.4 V: another unit?"),
        ("vbat_v", 164.0, "in tenths of a volt it would be 16.4 V: another unit?"),
        ("vbat_v", 16400.0, "in mV it would be 16.4 V"),
        ("ibat_a", 2030.0, "in hundredths of an ampere it would be 20.3 A"),
        ("baro", 1013.25, "in hPa it would be 1.013e+05 Pa"),
        ("mag", 0.48, "in gauss it would be 4.8e-05 T"),
        ("mag", 480.0, "in mgauss it would be 4.8e-05 T"),
        ("mag", 48.0, "in uT it would be 4.8e-05 T"),
        ("acc", 1000.0, "in mg it would be 9.807 m/s^2"),
        ("acc", 1.0, "in g it would be 9.807 m/s^2"),
    ],
)
def test_the_other_unit_is_named(signal: str, reading: float, text: str) -> None:
    assert text in other_unit(signal, reading)


@pytest.mark.parametrize("signal", READINGS)
def test_what_a_sensor_reads_is_left_alone(signal: str) -> None:
    _, low, high, _ = READINGS[signal]
    for reading in np.geomspace(low, high, 7):
        assert other_unit(signal, float(np.clip(reading, low, high))) == ""


def test_what_no_unit_explains_is_damage() -> None:
    assert other_unit("vbat_v", 1e9) == ""
    assert "damaged" in beyond_message("vbat_v", np.full((3, 1), 1e9))
    assert "in hundredths of a volt it would be 16.4 V" in beyond_message(
        "vbat_v", np.full((3, 1), 1640.0)
    )
    assert other_unit("pos", 1e9) == ""


@pytest.mark.parametrize(("column", "value"), [("vbat_v", 164.0), ("ibat_a", 2030.0)])
def test_a_table_in_another_unit_is_an_error_and_is_not_changed(column: str, value: float) -> None:
    t = np.arange(0.0, 10.0, 0.1)
    values = np.full(len(t), value)
    table = {"time": t, column: values, "phase": np.full(len(t), "", dtype=object)}
    (found,) = [f for f in doubts(table) if f.where == column]
    assert found.severity == "error" and "another unit?" in found.message
    assert (values == value).all()
