"""Site of a draft: the pressure of the barometer belongs to the height at which it was read."""

import numpy as np
import pandas as pd
import pytest
from rig import Rig, plain

from twin.draft.draft import pressure_at_origin
from twin.logs import Flight
from twin.physics.sensors.barometer import barometer

T = np.arange(0.0, 10.0, 0.02)


def flight(**columns: object) -> Flight:
    return Flight("made", pd.DataFrame({"time": T, **columns, "phase": ""}))


def read_at(down_m: float, ground_pa: float) -> float:
    """Reading of the twin's barometer without noise."""
    rig = Rig(barometer(plain()), {"ground_pressure": ground_pa})
    return rig.outputs(rig.state(), rig.inputs({"pos_z": down_m}))["baro_pa"]


@pytest.mark.parametrize("start_m", [-15.0, 0.0, 8.0, -400.0])
def test_a_reading_is_reduced_to_the_origin(start_m: float) -> None:
    """178 Pa at 15 m: it was named as a bias of the barometer."""
    found, where = pressure_at_origin(flight(baro_pa=read_at(start_m, 98_000.0), pos_z=start_m))
    assert found == pytest.approx(98_000.0, abs=0.01)
    assert f"{0.0 - start_m:.1f} m above" in where


def test_readings_before_the_height_is_known_are_not_used() -> None:
    down = np.where(T < 4.0, np.nan, -20.0)
    baro = np.where(T < 4.0, 90_000.0, read_at(-20.0, 98_000.0))
    found, _ = pressure_at_origin(flight(baro_pa=baro, pos_z=down))
    assert found == pytest.approx(98_000.0, abs=0.01)


def test_without_a_height_the_source_says_so() -> None:
    found, where = pressure_at_origin(flight(baro_pa=97_000.0))
    assert found == 97_000.0
    assert "height is not known" in where
