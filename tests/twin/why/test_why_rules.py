"""Rules of one line: what they say, and that they are no detector."""

import numpy as np
import pandas as pd
import pytest
from why_rig import sound

from twin.logs import Flight
from twin.why.flight import FlightFrame
from twin.why.rules import highest_mean, parted_outputs


def framed(**changed: np.ndarray) -> FlightFrame:
    return FlightFrame.of(Flight("flight", pd.DataFrame(sound() | changed)))


def test_the_first_output_that_parts_is_taken() -> None:
    t = sound()["time"]
    up = np.where(t > 20.0, 0.8, 0.5)
    read = parted_outputs(framed(cmd_2=up))
    assert read is not None and read.rotor == 2
    assert read.t_s == pytest.approx(20.0, abs=0.02)
    assert parted_outputs(framed()) is None


def test_outputs_may_part_during_the_first_seconds() -> None:
    t = sound()["time"]
    assert parted_outputs(framed(cmd_2=np.where(t < 5.0, 0.9, 0.5))) is None


def test_a_turn_of_the_pilot_fires_the_rule_as_well() -> None:
    t = sound()["time"]
    turn = np.where((t > 15.0) & (t < 15.3), 0.1, 0.0)
    changed = {f"cmd_{i}": 0.5 + (1 if i < 3 else -1) * turn for i in range(1, 5)}
    read = parted_outputs(framed(**changed))
    assert read is not None and read.t_s == pytest.approx(15.0, abs=0.02)


def test_the_highest_mean_is_the_weak_rotor() -> None:
    t = sound()["time"]
    read = highest_mean(framed(cmd_3=0.52 + 0 * t))
    assert read is not None and read.rotor == 3 and read.t_s is None
    without = {k: v for k, v in sound().items() if not k.startswith("cmd_")}
    assert highest_mean(FlightFrame.of(Flight("flight", pd.DataFrame(without)))) is None
