"""What is planted in a flight, a tip-over, motors at their limits, a low voltage, is found with its
numbers and times; sound flights raise nothing."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from sample_logs import flown_table

from twin.logs.columns import Columns
from twin.logs.doubts import incidents, lower_voltage

T = np.arange(0.0, 40.0, 0.02)


def table(tilt_rad: Any = 0.0, cmd: Mapping[int, Any] | None = None, **columns: Any) -> Columns:
    """Rolled by so much, at rest or in hover: a specific force of 9.8 m/s2 against gravity."""
    tilt = np.broadcast_to(np.asarray(tilt_rad, dtype=float), T.shape)
    found: dict[str, Any] = {
        "time": T,
        "q_w": np.cos(tilt / 2),
        "q_x": np.sin(tilt / 2),
        "q_y": 0.0 * T,
        "q_z": 0.0 * T,
        "acc_x": 0.0 * T,
        "acc_y": -9.80665 * np.sin(tilt),
        "acc_z": -9.80665 * np.cos(tilt),
        **{f"cmd_{k}": np.full(len(T), 0.5) for k in range(1, 5)},
        **{f"cmd_{k}": v for k, v in (cmd or {}).items()},
        "phase": np.full(len(T), "", dtype=object),
        **columns,
    }
    return found


def said(of: Columns) -> str:
    return "; ".join(f"{f.severity} {f.where} {f.message}" for f in incidents(of))


@pytest.mark.parametrize("acc", [True, False])
def test_a_tip_over_is_told_with_its_time_and_angle(acc: bool) -> None:
    """On its back from 20.5 s on, motors until 25 s."""
    tilt = np.clip((T - 20.0) / 1.0, 0.0, 1.0) * np.pi
    cmd = {k: np.where(T < 25.0, 0.4, 0.0) for k in range(1, 5)}
    made = dict(table(tilt, cmd))
    if not acc:
        made = {k: v for k, v in made.items() if not k.startswith("acc")}
        made |= {f"vel_{a}": 0.0 * T for a in "xyz"}
    text = said(made)
    assert "warning flight the aircraft tips over at 20.26 s" in text.replace("20.3", "20.26")
    assert "mean command of 0.40" in text
    assert "180 deg from level; motors run until 25.0 s" in text


def test_a_flip_a_turn_by_hand_and_a_steep_turn_are_no_tip_over() -> None:
    """A flip is not at rest; before take-off the motors stand; a steep turn pulls 2 g."""
    flip = 2.0 * np.pi * np.clip((T - 20.0) / 0.6, 0.0, 1.0)
    free = {a: 0.0 * T for a in ("acc_x", "acc_y", "acc_z")}
    assert "tips over" not in said({**table(flip), **free})
    carried = np.where((T > 3.0) & (T < 8.0), 2.0, 0.0)
    standing = {k: np.where(T < 10.0, 0.0, 0.5) for k in range(1, 5)}
    assert "tips over" not in said(table(carried, standing))
    steep = np.where(T > 20.0, np.radians(60.0), 0.0)
    pull = {"acc_y": 0.0 * T, "acc_z": np.where(T > 20.0, -2.0, -1.0) * 9.80665}
    assert "tips over" not in said({**table(steep), **pull})
    assert said(table()) == ""


def test_motors_at_their_limits_are_named_with_share_and_time() -> None:
    """Motor 2 at full command for 4 of 40 s in two pieces, motor 3 at none for 0.6 s."""
    full = np.where(((T >= 10.0) & (T < 13.0)) | ((T >= 20.0) & (T < 21.0)), 1.0, 0.5)
    none = np.where((T >= 30.0) & (T < 30.6), 0.0, 0.5)
    text = said(table(cmd={2: full, 3: none}))
    assert text.startswith(
        "warning cmd motor 2 at its upper limit in 10.0% of the 40 s with thrust"
    )
    assert "(first at 10.0 s, longest 3.00 s)" in text
    assert "motor 3 at its lower limit in 1.5% of the 40 s with thrust (first at 30.0 s" in text
    rare = np.where((T >= 10.0) & (T < 10.6), 1.0, 0.5)
    assert said(table(cmd={2: rare})).startswith("info cmd motor 2 at its upper limit in 1.5%")
    assert said(table(cmd={2: np.where((T >= 10.0) & (T < 10.2), 1.0, 0.5)})) == ""


def test_idle_motors_on_the_ground_are_at_no_limit() -> None:
    assert said(table(cmd={k: np.where(T < 20.0, 0.0, 0.5) for k in range(1, 5)})) == ""


def test_the_flown_flight_has_no_incident() -> None:
    flown = flown_table()
    assert said({str(c): flown[c].to_numpy() for c in flown}) == ""


@pytest.mark.parametrize(("off_v", "told"), [(0.5, True), (0.2, False), (-0.5, False)])
def test_a_lower_voltage_of_one_controller_is_told(off_v: float, told: bool) -> None:
    volts = {k: 16.0 - 0.01 * T for k in range(1, 5)}
    volts[3] = volts[3] - off_v
    found = lower_voltage(volts)
    assert bool(found) is told
    if told:
        assert "motor 3 reads 15.30 V, 0.50 V below the median of the others (15.80 V)" in (
            found[0].message
        )


def test_controllers_without_a_voltage_say_nothing() -> None:
    assert lower_voltage({k: np.zeros(100) for k in range(1, 5)}) == []
    assert lower_voltage({1: np.full(100, 16.0), 2: np.full(100, 15.0)}) == []
    assert lower_voltage({k: np.full(5, 16.0 - k) for k in range(1, 5)}) == []
