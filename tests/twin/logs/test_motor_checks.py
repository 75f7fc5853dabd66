"""Order, signs and range of motors held against the motion: a sound flight is left alone, a planted
fault is named, and where a flight does not excite a channel nothing is said of it."""

from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter

from twin.logs import Finding, open_flight, read_flight
from twin.logs.agreement import signals
from twin.logs.motor_checks import doubt_motors, moments_of
from twin.vehicle.layouts import Layout, frame

Array = NDArray[np.float64]
Columns = dict[str, Array]
STEP_S, LAG_S = 0.01, 0.05
QUAD, HEXA, OCTO = "x", "hex x", "octo x"


def low_passed(values: Array, time_constant_s: float) -> Array:
    """First order, along the first axis."""
    a = np.exp(-STEP_S / time_constant_s)
    return np.asarray(lfilter([1.0 - a], [1.0, -a], values, axis=0))


@cache
def flown(kind: str = QUAD, seed: int = 0, roll: float = 1.0) -> tuple[Columns, Layout]:
    """Forty seconds of a body whose rotors follow with a lag, and whose thrust is their speed
    squared; commands of a mixer without coupling, gusts and noise on top."""
    layout = frame(kind)
    rng = np.random.default_rng(seed)
    n = 4000
    asked = low_passed(rng.standard_normal((n, 4)), 0.1) * (0.1 * roll, 0.1, 0.05, 0.1)
    allocation = moments_of(layout)
    cmd = 0.55 + asked[:, 3:] + asked[:, :3] @ allocation * 4 / layout.count
    speed = 800.0 * low_passed(cmd - 0.55, LAG_S) + 440.0
    thrust = speed**2 / 440.0**2 * 9.80665 / layout.count
    gust = low_passed(rng.standard_normal((n, 3)), 0.3)
    turning = (thrust @ allocation.T) * (8.0, 8.0, 1.5) + gust * (2.0, 2.0, 0.3)
    rates = np.cumsum(turning - turning.mean(axis=0), axis=0) * STEP_S
    table: Columns = {"time": np.linspace(0.0, STEP_S * (n - 1), n)}
    for k in range(layout.count):
        table[f"cmd_{k + 1}"] = cmd[:, k]
        table[f"rotor_{k + 1}"] = speed[:, k] + rng.standard_normal(n)
    for k, axis in enumerate("xyz"):
        table[f"gyro_{axis}"] = rates[:, k] + 0.01 * rng.standard_normal(n)
        table[f"acc_{axis}"] = 0.2 * rng.standard_normal(n)
    table["acc_z"] = table["acc_z"] - thrust.sum(axis=1)
    return table, layout


def doubts(table: Columns, layout: Layout | None) -> list[Finding]:
    return doubt_motors(table, signals(table), layout)


def relabelled(table: Columns, stem: str, order: tuple[int, ...]) -> Columns:
    """Column i holds what belongs to motor `order[i]`, counted from 0."""
    return {**table, **{f"{stem}_{i + 1}": table[f"{stem}_{k + 1}"] for i, k in enumerate(order)}}


def swapped(n: int, one: int, two: int) -> tuple[int, ...]:
    order = list(range(n))
    order[one], order[two] = two, one
    return tuple(order)


@pytest.mark.parametrize("kind", [QUAD, HEXA, OCTO, "+", "h", "betaflight x", "octo +"])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_sound_flight_is_left_alone(kind: str, seed: int) -> None:
    assert doubts(*flown(kind, seed)) == []


@pytest.mark.slow
@settings(max_examples=24)
@given(st.permutations(range(4)))
def test_any_order_of_a_quadrotors_outputs_is_named(order: list[int]) -> None:
    table, layout = flown()
    moved = [(i, k) for i, k in enumerate(order) if i != k]
    found = doubts(relabelled(table, "cmd", tuple(order)), layout)
    if not moved:
        assert found == []
        return
    about = {f.where: f for f in found}
    assert about["cmd"].severity == "error"
    for i, k in moved:
        assert f"cmd_{i + 1} drove rotor {k + 1}" in about["cmd"].message
        assert f"rotor_{k + 1} follows cmd_{i + 1}" in about["rotor"].message


