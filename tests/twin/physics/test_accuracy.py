"""What a driven twin says of how far it may be off: regimes, bands, and where they hold."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.component import Run
from twin.errors import ModelError
from twin.physics.accuracy import PERIOD_S, SEEN, Bands, accuracy, nowhere_valid
from twin.vehicle_file import load_vehicle

VEHICLE = load_vehicle("copter_default")
HORIZONS_S = (0.05, 0.2, 1.0)
CALM, LIVELY = (0.1, 0.4, 2.0), (0.3, 1.2, 6.0)
KNOWN = Bands(HORIZONS_S, (10.0, 2.0, 0.5, 0.6), 0.5, {"position": (CALM, LIVELY)})
Given = dict[str, float]
THRUST_N = VEHICLE.mass_kg * VEHICLE.gravity_m_s2 / 4
HOVER = {f"thrust_{i}": THRUST_N for i in range(1, 5)}


def flown(steps: Sequence[Given], bands: Bands | None = KNOWN, **parameters: float) -> list[Given]:
    """Outputs after each `PERIOD_S`, of inputs that stay as they are until they change."""
    part = accuracy(VEHICLE, bands)
    p = part.parameter_values(parameters)
    given = {"alone": 0.0} | HOVER | steps[0]
    u: NDArray[np.float64] = part.input_values(given)
    run, rows = Run(part, u, p), []
    for k, changed in enumerate(steps):
        given |= {"alone": given["alone"] + PERIOD_S} | changed
        u = part.input_values(given)
        run.step(k * PERIOD_S, PERIOD_S, u)
        rows.append(dict(zip(part.output_names, run.outputs(u).tolist(), strict=True)))
    return rows


def alone(seconds: float, **first: float) -> list[Given]:
    """Inputs from a restart on."""
    return [{"alone": 0.0, **first}, *[{}] * round(seconds / PERIOD_S)]


def test_a_band_goes_in_straight_lines_from_time_to_time() -> None:
    rows = flown(alone(1.0, vel_x=1.0))
    band = [row["error_95.position"] for row in rows]
    t = PERIOD_S * np.arange(len(rows))
    assert band == pytest.approx(np.interp(t, HORIZONS_S, CALM), abs=1e-9)
    assert all(row["valid"] for row in rows)


@pytest.mark.parametrize(
    "lively",
    [{"vel_y": 7.0}, {"omega_z": -1.4}, {"thrust_1": 2.2 * THRUST_N}, {"pos_z": -VEHICLE.arm_m}],
)
def test_each_quantity_alone_makes_it_lively_until_the_motion_is_given(lively: Given) -> None:
    calm = {"vel_y": 0.0, "omega_z": 0.0, "thrust_1": THRUST_N, "pos_z": -100.0}
    first, after, again = (
        r["error_95.position"]
        for r in (
            flown(alone(0.2, **calm))[-1],
            flown([*alone(0.1, **calm), {**calm, **lively}, *[calm] * 9])[-1],
            flown([*alone(0.1, **calm), {**calm, **lively}, *alone(0.2, **calm)])[-1],
        )
    )
    assert after == pytest.approx(LIVELY[1])
    assert first == again == pytest.approx(CALM[1])


def test_it_holds_inside_the_envelope_and_up_to_the_longest_time() -> None:
    assert not flown(alone(0.1, vel_x=10.01))[-1]["valid"]
    left = flown([*alone(0.1), {"vel_x": 10.01}, *[{"vel_x": 0.0}] * 5, *alone(0.1, vel_x=0.0)])
    valid = [bool(row["valid"]) for row in left]
    assert valid == [True] * 11 + [False] * 6 + [True] * 11
    assert left[12]["envelope"] == pytest.approx(1.001)
    late = flown(alone(1.05))
    assert [bool(r["valid"]) for r in late[99:104]] == [True, True, False, False, False]


def test_another_twin_than_the_compared_is_nowhere_valid() -> None:
    assert not any(row["valid"] for row in flown(alone(0.2), known=0.0))
    part = nowhere_valid(VEHICLE)
    assert part.output_names == ("valid",)
    assert not np.asarray(part.outputs([], [], [])).any()


def test_wind_counts_as_airspeed() -> None:
    (row,) = flown(alone(0.0, vel_x=3.0, wind_x=-1.0), None)
    assert row["seen.airspeed"] == pytest.approx(4.0)
    assert tuple(row) == tuple(f"seen.{name}" for name, *_ in SEEN)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"horizons_s": (0.2, 0.1)}, "rising"),
        ({"limits": (1.0, 0.0, 1.0, 1.0)}, "above 0"),
        ({"bands": {"position": (CALM, LIVELY[:2])}}, "rows of 3 numbers"),
        ({"bands": {"fame": (CALM, LIVELY)}}, "fame"),
    ],
)
def test_bands_that_are_none_are_refused(wrong: dict[str, object], said: str) -> None:
    whole = {"horizons_s": HORIZONS_S, "limits": (1.0,) * 4, "calm": 0.5, "bands": {}}
    with pytest.raises(ModelError, match=said):
        Bands(**{**whole, **wrong})  # type: ignore[arg-type]
