"""Instruments: a planted loop is not read backwards, a setpoint in the loop is no instrument."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, sosfiltfilt

from twin.effects import EFFECTS
from twin.explain.inference.fit import Problem
from twin.explain.inference.instruments import UNEVEN, Instrument, InstrumentNoise
from twin.explain.inference.noise import BandNoise
from twin.explain.inference.priors import priors_of
from twin.explain.inference.search import search, with_instruments_of_end
from twin.explain.inference.spectrum import Spectrum, transformed
from twin.explain.model.model import model_of
from twin.frames import from_euler
from twin.logs import Flight
from twin.logs.autopilot import Autopilot, Setpoint
from twin.logs.columns import POS, QUAT, VEL
from twin.residuals.channels import CHANNEL_HZ, ChannelData
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly

Array = NDArray[np.float64]
GAIN = 1.5
"""Of the plant over that of the model: its inertia is smaller."""
TWIST = -8.0
"""Angular acceleration by the air per speed, 1/(m s): a third of a Crazyflie's."""
T_S = np.arange(0, 60, 1 / CHANNEL_HZ)
ZERO = np.zeros_like(T_S)


def slow_noise(seed: int, edge_hz: float) -> Array:
    """Of deviation one."""
    noise = np.random.default_rng(seed).standard_normal(len(T_S))
    low = sosfiltfilt(butter(2, edge_hz / (CHANNEL_HZ / 2), output="sos"), noise)
    return np.asarray(low / low.std())


def pushes(seed: int, size: float) -> Array:
    """Disturbance as of turbulence: it falls with the first power of frequency."""
    noise = np.random.default_rng(seed).standard_normal(len(T_S))
    kept = np.exp(-1 / (0.1 * CHANNEL_HZ))
    return np.asarray(size * np.sqrt(1 - kept**2) * lfilter([1.0], [1.0, -kept], noise))


def looped(asked: Array, push: Array, follows: float = 0.0) -> tuple[Array, Array, Array]:
    """Angular acceleration, command and attitude setpoint of a roll axis under a controller.

    Args:
        asked: Roll that is asked for, rad.
        push: Disturbance, rad/s2.
        follows: Gain of a position loop from lateral speed to the attitude setpoint.
    """
    step, lag = 1 / CHANNEL_HZ, 0.0
    turned = rate = speed = 0.0
    found = np.zeros((3, len(T_S)))
    for k, (want, d) in enumerate(zip(asked, push, strict=True)):
        setpoint = want - follows * speed
        lag += 0.5 * (40.0 * (setpoint - turned) - 9.0 * rate - lag)
        found[:, k] = GAIN * lag + d, lag, setpoint
        rate += step * found[0, k]
        turned += step * rate
        speed += step * (9.8 * turned + 0.3 * d)
    return found[0], found[1], found[2]


def channel(y: Array, u: Array) -> ChannelData:
    """Of the model whose gain is one."""
    piece = np.zeros(len(T_S), dtype=np.intp)
    return ChannelData("gyro_rate_x", "rad/s2", T_S, y, y - u, u[:, None], piece)


def flight(setpoint: Setpoint | None, velocity: Array | None = None, name: str = "one") -> Flight:
    q = from_euler(ZERO, ZERO, ZERO).T
    columns = {"time": T_S, "cmd_1": ZERO} | dict(zip(QUAT, q.T, strict=True))
    if velocity is not None:
        columns |= dict(zip(VEL, (ZERO, velocity, ZERO), strict=True))
    asked = None if setpoint is None else Autopilot(setpoints=(setpoint,))
    return Flight(name, pd.DataFrame(columns), autopilot=asked)


def rolled(roll: Array) -> Setpoint:
    return Setpoint(QUAT, T_S, from_euler(roll, ZERO, ZERO).T)


def law_of(flights: Sequence[Flight], channels: Sequence[ChannelData]) -> InstrumentNoise:
    rows = [[c] for c in channels]
    nothing = np.zeros((len(flights), 0)), np.zeros(0, dtype=np.intp)
    rest = Spectrum.of(rows, np.zeros(1), *nothing)
    return InstrumentNoise.of(flights, rows, BandNoise.of(rest, [1.0]), 0.02)


GAINS = np.linspace(-2, 4, 601)


