"""Effects that change no mean, planted in readings of a vehicle that hovers; none where none is."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter

from twin.effects import EFFECTS
from twin.effects.sensors import SENSOR_NOISE_LEVEL, STUCK_SENSOR, VIBRATION
from twin.explain.model.model import FlightModel, Model
from twin.explain.model.numbers import numbers_of
from twin.explain.model.prediction import Physics
from twin.explain.stochastic.imu_noise import find_noise_level, find_vibration
from twin.explain.stochastic.search import (
    find_stochastic,
    pieces_in_common,
    stuck_channels,
    stuck_numbers,
    without_stuck,
)
from twin.explain.stochastic.spectral import StochasticEffect
from twin.logs import Flight
from twin.logs.columns import ACC, GYRO, MAG
from twin.physics.airframe import airframe
from twin.residuals.channels import ChannelData
from twin.vehicle import GRAVITY_M_S2, Vehicle
from twin.vehicle.vehicle import hover_level
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]
Change = Callable[[dict[str, Array], Array, np.random.Generator], None]
COPTER = load_vehicle("copter_default")
ACCEL_NOISE, GYRO_NOISE = 0.08, 0.004
NOISY = replace(
    COPTER,
    drag_linear_n_s_m=0.3 * COPTER.mass_kg * np.ones(3),
    sensors=replace(COPTER.sensors, accel_noise_m_s2=ACCEL_NOISE, gyro_noise_rad_s=GYRO_NOISE),
)
CANDIDATES = tuple(EFFECTS[e] for e in ("accel_bias", "steady_wind", "rotor_drag"))


def unchanged(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
    """Nothing is planted."""


def hovering(
    change: Change = unchanged,
    noise: float = 1.0,
    seconds: float = 20.0,
    rate_hz: float = 200.0,
    seed: int = 1,
) -> Flight:
    """A vehicle that stands in the air, each reading with white noise of `noise` times stated."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    columns = {f"rotor_{i}": np.full(len(t), hover_level(NOISY)) for i in range(1, 5)}
    mean = dict.fromkeys((*ACC, *GYRO), 0.0) | {"acc_z": -GRAVITY_M_S2}
    for names, size in ((ACC, ACCEL_NOISE), (GYRO, GYRO_NOISE)):
        for c in names:
            columns[c] = mean[c] + noise * size * rng.standard_normal(len(t))
    for c, value in zip(MAG, (2e-5, 1e-6, 4e-5), strict=True):
        columns[c] = value + 1e-7 * rng.standard_normal(len(t))
    columns["baro_pa"] = 101300 + 5 * rng.standard_normal(len(t))
    places = {"pos_z": -3.0, "q_w": 1.0}
    for c in ("pos_x", "pos_y", "pos_z", "vel_x", "vel_y", "vel_z", "q_w", "q_x", "q_y", "q_z"):
        columns[c] = np.full(len(t), places.get(c, 0.0))
    change(columns, t, rng)
    return Flight(f"hover_{seed}", pd.DataFrame({"time": t, **columns}))


@cache
def body() -> Physics:
    """Prediction, built once for all models."""
    effects = [e.name for e in CANDIDATES]
    made = airframe(NOISY, "rotor_speed", effects)
    return Physics(made, NOISY, effects, numbers_of(CANDIDATES, NOISY))


def model(flights: Sequence[Flight], vehicle: Vehicle = NOISY) -> Model:
    numbers, effects = tuple(numbers_of(CANDIDATES, NOISY)), [e.name for e in CANDIDATES]
    made = tuple(FlightModel(f, vehicle, body(), effects, numbers) for f in flights)
    return Model(vehicle, tuple(effects), numbers, made)


def found(*flights: Flight) -> dict[str, StochasticEffect]:
    return {u.effect: u for u in find_stochastic(model(flights), {})}


def inside(u: StochasticEffect, name: str, value: float) -> bool:
    low, high = u.intervals[name]
    return low <= value <= high


# -- noise level ----------------------------------------------------------------------------


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is() -> None:
    assert found(hovering(seed=1), hovering(seed=2)) == {}


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.4, 1.8, 4.0])
def test_noise_level_is_found_with_its_scale(scale: float) -> None:
    named = found(hovering(noise=scale))
    assert set(named) == {"sensor_noise_level"}
    assert inside(named["sensor_noise_level"], "sensor_noise_level.scale", scale)


