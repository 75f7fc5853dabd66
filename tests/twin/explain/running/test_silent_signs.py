"""Readings that stand still and shaking, on frames that are made up."""

import numpy as np
from numpy.typing import NDArray

from twin.explain.running.alarms import Shaking, StandStill
from twin.explain.running.frames import FRAME_ROWS, Frame, high_power, longest_repeats
from twin.explain.running.hypotheses import RUNNING
from twin.residuals.channels import GRID_HZ

Array = NDArray[np.float64]
WANTED = ("stuck_sensor", "vibration", "sensor_noise_level")


def frame(number: int, acc: Array, gyro: Array) -> Frame:
    t = (FRAME_ROWS * number + np.arange(len(acc))) / GRID_HZ
    repeats = longest_repeats({"acc": (t, acc), "gyro": (t, gyro)})
    loud = high_power(np.hstack([acc, gyro]))
    return Frame(number, True, {}, loud, repeats, {"acc": len(acc), "gyro": len(gyro)})


def noise(rng: np.random.Generator) -> tuple[Array, Array]:
    return (
        0.1 * rng.standard_normal((FRAME_ROWS, 3)),
        0.005 * rng.standard_normal((FRAME_ROWS, 3)),
    )


def test_a_reading_that_stands_still_is_told_and_kept_out() -> None:
    rng, still = np.random.default_rng(1), StandStill(RUNNING)
    still.begin([frame(k, *noise(rng)) for k in range(10)])
    for k in range(10, 16):
        acc, gyro = noise(rng)
        gyro[:, 1] = 0.37 if k >= 13 else gyro[:, 1]
        now = frame(k, acc, gyro)
        assert still.follow(now) == ({"gyro"} if k >= 13 else set())
        signs = still.signs(now)
        assert bool(signs) == (k >= 13)
    assert signs[0].start == 13
    assert signs[0].numbers[0].value == 5  # gyro_y
    acc, gyro = noise(rng)
    assert still.follow(frame(16, acc, gyro)) == set()
    assert not still.signs(frame(16, acc, gyro))


def test_a_log_that_holds_every_reading_is_not_stuck() -> None:
    """A table faster than its sensor repeats all axes alike."""
    rng, still = np.random.default_rng(2), StandStill(RUNNING)
    still.begin([frame(k, *noise(rng)) for k in range(10)])
    acc, gyro = (np.repeat(x[:: FRAME_ROWS // 4], FRAME_ROWS // 4, axis=0) for x in noise(rng))
    still.follow(frame(10, acc, gyro))
    assert not still.signs(frame(10, acc, gyro))


def shaken(kind: str, size: float) -> tuple[str, float, float]:
    """Name, since which frame, first number of what is told."""
    rng, shaking = np.random.default_rng(3), Shaking(RUNNING)
    shaking.begin([frame(k, *noise(rng)) for k in range(16)])
    found = []
    for k in range(16, 40):
        acc, gyro = noise(rng)
        if k >= 30 and kind == "vibration":
            t = (FRAME_ROWS * k + np.arange(FRAME_ROWS)) / GRID_HZ
            for phase in range(4):
                angle = 2 * np.pi * (52.0 + 0.3 * phase) * t + 1.7 * phase
                acc[:, 0] += size * np.cos(angle)
                acc[:, 1] += size * np.sin(angle)
        elif k >= 30:
            acc, gyro = (x * size for x in (acc, gyro))
        shaking.follow(frame(k, acc, gyro))
        signs = shaking.signs(WANTED)
        found += [s for s in signs if s.evidence > 20]
        assert k >= 30 or not found
    return found[-1].effect, found[-1].start, found[-1].numbers[0].value


def test_lines_are_vibration() -> None:
    effect, start, size = shaken("vibration", 0.5)
    assert (effect, abs(start - 30) <= 1) == ("vibration", True)
    assert 0.35 < size < 0.7


def test_noise_everywhere_is_noise() -> None:
    effect, start, _ = shaken("noise", 3.0)
    assert (effect, abs(start - 30) <= 1) == ("sensor_noise_level", True)


def test_power_is_that_of_the_signal() -> None:
    """White noise of variance 1 has 3/4 of it between 25 and 100 Hz."""
    rng = np.random.default_rng(4)
    power = np.mean(
        [high_power(rng.standard_normal((FRAME_ROWS, 6))).sum(axis=1) for _ in range(300)]
    )
    assert abs(power - 0.75) < 0.03