def votes(law: InstrumentNoise, channels: Sequence[ChannelData]) -> Array:
    """Log likelihood of each of `GAINS`."""
    parts = [transformed(c, np.column_stack([c.measured, c.slopes])) for c in channels]
    flight = np.repeat(np.arange(len(parts)), [len(p[1]) for p in parts])
    rows, band = (np.concatenate([p[i] for p in parts]) for i in (0, 1))
    terms = law.terms(0, rows, np.where(band == 0, -1, band), flight)
    rss = np.array([np.array([1, -g]) @ t.gram @ [1, -g] for g in GAINS for t in terms])
    log = law.likelihood(terms).log
    return np.array([log(r) for r in rss.reshape(len(GAINS), -1)])


def best_gain(law: InstrumentNoise, channels: Sequence[ChannelData]) -> float:
    """Where the likelihood of a gain is largest."""
    return float(GAINS[np.argmax(votes(law, channels))])


def directly(c: ChannelData) -> float:
    """Least squares."""
    u = c.slopes[:, 0]
    return float(u @ c.measured / (u @ u))


@pytest.mark.parametrize("seed", range(4))
def test_what_is_asked_tells_the_gain_where_the_loop_reads_backwards(seed: int) -> None:
    """As much push as is asked for: least squares have -1/C in them."""
    roll = 0.1 * slow_noise(seed, 2.0)
    y, u, setpoint = looped(roll, pushes(100 + seed, 3.0))
    c = channel(y, u)
    law = law_of([flight(rolled(setpoint))], [c])
    assert directly(c) < GAIN - 0.25
    assert law.instruments[0, 0].trust > 0.3
    assert best_gain(law, [c]) == pytest.approx(GAIN, abs=0.15)


@pytest.mark.parametrize("seed", range(4))
def test_a_setpoint_that_follows_the_disturbance_is_none(seed: int) -> None:
    """Hover: nothing is asked for but what the position loop makes of the push."""
    y, u, setpoint = looped(ZERO, pushes(seed, 3.0), follows=0.2)
    law = law_of([flight(rolled(setpoint))], [channel(y, u)])
    assert law.instruments[0, 0].trust == 0


@pytest.mark.parametrize("seed", range(4))
def test_the_loop_of_the_height_is_not_read_backwards(seed: int) -> None:
    """Hover: commands answer to gusts, and what they predict votes for no gain and no lag; what is
    read and no command answers to, as beside the centre of mass, is told all the same."""
    gust = pushes(20 + seed, 1.0)
    y, u, _ = looped(ZERO, gust)
    c = replace(channel(y, u), name="acc_z")
    law = law_of([flight(None)], [c])
    assert directly(c) < GAIN - 0.5
    assert vote(law, c, GAIN) == pytest.approx(vote(law, c, 1.0), abs=0.3)
    late = replace(c, slopes=np.gradient(u)[:, None])
    assert vote(law, late, 1.0) == pytest.approx(vote(law, late, 0.0), abs=0.3)
    turned = slow_noise(seed, 6.0)
    read = y + 0.5 * turned
    c = replace(c, measured=read, residual=read - GAIN * u, slopes=turned[:, None])
    law = law_of([flight(None)], [c])
    assert best_gain(law, [replace(c, measured=c.residual)]) == pytest.approx(0.5, abs=0.1)


def vote(law: InstrumentNoise, c: ChannelData, gain: float) -> float:
    """Log likelihood of a gain of the slope, from 0.8 Hz on."""
    rows, band = transformed(c, np.column_stack([c.measured, c.slopes]))
    terms = law.terms(0, rows, np.where(band < 3, -1, band), np.zeros_like(band))
    left = [np.array([1, -gain]) @ t.gram @ [1, -gain] for t in terms]
    return law.likelihood(terms).log(np.array(left))


def test_an_attitude_setpoint_that_two_bands_cannot_test_is_none() -> None:
    """A log of 10 Hz: of one flight it is not tested, of two it is."""
    found = []
    for seed in (1, 2):
        roll = 0.1 * slow_noise(seed, 1.0)
        y, u, setpoint = looped(roll, pushes(100 + seed, 1.0))
        one = flight(rolled(setpoint), name=str(seed))
        slow = one.table.assign(cmd_1=np.where(np.arange(len(T_S)) % 5, np.nan, 0.0))
        found.append((replace(one, table=slow), channel(y, u)))
    alone, both = (law_of(*zip(*some, strict=True)) for some in (found[:1], found))
    assert len(alone.instruments[0, 0].bases) == 2
    assert alone.instruments[0, 0].trust == 0
    assert all(both.instruments[0, f].trust > 0.2 for f in (0, 1))


