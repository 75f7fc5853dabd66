"""What a PX4 log says of its aircraft, from logs made from nothing."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sample_logs import MOVING_S, moving_topics, ulog

from twin.logs.airframe import Airframe, Cells, SourcedValue
from twin.logs.formats import ReadOptions
from twin.logs.px4.control import Mixer, frame_of_mixer, mix, mixer_scale
from twin.logs.px4.ulog import read_ulog
from twin.vehicle.layouts import frame

QUAD = {
    "CA_ROTOR_COUNT": 4,
    **{f"CA_ROTOR{k}_PX": x for k, x in enumerate((0.1, -0.1, 0.1, -0.1))},
    **{f"CA_ROTOR{k}_PY": y for k, y in enumerate((0.14, -0.12, -0.14, 0.12))},
    **{f"CA_ROTOR{k}_KM": m for k, m in enumerate((0.05, 0.05, -0.05, -0.05))},
}


def airframe(params: dict[str, float], extra: dict[str, Any] | None = None) -> Airframe:
    topics = {**moving_topics(), **(extra or {})}
    found = read_ulog(Path("made.ulg"), ulog(topics, params), ReadOptions()).airframe
    assert found is not None
    return found


def test_rotors_are_where_the_allocation_has_them() -> None:
    told = airframe(QUAD)
    assert told.layout is not None
    assert told.layout.metric
    assert told.layout.position[0] == pytest.approx((0.1, 0.14, 0.0))
    assert told.layout.direction.tolist() == [-1, -1, 1, 1]  # positive KM: counter-clockwise
    assert told.layout.arm == pytest.approx(np.hypot(0.1, 0.14))
    assert told.rotors == SourcedValue(4, "CA_ROTOR_COUNT of the log")


@pytest.mark.parametrize("size", [0.15, 1.0])
def test_coordinates_of_the_generic_aircraft_are_no_sizes(size: float) -> None:
    places = {k: float(np.copysign(size, v)) for k, v in QUAD.items() if "_P" in k}
    told = airframe({**QUAD, **places})
    assert told.layout is not None
    assert not told.layout.metric


@pytest.mark.parametrize(
    ("autostart", "kind", "first"),
    [(4250, 2, (0.707107, 0.707107)), (5001, 2, (0.0, 1.0)), (6001, 13, (0.0, 1.0))],
)
def test_the_airframe_that_was_chosen_tells_the_order(
    autostart: int, kind: int, first: tuple[float, float]
) -> None:
    told = airframe({"SYS_AUTOSTART": autostart, "MAV_TYPE": kind})
    assert told.layout is not None
    assert tuple(told.layout.position[0, :2]) == first
    assert f"SYS_AUTOSTART {autostart}" in told.layout.source
    assert not told.layout.metric


@pytest.mark.parametrize(
    ("params", "word"),
    [({"MAV_TYPE": 1}, "fixed-wing"), ({"CA_AIRFRAME": 2}, "VTOL"), ({"MAV_TYPE": 10}, "rover")],
)
def test_what_is_no_multirotor_says_why(params: dict[str, float], word: str) -> None:
    assert word in airframe(params).no_multirotor
    assert airframe({"MAV_TYPE": 2}).no_multirotor == ""


def test_numbers_of_the_parameters() -> None:
    told = airframe(
        {
            "THR_MDL_FAC": 0.3,
            "EKF2_IMU_POS_X": 0.02,
            "IMU_GYRO_CUTOFF": 60.0,
            "BAT1_N_CELLS": 4,
            "BAT1_V_CHARGED": 4.05,
            "BAT1_V_EMPTY": 3.5,
            "BAT1_CAPACITY": 5000.0,
            "BAT1_R_INTERNAL": 0.02,
        }
    )
    assert told.thrust is not None
    assert told.thrust.value.factor == pytest.approx(0.3)
    assert told.imu_position_m is not None
    assert told.imu_position_m.value == pytest.approx((0.02, 0.0, 0.0))
    assert told.cells is not None
    assert told.cells.value == Cells(
        4,
        *(pytest.approx(v) for v in (4.05, 3.5, 18000.0, 0.02)),  # type: ignore[arg-type]
    )
    # the samples of sensor_combined have not gone through the low-pass
    assert told.gyro_cutoff_hz is None
    assert "gyroscope 60 Hz" in told.filters


def test_filtered_samples_have_the_cutoff() -> None:
    topics = moving_topics()
    topics["vehicle_angular_velocity"] = {
        "t": MOVING_S,
        "xyz": topics.pop("sensor_combined")["gyro_rad"],
    }
    log = ulog(topics, {"IMU_GYRO_CUTOFF": 60.0})
    told = read_ulog(Path("made.ulg"), log, ReadOptions()).airframe
    assert told is not None
    assert told.gyro_cutoff_hz == SourcedValue(60.0, "IMU_GYRO_CUTOFF of the log")
    assert told.filters == ""


def test_defaults_of_px4_say_nothing() -> None:
    told = airframe({"THR_MDL_FAC": 0.0, "EKF2_IMU_POS_X": 0.0, "BAT1_N_CELLS": 0})
    assert told.thrust is None
    assert told.imu_position_m is None
    assert told.cells is None
    assert told.layout is None


@pytest.mark.parametrize("mixer", ["quad_x", "quad_wide", "quad_plus"])
@pytest.mark.parametrize("lively", [0.1, 0.0])
def test_the_mixer_of_an_unknown_airframe_is_told_by_its_outputs(mixer: str, lively: float) -> None:
    """Controls of a hover alone, which all mixers turn into the same outputs, tell nothing."""
    t = MOVING_S[::20]
    control = np.zeros((len(t), 8))
    control[:, :3] = lively * np.sin(np.outer(t, (3.0, 4.0, 5.0)))
    control[:, 3] = 0.5
    width = np.full((len(t), 16), 900.0)
    width[:, :4] = 1000 + 1000 * mix(control[:, :4], Mixer(mixer_scale(mixer), 0, 0.0))
    topics = moving_topics()
    del topics["actuator_motors"]
    topics["actuator_controls_0"] = {"t": t, "control": control.astype(np.float32)}
    topics["actuator_outputs"] = {
        "t": t,
        "output": np.floor(width).astype(np.float32),
        "noutputs": np.full(len(t), 4, dtype=np.uint32),
    }
    log = ulog(topics, {"SYS_AUTOSTART": 3010, "MAV_TYPE": 2}, release=(1, 12, 0))
    told = read_ulog(Path("made.ulg"), log, ReadOptions()).airframe
    assert told is not None
    if not lively:
        assert told.layout is None
        return
    assert told.layout is not None
    assert told.layout.source.startswith(f"mixer {mixer} by logged controls")
    assert tuple(told.layout.position[0]) == tuple(frame(frame_of_mixer(mixer)).position[0])


def test_the_place_is_the_median_of_the_fixes() -> None:
    t = MOVING_S[::250]
    fixes = {
        "t": t,
        "fix_type": np.array([0] + [3] * (len(t) - 1), dtype=np.uint8),
        "lat": np.array([0] + [481234567] * (len(t) - 1), dtype=np.int32),
        "lon": np.array([0] + [-115000000] * (len(t) - 1), dtype=np.int32),
        "alt_ellipsoid": np.full(len(t), 512_000, dtype=np.int32),
        "time_utc_usec": np.full(len(t), 1_751_500_800_000_000, dtype=np.uint64),
    }
    told = airframe({}, {"vehicle_gps_position": fixes})
    assert told.place is not None
    place = told.place.value
    assert np.degrees([place.latitude_rad, place.longitude_rad]) == pytest.approx(
        (48.1234567, -11.5)
    )
    assert place.height_m == pytest.approx(512.0)
    assert place.year == pytest.approx(2025.5, abs=0.01)
    assert (
        airframe({}, {"vehicle_gps_position": {**fixes, "fix_type": fixes["fix_type"] * 0}}).place
        is None
    )


def test_facts_of_several_logs_are_put_together() -> None:
    one, two = Airframe(filters="a"), Airframe(filters="b", rotors=SourcedValue(6, "two"))
    assert Airframe.together([one, two]) == Airframe(filters="a", rotors=SourcedValue(6, "two"))
    assert Airframe.together([]) == Airframe()


@pytest.mark.parametrize(
    "params",
    [
        {"CA_ROTOR_COUNT": 2_000_000_000},
        {**QUAD, "CA_ROTOR0_PX": 1e38},
        {**QUAD, "CA_ROTOR0_KM": 0.0},
        {"SYS_AUTOSTART": -2_147_483_648, "MAV_TYPE": -5},
        {"BAT1_N_CELLS": 2_000_000_000, "BAT1_V_CHARGED": 4.2, "BAT1_V_EMPTY": 3.5},
        {"THR_MDL_FAC": -1e38},
    ],
)
def test_absurd_parameters_tell_nothing(params: dict[str, float]) -> None:
    told = airframe(params)
    assert told.layout is None or not told.layout.metric
    assert told.cells is None
    assert told.thrust is None


def test_the_origin_of_positions_unless_it_moves() -> None:
    """From when the estimator has one; a kilometre further north at the end."""
    t = MOVING_S[::5]
    n = len(t)
    known = np.arange(n) > 3
    local = {
        "t": t,
        **{k: np.zeros(n, dtype=np.float32) for k in ("x", "y", "z", "vx", "vy", "vz")},
        "ref_lat": np.where(known, 47.3977, np.nan),
        "ref_lon": np.where(known, 8.5456, np.nan),
        "ref_alt": np.where(known, 488.0, np.nan).astype(np.float32),
        "xy_global": known.astype(np.uint8),
    }
    told = airframe({}, {"vehicle_local_position": local}).origin
    assert told is not None and told.source == "vehicle_local_position of the log"
    origin = told.value
    assert np.degrees([origin.latitude_rad, origin.longitude_rad]) == pytest.approx(
        (47.3977, 8.5456)
    )
    assert origin.height_m == 488.0
    moved = local | {"ref_lat": local["ref_lat"] + 0.01 * (np.arange(n) > 0.8 * n)}
    never = local | {"xy_global": np.zeros(n, dtype=np.uint8)}
    for other in (moved, never):
        assert airframe({}, {"vehicle_local_position": other}).origin is None
