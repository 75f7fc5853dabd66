"""The table of numbers in closed loop."""

from typing import Any

from benchmarks.closed_loop.__main__ import table


def row(seed: int, off: float) -> dict[str, Any]:
    """A flight whose lag is told `off` deviations too long, and whose file is 1.5 prior deviations
    off; of the last seed 3."""
    truth = -0.03 if seed < 9 else -0.06
    lag = {"truth": truth, "estimate": truth + 0.01 * off, "sd": 0.01, "prior": 0.02}
    return {"mission": "tour", "log": "imu", "numbers": {"motor_lag.tau_s": lag}}


def test_what_misses_a_goal_is_marked_and_the_file_stands_beside_it() -> None:
    """Nine of ten intervals hold the truth, of the file as well; their mean is 1.2 and 1.65 off."""
    text = table([row(k, 1.0 if k < 9 else 3.0) for k in range(10)])
    assert "| lag | - | - | +1.20\\*, 0.90 (0.50) | - | +1.65\\*, 0.90 (1.00) |" in text
    exact = table([row(k, 0.0) for k in range(10)])
    assert "| lag | - | - | +0.00, 1.00\\* (0.50) | - |" in exact