def test_a_setpoint_that_follows_in_part_tells_no_confident_gain() -> None:
    """Two logs of 10 Hz whose attitude setpoint is half of the mission's and half of the position
    loop's: the test lets them pass with a first stage of 60, and the gain comes out small."""
    off = []
    for seed in range(12):
        found = []
        for k in (seed, 50 + seed):
            y, u, setpoint = looped(0.1 * slow_noise(k, 1.0), pushes(100 + k, 3.0), follows=0.2)
            one = flight(rolled(setpoint), name=str(k))
            slow = one.table.assign(cmd_1=np.where(np.arange(len(T_S)) % 5, np.nan, 0.0))
            found.append((replace(one, table=slow), channel(y, u)))
        flights, channels = zip(*found, strict=True)
        law = law_of(flights, channels)
        if law.instruments[0, 0].trust:
            logs = votes(law, channels)
            true = np.interp(GAIN, GAINS, logs)
            off.append((GAINS[np.argmax(logs)] - GAIN, 2 * (logs.max() - true)))
    away, ratio = np.array(off).T
    assert len(away) >= 4 and away.mean() < -0.2
    assert np.mean(ratio < 1.96**2) >= 0.75


@pytest.mark.parametrize("seed", range(3))
def test_what_the_model_lacks_is_no_disturbance_once_it_is_there(seed: int) -> None:
    """A moment that comes late looks like a setpoint in the loop; with it in the model, J is small,
    and that of a setpoint in the loop stays."""
    roll = 0.1 * slow_noise(seed, 2.0)
    y, u, setpoint = looped(roll, pushes(100 + seed, 1.0))
    late = -0.8 * np.roll(u, round(0.4 * CHANNEL_HZ))
    asked = [flight(rolled(setpoint))]
    before, after = (law_of(asked, [channel(y + late, u + known)]) for known in (ZERO, late))
    assert before.instruments[0, 0].trust == 0
    assert after.instruments[0, 0].trust > 0.3
    assert not after.trusts_as(before)
    assert after.trusts_as(law_of(asked, [channel(y + late, u + late)]))
    y, u, setpoint = looped(ZERO, pushes(seed, 3.0), follows=0.2)
    law = law_of([flight(rolled(setpoint))], [channel(y, GAIN * u)])
    assert law.instruments[0, 0].trust == 0


@pytest.mark.parametrize(("strength", "trusted"), [(2.9, 0.0), (4.0, 0.75), (1e9, 1.0)])
def test_noise_of_the_first_stage_tells_nothing(strength: float, trusted: float) -> None:
    """Of a moment that goes with a mission 1 / F is noise."""
    made = Instrument("mission", {}, {}, 0.5, 1.0, strength)
    assert made.trust == pytest.approx(trusted / UNEVEN)


@pytest.mark.slow
def test_a_search_goes_on_where_its_instruments_are_trusted_otherwise() -> None:
    """And ends as it was where they are not."""
    vehicle = load_vehicle("copter_default")
    flown = fly(vehicle, vehicle, 3)
    model = model_of([flown], vehicle, [EFFECTS["thrust_scale"], EFFECTS["motor_lag"]])
    problem = Problem.of(model, priors_of(model))
    found = search(problem, ())
    same, end = with_instruments_of_end(problem, found)
    assert (same, end) == (problem, found)
    distrusted = {k: replace(i, chance=0.0) for k, i in problem.noise.instruments.items()}
    blind = replace(problem, noise=replace(problem.noise, instruments=distrusted))
    renewed, end = with_instruments_of_end(blind, found)
    assert not blind.noise.trusts_as(problem.noise)
    assert renewed.noise.trusts_as(problem.noise)
    assert end.state.evidence == pytest.approx(found.state.evidence, abs=1.0)


def test_the_mission_comes_before_the_attitude_and_its_position_will_do() -> None:
    speed = slow_noise(5, 0.8)
    lean = np.gradient(speed) * CHANNEL_HZ / 9.8
    y, u, _ = looped(lean, pushes(6, 1.0))
    place = np.cumsum(speed) / CHANNEL_HZ
    found = []
    for columns, values in ((VEL, speed), (POS, place)):
        asked = Setpoint(columns, T_S, np.column_stack([ZERO, values, ZERO]))
        both = Autopilot(setpoints=(asked, rolled(lean)))
        law = law_of([replace(flight(None), autopilot=both)], [channel(y, u)])
        assert law.instruments[0, 0].source == "mission"
        found.append(best_gain(law, [channel(y, u)]))
    assert found == pytest.approx([GAIN, GAIN], abs=0.25)