@pytest.mark.slow
def test_noise_of_one_sensor_is_further_noise_of_that_sensor() -> None:
    def louder(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
        for c in GYRO:
            columns[c] += 0.01 * rng.standard_normal(len(t))

    named = found(hovering(louder))["sensor_noise_level"]
    assert named.channels == GYRO
    assert inside(named, "sensor_noise_level.gyro_rad_s", 0.01)
    assert dict(named.values)["sensor_noise_level.scale"] == 1.0


@pytest.mark.slow
def test_a_vehicle_file_without_noise_says_nothing_about_noise() -> None:
    assert find_noise_level(model([hovering(noise=3.0)], COPTER), SENSOR_NOISE_LEVEL) is None


def filtered(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
    """A filter behind the noise takes most of it above 25 Hz."""
    for c in (*ACC, *GYRO):
        columns[c] = columns[c].mean() + np.convolve(
            columns[c] - columns[c].mean(), [0.25, 0.5, 0.25], mode="same"
        )


def held(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
    """Readings of 100 Hz in a table of 200 Hz."""
    for c in (*ACC, *GYRO):
        columns[c] = np.repeat(columns[c][::2], 2)


def coarse(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
    """A last bit of the size of the noise; readings rest in it now and then."""
    for names, bit in ((ACC, ACCEL_NOISE), (GYRO, GYRO_NOISE)):
        for c in names:
            columns[c] = bit * np.round(columns[c] / bit)


@pytest.mark.slow
@pytest.mark.parametrize("change", [filtered, held, coarse])
def test_filters_held_and_coarse_readings_raise_no_alarm(change: Change) -> None:
    flight = hovering(change)
    assert stuck_channels(flight) == []
    assert found(flight) == {}


@pytest.mark.slow
def test_readings_without_noise_raise_no_alarm() -> None:
    flight = hovering(noise=0.0)
    assert stuck_channels(flight) == []
    assert found(flight) == {}


# -- vibration ------------------------------------------------------------------------------


def shaking(hz: float, accel: float, gyro: float) -> Change:
    """Four rotors of nearly the same speed, `hz` turns per second on average."""

    def change(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
        for rotor, speed in enumerate((0.99, 1.0, 1.005, 1.01), start=1):
            angle = 2 * np.pi * (hz * speed * t + rng.uniform())
            for names, size in ((ACC, accel), (GYRO, gyro)):
                columns[names[0]] += size * np.cos(angle)
                columns[names[1]] += size * np.sin(angle)
            columns[f"rotor_{rotor}"] *= speed

    return change


@pytest.mark.slow
@pytest.mark.parametrize("hz", [60.0, 85.0, 140.0])
def test_vibration_is_found_with_its_sizes(hz: float) -> None:
    named = found(hovering(shaking(hz, 0.4, 0.02)))
    assert set(named) == {"vibration"}
    sizes = dict(named["vibration"].values)
    # At a constant speed a line above half the rate is also one below it.
    images = {hz, 200.0 - hz, 200.0 + hz, 400.0 - hz}
    assert min(abs(sizes["vibration.frequency_hz"] - i) for i in images) < 0.02 * hz
    assert sizes["vibration.gyro_rad_s"] == pytest.approx(0.02, rel=0.2)
    assert sizes["vibration.accel_m_s2"] == pytest.approx(0.4, rel=0.2)
    assert {"acc_x", "acc_y", "gyro_x", "gyro_y"} <= set(named["vibration"].channels)


@pytest.mark.slow
def test_lines_below_the_noise_and_slow_swings_are_no_vibration() -> None:
    assert find_vibration(model([hovering(shaking(85.0, 0.002, 1e-4))]), VIBRATION) is None
    assert find_vibration(model([hovering(shaking(8.0, 0.4, 0.05))]), VIBRATION) is None


# -- gust -----------------------------------------------------------------------------------


def breeze(sigma_m_s: float, time_s: float) -> Change:
    """Exact first-order turbulence through the drag of the vehicle, 0.3 1/s."""

    def change(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
        kept = np.exp(-(t[1] - t[0]) / time_s)
        for c in ACC:
            kicks = np.sqrt(1 - kept**2) * rng.standard_normal(len(t))
            columns[c] += 0.3 * sigma_m_s * lfilter([1.0], [1.0, -kept], kicks)

    return change


def swinging(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
    """A load on a rope, or a loose part: one frequency."""
    columns["acc_x"] += 0.2 * np.sin(2 * np.pi * 0.9 * t)
    columns["acc_y"] += 0.2 * np.cos(2 * np.pi * 0.9 * t)


def rattling(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
    """A few bumps in an otherwise quiet flight."""
    for start in (4.0, 12.0):
        columns["acc_x"] += 0.6 * np.exp(-(((t - start) / 0.3) ** 2))
        columns["acc_y"] -= 0.6 * np.exp(-(((t - start) / 0.3) ** 2))


def leaning(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
    """The same, and the vehicle leans against it as far as it is pushed."""
    calm = {c: columns[c].copy() for c in ACC}
    breeze(1.5, 0.7)(columns, t, rng)
    push = [(columns[c] - calm[c]) / (2 * GRAVITY_M_S2) for c in ACC[:2]]
    columns["q_x"], columns["q_y"] = -push[1], push[0]
    columns["q_w"] = np.sqrt(1 - push[0] ** 2 - push[1] ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("change", [breeze(1.5, 0.7), leaning], ids=["still", "leaning"])
def test_gust_is_found_with_its_intensity(change: Change) -> None:
    """No wind that is the same all flight explains it by the attitude."""
    named = found(*(hovering(change, seconds=30.0, seed=k) for k in (3, 4)))
    assert set(named) == {"gust"}
    assert inside(named["gust"], "gust.intensity_u", 1.5)
    assert inside(named["gust"], "gust.intensity_w", 1.5)


@pytest.mark.slow
@pytest.mark.parametrize("change", [swinging, rattling])
def test_a_swing_and_a_bump_are_no_gust(change: Change) -> None:
    assert found(hovering(change), hovering(change, seed=2)) == {}


# -- stuck sensor ---------------------------------------------------------------------------


def standing(channel: str, from_s: float, to_s: float = np.inf) -> Change:
    def change(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
        rows = np.flatnonzero((t >= from_s) & (t < to_s))
        columns[channel][rows] = columns[channel][rows[0]]

    return change


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(st.sampled_from((*ACC, *GYRO, *MAG, "baro_pa")), st.floats(0.5, 18.0))
def test_a_stuck_channel_is_found_with_its_time(channel: str, from_s: float) -> None:
    (stuck,) = stuck_channels(hovering(standing(channel, from_s)))
    assert (stuck.channel, stuck.to_the_end) == (channel, True)
    assert stuck.from_s == pytest.approx(from_s, abs=0.0051)
    if channel in (*ACC, *GYRO):
        numbers = stuck_numbers([stuck], STUCK_SENSOR)
        assert numbers["stuck_sensor.channel"] == 1 + (*ACC, *GYRO).index(channel)
        assert numbers["stuck_sensor.time_s"] == stuck.from_s


def test_stuck_readings_are_taken_out_with_their_sensor() -> None:
    flight = hovering(standing("gyro_y", 8.0, 11.0))
    (stuck,) = stuck_channels(flight)
    clean = without_stuck(flight, [stuck]).table
    assert not stuck.to_the_end
    assert stuck_numbers([stuck], STUCK_SENSOR) == {}
    assert clean.loc[clean["time"].between(8.0, 10.99), list(GYRO)].isna().all(axis=None)
    assert clean[list(ACC)].notna().all(axis=None)
    assert clean.loc[clean["time"] < 8.0, list(GYRO)].notna().all(axis=None)
    assert flight.table.notna().all(axis=None)


def on_the_ground(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
    """Every reading stands still for a while."""
    for c in (*ACC, *GYRO, *MAG, "baro_pa"):
        columns[c][t < 6.0] = columns[c][0]


def unmeasured(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
    """An axis that a simulator does not fill."""
    columns["gyro_z"][:] = 0.0


def short_loss(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
    """A packet of 0.2 s is lost."""
    standing("acc_x", 5.0, 5.2)(columns, t, rng)


def gliding(columns: dict[str, Array], t: Array, rng: np.random.Generator) -> None:
    """Readings without noise, of which one comes to rest."""
    for k, c in enumerate((*ACC, *GYRO)):
        columns[c] = np.sin((1 + 0.1 * k) * t)
    columns["acc_x"] = np.where(t < 6.0, (6.0 - t) ** 2, 0.0) + 0.1


@pytest.mark.parametrize("change", [on_the_ground, unmeasured, short_loss, gliding, held, coarse])
def test_other_reasons_to_stand_still_raise_no_alarm(change: Change) -> None:
    assert stuck_channels(hovering(change)) == []


def test_axes_that_lack_different_pieces_share_the_rest() -> None:
    t = np.arange(100) / 50
    no = np.zeros(0)

    def axis(known: NDArray[np.bool_]) -> ChannelData:
        return ChannelData("acc_x", "m/s2", t[known], no, no, no, np.zeros(0, np.intp))

    whole, cut = np.ones(100, np.bool_), (t < 0.5) | (t > 1.2)
    assert [len(p) for p in pieces_in_common([axis(whole)] * 3)] == [100]
    pieces = pieces_in_common([axis(whole), axis(cut), axis(t < 1.9)])
    assert [(p[0], p[-1]) for p in pieces] == [(0.0, 0.48), (1.22, 1.88)]
