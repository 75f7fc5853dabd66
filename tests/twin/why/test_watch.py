"""`why` on the stream: what is planted in a flight is said while it goes on, as of the log."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from why_rig import ONSET_S, sound

from benchmarks.sudden_faults.built_in import Planted
from twin.logs import Flight
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from twin.why.diagnose import diagnose
from twin.why.records import Event
from twin.why.watch import PERIOD_S, Alarm, Case, Watch
from uavtwin.demo.in_flight import damaged_flight


def watched(flight: Flight, vehicle: Vehicle | None = None) -> tuple[list[Alarm], Watch]:
    """All that is said of a flight, look by look."""
    watch = Watch(vehicle)
    said: list[Alarm] = []
    t, columns, first = flight.time_s, flight.columns, 0
    for end in np.searchsorted(t, np.arange(t[0] + PERIOD_S, t[-1] + PERIOD_S, PERIOD_S)):
        watch.push({c: v[first:end] for c, v in columns.items()})
        said += watch.evaluate()
        first = int(end)
    return said, watch


@pytest.mark.slow
@pytest.mark.parametrize(("size", "seed", "rate_hz"), [(0.3, 3, 200.0), (1.0, 1, 10.0)])
def test_the_first_alarm_is_the_first_event_of_the_log(
    size: float, seed: int, rate_hz: float
) -> None:
    planted = Planted("rotor_failure", size, seed, rate_hz)
    flight, begins_s, rotor = planted.flown()
    said, _ = watched(flight, planted.vehicle)
    first, event = said[0], diagnose(flight).events[0]
    assert (first.event.cause, first.event.rotor) == (event.cause, event.rotor)
    assert first.event.rotor == (rotor,)
    assert first.event.onset_s == pytest.approx(event.onset_s, abs=0.1)
    assert first.event.onset_s == pytest.approx(begins_s, abs=0.1)
    assert begins_s < first.raised_s < begins_s + 3.0
    assert {a.raised_s for a in said} == {first.raised_s}, "one alarm, which settles"
    assert said[-1].closed_s is None


@pytest.mark.slow
def test_a_sound_flight_is_silent_from_the_idling_motors_on() -> None:
    """A quarter of a minute on the ground with idling motors; then a square."""
    flight = damaged_flight(load_vehicle("copter_default"), loss=0.0, seconds=20.0).table
    rest = pd.concat([flight[:200]] * 15, ignore_index=True)
    flight = flight.assign(time=flight["time"] + 15.0)
    rest["time"] = np.arange(len(rest)) * 0.005
    whole = Flight("idle", pd.concat([rest, flight], ignore_index=True))
    said, watch = watched(whole, load_vehicle("copter_default"))
    assert said == [] and watch.misfit == ""
    _, early = watched(whole.between(0.0, 14.0), load_vehicle("copter_default"))
    assert "after take-off" in early.rests
    _, learns = watched(whole.between(0.0, 22.0), load_vehicle("copter_default"))
    assert "is learned" in learns.rests and watch.rests == ""


@pytest.mark.slow
def test_rotors_in_another_order_are_said_instead_of_events() -> None:
    copter = load_vehicle("copter_default")
    order = [2, 3, 0, 1]
    rotors = replace(
        copter.rotors,
        position_m=copter.rotors.position_m[order],
        direction=copter.rotors.direction[order],
    )
    flight = damaged_flight(copter, begins_s=24.0, loss=0.3, seconds=28.0)
    said, watch = watched(flight, replace(copter, rotors=rotors))
    assert said == [] and "does not fit" in watch.misfit


def test_an_instrument_is_named_once() -> None:
    """A gyroscope that is noisier, from then on in every window: one alarm, not one a look."""
    table = {k: v for k, v in sound(45.0).items() if k[:4] not in ("cmd_", "pos_")}
    late, rng = table["time"] > ONSET_S, np.random.default_rng(1)
    for axis in "xyz":
        table[f"gyro_{axis}"][late] += 0.05 * rng.standard_normal(int(late.sum()))
    said, _ = watched(Flight("noisy", pd.DataFrame(table)))
    assert {(a.event.cause, a.event.sensor) for a in said} == {("sensor_noise_level", "gyroscope")}
    assert len({a.raised_s for a in said}) == 1
    assert said[0].event.onset_s == pytest.approx(ONSET_S, abs=0.5)
    assert said[0].raised_s < ONSET_S + 10.0


def event(rotor: int, onset_s: float = 10.0, probability: float = 0.97) -> Event:
    return Event(cause="rotor_failure", rotor=(rotor,), onset_s=onset_s, probability=probability)


def test_a_name_needs_two_looks_or_a_loss_of_control() -> None:
    case = Case()
    case.see(event(1), 11.0)
    assert list(case.news(11.0, 6.0)) == []
    case.see(event(1, 10.1), 12.0)
    (alarm,) = case.news(12.0, 6.0)
    assert alarm.raised_s == 12.0 and alarm.known_s == 11.0 and alarm.closed_s is None
    at_once = Case()
    at_once.see(event(1), 11.0)
    assert len(list(at_once.news(11.0, 6.0, at_once=True))) == 1


def test_an_unsure_name_waits_until_it_settles() -> None:
    case = Case()
    for now in (11.0, 12.0, 13.0):
        case.see(event(2, probability=0.6), now)
        assert list(case.news(now, 6.0)) == []
    case.see(event(2, probability=0.6), 16.5)
    raised, settled = case.news(16.5, 6.0)
    assert raised.raised_s == settled.raised_s == 16.5 and case.settled
    assert list(case.news(18.0, 6.0)) == []


def test_another_name_withdraws_the_first_one() -> None:
    case = Case()
    for now in (11.0, 12.0):
        case.see(event(1), now)
        told = list(case.news(now, 6.0))
    assert told[0].event.rotor == (1,)
    case.see(event(3), 13.0)
    (over,) = case.news(13.0, 6.0)
    assert over.event.rotor == (1,) and over.closed_s == 13.0
    case.see(event(3), 14.0)
    (new,) = case.news(14.0, 6.0)
    assert new.event.rotor == (3,) and new.raised_s == 14.0
    assert new.known_s == 13.0, "it could be known since it has this name"


def test_one_evaluation_that_misses_an_event_withdraws_no_alarm() -> None:
    case = Case()
    for now in (11.0, 12.0, 13.0, 14.0, 15.0):
        case.see(event(1), now)
        list(case.news(now, 6.0))
    case.see(None, 16.0)
    assert list(case.news(16.0, 6.0)) == [] and not case.settled
    case.see(event(1), 17.0)
    (settled,) = case.news(17.0, 6.0)
    assert settled.raised_s == 12.0 and settled.closed_s is None and case.settled


def test_what_is_not_seen_again_is_withdrawn_when_it_would_settle() -> None:
    case = Case()
    for now in (11.0, 12.0):
        case.see(event(1), now)
        list(case.news(now, 6.0))
    case.see(None, 13.0)
    assert list(case.news(13.0, 6.0)) == [], "one look is no proof"
    case.see(None, 16.5)
    (over,) = case.news(16.5, 6.0)
    assert over.closed_s == 16.5 and case.settled and case.alarm is None