def test_without_a_setpoint_constants_alone_vote() -> None:
    y, u, _ = looped(0.1 * slow_noise(7, 1.0), pushes(8, 1.0))
    c = channel(y, u)
    rows, band = transformed(c, np.column_stack([c.residual, c.slopes]))
    law = law_of([flight(None)], [c])
    terms = law.terms(0, rows, band, np.zeros(len(band), dtype=np.intp))
    assert not law.instruments
    assert [t.constant for t in terms] == [True]


def test_another_flight_of_the_same_mission_stands_in_for_setpoints() -> None:
    """It began two seconds later in its record, and had pushes of its own."""
    roll, late = 0.2 * slow_noise(9, 1.0), round(2 * CHANNEL_HZ)
    channels, flights = [], []
    for k, by in enumerate((0, late)):
        y, u, _ = looped(np.roll(roll, by), pushes(10 + k, 2.0))
        channels.append(channel(y, u))
        flights.append(flight(None, np.roll(np.cumsum(roll), by) / CHANNEL_HZ, f"flight {k}"))
    law = law_of(flights, channels)
    assert {i.source for i in law.instruments.values()} == {"other flights"}
    assert all(i.trust > 0.3 for i in law.instruments.values())
    assert best_gain(law, channels) == pytest.approx(GAIN, abs=0.25)
    other = [
        flights[0],
        replace(flights[1], table=flights[1].table.assign(vel_y=slow_noise(12, 1))),
    ]
    assert all(i.source != "other flights" for i in law_of(other, channels).instruments.values())


def moved(seed: int, push: float, asked: float = 0.1) -> tuple[Array, Array, Array]:
    """Angular acceleration, command and speed of an aircraft that is asked to go to and fro, which
    the air turns by `TWIST` as it does."""
    way = 10.0 * asked * slow_noise(seed, 0.3)
    step, lag = 1 / CHANNEL_HZ, 0.0
    turned = rate = speed = 0.0
    found = np.zeros((3, len(T_S)))
    for k, (want, d) in enumerate(zip(way, pushes(100 + seed, push), strict=True)):
        lag += 0.5 * (40.0 * (0.15 * (want - speed) - turned) - 9.0 * rate - lag)
        found[:, k] = GAIN * lag + TWIST * speed + d, lag, speed
        rate += step * found[0, k]
        turned += step * rate
        speed += step * 9.8 * turned
    return found[0], found[1], found[2]


@pytest.mark.parametrize("seed", range(4))
def test_the_flown_speed_tells_the_moment_of_the_air(seed: int) -> None:
    """Below the loop rotors answer to nothing else, whatever the gain of the plant."""
    y, u, speed = moved(seed, 1.0)
    c = channel(y, u)
    law = law_of([flight(None, speed)], [c])
    assert law.instruments[0, 0].source == "flown speed"
    assert law.instruments[0, 0].trust > 0.3
    rows, band = transformed(c, np.column_stack([y - GAIN * u, speed]))
    terms = law.terms(0, rows, np.where(band == 0, -1, band), np.zeros(len(band), dtype=np.intp))
    log = law.likelihood(terms).log
    twists = np.linspace(-20, 20, 401)
    logs = [log(np.array([np.array([1, -t]) @ x.gram @ [1, -t] for x in terms])) for t in twists]
    assert twists[np.argmax(logs)] == pytest.approx(TWIST, abs=1.5)


def test_a_hover_tells_no_moment_of_the_air() -> None:
    """What pushes it moves it, too: the controller would be read backwards."""
    y, u, speed = moved(1, 1.0, asked=0.0)
    assert np.std(speed) > 0.02
    assert not law_of([flight(None, speed)], [channel(y, u)]).instruments


@pytest.mark.parametrize("seed", range(3))
def test_a_mission_is_trusted_though_the_file_lacks_the_moment_of_the_air(seed: int) -> None:
    y, u, speed = moved(seed, 1.0)
    asked = Setpoint(VEL, T_S, np.column_stack([ZERO, slow_noise(seed, 0.3), ZERO]))
    both = replace(flight(None, speed), autopilot=Autopilot(setpoints=(asked,)))
    law = law_of([both], [channel(y, u)])
    assert law.instruments[0, 0].source == "mission"
    assert law.instruments[0, 0].trust > 0.3
    assert 1 in law.instruments[0, 0].bases
    assert best_gain(law, [channel(y - TWIST * speed, u)]) == pytest.approx(GAIN, abs=0.3)


