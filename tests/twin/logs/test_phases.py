"""Phases from landed state and velocity, against a flight whose every moment is known."""

import numpy as np

from twin.logs.autopilot import ground_spans, label_phases, motion_spans

T_S = np.arange(0.0, 20.0, 0.1)


def flown() -> np.ndarray:
    """Velocity NED: ground to 2 s, up to 4, still to 8, north to 12, still, down 15 to 17."""
    velocity = np.zeros((len(T_S), 3))
    velocity[(T_S >= 2) & (T_S < 4), 2] = -1.0
    velocity[(T_S >= 8) & (T_S < 12), 0] = 3.0
    velocity[(T_S >= 15) & (T_S < 17), 2] = 1.0
    return velocity


def test_a_flight_from_ground_to_ground() -> None:
    landed_t = np.array([0.0, 2.0, 17.0])
    ground = ground_spans(landed_t, np.array([True, False, True]))
    assert ground == [("ground", -np.inf, 2.0), ("ground", 17.0, np.inf)]
    phase = label_phases(T_S, motion_spans(T_S, flown(), ground))
    edges = {"ground": 0.0, "takeoff": 2.0, "hover": 4.0, "forward": 8.0, "land": 15.0}
    for name, start in edges.items():
        assert T_S[phase == name].min() == start, name
    assert T_S[phase == "takeoff"].max() < 4.0 and T_S[phase == "forward"].max() < 12.0
    assert set(phase[(T_S >= 12) & (T_S < 15)]) == {"hover"}
    assert set(phase[T_S >= 17]) == {"ground"}


def test_climbing_in_the_air_is_no_takeoff() -> None:
    velocity = flown()
    velocity[(T_S >= 12.0) & (T_S < 13.5), 2] = -1.0
    ground = ground_spans(np.array([0.0, 2.0, 17.0]), np.array([True, False, True]))
    phase = label_phases(T_S, motion_spans(T_S, velocity, ground))
    assert set(phase[(T_S >= 12) & (T_S < 15)]) == {"hover"}


def test_without_a_land_detector_nothing_is_said() -> None:
    assert motion_spans(T_S, flown(), []) == []
    assert set(label_phases(T_S, [])) == {""}


def test_half_a_second_without_velocity_has_no_phase() -> None:
    velocity = flown()
    velocity[(T_S >= 10.0) & (T_S < 10.5)] = np.nan
    ground = ground_spans(np.array([0.0, 2.0, 17.0]), np.array([True, False, True]))
    phase = label_phases(T_S, motion_spans(T_S, velocity, ground))
    assert set(phase[(T_S >= 10.0) & (T_S < 10.5)]) == {""}


def test_later_spans_win() -> None:
    spans = [("hover", 0.0, 5.0), ("tour", 2.0, 3.0)]
    assert list(label_phases(np.array([-1.0, 0.0, 2.0, 3.0, 5.0]), spans)) == [
        "",
        "hover",
        "tour",
        "hover",
        "",
    ]
