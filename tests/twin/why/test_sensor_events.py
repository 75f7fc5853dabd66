"""Sensors and state estimate: faults put into a sound flight are named, and a sound one is not."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from why_rig import ONSET_S, RATE_HZ, Table, sound

from twin.frames import from_euler
from twin.logs import Flight
from twin.logs.autopilot import Autopilot, Reset, ResetOf
from twin.logs.columns import ACC, GYRO, MAG, POS, QUAT, VEL
from twin.why import disagreements
from twin.why.consistency import (
    FALSE_IN_10_H,
    FalseAlarmBudget,
    Residual,
    changed_at,
    smallest_detectable,
)
from twin.why.diagnose import diagnose
from twin.why.disagreements import SENSOR_CAUSES, within
from twin.why.flight import FlightFrame
from twin.why.records import Event
from twin.why.sensors import grouped, sensors
from twin.why.timeline import MOST_MESSAGES, timeline


def after(table: Table) -> np.ndarray:
    return np.asarray(table["time"] >= ONSET_S)


def found_in(table: Table) -> list[Event]:
    frame = FlightFrame.of(Flight("flight", pd.DataFrame(table)))
    return list(sensors(frame).events)


def _add(column: str, size: float, until_s: float = np.inf) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        table[column] = table[column] + size * (after(table) & (table["time"] < until_s))

    return change


def _gyro_scale(table: Table) -> None:
    table["gyro_x"] = table["gyro_x"] * np.where(after(table), 1.5, 1.0)


def _stuck(table: Table) -> None:
    table["acc_y"] = np.where(
        after(table), table["acc_y"][round(ONSET_S * RATE_HZ)], table["acc_y"]
    )


def _missing(table: Table) -> None:
    for column in MAG:
        table[column] = np.where(after(table), np.nan, table[column])


def _turned(table: Table, where: np.ndarray) -> None:
    turn = from_euler(0.0, 0.0, 0.9)
    w, x, y, z = (table[c] for c in QUAT)
    turned = [turn[0] * w - turn[3] * z, turn[0] * x - turn[3] * y, turn[0] * y + turn[3] * x]
    for column, value in zip(QUAT, [*turned, turn[0] * z + turn[3] * w], strict=True):
        table[column] = np.where(where, value, table[column])


def _yaw_reset(table: Table) -> None:
    _turned(table, after(table))


def _yaw_mended(table: Table) -> None:
    """A yaw that is wrong from the start, and is reset to the right one."""
    _turned(table, ~after(table))


def _shakes(table: Table) -> None:
    rng = np.random.default_rng(3)
    for column in ACC:
        table[column] = table[column] + 0.5 * rng.standard_normal(len(table["time"])) * after(table)


def _steel(table: Table) -> None:
    for column in MAG:
        table[column] = table[column] * np.where(after(table), 1.6, 1.0)


def _sag(table: Table) -> None:
    table["vbat_v"] = table["vbat_v"] * np.where(after(table), 0.8, 1.0)


FAULTS: dict[str, tuple[Callable[[Table], None], str, str | None, float]] = {
    "gyro bias": (_add("gyro_y", 0.08), "gyro_bias", "gyro_y", 0.08),
    "gyro scale": (_gyro_scale, "gyro_scale", "gyro_x", 1.0 / 3.0),
    "accelerometer bias": (_add("acc_x", 0.8), "accel_bias", "acc_x", 0.8),
    "barometer": (_add("baro_pa", -150.0), "baro_bias", "barometer", 12.5),
    "compass": (_steel, "mag_hard_iron", "compass", 0.6),
    "yaw reset": (_yaw_reset, "attitude_estimate", None, np.nan),
    "position jump": (_add("pos_x", 6.0), "position_estimate", None, np.nan),
    "velocity jump": (_add("vel_y", 4.0), "velocity_estimate", None, np.nan),
    "stuck": (_stuck, "stuck_sensor", "acc_y", np.nan),
    "missing": (_missing, "sensor_dropout", "compass", np.nan),
    "noise": (_shakes, "sensor_noise_level", "accelerometer", np.hypot(0.5, 0.03) / 0.03),
    "battery": (_sag, "battery_sag", "battery", -0.2),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_with_onset_and_size(fault: str) -> None:
    change, cause, sensor, size = FAULTS[fault]
    change(table := sound())
    events = [e for e in found_in(table) if not e.consequence]
    assert [(e.cause, e.sensor) for e in events] == [(cause, sensor)]
    (event,) = events
    assert event.onset_s == pytest.approx(ONSET_S, abs=0.3)
    assert event.probability > 0.5
    assert event.text and event.bench_check
    if np.isfinite(size) and event.severity is not None:
        assert event.severity.value == pytest.approx(size, rel=0.15)


@pytest.mark.parametrize("seed", range(4))
def test_a_sound_flight_is_silent_and_says_what_it_hides(seed: int) -> None:
    found = sensors(FlightFrame.of(Flight("sound", pd.DataFrame(sound(seed=seed)))))
    assert not found.events and found.nothing == 1.0
    hidden = {v.cause: v.smallest_detectable.value for v in found.not_visible}
    assert {"gyro_bias", "accel_bias", "baro_bias", "mag_hard_iron"} <= hidden.keys()
    assert hidden["gyro_bias"] is not None and 0.01 < hidden["gyro_bias"] < 0.05


def test_what_is_hidden_is_not_reported_and_twice_of_it_is() -> None:
    found = sensors(FlightFrame.of(Flight("sound", pd.DataFrame(sound()))))
    least = next(v for v in found.not_visible if v.cause == "gyro_bias").smallest_detectable.value
    assert least is not None
    for share, reported in ((0.4, False), (2.5, True)):
        _add("gyro_z", share * least)(table := sound())
        assert any(e.cause == "gyro_bias" for e in found_in(table)) == reported


def test_what_stays_off_is_told_where_one_mean_is_not_enough() -> None:
    """Motion may bring 0.02; 0.12 more for a second, for good, and of a level, which wanders."""
    rng, n = np.random.default_rng(1), 160
    calm = height_residual(rng, n, least=0.02)
    off = 0.12 * (np.arange(n) >= 100)
    passing = off * (np.arange(n) < 110)

    def told(scaled: str, change: np.ndarray) -> bool:
        difference = 0.005 * calm.difference + change
        r = replace(calm, scaled=scaled, difference=difference, error=np.full(n, 0.02))
        found = changed_at(r, FalseAlarmBudget(FALSE_IN_10_H, 10))
        return found is not None and found.onset_s == pytest.approx(10.0, abs=0.2)

    assert [told("gyro_scale", off), told("gyro_scale", passing), told("", off)] == [1, 0, 0]


def test_motion_that_has_brought_no_error_is_believed_to_bring_none() -> None:
    rng = np.random.default_rng(1)

    def least(bins: int, noise: float) -> float:
        r = height_residual(rng, bins, least=0.02)
        moved = replace(r, difference=noise * r.difference, error=np.full(bins, 0.1))
        return smallest_detectable(moved, FalseAlarmBudget(FALSE_IN_10_H, 10))

    assert least(3000, 0.01) < 0.25 * least(100, 0.01)
    assert least(3000, 1.0) > least(3000, 0.01)


def test_a_touch_of_the_ground_is_no_noise() -> None:
    """A jolt of a third of a second, and the same shaking for three seconds."""
    rng = np.random.default_rng(3)
    for long_s, named in ((0.3, False), (3.0, True)):
        table = sound()
        shaken = after(table) & (table["time"] < ONSET_S + long_s)
        for column in (*GYRO, *ACC):
            table[column] = table[column] + 2.0 * rng.standard_normal(len(shaken)) * shaken
        assert any(e.cause == "sensor_noise_level" for e in found_in(table)) == named


def test_a_size_that_nothing_can_have_is_no_threshold() -> None:
    """A compass that reads at random shows no change of heading, however large."""
    table, rng = sound(), np.random.default_rng(4)
    for column in MAG:
        table[column] = 1e-5 * rng.standard_normal(len(table["time"])).cumsum()
    hidden = sensors(FlightFrame.of(Flight("random", pd.DataFrame(table)))).not_visible
    least = next(v for v in hidden if v.cause == "mag_hard_iron").smallest_detectable
    assert least.value is None


def test_a_log_without_attitude_still_shows_a_frozen_reading() -> None:
    _stuck(table := sound())
    for column in (*QUAT, *VEL, *POS, *MAG, "baro_pa", *(f"cmd_{i}" for i in range(1, 5))):
        del table[column]
    assert [e.cause for e in found_in(table)] == ["stuck_sensor"]


def height_residual(rng: np.random.Generator, n: int, least: float) -> Residual:
    """White, of one deviation, every 0.1 s."""
    return Residual(
        lasting="baro_bias",
        passing="baro_disturbance",
        sensor="barometer",
        quantity="height",
        unit="m",
        t_s=np.asarray(0.1 * np.arange(n)),
        reading=np.zeros(n),
        difference=rng.standard_normal(n),
        error=np.zeros(n),
        window_s=1.0,
        least=least,
        usual=1.0,
        largest=100.0,
    )


def filled(columns: tuple[str, ...], value: float) -> Table:
    return sound() | {c: np.full(len(sound()["time"]), value) for c in columns}


@pytest.mark.parametrize(
    ("columns", "value", "named"),
    [
        (GYRO, 0.0, "gyroscope"),
        (GYRO, 0.02, "gyroscope"),
        (ACC, 0.0, "accelerometer"),
        (("acc_x",), 0.3, "acc_x"),
        (("baro_pa",), 101325.0, "barometer"),
    ],
)
def test_a_reading_that_never_changes_is_stuck(
    columns: tuple[str, ...], value: float, named: str
) -> None:
    events = [e for e in found_in(filled(columns, value)) if not e.consequence]
    assert [(e.cause, e.sensor) for e in events] == [("stuck_sensor", named)]
    assert events[0].onset_s == pytest.approx(1.0, abs=0.6) and events[0].probability > 0.99


@pytest.mark.parametrize("columns", [MAG, ("gyro_z",), ("baro_pa",)])
def test_what_is_not_measured_is_not_stuck(columns: tuple[str, ...]) -> None:
    assert not any(e.cause == "stuck_sensor" for e in found_in(filled(columns, 0.0)))


def test_a_body_that_does_not_turn_has_no_stuck_gyroscope() -> None:
    """A simulation without noise that climbs: attitude, field and rates stay what they are."""
    table = {k: v for k, v in filled((*GYRO, *MAG), 0.0).items() if k != "baro_pa"}
    table |= {c: np.full(len(table["time"]), float(c == "q_w")) for c in QUAT}
    assert not any(e.cause == "stuck_sensor" for e in found_in(table))


def test_more_false_alarms_allowed_bring_a_lower_bound() -> None:
    rng = np.random.default_rng(2)
    r = height_residual(rng, 400, least=0.1)
    bounds = [smallest_detectable(r, FalseAlarmBudget(f, 10)) for f in (0.1, FALSE_IN_10_H, 100.0)]
    assert bounds[0] > bounds[1] > bounds[2]
    assert changed_at(r, FalseAlarmBudget(FALSE_IN_10_H, 10)) is None


def test_by_chance_a_bound_is_exceeded_no_more_often_than_allowed() -> None:
    rng = np.random.default_rng(5)
    n, flights = 3000, 60  # of five minutes: 5 h
    allowed = 100.0
    hits = 0
    for _ in range(flights):
        r = height_residual(rng, n, least=0.01)
        hits += changed_at(r, FalseAlarmBudget(allowed, 1)) is not None
    assert hits <= allowed / 2


def test_what_begins_first_explains_what_follows() -> None:
    def event(cause: str, onset_s: float, probability: float = 0.9) -> Event:
        return Event(cause=cause, sensor=cause, onset_s=onset_s, probability=probability)

    marked = grouped(
        [
            event("gyro_bias", 10.0),
            event("stuck_sensor", 10.2),
            event("velocity_estimate", 19.0),
            event("baro_bias", 40.0),
        ]
    )
    causes = [e.cause for e in marked if not e.consequence]
    assert causes == ["stuck_sensor", "baro_bias"]
    assert {e.cause for e in marked if e.consequence} == {"gyro_bias", "velocity_estimate"}


def _made(maker: Callable[..., Iterator[Residual]]) -> list[Residual]:
    frame = FlightFrame.of(Flight("sound", pd.DataFrame(sound())))
    return list(maker(within(frame.flight, 1.0, 44.0)))


def _height_jump(table: Table) -> None:
    _add(POS[2], 6.0)(table)


def reset_at(table: Table, of: ResetOf, *times_s: float) -> Flight:
    """A flight whose autopilot reports resets."""
    autopilot = Autopilot(resets=tuple(Reset(of, t) for t in times_s))
    return Flight("flight", pd.DataFrame(table), autopilot=autopilot)


@pytest.mark.parametrize(
    ("step", "cause", "of", "late_s", "events"),
    [
        (_yaw_mended, "attitude_estimate", "yaw", 0.1, 0),
        (_yaw_mended, "attitude_estimate", "height", 0.1, 1),
        (_yaw_mended, "attitude_estimate", "yaw", 5.0, 1),
        (_height_jump, "position_estimate", "height", 0.0, 0),
        (_height_jump, "position_estimate", "yaw", 0.0, 1),
    ],
)
def test_a_reset_that_the_autopilot_reports_is_an_item_and_no_event(
    step: Callable[[Table], None], cause: str, of: ResetOf, late_s: float, events: int
) -> None:
    """Compass and barometer, held against the estimate that steps, are not blamed either."""
    step(table := sound())
    frame = FlightFrame.of(reset_at(table, of, ONSET_S + late_s))
    found = sensors(frame)
    assert [e.cause for e in found.events if not e.consequence] == [cause] * events
    assert events or (not found.events and found.nothing == 1.0)
    assert f"the estimator resets its {of}" in {i.text for i in timeline(frame).timeline}


def test_what_follows_a_reported_reset_is_no_consequence_of_nothing() -> None:
    _yaw_mended(table := sound())
    table["baro_pa"] = table["baro_pa"] - 150.0 * (table["time"] >= ONSET_S + 4.0)
    found = diagnose(reset_at(table, "yaw", ONSET_S), finders=(sensors,))
    assert [e.cause for e in found.events if not e.consequence] == ["baro_bias"]
    assert found.verdict == "found" and found.probability > 0.5
    assert found.events[0].onset_s == pytest.approx(ONSET_S + 4.0, abs=0.3)


def test_an_error_that_a_reset_ends_keeps_its_place() -> None:
    """The velocity runs away by 5 m/s2 for 1.5 s, and steps back."""
    table, led_s = sound(), 1.5
    away = (table["time"] - ONSET_S) * (after(table) & (table["time"] < ONSET_S + led_s))
    table["vel_z"] = table["vel_z"] + 5.0 * away
    frame = FlightFrame.of(reset_at(table, "velocity", ONSET_S + led_s))
    event, *rest = sensors(frame).events
    assert not event.consequence and all(e.consequence for e in rest)
    assert event.cause == "velocity_estimate"
    assert event.onset_s == pytest.approx(ONSET_S, abs=0.3)
    assert event.severity is not None
    assert abs(event.severity.value) == pytest.approx(5.0, rel=0.15)
    assert event.text.endswith(", then the estimator resets its velocity at 26.50 s")


def test_a_reset_hides_no_fault_that_begins_with_it() -> None:
    _yaw_mended(table := sound())
    _add("gyro_y", 0.08)(table)
    events = sensors(FlightFrame.of(reset_at(table, "yaw", ONSET_S))).events
    assert [(e.cause, e.sensor) for e in events] == [("gyro_bias", "gyro_y")]


def test_an_estimator_that_resets_all_the_time_hides_nothing_and_is_said_once() -> None:
    _yaw_mended(table := sound())
    frame = FlightFrame.of(reset_at(table, "yaw", *np.arange(5.0, 40.0, 0.01).tolist()))
    assert "attitude_estimate" in {e.cause for e in sensors(frame).events if not e.consequence}
    (item,) = [i for i in timeline(frame).timeline if "resets" in i.text]
    assert item.text == "the estimator resets its yaw 3500 times"
    assert (item.t_s, item.end_s) == pytest.approx((5.0, 39.99))


def test_resets_far_apart_are_items_and_not_endless() -> None:
    frame = FlightFrame.of(reset_at(sound(), "height", *np.arange(-3000.0, 45.0, 15.0).tolist()))
    items = [i for i in timeline(frame).timeline if "resets" in i.text]
    assert len(items) == MOST_MESSAGES and all(i.end_s is None for i in items)


def test_every_residual_is_asked_and_has_its_signals() -> None:
    makers = {
        name: f
        for name, f in vars(disagreements).items()
        if callable(f) and getattr(f, "__annotations__", {}).get("return") == Iterator[Residual]
    }
    for name, maker in makers.items():
        assert maker in disagreements.RESIDUALS, f"{name} is not in RESIDUALS"
        assert _made(maker), f"{name} finds no signal in a flight that has all"


def test_every_cause_of_a_residual_has_words() -> None:
    for maker in disagreements.RESIDUALS:
        for r in _made(maker):
            for cause in {r.lasting, r.passing, r.scaled} - {""}:
                assert cause in SENSOR_CAUSES, f"{cause} has no words"


def test_every_cause_fills_its_sentence() -> None:
    for about in SENSOR_CAUSES.values():
        text = about.text.format(sensor="gyro_x", size="1 rad/s", t="3.00")
        assert "{" not in text and about.bench_check.endswith(".")
