"""Vibration: its level, and what it follows."""

import numpy as np
import pandas as pd
import pytest

from twin.logs import Flight
from twin.logs.columns import ACC
from twin.why.flight import FlightFrame
from twin.why.vibration import vibration

RATE_HZ = 400.0


def shaken(
    rotor: int | None, harmonic: int = 1, size: float = 3.0, speeds: bool = True, base: float = 60.0
) -> FlightFrame:
    """A flight whose rotors change speed, each in its own way, and one of them, or the structure at
    70 Hz, shakes the board."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 30.0, 1 / RATE_HZ)
    turns = [base * (1 + 0.1 * np.sin(0.5 * t) + 0.05 * np.sin(0.2 * i * t)) for i in range(1, 5)]
    own = np.full(len(t), 70.0) if rotor is None else harmonic * turns[rotor - 1]
    wave = size * np.sqrt(2) * np.sin(2 * np.pi * np.cumsum(own) / RATE_HZ)
    acc = 0.1 * rng.standard_normal((len(t), 3)) + [0.0, 0.0, -9.81]
    acc[:, 0] += wave
    table = {"time": t} | dict(zip(ACC, acc.T, strict=True))
    table |= {f"cmd_{i}": turns[i - 1] / (2 * base) for i in range(1, 5)}
    if speeds:
        table |= {f"rotor_{i}": 2 * np.pi * turns[i - 1] for i in range(1, 5)}
    return FlightFrame.of(Flight("shaken", pd.DataFrame(table)))


@pytest.mark.parametrize(("rotor", "harmonic"), [(3, 1), (2, 2), (4, 1)])
def test_a_rotor_is_named_by_its_speed(rotor: int, harmonic: int) -> None:
    (note,) = vibration(shaken(rotor, harmonic)).notes
    often = "once" if harmonic == 1 else f"{harmonic} times"
    assert f"of rotor {rotor}, {often} per turn" in note


def test_a_line_above_half_the_rate_is_found_where_it_is_folded_to() -> None:
    (note,) = vibration(shaken(1, 2, base=130.0)).notes  # 260 Hz in a log of 400 Hz
    assert "of rotor 1, 2 times per turn" in note


def test_what_stays_is_of_the_structure() -> None:
    for speeds in (True, False):
        (note,) = vibration(shaken(None, speeds=speeds)).notes
        assert "of the structure" in note and "70" in note


def test_without_speeds_it_is_of_the_rotors_and_of_none_by_name() -> None:
    (note,) = vibration(shaken(2, speeds=False)).notes
    assert "of the rotors: it follows the commands" in note


def test_the_level_is_a_root_mean_square_and_too_much_is_an_event() -> None:
    (note,) = vibration(shaken(3, size=3.0)).notes
    assert float(note.split(": ")[1].split(" ")[0]) == pytest.approx(3.0, rel=0.1)
    (event,) = vibration(shaken(3, size=40.0)).events
    assert event.cause == "vibration" and event.rotor == (3,) and event.onset_s is None
    assert event.severity is not None and event.severity.value == pytest.approx(40.0, rel=0.1)
    assert event.probability > 0.95


def test_a_slow_log_says_nothing_of_vibration() -> None:
    frame = shaken(3)
    slow = Flight("slow", frame.flight.table[::20].reset_index(drop=True))
    assert not vibration(FlightFrame.of(slow)).notes


def test_even_rotors_are_not_parted_from_the_structure() -> None:
    frame = shaken(None)
    even = frame.flight.table.assign(**{f"cmd_{i}": 0.5 for i in range(1, 5)})
    even = even.drop(columns=[f"rotor_{i}" for i in range(1, 5)])
    (note,) = vibration(FlightFrame.of(Flight("even", even))).notes
    assert "source not known" in note


def test_a_rotor_whose_speed_never_comes_is_not_named_and_hides_no_other() -> None:
    table = shaken(3).flight.table.assign(rotor_2=np.nan)
    (note,) = vibration(FlightFrame.of(Flight("one is missing", table))).notes
    assert "of rotor 3, once per turn" in note
    without = table.assign(**{f"rotor_{i}": np.nan for i in range(1, 5)})
    (note,) = vibration(FlightFrame.of(Flight("all are missing", without))).notes
    assert "of the rotors: it follows the commands" in note
