"""The table of numbers in closed loop."""

from typing import Any

from benchmarks.closed_loop.__main__ import GOALS, table


def told(truth: float, estimate: float, sd: float, width: float) -> dict[str, float]:
    low, high = estimate - 1.96 * sd, estimate + 1.96 * sd
    off = (estimate - truth) / sd
    return {"truth": truth, "low": low, "high": high, "off": off, "width": width}


def row(seed: int, off: float) -> dict[str, Any]:
    """A flight whose numbers are told `off` deviations too large, and whose file is 1.5 prior
    deviations off; of the last seed 3."""
    truth = -0.03 if seed < 9 else -0.06
    number = {
        "told": told(truth, truth + 0.01 * off, 0.01, 0.5),
        "file": told(truth, 0.0, 0.02, 1.0),
    }
    numbers = {n: number for names in GOALS.values() for n in names}
    return {"mission": "tour", "log": "imu", "numbers": numbers}


def test_what_misses_a_goal_is_marked_and_the_file_stands_beside_it() -> None:
    """Nine of ten intervals hold the truth, of the file as well; their mean is 1.2 and 1.65 off."""
    text = table([row(k, 1.0 if k < 9 else 3.0) for k in range(10)])
    assert "| lag | - | - | +1.20\\*, 0.90 (0.50) | - | +1.65\\*, 0.90 (1.00) |" in text
    exact = table([row(k, 0.0) for k in range(10)])
    assert "| lag | - | - | +0.00, 1.00\\* (0.50) | - |" in exact