@pytest.mark.slow
@settings(max_examples=12)
@given(st.permutations(range(6)))
def test_any_order_of_speeds_is_named(order: list[int]) -> None:
    table, layout = flown(HEXA)
    found = doubts(relabelled(table, "rotor", tuple(order)), layout)
    moved = [(i, k) for i, k in enumerate(order) if i != k]
    assert [f.where for f in found] == ["rotor"] * bool(moved)
    assert all(f"rotor_{i + 1} follows cmd_{k + 1}" in found[0].message for i, k in moved)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "blind_deg"), [(HEXA, 0.0), (OCTO, 50.0)])
def test_two_outputs_exchanged_of_many_are_noticed(kind: str, blind_deg: float) -> None:
    """Neighbours of an octorotor act so alike that gusts hide the difference."""
    table, layout = flown(kind)
    for one, two in combinations(range(layout.count), 2):
        cosine = float(layout.position[one, :2] @ layout.position[two, :2])
        if np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) < blind_deg:
            continue
        found = doubts(relabelled(table, "cmd", swapped(layout.count, one, two)), layout)
        assert "cmd" in {f.where for f in found}, (one, two)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [QUAD, HEXA, OCTO])
def test_signs_are_named(kind: str) -> None:
    table, layout = flown(kind)
    commands = [c for c in table if c.startswith("cmd_")]
    reversed_all = {**table, **{c: 1.0 - table[c] for c in commands}}
    said = " ".join(f.message for f in doubts(reversed_all, layout) if f.where == "cmd")
    assert "specific force falls as the commands rise" in said
    assert "every command were reversed" in said
    one = {**table, "cmd_2": 1.0 - table["cmd_2"]}
    assert "cmd_2 were reversed" in str(doubts(one, layout))
    for axis in "xyz":
        turned = {**table, f"gyro_{axis}": -table[f"gyro_{axis}"]}
        found = doubts(turned, layout)
        assert [f.severity for f in found] == ["error"], axis
    senses = Layout(layout.position, -layout.direction, False, 0.05, "CA_ROTOR0..3 of the log")
    found = doubts(table, senses)
    assert "senses of rotation were exchanged" in found[0].message
    assert "CA_ROTOR0..3 of the log" in found[0].message


def test_an_output_of_something_else_is_named() -> None:
    table, layout = flown()
    tilt = {**table, "cmd_3": 0.5 + 0.4 * np.sin(0.3 * table["time"])}
    found = " ".join(f.message for f in doubts(tilt, layout) if f.where == "cmd")
    assert "hardly changes in flight compared with the other motors: cmd_3" in found


@pytest.mark.parametrize(
    ("scale", "offset", "word"),
    [
        (0.12, 0.0, "in the median of the flight"),
        (0.3, 0.6, "% more"),
        (5.0, -2.3, "% more"),
    ],
)
def test_a_wrong_range_of_the_commands_is_told(scale: float, offset: float, word: str) -> None:
    """CAN values taken for a part of their range, pulses with other ends."""
    table, layout = flown()
    commands = [c for c in table if c.startswith("cmd_")]
    changed = {c: np.clip(scale * table[c] + offset, 0.0, 1.0) for c in commands}
    found = doubts({**table, **changed}, layout)
    assert any(word in f.message for f in found if f.where == "cmd"), found


def test_what_a_flight_does_not_excite_is_not_judged() -> None:
    """Hover in gusts: the commands do nothing. Where roll is not excited, pitch and yaw still place
    each rotor of this frame, and no other order is named."""
    table, layout = flown()
    rng = np.random.default_rng(3)
    still = {c: v for c, v in table.items() if not c.startswith("rotor_")}
    still |= {f"cmd_{k}": 0.55 + 1e-3 * rng.standard_normal(4000) for k in range(1, 5)}
    assert doubts(still, layout) == []
    table, layout = flown(QUAD, 0, 0.0)
    found = doubts(relabelled(table, "cmd", swapped(4, 0, 2)), layout)
    named = [f.message for f in found if "as if" in f.message]
    assert all("as if cmd_1 drove rotor 3, cmd_3 drove rotor 1" in m for m in named)


