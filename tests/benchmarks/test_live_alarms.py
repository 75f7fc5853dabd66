"""The planted flights have the numbers of their effects; the table says what was said."""

import pytest

from benchmarks.live_alarms.__main__ import Said, lines
from benchmarks.live_alarms.flights import SIZES, Case, aircraft, numbers
from twin.effects import EFFECTS
from twin.why.records import Event
from twin.why.watch import Alarm


@pytest.mark.parametrize("effect", SIZES)
def test_every_case_has_the_numbers_of_its_effect(effect: str) -> None:
    vehicle = aircraft("copter_default")
    drawn = numbers(effect, SIZES[effect][1], vehicle, Case(effect, "medium", 1000).rng)
    assert drawn.keys() <= EFFECTS[effect].starts(vehicle).keys()


def said(truth: str, alarm: Alarm | None, event: Event | None) -> Said:
    alarms = () if alarm is None else (alarm,)
    return Said("flight", "planted", truth, alarms, event, "-", 1800.0, 0.2)


def test_an_alarm_that_was_withdrawn_is_not_the_first_event() -> None:
    event = Event(cause="rotor_failure", rotor=(2,), onset_s=20.0, probability=0.99)
    alarm = Alarm(event=event, raised_s=21.0, known_s=20.5)
    over = Alarm(event=event, raised_s=21.0, known_s=20.5, closed_s=25.0)
    rows = [said("it stops", alarm, event), said("", over, event), said("", None, None)]
    assert [r.same for r in rows] == [True, False, True]
    text = "\n".join(lines(rows))
    assert "alike: 2 of 3." in text and "begin: 1 in 1.00 h" in text
    assert "| rotor failure 2, 20.00 s | 21.0 s | rotor failure 2, 20.00 s | - |" in text
