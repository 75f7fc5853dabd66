"""Why a flight went wrong: the frame of a flight, loss of control, what is a consequence."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from why_rig import sound

from twin.errors import LogError
from twin.logs import Flight
from twin.logs.columns import ACC, GYRO, QUAT
from twin.why.diagnose import FINDERS, diagnose, in_order
from twin.why.findings import Finder, Findings
from twin.why.flight import FlightFrame, moment_signs
from twin.why.records import Amount, Candidate, Event, NotVisible

G = 9.80665


def hover(seconds: float = 30.0, rate_hz: float = 100.0, lost_s: float | None = None) -> Flight:
    """A quad on its spot, that tumbles from `lost_s` on and hits the ground a second later."""
    rng = np.random.default_rng(1)
    t = np.arange(0, seconds, 1 / rate_hz)
    flies = (t > 3) & (t < seconds - 3)
    table = {"time": t} | {f"cmd_{i}": np.where(flies, 0.5, 0.0) for i in range(1, 5)}
    gyro, acc = 0.02 * rng.standard_normal((len(t), 3)), np.tile([0.0, 0.0, -G], (len(t), 1))
    angle = np.zeros(len(t))
    if lost_s is not None:
        after = (t > lost_s) & (t < lost_s + 1)
        gyro[after, 0] += 10 * (t[after] - lost_s)
        angle = np.cumsum(np.where(after, gyro[:, 0], 0.0)) / rate_hz
        acc[(t > lost_s + 1) & (t < lost_s + 1.1)] *= 8
    acc += 0.05 * rng.standard_normal(acc.shape)
    q = np.column_stack([np.cos(angle / 2), np.sin(angle / 2), 0 * t, 0 * t])
    table |= dict(zip(GYRO, gyro.T, strict=True)) | dict(zip(ACC, acc.T, strict=True))
    table |= dict(zip(QUAT, q.T, strict=True))
    return Flight("hover", pd.DataFrame(table))


def test_loss_of_control_and_crash_are_found_in_time() -> None:
    found = diagnose(hover(lost_s=20.0), finders=FINDERS[:1])
    assert found.loss_of_control_s == pytest.approx(20.45, abs=0.15)  # 4 rad/s after 0.4 s
    assert found.crash_s == pytest.approx(21.0, abs=0.1)
    assert [i.kind for i in found.timeline] == ["loss_of_control", "crash"]
    assert found.verdict == "cannot_tell"


def test_a_blow_after_which_it_flies_on_is_no_crash() -> None:
    begins_s = FlightFrame.of(hover(lost_s=23.0)).crash_begins_s
    assert begins_s == pytest.approx(23.45, abs=0.15)
    assert FlightFrame.of(hover(lost_s=20.0)).crash_begins_s is None


def test_a_hover_is_flown_to_its_end() -> None:
    found = diagnose(hover(), finders=FINDERS[:1])
    assert found.verdict == "nothing_found"
    assert found.loss_of_control_s is None and found.crash_s is None
    assert found.airborne_s == pytest.approx(24.0, abs=1.0)


@pytest.mark.parametrize(
    ("fact", "ours", "theirs"),
    [
        ("aircraft", "autopilot 0001", "autopilot 0002"),
        ("hardware", "PX4_FMU_V6C", "PX4_SITL"),
        ("airframe", "quad x", "SYS_AUTOSTART 3010"),
        ("firmware", "ArduCopter V4.5.7", "PX4 1.12.3"),
    ],
)
def test_a_normal_flight_of_another_aircraft_is_refused_and_both_are_named(
    fact: str, ours: str, theirs: str
) -> None:
    own, other = (replace(hover(), facts={fact: text}) for text in (ours, theirs))
    with pytest.raises(LogError, match="unusable reference") as refused:
        diagnose(own, [replace(other, name="stranger")])
    parts = (ours, theirs) if fact != "firmware" else ("ArduCopter", "PX4")
    assert all(text in str(refused.value) for text in ("stranger", "hover", *parts))


def test_a_normal_flight_with_more_rotors_is_refused() -> None:
    table = hover().table.copy()
    table["cmd_5"] = table["cmd_6"] = table["cmd_1"]
    with pytest.raises(LogError, match="number of rotors 6 instead of 4"):
        diagnose(hover(), [Flight("six", table)])


def test_a_newer_firmware_and_a_log_that_states_nothing_are_no_other_aircraft() -> None:
    releases = [replace(hover(), facts={"firmware": f"PX4 1.1{k}"}) for k in (4, 5)]
    found = diagnose(releases[0], [releases[1], hover()], finders=FINDERS[:1])
    assert found.verdict == "nothing_found"


def test_a_log_without_commands_says_first_that_it_cannot_tell() -> None:
    table = {name: v for name, v in sound().items() if not name.startswith("cmd_")}
    found = diagnose(Flight("f", pd.DataFrame(table)))
    assert found.verdict == "cannot_tell" and found.probability == pytest.approx(0.0, abs=0.2)
    assert found.text.startswith("Cannot tell: rotors, mass, forces are not judged")


def hidden(value: float | None, events: Sequence[Event] = ()) -> Finder:
    """Finds events, and that a rotor failure below a size would not show."""
    least = Amount(value=value, unit="1")
    unseen = NotVisible(cause="rotor_failure", smallest_detectable=least, reason="noise")
    return lambda frame, references: Findings(events=events, not_visible=[unseen])


def test_where_no_rotor_failure_would_show_the_log_cannot_tell() -> None:
    found = diagnose(hover(), finders=[hidden(None)])
    assert found.verdict == "cannot_tell" and found.probability == 0.0
    assert found.text == (
        "Cannot tell: rotor failure would not show, since noise. "
        "Nothing else went wrong that this log can show (more than 99 %)."
    )
    found = diagnose(hover(), finders=[hidden(0.3)])
    assert found.verdict == "nothing_found"
    assert found.text == "Nothing went wrong that this log can show (more than 99 %)."


@pytest.mark.parametrize(
    ("pairs", "verdict"),
    [
        ([(1, 2), (3, 4)], "found"),
        ([(1, 2), (3, 4), (1, 3)], "cannot_tell"),
        ([(1,)], "cannot_tell"),
    ],
)
def test_one_of_two_causes_is_an_answer_and_one_of_more_is_none(
    pairs: list[tuple[int, ...]], verdict: str
) -> None:
    share = 0.9 / max(len(pairs), 2)
    each = [Candidate(cause="rotor_efficiency_loss", rotor=p, probability=share) for p in pairs]
    found = diagnose(hover(), finders=[lambda *_: Findings(one_of_causes=each, nothing=0.1)])
    assert found.verdict == verdict and found.probability == pytest.approx(0.9)
    if len(pairs) == 2:
        assert found.text == (
            "Most probable: rotor efficiency loss of rotors 1 and 2 (45 %) or "
            "rotor efficiency loss of rotors 3 and 4 (45 %)."
        )


def test_a_cause_that_is_an_event_is_not_invisible() -> None:
    event = Event(cause="rotor_failure", rotor=(2,), onset_s=10.0, probability=0.9, text="Rotor 2")
    found = diagnose(hover(), finders=[hidden(None, [event])])
    assert found.verdict == "found" and not found.not_visible
    assert found.notes[-1] == "another rotor failure would not show: noise"
    assert diagnose(hover(), finders=[hidden(0.3, [event])]).not_visible


def test_the_grid_averages() -> None:
    flight = hover()
    frame = FlightFrame.of(flight)
    assert frame.dt_s == pytest.approx(0.02)
    first = flight.table.gyro_x[flight.table.time < frame.edges_s[1]].mean()
    assert frame.grid["gyro"][0, 0] == pytest.approx(first)


def test_a_short_log_is_refused() -> None:
    with pytest.raises(LogError, match=r"lasts less than 5 s \(3 s\).*Give a log"):
        diagnose(hover().between(0, 3))


def test_what_a_lost_rotor_explains_is_a_consequence() -> None:
    events = (
        Event(cause="attitude_estimate", onset_s=12.0, probability=0.9),
        Event(cause="rotor_failure", rotor=(2,), onset_s=10.0, probability=0.9, text="Rotor 2"),
        Event(cause="compass", onset_s=5.0, probability=0.9),
    )
    found = diagnose(hover(), finders=[lambda *_: Findings(events=events, nothing=0.1)])
    assert [e.cause for e in found.events] == ["compass", "rotor_failure", "attitude_estimate"]
    assert [e.consequence for e in found.events] == [False, False, True]
    assert found.verdict == "found"


@pytest.mark.parametrize(("bias_s", "first"), [(20.1, "accel_bias"), (24.0, "force_or_moment")])
def test_a_force_that_does_not_change_the_velocity_is_the_accelerometer(
    bias_s: float, first: str
) -> None:
    events = [
        Event(cause="force_or_moment", onset_s=20.0, probability=0.99, text="force"),
        Event(cause="accel_bias", sensor="acc_x", onset_s=bias_s, probability=0.8, text="bias"),
    ]
    assert [e.cause for e in in_order(events) if not e.consequence] == [first]


def test_a_cause_that_is_not_named_explains_nothing() -> None:
    """Both follow what is less probable than something else, which is not said."""
    events = (
        Event(cause="command_cut", onset_s=9.0, probability=0.4),
        Event(cause="rotor_failure", rotor=(2,), onset_s=10.0, probability=0.9, text="Rotor 2"),
        Event(cause="mass_change", onset_s=20.0, probability=0.4),
        Event(cause="gyro_bias", sensor="gyro_x", onset_s=27.0, probability=0.9),
    )
    found = diagnose(hover(), finders=[lambda *_: Findings(events=events, nothing=0.1)])
    assert [(e.cause, e.consequence) for e in found.events] == [
        ("rotor_failure", False),
        ("gyro_bias", False),
    ]
    assert found.text.startswith("Rotor 2")


@pytest.mark.parametrize("name", ["x", "+", "h", "crazyflie x", "betaflight x"])
def test_the_frame_is_found_by_how_the_body_turns(name: str) -> None:
    """Random commands turn the body by the signs of one usual frame; the log states none."""
    from twin.vehicle.layouts import frame

    rng = np.random.default_rng(2)
    flight = hover(60.0, 33.0)
    signs = moment_signs(frame(name))
    commands = 0.5 + 0.05 * rng.standard_normal((len(flight.table), 4))
    turning = np.cumsum((commands - 0.5) @ signs[1:].T, axis=0)
    table = flight.table.assign(**{f"cmd_{i + 1}": commands[:, i] for i in range(4)})
    table = table.assign(**dict(zip(GYRO, turning.T, strict=True)))
    found = FlightFrame.of(Flight("random", table)).layout
    assert found is not None
    assert np.array_equal(np.sign(moment_signs(found).round(3)), np.sign(signs.round(3)))
