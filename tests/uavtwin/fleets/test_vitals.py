"""Numbers of a flight that tell how an aircraft does, of flights that hold known ones."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.fleet.flights import BATTERY, GYROSCOPE, OHM, OHM_PER_30_D, aircraft_of, flown
from twin.logs import Flight
from twin.logs.columns import GYRO, QUAT
from uavtwin.fleets.log_analysis import (
    aircraft_name,
    battery_resistance,
    date_of,
    file_stem,
    gyro_bias,
)


def made(**columns: np.ndarray) -> Flight:
    return Flight("made", pd.DataFrame(columns))


def test_a_resistance_is_found_under_a_falling_voltage() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    rng = np.random.default_rng(2)
    amps = 20 + 4 * np.sin(0.7 * t) + 3 * np.sin(2.3 * t)
    volts = 16.8 - 0.01 * t - 0.035 * amps + 0.005 * rng.standard_normal(len(t))
    assert battery_resistance(made(time=t, vbat_v=volts, ibat_a=amps)) == pytest.approx(
        0.035, rel=0.01
    )
    steady = made(time=t, vbat_v=volts, ibat_a=np.full(len(t), 20.0))
    assert battery_resistance(steady) is None  # a current that does not vary tells nothing
    assert battery_resistance(made(time=t, vbat_v=volts)) is None


@pytest.mark.slow
def test_a_bias_is_found_while_the_aircraft_turns() -> None:
    """About an axis that moves itself; the attitude is integrated in steps of a millisecond."""
    t = np.arange(0.0, 30.0, 0.001)
    omega = 0.8 * np.column_stack([np.sin(1.1 * t), np.sin(0.7 * t + 1), np.sin(0.5 * t + 2)])
    turned, q = Rotation.identity(), []
    for k, step in enumerate(0.001 * omega):
        if k % 20 == 0:
            q.append(turned.as_quat(scalar_first=True))
        turned = turned * Rotation.from_rotvec(step)
    bias = np.array([0.01, -0.004, 0.02])
    rows = slice(None, None, 20)
    columns = dict(zip(GYRO, (omega[rows] + bias).T, strict=True))
    columns |= dict(zip(QUAT, np.array(q).T, strict=True))
    found = gyro_bias(made(time=t[rows], **columns))
    assert found == pytest.approx(bias, abs=3e-4)
    assert gyro_bias(made(time=t[rows])) is None


@pytest.mark.slow
def test_made_flights_hold_what_is_planted_in_them(tmp_path: Path) -> None:
    aircraft = {a.name: a for a in aircraft_of(5)}
    worn = flown(aircraft[BATTERY], 60.0, 3, 10.0)
    told = battery_resistance(worn)
    assert told == pytest.approx(OHM + 2 * OHM_PER_30_D, rel=0.1)
    assert aircraft_name(worn) == "A01, made copter"
    assert date_of(worn) == pytest.approx(2026.25 + 60 / 365.25)
    fresh, biased = (gyro_bias(flown(aircraft[GYROSCOPE], d, 4, 10.0)) for d in (0.0, 60.0))
    assert fresh is not None
    assert biased is not None
    assert biased - fresh == pytest.approx([0, 0.012, 0], abs=1e-3)


def test_names_of_files_stay_in_their_folder() -> None:
    assert file_stem("0006, SYS_AUTOSTART 4011") == "0006_SYS_AUTOSTART_4011"
    assert file_stem("../../etc/passwd") == "etc_passwd"
    assert file_stem("..") == "aircraft"