@pytest.mark.slow
@settings(max_examples=15)
@given(st.floats(0, 3), st.integers(0, 100))
def test_the_density_does_not_know_how_loud_the_noise_is(decades: float, seed: int) -> None:
    """Anderson & Rubin: a ratio of what is along to what is across; rounding is next to none."""
    c, times = channel(*looped(0.1 * slow_noise(1, 1.0), pushes(2, 1.0))[:2]), 10**decades
    loud = replace(c, measured=times * c.measured, residual=times * c.residual)
    loud = replace(loud, slopes=times * c.slopes)
    rss = np.random.default_rng(seed).uniform(1, 100, 10)
    logs = []
    for each, scale in ((c, 1.0), (loud, times)):
        law = law_of([flight(rolled(0.1 * slow_noise(1, 1.0)))], [each])
        rows, band = transformed(each, each.residual[:, None])
        band = np.where(band == 0, -1, band)
        terms = law.terms(0, rows, band, np.zeros(len(band), dtype=np.intp))
        logs.append(law.likelihood(terms).log(scale**2 * rss[: len(terms)]))
    assert logs[1] == pytest.approx(logs[0], rel=1e-3)


def test_the_gradient_is_that_of_the_density() -> None:
    c = channel(*looped(0.1 * slow_noise(1, 1.0), pushes(2, 1.0))[:2])
    law = law_of([flight(rolled(0.1 * slow_noise(1, 1.0)))], [c])
    rows, band = transformed(c, c.residual[:, None])
    terms = law.terms(0, rows, band, np.zeros(len(band), dtype=np.intp))
    likelihood, rss = law.likelihood(terms), np.array([t.gram[0, 0] for t in terms])
    gradient, weight = likelihood.weights(rss)
    for i, step in enumerate(1e-6 * rss):
        ahead, back = rss.copy(), rss.copy()
        ahead[i] += step
        back[i] -= step
        slope = (likelihood.log(ahead) - likelihood.log(back)) / (2 * step)
        assert -2 * slope == pytest.approx(gradient[i], rel=1e-4, abs=1e-9)
    assert np.all(weight >= 0)


@pytest.mark.slow
def test_no_scale_changes_a_constant() -> None:
    """It is that of the moment, with the torque of the model as it stands, slopes and all."""
    vehicle = load_vehicle("copter_default")
    effects = [EFFECTS[e] for e in ("inertia_error", "yaw_torque_scale", "rotor_cant")]
    model = model_of([fly(vehicle, vehicle, seed=1)], vehicle, effects)
    problem = Problem.of(model, priors_of(model))
    names = list(problem.priors.names)
    x = np.zeros(len(names) + problem.rest.days.size)
    x[names.index("rotor_cant.yaw_m")] = 0.003
    scales = {"inertia_error.scale_x": 0.5, "inertia_error.scale_z": -0.3} | {
        "yaw_torque_scale.scale": -0.6
    }
    scaled = x.copy()
    scaled[[names.index(n) for n in scales]] = [*scales.values()]
    for plain, made in zip(problem.channels(x)[0], problem.channels(scaled)[0], strict=True):
        if "gyro_rate" in plain.name:
            # But for what was measured and the gyroscopic moment: 0.35 rad/s2 else about z.
            assert made.residual.mean() == pytest.approx(plain.residual.mean(), abs=0.003)
    for at in (x, scaled):
        for c in problem.channels(at, range(len(names)))[0]:
            if "gyro_rate" in c.name:
                for name in scales:
                    mean = c.slopes[:, names.index(name)].mean()
                    assert mean == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
def test_an_accelerometer_beside_the_centre_of_mass_tells_nothing_of_inertia() -> None:
    """It feels the turning that the gyroscope shows, not the one that the model predicts; a centre
    of mass that is off is the same as an accelerometer that is off the other way."""
    vehicle = replace(load_vehicle("copter_default"), imu_position_m=np.array([0.1, -0.05, 0.1]))
    flown = fly(vehicle, vehicle, 3)
    effects = [EFFECTS[e] for e in ("inertia_error", "imu_lever_arm", "cog_offset")]
    model = model_of([flown], vehicle, effects)
    names = [n.full for n in model.numbers]
    for c in model.channels(range(len(names)), {NUMBERS_OF_TURNING[2]: 0.05})[0]:
        scale, arm, centre = (c.slopes[:, names.index(n)] for n in NUMBERS_OF_TURNING)
        if c.name in ("acc_x", "acc_y"):
            assert not scale.any()
            assert centre == pytest.approx(-arm, abs=1e-9)
            assert np.std(arm) > 0.1
            assert np.std(c.residual + 0.05 * centre) < 0.2
        if c.name == "gyro_rate_x":
            assert scale.any()


NUMBERS_OF_TURNING = "inertia_error.scale_x", "imu_lever_arm.z_m", "cog_offset.z_m"