def test_without_a_layout_or_with_another_count_the_rest_is_judged() -> None:
    table, _ = flown()
    swap = relabelled(table, "rotor", swapped(4, 0, 2))
    for layout in (None, frame(HEXA)):
        assert [f.where for f in doubts(swap, layout)] == ["rotor"]
        assert doubts(relabelled(table, "cmd", (0, 1, 2, 3)), layout) == []


def test_misnumbered_speeds_are_left_out_of_the_flight(tmp_path: Path) -> None:
    table, _ = flown()
    path = tmp_path / "flight.parquet"
    pd.DataFrame(relabelled(table, "rotor", swapped(4, 0, 2))).to_parquet(path)
    flight = read_flight(path)
    assert not flight.has("rotor_1") and flight.has("cmd_1")
    (found,) = (f for f in flight.findings if f.where == "rotor")
    assert found.severity == "error" and found.message.startswith("left out: ")
    assert "rotor_1 follows cmd_3, rotor_3 follows cmd_1" in found.message


@pytest.mark.slow
@pytest.mark.parametrize("form", ["parquet", "csv", "left in its file"])
def test_motors_are_told_by_number_and_not_by_place(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table, _ = flown()
    names = list(table)[1:]
    orders = [names, names[::-1], sorted(names, key=lambda c: (c != "cmd_3", c))]
    if form == "left in its file":
        monkeypatch.setattr("twin.logs.table.HELD_CELLS", 0)

    def findings_of(columns: Columns, order: list[str]) -> list[tuple[str, str]]:
        frame_of = pd.DataFrame(columns)[["time", *order]]
        path = tmp_path / f"flight.{'csv' if form == 'csv' else 'parquet'}"
        frame_of.to_csv(path, index=False) if form == "csv" else frame_of.to_parquet(path)
        found = open_flight(path).findings
        return [(f.where, f.message) for f in found]

    assert [findings_of(table, order) for order in orders] == [[], [], []]
    exchanged = relabelled(table, "rotor", swapped(4, 0, 2))
    first, *others = [findings_of(exchanged, order) for order in orders]
    assert "rotor_1 follows cmd_3" in first[0][1] and others == [first, first]


# -- recorded flights -------------------------------------------------------------------------

LOGS = ("rflysimdt/*.ulg", "px4_negatives/*.ulg", "rflymad_sil/*.ulg", "quiver_pt1/*.BIN")
TABLES = ("nanobench/tables/*.parquet", "crazypad/tables_pitch_rebuilt/*.parquet")


def recorded(data_dir: Path) -> list[tuple[Path, Columns, Layout | None]]:
    """Flights with commands, and their layout: by the log, or of a Crazyflie."""
    found = []
    for path in sorted(p for pattern in (*LOGS, *TABLES) for p in data_dir.glob(pattern)):
        flight = read_flight(path)
        if flight.has("cmd_1"):
            own = flight.airframe.layout if flight.airframe else None
            layout = own or (frame("crazyflie x") if path.suffix == ".parquet" else None)
            found.append((path, dict(flight.columns), layout))
    return found


@pytest.mark.slow
def test_no_recorded_flight_is_doubted(data_dir: Path) -> None:
    """They chose the thresholds; two outputs exchanged are noticed in those that excite them."""
    noticed = 0
    for path, table, layout in recorded(data_dir):
        assert doubts(table, layout) == [], path.name
        if layout is not None and "gyro_x" in table:
            swap = doubts(relabelled(table, "cmd", swapped(4, 0, 2)), layout)
            noticed += any("cmd_1 drove rotor 3, cmd_3 drove rotor 1" in f.message for f in swap)
    assert noticed >= 15
