"""Of a long flight the part is read that moves most; a short one is read whole."""

import numpy as np
import pandas as pd
import pytest

from twin.explain.settings import DEFAULT
from twin.explain.usable import part_read
from twin.logs import Flight

SETTINGS = DEFAULT.usable
LONG_S = 3 * SETTINGS.longest_s


def moving(from_s: float, to_s: float, long_s: float = LONG_S, **held: float) -> Flight:
    """A hover that a tour breaks; all the while each signal shakes a little."""
    t = np.arange(0.0, long_s, 0.1)
    rng, tour = np.random.default_rng(0), (t >= from_s) & (t < to_s)
    columns = {"time": t} | {k: np.full(len(t), v) for k, v in held.items()}
    for name in ("vel_x", "vel_y", "vel_z"):
        columns[name] = 0.05 * rng.normal(size=len(t)) + 3 * tour * np.sin(t)
    return Flight("long", pd.DataFrame(columns))


@pytest.mark.parametrize("begin", [0.0, 130.0, 400.0, LONG_S - 100])
def test_the_tour_is_read_wherever_it_is(begin: float) -> None:
    flight = moving(begin, begin + 90)
    part, note = part_read(flight)
    time = part.table["time"].to_numpy()
    assert time[0] <= begin and time[-1] >= min(begin + 90, LONG_S) - 0.2
    assert time[-1] - time[0] <= SETTINGS.longest_s
    assert note == (
        f"long: {time[0]:.0f} to {min(time[0] + SETTINGS.longest_s, LONG_S - 0.1):.0f} s of "
        f"{LONG_S - 0.1:.0f} s are read, where it moves most; cut the log for others"
    )
    whole = flight.table.set_index("time")
    pd.testing.assert_frame_equal(part.table.set_index("time"), whole.loc[time[0] : time[-1]])


def test_a_short_flight_is_read_whole() -> None:
    flight = moving(10.0, 20.0, SETTINGS.longest_s)
    assert part_read(flight) == (flight, None)


def test_a_signal_that_never_changes_says_nothing() -> None:
    flight = moving(400.0, 490.0, q_w=1.0, q_x=0.0, q_y=0.0, q_z=0.0)
    assert part_read(flight)[0].table["time"].iloc[0] <= 400.0


def test_a_flight_without_motion_is_read_from_its_start() -> None:
    table = pd.DataFrame({"time": np.arange(0.0, LONG_S, 0.1), "baro_pa": 101325.0})
    part, note = part_read(Flight("still", table))
    assert part.table["time"].iloc[0] == 0.0 and note is not None
